"""Features of a map, detected once: in tiles of the plane, at sizes of pixel that double from level to level."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.imaging.matching import Detector, Features, detect
from radioloc.imaging.tracks import MAP, Tracks
from radioloc.lunar.maps import Map, TangentPlane
from radioloc.vectors import Floats

Tile = tuple[int, int, int]  # level, line and column of the tile

_TILE_PIXELS = 1024
_OVERLAP_PIXELS = 32  # features near an edge are described from what is beyond it
_FEATURES_OF_TILE = 8000
_MOST_FEATURES = 12000


class MapPart(NamedTuple):
    """Features of a part of the map, their pixels counted from the plane's origin, to the east and to the south."""

    features: Features
    numbers: NDArray[np.int64]  # among the measurements of all tracks, shape (n,)
    pixel_m: float

    @property
    def to_plane(self) -> Floats:
        """From these pixels to the plane, m, shape (3, 3)."""
        return np.diag([self.pixel_m, -self.pixel_m, 1.0])


@dataclass(slots=True, eq=False)
class MapFeatures:
    """Features of a map in a plane, and the tracks to which they are added as places."""

    base: Map
    plane: TangentPlane
    detector: Detector = Detector.SIFT
    tracks: Tracks = field(default_factory=Tracks, repr=False)
    _tiles: dict[Tile, tuple[Features, int]] = field(default_factory=dict, repr=False)

    def pixel_m(self, level: int) -> float:
        """Size of a pixel at a level; at level 0 that of the map."""
        return self.base.resolution_m * 2.0**level

    def level(self, pixel_m: float) -> int:
        """The level whose pixels are nearest in size, not below 0."""
        return max(0, round(math.log2(pixel_m / self.base.resolution_m)))

    def around(self, level: int, extent_m: tuple[float, float, float, float]) -> MapPart:
        """Features within west, south, east, north."""
        west, south, east, north = extent_m
        pixel_m = self.pixel_m(level)
        side_m = _TILE_PIXELS * pixel_m
        rows = range(math.floor(-north / side_m), math.floor(-south / side_m) + 1)
        columns = range(math.floor(west / side_m), math.floor(east / side_m) + 1)
        tiles = [(level, row, column) for row in rows for column in columns]
        features, first = zip(*(self._tile(tile) for tile in tiles), strict=True)
        in_tile = np.concatenate([np.arange(len(f.pixels)) for f in features])
        numbers = in_tile + np.repeat(first, [len(f.pixels) for f in features])
        pixels = np.concatenate([f.pixels for f in features])
        place_m = pixels * [1.0, -1.0] * pixel_m
        kept = np.flatnonzero(((place_m >= [west, south]) & (place_m <= [east, north])).all(axis=1))
        # The number in its tile is a feature's rank among those of its surroundings.
        kept = kept[np.argsort(in_tile[kept], kind="stable")[:_MOST_FEATURES]]
        joined = Features(
            pixels[kept],
            np.concatenate([f.sigma_px for f in features])[kept],
            np.concatenate([f.descriptors for f in features])[kept],
            (math.ceil((north - south) / pixel_m), math.ceil((east - west) / pixel_m)),
            self.detector,
        )
        return MapPart(joined, numbers[kept], pixel_m)

    def _tile(self, tile: Tile) -> tuple[Features, int]:
        """Features of a tile, and the number of the first."""
        if tile not in self._tiles:
            level, row, column = tile
            first = np.array([column, row]) * _TILE_PIXELS - _OVERLAP_PIXELS
            pixel_m, size = self.pixel_m(level), _TILE_PIXELS + 2 * _OVERLAP_PIXELS
            view, valid = self.base.view(
                self.plane, first[0] * pixel_m, -first[1] * pixel_m, pixel_m, (size, size)
            )
            found = detect(view, valid, self.detector, _FEATURES_OF_TILE)
            low, high = _OVERLAP_PIXELS - 0.5, size - _OVERLAP_PIXELS - 0.5
            inner = ((found.pixels >= low) & (found.pixels < high)).all(axis=1)
            pixels, sigma_px = found.pixels[inner] + first, found.sigma_px[inner]
            features = Features(pixels, sigma_px, found.descriptors[inner], found.shape, self.detector)
            number = self.tracks.add(MAP, 0, pixels * [pixel_m, -pixel_m], sigma_px * pixel_m)
            self._tiles[tile] = features, number
        return self._tiles[tile]
