"""What all readers of observations share: canonical names, limits of lunar ranging, no measurement counted twice."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.errors import DataQualityWarning, FileFormatError, InputError, StationError
from radioloc.io.dates import utc_from_seconds_of_day
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations
from radioloc.measurements.registry import is_integrated
from radioloc.measurements.targets import canonical_target
from radioloc.time import utc_to_tai
from radioloc.time.scales import calendar_to_jd

FLIGHT_TIME_LIMITS_S = (2.2, 2.8)
"""Round-trip light times between the Earth's and the Moon's surface lie well inside (2.31 to 2.74 s)."""

YEARS = (1972, 2100)
"""First year of UTC with leap seconds, and one beyond any data."""

_WEATHER_REACH_S = 7200.0
_Rows = NDArray[np.intp]
# Modified Julian dates of six decimals are rounded to half of this.
_REREAD_S = 0.1


class Catalogue(Protocol):
    """What reading needs of a station catalogue."""

    def get(self, name: str) -> Any:
        """Station of a name or alias, with an attribute ``name``; :class:`StationError` if unknown."""


def station_name(names: tuple[str, ...], catalogue: Catalogue | None) -> str:
    """Catalogue's name of a station of one or more names, the most reliable first, which is kept if it knows none."""
    if catalogue is not None:
        for name in names:
            try:
                return str(catalogue.get(name).name)
            except StationError:
                continue
    return names[0]


def named_link(link: Link, catalogue: Catalogue | None) -> Link:
    """Make the same link under canonical names."""
    if link.on_map:
        return replace(link, target=canonical_target(link.target))
    return Link(
        station_name((link.transmitter,), catalogue) if link.transmitter else "",
        canonical_target(link.target),
        station_name((link.receiver,), catalogue),
        link.differenced,
        canonical_target(link.second_target) if link.second_target else "",
    )


def require_lunar_flight_time(path: str | Path, line: int, flight_time_s: float) -> None:
    """Raise :class:`FileFormatError` for a round-trip time of flight that no lunar target has."""
    low, high = FLIGHT_TIME_LIMITS_S
    if low < flight_time_s < high:
        return
    problem = f"the time of flight is {flight_time_s!r} s, but between Earth and Moon it is {low} to {high} s"
    advice = "leave the point out or correct it"
    for factor, said in (
        (2.0, "half of such a one: give the round trip"),
        (0.5, "twice such a one: halve it"),
    ):
        if low < factor * flight_time_s < high:
            advice = f"it is {said}, if that is what it holds"
    raise FileFormatError(path, f"{problem}; {advice}", line)


def midnight_and_second(
    path: str | Path, line: int, year: int, month: int, day: int, hour: int, minute: int, second: float
) -> tuple[float, float]:
    """Julian date of midnight and second of day of a UTC date that must exist, from 1972 on."""
    if not YEARS[0] <= year <= YEARS[1]:
        problem = f"the year is {year}; years from {YEARS[0]} to {YEARS[1]} can be read"
        raise FileFormatError(path, problem, line)
    try:
        jd, _ = calendar_to_jd(year, month, day, hour, minute, second)
    except InputError as error:
        raise FileFormatError(path, str(error), line) from None
    return jd, 3600.0 * hour + 60.0 * minute + second


