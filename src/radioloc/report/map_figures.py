"""Positions on a map of the Moon, over shaded terrain or an image, and descent images laid over theirs."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radioloc.boundary import bare_arguments
from radioloc.errors import InputError
from radioloc.imaging import read_frame
from radioloc.imaging.frames import load_opencv
from radioloc.imaging.homography import transformed
from radioloc.imaging.registration import RegisteredFrame
from radioloc.lunar import Map, TangentPlane
from radioloc.lunar.terrain import TerrainModel
from radioloc.report.figures import (
    COLORS,
    SCALE_95,
    draw_ellipse,
    draws_names_literally,
    legend_below,
    legend_outside,
    length_unit,
    one_panel,
    several_panels,
    style_axes,
)
from radioloc.report.position_figures import draw_place
from radioloc.results.image_solution import ImageSolution
from radioloc.results.result import Result
from radioloc.results.tables import (
    Located,
    contents_by_target,
    horizontal_covariance_of,
    position_of,
    references_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Floats = NDArray[np.float64]

_PIXELS, _MOSAIC_PIXELS = 600, 700
_PANELS = 3  # of descent images
_PART = 0.15  # of an image
_SHADES = (3.0, 0.10, ""), (1.0, 0.25, "")  # ellipses of so many sigmas: how opaque they are, no labels
_SUN_AZIMUTH_DEG, _SUN_ELEVATION_DEG = 315.0, 40.0  # from the upper left, as eyes expect
_LEAST_CELLS = 60.0  # of the terrain or the image, across
_MOST_NAMED = 3  # studies in the title
_FARTHEST_DEG = 150.0  # in longitude from the middle, where lines of it end at a pole that is on the map
_FARTHEST_M = 5e5  # of the edges; the plane that touches the sphere shows no more without distortion
_WIDEST_M = 1e6  # where that is accepted; the corners are on the Moon still


@draws_names_literally
@bare_arguments
def plot_map(
    solutions: Located | Iterable[Located],
    *,
    dem: str | Path | TerrainModel | None = None,
    base_map: str | Path | None = None,
    reach_m: float | None = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw positions, their error ellipses of one and three sigma, and references on a map in mean-Earth axes.

    Parameters
    ----------
    solutions : Solution, ImageSolution or mapping, or several
        What to draw; a mapping is what ``solution.json`` holds. The first is in the middle.
    dem : path-like or TerrainModel, optional
        An elevation model, drawn with shades; of any format that :class:`~radioloc.lunar.TerrainModel` opens.
    base_map : path-like, optional
        A map image, in place of that; of any format that :class:`~radioloc.lunar.Map` opens.
    reach_m : float, optional
        From the middle to the edges, 1000 km at most, m; by default all that is drawn, and some of the ground around
        it.
    ax : matplotlib.axes.Axes, optional
        Axes to draw in, in place of a figure of its own; without the globe.

    Returns
    -------
    matplotlib.figure.Figure
        Shows itself in a notebook; save it with :func:`~radioloc.report.save_figure`.

    Raises
    ------
    InputError
        There is no position to draw, they are of different axes, both backgrounds are given, a map does not cover what
        is drawn, or there is no such reach.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> figure = radioloc.report.plot_map(solution)
    >>> figure.axes[0].get_xlabel()
    'east longitude, ME_DE421 (deg)'
    """
    several = [solutions] if isinstance(solutions, Result | Mapping) else list(solutions)
    contents = contents_by_target(several)
    if dem is not None and base_map is not None:
        raise InputError("give either dem or base_map to draw a map on, not both")
    if reach_m is not None and not 0.0 < reach_m <= _WIDEST_M:
        raise InputError(f"reach_m = {reach_m!r} is not above 0 and at most {_WIDEST_M:g} m")
    frame = _frame(contents)
    plane = TangentPlane(*_place(contents[0]["position"]["me"]))
    # In the order of the solutions, each once.
    references = dict.fromkeys((item["name"], _place(item)) for c in contents for item in references_of(c))
    ground = _ground(dem, base_map)
    reach_m = _reach_m(contents, references, plane, ground) if reach_m is None else reach_m
    factor, unit = length_unit(2.0 * reach_m)
    studies = list(dict.fromkeys(re.sub(r", [0-9.]+ h$", "", content["name"]) for content in contents))
    title = " and ".join(studies) if len(studies) <= _MOST_NAMED else f"{len(studies)} studies"
    legend_rows = -(-(len(contents) + len(references)) // 2)
    axes = one_panel(ax, 6.4, 6.5 + 0.17 * legend_rows, title)
    edges = [factor * edge for edge in (-reach_m, reach_m, -reach_m, reach_m)]
    if ground is not None:
        image = _shown(ground, plane, reach_m)
        axes.imshow(image, extent=edges, cmap="gray", interpolation="bilinear")  # type: ignore[arg-type]
    for k, content in enumerate(contents):
        [at_m] = plane.from_longitude_latitude([_place(content["position"]["me"])])
        covariance_m2, method = horizontal_covariance_of(content), content.get("method", "tracking")
        name = content["name"] + (", 1 and 3 sigma" if covariance_m2 is not None else "")
        draw_place(axes, factor, at_m, name, method, k, covariance_m2, _SHADES)
    for k, (name, place) in enumerate(references):
        [at_m] = plane.from_longitude_latitude([place])
        draw_place(axes, factor, at_m, name, "reference", k)
    axes.set_xlim(edges[0], edges[1])
    axes.set_ylim(edges[2], edges[3])
    axes.set_aspect("equal")
    _draw_grid(axes, plane, reach_m, factor, frame)
    _draw_scale(axes, factor * reach_m, unit)
    if ax is None:
        _draw_globe(axes, plane)
    legend_below(axes, ax, 2)
    return axes.figure.figure


def _place(angles: Mapping[str, Any]) -> tuple[float, float]:
    return angles["longitude_deg"], angles["latitude_deg"]


def _frame(contents: Sequence[Mapping[str, Any]]) -> str:
    """The axes of all positions."""
    if not contents:
        raise InputError("there is no position to draw on a map")
    frames = {position_of(content)["me"]["frame"] for content in contents}
    if len(frames) > 1:
        raise InputError(f"positions of different axes ({', '.join(sorted(frames))}) do not go on one map")
    return str(frames.pop())


def _reach_m(
    contents: Sequence[Mapping[str, Any]],
    references: Iterable[tuple[str, tuple[float, float]]],
    plane: TangentPlane,
    ground: Map | TerrainModel | None,
) -> float:
    sizes_m = []
    for content in contents:
        covariance = horizontal_covariance_of(content)
        size_m = 0.0 if covariance is None else _SHADES[0][0] * float(np.sqrt(np.diag(covariance)).max())
        sizes_m.append(size_m)
    places = [_place(content["position"]["me"]) for content in contents] + [place for _, place in references]
    offsets_m = np.abs(plane.from_longitude_latitude(places)).max(axis=1)
    offsets_m[: len(sizes_m)] += sizes_m
    if not offsets_m.max() < _FARTHEST_M:  # nor NaN, where the plane does not show the point
        raise InputError("positions and references are too far apart for one map, 500 km and more")
    cell_m = 0.0
    if ground is not None:
        cell_m = ground.resolution_m if isinstance(ground, Map) else ground.metadata.resolution_m
    return max(1.0, 0.5 * _LEAST_CELLS * cell_m, 1.25 * float(offsets_m.max()))


def _ground(dem: str | Path | TerrainModel | None, base_map: str | Path | None) -> Map | TerrainModel | None:
    if base_map is not None:
        return Map.open(base_map)
    if isinstance(dem, TerrainModel):
        return replace(dem, interpolation="bicubic")
    return None if dem is None else TerrainModel.open(dem, interpolation="bicubic")


def _shown(ground: Map | TerrainModel, plane: TangentPlane, reach_m: float) -> NDArray[Any]:
    """The map image, or the shaded terrain, about the middle."""
    pixel_m = 2.0 * reach_m / _PIXELS
    first_m = reach_m - 0.5 * pixel_m
    if isinstance(ground, Map):
        view, _ = ground.view(plane, -first_m, first_m, pixel_m, (_PIXELS, _PIXELS))
        return view
    from matplotlib.colors import LightSource

    east, north = np.meshgrid(*[np.linspace(-first_m, first_m, _PIXELS)] * 2)
    degrees = plane.to_longitude_latitude(np.column_stack([east.ravel(), north[::-1].ravel()]))
    heights = ground.height_m(*np.radians(degrees).T).reshape(east.shape)
    light = LightSource(_SUN_AZIMUTH_DEG, _SUN_ELEVATION_DEG)
    return np.asarray(light.hillshade(heights, vert_exag=1.0, dx=pixel_m, dy=pixel_m))


def _draw_grid(axes: Axes, plane: TangentPlane, reach_m: float, factor: float, frame: str) -> None:
    """Lines of equal longitude and latitude, with their degrees where they leave the map below and to the left."""
    side = np.linspace(-reach_m, reach_m, 101)
    places = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    longitude, latitude = plane.to_longitude_latitude(places).T.reshape(2, len(side), len(side))
    away = (longitude - plane.longitude_deg + 180.0) % 360.0 - 180.0
    longitude = np.where(np.abs(away) < _FARTHEST_DEG, plane.longitude_deg + away, np.nan)
    borders = (longitude, longitude[0], axes.set_xticks), (latitude, latitude[:, 0], axes.set_yticks)
    for angle_deg, along, set_ticks in borders:
        if not (np.diff(along) > 0.0).all():
            set_ticks([])  # a pole is on the map
            continue
        step = _nice((along[-1] - along[0]) / 4.0)
        values = step * np.arange(math.ceil(along[0] / step), math.floor(along[-1] / step) + 1)
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        set_ticks(factor * np.interp(values, along, side), [f"{value:.{decimals}f}" for value in values])
        look: dict[str, Any] = {"colors": "0.6", "linewidths": 0.4, "linestyles": "-", "alpha": 0.7}
        axes.contour(factor * side, factor * side, angle_deg, values, zorder=1, **look)
    axes.set_xlabel(f"east longitude, {frame} (deg)", fontsize=9)
    axes.set_ylabel("latitude (deg)", fontsize=9)
    axes.tick_params(labelsize=8, color="0.4")


def _nice(size: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not larger."""
    power = 10.0 ** math.floor(math.log10(size))
    return next(step * power for step in (5.0, 2.0, 1.0) if step * power <= size * (1.0 + 1e-9))


def _draw_scale(axes: Axes, reach: float, unit: str) -> None:
    """A bar of a round length in the lower right corner."""
    from matplotlib.patheffects import withStroke

    length = _nice(0.5 * reach)
    x, y = 0.92 * reach, -0.9 * reach
    halo = [withStroke(linewidth=3, foreground="white")]
    axes.plot([x - length, x], [y, y], color="black", linewidth=2.5, solid_capstyle="butt", path_effects=halo)
    axes.text(
        x - 0.5 * length, y + 0.03 * reach, f"{length:g} {unit}", ha="center", fontsize=8, path_effects=halo
    )


def _draw_globe(around: Axes, plane: TangentPlane) -> None:
    """The side of the Moon that the Earth sees, the Earth's mean direction in its middle, with the site."""
    axes = around.inset_axes((0.015, 0.80, 0.185, 0.185))
    turn = np.linspace(0.0, 2.0 * np.pi, 121)
    axes.fill(np.cos(turn), np.sin(turn), facecolor=(1.0, 1.0, 1.0, 0.85), edgecolor="0.3", linewidth=0.8)
    half = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 61)
    for angle in np.radians(np.arange(-60, 61, 30)):
        axes.plot(np.sin(angle) * np.cos(half), np.sin(half), color="0.75", linewidth=0.4)
        axes.plot(
            np.cos(angle) * np.sin(half), np.full_like(half, np.sin(angle)), color="0.75", linewidth=0.4
        )
    axes.plot(0.0, 0.0, "+", color="0.3", markersize=5, markeredgewidth=0.8)
    axes.annotate("Earth", (0.0, 0.0), (2, 2), textcoords="offset points", fontsize=6, color="0.3")
    to_earth, to_east, to_north = plane.axes()[2]
    seen = to_earth > 0.0
    axes.plot(
        to_east, to_north, "o", color=COLORS[1], markersize=4, markerfacecolor=COLORS[1] if seen else "white"
    )
    if not seen:
        axes.set_title("far side", fontsize=6, y=-0.12)
    axes.set_aspect("equal")
    axes.axis("off")


@draws_names_literally
def plot_images(solution: ImageSolution, ax: Axes | None = None) -> Figure:
    """Draw the mosaic of the images on the map, from all that the highest shows down to the lander.

    Parameters
    ----------
    solution : ImageSolution
    ax : matplotlib.axes.Axes, optional
        Axes of a grid whose place the panels take, in place of a figure of their own.

    Returns
    -------
    matplotlib.figure.Figure
        Three panels, each a closer look: the map with the images laid over it, their outlines, tie points with the map,
        the path of their centres, and the lander with its 95 % ellipse.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate_images(radioloc.jobs.read_image_study("examples/images/descent.toml"))
    >>> len(radioloc.report.plot_images(solution).axes)
    3
    """
    frames = solution.registered
    plane = solution.registration.plane
    longitude, latitude, _ = solution.position.selenographic
    lander = plane.from_longitude_latitude([[longitude, latitude]])[0]
    corners = [_in_plane(frame, [[0, 0], [2, 0], [2, 2], [0, 2]]) for frame in frames]
    widest, closest = (float(np.ptp(c, axis=0).max()) for c in (corners[0], corners[-1]))
    widths = np.geomspace(widest, 3.0 * closest, _PANELS)
    title = f"{solution.name}: {len(frames)} images on {solution.map_name}"
    figure = several_panels(ax, 13.0, 4.9, title)
    panels = figure.subplots(1, _PANELS)
    centres = np.concatenate([_in_plane(frame, [[1, 1]]) for frame in frames])
    for k, (axes, width) in enumerate(zip(panels, widths, strict=True)):
        middle = 0.5 * (corners[0].min(axis=0) + corners[0].max(axis=0)) if k == 0 else lander
        west, north = middle[0] - 0.5 * width - lander[0], middle[1] + 0.5 * width - lander[1]
        factor, unit = length_unit(width)
        style_axes(axes)
        axes.grid(visible=False)
        edges = [factor * edge for edge in (west, west + width, north - width, north)]
        mosaic = _mosaic(solution, west + lander[0], north + lander[1], width)
        axes.imshow(mosaic, extent=edges, cmap="gray", vmin=0, vmax=255, interpolation="bilinear")
        for corner in corners:
            if np.ptp(corner, axis=0).max() > 0.02 * width:
                ring = factor * (np.vstack([corner, corner[:1]]) - lander)
                axes.plot(*ring.T, color=COLORS[3], linewidth=0.7, alpha=0.8, label="images")
        ties = factor * (solution.registration.map_places_m - lander)
        dots = {"markersize": 2.5, "alpha": 0.7, "label": "tie points with the map"}
        axes.plot(*ties.T, ".", color=COLORS[2], **dots)
        path = {"markersize": 3, "linewidth": 1.0, "label": "middles of the images"}
        axes.plot(*(factor * (centres - lander)).T, "o-", color=COLORS[0], **path)
        axes.plot(0.0, 0.0, "+", color=COLORS[1], markersize=13, markeredgewidth=1.8, label="lander")
        total_m2, relative_m2 = solution.covariance_enu_m2[:2, :2], solution.relative_covariance_en_m2
        for covariance_m2, dashes, label in (
            (total_m2, "-", "95 % ellipse"),
            (relative_m2, ":", "the same, relative to the map"),
        ):
            style = {"edgecolor": COLORS[1], "linewidth": 1.3, "linestyle": dashes, "label": label}
            draw_ellipse(axes, (0.0, 0.0), covariance_m2, SCALE_95, factor, fill=False, **style)
        axes.set_xlim(edges[:2])
        axes.set_ylim(edges[2:])
        axes.set_xlabel(f"east of the lander ({unit})")
        if k == 0:
            axes.set_ylabel("north of the lander")
    legend_outside(figure, panels[:1], 6)
    return figure.figure


def _in_plane(frame: RegisteredFrame, halves: Sequence[Sequence[int]]) -> _Floats:
    """Places of an image in the plane, m, by how many halves of its size they are from its first pixel."""
    assert frame.homography is not None
    to_plane = np.asarray(np.linalg.inv(frame.homography.matrix), dtype=np.float64)
    return transformed(to_plane, np.array(halves, dtype=np.float64) * frame.centre)


def _apart(frames: Sequence[RegisteredFrame]) -> Iterator[RegisteredFrame]:
    """The frames that show more than those before them: nearer by a part, or of other ground; and the last."""
    drawn, middle = math.inf, np.zeros(2)
    for frame in frames:
        [here] = _in_plane(frame, [[1, 1]])
        moved = float(np.abs(here - middle).max()) > _PART * frame.pixel_m * frame.centre.max()
        if frame.pixel_m < (1.0 - _PART) * drawn or moved or frame is frames[-1]:
            drawn, middle = frame.pixel_m, here
            yield frame


def _mosaic(solution: ImageSolution, west_m: float, north_m: float, width_m: float) -> NDArray[np.uint8]:
    """The map and, over it, the images from high to low."""
    cv2 = load_opencv()
    pixel_m = width_m / _MOSAIC_PIXELS
    shape = (_MOSAIC_PIXELS, _MOSAIC_PIXELS)
    canvas, seen = solution.base.view(
        solution.registration.plane, west_m + 0.5 * pixel_m, north_m - 0.5 * pixel_m, pixel_m, shape
    )
    canvas = np.where(seen, canvas, 255).astype(np.uint8)
    to_plane = np.array(
        [[pixel_m, 0.0, west_m + 0.5 * pixel_m], [0.0, -pixel_m, north_m - 0.5 * pixel_m], [0.0, 0.0, 1.0]]
    )
    for frame in _apart(solution.registered):
        assert frame.homography is not None
        if frame.pixel_m * 2.0 * frame.centre.max() < 0.01 * width_m:
            continue  # too small to be seen
        image, usable = _undistorted(solution, frame)
        # From the canvas to the image's pixels, which are put together where the canvas is coarser.
        matrix = frame.homography.matrix @ to_plane
        reduction = max(1, int(pixel_m / frame.pixel_m))
        if reduction > 1:
            image, usable = (cv2.blur(part, (reduction, reduction)) for part in (image, usable))
        drawn = cv2.warpPerspective(image, matrix, shape, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        inside = cv2.warpPerspective(usable, matrix, shape, flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP)
        canvas = np.where(inside == 255, drawn, canvas)
    return canvas


def _undistorted(
    solution: ImageSolution, frame: RegisteredFrame
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """An image without its camera's distortion, and 255 where it shows the ground."""
    cv2 = load_opencv()
    image = read_frame(solution.paths[frame.name])
    usable = np.full(image.shape, 255, np.uint8)
    if solution.mask is not None:
        usable[~solution.mask] = 0
    if solution.camera is None:
        return image, usable
    camera = solution.camera(image.shape)
    lens = np.array(camera.distortion.coefficients)
    x, y = cv2.initUndistortRectifyMap(
        camera.matrix, lens, None, camera.matrix, image.shape[::-1], cv2.CV_32FC1
    )
    return cv2.remap(image, x, y, cv2.INTER_LINEAR), cv2.remap(usable, x, y, cv2.INTER_NEAREST)
