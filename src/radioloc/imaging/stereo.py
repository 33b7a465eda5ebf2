"""Where a rover or lander stands from its own stereo images: forward intersection, and landmarks that the map shows.

The method is that of the Chang'e-3 team (descent images, 2014): points seen by both cameras are intersected, their
distances compared with where a map has them (equation 6).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import ConvergenceError, InputError
from radioloc.imaging.cameras import Camera, as_points
from radioloc.vectors import Floats

_STEPS = 20
_SETTLED = 1e-10  # last step of an intersection as a part of the distance: far below what pixels tell
_AS_GOOD = 9.0
"""Difference of the sums of squares, in sigmas squared, of two places below which distances do not tell them apart."""
_DIRECTIONS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Intersection:
    """Points seen by both cameras, in the axes of the left one."""

    points_m: Floats  # shape (n, 3)
    covariance_m2: Floats  # from the sigma of the pixels, shape (n, 3, 3)
    misfit: Floats  # how far the two rays pass each other in sigmas; the square is of one degree of freedom


@dataclass(frozen=True, slots=True, eq=False)
class StereoPair:
    """Two calibrated cameras on one body."""

    left: Camera
    right: Camera
    baseline_m: Floats  # the right camera in the left one's axes
    rot_left_to_right: Floats = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        if not self.baseline_m.any():
            raise InputError("baseline_m is zero: the two cameras stand at one place")

    def intersect(self, left_px: ArrayLike, right_px: ArrayLike, sigma_px: float = 0.3) -> Intersection:
        """Intersect the rays of points, (n, 2), that both images show, by least squares of their four coordinates."""
        left, right = as_points(left_px, 2, "left_px"), as_points(right_px, 2, "right_px")
        points = self._nearest_to_both_rays(left, right)
        observed = np.concatenate([left, right], axis=1)
        for _ in range(_STEPS):
            seen_left, by_left, before_left = self.left.pixels_and_partials(points)
            seen_right, by_right, before_right = self.right.pixels_and_partials(
                (points - self.baseline_m) @ self.rot_left_to_right.T
            )
            self._require(before_left & before_right)
            misfit = observed - np.concatenate([seen_left, seen_right], axis=1)
            design = np.concatenate([by_left, by_right @ self.rot_left_to_right], axis=1)
            inverse = np.linalg.inv(np.swapaxes(design, 1, 2) @ design)
            step = np.einsum("nij,nkj,nk->ni", inverse, design, misfit)
            points = points + step
            if (np.abs(step).max(axis=1) <= _SETTLED * np.linalg.norm(points, axis=1)).all():
                break
        else:
            raise ConvergenceError("the rays of a point meet too far away to be intersected; leave it out")
        return Intersection(points, sigma_px**2 * inverse, np.sqrt((misfit**2).sum(axis=1)) / sigma_px)

    def _nearest_to_both_rays(self, left: Floats, right: Floats) -> Floats:
        """Points halfway between two rays, which is where the intersection starts."""
        rays = [self.left.directions(left), self.right.directions(right) @ self.rot_left_to_right]
        one, two = (ray / np.linalg.norm(ray, axis=1)[:, None] for ray in rays)
        cosine = (one * two).sum(axis=1)
        sine2 = 1.0 - cosine**2
        self._require(sine2 > 1e-14)
        along_one, along_two = one @ self.baseline_m, two @ self.baseline_m
        to_one, to_two = (along_one - cosine * along_two) / sine2, (cosine * along_one - along_two) / sine2
        self._require((to_one > 0.0) & (to_two > 0.0))
        return 0.5 * (to_one[:, None] * one + self.baseline_m + to_two[:, None] * two)

    @staticmethod
    def _require(ahead: NDArray[np.bool_]) -> None:
        if not ahead.all():
            raise InputError(
                f"the rays of point {int(np.argmin(ahead)) + 1} meet nowhere before both cameras; "
                "is it the same point in both images?"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Resection:
    """The place of a camera from n distances to landmarks, in the plane."""

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

    # From the middle of the landmarks and from all around it: distances alone may have several places.
    middle, reach = landmarks_m.mean(axis=0), float(np.max(distances_m))
    around = np.linspace(0.0, 2.0 * np.pi, _DIRECTIONS, endpoint=False)
    starts = [middle + reach * np.array([np.cos(a), np.sin(a)]) for a in around]
    found = sorted((least_squares(misfit, start) for start in (middle, *starts)), key=lambda fit: fit.cost)
    best = found[0]
    covariance = np.linalg.pinv(best.jac.T @ best.jac)
    for other in found[1:]:
        apart = np.linalg.norm(other.x - best.x)
        if 2.0 * (other.cost - best.cost) < _AS_GOOD and apart > 5.0 * np.sqrt(covariance.trace()):
            raise ConvergenceError(
                f"the distances fit two places {apart:.1f} m apart equally well; add a landmark in another direction"
            )
    return Resection(best.x, covariance, best.fun * sigmas, 2.0 * float(best.cost))
