"""Files of descent images for geographic information systems: rectified images, mosaic, tie points, outlines, poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.imaging.frames import read_frame
from radioloc.imaging.homography import transformed
from radioloc.imaging.mosaic import balanced
from radioloc.imaging.orientation import quaternions_from_matrices
from radioloc.imaging.rectification import (
    grid_around,
    map_grid,
    nearest_projection,
    new_cog,
    part_of,
    rectified,
)
from radioloc.imaging.registration import TIE_COLUMNS, RegisteredFrame, Registration
from radioloc.io.gis import feature, position_layers, write_geopackage
from radioloc.lunar import LunarPosition, Map, cartesian_to_selenographic, east_north_up
from radioloc.lunar.grey_images import Image, Mask
from radioloc.lunar.map_grid import MapGrid
from radioloc.results.result import Content, Result, Table
from radioloc.vectors import Floats

FILES = ("poses.csv", "tie_points.csv", "images.gpkg", "mosaic.tif", "rectified/*.tif")
"""Names and patterns of the files."""

_MAX_SIDE_CELLS = 4096  # of a map: 17 million cells; finer images have their own map
_MIN_DRAWN_CELLS = 10  # on each side of an image; coarser ones show the ground of smaller ones as well
_MIN_NEW_PART = 0.15  # change of scale, or motion as a part of the image, of an image that is drawn
_TOLERANCE_PX = 0.1  # of rectified images: a third of the residuals of tie points
_RING_STEPS = 16  # points on each side of an outline
_ADJUSTED, _LEVEL = "adjusted", "level ground"  # poses in the table
POSE_COLUMNS = (
    *("file", "pose", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz", "longitude_deg", "latitude_deg"),
    *("height_m", "altitude_m", "tilt_deg", "azimuth_deg", "sigma_x_deg", "sigma_y_deg", "sigma_z_deg"),
    *("sigma_east_m", "sigma_north_m", "sigma_up_m"),
)
_CSV_DECIMALS = {"longitude_deg": 8, "latitude_deg": 8} | dict.fromkeys(TIE_COLUMNS, 3)


class MappedImages(Result):
    """Base class of a solution with descent images on a map."""

    __slots__ = ()
    name: str
    position: LunarPosition
    registration: Registration
    base: Map
    mask: Mask | None
    altitudes_m: Mapping[str, float]
    paths: Mapping[str, Path]

    @property
    def registered(self) -> tuple[RegisteredFrame, ...]:
        """Images with a place on the map."""
        return tuple(f for f in self.registration.frames if f.is_registered)


def product_files(solution: MappedImages) -> dict[str, Content]:
    """Return the files of a solution by name, with functions that write the maps and the layers."""
    poses = pose_table(solution)
    files: dict[str, Content] = {
        "poses.csv": Table(poses),
        "tie_points.csv": Table(solution.registration.tie_points(), _CSV_DECIMALS),
        "images.gpkg": lambda path: write_geopackage(path, _layers(solution, poses)),
    }
    for number, frame in enumerate(solution.registration.frames, 1):
        if frame.is_registered:
            name = f"rectified/{number:03d}_{Path(frame.name).stem}.tif"
            files[name] = partial(_write_rectified, solution, frame)
    return {**files, "mosaic.tif": partial(_write_mosaic, solution)}


def pose_table(solution: MappedImages) -> dict[str, Any]:
    """Return poses of the registered images with a camera: position in mean-Earth axes, and attitude.

    The quaternion, scalar first, turns vectors from the camera's axes (x right, y down, z ahead) to the Moon's. The
    azimuth counts from north over east. Poses that are not adjusted follow from the homography of level ground; their
    attitude contains its slope. Sigmas are relative to the map.
    """
    registration, rows = solution.registration, []
    for frame in solution.registered:
        sensor = registration.sensor_model(frame.name, solution.position.selenographic[2])
        if sensor is None:
            continue
        position, rotation = sensor.orientation.position_m, sensor.orientation.rot_camera_to_moon
        longitude, latitude, [height_m] = cartesian_to_selenographic(position[None])
        east, north, up = east_north_up(longitude[0], latitude[0]) @ rotation[:, 2]
        covariance = registration.pose_covariance(frame.name)
        sigmas = np.full(6, np.nan) if covariance is None else np.sqrt(np.diag(covariance))
        altitude_m = solution.altitudes_m.get(frame.name, math.nan)
        axis_deg = math.degrees(math.acos(min(1.0, -up))), math.degrees(math.atan2(east, north)) % 360.0
        numbers = (
            *(*position, *quaternions_from_matrices(rotation[None])[0]),
            *(*np.degrees([longitude[0], latitude[0]]), height_m, altitude_m),
            *(*axis_deg, *np.degrees(sigmas[:3]), *sigmas[3:]),
        )
        rows.append((frame.name, _LEVEL if covariance is None else _ADJUSTED, *numbers))
    columns = map(np.array, zip(*rows, strict=True))
    return dict(zip(POSE_COLUMNS, columns, strict=True)) if rows else {"file": []}


def track_deg(poses: Mapping[str, Any]) -> Floats:
    """Return longitude and latitude of the camera by adjusted poses, or else by the others, shape (n, 2)."""
    if not len(poses["file"]):
        return np.zeros((0, 2))
    places = np.column_stack([poses["longitude_deg"], poses["latitude_deg"]])
    adjusted = poses["pose"] == _ADJUSTED
    return places[adjusted] if adjusted.any() else places


def lay_over(canvas: Image, valid: Mask, solution: MappedImages, grid: MapGrid) -> None:
    """Draw images finer than the map over it in the cells of a grid, the finest on top, with its brightness.

    `valid` selects the cells of the map, at the end also those of images.
    """
    covered = np.zeros(canvas.shape, bool)
    finer = (frame for frame in solution.registered if frame.pixel_m < solution.base.resolution_m)
    for frame in sorted(_distinct_frames([*finer]), key=lambda frame: frame.pixel_m):
        cells = np.column_stack(grid.cells(*solution.registration.outline(frame.name).T))
        first = np.clip(np.floor(cells.min(axis=0)), 0, canvas.shape).astype(int)
        last = np.clip(np.ceil(cells.max(axis=0)) + 1, first, canvas.shape).astype(int)
        part = slice(first[0], last[0]), slice(first[1], last[1])
        if (last - first).min() >= _MIN_DRAWN_CELLS and not covered[part].all():
            values, shown = _rectified_frame(solution, frame, part_of(grid, *part))
            values = balanced(values, canvas[part], shown & valid[part])
            uncovered = shown & ~covered[part]
            canvas[part][uncovered] = values[uncovered]
            covered[part] |= shown
            valid[part] |= shown


def _distinct_frames(frames: Sequence[RegisteredFrame]) -> Iterator[RegisteredFrame]:
    """Yield frames that are closer than the previous one or show other ground, and the last."""
    pixel_m, middle = math.inf, np.zeros(2)
    for frame in frames:
        [centre] = in_plane(frame, [[1, 1]])
        moved = float(np.abs(centre - middle).max()) > _MIN_NEW_PART * frame.pixel_m * frame.centre.max()
        if frame.pixel_m < (1.0 - _MIN_NEW_PART) * pixel_m or moved or frame is frames[-1]:
            pixel_m, middle = frame.pixel_m, centre
            yield frame


def in_plane(frame: RegisteredFrame, halves: Sequence[Sequence[int]]) -> Floats:
    """Return places of an image in the plane, m, for pixels in halves of its size."""
    assert frame.homography is not None
    to_plane = np.asarray(np.linalg.inv(frame.homography.matrix), dtype=np.float64)
    return transformed(to_plane, np.array(halves, dtype=np.float64) * frame.centre)


def _rectified_frame(
    solution: MappedImages, frame: RegisteredFrame, grid: MapGrid
) -> tuple[NDArray[Any], Mask]:
    """Return an image in the cells of a grid, and the mask of cells that it shows."""
    image, view = read_frame(solution.paths[frame.name]), solution.registration.view(frame.name)
    return rectified(image, view, grid, solution.mask, _TOLERANCE_PX)


def _write_mosaic(solution: MappedImages, path: Path) -> None:
    """Write the base map, as far as images show its ground, with the finer ones over it."""
    registration, frames = solution.registration, solution.registered
    plane, (west, south, east, north) = registration.plane, solution.base.extent_m(registration.plane)
    angles = np.concatenate([registration.outline(frame.name) for frame in frames])
    shown_m = plane.from_longitude_latitude(np.degrees(angles))
    angles = np.radians(plane.to_longitude_latitude(np.clip(shown_m, [west, south], [east, north])))
    finest_m = min(frame.pixel_m for frame in frames)
    grid = _limited(lambda cell_m: map_grid(_projection(solution), angles, cell_m), finest_m)
    canvas, valid = solution.base.on_grid(grid)
    lay_over(canvas, valid, solution, grid)
    _write_map(path, grid, canvas, valid)


def _write_rectified(solution: MappedImages, frame: RegisteredFrame, path: Path) -> None:
    angles = solution.registration.outline(frame.name)
    grid = _limited(lambda cell_m: grid_around(angles, _projection(solution), cell_m), frame.pixel_m)
    _write_map(path, grid, *_rectified_frame(solution, frame, grid))


def _write_map(path: Path, grid: MapGrid, values: NDArray[Any], shown: Mask) -> None:
    with new_cog(path, grid, values.dtype) as file:
        file.write(values, 1)
        file.write_mask(shown)


def _projection(solution: MappedImages) -> str:
    return nearest_projection(*solution.position.selenographic[:2])


def _limited(grid_of: Callable[[float], MapGrid], cell_m: float) -> MapGrid:
    """Return a grid of cells of a size in two digits, or larger ones if the grid had too many cells."""
    grid = grid_of(float(f"{cell_m:.2g}"))
    part = max(grid.rows, grid.columns) / _MAX_SIDE_CELLS
    return grid if part <= 1.0 else grid_of(float(f"{1.05 * part * grid.resolution_m:.2g}"))


def _layers(solution: MappedImages, poses: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Return features of all layers: position with ellipses, outlines, cameras with their track, tie points."""
    cameras = [
        feature("Point", [row["longitude_deg"], row["latitude_deg"]], row)
        for row in _rows({name: column for name, column in poses.items() if len(column)})
    ]
    places = track_deg(poses)
    track = [feature("LineString", places.tolist(), {"name": solution.name})] if len(places) > 1 else []
    return {
        "tie_points": list(_tie_features(solution)),
        "outlines": [_outline_feature(solution, frame) for frame in solution.registered],
        "track": track,
        "cameras": cameras,
        **position_layers([solution.to_dict()]),
    }


