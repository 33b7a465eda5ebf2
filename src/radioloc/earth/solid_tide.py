"""Displacement of a station by the tides of the solid Earth, up to 0.4 m, and by the pole tide.

The conventional model of the IERS Conventions (2010), section 7.1.1. Step 1 takes the tide that the Moon
and the Sun raise on an Earth that responds to all frequencies alike: degrees 2 and 3, the dependence on
latitude, and the part out of phase. Step 2 corrects for the frequencies at which the Earth responds
otherwise: 31 diurnal tides (near the free core nutation) and 5 of long period (anelasticity).

The permanent part of the tide stays in, as in ITRF practice (the ITRF is conventionally tide free).

This is derived from, and checked against, the routine DEHANTTIDEINEL of the IERS Conventions Centre; it is
not that software. It is written from the equations, for many epochs at once, and takes UT1 where that takes
UTC.

The pole tide, up to some 25 mm up and 7 mm sideways, goes over months and years: as the spin axis wanders through the
crust, the centrifugal potential at a station changes and the solid Earth gives way. Only the wander about a pole that
itself drifts slowly counts: the secular pole of the IERS (2018), a straight line. The load of the ocean's own pole tide
is not modelled (IERS Conventions 2010, section 7.1.5, needs a global grid of coefficients): it is up to about 2 mm up
and 0.6 mm sideways.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.polynomial import polyval

from radioloc.constants import ARCSEC_RAD
from radioloc.earth.geodesy import rot_itrf_to_spherical_enu
from radioloc.time import Epochs
from radioloc.time.smooth import table_of
from radioloc.vectors import Floats

# Masses in Earth masses and the equatorial radius, as the conventional model has them.
_SUN_MASS_RATIO = 332946.0482
_MOON_MASS_RATIO = 0.0123000371
_EARTH_RADIUS_M = 6378136.6

_H2, _H2_LATITUDE = 0.6078, -0.0006
_L2, _L2_LATITUDE = 0.0847, 0.0002
_H3, _L3 = 0.292, 0.015
"""Nominal Love and Shida numbers (section 7.1.1, eq. 7.2; Table 7.2)."""

_L1_DIURNAL, _L1_SEMIDIURNAL = 0.0012, 0.0024
_H_IMAG_DIURNAL, _L_IMAG_DIURNAL = -0.0025, -0.0007
_H_IMAG_SEMIDIURNAL, _L_IMAG_SEMIDIURNAL = -0.0022, -0.0007

_LONG_PERIOD = np.array(
    [
        (0, 0, 0, 1, 0, 0.47, 0.16, 0.23, 0.07),
        (0, 2, 0, 0, 0, -0.20, -0.11, -0.12, -0.05),
        (1, 0, -1, 0, 0, -0.11, -0.09, -0.08, -0.04),
        (2, 0, 0, 0, 0, -0.13, -0.15, -0.11, -0.07),
        (2, 0, 0, 1, 0, -0.05, -0.06, -0.05, -0.03),
    ]
)
"""Table 7.3b, in the columns of Table 7.3a (``data/solid_tide_diurnal.csv``)."""

# Polynomials in Julian centuries TT since J2000, degrees, lowest power first, that belong to these tables.
_MEAN_MOON_OF_DATE = (218.31664563, 481267.88194, -0.0014663889, 0.00000185139)
_PRECESSION = (0.0, 1.396971278, 0.000308889, 0.000000021, 0.000000007)
_MEAN_SUN_AT_MIDNIGHT = (280.4606184, 36000.7700536, 0.00038793, -0.0000000258)
_SLOW_ARGUMENTS = (
    (280.46645, 36000.7697489, 0.00030322222, 0.000000020, -0.00000000654),
    (83.35324312, 4069.01363525, -0.01032172222, -0.0000124991, 0.00000005263),
    (234.95544499, 1934.13626197, -0.00207561111, -0.00000213944, 0.00000001650),
    (282.93734098, 1.71945766667, 0.00045688889, -0.00000001778, -0.00000000334),
)
"""h, p, N', ps."""

_RADIAL_M_RAD = 33e-3 / ARCSEC_RAD
_TRANSVERSE_M_RAD = 9e-3 / ARCSEC_RAD
"""Displacement per radian of wobble (eq. 7.26)."""


