"""Sensor models of frame and line-scan cameras: pixels to rays, and points on the ground to pixels.

Collinearity equations with interior and exterior orientation (Wang et al. 2021, equation 6): for a point P on the Moon,
the camera's position S and its rotation R, P - S = lambda R c, where c is the direction of the pixel in the camera's
axes. A frame has one S and R; each line of a line scan has its own, by its time.

Errors of the orientation are three components of S in the Moon's axes, and three small angles about the camera's
axes, R (1 + [angles x]); the same for all pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc import vectors
from radioloc.errors import InputError
from radioloc.imaging.cameras import Camera, as_points
from radioloc.imaging.distortion import Distortion
from radioloc.imaging.orientation import ConstantOrientation, Orientation
from radioloc.units import set_fields
from radioloc.vectors import Floats

_MAX_ITERATIONS = 30
_TOLERANCE_LINES = 1e-8
# Half the step of central differences of the orientation: 1e-9 of 1.6 km/s is lost to rounding of positions.
_RATE_STEP_S = 1e-3
# Longest spacing of the start epochs of a search: in 20 s an orbiter moves by 0.3 of its height or less.
_MAX_START_SPACING_S = 20.0


class Rays(NamedTuple):
    """Rays from the camera through pixels, in the Moon's axes."""

    origins_m: Floats  # (n, 3)
    directions: Floats  # (n, 3), unit vectors


class RayPartials(NamedTuple):
    """Derivatives of rays; the origin is the camera position."""

    origins_by_pixel: Floats  # (n, 3, 2)
    directions_by_pixel: Floats  # (n, 3, 2)
    directions_by_angles: Floats  # (n, 3, 3)


class ImagePoints(NamedTuple):
    """Pixels of points on the ground."""

    pixels: Floats  # (n, 2); meaningless for points that are not visible
    # In front of the camera at a time that the orientation covers; perhaps outside the image.
    visible: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class FrameModel:
    """Frame camera."""

    camera: Camera
    orientation: ConstantOrientation
    shape: tuple[int, int]  #: lines and samples
    axes: str = "ME_DE421"  #: axes of the Moon for the orientation

    def rays(self, pixels: ArrayLike) -> Rays:
        """Return rays of pixels, shape (n, 2)."""
        pixel = as_points(pixels, 2, "pixels")
        return _rays(*self.orientation.poses(pixel[:, 1]), self.camera.directions(pixel))

    def positions_m(self, lines: Floats) -> Floats:
        """Return the position of the camera for each line, shape (n, 3)."""
        return self.orientation.poses(lines)[0]

    def rays_and_partials(self, pixels: ArrayLike) -> tuple[Rays, RayPartials]:
        """Return rays of pixels, shape (n, 2), with derivatives."""
        pixel = as_points(pixels, 2, "pixels")
        directions, by_pixel = self.camera.directions_and_partials(pixel)
        position, rotation = self.orientation.poses(pixel[:, 1])
        partials = _ray_partials(rotation, directions, np.zeros((len(pixel), 3, 2)), rotation @ by_pixel)
        return _rays(position, rotation, directions), partials

    def project(self, points_m: ArrayLike) -> ImagePoints:
        """Project points, shape (n, 3), to pixels."""
        points = as_points(points_m, 3, "points_m")
        return ImagePoints(
            *self.camera.pixels(_to_camera_axes(*self.orientation.poses(points[:, 0]), points))
        )


