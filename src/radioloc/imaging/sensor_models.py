"""Sensor models: from pixels to rays and the ground, and from the ground to pixels, of frame and line-scan cameras.

The collinearity equations with interior and exterior orientation (Wang et al. 2021, equation 6): a point P on the Moon,
the camera's place S and its rotation R have P - S = lambda R c, where c is the direction of the pixel in the camera's
axes. All of a frame has one S and R; each line of a line scan has its own, by the time at which it was taken.

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
from radioloc.vectors import Floats

_ITERATIONS = 30
_CONVERGED_LINES = 1e-8
_RATE_STEP_S = 1e-3
"""Half the step of central differences of the orientation: 1e-9 of 1.6 km/s is lost to rounding of positions."""


class Rays(NamedTuple):
    """Rays of pixels, from the camera outward, in the Moon's axes."""

    origins_m: Floats  # (n, 3)
    directions: Floats  # (n, 3), unit vectors


class RayPartials(NamedTuple):
    """Derivatives of rays; the origin is the camera's position."""

    origins_by_pixel: Floats  # (n, 3, 2)
    directions_by_pixel: Floats  # (n, 3, 2)
    directions_by_angles: Floats  # (n, 3, 3)


class ImagePoints(NamedTuple):
    """Pixels of points on the ground, and which points are seen."""

    pixels: Floats  # (n, 2); without meaning where the point is not seen
    # Before the camera while its orientation is known; perhaps beyond the image's edges.
    seen: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class FrameModel:
    """A frame camera.

    Parameters
    ----------
    camera : Camera
    orientation : ConstantOrientation
    shape : tuple of int
        Lines and samples.
    axes : str
        The Moon's axes in which the orientation is.
    """

    camera: Camera
    orientation: ConstantOrientation
    shape: tuple[int, int]
    axes: str = "ME_DE421"

    def rays(self, pixels: ArrayLike) -> Rays:
        """Rays of pixels, shape (n, 2)."""
        pixel = as_points(pixels, 2, "pixels")
        return _rays(*self.orientation.at(pixel[:, 1]), self.camera.directions(pixel))

    def rays_and_partials(self, pixels: ArrayLike) -> tuple[Rays, RayPartials]:
        """As :meth:`rays`, with derivatives."""
        pixel = as_points(pixels, 2, "pixels")
        seen, by_pixel = self.camera.directions_and_partials(pixel)
        position, rotation = self.orientation.at(pixel[:, 1])
        partials = _ray_partials(rotation, seen, np.zeros((len(pixel), 3, 2)), rotation @ by_pixel)
        return _rays(position, rotation, seen), partials

    def project(self, points_m: ArrayLike) -> ImagePoints:
        """Pixels of points, shape (n, 3)."""
        points = as_points(points_m, 3, "points_m")
        return ImagePoints(*self.camera.pixels(_in_camera(*self.orientation.at(points[:, 0]), points)))


