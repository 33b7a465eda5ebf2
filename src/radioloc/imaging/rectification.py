"""Rectification: images resampled to the cells of a map, as cloud-optimised GeoTIFF.

Each cell has a ground point, the ground point a pixel by the view of the image, and the image a value there (bilinear).
Cells outside the image, hidden by other ground, or without height are masked.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc import vectors
from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.imaging.cameras import Camera, distorted, undistorted
from radioloc.imaging.frames import load_opencv
from radioloc.imaging.homography import transformed
from radioloc.imaging.sensor_models import SensorModel, require_mean_earth
from radioloc.imaging.surfaces import Terrain
from radioloc.lunar import TerrainModel, cartesian_to_selenographic, selenographic_to_cartesian
from radioloc.lunar.grey_images import Mask
from radioloc.lunar.map_files import BLOCK_CELLS, new_geotiff
from radioloc.lunar.map_grid import MapGrid, load_rasterio
from radioloc.lunar.maps import TangentPlane
from radioloc.lunar.terrain import LargeWindowError, NoTerrainError
from radioloc.text_files import replaced_file, scratch_folder
from radioloc.vectors import Floats

_MARGIN_PART = 1.0 / 64.0  # margin of the grid of an image, as a part of the size of its ground
_OUTLINE_POINTS = 65  # per side of an image
_MAX_RAY_MISS_CELLS = 1.0  # of a point from the first intersection of its ray, for a visible point
# Largest distance from the middle of an image's tie points, in their standard deviations; a square's corner has 2.4.
_MAX_EXTRAPOLATION = 4.0
_SQUARE_CELLS = (16, 4)  # sides of the squares in which pixels are interpolated
_MIN_SQUARES = 8  # least number of squares along a side of the grid
_MAX_EQUIRECTANGULAR_LATITUDE_DEG = 60.0  # a parallel there has half of its length on the map


class Bounds(NamedTuple):
    """Ground within four standard deviations of tie points, beyond which an image is not determined."""

    plane: TangentPlane
    places_m: Floats  # of the tie points, shape (n, 2)

    def are_near(self, places_m: Floats) -> Mask:
        """Select places, shape (n, 2), within the largest distance from the middle of the tie points."""
        offset_m = places_m - self.places_m.mean(axis=0)
        distance2 = np.einsum("ni,ij,nj->n", offset_m, np.linalg.inv(np.cov(self.places_m.T)), offset_m)
        return np.asarray(distance2 <= _MAX_EXTRAPOLATION**2)


def _within(bounds: Bounds | None, angles: Floats) -> Any:
    return bounds is None or bounds.are_near(bounds.plane.from_longitude_latitude(np.degrees(angles)))


@dataclass(frozen=True, slots=True, eq=False)
class TerrainView:
    """View of an elevation model by a sensor model in mean-Earth axes."""

    model: SensorModel
    terrain: TerrainModel = field(repr=False)
    bounds: Bounds | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        require_mean_earth(self.model)

    @property
    def shape(self) -> tuple[int, int]:
        """Lines and samples."""
        return self.model.shape

    def ground(self, pixels: Floats) -> tuple[Floats, Mask]:
        """Return angles of the first intersections of rays with the ground, and whether each ray has one."""
        rays = self.model.rays(pixels)
        points, hits = Terrain(self.terrain).intersect(rays.origins_m, rays.directions)
        angles = np.column_stack(cartesian_to_selenographic(points)[:2])
        return angles, hits & _within(self.bounds, angles)

    def pixels(self, angles: Floats, tolerance_m: float) -> tuple[Floats, Mask]:
        """Return pixels of ground points, and whether the image shows them."""
        pixels, visible = np.zeros((len(angles), 2)), np.zeros(len(angles), bool)
        try:
            window = self.terrain.window(*angles.T)
        except NoTerrainError:
            return pixels, visible
        except LargeWindowError:  # the elevation map is much finer than the orthophoto
            half = len(angles) // 2
            parts = [self.pixels(part, tolerance_m) for part in (angles[:half], angles[half:])]
            return np.concatenate([p for p, _ in parts]), np.concatenate([v for _, v in parts])
        height_m, mapped = window.heights(*angles.T)
        cells = np.flatnonzero(mapped)
        points = selenographic_to_cartesian(angles[cells, 0], angles[cells, 1], height_m[cells])
        projected = self.model.project(points)
        lines, samples = self.model.shape
        in_image = ((projected.pixels >= -0.5) & (projected.pixels < [samples - 0.5, lines - 0.5])).all(
            axis=1
        )
        shown = np.flatnonzero(projected.visible & in_image)
        origins_m = self.model.positions_m(projected.pixels[shown, 1])
        hidden = self._hidden(points[shown], origins_m, window.max_slope, tolerance_m)
        shown = shown[~hidden]
        pixels[cells[shown]], visible[cells[shown]] = projected.pixels[shown], True
        return pixels, visible & _within(self.bounds, angles)

    def _hidden(self, points: Floats, origins_m: Floats, max_slope: float, tolerance_m: float) -> Mask:
        """Select points behind other ground; rays steeper than all slopes need no test."""
        directions, reach_m = vectors.normalized(points - origins_m), vectors.length(points - origins_m)
        down = -vectors.dot(points, directions) / vectors.length(points)
        flat = np.flatnonzero(down <= max_slope * np.sqrt(np.maximum(1.0 - down * down, 0.0)))
        hidden = np.zeros(len(points), dtype=bool)
        if len(flat):
            allowed_m = max(tolerance_m, _MAX_RAY_MISS_CELLS * self.terrain.metadata.resolution_m)
            rays = origins_m[flat], directions[flat], reach_m[flat] - allowed_m
            hidden[flat] = ~Terrain(self.terrain).is_clear(*rays)
        return hidden


@dataclass(frozen=True, slots=True, eq=False)
class PlaneView:
    """View of a plane that touches the Moon by a homography from its places to pixels without distortion."""

    plane: TangentPlane
    matrix: Floats = field(repr=False)
    shape: tuple[int, int]
    camera: Camera | None = None  # with the distortion of the image
    bounds: Bounds | None = field(default=None, repr=False)

    def ground(self, pixels: Floats) -> tuple[Floats, Mask]:
        """Return angles of pixels, and whether each is below the horizon."""
        straight = pixels if self.camera is None else undistorted(self.camera)(pixels)
        places_m = transformed(np.asarray(np.linalg.inv(self.matrix), np.float64), straight)
        angles = np.radians(self.plane.to_longitude_latitude(np.nan_to_num(places_m, nan=np.inf)))
        return angles, self._is_ahead(places_m) & np.isfinite(angles).all(axis=1) & _within(
            self.bounds, angles
        )

    def pixels(self, angles: Floats, tolerance_m: float) -> tuple[Floats, Mask]:
        """Return pixels of ground points, also beyond the image's edges, and whether each is ahead and on the lens."""
        places_m = self.plane.from_longitude_latitude(np.degrees(angles))
        pixels, visible = transformed(self.matrix, places_m), self._is_ahead(places_m)
        if self.camera is not None:
            pixels, on_lens = distorted(self.camera)(np.nan_to_num(pixels))
            visible &= on_lens
        return pixels, visible & _within(self.bounds, angles)

    def _is_ahead(self, places_m: Floats) -> Mask:
        # Points in front of a camera above the plane have a third coordinate of the sign opposite to the determinant.
        with np.errstate(invalid="ignore"):
            depth = places_m @ self.matrix[2, :2] + self.matrix[2, 2]
        return np.asarray(depth * np.linalg.det(self.matrix) < 0.0)


