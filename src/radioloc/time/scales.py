"""Changes between UTC, TAI, TT and TDB, and dates as text.

UTC is what tags observations. Leap seconds are ERFA's table, brought up to date from the list that
``astropy-iers-data`` ships. Before 1972 UTC ran at another rate than TAI; such dates are refused.

TDB - TT at the geocentre is ERFA's series; what depends on the place is the exact first-order term v_E . r / c^2 (Moyer
2003, eq. 2-23; IERS Conventions 2010, eq. 10.7), from the ephemeris' own velocity. ERFA has terms for a place too, but
without the second order in the Earth's eccentricity and, along the spin axis, what Jupiter and the Moon do to its
velocity: up to 1.2 ns at a station and 2.2 ns, 0.65 m of three-way range, between two.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import astropy_iers_data
import erfa
import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import C_M_S, SECONDS_PER_DAY, TT_MINUS_TAI_S, UTC_JD
from radioloc.errors import CoverageError, InputError
from radioloc.time.epochs import Epochs
from radioloc.time.smooth import table_of, tabulated
from radioloc.units import as_float_array
from radioloc.vectors import Floats


@cache
def _leap_seconds_up_to_date() -> None:
    """Bring ERFA's table up to the one in ``astropy-iers-data``."""
    installed = erfa.leap_seconds.get()
    rows = np.loadtxt(astropy_iers_data.IERS_LEAP_SECOND_FILE, comments="#", usecols=(3, 2, 4))
    last = (installed["year"][-1], installed["month"][-1])
    fresh = [(year, month, seconds) for year, month, seconds in rows.tolist() if (year, month) > last]
    if fresh:
        erfa.leap_seconds.update(np.array(fresh, dtype=installed.dtype))


def last_leap_second() -> str:
    """Return the day (UTC) at whose beginning TAI-UTC last changed."""
    _leap_seconds_up_to_date()
    last = erfa.leap_seconds.get()[-1]
    return f"{last['year']}-{last['month']:02d}-01"


@contextmanager
def _any_year() -> Iterator[None]:
    """ERFA calls dates past its table "dubious"; Earth orientation reports how far the data reach."""
    _leap_seconds_up_to_date()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        yield


def in_scale(epochs: Epochs | Any, scale: str) -> Epochs:
    """Return epochs of a scale; an astropy Time of any scale is converted."""
    if not isinstance(epochs, Epochs):
        return to_scale(Epochs.from_time(epochs), scale)
    epochs.require(scale)
    return epochs


def _require_utc_era(utc: Epochs) -> None:
    if len(utc) and utc.jd.min() < UTC_JD:
        early = utc[int(np.argmin(utc.jd))].day_strings()[0]
        raise CoverageError(
            "UTC with leap seconds",
            ("1972-01-01", "today"),
            (early, early),
            "before 1972 UTC had another rate than TAI: give the epochs in TAI or TT instead",
        )


def utc_to_tai(utc: Epochs) -> Epochs:
    """UTC to TAI; from 1972 on, when the present UTC began.

    Examples
    --------
    >>> from radioloc.time import epochs_from_strings, utc_strings, utc_to_tai
    >>> utc_strings(utc_to_tai(epochs_from_strings("2020-12-01T15:11:00", "UTC")), 6).tolist()
    ['2020-12-01T15:11:37.000000']
    """
    utc = in_scale(utc, "UTC")
    _require_utc_era(utc)
    if not len(utc):
        return Epochs(utc.jd, utc.fraction, "TAI")
    day = (utc.jd - utc.jd.min()).astype(np.int64)
    n_days = int(day.max()) + 2
    with _any_year():
        if n_days > len(utc):
            jd, fraction = erfa.utctai(utc.jd, utc.fraction)
            return Epochs.from_jd(jd, fraction, "TAI")
        # Of many epochs in few days, those of one day share an offset; the last entry is the midnight after the last.
        midnights = erfa.utctai(utc.jd.min() + np.arange(n_days), np.zeros(n_days))
    after_midnight_d = (midnights[0] - midnights[0][0]) - np.arange(n_days) + midnights[1]
    length_d = 1.0 + np.diff(after_midnight_d)
    return Epochs.from_jd(utc.jd, after_midnight_d[day] + utc.fraction * length_d[day], "TAI")


