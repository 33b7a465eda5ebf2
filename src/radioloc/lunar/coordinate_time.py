"""TCL, the coordinate time of the Lunar Celestial Reference System (LCRS; IAU 2024, Resolution II).

TCL is to the Moon what TCG is to the Earth. With v the barycentric velocity of either's centre and U the potential
there of all other bodies, d(TCG)/d(TCB) = 1 - (v_E^2/2 + U_E)/c^2 and d(TCL)/d(TCB) = 1 - (v_M^2/2 + U_M)/c^2; all
three agreed on 1977-01-01 at 0 h TAI. TCL - TCG is integrated; TCG - TT and TT - TDB are closed expressions. Distant
bodies contribute equally to both potentials, so small bodies and planets that a kernel lacks cancel.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from radioloc.constants import C_M_S, J2000_JD, L_G, SECONDS_PER_DAY
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.ephemeris.positions import clock_rate
from radioloc.lunar.frames import rot_icrf_to_pa
from radioloc.lunar.position import LunarPosition
from radioloc.quantities import EpochsLike, accepts_quantities
from radioloc.time import Epochs, geocentric_tdb_minus_tt
from radioloc.vectors import Floats, dot

_START = Epochs.from_jd(2443144.5, 32.184 / SECONDS_PER_DAY, "TDB")
"""Epoch at which TCB, TCG and TCL agreed, with TT 65.5 microseconds before TDB; the number is that of TT."""
_AT_J2000_S = -0.012625078685
"""TCL - TCG at the centres at J2000.0, integrated from 1977 with DE421; kernels may begin later."""
_STEP_S = 43200.0


@accepts_quantities
def tcl_minus_tdb(
    tdb: EpochsLike, position: LunarPosition | None = None, ephemeris: str | Path = "DE421"
) -> Floats:
    """TCL - TDB at the Moon's centre, or at a point fixed to the Moon, s, shape (n,).

    Parameters
    ----------
    tdb : Epochs or Time
        Epochs; a Time in any scale.
    position : LunarPosition, optional
        Point fixed to the Moon; by default the Moon's centre.
    ephemeris : str or path-like
        ``"DE421"``, ``"DE440"``, or an SPK that covers J2000.0 and the epochs.

    Raises
    ------
    CoverageError
        The ephemeris does not cover this time.
    InputError
        The rotation from the position's axes to those of the ephemeris is not available.

    Notes
    -----
    TCL gains 58.7 microseconds a day on TDB and on TT on average; TCL - TDB is 0.49 s in 2000. Its variations are
    1.65 ms within a year, as of TT against TDB, and 0.13 ms within a month, v_E . r_M / c^2. A point on the
    surface differs from the centre by v_M . r / c^2, up to 0.58 microseconds. At J2000.0 the lunar time ephemeris
    LTE440 (Lu, Yang and Xie 2025, Astron. Astrophys. 704, A76) is 18 ns less, the accuracy of this series of TDB - TT.

    Examples
    --------
    >>> from radioloc.lunar import tcl_minus_tdb
    >>> from radioloc.time import epochs_from_strings
    >>> tcl_minus_tdb(epochs_from_strings("2000-01-01T12:00:00", "TDB")).round(4).tolist()
    [0.4933]
    """
    source = Ephemeris.open(ephemeris)
    tdb_minus_tt_s = geocentric_tdb_minus_tt(tdb)
    tt_since_1977_s = tdb.seconds_since(_START) - tdb_minus_tt_s
    difference_s = _tcl_minus_tcg(source, tdb) + L_G / (1.0 - L_G) * tt_since_1977_s - tdb_minus_tt_s
    if position is not None:
        pa_m = position.to_axes("PA", source.constants).xyz_m
        icrf_m = pa_m @ rot_icrf_to_pa(LunarOrientation.open(source.name).angles(tdb)[0])
        difference_s = difference_s - dot(source.barycentric("moon", tdb)[1], icrf_m) / C_M_S**2
    return difference_s


def _tcl_minus_tcg(source: Ephemeris, tdb: Epochs) -> Floats:
    """Return TCL - TCG at the centres of Moon and Earth at the same TDB, s, shape (n,)."""
    from scipy.interpolate import make_interp_spline

    seconds = ((tdb.jd - J2000_JD) + tdb.fraction) * SECONDS_PER_DAY
    # At least six nodes; the error of the fastest terms, of a week, is 1e-9 of their amplitude.
    first, last = min(0.0, seconds.min(initial=0.0)), max(_STEP_S, seconds.max(initial=0.0))
    nodes = np.linspace(first, last, max(6, int((last - first) / _STEP_S) + 2))
    at_nodes = Epochs.from_tdb_seconds(nodes)
    rates = make_interp_spline(
        nodes, clock_rate(source, at_nodes, *source.geocentric("moon", at_nodes), "moon"), k=5
    )
    integral = rates.antiderivative()
    return np.asarray(_AT_J2000_S + integral(seconds) - integral(0.0))
