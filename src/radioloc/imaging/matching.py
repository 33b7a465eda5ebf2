r"""Tie points of two images: detected, compared, and believed only if chance does not make as many that agree.

Features are detected after local equalization of contrast, so that dark and bright ground give as many. Two are a
candidate if each is the other's nearest and the second nearest is farther by the ratio test (Lowe 2004). Of SIFT, the
square roots of descriptions are compared (Arandjelovic and Zisserman 2012), of wider surroundings than usual. A robust
search (MAGSAC++, Barath et al. 2020) finds the homography with which most candidates agree; least squares refine it.

Whether k of n candidates that agree are more than chance makes is asked by the number of false alarms (Moisan and
Stival 2004, equation 7): how many transformations one would find by chance, of points thrown on the image at random,

.. math:: \mathrm{NFA} = (n - 4) \binom{n}{k} \binom{k}{4} \alpha^{k - 4}

with :math:`\alpha` the chance that a random point falls within the tolerance of a place. Points near each other count
once, so that a cluster on one rock or one speck of dirt is no evidence. A transformation that no camera above the
ground makes is refused: one that turns the plane over, as of a mirrored image, or stretches it out of proportion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.imaging.frames import load_opencv
from radioloc.imaging.homography import derivative, fit_homography, transformed
from radioloc.lunar.grey_images import Image, Mask
from radioloc.vectors import Floats

Indices = NDArray[np.int64]

_DESCRIBED = 1.5  # widths of what SIFT describes: more of the surroundings is alike under another sun
_TOLERANCE_PX = 3.0  # five sigmas of features under another sun
_FALSE_ALARMS = 1e-6  # of all transformations tried on one pair of images
_CELL_TOLERANCES = 4.0  # features nearer to each other than this are one
_LARGEST_SCALE = 30.0
_LARGEST_STRETCH = 5.0  # seen some 78 degrees off the vertical
_ROOT_SCALE = 512.0  # the largest of 128 numbers is below 255
_CONTRAST_LIMIT, _CONTRAST_TILES = 3.0, (8, 8)
_SATURATED_PART = 0.9
_FEWEST_FEATURES = 12
_CHUNK_DISTANCES = 2**19

# Scatter of places of features of one scene under other suns: of small ones 0.5 pixel, of large ones a twentieth of
# their diameter (the pairs of real images in the tests).
_SIGMA_PX, _SIGMA_OF_SIZE = 0.5, 0.05


class Detector(StrEnum):
    """What finds and describes features."""

    SIFT = "sift"
    ORB = "orb"


_DESCRIPTOR_BYTES = {Detector.SIFT: 128, Detector.ORB: 32}
# Lowe 2004, section 7.1, has 0.8. With square roots of SIFT's numbers more pairs are right where their ratio is near 1.
# It is of distances: Euclidean ones of SIFT, here squared, and numbers of bits of ORB.
_RATIO = {Detector.SIFT: 0.9**2, Detector.ORB: 0.8}


class MatchStatus(StrEnum):
    """What became of a pair of images."""

    MATCHED = "matched"
    FEATURELESS = "featureless"  # one of the images is black, saturated, or without detail
    UNMATCHED = "unmatched"  # no more tie points agree than chance makes
    IMPLAUSIBLE = "implausible"  # they agree with a view that no camera has


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Features of one image."""

    pixels: Floats  # shape (n, 2)
    sigma_px: Floats  # of each of the two coordinates, shape (n,)
    descriptors: NDArray[np.uint8]  # of SIFT 128 numbers each, of ORB 32
    shape: tuple[int, int]  # lines and samples of the image
    detector: Detector

    def moved(self, pixels: Floats, sigma_px: Floats, shape: tuple[int, int]) -> Features:
        """Return the same features at other pixels, such as those of the image that was reduced."""
        return Features(pixels, sigma_px, self.descriptors, shape, self.detector)


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Tie points of two images."""

    status: MatchStatus
    first: Indices  # features of the first image that have a partner,
    second: Indices  # and their partners in the second
    candidates: int  # pairs before the robust search
    log10_false_alarms: float  # of the agreement; chance makes fewer than ten to this
    matrix: Floats | None  # from pixels of the first image to those of the second

    @property
    def matched(self) -> bool:
        """Whether the tie points can be believed."""
        return self.status is MatchStatus.MATCHED


def detect(
    image: Image, mask: Mask | None = None, detector: Detector = Detector.SIFT, count: int = 2000
) -> Features:
    """Detect and describe so many features, those of most contrast in each part of the image; none of a flat image."""
    cv2 = load_opencv()
    usable = np.ones(image.shape, bool) if mask is None else mask
    points: Any = ()
    descriptors: Any = None
    if usable.any() and not _flat(image[usable]):
        equalized = cv2.createCLAHE(_CONTRAST_LIMIT, _CONTRAST_TILES).apply(image)
        engine = _engine(cv2, detector, count)
        points = engine.detect(equalized, usable.astype(np.uint8))
        points = [points[k] for k in _spread(points, image.shape, count)]
        points, descriptors = _described(engine, detector, equalized, points)
    return Features(
        np.array([p.pt for p in points], dtype=np.float64).reshape(-1, 2),
        np.hypot(_SIGMA_PX, _SIGMA_OF_SIZE * np.array([p.size for p in points], dtype=np.float64)),
        np.asarray(
            np.zeros((0, _DESCRIPTOR_BYTES[detector])) if descriptors is None else descriptors, np.uint8
        ),
        (image.shape[0], image.shape[1]),
        detector,
    )


def match(
    first: Features, second: Features, predicted: Floats | None = None, radius_px: float = math.inf
) -> Matches:
    """Find the tie points of two images and the homography between them, within a radius of predicted partners."""
    if min(len(first.pixels), len(second.pixels)) < _FEWEST_FEATURES:
        return _none(MatchStatus.FEATURELESS)
    candidates = _distinct(first, second, *_candidates(first, second, predicted, radius_px))
    if len(candidates[0]) < _FEWEST_FEATURES // 2:
        return _none(MatchStatus.UNMATCHED, len(candidates[0]))
    # The tolerance is in pixels of the image that resolves less, so that its errors do not hide.
    sizes = np.median(first.sigma_px[candidates[0]]), np.median(second.sigma_px[candidates[1]])
    return _agreement(first, second, *candidates, bool(sizes[0] < sizes[1]), radius_px)


def _agreement(
    first: Features, second: Features, i: Indices, j: Indices, coarse_first: bool, radius_px: float
) -> Matches:
    cv2 = load_opencv()
    fine, coarse = (second, first) if coarse_first else (first, second)
    start, end = (fine.pixels[j], coarse.pixels[i]) if coarse_first else (fine.pixels[i], coarse.pixels[j])
    options = {"ransacReprojThreshold": _TOLERANCE_PX, "maxIters": 10000, "confidence": 0.9999}
    matrix, _ = cv2.findHomography(start, end, cv2.USAC_MAGSAC, **options)
    if matrix is None:
        return _none(MatchStatus.UNMATCHED, len(i))
    agree = _near(matrix, start, end)
    if agree.sum() >= _FEWEST_FEATURES // 2:
        try:
            matrix = fit_homography(start[agree], end[agree], 0.5, 0.5, approximate=matrix)
        except InputError:
            return _none(MatchStatus.UNMATCHED, len(i))
        agree = _near(matrix, start, end)
    area = min(float(np.prod(coarse.shape)), math.pi * min(radius_px, 1e6) ** 2)
    alarms = _log10_false_alarms(len(i), _apart(start[agree], end[agree]), math.pi * _TOLERANCE_PX**2 / area)
    if alarms > math.log10(_FALSE_ALARMS):
        return _none(MatchStatus.UNMATCHED, len(i), alarms)
    if not _plausible(derivative(matrix, start[agree])):
        return _none(MatchStatus.IMPLAUSIBLE, len(i), alarms)
    matrix = np.linalg.inv(matrix) if coarse_first else matrix
    return Matches(MatchStatus.MATCHED, i[agree], j[agree], len(i), alarms, matrix / np.linalg.norm(matrix))


def _none(status: MatchStatus, candidates: int = 0, alarms: float = math.inf) -> Matches:
    nobody = np.zeros(0, dtype=np.int64)
    return Matches(status, nobody, nobody, candidates, alarms, None)


def _engine(cv2: Any, detector: Detector, count: int) -> Any:
    if detector is Detector.SIFT:
        # Without the precise upscaling features of images of different scale are 0.15 pixel apart, all to one side.
        return cv2.SIFT_create(0, 3, 0.01, 10, 1.6, enable_precise_upscale=True)
    return cv2.ORB_create(10 * count, scaleFactor=1.2, nlevels=12, fastThreshold=5)


def _described(engine: Any, detector: Detector, image: Image, points: Any) -> tuple[Any, Any]:
    """Points, and their descriptions within 255."""
    if detector is not Detector.SIFT or not points:
        return engine.compute(image, points)
    for point in points:
        point.size *= _DESCRIBED
    points, descriptors = engine.compute(image, points)
    for point in points:
        point.size /= _DESCRIBED
    return points, np.sqrt(descriptors / descriptors.sum(axis=1, keepdims=True).clip(1.0)) * _ROOT_SCALE


def _flat(values: NDArray[np.uint8]) -> bool:
    """Whether an image is black, saturated or of one grey."""
    low, high = np.percentile(values, [1.0, 99.0])
    return bool(high - low < 3 or np.mean(values == 255) > _SATURATED_PART)


def _spread(points: Any, shape: tuple[int, ...], count: int) -> Indices:
    """The features of most response in each cell of a grid, so many in each that `count` are left."""
    pixels = np.array([p.pt for p in points], dtype=np.float64).reshape(-1, 2)
    response = np.array([p.response for p in points])
    cell = math.sqrt(shape[0] * shape[1] / max(count / 4.0, 1.0))
    place = (pixels // cell).astype(np.int64)
    key = place[:, 1] * (1 + int(shape[1] // cell)) + place[:, 0]
    order = np.lexsort([-response, key])
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    rank = np.arange(len(order)) - np.repeat(starts, np.diff(np.append(starts, len(order))))
    return order[np.argsort(rank, kind="stable")][:count]


def _candidates(
    first: Features, second: Features, predicted: Floats | None, radius_px: float
) -> tuple[Indices, Indices]:
    """Pairs that are each other's nearest in description, the second nearest being farther by the ratio."""
    if first.detector is not second.detector:
        raise InputError("features of two detectors cannot be compared; detect both with the same")
    these, those = _numbers(first), _numbers(second)
    near = first.pixels if predicted is None else transformed(predicted, first.pixels)
    least, following = np.full((2, len(these)), np.inf, np.float32)
    least_of_second = np.full(len(those), np.inf, np.float32)
    forward, backward = np.zeros(len(these), np.int64), np.zeros(len(those), np.int64)
    for rows in _neighbours(near, radius_px, max(1, _CHUNK_DISTANCES // len(those))):
        low, high = near[rows].min(axis=0) - radius_px, near[rows].max(axis=0) + radius_px
        there = np.flatnonzero(((second.pixels >= low) & (second.pixels <= high)).all(axis=1))
        if not len(there):
            continue
        distance = _squared_distances(these[rows], those[there])
        if np.isfinite(radius_px):
            for place, other in zip(near[rows].T, second.pixels[there].T, strict=True):
                np.putmask(distance, np.abs(place[:, np.newaxis] - other) > radius_px, np.inf)
        every, nearest = np.arange(len(rows)), distance.argmin(axis=1)
        forward[rows], least[rows] = there[nearest], distance[every, nearest]
        nearest_back = distance.argmin(axis=0)
        least_back = distance[nearest_back, np.arange(len(there))]
        nearer = least_back < least_of_second[there]  # of two that are as near the first
        backward[there[nearer]] = rows[nearest_back[nearer]]
        least_of_second[there[nearer]] = least_back[nearer]
        distance[every, nearest] = np.inf
        following[rows] = distance.min(axis=1)
    good = np.isfinite(least) & (least < _RATIO[first.detector] * following)
    i = np.flatnonzero(good & (backward[forward] == np.arange(len(these))))
    return i, forward[i]


def _neighbours(near: Floats, radius_px: float, most: int) -> Iterator[Indices]:
    """Features of the first image by where their partners are sought, so many together at most."""
    _, cell = np.unique(near // (2.0 * radius_px), axis=0, return_inverse=True)
    order = np.argsort(cell, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(cell[order])) + 1):
        yield from np.array_split(rows, -(-len(rows) // most))


def _numbers(features: Features) -> NDArray[np.float32]:
    """Descriptions as vectors whose squared distance counts: of ORB the number of bits that are different."""
    of_bits = features.detector is Detector.ORB
    return (np.unpackbits(features.descriptors, axis=1) if of_bits else features.descriptors).astype(
        np.float32
    )


def _squared_distances(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """Between all rows; of whole numbers below 256, 128 in a row, they are exact."""
    distances = a @ (-2.0 * b.T)
    distances += (a * a).sum(axis=1)[:, np.newaxis]
    distances += (b * b).sum(axis=1)
    return np.asarray(distances)


def _distinct(first: Features, second: Features, i: Indices, j: Indices) -> tuple[Indices, Indices]:
    """Pairs whose two places no other pair has: a feature may be described once for each of its directions."""
    places = np.column_stack([first.pixels[i], second.pixels[j]]).round()
    _, kept = np.unique(places, axis=0, return_index=True)
    return i[np.sort(kept)], j[np.sort(kept)]


def _near(matrix: Floats, start: Floats, end: Floats) -> NDArray[np.bool_]:
    """Which tie points agree with a homography, on its side of the horizon."""
    with np.errstate(invalid="ignore"):
        close = np.hypot(*(transformed(matrix, start) - end).T) < _TOLERANCE_PX
    scale = start @ matrix[2, :2] + matrix[2, 2]
    side = np.sign(np.median(scale[close])) if close.any() else 1.0
    return np.asarray(close & (scale * side > 0.0))


def _apart(start: Floats, end: Floats) -> int:
    """How many tie points there are if those near to each other in either image count once."""
    cell = _CELL_TOLERANCES * _TOLERANCE_PX
    return min((len(np.unique(points // cell, axis=0)) for points in (start, end)), default=0)


def _log10_false_alarms(candidates: int, agreeing: int, alpha: float) -> float:
    """The number of false alarms; `agreeing` of `candidates` pairs within a tolerance met with chance `alpha`."""
    n, k = candidates, agreeing
    if k <= 4:
        return math.inf
    choices = (n - 4) * math.comb(n, k) * math.comb(k, 4)
    return math.log10(choices) + (k - 4) * math.log10(min(alpha, 1.0))


def _plausible(by_place: Floats) -> bool:
    """Whether a camera above the ground can make a homography with such derivatives where there are tie points."""
    large, small = np.linalg.svd(by_place, compute_uv=False).T
    whole = (large < _LARGEST_SCALE).all() and (small > 1.0 / _LARGEST_SCALE).all()
    return bool(whole and (np.linalg.det(by_place) > 0.0).all() and (large < _LARGEST_STRETCH * small).all())