def _rows(columns: Mapping[str, NDArray[Any]]) -> Iterator[dict[str, Any]]:
    """Yield rows of a table, with None for NaN."""
    plain = [
        np.where(np.isfinite(column), column, np.array(None))
        if column.dtype.kind == "f"
        else column.astype(object)
        for column in columns.values()
    ]
    for row in zip(*plain, strict=True):
        yield dict(zip(columns, row, strict=True))


def _tie_features(solution: MappedImages) -> Iterator[dict[str, Any]]:
    """Yield the tie points in the adjustment, with residuals in their images and on the map."""
    ties = solution.registration.tie_points()
    used = ties["used"] == 1
    on_map = used & np.isfinite(ties["residual_east_m"])
    in_images = used & ~on_map
    point = ties["point"]
    squares = ties["residual_sample_px"] ** 2 + ties["residual_line_px"] ** 2
    count = int(point.max()) + 1
    numbers, first = np.unique(point[used], return_index=True)
    images = np.bincount(point[in_images], minlength=count)
    rms_px = np.sqrt(np.bincount(point[in_images], squares[in_images], count) / np.maximum(images, 1))
    residuals_m = np.full((2, count), np.nan)
    residuals_m[:, point[on_map]] = ties["residual_east_m"][on_map], ties["residual_north_m"][on_map]
    table = {
        "point": numbers,
        "longitude_deg": ties["longitude_deg"][used][first],
        "latitude_deg": ties["latitude_deg"][used][first],
        "images": images[numbers],
        "rms_px": rms_px[numbers],
        "residual_east_m": residuals_m[0, numbers],
        "residual_north_m": residuals_m[1, numbers],
    }
    for row in _rows(table):
        yield feature("Point", [row.pop("longitude_deg"), row.pop("latitude_deg")], row)


def _outline_feature(solution: MappedImages, frame: RegisteredFrame) -> dict[str, Any]:
    view = solution.registration.view(frame.name)
    part = np.linspace(0.0, 1.0, _RING_STEPS, endpoint=False)
    first, last = np.zeros_like(part), np.ones_like(part)
    sides = (part, first), (last, part), (1.0 - part, last), (first, 1.0 - part)
    edges = np.hstack([np.array(side) for side in sides]).T
    angles, hits = view.ground(edges * 2.0 * frame.centre)
    ring = np.degrees(angles[hits])
    ring[:, 0] = np.degrees(np.unwrap(np.radians(ring[:, 0])))
    attributes = {
        "file": frame.name,
        "pixel_m": frame.pixel_m,
        "tie_points": frame.inliers,
        "rms_px": frame.rms_px,
    }
    return feature("Polygon", [[*ring.tolist(), ring[0].tolist()]], attributes)
