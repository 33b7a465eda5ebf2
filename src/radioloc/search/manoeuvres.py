"""Undocumented manoeuvres: times in an arc at which residuals jump as after a change of the velocity.

An impulse acts on later observations like a change of the state at the epoch that leaves the position at the time of
the impulse unchanged. Sums of partials with respect to the state, over the observations after each time, therefore
give the effect of impulses at all times, each with a new fit of the orbit. The best impulse is integrated and adjusted
with its time.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from radioloc.dynamics import AdjustableOrbit, Impulse
from radioloc.errors import RadiolocError
from radioloc.estimation.statistics import robust_scale
from radioloc.jobs.orbit_start import REACH_FACTOR, OrbitPart, StagedStart, fitted_state
from radioloc.measurements.observations import Observations
from radioloc.measurements.registry import is_integrated
from radioloc.measurements.target_motion import OrbitMotion
from radioloc.targets.orbit_state import RTN
from radioloc.time import Epochs, tt_to_tdb, utc_strings, utc_to_tt
from radioloc.vectors import Floats, Indices, Mask, rtn_axes

logger = logging.getLogger(__name__)

_NAME = "undocumented"
# Smallest ratio of the reduced chi-square without and with a manoeuvre. In real Doppler of a low orbit without
# manoeuvres, impulses absorb errors of gravity: the ratio is 7 with a field to degree 150, 16 to degree 100, 47 to 60.
_MIN_GAIN = 100.0
_MIN_SCAN_GAIN = 20.0  # the same, linearized, for an impulse that is integrated
_MIN_SIZE_SIGMAS = 5.0
_MIN_SIDE_OBSERVATIONS = 8
_MAX_TIMES, _MIN_STEP_S = 5000, 10.0  # of the scan
_MAX_SIZE_M_S = 100.0
_STATE_SCALES = np.repeat([1e3, 1.0], 3)
# Residuals farther from the median of their neighbours, in robust sigmas, are outliers and not part of a jump.
_NEIGHBOUR_COUNT, _MAX_ISOLATION_SIGMAS = 15, 10.0
_MAX_RESIDUAL_SIGMAS = 5.0
_ROUND_COUNT, _MAX_TIME_STEP_S = 8, 600.0
_DIFFERENCE_S = 0.1  # step of the partials with respect to the time of the impulse
# Observations this close to the uncertain time are excluded; the interval shrinks by the ratio in each round.
_EXCLUDED_S, _EXCLUDED_RATIO = 300.0, 0.3
_MIN_GAP_S = 600.0


@dataclass(frozen=True, slots=True, eq=False)
class Manoeuvre:
    """Undocumented change of the velocity."""

    epoch: Epochs  # TDB, one
    sigma_s: float
    delta_v_m_s: Floats  # radial, along and across the orbit
    sigma_m_s: float  # of its magnitude
    gap: Epochs | None  # ends of the gap without observations around it, TDB
    x: Floats  # parameters of the orbit at its epoch
    is_later: bool  # than the epoch of the orbit

    def __str__(self) -> str:
        size = float(np.linalg.norm(self.delta_v_m_s))
        direction = RTN[int(np.argmax(np.abs(self.delta_v_m_s)))]
        mostly = direction if direction == "radial" else f"{direction} the orbit"
        digits = int(np.clip(1 - np.floor(np.log10(max(self.sigma_m_s, 1e-9))), 1, 6))
        parts = ", ".join(f"{value:.{digits}f}" for value in self.delta_v_m_s)
        gap = ""
        if self.gap is not None:
            first, last = utc_strings(self.gap, 0)
            gap = f", in the gap of the data from {first} to {last}"
        return (
            f"residuals jump at {utc_strings(self.epoch, 0)[0]} TDB (+- {max(self.sigma_s, 1.0):.0f} s){gap}: as after "
            f"a manoeuvre of {size:.{digits}f} +- {self.sigma_m_s:.{digits}f} m/s, mostly {mostly} "
            f"(delta_v_m_s = [{parts}])"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers in JSON types."""
        return {
            "epoch_tdb": str(utc_strings(self.epoch, 3)[0]),
            "sigma_s": self.sigma_s,
            "delta_v_m_s": self.delta_v_m_s.tolist(),
            "sigma_m_s": self.sigma_m_s,
            "gap_tdb": None if self.gap is None else [str(end) for end in utc_strings(self.gap, 0)],
        }

    def separates(self, observations: Observations) -> Mask:
        """Return True for observations on the other side of the manoeuvre than the epoch of the orbit."""
        since_s = tt_to_tdb(utc_to_tt(observations.epoch)).seconds_since(self.epoch)
        return np.asarray(
            since_s * (1.0 if self.is_later else -1.0) > -0.5 * np.nan_to_num(observations.count_s)
        )


