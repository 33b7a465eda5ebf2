"""Ratio of the delay of radio waves along a ray to that at the zenith, by elevation.

All mapping functions in use are one continued fraction in the sine of elevation, with three coefficients a, b, c.
Niell (1996) gives them from latitude, height and season alone, good to 1 % at 5 degrees of elevation, some
3 mm of delay at 20 degrees. VMF3 (Landskron and Boehm 2018) is good to less than a millimetre there. Its a come
from ray tracing through weather models every six hours, or from a climatology (:mod:`radioloc.media.air_files`). Its b
and c are a fit to ten years of such rays: spherical harmonics of degree and order 12 with annual and semiannual terms,
which the package contains.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from radioloc.constants import UNIX_JD
from radioloc.time import Epochs
from radioloc.time.smooth import table_of
from radioloc.vectors import Floats

_NIELL_LATITUDE_RAD = np.deg2rad([15.0, 30.0, 45.0, 60.0, 75.0])
_NIELL_MEAN = (
    (1.2769934e-3, 1.2683230e-3, 1.2465397e-3, 1.2196049e-3, 1.2045996e-3),
    (2.9153695e-3, 2.9152299e-3, 2.9288445e-3, 2.9022565e-3, 2.9024912e-3),
    (62.610505e-3, 62.837393e-3, 63.721774e-3, 63.824265e-3, 64.258455e-3),
)
_NIELL_AMPLITUDE = (
    (0.0, 1.2709626e-5, 2.6523662e-5, 3.4000452e-5, 4.1202191e-5),
    (0.0, 2.1414979e-5, 3.0160779e-5, 7.2562722e-5, 11.723375e-5),
    (0.0, 9.0128400e-5, 4.3497037e-5, 84.795348e-5, 170.37206e-5),
)
_NIELL_WET = (
    (5.8021897e-4, 5.6794847e-4, 5.8118019e-4, 5.9727542e-4, 6.1641693e-4),
    (1.4275268e-3, 1.5138625e-3, 1.4572752e-3, 1.5007428e-3, 1.7599082e-3),
    (4.3472961e-2, 4.6729510e-2, 4.3908931e-2, 4.4626982e-2, 5.4736038e-2),
)
"""Niell (1996), tables 3 and 4: rows a, b, c; columns latitudes of 15 to 75 degrees."""

_HEIGHT_ABC = np.array([2.53e-5, 5.49e-3, 1.14e-3])
_NIELL_COLDEST_DAY = 28.0
_YEAR_DAYS = 365.25
_VMF3_DEGREE = 12
_VMF3_TERMS = (_VMF3_DEGREE + 1) * (_VMF3_DEGREE + 2) // 2


class MappingFactors(NamedTuple):
    """Ratios of the delay along the ray to that at the zenith, and their derivatives with elevation, 1/rad."""

    hydrostatic: Floats
    wet: Floats
    hydrostatic_rate_rad: Floats
    wet_rate_rad: Floats


def continued_fraction(
    sine: Floats, cosine: Floats, a: Floats, b: Floats, c: Floats
) -> tuple[Floats, Floats]:
    """Return the continued fraction in the sine of elevation (IERS 2010, section 9.2) and its slope, 1/rad."""
    inner = sine + c
    middle = sine + b / inner
    outer = sine + a / middle
    middle_rate = cosine * (1.0 - b / inner**2)
    outer_rate = cosine - a * middle_rate / middle**2
    zenith = 1.0 + a / (1.0 + b / (1.0 + c))
    return zenith / outer, -zenith * outer_rate / outer**2


def height_correction(sine: Floats, cosine: Floats, height_m: Floats) -> tuple[Floats, Floats]:
    """Return the height correction of a hydrostatic mapping function (Niell 1996), and its derivative, 1/rad."""
    height_km = height_m / 1000.0
    sea_level, rate = continued_fraction(sine, cosine, *_HEIGHT_ABC)
    return height_km * (1.0 / sine - sea_level), height_km * (-cosine / sine**2 - rate)


def mapping_factors(
    elevation_rad: Floats, height_m: Floats, hydrostatic_abc: Sequence[Floats], wet_abc: Sequence[Floats]
) -> MappingFactors:
    """Evaluate mapping functions at elevations (without refraction, 3 to 90 deg) by their coefficients a, b, c."""
    # Heights are above the reference of the hydrostatic coefficients: sea level for Niell, maps and GPT3 (the ellipsoid
    # changes the delay by less than 0.2 mm at 20 degrees), the station for VMF3's files of sites.
    sine, cosine = np.sin(elevation_rad), np.cos(elevation_rad)
    hydrostatic, hydrostatic_rate = continued_fraction(sine, cosine, *hydrostatic_abc)
    correction, correction_rate = height_correction(sine, cosine, height_m)
    wet, wet_rate = continued_fraction(sine, cosine, *wet_abc)
    return MappingFactors(hydrostatic + correction, wet, hydrostatic_rate + correction_rate, wet_rate)


def niell_coefficients(latitude_rad: Floats, day_of_year: Floats) -> tuple[list[Floats], list[Floats]]:
    """Return hydrostatic and wet coefficients a, b, c of Niell (1996), tables 3 and 4, at sea level."""
    # South of the equator seasons are half a year later. The values of 15 and 75 degrees hold beyond these latitudes.
    south = np.where(latitude_rad < 0.0, np.pi, 0.0)
    phase = 2.0 * np.pi * (day_of_year - _NIELL_COLDEST_DAY) / _YEAR_DAYS + south

    def at_latitude(row: tuple[float, ...]) -> Floats:
        return np.interp(np.abs(latitude_rad), _NIELL_LATITUDE_RAD, row)

    hydrostatic = [
        at_latitude(mean) - at_latitude(amplitude) * np.cos(phase)
        for mean, amplitude in zip(_NIELL_MEAN, _NIELL_AMPLITUDE, strict=True)
    ]
    return hydrostatic, [at_latitude(row) for row in _NIELL_WET]


def vmf3_bc(latitude_rad: Floats | float, longitude_rad: Floats | float, day_of_year: Floats) -> Floats:
    """Return b hydrostatic, b wet, c hydrostatic, c wet of VMF3 at a place on some days, shape (4, ...)."""
    harmonics = _solid_harmonics(latitude_rad, longitude_rad)
    return np.einsum("...k,ckp,...p->c...", harmonics, _vmf3_table(), seasons(day_of_year), optimize=True)


def seasons(day_of_year: Floats) -> Floats:
    """Return factors of mean, annual cosine and sine, semiannual cosine and sine, shape (..., 5)."""
    year = 2.0 * np.pi * day_of_year / _YEAR_DAYS
    return np.stack(
        [np.ones_like(year), np.cos(year), np.sin(year), np.cos(2.0 * year), np.sin(2.0 * year)], axis=-1
    )


def _solid_harmonics(latitude_rad: Floats | float, longitude_rad: Floats | float) -> Floats:
    """Return P_nm cos(m lon), then P_nm sin(m lon), not normalized, in the table's order, shape (..., 182)."""
    from scipy.special import lpmv

    n, m = np.array([(n, m) for n in range(_VMF3_DEGREE + 1) for m in range(n + 1)]).T
    p = (-1.0) ** m * lpmv(m, n, np.sin(latitude_rad)[..., None])  # without the phase of Condon and Shortley
    angle = m * np.asarray(longitude_rad)[..., None]
    return np.concatenate([p * np.cos(angle), p * np.sin(angle)], axis=-1)


@cache
def _vmf3_table() -> Floats:
    """Return factors of the harmonics, shape (4, 182, 5): coefficient, harmonic, season."""
    numbers = table_of("radioloc.media", "vmf3_bc.csv", 3).reshape(4, _VMF3_TERMS, 2, 5)
    # Cosines of the longitude first, then sines.
    table = np.ascontiguousarray(np.swapaxes(numbers, 1, 2)).reshape(4, 2 * _VMF3_TERMS, 5)
    table.setflags(write=False)
    return table


def day_of_year(epochs: Epochs) -> Floats:
    """Return the day of the year with its fraction, 1.0 at 0h on 1 January, in the scale of the epochs, shape (n,)."""
    days = np.floor(epochs.jd - UNIX_JD).astype(np.int64).astype("datetime64[D]")
    since_january = (days - days.astype("datetime64[Y]").astype("datetime64[D]")).astype(np.float64)
    return 1.0 + since_january + epochs.fraction
