"""Displacement of a station by the load of the ocean tides: millimetres inland, centimetres at some coasts.

A station's coefficients give eleven tides. The other 331 of 342 follow from them: what a station does per
metre of equilibrium tide, its admittance, varies smoothly with frequency within each band (long period,
diurnal, semidiurnal), so it is interpolated between the tides that are given. This recovers the modulation
with 18.6 years and the minor tides, to about 1 percent of the loading.

The method and the tidal potential are those of the IERS Conventions (2010), section 7.1.2, as in its
program HARDISP (D. Agnew), against which this is checked; it is not that software. It is written from the
method's description, for many epochs at once.

Coefficients are commonly given against the solid Earth's centre of mass, not that of Earth and oceans
together, to which an ephemeris refers; the difference, the tidal motion of the geocentre, is up to some 10
mm and is not modelled here (coefficients that are made with it, "CMC: YES", contain it).
"""

from __future__ import annotations

import csv
from functools import cache
from importlib.resources import files

import erfa
import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.earth.blq import BlqCoefficients
from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.errors import InputError
from radioloc.time import Epochs

_GIVEN = np.array(
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

_WEST_SOUTH_UP_TO_ENU = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""From the order of a BLQ record (up, west, south)."""


def ocean_loading_displacement(
    coefficients: BlqCoefficients, station_itrf_m: ArrayLike, tt: Epochs, ut1_fraction: ArrayLike
) -> NDArray[np.float64]:
    """Displacement of a station by ocean tide loading.

    Parameters
    ----------
    coefficients : BlqCoefficients
        The station's coefficients.
    station_itrf_m : array_like, shape (3,) or (n, 3)
        The station, ITRF, m.
    tt : Epochs
        Epochs in TT, n of them.
    ut1_fraction : array_like, shape (n,)
        UT1 as a fraction of its day (UTC instead costs less than some micrometres).

    Returns
    -------
    ndarray, shape (n, 3)
        What to add to the station's position, ITRF, m.

    Raises
    ------
    InputError
        The epochs are not in TT, or a shape does not fit.
    """
    enu = ocean_loading_enu(coefficients, tt, ut1_fraction)
    station = np.asarray(station_itrf_m, dtype=np.float64)
    if station.shape not in ((3,), (len(tt), 3)):
        raise InputError(f"stations have shape {station.shape}; give (3,) or ({len(tt)}, 3)")
    return np.einsum("...ij,...i->...j", rot_itrf_to_enu(station), enu)


def ocean_loading_enu(
    coefficients: BlqCoefficients, tt: Epochs, ut1_fraction: ArrayLike
) -> NDArray[np.float64]:
    """Displacement of a station by ocean tide loading to the east, the north and up, m, shape (n, 3).

    Parameters and errors as :func:`ocean_loading_displacement`.

    Notes
    -----
    IERS Conventions (2010), section 7.1.2: the sum over 342 tides of A_j cos(theta_j(t) + chi_j - phi_j),
    with the amplitude of each relative to the equilibrium tide, and its lag, interpolated in frequency.
    Outside the given tides of a band the nearest one's admittance is taken, as the conventional program
    does.
    """
    tt.require("TT")
    fraction = np.asarray(ut1_fraction, dtype=np.float64)
    if fraction.shape not in ((), (len(tt),)) or not np.isfinite(fraction).all():
        raise InputError(f"give the fraction of the UT1 day for {len(tt)} epochs, finite")
    multipliers, _ = _tidal_potential()
    arguments = _doodson_arguments_rad(tt.centuries_since_j2000(), fraction) @ multipliers.T
    weights = _tide_amplitudes(coefficients)
    up_west_south = np.cos(arguments) @ weights.real.T - np.sin(arguments) @ weights.imag.T
    return up_west_south @ _WEST_SOUTH_UP_TO_ENU.T


def _tide_amplitudes(coefficients: BlqCoefficients) -> NDArray[np.complex128]:
    """Amplitudes A of the 342 tides, m, complex, shape (3, 342): displacement is Re sum(A e^(i arg))."""
    multipliers, equilibrium_m = _tidal_potential()
    frequency = multipliers @ _RATES_CYCLES_PER_DAY
    given_frequency = _GIVEN @ _RATES_CYCLES_PER_DAY
    given = [int(np.flatnonzero((multipliers == tide).all(axis=1))[0]) for tide in _GIVEN]
    admittance = (
        coefficients.amplitude_m * np.exp(-1j * coefficients.phase_lag_rad) / np.abs(equilibrium_m[given])
    )
    amplitudes = np.empty((3, len(frequency)), dtype=np.complex128)
    for band, phase in enumerate(_EQUILIBRIUM_PHASE_RAD):
        members = multipliers[:, 0] == band
        nodes = np.flatnonzero(_GIVEN[:, 0] == band)
        nodes = nodes[np.argsort(given_frequency[nodes])]
        interpolated = _interpolate(given_frequency[nodes], admittance[:, nodes], frequency[members])
        amplitudes[:, members] = interpolated * equilibrium_m[members] * np.exp(1j * phase)
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


def _doodson_arguments_rad(
    centuries_tt: NDArray[np.float64], ut1_fraction: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Arguments tau, s, h, p, N', ps, rad, shape (n, 6), by the IERS 2003 fundamental arguments (ERFA)."""
    node = erfa.faom03(centuries_tt)
    elongation = erfa.fad03(centuries_tt)
    moon = erfa.faf03(centuries_tt) + node
    sun = moon - elongation
    tau = 2.0 * np.pi * ut1_fraction - elongation
    return np.stack(
        [tau, moon, sun, moon - erfa.fal03(centuries_tt), -node, sun - erfa.falp03(centuries_tt)], axis=-1
    )


@cache
def _tidal_potential() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Multipliers, shape (342, 6), and equilibrium amplitudes, m, of the tides."""
    text = (files("radioloc.earth") / "data" / "tide_potential.csv").read_text(encoding="utf-8")
    rows = list(csv.reader(line for line in text.splitlines() if not line.startswith("#")))[1:]
    table = np.array(rows, dtype=np.float64)
    table.setflags(write=False)
    return table[:, :6], table[:, 6]