def tai_to_utc(tai: Epochs) -> Epochs:
    """TAI to UTC; from 1972 on.

    Examples
    --------
    >>> from radioloc.time import epochs_from_strings, tai_to_utc, utc_strings
    >>> utc_strings(tai_to_utc(epochs_from_strings("2020-12-01T15:11:00", "TAI")), 6).tolist()
    ['2020-12-01T15:10:23.000000']
    """
    tai = in_scale(tai, "TAI")
    with _any_year():
        jd, fraction = erfa.taiutc(tai.jd, tai.fraction)
    utc = Epochs.from_jd(jd, fraction, "UTC")
    _require_utc_era(utc)
    return utc


def _shifted(epochs: Epochs, to: str, seconds: float | Floats) -> Epochs:
    return Epochs.from_jd(epochs.jd, epochs.fraction + seconds / SECONDS_PER_DAY, to)


def tai_to_tt(tai: Epochs) -> Epochs:
    """TAI to TT, a constant 32.184 s.

    Examples
    --------
    >>> from radioloc.time import epochs_from_strings, tai_to_tt, utc_strings
    >>> utc_strings(tai_to_tt(epochs_from_strings("2020-12-01T15:11:00", "TAI")), 6).tolist()
    ['2020-12-01T15:11:32.184000']
    """
    return _shifted(in_scale(tai, "TAI"), "TT", TT_MINUS_TAI_S)


def tt_to_tai(tt: Epochs) -> Epochs:
    """Return TAI of TT, a constant 32.184 s earlier."""
    return _shifted(in_scale(tt, "TT"), "TAI", -TT_MINUS_TAI_S)


def utc_to_tt(utc: Epochs) -> Epochs:
    """UTC to TT.

    Examples
    --------
    >>> from radioloc.time import epochs_from_strings, utc_strings, utc_to_tt
    >>> utc_strings(utc_to_tt(epochs_from_strings("2020-12-01T15:11:00", "UTC")), 6).tolist()
    ['2020-12-01T15:12:09.184000']
    """
    return tai_to_tt(utc_to_tai(utc))


def tt_to_tdb(tt: Epochs) -> Epochs:
    """TT to TDB at the geocentre (ERFA ``dtdb``, Fairhead and Bretagnon 1990).

    Examples
    --------
    >>> from radioloc.time import epochs_from_strings, tt_to_tdb, utc_strings
    >>> utc_strings(tt_to_tdb(epochs_from_strings("2020-12-01T15:11:00", "TT")), 6).tolist()
    ['2020-12-01T15:10:59.999070']
    """
    tt = in_scale(tt, "TT")
    return _shifted(tt, "TDB", geocentric_tdb_minus_tt(tt))


def tdb_to_tt(tdb: Epochs) -> Epochs:
    """Return TT of TDB at the geocentre, to 1e-12 s."""
    # TDB - TT is below 2 ms and changes by less than 4e-10 of a shift: it may be taken at the TDB date itself.
    tdb = in_scale(tdb, "TDB")
    return _shifted(tdb, "TT", -geocentric_tdb_minus_tt(tdb))


def geocentric_tdb_minus_tt(epochs: Epochs) -> Floats:
    """TDB - TT at the geocentre, s, shape (n,); the epochs may be TT or TDB.

    ERFA ``dtdb``: Fairhead and Bretagnon (1990), with 787 terms, good to some nanoseconds over decades; from 1972 to
    2049 by polynomials that follow it to 3e-16 s.

    Examples
    --------
    >>> from radioloc.time import epochs_from_strings, geocentric_tdb_minus_tt
    >>> geocentric_tdb_minus_tt(epochs_from_strings("2020-04-01", "TT")).round(6).tolist()
    [0.001677]
    """
    if not isinstance(epochs, Epochs):
        epochs = in_scale(epochs, "TDB")
    values_s, _ = tabulated(
        table_of("radioloc.time", "tdb_minus_tt.npy"),
        epochs,
        lambda at: erfa.dtdb(at.jd, at.fraction, 0.0, 0.0, 0.0, 0.0)[None],
    )
    return values_s[0]


