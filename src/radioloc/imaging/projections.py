r"""How images show places in the plane: what their adjustment needs to know.

A place is east and north, m, in a plane that touches the Moon (:class:`~radioloc.lunar.TangentPlane`). Without a
camera or heights the ground is taken as a plane, and an image has the eight parameters of a homography (equation 7 of
Wang et al. 2021); with both it has the place and the attitude of the camera. The place X in the plane has the point
:math:`P = (R + h) u(X)` of the sphere's radius R, the height h of an elevation model and the direction u. It is seen at
(equation 6)

.. math:: p \simeq K Q (P - C)

with the camera's place C, the rotation Q to its axes, and K of the focal length and the principal point. So relief, the
Moon's curvature and what is oblique move no point by more than heights are wrong.

A low image shows a few cells of the model, or one, and lies on slopes that the model does not have. A homography
follows these, and a pose does not; so the images of a descent have one or the other by the size of what they show.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc import vectors
from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.imaging.homography import (
    Homography,
    by_correction,
    corrected,
    of_correction,
    of_elements,
    transformed,
)
from radioloc.imaging.orientation import rotation_of
from radioloc.imaging.surfaces import Terrain
from radioloc.lunar import TerrainModel
from radioloc.lunar.maps import TangentPlane
from radioloc.lunar.terrain import TerrainWindow, height_and_gradient
from radioloc.vectors import Floats

Indices = NDArray[np.int64]

_CELLS_ACROSS = 4.0  # of the elevation model, in an image that it describes


class Projected(NamedTuple):
    """Pixels of places, with derivatives."""

    pixels: Floats  # (n, 2)
    by_place: Floats  # (n, 2, 2), pixel / m
    by_parameters: Floats  # (n, 2, 8)


@dataclass(frozen=True, slots=True, eq=False)
class Homographies:
    """Images of a plane.

    A correction moves the places before the image is taken of them: when the ground on which a chain of images stands
    turns out to be elsewhere, by many widths of the low ones, all of these follow in one step. Corrections of pixels
    would lead such an image beyond its horizon.
    """

    matrices: Floats  # from places to pixels, shape (images, 3, 3)
    normals: Floats  # from pixels to numbers of size one, shape (images, 3, 3)

    @classmethod
    def of_matrices(cls, matrices: Floats, sizes: Floats) -> Homographies:
        """From approximate matrices, and samples and lines of the images, shape (images, 2)."""
        unit = matrices / np.linalg.norm(matrices, axis=(1, 2), keepdims=True)
        return cls(unit, np.array([_of_size(size) for size in sizes]))

    @property
    def images(self) -> int:
        """How many."""
        return len(self.matrices)

    def pixels(self, image: Indices, point: Indices, places_m: Floats) -> Floats:
        """Pixels of tie points, shape (n, 2)."""
        return _dehomogenized(_applied(self.matrices[image], places_m[point]))

    def project(self, image: Indices, point: Indices, places_m: Floats) -> Projected:
        """Pixels of tie points, with derivatives."""
        place, matrix, normals = places_m[point], self.matrices[image], self._normals_of_places()
        ahead = _applied(matrix, place)
        by_place = _dehomogenized_partials(ahead, matrix[:, :, :2])
        by_normalized = by_place @ np.linalg.inv(normals[:, :2, :2])[image]
        normalized = _applied(normals[image, :2], place)
        return Projected(_dehomogenized(ahead), by_place, by_correction(normalized, by_normalized))

    def known(self, places_m: Floats) -> NDArray[np.bool_]:
        """All of the plane."""
        return np.ones(len(places_m), bool)

    def held(self) -> NDArray[np.bool_]:
        """Which corrections have no effect: none."""
        return np.zeros((self.images, 8), bool)

    def corrected(self, steps: Floats) -> Homographies:
        """After corrections."""
        normals = self._normals_of_places() @ np.linalg.inv(self.matrices)
        return replace(self, matrices=corrected(self.matrices, normals, steps))

    def place(self, image: int, pixel: Floats) -> Floats:
        """The place that a pixel shows."""
        matrix = self.matrices[image]
        place = transformed(np.linalg.inv(matrix), pixel[np.newaxis])[0]
        # What is before a camera above the plane has a third coordinate whose sign is not the determinant's.
        if not (matrix[2] @ [*place, 1.0]) * np.linalg.det(matrix) < 0.0:
            raise InputError(
                f"the pixel (sample {pixel[0]:.1f}, line {pixel[1]:.1f}) looks above the horizon"
            )
        return place

    def homography(self, image: int, covariance: Floats) -> Homography:
        """Of the image."""
        matrix = self.matrices[image]
        return of_correction(matrix, self._normals_of_places()[image] @ np.linalg.inv(matrix), covariance)

    def altitude_m(self, image: int) -> float:
        """Not known."""
        return float("nan")

    def _normals_of_places(self) -> Floats:
        """From places to numbers of size one, as the middle of each image shows its surroundings."""
        normal = self.normals @ self.matrices
        middle = np.linalg.inv(normal)[:, :, 2]
        middle = middle[:, :2] / middle[:, 2:]
        ahead = np.einsum("nij,nj->ni", normal[:, :, :2], middle) + normal[:, :, 2]
        result = np.zeros_like(normal)
        result[:, :2, :2] = normal[:, :2, :2] / ahead[:, 2, np.newaxis, np.newaxis]
        result[:, :2, 2] = -np.einsum("nij,nj->ni", result[:, :2, :2], middle)
        result[:, 2, 2] = 1.0
        return result


@dataclass(frozen=True, slots=True, eq=False)
class Relief:
    """Heights of an elevation model at places in a plane; points are in the plane's east, north and up."""

    plane: TangentPlane
    model: TerrainModel
    window: TerrainWindow

    @classmethod
    def around(cls, plane: TangentPlane, model: TerrainModel, places_m: Floats) -> Relief:
        """Return the part of an elevation model around places, shape (n, 2); an error if it has none of them."""
        # Between bilinear cells slopes jump, and keep the adjustment from settling.
        smooth = replace(model, interpolation="bicubic")
        return cls(plane, smooth, smooth.window(*_angles(plane, places_m)))

    def known(self, places_m: Floats) -> NDArray[np.bool_]:
        """Which places have a height."""
        return self.window.heights(*_angles(self.plane, places_m))[1]

    def points(self, places_m: Floats) -> tuple[Floats, Floats]:
        """Points from the Moon's centre, m, shape (n, 3), of places, and their derivatives, shape (n, 3, 2)."""
        longitude, latitude = _angles(self.plane, places_m)
        height_m, gradient = height_and_gradient(self.window.heights_and_slopes, longitude, latitude)
        up_m = np.sqrt(MEAN_LUNAR_RADIUS_M**2 - (places_m**2).sum(axis=1))
        on_sphere = np.column_stack([places_m, up_m])
        sphere_by_place = np.broadcast_to(np.eye(3, 2), (len(places_m), 3, 2)).copy()
        sphere_by_place[:, 2] = -places_m / up_m[:, np.newaxis]
        gradient_local = gradient @ self.plane.axes().T / MEAN_LUNAR_RADIUS_M
        height_by_place = np.einsum("ni,nik->nk", gradient_local, sphere_by_place)
        scale = (1.0 + height_m / MEAN_LUNAR_RADIUS_M)[:, np.newaxis]
        by_place = scale[:, :, np.newaxis] * sphere_by_place
        by_place += on_sphere[:, :, np.newaxis] / MEAN_LUNAR_RADIUS_M * height_by_place[:, np.newaxis]
        return scale * on_sphere, by_place


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Cameras over relief; low images have homographies.

    A correction is three angles about the camera's axes, of its place three parts of its range, and two numbers without
    effect, as that of a homography has eight.
    """

    homographies: Homographies  # those of images that are not low mean nothing,
    low: NDArray[np.bool_]  # shape (images,)
    relief: Relief  # nor does what follows of low ones
    cameras: Floats  # K, from directions to pixels, shape (images, 3, 3)
    rotations: Floats  # Q, from the plane's axes to the camera's, shape (images, 3, 3)
    positions_m: Floats  # C, from the Moon's centre in the plane's axes, shape (images, 3)
    middles_m: Floats  # of the ground that each shows, approximately, shape (images, 3)

    @classmethod
    def of_homographies(
        cls, relief: Relief, cameras: Floats, homographies: Homographies, image: Indices, places_m: Floats
    ) -> Poses:
        """From approximate homographies and places that are seen, each in an image.

        A homography of a plane at the mean height of an image's places is K [q1 q2 t] but for scale (Zhang 2000,
        section 3.1). Low are images that show less than four cells of the elevation model.
        """
        scatter = [places_m[image == k].var(axis=0).mean() for k in range(len(cameras))]
        widths_m = np.sqrt(12.0 * np.array(scatter))  # of a square
        low = widths_m < _CELLS_ACROSS * relief.model.metadata.resolution_m
        points = relief.points(places_m)[0]
        middles, rotations, positions = [], [], []
        for k, (camera, matrix) in enumerate(zip(cameras, homographies.matrices, strict=True)):
            middle = points[image == k].mean(axis=0)
            columns = np.linalg.solve(camera, matrix @ _to_height(middle))
            columns = columns / np.linalg.norm(columns[:, :2], axis=0).mean()
            columns = columns * np.sign(columns[2] @ [*middle[:2], 1.0])  # the ground is before the camera
            u, _, v = np.linalg.svd(np.column_stack([columns[:, :2], np.cross(*columns[:, :2].T)]))
            middles.append(middle)
            rotations.append(u @ v)
            positions.append([0.0, 0.0, middle[2]] - rotations[-1].T @ columns[:, 2])
        known = np.array(rotations), np.array(positions), np.array(middles)
        return cls(homographies, low, relief, cameras, *known)

    @property
    def images(self) -> int:
        """How many."""
        return len(self.cameras)

    def pixels(self, image: Indices, point: Indices, places_m: Floats) -> Floats:
        """Pixels of tie points, shape (n, 2)."""
        ahead = self._ahead(image, self.relief.points(places_m)[0][point])
        posed = _dehomogenized(vectors.rotated(self.cameras[image], ahead))
        return np.where(self.low[image, np.newaxis], self.homographies.pixels(image, point, places_m), posed)

    def project(self, image: Indices, point: Indices, places_m: Floats) -> Projected:
        """Pixels of tie points, with derivatives."""
        points, point_by_place = (part[point] for part in self.relief.points(places_m))
        to_pixel = self.cameras[image] @ self.rotations[image]
        ahead = self._ahead(image, points)
        by_angles = -self.cameras[image] @ vectors.cross_matrices(ahead)
        by_position = -to_pixel * self._ranges_m()[image, np.newaxis, np.newaxis]
        none = np.zeros((len(image), 3, 2))
        partials = np.concatenate([to_pixel @ point_by_place, by_angles, by_position, none], axis=2)
        homogeneous = vectors.rotated(self.cameras[image], ahead)
        of_pixels = _dehomogenized_partials(homogeneous, partials)
        posed = Projected(_dehomogenized(homogeneous), of_pixels[:, :, :2], of_pixels[:, :, 2:])
        low = self.low[image, np.newaxis, np.newaxis]
        flat = self.homographies.project(image, point, places_m)
        return Projected(
            np.where(low[:, :, 0], flat.pixels, posed.pixels),
            np.where(low, flat.by_place, posed.by_place),
            np.where(low, flat.by_parameters, posed.by_parameters),
        )

    def held(self) -> NDArray[np.bool_]:
        """Which corrections have no effect."""
        return (np.arange(8) > 5) & ~self.low[:, np.newaxis]

    def known(self, places_m: Floats) -> NDArray[np.bool_]:
        """Which places have a height."""
        return self.relief.known(places_m)

    def corrected(self, steps: Floats) -> Poses:
        """After corrections."""
        low = self.low[:, np.newaxis]
        of_poses = np.where(low, 0.0, steps)
        return replace(
            self,
            homographies=self.homographies.corrected(np.where(low, steps, 0.0)),
            rotations=rotation_of(of_poses[:, :3]) @ self.rotations,
            positions_m=self.positions_m + self._ranges_m()[:, np.newaxis] * of_poses[:, 3:6],
        )

    def place(self, image: int, pixel: Floats) -> Floats:
        """The place that a pixel shows: where its ray meets the ground first."""
        if self.low[image]:
            return self.homographies.place(image, pixel)
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
        if self.low[image]:
            return self.homographies.homography(image, covariance)
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
        """Height of the camera above the middle of the ground that it sees; NaN of a low image."""
        if self.low[image]:
            return float("nan")
        return float(np.linalg.norm(self.positions_m[image]) - np.linalg.norm(self.middles_m[image]))

    def _ahead(self, image: Indices, points_m: Floats) -> Floats:
        """Points from the cameras, in the cameras' axes, shape (n, 3)."""
        return vectors.rotated(self.rotations[image], points_m - self.positions_m[image])

    def _ranges_m(self) -> Floats:
        return vectors.length(self.positions_m - self.middles_m)


