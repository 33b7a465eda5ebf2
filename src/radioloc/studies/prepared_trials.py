"""A Monte Carlo study made ready, and its trials with the whole model.

:class:`Prepared` has the world without noise and an arc for each length; from it come the fast trials
(:mod:`radioloc.studies.linear_trials`) and those that they are proved by, simulated and fitted in full, a second each.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.ephemeris import Trajectory
from radioloc.errors import InputError
from radioloc.estimation.build import seconds_since_midnight
from radioloc.estimation.consider import few_errors
from radioloc.estimation.labels import USED, Labels
from radioloc.estimation.robust import linear_problem
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.solution import Solution
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.registry import KINDS
from radioloc.parameters.choice import ParameterChoice
from radioloc.parameters.design import ObservationModel
from radioloc.parameters.kind import Scope
from radioloc.parameters.registry import PARAMETERS
from radioloc.simulation import World
from radioloc.simulation.noise import NoiseDraws
from radioloc.simulation.simulate import rot_pa_to_enu
from radioloc.simulation.truth import position_error_m
from radioloc.studies.linear_trials import (
    COLUMNS,
    LinearArc,
    LinearTrials,
    row_of,
    trial_seed,
    true_values,
)
from radioloc.studies.locate import fit_arc, model_of
from radioloc.studies.orbiter import Orbiter
from radioloc.studies.problem import (
    considered_errors,
    needs_more_partials,
    observation_model,
    position_in_pa,
    status_of,
)
from radioloc.studies.selection import ArcPart, arc_parts, require_planned_counts, selected
from radioloc.studies.simulate import scenario_of
from radioloc.studies.station_noise import stated_noise
from radioloc.studies.study import Study
from radioloc.studies.weights import weighted_observations

_Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A study made ready: the world without noise, and an arc for each length."""

    study: Study
    model: PhysicalModel  # the nominal one
    world: World  # with the errors of the truth, none drawn
    rows: NDArray[np.intp]  # those of the plan that the study asks for
    parts: tuple[ArcPart, ...]  # the longest arc first
    rot_pa_to_enu: _Floats  # (3, 3), at the true position
    columns: tuple[str, ...]

    @property
    def hours(self) -> tuple[float, ...]:
        """Lengths of the arcs, h."""
        return tuple(part.hours for part in self.parts)

    @classmethod
    def of(cls, study: Study, hours: Sequence[float]) -> Prepared:
        """Prepare a study for arcs of some lengths, the shortest first, h.

        Raises
        ------
        RadiolocError
            The study has no simulation or estimates no position, or it cannot be simulated.
        """
        scenario = scenario_of(study)
        require_planned_counts(study.observations)
        if isinstance(study.target, Trajectory | Orbiter) or not isinstance(scenario.position, LunarPosition):
            raise InputError(
                f"{study.name}: a Monte Carlo study compares positions, but the target is a trajectory"
            )
        if study.observations.map_positions:
            raise InputError(
                f"{study.name}: a Monte Carlo study draws tracking, but no places on maps; leave "
                "[[observations.map_positions]] out, or use `radioloc covariance`, which allows for them"
            )
        if study.estimate.position == "none":
            raise InputError(
                'a Monte Carlo study needs the position estimated: [estimate] position is "none"'
            )
        model = model_of(study)
        constants = model.ephemeris.constants
        target = position_in_pa("[target]", study.target, constants)
        position_in_pa("[simulation.position]", scenario.position, constants)
        world = scenario.world(model)
        choice = replace(study.observations, hours=hours[-1])
        rows = np.flatnonzero(
            selected(world.plan.observations, choice, study.catalogue, sources=model.sources)[0]
        )
        planned = weighted_observations(
            world.plan.observations.select(rows), study.observations.weights, study.catalogue
        )
        longest = prepare_predictor(
            model, planned, target.xyz_m, study.model.evaluation, more_partials=needs_more_partials(study)
        )
        parts = arc_parts(longest, study, reversed(hours))
        names = dict.fromkeys(
            p.name
            for part in parts
            for p in observation_model(part.arc, target, part.estimate).parameters
            if p.kind != "position" and not p.fixed
        )
        biases = study.estimate.parameters.get("range_bias", ParameterChoice())
        by_station = biases.scope(PARAMETERS["range_bias"]) in (Scope.STATION, Scope.PASS)
        has_error = [name for name in names if by_station and name.startswith("range_bias.")]
        kinds = [KINDS[k] for k in np.unique(longest.observations.kind)]
        return cls(
            study=study,
            model=model,
            world=world,
            rows=rows,
            parts=tuple(parts),
            rot_pa_to_enu=rot_pa_to_enu(world.target_pa_m, model),
            columns=(
                *COLUMNS,
                *(f"excess_noise_m.{kind}" for kind in kinds),
                *(
                    column
                    for name in names
                    for column in (name, f"{name}.sigma", *([f"{name}.error"] if name in has_error else []))
                ),
            ),
        )

    def linear(self) -> LinearTrials | None:
        """The trials by the linear model; none where it cannot stand for the fit of every arc."""
        longest = self.parts[0].arc
        computed_m = longest.at(self.world.target_pa_m).value_m
        usable = status_of(longest, {"": self._target_pa})[0].are(USED)
        arcs = []
        for part in self.parts:
            one = self._linear_arc(part, usable[part.rows])
            if one is None:
                return None
            arcs.append(one)
        return LinearTrials(
            draws=NoiseDraws.of(self.world.scenario.noise, self.world.plan),
            rows=self.rows,
            constant_m=self.world.value_m[self.rows] - computed_m,
            drawn=self.world.drawn.rows(self.rows),
            arcs=tuple(arcs),
            columns=self.columns,
            errors=self.world.errors,
        )

    @property
    def _target_pa(self) -> LunarPosition:
        """A-priori position."""
        assert isinstance(self.study.target, LunarPosition)  # others are refused
        return position_in_pa("[target]", self.study.target, self.model.ephemeris.constants)

    def _linear_arc(self, part: ArcPart, usable: NDArray[np.bool_]) -> LinearArc | None:
        study, arc = self.study, part.arc
        problem = observation_model(arc, self._target_pa, part.estimate)
        x = _parameters_at(problem, self.world.target_pa_m)
        partials = problem.linearize(x).partials(np.arange(len(part.rows)))
        noise = stated_noise(arc, study.observations)
        made = linear_problem(partials, problem.parameters, x, noise, usable)
        if made is None:
            return None
        observations = arc.observations
        considered, _ = considered_errors(study, problem, part.estimate, x)
        considered_m, count_at_stations = np.zeros((len(part.rows), 0)), 0
        if considered is not None:
            considered_m, count_at_stations = few_errors(considered, noise.sigma_m)
        types = Labels(observations.kind.astype(np.int32), tuple(KINDS))
        paths = Labels.coded([link.path for link in observations.links], observations.link)
        order = SeriesOrder.of(types, paths, seconds_since_midnight(observations.epoch))
        return LinearArc(
            part=part.rows,
            problem=made,
            parameters=problem.parameters,
            held_m=partials[:, 3:] @ x[3:],
            enu_by_parameters=self.rot_pa_to_enu @ problem.position_partials(x),
            ephemeris_sigma_m=np.array(part.estimate.ephemeris_sigma_m),
            noise=noise,
            status=Labels((~usable).astype(np.int32), (USED, "not usable")),
            threshold=study.estimate.rejection_sigma,
            order=order,
            groups=part.estimate.component_groups(order),
            height_m=float(np.linalg.norm(self.world.target_pa_m)) - MEAN_LUNAR_RADIUS_M,
            considered_m=considered_m,
            count_at_stations=count_at_stations,
            correlated=study.estimate.weights == "correlated",
            huber=study.estimate.estimator == "huber",
        )


