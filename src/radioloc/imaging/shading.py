"""Brightness of ground under the Sun: the Lunar-Lambert law, and elevation models shaded by it.

Without a map under a similar Sun, images are registered to an elevation model shaded at their own Sun.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.lunar import TerrainModel
from radioloc.lunar.frames import sun_position_me_m
from radioloc.lunar.map_files import new_geotiff, open_dataset
from radioloc.lunar.maps import Map, TangentPlane
from radioloc.lunar.terrain_source import heights_m
from radioloc.time import Epochs, utc_strings
from radioloc.vectors import Floats

_BLANK = 0
# Weight of the Lommel-Seeliger part: polynomial of the phase angle in degrees, of the Moon (McEwen 1996, LPSC 27).
LUNAR_LAMBERT = (1.0, -0.019, 2.42e-4, -1.46e-6)


def lunar_lambert(cos_incidence: ArrayLike, cos_emission: ArrayLike, phase_rad: ArrayLike) -> Floats:
    """Return the brightness by the Lunar-Lambert law: 1 along the Sun's rays, 0 in shadow."""
    # 2 L mu0 / (mu0 + mu) + (1 - L) mu0 with the cosines mu0 of incidence and mu of emission and L of the phase angle
    # (McEwen 1996). Exposure compensates for the decrease of brightness with the phase angle.
    sun, camera = np.maximum(cos_incidence, 0.0), np.maximum(cos_emission, 0.0)
    weight = np.polynomial.polynomial.polyval(np.degrees(phase_rad), LUNAR_LAMBERT)
    total = np.where(sun + camera > 0.0, sun + camera, 1.0)
    return np.asarray(2.0 * weight * sun / total + (1.0 - weight) * sun)


def brightness_of_slopes(by_east: ArrayLike, by_north: ArrayLike, sun: Floats) -> Floats:
    """Return the brightness, from above, of slopes to the east and north, for a unit vector to the Sun."""
    by_east, by_north = np.asarray(by_east), np.asarray(by_north)
    cos_emission = 1.0 / np.sqrt(1.0 + by_east**2 + by_north**2)
    cos_incidence = (sun[2] - sun[0] * by_east - sun[1] * by_north) * cos_emission
    return lunar_lambert(cos_incidence, cos_emission, math.acos(sun[2]))


def to_eight_bits(brightness: ArrayLike, sun: Floats, noise: ArrayLike = 0.0) -> NDArray[np.uint8]:
    """Return the brightness in eight bits, with level ground at 110."""
    level = float(lunar_lambert(sun[2], 1.0, math.acos(sun[2])))
    grey = 110.0 / level * np.asarray(brightness) + np.asarray(noise)
    return np.clip(np.rint(np.nan_to_num(grey)), 0, 255).astype(np.uint8)


def sun_direction(azimuth_deg: float, elevation_deg: float) -> Floats:
    """Return the unit vector (east, north, up) to the Sun; its azimuth counts from north over east."""
    if not (0.0 < elevation_deg <= 90.0 and math.isfinite(azimuth_deg)):
        raise InputError(
            f"sun: expected a finite azimuth and an elevation above 0 and up to 90 degrees, got {azimuth_deg!r} and "
            f"{elevation_deg!r}"
        )
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    level = math.cos(elevation)
    return np.array([math.sin(azimuth) * level, math.cos(azimuth) * level, math.sin(elevation)])


def write_shaded_map(
    path: str | Path, dem: str | Path, sun_azimuth_deg: float, sun_elevation_deg: float
) -> None:
    """Write an elevation model, shaded by the Lunar-Lambert law, as GeoTIFF in its projection; 0 without height."""
    sun = sun_direction(sun_azimuth_deg, sun_elevation_deg)
    metadata = TerrainModel.open(dem).metadata
    base = Map.open(dem)
    sun_me = base.plane().axes().T @ sun
    with open_dataset(Path(dem)) as source:
        crs, transform = source.crs, source.transform
    with new_geotiff(path, crs, transform, base.shape, "uint8", _BLANK) as file:
        for _, window in file.block_windows(1):
            # One more cell on each side makes slopes continuous over the edges of blocks.
            rows, columns = (
                np.clip(np.arange(part.start - 1, part.stop + 1), 0, size - 1)
                for part, size in zip(window.toslices(), base.shape, strict=True)
            )
            heights = heights_m(metadata, *np.meshgrid(rows, columns, indexing="ij"))
            by_line, by_sample = (np.asarray(part)[1:-1, 1:-1] for part in np.gradient(heights))
            plane, to_m = _metres_by_pixel(base, columns.mean(), rows.mean())
            to_px = np.linalg.inv(to_m)
            by_east, by_north = (by_sample * to_px[0, k] + by_line * to_px[1, k] for k in (0, 1))
            bright = brightness_of_slopes(by_east, by_north, plane.axes() @ sun_me)
            band = np.maximum(to_eight_bits(bright, sun), _BLANK + 1)
            band = np.where(np.isfinite(heights[1:-1, 1:-1]), band, _BLANK).astype(np.uint8)
            file.write(band, 1, window=window)


def sun_over_map(base: Map, epoch: Epochs) -> tuple[float, float]:
    """Return azimuth and elevation of the Sun, deg, at the middle of a map at an epoch, UTC (DE421)."""
    east, north, up = base.plane().axes() @ sun_position_me_m(epoch)[0] - [0.0, 0.0, MEAN_LUNAR_RADIUS_M]
    elevation_deg = math.degrees(math.atan2(up, math.hypot(east, north)))
    if elevation_deg <= 0.0:
        raise InputError(
            f"at {utc_strings(epoch, 0)[0]} UTC the Sun is {-elevation_deg:.1f} degrees below the horizon at the "
            f"middle of {base.path}; give the epoch of its image"
        )
    return math.degrees(math.atan2(east, north)) % 360.0, elevation_deg


def _metres_by_pixel(base: Map, sample: float, line: float) -> tuple[TangentPlane, Floats]:
    """Return the plane at a pixel, and derivatives of east and north, m, by sample and line, shape (2, 2)."""
    longitude_deg, latitude_deg = base.longitude_latitude_deg([[sample, line]])[0]
    plane = TangentPlane(float(longitude_deg), float(latitude_deg))
    steps = np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
    ends = plane.from_longitude_latitude(base.longitude_latitude_deg(np.add(steps, [sample, line])))
    return plane, np.column_stack([ends[0] - ends[1], ends[2] - ends[3]])