Projections = Homographies | Poses


def _to_height(point_m: Floats) -> Floats:
    """From east and north of points at the height of one to places, shape (3, 3)."""
    raised = np.linalg.norm(point_m) / MEAN_LUNAR_RADIUS_M
    return np.diag([1.0 / raised, 1.0 / raised, 1.0])


def _angles(plane: TangentPlane, places_m: Floats) -> tuple[Floats, Floats]:
    longitude, latitude = np.radians(plane.to_longitude_latitude(places_m)).T
    return longitude, latitude


def _applied(matrices: Floats, places_m: Floats) -> Floats:
    """Matrices, shape (n, m, 3), applied to east, north and one, shape (n, m)."""
    return np.einsum("nij,nj->ni", matrices[..., :2], places_m) + matrices[..., 2]


def _dehomogenized(values: Floats) -> Floats:
    """Pixels, shape (n, 2), of homogeneous ones, shape (n, 3)."""
    return values[:, :2] / values[:, 2:]


def _dehomogenized_partials(values: Floats, partials: Floats) -> Floats:
    """Derivatives of pixels, shape (n, 2, m), of those of homogeneous ones, shape (n, 3, m)."""
    of_pixels = partials[:, :2] - _dehomogenized(values)[:, :, np.newaxis] * partials[:, 2:]
    return of_pixels / values[:, 2:, np.newaxis]


def _of_size(size: Floats) -> Floats:
    """The similarity that brings the pixels of an image to between -1 and 1."""
    half = 0.5 * float(np.max(size))
    return np.array([[1 / half, 0, -0.5 * size[0] / half], [0, 1 / half, -0.5 * size[1] / half], [0, 0, 1.0]])
