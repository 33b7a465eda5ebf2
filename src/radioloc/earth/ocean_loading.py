"""Displacement of stations by the tides of the oceans: their load on the crust, and the motion of the geocentre.

Whatever the oceans bring about is known for eleven tides, of a station by its BLQ record. The other 331 of 342 follow:
what happens per metre of equilibrium tide, the admittance, varies smoothly with frequency within each band (long
period, diurnal, semidiurnal), so it is interpolated between the tides that are given. This recovers the modulation
with 18.6 years and the minor tides.

The method and the tidal potential are those of the IERS Conventions (2010), section 7.1.2, as in its program
HARDISP (D. Agnew), against which this is checked; it is not that software. It is written from the method's
description, for many epochs at once.

Loading: millimetres inland, centimetres at some coasts. Its coefficients are commonly given against the centre of mass
of the solid Earth (those that ship are). The motion of that centre about the one of Earth and oceans together, up to
some 13 mm and the same for all stations, is another term, the tidal geocentre: as the tides move the water, the solid
Earth moves the other way, and an ephemeris' Earth is the common centre. Coefficients marked "CMC: YES" contain it,
and it is not added to them.
"""

from __future__ import annotations

from functools import cache

import erfa
import numpy as np
from numpy.typing import NDArray

from radioloc.earth.blq import BlqCoefficients
from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.time import Epochs
from radioloc.time.smooth import evaluate_smooth, table_of
from radioloc.vectors import Floats

# fmt: off
GIVEN_TIDES = np.array([
    (2, 0, 0, 0, 0, 0), (2, 2, -2, 0, 0, 0), (2, -1, 0, 1, 0, 0), (2, 2, 0, 0, 0, 0),
    (1, 1, 0, 0, 0, 0), (1, -1, 0, 0, 0, 0), (1, 1, -2, 0, 0, 0), (1, -2, 0, 1, 0, 0),
    (0, 2, 0, 0, 0, 0), (0, 1, 0, -1, 0, 0), (0, 0, 2, 0, 0, 0),
])
# fmt: on
"""The tides of a BLQ record, in its order: multipliers of tau, s, h, p, N', ps."""

_RATES_CYCLES_PER_DAY = np.array(
    [0.9661368080, 0.0366011013, 0.0027379091, 0.0003094542, 0.0001470938, 0.0000001305]
)
"""Rates of tau, s, h, p, N', ps, cycles per day (from the IERS 2003 fundamental arguments)."""

_EQUILIBRIUM_PHASE_RAD = np.array([np.pi, np.pi / 2.0, 0.0])
"""Phase of the equilibrium tide of each band against its argument; lags at Greenwich count from it."""

_WEST_SOUTH_UP_TO_ENU = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""From the order of a BLQ record (up, west, south)."""

# fmt: off
_FES2004_M = np.array([
    (-1.3724e-3, 8.2077e-4, 1.1479e-3, 2.3005e-4, -1.2661e-3, -1.4298e-3),
    (-5.3350e-4, -3.1591e-4, -5.1370e-5, 2.8184e-4, -1.7763e-4, -5.7273e-4),
    (-2.7121e-4, 1.9849e-4, 2.6018e-4, -1.4302e-4, -3.2372e-4, -2.8986e-4),
    (-1.1223e-4, -1.0889e-5, -1.5751e-5, 1.2367e-4, -1.1814e-4, -1.5250e-4),
    (-1.8539e-3, -8.6426e-4, -9.1022e-4, -1.7823e-3, -1.1370e-3, 4.4839e-3),
    (-1.3985e-3, -2.2975e-4, -8.8858e-4, -6.4989e-4, -1.6802e-4, 2.9702e-3),
    (-6.1436e-4, -2.9129e-4, -2.9261e-4, -5.7461e-4, -3.6495e-4, 1.4941e-3),
    (-2.7831e-4, -2.9313e-5, -2.1734e-4, -4.1637e-5, 3.0709e-5, 4.5472e-4),
    (-2.2065e-4, 4.1472e-4, -1.0212e-4, 8.2276e-5, -5.0643e-4, -7.3040e-5),
    (4.6882e-5, 1.8399e-4, -7.4897e-6, 1.3209e-5, -2.7885e-4, 2.0596e-5),
    (1.3687e-4, 3.5475e-5, -2.4093e-5, 3.1666e-7, -1.4899e-4, 2.6146e-6),
])
# fmt: on
"""In-phase and cross-phase parts of x, y and z, m, for M2 S2 N2 K2 K1 O1 P1 Q1 Mf Mm Ssa: ocean tide model
FES2004 (Scherneck, Onsala Space Observatory, file of centre of mass coefficients)."""

TIDAL_GEOCENTRE_M = (_FES2004_M[:, 0::2] - 1j * _FES2004_M[:, 1::2]).T
"""Amplitudes for :func:`sum_of_tides`, ITRF: displacement of the solid Earth, with all stations, from the common centre
of mass with the oceans.

