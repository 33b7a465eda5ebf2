"""Features of a map, detected once in tiles of the plane, with pixels that double in size from level to level."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.imaging.matching import Features, detect
from radioloc.imaging.tracks import MAP, Tracks
from radioloc.lunar.maps import Map, TangentPlane
from radioloc.vectors import Floats

Tile = tuple[int, int, int]  # level, line and column of the tile

_TILE_PIXELS = 1024
_OVERLAP_PIXELS = 32  # descriptors of features near an edge need the surroundings beyond it
_MAX_TILE_FEATURES = 8000
_MAX_FEATURES = 12000


class MapPart(NamedTuple):
    """Features of a part of the map; pixels count from the plane's origin to the east and south."""

    features: Features
    numbers: NDArray[np.int64]  # among the measurements of all tracks, shape (n,)
    pixel_m: float

    @property
    def to_plane(self) -> Floats:
        """Matrix from pixels to the plane, m, shape (3, 3)."""
        return np.diag([self.pixel_m, -self.pixel_m, 1.0])


@dataclass(slots=True, eq=False)
class MapFeatures:
    """Features of a map in a plane, and the tracks that hold their places."""

    base: Map
    plane: TangentPlane
    tracks: Tracks = field(default_factory=Tracks, repr=False)
    _tiles: dict[Tile, tuple[Features, int]] = field(default_factory=dict, repr=False)

    def pixel_m(self, level: int) -> float:
        """Return the size of a pixel at a level; level 0 is the map."""
        return self.base.resolution_m * 2.0**level

    def level(self, pixel_m: float) -> int:
        """Return the level with the nearest size of pixels, at least 0."""
        return max(0, round(math.log2(pixel_m / self.base.resolution_m)))

    def part(self, level: int, extent_m: tuple[float, float, float, float]) -> MapPart:
        """Return the features within west, south, east, north."""
        west, south, east, north = extent_m
        pixel_m = self.pixel_m(level)
        side_m = _TILE_PIXELS * pixel_m
        lines = range(math.floor(-north / side_m), math.floor(-south / side_m) + 1)
        samples = range(math.floor(west / side_m), math.floor(east / side_m) + 1)
        tiles = [(level, line, sample) for line in lines for sample in samples]
        features, first = zip(*(self._tile(tile) for tile in tiles), strict=True)
        in_tile = np.concatenate([np.arange(len(f.pixels)) for f in features])
        numbers = in_tile + np.repeat(first, [len(f.pixels) for f in features])
        pixels = np.concatenate([f.pixels for f in features])
        place_m = pixels * [1.0, -1.0] * pixel_m
        rows = np.flatnonzero(((place_m >= [west, south]) & (place_m <= [east, north])).all(axis=1))
        # The number in its tile is a feature's rank among its neighbours.
        rows = rows[np.argsort(in_tile[rows], kind="stable")[:_MAX_FEATURES]]
        joined = Features(
            pixels[rows],
            np.concatenate([f.sigma_px for f in features])[rows],
            np.concatenate([f.descriptors for f in features])[rows],
            (math.ceil((north - south) / pixel_m), math.ceil((east - west) / pixel_m)),
        )
        return MapPart(joined, numbers[rows], pixel_m)

    def _tile(self, tile: Tile) -> tuple[Features, int]:
        """Return the features of a tile, and the number of the first."""
        if tile not in self._tiles:
            level, row, column = tile
            corner, pixel_m = np.array([column, row]) * _TILE_PIXELS, self.pixel_m(level)
            # Parts of a tile beyond the map, in whole parts so that pyramids of images keep their pixels, are left out.
            west, south, east, north = np.array(self.base.extent_m(self.plane)) / (_OVERLAP_PIXELS * pixel_m)
            low, high = np.floor([west, -north]), np.ceil([east, -south])
            first = np.maximum(corner - _OVERLAP_PIXELS, _OVERLAP_PIXELS * low.astype(np.int64))
            last = np.minimum(
                corner + _TILE_PIXELS + _OVERLAP_PIXELS, _OVERLAP_PIXELS * high.astype(np.int64)
            )
            samples, lines = np.maximum(last - first, 2 * _OVERLAP_PIXELS).tolist()
            view, valid = self.base.view(
                self.plane, first[0] * pixel_m, -first[1] * pixel_m, pixel_m, (lines, samples)
            )
            features = detect(view, valid, _MAX_TILE_FEATURES)
            places = features.pixels + first + 0.5 - corner
            inner = ((places >= 0.0) & (places < _TILE_PIXELS)).all(axis=1)
            pixels, sigma_px = features.pixels[inner] + first, features.sigma_px[inner]
            number = self.tracks.add(MAP, 0, pixels * [pixel_m, -pixel_m], sigma_px * pixel_m)
            self._tiles[tile] = (
                Features(pixels, sigma_px, features.descriptors[inner], features.shape),
                number,
            )
        return self._tiles[tile]
