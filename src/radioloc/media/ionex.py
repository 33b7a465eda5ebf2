"""Global maps of the ionosphere's vertical electron content, from IONEX files.

IONEX 1.0 and 1.1 in fixed columns (Schaer, Gurtner and Feltens 1998, IONEX: The IONosphere Map EXchange Format), plain
or gzip. Maps come every one or two hours on a grid of 2.5 degrees of latitude and 5 of longitude, good to 2 to 8 TECU.
Maps of rms and of heights are left aside. Epochs are UTC.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.errors import FileFormatError, InputError
from radioloc.media.grids import LatLonGrid, epochs_around
from radioloc.media.ionosphere import modified_shell_mapping, pierce_point, require_shell
from radioloc.media.text_numbers import ENCODING, fixed_numbers
from radioloc.text_files import read_lines
from radioloc.time import Epochs, epochs_from_strings
from radioloc.time.scales import to_scale

_ROUNDING = 1e-9
_MISSING = 9999
_VALUES_PER_LINE = 16
_WIDTH = 5
_USUAL_INTERVAL_S = 7200.0
"""Where the header says 0 for an interval that varies."""
_POSSIBLE_TECU = (-10.0, 1000.0)
"""Maps may fall a little below zero at night; 250 TECU is the most that was ever seen."""


@dataclass(frozen=True, slots=True, eq=False)
class IonexMaps:
    """Maps of vertical electron content on a shell, at rising epochs.

    ``tec_tecu`` has shape (epochs, rows, columns), NaN where the file says that there is none; places are geocentric;
    the shell is so high above a sphere of the base radius. Between maps further apart than the longest gap nothing is
    interpolated.
    """

    grid: LatLonGrid
    mjd_utc: NDArray[np.float64]
    tec_tecu: NDArray[np.float64]
    shell_height_m: float
    base_radius_m: float
    longest_gap_s: float
    source: str

    def vertical_tec(
        self, latitude_rad: ArrayLike, longitude_rad: ArrayLike, epochs: Epochs
    ) -> NDArray[np.float64]:
        """Vertical electron content at places of the shell, TECU, shape (n,).

        Bilinear on each of the two maps around an epoch, which are turned with the Sun to that epoch, and linear
        between them (Schaer et al. 1998, with longitudes turned by 360 degrees a day). Places are geocentric, epochs of
        any scale but UT1.

        Raises :class:`CoverageError` for an epoch before the first map, after the last, or in a gap between them, and
        :class:`InputError` for a place outside the maps, or where a value that is needed is missing in them.
        """
        latitude, longitude, mjd = np.broadcast_arrays(
            latitude_rad, longitude_rad, to_scale(epochs, "UTC").mjd
        )
        # 1 % over the step between maps is rounding of their epochs.
        before, after, share = epochs_around(
            self.mjd_utc, mjd, 1.01 * self.longest_gap_s / SECONDS_PER_DAY, self.source
        )
        return (1.0 - share) * self._on_map(before, latitude, longitude, mjd, share < 1.0) + (
            share * self._on_map(after, latitude, longitude, mjd, share > 0.0)
        )

    def slant_tec(
        self, station_itrf_m: ArrayLike, azimuth_rad: ArrayLike, elevation_rad: ArrayLike, epochs: Epochs
    ) -> NDArray[np.float64]:
        """Electron content along rays from stations, TECU, shape (n,), by the modified single layer mapping.

        Errors as those of :meth:`vertical_tec` and :func:`radioloc.media.ionosphere.pierce_point`.
        """
        place = pierce_point(
            station_itrf_m, azimuth_rad, elevation_rad, self.shell_height_m, self.base_radius_m
        )
        return modified_shell_mapping(elevation_rad)[0] * self.vertical_tec(*place, epochs)

    def _on_map(
        self,
        index: NDArray[np.int64],
        latitude_rad: NDArray[np.float64],
        longitude_rad: NDArray[np.float64],
        mjd_utc: NDArray[np.float64],
        used: NDArray[np.bool_],
    ) -> NDArray[np.float64]:
        turned = longitude_rad + 2.0 * np.pi * (mjd_utc - self.mjd_utc[index])
        row, column, weight = self.grid.corners(latitude_rad, turned)
        values = self.tec_tecu[index[:, None], row, column]
        # On a point of the map its neighbours have weights of rounding only.
        needed = (weight > _ROUNDING) & used[:, None]
        missing = np.isnan(values) & needed
        if missing.any():
            k = np.flatnonzero(missing.any(axis=1))[0]
            raise InputError(
                f"{self.source} has no electron content at latitude {np.rad2deg(latitude_rad[k]):.1f}, longitude "
                f"{np.rad2deg(longitude_rad[k]):.1f} degrees, MJD {mjd_utc[k]:.3f}; take the maps of another centre"
            )
        return np.sum(np.where(needed, weight * values, 0.0), axis=-1)


def read_ionex(paths: str | Path | Sequence[str | Path]) -> IonexMaps:
    """Read the maps of one or more IONEX files.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        The files, of one grid; where two have a map of one epoch, as at midnight, that of the file named later is used.

    Raises
    ------
    FileFormatError
        A file cannot be read or is not IONEX of two dimensions, maps are cut short or missing, a content or the shell
        is impossible, or the files' grids or shells differ.
    """
    files = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
    if not files:
        raise InputError("no IONEX file is given")
    parts = [_parsed(path) for path in files]
    first = parts[0]
    for path, part in zip(files, parts, strict=True):
        if _geometry(part) != _geometry(first):
            raise FileFormatError(
                path, f"has another grid or shell than {files[0]}; give files of one centre"
            )
    maps = {mjd: tec for part in parts for mjd, tec in zip(part.mjd_utc.tolist(), part.tec_tecu, strict=True)}
    mjds = sorted(maps)
    return replace(
        first,
        mjd_utc=np.array(mjds),
        tec_tecu=np.stack([maps[mjd] for mjd in mjds]),
        longest_gap_s=max(part.longest_gap_s for part in parts),
        source=", ".join(path.name for path in files),
    )


def _geometry(maps: IonexMaps) -> tuple[object, ...]:
    grid = maps.grid
    return (*grid.latitudes_deg, *grid.longitudes_deg, maps.shell_height_m, maps.base_radius_m, *grid.shape)


def _parsed(path: Path) -> IonexMaps:
    """One file; where it ends in the middle of something, the error says so."""
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

    def read(self) -> IonexMaps:
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
            require_shell(1e3 * heights[0], 1e3 * radius)
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
        return IonexMaps(grid, mjds, tec, 1e3 * heights[0], 1e3 * radius, interval_s, self.path.name)

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
            self._set_exponent(*header["EXPONENT"])
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
                    self._set_exponent(number, content)
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
                    self._set_exponent(number, content)
                case "LAT/LON1/LON2/DLON/H":
                    latitude, *along = fixed_numbers(self.path, number, content, 2, 6, 4)
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
        tec = np.where(row == _MISSING, np.nan, row * 10.0**self.exponent)
        wrong = (tec < _POSSIBLE_TECU[0]) | (tec > _POSSIBLE_TECU[1])
        if wrong.any():
            # Of the line on which the value stands.
            at = int(np.argmax(wrong))
            at_line = self.next - (n_values - 1) // _VALUES_PER_LINE + at // _VALUES_PER_LINE
            problem = f"a content of {tec[at]:g} TECU (with the exponent {self.exponent}) cannot be"
            raise FileFormatError(self.path, f"{problem}; {_POSSIBLE_TECU[1]:g} is the most", at_line)
        return tec

    def _set_exponent(self, number: int, content: str) -> None:
        exponent = fixed_numbers(self.path, number, content, 0, 6, 1)[0]
        if not (exponent.is_integer() and abs(exponent) <= 9):
            raise FileFormatError(self.path, f"the exponent is {exponent:g}, but -1 is usual", number)
        self.exponent = int(exponent)

    def _epoch(self, number: int, content: str) -> float:
        year, month, day, hour, minute, second = fixed_numbers(self.path, number, content, 0, 6, 6)
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
        return fixed_numbers(self.path, number, content, skip, width, count)

    def _take(self) -> tuple[int, str, str]:
        if self.next >= len(self.lines):
            raise FileFormatError(self.path, "the map or header is not complete", len(self.lines))
        line = self.lines[self.next]
        self.next += 1
        return self.next, line[60:80].strip(), line[:60]

    def _skip_to(self, end: str) -> None:
        while self._take()[1] != end:
            pass