def find_manoeuvres(start: StagedStart, usable: Mask) -> list[Manoeuvre]:
    """Return the first undocumented manoeuvre before and the first after the epoch of an orbit."""
    if not usable.any():
        return []
    manoeuvres = list[Manoeuvre]()
    x, reach_s = start.part.apriori, start.first_reach_s(usable)
    while True:
        rows = start.rows_within(reach_s, usable)
        x = start.fitted(rows, x)
        manoeuvre = _find_manoeuvre(start, rows, x)
        if manoeuvre is not None:
            manoeuvres.append(manoeuvre)
            x, usable = manoeuvre.x, usable & ~manoeuvre.separates(start.part.predictor.observations)
        elif reach_s >= start.away_s[usable].max():
            return manoeuvres
        else:
            reach_s *= REACH_FACTOR


def _find_manoeuvre(start: StagedStart, rows: Indices, x: Floats) -> Manoeuvre | None:
    """Return the manoeuvre that explains the residuals of some observations, or ``None``."""
    search = _Search(start.part.select(rows))
    guess = search.scan(x)
    if guess is None or guess.gain < _MIN_SCAN_GAIN:
        return None
    logger.info(
        "an impulse at %.0f s reduces the sum of squares by a factor of %.3g", guess.time_s, guess.gain
    )
    try:
        return search.refine(guess, x)
    except RadiolocError as error:
        logger.info("the impulse does not converge: %s", error)
        return None


@dataclass(frozen=True, slots=True, eq=False)
class _Guess:
    """Impulse with the parameters of the orbit."""

    gain: float
    time_s: float
    delta_v_m_s: Floats
    x: Floats


