"""Tie points as tracks: measurements of one point of the ground, in images and on the map, joined by pairs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.imaging.adjustment import TiePoints
from radioloc.vectors import Floats

Indices = NDArray[np.int64]

MAP = -1  # in place of an image's number
_KIND_COUNT = 2  # kinds of measurements in an image; a track has at most one of each


@dataclass(slots=True, eq=False)
class Tracks:
    """Measurements, numbered from 0, and pairs of measurements of one point."""

    _groups: list[Indices] = field(default_factory=list)  # image and kind
    _places: list[Floats] = field(default_factory=list)
    _sigmas: list[Floats] = field(default_factory=list)
    _pairs: list[Indices] = field(default_factory=lambda: [np.zeros((0, 2), np.int64)])
    _count: int = 0

    def add(self, image: int, kind: int, places: Floats, sigmas: ArrayLike) -> int:
        """Add pixels of an image, or places on the map, and return the number of the first."""
        first, self._count = self._count, self._count + len(places)
        self._groups.append(np.full(len(places), _KIND_COUNT * image + kind))
        self._places.append(places)
        self._sigmas.append(np.asarray(sigmas, dtype=np.float64))
        return first

    def join(self, later: ArrayLike, earlier: ArrayLike) -> None:
        """Join measurements of the same points, by their numbers."""
        self._pairs.append(np.column_stack([earlier, later]))

    def ties(self, rejected: set[int], placed: NDArray[np.bool_]) -> tuple[Indices, TiePoints]:
        """Return the placed images that tie points connect to the map, without rejected ones, and their tie points."""
        group, places, sigmas = (np.concatenate(part) for part in (self._groups, self._places, self._sigmas))
        map_image = len(placed)  # the map is one more image
        image = np.where(group < 0, map_image, group // _KIND_COUNT)
        pairs = np.concatenate(self._pairs)
        pairs = pairs[~np.isin(image[pairs], [*rejected]).any(axis=1)]
        track = connected_components(pairs[:, 0], pairs[:, 1], len(image))
        # The first of several measurements in an image or on the map.
        measured, first = np.unique(pairs, return_index=True)
        measured = measured[np.argsort(first)]
        key = track[measured] * _KIND_COUNT * (map_image + 1) + group[measured]
        measured = measured[np.unique(key, return_index=True)[1]]
        track, image = track[measured], image[measured]
        component = connected_components(image, map_image + 1 + track, map_image + 2 + track.max(initial=-1))
        images = np.flatnonzero((component[:map_image] == component[map_image]) & placed)
        numbers = np.full(map_image + 1, -1)
        numbers[images] = np.arange(len(images))
        usable = (numbers[image] >= 0) | (image == map_image)
        usable &= np.bincount(track, weights=usable)[track] > 1
        _, point = np.unique(track[usable], return_inverse=True)
        number, rows = numbers[image[usable]], measured[usable]
        in_image, on_map = number >= 0, number < 0
        return images, TiePoints(
            number[in_image],
            point[in_image],
            places[rows[in_image]],
            sigmas[rows[in_image]],
            point[on_map],
            places[rows[on_map]],
            sigmas[rows[on_map]],
        )


def connected_components(start: Indices, end: Indices, nodes: int) -> Indices:
    """Return the connected component of each node of a graph."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components as components

    graph = coo_array((np.ones(len(start)), (start, end)), shape=(nodes, nodes))
    return np.asarray(components(graph, directed=False)[1], dtype=np.int64)
