r"""Self-calibration: focal length and radial distortion of the camera from the tie points of a descent.

The parameters g are the relative error of the focal length and that of k1. C are the partials of all pixels with
respect to g, and :math:`C_\perp` is the part of C that images and places of tie points do not absorb. With residuals r,
weights W and a-priori variances S,

.. math:: (C^T W C_\perp + S^{-1})\, g = C^T W r

The place of a pixel follows g by way of its image. A parameter is *estimated* if the images reduce its sigma to less
than half of the a-priori sigma, otherwise *considered*. In both cases its error is part of the sigma of the place.

Relief of ground taken as a plane displaces points radially, as k1 does, but not alike in all images. The parts of
images in the right side, less those of a common g, have a scatter. If it exceeds that by W, W is divided by the ratio.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from radioloc.imaging.adjustment import Adjusted, Indices, TiePoints, absorbed
from radioloc.imaging.projections import Poses
from radioloc.vectors import Floats

_MAX_ESTIMATED_PART = 0.5  # of the a-priori sigma, for an estimated parameter
NAMES = ("focal length", "k1")


@dataclass(frozen=True, slots=True, eq=False)
class SelfCalibration:
    """Errors of the relative focal length and of k1, estimated or considered."""

    values: Floats  # shape (2,)
    covariance: Floats  # shape (2, 2)
    prior_sigmas: Floats  # shape (2,)
    steps: Floats  # corrections of images by the parameters, shape (2, images, 8)
    cameras: Floats  # matrices from directions to pixels, shape (images, 3, 3)

    @property
    def sigmas(self) -> Floats:
        """Standard deviations of both parameters, shape (2,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def is_estimated(self) -> tuple[bool, bool]:
        """True for each parameter that the images determine."""
        focal, k1 = (self.sigmas > 0.0) & (self.sigmas < _MAX_ESTIMATED_PART * self.prior_sigmas)
        return bool(focal), bool(k1)

    def place_partials(self, result: Adjusted, image: int, pixel: Floats) -> Floats:
        """Return partials of the place of an undistorted pixel with respect to both parameters, m, shape (2, 2)."""
        index = np.array([image])
        place = result.model.place(image, pixel)[np.newaxis]
        projected = result.model.project(index, np.array([0]), place)
        patterns = _patterns(result, self.cameras, index, pixel[np.newaxis])[:, 0]
        moved = self.steps[:, image] @ projected.by_parameters[0].T - patterns
        return np.asarray(np.linalg.solve(projected.by_place[0], moved.T))


def self_calibration(
    ties: TiePoints, result: Adjusted, cameras: Floats, prior_sigmas: Floats
) -> SelfCalibration:
    """Estimate both parameters from the residuals; those with a zero sigma are fixed."""
    patterns = _patterns(result, cameras, ties.image, ties.pixels - result.residuals_px)
    steps, remaining = zip(*(absorbed(ties, result, pattern) for pattern in patterns), strict=True)
    weights = result.used / np.square(result.sigma_factors[0] * ties.sigma_px)
    scaled = prior_sigmas[:, np.newaxis, np.newaxis] * patterns * weights[:, np.newaxis]
    normal = np.einsum("inp,jnp->ij", scaled, np.array(remaining)) * prior_sigmas
    normal = 0.5 * (normal + normal.T)
    right = np.einsum("inp,np->i", scaled, result.residuals_px)
    if not isinstance(result.model, Poses):
        common = np.tensordot(prior_sigmas * np.linalg.solve(normal + np.eye(2), right), remaining, 1)
        parts = (scaled * (result.residuals_px - common)).sum(axis=2)
        ratio = max(
            _scatter_ratio(np.bincount(ties.image, part, result.model.images).astype(float), float(variance))
            for part, variance in zip(parts, np.diag(normal), strict=True)
        )
        normal, right = normal / ratio, right / ratio
    covariance = np.linalg.inv(normal + np.eye(2)) * np.outer(prior_sigmas, prior_sigmas)
    values = prior_sigmas * np.linalg.solve(normal + np.eye(2), right)
    return SelfCalibration(values, covariance, prior_sigmas, np.array(steps), cameras)


def _scatter_ratio(by_image: Floats, variance: float) -> float:
    """Return the variance of the sum of parts of images by their scatter over that by noise, at least 1.

    Neighbouring images show the same relief, so their parts are correlated (initial positive sequence, as on the map).
    One image does not separate relief from the camera.
    """
    count = len(by_image)
    if not variance > 0.0:
        return 1.0
    lags = np.correlate(by_image, by_image, "full")[count - 1 :]
    lags *= np.logical_and.accumulate(lags > 0.0)
    scatter = (2.0 * lags.sum() - lags[0]) / variance
    return max(1.0, float(scatter) * count / (count - 1)) if count > 1 else math.inf


def _patterns(result: Adjusted, cameras: Floats, image: Indices, pixels: Floats) -> Floats:
    """Return partials of undistorted pixels with respect to the relative focal length and k1, shape (2, n, 2)."""
    from_axis = pixels - cameras[image, :2, 2]
    posed = ~result.model.low[image] if isinstance(result.model, Poses) else np.zeros(len(pixels), bool)
    focal_px = np.sqrt(np.abs(np.linalg.det(cameras[:, :2, :2])))[image]
    radius2 = (from_axis**2).sum(axis=1) / focal_px**2
    return np.stack([from_axis * posed[:, np.newaxis], from_axis * radius2[:, np.newaxis]])
