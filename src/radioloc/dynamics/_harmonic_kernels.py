"""Compiled sums of spherical harmonics.

A solid harmonic is (R/r)^(n+1) P_nm(z/r) exp(i m lambda), fully normalized. It is split into h_nm (u + i v)^m with
u + i v = (x + i y)/r, so that h_nm and all sums are regular at the poles (Pines 1973, AIAA J. 11, 1508). h_nm follows
from the two degrees below by the recursion for columns of one order, which is stable (Holmes and Featherstone 2002, J.
Geodesy 76, 279). The inner loops run over the order, so that the compiler can use vector instructions.
"""

import math

import numpy as np
from numpy.typing import NDArray

from radioloc.compiled import compiled
from radioloc.dynamics._vector_kernels import put
from radioloc.vectors import Floats

NEGLIGIBLE = 1e-18
"""Power of R/r below which degrees are neglected."""


@compiled()
def harmonic_sums(x: float, y: float, z: float, radius: float, series: Floats, recursion: Floats) -> Floats:
    """Sum several series of solid harmonics at one point, shape (k,)."""
    # `series`, (n_degrees, 2 k, n_degrees), by degree, series and order: factors of all cosines, then of all sines.
    # `recursion` is that of `gravity.recursion`, or a larger one; the point and the reference radius have one unit.
    n_sums = series.shape[1]
    r2 = x * x + y * y + z * z
    r = math.sqrt(r2)
    n_degrees = series.shape[0]
    if r > 1.1 * radius:  # high degrees are below rounding
        n_degrees = min(n_degrees, 3 + int(-math.log(NEGLIGIBLE) / math.log(r / radius)))
    ratio, z_ratio, square = radius / r, z * radius / r2, radius * radius / r2
    # Rows of the present degree and of the preceding one.
    h, preceding = np.zeros(n_degrees), np.zeros(n_degrees)
    sums = np.zeros((n_sums, n_degrees))
    h[0] = ratio
    for k in range(n_sums):
        sums[k, 0] = series[0, k, 0] * ratio
    for n in range(1, n_degrees):
        a, b = recursion[0, n], recursion[1, n]
        for m in range(n):
            preceding[m] = a[m] * z_ratio * h[m] - b[m] * square * preceding[m]
        preceding[n] = a[n] * ratio * h[n - 1]
        h, preceding = preceding, h
        for k in range(n_sums):
            factors, total = series[n, k], sums[k]
            for m in range(n + 1):
                total[m] += factors[m] * h[m]
    k_series = n_sums // 2
    result = np.zeros(k_series)
    u, v = x / r, y / r
    cosine, sine = 1.0, 0.0
    for m in range(n_degrees):
        for k in range(k_series):
            result[k] += sums[k, m] * cosine + sums[k_series + k, m] * sine
        cosine, sine = cosine * u - sine * v, cosine * v + sine * u
    return result


@compiled()
def harmonic_sums_at(points: Floats, radius: float, series: Floats, recursion: Floats) -> Floats:
    """Evaluate :func:`harmonic_sums` at points of shape (n, 3); shape (n, k)."""
    out = np.empty((len(points), series.shape[1] // 2))
    for i in range(len(points)):
        put(out[i], harmonic_sums(points[i, 0], points[i, 1], points[i, 2], radius, series, recursion))
    return out


@compiled()
def harmonics_at(points: Floats, radius: float, recursion: Floats, out: NDArray[np.float32]) -> None:
    """Fill rows with solid harmonics at points, shape (n, 3): all cosines degree by degree, then all sines."""
    size = recursion.shape[1]
    h, preceding, cosines, sines = np.zeros((4, size))
    for i in range(len(points)):
        x, y, z = points[i]
        r2 = x * x + y * y + z * z
        r = math.sqrt(r2)
        ratio, z_ratio, square = radius / r, z * radius / r2, radius * radius / r2
        cosines[0], sines[0] = 1.0, 0.0
        for m in range(1, size):
            cosines[m] = (cosines[m - 1] * x - sines[m - 1] * y) / r
            sines[m] = (cosines[m - 1] * y + sines[m - 1] * x) / r
        preceding[:] = 0.0
        h[0] = ratio
        for n in range(size):
            if n > 0:
                a, b = recursion[0, n], recursion[1, n]
                for m in range(n):
                    preceding[m] = a[m] * z_ratio * h[m] - b[m] * square * preceding[m]
                preceding[n] = a[n] * ratio * h[n - 1]
                h, preceding = preceding, h
            first = n * (n + 1) // 2
            of_cosines, of_sines = out[i, first:], out[i, out.shape[1] // 2 + first :]
            for m in range(n + 1):
                of_cosines[m] = h[m] * cosines[m]
                of_sines[m] = h[m] * sines[m]
