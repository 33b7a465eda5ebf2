"""Stochastic accelerations of a study's orbit: intervals, partials, and the orbit that they are estimated about."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics.stochastic import (
    ACROSS,
    AFTER,
    BEFORE,
    COLOURS,
    Chains,
    StochasticAccelerations,
    StochasticEffects,
    colours,
    stochastic_forces,
)
from radioloc.errors import InputError
from radioloc.estimation.consider import ConsideredErrors, moved_by
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.information_filter import InformationFilter
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.time_correlation import estimated_covariance
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.parameters.parameter import Parameter, Role
from radioloc.study.orbit_choice import ProcessNoise
from radioloc.targets.design import ObservationModel
from radioloc.targets.orbit_state import OrbitState, ProcessEstimate
from radioloc.time import Epochs, tt_to_tdb, utc_to_tt

Floats = NDArray[np.float64]

_AROUND_S = 5.0
"""Events at the target are within the count interval and so much of the time tag: light takes 1.4 s."""
_LINEAR_M = 2.0  # Accelerations that move the orbit by no more follow from those it was integrated with


@dataclass(frozen=True, slots=True, eq=False)
class StochasticProblem:
    """A problem whose orbit has stochastic accelerations."""

    without: ObservationModel  # of the orbit without them
    noise: ProcessNoise
    here: ObservationModel  # about the orbit that was integrated with the reference accelerations
    effects: StochasticEffects

    @classmethod
    def about(
        cls, without: ObservationModel, noise: ProcessNoise, x: Floats, values: Chains | None = None
    ) -> StochasticProblem:
        """Linearize about the orbit of parameters x with accelerations, in their sigmas; by default without any."""
        predictor = without.predictor
        if not isinstance(predictor, ExactPredictor):
            raise InputError(
                "[estimate.orbit] process_noise: observations that are combined of others cannot be used; leave them "
                "out with [observations] types"
            )
        orbit, interval_s = without.orbit, noise.interval_s
        assert orbit is not None  # process noise belongs to an orbit
        around_s = np.nan_to_num(predictor.observations.count_s) + _AROUND_S
        if 2.0 * around_s.max(initial=0.0) > interval_s:
            raise InputError(
                f"[estimate.orbit] process_noise: interval_s = {interval_s:g} is too short for counts of "
                f"{around_s.max() - _AROUND_S:g} s; give {2.0 * around_s.max():g} or more"
            )
        if values is not None:
            after, before = (one[:-1] * noise.sigma_m_s2 for one in values)
            given = stochastic_forces(orbit.epoch, (after, before), interval_s)
            forces = replace(orbit.forces, accelerations=orbit.forces.accelerations + given)
            orbit = replace(orbit, forces=forces, integrated=[])
        here = without.with_orbit(orbit)
        moved = here.orbit_at(x)
        assert moved is not None
        effects = StochasticEffects(moved.nearest(), noise.sigma_m_s2, interval_s)
        partials = without.effects_on_orbit(replace(moved, errors=effects.state_partials))
        by_colour = partials[:, 6:].reshape(len(partials), COLOURS, 3)
        tag_s = tt_to_tdb(utc_to_tt(predictor.observations.epoch)).seconds_since(orbit.epoch)
        first, last = (
            np.floor((tag_s + by_s) / interval_s).astype(np.intp) for by_s in (-around_s, around_s)
        )
        chain = np.where(first >= 0, AFTER, np.where(last < 0, BEFORE, ACROSS)).astype(np.int8)
        step = np.where(chain == AFTER, first, np.where(chain == BEFORE, -1 - last, 0))
        rows, before = np.arange(len(step)), chain == BEFORE
        near = colours(before, step)
        far = np.where(chain == ACROSS, colours(~before, step), colours(before, step + 1))
        process = StochasticAccelerations(
            chain,
            step,
            partials[:, :6],
            by_colour[rows, near],
            by_colour[rows, far],
            effects.moved,
            noise.persistence,
            values or tuple(np.zeros((len(one) + 1, 3)) for one in effects.moved),  # type: ignore[arg-type]
        )
        return cls(without, noise, replace(here, process=process), effects)

    def again(self, fit: FitResult) -> StochasticProblem:
        """About the orbit of a fit."""
        assert fit.smoothed is not None
        return StochasticProblem.about(self.without, self.noise, fit.x, fit.smoothed.values)

    def near(self, fit: FitResult) -> bool:
        """Whether the accelerations of a fit move the orbit little from the one that was integrated."""
        assert fit.smoothed is not None
        assert self.here.process is not None
        process, orbit = self.here.process, self.effects.orbit
        changes = zip(
            process.deviations(fit.smoothed.values), process.deviations(process.reference), strict=True
        )
        begin_s, end_s = orbit.span_s
        for sign, (now, before) in zip((1.0, -1.0), changes, strict=True):
            times_s = np.clip(sign * self.noise.interval_s * np.arange(len(now)), begin_s, end_s)
            at = orbit.epoch.shifted(times_s)
            moved_m = orbit.partials(at)[:, :3, :6] @ (now - before)[:, :, None]
            if np.linalg.norm(moved_m[:, :, 0], axis=1).max() > _LINEAR_M:
                return False
        return True

    def smoothed(
        self, state: OrbitState, fitted: EditedFit, order: SeriesOrder, suboptimal: ConsideredErrors | None
    ) -> OrbitState:
        """Return the state of the smoothed orbit, with errors by interval where all is determined."""
        fit = fitted.fit
        assert isinstance(fit.whitening, InformationFilter)
        found = self.again(fit)
        orbit, target = found.here.orbit_at(fit.x), self.here.orbit_index
        assert orbit is not None
        assert target is not None
        state = replace(state, orbit=orbit)
        free, here = fit.parameters.free, fit.linearization
        joint, sigmas = estimated_covariance(fitted, order)[0][np.ix_(free, free)], np.zeros(0)
        if not np.isfinite(joint).all():
            return state
        if suboptimal is not None:
            # Their errors are those of the assumed values, which residuals have with the other sign.
            sigmas = suboptimal.parameters.prior_sigmas
            moved = moved_by(fit, suboptimal.partials, len(sigmas))[free] * sigmas
            joint = np.block([[joint + moved @ moved.T, -moved], [-moved.T, np.eye(len(sigmas))]])

        def others(rows: NDArray[np.intp]) -> Floats:
            mine = here.partials(rows)[:, free]
            return mine if suboptimal is None else np.hstack([mine, suboptimal.partials(rows) * sigmas])

        smoothed = fit.whitening.smoothed(others, here.residual_m, joint)
        # From errors of free parameters, of what is considered, of the deviation and the acceleration.
        onto = np.zeros((len(state.parameter_covariance) + 9, len(joint) + 9))
        mine = self.here.columns_of(target)
        of_orbit, begin = free[mine], int(free[: mine.start].sum())
        by_x = self.without.targets[target].motion(fit.x[mine])[1]
        onto[:-9, begin : begin + of_orbit.sum()] = by_x[:, of_orbit]
        onto[-9:, -9:] = np.eye(9)
        after_covariance, before_covariance = (onto @ one @ onto.T for one in smoothed.covariance)
        after, before = (one * self.noise.sigma_m_s2 for one in smoothed.values)
        process = ProcessEstimate(
            found.effects,
            self.noise.sigma_m_s2,
            self.noise.correlation_s,
            (after, before),
            (after_covariance, before_covariance),
        )
        return replace(state, process=process)


@dataclass(frozen=True, slots=True, eq=False)
class IndependentAccelerations:
    """Stochastic accelerations as w independent parameters of unit variance, one for what each interval adds.

    The batch form of process noise, for plans of a few hundred intervals, whatever the noise of the observations.
    """

    effects: StochasticEffects
    process: StochasticAccelerations
    noise: ProcessNoise
    values: Chains  # u of the intervals in their sigmas, (K + 1, 3, w)
    deviations: Chains  # d with which the intervals begin, (K + 1, 6, w)

    @classmethod
    def of(cls, problem: StochasticProblem) -> IndependentAccelerations:
        """Return those of the intervals of a problem, outward from the epoch."""
        process = problem.here.process
        assert process is not None
        counts = [len(moved) + 1 for moved in process.moved]
        m, width = process.persistence, 3 * sum(counts)
        fresh, begin = np.sqrt(1.0 - m**2), 0
        values = list[Floats]()
        for count in counts:
            u = np.zeros((count, 3, width))
            # The first interval before the epoch follows from the first behind it.
            inner = values[0][0] if values else None
            for k in range(count):
                carried = inner if k == 0 else u[k - 1]
                own = np.zeros((3, width))
                own[:, begin : begin + 3] = np.eye(3)
                u[k] = own if carried is None else m * carried + fresh * own
                begin += 3
            values.append(u)
        deviations = [
            np.concatenate([np.zeros((1, 6, width)), np.cumsum(moved @ u[:-1], axis=0)])
            for moved, u in zip(process.moved, values, strict=True)
        ]
        chains = (values[0], values[1]), (deviations[0], deviations[1])
        return cls(problem.effects, process, problem.noise, *chains)

    @property
    def parameters(self) -> list[Parameter]:
        """Parameters of unit variance, which are considered."""
        names = (f"process_noise.{k + 1}" for k in range(self.values[0].shape[2]))
        return [Parameter(name, "1", "process_noise", 0.0, 1.0, role=Role.CONSIDERED) for name in names]

    def effects_m(self, rows: NDArray[np.intp]) -> Floats:
        """Effects on observations, m, shape (m, w)."""
        process, out = self.process, np.zeros((len(rows), self.values[0].shape[2]))
        near, far, by_state = process.near[rows], process.far[rows], process.by_state[rows]
        chain, step = process.chain[rows], process.step[rows]
        for which in (AFTER, BEFORE):
            mine = np.flatnonzero(chain == which)
            k = step[mine]
            for partials, by in (
                (by_state, self.deviations[which][k]),
                (near, self.values[which][k]),
                (far, self.values[which][k + 1]),
            ):
                out[mine] += np.einsum("ns,nsw->nw", partials[mine], by)
        mine = np.flatnonzero(chain == ACROSS)
        out[mine] = near[mine] @ self.values[AFTER][0] + far[mine] @ self.values[BEFORE][0]
        return out

    def states(self, tdb: Epochs) -> Floats:
        """Effects on the states at epochs of TDB, m and m/s, ICRF axes, shape (n, 6, w)."""
        chain, step, near = self.effects.intervals(tdb)
        transition = self.effects.orbit.partials(tdb)[:, :, :6]
        out = np.empty((len(step), 6, self.values[0].shape[2]))
        for which in (AFTER, BEFORE):
            mine, k = chain == which, step[chain == which]
            out[mine] = transition[mine] @ self.deviations[which][k] + near[mine] @ self.values[which][k]
        return out

    def estimate(self, covariance: Floats) -> ProcessEstimate:
        """Return accelerations of zero, as nothing is measured, by the covariance of orbit and parameters, (p + w)."""
        count = len(covariance) - self.values[0].shape[2]
        chains = []
        for d, u in zip(self.deviations, self.values, strict=True):
            onto = np.zeros((len(u), count + 9, len(covariance)))
            onto[:, :count, :count] = np.eye(count)
            onto[:, count:, count:] = np.concatenate([d, u], axis=1)
            chains.append(onto @ covariance @ np.swapaxes(onto, 1, 2))
        nothing = (np.zeros((len(self.values[0]), 3)), np.zeros((len(self.values[1]), 3)))
        return ProcessEstimate(
            self.effects, self.noise.sigma_m_s2, self.noise.correlation_s, nothing, (chains[0], chains[1])
        )
