"""The state of an orbit that was determined, and how well it is known at the epoch and elsewhere on the arc.

Of several arcs also by how much neighbours differ where they meet.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.dynamics import AdjustableOrbit, Orbit
from radioloc.dynamics.elements import ELEMENT_NAMES, elements_from_state, state_with_partials
from radioloc.dynamics.stochastic import Chains, StochasticEffects
from radioloc.quantities import EpochsLike, accepts_quantities
from radioloc.text_files import finite_or_none
from radioloc.time import Epochs, utc_strings
from radioloc.vectors import Floats, rtn_axes

RTN = ("radial", "along", "across")
ALONG_ACROSS_RADIAL = ("along", "across", "radial")
"""Axes of errors of an orbit; the first two are horizontal, as those of a place."""
# Places of along, across and radial position and velocity among radial, along and across.
LOCAL_LEVEL = [1, 2, 0, 4, 5, 3]
_MAPPED_EPOCH_COUNT = 25  # at which the covariance is mapped, the ends of the arc included


def turned(axes: Floats, of_states: Floats) -> Floats:
    """Return changes of states, shape (n, 6, k), in axes, shape (n, 3, 3)."""
    return np.concatenate([axes @ of_states[:, :3], axes @ of_states[:, 3:]], axis=1)


def along_across_radial(orbit: Orbit | AdjustableOrbit, tdb: Epochs, of_states: Floats) -> Floats:
    """Return changes of ICRF states at epochs, (n, 6, k), along, across and radial, positions before velocities."""
    return turned(rtn_axes(*orbit.states(tdb)), of_states)[:, LOCAL_LEVEL]


@dataclass(frozen=True, slots=True, eq=False)
class ProcessEstimate:
    """Stochastic accelerations of an orbit, smoothed."""

    effects: StochasticEffects  # of accelerations of one sigma
    sigma_m_s2: Floats  # (3,), a priori, radial, along, across
    correlation_s: float  # zero without
    values_m_s2: Chains  # two of (K + 1, 3), behind and before the epoch, both outward; the last is of none
    # Two of (K + 1, p + 9, p + 9): of the orbit's parameters, the deviation of its state with which the interval begins
    # (mapped to the epoch) and the acceleration in its sigmas.
    covariance: Chains

    def covariance_at(self, tdb: Epochs, partials: Floats) -> tuple[Floats, Floats]:
        """Return partials (n, 6, p + 9), first those by the parameters, and the covariance of their variables."""
        chain, step, of_acceleration = self.effects.intervals(tdb)
        by_all = np.concatenate([partials, partials[:, :, :6], of_acceleration], axis=2)
        covariance = np.empty((len(step), by_all.shape[2], by_all.shape[2]))
        for number, of_steps in enumerate(self.covariance):
            covariance[chain == number] = of_steps[step[chain == number]]
        return by_all, covariance

    def to_dict(self) -> dict[str, Any]:
        """Return the estimate in types that JSON has, accelerations in the order of time."""

        def in_order(chains: Chains) -> Floats:
            return np.concatenate([chains[1][:-1][::-1], chains[0][:-1]])

        later, earlier = (np.sqrt(np.diagonal(item, axis1=1, axis2=2)[:, -3:]) for item in self.covariance)
        values, sigmas = in_order(self.values_m_s2), in_order((later, earlier)) * self.sigma_m_s2
        epoch, interval_s = self.effects.orbit.epoch, self.effects.interval_s
        starts_s = interval_s * (np.arange(len(values)) - len(self.values_m_s2[1]) + 1.0)
        starts = epoch.shifted(starts_s)
        return {
            "interval_s": interval_s,
            "correlation_s": self.correlation_s,
            **{f"{axis}_m_s2": sigma for axis, sigma in zip(RTN, self.sigma_m_s2.tolist(), strict=True)},
            "start_tdb": [str(date) for date in utc_strings(starts, 3)],
            "acceleration_m_s2": values.tolist(),
            "acceleration_sigma_m_s2": sigmas.tolist(),
        }


@dataclass(frozen=True, slots=True)
class StateDifference:
    """Difference of the state from a part of the data to that from all, at the epoch of the latter."""

    rtn_m: tuple[float, float, float]  # radial, along and across
    sigma_rtn_m: tuple[float, float, float] | None = None  # of this difference; None where it has none
    sigmas: float | None = None  # its length in standard deviations, over position and velocity


@dataclass(frozen=True, slots=True, eq=False)
class OrbitState:
    """State at the epoch of an orbit that was fitted."""

    orbit: AdjustableOrbit  #: of the estimated values
    parameter_covariance: Floats  #: (p, p), total, those of the state first; m, m/s and the forces' units
    sensitivity: Floats  #: (p, k), of the parameters to considered errors of gravity, each of one sigma
    disturbed: AdjustableOrbit | None = None  #: with the effects of these errors, if there are any
    body: int = -999  #: NAIF code of the spacecraft in kernels
    process: ProcessEstimate | None = None  #: those of the orbit itself have its values

    @property
    def epoch(self) -> Epochs:
        """Epoch of the state, TDB."""
        return self.orbit.epoch

    @property
    def position_m(self) -> Floats:
        """Position relative to the Moon's centre, ICRF axes, shape (3,)."""
        return self.orbit.state[:3]

    @property
    def velocity_m_s(self) -> Floats:
        """Velocity relative to the Moon's centre, ICRF axes, shape (3,)."""
        return self.orbit.state[3:]

    @property
    def covariance(self) -> Floats:
        """Covariance of position and velocity, m and m/s, ICRF axes, shape (6, 6)."""
        return self.parameter_covariance[:6, :6]

    @accepts_quantities
    def covariance_rtn(self, tdb: EpochsLike) -> Floats:
        """Covariance of position and velocity at epochs, radial, along and across the orbit, (n, 6, 6)."""
        noise, by_errors = self._covariance_parts_rtn(tdb)
        return np.asarray(noise + by_errors @ np.swapaxes(by_errors, 1, 2))

    def _covariance_parts_rtn(self, tdb: Epochs) -> tuple[Floats, Floats]:
        """Return the covariance without errors of gravity (n, 6, 6), and changes of the state by these (n, 6, k)."""
        if self.process is not None:
            by_parameters, covariance = self.process.covariance_at(tdb, self.orbit.partials(tdb))
            partials = turned(rtn_axes(*self.orbit.states(tdb)), by_parameters)
            return partials @ covariance @ np.swapaxes(partials, 1, 2), np.zeros((len(tdb), 6, 0))
        partials, direct = self.partials_rtn(tdb)
        independent = self.parameter_covariance - self.sensitivity @ self.sensitivity.T
        # An error that the model does not have changes the estimate, and the truth as well.
        return partials @ independent @ np.swapaxes(partials, 1, 2), partials @ self.sensitivity - direct

    def difference_from_all(self, reference: OrbitState) -> StateDifference:
        """Return the difference of the state from a part of the data to the reference, the state from all."""
        # The covariance of the difference is that of the part less that of all (Hausman 1978). Errors of gravity, which
        # no weights have, are the same in both.
        epoch = reference.epoch
        axes = rtn_axes(reference.position_m[None], reference.velocity_m_s[None])
        states = (np.concatenate(state.orbit.states(epoch), axis=-1) for state in (self, reference))
        [error] = turned(axes, np.subtract(*states)[:, :, None])[:, :, 0]
        (noise, by_errors), (noise_of_all, by_errors_of_all) = (
            state._covariance_parts_rtn(epoch) for state in (self, reference)
        )
        change = by_errors - by_errors_of_all
        [covariance] = noise - noise_of_all + change @ np.swapaxes(change, 1, 2)
        difference = StateDifference(tuple(error[:3].tolist()))
        if not np.isfinite(covariance).all() or not (np.diag(covariance) > 0.0).all():
            return difference
        sigma = np.sqrt(np.diag(covariance))
        difference = replace(difference, sigma_rtn_m=tuple(sigma[:3].tolist()))
        scaled = covariance / np.outer(sigma, sigma)
        if not (np.linalg.eigvalsh(scaled) > 0.0).all():
            return difference
        ratio = error / sigma
        return replace(difference, sigmas=float(np.sqrt(ratio @ np.linalg.solve(scaled, ratio))))

    @accepts_quantities
    def partials_rtn(self, tdb: EpochsLike) -> tuple[Floats, Floats]:
        """Return partials of the state radial, along, across by parameters (n, 6, p) and gravity errors (n, 6, k)."""
        axes = rtn_axes(*self.orbit.states(tdb))
        direct = (self.disturbed or self.orbit).effects(tdb)
        return turned(axes, self.orbit.partials(tdb)), turned(axes, direct)

    @accepts_quantities
    def sigma_rtn_m(self, tdb: EpochsLike) -> Floats:
        """Return standard deviations of the position radial, along and across at epochs, m, shape (n, 3)."""
        return np.sqrt(np.diagonal(self.covariance_rtn(tdb), axis1=1, axis2=2)[:, :3])

    def elements(self, form: str = "keplerian") -> tuple[dict[str, float], dict[str, float | None]]:
        """Osculating elements at the epoch by the Moon's equator, by name, and their sigmas, None where infinite."""
        gm, axes = self.orbit.gm_m3_s2, self.orbit.equator
        values = elements_from_state(self.orbit.state, gm, axes, form)
        variances = np.full(6, np.inf)
        try:
            by_state = np.linalg.inv(state_with_partials(values, gm, axes, form)[1])
        except np.linalg.LinAlgError:  # the periapsis of a circle
            by_state = np.full((6, 6), np.inf)
        if np.isfinite(self.covariance).all() and np.isfinite(by_state).all():
            variances = np.diag(by_state @ self.covariance @ by_state.T)
        sigmas = [finite_or_none(sigma) for sigma in np.sqrt(variances).tolist()]
        return dict(zip(ELEMENT_NAMES[form], values.tolist(), strict=True)), dict(
            zip(ELEMENT_NAMES[form], sigmas, strict=True)
        )

    def apsides_m(self) -> tuple[float, float | None]:
        """Lowest and highest height of the osculating orbit above the mean lunar radius; of a hyperbola the lowest."""
        axis_m, size, *_ = self.elements()[0].values()
        highest_m = None if size >= 1.0 else axis_m * (1.0 + size) - MEAN_LUNAR_RADIUS_M
        return axis_m * (1.0 - size) - MEAN_LUNAR_RADIUS_M, highest_m

    def to_dict(self) -> dict[str, Any]:
        """Return the state in types that JSON has."""
        mapped = self.orbit.times(_MAPPED_EPOCH_COUNT)
        determined = bool(np.isfinite(self.parameter_covariance).all())
        sigmas = self.sigma_rtn_m(mapped) if determined else np.full((_MAPPED_EPOCH_COUNT, 3), np.inf)
        at_epoch = self.sigma_rtn_m(self.epoch)[0] if determined else np.full(3, np.inf)
        (elements, element_sigmas), (equinoctial, equinoctial_sigmas) = map(self.elements, ELEMENT_NAMES)
        lowest_m, highest_m = self.apsides_m()
        return {
            "name": self.orbit.name,
            "frame": "Moon-centred ICRF",
            "epoch_tdb": str(utc_strings(self.epoch, 6)[0]),
            "position_m": self.position_m.tolist(),
            "velocity_m_s": self.velocity_m_s.tolist(),
            "elements": elements | {"lowest_m": lowest_m, "highest_m": highest_m},
            "element_sigmas": element_sigmas,
            "equinoctial": equinoctial,
            "equinoctial_sigmas": equinoctial_sigmas,
            "sigma_m": by_axis(at_epoch),
            "covariance": [[finite_or_none(value) for value in row] for row in self.covariance],
            "mapped": [
                {"epoch_tdb": str(date), **by_axis(sigma)}
                for date, sigma in zip(utc_strings(mapped, 3), sigmas, strict=True)
            ],
            "process_noise": None if self.process is None else self.process.to_dict(),
        }


def by_axis(sigma_m: Floats) -> dict[str, float | None]:
    """Lengths radial, along and across by name, None where one is not finite."""
    return {f"{axis}_m": finite_or_none(value) for axis, value in zip(RTN, sigma_m.tolist(), strict=True)}
