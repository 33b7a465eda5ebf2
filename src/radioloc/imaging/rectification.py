"""Rectification: images resampled to the cells of a map, as cloud-optimised GeoTIFF.

Each cell has a ground point, the ground point a pixel by the view of the image, and the image a value there (bilinear).
Cells outside the image, hidden by other ground, or without height are masked.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from radioloc import vectors
from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.imaging.sensor_models import SensorModel, require_mean_earth
from radioloc.imaging.surfaces import Terrain
from radioloc.lunar import TerrainModel, cartesian_to_selenographic, selenographic_to_cartesian
from radioloc.lunar.map_files import new_geotiff
from radioloc.lunar.map_grid import MapGrid, load_rasterio
from radioloc.lunar.terrain import LargeWindowError, NoTerrainError
from radioloc.text_files import replaced_file, scratch_folder
from radioloc.vectors import Floats

_OUTLINE_POINTS = 65  # per side of an image
_MAX_RAY_MISS_CELLS = 1.0  # of a point from the first intersection of its ray, for a visible point
# Tangent of 60 degrees, which slopes between cells do not exceed: steeper rays need no test for hidden points.
_MAX_SLOPE = 1.7
_MAX_EQUIRECTANGULAR_LATITUDE_DEG = 60.0  # a parallel there has half of its length on the map


class View(Protocol):
    """Ground of the Moon in an image of a shape (lines, samples); angles are longitude and latitude, rad."""

    @property
    def shape(self) -> tuple[int, int]:
        """Lines and samples."""
        ...

    def ground(self, pixels: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return angles, shape (n, 2), of pixels, shape (n, 2), and whether each shows the ground."""
        ...

    def pixels(self, angles: Floats, tolerance_m: float) -> tuple[Floats, NDArray[np.bool_]]:
        """Return pixels of ground points, and whether the image shows them; hidden by more than a tolerance."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class TerrainView:
    """View of an elevation model by a sensor model in mean-Earth axes."""

    model: SensorModel
    terrain: TerrainModel = field(repr=False)

    def __post_init__(self) -> None:
        require_mean_earth(self.model)

    @property
    def shape(self) -> tuple[int, int]:
        """Lines and samples."""
        return self.model.shape

    def ground(self, pixels: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return angles of the first intersections of rays with the ground, and whether each ray has one."""
        rays = self.model.rays(pixels)
        points, hits = Terrain(self.terrain).intersect(rays.origins_m, rays.directions)
        return np.column_stack(cartesian_to_selenographic(points)[:2]), hits

    def pixels(self, angles: Floats, tolerance_m: float) -> tuple[Floats, NDArray[np.bool_]]:
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
        shown = shown[~self._hidden(points[shown], projected.pixels[shown], tolerance_m)]
        pixels[cells[shown]], visible[cells[shown]] = projected.pixels[shown], True
        return pixels, visible

    def _hidden(self, points: Floats, pixels: Floats, tolerance_m: float) -> NDArray[np.bool_]:
        """Select points behind other ground; only rays of low elevation are tested."""
        hidden = np.zeros(len(points), dtype=bool)
        if not len(points):
            return hidden
        rays = self.model.rays(pixels)
        down = -vectors.dot(points, rays.directions) / vectors.length(points)
        flat = np.flatnonzero(down <= _MAX_SLOPE * np.sqrt(np.maximum(1.0 - down * down, 0.0)))
        if len(flat):
            first_m, _ = Terrain(self.terrain).intersect(rays.origins_m[flat], rays.directions[flat])
            allowed_m = max(tolerance_m, _MAX_RAY_MISS_CELLS * self.terrain.metadata.resolution_m)
            hidden[flat] = vectors.length(first_m - points[flat]) > allowed_m
        return hidden


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
    left, right = np.floor((x.min() - margin_m) / resolution_m), np.ceil((x.max() + margin_m) / resolution_m)
    bottom, top = np.floor((y.min() - margin_m) / resolution_m), np.ceil((y.max() + margin_m) / resolution_m)
    corner = Affine(resolution_m, 0.0, left * resolution_m, 0.0, -resolution_m, top * resolution_m)
    return MapGrid.of_map(crs, corner, int(top - bottom), int(right - left), MEAN_LUNAR_RADIUS_M)


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


def grid_around(views: Iterable[View], projection: str, resolution_m: float) -> MapGrid:
    """Return the grid of cells that contains the ground of all images."""
    return map_grid(projection, np.concatenate([outline(view) for view in views]), resolution_m, 1.0 / 64.0)


def outline(view: View) -> Floats:
    """Return angles of the ground, rad, shape (n, 2), at a lattice of pixels over the image."""
    lines, samples = (np.linspace(0.0, size - 1.0, _OUTLINE_POINTS) for size in view.shape)
    angles, hits = view.ground(np.stack(np.meshgrid(samples, lines), axis=-1).reshape(-1, 2))
    if not hits.any():
        raise InputError(f"the image shows ground outside the map or elevation model: {view!r}")
    return angles[hits]


def rectified(
    image: NDArray[Any], view: View, grid: MapGrid, rows: slice, columns: slice
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return an image resampled to some rows and columns of a grid, and the mask of cells that it shows."""
    shape = rows.stop - rows.start, columns.stop - columns.start
    row, column = np.mgrid[rows, columns].reshape(2, -1).astype(float)
    angles = np.column_stack(grid.longitude_latitude(row, column))
    cells = np.flatnonzero(np.isfinite(angles).all(axis=1))
    values, visible = np.zeros(len(row), image.dtype), np.zeros(len(row), bool)
    pixels, shown = view.pixels(angles[cells], grid.resolution_m)
    visible[cells] = shown
    values[visible] = interpolated(image, pixels[shown])
    return values.reshape(shape), visible.reshape(shape)


def interpolated(image: NDArray[Any], pixels: Floats) -> NDArray[Any]:
    """Return the image at pixels, shape (n, 2), by bilinear interpolation; outer pixels are repeated outside."""
    from scipy.ndimage import map_coordinates

    values = map_coordinates(image, pixels.T[::-1], np.float64, order=1, mode="nearest")
    return (np.rint(values) if image.dtype.kind in "iu" else values).astype(image.dtype)


@contextmanager
def new_cog(path: str | Path, grid: MapGrid, dtype: Any) -> Iterator[Any]:
    """Open a map of one band with a mask, to be written by parts; at the end it becomes a cloud-optimised GeoTIFF."""
    rasterio = load_rasterio()
    from rasterio.shutil import copy

    with scratch_folder() as folder, rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        parts = folder / "parts.tif"
        with new_geotiff(parts, grid.crs, grid.transform, (grid.rows, grid.columns), dtype) as file:
            yield file
        predictor = "FLOATING_POINT" if np.issubdtype(dtype, np.floating) else "STANDARD"
        options = {"compress": "DEFLATE", "predictor": predictor, "overview_resampling": "AVERAGE"}
        with replaced_file(path) as temporary:
            copy(parts, temporary, driver="COG", **options)
