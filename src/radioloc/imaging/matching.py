r"""Tie points of two images: detection, comparison, and a test against random agreement.

SIFT features are detected after local equalization of contrast, so that dark and bright ground contribute equally. Two
features are a candidate if they are mutual nearest neighbours and pass the ratio test (Lowe 2004). Square roots of
descriptors are compared (Arandjelovic and Zisserman 2012), of wider surroundings than usual. A robust search (MAGSAC++,
Barath et al. 2020) finds the homography with which most candidates agree; least squares refine it.

The number of false alarms (Moisan and Stival 2004, equation 7) tests k consistent candidates out of n. It is the
expected number of transformations as good among points at random places:

.. math:: \mathrm{NFA} = (n - 4) \binom{n}{k} \binom{k}{4} \alpha^{k - 4}

with :math:`\alpha` the probability that a random point falls within the tolerance of a place. Neighbouring points count
once, so that a cluster on one rock does not decide. Transformations that a camera above the ground cannot produce are
rejected: those that mirror the plane, as of a mirrored image, or stretch it out of proportion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.imaging.frames import load_opencv
from radioloc.imaging.homography import derivative, transformed
from radioloc.lunar.grey_images import Image, Mask
from radioloc.vectors import Floats

Indices = NDArray[np.int64]

_DESCRIBED_SIZE_FACTOR = 1.5  # of SIFT's surroundings: wider ones are more similar under different Suns
_BLUR_PX = 1.6  # of the first layer (Lowe 2004), in pixels of the doubled image
_TOLERANCE_PX = 3.0  # five sigmas of features under different Suns
_MAX_FALSE_ALARMS = 1e-6  # per pair of images
_CELL_SIZE_TOLERANCES = 4.0  # features in one cell count once
_MAX_SCALE = 30.0
_MAX_STRETCH = 5.0  # at some 78 degrees off the vertical
_MAX_RATIO = 0.9  # of distances of descriptors; 0.8 in Lowe (2004, section 7.1), without square roots
_ROOT_SCALE = 512.0  # keeps the largest of 128 numbers below 255
_CONTRAST_LIMIT, _CONTRAST_TILES = 3.0, (8, 8)
_SATURATED_PART = 0.9
_MIN_FEATURES = 12
_BLOCK_DISTANCES = 2**19

# Scatter of features of one scene under different Suns: 0.5 pixel, and a twentieth of the diameter of large ones
# (pairs of real images in the tests).
_SIGMA_PX, _SIGMA_SIZE_RATIO = 0.5, 0.05


class MatchStatus(StrEnum):
    """Result of comparing two images."""

    MATCHED = "matched"
    FEATURELESS = "featureless"  # one of the images is black, saturated, or without detail
    UNMATCHED = "unmatched"  # random features would agree as well
    IMPLAUSIBLE = "implausible"  # the features agree on a view that a camera cannot have


class Features(NamedTuple):
    """Features of one image."""

    pixels: Floats  # shape (n, 2)
    sigma_px: Floats  # of each of the two coordinates, shape (n,)
    descriptors: NDArray[np.uint8]  # shape (n, 128)
    shape: tuple[int, int]  # lines and samples of the image


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Tie points of two images."""

    status: MatchStatus
    candidates: int = 0  # pairs before the robust search
    log10_false_alarms: float = math.inf
    # Matched features of the first image, and their partners in the second.
    first: Indices = field(default_factory=lambda: np.zeros(0, np.int64))
    second: Indices = field(default_factory=lambda: np.zeros(0, np.int64))
    matrix: Floats | None = None  # from pixels of the first image to those of the second


def detect(image: Image, mask: Mask | None = None, count: int = 2000) -> Features:
    """Detect and describe features, those of most contrast in each part of the image; flat images yield zero."""
    cv2 = load_opencv()
    usable = None if mask is None else mask.astype(np.uint8)
    points: Any = ()
    if not _is_flat(cv2.calcHist([image], [0], usable, [256], [0, 256]).ravel()):
        image = cv2.createCLAHE(_CONTRAST_LIMIT, _CONTRAST_TILES).apply(image)
        # Without precise upscaling, features of images of different scale are 0.15 pixel apart in one direction.
        detector = cv2.SIFT_create(0, 3, 0.01, 10, _BLUR_PX, enable_precise_upscale=True)
        points = detector.detect(image, usable)
        points = [points[k] for k in _strongest_by_cell(points, image.shape, count)]
    pixels = _pixels(points)
    sigma_px = np.hypot(_SIGMA_PX, _SIGMA_SIZE_RATIO * np.array([p.size for p in points], dtype=np.float64))
    return Features(pixels, sigma_px, _descriptors(image, points), (image.shape[0], image.shape[1]))


