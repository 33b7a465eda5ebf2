"""Figures of positions by images: descent images on their map, and a point or landmarks with error ellipses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.imaging.base_map import BaseMap
from radioloc.imaging.products import in_plane, lay_over, pose_table, track_deg
from radioloc.imaging.solution import ImageSolution, PointSolution
from radioloc.imaging.stereo_points import StereoPoints
from radioloc.report.figures import (
    COLORS,
    SCALE_95,
    draw_ellipse,
    draw_square,
    draws_names_literally,
    legend_outside,
    length_unit,
    one_panel,
    several_panels,
    style_axes,
)
from radioloc.report.position_figures import draw_place
from radioloc.results.tables import difference
from radioloc.vectors import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MAX_PANEL_COUNT = 3
_MOSAIC_PIXELS = 700
_MIN_SIGMA_PART = 1e-2  # of a source of error that is drawn


@draws_names_literally
def plot_images(solution: ImageSolution, ax: Axes | None = None) -> Figure:
    """Draw the mosaic of the images on the map, from the ground of the highest image to the lander.

    Parameters
    ----------
    solution : ImageSolution
    ax : matplotlib.axes.Axes, optional
        Axes of a grid to be replaced by the panels; without it a new figure is made.

    Returns
    -------
    matplotlib.figure.Figure
        Up to three panels, each a closer look by two or more: the map with the images laid over it, their outlines, tie
        points with the map and their residuals, the path of the middles, the ground track of the camera, and the lander
        with its 95 % ellipse.

    Examples
    --------
    >>> from radioloc.imaging import locate_images, plot_images
    >>> len(plot_images(locate_images("examples/images/descent.toml")).axes)
    3
    """
    frames = solution.registered
    plane = solution.registration.plane
    longitude, latitude, _ = solution.position.selenographic
    lander = plane.from_longitude_latitude([[longitude, latitude]])[0]
    corners = [in_plane(frame, [[0, 0], [2, 0], [2, 2], [0, 2]]) for frame in frames]
    widest, closest = (float(np.ptp(c, axis=0).max()) for c in (corners[0], corners[-1]))
    count = int(np.clip(1.0 + np.log2(widest / (3.0 * closest)), 1, _MAX_PANEL_COUNT))
    widths = np.geomspace(widest, 3.0 * closest, count) if count > 1 else np.array([widest])
    title = f"{solution.name}: {len(frames)} images on {solution.map_name}"
    figure = several_panels(ax, max(1.0 + 4.0 * count, 7.0), 4.9 if count > 1 else 7.0, title)
    panels = figure.subplots(1, count, squeeze=False)[0]
    rms_m = float(np.sqrt((solution.registration.map_residuals_m**2).sum(axis=1).mean()))
    centres = np.concatenate([in_plane(frame, [[1, 1]]) for frame in frames])
    track = plane.from_longitude_latitude(track_deg(pose_table(solution)))
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
        ties = solution.registration.map_places_m - lander
        shown = (np.abs(ties - [west + 0.5 * width, north - 0.5 * width]) < 0.6 * width).all(axis=1)
        ties, residuals_m = factor * ties[shown], solution.registration.map_residuals_m[shown]
        dots = {"markersize": 2.5, "alpha": 0.7, "label": "tie points on the map"}
        axes.plot(*ties.T, ".", color=COLORS[2], **dots)
        vectors = residuals_m * (0.04 * width * factor / rms_m)
        style: Any = {"color": COLORS[5], "alpha": 0.8, "label": f"their residuals, rms {rms_m:.2g} m"}
        axes.quiver(*ties.T, *vectors.T, angles="xy", scale_units="xy", scale=1.0, width=0.0025, **style)
        path = {"markersize": 3, "linewidth": 1.0, "label": "middles of images"}
        axes.plot(*(factor * (centres - lander)).T, "o-", color=COLORS[0], **path)
        if len(track):
            line = {"linewidth": 1.0, "label": "camera"}
            axes.plot(*(factor * (track - lander)).T, ".--", color=COLORS[4], markersize=3, **line)
        axes.plot(0.0, 0.0, "+", color=COLORS[1], markersize=13, markeredgewidth=1.8, label="lander")
        total_m2, relative_m2 = solution.covariance_enu_m2[:2, :2], solution.relative_covariance_en_m2
        for covariance_m2, dashes, label in (
            (total_m2, "-", "95 % ellipse"),
            (relative_m2, ":", "95 % ellipse relative to the map"),
        ):
            style = {"edgecolor": COLORS[1], "linewidth": 1.3, "linestyle": dashes, "label": label}
            draw_ellipse(axes, (0.0, 0.0), covariance_m2, SCALE_95, factor, fill=False, **style)
        axes.set_xlim(edges[:2])
        axes.set_ylim(edges[2:])
        axes.set_xlabel(f"east of the lander ({unit})")
        if k == 0:
            axes.set_ylabel("north of the lander")
    legend_outside(figure, panels[:1], 3 * count)
    return figure.figure


def _mosaic(solution: ImageSolution, west_m: float, north_m: float, width_m: float) -> NDArray[np.uint8]:
    """Draw the images from high to low over the map."""
    from radioloc.lunar.map_grid import MapGrid, load_rasterio

    rasterio = load_rasterio()
    plane, pixel_m = solution.registration.plane, width_m / _MOSAIC_PIXELS
    crs = rasterio.crs.CRS.from_string(
        f"+proj=ortho +lat_0={plane.latitude_deg!r} +lon_0={plane.longitude_deg!r} +R={MEAN_LUNAR_RADIUS_M!r}"
    )
    corner = rasterio.Affine(pixel_m, 0.0, west_m, 0.0, -pixel_m, north_m)
    grid = MapGrid.of_map(crs, corner, _MOSAIC_PIXELS, _MOSAIC_PIXELS, MEAN_LUNAR_RADIUS_M)
    canvas, valid = solution.base.on_grid(grid)
    lay_over(canvas, valid, solution, grid)
    return np.where(valid, canvas, 255)


@draws_names_literally
def plot_point(solution: PointSolution, ax: Axes | None = None) -> Figure:
    """Draw the 95 % ellipses of a position by source of error, and the landmarks of stereo images.

    Parameters
    ----------
    solution : PointSolution
    ax : matplotlib.axes.Axes, optional
        Axes of a grid to be replaced by the panels; without it a new figure is made.

    Returns
    -------
    matplotlib.figure.Figure
        One panel about the position; of stereo images one more, with the landmarks, circles about them at the distances
        measured, and the ellipse relative to the map.

    Examples
    --------
    >>> from radioloc.imaging import locate_images, plot_point
    >>> len(plot_point(locate_images("examples/stereo/stereo.toml")).axes)
    2
    """
    stereo = solution.landmarks_en_m is not None
    figure = several_panels(ax, 10.0 if stereo else 5.2, 5.6, f"{solution.name}: position")
    panels = figure.subplots(1, 1 + stereo, squeeze=False)[0]
    if stereo:
        _draw_landmarks(panels[0], solution)
    _draw_sources(panels[-1], solution)
    legend_outside(figure, panels, 6 if stereo else 3)
    return figure.figure


def _draw_sources(axes: Axes, solution: PointSolution) -> None:
    total_m2 = solution.covariance_enu_m2[:2, :2]
    parts = {source.name: source.covariance_enu_m2[:2, :2] for source in solution.sources}
    shown = {
        name: part for name, part in parts.items() if part.trace() > _MIN_SIGMA_PART**2 * total_m2.trace()
    }
    factor = _draw_about(axes, solution, 1.15 * SCALE_95 * float(np.sqrt(np.diag(total_m2).max())))
    for color, (name, part) in zip(COLORS[1:], shown.items(), strict=False):
        style = {"edgecolor": color, "linewidth": 1.4, "label": name}
        draw_ellipse(axes, (0.0, 0.0), part, SCALE_95, factor, fill=False, **style)
    style = {"edgecolor": "0.1", "linestyle": "--", "label": "all"}
    draw_ellipse(axes, (0.0, 0.0), total_m2, SCALE_95, factor, fill=False, **style)
    axes.set_title("ellipses of 95 %, by source", fontsize=8, color="0.3")


def _draw_landmarks(axes: Axes, solution: PointSolution) -> None:
    from matplotlib.patches import Circle

    assert solution.landmarks_en_m is not None
    assert solution.distances_m is not None
    factor = _draw_about(axes, solution, 1.2 * float(np.abs(solution.landmarks_en_m).max()))
    names = [landmark["name"] for landmark in solution.details["landmarks"]]
    measured = zip(names, factor * solution.landmarks_en_m, factor * solution.distances_m, strict=True)
    for k, (name, place, distance) in enumerate(measured):
        color = COLORS[1 + k % (len(COLORS) - 1)]
        label = "distances measured" if k == 0 else None
        axes.add_patch(Circle(place, distance, fill=False, edgecolor=color, lw=0.8, label=label))
        axes.plot(*place, "^", color=color, markersize=6)
        axes.annotate(name, place, xytext=(5, 5), textcoords="offset points", fontsize=8)
    relative = [source.covariance_enu_m2[:2, :2] for source in solution.sources if not source.shared]
    style = {"facecolor": (COLORS[0], 0.3), "edgecolor": COLORS[0], "label": "95 %, relative to the map"}
    draw_ellipse(axes, (0.0, 0.0), np.sum(relative, axis=0), SCALE_95, factor, linewidth=0.9, **style)
    axes.set_title("landmarks", fontsize=8, color="0.3")


def _draw_about(axes: Axes, solution: PointSolution, reach_m: float) -> float:
    """Draw a square about the position with references inside it, and return the factor from metres to its unit."""
    factor = draw_square(axes, (0.0, 0.0), reach_m, "the position")
    draw_place(axes, factor, np.zeros(2), "position", solution.method, 0)
    for k, (name, place) in enumerate(solution.references.items()):
        _, _, east_m, north_m, _ = difference(place.selenographic, solution.position.selenographic)
        if max(abs(east_m), abs(north_m)) < reach_m:
            draw_place(axes, factor, np.array([east_m, north_m]), name, "reference", k)
    return factor


@draws_names_literally
def plot_base_map(result: BaseMap, ax: Axes | None = None) -> Figure:
    """Draw the mosaic of a base map, and the residuals of its tie points.

    Parameters
    ----------
    result : BaseMap
    ax : matplotlib.axes.Axes, optional
        Axes of a grid to be replaced by the panels; without it a new figure is made.

    Returns
    -------
    matplotlib.figure.Figure
        The mosaic, and the residuals as vectors, with the number of the image at the middle of its tie points.

    Examples
    --------
    >>> from radioloc.imaging import plot_base_map
    >>> plot_base_map(result)  # doctest: +SKIP
    """
    from radioloc.lunar.map_files import open_dataset

    with open_dataset(result.mosaic) as file:
        reduction = max(1, max(file.shape) // (2 * _MOSAIC_PIXELS))
        mosaic = file.read(1, out_shape=(file.height // reduction, file.width // reduction), masked=True)
        west, south, east, north = file.bounds
        crs = file.crs
    figure = several_panels(ax, 12.0, 6.8, f"{result.name}: {len(result.images)} images")
    map_axes, residual_axes = figure.subplots(1, 2)
    factor, unit = length_unit(max(east - west, north - south))
    extent = [0.0, factor * (east - west), 0.0, factor * (north - south)]
    low, high = np.percentile(mosaic.compressed(), [0.5, 99.5])
    map_axes.imshow(mosaic, extent=extent, cmap="gray", vmin=low, vmax=high)
    places = factor * (_on_map(crs, result.adjustment.ground_m) - [west, south])
    used = result.adjustment.used[result.ties.point]
    residuals_m = result.adjustment.residuals_m[used]
    residual_axes.quiver(*places[used].T, *residuals_m.T, color=COLORS[0], angles="xy", width=0.0015)
    for k in range(len(result.images)):
        of_image = places[result.ties.image == k]
        if len(of_image):
            residual_axes.annotate(
                str(k + 1), of_image.mean(axis=0), color=COLORS[1], ha="center", weight="bold"
            )
    rms_m = float(np.sqrt(np.mean(residuals_m**2))) if len(residuals_m) else 0.0
    for axes, title in ((map_axes, "mosaic"), (residual_axes, f"residuals of tie points, rms {rms_m:.2g} m")):
        style_axes(axes)
        axes.grid(visible=False)
        axes.set_title(title)
        axes.set_aspect("equal")
        axes.set_xlim(extent[:2])
        axes.set_ylim(extent[2:])
        axes.set_xlabel(f"x of the map ({unit})")
    map_axes.set_ylabel(f"y of the map ({unit})")
    return figure.figure


def _on_map(crs: Any, points_m: Floats) -> Floats:
    """Return the coordinates of points on a map."""
    from rasterio.warp import transform

    from radioloc.lunar import cartesian_to_selenographic

    longitude, latitude, _ = cartesian_to_selenographic(points_m)
    geographic = f"+proj=longlat +R={MEAN_LUNAR_RADIUS_M!r} +no_defs"
    return np.column_stack(transform(geographic, crs, np.degrees(longitude), np.degrees(latitude)))


@draws_names_literally
def plot_stereo(result: StereoPoints, ax: Axes | None = None) -> Figure:
    """Draw the points of a stereo pair from above, with the chosen features and their distances.

    Parameters
    ----------
    result : StereoPoints
    ax : matplotlib.axes.Axes, optional
        Axes to draw in, in place of a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        Points by their coordinates to the right and ahead, coloured by height, with the features.

    Examples
    --------
    >>> from radioloc.imaging import plot_stereo
    >>> plot_stereo(result)  # doctest: +SKIP
    """
    axes = one_panel(ax, 7.0, 7.0, f"{result.name}: {len(result.grey)} points")
    style_axes(axes)
    ahead, right, down = result.cloud_m.T
    low, high = np.percentile(-down, [1.0, 99.0]) if len(down) else (0.0, 1.0)
    dots = axes.scatter(
        right, ahead, c=-down, vmin=low, vmax=high, s=2.0, linewidths=0.0, cmap="viridis", rasterized=True
    )
    axes.figure.colorbar(dots, ax=axes, label="height (m)", shrink=0.8)
    for name, position in zip(result.features, result.feature_m, strict=True):
        axes.plot(position[1], position[0], "+", color=COLORS[1], markersize=11, markeredgewidth=1.8)
        axes.annotate(name, position[[1, 0]], xytext=(6, 6), textcoords="offset points", color=COLORS[1])
    for row in result.distances():
        ends = result.feature_m[[result.features.index(name) for name in row["features"]]][:, [1, 0]]
        axes.plot(*ends.T, color=COLORS[1], linewidth=0.8)
        box = {"facecolor": "white", "alpha": 0.8, "linewidth": 0.0, "pad": 1.0}
        axes.annotate(f"{row['distance_m']:.2f} m", ends.mean(axis=0), fontsize=8, ha="center", bbox=box)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("right (m)")
    axes.set_ylabel("ahead (m)")
    return axes.figure.figure
