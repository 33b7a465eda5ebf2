"""Points of the ground in a pair of stereo images: matched densely, and intersected with their covariance.

Both images are rectified, so that a point has equal lines in them. Semi-global matching (Hirschmueller 2008, by OpenCV)
finds its shift along the line. The pixels lead back to the images, where rays are intersected
(:class:`radioloc.imaging.stereo.StereoPair`). Coordinates are in the axes of the body: ahead, right, down.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from radioloc.errors import InputError
from radioloc.estimation.statistics import robust_scale
from radioloc.imaging.frames import load_opencv, read_frame
from radioloc.imaging.point_location import MAX_MISFIT_SIGMAS, build_provenance, stereo_pair
from radioloc.imaging.stereo import StereoPair
from radioloc.imaging.study import PointStudy, StereoPairChoice
from radioloc.lunar.grey_images import Image
from radioloc.results.cards import Card, Field, metres, provenance_detail
from radioloc.results.result import Content, Result, Table
from radioloc.vectors import Floats

BODY_AXES = ("ahead", "right", "down")
_BLOCK_PX = 7
_DISPARITY_UNITS = 16  # of OpenCV's matching, per pixel
_CLOUD_STEP_PX = 3
_MAX_SIGMA_PART = 0.05  # of the distance, for points of the cloud
_NEIGHBOURHOOD_PX = 3  # around a chosen feature; the median of its shifts is used
# Rows: ahead, right and down in the axes of a camera: right, down, ahead.
_BODY_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class StereoPoints(Result):
    """Points of a pair of stereo images in the axes of the body.

    Parameters
    ----------
    name : str
    features : tuple of str
        Names of the chosen features.
    feature_m : ndarray, shape (k, 3)
        Their coordinates ahead, right, down, m.
    feature_covariance_m2 : ndarray, shape (k, 3, 3)
    cloud_m : ndarray, shape (n, 3)
        Coordinates of all points, m.
    cloud_sigma_m : ndarray, shape (n,)
        Root of the largest eigenvalue of their covariance, m.
    grey : ndarray, shape (n,)
        Brightness of the points in the left image.
    provenance : mapping
    """

    name: str
    features: tuple[str, ...]
    feature_m: Floats
    feature_covariance_m2: Floats
    cloud_m: Floats = field(repr=False)
    cloud_sigma_m: Floats = field(repr=False)
    grey: Image = field(repr=False)
    provenance: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def distances(self) -> list[dict[str, Any]]:
        """Return the distance of each pair of features with its sigma, m; errors of pixels are independent."""
        rows = []
        for i, j in combinations(range(len(self.features)), 2):
            difference = self.feature_m[j] - self.feature_m[i]
            distance_m = float(np.linalg.norm(difference))
            unit = difference / (distance_m or 1.0)
            variance = unit @ (self.feature_covariance_m2[i] + self.feature_covariance_m2[j]) @ unit
            names = [self.features[i], self.features[j]]
            rows.append({"features": names, "distance_m": distance_m, "sigma_m": math.sqrt(variance)})
        return rows

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers but the cloud in types that JSON has."""
        return {
            "name": self.name,
            "method": "stereo_pair",
            "axes": list(BODY_AXES),
            "features": [
                {"name": name, "position_m": position.tolist(), "covariance_m2": covariance.tolist()}
                for name, position, covariance in zip(
                    self.features, self.feature_m, self.feature_covariance_m2, strict=True
                )
            ],
            "distances": self.distances(),
            "points": len(self.cloud_m),
            "provenance": dict(self.provenance),
        }

    def files(self) -> Mapping[str, Content]:
        """Return ``stereo_points.json``, ``points.csv`` and ``points.ply``."""
        columns = {f"{axis}_m": values for axis, values in zip(BODY_AXES, self.cloud_m.T, strict=True)}
        table = Table(
            {**columns, "sigma_m": self.cloud_sigma_m, "grey": self.grey}, dict.fromkeys(columns, 4)
        )
        names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "sigma"))
        colours = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
        header = (
            f"ply\nformat ascii 1.0\ncomment x ahead, y right, z down, m\nelement vertex {len(self.grey)}\n"
        )
        rows = np.column_stack([self.cloud_m, self.cloud_sigma_m, self.grey, self.grey, self.grey])
        lines = "".join("{:.4f} {:.4f} {:.4f} {:.4f} {:.0f} {:.0f} {:.0f}\n".format(*row) for row in rows)
        ply = f"{header}{names}{colours}end_header\n{lines}"
        return {"stereo_points.json": self.to_dict(), "points.csv": table, "points.ply": ply}

    def card(self) -> Card:
        """Return the card of the points."""
        sigmas = np.sqrt(np.diagonal(self.feature_covariance_m2, axis1=1, axis2=2))
        rows = [
            (name, *(f"{value:.3f}" for value in position), *map(metres, sigma))
            for name, position, sigma in zip(self.features, self.feature_m, sigmas, strict=True)
        ]
        heading = ("feature", "ahead, m", "right, m", "down, m", "sigmas, m", "", "")
        distances = (
            f"{' to '.join(row['features'])}: {row['distance_m']:.3f} m, sigma {metres(row['sigma_m'])} m"
            for row in self.distances()
        )
        return Card(
            (
                Field("stereo pair", (self.name, f"{len(self.grey)} points")),
                Field("features", (), heading, rows),
                Field("distances", distances),
            ),
            (provenance_detail(self.provenance),),
        )