def solid_earth_tide(
    station_itrf_m: Floats, moon_itrf_m: Floats, sun_itrf_m: Floats, tt: Epochs, ut1_fraction: Floats
) -> Floats:
    """Displacement of stations by the solid Earth tide, ITRF, m, shape (n, 3)."""
    # Stations, Moon and Sun are geocentric, ITRF, m, (n, 3); 300 m for the Moon and 300 km for the Sun are enough for a
    # micrometre, and so is UTC in place of UT1. IERS Conventions (2010), eq. 7.5, 7.6, 7.8 to 7.11 (step 1) and 7.12,
    # 7.13 with Tables 7.3a and 7.3b (step 2); Mathews, Dehant and Gipson (1997). Good to about a millimetre; largest
    # parts are the Moon's (0.36 m) and the Sun's (0.16 m) of degree 2, step 2 (13 mm), degree 3 (2 mm), out of phase
    # (2 mm), latitude (1 mm).
    tt.require("TT")
    axes = rot_itrf_to_spherical_enu(station_itrf_m)
    sin_lat = axes[:, 2, 2]
    longitude = np.arctan2(station_itrf_m[:, 1], station_itrf_m[:, 0])
    enu = _step_1(axes, sin_lat, longitude, moon_itrf_m, _MOON_MASS_RATIO)
    enu += _step_1(axes, sin_lat, longitude, sun_itrf_m, _SUN_MASS_RATIO)
    enu += _step_2(sin_lat, longitude, tt.centuries_since_j2000(), ut1_fraction)
    return np.einsum("nij,ni->nj", axes, enu)


def secular_pole_rad(tt: Epochs) -> Floats:
    """Coordinates x and y of the IERS secular pole (2018; section 7.1.4 as updated in February 2018), rad, (n, 2)."""
    tt.require("TT")
    years = 100.0 * tt.centuries_since_j2000()
    return np.stack([55.0 + 1.677 * years, 320.5 + 3.460 * years], axis=-1) * (1e-3 * ARCSEC_RAD)


def pole_tide_displacement(station_itrf_m: Floats, xp_rad: Floats, yp_rad: Floats, tt: Epochs) -> Floats:
    """Displacement of stations (ITRF, m, shape (n, 3)) by the solid Earth pole tide, ITRF, m, shape (n, 3)."""
    # IERS Conventions (2010), eq. 7.26 with m1 = xp - xs, m2 = -(yp - ys): towards the radius, the south and the east,
    # -33 sin 2t (m1 cos L + m2 sin L), -9 cos 2t (m1 cos L + m2 sin L) and 9 cos t (m1 sin L - m2 cos L) mm for m1, m2
    # in arcseconds, at colatitude t and longitude L.
    x_secular, y_secular = secular_pole_rad(tt).T
    m1, m2 = xp_rad - x_secular, y_secular - yp_rad
    axes = rot_itrf_to_spherical_enu(station_itrf_m)
    sin_lat, cos_lat = axes[:, 2, 2], axes[:, 1, 2]
    sin_lon, cos_lon = -axes[:, 0, 0], axes[:, 0, 1]
    parallel = m1 * cos_lon + m2 * sin_lon
    across = m1 * sin_lon - m2 * cos_lon
    up = -_RADIAL_M_RAD * 2.0 * sin_lat * cos_lat * parallel
    north = _TRANSVERSE_M_RAD * (sin_lat**2 - cos_lat**2) * parallel
    east = _TRANSVERSE_M_RAD * sin_lat * across
    return np.einsum("nij,ni->nj", axes, np.stack([east, north, up], axis=-1))


