"""Position of a rover or lander from its own stereo images: forward intersection, and resection from landmarks.

The method is that of the Chang'e-3 team (descent images, 2014): points in both images are intersected, and their
distances fitted to the landmarks on a map (equation 6).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import ConvergenceError, InputError
from radioloc.imaging.cameras import Camera, as_points
from radioloc.vectors import Floats

_MAX_STEPS = 20
_STEP_TOLERANCE = 1e-10  # of an intersection as a part of the distance: far below the noise of pixels
_MIN_CHI2_DIFFERENCE = 9.0  # of two places between which distances decide
_START_DIRECTIONS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Intersection:
    """Points in both images, in the axes of the left camera."""

    points_m: Floats  # shape (n, 3)
    covariance_m2: Floats  # from the sigma of the pixels, shape (n, 3, 3)
    misfit: Floats  # separation of the two rays in sigmas, with one degree of freedom


@dataclass(frozen=True, slots=True, eq=False)
class StereoPair:
    """Two calibrated cameras on one body."""

    left: Camera
    right: Camera
    baseline_m: Floats  # the right camera in the left one's axes
    rot_left_to_right: Floats = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        if not self.baseline_m.any():
            raise InputError("baseline_m: expected two cameras at different places, got zero")

    def intersect(self, left_px: ArrayLike, right_px: ArrayLike, sigma_px: float = 0.3) -> Intersection:
        """Intersect the rays of points, (n, 2), in both images by least squares of their four coordinates."""
        left, right = as_points(left_px, 2, "left_px"), as_points(right_px, 2, "right_px")
        points = self._midpoints(left, right)
        observed = np.concatenate([left, right], axis=1)
        for _ in range(_MAX_STEPS):
            computed_left, by_left, visible_left = self.left.pixels_and_partials(points)
            computed_right, by_right, visible_right = self.right.pixels_and_partials(
                (points - self.baseline_m) @ self.rot_left_to_right.T
            )
            _require_intersections(visible_left & visible_right)
            misfit = observed - np.concatenate([computed_left, computed_right], axis=1)
            design = np.concatenate([by_left, by_right @ self.rot_left_to_right], axis=1)
            inverse = np.linalg.inv(np.swapaxes(design, 1, 2) @ design)
            step = np.einsum("nij,nkj,nk->ni", inverse, design, misfit)
            points = points + step
            if (np.abs(step).max(axis=1) <= _STEP_TOLERANCE * np.linalg.norm(points, axis=1)).all():
                break
        else:
            raise ConvergenceError("the rays of a point meet too far away; leave it out")
        return Intersection(points, sigma_px**2 * inverse, np.sqrt((misfit**2).sum(axis=1)) / sigma_px)

    def _midpoints(self, left: Floats, right: Floats) -> Floats:
        """Return the points halfway between two rays."""
        rays = [self.left.directions(left), self.right.directions(right) @ self.rot_left_to_right]
        u, v = (ray / np.linalg.norm(ray, axis=1)[:, None] for ray in rays)
        cosine = (u * v).sum(axis=1)
        sine2 = 1.0 - cosine**2
        _require_intersections(sine2 > 1e-14)
        base_u, base_v = u @ self.baseline_m, v @ self.baseline_m
        range_u, range_v = (base_u - cosine * base_v) / sine2, (cosine * base_u - base_v) / sine2
        _require_intersections((range_u > 0.0) & (range_v > 0.0))
        return 0.5 * (range_u[:, None] * u + self.baseline_m + range_v[:, None] * v)


def _require_intersections(valid: NDArray[np.bool_]) -> None:
    if not valid.all():
        raise InputError(
            f"the rays of point {int(np.argmin(valid)) + 1} do not meet in front of both cameras; check that it is the "
            "same point in both images"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Resection:
    """Position of a camera from n distances to landmarks, in the plane."""

    position_m: Floats  # east and north, shape (2,)
    covariance_m2: Floats  # from the sigmas of distances and landmarks, shape (2, 2)
    residuals_m: Floats  # measured less computed distances, shape (n,)
    chi2: float  # of the residuals, with n - 2 degrees of freedom


def resect(
    landmarks_m: Floats, distances_m: ArrayLike, distance_sigma_m: ArrayLike, landmark_sigma_m: float
) -> Resection:
    """Locate a camera by its horizontal distances to landmarks, (n, 2), east and north on a map (equation 6)."""
    # The sigma of landmarks is that of each coordinate on the map, without the tie of the map as a whole.
    from scipy.optimize import least_squares

    sigmas = np.sqrt(np.square(distance_sigma_m) + landmark_sigma_m**2)

    def misfit(place: Floats) -> Floats:
        return np.asarray((distances_m - np.linalg.norm(landmarks_m - place, axis=1)) / sigmas)

    # Starts at the middle of the landmarks and all around it: distances alone may fit several places.
    middle, reach = landmarks_m.mean(axis=0), float(np.max(distances_m))
    azimuths = np.linspace(0.0, 2.0 * np.pi, _START_DIRECTIONS, endpoint=False)
    starts = [middle + reach * np.array([np.cos(a), np.sin(a)]) for a in azimuths]
    fits = sorted((least_squares(misfit, start) for start in (middle, *starts)), key=lambda fit: fit.cost)
    best = fits[0]
    covariance = np.linalg.pinv(best.jac.T @ best.jac)
    for fit in fits[1:]:
        separation_m = np.linalg.norm(fit.x - best.x)
        ambiguous = 2.0 * (fit.cost - best.cost) < _MIN_CHI2_DIFFERENCE
        if ambiguous and separation_m > 5.0 * np.sqrt(covariance.trace()):
            raise ConvergenceError(
                f"the distances fit two places, {separation_m:.1f} m apart; add a landmark in another direction"
            )
    return Resection(best.x, covariance, best.fun * sigmas, 2.0 * float(best.cost))