def measure_stereo(study: PointStudy) -> StereoPoints:
    """Measure the points of ``[stereo_pair]``."""
    chosen = study.chosen
    assert isinstance(chosen, StereoPairChoice)
    images = [read_frame(path) for path in (chosen.left_image, chosen.right_image)]
    if images[0].shape != images[1].shape:
        raise InputError(
            f"expected images of one size, got {images[0].shape} and {images[1].shape} lines and samples"
        )
    pair = stereo_pair(chosen, images[0].shape)
    left_px, right_px = _matched(pair, images[0], images[1], chosen.nearest_m, chosen.point_sigma_px)
    rows = [_nearest_matches(left_px, feature.left_px, feature.name) for feature in chosen.features]
    # The right pixel of a feature: its own left pixel, less the median shift of its neighbours.
    of_features = [np.array(feature.left_px) + np.median(right_px[k] - left_px[k], axis=0)
                   for feature, k in zip(chosen.features, rows, strict=True)]  # fmt: skip
    lines, samples = np.rint(left_px[:, ::-1]).astype(int).T
    lattice = (lines % _CLOUD_STEP_PX == 0) & (samples % _CLOUD_STEP_PX == 0)
    cloud = pair.intersect(left_px[lattice], right_px[lattice], chosen.point_sigma_px)
    sigma_m = np.sqrt(np.linalg.eigvalsh(cloud.covariance_m2)[:, -1])
    consistent = cloud.misfit < MAX_MISFIT_SIGMAS
    consistent &= sigma_m < _MAX_SIGMA_PART * np.linalg.norm(cloud.points_m, axis=1)
    to_body = _rot_camera_to_body(chosen)
    feature_m, covariance_m2 = np.zeros((0, 3)), np.zeros((0, 3, 3))
    if of_features:
        pixels = [feature.left_px for feature in chosen.features]
        points = pair.intersect(pixels, of_features, chosen.point_sigma_px)
        feature_m, covariance_m2 = points.points_m, to_body @ points.covariance_m2 @ to_body.T
        feature_m = feature_m @ to_body.T + chosen.camera_in_body_m
    return StereoPoints(
        study.name,
        tuple(feature.name for feature in chosen.features),
        feature_m,
        covariance_m2,
        (cloud.points_m @ to_body.T + chosen.camera_in_body_m)[consistent],
        sigma_m[consistent],
        images[0][lines[lattice], samples[lattice]][consistent],
        build_provenance(study.path, (chosen.left_image, chosen.right_image), ()),
    )


