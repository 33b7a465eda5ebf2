"""Seamless mosaic of orthophotos on one grid: balance of brightness, seam lines, and blending across them.

The logarithm of the brightness of each image receives a plane, so that overlapping images agree by least squares:
different Suns and exposures change brightness by a factor that varies slowly. Seam lines follow the cells in which two
images differ least (graph cut; Kwatra et al. 2003, by OpenCV). Across a seam the images are blended over a few cells of
the reduced mosaic in which the seams were searched.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.imaging.frames import load_opencv
from radioloc.imaging.rectification import new_cog
from radioloc.lunar.grey_images import Image, Mask
from radioloc.lunar.map_files import open_dataset
from radioloc.lunar.map_grid import MapGrid
from radioloc.vectors import Floats

_MAX_REDUCED_SIDE = 1500
_BLEND_CELLS = 3.0  # of the reduced mosaic; standard deviation of the transition
_MIN_WEIGHT = 1e-6  # of an image beyond its seams: used where no other image has a value
_SLOPE_WEIGHT = 10.0  # cells that would show no slope of brightness, for overlaps that do not determine it
_MIN_SEAM_CELLS = 20
_MAX_PAIR_CELLS = 2000  # of an overlap, for the balance


@dataclass(frozen=True, slots=True, eq=False)
class _Reduced:
    """Orthophoto at the size in which seams are searched."""

    window: Any  # of rasterio, in the reduced grid
    log_values: Floats  # NaN without value
    planes: Floats  # 1, x, y of each cell, from -1 to 1 over the mosaic, shape (3, rows, columns)


def common_windows(datasets: Sequence[Any]) -> tuple[list[Any], MapGrid]:
    """Return the windows of datasets in the smallest grid that contains all, and that grid."""
    from rasterio.transform import Affine
    from rasterio.windows import Window

    size = datasets[0].transform.a
    corners = np.array([[d.transform.c, -d.transform.f] for d in datasets])
    cells = np.rint((corners - corners.min(axis=0)) / size).astype(int).tolist()
    windows = [Window(*first, d.width, d.height) for first, d in zip(cells, datasets, strict=True)]
    west, south = corners.min(axis=0)
    rows, columns = (max(ends) for ends in zip(*map(_ends, windows), strict=True))
    transform = Affine(size, 0.0, west, 0.0, -size, -south)
    return windows, MapGrid.of_map(datasets[0].crs, transform, rows, columns, MEAN_LUNAR_RADIUS_M)


def _ends(window: Any) -> tuple[int, int]:
    return window.row_off + window.height, window.col_off + window.width


def common_window(first: Any, second: Any) -> Any:
    """Return the cells that both windows have, None without any."""
    from rasterio.windows import intersect, intersection

    return intersection(first, second) if intersect(first, second) else None


def slices_in(window: Any, outer: Any) -> tuple[slice, slice]:
    """Return rows and columns of a window in a window that contains it."""
    row, column = window.row_off - outer.row_off, window.col_off - outer.col_off
    return slice(row, row + window.height), slice(column, column + window.width)


def write_mosaic(path: Path, orthophotos: Sequence[Path]) -> dict[tuple[int, int], float]:
    """Write the mosaic of orthophotos (COG), and return the relative step of brightness across each seam."""
    with ExitStack() as closing:
        datasets = [closing.enter_context(open_dataset(file)) for file in orthophotos]
        windows, grid = common_windows(datasets)
        shape = grid.rows, grid.columns
        reduction = max(1, -(-max(shape) // _MAX_REDUCED_SIDE))
        reduced = [_reduced(d, w, shape, reduction) for d, w in zip(datasets, windows, strict=True)]
        planes = _balance(reduced)
        for image, plane in zip(reduced, planes, strict=True):
            image.log_values[:] += np.tensordot(plane, image.planes, 1)
        masks = _seam_masks(reduced)
        weights = [_blurred(mask) for mask in masks]
        dtype = datasets[0].dtypes[0]
        file = closing.enter_context(new_cog(path, grid, dtype))
        for _, block in file.block_windows(1):
            total, weight = np.zeros((2, block.height, block.width))
            for k, dataset in enumerate(datasets):
                part = _block(dataset, windows[k], block, shape, planes[k], weights[k])
                if part is not None:
                    cells, values, value_weights = part
                    total[cells] += value_weights * values
                    weight[cells] += value_weights
            shown = weight > 0.0
            mean = np.divide(total, weight, out=np.zeros_like(total), where=shown)
            if np.dtype(dtype).kind in "iu":
                limits = np.iinfo(dtype)
                mean = np.clip(np.rint(mean), limits.min, limits.max)
            file.write(mean.astype(dtype), 1, window=block)
            file.write_mask(shown, window=block)
    return _seam_steps(reduced, masks)


def read_cells(dataset: Any, cells: tuple[slice, slice]) -> Any:
    """Read rows and columns of a dataset as a masked array."""
    rows, columns = cells
    return dataset.read(1, window=((rows.start, rows.stop), (columns.start, columns.stop)), masked=True)


def _reduced(dataset: Any, window: Any, shape: tuple[int, int], reduction: int) -> _Reduced:
    """Read an orthophoto by averages of cells."""
    from rasterio.enums import Resampling
    from rasterio.windows import Window

    rows, columns = (max(1, round(n / reduction)) for n in (window.height, window.width))
    values = dataset.read(1, out_shape=(rows, columns), masked=True, resampling=Resampling.average)
    numbers = np.where(np.ma.getmaskarray(values), 0.0, np.ma.getdata(values).astype(np.float64))
    with np.errstate(invalid="ignore"):
        log_values = np.log(np.where(numbers > 0.0, numbers, np.nan))
    place = Window(round(window.col_off / reduction), round(window.row_off / reduction), columns, rows)
    row = window.row_off + (np.arange(rows) + 0.5) * (window.height / rows)
    column = window.col_off + (np.arange(columns) + 0.5) * (window.width / columns)
    return _Reduced(place, log_values, _planes(row, column, shape))


def _planes(row: NDArray[Any], column: NDArray[Any], shape: tuple[int, int]) -> Floats:
    """Return 1, x and y of cells, rows and columns counted from the corner, shape (3, rows, columns)."""
    x, y = np.meshgrid(2.0 * column / shape[1] - 1.0, 2.0 * row / shape[0] - 1.0)
    return np.stack([np.ones_like(x), x, y])


def _overlaps(parts: Sequence[_Reduced]) -> Iterator[tuple[int, int, Any, Any]]:
    """Yield pairs of images with the slices of both in which they overlap."""
    for i, j in combinations(range(len(parts)), 2):
        first, second = parts[i].window, parts[j].window
        common = common_window(first, second)
        if common is not None:
            yield i, j, slices_in(common, first), slices_in(common, second)


def _balance(parts: Sequence[_Reduced]) -> Floats:
    """Return the plane of log brightness that is added to each image, shape (images, 3)."""
    count = len(parts)
    normal, right = np.zeros((count, 3, count, 3)), np.zeros((count, 3))
    for i, j, of_i, of_j in _overlaps(parts):
        difference = parts[j].log_values[of_j] - parts[i].log_values[of_i]
        cells = np.flatnonzero(np.isfinite(difference))
        cells = cells[:: max(1, len(cells) // _MAX_PAIR_CELLS)]
        plane = parts[i].planes[(slice(None), *of_i)].reshape(3, -1)[:, cells]
        product, moment = plane @ plane.T, plane @ difference.ravel()[cells]
        for first, second in ((i, j), (j, i)):
            normal[first, :, first] += product
            normal[first, :, second] -= product
        right[i] += moment
        right[j] -= moment
    weight = max(1.0, float(np.trace(normal[:, 0, :, 0])) / count)
    # The mean of all images keeps its brightness; slopes that overlaps do not determine stay small.
    prior = np.kron(np.eye(count), np.diag([0.0, _SLOPE_WEIGHT, _SLOPE_WEIGHT]))
    prior[::3, ::3] += weight / count
    system = normal.reshape(3 * count, -1) + prior
    return np.asarray(np.linalg.solve(system, right.ravel())).reshape(count, 3)


def balanced(values: Image, canvas: Image, common: Mask) -> Image:
    """Return an image with the brightness of a canvas, by a plane of the logarithm of their ratio in common cells."""
    step = max(1, int(math.sqrt(values.size / _MAX_PAIR_CELLS)))
    places = [np.linspace(-1.0, 1.0, count) for count in values.shape]
    lattice, ground = values[::step, ::step], canvas[::step, ::step]
    rows, columns = np.nonzero(common[::step, ::step] & (lattice > 0) & (ground > 0))
    by_plane = np.stack([np.ones(len(rows)), places[0][::step][rows], places[1][::step][columns]])
    normal = by_plane @ by_plane.T + np.diag([1.0, _SLOPE_WEIGHT, _SLOPE_WEIGHT])
    log_ratio = np.log(ground[rows, columns] / lattice[rows, columns])
    mean, *slopes = np.linalg.solve(normal, by_plane @ log_ratio)
    factors = (np.exp(slope * part).astype(np.float32) for slope, part in zip(slopes, places, strict=True))
    result = np.outer(*factors)
    result *= math.exp(mean)
    result *= values
    return np.asarray(np.clip(np.rint(result, out=result), 0, 255, out=result), np.uint8)


def _seam_masks(parts: Sequence[_Reduced]) -> list[NDArray[np.uint8]]:
    """Return the cells that show each image."""
    cv2 = load_opencv()
    finder = cv2.detail_GraphCutSeamFinder("COST_COLOR_GRAD")
    low, high = np.nanpercentile(np.concatenate([p.log_values.ravel() for p in parts]), [1.0, 99.0])
    grey = [np.clip((p.log_values - low) * (255.0 / max(high - low, 1e-9)), 0.0, 255.0) for p in parts]
    images = [cv2.merge([np.nan_to_num(image).astype(np.float32)] * 3) for image in grey]
    masks = [np.isfinite(p.log_values).astype(np.uint8) * 255 for p in parts]
    corners = [(p.window.col_off, p.window.row_off) for p in parts]
    seams = finder.find(images, corners, masks) if len(parts) > 1 else masks
    return [np.asarray(mask.get() if hasattr(mask, "get") else mask) for mask in seams]


def _blurred(mask: NDArray[np.uint8]) -> NDArray[np.float32]:
    cv2 = load_opencv()
    return np.asarray(cv2.GaussianBlur(mask.astype(np.float32) / 255.0, (0, 0), _BLEND_CELLS))


def _block(
    dataset: Any,
    window: Any,
    block: Any,
    shape: tuple[int, int],
    plane: Floats,
    weights: NDArray[np.float32],
) -> tuple[tuple[slice, slice], Floats, Floats] | None:
    """Return the cells of a block that an orthophoto covers, their balanced values and their weights."""
    cv2 = load_opencv()
    common = common_window(window, block)
    if common is None:
        return None
    values = read_cells(dataset, slices_in(common, window))
    numbers = np.ma.getdata(values).astype(np.float64)
    valid = ~np.ma.getmaskarray(values) & np.isfinite(numbers)
    row = common.row_off + 0.5 + np.arange(common.height)
    column = common.col_off + 0.5 + np.arange(common.width)
    gain = np.exp(np.tensordot(plane, _planes(row, column, shape), 1))
    line = (row - window.row_off) * (weights.shape[0] / window.height) - 0.5
    sample = (column - window.col_off) * (weights.shape[1] / window.width) - 0.5
    places = np.meshgrid(sample.astype(np.float32), line.astype(np.float32))
    weight = cv2.remap(weights, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return slices_in(common, block), np.where(valid, numbers * gain, 0.0), (weight + _MIN_WEIGHT) * valid


def _seam_steps(
    parts: Sequence[_Reduced], masks: Sequence[NDArray[np.uint8]]
) -> dict[tuple[int, int], float]:
    """Return the mean difference of log brightness at the cells of each seam."""
    cv2 = load_opencv()
    steps = {}
    for i, j, of_i, of_j in _overlaps(parts):
        near_i, near_j = (cv2.dilate(masks[k][cells], np.ones((3, 3))) for k, cells in ((i, of_i), (j, of_j)))
        difference = parts[j].log_values[of_j] - parts[i].log_values[of_i]
        seam = (near_i > 0) & (near_j > 0) & np.isfinite(difference)
        if seam.sum() >= _MIN_SEAM_CELLS:
            steps[i, j] = float(difference[seam].mean())
    return steps
