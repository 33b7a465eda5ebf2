"""The file format IONEX 1.0 and 1.1: maps of the ionosphere's electron content in fixed columns.

Schaer, Gurtner and Feltens (1998), IONEX: The IONosphere Map EXchange Format.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError, InputError
from radioloc.media.lat_lon_grid import LatLonGrid
from radioloc.media.text_numbers import ENCODING
from radioloc.text_files import read_lines
from radioloc.time import epochs_from_strings

_MISSING = 9999
_VALUES_PER_LINE = 16
_WIDTH = 5
_USUAL_INTERVAL_S = 7200.0
"""Where the header says 0 for an interval that varies."""


@dataclass(frozen=True, slots=True, eq=False)
class IonexFile:
    """Content of one file.

    Parameters
    ----------
    grid : LatLonGrid
        Points, by geocentric latitude and east longitude.
    mjd_utc : ndarray, shape (k,)
        Epochs, rising.
    tec_tecu : ndarray, shape (k, rows, columns)
        Vertical electron content, 1e16 per square metre; NaN where the file says that there is none.
    shell_height_m, base_radius_m : float
        Height of the shell and the radius of the sphere above which it is, m.
    interval_s : float
        Time between maps, s.
    """

    grid: LatLonGrid
    mjd_utc: NDArray[np.float64]
    tec_tecu: NDArray[np.float64]
    shell_height_m: float
    base_radius_m: float
    interval_s: float


def parse_ionex(path: Path) -> IonexFile:
    """Read one file; errors as :func:`radioloc.media.ionex.read_ionex`."""
    reader = _Reader(path)
    try:
        return reader.read()
    except FileFormatError as error:
        if error.line is None or any(line.strip() for line in reader.lines[error.line :]):
            raise
        problem = f"{error.problem}; as the file ends here, it may have been cut: fetch it again"
        raise FileFormatError(path, problem, error.line) from None


class _Reader:
    """One file: lines whose last twenty columns name what stands in the first sixty."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lines = list(read_lines(path, encoding=ENCODING))
        self.next = 0
        self.exponent = -1

    def read(self) -> IonexFile:
        header = self._header()
        latitudes = self._range(header, "LAT1 / LAT2 / DLAT")
        longitudes = self._range(header, "LON1 / LON2 / DLON")
        heights = self._header_numbers(header, "HGT1 / HGT2 / DHGT", 2, 6, 3)
        dimension = self._header_numbers(header, "MAP DIMENSION", 0, 6, 1)[0]
        if dimension != 2 or heights[0] != heights[1]:
            raise FileFormatError(self.path, "maps of two dimensions, on one shell, are wanted")
        radius = self._header_numbers(header, "BASE RADIUS", 0, 8, 1)[0]
        interval_s = self._header_numbers(header, "INTERVAL", 0, 6, 1)[0] or _USUAL_INTERVAL_S
        announced = self._header_numbers(header, "# OF MAPS IN FILE", 0, 6, 1)[0]
        try:
            grid = LatLonGrid(latitudes, longitudes, self.path.name)
        except InputError as error:
            raise FileFormatError(self.path, str(error)) from error
        maps = self._tec_maps(grid)
        if len(maps) != announced:
            problem = (
                f"the header announces {announced:g} maps, but there are {len(maps)}; fetch the file again"
            )
            raise FileFormatError(self.path, problem)
        mjds = np.array([mjd for mjd, _ in maps])
        if (np.diff(mjds) <= 0.0).any():
            raise FileFormatError(self.path, "the maps' epochs do not rise")
        tec = np.stack([values for _, values in maps])
        return IonexFile(grid, mjds, tec, 1e3 * heights[0], 1e3 * radius, interval_s)

    def _header(self) -> dict[str, tuple[int, str]]:
        number, label, content = self._take()
        if label != "IONEX VERSION / TYPE" or content[20:21] != "I":
            raise FileFormatError(self.path, "this is not the first line of an IONEX file", number)
        if content[:8].strip() not in ("1.0", "1.1", "1"):
            raise FileFormatError(self.path, f"version {content[:8].strip()} is not 1.0 or 1.1", number)
        header: dict[str, tuple[int, str]] = {}
        while label != "END OF HEADER":
            number, label, content = self._take()
            if label == "START OF AUX DATA":
                self._skip_to("END OF AUX DATA")
            header[label] = number, content
        if "EXPONENT" in header:
            self.exponent = int(self._header_numbers(header, "EXPONENT", 0, 6, 1)[0])
        return header

    def _tec_maps(self, grid: LatLonGrid) -> list[tuple[float, NDArray[np.float64]]]:
        maps = []
        while True:
            number, label, content = self._take()
            match label:
                case "START OF TEC MAP":
                    maps.append(self._tec_map(grid))
                case "START OF RMS MAP" | "START OF HEIGHT MAP":
                    self._skip_to(label.replace("START", "END"))
                case "EXPONENT":
                    self.exponent = int(self._numbers(number, content, 0, 6, 1)[0])
                case "END OF FILE":
                    return maps
                case "COMMENT" | "":
                    pass
                case _:
                    raise FileFormatError(self.path, f"{label!r} is not expected here", number)

    def _tec_map(self, grid: LatLonGrid) -> tuple[float, NDArray[np.float64]]:
        tec = np.full(grid.shape, np.nan)
        rows_left = {round(float(latitude), 3): k for k, latitude in enumerate(grid.latitudes_deg)}
        mjd = None
        while True:
            number, label, content = self._take()
            match label:
                case "EPOCH OF CURRENT MAP":
                    mjd = self._epoch(number, content)
                case "EXPONENT":
                    self.exponent = int(self._numbers(number, content, 0, 6, 1)[0])
                case "LAT/LON1/LON2/DLON/H":
                    latitude, *along = self._numbers(number, content, 2, 6, 4)
                    first, last = grid.longitudes_deg[[0, -1]]
                    row = rows_left.pop(round(latitude, 3), None)
                    if row is None or along[:2] != [first, last]:
                        problem = "the row is not one of the header's grid, or comes twice"
                        raise FileFormatError(self.path, problem, number)
                    tec[row] = self._row(grid.shape[1])
                case "END OF TEC MAP":
                    break
                case "COMMENT":
                    pass
                case _:
                    shown = label or content.strip()
                    raise FileFormatError(self.path, f"{shown!r} is not expected in a map", number)
        if mjd is None or rows_left:
            what = "its epoch" if mjd is None else f"{len(rows_left)} of its rows"
            raise FileFormatError(self.path, f"the map that ends here lacks {what}", number)
        return mjd, tec

    def _row(self, n_values: int) -> NDArray[np.float64]:
        values: list[int] = []
        while len(values) < n_values:
            number = self.next + 1
            count = min(_VALUES_PER_LINE, n_values - len(values))
            line = self.lines[self.next] if self.next < len(self.lines) else ""
            self.next += 1
            try:
                values.extend(int(line[k * _WIDTH : (k + 1) * _WIDTH]) for k in range(count))
            except ValueError:
                problem = f"{count} whole numbers of five columns each are wanted"
                raise FileFormatError(self.path, problem, number) from None
            if line[count * _WIDTH :].strip():
                raise FileFormatError(self.path, f"more than {count} values stand here", number)
        row = np.array(values, dtype=np.float64)
        return np.where(row == _MISSING, np.nan, row * 10.0**self.exponent)

    def _epoch(self, number: int, content: str) -> float:
        year, month, day, hour, minute, second = self._numbers(number, content, 0, 6, 6)
        try:
            # Midnight at the end of a day may be called its 24th hour.
            midnight = epochs_from_strings(f"{year:04.0f}-{month:02.0f}-{day:02.0f}", "UTC").mjd[0]
        except InputError as error:
            raise FileFormatError(self.path, str(error), number) from error
        seconds = 3600.0 * hour + 60.0 * minute + second
        if not 0.0 <= seconds <= 86400.0:
            raise FileFormatError(self.path, f"{content.strip()} is not a time of day", number)
        return float(midnight + seconds / 86400.0)

    def _range(self, header: dict[str, tuple[int, str]], label: str) -> NDArray[np.float64]:
        first, last, step = self._header_numbers(header, label, 2, 6, 3)
        count = round((last - first) / step) + 1 if step else 0
        if count < 2 or abs(first + (count - 1) * step - last) > 1e-6:
            problem = f"from {first:g} to {last:g} in steps of {step:g} is no range"
            raise FileFormatError(self.path, problem, header[label][0])
        return np.linspace(first, last, count)

    def _header_numbers(
        self, header: dict[str, tuple[int, str]], label: str, skip: int, width: int, count: int
    ) -> list[float]:
        if label not in header:
            raise FileFormatError(self.path, f"the header has no line {label!r}")
        number, content = header[label]
        return self._numbers(number, content, skip, width, count)

    def _numbers(self, number: int, content: str, skip: int, width: int, count: int) -> list[float]:
        fields = [content[skip + k * width : skip + (k + 1) * width] for k in range(count)]
        try:
            numbers = [float(field) for field in fields]
        except ValueError:
            numbers = []
        if not np.isfinite(numbers).all() or not numbers:
            problem = (
                f"{count} numbers of {width} columns each are wanted, but {content.rstrip()!r} stands here"
            )
            raise FileFormatError(self.path, problem, number)
        return numbers

    def _take(self) -> tuple[int, str, str]:
        if self.next >= len(self.lines):
            raise FileFormatError(self.path, "the map or header is not complete", len(self.lines))
        line = self.lines[self.next]
        self.next += 1
        return self.next, line[60:80].strip(), line[:60]

    def _skip_to(self, end: str) -> None:
        while self._take()[1] != end:
            pass
