"""Targets of simulated trials, whose estimates are compared with the truth: a place, or the states of an orbit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.dynamics import AdjustableOrbit, Orbit
from radioloc.jobs.error_columns import GravityErrorOrbits, own_gravity_errors
from radioloc.jobs.linear_trials import Compared
from radioloc.jobs.problem import ArcPart, EstimationProblem
from radioloc.lunar import rot_pa_to_me
from radioloc.lunar.local import local_difference, rot_pa_to_enu
from radioloc.parameters.parameter import ParameterSet
from radioloc.results.solution import Solution
from radioloc.simulation.truth import GRAVITY_ERROR, TrueTarget
from radioloc.targets.orbit_state import LOCAL_LEVEL, along_across_radial
from radioloc.targets.target import Target
from radioloc.time import Epochs, tt_to_tdb, utc_to_tt
from radioloc.vectors import Floats


@dataclass(frozen=True, slots=True, eq=False)
class ComparedTarget:
    """A target of a problem with its true position or orbit."""

    index: int  # among the targets of the problem
    target: Target  # of the longest arc; its orbit spans the whole plan
    truth: TrueTarget
    orbit: AdjustableOrbit | None = None  # true orbit of a spacecraft

    @property
    def axes(self) -> tuple[str, str, str]:
        """Axes of the errors."""
        return self.target.local_axes

    @property
    def compares_states(self) -> bool:
        """True if states of an orbit are compared, not a place."""
        return not self.target.has_place

    def epochs(self, part: ArcPart) -> Epochs:
        """Return the epochs at which an orbit is compared: its own, the middle and the end of the tracking, TDB."""
        epoch = self._true_orbit.epoch
        span = tt_to_tdb(utc_to_tt(part.problem.predictor.observations.span()))
        first_s, last_s = span.seconds_since(epoch).tolist()
        return epoch.shifted(np.array([0.0, 0.5 * (first_s + last_s), last_s]))

    def at_h(self, part: ArcPart) -> list[float]:
        """Return the epochs of comparison from that of the orbit, h; NaN of a place."""
        if not self.compares_states:
            return [np.nan]
        return (self.epochs(part).seconds_since(self._true_orbit.epoch) / 3600.0).tolist()

    @property
    def true_motion(self) -> Floats:
        """True position, m, parameters of the orbit with the true state, or those of a registered kind."""
        if self.truth.values is not None:
            return self.truth.values
        if self.orbit is None:
            return self.truth.position_pa_m
        assert self.target.orbit is not None
        values = np.array(list(self.target.orbit.values.values()))
        values[:6] = self.orbit.state
        return values

    def errors_m(
        self, part: ArcPart, solution: Solution, x: Floats, drawn: Floats, names: Sequence[str]
    ) -> tuple[Floats, Floats]:
        """Return the errors of a solution, (q, d), and their claimed covariance, (q, d, d).

        `x` are the true parameters, `drawn` the drawn errors with their `names`.
        """
        moved_m = self.drawn_moves(part, names) @ drawn
        if not self.compares_states:
            of_target = solution.of_target(self.target.name) if solution.targets else solution
            place_m, enu_pa = self._true_place(part, x)
            error = local_difference(of_target.position_pa_m, place_m, enu_pa)
            return error.enu_m - moved_m, of_target.position_covariance("enu")[None]
        state, tdb, truth = solution.states[self.target.name], self.epochs(part), self._trajectory
        difference = np.hstack(state.orbit.states(tdb)) - np.hstack(truth.states(tdb))
        covariances = state.covariance_rtn(tdb)[:, LOCAL_LEVEL][:, :, LOCAL_LEVEL]
        return along_across_radial(truth, tdb, difference[..., None])[..., 0] - moved_m, covariances

    def drawn_moves(self, part: ArcPart, names: Sequence[str]) -> Floats:
        """Return the changes of the truth by drawn errors, shape (q, d, k)."""
        if not self.compares_states:
            return np.array(
                [[[name == error for name in names] for error in self.truth.position_errors]], dtype=float
            )
        moves, disturbed = np.zeros((3, 6, len(names))), self.truth.with_gravity_errors
        if disturbed is not None:
            of_gravity, tdb = [name.startswith(f"{GRAVITY_ERROR}.") for name in names], self.epochs(part)
            moves[..., of_gravity] = along_across_radial(disturbed, tdb, disturbed.effects(tdb))
        return moves

    def compared(
        self,
        part: ArcPart,
        x: Floats,
        orbits: GravityErrorOrbits,
        names: Sequence[str],
        unadjusted: ParameterSet,
    ) -> Compared:
        """Return the comparison of estimates linearized at x, where errors outside the weights change the truth."""
        problem, by_drawn = part.problem, self.drawn_moves(part, names)
        model, reported = problem.model, problem.reported_count
        if not self.compares_states:
            place_m, enu_pa = self._true_place(part, x)
            return Compared(
                axes=self.axes,
                by_parameters=(enu_pa @ model.position_partials(x, self.index)[:, :reported])[None],
                by_drawn=by_drawn,
                by_considered=np.zeros((1, 3, len(unadjusted))),
                offset_m=np.zeros((1, 3)),
                added_m2=np.diag(np.array(problem.choice.ephemeris_sigma_m) ** 2),
                height_m=float(np.linalg.norm(place_m)) - MEAN_LUNAR_RADIUS_M,
            )
        tdb, truth = self.epochs(part), self._trajectory
        estimate = self.target.orbit_at(x[model.columns_of(self.index)])
        assert estimate is not None
        by_considered = np.zeros((len(tdb), 6, len(unadjusted)))
        if self.index in orbits:
            of_gravity = own_gravity_errors(unadjusted, orbits, model, self.index)
            direct = along_across_radial(estimate, tdb, orbits[self.index].effects(tdb))
            by_considered[..., of_gravity] = -direct  # it is the truth that they move
        difference = np.hstack(truth.states(tdb)) - np.hstack(estimate.states(tdb))
        assert self.target.orbit is not None
        over_plan = model.with_orbit(self.target.orbit, self.index)
        return Compared(
            axes=self.axes,
            by_parameters=over_plan.local_partials(x, tdb, self.index)[..., :reported],
            by_drawn=by_drawn,
            by_considered=by_considered,
            offset_m=along_across_radial(estimate, tdb, difference[..., None])[..., 0],
            added_m2=np.zeros((6, 6)),
        )

    @property
    def _true_orbit(self) -> AdjustableOrbit:
        assert self.orbit is not None
        return self.orbit

    @property
    def _trajectory(self) -> Orbit:
        return cast(Orbit, self.truth.trajectory)

    def _true_place(self, part: ArcPart, x: Floats) -> tuple[Floats, Floats]:
        """Return the true position, principal axes, m, and the axes east, north and up at it, as rows."""
        if self.orbit is None:
            return self.truth.position_pa_m, self.truth.enu_pa
        model = part.problem.model
        place_m = model.position_pa_m(x, self.index)
        return place_m, rot_pa_to_enu(place_m, rot_pa_to_me(model.predictor.model.ephemeris.constants))


def true_parameters(problem: EstimationProblem, targets: Sequence[ComparedTarget]) -> Floats:
    """Return the parameters of the true positions and states, the others at their a-priori values."""
    model = problem.model
    x = model.parameters.prior_values.copy()
    for item in targets:
        columns = model.columns_of(item.index)
        x[columns] = model.targets[item.index].solved(item.true_motion, x[columns])
    return x
