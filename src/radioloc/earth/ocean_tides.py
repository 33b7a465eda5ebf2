"""Ocean tides in full from eleven of them: the sum that ocean loading and the tidal geocentre share.

Whatever the oceans bring about is known for eleven tides. The other 331 of 342 follow: what happens per
metre of equilibrium tide, the admittance, varies smoothly with frequency within each band (long period,
diurnal, semidiurnal), so it is interpolated between the tides that are given. This recovers the modulation
with 18.6 years and the minor tides.

The method and the tidal potential are those of the IERS Conventions (2010), section 7.1.2, as in its program
HARDISP (D. Agnew), against which this is checked; it is not that software. It is written from the method's
description, for many epochs at once.
"""

from __future__ import annotations

import csv
from functools import cache
from importlib.resources import files

import erfa
import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.time import Epochs, evaluate_smooth

GIVEN_TIDES = np.array(
    [
        (2, 0, 0, 0, 0, 0),
        (2, 2, -2, 0, 0, 0),
        (2, -1, 0, 1, 0, 0),
        (2, 2, 0, 0, 0, 0),
        (1, 1, 0, 0, 0, 0),
        (1, -1, 0, 0, 0, 0),
        (1, 1, -2, 0, 0, 0),
        (1, -2, 0, 1, 0, 0),
        (0, 2, 0, 0, 0, 0),
        (0, 1, 0, -1, 0, 0),
        (0, 0, 2, 0, 0, 0),
    ]
)
"""The tides of a BLQ record, in its order: multipliers of tau, s, h, p, N', ps."""

_RATES_CYCLES_PER_DAY = np.array(
    [0.9661368080, 0.0366011013, 0.0027379091, 0.0003094542, 0.0001470938, 0.0000001305]
)
"""Rates of tau, s, h, p, N', ps, cycles per day (from the IERS 2003 fundamental arguments)."""

_EQUILIBRIUM_PHASE_RAD = np.array([np.pi, np.pi / 2.0, 0.0])
"""Phase of the equilibrium tide of each band against its argument; lags at Greenwich count from it."""


def sum_of_tides(
    amplitudes_m: NDArray[np.complex128], tt: Epochs, ut1_fraction: ArrayLike
) -> NDArray[np.float64]:
    """Sum 342 tides that follow from eleven.

    Parameters
    ----------
    amplitudes_m : ndarray of complex, shape (3, 11)
        Three components of the eleven tides of :data:`GIVEN_TIDES`: amplitude times exp(-i lag), the lag
        counted from the equilibrium tide at Greenwich; in-phase and cross-phase parts are the real part and
        minus the imaginary part.
    tt : Epochs
        Epochs in TT, n of them.
    ut1_fraction : array_like, shape (n,)
        UT1 as a fraction of its day.

    Returns
    -------
    ndarray, shape (n, 3)
        The components, m.

    Raises
    ------
    InputError
        The epochs are not in TT, or a shape does not fit.

    Notes
    -----
    IERS Conventions (2010), section 7.1.2: the sum of A_j cos(theta_j(t) + chi_j - phi_j), with amplitude
    relative to the equilibrium tide, and lag, interpolated in frequency. Outside the given tides of a band
    the nearest one's admittance is taken, as the conventional program does.
    """
    tt.require("TT")
    fraction = np.asarray(ut1_fraction, dtype=np.float64)
    if fraction.shape not in ((), (len(tt),)) or not np.isfinite(fraction).all():
        raise InputError(f"give the fraction of the UT1 day for {len(tt)} epochs, finite")
    multipliers, _ = tidal_potential()
    amplitudes = all_amplitudes(amplitudes_m)
    bands = [multipliers[:, 0] == band for band in range(len(_EQUILIBRIUM_PHASE_RAD))]

    def envelopes(at: Epochs) -> NDArray[np.complex128]:
        """Tides of each band without the turning of the Earth, shape (n, bands, 3)."""
        arguments = _doodson_arguments_rad(at.centuries_since_j2000())
        sums = [np.exp(1j * (arguments @ multipliers[b, 1:].T)) @ amplitudes[:, b].T for b in bands]
        return np.stack(sums, axis=1)

    # The moon's mean longitude enters five times at most: what is left turns in five days or more.
    envelope = evaluate_smooth(envelopes, tt)
    tau = 2.0 * np.pi * fraction - erfa.fad03(tt.centuries_since_j2000())
    turned = np.exp(1j * np.multiply.outer(np.broadcast_to(tau, len(tt)), np.arange(len(bands))))
    return np.asarray(np.einsum("nb,nbk->nk", turned, envelope).real)


