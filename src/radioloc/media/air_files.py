"""Air above stations from files of TU Wien: VMF3, every six hours from weather models, and GPT3, a climatology.

Two kinds of file of VMF3, with coefficients and zenith delays, are read, plain or gzip:

- site files of a day or year, such as ``2024001.vmf3_r`` or ``y2024.vmf3_r``: one line per station and epoch with
  name, MJD, a hydrostatic, a wet, zenith delays hydrostatic and wet (m), pressure (hPa), temperature (degrees Celsius)
  and vapour pressure (hPa), all at the station. Weather, and the horizontal gradients of ``.v3gr_r``, are ignored;
- maps of the Earth, such as ``VMF3_20240101.H00``, on a grid of 1 or 5 degrees: latitude, longitude, the two a on
  the ellipsoid, and the two zenith delays at the height of the file ``orography_ell_1x1`` or ``_5x5``, which are
  reduced to the station's height. The gradients of the maps ``V3GR_20240101.H00`` are ignored.

Neither has an end mark. A truncated site file lacks epochs or stations, which is an error if they are needed. A
truncated map does not fill its grid, or its last line has no end.

Epochs are UTC. The hydrostatic zenith delay of these files is some 2.5 mm above that of Saastamoinen's formula for
their pressure, due to other constants of refractivity. The wet delay is good to 1 to 2 cm.

The grid of GPT3 (Landskron and Boehm 2018) has the climate of any place, for stations without weather. The file
``gpt3_5.grd`` or ``gpt3_1.grd``, which the user provides, has at each point of a grid of 5 or 1 degrees the mean,
annual and semiannual variation of pressure, temperature, humidity, lapse rate, the coefficients a of VMF3, mean
temperature and decrease factor of water vapour, and horizontal gradients. Day-to-day weather is not contained: pressure
differs by 7 hPa (16 mm of zenith delay) and the wet delay by 3 to 4 cm as a rule.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError, in_file
from radioloc.media.grids import LatLonGrid, enclosing_epochs, sort_into_grid
from radioloc.media.mapping_functions import day_of_year, seasons
from radioloc.media.neutral_atmosphere import (
    DRY_AIR_KG_MOL,
    GAS_CONSTANT_J_K_MOL,
    STANDARD_GRAVITY_M_S2,
    column_gravity,
)
from radioloc.text_files import ANY_BYTE, parse_numbers, read_lines, table_of
from radioloc.time import Epochs, epochs_from_strings
from radioloc.time.scales import to_scale
from radioloc.vectors import Floats

_MAX_GAP_D = 0.2501  # epochs are six hours apart
_SITE_COLUMNS = (8, 12)
_GRID_COLUMNS = {"VMF3": 6, "V3GR": 10}
_VALUE_LIMITS = np.array(
    [(1e-5, 2e-3), (1e-5, 2e-3), (0.5, 2.7), (-0.01, 1.0), (300.0, 1100.0), (-100.0, 70.0), (0.0, 100.0)]
)
"""Limits of both a, zenith delays (m), pressure (hPa), temperature (degrees Celsius), vapour pressure (hPa)."""
_HEIGHT_LIMITS_M = -1000.0, 10_000.0  # of the ground above the ellipsoid
_WET_SCALE_HEIGHT_M = 2000.0


@dataclass(frozen=True, slots=True, eq=False)
class Vmf3Values:
    """Coefficients a and zenith delays at a station from VMF3, shape (n,)."""

    hydrostatic_a: Floats
    wet_a: Floats
    mapping_height_m: float  # of the station above the height at which the coefficients hold
    zenith_hydrostatic_m: Floats
    zenith_wet_m: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Vmf3Site:
    """VMF3 of a station at rising epochs; values (k, 4): a hydrostatic, a wet, zenith delays hydrostatic, wet (m)."""

    station: str
    mjd_utc: Floats
    values: Floats

    def values_at(self, epochs: Epochs, *_place: float) -> Vmf3Values:
        """Return values at epochs of any scale but UT1, linear between those of the file; a gap is an error."""
        earlier, later, share = enclosing_epochs(
            self.mjd_utc, to_scale(epochs, "UTC").mjd, _MAX_GAP_D, f"VMF3 of {self.station}"
        )
        values = self.values[earlier] + share[:, None] * (self.values[later] - self.values[earlier])
        return Vmf3Values(values[:, 0], values[:, 1], 0.0, values[:, 2], values[:, 3])


@dataclass(frozen=True, slots=True, eq=False)
class Vmf3Grids:
    """Maps of VMF3 at rising epochs; values (k, rows, columns, 4): a on the ellipsoid, zenith delays at `height_m`."""

    grid: LatLonGrid
    mjd_utc: Floats
    values: Floats
    height_m: Floats

    def values_at(
        self, epochs: Epochs, latitude_rad: float, longitude_rad: float, height_m: float
    ) -> Vmf3Values:
        """Return values at a place: linear in time, bilinear in space, delays reduced to the ellipsoidal height."""
        # Kouba (2008): pressure falls as in the standard atmosphere, the wet delay with a scale height of 2 km. A
        # difference of 1 km between station and grid causes an error of some 5 mm in the hydrostatic delay.
        first, second, share = enclosing_epochs(
            self.mjd_utc, to_scale(epochs, "UTC").mjd, _MAX_GAP_D, "the maps of VMF3"
        )
        row, column, weight = self.grid.corners(latitude_rad, longitude_rad)
        earlier, later = (self.values[k[:, None], row, column] for k in (first, second))
        corners = earlier + share[:, None, None] * (later - earlier)
        ground_m = self.height_m[row, column]
        above_m = height_m - ground_m
        pressure_ratio = (1.0 - 2.26e-5 * above_m) ** 5.225
        corners[..., 2] *= pressure_ratio * (
            column_gravity(latitude_rad, ground_m) / column_gravity(latitude_rad, height_m)
        )
        corners[..., 3] *= np.exp(-above_m / _WET_SCALE_HEIGHT_M)
        a_h, a_w, hydrostatic, wet = np.einsum("c,ncv->vn", weight, corners)
        return Vmf3Values(a_h, a_w, height_m, hydrostatic, wet)


def read_vmf3_sites(paths: Sequence[Path]) -> dict[str, Vmf3Site]:
    """Read site files in any order; return series by the station's name in the files."""
    rows: dict[str, dict[float, list[float]]] = {}
    for path in paths:
        for number, line in enumerate(read_lines(path, encoding=ANY_BYTE), start=1):
            station, *words = line.split() or ["#"]
            if station[0] in "#!%":
                if re.search(r"VMF1(?![\d])", line, re.IGNORECASE):
                    raise FileFormatError(
                        path, "expected VMF3, got VMF1, whose coefficients go with other b and c", number
                    )
                continue
            if len(words) not in _SITE_COLUMNS:
                problem = (
                    f"expected 9 columns (name, MJD, ah, aw, zhd, zwd, p, T, e) or 13, got {len(words) + 1}"
                )
                raise FileFormatError(path, problem, number)
            mjd, *values = parse_numbers(path, number, words, "a value of VMF3")
            _require_plausible(path, [number], np.array([values[:7]]))
            series = rows.setdefault(station, {})
            if mjd in series:
                raise FileFormatError(path, f"duplicate epoch of {station}: MJD {mjd:.2f}", number)
            series[mjd] = values[:4]
        if not rows:
            raise FileFormatError(path, "expected lines of stations, got none")
    return {
        station: Vmf3Site(
            station, np.array(sorted(series)), np.array([series[mjd] for mjd in sorted(series)])
        )
        for station, series in rows.items()
    }