def weather_near(
    time_s: NDArray[np.float64], recorded: NDArray[np.float64], wanted_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Recorded weather at other times, linear between records and held before and after them.

    NaN where the nearest record that is not NaN is more than two hours away, or there is none.
    """
    order = np.argsort(time_s, kind="stable")
    order = order[~np.isnan(recorded[order])]
    if not len(order):
        return np.full(len(wanted_s), np.nan)
    time_s, recorded = time_s[order], recorded[order]
    after = np.minimum(np.searchsorted(time_s, wanted_s), len(time_s) - 1)
    before = np.maximum(after - 1, 0)
    away_s = np.minimum(abs(time_s[after] - wanted_s), abs(time_s[before] - wanted_s))
    return np.where(away_s <= _WEATHER_REACH_S, np.interp(wanted_s, time_s, recorded), np.nan)


def without_duplicates(observations: Observations, *, first_counts: bool = False) -> Observations:
    """Observations each once: exact copies are left out with a warning; two values of one observation are an error.

    Rows are of one observation if epoch, time tag, kind, path, wavelength and count interval are the same. Where the
    `first_counts`, as of frequencies read off twice, another value is left out with a warning, too.
    """
    columns = (
        observations.epoch.fraction,
        observations.epoch.jd - observations.epoch.jd.min(initial=np.inf),
        observations.link,
        observations.kind,
        observations.tag,
        np.nan_to_num(observations.wavelength_um),
        np.nan_to_num(observations.count_s),
    )
    # One number for each row, equal for equal rows and hardly ever for others; these are then compared in full.
    mixed = np.zeros(len(observations))
    for column, weight in zip(columns, (1.7e8, 2.3e5, 19.3, 7.7, 3.1, 0.17, 0.013), strict=True):
        mixed += weight * column
    in_order = np.sort(mixed)
    suspects = np.flatnonzero(np.isin(mixed, in_order[1:][in_order[1:] == in_order[:-1]]))
    order = suspects[np.lexsort([column[suspects] for column in columns])]
    same = np.all([column[order[1:]] == column[order[:-1]] for column in columns], axis=0)
    first, second = order[:-1][same], order[1:][same]
    if not len(first):
        return observations
    other = np.flatnonzero(
        (observations.value_m[first] != observations.value_m[second])
        | (observations.sigma_m[first] != observations.sigma_m[second])
    )
    if len(other) and not first_counts:
        pair = other[np.argmin(second[other])]
        raise InputError(
            f"{observations.origin(int(second[pair]))}: this observation has another value or sigma in "
            f"{observations.origin(int(first[pair]))} ({len(other)} such pair(s) in all); leave one of them out"
        )
    with_other = f", {len(other)} with another value or sigma" if len(other) else ""
    return _counted_once(
        observations, first, second, "this observation is already there, in {}", stacklevel=5, more=with_other
    )


def without_rereadings(observations: Observations) -> Observations:
    """Counts of Doppler each once, where two files have them with time tags that are rounded in different ways.

    Counts are the same if path, type, band and interval are, and the tags nearer than a quarter of it and a tenth of a
    second. That of the file that was read first is kept; the others are left out with a warning.
    """
    rows = np.flatnonzero(is_integrated(observations.kind))
    if len(observations.files) == 1 or len(rows) < 2:
        return observations
    tai, count_s = utc_to_tai(observations.epoch[rows]), observations.count_s[rows]
    time_s = tai.seconds_since(tai[np.zeros(len(rows), dtype=np.intp)])
    band = np.nan_to_num(np.rint(10.0 * np.log(observations.wavelength_um[rows])))
    series = [band, count_s, *(getattr(observations, name)[rows] for name in ("tag", "kind", "link"))]
    order = np.lexsort([time_s, *series])
    near = np.diff(time_s[order]) < np.minimum(_REREAD_S, 0.25 * count_s[order[1:]])
    near &= np.all([column[order[1:]] == column[order[:-1]] for column in series], axis=0)
    file = observations.file[rows]
    pairs = np.column_stack([order[:-1], order[1:]])[near & (np.diff(file[order]) != 0)]
    if not len(pairs):
        return observations
    later = np.argsort(file[pairs], axis=1)
    first, second = rows[np.take_along_axis(pairs, later, axis=1).T]
    problem = "this count of Doppler is already there, but for the rounding of its time, in {}"
    return _counted_once(observations, first, second, problem, stacklevel=4)


def _counted_once(
    observations: Observations, first: _Rows, second: _Rows, problem: str, *, stacklevel: int, more: str = ""
) -> Observations:
    """Observations without the second of each pair, with a warning that says the problem and the first row."""
    pair = int(np.argmin(second))
    where = problem.format(observations.origin(int(first[pair])))
    warnings.warn(
        f"{observations.origin(int(second[pair]))}: {where} ({len(first)} such pair(s) in all{more}); "
        "it is counted once",
        DataQualityWarning,
        stacklevel=stacklevel,
    )
    kept = np.ones(len(observations), dtype=bool)
    kept[second] = False
    return observations.select(kept)


def normal_points(path: str | Path, links: Iterable[Link], columns: dict[str, Any]) -> Observations:
    """Laser ranges of one file: columns of observations, and ``jd``, ``second_of_day``, ``flight_s``, ``sigma_s``."""
    observations = Observations.from_columns(
        epoch=utc_from_seconds_of_day(columns.pop("jd"), columns.pop("second_of_day")),
        links=tuple(links),
        value_m=C_M_S * columns.pop("flight_s"),
        sigma_m=C_M_S * columns.pop("sigma_s"),
        files=(str(path),),
        **columns,
    )
    return without_duplicates(observations)
