"""The third of the Vienna mapping functions, VMF3 (Landskron and Boehm 2018).

Its coefficients a come every six hours from ray tracing through weather models, in the files that
:mod:`radioloc.media.vmf3_files` reads, or from the climatology :mod:`radioloc.media.gpt3`. Its b and c are a fit
to ten years of such rays, spherical harmonics of degree and order 12 with annual and semiannual terms, and are
packaged with the library.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.media.checks import within
from radioloc.media.mapping_functions import MappingFactors, mapping_factors

_DEGREE = 12
_TERMS = (_DEGREE + 1) * (_DEGREE + 2) // 2
_COEFFICIENTS = ("bh", "bw", "ch", "cw")
_A_RANGES = {"hydrostatic": (1e-4, 2e-3), "wet": (5e-5, 2e-3)}
_YEAR_DAYS = 365.25


def vmf3(
    elevation_rad: ArrayLike,
    hydrostatic_a: ArrayLike,
    wet_a: ArrayLike,
    latitude_rad: ArrayLike,
    longitude_rad: ArrayLike,
    day_of_year: ArrayLike,
    height_above_a_m: ArrayLike,
) -> MappingFactors:
    """Mapping functions VMF3 from their coefficients a.

    Parameters
    ----------
    elevation_rad : array_like
        Elevation without refraction, rad, at least 3 degrees.
    hydrostatic_a, wet_a : array_like
        Coefficients a, near 1.2e-3 and 5e-4.
    latitude_rad, longitude_rad : array_like
        Geodetic latitude and east longitude, rad.
    day_of_year : array_like
        Day of the year, 1 at 0h on 1 January, as :func:`radioloc.media.mapping_functions.day_of_year` gives it.
    height_above_a_m : array_like
        Height of the station above that for which `hydrostatic_a` was given, m: nought with a file of sites, whose
        coefficients hold at the station; the station's height above the ellipsoid with grids and GPT3, whose
        coefficients hold on the ellipsoid.

    Returns
    -------
    MappingFactors
        Arrays of the shape to which the arguments broadcast.

    Raises
    ------
    InputError
        A quantity is outside of what the model covers, or not finite.

    Notes
    -----
    Landskron and Boehm (2018); the height correction is that of Niell (1996).
    """
    a_h = _a_within("hydrostatic", hydrostatic_a)
    a_w = _a_within("wet", wet_a)
    b_h, b_w, c_h, c_w = vmf3_bc(latitude_rad, longitude_rad, day_of_year)
    return mapping_factors(elevation_rad, height_above_a_m, (a_h, b_h, c_h), (a_w, b_w, c_w))


def vmf3_bc(
    latitude_rad: ArrayLike, longitude_rad: ArrayLike, day_of_year: ArrayLike
) -> tuple[NDArray[np.float64], ...]:
    """Coefficients b hydrostatic, b wet, c hydrostatic, c wet of VMF3, each of the arguments' common shape.

    Parameters
    ----------
    latitude_rad, longitude_rad : array_like
        Geodetic latitude and east longitude, rad.
    day_of_year : array_like
        Day of the year, 1 at 0h on 1 January.

    Raises
    ------
    InputError
        A quantity is outside of what can be, or not finite.
    """
    latitude, longitude, day = np.broadcast_arrays(
        within("latitude", latitude_rad, "VMF3"),
        within("longitude", longitude_rad, "VMF3"),
        within("day of year", day_of_year, "VMF3"),
    )
    harmonics = _solid_harmonics(latitude, longitude)
    year = 2.0 * np.pi * day / _YEAR_DAYS
    seasons = np.stack(
        [np.ones_like(year), np.cos(year), np.sin(year), np.cos(2.0 * year), np.sin(2.0 * year)], axis=-1
    )
    values = np.einsum("...k,ckp,...p->c...", harmonics, _harmonic_coefficients(), seasons, optimize=True)
    return tuple(values)


def _a_within(part: str, values: ArrayLike) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    least, most = _A_RANGES[part]
    inside = (array >= least) & (array <= most)
    if not inside.all():
        wrong = np.ravel(array)[np.argmin(np.ravel(inside))]
        raise InputError(
            f"the {part} coefficient a of VMF3 is {wrong:.6g}, but such lie between {least:g} and {most:g}"
        )
    return array


def _solid_harmonics(
    latitude_rad: NDArray[np.float64], longitude_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """P_nm cos(m lon), then P_nm sin(m lon), without norm, in the table's order: shape (..., 182).

    By the recursions of the solid harmonics on the unit sphere (Cunningham 1970), exact to rounding at the poles too.
    """
    x = np.cos(latitude_rad) * np.exp(1j * longitude_rad)
    z = np.sin(latitude_rad)
    p: dict[tuple[int, int], NDArray[np.complex128]] = {(0, 0): np.ones_like(x)}
    for m in range(_DEGREE + 1):
        if m:
            p[m, m] = (2 * m - 1) * x * p[m - 1, m - 1]
        for n in range(m + 1, _DEGREE + 1):
            p[n, m] = (2 * n - 1) * z * p[n - 1, m] / (n - m)
            if n > m + 1:
                p[n, m] = p[n, m] - (n + m - 1) * p[n - 2, m] / (n - m)
    terms = np.stack([p[n, m] for n in range(_DEGREE + 1) for m in range(n + 1)], axis=-1)
    return np.concatenate([terms.real, terms.imag], axis=-1)


@cache
def _harmonic_coefficients() -> NDArray[np.float64]:
    """Factors of the harmonics, shape (4, 182, 5): which coefficient, which harmonic, which season."""
    text = (files("radioloc.media") / "data" / "vmf3_bc.csv").read_text(encoding="ascii")
    rows = [line.split(",") for line in text.splitlines() if not line.startswith(("#", "coefficient"))]
    numbers = np.array([row[3:] for row in rows], dtype=np.float64).reshape(len(_COEFFICIENTS), _TERMS, 2, 5)
    # Cosines of the longitude first, then sines.
    table = np.ascontiguousarray(np.swapaxes(numbers, 1, 2)).reshape(len(_COEFFICIENTS), 2 * _TERMS, 5)
    table.setflags(write=False)
    return table
