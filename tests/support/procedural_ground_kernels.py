"""Compiled loops: fractal relief and craters of all sizes from hashes of places, and intersections of rays."""

import math

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SLOPE = 0.1
"""Amplitude of each octave of fractal relief over its wavelength: slopes of some 5 degrees on all scales."""
CRATER_SHARE = 0.6
"""Cells of each octave that have a crater: as many for each octave as the square of 1/size."""
DEPTH, RIM = 0.36, 0.06
"""Of fresh craters over their radius."""
ALBEDO = 0.04
"""Amplitude of each octave of brightness."""
FINEST = 5.0
"""Pixels of the shortest wavelength with full amplitude, which decreases to zero at three pixels."""
MOST_STEPS = 25

_K1 = np.uint64(0x9E3779B97F4A7C15)
_K2 = np.uint64(0xC2B2AE3D27D4EB4F)
_K3 = np.uint64(0x165667B19E3779F9)
_K4 = np.uint64(0xBF58476D1CE4E5B9)
_S30, _S27, _S31 = np.uint64(30), np.uint64(27), np.uint64(31)
_PART = np.uint64(0xFFF)


@numba.njit(cache=True, nogil=True)
def _mixed(i: int, j: int, octave: int, seed: np.uint64) -> np.uint64:
    """Return a hash of a cell (the finalizer of splitmix64)."""
    h = seed + np.uint64(i) * _K1 + np.uint64(j) * _K2 + np.uint64(octave) * _K3
    h = (h ^ (h >> _S30)) * _K4
    h = (h ^ (h >> _S27)) * _K2
    return h ^ (h >> _S31)


@numba.njit(cache=True, nogil=True)
def _uniform(h: np.uint64, part: int) -> float:
    """Return a number from 0 to 1 from twelve bits of a hash, parts 0 to 4."""
    return (float((h >> np.uint64(12 * part)) & _PART) + 0.5) / 4096.0


@numba.njit(cache=True, nogil=True)
def _noise(x: float, y: float, octave: int, seed: np.uint64) -> tuple[float, float, float]:
    """Return gradient noise of unit wavelength, and its derivatives."""
    i, j = math.floor(x), math.floor(y)
    fx, fy = x - i, y - j
    u, v = fx * fx * fx * (fx * (fx * 6.0 - 15.0) + 10.0), fy * fy * fy * (fy * (fy * 6.0 - 15.0) + 10.0)
    du, dv = 30.0 * fx * fx * (fx - 1.0) ** 2, 30.0 * fy * fy * (fy - 1.0) ** 2
    value, by_x, by_y = 0.0, 0.0, 0.0
    for a in range(2):
        for b in range(2):
            h = _mixed(i + a, j + b, octave, seed)
            gx, gy = 2.0 * _uniform(h, 0) - 1.0, 2.0 * _uniform(h, 1) - 1.0
            wx, wy = (u if a else 1.0 - u), (v if b else 1.0 - v)
            slope = gx * (fx - a) + gy * (fy - b)
            value += wx * wy * slope
            by_x += wx * wy * gx + (du if a else -du) * wy * slope
            by_y += wx * wy * gy + (dv if b else -dv) * wx * slope
    return value, by_x, by_y


@numba.njit(cache=True, nogil=True)
def _craters(x: float, y: float, octave: int, seed: np.uint64) -> tuple[float, float, float]:
    """Return craters of one size, in cells of unit width, and the derivatives of the height.

    They reach half a cell, so that none of the other cells than the nearest four matters.
    """
    i, j = math.floor(x - 0.5), math.floor(y - 0.5)
    value, by_x, by_y = 0.0, 0.0, 0.0
    for a in range(2):
        for b in range(2):
            h = _mixed(i + a, j + b, octave, seed ^ _K3)
            if _uniform(h, 4) > CRATER_SHARE:
                continue
            dx, dy = x - (i + a + _uniform(h, 0)), y - (j + b + _uniform(h, 1))
            d2 = dx * dx + dy * dy
            radius = 0.12 + 0.13 * _uniform(h, 2)
            if d2 >= 4.0 * radius * radius:
                continue
            s = math.sqrt(d2) / radius
            fresh = radius * (0.15 + 0.85 * _uniform(h, 3) ** 2)
            if s < 1.0:
                value += fresh * (DEPTH * (s * s - 1.0) + RIM)
                slope = 2.0 * fresh * DEPTH
            else:
                value += fresh * RIM * (2.0 - s) ** 3
                slope = -3.0 * fresh * RIM * (2.0 - s) ** 2 / s
            by_x += slope * dx / (radius * radius)
            by_y += slope * dy / (radius * radius)
    return value, by_x, by_y


@numba.njit(cache=True, nogil=True)
def height(
    x: float, y: float, pixel_m: float, largest_m: float, seed: np.uint64, level_m: float
) -> tuple[float, float, float]:
    """Return the height at a place, and its derivatives by east and north.

    What is finer than the pixels that look at it is left out.
    """
    value, by_x, by_y = level_m, 0.0, 0.0
    wavelength, octave = largest_m, 0
    while True:
        weight = min((wavelength / pixel_m - 3.0) / (FINEST - 3.0), 1.0)
        if weight <= 0.0:
            return value, by_x, by_y
        u, v = x / wavelength, y / wavelength
        h, hx, hy = _noise(u, v, octave, seed)
        c, cx, cy = _craters(u, v, octave, seed)
        value += weight * wavelength * (SLOPE * h + c)
        by_x += weight * (SLOPE * hx + cx)
        by_y += weight * (SLOPE * hy + cy)
        wavelength *= 0.5
        octave += 1


