"""Common parts of readers: dates of lines, interpolation of weather, and normal points of laser ranging."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.constants import C_M_S, UTC_JD
from radioloc.errors import FileFormatError
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations, without_duplicates
from radioloc.measurements.table_columns import require_lunar_flight_times
from radioloc.time import Epochs
from radioloc.time.dates import DateError, read_dates, utc_from_seconds_of_day
from radioloc.vectors import Floats

_YEARS_JD = (UTC_JD, 2488434.5)
"""From 1972, the first year of UTC with leap seconds, to 2100, beyond any data."""

_MAX_WEATHER_AGE_S = 7200.0


def read_utc(path: str | Path, dates: Sequence[str], lines: Sequence[int]) -> Epochs:
    """Return the UTC dates of lines of a file; a FileFormatError for a date that is not from 1972 to 2100."""
    try:
        utc = read_dates(dates, "UTC")
    except DateError as error:
        raise FileFormatError(path, str(error), lines[error.row]) from None
    wrong = (utc.jd < _YEARS_JD[0]) | (utc.jd >= _YEARS_JD[1])
    if wrong.any():
        row = int(np.argmax(wrong))
        raise FileFormatError(
            path, f"expected a year from 1972 to 2100, got the date {dates[row]}", lines[row]
        )
    return utc


def weather_at(time_s: Floats, recorded: Floats, target_s: Floats) -> Floats:
    """Interpolate weather linearly, constant beyond the records, NaN more than two hours from them."""
    order = np.argsort(time_s, kind="stable")
    order = order[~np.isnan(recorded[order])]
    if not len(order):
        return np.full(len(target_s), np.nan)
    time_s, recorded = time_s[order], recorded[order]
    next_row = np.minimum(np.searchsorted(time_s, target_s), len(time_s) - 1)
    previous_row = np.maximum(next_row - 1, 0)
    age_s = np.minimum(abs(time_s[next_row] - target_s), abs(time_s[previous_row] - target_s))
    return np.where(age_s <= _MAX_WEATHER_AGE_S, np.interp(target_s, time_s, recorded), np.nan)


def normal_points(path: str | Path, links: Iterable[Link], columns: dict[str, Any]) -> Observations:
    """Return laser ranges of one file from columns of observations and jd, second_of_day, flight_s, sigma_s."""
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
