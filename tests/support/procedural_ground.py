"""Procedural ground with craters of all sizes: heights, images and maps."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import procedural_ground_kernels as kernels
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.imaging.sensor_models import FrameModel
from radioloc.imaging.shading import LUNAR_LAMBERT, brightness_of_slopes, to_eight_bits
from radioloc.lunar.map_files import new_geotiff
from radioloc.lunar.map_grid import load_rasterio
from radioloc.lunar.maps import TangentPlane

Floats = NDArray[np.float64]

_BLOCK_LINES = 64


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Relief of fractal slopes and craters; one seed is one relief.

    Each octave of wavelengths has gradient noise with slopes of some 5 degrees, and craters in 60 % of its cells, from
    fresh to worn; so the number of craters is the inverse square of their size. Shadows are not cast.
    """

    # Places are east and north of the point of contact, projected from the point on the sphere.
    plane: TangentPlane
    seed: int = 0
    level_m: float = 0.0  # of the ground under the relief, above the 1737.4 km sphere
    largest_m: float = 4000.0  # longest wavelength of the relief; craters are up to half as wide
    relief: float = 1.0  # factor of heights; 0 is the picture of the relief on flat ground

    def heights_at_m(self, east_north_m: ArrayLike, pixel_m: float) -> Floats:
        """Return heights above the 1737.4 km sphere at places, shape (n, 2), smoothed to the size of pixels, m."""
        return self._relief(np.ascontiguousarray(east_north_m, dtype=np.float64), pixel_m)[:, 0]

    def seen_by(self, model: FrameModel, sun: Floats) -> tuple[Floats, Floats]:
        """Return brightness, shape (lines, samples), and places (east, north, height, m) in the view of a camera.

        The Sun's unit vector is east, north, up at the point of contact; brightness is 1 along its rays.
        """
        lines, samples = model.shape
        brightness, points = np.empty((lines, samples)), np.empty((lines, samples, 3))

        def block(first: int) -> int:
            last = min(first + _BLOCK_LINES, lines)
            pixels = np.stack(np.meshgrid(np.arange(samples), np.arange(first, last)), axis=-1).reshape(-1, 2)
            of_block = brightness[first:last].reshape(-1), points[first:last].reshape(-1, 3)
            return self._look(model, sun, pixels, *of_block)

        if missed := sum(_by_threads(block, range(0, lines, _BLOCK_LINES))):
            raise InputError(f"{missed} pixels look past the ground; tilt the camera less")
        return brightness, points

    def point_seen(self, model: FrameModel, pixel: ArrayLike) -> Floats:
        """Return east, north and height of the ground at a pixel (sample, line), m, shape (3,)."""
        points = np.empty((1, 3))
        if self._look(model, np.array([0.0, 0.0, 1.0]), np.reshape(pixel, (1, 2)), np.empty(1), points):
            raise InputError(f"pixel {pixel!r} looks past the ground")
        return points[0]

    def write_map(
        self,
        path: str | Path,
        pixel_m: float,
        width_m: float,
        sun: Floats,
        shift_m: tuple[float, float] = (0.0, 0.0),
        noise: float = 2.0,
    ) -> None:
        """Write a map image about the point of contact as GeoTIFF, equidistant cylindrical, eight bits.

        The map is displaced by `shift_m` to the east and north.
        """

        def values(relief: Floats) -> NDArray[np.uint8]:
            _, by_east, by_north, albedo = relief.T
            bright = albedo * brightness_of_slopes(by_east, by_north, sun)
            return as_bytes(bright, sun, noise, self.seed + 1)

        self._write(path, pixel_m, width_m, shift_m, "uint8", values)

    def write_heights(
        self, path: str | Path, pixel_m: float, width_m: float, shift_m: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """Write an elevation model as GeoTIFF, m above the 1737.4 km sphere; parameters as of :meth:`write_map`."""
        self._write(
            path, pixel_m, width_m, shift_m, "float32", lambda relief: relief[:, 0].astype(np.float32)
        )

    def _write(
        self,
        path: str | Path,
        pixel_m: float,
        width_m: float,
        shift_m: tuple[float, float],
        dtype: str,
        values: Callable[[Floats], Any],
    ) -> None:
        rasterio = load_rasterio()
        size = max(2, round(width_m / pixel_m))
        # By the definition of the projection: x = R cos(lat_ts) (lon - lon_0), y = R (lat - lat_0).
        per_degree = np.radians(MEAN_LUNAR_RADIUS_M)
        scale = np.array([per_degree * np.cos(np.radians(self.plane.latitude_deg)), per_degree])
        crs = (
            f"+proj=eqc +lat_ts={self.plane.latitude_deg!r} +lat_0={self.plane.latitude_deg!r} "
            f"+lon_0={self.plane.longitude_deg!r} +R={MEAN_LUNAR_RADIUS_M!r} +units=m +no_defs"
        )
        edge = 0.5 * size * pixel_m
        transform = rasterio.Affine(pixel_m, 0.0, shift_m[0] - edge, 0.0, -pixel_m, shift_m[1] + edge)
        middle = (np.arange(size) - 0.5 * (size - 1)) * pixel_m
        with new_geotiff(path, crs, transform, (size, size), dtype) as file:

            def block(first: int) -> Any:
                last = min(first + _BLOCK_LINES, size)
                xy = np.stack(np.meshgrid(middle, -middle[first:last]), axis=-1).reshape(-1, 2)
                degrees = xy / scale + [self.plane.longitude_deg, self.plane.latitude_deg]
                relief = self._relief(self.plane.from_longitude_latitude(degrees), pixel_m)
                return first, values(relief).reshape(last - first, size)

            for first, band in _by_threads(block, range(0, size, _BLOCK_LINES)):
                file.write(band, 1, window=((first, first + len(band)), (0, size)))

    def _look(
        self, model: FrameModel, sun: Floats, pixels: ArrayLike, brightness: Floats, points_m: Floats
    ) -> int:
        """Fill in brightness and places of pixels; return the number of pixels without ground."""
        rays = model.rays(pixels)
        axes = self.plane.axes()
        missed: int = kernels.look(
            axes @ rays.origins_m[0],
            np.ascontiguousarray(rays.directions @ axes.T),
            abs(np.linalg.det(model.camera.pixel_per_mm)) ** -0.5 / model.camera.focal_length_mm,
            MEAN_LUNAR_RADIUS_M,
            sun,
            np.array(LUNAR_LAMBERT),
            *self._of_relief(),
            brightness,
            points_m,
        )
        return missed

    def _relief(self, east_north_m: Floats, pixel_m: float) -> Floats:
        out = np.empty((len(east_north_m), 4))
        kernels.heights(np.ascontiguousarray(east_north_m), pixel_m, *self._of_relief(), out)
        return out

    def _of_relief(self) -> tuple[Any, ...]:
        return self.largest_m, np.uint64(self.seed), self.level_m, self.relief


def as_bytes(brightness: Floats, sun: Floats, noise: float, seed: int) -> NDArray[np.uint8]:
    """Return eight bits with noise of a standard deviation."""
    drawn = np.random.default_rng([seed, brightness.size]).normal(0.0, noise, brightness.shape)
    return to_eight_bits(brightness, sun, drawn)


def _by_threads(work: Callable[[int], Any], items: range) -> list[Any]:
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(work, items))
