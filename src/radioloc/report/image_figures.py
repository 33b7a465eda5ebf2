"""Descent images drawn on their map: the mosaic, tie points, the path of the images' centres, and the lander."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from radioloc.imaging import read_frame
from radioloc.imaging.frames import load_opencv
from radioloc.imaging.homography import transformed
from radioloc.imaging.registration import RegisteredFrame
from radioloc.report.figures import COLORS, SCALE_95, draw_ellipse, length_unit, several_panels, style_axes
from radioloc.report.image_solution import ImageSolution

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

_PANELS = 3
_PART = 0.15  # of an image
_PIXELS = 700


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
    >>> solution = radioloc.locate_images(radioloc.studies.read_image_study("examples/images/descent.toml"))
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
                axes.plot(*ring.T, color=COLORS[3], linewidth=0.7, alpha=0.8)
        ties = factor * (solution.registration.map_places_m - lander)
        axes.plot(*ties.T, ".", color=COLORS[2], markersize=2.5, alpha=0.7)
        axes.plot(*(factor * (centres - lander)).T, "o-", color=COLORS[0], markersize=3, linewidth=1.0)
        total_m2, relative_m2 = solution.covariance_enu_m2[:2, :2], solution.relative_covariance_en_m2
        for covariance_m2, dashes in ((total_m2, "-"), (relative_m2, ":")):
            style = {"fill": False, "edgecolor": COLORS[1], "linewidth": 1.3, "linestyle": dashes}
            draw_ellipse(axes, (0.0, 0.0), covariance_m2, SCALE_95, factor, **style)
        axes.plot(0.0, 0.0, "+", color=COLORS[1], markersize=13, markeredgewidth=1.8)
        axes.set_xlim(edges[:2])
        axes.set_ylim(edges[2:])
        axes.set_xlabel(f"east of the lander ({unit})")
        if k == 0:
            axes.set_ylabel("north of the lander")
    handles = [
        panels[0].plot([], [], color=COLORS[color], marker=marker, linestyle=line, label=label)[0]
        for marker, color, line, label in (
            ("", 3, "-", "images"),
            (".", 2, "", "tie points with the map"),
            ("o", 0, "-", "middles of the images"),
            ("+", 1, "", "lander"),
            ("", 1, "-", "95 % ellipse"),
            ("", 1, ":", "the same, relative to the map"),
        )
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=6, fontsize=8, frameon=False)
    return figure.figure


def _in_plane(frame: RegisteredFrame, halves: Sequence[Sequence[int]]) -> Floats:
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
    pixel_m = width_m / _PIXELS
    shape = (_PIXELS, _PIXELS)
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
    matrix = np.eye(3)
    matrix[:2, :2], matrix[:2, 2] = camera.focal_length_mm * camera.pixel_per_mm, camera.principal_point_px
    lens = np.array(camera.distortion.coefficients)
    x, y = cv2.initUndistortRectifyMap(matrix, lens, None, matrix, image.shape[::-1], cv2.CV_32FC1)
    return cv2.remap(image, x, y, cv2.INTER_LINEAR), cv2.remap(usable, x, y, cv2.INTER_NEAREST)
