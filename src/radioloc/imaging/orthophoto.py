"""Orthophotos and mosaics: images on the ground of an elevation map, as a GeoTIFF in a lunar projection.

For each cell of the map the height is looked up, the ground point goes through the sensor model, and the image is
interpolated there. Cells that no image shows are masked: outside it, hidden behind other ground, or without height.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from radioloc import vectors
from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.imaging.sensor_models import SensorModel, inside, require_mean_earth
from radioloc.imaging.surfaces import Terrain
from radioloc.lunar import TerrainModel, cartesian_to_selenographic, selenographic_to_cartesian
from radioloc.lunar.interpolation import Stencil
from radioloc.lunar.map_files import new_geotiff
from radioloc.lunar.map_grid import MapGrid, load_rasterio
from radioloc.lunar.terrain import LargeWindowError, NoTerrainError
from radioloc.quantities import accepts_quantities
from radioloc.vectors import Floats

_OUTLINE_POINTS = 65
_HIDDEN_CELLS = 1.0  # a ray that meets the ground farther than this before the point does not show it

_STEEPEST = 1.7
"""Tangent of a slope, 60 degrees, that terrain in cells of an elevation map does not exceed: so much above the horizon
nothing hides a camera."""

_KINDS = {"bilinear": "bilinear", "cubic": "bicubic"}


@accepts_quantities
def write_orthophoto(
    path: str | Path,
    images: Sequence[tuple[NDArray[Any], SensorModel]],
    terrain: TerrainModel,
    *,
    projection: str = "IAU_2015:30110",
    resolution_m: float,
    interpolation: Literal["nearest", "bilinear", "cubic"] = "bilinear",
) -> None:
    """Write an image, or several as a mosaic, as a map: a GeoTIFF with a mask.

    Parameters
    ----------
    path : path-like
        To write.
    images : sequence of tuple
        Images of one type of numbers, shape (lines, samples), each with its model in mean-Earth axes; later ones lie
        over earlier ones, such as those of a descent from high to low. The file has their type.
    terrain : TerrainModel
        The ground.
    projection : str
        Of a sphere of 1737.4 km, in any way that PROJ knows: ``IAU_2015:30110`` (equirectangular about longitude zero),
        ``30115`` (about 180 degrees), ``30130`` and ``30135`` (polar stereographic, north and south), or
        ``"+proj=..."``.
    resolution_m : float
        Size of the cells in the map's coordinates; they begin at whole multiples of it.
    interpolation : str
        ``"nearest"``, ``"bilinear"`` or ``"cubic"`` (cubic convolution, Keys 1981).

    Raises
    ------
    InputError
        An image has another shape than its model or another type than the others; a projection that is not of the Moon
        or in metres, or that an image crosses at its seam; no ground of the elevation map is shown.

    Examples
    --------
    >>> from radioloc.imaging import write_orthophoto
    >>> write_orthophoto("map.tif", [(image, model)], terrain, resolution_m=1.0)  # doctest: +SKIP
    """
    types = {image.dtype for image, _ in images}
    if len(types) != 1:
        raise InputError(f"a mosaic is made of images of one type of numbers, not of {len(types)}")
    for image, model in images:
        require_mean_earth(model)
        if image.ndim != 2 or image.shape != tuple(model.shape):
            raise InputError(
                f"the image has the shape {image.shape}, the model {tuple(model.shape)} (lines, samples)"
            )
    if interpolation != "nearest" and interpolation not in _KINDS:
        raise InputError(f"interpolation = {interpolation!r} is not known; use nearest, bilinear or cubic")
    rasterio = load_rasterio()
    crs = _reference_system(projection, resolution_m)
    grid = _covered(crs, [model for _, model in images], Terrain(terrain), resolution_m)
    shown = False
    [kind] = types
    file = new_geotiff(path, crs, grid.transform, (grid.rows, grid.columns), kind)
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), file:
        for _, window in file.block_windows(1):
            rows, columns = np.mgrid[window.toslices()].reshape(2, -1).astype(float)
            values, seen = np.zeros(len(rows), kind), np.zeros(len(rows), bool)
            for image, model in reversed(images):
                hole = np.flatnonzero(~seen)
                values[hole], seen[hole] = _block(
                    image, model, terrain, grid, rows[hole], columns[hole], interpolation
                )
            shape = window.height, window.width
            file.write(values.reshape(shape), 1, window=window)
            file.write_mask(seen.reshape(shape), window=window)
            shown |= bool(seen.any())
    if not shown:
        Path(path).unlink()
        raise InputError("no cell of the map is seen in any image")


def _reference_system(projection: str, resolution_m: float) -> Any:
    """The projection, if it is one of the Moon's sphere and in metres."""
    rasterio = load_rasterio()
    if not (np.isfinite(resolution_m) and resolution_m > 0.0):
        raise InputError(f"resolution_m = {resolution_m!r} is not a positive number of metres")
    try:
        crs = rasterio.crs.CRS.from_user_input(projection)
    except rasterio.errors.CRSError as error:
        raise InputError(f"projection {projection!r} is not known to PROJ: {error}") from error
    definition = crs.to_dict()
    radii = {float(definition.get(key, MEAN_LUNAR_RADIUS_M)) for key in ("R", "a", "b")}
    if crs.is_geographic or not {"R", "a"} & set(definition) or radii != {MEAN_LUNAR_RADIUS_M}:
        raise InputError(
            f"projection {projection!r} is not one of the Moon's sphere of 1737.4 km in metres; use one of the family "
            "of IAU_2015:30100, such as IAU_2015:30110"
        )
    return crs