def read_vmf3_grids(paths: Sequence[Path], orography: str | Path) -> Vmf3Grids:
    """Read maps of VMF3 on a common grid, each of an epoch, and their heights (``orography_ell_1x1`` or ``_5x5``)."""
    maps: dict[float, tuple[Path, Floats]] = {}
    for path in paths:
        mjd, table = _read_map(path)
        if mjd in maps:
            raise FileFormatError(
                path, f"duplicate epoch MJD {mjd:.2f}, as in {maps[mjd][0]}; remove one of the files"
            )
        first = next(iter(maps.values()), (path, table))
        if table.shape != first[1].shape or (table[:, :2] != first[1][:, :2]).any():
            raise FileFormatError(path, f"expected the grid of {first[0]}, got other points")
        maps[mjd] = path, table
    with in_file(path):
        grid, order = sort_into_grid(table[:, 0], table[:, 1], "the map of VMF3")
    mjds = np.array(sorted(maps))
    values = np.stack([maps[mjd][1][order, 2:] for mjd in mjds])
    return Vmf3Grids(grid, mjds, values, _read_orography(orography, order))


def _read_map(path: Path) -> tuple[float, Floats]:
    """Return the epoch, MJD UTC, and rows of latitude, longitude, both a and zenith delays of a map."""
    header: dict[str, tuple[int, str]] = {"Data_types": (1, ""), "Scale_factor": (1, "1")}
    rows = []
    for number, line in enumerate(read_lines(path, encoding=ANY_BYTE, ended=True), start=1):
        if line.lstrip().startswith("!"):
            key, _, text = line.lstrip(" !").partition(":")
            header[key.strip()] = number, text.strip()
        elif line.strip():
            rows.append((number, line))
    number, content = header["Data_types"]
    kind = content[:4]
    if kind not in _GRID_COLUMNS:
        problem = f"Data_types: expected VMF3 or V3GR (lat lon ah aw zhd zwd ...), got {content!r}"
        raise FileFormatError(path, problem, number)
    number, content = header["Scale_factor"]
    if parse_numbers(path, number, [content], "a scale factor") != [1.0]:
        raise FileFormatError(path, f"Scale_factor: expected 1, got {content}", number)
    if "Epoch" not in header:
        raise FileFormatError(path, "the header lacks the line '! Epoch:'")
    number, content = header["Epoch"]
    parts = parse_numbers(path, number, content.split(), "an epoch")
    if len(parts) != 6:
        raise FileFormatError(path, "Epoch: expected year month day hour minute second", number)
    date = "{:04.0f}-{:02.0f}-{:02.0f}T{:02.0f}:{:02.0f}:{:02.0f}".format(*parts)
    with in_file(path, number):
        mjd = float(epochs_from_strings(date, "UTC").mjd[0])
    table = table_of(path, rows, _GRID_COLUMNS[kind], f"a map {content}")[:, :6]
    if not len(table):
        raise FileFormatError(path, "expected points of a map, got none")
    _require_plausible(path, [number for number, _ in rows], table[:, 2:])
    return mjd, table


