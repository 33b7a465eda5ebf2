"""Positions beside a benchmark, as in Wang et al. (2021), table 1."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.report.text_table import TextTable

HEADING = ("", "L, deg E", "B, deg N", "dL, deg", "dB, deg", "dL, m", "dB, m")
"""Of :func:`position_cells` after a name."""

METHODS = ("tracking", "images", "image_point", "stereo")
"""How positions are found."""

Place = tuple[float, float, float]
"""East longitude and latitude, deg, and height, m."""


@dataclass(frozen=True, slots=True)
class PositionRow:
    """A position and how far it is from the benchmark.

    Longitudes are counted to the west, -180 to 180 deg, as maps of the near side's west and Wang et al. (2021) do.
    Differences in metres are arcs on the sphere of 1737.4 km: of longitude R cos(B) dL at the benchmark's latitude, of
    latitude R dB. What a reference does not have is None.
    """

    method: str  # one of METHODS, "joint" or "reference"
    name: str  # length of the arc, name of the solution or of the reference
    longitude_west_deg: float  # mean-Earth axes
    latitude_deg: float
    height_m: float
    west_deg: float | None  # this less the benchmark, as the next four; None for the benchmark itself
    north_deg: float | None
    west_m: float | None
    north_m: float | None
    up_m: float | None
    sigma_west_m: float | None = None  # total standard deviation, as the next two; None where not determined
    sigma_north_m: float | None = None
    sigma_up_m: float | None = None
    # Horizontal distance from the longest arc's position; None for that itself.
    from_longest_m: float | None = None
    # The same in the standard deviations that this difference should have.
    from_longest_sigmas: float | None = None
    used: int | None = None
    left_out: int | None = None
    wrms_m: float | None = None
    converged: bool | None = None


def difference(one: Place, benchmark: Place) -> tuple[float, float, float, float, float]:
    """How far west, north (deg), west, north, up (m) a position is of a benchmark."""
    west_deg = -math.remainder(one[0] - benchmark[0], 360.0)
    north_deg = one[1] - benchmark[1]
    metres_per_deg = math.radians(MEAN_LUNAR_RADIUS_M)
    west_m = west_deg * metres_per_deg * math.cos(math.radians(benchmark[1]))
    return west_deg, north_deg, west_m, north_deg * metres_per_deg, one[2] - benchmark[2]


def place_fields(place: Place, benchmark: Place | None) -> dict[str, Any]:
    """A position and its differences to the benchmark, as fields of a row."""
    names = ("west_deg", "north_deg", "west_m", "north_m", "up_m")
    differences = (None,) * 5 if benchmark is None else difference(place, benchmark)
    return {
        "longitude_west_deg": -math.remainder(place[0], 360.0),
        "latitude_deg": place[1],
        "height_m": place[2],
        **dict(zip(names, differences, strict=True)),
    }


def east_longitude_deg(row: PositionRow, to_360: bool = False) -> float:
    """East longitude, -180 to 180 or 0 to 360 deg."""
    return -row.longitude_west_deg % 360.0 if to_360 else -row.longitude_west_deg


def position_cells(row: PositionRow, *, east: bool = True, to_360: bool = False) -> tuple[str, ...]:
    """Longitude (to the east, or as the row has it) and latitude with their differences in deg and m, as text."""
    sign = -1.0 if east else 1.0
    longitude_deg = east_longitude_deg(row, to_360) if east else row.longitude_west_deg
    cells = (f"{longitude_deg:z.5f}", f"{row.latitude_deg:.5f}")
    if row.west_deg is None or row.west_m is None:
        return (*cells, "benchmark", "-", "-", "-")
    differences = f"{sign * row.west_deg:z.5f}", f"{row.north_deg:z.5f}"
    return (*cells, *differences, f"{sign * row.west_m:z.1f}", f"{row.north_m:z.1f}")


def position_table(rows: Iterable[PositionRow], names: Mapping[str, str] | None = None) -> TextTable:
    """The table to print; ``names`` of rows that are called otherwise there."""
    heading = ("Method", "", "L (°W)", "B (°N)", "δL (°W)", "δB (°N)", "δL (m)", "δB (m)")
    cells = [
        (row.method, (names or {}).get(row.name, row.name), *position_cells(row, east=False)) for row in rows
    ]
    return TextTable(heading, cells, words=2)


def csv_table(rows: Sequence[PositionRow], more: Sequence[Mapping[str, Any]] = ()) -> str:
    """The table as comma-separated text, with further columns of some rows."""
    records = [asdict(row) for row in rows]
    for record, added in zip(records, more, strict=False):
        record |= added
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(dict.fromkeys(k for r in records for k in r)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return stream.getvalue()
