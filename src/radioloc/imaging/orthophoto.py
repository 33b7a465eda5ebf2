"""Orthophotos and mosaics: images on the ground of an elevation map, as a GeoTIFF in a lunar projection.

Each cell of the map has a height, its ground point a pixel by the sensor model, and the image a value there. Cells
outside all images, hidden by other ground, or without height are masked.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc import vectors
from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.imaging.sensor_models import SensorModel, require_mean_earth
from radioloc.imaging.surfaces import Terrain
from radioloc.lunar import TerrainModel, cartesian_to_selenographic, selenographic_to_cartesian
from radioloc.lunar.interpolation import Stencil
from radioloc.lunar.map_files import new_geotiff
from radioloc.lunar.map_grid import MapGrid, load_rasterio
from radioloc.lunar.terrain import LargeWindowError, NoTerrainError
from radioloc.vectors import Floats

_OUTLINE_POINTS = 65  # per side of an image
_MAX_RAY_MISS_CELLS = 1.0  # of a point from the first intersection of its ray, for a visible point
# Tangent of 60 degrees, which slopes between cells do not exceed: steeper rays need no test for hidden points.
_MAX_SLOPE = 1.7


def write_orthophoto(
    path: str | Path,
    images: Sequence[tuple[NDArray[Any], SensorModel]],
    terrain: TerrainModel,
    *,
    projection: str = "IAU_2015:30110",
    resolution_m: float,
) -> None:
    """Write an image, or a mosaic of several, as a map by bilinear interpolation: a GeoTIFF with a mask.

    Parameters
    ----------
    path : path-like
        File to write.
    images : sequence of tuple
        Images of one data type, shape (lines, samples), each with its model in mean-Earth axes. Later images cover
        earlier ones, such as those of a descent from high to low. The file has their type.
    terrain : TerrainModel
        The ground.
    projection : str
        Projection of a sphere of 1737.4 km, in any notation of PROJ: ``IAU_2015:30110`` (equirectangular about
        longitude zero), ``30115`` (about 180 degrees), ``30130`` and ``30135`` (polar stereographic, north and south),
        or ``"+proj=..."``.
    resolution_m : float
        Size of the cells in the map's coordinates; they begin at whole multiples of it.

    Raises
    ------
    InputError
        An image has another shape than its model or another type than the first image; a projection that is not of
        the Moon or in metres, or whose seam crosses an image; no ground of the elevation map is visible.

    Examples
    --------
    >>> from radioloc.imaging import write_orthophoto
    >>> write_orthophoto("map.tif", [(image, model)], terrain, resolution_m=1.0)  # doctest: +SKIP
    """
    dtype = images[0][0].dtype
    for image, model in images:
        require_mean_earth(model)
        if image.shape != tuple(model.shape) or image.dtype != dtype:
            raise InputError(
                f"expected an image of {dtype} with the shape {tuple(model.shape)} (lines, samples) of its model, got "
                f"{image.dtype} and {image.shape}"
            )
    rasterio = load_rasterio()
    crs = _lunar_projection(projection, resolution_m)
    grid = _grid(crs, [model for _, model in images], Terrain(terrain), resolution_m)
    any_visible = False
    file = new_geotiff(path, crs, grid.transform, (grid.rows, grid.columns), dtype)
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), file:
        for _, window in file.block_windows(1):
            rows, columns = np.mgrid[window.toslices()].reshape(2, -1).astype(float)
            values, visible = np.zeros(len(rows), dtype), np.zeros(len(rows), bool)
            for image, model in reversed(images):
                empty = np.flatnonzero(~visible)
                values[empty], visible[empty] = _cell_values(
                    image, model, terrain, grid, rows[empty], columns[empty]
                )
            shape = window.height, window.width
            file.write(values.reshape(shape), 1, window=window)
            file.write_mask(visible.reshape(shape), window=window)
            any_visible |= bool(visible.any())
    if not any_visible:
        Path(path).unlink()
        raise InputError("all cells of the map are outside the images")


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


def _grid(crs: Any, models: Sequence[SensorModel], ground: Terrain, resolution_m: float) -> MapGrid:
    """Return the grid of cells that contains the ground of all images."""
    from rasterio.transform import Affine
    from rasterio.warp import transform

    points_m = []
    for model in models:
        lines, samples = (np.linspace(0.0, size - 1.0, _OUTLINE_POINTS) for size in model.shape)
        rays = model.rays(np.stack(np.meshgrid(samples, lines), axis=-1).reshape(-1, 2))
        points, hits = ground.intersect(rays.origins_m, rays.directions)
        if not hits.any():
            raise InputError(f"the image shows ground outside {ground.model.metadata.path}")
        points_m.append(points[hits])
    longitude, latitude, _ = cartesian_to_selenographic(np.concatenate(points_m))
    geographic = f"+proj=longlat +R={MEAN_LUNAR_RADIUS_M!r} +no_defs"
    x, y = map(np.array, transform(geographic, crs, np.degrees(longitude), np.degrees(latitude)))
    if not (np.isfinite(x) & np.isfinite(y)).all() or np.ptp(x) > np.pi * MEAN_LUNAR_RADIUS_M:
        raise InputError(
            f"the image crosses the seam or the limit of {crs.to_string()}; take a projection about another longitude, "
            "such as IAU_2015:30115, or a polar one"
        )
    margin_m = max(np.ptp(x), np.ptp(y)) / (_OUTLINE_POINTS - 1)  # for ground between the points
    left, right = np.floor((x.min() - margin_m) / resolution_m), np.ceil((x.max() + margin_m) / resolution_m)
    bottom, top = np.floor((y.min() - margin_m) / resolution_m), np.ceil((y.max() + margin_m) / resolution_m)
    corner = Affine(resolution_m, 0.0, left * resolution_m, 0.0, -resolution_m, top * resolution_m)
    return MapGrid.of_map(crs, corner, int(top - bottom), int(right - left), MEAN_LUNAR_RADIUS_M)


def _cell_values(
    image: NDArray[Any],
    model: SensorModel,
    terrain: TerrainModel,
    grid: MapGrid,
    rows: Floats,
    columns: Floats,
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return values of some cells, and whether each is visible in the image."""
    values, visible = np.zeros(len(rows), dtype=image.dtype), np.zeros(len(rows), dtype=bool)
    longitude, latitude = grid.longitude_latitude(rows, columns)
    cells = np.flatnonzero(np.isfinite(longitude) & np.isfinite(latitude))
    try:
        window = terrain.window(longitude[cells], latitude[cells])
    except NoTerrainError:
        return values, visible
    except LargeWindowError:  # the elevation map is much finer than the orthophoto
        half = len(rows) // 2
        halves = [
            _cell_values(image, model, terrain, grid, rows[k], columns[k])
            for k in (slice(half), slice(half, None))
        ]
        return np.concatenate([v for v, _ in halves]), np.concatenate([s for _, s in halves])
    height_m, mapped = window.heights(longitude[cells], latitude[cells])
    cells, height_m = cells[mapped], height_m[mapped]
    if not len(cells):
        return values, visible
    points = selenographic_to_cartesian(longitude[cells], latitude[cells], height_m)
    projected = model.project(points)
    lines, samples = model.shape
    in_image = ((projected.pixels >= -0.5) & (projected.pixels < [samples - 0.5, lines - 0.5])).all(axis=1)
    shown = np.flatnonzero(projected.visible & in_image)
    shown = shown[~_hidden(model, terrain, points[shown], projected.pixels[shown], grid.resolution_m)]
    visible[cells[shown]] = True
    values[cells[shown]] = _interpolated(image, projected.pixels[shown])
    return values, visible


