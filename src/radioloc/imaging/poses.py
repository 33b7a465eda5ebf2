r"""Images of relief by a known camera: the place and the attitude of each.

The place X in the plane has the point :math:`P = (R + h) u(X)` of the sphere's radius R, the height h of an elevation
model and the direction u. It is seen at (Wang et al. 2021, equation 6)

.. math:: p \simeq K Q (P - C)

with the camera's place C, the rotation Q to its axes, and K of the focal length and the principal point. So relief, the
Moon's curvature and what is oblique move no point by more than heights are wrong.

A low image shows a few cells of the model, or one, and lies on slopes that the model does not have. A homography
follows these, and a pose does not; so the images of a descent have one or the other by the size of what they show.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc import vectors
from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.imaging.cameras import Camera
from radioloc.imaging.homography import Homography, of_elements
from radioloc.imaging.maps import TangentPlane
from radioloc.imaging.orientation import rotation_of
from radioloc.imaging.projections import Homographies, Projected, dehomogenized
from radioloc.imaging.surfaces import Terrain
from radioloc.lunar import TerrainModel
from radioloc.lunar.terrain_window import TerrainWindow

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_CELLS_ACROSS = 4.0  # of the elevation model, in an image that it describes


@dataclass(frozen=True, slots=True, eq=False)
class Relief:
    """Heights of an elevation model at places in a plane; points are in the plane's east, north and up."""

    plane: TangentPlane
    model: TerrainModel
    window: TerrainWindow

    @classmethod
    def around(cls, plane: TangentPlane, model: TerrainModel, places_m: Floats) -> Relief:
        """The part of an elevation model around places, shape (n, 2).

        Raises
        ------
        InputError
            The model has none of them, or they need more than 20 million cells.
        """
        # Between bilinear cells slopes jump, and keep the adjustment from settling.
        smooth = replace(model, interpolation="bicubic")
        return cls(plane, smooth, smooth.window(*_angles(plane, places_m)))

    def known(self, places_m: Floats) -> NDArray[np.bool_]:
        """Which places have a height."""
        return self.window.heights(*_angles(self.plane, places_m))[1]

    def points(self, places_m: Floats) -> tuple[Floats, Floats]:
        """Points from the Moon's centre, m, shape (n, 3), of places, and their derivatives, shape (n, 3, 2)."""
        longitude, latitude = _angles(self.plane, places_m)
        height_m, by_longitude, by_latitude = self.window.heights_and_slopes(longitude, latitude)
        up_m = np.sqrt(MEAN_LUNAR_RADIUS_M**2 - (places_m**2).sum(axis=1))
        on_sphere = np.column_stack([places_m, up_m])
        sphere_by_place = np.broadcast_to(np.eye(3, 2), (len(places_m), 3, 2)).copy()
        sphere_by_place[:, 2] = -places_m / up_m[:, np.newaxis]
        east, north, _ = np.moveaxis(vectors.east_north_up(longitude, latitude), -2, 0)
        slope = (by_longitude / np.cos(latitude))[:, np.newaxis] * east + by_latitude[:, np.newaxis] * north
        slope_local = slope @ self.plane.axes().T / MEAN_LUNAR_RADIUS_M
        height_by_place = np.einsum("ni,nik->nk", slope_local, sphere_by_place)
        scale = (1.0 + height_m / MEAN_LUNAR_RADIUS_M)[:, np.newaxis]
        by_place = scale[:, :, np.newaxis] * sphere_by_place
        by_place += on_sphere[:, :, np.newaxis] / MEAN_LUNAR_RADIUS_M * height_by_place[:, np.newaxis]
        return scale * on_sphere, by_place


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Cameras over relief.

    A correction is three angles about the camera's axes, of its place three parts of its range, and two numbers without
    effect, as that of a homography has eight.
    """

    relief: Relief
    cameras: Floats  # K, from directions to pixels, shape (images, 3, 3)
    rotations: Floats  # Q, from the plane's axes to the camera's, shape (images, 3, 3)
    positions_m: Floats  # C, from the Moon's centre in the plane's axes, shape (images, 3)
    middles_m: Floats  # of the ground that each shows, approximately, shape (images, 3)

    @classmethod
    def of_homographies(
        cls, relief: Relief, cameras: Floats, matrices: Floats, image: Indices, places_m: Floats
    ) -> Poses:
        """From approximate homographies, shape (images, 3, 3), and places that are seen, each in an image.

        A homography of a plane at the mean height of an image's places is K [q1 q2 t] but for scale (Zhang 2000,
        section 3.1).
        """
        points = relief.points(places_m)[0]
        middles, rotations, positions = [], [], []
        for k, (camera, matrix) in enumerate(zip(cameras, matrices, strict=True)):
            middle = points[image == k].mean(axis=0)
            columns = np.linalg.solve(camera, matrix @ _to_height(middle))
            columns = columns / np.linalg.norm(columns[:, :2], axis=0).mean()
            columns = columns * np.sign(columns[2] @ [*middle[:2], 1.0])  # the ground is before the camera
            u, _, v = np.linalg.svd(np.column_stack([columns[:, :2], np.cross(*columns[:, :2].T)]))
            middles.append(middle)
            rotations.append(u @ v)
            positions.append([0.0, 0.0, middle[2]] - rotations[-1].T @ columns[:, 2])
        return cls(relief, cameras, np.array(rotations), np.array(positions), np.array(middles))

    @property
    def images(self) -> int:
        """How many."""
        return len(self.cameras)

    def project(self, image: Indices, point: Indices, places_m: Floats) -> Projected:
        """Pixels of tie points."""
        points, point_by_place = (part[point] for part in self.relief.points(places_m))
        to_pixel = self.cameras[image] @ self.rotations[image]
        ahead = np.einsum("nij,nj->ni", self.rotations[image], points - self.positions_m[image])
        by_angles = -self.cameras[image] @ vectors.cross_matrices(ahead)
        by_position = -to_pixel * self._ranges_m()[image, np.newaxis, np.newaxis]
        none = np.zeros((len(image), 3, 2))
        partials = np.concatenate([to_pixel @ point_by_place, by_angles, by_position, none], axis=2)
        pixels, of_pixels = dehomogenized(np.einsum("nij,nj->ni", self.cameras[image], ahead), partials)
        return Projected(pixels, of_pixels[:, :, :2], of_pixels[:, :, 2:])

    def held(self) -> NDArray[np.bool_]:
        """Which corrections have no effect."""
        return np.broadcast_to(np.arange(8) > 5, (self.images, 8))

    def known(self, places_m: Floats) -> NDArray[np.bool_]:
        """Which places have a height."""
        return self.relief.known(places_m)

    def corrected(self, steps: Floats) -> Poses:
        """After corrections."""
        return replace(
            self,
            rotations=rotation_of(steps[:, :3]) @ self.rotations,
            positions_m=self.positions_m + self._ranges_m()[:, np.newaxis] * steps[:, 3:6],
        )

    def place(self, image: int, pixel: Floats) -> Floats:
        """The place that a pixel shows: where its ray meets the ground first."""
        axes = self.relief.plane.axes()
        ray = self.rotations[image].T @ np.linalg.solve(self.cameras[image], [*pixel, 1.0])
        origin, direction = self.positions_m[image] @ axes, ray / np.linalg.norm(ray) @ axes
        points, hits = Terrain(self.relief.model).intersect(origin[np.newaxis], direction[np.newaxis])
        if not hits[0]:
            at = f"(sample {pixel[0]:.1f}, line {pixel[1]:.1f})"
            raise InputError(f"the pixel {at} shows no ground of {self.relief.model.metadata.path}")
        return np.asarray(axes[:2] @ points[0] * MEAN_LUNAR_RADIUS_M / np.linalg.norm(points[0]))

    def homography(self, image: int, covariance: Floats) -> Homography:
        """From places to pixels as if the ground were a plane at the height of the image's middle."""
        to_point = np.linalg.inv(_to_height(self.middles_m[image]))
        to_point[2, 2] = self.middles_m[image, 2]
        to_point[:, 2] -= self.positions_m[image]
        camera, rotation = self.cameras[image], self.rotations[image]
        by_angles = [camera @ turn @ rotation @ to_point for turn in vectors.cross_matrices(np.eye(3))]
        to_pixel = -self._ranges_m()[image] * camera @ rotation
        by_position = [np.outer(to_pixel @ axis, [0.0, 0.0, 1.0]) for axis in np.eye(3)]
        change = np.stack([one.ravel() for one in (*by_angles, *by_position)], axis=1)
        return of_elements(camera @ rotation @ to_point, change @ covariance[:6, :6] @ change.T)

    def altitude_m(self, image: int) -> float:
        """Height of the camera above the middle of the ground that it sees."""
        return float(np.linalg.norm(self.positions_m[image]) - np.linalg.norm(self.middles_m[image]))

    def _ranges_m(self) -> Floats:
        return vectors.length(self.positions_m - self.middles_m)