View = TerrainView | PlaneView


def nearest_projection(longitude_deg: float, latitude_deg: float) -> str:
    """Return the projection of IAU_2015 for a place: equirectangular, or polar stereographic beyond 60 degrees."""
    if abs(latitude_deg) > _MAX_EQUIRECTANGULAR_LATITUDE_DEG:
        return "IAU_2015:30130" if latitude_deg > 0.0 else "IAU_2015:30135"
    return "IAU_2015:30110" if abs(longitude_deg) <= 90.0 else "IAU_2015:30115"


def map_grid(projection: str, angles: Floats, resolution_m: float, margin_part: float = 0.0) -> MapGrid:
    """Return the grid of cells that contains places, widened by a part of its size; cells begin at whole multiples."""
    from rasterio.transform import Affine
    from rasterio.warp import transform

    crs = _lunar_projection(projection, resolution_m)
    geographic = f"+proj=longlat +R={MEAN_LUNAR_RADIUS_M!r} +no_defs"
    x, y = map(np.array, transform(geographic, crs, *np.degrees(angles).T))
    if not (np.isfinite(x) & np.isfinite(y)).all() or np.ptp(x) > np.pi * MEAN_LUNAR_RADIUS_M:
        raise InputError(
            f"the image crosses the seam or the limit of {crs.to_string()}; take a projection about another longitude, "
            "such as IAU_2015:30115, or a polar one"
        )
    margin_m = max(np.ptp(x), np.ptp(y)) * margin_part
    west, east = np.floor((x.min() - margin_m) / resolution_m), np.ceil((x.max() + margin_m) / resolution_m)
    south, north = np.floor((y.min() - margin_m) / resolution_m), np.ceil((y.max() + margin_m) / resolution_m)
    corner = Affine(resolution_m, 0.0, west * resolution_m, 0.0, -resolution_m, north * resolution_m)
    return MapGrid.of_map(crs, corner, int(north - south), int(east - west), MEAN_LUNAR_RADIUS_M)


