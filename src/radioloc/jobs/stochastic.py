"""Stochastic accelerations of a study's orbits: intervals, partials, and the orbits that they are estimated about."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

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
from radioloc.estimation.information_filter import InformationFilters
from radioloc.estimation.least_squares import FitResult
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.time_correlation import estimated_covariance
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.parameters.parameter import Parameter, Role
from radioloc.targets.design import ObservationModel, effects_on_orbit
from radioloc.targets.orbit_state import OrbitState, ProcessEstimate
from radioloc.targets.target import ProcessNoise
from radioloc.time import Epochs, tt_to_tdb, utc_to_tt
from radioloc.vectors import Floats, Indices

_AROUND_S = 5.0
"""Events at the target are within the count interval and so much of the time tag: light takes 1.4 s."""
_LINEAR_M = 2.0  # Accelerations that move the orbit by no more follow from those it was integrated with


@dataclass(frozen=True, slots=True, eq=False)
class StochasticOrbit:
    """Stochastic accelerations of a target, and their effects on its orbit and on the observations."""

    target: int
    noise: ProcessNoise
    effects: StochasticEffects
    process: StochasticAccelerations

    @classmethod
    def linearized_about(
        cls, model: ObservationModel, target: int, x: Floats, values: Chains | None
    ) -> StochasticOrbit:
        """Linearize about the orbit of parameters x; values are those that the model's orbit has, None without any."""
        predictor, noise = model.predictor, model.targets[target].process_noise
        orbit = model.targets[target].orbit_at(x[model.columns_of(target)])
        assert noise is not None
        assert orbit is not None  # process noise belongs to an orbit
        interval_s = noise.interval_s
        around_s = np.nan_to_num(predictor.observations.count_s) + _AROUND_S
        if 2.0 * around_s.max(initial=0.0) > interval_s:
            raise InputError(
                f"[estimate.orbit] process_noise: interval_s = {interval_s:g} is too short for counts of "
                f"{around_s.max() - _AROUND_S:g} s; give {2.0 * around_s.max():g} or more"
            )
        effects = StochasticEffects(orbit.nearest(), noise.sigma_m_s2, interval_s)
        partials = effects_on_orbit(predictor, replace(orbit, errors=effects.state_partials), target)
        by_colour = partials[:, 6:].reshape(len(partials), COLOURS, 3)
        tag_s = tt_to_tdb(utc_to_tt(predictor.observations.epoch)).seconds_since(orbit.epoch)
        first, last = (
            np.floor((tag_s + by_s) / interval_s).astype(np.intp) for by_s in (-around_s, around_s)
        )
        chain = np.where(first >= 0, AFTER, np.where(last < 0, BEFORE, ACROSS))
        step = np.where(chain == AFTER, first, np.where(chain == BEFORE, -1 - last, 0))
        # Other targets may be observed before or after the span of the orbit, which does not move them.
        is_outside = ~partials.any(axis=1) & (step >= np.array([*map(len, effects.moved), 1])[chain])
        chain, step = np.where(is_outside, ACROSS, chain).astype(np.int8), np.where(is_outside, 0, step)
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
        return cls(target, noise, effects, process)

    def is_linear(self, values: Chains) -> bool:
        """Return whether the orbit moves little by accelerations, from the one that was integrated."""
        process, orbit = self.process, self.effects.orbit
        changes = zip(process.deviations(values), process.deviations(process.reference), strict=True)
        begin_s, end_s = orbit.span_s
        for sign, (fitted, reference) in zip((1.0, -1.0), changes, strict=True):
            times_s = np.clip(sign * self.noise.interval_s * np.arange(len(fitted)), begin_s, end_s)
            at = orbit.epoch.shifted(times_s)
            moved_m = orbit.partials(at)[:, :3, :6] @ (fitted - reference)[:, :, None]
            if np.linalg.norm(moved_m[:, :, 0], axis=1).max() > _LINEAR_M:
                return False
        return True


