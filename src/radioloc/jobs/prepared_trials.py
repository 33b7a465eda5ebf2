"""A Monte Carlo study made ready, and its trials with the whole model.

:class:`Prepared` has the world without noise and an arc for each length; from it come the fast trials
(:mod:`radioloc.jobs.linear_trials`), and it runs those that they are proved by, simulated and fitted in full.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from radioloc.estimation.consider import principal_errors
from radioloc.estimation.robust import linear_problem
from radioloc.jobs.compared_target import ComparedTarget, true_parameters
from radioloc.jobs.error_columns import GravityErrorOrbits
from radioloc.jobs.linear_trials import (
    LinearArc,
    LinearTrials,
    base_columns,
    rows_of,
    trial_seed,
    true_values,
    with_drawn_priors,
)
from radioloc.jobs.locate import solve
from radioloc.jobs.preparation import build_model, planned_arc, usability
from radioloc.jobs.problem import (
    ArcPart,
    EstimationProblem,
    arc_parts,
    considered_parameters,
    require_position_or_orbit,
)
from radioloc.jobs.simulate import build_scenario, names_in_scenario, planned_orbits
from radioloc.jobs.study_targets import position_in_pa
from radioloc.labels import USED, Labels
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.registry import KINDS
from radioloc.parameters.choice import ParameterChoice
from radioloc.parameters.kind import Scope
from radioloc.parameters.parameter import Parameter, ParameterSet, Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.results.monte_carlo import MonteCarlo
from radioloc.simulation import World
from radioloc.simulation.noise import NoiseDraws
from radioloc.study.study import Study
from radioloc.time import epochs_from_strings
from radioloc.vectors import Floats, Indices, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A study made ready: the world without noise, and an arc for each length."""

    study: Study
    world: World  # with the errors of the truth, none drawn
    rows: Indices  # those of the plan that the study asks for
    parts: tuple[ArcPart, ...]  # the longest arc first
    targets: tuple[ComparedTarget, ...]  # those with estimated parameters
    columns: tuple[str, ...]

    @property
    def _cases(self) -> list[tuple[ArcPart, int, float]]:
        """Part, number of the target among `targets`, and epoch of comparison of each row of a trial."""
        return [
            (part, k, at_h)
            for part in self.parts
            for k, target in enumerate(self.targets)
            for at_h in target.at_h(part)
        ]

    @property
    def hours(self) -> tuple[float, ...]:
        """Lengths of the arcs, h, of each row of a trial: once for each target and epoch of comparison."""
        return tuple(part.hours for part, _, _ in self._cases)

    def results(self, values: Floats, **fields: Any) -> list[MonteCarlo]:
        """Return the result of each target from the rows of all trials, shape (trials, rows, columns)."""
        cases, results = self._cases, []
        for k, target in enumerate(self.targets):
            rows = [row for row, (_, number, _) in enumerate(cases) if number == k]
            other_axes = [item.axes for item in self.targets if item.axes != target.axes]
            absent = {*base_columns(*other_axes)} - {*base_columns(target.axes)}
            columns = [column for column, name in enumerate(self.columns) if name not in absent]
            at_h = tuple(cases[row][2] for row in rows) if target.compares_states else ()
            result = MonteCarlo(
                name=f"{self.study.name}, {target.truth.name}" if len(self.targets) > 1 else self.study.name,
                hours=tuple(cases[row][0].hours for row in rows),
                span_h=tuple(cases[row][0].span_h for row in rows),
                columns=tuple(self.columns[column] for column in columns),
                values=values[:, rows][..., columns],
                drawn=self.world.drawn_keys,
                at_h=at_h,
                notes=self.world.notes,
                **fields,
            )
            results.append(result)
        return results

    @classmethod
    def from_study(cls, study: Study, hours: Sequence[float]) -> Prepared:
        """Prepare a study for arcs of some lengths, the shortest first, h."""
        scenario = build_scenario(study)
        require_position_or_orbit(study, "a Monte Carlo study")
        model = build_model(study)
        for record in scenario.targets.values():
            if isinstance(record, LunarPosition):
                position_in_pa("[simulation.position]", record, model.ephemeris.constants)
        names = names_in_scenario(study, scenario)
        world = scenario.world(model, partial(considered_parameters, study))
        orbits = planned_orbits(study, scenario, model)
        observations = replace(study.observations, hours=hours[-1])
        whole_study = replace(study, reference=None, references=(), observations=observations)
        longest, _, rows = planned_arc(whole_study, world.plan.observations, model, orbits)
        # Clocks of the world and of the fits refer to one epoch.
        clock_epoch = study.estimate.clock_epoch or epochs_from_strings([scenario.clock_epoch_utc], "UTC")
        study = replace(study, reference=None, estimate=replace(study.estimate, clock_epoch=clock_epoch))
        parts = arc_parts(EstimationProblem.from_study(study, longest, study.estimate), reversed(hours))
        truths, targets = {item.name: item for item in world.targets}, []
        fitted = parts[0].problem.model
        for k in fitted.estimated_indices:
            target = fitted.targets[k]
            simulated = names[target.name if len(names) > 1 else next(iter(names))]
            record, true_orbit = scenario.targets[simulated], None
            if target.orbit is not None:
                target = target.with_orbit(orbits[target.name])
                true_orbit = scenario.orbit(model, record)  # type: ignore[arg-type]
            targets.append(ComparedTarget(k, target, truths[simulated], true_orbit))
        parameters = dict.fromkeys(
            p.name
            for part in parts
            for p in part.problem.model.parameters
            if p.kind not in ("position", "state") and p.role is Role.ESTIMATED
        )
        biases = study.estimate.parameters.get("range_bias", ParameterChoice())
        by_station = biases.scope(PARAMETERS["range_bias"]) in (Scope.STATION, Scope.PASS)
        columns = list(base_columns(*dict.fromkeys(target.axes for target in targets)))
        columns += [f"excess_noise_m.{KINDS[k]}" for k in np.unique(longest.observations.kind)]
        for name in parameters:
            columns += [name, f"{name}.sigma"]
            if by_station and name.startswith("range_bias."):
                columns.append(f"{name}.error")
        return cls(study, world, rows, tuple(parts), tuple(targets), tuple(columns))

    def run(self, seed: int, trials: Iterable[int]) -> Floats:
        """Trials with the whole model, as :meth:`LinearTrials.run`: each arc fitted from the a-priori position on."""
        truths = [true_parameters(part.problem, self.targets) for part in self.parts]
        return np.array([self._trial(trial_seed(seed, trial), truths) for trial in trials])

    def _trial(self, seed: int, truths: Sequence[Floats]) -> list[Floats]:
        world, rows = self.world, list[Floats]()
        errors, names = world.drawn.draw(seed), world.drawn.names
        noise_m = world.scenario.noise.draw(world.plan, seed)[0]
        value_m = (world.value_m + errors @ world.drawn.partials + noise_m)[self.rows]
        for part, x in zip(self.parts, truths, strict=True):
            problem = part.problem
            predictor = problem.predictor.with_values(value_m[part.rows])
            drawn = EstimationProblem.from_study(problem.study, predictor, problem.choice, problem.noise)
            parameters = with_drawn_priors(drawn.model.parameters, x, self._drawn_sigmas(problem), seed)
            order = replace(problem.order, is_of_trials=True)
            drawn = replace(drawn, model=replace(drawn.model, parameters=parameters), order=order)
            solution = solve(drawn, {}, consistency=False)
            sigmas, total = solution.sigmas(), solution.fit.total
            for target in self.targets:
                rows += rows_of(
                    self.columns,
                    target.axes,
                    *target.errors_m(part, solution, x, errors, names),
                    (solution.converged, total.used, total.rejected),
                    solution.noise_scale,
                    solution.fit.excess_noise_m,
                    {p.name: (solution.values[j], sigmas[j]) for j, p in enumerate(solution.parameters)},
                    true_values(world.errors, world.drawn.by_name(errors)),
                )
        return rows

    def _drawn_sigmas(self, problem: EstimationProblem) -> Floats:
        """Return sigmas of the a-priori positions on maps, which each trial draws; zero for the other parameters."""
        model, sigmas = problem.model, np.zeros(problem.reported_count)
        for prior in problem.choice.position_priors:
            [k] = (k for k in model.place_indices if model.targets[k].name == prior.target)
            begin = model.columns_of(k).stop - len(model.targets[k].parameters)
            rows = slice(begin, begin + (3 if prior.has_height else 2))
            sigmas[rows] = model.parameters.prior_sigmas[rows]
        return sigmas

    def linear(self) -> LinearTrials | None:
        """Return the trials by the linear model; None where it does not replace a fit, as with process noise."""
        longest = self.parts[0].problem
        if longest.has_process_noise:
            return None
        x = true_parameters(longest, self.targets)
        computed_m = longest.predictor.predict(longest.model.motions(x)).value_m
        usable = usability(longest.predictor)[0].are(USED)
        orbits = longest.orbits_with_gravity_errors(x)
        arcs = [self._linear_arc(part, usable[part.rows], orbits) for part in self.parts]
        if any(arc is None for arc in arcs):
            return None
        return LinearTrials(
            draws=NoiseDraws.from_plan(self.world.scenario.noise, self.world.plan),
            rows=self.rows,
            constant_m=self.world.value_m[self.rows] - computed_m,
            drawn=self.world.drawn.rows(self.rows),
            arcs=tuple(arc for arc in arcs if arc is not None),
            columns=self.columns,
            errors=self.world.errors,
        )

    def _linear_arc(self, part: ArcPart, usable: Mask, orbits: GravityErrorOrbits) -> LinearArc | None:
        """Return an arc linearized at the truth; None where its partials are not finite."""
        problem = part.problem
        model, noise, estimate, count = problem.model, problem.noise, problem.choice, problem.reported_count
        order = replace(problem.order, is_of_trials=True)
        assert estimate is not None
        x = true_parameters(problem, self.targets)
        rows = np.arange(len(part.rows))
        partials = model.linearize(x).partials(rows)
        effects = partials[:, count:] * model.parameters.prior_sigmas[count:]  # of one sigma of each error
        held_m = partials[:, model.first :] @ x[model.first :]
        reported = ParameterSet(model.parameters.parameters[:count])
        by_reported = linear_problem(partials[:, :count], reported, x[:count], noise, usable)
        if by_reported is None:
            return None
        directions = principal_errors(effects, noise.sigma_m, by_reported.basis, usable)
        parameters = ParameterSet(
            [
                *reported,
                *(
                    Parameter(f"considered.{k}", "1", "considered", 0.0, 1.0, role=Role.CONSIDERED)
                    for k in range(directions.shape[1])
                ),
            ]
        )
        values = np.append(x[:count], np.zeros(directions.shape[1]))
        linear = linear_problem(
            np.hstack([partials[:, :count], directions]), parameters, values, noise, usable, order
        )
        if linear is None:
            return None
        unadjusted = problem.unadjusted_errors(model, x, orbits)
        return LinearArc(
            part=part.rows,
            problem=linear,
            parameters=parameters,
            held_m=held_m,
            compared=tuple(
                target.compared(part, x, orbits, self.world.drawn.names, unadjusted.parameters)
                for target in self.targets
            ),
            noise=noise,
            status=Labels((~usable).astype(np.int32), (USED, "not usable")),
            order=order,
            estimate=replace(estimate, height_prior=None),  # which is in the parameters; a map is large
            unadjusted_m=unadjusted.partials(rows) * unadjusted.parameters.prior_sigmas,
            drawn_sigmas=self._drawn_sigmas(problem),
        )