def _read_orography(path: str | Path, order: NDArray[np.int64]) -> Floats:
    heights: list[float] = []
    for number, line in enumerate(read_lines(path, encoding=ANY_BYTE), start=1):
        if not line.lstrip().startswith(("!", "%", "#")):
            heights.extend(parse_numbers(path, number, line.split(), "a height"))
    low_m, high_m = _HEIGHT_LIMITS_M
    for height_m in heights:
        if not low_m <= height_m <= high_m:
            problem = f"expected heights of the ground from {low_m:g} to {high_m:g} m, got {height_m:g}"
            raise FileFormatError(path, problem)
    if len(heights) != order.size:
        problem = f"expected {order.size} heights, one per point of the map, got {len(heights)}"
        raise FileFormatError(path, problem)
    return np.array(heights)[order]


def _require_plausible(path: Path, lines: Sequence[int], table: Floats) -> None:
    """Raise an error for impossible coefficients, delays or weather, which reveals files of another kind."""
    low, high = _VALUE_LIMITS[: table.shape[1]].T
    wrong = ~((table >= low) & (table <= high))
    if not wrong.any():
        return
    row = int(np.argmax(wrong.any(axis=1)))
    shown = [f"{value:g}" for value in table[row]]
    if wrong[row, :4].any():
        problem = f"ah, aw, zhd, zwd: expected about 0.0012, 0.0005, 2.3 m, 0.1 m, got {', '.join(shown[:4])}"
    else:
        problem = f"p, T, e: expected about 1000 hPa, 15 degrees Celsius, 10 hPa, got {', '.join(shown[4:])}"
    raise FileFormatError(path, problem, lines[row])


_GPT3_COLUMN_COUNT = 64
_LEADING_SEASONAL_COUNT = 4  # quantities with seasons that precede the columns of undulation and height
_SCALES = np.array([1.0, 1.0, 1e-3, 1e-3, 1e-3, 1e-3, 1.0, 1.0, 1e-5, 1e-5, 1e-5, 1e-5])
"""Factors to Pa, K, kg/kg, K/m, then a hydrostatic, a wet, decrease factor, K, and gradients in m."""