def _step_1(axes: Floats, sin_lat: Floats, longitude: Floats, body_m: Floats, mass_ratio: float) -> Floats:
    """Sum the terms of one body in the time domain: east, north, radial, m, shape (n, 3)."""
    distance = np.linalg.norm(body_m, axis=-1)
    unit = body_m / distance[:, np.newaxis]
    # The body's direction in the station's axes; its last component is the cosine of the zenith distance.
    local = np.einsum("nij,nj->ni", axes, unit)
    cos_zenith = local[:, 2]
    scale_2 = mass_ratio * _EARTH_RADIUS_M * (_EARTH_RADIUS_M / distance) ** 3
    scale_3 = scale_2 * (_EARTH_RADIUS_M / distance)

    # Degrees 2 and 3, in phase (eq. 7.5, 7.6).
    legendre_2 = (3.0 * sin_lat**2 - 1.0) / 2.0
    h2 = _H2 + _H2_LATITUDE * legendre_2
    l2 = _L2 + _L2_LATITUDE * legendre_2
    toward = scale_2 * 3.0 * l2 * cos_zenith + scale_3 * _L3 * (7.5 * cos_zenith**2 - 1.5)
    up = scale_2 * h2 * (1.5 * cos_zenith**2 - 0.5) + scale_3 * _H3 * (2.5 * cos_zenith**3 - 1.5 * cos_zenith)
    east, north = toward * local[:, 0], toward * local[:, 1]

    cos_lat = np.sqrt(1.0 - sin_lat**2)
    sin_2lat, cos_2lat = 2.0 * sin_lat * cos_lat, 1.0 - 2.0 * sin_lat**2
    sin_dec = unit[:, 2]
    cos2_dec = 1.0 - sin_dec**2
    sin_2dec = 2.0 * sin_dec * np.sqrt(cos2_dec)
    hour = longitude - np.arctan2(body_m[:, 1], body_m[:, 0])
    sin_1, cos_1, sin_2, cos_2 = np.sin(hour), np.cos(hour), np.sin(2.0 * hour), np.cos(2.0 * hour)

    # Dependence of the transverse displacement on latitude (eq. 7.8, 7.9; P21 = 1.5 sin 2D, P22 = 3 cos^2 D).
    diurnal = -_L1_DIURNAL * sin_lat * scale_2 * 1.5 * sin_2dec
    semidiurnal = -0.5 * _L1_SEMIDIURNAL * sin_lat * cos_lat * scale_2 * 3.0 * cos2_dec
    north += diurnal * sin_lat * cos_1 + semidiurnal * cos_2
    east += -diurnal * cos_2lat * sin_1 + semidiurnal * sin_lat * sin_2

    # Out of phase (eq. 7.10, 7.11).
    diurnal = scale_2 * sin_2dec
    semidiurnal = scale_2 * cos2_dec
    up += -0.75 * _H_IMAG_DIURNAL * diurnal * sin_2lat * sin_1
    up += -0.75 * _H_IMAG_SEMIDIURNAL * semidiurnal * cos_lat**2 * sin_2
    north += -1.5 * _L_IMAG_DIURNAL * diurnal * cos_2lat * sin_1
    north += 0.75 * _L_IMAG_SEMIDIURNAL * semidiurnal * sin_2lat * sin_2
    east += -1.5 * _L_IMAG_DIURNAL * diurnal * sin_lat * cos_1
    east += -1.5 * _L_IMAG_SEMIDIURNAL * semidiurnal * cos_lat * cos_2
    return np.stack([east, north, up], axis=-1)


def _step_2(sin_lat: Floats, longitude: Floats, centuries_tt: Floats, ut1_fraction: Floats) -> Floats:
    """Sum the corrections in the frequency domain: east, north, radial, m, shape (n, 3)."""
    moon_of_date = polyval(centuries_tt, _MEAN_MOON_OF_DATE)
    tau = 360.0 * ut1_fraction + polyval(centuries_tt, _MEAN_SUN_AT_MIDNIGHT) - moon_of_date
    moon = moon_of_date + polyval(centuries_tt, _PRECESSION)
    slow = [polyval(centuries_tt, coefficients) for coefficients in _SLOW_ARGUMENTS]
    arguments = np.remainder(np.stack([moon, *slow], axis=-1), 360.0)

    cos_lat = np.sqrt(1.0 - sin_lat**2)
    diurnal = table_of("radioloc.earth", "solid_tide_diurnal.csv")
    theta = np.deg2rad(np.remainder(tau, 360.0)[:, np.newaxis] + arguments @ diurnal[:, :5].T)
    theta += longitude[:, np.newaxis]
    sine, cosine = np.sin(theta), np.cos(theta)
    radial_in, radial_out, transverse_in, transverse_out = diurnal[:, 5:].T
    up = 2.0 * sin_lat * cos_lat * (sine @ radial_in + cosine @ radial_out)
    north = (cos_lat**2 - sin_lat**2) * (sine @ transverse_in + cosine @ transverse_out)
    east = sin_lat * (cosine @ transverse_in - sine @ transverse_out)

    theta = np.deg2rad(arguments @ _LONG_PERIOD[:, :5].T)
    sine, cosine = np.sin(theta), np.cos(theta)
    radial_in, radial_out, transverse_in, transverse_out = _LONG_PERIOD[:, 5:].T
    up += (1.5 * sin_lat**2 - 0.5) * (cosine @ radial_in + sine @ radial_out)
    north += 2.0 * sin_lat * cos_lat * (cosine @ transverse_in + sine @ transverse_out)
    return np.stack([east, north, up], axis=-1) * 1e-3