def _lunar_projection(projection: str, resolution_m: float) -> Any:
    """Return the reference system, which must be of the Moon's sphere and in metres."""
    rasterio = load_rasterio()
    if not (np.isfinite(resolution_m) and resolution_m > 0.0):
        raise InputError(f"resolution_m: expected a positive number of metres, got {resolution_m!r}")
    try:
        crs = rasterio.crs.CRS.from_user_input(projection)
    except rasterio.errors.CRSError as error:
        raise InputError(f"projection: PROJ does not accept {projection!r}: {error}") from error
    definition = crs.to_dict()
    radii = {float(definition.get(key, MEAN_LUNAR_RADIUS_M)) for key in ("R", "a", "b")}
    if crs.is_geographic or not {"R", "a"} & set(definition) or radii != {MEAN_LUNAR_RADIUS_M}:
        raise InputError(
            f"projection: expected one of the Moon's sphere of 1737.4 km in metres, such as IAU_2015:30110, got "
            f"{projection!r}"
        )
    return crs


def grid_around(angles: Floats, projection: str, resolution_m: float) -> MapGrid:
    """Return the grid of cells that contains the ground of images, given by angles (n, 2), with a margin."""
    return map_grid(projection, angles, resolution_m, _MARGIN_PART)


def outline(view: View) -> Floats:
    """Return angles of the ground, rad, shape (n, 2), at a lattice of pixels over the image."""
    lines, samples = (np.linspace(0.0, size - 1.0, _OUTLINE_POINTS) for size in view.shape)
    angles, hits = view.ground(np.stack(np.meshgrid(samples, lines), axis=-1).reshape(-1, 2))
    if not hits.any():
        raise InputError(f"the image shows ground outside the map or elevation model: {view!r}")
    return angles[hits]


def part_of(grid: MapGrid, rows: slice, columns: slice) -> MapGrid:
    """Return some rows and columns of a grid."""
    a, b, c, d, e, f = grid.transform[:6]
    x, y = c + a * columns.start + b * rows.start, f + d * columns.start + e * rows.start
    size = {"rows": rows.stop - rows.start, "columns": columns.stop - columns.start}
    return replace(grid, transform=type(grid.transform)(a, b, x, d, e, y), **size)


def rectified(
    image: NDArray[Any], view: View, grid: MapGrid, mask: Mask | None = None, tolerance_px: float = 0.0
) -> tuple[NDArray[Any], Mask]:
    """Return an image resampled to a grid, and the mask of cells that it shows.

    Pixels much smaller than a cell are averaged. `mask` selects usable pixels of the image. With a tolerance, pixels
    are interpolated in squares of cells whose middle agrees with the corners; other squares are divided.
    """
    from radioloc.imaging._kernels import resampled  # imports numba

    counts = grid.rows, grid.columns
    usable = np.ones(image.shape, bool) if mask is None else mask
    limits = np.iinfo(image.dtype) if image.dtype.kind in "iu" else None
    bounds = (-np.inf, np.inf) if limits is None else (float(limits.min), float(limits.max))
    values, visible, remaining = np.zeros(counts, image.dtype), np.zeros(counts, bool), np.ones(counts, bool)
    steps = [step for step in _SQUARE_CELLS if tolerance_px and _MIN_SQUARES * step <= min(counts)]
    reduced = None
    for step in (*steps, 1):
        squares = _squares(view, grid, remaining[::step, ::step], step, tolerance_px)
        if reduced is None:
            reduced = _reduced(image, squares, step)
        part, reduction = reduced
        drawn = _cells(squares.smooth, step, counts)
        resampled(squares.corners, step, drawn, values, part, usable, reduction, bounds)
        visible |= drawn
        remaining = _cells(squares.mixed, step, counts)
    return values, visible