def all_amplitudes(amplitudes_m: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Find the amplitudes A of all 342 tides, m, shape (3, 342): the sum is Re(A e^(i argument))."""
    return amplitudes_m @ _amplitudes_by_given()


@cache
def _amplitudes_by_given() -> NDArray[np.complex128]:
    """Amplitudes of all tides, shape (11, 342), if one of those given is one and the others zero."""
    multipliers, equilibrium_m = tidal_potential()
    frequency = multipliers @ _RATES_CYCLES_PER_DAY
    given_frequency = GIVEN_TIDES @ _RATES_CYCLES_PER_DAY
    given = [int(np.flatnonzero((multipliers == tide).all(axis=1))[0]) for tide in GIVEN_TIDES]
    admittance = np.diag(1.0 / np.abs(equilibrium_m[given])).astype(np.complex128)
    amplitudes = np.empty((len(GIVEN_TIDES), len(frequency)), dtype=np.complex128)
    for band, phase in enumerate(_EQUILIBRIUM_PHASE_RAD):
        members = multipliers[:, 0] == band
        nodes = np.flatnonzero(GIVEN_TIDES[:, 0] == band)
        nodes = nodes[np.argsort(given_frequency[nodes])]
        interpolated = _interpolate(given_frequency[nodes], admittance[:, nodes], frequency[members])
        amplitudes[:, members] = interpolated * equilibrium_m[members] * np.exp(1j * phase)
    amplitudes.setflags(write=False)
    return amplitudes


def _interpolate(
    x: NDArray[np.float64], y: NDArray[np.complex128], at: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Interpolate rows of y by a cubic spline (four nodes) or lines (three); outside, take the end."""
    inside = np.minimum(np.maximum(at, x[0]), x[-1])
    k = np.minimum(np.searchsorted(x, inside, side="right") - 1, len(x) - 2)
    width = x[k + 1] - x[k]
    b = (inside - x[k]) / width
    a = 1.0 - b
    curvature = _spline_curvature(x, y) if len(x) > 3 else np.zeros_like(y)
    cubic = (a**3 - a) * curvature[:, k] + (b**3 - b) * curvature[:, k + 1]
    return a * y[:, k] + b * y[:, k + 1] + cubic * width**2 / 6.0


def _spline_curvature(x: NDArray[np.float64], y: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Second derivatives at the nodes of the cubic spline with the end slopes of parabolas, shape of y.

    Each parabola goes through the three nodes nearest to its end.
    """
    step = np.diff(x)
    slope = np.diff(y, axis=1) / step
    first = slope[:, 0] + (slope[:, 0] - slope[:, 1]) * step[0] / (step[0] + step[1])
    last = slope[:, -1] + (slope[:, -1] - slope[:, -2]) * step[-1] / (step[-1] + step[-2])
    matrix = np.diag(np.r_[step[0], step[:-1] + step[1:], step[-1]] / 3.0)
    matrix += np.diag(step / 6.0, 1) + np.diag(step / 6.0, -1)
    right = np.diff(np.column_stack([first, slope, last]), axis=1)
    return np.asarray(np.linalg.solve(matrix, right.T).T, dtype=np.complex128)


def _doodson_arguments_rad(centuries_tt: NDArray[np.float64]) -> NDArray[np.float64]:
    """Arguments s, h, p, N', ps, rad, shape (n, 5), by the IERS 2003 fundamental arguments (ERFA)."""
    node = erfa.faom03(centuries_tt)
    moon = erfa.faf03(centuries_tt) + node
    sun = moon - erfa.fad03(centuries_tt)
    return np.stack(
        [moon, sun, moon - erfa.fal03(centuries_tt), -node, sun - erfa.falp03(centuries_tt)], axis=-1
    )


@cache
def tidal_potential() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Multipliers, shape (342, 6), and equilibrium amplitudes, m, of the tides."""
    text = (files("radioloc.earth") / "data" / "tide_potential.csv").read_text(encoding="utf-8")
    rows = list(csv.reader(line for line in text.splitlines() if not line.startswith("#")))[1:]
    table = np.array(rows, dtype=np.float64)
    table.setflags(write=False)
    return table[:, :6], table[:, 6]