def _hidden(
    model: SensorModel, terrain: TerrainModel, points: Floats, pixels: Floats, resolution_m: float
) -> NDArray[np.bool_]:
    """Select points behind other ground; only rays of low elevation are tested."""
    hidden = np.zeros(len(points), dtype=bool)
    if not len(points):
        return hidden
    rays = model.rays(pixels)
    down = -vectors.dot(points, rays.directions) / vectors.length(points)
    flat = np.flatnonzero(down <= _MAX_SLOPE * np.sqrt(np.maximum(1.0 - down * down, 0.0)))
    if len(flat):
        first_m, _ = Terrain(terrain).intersect(rays.origins_m[flat], rays.directions[flat])
        allowed_m = _MAX_RAY_MISS_CELLS * max(resolution_m, terrain.metadata.resolution_m)
        hidden[flat] = vectors.length(first_m - points[flat]) > allowed_m
    return hidden


def _interpolated(image: NDArray[Any], pixels: Floats) -> NDArray[Any]:
    """Return the image at pixels; outer pixels are repeated beyond the edge."""
    lines, samples = image.shape
    stencil = Stencil.around(pixels[:, 1], pixels[:, 0], image.shape, "bilinear")
    rows, columns = np.clip(stencil.rows, 0, lines - 1), np.clip(stencil.columns, 0, samples - 1)
    values = stencil.value(image[rows, columns].astype(np.float64))
    return (np.rint(values) if image.dtype.kind in "iu" else values).astype(image.dtype)
