"""Compiled loops of exterior orientation."""

import numpy as np
from numpy.typing import NDArray

from radioloc.compiled import compiled

Floats = NDArray[np.float64]


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
