"""Weather of a Tracking Data Message at the epochs of its observations.

TEMPERATURE (K), PRESSURE (hPa) and RHUMIDITY are interpolated linearly between the records, and held before the
first and after the last; where the nearest record is more than two hours away the weather counts as not
recorded, as in laser ranging files. Weather in a segment that holds the measurements too belongs to these.
Weather in a segment of one participant and without a path (3.3.2.7) belongs to that station's two-way
observations: other observations have two stations, but only one weather.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from radioloc.io.tdm_file import TdmSegment
from radioloc.io.tdm_times import seconds_from
from radioloc.time import Epochs

WEATHER_REACH_S = 7200.0
COLUMNS = {"PRESSURE": "pressure_hpa", "TEMPERATURE": "temperature_k", "RHUMIDITY": "relative_humidity"}
"""Columns of observations by the keyword that fills them."""


def weather_at(segments: Iterable[TdmSegment], utc: Epochs) -> dict[str, NDArray[np.float64]]:
    """Weather columns at epochs (UTC), from segments that belong to them; NaN where none was recorded nearby."""
    out = {}
    for keyword, column in COLUMNS.items():
        parts = [(segment, rows) for segment in segments if len(rows := segment.rows(keyword))]
        if not parts:
            continue
        start = parts[0][0].epoch[[0]]
        times = np.concatenate([seconds_from(start, segment.epoch[rows]) for segment, rows in parts])
        values = np.concatenate([segment.value[rows] for segment, rows in parts])
        order = np.argsort(times, kind="stable")
        times, values = times[order], values[order]
        wanted = seconds_from(start, utc)
        after = np.minimum(np.searchsorted(times, wanted), len(times) - 1)
        before = np.maximum(after - 1, 0)
        away_s = np.minimum(abs(times[after] - wanted), abs(times[before] - wanted))
        out[column] = np.where(away_s <= WEATHER_REACH_S, np.interp(wanted, times, values), np.nan)
    return out
