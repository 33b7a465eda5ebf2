r"""Joint adjustment of overlapping orbital images on an elevation model.

The corrections u of an image are those of its position (east, north, up) and of its attitude (small angles about the
camera's axes). Each is an offset, and for line scans a drift: its change from the middle of the image to the last line.
The ray of tie point j in image i meets the elevation model at :math:`G_{ij}`. With the place of the tie point
:math:`X_j` in the local plane, and the error of the model's height there, :math:`h_j`,

.. math:: G_{ij} + D_{ij} u_i + b_{ij} h_j - X_j = J_{ij} e_{ij}

with partials D by corrections, b by the height and J by the pixel (:mod:`radioloc.imaging.ground_points`), and the
error e of the pixel. Partials are those at the adjusted pixels (Gauss-Helmert model): at the measured ones, a smaller
scale of all images would reduce the residuals. Corrections and heights have a-priori sigmas; ground points, such as
laser reflectors, are tie points with a-priori coordinates. Places and heights are eliminated (Triggs et al. 2000,
section 6.1). The inverse of the reduced normal matrix is the covariance of all corrections. Residuals determine the
noise of the tie points, a variance component. A tie point is rejected if its chi squared is exceeded with a probability
below 1 in 1000.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import ConvergenceError, InputError
from radioloc.imaging.ground_points import image_to_ground_and_partials
from radioloc.imaging.orientation import ConstantOrientation, CorrectedOrientation
from radioloc.imaging.sensor_models import FrameModel, LineScanModel, SensorModel
from radioloc.imaging.surfaces import Surface
from radioloc.lunar.local import axes_at
from radioloc.lunar.selenographic import cartesian_to_selenographic, east_north_up
from radioloc.vectors import Floats, length

CORRECTION_COUNT = 12  # of an image: offsets of position and angles, then their drifts
_MAX_STEPS = 30
_STEP_TOLERANCE = 1e-2  # of corrections, in a-priori sigmas and in sigmas of the result
_FACTOR_TOLERANCE = 0.02  # relative change of the variance component
_MIN_FACTOR = 0.05
_OUTLIER_PROBABILITY = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class GroundTies:
    """Pixels of tie points in images; points have the numbers 0 to m - 1."""

    image: NDArray[np.int64]  # of each pixel, shape (n,)
    point: NDArray[np.int64]  # shape (n,)
    pixels: Floats  # shape (n, 2)
    sigma_px: Floats  # shape (n,)
    places_m: (
        Floats  # a-priori coordinates of points, mean-Earth axes, shape (m, 3); NaN for undetermined ones
    )
    place_sigma_m: Floats  # of each coordinate, shape (m,); infinite for undetermined ones


@dataclass(frozen=True, slots=True, eq=False)
class StripAdjustment:
    """Result of the adjustment."""

    models: tuple[SensorModel, ...]  # with corrections
    corrections: Floats  # m and rad, shape (images, 12)
    covariance: Floats  # of all corrections, shape (12 images, 12 images)
    used: NDArray[np.bool_]  # points that were not rejected
    ground_m: Floats  # places of the pixels on the ground, mean-Earth axes, shape (n, 3)
    residuals_px: Floats  # of pixels, shape (n, 2)
    residuals_m: Floats  # the same on the ground, east and north, shape (n, 2)
    sigma_factor: float  # of the sigmas of tie points
    redundancy: float


class _Equations(NamedTuple):
    """Equations of the pixels; unknowns are in a-priori sigmas, places in metres."""

    ground_m: Floats
    by_pixel: Floats  # east and north, shape (n, 2, 2)
    misclosures_px: Floats  # of places from those of their points, shape (n, 2)
    by_corrections: Floats  # shape (n, 2, 12)
    by_point: Floats  # by place and height, shape (n, 2, 3)
    prior_weights: Floats  # of places and height, shape (m, 3)
    priors: Floats


def adjust_strips(
    models: Sequence[SensorModel], ties: GroundTies, surface: Surface, sigmas: Floats, dem_sigma_m: float
) -> StripAdjustment:
    """Adjust images by tie points; `sigmas` are those of the twelve corrections, a-priori, m and rad."""
    corrections = np.zeros((len(models), CORRECTION_COUNT))
    used, factor = np.ones(len(ties.places_m), bool), 1.0
    scale = np.tile(sigmas, len(models))
    if not len(ties.image):
        empty = np.zeros((0, 3))
        no_residuals = empty[:, :2], empty[:, :2]
        return StripAdjustment(
            tuple(models), corrections, np.diag(scale**2), used, empty, *no_residuals, 1.0, 0.0
        )
    adjusted = ties.pixels
    for _ in range(_MAX_STEPS):
        corrected = tuple(map(corrected_model, models, corrections * sigmas))
        equations = _equations(corrected, ties, adjusted, surface, sigmas, dem_sigma_m)
        rows = used[ties.point]
        step, covariance, residuals, redundancy = _solved(equations, ties, rows, factor, corrections)
        corrections = corrections + step
        small = bool((np.abs(step) < _STEP_TOLERANCE).all())
        adjusted = ties.pixels - np.where(rows[:, None], residuals, 0.0)
        whitened = residuals / (factor * ties.sigma_px[:, None])
        chi2 = np.bincount(ties.point, weights=(whitened**2).sum(axis=1) * rows, minlength=len(used))
        change = max(float(np.sqrt(chi2.sum() / redundancy)), _MIN_FACTOR) if redundancy > 1.0 else 1.0
        rejected = used & _are_outliers(ties, chi2 / change**2) & (np.abs(step).max() < 1.0)
        if small and not rejected.any() and abs(change - 1.0) < _FACTOR_TOLERANCE:
            return StripAdjustment(
                tuple(map(corrected_model, models, corrections * sigmas)),
                corrections * sigmas,
                covariance * scale * scale[:, None],
                used,
                equations.ground_m,
                residuals,
                np.einsum("nij,nj->ni", equations.by_pixel, residuals),
                factor,
                redundancy,
            )
        used, factor = used & ~rejected, factor * change
    raise ConvergenceError(f"the adjustment of the orbital images did not converge in {_MAX_STEPS} steps")


def corrected_model(model: SensorModel, correction: Floats) -> SensorModel:
    """Return a sensor model with twelve corrections, m and rad."""
    if not correction.any():
        return model
    middle_s, half_s = _span_s(model)
    [position], [rotation] = model.orientation.poses(np.array([middle_s]))
    to_me = axes_at(position).T
    offset, drift = correction.reshape(2, 2, 3)
    orientation = CorrectedOrientation(
        model.orientation, np.stack([to_me @ offset[0], to_me @ drift[0]]), np.stack([offset[1], drift[1]]),
        (middle_s, half_s),
    )  # fmt: skip
    if isinstance(model, LineScanModel):
        return replace(model, orientation=orientation)
    [position], [rotation] = orientation.poses(np.zeros(1))
    return replace(model, orientation=ConstantOrientation(position, rotation))


def ground_partials(
    model: SensorModel, pixels: Floats, surface: Surface
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return ground points, (n, 3), and partials: corrections, (n, 3, 12), height, (n, 3), pixel, (n, 3, 2)."""
    # Slopes change within the offsets, and errors of neighbouring heights are equal: heights shall not move images.
    ground = image_to_ground_and_partials(model, pixels, surface, level=True)
    middle_s, half_s = _span_s(model)
    [position], _ = model.orientation.poses(np.array([middle_s]))
    by_offsets = np.concatenate([ground.by_position @ axes_at(position).T, ground.by_angles], axis=2)
    part = np.zeros(len(pixels))
    if isinstance(model, LineScanModel):
        part = (model.times_s(pixels[:, 1])[0] - middle_s) / half_s
    by_corrections = np.concatenate([by_offsets, part[:, None, None] * by_offsets], axis=2)
    return ground.points_m, by_corrections, ground.by_height, ground.by_pixel