IERS Conventions (2010), section 7.1.2: in-phase part times the cosine and cross-phase part times the sine of each
tide's argument, here with the minor tides. A position about the common centre is one in the crust's frame plus this.
Ocean tide models differ by some 0.5 mm (K1 and O1 in z, FES2004 and GOT5.5)."""


_BLOCK = 256  # epochs per block, so that the phases of all tides stay in the processor's cache


def loading_itrf_m(coefficients: BlqCoefficients, station_itrf_m: Floats) -> NDArray[np.complex128]:
    """Amplitudes for :func:`sum_of_tides` of the displacement by ocean tide loading, ITRF, shape (3, 11)."""
    return np.asarray(rot_itrf_to_enu(station_itrf_m).T @ loading_enu_m(coefficients))


def loading_enu_m(coefficients: BlqCoefficients) -> NDArray[np.complex128]:
    """Amplitudes as of :func:`loading_itrf_m`, to the east, the north and up."""
    amplitudes_m = coefficients.amplitude_m * np.exp(-1j * coefficients.phase_lag_rad)
    return np.asarray(_WEST_SOUTH_UP_TO_ENU @ amplitudes_m)


def sum_of_tides(amplitudes_m: NDArray[np.complex128], tt: Epochs, ut1_fraction: Floats) -> Floats:
    """Sum 342 tides that follow from eleven, m, shape (n, 3); amplitudes have the shape (3, 11) or (n, 3, 11)."""
    # IERS Conventions (2010), section 7.1.2: the sum of A_j cos(theta_j(t) + chi_j - phi_j), with amplitude relative to
    # the equilibrium tide, and lag, interpolated in frequency. Amplitudes are complex, A exp(-i lag), in the order of
    # GIVEN_TIDES, the lag counted from the equilibrium tide at Greenwich. Outside the given tides of a band the
    # admittance is that of the nearest, as in the conventional program.
    tt.require("TT")
    # The Moon's mean longitude enters at most five times, so the remaining arguments have periods of five days or more.
    envelope = evaluate_smooth(_envelopes, tt)
    tau = 2.0 * np.pi * ut1_fraction - erfa.fad03(tt.centuries_since_j2000())
    turned = np.exp(1j * np.multiply.outer(tau, np.arange(len(_EQUILIBRIUM_PHASE_RAD))))
    main_tides = envelope * turned[:, GIVEN_TIDES[:, 0]]
    return np.asarray((amplitudes_m @ main_tides[:, :, None])[:, :, 0].real)


def _envelopes(tt: Epochs) -> NDArray[np.complex128]:
    """Sum the tides per unit of each main one, without the rotation of the Earth, shape (n, 11)."""
    arguments = _doodson_arguments_rad(tt.centuries_since_j2000()).T
    powers = [np.unique(column, return_inverse=True) for column in tidal_potential()[0][:, 1:].T]
    sums = np.empty((len(GIVEN_TIDES), len(tt)), dtype=np.complex128)
    # Of each argument few multiples occur, and products are faster than exponentials as long as they stay in cache.
    for first in range(0, len(tt), _BLOCK):
        block = slice(first, first + _BLOCK)
        tides = np.ones((1, 1), dtype=np.complex128)
        for argument, (multiples, indices) in zip(arguments[:, block], powers, strict=True):
            tides = tides * np.exp(1j * np.multiply.outer(multiples, argument))[indices]
        sums[:, block] = amplitudes_by_given() @ tides
    return sums.T


@cache
def amplitudes_by_given() -> NDArray[np.complex128]:
    """Amplitudes A of all 342 tides per unit of each of the eleven, (11, 342): a tide is Re(A e^(i argument))."""
    multipliers, equilibrium_m = tidal_potential()
    frequency = multipliers @ _RATES_CYCLES_PER_DAY
    given_frequency = GIVEN_TIDES @ _RATES_CYCLES_PER_DAY
    main_rows = [int(np.flatnonzero((multipliers == tide).all(axis=1))[0]) for tide in GIVEN_TIDES]
    admittance = np.diag(1.0 / np.abs(equilibrium_m[main_rows])).astype(np.complex128)
    amplitudes = np.empty((len(GIVEN_TIDES), len(frequency)), dtype=np.complex128)
    for band, phase in enumerate(_EQUILIBRIUM_PHASE_RAD):
        members = multipliers[:, 0] == band
        nodes = np.flatnonzero(GIVEN_TIDES[:, 0] == band)
        nodes = nodes[np.argsort(given_frequency[nodes])]
        interpolated = _interpolate(given_frequency[nodes], admittance[:, nodes], frequency[members])
        amplitudes[:, members] = interpolated * equilibrium_m[members] * np.exp(1j * phase)
    amplitudes.setflags(write=False)
    return amplitudes


def _interpolate(x: Floats, y: NDArray[np.complex128], at: Floats) -> NDArray[np.complex128]:
    """Interpolate rows of y by a cubic spline (four nodes) or lines (three); outside, take the end."""
    # By hand, as importing scipy.interpolate takes half as long as locating a reflector.
    clipped = np.clip(at, x[0], x[-1])
    k = np.minimum(np.searchsorted(x, clipped, side="right") - 1, len(x) - 2)
    width = x[k + 1] - x[k]
    b = (clipped - x[k]) / width
    a = 1.0 - b
    curvature = _spline_curvature(x, y) if len(x) > 3 else np.zeros_like(y)
    cubic = (a**3 - a) * curvature[:, k] + (b**3 - b) * curvature[:, k + 1]
    return a * y[:, k] + b * y[:, k + 1] + cubic * width**2 / 6.0


def _spline_curvature(x: Floats, y: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Second derivatives at the nodes of the cubic spline whose end slopes are those of parabolas, shape of y."""
    step = np.diff(x)
    slope = np.diff(y, axis=1) / step
    first = slope[:, 0] + (slope[:, 0] - slope[:, 1]) * step[0] / (step[0] + step[1])
    last = slope[:, -1] + (slope[:, -1] - slope[:, -2]) * step[-1] / (step[-1] + step[-2])
    matrix = np.diag(np.r_[step[0], step[:-1] + step[1:], step[-1]] / 3.0)
    matrix += np.diag(step / 6.0, 1) + np.diag(step / 6.0, -1)
    right = np.diff(np.column_stack([first, slope, last]), axis=1)
    return np.asarray(np.linalg.solve(matrix, right.T).T, dtype=np.complex128)


def _doodson_arguments_rad(centuries_tt: Floats) -> Floats:
    """Arguments s, h, p, N', ps, rad, shape (n, 5), by the IERS 2003 fundamental arguments (ERFA)."""
    node = erfa.faom03(centuries_tt)
    moon = erfa.faf03(centuries_tt) + node
    sun = moon - erfa.fad03(centuries_tt)
    return np.stack(
        [moon, sun, moon - erfa.fal03(centuries_tt), -node, sun - erfa.falp03(centuries_tt)], axis=-1
    )


def tidal_potential() -> tuple[Floats, Floats]:
    """Multipliers, shape (342, 6), and equilibrium amplitudes, m, of the tides."""
    table = table_of("radioloc.earth", "tide_potential.csv")
    return table[:, :6], table[:, 6]
