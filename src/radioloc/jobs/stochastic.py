"""Stochastic accelerations of a study's orbit: intervals, partials, and the orbit that they are estimated about."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

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
from radioloc.estimation.consider import UnestimatedErrors, consider_sensitivity
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.information_filter import InformationFilter
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.time_correlation import estimated_covariance
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.parameters.parameter import Parameter, Role
from radioloc.study.orbit_choice import ProcessNoise
from radioloc.targets.design import ObservationModel, effects_on_orbit
from radioloc.targets.orbit_state import OrbitState, ProcessEstimate
from radioloc.time import Epochs, tt_to_tdb, utc_to_tt
from radioloc.vectors import Floats, Indices

_AROUND_S = 5.0
"""Events at the target are within the count interval and so much of the time tag: light takes 1.4 s."""
_LINEAR_M = 2.0  # Accelerations that move the orbit by no more follow from those it was integrated with


@dataclass(frozen=True, slots=True, eq=False)
class StochasticProblem:
    """A problem whose orbit has stochastic accelerations."""

    model: ObservationModel  # of the orbit without them
    noise: ProcessNoise
    with_process: ObservationModel  # about the orbit that was integrated with the reference accelerations
    effects: StochasticEffects

    @classmethod
    def linearized_about(
        cls, model: ObservationModel, noise: ProcessNoise, x: Floats, values: Chains | None = None
    ) -> StochasticProblem:
        """Linearize about the orbit of parameters x with accelerations, in their sigmas; by default without any."""
        predictor = model.predictor
        if not isinstance(predictor, ExactPredictor):
            raise InputError(
                "[estimate.orbit] process_noise: observations that are combined of others cannot be used; leave them "
                "out with [observations] types"
            )
        orbit, interval_s = model.orbit, noise.interval_s
        assert orbit is not None  # process noise belongs to an orbit
        around_s = np.nan_to_num(predictor.observations.count_s) + _AROUND_S
        if 2.0 * around_s.max(initial=0.0) > interval_s:
            raise InputError(
                f"[estimate.orbit] process_noise: interval_s = {interval_s:g} is too short for counts of "
                f"{around_s.max() - _AROUND_S:g} s; give {2.0 * around_s.max():g} or more"
            )
        if values is not None:
            later, earlier = (chain[:-1] * noise.sigma_m_s2 for chain in values)
            added = stochastic_forces(orbit.epoch, (later, earlier), interval_s)
            forces = replace(orbit.forces, accelerations=orbit.forces.accelerations + added)
            orbit = replace(orbit, forces=forces, integrated=[])
        about_orbit = model.with_orbit(orbit)
        moved = about_orbit.orbit_at(x)
        assert moved is not None
        effects = StochasticEffects(moved.nearest(), noise.sigma_m_s2, interval_s)
        partials = effects_on_orbit(
            predictor, replace(moved, errors=effects.state_partials), model.orbit_indices[0]
        )
        by_colour = partials[:, 6:].reshape(len(partials), COLOURS, 3)
        tag_s = tt_to_tdb(utc_to_tt(predictor.observations.epoch)).seconds_since(orbit.epoch)
        first, last = (
            np.floor((tag_s + by_s) / interval_s).astype(np.intp) for by_s in (-around_s, around_s)
        )
        chain = np.where(first >= 0, AFTER, np.where(last < 0, BEFORE, ACROSS)).astype(np.int8)
        step = np.where(chain == AFTER, first, np.where(chain == BEFORE, -1 - last, 0))
        rows, is_earlier = np.arange(len(step)), chain == BEFORE
        near_colour = colours(is_earlier, step)
        far_colour = np.where(chain == ACROSS, colours(~is_earlier, step), colours(is_earlier, step + 1))
        process = StochasticAccelerations(
            chain,
            step,
            partials[:, :6],
            by_colour[rows, near_colour],
            by_colour[rows, far_colour],
            effects.moved,
            noise.persistence,
            values or tuple(np.zeros((len(moves) + 1, 3)) for moves in effects.moved),  # type: ignore[arg-type]
        )
        return cls(model, noise, replace(about_orbit, process=process), effects)

    def relinearized(self, fit: FitResult) -> StochasticProblem:
        """Return the problem about the orbit of a fit."""
        assert fit.smoothed is not None
        return StochasticProblem.linearized_about(self.model, self.noise, fit.x, fit.smoothed.values)

    def is_linear(self, fit: FitResult) -> bool:
        """Return whether the orbit moves little by the accelerations of a fit, from the one that was integrated."""
        assert fit.smoothed is not None
        assert self.with_process.process is not None
        process, orbit = self.with_process.process, self.effects.orbit
        changes = zip(
            process.deviations(fit.smoothed.values), process.deviations(process.reference), strict=True
        )
        begin_s, end_s = orbit.span_s
        for sign, (fitted, reference) in zip((1.0, -1.0), changes, strict=True):
            times_s = np.clip(sign * self.noise.interval_s * np.arange(len(fitted)), begin_s, end_s)
            at = orbit.epoch.shifted(times_s)
            moved_m = orbit.partials(at)[:, :3, :6] @ (fitted - reference)[:, :, None]
            if np.linalg.norm(moved_m[:, :, 0], axis=1).max() > _LINEAR_M:
                return False
        return True

    def smoothed(
        self, state: OrbitState, fitted: EditedFit, order: SeriesOrder, unadjusted: UnestimatedErrors | None
    ) -> OrbitState:
        """Return the state of the smoothed orbit, with errors by interval where all is determined."""
        fit = fitted.fit
        assert isinstance(fit.whitening, InformationFilter)
        problem = self.relinearized(fit)
        orbit, target = problem.with_process.orbit_at(fit.x), self.with_process.orbit_index
        assert orbit is not None
        assert target is not None
        state = replace(state, orbit=orbit)
        free, design = fit.parameters.free, fit.linearization
        joint, sigmas = estimated_covariance(fitted, order)[0][np.ix_(free, free)], np.zeros(0)
        if not np.isfinite(joint).all():
            return state
        if unadjusted is not None:
            # Their errors are those of the assumed values, which residuals have with the other sign.
            sigmas = unadjusted.parameters.prior_sigmas
            moved = consider_sensitivity(fit, unadjusted.partials, len(sigmas))[free] * sigmas
            joint = np.block([[joint + moved @ moved.T, -moved], [-moved.T, np.eye(len(sigmas))]])

        def partials(rows: Indices) -> Floats:
            by_free = design.partials(rows)[:, free]
            return by_free if unadjusted is None else np.hstack([by_free, unadjusted.partials(rows) * sigmas])

        smoothed = fit.whitening.smoothed(partials, design.residual_m, joint)
        # From errors of free and considered parameters, of the deviation and the acceleration.
        onto = np.zeros((len(state.parameter_covariance) + 9, len(joint) + 9))
        columns = self.with_process.columns_of(target)
        of_orbit, begin = free[columns], int(free[: columns.start].sum())
        by_x = self.model.targets[target].motion(fit.x[columns])[1]
        onto[:-9, begin : begin + of_orbit.sum()] = by_x[:, of_orbit]
        onto[-9:, -9:] = np.eye(9)
        after_covariance, before_covariance = (onto @ chain @ onto.T for chain in smoothed.covariance)
        later, earlier = (chain * self.noise.sigma_m_s2 for chain in smoothed.values)
        process = ProcessEstimate(
            problem.effects,
            self.noise.sigma_m_s2,
            self.noise.correlation_s,
            (later, earlier),
            (after_covariance, before_covariance),
        )
        return replace(state, process=process)


@dataclass(frozen=True, slots=True, eq=False)
class IndependentAccelerations:
    """Stochastic accelerations as w independent parameters of unit variance, the increments of each interval.

    The batch form of process noise, for plans of a few hundred intervals, whatever the noise of the observations.
    """

    effects: StochasticEffects
    process: StochasticAccelerations
    noise: ProcessNoise
    values: Chains  # u of the intervals in their sigmas, (K + 1, 3, w)
    deviations: Chains  # d with which the intervals begin, (K + 1, 6, w)

    @classmethod
    def from_problem(cls, problem: StochasticProblem) -> IndependentAccelerations:
        """Return those of the intervals of a problem, outward from the epoch."""
        process = problem.with_process.process
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
                added = np.zeros((3, width))
                added[:, begin : begin + 3] = np.eye(3)
                u[k] = added if carried is None else m * carried + fresh * added
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

    def effects_m(self, rows: Indices) -> Floats:
        """Effects on observations, m, shape (m, w)."""
        process, out = self.process, np.zeros((len(rows), self.values[0].shape[2]))
        by_near, by_far, by_state = process.near[rows], process.far[rows], process.by_state[rows]
        chain, step = process.chain[rows], process.step[rows]
        for side in (AFTER, BEFORE):
            members = np.flatnonzero(chain == side)
            k = step[members]
            for partials, by in (
                (by_state, self.deviations[side][k]),
                (by_near, self.values[side][k]),
                (by_far, self.values[side][k + 1]),
            ):
                out[members] += np.einsum("ns,nsw->nw", partials[members], by)
        members = np.flatnonzero(chain == ACROSS)
        out[members] = by_near[members] @ self.values[AFTER][0] + by_far[members] @ self.values[BEFORE][0]
        return out

    def states(self, tdb: Epochs) -> Floats:
        """Effects on the states at epochs of TDB, m and m/s, ICRF axes, shape (n, 6, w)."""
        chain, step, by_near = self.effects.intervals(tdb)
        transition = self.effects.orbit.partials(tdb)[:, :, :6]
        out = np.empty((len(step), 6, self.values[0].shape[2]))
        for side in (AFTER, BEFORE):
            members, k = chain == side, step[chain == side]
            by_deviation = transition[members] @ self.deviations[side][k]
            out[members] = by_deviation + by_near[members] @ self.values[side][k]
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
        zeros = (np.zeros((len(self.values[0]), 3)), np.zeros((len(self.values[1]), 3)))
        return ProcessEstimate(
            self.effects, self.noise.sigma_m_s2, self.noise.correlation_s, zeros, (chains[0], chains[1])
        )