def pixel_size_m(model: SensorModel, pixel: Floats, surface: Surface) -> float:
    """Return the size of a pixel on the ground, m."""
    _, _, _, by_pixel = ground_partials(model, pixel[np.newaxis], surface)
    return math.sqrt(float(np.linalg.norm(np.cross(*by_pixel[0].T))))


def _span_s(model: SensorModel) -> tuple[float, float]:
    """Return the middle and half of the time of an image; a frame has no duration."""
    if isinstance(model, FrameModel):
        return 0.0, 1.0
    first_s, last_s = model.times_s(np.array([-0.5, model.shape[0] - 0.5]))[0]
    return 0.5 * float(first_s + last_s), 0.5 * float(last_s - first_s)


def _equations(
    models: Sequence[SensorModel],
    ties: GroundTies,
    adjusted: Floats,
    surface: Surface,
    sigmas: Floats,
    dem_sigma_m: float,
) -> _Equations:
    """Linearize the equations of all pixels at adjusted pixels."""
    count, points = len(ties.image), len(ties.places_m)
    shapes = (3,), (3, CORRECTION_COUNT), (3,), (3, 2)
    ground, by_corrections, by_height, by_pixel = (np.empty((count, *shape)) for shape in shapes)
    for k, model in enumerate(models):
        rows = np.flatnonzero(ties.image == k)
        if len(rows):
            pixels = np.clip(adjusted[rows], -0.5, np.array(model.shape[::-1]) - 0.5)
            parts = ground_partials(model, pixels, surface)
            ground[rows], by_corrections[rows], by_height[rows], by_pixel[rows] = parts
            ground[rows] += np.einsum("nij,nj->ni", by_pixel[rows], ties.pixels[rows] - pixels)
    number = np.bincount(ties.point, minlength=points)
    sums = [np.bincount(ties.point, weights=axis, minlength=points) for axis in ground.T]
    middle = np.stack(sums, axis=1) / number[:, None]
    to_plane = np.array(
        [east_north_up(lon, lat) for lon, lat, _ in np.transpose(cartesian_to_selenographic(middle))]
    )
    in_plane = to_plane[ties.point, :2]
    to_place = in_plane @ by_pixel
    to_pixel = np.linalg.inv(to_place) @ in_plane
    misclosures = np.einsum("nij,nj->ni", to_pixel, ground - middle[ties.point])
    by_place = -np.swapaxes(in_plane, 1, 2)
    by_point = to_pixel @ np.concatenate([by_place, dem_sigma_m * by_height[:, :, None]], axis=2)
    weights, priors = np.zeros((points, 3)), np.zeros((points, 3))
    weights[:, 2] = 1.0
    stated = np.flatnonzero(np.isfinite(ties.place_sigma_m))
    offset_m = ties.places_m[stated] - middle[stated]
    priors[stated, :2] = np.einsum("nij,nj->ni", to_plane[stated, :2], offset_m)
    priors[stated, 2] = (length(ties.places_m[stated]) - length(middle[stated])) / dem_sigma_m
    scale = np.array([1.0, 1.0, dem_sigma_m])
    weights[stated] = np.square(scale / ties.place_sigma_m[stated, None])
    by_corrections = to_pixel @ by_corrections * sigmas
    return _Equations(ground, to_place, misclosures, by_corrections, by_point, weights, priors)


