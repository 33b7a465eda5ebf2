"""Orbital maps as images of the ground: from pixels to longitude and latitude, to the map's own metres, to a plane.

Longitudes and latitudes are degrees in mean-Earth axes, in which lunar maps are drawn, longitudes to the east from
-180 to 180. Pixels are (sample, line); the centre of the first one is (0, 0). The plane in which images are adjusted
touches the sphere at a reference point; it has east and north in metres, whatever the map's projection.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.boundary import bare_arguments
from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import FileFormatError, InputError
from radioloc.imaging.frames import Image, Mask, eight_bit, load_opencv
from radioloc.lunar import cartesian_to_selenographic, east_north_up, selenographic_to_cartesian
from radioloc.lunar.map_files import SourceFile, open_dataset, open_map_file
from radioloc.lunar.map_grid import MapGrid, load_rasterio

Floats = NDArray[np.float64]

_NODE_PIXELS = (
    32  # between nodes the projection is interpolated: 0.2 mm off for pixels of 1.5 m at latitude 45
)
_LARGEST_VIEW_PIXELS = 2**26


@dataclass(frozen=True, slots=True)
class TangentPlane:
    """The plane that touches the sphere of 1737.4 km at a point; points are seen on it from above (orthographic).

    Parameters
    ----------
    longitude_deg, latitude_deg : float
        The point of contact, mean-Earth axes.

    Examples
    --------
    >>> plane = TangentPlane(-19.51, 44.12)
    >>> plane.from_longitude_latitude([[-19.51, 44.13]]).round(3).tolist()
    [[0.0, 303.234]]
    >>> plane.to_longitude_latitude([[0.0, 303.234]]).round(6).tolist()
    [[-19.51, 44.13]]
    """

    longitude_deg: float
    latitude_deg: float

    def from_longitude_latitude(self, degrees: ArrayLike) -> Floats:
        """East and north, m, shape (n, 2), of longitudes and latitudes, degrees, shape (n, 2); NaN on the far side."""
        lon_lat = np.radians(np.asarray(degrees, dtype=np.float64))
        local_m = selenographic_to_cartesian(lon_lat[:, 0], lon_lat[:, 1], 0.0) @ self.axes().T
        return np.where(local_m[:, 2:] > 0.0, local_m[:, :2], np.nan)

    @bare_arguments
    def to_longitude_latitude(self, east_north_m: ArrayLike) -> Floats:
        """Longitudes and latitudes, degrees, shape (n, 2), of points of the plane, m; NaN beyond the Moon's limb."""
        plane_m = np.asarray(east_north_m, dtype=np.float64)
        up2 = MEAN_LUNAR_RADIUS_M**2 - (plane_m**2).sum(axis=1)
        seen = up2 > 0.0
        local_m = np.column_stack([plane_m, np.sqrt(np.where(seen, up2, 0.0))])
        local_m[~seen] = [0.0, 0.0, MEAN_LUNAR_RADIUS_M]
        longitude, latitude, _ = cartesian_to_selenographic(local_m @ self.axes())
        degrees = np.degrees(np.column_stack([longitude, latitude]))
        degrees[~seen] = np.nan
        return degrees

    @bare_arguments
    def covariance_at(self, east_north_m: ArrayLike, covariance_m2: ArrayLike) -> Floats:
        """A covariance of the plane's metres in east and north at another of its points, m^2, shape (2, 2)."""
        here = np.radians(self.to_longitude_latitude(np.reshape(east_north_m, (1, 2)))[0])
        to_sphere = np.linalg.inv((self.axes() @ east_north_up(*here).T)[:2, :2])
        return to_sphere @ np.asarray(covariance_m2, dtype=np.float64) @ to_sphere.T

    def axes(self) -> Floats:
        """East, north and up at the point of contact as rows, mean-Earth axes, shape (3, 3)."""
        return east_north_up(math.radians(self.longitude_deg), math.radians(self.latitude_deg))


