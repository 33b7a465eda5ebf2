"""Ratio of the delay of radio waves along a ray to that at the zenith, by elevation.

All mapping functions in use are one continued fraction in the sine of elevation, with three coefficients a, b, c.
Niell (1996) gives them from latitude, height and season alone, good to 1 % at 5 degrees of elevation, so to some
3 mm of delay at 20 degrees. :mod:`radioloc.media.vmf3` gives those of Landskron and Boehm (2018) with a from
weather models, good to less than a millimetre there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.media.checks import within
from radioloc.time import Epochs

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


@dataclass(frozen=True, slots=True, eq=False)
class MappingFactors:
    """Mapping functions and their derivatives; arrays of one shape.

    Parameters
    ----------
    hydrostatic, wet : ndarray
        Delay along the ray per delay at the zenith.
    hydrostatic_rate_rad, wet_rate_rad : ndarray
        Derivative with respect to elevation, 1/rad; negative.
    """

    hydrostatic: NDArray[np.float64]
    wet: NDArray[np.float64]
    hydrostatic_rate_rad: NDArray[np.float64]
    wet_rate_rad: NDArray[np.float64]


def continued_fraction(
    elevation_rad: ArrayLike, a: ArrayLike, b: ArrayLike, c: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Give the continued fraction in the sine of elevation, 1 at the zenith, and its derivative, 1/rad.

    Parameters
    ----------
    elevation_rad : array_like
        Elevation without refraction, rad, at least 3 degrees.
    a, b, c : array_like
        The three coefficients.

    Raises
    ------
    InputError
        An elevation is outside 3 to 90 degrees.

    Notes
    -----
    Marini (1972), normed by Herring (1992); IERS Conventions (2010), section 9.2.
    """
    sine, cosine = _sine_and_cosine(elevation_rad)
    return _fraction(sine, cosine, *(np.asarray(value, dtype=np.float64) for value in (a, b, c)))


def _sine_and_cosine(elevation_rad: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    elevation = within("elevation", elevation_rad, "the mapping function")
    return np.sin(elevation), np.cos(elevation)


def _fraction(
    sine: NDArray[np.float64],
    cosine: NDArray[np.float64],
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    c: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Continued fraction and its derivative, of the elevation's sine and cosine."""
    inner = sine + c
    middle = sine + b / inner
    outer = sine + a / middle
    middle_rate = cosine * (1.0 - b / inner**2)
    outer_rate = cosine - a * middle_rate / middle**2
    zenith = 1.0 + a / (1.0 + b / (1.0 + c))
    return np.asarray(zenith / outer), np.asarray(-zenith * outer_rate / outer**2)


def height_correction(
    elevation_rad: ArrayLike, height_m: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What height adds to a hydrostatic mapping function given for sea level, and its derivative, 1/rad.

    Parameters
    ----------
    elevation_rad : array_like
        Elevation without refraction, rad, at least 3 degrees.
    height_m : array_like
        Height, m.

    Raises
    ------
    InputError
        A quantity is outside of what the model covers, or not finite.

    Notes
    -----
    Niell (1996); 0.00053 at 1000 m and 20 degrees, 1.2 mm of delay.
    """
    return _height_correction(*_sine_and_cosine(elevation_rad), height_m)


def _height_correction(
    sine: NDArray[np.float64], cosine: NDArray[np.float64], height_m: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    height_km = within("height", height_m, "the height correction") / 1000.0
    sea_level, rate = _fraction(sine, cosine, *_HEIGHT_ABC)
    return np.asarray(height_km * (1.0 / sine - sea_level)), np.asarray(
        height_km * (-cosine / sine**2 - rate)
    )


def niell(
    elevation_rad: ArrayLike, latitude_rad: ArrayLike, height_m: ArrayLike, day_of_year: ArrayLike
) -> MappingFactors:
    """Mapping functions of Niell (1996), which need no weather.

    Parameters
    ----------
    elevation_rad : array_like
        Elevation without refraction, rad, at least 3 degrees.
    latitude_rad : array_like
        Geodetic latitude, rad.
    height_m : array_like
        Height above the geoid, m; that above the ellipsoid changes the delay by less than 0.2 mm at 20 degrees.
    day_of_year : array_like
        Day of the year, 1 at 0h on 1 January, as :func:`day_of_year` gives it.

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
    Niell (1996), tables 3 and 4. Nearer to the equator than 15 degrees and nearer to the poles than 75
    the coefficients are those at 15 and 75 degrees; the south has the north's seasons half a year later.
    """
    return mapping_factors(elevation_rad, height_m, *niell_coefficients(latitude_rad, day_of_year))


def niell_coefficients(
    latitude_rad: ArrayLike, day_of_year: ArrayLike
) -> tuple[tuple[NDArray[np.float64], ...], tuple[NDArray[np.float64], ...]]:
    """Coefficients a, b, c of :func:`niell` at sea level, hydrostatic and wet; parameters and errors as there."""
    latitude = within("latitude", latitude_rad, "the mapping function of Niell")
    day = within("day of year", day_of_year, "the mapping function of Niell")
    phase = 2.0 * np.pi * (day - _NIELL_COLDEST_DAY) / _YEAR_DAYS + np.where(latitude < 0.0, np.pi, 0.0)

    def at_latitude(row: tuple[float, ...]) -> NDArray[np.float64]:
        return np.interp(np.abs(latitude), _NIELL_LATITUDE_RAD, row)

    hydrostatic = (
        at_latitude(mean) - at_latitude(amplitude) * np.cos(phase)
        for mean, amplitude in zip(_NIELL_MEAN, _NIELL_AMPLITUDE, strict=True)
    )
    return (*hydrostatic,), tuple(at_latitude(row) for row in _NIELL_WET)


def mapping_factors(
    elevation_rad: ArrayLike,
    height_m: ArrayLike,
    hydrostatic_abc: tuple[ArrayLike, ...],
    wet_abc: tuple[ArrayLike, ...],
) -> MappingFactors:
    """Mapping functions from their coefficients at sea level, a, b, c each; errors as :func:`niell`."""
    sine, cosine = _sine_and_cosine(elevation_rad)
    hydrostatic, hydrostatic_rate = _fraction(sine, cosine, *map(np.asarray, hydrostatic_abc))
    correction, correction_rate = _height_correction(sine, cosine, height_m)
    wet, wet_rate = _fraction(sine, cosine, *map(np.asarray, wet_abc))
    return MappingFactors(
        *np.broadcast_arrays(hydrostatic + correction, wet, hydrostatic_rate + correction_rate, wet_rate)
    )


def day_of_year(epochs: Epochs) -> NDArray[np.float64]:
    """Day of the year with its fraction, 1 at 0h on 1 January, shape (n,); in the epochs' own scale."""
    days = np.floor(epochs.jd - 2440587.5).astype(np.int64).astype("datetime64[D]")
    since_january = (days - days.astype("datetime64[Y]").astype("datetime64[D]")).astype(np.float64)
    return 1.0 + since_january + epochs.fraction