def _solved(
    equations: _Equations, ties: GroundTies, rows: NDArray[np.bool_], factor: float, corrections: Floats
) -> tuple[Floats, Floats, Floats, float]:
    """Return the step of the corrections, their covariance, residuals in pixels, and the redundancy."""
    from scipy import linalg, sparse

    images, points = corrections.size // CORRECTION_COUNT, len(equations.priors)
    inverse = np.where(rows, 1.0 / (factor * ties.sigma_px), 0.0)[:, None]
    row = np.arange(len(ties.image))
    pointers = np.arange(len(row) + 1)
    by_images = sparse.bsr_array(
        (inverse[:, :, None] * equations.by_corrections, ties.image, pointers),
        shape=(2 * len(row), CORRECTION_COUNT * images),
    ).tocsr()
    scaled = inverse[:, :, None] * equations.by_point
    by_points = sparse.bsr_array((scaled, ties.point, pointers), shape=(2 * len(row), 3 * points)).tocsr()
    # Gauss-Newton about the present corrections, which have the a-priori value zero.
    total = by_images @ corrections.ravel() - (inverse * equations.misclosures_px).ravel()
    blocks: Floats = np.zeros((points, 3, 3))
    np.add.at(blocks, ties.point, np.swapaxes(scaled, 1, 2) @ scaled)
    blocks[:, range(3), range(3)] += equations.prior_weights
    unused = np.bincount(ties.point, weights=rows, minlength=points) == 0
    blocks[unused] = np.eye(3)
    blocks = np.asarray(np.linalg.inv(blocks), np.float64)
    point_inverse = sparse.bsr_array((blocks, np.arange(points), np.arange(points + 1))).tocsr()
    coupling = by_points.T @ by_images
    gain = point_inverse @ coupling
    reduced = (by_images.T @ by_images - coupling.T @ gain).toarray() + np.eye(corrections.size)
    point_right = by_points.T @ total + (equations.prior_weights * equations.priors).ravel() * ~np.repeat(
        unused, 3
    )
    right = by_images.T @ total - gain.T @ point_right
    covariance = np.asarray(linalg.cho_solve(linalg.cho_factor(reduced), np.eye(corrections.size)))
    estimate = covariance @ right
    place = point_inverse @ point_right - gain @ estimate
    residuals = by_images @ estimate + by_points @ place - total
    # The prior takes its part of the parameters: n - (u - trace of prior weights times covariance).
    place_variances = blocks[:, range(3), range(3)].ravel() + np.asarray(
        (gain * (gain @ covariance)).sum(axis=1)
    )
    prior_part = place_variances @ (equations.prior_weights * ~unused[:, None]).ravel() + covariance.trace()
    redundancy = 2.0 * rows.sum() - corrections.size - 3.0 * (~unused).sum() + prior_part
    step = estimate.reshape(corrections.shape) - corrections
    residuals_px = residuals.reshape(-1, 2) * (factor * ties.sigma_px)[:, None]
    return step, covariance, residuals_px, float(redundancy)