@dataclass(frozen=True, slots=True, eq=False)
class LineScanModel:
    """A line-scan (pushbroom) camera, whose detector is the camera's line 0.

    Parameters
    ----------
    camera : Camera
    orientation : Orientation
        Of time, s from the reference epoch.
    line_times : array_like, shape (k, 3)
        The line at which a rate begins, its time, s, and the duration of a line, s, in rising order. A line lasts from
        half a line before its number to half a line after.
    shape : tuple of int
        Lines and samples.
    axes : str
        The Moon's axes in which the orientation is.
    """

    camera: Camera
    orientation: Orientation
    line_times: Floats
    shape: tuple[int, int]
    axes: str = "ME_DE421"

    def __post_init__(self) -> None:
        table = as_points(self.line_times, 3, "line_times")
        if not len(table) or not (table[:, 2] > 0.0).all() or not (np.diff(table[:, :2], axis=0) > 0.0).all():
            raise InputError("line_times: lines and times have to rise, and lines to last longer than 0 s")
        object.__setattr__(self, "line_times", table)

    def times_s(self, lines: Floats) -> tuple[Floats, Floats]:
        """Times at which lines were taken, s, and how long a line lasts there, shape (n,)."""
        start, time_s, step_s = self._rate(np.asarray(lines), 0)
        return time_s + (lines - start) * step_s, step_s

    def lines_at(self, times_s: Floats) -> tuple[Floats, Floats]:
        """Lines that were taken at times, and how long a line lasts there, s, shape (n,)."""
        start, time_s, step_s = self._rate(np.asarray(times_s), 1)
        return start + (times_s - time_s) / step_s, step_s

    def rays(self, pixels: ArrayLike) -> Rays:
        """Return rays of pixels, shape (n, 2); lines need a known orientation."""
        pixel = as_points(pixels, 2, "pixels")
        time_s, _ = self.times_s(pixel[:, 1])
        return _rays(*self.orientation.at(time_s), self.camera.directions(pixel * [1.0, 0.0]))

    def rays_and_partials(self, pixels: ArrayLike) -> tuple[Rays, RayPartials]:
        """As :meth:`rays`, with derivatives."""
        pixel = as_points(pixels, 2, "pixels")
        time_s, step_s = self.times_s(pixel[:, 1])
        seen, by_detector = self.camera.directions_and_partials(pixel * [1.0, 0.0])
        position, rotation = self.orientation.at(time_s)
        velocity, turning = self._rates(time_s)
        origins_by_pixel = np.zeros((len(pixel), 3, 2))
        origins_by_pixel[:, :, 1] = velocity * step_s[:, None]
        by_pixel = rotation @ by_detector
        by_pixel[:, :, 1] = vectors.rotated(turning, seen) * step_s[:, None]
        return _rays(position, rotation, seen), _ray_partials(rotation, seen, origins_by_pixel, by_pixel)

    def project(self, points_m: ArrayLike) -> ImagePoints:
        """Pixels of points, shape (n, 3): the time is sought at which the detector's line sees each point."""
        points = as_points(points_m, 3, "points_m")
        time_s, found = self._seeing_times(points)
        on_detector, seen = self.camera.pixels(_in_camera(*self.orientation.at(time_s), points))
        return ImagePoints(np.stack([on_detector[:, 0], self.lines_at(time_s)[0]], axis=-1), seen & found)

    def _rate(self, values: Floats, column: int) -> tuple[Floats, Floats, Floats]:
        """The rate that holds at lines (column 0) or times (column 1); the first one also before its start."""
        index = np.searchsorted(self.line_times[:, column], values, side="right") - 1
        start, time_s, step_s = self.line_times[np.maximum(index, 0)].T
        return start, time_s, step_s

    @property
    def _span_s(self) -> tuple[float, float]:
        """When the image was taken, as far as the orientation is known."""
        edges, _ = self.times_s(np.array([-0.5, self.shape[0] - 0.5]))
        first, last = self.orientation.span_s
        return max(float(edges[0]), first), min(float(edges[1]), last)

    def _rates(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Velocities, m/s, shape (n, 3), and derivatives of rotations, 1/s, shape (n, 3, 3)."""
        first, last = self.orientation.span_s
        before, after = np.maximum(time_s - _RATE_STEP_S, first), np.minimum(time_s + _RATE_STEP_S, last)
        (position_0, rotation_0), (position_1, rotation_1) = map(self.orientation.at, (before, after))
        step_s = after - before
        return (position_1 - position_0) / step_s[:, None], (rotation_1 - rotation_0) / step_s[:, None, None]

    def _seeing_times(self, points: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Times at which the detector's line sees points, and whether there is one; at first without distortion."""
        time_s = self._nearest_times(points)
        for camera in (replace(self.camera, distortion=Distortion("none", ())), self.camera):
            time_s, found = self._crossings(camera, time_s, points)
        return time_s, found

    def _crossings(self, camera: Camera, time_s: Floats, points: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Times at which points are on the camera's line 0, by the secant method, and whether there is one."""
        first, last = self._span_s
        line_s = float(self.line_times[:, 2].min())
        least_s = _CONVERGED_LINES * line_s
        earlier_s = np.where(time_s + line_s < last, time_s + line_s, time_s - line_s)
        time_s = time_s.copy()
        offset_before = self._detector_lines(camera, earlier_s, points)
        found = np.zeros(len(points), dtype=bool)
        active = np.arange(len(points))
        for _ in range(_ITERATIONS):
            offset = self._detector_lines(camera, time_s[active], points[active])
            with np.errstate(divide="ignore", invalid="ignore"):
                step_s = offset * (time_s[active] - earlier_s[active]) / (offset_before[active] - offset)
            step_s = np.where(np.isfinite(step_s), step_s, 0.0)
            earlier_s[active], offset_before[active] = time_s[active], offset
            moved_s = np.clip(time_s[active] + step_s, first, last)
            done = np.abs(moved_s - time_s[active]) <= least_s
            # at an end of the orientation the time stands still, though the detector does not see the point
            found[active[done & (np.abs(step_s) <= 2.0 * least_s)]] = True
            time_s[active] = moved_s
            active = active[~done]
            if not len(active):
                break
        return time_s, found

    def _nearest_times(self, points: Floats) -> Floats:
        """Of some times spread over the image, that at which each point is nearest to the camera's axis."""
        first, last = self._span_s
        count = 2 + int((last - first) / 20.0)  # in 20 s an orbiter moves by 0.3 of its height or less
        times_s = np.linspace(first, last, 2 * count + 1)[1::2]
        positions, rotations = self.orientation.at(times_s)
        axis = self.camera.directions(np.array([[0.5 * (self.shape[1] - 1), 0.0]]))[0]
        best, cosine = np.full(len(points), times_s[0]), np.full(len(points), -np.inf)
        for time_s, position, rotation in zip(times_s, positions, rotations, strict=True):
            from_camera = points - position
            here = (from_camera @ (rotation @ axis)) / vectors.length(from_camera)
            best[here > cosine] = time_s
            cosine = np.maximum(cosine, here)
        return best

    def _detector_lines(self, camera: Camera, time_s: Floats, points: Floats) -> Floats:
        """How far on the focal plane points are from the detector's line, lines."""
        return camera.pixels(_in_camera(*self.orientation.at(time_s), points))[0][:, 1]


SensorModel = FrameModel | LineScanModel


def require_mean_earth(model: SensorModel) -> None:
    """Refuse a model in other axes than elevation maps and positions."""
    if not model.axes.startswith("ME_"):
        raise InputError(
            f"the model's points are in {model.axes}, not in mean-Earth axes as elevation maps; read the model with "
            "axes='ME_DE421'"
        )


def inside(model: SensorModel, pixels: Floats) -> NDArray[np.bool_]:
    """Whether pixels are in the image, shape (n,)."""
    lines, samples = model.shape
    return np.asarray(((pixels >= -0.5) & (pixels < [samples - 0.5, lines - 0.5])).all(axis=-1))


def _rays(position: Floats, rotation: Floats, seen: Floats) -> Rays:
    """Rays with unit directions, from directions in the camera's axes."""
    turned = vectors.rotated(rotation, seen)
    return Rays(np.array(position), turned / vectors.length(turned)[:, None])


def _ray_partials(rotation: Floats, seen: Floats, origins_by_pixel: Floats, by_pixel: Floats) -> RayPartials:
    """From directions in the camera's axes and derivatives of the turned directions."""
    size = vectors.length(seen)[:, None]
    direction = vectors.rotated(rotation, seen) / size
    across = (np.eye(3) - direction[:, :, None] * direction[:, None, :]) / size[:, :, None]
    return RayPartials(origins_by_pixel, across @ by_pixel, across @ rotation @ -vectors.cross_matrices(seen))


def _in_camera(position: Floats, rotation: Floats, points: Floats) -> Floats:
    """Points in the camera's axes."""
    return vectors.rotated(np.swapaxes(rotation, 1, 2), points - position)