@numba.njit(cache=True, nogil=True)
def _albedo(x: float, y: float, pixel_m: float, largest_m: float, seed: np.uint64) -> float:
    """Return the albedo of the ground, about 1."""
    albedo, wavelength, octave = 1.0, largest_m, 0
    while True:
        weight = min((wavelength / pixel_m - 3.0) / (FINEST - 3.0), 1.0)
        if weight <= 0.0:
            return albedo
        value, _, _ = _noise(x / wavelength + 0.37, y / wavelength + 0.71, octave, seed ^ _K4)
        albedo += weight * ALBEDO * value
        wavelength *= 0.5
        octave += 1


@numba.njit(cache=True, nogil=True)
def look(
    origin_m: Floats,
    directions: Floats,
    slope_per_pixel: float,
    radius_m: float,
    sun: Floats,
    weights: Floats,
    largest_m: float,
    seed: np.uint64,
    level_m: float,
    relief: float,
    brightness: Floats,
    points_m: Floats,
) -> int:
    """Compute brightness and place of the ground on unit rays from a point; return the number without ground.

    Axes are east, north and up at the plane's point of contact, from the Moon's centre. Places on the ground are
    orthographic projections of the point on the sphere. Heights are multiplied by `relief`, slopes in the shading not.
    """
    missed = 0
    radial_m = math.sqrt(origin_m[0] ** 2 + origin_m[1] ** 2 + origin_m[2] ** 2)
    # The first ray starts from the height of the ground below the camera, which may be below the sphere.
    nadir_m, _, _ = height(
        radius_m * origin_m[0] / radial_m,
        radius_m * origin_m[1] / radial_m,
        slope_per_pixel,
        largest_m,
        seed,
        level_m,
    )
    nadir_m = level_m + relief * (nadir_m - level_m)
    level = nadir_m
    for k in range(len(directions)):
        dx, dy, dz = directions[k, 0], directions[k, 1], directions[k, 2]
        cosine = (origin_m[0] * dx + origin_m[1] * dy + origin_m[2] * dz) / radial_m
        # Sphere at the height of the previous intersection.
        c = radial_m * radial_m - (radius_m + level) ** 2
        b = radial_m * cosine
        root = b * b - c
        if b >= 0.0 or root <= 0.0:
            missed += 1
            brightness[k] = 0.0
            points_m[k, 0] = points_m[k, 1] = points_m[k, 2] = math.nan
            continue
        t = -b - math.sqrt(root)
        h, hx, hy, x, y, r, pixel_m = 0.0, 0.0, 0.0, 0.0, 0.0, radial_m, 0.0
        px, py, pz = 0.0, 0.0, 0.0
        settled = False
        upper, lower = 0.0, math.inf  # distances above and below the ground
        for _ in range(MOST_STEPS):
            px, py, pz = origin_m[0] + t * dx, origin_m[1] + t * dy, origin_m[2] + t * dz
            r = math.sqrt(px * px + py * py + pz * pz)
            x, y = radius_m * px / r, radius_m * py / r
            pixel_m = t * slope_per_pixel
            h, hx, hy = height(x, y, pixel_m, largest_m, seed, level_m)
            h = level_m + relief * (h - level_m)
            clearance = r - radius_m - h
            fall = (px * dx + py * dy + pz * dz) / r
            # Newton's step, bounded for steep ground.
            steep = fall - relief * (hx * (dx - fall * px / r) + hy * (dy - fall * py / r))
            if steep > 0.5 * fall:
                steep = 0.5 * fall
            if t < lower:
                if clearance > 0.0:
                    upper = t
                else:
                    lower = t
            t -= clearance / steep
            if abs(clearance) < 0.05 * pixel_m:
                settled = True
                break
            # Over rough ground, steps may oscillate between the sides of a rim.
            if not upper < t < lower:
                t = 0.5 * (upper + lower)
        if not settled:
            missed += 1
        level = h if radius_m + h < radial_m else nadir_m
        points_m[k, 0], points_m[k, 1], points_m[k, 2] = x, y, h
        # Normal in local horizontal axes.
        ux, uy, uz = px / r, py / r, pz / r
        nx, ny, nz = ux - hx, uy - hy, uz + hx * ux + hy * uy
        size = math.sqrt(nx * nx + ny * ny + nz * nz)
        mu0 = (nx * sun[0] + ny * sun[1] + nz * sun[2]) / size
        mu = -(nx * dx + ny * dy + nz * dz) / size
        if mu0 <= 0.0 or mu <= 0.0:
            brightness[k] = 0.0
            continue
        phase = math.degrees(math.acos(min(max(-(sun[0] * dx + sun[1] * dy + sun[2] * dz), -1.0), 1.0)))
        lommel = weights[0] + phase * (weights[1] + phase * (weights[2] + phase * weights[3]))
        albedo = _albedo(x, y, pixel_m, largest_m, seed)
        brightness[k] = albedo * (2.0 * lommel * mu0 / (mu0 + mu) + (1.0 - lommel) * mu0)
    return missed


@numba.njit(cache=True, nogil=True)
def heights(
    east_north_m: Floats,
    pixel_m: float,
    largest_m: float,
    seed: np.uint64,
    level_m: float,
    relief: float,
    out: Floats,
) -> None:
    """Compute heights of places, slopes of the shading and albedos, shape (n, 4)."""
    for k in range(len(east_north_m)):
        x, y = east_north_m[k, 0], east_north_m[k, 1]
        h, out[k, 1], out[k, 2] = height(x, y, pixel_m, largest_m, seed, level_m)
        out[k, 0] = level_m + relief * (h - level_m)
        out[k, 3] = _albedo(x, y, pixel_m, largest_m, seed)
