"""Images turned by software: as a camera without distortion sees them, and from straight above.

A homography relates pixels of two views only if neither is distorted. An image taken far from the vertical shows
craters so foreshortened that few features of a map are found in it; turned by the approximate attitude, which needs to
be good to some degrees, it looks like a map.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.imaging.cameras import Camera

Floats = NDArray[np.float64]


def undistorted(camera: Camera) -> Callable[[Floats], Floats]:
    """The function from pixels, shape (n, 2), to where the same camera without distortion has them.

    Examples
    --------
    >>> import numpy as np
    >>> from radioloc.imaging import Camera, undistorted
    >>> camera = Camera.of_pinhole(8.3, 6.7, [511.5, 511.5], [-0.1, 0.0, 0.0, 0.0, 0.0])
    >>> undistorted(camera)(np.array([[511.5, 511.5], [1000.0, 511.5]])).round(1).tolist()
    [[511.5, 511.5], [1008.0, 511.5]]
    """
    straight = camera.without_distortion()
    return lambda pixels: straight.pixels(camera.directions(pixels))[0]


def rectification(camera: Camera, down: ArrayLike) -> Floats:
    """The homography from pixels to those of the same camera looking straight down, shape (3, 3).

    Parameters
    ----------
    camera : Camera
        Its distortion is left aside: this is for finding features, not for measuring.
    down : array_like, shape (3,)
        The direction of the vertical, downward, in the camera's axes.

    Returns
    -------
    numpy.ndarray
        Pixels (sample, line, 1) times this are pixels of the view from above, times a number that is positive below
        the horizon. The camera is turned by the shortest way, so that the view is not turned about the vertical.

    Raises
    ------
    InputError
        The direction is not three finite numbers, or the camera looks up.

    Examples
    --------
    >>> import numpy as np
    >>> from radioloc.imaging import Camera, rectification
    >>> camera = Camera.of_pinhole(8.3, 6.7, [511.5, 511.5])
    >>> tilt = np.radians(40.0)
    >>> turned = rectification(camera, [0.0, np.sin(tilt), np.cos(tilt)])
    >>> nadir = turned @ [511.5, 511.5 + 8.3 / 6.7e-3 * np.tan(tilt), 1.0]  # the pixel that looks down
    >>> (nadir[:2] / nadir[2]).round(6).tolist()
    [511.5, 511.5]
    """
    vertical = np.asarray(down, dtype=np.float64)
    length = np.linalg.norm(vertical)
    if vertical.shape != (3,) or not np.isfinite(vertical).all() or length == 0.0:
        raise InputError(f"down = {down!r} is not a direction of three finite numbers")
    vertical = vertical / length
    axis = np.array([0.0, 0.0, float(camera.looks_along_z)])
    if vertical @ axis <= 0.0:
        raise InputError(f"down = {down!r} is behind the camera, which looks up or at the horizon")
    cross = np.cross(vertical, axis)
    skew = np.array([[0, -cross[2], cross[1]], [cross[2], 0, -cross[0]], [-cross[1], cross[0], 0]])
    turn = np.eye(3) + skew + skew @ skew / (1.0 + vertical @ axis)  # brings the vertical to the axis
    straight = camera.without_distortion()
    point = straight.principal_point_px
    partials = straight.directions_and_partials(point[np.newaxis])[1][0, :2]
    to_direction = np.zeros((3, 3))
    to_direction[:2, :2], to_direction[:2, 2] = partials, -partials @ point
    to_direction[2, 2] = axis[2]
    return np.asarray(np.linalg.inv(to_direction) @ turn @ to_direction)