@dataclass(frozen=True, slots=True, eq=False)
class Map:
    """A map of one band with a projection; build with :meth:`Map.open`. Pixels are read when a view asks for them."""

    path: Path
    files: tuple[SourceFile, ...]
    resolution_m: float  # of a pixel where the projection is true to scale
    coverage: str  # in degrees, for people
    _grid: MapGrid = field(repr=False)

    @classmethod
    def open(cls, path: str | Path) -> Map:
        """Open a map image: GeoTIFF in any lunar projection, ISIS cube, PDS by its label.

        Raises
        ------
        FileFormatError
            No such file, a part of one, or none that GDAL reads as one band of numbers with a map projection.
        InputError
            rasterio is not installed; another body's map, axes that are not mean-Earth, longitudes that count west,
            an ellipsoid.
        """
        path = Path(path)
        with open_map_file(path, "u1 i1 i2 u2 i4 u4 f4 f8", "map image; give one band") as file:
            return cls(path, file.files(), file.grid.resolution_m, file.grid.coverage(), file.grid)

    @property
    def shape(self) -> tuple[int, int]:
        """Lines and samples."""
        return self._grid.rows, self._grid.columns

    def longitude_latitude_deg(self, pixels: ArrayLike) -> Floats:
        """Longitudes and latitudes of pixels, shape (n, 2); infinite where the projection has no Moon.

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
        >>> base.pixels([[0.001649, 0.031329]]).round(2) + 0.0, base.xy_m([[0.0, 0.0]])
        (array([[0., 0.]]), array([[ 50., 950.]]))
        """
        pixels = _pairs(pixels, "pixels")
        degrees = np.degrees(np.column_stack(self._grid.longitude_latitude(pixels[:, 1], pixels[:, 0])))
        degrees[:, 0] -= 360.0 * np.round(degrees[:, 0] / 360.0)
        return degrees

    @bare_arguments
    def pixels(self, longitude_latitude_deg: ArrayLike) -> Floats:
        """Pixels, shape (n, 2), of longitudes and latitudes; not finite where the projection does not show them."""
        radians = np.radians(_pairs(longitude_latitude_deg, "longitudes and latitudes"))
        return np.column_stack(self._grid.cells(radians[:, 0], radians[:, 1])[::-1])

    def xy_m(self, pixels: ArrayLike) -> Floats:
        """The projection's own x and y of pixels, shape (n, 2): metres, or degrees if the map is drawn in degrees."""
        pixels = _pairs(pixels, "pixels")
        a, b, c, d, e, f = self._grid.transform[:6]
        return (pixels + 0.5) @ np.array([[a, d], [b, e]]) + np.array([c, f])

    @bare_arguments
    def from_xy_m(self, xy_m: ArrayLike) -> Floats:
        """Pixels, shape (n, 2), of the projection's own x and y; the inverse of :meth:`xy_m`."""
        a, b, c, d, e, f = self._grid.transform[:6]
        return (_pairs(xy_m, "x and y") - [c, f]) @ np.linalg.inv([[a, d], [b, e]]) - 0.5

    def plane(self) -> TangentPlane:
        """The plane that touches the sphere at the centre of the map."""
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
        """The map drawn in a plane.

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
            The view in eight bits, and where the map has values.

        Raises
        ------
        FileFormatError
            Pixels that cannot be read.
        InputError
            A view of more than 67 million pixels.
        """
        cv2, rasterio = load_opencv(), load_rasterio()
        lines, samples = shape
        if not 0 < lines * samples <= _LARGEST_VIEW_PIXELS:
            raise InputError(f"a view of {lines} x {samples} pixels was asked for; make pixel_m larger")
        map_pixels = self._map_pixels(plane, west_m, north_m, pixel_m, shape)
        blank = np.zeros(shape, np.uint8), np.zeros(shape, bool)
        near = map_pixels[np.isfinite(map_pixels).all(axis=-1)]
        if not len(near):
            return blank
        reduction = max(1, int(pixel_m / self.resolution_m + 0.01))
        first = np.maximum(np.floor(near.min(axis=0) / reduction - 2).astype(int), 0) * reduction
        last = np.minimum(np.ceil(near.max(axis=0)).astype(int) + 3 * reduction, self.shape[::-1])
        size = (last - first) // reduction
        if (size < 2).any():
            return blank
        last = first + size * reduction
        window = ((int(first[1]), int(last[1])), (int(first[0]), int(last[0])))
        try:
            with open_dataset(self.path) as dataset:
                out_shape, mean = (int(size[1]), int(size[0])), rasterio.enums.Resampling.average
                values = dataset.read(1, window=window, out_shape=out_shape, resampling=mean, masked=True)
        except rasterio.errors.RasterioError as error:
            raise FileFormatError(self.path, f"pixels could not be read: {error}") from error
        image, valid = eight_bit(values)
        place = (
            np.nan_to_num(map_pixels, nan=-1e6, posinf=-1e6, neginf=-1e6) - first + 0.5
        ) / reduction - 0.5
        x, y = (np.ascontiguousarray(place[..., k], dtype=np.float32) for k in (0, 1))
        seen = cv2.remap(valid.astype(np.uint8), x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
        return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), seen.astype(bool)

    def _map_pixels(
        self, plane: TangentPlane, west_m: float, north_m: float, pixel_m: float, shape: tuple[int, int]
    ) -> Floats:
        """Pixels of the map under those of a view, shape (lines, samples, 2), interpolated between nodes."""
        nodes = [np.linspace(0.0, n - 1.0, 2 + (n - 1) // _NODE_PIXELS) for n in shape]
        east, north = np.meshgrid(west_m + pixel_m * nodes[1], north_m - pixel_m * nodes[0])
        degrees = plane.to_longitude_latitude(np.column_stack([east.ravel(), north.ravel()]))
        lost = np.asarray(np.isnan(degrees).any(axis=1))
        pixels = self.pixels(np.where(lost[:, np.newaxis], 0.0, degrees))
        pixels[lost] = np.nan
        if self._grid.columns_around is not None:  # a view over the seam goes on beyond it
            around = self._grid.columns_around
            pixels[:, 0] -= around * np.round((pixels[:, 0] - pixels[len(pixels) // 2, 0]) / around)
        by_line, by_sample = (_linear(n, at) for n, at in zip(shape, nodes, strict=True))
        at_nodes = pixels.reshape(*east.shape, 2)
        return np.stack([by_line @ at_nodes[..., k] @ by_sample.T for k in (0, 1)], axis=-1)


def _linear(count: int, nodes: Floats) -> Floats:
    """Weights of values at nodes for linear interpolation at 0, 1, ... count - 1, shape (count, nodes)."""
    place = np.arange(count) / max(nodes[1] - nodes[0], 1e-9) if len(nodes) > 1 else np.zeros(count)
    return np.clip(1.0 - np.abs(place[:, np.newaxis] - np.arange(len(nodes))), 0.0, None)


def _pairs(values: Any, what: str) -> Floats:
    pairs = np.asarray(values, dtype=np.float64)
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise InputError(f"{what} have shape {pairs.shape}; give pairs, shape (n, 2)")
    return pairs