@dataclass(frozen=True, slots=True, eq=False)
class PosesAndHomographies:
    """Images some of which are low: these have homographies, the others poses."""

    poses: Poses  # of all images; those of low ones mean nothing,
    homographies: Homographies  # nor do these of the others
    low: NDArray[np.bool_]  # shape (images,)

    @classmethod
    def of_homographies(
        cls, relief: Relief, cameras: Floats, homographies: Homographies, image: Indices, places_m: Floats
    ) -> PosesAndHomographies:
        """As :meth:`Poses.of_homographies`; low are images that show less than four cells of the elevation model."""
        poses = Poses.of_homographies(relief, cameras, homographies.matrices, image, places_m)
        scatter = [places_m[image == k].var(axis=0).mean() for k in range(len(cameras))]
        widths_m = np.sqrt(12.0 * np.array(scatter))  # of a square
        return cls(poses, homographies, widths_m < _CELLS_ACROSS * relief.model.metadata.resolution_m)

    @property
    def images(self) -> int:
        """How many."""
        return len(self.low)

    def project(self, image: Indices, point: Indices, places_m: Floats) -> Projected:
        """Pixels of tie points."""
        low = self.low[image]
        parts = [model.project(image, point, places_m) for model in (self.homographies, self.poses)]
        return Projected(
            *(np.where(low.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in zip(*parts, strict=True))
        )

    def known(self, places_m: Floats) -> NDArray[np.bool_]:
        """Which places have a height."""
        return self.poses.known(places_m)

    def held(self) -> NDArray[np.bool_]:
        """Which corrections have no effect."""
        return self.poses.held() & ~self.low[:, np.newaxis]

    def corrected(self, steps: Floats) -> PosesAndHomographies:
        """After corrections."""
        low = self.low[:, np.newaxis]
        return replace(
            self,
            poses=self.poses.corrected(np.where(low, 0.0, steps)),
            homographies=self.homographies.corrected(np.where(low, steps, 0.0)),
        )

    def place(self, image: int, pixel: Floats) -> Floats:
        """The place that a pixel shows."""
        return self._of(image).place(image, pixel)

    def homography(self, image: int, covariance: Floats) -> Homography:
        """From places to pixels as if the ground were a plane."""
        return self._of(image).homography(image, covariance)

    def altitude_m(self, image: int) -> float:
        """Height of the camera above the middle of the ground that it sees; NaN of a low image."""
        return float("nan") if self.low[image] else self.poses.altitude_m(image)

    def _of(self, image: int) -> Poses | Homographies:
        return self.homographies if self.low[image] else self.poses


def camera_matrix(camera: Camera) -> Floats:
    """K of a camera without its distortion, in axes of which z is ahead: from directions to pixels, shape (3, 3)."""
    matrix = np.eye(3)
    matrix[:2, :2] = camera.focal_length_mm * camera.pixel_per_mm * [camera.looks_along_z, 1.0]
    matrix[:2, 2] = camera.principal_point_px
    return matrix


def _to_height(point_m: Floats) -> Floats:
    """From east and north of points at the height of one to places, shape (3, 3)."""
    raised = np.linalg.norm(point_m) / MEAN_LUNAR_RADIUS_M
    return np.diag([1.0 / raised, 1.0 / raised, 1.0])


def _angles(plane: TangentPlane, places_m: Floats) -> tuple[Floats, Floats]:
    longitude, latitude = np.radians(plane.to_longitude_latitude(places_m)).T
    return longitude, latitude
