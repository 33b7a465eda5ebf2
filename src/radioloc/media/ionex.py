"""Global maps of the ionosphere's vertical electron content, from IONEX files.

IONEX 1.0 and 1.1 (Schaer, Gurtner and Feltens 1998), plain or gzip. Maps come every one or two hours on a grid of 2.5
degrees of latitude and 5 of longitude, good to 2 to 8 TECU. Maps of rms and of heights are left aside. Epochs are UTC.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.errors import FileFormatError, InputError
from radioloc.media.file_epochs import epochs_around
from radioloc.media.ionex_file import IonexFile, parse_ionex
from radioloc.media.ionosphere import modified_shell_mapping, pierce_point, thin_shell_mapping
from radioloc.media.lat_lon_grid import LatLonGrid
from radioloc.time import Epochs
from radioloc.time.scales import utc_of

_MAPPINGS = ("modified", "shell")
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class IonexMaps:
    """Maps of vertical electron content.

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
    longest_gap_s : float
        Between maps further apart than this nothing is interpolated, s.
    source : str
        The files' names.
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
        between them.

        Parameters
        ----------
        latitude_rad, longitude_rad : array_like, shape () or (n,)
            Geocentric latitude and east longitude, rad.
        epochs : Epochs
            n epochs, of any scale but UT1.

        Raises
        ------
        CoverageError
            An epoch is before the first map, after the last, or in a gap between them.
        InputError
            A place is outside the maps, or a value that is needed is missing in them.

        Notes
        -----
        Schaer et al. (1998), with longitudes turned by 360 degrees a day.
        """
        latitude, longitude, mjd = np.broadcast_arrays(latitude_rad, longitude_rad, utc_of(epochs).mjd)
        # 1 % over the step between maps is rounding of their epochs.
        before, after, share = epochs_around(
            self.mjd_utc, mjd, 1.01 * self.longest_gap_s / SECONDS_PER_DAY, self.source
        )
        return (1.0 - share) * self._on_map(before, latitude, longitude, mjd, share < 1.0) + (
            share * self._on_map(after, latitude, longitude, mjd, share > 0.0)
        )

    def slant_tec(
        self,
        station_itrf_m: ArrayLike,
        azimuth_rad: ArrayLike,
        elevation_rad: ArrayLike,
        epochs: Epochs,
        mapping: str = "modified",
    ) -> NDArray[np.float64]:
        """Electron content along rays from a station, TECU, shape (n,).

        Parameters
        ----------
        station_itrf_m : array_like, shape (3,) or (n, 3)
            Station, ITRF, m.
        azimuth_rad, elevation_rad : array_like, shape () or (n,)
            Direction, rad; elevations of at least 3 degrees.
        epochs : Epochs
            n epochs, of any scale but UT1.
        mapping : {"modified", "shell"}
            From vertical to slant by :func:`radioloc.media.ionosphere.modified_shell_mapping`, or by the plain shell at
            the file's height.

        Raises
        ------
        CoverageError, InputError
            As :meth:`vertical_tec` and :func:`radioloc.media.ionosphere.pierce_point`.
        """
        if mapping not in _MAPPINGS:
            raise InputError(f"mapping = {mapping!r} is not one of {', '.join(_MAPPINGS)}")
        place = pierce_point(
            station_itrf_m, azimuth_rad, elevation_rad, self.shell_height_m, self.base_radius_m
        )
        factor, _ = (
            modified_shell_mapping(elevation_rad)
            if mapping == "modified"
            else thin_shell_mapping(elevation_rad, self.shell_height_m, self.base_radius_m)
        )
        return factor * self.vertical_tec(*place, epochs)

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
        A file cannot be read or is not IONEX of two dimensions, maps are cut short or missing, or the files' grids or
        shells differ.
    InputError
        No file is given.
    """
    files = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
    if not files:
        raise InputError("no IONEX file is given")
    parts = [parse_ionex(path) for path in files]
    first = parts[0]
    for path, part in zip(files, parts, strict=True):
        if _geometry(part) != _geometry(first):
            raise FileFormatError(
                path, f"has another grid or shell than {files[0]}; give files of one centre"
            )
    maps = {mjd: tec for part in parts for mjd, tec in zip(part.mjd_utc.tolist(), part.tec_tecu, strict=True)}
    mjds = sorted(maps)
    return IonexMaps(
        first.grid,
        np.array(mjds),
        np.stack([maps[mjd] for mjd in mjds]),
        first.shell_height_m,
        first.base_radius_m,
        max(part.interval_s for part in parts),
        ", ".join(path.name for path in files),
    )


def _geometry(maps: IonexFile) -> tuple[object, ...]:
    grid = maps.grid
    return (
        tuple(grid.latitudes_deg),
        tuple(grid.longitudes_deg),
        maps.shell_height_m,
        maps.base_radius_m,
    )
