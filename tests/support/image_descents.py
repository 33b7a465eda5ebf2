"""Descent over procedural ground: map as GeoTIFF, frames from high to low, true places."""

from dataclasses import dataclass, field
from functools import cache, cached_property

import cv2
import numpy as np
from rasterio.crs import CRS
from rasterio.transform import Affine
from scenes import frame, frame_matrix, ground
from terrain_maps import R, write_raster

from radioloc.imaging.homography import transformed
from radioloc.imaging.image_chain import Frame
from radioloc.lunar.maps import TangentPlane

SITE = (-19.51, 44.12)  # degrees
PIXEL_M = 2.0  # of the ground


@cache
def scene(seed=1, sun_deg=0.0):
    return ground(seed, 2000, 2500, sun_deg)


@dataclass(frozen=True)
class Descent:
    """Frames of 500 x 400 pixels; the first show 0.6 of the ground, the last 30 m."""

    frames: int = 16
    seed: int = 1
    map_seed: int = 1
    map_pixel_m: float = 4.0
    shift_m: tuple[float, float] = (0.0, 0.0)  # of the map, east and north
    spacecraft: bool = False
    tilt: float = 2e-4  # of the first frames, per pixel
    shape: tuple[int, int] = (400, 500)
    changed: dict = field(default_factory=dict)  # replaced frames

    def matrix(self, k):
        """Return the matrix from pixels of a frame to those of the ground, whose centre is the site."""
        pixel = 2.6 * 0.8**k
        tilt = self.tilt * max(0.0, 1.0 - k / 5.0)
        return frame_matrix(
            (1040.0 - 40.0 * 0.8**k, 990.0 + 30.0 * 0.8**k), pixel, 4.0 * k, (tilt, tilt), self.shape
        )

    def image(self, k):
        if k in self.changed:
            return self.changed[k]()
        return frame(scene(self.seed), self.matrix(k), self.shape, seed=k, spacecraft=self.spacecraft)

    @cached_property
    def list(self):
        return [Frame(f"{k:04d}.png", lambda k=k: self.image(k)) for k in range(self.frames)]

    def truth_deg(self, k, pixel=None):
        """Return longitude and latitude of a pixel, by default of the centre, deg."""
        centre = 0.5 * (np.array(self.shape[::-1]) - 1.0)
        ground_px = transformed(self.matrix(k), np.reshape(centre if pixel is None else pixel, (1, 2)))[0]
        plane_m = (ground_px - 999.5) * [PIXEL_M, -PIXEL_M]
        return TangentPlane(*SITE).to_longitude_latitude(plane_m[np.newaxis])[0]

    def error_m(self, point, k):
        """Return the error of an estimate, east and north, m."""
        plane = TangentPlane(*SITE)
        return np.diff(
            plane.from_longitude_latitude([self.truth_deg(k), [point.longitude_deg, point.latitude_deg]]),
            axis=0,
        )[0]

    def write_map(self, path):
        """Write the map with larger pixels, in the orthographic projection about the site."""
        factor = self.map_pixel_m / PIXEL_M
        size = int(2000 / factor)
        image = cv2.resize(scene(self.map_seed), (size, size), interpolation=cv2.INTER_AREA)
        noisy = image + np.random.default_rng(77).normal(0.0, 2.0, image.shape)
        half = 2000 * PIXEL_M / 2.0
        west, north = -half + self.shift_m[0], half + self.shift_m[1]
        crs = CRS.from_string(f"+proj=ortho +lon_0={SITE[0]} +lat_0={SITE[1]} +R={R}")
        transform = Affine(self.map_pixel_m, 0.0, west, 0.0, -self.map_pixel_m, north)
        return write_raster(path, np.clip(noisy, 0, 255).astype(np.uint8), crs=crs, transform=transform)
