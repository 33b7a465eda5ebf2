"""Tie points of overlapping orbital images, found in their orthophotos.

Orthophotos on a common grid have equal scale and direction, and relief is removed from them. Each cell with a feature
leads back to the pixel of its image by the sensor model of the orthophoto.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.imaging.matching import Features, detect, match
from radioloc.imaging.mosaic import common_window, common_windows, read_cells, slices_in
from radioloc.imaging.sensor_models import SensorModel
from radioloc.imaging.strip_adjustment import GroundTies, pixel_size_m
from radioloc.imaging.surfaces import Terrain
from radioloc.imaging.tracks import Indices, connected_components
from radioloc.lunar import TerrainModel, selenographic_to_cartesian
from radioloc.lunar.grey_images import eight_bit
from radioloc.lunar.map_files import open_dataset
from radioloc.lunar.map_grid import MapGrid
from radioloc.vectors import Floats

_TILE_CELLS = 1024
_TILE_FEATURES = 1500
_MIN_SEARCH_CELLS = 8.0


def find_ground_ties(
    orthophotos: Sequence[Path], models: Sequence[SensorModel], terrain: TerrainModel, radius_m: float
) -> GroundTies:
    """Find the tie points of images within a distance on the ground, m, by orthophotos of their sensor models."""
    features: list[Features] = []
    images: list[int] = []
    pairs = [np.zeros((0, 2), np.int64)]
    from rasterio.windows import Window

    with ExitStack() as closing:
        datasets = [closing.enter_context(open_dataset(path)) for path in orthophotos]
        windows, grid = common_windows(datasets)
        radius = max(_MIN_SEARCH_CELLS, radius_m / grid.resolution_m)
        first = 0
        for row in range(0, grid.rows, _TILE_CELLS):
            for column in range(0, grid.columns, _TILE_CELLS):
                tile = Window(column, row, _TILE_CELLS, _TILE_CELLS)
                in_tile: list[tuple[Features, int]] = []
                shown = [k for k, window in enumerate(windows) if common_window(tile, window)]
                for k in shown if len(shown) > 1 else ():
                    part = _tile_features(datasets[k], windows[k], tile)
                    in_tile.append((part, first))
                    features.append(part)
                    images += [k] * len(part.pixels)
                    first += len(part.pixels)
                for (first_part, i), (second_part, j) in combinations(in_tile, 2):
                    matches = match(first_part, second_part, np.eye(3), radius)
                    pairs.append(np.column_stack([i + matches.first, j + matches.second]))
    return _joined(features, np.array(images, np.int64), np.concatenate(pairs), models, terrain, grid)


def _tile_features(dataset: Any, window: Any, tile: Any) -> Features:
    """Detect the features of an orthophoto in a tile, at cells of the common grid."""
    common = common_window(tile, window)
    image, valid = eight_bit(read_cells(dataset, slices_in(common, window)))
    features = detect(image, valid, _TILE_FEATURES)
    return features._replace(pixels=features.pixels + np.array([common.col_off, common.row_off]))


def _joined(
    features: Sequence[Features],
    images: Indices,
    pairs: Indices,
    models: Sequence[SensorModel],
    terrain: TerrainModel,
    grid: MapGrid,
) -> GroundTies:
    """Return the tie points that pairs of features form, each at most once in an image."""
    cells = np.concatenate([part.pixels for part in features]) if features else np.zeros((0, 2))
    sigma = np.concatenate([part.sigma_px for part in features]) if features else np.zeros(0)
    track = connected_components(pairs[:, 0], pairs[:, 1], len(images))
    measured = np.unique(pairs)
    measured = measured[np.unique(track[measured] * len(models) + images[measured], return_index=True)[1]]
    pixels = np.zeros((len(measured), 2))
    visible = np.zeros(len(measured), bool)
    for k, model in enumerate(models):
        rows = np.flatnonzero(images[measured] == k)
        if len(rows):
            points = _ground(cells[measured[rows]], terrain, grid)
            pixels[rows], visible[rows] = model.project(points)
    measured, pixels = measured[visible], pixels[visible]
    several = np.bincount(track[measured], minlength=track.max(initial=0) + 1)[track[measured]] > 1
    measured, pixels = measured[several], pixels[several]
    _, point = np.unique(track[measured], return_inverse=True)
    count = int(point.max(initial=-1)) + 1
    sizes_m = np.array(
        [pixel_size_m(model, 0.5 * np.array(model.shape[::-1]), Terrain(terrain)) for model in models]
    )
    sigma_px = sigma[measured] * grid.resolution_m / sizes_m[images[measured]]
    places, place_sigmas = np.full((count, 3), np.nan), np.full(count, np.inf)
    return GroundTies(images[measured], point, pixels, sigma_px, places, place_sigmas)


def _ground(cells: Floats, terrain: TerrainModel, grid: MapGrid) -> Floats:
    longitude, latitude = grid.longitude_latitude(cells[:, 1], cells[:, 0])
    height_m, _ = terrain.window(longitude, latitude).heights(longitude, latitude)
    return selenographic_to_cartesian(longitude, latitude, height_m)
