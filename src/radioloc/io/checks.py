"""What readers of observations share: dates that must exist, weather at other times, normal points of laser ranging."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.errors import FileFormatError, InputError
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations, without_duplicates
from radioloc.measurements.table_columns import require_lunar_flight_times
from radioloc.time.dates import utc_from_seconds_of_day
from radioloc.time.scales import calendar_to_jd

YEARS = (1972, 2100)
"""First year of UTC with leap seconds, and one beyond any data."""

_WEATHER_REACH_S = 7200.0


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


def normal_points(path: str | Path, links: Iterable[Link], columns: dict[str, Any]) -> Observations:
    """Laser ranges of one file: columns of observations, and ``jd``, ``second_of_day``, ``flight_s``, ``sigma_s``."""
    require_lunar_flight_times(path, columns["flight_s"], columns["line"])
    observations = Observations.from_columns(
        epoch=utc_from_seconds_of_day(columns.pop("jd"), columns.pop("second_of_day")),
        links=tuple(links),
        value_m=C_M_S * columns.pop("flight_s"),
        sigma_m=C_M_S * columns.pop("sigma_s"),
        files=(str(path),),
        **columns,
    )
    return without_duplicates(observations)