@dataclass(frozen=True, slots=True, eq=False)
class Gpt3Values:
    """Climate of a place at n epochs, shape (n,); mean temperature and decrease factor are of water vapour."""

    pressure_hpa: Floats
    vapour_pressure_hpa: Floats
    mean_temperature_k: Floats
    vapour_decrease_factor: Floats
    hydrostatic_a: Floats
    wet_a: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Gpt3Grid:
    """Grid of GPT3: seasonal variations, and heights of the geoid and, above it, of the points."""

    grid: LatLonGrid
    # Shape (rows, columns, 12, 5): mean, annual cosine and sine, semiannual cosine and sine of pressure (Pa),
    # temperature (K), specific humidity, lapse rate (K/m), a hydrostatic, a wet, decrease factor, mean temperature (K)
    # and four gradients (m); lapse rate and gradients are not used.
    seasonal: Floats
    undulation_m: Floats
    height_m: Floats

    def values_at(
        self, epochs: Epochs, latitude_rad: float, longitude_rad: float, height_m: float
    ) -> Gpt3Values:
        """Return the bilinear mean of four points, each reduced to the ellipsoidal height; epochs of any scale."""
        # Landskron and Boehm (2018), section 4, as GPT2w (Boehm et al. 2015): pressure falls exponentially with the
        # virtual temperature of the grid point, vapour pressure with the power lambda + 1 of pressure.
        row, column, weight = self.grid.corners(latitude_rad, longitude_rad)
        corners = np.einsum("cqs,ns->qnc", self.seasonal[row, column, :8], seasons(day_of_year(epochs)))
        pressure, temperature, humidity, _, hydrostatic_a, wet_a, decrease, mean_temperature = corners
        above_m = height_m - self.undulation_m[row, column] - self.height_m[row, column]
        virtual = temperature * (1.0 + 0.6077 * humidity)
        per_metre = STANDARD_GRAVITY_M_S2 * DRY_AIR_KG_MOL / (GAS_CONSTANT_J_K_MOL * virtual)
        ratio = np.exp(-per_metre * above_m)
        vapour = humidity * pressure / (0.622 + 0.378 * humidity) * ratio ** (decrease + 1.0)
        hectopascal = 0.01 * pressure * ratio, 0.01 * vapour
        return Gpt3Values(
            *(v @ weight for v in (*hectopascal, mean_temperature, decrease, hydrostatic_a, wet_a))
        )


def read_gpt3(path: str | Path) -> Gpt3Grid:
    """Read ``gpt3_5.grd`` or ``gpt3_1.grd``, plain or gzip."""
    path = Path(path)
    lines = [
        (number, line)
        for number, line in enumerate(read_lines(path, encoding=ANY_BYTE), start=1)
        if line.strip() and not line.lstrip().startswith("%")
    ]
    table = table_of(path, lines, _GPT3_COLUMN_COUNT, "a grid of GPT3")
    with in_file(path):
        grid, order = sort_into_grid(table[:, 0], table[:, 1], "the grid of GPT3")
    split = 2 + 5 * _LEADING_SEASONAL_COUNT
    seasonal = np.concatenate([table[:, 2:split], table[:, split + 2 :]], axis=1)
    seasonal = _SCALES[:, None] * seasonal.reshape(len(table), -1, 5)
    mean = seasonal[..., 0]
    ground_m = table[:, split] + table[:, split + 1]
    plausible = (
        (np.abs(mean[:, 0] - 7.5e4) < 3.5e4)
        & (np.abs(mean[:, 1] - 260.0) < 60.0)
        & (np.abs(mean[:, 4] - 1.2e-3) < 1e-4)
        & (ground_m >= _HEIGHT_LIMITS_M[0])
        & (ground_m <= _HEIGHT_LIMITS_M[1])
    )
    if not plausible.all():
        problem = (
            "expected pressure in Pa, temperature in K, ah in thousandths and height in m, as in gpt3_5.grd"
        )
        raise FileFormatError(path, problem, lines[int(np.argmin(plausible))][0])
    return Gpt3Grid(grid, seasonal[order], table[order, split], table[order, split + 1])