def match(
    first: Features, second: Features, predicted: Floats | None = None, radius_px: float = math.inf
) -> Matches:
    """Find the tie points of two images and the homography between them, within a radius of predicted partners."""
    if min(len(first.pixels), len(second.pixels)) < _MIN_FEATURES:
        return Matches(MatchStatus.FEATURELESS)
    candidates = _distinct(first, second, *_candidates(first, second, predicted, radius_px))
    if len(candidates[0]) < _MIN_FEATURES // 2:
        return Matches(MatchStatus.UNMATCHED, len(candidates[0]))
    # The tolerance is in pixels of the coarser image, whose errors are larger.
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
        return Matches(MatchStatus.UNMATCHED, len(i))
    agree = _is_consistent(matrix, start, end)
    if agree.sum() >= _MIN_FEATURES // 2:
        refined, _ = cv2.findHomography(start[agree], end[agree])
        if refined is None:
            return Matches(MatchStatus.UNMATCHED, len(i))
        matrix, agree = refined, _is_consistent(refined, start, end)
    area = min(float(np.prod(coarse.shape)), math.pi * min(radius_px, 1e6) ** 2)
    count = _occupied_cells(start[agree], end[agree])
    alarms = _log10_false_alarms(len(i), count, math.pi * _TOLERANCE_PX**2 / area)
    if alarms > math.log10(_MAX_FALSE_ALARMS):
        return Matches(MatchStatus.UNMATCHED, len(i), alarms)
    if not _is_plausible(derivative(matrix, start[agree])):
        return Matches(MatchStatus.IMPLAUSIBLE, len(i), alarms)
    matrix = np.linalg.inv(matrix) if coarse_first else matrix
    return Matches(MatchStatus.MATCHED, len(i), alarms, i[agree], j[agree], matrix / np.linalg.norm(matrix))


def _descriptors(image: Image, points: Any) -> NDArray[np.uint8]:
    """Return the scaled square roots of descriptors; changes the points."""
    if not points:
        return np.zeros((0, 128), np.uint8)
    # Detection doubles the image. Half the blur without doubling gives the same layers in a quarter of the pixels.
    describer = load_opencv().SIFT_create(0, 3, 0.01, 10, 0.5 * _BLUR_PX)
    for point in points:
        point.octave = (point.octave & ~0xFF) + (point.octave + 1 & 0xFF)  # in the lowest byte, from -1
        point.size *= _DESCRIBED_SIZE_FACTOR
    descriptors = describer.compute(image, points)[1]
    roots = np.sqrt(descriptors / descriptors.sum(axis=1, keepdims=True).clip(1.0)) * _ROOT_SCALE
    return roots.astype(np.uint8)


def _is_flat(histogram: NDArray[np.float32]) -> bool:
    """Return True for the numbers of pixels of each grey value of black, saturated, uniform or no images."""
    part = np.cumsum(histogram, dtype=np.float64) / max(histogram.sum(), 1.0)
    low, high = np.searchsorted(part, [0.01, 0.99])
    return bool(high - low < 3 or part[-2] < 1.0 - _SATURATED_PART)


def _pixels(points: Any) -> Floats:
    """Return the pixels of features, shape (n, 2)."""
    return np.array(load_opencv().KeyPoint_convert(points), dtype=np.float64).reshape(-1, 2)