@dataclass(frozen=True, eq=False)
class _Search:
    """Search for a manoeuvre among observations."""

    part: OrbitPart

    @cached_property
    def time_s(self) -> Floats:
        """Times of the observations from the epoch of the orbit, TDB."""
        return tt_to_tdb(utc_to_tt(self.part.predictor.observations.epoch)).seconds_since(
            self.part.orbit.epoch
        )

    @property
    def count_s(self) -> Floats:
        """Count intervals; zero for instantaneous observations."""
        observations = self.part.predictor.observations
        return np.where(is_integrated(observations.kind), observations.count_s, 0.0)

    def constants(self) -> Floats:
        """Return columns of a constant for each link and type, such as a frequency offset or a bias."""
        observations = self.part.predictor.observations
        code = np.unique(np.stack([observations.kind, observations.link]), axis=1, return_inverse=True)[1]
        unit = np.where(self.count_s > 0.0, self.count_s, 1.0) / self.part.sigma_m
        return np.asarray((code.ravel()[:, None] == np.arange(code.max() + 1)) * unit[:, None])

    def residuals(self, orbit: AdjustableOrbit, change: Floats) -> tuple[Floats, Floats]:
        """Return residuals in sigmas, and the design matrix of state (km and m/s), forces and constants."""
        computed = self.part.predictor.compute(OrbitMotion(orbit, change))
        design = np.hstack([computed.by_motion / self.part.sigma_m[:, None], self.constants()])
        design[:, :6] *= _STATE_SCALES
        return (self.part.predictor.observations.value_m - computed.value_m) / self.part.sigma_m, design

    def has_similar_neighbours(self, ratio: Floats) -> Mask:
        """Return False for outliers among their neighbours of the same link."""
        from scipy.ndimage import median_filter

        offset, time_s = np.zeros(len(ratio)), self.time_s
        for column in self.constants().T:
            rows = np.flatnonzero(column)
            rows = rows[np.argsort(time_s[rows])]
            offset[rows] = ratio[rows] - median_filter(ratio[rows], _NEIGHBOUR_COUNT, mode="mirror")
        return np.asarray(np.abs(offset) <= _MAX_ISOLATION_SIGMAS * max(1.0, robust_scale(offset, 0)))

    def scan(self, x: Floats) -> _Guess | None:
        """Return the impulse with the smallest residuals of a linearized fit of orbit and impulse."""
        ratio, design = self.residuals(self.part.orbit, x - self.part.apriori)
        rows = np.flatnonzero(self.has_similar_neighbours(ratio))
        rows = rows[np.argsort(self.time_s[rows])]
        time_s, ratio, design = self.time_s[rows], ratio[rows], design[rows]
        width = design.shape[1]
        size = np.linalg.norm(design, axis=0)
        design[:, 6:] /= np.where(size > 0.0, size, 1.0)[6:]
        if len(rows) < width + 2 * _MIN_SIDE_OBSERVATIONS:
            return None
        begin_s, end_s = time_s[_MIN_SIDE_OBSERVATIONS], time_s[-_MIN_SIDE_OBSERVATIONS]
        scan_s = np.linspace(begin_s, end_s, min(_MAX_TIMES, int((end_s - begin_s) / _MIN_STEP_S)) + 2)
        state = design[:, :6]
        inverse = np.linalg.inv(design.T @ design + 1e-8 * np.eye(width))
        fitted = inverse @ (design.T @ ratio)
        plain_chi2 = float(np.square(ratio - design @ fitted).sum())

        def later_sums(terms: Floats) -> Floats:
            """Return sums over the observations after each time of the scan."""
            return np.asarray(np.cumsum(terms[::-1], axis=0)[::-1][np.searchsorted(time_s, scan_s)])

        orbit = self.part.orbit.corrected(x - self.part.apriori)
        transition = orbit.partials(orbit.epoch.shifted(scan_s))[:, :, :6]
        kick = np.linalg.inv(transition)[:, :, 3:] / _STATE_SCALES[:, None]
        kick_transposed = np.swapaxes(kick, 1, 2)
        cross = later_sums(design[:, :, None] * state[:, None]) @ kick
        square = kick_transposed @ later_sums(state[:, :, None] * state[:, None]) @ kick
        # An a-priori sigma bounds the impulses that a few noisy observations determine.
        square += (
            plain_chi2 / len(rows) * np.eye(3) / _MAX_SIZE_M_S**2 - np.swapaxes(cross, 1, 2) @ inverse @ cross
        )
        right = (
            kick_transposed @ later_sums(state * ratio[:, None])[..., None]
            - np.swapaxes(cross, 1, 2) @ fitted[:, None]
        )
        delta_v = np.linalg.solve(square, right)
        best = int(np.argmax((right * delta_v).sum(axis=(1, 2))))
        impulse_columns = (time_s > scan_s[best])[:, None] * (state @ kick[best])
        full = np.hstack([design, impulse_columns])
        solution = np.linalg.lstsq(full, ratio, rcond=1e-12)[0]
        chi2 = float(np.square(ratio - full @ solution).sum())
        gain = plain_chi2 / chi2 * (len(rows) - width - 4) / (len(rows) - width)
        moved, impulse = x.copy(), solution[-3:]
        moved[:6] += solution[:6] * _STATE_SCALES
        if scan_s[best] < 0.0:  # the epoch is later than the impulse
            moved[:6] += kick[best] @ impulse * _STATE_SCALES
        return _Guess(gain, float(scan_s[best]), impulse, moved)

    def refine(self, guess: _Guess, plain: Floats) -> Manoeuvre | None:
        """Integrate the impulse and adjust its time; ``None`` without a significant gain over the plain orbit."""
        time_s, delta_v, x = guess.time_s, guess.delta_v_m_s, guess.x
        count = len(x)
        free = np.concatenate([self.part.free, count + np.arange(3)])
        sigmas = np.concatenate([self.part.step_sigmas, np.ones(3)])
        apriori = np.concatenate([self.part.apriori, np.zeros(3)])

        def orbit_with_impulse(epoch_s: float) -> AdjustableOrbit:
            impulse = Impulse(_NAME, self.part.orbit.epoch.shifted([epoch_s]), axes="ICRF")
            return replace(
                self.part.orbit,
                forces=replace(self.part.orbit.forces, impulses=(*self.part.orbit.forces.impulses, impulse)),
                parameters=(*self.part.orbit.parameters, *impulse.names()),
                integrated=[],
            )

        first_s, last_s = self.time_s.min() + 1.0, self.time_s.max() - 1.0
        for k in range(_ROUND_COUNT):
            orbit = orbit_with_impulse(time_s)
            part = replace(
                self.part, orbit=orbit, apriori=apriori, free=free, step_sigmas=sigmas, columns=slice(None)
            )
            y, spread = fitted_state(part, np.concatenate([x, delta_v]))
            x, delta_v = y[:count], y[count:]
            ratio, design = self.residuals(orbit, y - apriori)
            later = ratio - self.residuals(orbit_with_impulse(time_s + _DIFFERENCE_S), y - apriori)[0]
            distant = np.abs(self.time_s - time_s) > _EXCLUDED_S * _EXCLUDED_RATIO**k
            rows = np.flatnonzero(distant & (np.abs(ratio) <= _MAX_RESIDUAL_SIGMAS * spread))
            residuals, (shift_s, *_), covariance = _least_squares(
                np.column_stack([later / _DIFFERENCE_S, design])[rows], ratio[rows]
            )
            reached_s, sigma_s = time_s, float(covariance[0, 0] ** 0.5)
            time_s = float(
                np.clip(time_s + np.clip(shift_s, -_MAX_TIME_STEP_S, _MAX_TIME_STEP_S), first_s, last_s)
            )
            if abs(shift_s) < max(0.1, 0.1 * sigma_s):
                break
        plain_ratio, plain_design = self.residuals(self.part.orbit, plain - self.part.apriori)
        plain_residuals, _, _ = _least_squares(plain_design[rows], plain_ratio[rows])
        gain = (
            float(plain_residuals @ plain_residuals / (residuals @ residuals))
            * (len(rows) - design.shape[1] - 1)
            / len(rows)
        )
        impulse_rows = slice(1 + count, 4 + count)
        size = float(np.linalg.norm(delta_v))
        sigma_m_s = float(np.sqrt(delta_v @ covariance[impulse_rows, impulse_rows] @ delta_v)) / size
        logger.info(
            "an impulse of %.3g +- %.2g m/s reduces the sum of squares by a factor of %.3g",
            size,
            sigma_m_s,
            gain,
        )
        sides = np.bincount(self.time_s[rows] > reached_s, minlength=2)
        if gain < _MIN_GAIN or size < _MIN_SIZE_SIGMAS * sigma_m_s or sides.min() < _MIN_SIDE_OBSERVATIONS:
            return None
        position, velocity = orbit.corrected(y - apriori).states(orbit.epoch.shifted([reached_s]))
        used_s = np.sort(self.time_s[rows])
        next_index = int(np.searchsorted(used_s, reached_s))
        gap_s = used_s[next_index - 1 : next_index + 1]
        gap = orbit.epoch.shifted(gap_s) if np.ptp(gap_s) > _MIN_GAP_S else None
        in_rtn = rtn_axes(position[0], velocity[0]) @ delta_v
        epoch = orbit.epoch.shifted([reached_s])
        return Manoeuvre(epoch, sigma_s, in_rtn, sigma_m_s, gap, x, reached_s > 0.0)


def _least_squares(design: Floats, ratio: Floats) -> tuple[Floats, Floats, Floats]:
    """Return residuals, solution and covariance, scaled for residuals that are correlated in time."""
    scale = np.linalg.norm(design, axis=0)
    scale[scale == 0.0] = 1.0
    solution = np.linalg.lstsq(design / scale, ratio, rcond=1e-12)[0] / scale
    residuals = ratio - design @ solution
    square = residuals @ residuals
    lag = float(np.clip(residuals[1:] @ residuals[:-1] / square, 0.0, 0.98))
    variance = float(square) / max(1, len(ratio) - len(scale)) * (1.0 + lag) / (1.0 - lag)
    inverse = np.linalg.pinv((design / scale).T @ (design / scale), rcond=1e-14, hermitian=True)
    return residuals, solution, variance * inverse / np.outer(scale, scale)
