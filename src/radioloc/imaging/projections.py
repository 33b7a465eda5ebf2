r"""Projections of places in a plane to pixels, with partial derivatives for the adjustment.

A place is east and north, m, in a plane that touches the Moon (:class:`~radioloc.lunar.TangentPlane`). Without a
camera or heights the ground is taken as a plane, and an image has the eight parameters of a homography (equation 7 of
Wang et al. 2021); with both it has the position and attitude of the camera. The place X has the point
:math:`P = (R + h) u(X)` of the sphere's radius R, the height h of an elevation model and the direction u. Its pixel is
(equation 6)

.. math:: p \simeq K Q (P - C)

with the camera position C, the rotation Q to its axes, and K of the focal length and the principal point. Relief, the
Moon's curvature and oblique views are exact to the errors of the heights.

A low image shows a few cells of the elevation model, or one, on slopes that the model does not resolve. A homography
follows these slopes, and a pose does not. The size of the visible ground decides between them.
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
    corrected,
    correction_partials,
    of_correction,
    of_elements,
    transformed,
)
from radioloc.imaging.orientation import rotation_matrices
from radioloc.imaging.surfaces import Terrain
from radioloc.lunar import TerrainModel
from radioloc.lunar.maps import TangentPlane
from radioloc.lunar.terrain import TerrainWindow, height_and_gradient
from radioloc.vectors import Floats

Indices = NDArray[np.int64]

_MIN_WIDTH_CELLS = 4.0  # of the elevation model, in an image with a pose


class Projected(NamedTuple):
    """Pixels of places with derivatives."""

    pixels: Floats  # (n, 2)
    by_place: Floats  # (n, 2, 2), pixel / m
    by_parameters: Floats  # (n, 2, 8)


@dataclass(frozen=True, slots=True, eq=False)
class Homographies:
    """Images of a plane.

    Corrections act on places, before the projection: if the ground of a chain of images shifts by many widths of the
    low ones, all of these follow in one step. Corrections of pixels would lead such an image beyond its horizon.
    """

    matrices: Floats  # from places to pixels, shape (images, 3, 3)
    normals: Floats  # from pixels to numbers of size one, shape (images, 3, 3)

    @classmethod
    def of_matrices(cls, matrices: Floats, sizes: Floats) -> Homographies:
        """Build from approximate matrices, and samples and lines of the images, shape (images, 2)."""
        unit = matrices / np.linalg.norm(matrices, axis=(1, 2), keepdims=True)
        return cls(unit, np.array([_size_normalization(size) for size in sizes]))

    @property
    def images(self) -> int:
        """Number of images."""
        return len(self.matrices)

    def pixels(self, image: Indices, point: Indices, places_m: Floats) -> Floats:
        """Return pixels of tie points, shape (n, 2)."""
        return _dehomogenized(_applied(self.matrices[image], places_m[point]))

    def project(self, image: Indices, point: Indices, places_m: Floats) -> Projected:
        """Return pixels of tie points with derivatives."""
        place, matrix, normals = places_m[point], self.matrices[image], self._place_normals()
        ahead = _applied(matrix, place)
        by_place = _dehomogenized_partials(ahead, matrix[:, :, :2])
        by_normalized = by_place @ np.linalg.inv(normals[:, :2, :2])[image]
        normalized = _applied(normals[image, :2], place)
        return Projected(_dehomogenized(ahead), by_place, correction_partials(normalized, by_normalized))

    def covers(self, places_m: Floats) -> NDArray[np.bool_]:
        """Return True for every place."""
        return np.ones(len(places_m), bool)

    def fixed_corrections(self) -> NDArray[np.bool_]:
        """Return False for every correction, shape (images, 8)."""
        return np.zeros((self.images, 8), bool)

    def corrected(self, steps: Floats) -> Homographies:
        """Return the homographies after corrections, shape (images, 8)."""
        normals = self._place_normals() @ np.linalg.inv(self.matrices)
        return replace(self, matrices=corrected(self.matrices, normals, steps))

    def place(self, image: int, pixel: Floats) -> Floats:
        """Return the place of a pixel."""
        matrix = self.matrices[image]
        place = transformed(np.linalg.inv(matrix), pixel[np.newaxis])[0]
        # Points in front of a camera above the plane have a third coordinate of the sign opposite to the determinant.
        if not (matrix[2] @ [*place, 1.0]) * np.linalg.det(matrix) < 0.0:
            raise InputError(f"the pixel (sample {pixel[0]:.1f}, line {pixel[1]:.1f}) is above the horizon")
        return place

    def homography(self, image: int, covariance: Floats) -> Homography:
        """Return the homography of an image with its covariance."""
        matrix = self.matrices[image]
        return of_correction(matrix, self._place_normals()[image] @ np.linalg.inv(matrix), covariance)

    def altitude_m(self, image: int) -> float:
        """Return NaN: a homography does not determine the altitude."""
        return float("nan")

    def _place_normals(self) -> Floats:
        """Return matrices from places to numbers of size one, linearized at the middle of each image."""
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
        """Return the part of an elevation model around places, shape (n, 2)."""
        # Slopes jump between bilinear cells, which would prevent convergence of the adjustment.
        smooth = replace(model, interpolation="bicubic")
        return cls(plane, smooth, smooth.window(*_angles(plane, places_m)))

    def covers(self, places_m: Floats) -> NDArray[np.bool_]:
        """Return True for places with a height."""
        return self.window.heights(*_angles(self.plane, places_m))[1]

    def points(self, places_m: Floats) -> tuple[Floats, Floats]:
        """Return points of places from the Moon's centre, m, shape (n, 3), and derivatives, shape (n, 3, 2)."""
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

    A correction is three angles about the camera's axes, three components of its position as parts of its range, and
    two numbers without effect, since a homography has eight.
    """

    homographies: Homographies  # meaningful for low images
    low: NDArray[np.bool_]  # shape (images,); the following fields are meaningful for the other images
    relief: Relief
    cameras: Floats  # K, from directions to pixels, shape (images, 3, 3)
    rotations: Floats  # Q, from the plane's axes to the camera's, shape (images, 3, 3)
    positions_m: Floats  # C, from the Moon's centre in the plane's axes, shape (images, 3)
    middles_m: Floats  # of the visible ground, approximately, shape (images, 3)

    @classmethod
    def of_homographies(
        cls, relief: Relief, cameras: Floats, homographies: Homographies, image: Indices, places_m: Floats
    ) -> Poses:
        """Build from approximate homographies and places of tie points, each in an image.

        Images of less than four cells of the elevation model are low.
        """
        scatter = [places_m[image == k].var(axis=0).mean() for k in range(len(cameras))]
        widths_m = np.sqrt(12.0 * np.array(scatter))  # of a square
        low = widths_m < _MIN_WIDTH_CELLS * relief.model.metadata.resolution_m
        points = relief.points(places_m)[0]
        middles, rotations, positions = [], [], []
        for k, (camera, matrix) in enumerate(zip(cameras, homographies.matrices, strict=True)):
            middles.append(points[image == k].mean(axis=0))
            rotation, position_m = pose_of_homography(camera, matrix, middles[-1])
            rotations.append(rotation)
            positions.append(position_m)
        poses = np.array(rotations), np.array(positions), np.array(middles)
        return cls(homographies, low, relief, cameras, *poses)

    @property
    def images(self) -> int:
        """Number of images."""
        return len(self.cameras)

    def pixels(self, image: Indices, point: Indices, places_m: Floats) -> Floats:
        """Return pixels of tie points, shape (n, 2)."""
        pixels, low = np.empty((len(image), 2)), self.low[image]
        points = self.relief.points(places_m)[0][point[~low]]
        pixels[~low] = _dehomogenized(
            vectors.rotated(self.cameras[image[~low]], self._ahead(image[~low], points))
        )
        pixels[low] = self.homographies.pixels(image[low], point[low], places_m)
        return pixels

    def project(self, image: Indices, point: Indices, places_m: Floats) -> Projected:
        """Return pixels of tie points with derivatives."""
        low, n = self.low[image], len(image)
        result = Projected(np.empty((n, 2)), np.empty((n, 2, 2)), np.empty((n, 2, 8)))
        for rows, project in ((low, self.homographies.project), (~low, self._posed)):
            for values, part in zip(result, project(image[rows], point[rows], places_m), strict=True):
                values[rows] = part
        return result

    def _posed(self, image: Indices, point: Indices, places_m: Floats) -> Projected:
        """Return pixels of tie points with derivatives by poses."""
        points, point_by_place = (part[point] for part in self.relief.points(places_m))
        to_pixel = (self.cameras @ self.rotations)[image]
        ahead = self._ahead(image, points)
        by_angles = -self.cameras[image] @ vectors.cross_matrices(ahead)
        by_position = -to_pixel * self.ranges_m()[image, np.newaxis, np.newaxis]
        zeros = np.zeros((len(image), 3, 2))
        homogeneous_partials = np.concatenate(
            [to_pixel @ point_by_place, by_angles, by_position, zeros], axis=2
        )
        homogeneous = vectors.rotated(self.cameras[image], ahead)
        partials = _dehomogenized_partials(homogeneous, homogeneous_partials)
        return Projected(_dehomogenized(homogeneous), partials[:, :, :2], partials[:, :, 2:])

    def fixed_corrections(self) -> NDArray[np.bool_]:
        """Return True for corrections without effect, shape (images, 8)."""
        return (np.arange(8) > 5) & ~self.low[:, np.newaxis]

    def covers(self, places_m: Floats) -> NDArray[np.bool_]:
        """Return True for places with a height."""
        return self.relief.covers(places_m)

    def corrected(self, steps: Floats) -> Poses:
        """Return the poses after corrections, shape (images, 8)."""
        low = self.low[:, np.newaxis]
        pose_steps = np.where(low, 0.0, steps)
        return replace(
            self,
            homographies=self.homographies.corrected(np.where(low, steps, 0.0)),
            rotations=rotation_matrices(pose_steps[:, :3]) @ self.rotations,
            positions_m=self.positions_m + self.ranges_m()[:, np.newaxis] * pose_steps[:, 3:6],
        )

    def place(self, image: int, pixel: Floats) -> Floats:
        """Return the place of a pixel, the first intersection of its ray with the ground."""
        if self.low[image]:
            return self.homographies.place(image, pixel)
        axes = self.relief.plane.axes()
        ray = self.rotations[image].T @ np.linalg.solve(self.cameras[image], [*pixel, 1.0])
        origin, direction = self.positions_m[image] @ axes, ray / np.linalg.norm(ray) @ axes
        points, hits = Terrain(self.relief.model).intersect(origin[np.newaxis], direction[np.newaxis])
        if not hits[0]:
            raise InputError(
                f"the ray at sample {pixel[0]:.1f}, line {pixel[1]:.1f} does not meet the ground of "
                f"{self.relief.model.metadata.path}"
            )
        return np.asarray(axes[:2] @ points[0] * MEAN_LUNAR_RADIUS_M / np.linalg.norm(points[0]))

    def homography(self, image: int, covariance: Floats) -> Homography:
        """Return the homography of an image for a plane at the height of its middle, with its covariance."""
        if self.low[image]:
            return self.homographies.homography(image, covariance)
        to_point = np.linalg.inv(_to_height(self.middles_m[image]))
        to_point[2, 2] = self.middles_m[image, 2]
        to_point[:, 2] -= self.positions_m[image]
        camera, rotation = self.cameras[image], self.rotations[image]
        by_angles = [camera @ turn @ rotation @ to_point for turn in vectors.cross_matrices(np.eye(3))]
        to_pixel = -self.ranges_m()[image] * camera @ rotation
        by_position = [np.outer(to_pixel @ axis, [0.0, 0.0, 1.0]) for axis in np.eye(3)]
        change = np.stack([partials.ravel() for partials in (*by_angles, *by_position)], axis=1)
        return of_elements(camera @ rotation @ to_point, change @ covariance[:6, :6] @ change.T)

    def altitude_m(self, image: int) -> float:
        """Return the height of the camera above the middle of the visible ground, m; NaN for a low image."""
        if self.low[image]:
            return float("nan")
        return float(np.linalg.norm(self.positions_m[image]) - np.linalg.norm(self.middles_m[image]))

    def _ahead(self, image: Indices, points_m: Floats) -> Floats:
        """Return vectors from the cameras to points in the cameras' axes, shape (n, 3)."""
        return vectors.rotated(self.rotations[image], points_m - self.positions_m[image])

    def ranges_m(self) -> Floats:
        """Return distances of the cameras from the middles of their ground, m, shape (images,)."""
        return vectors.length(self.positions_m - self.middles_m)


