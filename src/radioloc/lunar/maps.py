"""Orbital maps as images of the ground: from pixels to longitude and latitude, and to a plane.

Longitudes and latitudes are degrees in mean-Earth axes, in which lunar maps are drawn, longitudes to the east from
-180 to 180. Pixels are (sample, line); the centre of the first one is (0, 0). The plane in which images are adjusted
touches the sphere at a reference point; it has east and north in metres, whatever the map's projection.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import FileFormatError, InputError
from radioloc.lunar.grey_images import Image, Mask, eight_bit, open_grey
from radioloc.lunar.map_files import SourceFile, open_dataset, open_map_file
from radioloc.lunar.map_grid import MapGrid, load_rasterio
from radioloc.lunar.selenographic import cartesian_to_selenographic, east_north_up, selenographic_to_cartesian
from radioloc.quantities import accepts_quantities
from radioloc.vectors import Floats

_TOLERANCE_PIXELS = 0.02  # of the map, to which GDAL interpolates the projection; features have 0.1 and more
_AVERAGED_FROM = 2.0  # pixels of the map in one of a view, from which on they are averaged, not interpolated
_LARGEST_VIEW_PIXELS = 2**26


@dataclass(frozen=True, slots=True)
class TangentPlane:
    """The plane that touches the sphere of 1737.4 km at a point; points are seen on it from above (orthographic).

    Examples
    --------
    >>> plane = TangentPlane(-19.51, 44.12)
    >>> plane.from_longitude_latitude([[-19.51, 44.13]]).round(3).tolist()
    [[0.0, 303.234]]
    >>> plane.to_longitude_latitude([[0.0, 303.234]]).round(6).tolist()
    [[-19.51, 44.13]]
    """

    longitude_deg: float  #: the point of contact, mean-Earth axes
    latitude_deg: float  #: likewise

    def from_longitude_latitude(self, degrees: ArrayLike) -> Floats:
        """East and north, m, shape (n, 2), of longitudes and latitudes, degrees, shape (n, 2); NaN on the far side."""
        lon_lat = np.radians(np.asarray(degrees, dtype=np.float64))
        local_m = selenographic_to_cartesian(lon_lat[:, 0], lon_lat[:, 1], 0.0) @ self.axes().T
        return np.where(local_m[:, 2:] > 0.0, local_m[:, :2], np.nan)

    @accepts_quantities
    def to_longitude_latitude(self, east_north_m: ArrayLike) -> Floats:
        """Longitudes and latitudes, degrees, shape (n, 2), of points of the plane, m; NaN beyond the Moon's limb."""
        plane_m = np.asarray(east_north_m, dtype=np.float64)
        up2 = MEAN_LUNAR_RADIUS_M**2 - (plane_m**2).sum(axis=1)
        visible = up2 > 0.0
        local_m = np.column_stack([plane_m, np.sqrt(np.where(visible, up2, 0.0))])
        local_m[~visible] = [0.0, 0.0, MEAN_LUNAR_RADIUS_M]
        longitude, latitude, _ = cartesian_to_selenographic(local_m @ self.axes())
        degrees = np.degrees(np.column_stack([longitude, latitude]))
        degrees[~visible] = np.nan
        return degrees

    @accepts_quantities
    def covariance_at(self, east_north_m: ArrayLike, covariance_m2: ArrayLike) -> Floats:
        """Return a covariance in the plane, m^2, (2, 2), rotated to local east and north at one of its points."""
        lon_lat = np.radians(self.to_longitude_latitude(np.reshape(east_north_m, (1, 2)))[0])
        to_sphere = np.linalg.inv((self.axes() @ east_north_up(*lon_lat).T)[:2, :2])
        return to_sphere @ np.asarray(covariance_m2, dtype=np.float64) @ to_sphere.T

    def axes(self) -> Floats:
        """East, north and up at the point of contact as rows, mean-Earth axes, shape (3, 3)."""
        return east_north_up(math.radians(self.longitude_deg), math.radians(self.latitude_deg))


