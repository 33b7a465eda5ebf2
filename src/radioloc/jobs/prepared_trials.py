"""A Monte Carlo study made ready, and its trials with the whole model.

:class:`Prepared` has the world without noise and an arc for each length; from it come the fast trials
(:mod:`radioloc.jobs.linear_trials`), and it runs those that they are proved by, simulated and fitted in full.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.dynamics import AdjustableOrbit, Orbit
from radioloc.errors import InputError
from radioloc.estimation.consider import few_errors
from radioloc.estimation.robust import linear_problem
from radioloc.jobs.linear_trials import (
    Compared,
    LinearArc,
    LinearTrials,
    base_columns,
    drawn_prior_errors,
    rows_of,
    trial_seed,
    true_values,
)
from radioloc.jobs.locate import solve
from radioloc.jobs.preparation import model_of, planned_arc
from radioloc.jobs.problem import ArcPart, EstimationProblem, arc_parts, require_position_or_orbit
from radioloc.jobs.simulate import scenario_of
from radioloc.jobs.study_targets import position_in_pa
from radioloc.jobs.usability import usability
from radioloc.labels import USED, Labels
from radioloc.lunar import rot_pa_to_me
from radioloc.lunar.local import local_difference, rot_pa_to_enu
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.registry import KINDS
from radioloc.measurements.target_motion import FixedPoint, OrbitMotion
from radioloc.parameters.choice import ParameterChoice
from radioloc.parameters.kind import Scope
from radioloc.parameters.parameter import Parameter, ParameterSet, Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.results.solution import Solution
from radioloc.simulation import World
from radioloc.simulation.noise import NoiseDraws
from radioloc.simulation.truth import GRAVITY_ERROR
from radioloc.study.study import EstimateChoice, Study
from radioloc.targets.descent import Descent
from radioloc.targets.design import ObservationModel, orbit_of
from radioloc.targets.orbit_state import (
    ALONG_ACROSS_RADIAL,
    EAST_NORTH_UP,
    LOCAL_LEVEL,
    along_across_radial,
)
from radioloc.time import Epochs, tt_to_tdb, utc_to_tt

_Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A study made ready: the world without noise, and an arc for each length."""

    study: Study
    world: World  # with the errors of the truth, none drawn
    rows: NDArray[np.intp]  # those of the plan that the study asks for
    parts: tuple[ArcPart, ...]  # the longest arc first
    columns: tuple[str, ...]
    true_orbit: AdjustableOrbit | None = None  # of a spacecraft

    @property
    def _of_states(self) -> bool:
        """Whether states of an orbit are compared with the truth, and not positions."""
        return self.study.orbiter is not None and not self.study.lands

    @property
    def hours(self) -> tuple[float, ...]:
        """Lengths of the arcs, h, once for each epoch at which they are compared with the truth."""
        return tuple(part.hours for part in self.parts for _ in range(self._epochs))

    @property
    def span_h(self) -> tuple[float, ...]:
        """Likewise from the start to the last observation."""
        return tuple(part.span_h for part in self.parts for _ in range(self._epochs))

    @property
    def at_h(self) -> tuple[float, ...]:
        """Of an orbit those epochs, from that of the state, h."""
        orbiter = self.study.orbiter
        if orbiter is None or not self._of_states:
            return ()
        epochs_s = (self.epochs(part).seconds_since(orbiter.epoch) for part in self.parts)
        return tuple((np.concatenate(list(epochs_s)) / 3600.0).tolist())

    @property
    def _epochs(self) -> int:
        return 3 if self._of_states else 1

    def epochs(self, part: ArcPart) -> Epochs:
        """When an orbit is compared with the truth: at its epoch, in the middle and at the end of the tracking, TDB."""
        assert self.study.orbiter is not None
        epoch = self.study.orbiter.epoch
        first_s, last_s = (
            tt_to_tdb(utc_to_tt(part.problem.arc.observations.span())).seconds_since(epoch).tolist()
        )
        return epoch.shifted(np.array([0.0, 0.5 * (first_s + last_s), last_s]))

    @classmethod
    def of(cls, study: Study, hours: Sequence[float]) -> Prepared:
        """Prepare a study for arcs of some lengths, the shortest first, h."""
        scenario = scenario_of(study)
        if scenario.trajectory is not None:
            raise InputError(
                f"{study.name}: a Monte Carlo study compares positions and orbits, but the target is a trajectory"
            )
        require_position_or_orbit(study, "a Monte Carlo study")
        model, orbit, truth = model_of(study), None, None
        constants = model.ephemeris.constants
        if scenario.place is not None:
            position_in_pa("[simulation.position]", scenario.place, constants)
        if study.orbiter is not None:
            assert study.estimate.orbit is not None
            forces = study.estimate.orbit.parameters(study.orbiter.forces)
            orbit = scenario.orbit(model, study.orbiter, forces)
            assert scenario.flight is not None
            truth = scenario.orbit(model, scenario.flight)
        world = scenario.world(model)
        observations = replace(study.observations, hours=hours[-1])
        whole_study = replace(study, reference=None, references=(), observations=observations)
        longest, _, rows = planned_arc(whole_study, world.plan.observations, model, orbit)
        study = replace(study, reference=None)
        parts = arc_parts(EstimationProblem.of(study, longest, study.estimate), reversed(hours))
        names = dict.fromkeys(
            p.name
            for part in parts
            for p in part.problem.model.parameters
            if p.kind not in ("position", "state") and p.role is Role.ESTIMATED
        )
        biases = study.estimate.parameters.get("range_bias", ParameterChoice())
        by_station = biases.scope(PARAMETERS["range_bias"]) in (Scope.STATION, Scope.PASS)
        lands = study.lands
        columns = list(base_columns(ALONG_ACROSS_RADIAL if orbit and not lands else EAST_NORTH_UP))
        columns += [f"excess_noise_m.{KINDS[k]}" for k in np.unique(longest.observations.kind)]
        for name in names:
            columns += [name, f"{name}.sigma"]
            if by_station and name.startswith("range_bias."):
                columns.append(f"{name}.error")
        return cls(study, world, rows, tuple(parts), tuple(columns), truth)

    def run(self, seed: int, trials: Iterable[int]) -> _Floats:
        """Trials with the whole model, as :meth:`LinearTrials.run`: each arc fitted from the a-priori position on."""
        return np.array([self._trial(trial_seed(seed, trial)) for trial in trials])

    def _trial(self, seed: int) -> list[_Floats]:
        world, found = self.world, list[_Floats]()
        errors = world.drawn.draw(seed)
        noise_m = world.scenario.noise.draw(world.plan, seed)[0]
        value_m = (world.value_m + errors @ world.drawn.partials + noise_m)[self.rows]
        for part in self.parts:
            problem = part.problem
            arc = problem.arc.with_values(value_m[part.rows])
            assert problem.estimate is not None
            estimate = self._with_drawn_prior(problem.estimate, seed)
            drawn = EstimationProblem.of(problem.study, arc, estimate, problem.noise)
            solution = solve(drawn, {}, consistency=False)
            sigmas, total = solution.sigmas(), solution.fit.total
            found += rows_of(
                self.columns,
                *self._errors_m(part, solution, errors),
                (solution.converged, total.used, total.rejected),
                solution.noise_scale,
                solution.fit.excess_noise_m,
                {p.name: (solution.values[j], sigmas[j]) for j, p in enumerate(solution.parameters)},
                true_values(world.errors, world.drawn.by_name(errors)),
            )
        return found

    def _drawn_prior_sigmas(self, estimate: EstimateChoice, count: int) -> _Floats | None:
        """Standard deviations of a-priori values that are drawn in each trial, those of a position on a map."""
        if not estimate.position_priors:
            return None
        sigmas, (_, of_position) = np.zeros(count), estimate.position_priors[0].factors()
        sigmas[:3] = np.where(np.isfinite(of_position), of_position, 0.0)
        return sigmas

    def _with_drawn_prior(self, estimate: EstimateChoice, seed: int) -> EstimateChoice:
        """The a-priori position of a map about the truth, with an error drawn from its covariance."""
        if not estimate.position_priors:
            return estimate
        [prior] = estimate.position_priors
        model = self.parts[0].problem.arc.model
        truth = LunarPosition.from_cartesian(self.world.target_pa_m, model.libration.frame)
        about_truth = replace(prior, mean=truth.to_axes("ME", model.ephemeris.constants))
        sigmas = self._drawn_prior_sigmas(estimate, 3)
        assert sigmas is not None
        offset_m = prior.factors()[0] @ drawn_prior_errors(sigmas, seed)
        drawn = replace(prior, mean=about_truth.mean_displaced(offset_m))
        return replace(estimate, position_priors=(drawn,))

    def _errors_m(self, part: ArcPart, solution: Solution, drawn: _Floats) -> tuple[_Floats, _Floats]:
        """How far a solution is from the truth, (q, d), and what it says of that, (q, d, d)."""
        world = self.world
        moved_m = self.drawn_moves(part, world.drawn.names) @ drawn
        if solution.state is None or not self._of_states:
            place_m, enu_pa = self._true_place(part)
            error = local_difference(solution.position_pa_m, place_m, enu_pa)
            return error.enu_m - moved_m, solution.position_covariance("enu")[None]
        assert isinstance(world.trajectory, Orbit)
        tdb = self.epochs(part)
        apart = np.hstack(solution.state.orbit.states(tdb)) - np.hstack(world.trajectory.states(tdb))
        covariances = solution.state.covariance_rtn(tdb)[:, LOCAL_LEVEL][:, :, LOCAL_LEVEL]
        return along_across_radial(world.trajectory, tdb, apart[..., None])[..., 0] - moved_m, covariances

    def linear(self) -> LinearTrials | None:
        """Return the trials by the linear model; None where it does not replace a fit, as with process noise."""
        longest = self.parts[0].problem
        if longest.process_noise is not None:
            return None
        x = self.true_parameters(longest)
        motions = longest.model.motions(x) if self.true_orbit else FixedPoint(self.world.target_pa_m)
        computed_m = longest.arc.at(motions).value_m
        usable = usability(longest.arc)[0].are(USED)
        orbits = longest.orbits_with_gravity_errors(x)
        orbit = next(iter(orbits.values()), None)
        arcs = [self._linear_arc(part, usable[part.rows], orbit) for part in self.parts]
        if any(arc is None for arc in arcs):
            return None
        return LinearTrials(
            draws=NoiseDraws.of(self.world.scenario.noise, self.world.plan),
            rows=self.rows,
            constant_m=self.world.value_m[self.rows] - computed_m,
            drawn=self.world.drawn.rows(self.rows),
            arcs=tuple(arc for arc in arcs if arc is not None),
            columns=self.columns,
            errors=self.world.errors,
        )

    def true_parameters(self, problem: EstimationProblem) -> _Floats:
        """Return the parameters of the true position or state, the others at their a-priori values."""
        model = problem.model
        if self.study.lands:
            assert self.true_orbit is not None
            [descent] = model.targets
            assert isinstance(descent, Descent)
            x = model.parameters.prior_values.copy()
            x[:6] = descent.touchdown_of(self.true_orbit.state)
            return x
        wanted = self.world.target_pa_m
        if self.study.orbiter is not None:
            assert self.world.scenario.flight is not None
            wanted = np.zeros(model.first)
            wanted[:6] = self.world.scenario.flight.state - self.study.orbiter.state
        return _parameters_at(model, wanted)

    def _true_place(self, part: ArcPart) -> tuple[_Floats, _Floats]:
        """True position, principal axes, m, and the axes east, north and up there, as rows."""
        if self.true_orbit is None:
            return self.world.target_pa_m, self.world.enu_pa
        model = part.problem.model
        place_m = model.position_pa_m(self.true_parameters(part.problem))
        return place_m, rot_pa_to_enu(place_m, rot_pa_to_me(model.predictor.model.ephemeris.constants))

    def drawn_moves(self, part: ArcPart, names: Sequence[str]) -> _Floats:
        """How drawn errors move what is compared, shape (q, d, k)."""
        if not self._of_states:
            return np.array(
                [[[name == f"position.{side}" for name in names] for side in EAST_NORTH_UP]], dtype=float
            )
        moves = np.zeros((3, 6, len(names)))
        errant = self.world.orbit_with_errors
        if errant is not None:
            of_gravity = [name.startswith(f"{GRAVITY_ERROR}.") for name in names]
            tdb = self.epochs(part)
            moves[..., of_gravity] = along_across_radial(errant, tdb, errant.effects(tdb))
        return moves

    def _compared(self, part: ArcPart, x: _Floats, orbit: AdjustableOrbit | None, count: int) -> Compared:
        """Return the comparison of estimates with the truth; `count` suboptimal errors end with those of gravity."""
        problem, by_drawn = part.problem, self.drawn_moves(part, self.world.drawn.names)
        model, reported = problem.model, problem.reported_count
        assert problem.estimate is not None
        if not self._of_states:
            by_parameters = self._true_place(part)[1] @ model.position_partials(x)[:, :reported]
            ephemeris_m2 = np.diag(np.array(problem.estimate.ephemeris_sigma_m) ** 2)
            return Compared(
                by_parameters[None], by_drawn, np.zeros((1, 3, count)), np.zeros((1, 3)), ephemeris_m2
            )
        assert isinstance(self.world.trajectory, Orbit)
        tdb = self.epochs(part)
        whole_orbit = orbit_of(self.parts[0].problem.arc)  # over the whole plan
        assert whole_orbit is not None
        model = model.with_orbit(whole_orbit)
        estimate = model.orbit_at(x)
        assert estimate is not None
        by_considered = np.zeros((len(tdb), 6, count))
        if orbit is not None:
            direct = along_across_radial(estimate, tdb, orbit.effects(tdb))
            by_considered[..., count - direct.shape[-1] :] = -direct  # it is the truth that they move
        difference = np.hstack(self.world.trajectory.states(tdb)) - np.hstack(estimate.states(tdb))
        offset_m = along_across_radial(estimate, tdb, difference[..., None])[..., 0]
        by_parameters = model.local_partials(x, tdb)[..., :reported]
        return Compared(by_parameters, by_drawn, by_considered, offset_m, np.zeros((6, 6)))

    def _linear_arc(
        self, part: ArcPart, usable: NDArray[np.bool_], orbit: AdjustableOrbit | None
    ) -> LinearArc | None:
        """Return an arc linearized at the truth; None where its partials are not finite."""
        problem = part.problem
        model, noise, estimate, count = problem.model, problem.noise, problem.estimate, problem.reported_count
        assert estimate is not None
        x = self.true_parameters(problem)
        rows = np.arange(len(part.rows))
        partials = model.linearize(x).partials(rows)
        effects = (
            partials[:, count:] * model.parameters.prior_sigmas[count:]
        )  # of considered errors of one sigma
        held_m = partials[:, model.first :] @ x[model.first :]
        reported = ParameterSet(model.parameters.parameters[:count])
        alone = linear_problem(partials[:, :count], reported, x[:count], noise, usable)
        if alone is None:
            return None
        few = few_errors(effects, noise.sigma_m, alone.basis, usable)
        parameters = ParameterSet(
            [
                *reported,
                *(
                    Parameter(f"considered.{k}", "1", "considered", 0.0, 1.0, role=Role.CONSIDERED)
                    for k in range(few.shape[1])
                ),
            ]
        )
        values = np.append(x[:count], np.zeros(few.shape[1]))
        linear = linear_problem(np.hstack([partials[:, :count], few]), parameters, values, noise, usable)
        if linear is None:
            return None
        suboptimal = problem.suboptimal_errors(
            model, x, {} if orbit is None else {model.orbit_indices[0]: orbit}
        )
        suboptimal_m = np.zeros((len(rows), 0))
        if suboptimal is not None:
            suboptimal_m = suboptimal.partials(rows) * suboptimal.parameters.prior_sigmas
        return LinearArc(
            part=part.rows,
            problem=linear,
            parameters=parameters,
            held_m=held_m,
            compared=self._compared(part, x, orbit, suboptimal_m.shape[1]),
            noise=noise,
            status=Labels((~usable).astype(np.int32), (USED, "not usable")),
            order=problem.order,
            estimate=replace(estimate, height_prior=None),  # which is in the parameters; a map is large
            height_m=None
            if self._of_states
            else float(np.linalg.norm(self._true_place(part)[0])) - MEAN_LUNAR_RADIUS_M,
            suboptimal_m=suboptimal_m,
            drawn_prior_sigmas=self._drawn_prior_sigmas(estimate, len(values)),
        )


def _parameters_at(model: ObservationModel, wanted: _Floats) -> _Floats:
    """Return parameters of a position, or of changes of an orbit, the others at their a-priori values."""
    x, count = model.parameters.prior_values.copy(), len(wanted)
    for _ in range(20):
        motion, partials = model.targets[0].motion(x[:count])
        reached = motion.changes if isinstance(motion, OrbitMotion) else motion.position_pa_m
        step = np.linalg.solve(partials, wanted - reached)
        x[:count] += step
        if np.abs(step).max() < 1e-7:
            return x
    raise InputError(
        "the true position is not among those that the parameters describe; move [target] closer to it"
    )
