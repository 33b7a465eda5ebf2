"""Where a rover or lander stands from its own stereo images: forward intersection, and landmarks that the map shows.

The method is that of the Chang'e-3 team (descent images, 2014): points seen by both cameras are intersected, their
distances compared with where a map has them (equation 6).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.boundary import bare_arguments
from radioloc.errors import ConvergenceError, InputError
from radioloc.imaging.cameras import Camera, as_points, as_rotation, as_vector
from radioloc.vectors import Floats

_STEPS = 20
_SETTLED = 1e-10
"""Last step of an intersection as a part of the distance: far below what pixels tell."""
_AS_GOOD = 9.0
"""Difference of the sums of squares, in sigmas squared, of two places below which distances do not tell them apart."""
_DIRECTIONS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Intersection:
    """Points seen by both cameras, in the axes of the left one."""

    points_m: Floats  # shape (n, 3)
    covariance_m2: Floats  # from the sigma of the pixels, shape (n, 3, 3)
    misfit: Floats  # how far the two rays pass each other in sigmas; the square is of one degree of freedom

    @property
    def distances_m(self) -> Floats:
        """From the left camera, m, shape (n,)."""
        return np.linalg.norm(self.points_m, axis=1)

    @property
    def distance_sigmas_m(self) -> Floats:
        """Standard deviations of the distances, m, shape (n,)."""
        unit = self.points_m / self.distances_m[:, None]
        return np.sqrt(np.einsum("ni,nij,nj->n", unit, self.covariance_m2, unit))


@dataclass(frozen=True, slots=True, eq=False)
class StereoPair:
    """Two calibrated cameras on one body.

    Parameters
    ----------
    left, right : Camera
        Each with its own focal length and distortion.
    baseline_m : array_like, shape (3,)
        The right camera's place in the left one's axes, m.
    rot_left_to_right : array_like, shape (3, 3)
        Rotation from the left camera's axes to the right one's; the identity if not given.

    Raises
    ------
    InputError
        The baseline is not three finite numbers that are not all zero, or the rotation is none.
    """

    left: Camera
    right: Camera
    baseline_m: Floats
    rot_left_to_right: Floats | None = None

    def __post_init__(self) -> None:
        baseline = as_vector(self.baseline_m, 3, "baseline_m")
        if not baseline.any():
            raise InputError("baseline_m is zero: the two cameras stand at one place")
        rotation = np.eye(3) if self.rot_left_to_right is None else self.rot_left_to_right
        object.__setattr__(self, "baseline_m", baseline)
        object.__setattr__(self, "rot_left_to_right", as_rotation(rotation, "rot_left_to_right"))

    @bare_arguments
    def intersect(self, left_px: ArrayLike, right_px: ArrayLike, sigma_px: float = 0.3) -> Intersection:
        """Intersect the rays of points that both images show, by least squares of their four coordinates.

        Parameters
        ----------
        left_px, right_px : array_like, shape (n, 2)
            (sample, line) of the same points.
        sigma_px : float
            Standard deviation of each coordinate, pixels.

        Raises
        ------
        InputError
            Pixels are not finite, not as many in both images, or rays that meet nowhere before both cameras: then one
            of the two is another point.

        Examples
        --------
        >>> from radioloc.imaging import Camera, StereoPair
        >>> camera = Camera.of_pinhole(17.7, 15.0, [511.5, 511.5])
        >>> pair = StereoPair(camera, camera, [0.27, 0.0, 0.0])
        >>> found = pair.intersect([[511.5, 511.5]], [[491.5, 511.5]])
        >>> found.points_m.round(3).tolist(), found.distance_sigmas_m.round(2).tolist()
        ([[0.0, 0.0, 15.93]], [0.34])
        """
        left, right = as_points(left_px, 2, "left_px"), as_points(right_px, 2, "right_px")
        if len(left) != len(right):
            raise InputError(f"left_px has {len(left)} points, right_px {len(right)}; each must be in both")
        if not sigma_px > 0.0:
            raise InputError(f"sigma_px = {sigma_px!r} is not a positive number of pixels")
        assert self.rot_left_to_right is not None
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
        assert self.rot_left_to_right is not None
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
    """The place of a camera from n distances to landmarks, in d dimensions."""

    position_m: Floats  # on the map's axes, shape (d,)
    covariance_m2: Floats  # from the sigmas of distances and landmarks, shape (d, d)
    residuals_m: Floats  # measured less computed distances, shape (n,)
    chi2: float  # of the residuals, with n - d degrees of freedom


@bare_arguments
def resect(
    landmarks_m: ArrayLike,
    distances_m: ArrayLike,
    distance_sigma_m: ArrayLike,
    landmark_sigma_m: float,
) -> Resection:
    """Locate a camera by its distances to landmarks that a map shows (equation 6).

    Parameters
    ----------
    landmarks_m : array_like, shape (n, d)
        Four points or more: east and north with horizontal distances, or three coordinates with those in space, m.
    distances_m : array_like, shape (n,)
    distance_sigma_m : array_like, scalar or shape (n,)
        Standard deviations, such as :attr:`Intersection.distance_sigmas_m`.
    landmark_sigma_m : float
        Standard deviation of each coordinate of a landmark on the map, m. How well the map as a whole is tied to the
        Moon is not in it.

    Raises
    ------
    InputError
        There are fewer than four landmarks, or a number is not right.
    ConvergenceError
        The landmarks do not tell two places apart, as those on a line do not.

    Examples
    --------
    >>> from radioloc.imaging import resect
    >>> found = resect([[9.0, 0.0], [0.0, 9.0], [-9.0, 1.0], [1.0, -9.0]], [9.0, 9.0, 9.06, 9.06], 0.1, 0.2)
    >>> [round(abs(value), 1) for value in found.position_m.tolist()]
    [0.0, 0.0]
    """
    from scipy.optimize import least_squares

    dimensions = np.shape(landmarks_m)[-1] if np.ndim(landmarks_m) == 2 else 0
    if dimensions not in (2, 3):
        raise InputError(
            "landmarks_m: east and north, or three coordinates, are needed, shape (n, 2) or (n, 3)"
        )
    landmarks = as_points(landmarks_m, dimensions, "landmarks_m")
    distances = np.asarray(distances_m, dtype=np.float64)
    if (
        distances.shape != (len(landmarks),)
        or not (distances > 0.0).all()
        or not np.isfinite(distances).all()
    ):
        raise InputError("distances_m: one positive number for each landmark is needed")
    if len(landmarks) < 4:
        raise InputError(f"{len(landmarks)} landmarks; four or more are needed, so that a wrong one shows")
    variances = np.square(distance_sigma_m) + landmark_sigma_m**2
    if not (np.isfinite(variances).all() and np.all(variances > 0.0)):
        raise InputError("distance_sigma_m and landmark_sigma_m must be finite, and not both zero")
    sigmas = np.sqrt(np.broadcast_to(variances, distances.shape))

    def misfit(place: Floats) -> Floats:
        return np.asarray((distances - np.linalg.norm(landmarks - place, axis=1)) / sigmas)

    # From the middle of the landmarks and from all around it: distances alone may have several places.
    middle, reach = landmarks.mean(axis=0), float(distances.max())
    around = np.linspace(0.0, 2.0 * np.pi, _DIRECTIONS, endpoint=False)
    starts = [middle + reach * np.array([np.cos(a), np.sin(a), 0.3][:dimensions]) for a in around]
    starts += [start * ([1.0, 1.0, -1.0][:dimensions]) for start in starts if dimensions == 3]
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