def _parameters_at(problem: ObservationModel, position_pa_m: _Floats) -> _Floats:
    """Parameters of a position, the others at their a-priori values."""
    x = problem.parameters.prior_values.copy()
    for _ in range(20):
        found_m, partials = problem.positions[0](x[:3])
        step = np.linalg.solve(partials, position_pa_m - found_m)
        x[:3] += step
        if np.abs(step).max() < 1e-7:
            return x
    raise InputError(
        "the true position is not among those that the parameters describe; move [target] closer to it"
    )


@dataclass(frozen=True, slots=True, eq=False)
class FullTrials:
    """Trials with the whole model: each world simulated, each arc fitted from the a-priori position on."""

    ready: Prepared  # workers get it as it is; they need no kernels or tables of their own

    def run(self, seed: int, trials: Iterable[int]) -> _Floats:
        """As :meth:`LinearTrials.run`."""
        return np.array([_full_trial(self.ready, trial_seed(seed, trial)) for trial in trials])


def _full_trial(ready: Prepared, seed: int) -> _Floats:
    world = ready.world
    errors = world.drawn.draw(seed)
    value_m = world.value_m + errors @ world.drawn.partials + world.scenario.noise.draw(world.plan, seed)[0]
    value_m = value_m[ready.rows]
    study = replace(ready.study, reference=None)
    found = []
    for part in ready.parts:
        arc = part.arc.with_values(value_m[part.rows])
        solution = fit_arc(study, arc, {}, part.estimate, consistency=False)
        found.append(_solution_row(ready, solution, world.drawn.by_name(errors)))
    return np.array(found)


def _solution_row(ready: Prepared, solution: Solution, drawn: dict[str, float]) -> _Floats:
    sigmas = solution.sigmas()
    return row_of(
        ready.columns,
        converged=solution.converged,
        used=solution.fit.total.used,
        rejected=solution.fit.total.rejected,
        error_m=ready.rot_pa_to_enu @ (solution.position_pa_m - ready.world.target_pa_m)
        - position_error_m(drawn),
        covariance_m2=solution.position_covariance("enu"),
        noise_scale=solution.noise_scale,
        excess_noise_m=dict(solution.fit.excess_noise_m),
        parameters={p.name: (solution.values[j], sigmas[j]) for j, p in enumerate(solution.parameters)},
        true=true_values(ready.world.errors, drawn),
    )
