"""Orthophotos and mosaics: images on the ground of an elevation map, as a GeoTIFF in a lunar projection."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.imaging.rectification import TerrainView, grid_around, new_cog, outline, part_of, rectified
from radioloc.imaging.sensor_models import SensorModel
from radioloc.lunar import TerrainModel


def write_orthophoto(
    path: str | Path,
    images: Sequence[tuple[NDArray[Any], SensorModel]],
    terrain: TerrainModel,
    *,
    projection: str = "IAU_2015:30110",
    resolution_m: float,
) -> None:
    """Write an image, or a mosaic of several, as a map by bilinear interpolation: a cloud-optimised GeoTIFF.

    Parameters
    ----------
    path : path-like
        File to write; it has a mask.
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
    views = [TerrainView(model, terrain) for _, model in images]
    for image, model in images:
        if image.shape != tuple(model.shape) or image.dtype != dtype:
            raise InputError(
                f"expected an image of {dtype} with the shape {tuple(model.shape)} (lines, samples) of its model, got "
                f"{image.dtype} and {image.shape}"
            )
    grid = grid_around(np.concatenate([outline(view) for view in views]), projection, resolution_m)
    any_visible = False
    with new_cog(path, grid, dtype) as file:
        for _, window in file.block_windows(1):
            part, shape = part_of(grid, *window.toslices()), (window.height, window.width)
            values, visible = np.zeros(shape, dtype), np.zeros(shape, bool)
            for (image, _), view in zip(images, views, strict=True):
                drawn, shown = rectified(image, view, part)
                values, visible = np.where(shown, drawn, values), visible | shown
            file.write(values, 1, window=window)
            file.write_mask(visible, window=window)
            any_visible |= bool(visible.any())
        if not any_visible:
            raise InputError("all cells of the map are outside the images")
