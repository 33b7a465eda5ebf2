"""Seamless mosaic of orthophotos on one grid: balance of brightness, seam lines, and blending across them.

The logarithm of the brightness of each image receives a plane, so that overlapping images agree by least squares:
different Suns and exposures change brightness by a factor that varies slowly. Seam lines follow the cells in which two
images differ least (graph cut; Kwatra et al. 2003, by OpenCV). Across a seam the images are blended over a few cells of
the reduced mosaic in which the seams were searched.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.imaging.frames import load_opencv
from radioloc.imaging.rectification import new_cog
from radioloc.lunar.map_files import open_dataset
from radioloc.lunar.map_grid import MapGrid
from radioloc.vectors import Floats

_MAX_REDUCED_SIDE = 1500
_BLEND_CELLS = 3.0  # of the reduced mosaic; standard deviation of the transition
_MIN_WEIGHT = 1e-6  # of an image beyond its seams: used where no other image has a value
_SLOPE_WEIGHT = 10.0  # cells that would show no slope of brightness, for overlaps that do not determine it
_MIN_SEAM_CELLS = 20
_MAX_PAIR_CELLS = 2000  # of an overlap, for the balance


class Window(NamedTuple):
    """Cells of an orthophoto in a common grid."""

    row: int
    column: int
    rows: int
    columns: int

    def common(self, window: Window) -> Window | None:
        """Return the cells that both windows have, None without any."""
        row, column = max(self.row, window.row), max(self.column, window.column)
        rows = min(self.row + self.rows, window.row + window.rows) - row
        columns = min(self.column + self.columns, window.column + window.columns) - column
        return Window(row, column, rows, columns) if min(rows, columns) > 0 else None

    def slices_in(self, outer: Window) -> tuple[slice, slice]:
        """Return rows and columns of this window in a window that contains it."""
        row, column = self.row - outer.row, self.column - outer.column
        return slice(row, row + self.rows), slice(column, column + self.columns)


@dataclass(frozen=True, slots=True, eq=False)
class _Reduced:
    """Orthophoto at the size in which seams are searched."""

    window: Window  # in the reduced grid
    log_values: Floats  # NaN without value
    planes: Floats  # 1, x, y of each cell, from -1 to 1 over the mosaic, shape (3, rows, columns)


def common_windows(datasets: Sequence[Any]) -> tuple[list[Window], Any]:
    """Return the windows of datasets in the smallest grid that contains all, and its transform."""
    from rasterio.transform import Affine

    size = datasets[0].transform.a
    corners = np.array([[-d.transform.f, d.transform.c] for d in datasets])
    cells = np.rint((corners - corners.min(axis=0)) / size).astype(int)
    windows = [Window(int(r), int(c), d.height, d.width) for (r, c), d in zip(cells, datasets, strict=True)]
    north, west = corners.min(axis=0)
    return windows, Affine(size, 0.0, west, 0.0, -size, -north)


def write_mosaic(path: Path, orthophotos: Sequence[Path]) -> dict[tuple[int, int], float]:
    """Write the mosaic of orthophotos (COG), and return the relative step of brightness across each seam."""
    with ExitStack() as closing:
        datasets = [closing.enter_context(open_dataset(file)) for file in orthophotos]
        windows, transform = common_windows(datasets)
        shape = (max(w.row + w.rows for w in windows), max(w.column + w.columns for w in windows))
        reduction = max(1, -(-max(shape) // _MAX_REDUCED_SIDE))
        reduced = [_reduced(d, w, shape, reduction) for d, w in zip(datasets, windows, strict=True)]
        planes = _balance(reduced)
        for image, plane in zip(reduced, planes, strict=True):
            image.log_values[:] += np.tensordot(plane, image.planes, 1)
        masks = _seam_masks(reduced)
        weights = [_blurred(mask) for mask in masks]
        dtype = datasets[0].dtypes[0]
        grid = MapGrid.of_map(datasets[0].crs, transform, *shape, MEAN_LUNAR_RADIUS_M)
        file = closing.enter_context(new_cog(path, grid, dtype))
        for _, block in file.block_windows(1):
            cells_of_block = Window(block.row_off, block.col_off, block.height, block.width)
            total, weight = np.zeros((2, block.height, block.width))
            for k, dataset in enumerate(datasets):
                part = _block(dataset, windows[k], cells_of_block, shape, planes[k], weights[k])
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


def _reduced(dataset: Any, window: Window, shape: tuple[int, int], reduction: int) -> _Reduced:
    """Read an orthophoto by averages of cells."""
    from rasterio.enums import Resampling

    rows, columns = (max(1, round(n / reduction)) for n in (window.rows, window.columns))
    values = dataset.read(1, out_shape=(rows, columns), masked=True, resampling=Resampling.average)
    numbers = np.where(np.ma.getmaskarray(values), 0.0, np.ma.getdata(values).astype(np.float64))
    with np.errstate(invalid="ignore"):
        log_values = np.log(np.where(numbers > 0.0, numbers, np.nan))
    place = Window(round(window.row / reduction), round(window.column / reduction), rows, columns)
    row = window.row + (np.arange(rows) + 0.5) * (window.rows / rows)
    column = window.column + (np.arange(columns) + 0.5) * (window.columns / columns)
    return _Reduced(place, log_values, _planes(row, column, shape))


def _planes(row: NDArray[Any], column: NDArray[Any], shape: tuple[int, int]) -> Floats:
    """Return 1, x and y of cells, rows and columns counted from the corner, shape (3, rows, columns)."""
    x, y = np.meshgrid(2.0 * column / shape[1] - 1.0, 2.0 * row / shape[0] - 1.0)
    return np.stack([np.ones_like(x), x, y])


def _overlaps(parts: Sequence[_Reduced]) -> Iterator[tuple[int, int, Any, Any]]:
    """Yield pairs of images with the slices of both in which they overlap."""
    for i, j in combinations(range(len(parts)), 2):
        first, second = parts[i].window, parts[j].window
        common = first.common(second)
        if common is not None:
            yield i, j, common.slices_in(first), common.slices_in(second)


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


def _seam_masks(parts: Sequence[_Reduced]) -> list[NDArray[np.uint8]]:
    """Return the cells that show each image."""
    cv2 = load_opencv()
    finder = cv2.detail_GraphCutSeamFinder("COST_COLOR_GRAD")
    low, high = np.nanpercentile(np.concatenate([p.log_values.ravel() for p in parts]), [1.0, 99.0])
    grey = [np.clip((p.log_values - low) * (255.0 / max(high - low, 1e-9)), 0.0, 255.0) for p in parts]
    images = [cv2.merge([np.nan_to_num(image).astype(np.float32)] * 3) for image in grey]
    masks = [np.isfinite(p.log_values).astype(np.uint8) * 255 for p in parts]
    corners = [(p.window.column, p.window.row) for p in parts]
    seams = finder.find(images, corners, masks) if len(parts) > 1 else masks
    return [np.asarray(mask.get() if hasattr(mask, "get") else mask) for mask in seams]


def _blurred(mask: NDArray[np.uint8]) -> NDArray[np.float32]:
    cv2 = load_opencv()
    return np.asarray(cv2.GaussianBlur(mask.astype(np.float32) / 255.0, (0, 0), _BLEND_CELLS))


def _block(
    dataset: Any,
    window: Window,
    block: Window,
    shape: tuple[int, int],
    plane: Floats,
    weights: NDArray[np.float32],
) -> tuple[tuple[slice, slice], Floats, Floats] | None:
    """Return the cells of a block that an orthophoto covers, their balanced values and their weights."""
    cv2 = load_opencv()
    common = window.common(block)
    if common is None:
        return None
    values = read_cells(dataset, common.slices_in(window))
    numbers = np.ma.getdata(values).astype(np.float64)
    valid = ~np.ma.getmaskarray(values) & np.isfinite(numbers)
    row = common.row + 0.5 + np.arange(common.rows)
    column = common.column + 0.5 + np.arange(common.columns)
    gain = np.exp(np.tensordot(plane, _planes(row, column, shape), 1))
    line = (row - window.row) * (weights.shape[0] / window.rows) - 0.5
    sample = (column - window.column) * (weights.shape[1] / window.columns) - 0.5
    places = np.meshgrid(sample.astype(np.float32), line.astype(np.float32))
    weight = cv2.remap(weights, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return common.slices_in(block), np.where(valid, numbers * gain, 0.0), (weight + _MIN_WEIGHT) * valid


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