@dataclass(frozen=True, slots=True, eq=False)
class LineScanModel:
    """Line-scan (pushbroom) camera, whose detector is the camera's line 0."""

    camera: Camera
    orientation: Orientation  #: by time, s from the reference epoch
    #: (k, 3), line at which a rate begins, its time, s, and the duration of a line, s, in rising order. A line
    #: lasts from half a line before its number to half a line after.
    line_times: Floats
    shape: tuple[int, int]  #: lines and samples
    axes: str = "ME_DE421"  #: axes of the Moon for the orientation

    def __post_init__(self) -> None:
        table = as_points(self.line_times, 3, "line_times")
        if not len(table) or not (table[:, 2] > 0.0).all() or not (np.diff(table[:, :2], axis=0) > 0.0).all():
            raise InputError("line_times: expected rising lines and times, and positive durations")
        set_fields(self, line_times=table)

    def times_s(self, lines: Floats) -> tuple[Floats, Floats]:
        """Return times of lines, s, and the duration of a line, s, shape (n,)."""
        start, time_s, step_s = self._rate(np.asarray(lines), 0)
        return time_s + (lines - start) * step_s, step_s

    def lines_at(self, times_s: Floats) -> tuple[Floats, Floats]:
        """Return lines at times, and the duration of a line, s, shape (n,)."""
        start, time_s, step_s = self._rate(np.asarray(times_s), 1)
        return start + (times_s - time_s) / step_s, step_s

    def rays(self, pixels: ArrayLike) -> Rays:
        """Return rays of pixels, shape (n, 2), in lines that the orientation covers."""
        pixel = as_points(pixels, 2, "pixels")
        time_s, _ = self.times_s(pixel[:, 1])
        return _rays(*self.orientation.poses(time_s), self.camera.directions(pixel * [1.0, 0.0]))

    def positions_m(self, lines: Floats) -> Floats:
        """Return the positions of the camera at lines, shape (n, 3)."""
        return self.orientation.poses(self.times_s(lines)[0])[0]

    def rays_and_partials(self, pixels: ArrayLike) -> tuple[Rays, RayPartials]:
        """Return rays of pixels, shape (n, 2), with derivatives."""
        pixel = as_points(pixels, 2, "pixels")
        time_s, step_s = self.times_s(pixel[:, 1])
        directions, by_detector = self.camera.directions_and_partials(pixel * [1.0, 0.0])
        position, rotation = self.orientation.poses(time_s)
        velocity, rotation_rate = self._rates(time_s)
        origins_by_pixel = np.zeros((len(pixel), 3, 2))
        origins_by_pixel[:, :, 1] = velocity * step_s[:, None]
        by_pixel = rotation @ by_detector
        by_pixel[:, :, 1] = vectors.rotated(rotation_rate, directions) * step_s[:, None]
        partials = _ray_partials(rotation, directions, origins_by_pixel, by_pixel)
        return _rays(position, rotation, directions), partials

    def project(self, points_m: ArrayLike) -> ImagePoints:
        """Project points, shape (n, 3), to pixels, by the time at which the detector's line passes each point."""
        points = as_points(points_m, 3, "points_m")
        time_s, converged = self._crossing_times(points)
        on_detector, visible = self.camera.pixels(_to_camera_axes(*self.orientation.poses(time_s), points))
        pixels = np.stack([on_detector[:, 0], self.lines_at(time_s)[0]], axis=-1)
        return ImagePoints(pixels, visible & converged)

    def _rate(self, values: Floats, column: int) -> tuple[Floats, Floats, Floats]:
        """Return the rate at lines (column 0) or times (column 1); the first rate also holds before its start."""
        index = np.searchsorted(self.line_times[:, column], values, side="right") - 1
        start, time_s, step_s = self.line_times[np.maximum(index, 0)].T
        return start, time_s, step_s

    @property
    def _span_s(self) -> tuple[float, float]:
        """Times of the image within those of the orientation."""
        edges, _ = self.times_s(np.array([-0.5, self.shape[0] - 0.5]))
        first, last = self.orientation.span_s
        return max(float(edges[0]), first), min(float(edges[1]), last)

    def _rates(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Return velocities, m/s, shape (n, 3), and derivatives of rotations, 1/s, shape (n, 3, 3)."""
        first, last = self.orientation.span_s
        start_s, end_s = np.maximum(time_s - _RATE_STEP_S, first), np.minimum(time_s + _RATE_STEP_S, last)
        (position_0, rotation_0), (position_1, rotation_1) = map(self.orientation.poses, (start_s, end_s))
        step_s = end_s - start_s
        return (position_1 - position_0) / step_s[:, None], (rotation_1 - rotation_0) / step_s[:, None, None]

    def _crossing_times(self, points: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return times at which the detector's line passes points, and convergence; first without distortion."""
        time_s = self._nearest_times(points)
        for camera in (replace(self.camera, distortion=Distortion("none", ())), self.camera):
            time_s, converged = self._crossings(camera, time_s, points)
        return time_s, converged

    def _crossings(self, camera: Camera, time_s: Floats, points: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return times at which points are on the camera's line 0, by the secant method, and convergence."""
        first, last = self._span_s
        line_s = float(self.line_times[:, 2].min())
        tolerance_s = _TOLERANCE_LINES * line_s
        earlier_s = np.where(time_s + line_s < last, time_s + line_s, time_s - line_s)
        time_s = time_s.copy()
        previous = self._detector_offsets(camera, earlier_s, points)
        converged = np.zeros(len(points), dtype=bool)
        active = np.arange(len(points))
        for _ in range(_MAX_ITERATIONS):
            offset = self._detector_offsets(camera, time_s[active], points[active])
            with np.errstate(divide="ignore", invalid="ignore"):
                step_s = offset * (time_s[active] - earlier_s[active]) / (previous[active] - offset)
            step_s = np.where(np.isfinite(step_s), step_s, 0.0)
            earlier_s[active], previous[active] = time_s[active], offset
            moved_s = np.clip(time_s[active] + step_s, first, last)
            done = np.abs(moved_s - time_s[active]) <= tolerance_s
            # At an end of the orientation the time stops changing although the detector does not pass the point.
            converged[active[done & (np.abs(step_s) <= 2.0 * tolerance_s)]] = True
            time_s[active] = moved_s
            active = active[~done]
            if not len(active):
                break
        return time_s, converged

    def _nearest_times(self, points: Floats) -> Floats:
        """Return the time, out of several over the image, at which each point is nearest to the camera's axis."""
        first, last = self._span_s
        count = 2 + int((last - first) / _MAX_START_SPACING_S)
        times_s = np.linspace(first, last, 2 * count + 1)[1::2]
        positions, rotations = self.orientation.poses(times_s)
        axis = self.camera.directions(np.array([[0.5 * (self.shape[1] - 1), 0.0]]))[0]
        best, max_cosine = np.full(len(points), times_s[0]), np.full(len(points), -np.inf)
        for time_s, position, rotation in zip(times_s, positions, rotations, strict=True):
            from_camera = points - position
            cosine = (from_camera @ (rotation @ axis)) / vectors.length(from_camera)
            best[cosine > max_cosine] = time_s
            max_cosine = np.maximum(max_cosine, cosine)
        return best

    def _detector_offsets(self, camera: Camera, time_s: Floats, points: Floats) -> Floats:
        """Return distances of points from the detector's line on the focal plane, lines."""
        return camera.pixels(_to_camera_axes(*self.orientation.poses(time_s), points))[0][:, 1]


SensorModel = FrameModel | LineScanModel


def require_mean_earth(model: SensorModel) -> None:
    """Raise an error for a model that is not in the axes of elevation maps."""
    if not model.axes.startswith("ME_"):
        raise InputError(
            f"expected a sensor model in mean-Earth axes, got {model.axes}; read it with axes='ME_DE421'"
        )


def _rays(position: Floats, rotation: Floats, camera_directions: Floats) -> Rays:
    turned = vectors.rotated(rotation, camera_directions)
    return Rays(np.array(position), turned / vectors.length(turned)[:, None])


def _ray_partials(
    rotation: Floats, camera_directions: Floats, origins_by_pixel: Floats, by_pixel: Floats
) -> RayPartials:
    """Normalize derivatives of turned directions by pixels, and add those by angles about the camera's axes."""
    size = vectors.length(camera_directions)[:, None]
    direction = vectors.rotated(rotation, camera_directions) / size
    across = (np.eye(3) - direction[:, :, None] * direction[:, None, :]) / size[:, :, None]
    by_angles = across @ rotation @ -vectors.cross_matrices(camera_directions)
    return RayPartials(origins_by_pixel, across @ by_pixel, by_angles)


def _to_camera_axes(position: Floats, rotation: Floats, points: Floats) -> Floats:
    """Return points in the camera's axes."""
    return vectors.rotated(np.swapaxes(rotation, 1, 2), points - position)