@dataclass(frozen=True, slots=True, eq=False)
class StochasticProblem:
    """A problem with orbits that have stochastic accelerations."""

    model: ObservationModel  # of the orbits without them
    with_process: ObservationModel  # about the orbits that were integrated with the reference accelerations
    orbits: tuple[StochasticOrbit, ...]

    @classmethod
    def linearized_about(
        cls, model: ObservationModel, x: Floats, values: Sequence[Chains] = ()
    ) -> StochasticProblem:
        """Linearize about orbits of parameters x with accelerations, in their sigmas; by default without any."""
        if not isinstance(model.predictor, ExactPredictor):
            raise InputError(
                "[estimate.orbit] process_noise: observations that are combined of others cannot be used; leave them "
                "out with [observations] types"
            )
        noises = {k: target.process_noise for k, target in enumerate(model.targets) if target.process_noise}
        about_orbits = model
        for (k, noise), chains in zip(noises.items(), values, strict=False):
            orbit = model.targets[k].orbit
            assert orbit is not None
            later, earlier = (chain[:-1] * noise.sigma_m_s2 for chain in chains)
            added = stochastic_forces(orbit.epoch, (later, earlier), noise.interval_s)
            forces = replace(orbit.forces, accelerations=orbit.forces.accelerations + added)
            about_orbits = about_orbits.with_orbit(replace(orbit, forces=forces, integrated=[]), k)
        items = zip_longest(noises, values)
        orbits = tuple(StochasticOrbit.linearized_about(about_orbits, k, x, chains) for k, chains in items)
        return cls(model, replace(about_orbits, processes=tuple(orbit.process for orbit in orbits)), orbits)

    def relinearized(self, fit: FitResult) -> StochasticProblem:
        """Return the problem about the orbits of a fit."""
        values = [smoothed.values for smoothed in fit.smoothed]
        return StochasticProblem.linearized_about(self.model, fit.x, values)

    def is_linear(self, fit: FitResult) -> bool:
        """Return whether the orbits move little by the accelerations of a fit, from those that were integrated."""
        pairs = zip(self.orbits, fit.smoothed, strict=True)
        return all(orbit.is_linear(smoothed.values) for orbit, smoothed in pairs)

    def smoothed(
        self,
        states: Mapping[int, OrbitState],
        fitted: EditedFit,
        order: SeriesOrder,
        unadjusted: UnestimatedErrors,
    ) -> dict[int, OrbitState]:
        """Return the states of smoothed orbits by target, with errors by interval where all is determined."""
        fit = fitted.fit
        assert isinstance(fit.whitening, InformationFilters)
        problem, out = self.relinearized(fit), dict[int, OrbitState]()
        for item in self.orbits:
            orbit = problem.with_process.targets[item.target].orbit_at(
                fit.x[self.model.columns_of(item.target)]
            )
            assert orbit is not None
            out[item.target] = replace(states[item.target], orbit=orbit)
        free, design = fit.parameters.free, fit.linearization
        joint, sigmas = (
            estimated_covariance(fitted, order)[0][np.ix_(free, free)],
            unadjusted.parameters.prior_sigmas,
        )
        if not np.isfinite(joint).all():
            return out
        # Unadjusted errors are those of the assumed values, which residuals have with the other sign.
        moved = consider_sensitivity(fit, unadjusted.partials, len(sigmas))[free] * sigmas
        joint = np.block([[joint + moved @ moved.T, -moved], [-moved.T, np.eye(len(sigmas))]])

        def partials(rows: Indices) -> Floats:
            return np.hstack([design.partials(rows)[:, free], unadjusted.partials(rows) * sigmas])

        each = fit.whitening.smoothed(partials, design.residual_m, joint)
        for item, smoothed in zip(problem.orbits, each, strict=True):
            state = out[item.target]
            # From errors of free and considered parameters, of the deviation and the acceleration.
            onto = np.zeros((len(state.parameter_covariance) + 9, len(joint) + 9))
            columns = self.model.columns_of(item.target)
            of_orbit, begin = free[columns], int(free[: columns.start].sum())
            by_x = self.model.targets[item.target].motion(fit.x[columns])[1]
            onto[:-9, begin : begin + of_orbit.sum()] = by_x[:, of_orbit]
            onto[-9:, -9:] = np.eye(9)
            after_covariance, before_covariance = (onto @ chain @ onto.T for chain in smoothed.covariance)
            later, earlier = (chain * item.noise.sigma_m_s2 for chain in smoothed.values)
            process = ProcessEstimate(
                item.effects,
                item.noise.sigma_m_s2,
                item.noise.correlation_s,
                (later, earlier),
                (after_covariance, before_covariance),
            )
            out[item.target] = replace(state, process=process)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class IndependentAccelerations:
    """Stochastic accelerations as w independent parameters of unit variance, the increments of each interval.

    The batch form of process noise, for plans of a few hundred intervals, whatever the noise of the observations.
    """

    orbit: StochasticOrbit
    first: int  # number of the first among the independent accelerations of all orbits
    values: Chains  # u of the intervals in their sigmas, (K + 1, 3, w)
    deviations: Chains  # d with which the intervals begin, (K + 1, 6, w)

    @classmethod
    def from_problem(cls, problem: StochasticProblem) -> list[IndependentAccelerations]:
        """Return those of each orbit of a problem."""
        items = list[IndependentAccelerations]()
        for orbit in problem.orbits:
            items.append(cls.from_orbit(orbit, sum(item.count for item in items)))
        return items

    @classmethod
    def from_orbit(cls, orbit: StochasticOrbit, first: int = 0) -> IndependentAccelerations:
        """Return those of the intervals of an orbit, outward from the epoch."""
        process = orbit.process
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
        return cls(orbit, first, *chains)

    @property
    def count(self) -> int:
        """Number w of accelerations."""
        return self.values[0].shape[2]

    @property
    def parameters(self) -> list[Parameter]:
        """Parameters of unit variance, which are considered."""
        names = (f"process_noise.{self.first + k + 1}" for k in range(self.count))
        return [Parameter(name, "1", "process_noise", 0.0, 1.0, role=Role.CONSIDERED) for name in names]

    def effects_m(self, rows: Indices) -> Floats:
        """Effects on observations, m, shape (m, w)."""
        process, out = self.orbit.process, np.zeros((len(rows), self.count))
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
        chain, step, by_near = self.orbit.effects.intervals(tdb)
        transition = self.orbit.effects.orbit.partials(tdb)[:, :, :6]
        out = np.empty((len(step), 6, self.count))
        for side in (AFTER, BEFORE):
            members, k = chain == side, step[chain == side]
            by_deviation = transition[members] @ self.deviations[side][k]
            out[members] = by_deviation + by_near[members] @ self.values[side][k]
        return out

    def estimate(self, covariance: Floats) -> ProcessEstimate:
        """Return accelerations of zero, as nothing is measured, by the covariance of orbit and parameters, (p + w)."""
        count, noise = len(covariance) - self.count, self.orbit.noise
        chains = []
        for d, u in zip(self.deviations, self.values, strict=True):
            onto = np.zeros((len(u), count + 9, len(covariance)))
            onto[:, :count, :count] = np.eye(count)
            onto[:, count:, count:] = np.concatenate([d, u], axis=1)
            chains.append(onto @ covariance @ np.swapaxes(onto, 1, 2))
        zeros = (np.zeros((len(self.values[0]), 3)), np.zeros((len(self.values[1]), 3)))
        return ProcessEstimate(
            self.orbit.effects, noise.sigma_m_s2, noise.correlation_s, zeros, (chains[0], chains[1])
        )