def _are_outliers(ties: GroundTies, chi2: Floats) -> NDArray[np.bool_]:
    """Select points with an improbable chi squared."""
    from scipy.special import chdtri

    number = np.bincount(ties.point, minlength=len(chi2))
    return np.asarray(chi2 > chdtri(2 * np.maximum(number - 1, 1), _OUTLIER_PROBABILITY))


def agreement_m(ties: GroundTies, result: StripAdjustment) -> dict[tuple[int, int], Floats]:
    """Return mean east and north and the count of differences of tie points by pairs of images, shape (3,)."""
    rows = np.flatnonzero(result.used[ties.point])
    rows = rows[np.argsort(ties.point[rows], kind="stable")]
    sums: dict[tuple[int, int], Floats] = {}
    for part in np.split(rows, np.flatnonzero(np.diff(ties.point[rows])) + 1):
        for i, first in enumerate(part):
            for second in part[i + 1 :]:
                low, high = sorted((first, second), key=lambda row: int(ties.image[row]))
                difference = result.residuals_m[high] - result.residuals_m[low]
                pair = int(ties.image[low]), int(ties.image[high])
                sums[pair] = sums.get(pair, np.zeros(3)) + np.append(difference, 1.0)
    return {pair: np.array([*total[:2] / total[2], total[2]]) for pair, total in sums.items()}


def require_connected(ties: GroundTies, names: Sequence[str]) -> None:
    """Raise an error for images without tie points."""
    bare = [name for k, name in enumerate(names) if not (ties.image == k).any()]
    if bare and len(names) > 1:
        raise InputError(
            f"no tie points between {bare[0]} and the other images; expected overlapping images under similar Suns "
            "whose offsets are within the a-priori sigmas; leave the image out, or enlarge the sigmas"
        )