def _covered(crs: Any, models: Sequence[SensorModel], ground: Terrain, resolution_m: float) -> MapGrid:
    """The cells that the images' ground may cover."""
    from rasterio.transform import Affine
    from rasterio.warp import transform

    seen = []
    for model in models:
        along, across = (np.linspace(0.0, size - 1.0, _OUTLINE_POINTS) for size in model.shape)
        pixels = np.stack([one.ravel() for one in np.meshgrid(across, along)], axis=-1)
        rays = model.rays(pixels)
        points, hits = ground.intersect(rays.origins_m, rays.directions)
        if not hits.any():
            raise InputError(f"the image shows no ground of {ground.model.metadata.path}")
        seen.append(points[hits])
    longitude, latitude, _ = cartesian_to_selenographic(np.concatenate(seen))
    geographic = f"+proj=longlat +R={MEAN_LUNAR_RADIUS_M!r} +no_defs"
    x, y = map(np.array, transform(geographic, crs, np.degrees(longitude), np.degrees(latitude)))
    if not (np.isfinite(x) & np.isfinite(y)).all():
        raise InputError(f"the projection {crs.to_string()} does not show all of the image")
    if np.ptp(x) > np.pi * MEAN_LUNAR_RADIUS_M:
        raise InputError(
            f"the image crosses the seam of {crs.to_string()}; take a projection about another longitude, such as "
            "IAU_2015:30115, or a polar one"
        )
    margin_m = max(np.ptp(x), np.ptp(y)) / (_OUTLINE_POINTS - 1)  # what the ground does between the points
    left, right = np.floor((x.min() - margin_m) / resolution_m), np.ceil((x.max() + margin_m) / resolution_m)
    bottom, top = np.floor((y.min() - margin_m) / resolution_m), np.ceil((y.max() + margin_m) / resolution_m)
    corner = Affine(resolution_m, 0.0, left * resolution_m, 0.0, -resolution_m, top * resolution_m)
    return MapGrid.of_map(crs, corner, int(top - bottom), int(right - left), MEAN_LUNAR_RADIUS_M)


def _block(
    image: NDArray[Any],
    model: SensorModel,
    terrain: TerrainModel,
    grid: MapGrid,
    rows: Floats,
    columns: Floats,
    interpolation: str,
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Values of some cells, and which of them the image shows."""
    values, seen = np.zeros(len(rows), dtype=image.dtype), np.zeros(len(rows), dtype=bool)
    longitude, latitude = grid.longitude_latitude(rows, columns)
    there = np.flatnonzero(np.isfinite(longitude) & np.isfinite(latitude))
    try:
        window = terrain.window(longitude[there], latitude[there])
    except NoTerrainError:
        return values, seen
    except LargeWindowError:  # the elevation map is much finer than the orthophoto
        half = len(rows) // 2
        halves = [
            _block(image, model, terrain, grid, rows[k], columns[k], interpolation)
            for k in (slice(half), slice(half, None))
        ]
        return np.concatenate([v for v, _ in halves]), np.concatenate([s for _, s in halves])
    height_m, known = window.heights(longitude[there], latitude[there])
    there, height_m = there[known], height_m[known]
    if not len(there):
        return values, seen
    points = selenographic_to_cartesian(longitude[there], latitude[there], height_m)
    found = model.project(points)
    shown = np.flatnonzero(found.seen & inside(model, found.pixels))
    shown = shown[~_hidden(model, terrain, points[shown], found.pixels[shown], grid.resolution_m)]
    seen[there[shown]] = True
    values[there[shown]] = _sampled(image, found.pixels[shown], interpolation)
    return values, seen


def _hidden(
    model: SensorModel, terrain: TerrainModel, points: Floats, pixels: Floats, resolution_m: float
) -> NDArray[np.bool_]:
    """Whether other ground is before points; only rays that are low enough for that are followed."""
    hidden = np.zeros(len(points), dtype=bool)
    if not len(points):
        return hidden
    rays = model.rays(pixels)
    down = -vectors.dot(points, rays.directions) / vectors.length(points)
    flat = np.flatnonzero(down <= _STEEPEST * np.sqrt(np.maximum(1.0 - down * down, 0.0)))
    if len(flat):
        met, _ = Terrain(terrain).intersect(rays.origins_m[flat], rays.directions[flat])
        allowed_m = _HIDDEN_CELLS * max(resolution_m, terrain.metadata.resolution_m)
        hidden[flat] = vectors.length(met - points[flat]) > allowed_m
    return hidden


def _sampled(image: NDArray[Any], pixels: Floats, interpolation: str) -> NDArray[Any]:
    """The image at pixels inside it; outer pixels are repeated beyond the edge."""
    lines, samples = image.shape
    if interpolation == "nearest":
        nearest = np.rint(pixels).astype(np.int64)
        return image[np.clip(nearest[:, 1], 0, lines - 1), np.clip(nearest[:, 0], 0, samples - 1)]
    stencil = Stencil.around(pixels[:, 1], pixels[:, 0], image.shape, _KINDS[interpolation])
    rows, columns = np.clip(stencil.rows, 0, lines - 1), np.clip(stencil.columns, 0, samples - 1)
    values = stencil.value(image[rows, columns].astype(np.float64))
    if np.issubdtype(image.dtype, np.integer):
        limits = np.iinfo(image.dtype)
        values = np.clip(np.rint(values), limits.min, limits.max)
    return values.astype(image.dtype)
