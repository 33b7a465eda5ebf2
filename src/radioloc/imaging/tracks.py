"""Tie points as tracks: all measurements of one point of the ground, in images and on the map, that pairs join."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.imaging.adjustment import TiePoints
from radioloc.vectors import Floats

Indices = NDArray[np.int64]

MAP = -1
"""In place of an image's number."""

_KINDS = 3  # of measurements in an image; a track has one of each


@dataclass(slots=True, eq=False)
class Tracks:
    """Measurements, numbered from 0 as they are added, and pairs of them that are of one point."""

    _groups: list[Indices] = field(default_factory=list)  # image and kind
    _places: list[Floats] = field(default_factory=list)
    _sigmas: list[Floats] = field(default_factory=list)
    _pairs: list[Indices] = field(default_factory=lambda: [np.zeros((0, 2), np.int64)])
    _count: int = 0

    def add(self, image: int, kind: int, places: Floats, sigmas: ArrayLike) -> int:
        """Add pixels of an image, or places in the plane on the map; the number of the first."""
        first, self._count = self._count, self._count + len(places)
        self._groups.append(np.full(len(places), _KINDS * image + kind))
        self._places.append(places)
        self._sigmas.append(np.asarray(sigmas, dtype=np.float64))
        return first

    def join(self, these: ArrayLike, those: ArrayLike) -> None:
        """Note which measurements are of the same points as others before them, by their numbers."""
        self._pairs.append(np.column_stack([those, these]))

    def ties(self, left_out: set[int], placed: NDArray[np.bool_]) -> tuple[Indices, TiePoints]:
        """Return the placed images, but those left out, that tie points lead from to the map, and these points."""
        group, places, sigmas = (np.concatenate(part) for part in (self._groups, self._places, self._sigmas))
        of_map = len(placed)  # the map is one more image
        image = np.where(group < 0, of_map, group // _KINDS)
        pairs = np.concatenate(self._pairs)
        pairs = pairs[~np.isin(image[pairs], [*left_out]).any(axis=1)]
        track = _parts(pairs[:, 0], pairs[:, 1], len(image))
        # Of several of an image, or of the map, the first that was found.
        found, first = np.unique(pairs, return_index=True)
        found = found[np.argsort(first)]
        _, kept = np.unique(track[found] * (_KINDS * of_map + _KINDS) + group[found], return_index=True)
        found = found[kept]
        track, image = track[found], image[found]
        part = _parts(image, of_map + 1 + track, of_map + 2 + track.max(initial=-1))
        images = np.flatnonzero((part[:of_map] == part[of_map]) & placed)
        numbers = np.full(of_map + 1, -1)
        numbers[images] = np.arange(len(images))
        usable = (numbers[image] >= 0) | (image == of_map)
        usable &= np.bincount(track, weights=usable)[track] > 1
        _, point = np.unique(track[usable], return_inverse=True)
        number, places, sigmas = numbers[image[usable]], places[found[usable]], sigmas[found[usable]]
        seen, on_map = number >= 0, number < 0
        return images, TiePoints(
            number[seen],
            point[seen],
            places[seen],
            sigmas[seen],
            point[on_map],
            places[on_map],
            sigmas[on_map],
        )


def _parts(one: Indices, other: Indices, nodes: int) -> Indices:
    """To which connected part of a graph with edges from one node to another each node belongs."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(one)), (one, other)), shape=(nodes, nodes))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)
