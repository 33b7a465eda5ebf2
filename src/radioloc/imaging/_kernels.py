"""Compiled loops: interpolation of exterior orientation, and rectification of images."""

import math
from typing import Any

import numpy as np

from radioloc.compiled import compiled
from radioloc.vectors import Floats


@compiled()
def lagrange(times_s: Floats, values: Floats, time_s: Floats) -> Floats:
    """Interpolate values, (k, m), at times, (n,), by Lagrange polynomials through up to four nodes to each side."""
    nodes, width = values.shape
    # 1 / product of the nodes' differences, for the nodes of each interval
    scale = np.ones((nodes - 1, 8))
    for index in range(nodes - 1):
        side = min(index + 1, nodes - 1 - index, 4)
        first = index + 1 - side
        for k in range(2 * side):
            for m in range(2 * side):
                if m != k:
                    scale[index, k] /= times_s[first + k] - times_s[first + m]
    out = np.zeros((len(time_s), width))
    step = (times_s[-1] - times_s[0]) / (nodes - 1)
    upper = np.empty(9)
    for i in range(len(time_s)):
        index = min(max(int((time_s[i] - times_s[0]) / step), 0), nodes - 2)
        side = min(index + 1, nodes - 1 - index, 4)
        first = index + 1 - side
        # products of the distances to the later nodes, then to the earlier nodes
        upper[2 * side] = 1.0
        for k in range(2 * side - 1, -1, -1):
            upper[k] = upper[k + 1] * (time_s[i] - times_s[first + k])
        lower = 1.0
        for k in range(2 * side):
            weight = lower * upper[k + 1] * scale[index, k]
            lower *= time_s[i] - times_s[first + k]
            for j in range(width):
                out[i, j] += weight * values[first + k, j]
    return out


@compiled()
def resampled(
    nodes: Floats,
    step: int,
    shown: Any,
    out: Any,
    image: Any,
    usable: Any,
    reduction: int,
    limits: tuple[float, float],
) -> None:
    """Set `out` to the image at the cells that are shown, and clear `shown` where no pixel is usable.

    Pixels of cells are interpolated between nodes, (rows, columns, 2), a number of cells apart. The image has pixels,
    repeated at its edges, or means of square blocks of them, extrapolated by one. With finite limits, values are whole.
    """
    size, blocks = np.array(usable.shape), np.array(image.shape)
    margin = 0.0 if reduction == 1 else 1.0
    place, first, part = np.empty(2), np.empty(2, np.int64), np.empty(2)
    for row in range(shown.shape[0]):
        i, u = row // step, (row % step) / step
        next_row = min(i + 1, nodes.shape[0] - 1)
        j, offset = 0, -1
        for column in range(shown.shape[1]):
            offset += 1
            if offset == step:
                j, offset = j + 1, 0
            if not shown[row, column]:
                continue
            v, next_column = offset / step, min(j + 1, nodes.shape[1] - 1)
            for k in range(2):
                upper = (1.0 - v) * nodes[i, j, 1 - k] + v * nodes[i, next_column, 1 - k]
                lower = (1.0 - v) * nodes[next_row, j, 1 - k] + v * nodes[next_row, next_column, 1 - k]
                place[k] = (1.0 - u) * upper + u * lower
            y, x = math.floor(place[0] + 0.5), math.floor(place[1] + 0.5)
            shown[row, column] = 0 <= y < size[0] and 0 <= x < size[1] and usable[int(y), int(x)]
            if not shown[row, column]:
                continue
            for k in range(2):
                block = (place[k] + 0.5) / reduction - 0.5
                first[k] = max(min(int(block), blocks[k] - 2), 0)
                part[k] = min(max(block - first[k], -margin), 1.0 + margin)
            i_y, i_x = first[0], first[1]
            next_y, next_x = min(i_y + 1, blocks[0] - 1), min(i_x + 1, blocks[1] - 1)
            value = (1.0 - part[0]) * ((1.0 - part[1]) * image[i_y, i_x] + part[1] * image[i_y, next_x])
            value += part[0] * ((1.0 - part[1]) * image[next_y, i_x] + part[1] * image[next_y, next_x])
            out[row, column] = (
                value if np.isinf(limits[0]) else min(max(np.rint(value), limits[0]), limits[1])
            )
