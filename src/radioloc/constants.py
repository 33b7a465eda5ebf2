"""Physical constants: value, unit suffix, citation.

Constants of one ephemeris (masses, Love numbers, angles between principal and mean-Earth axes) are in
:mod:`radioloc.ephemeris.constants`.
"""

from __future__ import annotations

import math

C_M_S = 299792458.0
"""Speed of light, m/s; exact (SI)."""

SECONDS_PER_DAY = 86400.0
"""SI seconds in a day of TAI, TT or TDB."""

EARTH_ROTATION_RAD_S = 7.292115e-5
"""Nominal angular velocity of the Earth, rad/s (GRS80; IERS Conventions 2010, table 1.2); within 2e-8 of
the rate of the Earth rotation angle by UT1, 2 pi 1.00273781191135448 / 86400 (ibid., eq. 5.15)."""

J2000_JD = 2451545.0
"""Julian date of J2000.0."""

MJD_ZERO_JD = 2400000.5
"""Julian date of the origin of modified Julian dates."""

UNIX_JD = 2440587.5
"""Julian date of 1970-01-01, origin of dates of NumPy."""

UTC_JD = 2441317.5
"""Julian date of 1972-01-01, when UTC with leap seconds began."""

TT_MINUS_TAI_S = 32.184
"""TT - TAI, s; exact (IAU 1991 resolution A4)."""

L_G = 6.969290134e-10
"""1 - d(TT)/d(TCG); exact (IAU 2000 resolution B1.9)."""

L_B = 1.550519768e-8
"""1 - d(TDB)/d(TCB); exact (IAU 2006 resolution B3)."""

ARCSEC_RAD = math.pi / 648000.0
"""One arcsecond, rad."""

MEAN_LUNAR_RADIUS_M = 1737400.0
"""Radius of the sphere to which selenographic heights refer, m (IAU WGCCRE 2015, Archinal et al. 2018)."""

LUNAR_HEIGHT_LIMITS_M = (-9.2e3, 10.8e3)
"""Lowest and highest terrain above that sphere, m: Antoniadi, 172 W 70 S, -9.12 km, and the Engel'gardt rim, 159 W 5 N,
10.79 km (Smith et al. 2010)."""