def _strongest_by_cell(points: Any, shape: tuple[int, ...], count: int) -> Indices:
    """Return `count` features, those of strongest response in each cell of a grid."""
    pixels, response = _pixels(points), np.array([p.response for p in points])
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
    """Return pairs of mutual nearest descriptors that pass the ratio test."""
    descriptors, targets = (part.descriptors.astype(np.float32) for part in (first, second))
    centres = first.pixels if predicted is None else transformed(predicted, first.pixels)
    nearest2, second2 = np.full((2, len(descriptors)), np.inf, np.float32)
    nearest2_of_target = np.full(len(targets), np.inf, np.float32)
    forward, backward = np.zeros(len(descriptors), np.int64), np.zeros(len(targets), np.int64)
    for rows in _blocks(centres, radius_px, max(1, _BLOCK_DISTANCES // len(targets))):
        low, high = centres[rows].min(axis=0) - radius_px, centres[rows].max(axis=0) + radius_px
        columns = np.flatnonzero(((second.pixels >= low) & (second.pixels <= high)).all(axis=1))
        if not len(columns):
            continue
        distance2 = _squared_distances(descriptors[rows], targets[columns])
        if np.isfinite(radius_px):
            for centre, coordinate in zip(centres[rows].T, second.pixels[columns].T, strict=True):
                np.putmask(distance2, np.abs(centre[:, np.newaxis] - coordinate) > radius_px, np.inf)
        index, nearest = np.arange(len(rows)), distance2.argmin(axis=1)
        forward[rows], nearest2[rows] = columns[nearest], distance2[index, nearest]
        nearest_row = distance2.argmin(axis=0)
        row_distance2 = distance2[nearest_row, np.arange(len(columns))]
        nearer = row_distance2 < nearest2_of_target[columns]  # the first of two at the same distance
        backward[columns[nearer]] = rows[nearest_row[nearer]]
        nearest2_of_target[columns[nearer]] = row_distance2[nearer]
        distance2[index, nearest] = np.inf
        second2[rows] = distance2.min(axis=1)
    good = np.isfinite(nearest2) & (nearest2 < _MAX_RATIO**2 * second2)
    i = np.flatnonzero(good & (backward[forward] == np.arange(len(descriptors))))
    return i, forward[i]


def _blocks(centres: Floats, radius_px: float, max_rows: int) -> Iterator[Indices]:
    """Yield features of the first image with neighbouring search areas, at most `max_rows` at a time."""
    _, cell = np.unique(centres // (2.0 * radius_px), axis=0, return_inverse=True)
    order = np.argsort(cell, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(cell[order])) + 1):
        yield from np.array_split(rows, -(-len(rows) // max_rows))


def _squared_distances(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return squared distances of all rows; exact for 128 whole numbers below 256."""
    distances = a @ (-2.0 * b.T)
    distances += (a * a).sum(axis=1)[:, np.newaxis]
    distances += (b * b).sum(axis=1)
    return np.asarray(distances)


def _distinct(first: Features, second: Features, i: Indices, j: Indices) -> tuple[Indices, Indices]:
    """Return pairs of different places: a feature has a descriptor for each of its directions."""
    places = np.column_stack([first.pixels[i], second.pixels[j]]).round()
    rows = np.sort(np.unique(places, axis=0, return_index=True)[1])
    return i[rows], j[rows]


def _is_consistent(matrix: Floats, start: Floats, end: Floats) -> NDArray[np.bool_]:
    """Select tie points that agree with a homography, on its side of the horizon."""
    with np.errstate(invalid="ignore"):
        close = np.hypot(*(transformed(matrix, start) - end).T) < _TOLERANCE_PX
    scale = start @ matrix[2, :2] + matrix[2, 2]
    side = np.sign(np.median(scale[close])) if close.any() else 1.0
    return np.asarray(close & (scale * side > 0.0))


def _occupied_cells(start: Floats, end: Floats) -> int:
    """Count tie points, those in one cell of either image once."""
    cell = _CELL_SIZE_TOLERANCES * _TOLERANCE_PX
    return min((len(np.unique(points // cell, axis=0)) for points in (start, end)), default=0)


def _log10_false_alarms(candidates: int, agreeing: int, alpha: float) -> float:
    """Return the number of false alarms of `agreeing` out of `candidates` pairs, each with probability `alpha`."""
    n, k = candidates, agreeing
    if k <= 4:
        return math.inf
    choices = (n - 4) * math.comb(n, k) * math.comb(k, 4)
    return math.log10(choices) + (k - 4) * math.log10(min(alpha, 1.0))


def _is_plausible(by_place: Floats) -> bool:
    """Return True for derivatives of a homography, at the tie points, that a camera above the ground can have."""
    large, small = np.linalg.svd(by_place, compute_uv=False).T
    scaled = (large < _MAX_SCALE).all() and (small > 1.0 / _MAX_SCALE).all()
    return bool(scaled and (np.linalg.det(by_place) > 0.0).all() and (large < _MAX_STRETCH * small).all())
