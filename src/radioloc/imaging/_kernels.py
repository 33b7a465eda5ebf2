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
    out = np.zeros((len(time_s), width))
    step = (times_s[-1] - times_s[0]) / (nodes - 1)
    for i in range(len(time_s)):
        index = min(max(int((time_s[i] - times_s[0]) / step), 0), nodes - 2)
        side = min(index + 1, nodes - 1 - index, 4)
        for node in range(index + 1 - side, index + 1 + side):
            weight = 1.0
            for other in range(index + 1 - side, index + 1 + side):
                if other != node:
                    weight *= (time_s[i] - times_s[other]) / (times_s[node] - times_s[other])
            for j in range(width):
                out[i, j] += weight * values[node, j]
    return out
