"""Compiled loops: interpolation of exterior orientation, and the images' adjustment.

The adjustment eliminates places from the normal equations one by one. Its observations of pixels are sorted by their
points, and those of a point by their images: `first` says where each point's begin, and ends with how many there are.
"""

import numpy as np
from numpy.typing import NDArray

from radioloc.compiled import compiled

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


@compiled()
def lagrange(times_s: Floats, values: Floats, time_s: Floats) -> Floats:
    """Lagrange polynomials through up to four nodes on each side of the interval, fewer near the table's ends.

    Nodes at rising times, shape (k,), with values, shape (k, m); at times between the first and last, shape (n,):
    shape (n, m).
    """
    nodes, width = values.shape
    # 1 / product of the nodes' differences, for the nodes of each interval
    scale = np.ones((nodes - 1, 8))
    for index in range(nodes - 1):
        side = min(index + 1, nodes - 1 - index, 4)
        first = index + 1 - side
        for k in range(2 * side):
            for other in range(2 * side):
                if other != k:
                    scale[index, k] /= times_s[first + k] - times_s[first + other]
    out = np.zeros((len(time_s), width))
    step = (times_s[-1] - times_s[0]) / (nodes - 1)
    behind = np.empty(9)
    for i in range(len(time_s)):
        index = min(max(int((time_s[i] - times_s[0]) / step), 0), nodes - 2)
        side = min(index + 1, nodes - 1 - index, 4)
        first = index + 1 - side
        # products of the distances to the nodes behind each, then before each
        behind[2 * side] = 1.0
        for k in range(2 * side - 1, -1, -1):
            behind[k] = behind[k + 1] * (time_s[i] - times_s[first + k])
        before = 1.0
        for k in range(2 * side):
            weight = before * behind[k + 1] * scale[index, k]
            before *= time_s[i] - times_s[first + k]
            for j in range(width):
                out[i, j] += weight * values[first + k, j]
    return out


@compiled()
def eliminate(
    first: Indices,
    image: Indices,
    by_image: Floats,
    by_place: Floats,
    residual: Floats,
    map_weight: Floats,
    map_right: Floats,
    reduced: Floats,
    right: Floats,
    coupling: Floats,
    inverse: Floats,
    of_places: Floats,
) -> bool:
    """Fill in the normal equations of the images, and what takes back from them to the places.

    Given are weighted partials by parameters (n, 2, 8) and places (n, 2, 2), weighted residuals (n, 2), and the
    places' information (points,) and right side (points, 2) from the map. Filled in are the lower triangle of S and
    its right side, W^T of each observation (n, 2, 8), V^-1 (points, 2, 2) and the places' right side (points, 2).
    Nothing moves a point of which nothing is used. Whether each of the other places is determined.
    """
    eliminated = np.empty((len(image), 2, 8))
    for j in range(len(first) - 1):
        begin, end = first[j], first[j + 1]
        a, b, c = map_weight[j], 0.0, map_weight[j]
        e, f = map_right[j, 0], map_right[j, 1]
        for k in range(begin, end):
            for r in range(2):
                x, y = by_place[k, r, 0], by_place[k, r, 1]
                a += x * x
                b += x * y
                c += y * y
                e += x * residual[k, r]
                f += y * residual[k, r]
        if begin == end and a == 0.0:
            a = c = 1.0
        determinant = a * c - b * b
        if not determinant > 0.0:
            return False
        inverse[j, 0, 0], inverse[j, 1, 1] = c / determinant, a / determinant
        inverse[j, 0, 1] = inverse[j, 1, 0] = -b / determinant
        of_places[j, 0], of_places[j, 1] = e, f
        for k in range(begin, end):
            at = 8 * image[k]
            for p in range(8):
                u = by_place[k, 0, 0] * by_image[k, 0, p] + by_place[k, 1, 0] * by_image[k, 1, p]
                v = by_place[k, 0, 1] * by_image[k, 0, p] + by_place[k, 1, 1] * by_image[k, 1, p]
                coupling[k, 0, p], coupling[k, 1, p] = u, v
                s, t = (
                    inverse[j, 0, 0] * u + inverse[j, 0, 1] * v,
                    inverse[j, 1, 0] * u + inverse[j, 1, 1] * v,
                )
                eliminated[k, 0, p], eliminated[k, 1, p] = s, t
                own = by_image[k, 0, p] * residual[k, 0] + by_image[k, 1, p] * residual[k, 1]
                right[at + p] += own - s * e - t * f
                for q in range(8):
                    reduced[at + p, at + q] += (
                        by_image[k, 0, p] * by_image[k, 0, q] + by_image[k, 1, p] * by_image[k, 1, q]
                    )
        for k in range(begin, end):
            for m in range(begin, end):
                if image[m] <= image[k]:
                    for p in range(8):
                        s, t = eliminated[k, 0, p], eliminated[k, 1, p]
                        for q in range(8):
                            reduced[8 * image[k] + p, 8 * image[m] + q] -= (
                                s * coupling[m, 0, q] + t * coupling[m, 1, q]
                            )
    return True


@compiled()
def places_moved(
    first: Indices, image: Indices, coupling: Floats, inverse: Floats, of_places: Floats, step: Floats
) -> Floats:
    """Corrections of the places, shape (points, 2), that belong to those of all images."""
    moved = np.empty((len(first) - 1, 2))
    for j in range(len(moved)):
        x, y = of_places[j, 0], of_places[j, 1]
        for k in range(first[j], first[j + 1]):
            for p in range(8):
                x -= coupling[k, 0, p] * step[8 * image[k] + p]
                y -= coupling[k, 1, p] * step[8 * image[k] + p]
        moved[j, 0] = inverse[j, 0, 0] * x + inverse[j, 0, 1] * y
        moved[j, 1] = inverse[j, 1, 0] * x + inverse[j, 1, 1] * y
    return moved


@compiled()
def explained_on_map(
    first: Indices, image: Indices, coupling: Floats, inverse: Floats, map_weight: Floats, covariance: Floats
) -> float:
    """Sum of the variances of all places, each V^-1 + V^-1 W^T C W V^-1, times what they weigh on the map."""
    total = 0.0
    for j in range(len(first) - 1):
        if map_weight[j] == 0.0:
            continue
        a = b = c = 0.0
        for k in range(first[j], first[j + 1]):
            for m in range(first[j], first[j + 1]):
                for p in range(8):
                    s = t = 0.0
                    for q in range(8):
                        element = covariance[8 * image[k] + p, 8 * image[m] + q]
                        s += element * coupling[m, 0, q]
                        t += element * coupling[m, 1, q]
                    a += coupling[k, 0, p] * s
                    b += coupling[k, 0, p] * t
                    c += coupling[k, 1, p] * t
        x, y, z = inverse[j, 0, 0], inverse[j, 0, 1], inverse[j, 1, 1]
        variance = x + z + (x * x + y * y) * a + 2.0 * y * (x + z) * b + (y * y + z * z) * c
        total += map_weight[j] * variance
    return total