Projections = Homographies | Poses


def pose_of_homography(camera: Floats, matrix: Floats, middle_m: Floats) -> tuple[Floats, Floats]:
    """Return rotation Q and position C of a camera by its homography of a plane at the height of a point."""
    # The homography is K [q1 q2 t] up to scale (Zhang 2000, section 3.1).
    columns = np.linalg.solve(camera, matrix @ _to_height(middle_m))
    columns = columns / np.linalg.norm(columns[:, :2], axis=0).mean()
    # The ground is in front of the camera.
    columns = columns * np.sign(columns[2] @ [*middle_m[:2], 1.0])
    u, _, v = np.linalg.svd(np.column_stack([columns[:, :2], np.cross(*columns[:, :2].T)]))
    rotation = u @ v
    return rotation, [0.0, 0.0, middle_m[2]] - rotation.T @ columns[:, 2]


def _to_height(point_m: Floats) -> Floats:
    """Return the matrix from east and north of points at the height of a point to places, shape (3, 3)."""
    raised = np.linalg.norm(point_m) / MEAN_LUNAR_RADIUS_M
    return np.diag([1.0 / raised, 1.0 / raised, 1.0])


def _angles(plane: TangentPlane, places_m: Floats) -> tuple[Floats, Floats]:
    longitude, latitude = np.radians(plane.to_longitude_latitude(places_m)).T
    return longitude, latitude


def _applied(matrices: Floats, places_m: Floats) -> Floats:
    """Return matrices, shape (n, m, 3), applied to east, north and 1, shape (n, m)."""
    return np.einsum("nij,nj->ni", matrices[..., :2], places_m) + matrices[..., 2]


def _dehomogenized(values: Floats) -> Floats:
    """Return pixels, shape (n, 2), of homogeneous coordinates, shape (n, 3)."""
    return values[:, :2] / values[:, 2:]


def _dehomogenized_partials(values: Floats, partials: Floats) -> Floats:
    """Return derivatives of pixels, shape (n, 2, m), from those of homogeneous coordinates, shape (n, 3, m)."""
    numerators = partials[:, :2] - _dehomogenized(values)[:, :, np.newaxis] * partials[:, 2:]
    return numerators / values[:, 2:, np.newaxis]


def _size_normalization(size: Floats) -> Floats:
    """Return the similarity from the pixels of an image to between -1 and 1."""
    half = 0.5 * float(np.max(size))
    return np.array([[1 / half, 0, -0.5 * size[0] / half], [0, 1 / half, -0.5 * size[1] / half], [0, 0, 1.0]])