def _matched(
    pair: StereoPair, left_image: Image, right_image: Image, nearest_m: float, sigma_px: float
) -> tuple[Floats, Floats]:
    """Return the pixels of all matched points in both images, shape (n, 2)."""
    cv2 = load_opencv()
    size = left_image.shape[::-1]
    rotation = pair.rot_left_to_right
    no_distortion = np.zeros(5)
    shift_m = (-rotation @ pair.baseline_m)[:, None]
    rectified = cv2.stereoRectify(
        pair.left.matrix, no_distortion, pair.right.matrix, no_distortion, size, rotation, shift_m, alpha=-1
    )
    to_left, to_right, camera = rectified[0], rectified[1], rectified[2][:, :3]
    places = np.stack(np.meshgrid(*map(np.arange, size)), axis=-1).reshape(-1, 2).astype(np.float64)
    views = []
    for model, turn, image in ((pair.left, to_left, left_image), (pair.right, to_right, right_image)):
        at = _in_image(model, turn, camera, places).astype(np.float32).reshape(*left_image.shape, 2)
        views.append(cv2.remap(image, at, None, cv2.INTER_LINEAR))
    baseline_m = float(np.linalg.norm(pair.baseline_m))
    count = 16 * math.ceil(camera[0, 0] * baseline_m / nearest_m / 16.0)
    matcher = cv2.StereoSGBM_create(
        0, count, _BLOCK_PX, 8 * _BLOCK_PX**2, 32 * _BLOCK_PX**2, 1, 31, 10, 100, 2, cv2.STEREO_SGBM_MODE_SGBM
    )
    shift = matcher.compute(*views) / _DISPARITY_UNITS
    matched = ((shift > 0.0) & (_shift_variance(views[0], views[1], shift) < sigma_px**2)).ravel()
    shift = shift.ravel()
    if not matched.any():
        raise InputError(
            "no point of the left image was found in the right; check cameras, baseline and rotation"
        )
    moved = places[matched] - np.column_stack([shift[matched], np.zeros(matched.sum())])
    pixels = (
        _in_image(pair.left, to_left, camera, places[matched]),
        _in_image(pair.right, to_right, camera, moved),
    )
    visible = np.all([(p >= 0.0) & (p <= np.array(size) - 1.0) for p in pixels], axis=(0, 2))
    return pixels[0][visible], pixels[1][visible]


def _shift_variance(left: Image, right: Image, shift: Floats) -> Floats:
    """Return the variance of shifts, px^2: twice that of noise over the squared gradients along the lines of a block.

    Along an edge without texture, such as the horizon, neighbouring shifts fit as well.
    """
    cv2 = load_opencv()
    lines, samples = np.indices(shift.shape, np.float32)
    moved = cv2.remap(right, (samples - shift).astype(np.float32), lines, cv2.INTER_LINEAR)
    difference = (left.astype(np.float64) - moved)[shift > 0.0]
    noise = 0.5 * robust_scale(difference - np.median(difference), 0) ** 2 if len(difference) else 0.0
    gradient = 0.5 * cv2.Sobel(left, cv2.CV_64F, 1, 0, ksize=1)
    energy = cv2.boxFilter(gradient**2 - 0.5 * noise, -1, (_BLOCK_PX, _BLOCK_PX), normalize=False)
    return np.divide(2.0 * noise, energy, out=np.full_like(energy, np.inf), where=energy > 0.0)


def _in_image(model: Any, to_rectified: Floats, camera: Floats, places: Floats) -> Floats:
    """Return the pixels of an image at places of its rectified one."""
    directions = np.column_stack([places, np.ones(len(places))]) @ np.linalg.inv(camera).T @ to_rectified
    return np.asarray(model.pixels(directions)[0])


def _nearest_matches(left_px: Floats, pixel: tuple[float, float], name: str) -> Any:
    """Return the matches around a chosen feature."""
    rows = np.flatnonzero((np.abs(left_px - pixel) <= _NEIGHBOURHOOD_PX).all(axis=1))
    if not len(rows):
        raise InputError(
            f"feature {name!r}: no match in the right image at {list(pixel)}; choose a pixel with texture"
        )
    return rows


def _rot_camera_to_body(chosen: StereoPairChoice) -> Floats:
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_euler("ZYX", chosen.camera_attitude_deg, degrees=True).as_matrix()
    return np.asarray(turn @ _BODY_FROM_CAMERA)