@dataclass(frozen=True, slots=True, eq=False)
class Map:
    """A map of one band with a projection; build with :meth:`Map.open`. Pixels are read when a view asks for them."""

    path: Path
    files: tuple[SourceFile, ...]
    resolution_m: float  #: of a pixel where the projection is true to scale
    coverage: str  #: text, in degrees
    _grid: MapGrid = field(repr=False)
    _overviews: tuple[int, ...] = field(repr=False)  # their factors

    @classmethod
    def open(cls, path: str | Path) -> Map:
        """Open a map image: GeoTIFF in any lunar projection, ISIS cube, PDS by its label.

        Raises
        ------
        FileFormatError
            The file is missing, cut, or GDAL does not read it as one band of numbers with a map projection.
        InputError
            rasterio is not installed; another body's map, axes that are not mean-Earth, longitudes that count west,
            an ellipsoid.
        """
        path = Path(path)
        with open_map_file(path, "u1 i1 i2 u2 i4 u4 f4 f8", "a map image of one band") as file:
            overviews = tuple(file.dataset.overviews(1))
            return cls(path, file.files(), file.grid.resolution_m, file.grid.coverage(), file.grid, overviews)

    @property
    def shape(self) -> tuple[int, int]:
        """Lines and samples."""
        return self._grid.rows, self._grid.columns

    def longitude_latitude_deg(self, pixels: ArrayLike) -> Floats:
        """Longitudes and latitudes of pixels, shape (n, 2); infinite outside the projection.

        Examples
        --------
        >>> import tempfile, rasterio
        >>> path = Path(tempfile.mkdtemp(), "map.tif")
        >>> profile = dict(driver="GTiff", width=40, height=20, count=1, dtype="uint8", crs="+proj=eqc +R=1737400")
        >>> to_x_y = rasterio.Affine(100.0, 0.0, 0.0, 0.0, -100.0, 1000.0)
        >>> with rasterio.open(path, "w", transform=to_x_y, **profile) as dataset:
        ...     dataset.write(np.ones((20, 40), np.uint8), 1)
        >>> base = Map.open(path)
        >>> base.longitude_latitude_deg([[0.0, 0.0]]).round(6).tolist()
        [[0.001649, 0.031329]]
        >>> base.pixels([[0.001649, 0.031329]]).round(2) + 0.0
        array([[0., 0.]])
        """
        pixels = _pairs(pixels, "pixels")
        degrees = np.degrees(np.column_stack(self._grid.longitude_latitude(pixels[:, 1], pixels[:, 0])))
        degrees[:, 0] -= 360.0 * np.round(degrees[:, 0] / 360.0)
        return degrees

    @accepts_quantities
    def pixels(self, longitude_latitude_deg: ArrayLike) -> Floats:
        """Pixels, shape (n, 2), of longitudes and latitudes; not finite where the projection does not show them."""
        radians = np.radians(_pairs(longitude_latitude_deg, "longitudes and latitudes"))
        return np.column_stack(self._grid.cells(radians[:, 0], radians[:, 1])[::-1])

    def plane(self) -> TangentPlane:
        """Return the plane that touches the sphere at the centre of the map."""
        lines, samples = self.shape
        longitude, latitude = self.longitude_latitude_deg([[0.5 * (samples - 1), 0.5 * (lines - 1)]])[0]
        return TangentPlane(float(longitude), float(latitude))

    def extent_m(self, plane: TangentPlane) -> tuple[float, float, float, float]:
        """West, south, east, north edges of the map in a plane, m; those of its side that the plane can show."""
        lines, samples = self.shape
        at = np.linspace(-0.5, [samples - 0.5, lines - 0.5], 65).T
        grid = np.stack(np.meshgrid(*at), axis=-1).reshape(-1, 2)
        degrees = self.longitude_latitude_deg(grid)
        plane_m = plane.from_longitude_latitude(degrees[np.isfinite(degrees).all(axis=1)])
        (west, south), (east, north) = np.nanmin(plane_m, axis=0), np.nanmax(plane_m, axis=0)
        return float(west), float(south), float(east), float(north)

    def view(
        self, plane: TangentPlane, west_m: float, north_m: float, pixel_m: float, shape: tuple[int, int]
    ) -> tuple[Image, Mask]:
        """Draw the map in a plane.

        Parameters
        ----------
        plane : TangentPlane
            The plane.
        west_m, north_m : float
            East and north of the centre of the first pixel.
        pixel_m : float
            Size of a pixel; larger ones are means of the map's.
        shape : tuple of int
            Lines and samples of the view.

        Returns
        -------
        tuple of numpy.ndarray
            The view in eight bits, and where the map has values. The seam of a global cylindrical map is the meridian
            opposite the view; in views over a pole, the pixels on it may be void or mixed.

        Raises
        ------
        FileFormatError
            Pixels that cannot be read.
        InputError
            A view of more than 67 million pixels.
        """
        sphere_m = self._grid.sphere_m
        pixel = pixel_m * sphere_m / MEAN_LUNAR_RADIUS_M
        corner = (west_m / pixel_m - 0.5) * pixel, (north_m / pixel_m + 0.5) * pixel
        to_plane = f"+proj=ortho +lat_0={plane.latitude_deg!r} +lon_0={plane.longitude_deg!r} +R={sphere_m!r}"
        transform = load_rasterio().Affine(pixel, 0.0, corner[0], 0.0, -pixel, corner[1])
        return self._warped(plane, to_plane, transform, shape, pixel_m / self.resolution_m)

    def on_grid(self, grid: MapGrid) -> tuple[Image, Mask]:
        """Draw the map in the cells of a grid, as :meth:`view` does in a plane."""
        middle_rad = grid.longitude_latitude(np.array([0.5 * grid.rows]), np.array([0.5 * grid.columns]))
        plane = TangentPlane(*(float(np.degrees(angle[0])) for angle in middle_rad))
        shape = grid.rows, grid.columns
        return self._warped(plane, grid.crs, grid.transform, shape, grid.resolution_m / self.resolution_m)

    def _warped(
        self, plane: TangentPlane, crs: Any, transform: Any, shape: tuple[int, int], reduction: float
    ) -> tuple[Image, Mask]:
        """Return the map around a plane in pixels of another reference system, larger by a reduction."""
        rasterio = load_rasterio()
        from rasterio._err import CPLE_BaseError
        from rasterio.vrt import WarpedVRT

        lines, samples = shape
        if not 0 < lines * samples <= _LARGEST_VIEW_PIXELS:
            raise InputError(f"a view of {lines} x {samples} pixels was asked for; make pixel_m larger")
        enums = rasterio.enums.Resampling
        try:
            with self._source(plane, reduction) as (dataset, (source_crs, source_transform)):
                finest = reduction * dataset.width / self.shape[1]
                warped = WarpedVRT(
                    dataset,
                    src_crs=source_crs,
                    src_transform=source_transform,
                    crs=crs,
                    transform=transform,
                    width=samples,
                    height=lines,
                    resampling=enums.average if finest >= _AVERAGED_FROM else enums.bilinear,
                    tolerance=_TOLERANCE_PIXELS,
                    add_alpha=True,
                    XSCALE=1.0,  # bilinear between four pixels, instead of a blur over more of them
                    YSCALE=1.0,
                )
                with warped:
                    values, alpha = warped.read(1), warped.read(2)
        except (rasterio.errors.RasterioError, CPLE_BaseError) as error:
            raise FileFormatError(self.path, f"pixels could not be read: {error}") from error
        return eight_bit(np.ma.masked_array(values, alpha == 0))

    @contextmanager
    def _source(self, plane: TangentPlane, reduction: float) -> Iterator[tuple[Any, tuple[Any, Any]]]:
        """Yield the coarsest sufficient overview, its seam opposite the view, its reference system and transform."""
        count = sum(factor <= reduction for factor in self._overviews)
        overview, (rows, columns), first = count - 1 if count else None, self.shape, 0
        if count:
            with open_dataset(self.path, overview_level=overview) as dataset:
                rows, columns = dataset.shape
        by_column, by_row = self.shape[1] / columns, self.shape[0] / rows
        if self._grid.closed and self._grid.columns_around == self.shape[1]:
            [[middle, _]] = self.pixels([[plane.longitude_deg, 0.0]])
            if math.isfinite(middle):
                first = round((middle + 0.5) / by_column - 0.5 * columns) % columns
        crs, (a, b, c, d, e, f, *_) = self._grid.unrolled(first * by_column)
        with open_grey(self.path, overview=overview, first_column=first) as dataset:
            kind = load_rasterio().Affine
            yield dataset, (crs, kind(a * by_column, b * by_row, c, d * by_column, e * by_row, f))


def _pairs(values: Any, name: str) -> Floats:
    pairs = np.asarray(values, dtype=np.float64)
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise InputError(f"{name} have shape {pairs.shape}; give pairs, shape (n, 2)")
    return pairs