def topocentric_tdb_minus_tt(earth_velocity_m_s: ArrayLike, station_gcrs_m: ArrayLike) -> Floats:
    """Part of TDB - TT that depends on the place, v_E . r / c^2, s, of BCRS velocity and GCRS position; shape (...,).

    Up to 2.1 microseconds, daily; it does not cancel in three-way range, where it reaches hundreds of metres.

    Examples
    --------
    >>> from radioloc.time import topocentric_tdb_minus_tt
    >>> float(topocentric_tdb_minus_tt([0.0, 3e4, 0.0], [0.0, 6.378e6, 0.0]).round(9))
    2.129e-06
    """
    velocity_m_s = as_float_array(earth_velocity_m_s, "m / s", "earth_velocity_m_s")
    station_m = as_float_array(station_gcrs_m, "m", "station_gcrs_m")
    return np.einsum("...i,...i->...", velocity_m_s, station_m) / C_M_S**2


def utc_strings(utc: Epochs, decimals: int = 9) -> NDArray[np.str_]:
    """Dates as ``yyyy-mm-ddThh:mm:ss.sssssssss``, leap seconds shown as second 60, shape (n,).

    Other scales are written without leap seconds. The last decimal is rounded, if needed into the next day.

    Examples
    --------
    >>> from radioloc.time import epochs_from_strings, utc_strings
    >>> utc_strings(epochs_from_strings("2016-366T23:59:60.5", "UTC"), 3).tolist()
    ['2016-12-31T23:59:60.500']
    """
    if not isinstance(utc, Epochs):
        utc = in_scale(utc, "UTC")
    if not 0 <= decimals <= 9:
        raise InputError(f"decimals = {decimals!r} is not a number of decimals from 0 to 9")
    with _any_year():
        year, month, day, hms = erfa.d2dtf(utc.scale, decimals, utc.jd, utc.fraction)
    texts = [
        f"{y:04d}-{mo:02d}-{d:02d}T{t['h']:02d}:{t['m']:02d}:{t['s']:02d}"
        + (f".{t['f']:0{decimals}d}" if decimals else "")
        for y, mo, d, t in zip(year, month, day, hms, strict=True)
    ]
    return np.array(texts, dtype=np.str_)


def to_scale(epochs: Epochs, scale: str) -> Epochs:
    """Epochs in another scale: UTC (from 1972 on), TAI, TT or TDB (at the geocentre); UT1 needs Earth orientation.

    Examples
    --------
    >>> from astropy.time import Time
    >>> from radioloc.time import to_scale, utc_strings
    >>> utc_strings(to_scale(Time("2020-12-01T15:11:00", scale="utc"), "TDB"), 6).tolist()
    ['2020-12-01T15:12:09.183070']
    """
    if not isinstance(epochs, Epochs):
        epochs = Epochs.from_time(epochs)
    if scale == epochs.scale:
        return epochs
    if not {scale, epochs.scale} <= set(_CHAIN):
        raise InputError(
            f"epochs in {epochs.scale} cannot be given in {scale} without Earth orientation; "
            f"{', '.join(_CHAIN)} convert into each other"
        )
    at, to = _CHAIN.index(epochs.scale), _CHAIN.index(scale)
    for step in _FORWARD[at:to] if at < to else _BACK[to:at][::-1]:
        epochs = step(epochs)
    return epochs


_CHAIN = ("UTC", "TAI", "TT", "TDB")
_FORWARD = (utc_to_tai, tai_to_tt, tt_to_tdb)
_BACK = (tai_to_utc, tt_to_tai, tdb_to_tt)
