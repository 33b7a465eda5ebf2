"""Global maps of the ionosphere's vertical electron content, from IONEX files.

IONEX 1.0 and 1.1 in fixed columns (Schaer, Gurtner and Feltens 1998, IONEX: The IONosphere Map EXchange Format), plain
or gzip. Maps come every one or two hours on a grid of 2.5 degrees of latitude and 5 of longitude, good to 2 to 8 TECU.
Maps of rms and of heights are ignored. Epochs are UTC.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.errors import FileFormatError, InputError, in_file
from radioloc.media.grids import LatLonGrid, enclosing_epochs
from radioloc.media.ionosphere import modified_shell_mapping, pierce_point, require_shell
from radioloc.text_files import ANY_BYTE, read_lines
from radioloc.time import Epochs, epochs_from_strings
from radioloc.time.scales import to_scale
from radioloc.vectors import Floats, Mask

_MIN_WEIGHT = 1e-9  # smaller weights of the points of a grid are rounding
_MISSING_VALUE = 9999
_DEFAULT_INTERVAL_S = 7200.0  # assumed if the header says 0 (varying interval)
_EPOCH_TOLERANCE_D = 1.0 / SECONDS_PER_DAY
_TECU_LIMITS = (-10.0, 1000.0)
"""Maps may be slightly negative at night; the largest contents observed are 250 TECU."""


@dataclass(frozen=True, slots=True, eq=False)
class IonexMaps:
    """Maps of vertical electron content on a shell, at rising epochs; a gap between maps is an error."""

    grid: LatLonGrid
    mjd_utc: Floats
    tec_tecu: Floats  # shape (epochs, rows, columns), NaN for missing values
    shell_height_m: float  # above a sphere of the base radius
    base_radius_m: float
    max_gap_s: float
    source: str

    @property
    def geometry(self) -> tuple[object, ...]:
        """Grid and shell, for comparison."""
        axes = self.grid.latitudes_deg.tolist(), self.grid.longitudes_deg.tolist()
        return (*axes, self.shell_height_m, self.base_radius_m)

    def vertical_tec(self, latitude_rad: ArrayLike, longitude_rad: ArrayLike, epochs: Epochs) -> Floats:
        """Return the vertical electron content at geocentric places of the shell, TECU, shape (n,)."""
        # Bilinear on each of the two maps around an epoch, rotated with the Sun (360 degrees a day) to that epoch, and
        # linear between them (Schaer et al. 1998).
        latitude, longitude, mjd = np.broadcast_arrays(
            latitude_rad, longitude_rad, to_scale(epochs, "UTC").mjd
        )
        # 1 % over the step between maps is rounding of their epochs.
        earlier, later, share = enclosing_epochs(
            self.mjd_utc, mjd, 1.01 * self.max_gap_s / SECONDS_PER_DAY, self.source
        )
        return (1.0 - share) * self._on_map(earlier, latitude, longitude, mjd, share < 1.0) + (
            share * self._on_map(later, latitude, longitude, mjd, share > 0.0)
        )

    def slant_tec(
        self, station_itrf_m: ArrayLike, azimuth_rad: ArrayLike, elevation_rad: ArrayLike, epochs: Epochs
    ) -> Floats:
        """Return the electron content along rays from stations, TECU, (n,), by the modified single layer mapping."""
        place = pierce_point(
            station_itrf_m, azimuth_rad, elevation_rad, self.shell_height_m, self.base_radius_m
        )
        # Negative values of maps at night are errors of the maps.
        return modified_shell_mapping(elevation_rad)[0] * np.maximum(self.vertical_tec(*place, epochs), 0.0)

    def _on_map(
        self,
        index: NDArray[np.int64],
        latitude_rad: Floats,
        longitude_rad: Floats,
        mjd_utc: Floats,
        used: Mask,
    ) -> Floats:
        turned = longitude_rad + 2.0 * np.pi * (mjd_utc - self.mjd_utc[index])
        row, column, weight = self.grid.corners(latitude_rad, turned)
        values = self.tec_tecu[index[:, None], row, column]
        needed = (weight > _MIN_WEIGHT) & used[:, None]
        missing = np.isnan(values) & needed
        if missing.any():
            k = np.flatnonzero(missing.any(axis=1))[0]
            raise InputError(
                f"{self.source}: missing value at latitude {np.rad2deg(latitude_rad[k]):.1f}, longitude "
                f"{np.rad2deg(longitude_rad[k]):.1f} degrees, MJD {mjd_utc[k]:.3f}; use the maps of another centre"
            )
        return np.sum(np.where(needed, weight * values, 0.0), axis=-1)


def read_ionex(paths: str | Path | Sequence[str | Path]) -> IonexMaps:
    """Read the maps of one or more IONEX files.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        Files with a common grid; if two have a map of the same epoch, as at midnight, the later file is used.

    Raises
    ------
    FileFormatError
        A file cannot be read or is not IONEX of two dimensions, maps are incomplete or missing, a content or the shell
        is impossible, or the grids or shells of the files differ.

    Examples
    --------
    >>> from radioloc.media import read_ionex
    >>> maps = read_ionex(["igsg3360.20i", "igsg3370.20i"])  # doctest: +SKIP
    """
    files = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
    if not files:
        raise InputError("expected one or more IONEX files, got none")
    parts = [_Reader(path).read() for path in files]
    first = parts[0]
    for path, part in zip(files, parts, strict=True):
        if part.geometry != first.geometry:
            raise FileFormatError(path, f"expected the grid and shell of {files[0]}; use files of one centre")
    maps = {mjd: tec for part in parts for mjd, tec in zip(part.mjd_utc.tolist(), part.tec_tecu, strict=True)}
    mjds = sorted(maps)
    return replace(
        first,
        mjd_utc=np.array(mjds),
        tec_tecu=np.stack([maps[mjd] for mjd in mjds]),
        max_gap_s=max(part.max_gap_s for part in parts),
        source=", ".join(path.name for path in files),
    )


class _Reader:
    """Reader of a file, whose lines have the content in 60 columns and its label in the last 20."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lines = list(read_lines(path, encoding=ANY_BYTE))
        self.line = 0  # number of the last line read
        self.header: dict[str, tuple[int, str]] = {}
        self.exponent = -1

    def error(self, problem: str, line: int | None = None) -> FileFormatError:
        """Return an error about a line, by default the last line read."""
        return FileFormatError(self.path, problem, self.line if line is None else line)

    def read(self) -> IonexMaps:
        self._read_header()
        latitudes, longitudes = self._range("LAT1 / LAT2 / DLAT"), self._range("LON1 / LON2 / DLON")
        lowest_km, highest_km, _ = self._header_numbers("HGT1 / HGT2 / DHGT", 3, skip=2)
        if self._header_numbers("MAP DIMENSION") != [2.0] or lowest_km != highest_km:
            raise FileFormatError(self.path, "expected maps of two dimensions on a single shell")
        (radius_km,) = self._header_numbers("BASE RADIUS", width=8)
        (interval_s,) = self._header_numbers("INTERVAL")
        with in_file(self.path):
            grid = LatLonGrid(latitudes, longitudes, self.path.name)
            require_shell(1e3 * lowest_km, 1e3 * radius_km)
        mjds, maps = [], []
        while (label := self._next()[0]) != "END OF FILE":
            if label == "START OF TEC MAP":
                mjd, tec = self._tec_map(grid)
                mjds.append(mjd)
                maps.append(tec)
            elif label in ("START OF RMS MAP", "START OF HEIGHT MAP"):
                self._skip_to(label.replace("START", "END"))
            elif label not in ("EXPONENT", "COMMENT", ""):
                raise self.error(f"unexpected label {label!r}")
        if not maps:
            raise FileFormatError(self.path, "expected maps, got none")
        if (np.diff(mjds) <= 0.0).any():
            raise FileFormatError(self.path, "the epochs of the maps do not rise")
        for label, mjd in zip(("FIRST", "LAST"), (mjds[0], mjds[-1]), strict=True):
            line, content = self.header.get(f"EPOCH OF {label} MAP", (0, ""))
            if content.strip() and abs(self._epoch(content) - mjd) > _EPOCH_TOLERANCE_D:
                problem = f"EPOCH OF {label} MAP: header {content.strip()}, map MJD {mjd:.5f}; download the file again"
                raise self.error(problem, line)
        gap_s = interval_s or _DEFAULT_INTERVAL_S
        shell_m = 1e3 * lowest_km, 1e3 * radius_km
        return IonexMaps(grid, np.array(mjds), np.stack(maps), *shell_m, gap_s, self.path.name)

    def _read_header(self) -> None:
        label, content = self._next()
        if label != "IONEX VERSION / TYPE" or content[20:21] != "I":
            raise self.error("expected the first line of an IONEX file")
        if content[:8].strip() not in ("1.0", "1.1", "1"):
            raise self.error(f"version: expected 1.0 or 1.1, got {content[:8].strip()}")
        while label != "END OF HEADER":
            label, content = self._next()
            if label == "START OF AUX DATA":
                self._skip_to("END OF AUX DATA")
            self.header[label] = self.line, content

    def _tec_map(self, grid: LatLonGrid) -> tuple[float, Floats]:
        tec = np.full(grid.shape, np.nan)
        missing_rows = {round(float(latitude), 3): k for k, latitude in enumerate(grid.latitudes_deg)}
        ends = grid.longitudes_deg[[0, -1]].tolist()
        mjd = None
        while True:
            label, content = self._next()
            if label == "EPOCH OF CURRENT MAP":
                mjd = self._epoch(content)
            elif label == "LAT/LON1/LON2/DLON/H":
                latitude, *longitudes = self._numbers(self.line, content, 4, skip=2)
                row = missing_rows.pop(round(latitude, 3), None)
                if row is None or longitudes[:2] != ends:
                    raise self.error("the row is duplicated or not on the grid of the header")
                tec[row] = self._row(grid.shape[1])
            elif label == "END OF TEC MAP":
                break
            elif label not in ("EXPONENT", "COMMENT"):
                raise self.error(f"unexpected label in a map: {label or content.strip()!r}")
        if mjd is None or missing_rows:
            missing = "its epoch" if mjd is None else f"{len(missing_rows)} of its rows"
            raise self.error(f"the map that ends in this line lacks {missing}")
        return mjd, tec

    def _row(self, n_values: int) -> list[float]:
        """Read the contents of a latitude, TECU: 16 numbers of five columns per line."""
        row: list[float] = []
        while len(row) < n_values:
            self._next()
            line, count = self.lines[self.line - 1], min(16, n_values - len(row))
            try:
                numbers = [int(line[5 * k : 5 * k + 5]) for k in range(count)]
            except ValueError:
                raise self.error(f"expected {count} integers of five columns each") from None
            if line[5 * count :].strip():
                raise self.error(f"expected {count} values, got more")
            unit = 10.0**self.exponent
            for number in numbers:
                tec = np.nan if number == _MISSING_VALUE else number * unit
                if tec < _TECU_LIMITS[0] or tec > _TECU_LIMITS[1]:
                    problem = f"expected a content of up to {_TECU_LIMITS[1]:g} TECU, got {tec:g}"
                    raise self.error(f"{problem} (exponent {self.exponent})")
                row.append(tec)
        return row

    def _epoch(self, content: str) -> float:
        year, month, day, hour, minute, second = self._numbers(self.line, content, 6)
        # Midnight at the end of a day may be called its 24th hour.
        with in_file(self.path, self.line):
            midnight = epochs_from_strings(f"{year:04.0f}-{month:02.0f}-{day:02.0f}", "UTC").mjd[0]
        seconds = 3600.0 * hour + 60.0 * minute + second
        if not 0.0 <= seconds <= SECONDS_PER_DAY:
            raise self.error(f"expected a time of day, got {content.strip()}")
        return float(midnight + seconds / SECONDS_PER_DAY)

    def _range(self, label: str) -> Floats:
        first, last, step = self._header_numbers(label, 3, skip=2)
        count = round((last - first) / step) + 1 if step else 0
        if count < 2 or abs(first + (count - 1) * step - last) > 1e-6:
            problem = f"{label}: {first:g} to {last:g} is not a multiple of the step {step:g}"
            raise self.error(problem, self.header[label][0])
        return np.linspace(first, last, count)

    def _header_numbers(self, label: str, count: int = 1, skip: int = 0, width: int = 6) -> list[float]:
        if label not in self.header:
            raise FileFormatError(self.path, f"the header lacks the line {label!r}")
        return self._numbers(*self.header[label], count, skip, width)

    def _numbers(self, line: int, content: str, count: int, skip: int = 0, width: int = 6) -> list[float]:
        """Read finite numbers in columns of a width, after some columns."""
        fields = [content[skip + k * width : skip + (k + 1) * width] for k in range(count)]
        try:
            numbers = [float(field) for field in fields]
        except ValueError:
            numbers = [np.nan]
        if not np.isfinite(numbers).all():
            problem = f"expected {count} numbers of {width} columns each, got {content.rstrip()!r}"
            raise self.error(problem, line)
        return numbers

    def _next(self) -> tuple[str, str]:
        """Return label and content of the next line, and keep the exponent if it has one."""
        if self.line >= len(self.lines):
            raise FileFormatError(self.path, "the map or header is incomplete", len(self.lines))
        self.line += 1
        line = self.lines[self.line - 1]
        label, content = line[60:80].strip(), line[:60]
        if label == "EXPONENT":
            (exponent,) = self._numbers(self.line, content, 1)
            if not (exponent.is_integer() and abs(exponent) <= 9):
                raise self.error(f"expected an exponent such as -1, got {exponent:g}")
            self.exponent = int(exponent)
        return label, content

    def _skip_to(self, end: str) -> None:
        exponent = self.exponent
        while self._next()[0] != end:
            pass
        self.exponent = exponent
