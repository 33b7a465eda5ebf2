"""Compiled operations on vectors of three components, component by component.

Array expressions give the same numbers, but take the compiler many times as long.
"""

import math

import numpy as np

from radioloc.compiled import compiled
from radioloc.vectors import Floats


@compiled()
def dot(a: Floats, b: Floats) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled()
def minus(a: Floats, b: Floats) -> Floats:
    out = np.empty(3)
    for i in range(3):
        out[i] = a[i] - b[i]
    return out


@compiled()
def add(out: Floats, factor: float, a: Floats) -> None:
    """Add a multiple of a vector to another."""
    for i in range(3):
        out[i] += factor * a[i]


@compiled(error_model="numpy")
def unit(a: Floats) -> Floats:
    """Return the unit vector along a vector; NaN for a zero vector."""
    length = math.sqrt(dot(a, a))
    out = np.empty(3)
    for i in range(3):
        out[i] = a[i] / length
    return out


@compiled()
def cross(a: Floats, b: Floats) -> Floats:
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


@compiled()
def times(matrix: Floats, a: Floats) -> Floats:
    out = np.empty(3)
    for i in range(3):
        out[i] = dot(matrix[i], a)
    return out


@compiled()
def put(out: Floats, values: Floats) -> None:
    """Copy values into an array."""
    for i in range(len(values)):
        out[i] = values[i]