class _Squares(NamedTuple):
    """Squares of cells: pixels of their corners, and whether pixels are interpolated or an edge may cross."""

    corners: Floats  # (rows, columns, 2)
    shown: Mask  # corners, (rows, columns)
    smooth: Mask
    mixed: Mask


def _squares(view: View, grid: MapGrid, chosen: Mask, step: int, tolerance_px: float) -> _Squares:
    """Return the chosen squares of a grid; single cells are smooth."""
    from scipy.ndimage import binary_dilation

    if step == 1:
        corners, shown = _exact_pixels(view, grid, chosen, 1, 0.0)
        return _Squares(corners, shown, shown, np.zeros_like(chosen))
    nodes = np.zeros(np.array(chosen.shape) + 1, bool)
    ends = slice(None, -1), slice(1, None)
    for i, j in product(ends, ends):
        nodes[i, j] |= chosen
    corners, shown = _exact_pixels(view, grid, nodes, step, 0.0)
    middle, middle_shown = _exact_pixels(view, grid, chosen, step, 0.5)
    mean = sum((corners[i, j] for i, j in product(ends, ends)), np.zeros_like(middle)) / 4.0
    visibles = np.array([*(shown[i, j] for i, j in product(ends, ends)), middle_shown])
    smooth = chosen & visibles.all(axis=0) & (np.abs(mean - middle).max(axis=-1) < tolerance_px)
    mixed = chosen & binary_dilation(visibles.any(axis=0), np.ones((3, 3))) & ~smooth
    return _Squares(corners, shown, smooth, mixed)


def _cells(squares: Mask, step: int, counts: tuple[int, int]) -> Mask:
    """Select the cells of squares in a grid of rows and columns."""
    return np.repeat(np.repeat(squares, step, axis=0), step, axis=1)[: counts[0], : counts[1]].copy()


def _exact_pixels(view: View, grid: MapGrid, chosen: Mask, step: int, offset: float) -> tuple[Floats, Mask]:
    """Return pixels and visibility of the chosen places of a lattice with a step of cells."""
    pixels, visible = np.zeros((*chosen.shape, 2)), chosen.copy()
    angles = np.column_stack(grid.longitude_latitude(*(step * (np.argwhere(chosen) + offset)).T))
    visible[chosen] = np.isfinite(angles).all(axis=1)
    if visible.any():
        pixels[visible], visible[visible] = view.pixels(angles[visible[chosen]], grid.resolution_m)
    return pixels, visible


def _reduced(image: NDArray[Any], squares: _Squares, step: int) -> tuple[NDArray[Any], int]:
    """Return an image by means of square blocks as wide as cells, and the width of a block."""
    pixels = squares.corners
    in_image = ((pixels >= -0.5) & (pixels < np.array(image.shape[::-1]) - 0.5)).all(axis=-1) & squares.shown
    widths = [
        np.hypot(*np.diff(pixels, axis=k)[in_image.take(range(n - 1), k) & in_image.take(range(1, n), k)].T)
        for k, n in enumerate(in_image.shape)
    ]
    medians = (float(np.median(width)) / step for width in widths if len(width))
    reduction = max(1, int(min(medians, default=1.0)))
    width, height = np.array(image.shape[::-1]) // reduction
    if reduction == 1 or not width * height:
        return image.astype(image.dtype.newbyteorder("="), copy=False), 1
    part = image[: height * reduction, : width * reduction].astype(np.float32)
    means = load_opencv().resize(part, (width, height), interpolation=load_opencv().INTER_AREA)
    return means.reshape(height, width), reduction


@contextmanager
def new_cog(path: str | Path, grid: MapGrid, dtype: Any) -> Iterator[Any]:
    """Open a map of one band with a mask, to be written by parts; at the end it becomes a cloud-optimised GeoTIFF."""
    rasterio = load_rasterio()
    from rasterio.shutil import copy

    with scratch_folder() as folder, rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        parts = folder / "parts.tif"
        with new_geotiff(
            parts, grid.crs, grid.transform, (grid.rows, grid.columns), dtype, compress=None
        ) as file:
            yield file
            # The driver would compress overviews of its own twice.
            count = math.ceil(math.log2(max(file.shape) / BLOCK_CELLS))
            file.build_overviews([2**k for k in range(1, count + 1)], rasterio.enums.Resampling.average)
        predictor = "FLOATING_POINT" if np.issubdtype(dtype, np.floating) else "STANDARD"
        options = {"compress": "DEFLATE", "level": 1, "predictor": predictor}
        with replaced_file(path) as temporary:
            copy(parts, temporary, driver="COG", num_threads="ALL_CPUS", **options)
