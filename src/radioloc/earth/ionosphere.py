"""Delay of radio waves in the ionosphere, first order in electron content.

The group delay falls with the square of frequency. In metres, for slant contents of 10 (night), 50 (day) and 150 TECU
(day at solar maximum, at 20 degrees of elevation), on the way to the Moon as to any satellite above it:

====================  =======  =======  ========
band                  10 TECU  50 TECU  150 TECU
====================  =======  =======  ========
S, 2.2 GHz             0.83     4.2      12.5
X up, 7.2 GHz          0.078    0.39      1.17
X down, 8.4 GHz        0.057    0.29      0.86
Ka, 32 GHz             0.0039   0.020     0.059
====================  =======  =======  ========

Terms of the second order are left out: for 100 TECU some 6 mm at S band and 0.1 mm at X band. Maps from GNSS reach up
to 20 000 km; the solar wind beyond, with 5 electrons per cubic centimetre, adds 0.2 TECU on the way to the Moon.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.earth.checks import within
from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.errors import InputError

GROUP_DELAY_M3_S2 = 40.308193022
"""Delay (m) times squared frequency per electron content (1/m^2): e^2 / (8 pi^2 eps0 m_e), CODATA 2018."""

TECU_PER_M2 = 1e16
"""Electrons per square metre in one unit of total electron content."""

SHELL_HEIGHT_M = 450e3
"""Usual height of the shell of maps of the ionosphere, above `BASE_RADIUS_M`."""

BASE_RADIUS_M = 6371e3
"""Usual radius from which maps count the shell's height, m."""

_MODIFIED_HEIGHT_M = 506.7e3
_MODIFIED_SCALE = 0.9782
_FREQUENCY_HZ = (1e8, 1e12)
_LARGEST_TECU = 5000.0


def ionosphere_delay_m(stec_tecu: ArrayLike, frequency_hz: ArrayLike) -> NDArray[np.float64]:
    """Group delay along a ray, one way, m: positive, to be added to the geometric range or VLBI group delay.

    The phase is advanced by as much.

    Parameters
    ----------
    stec_tecu : array_like
        Electron content along the ray, in 1e16 per square metre.
    frequency_hz : array_like
        Frequency, Hz.

    Raises
    ------
    InputError
        A frequency is outside 0.1 to 1000 GHz, or an electron content is not from 0 to 5000 TECU.

    Notes
    -----
    IERS Conventions (2010), section 9.4, first order, with the constant to its digits.
    """
    stec = np.asarray(stec_tecu, dtype=np.float64)
    frequency = np.asarray(frequency_hz, dtype=np.float64)
    if not ((stec >= 0.0) & (stec <= _LARGEST_TECU)).all():
        raise InputError(
            f"electron contents are {np.min(stec):.6g} to {np.max(stec):.6g} TECU (1e16 per square metre), "
            f"but 0 to {_LARGEST_TECU:g} are possible"
        )
    if not ((frequency >= _FREQUENCY_HZ[0]) & (frequency <= _FREQUENCY_HZ[1])).all():
        raise InputError(
            f"frequencies are {np.min(frequency):.6g} to {np.max(frequency):.6g} Hz, but the delay holds "
            f"from {_FREQUENCY_HZ[0]:g} to {_FREQUENCY_HZ[1]:g} Hz"
        )
    return np.asarray(GROUP_DELAY_M3_S2 * TECU_PER_M2 * stec / frequency**2)


def thin_shell_mapping(
    elevation_rad: ArrayLike, shell_height_m: float = SHELL_HEIGHT_M, base_radius_m: float = BASE_RADIUS_M
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Slant per vertical electron content with all electrons in a shell, and its derivative, 1/rad.

    Parameters
    ----------
    elevation_rad : array_like
        Elevation, rad, at least 3 degrees.
    shell_height_m, base_radius_m : float
        Height of the shell and the radius of the sphere above which it is, m.

    Raises
    ------
    InputError
        An elevation is outside 3 to 90 degrees, or the shell is not above the sphere.

    Notes
    -----
    1 / cos z' with sin z' = R / (R + H) sin z: the mapping function COSZ of the IONEX format (Schaer et al. 1998).
    """
    return _shell_mapping(elevation_rad, shell_height_m, base_radius_m, 1.0)


def modified_shell_mapping(elevation_rad: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Slant per vertical electron content by the modified single layer model, and its derivative, 1/rad.

    Less than that of a shell at 450 km by 2 % at 45 degrees, 6 % at 20 and 7 % at 10.

    Parameters
    ----------
    elevation_rad : array_like
        Elevation, rad, at least 3 degrees.

    Raises
    ------
    InputError
        An elevation is outside 3 to 90 degrees.

    Notes
    -----
    sin z' = R / (R + 506.7 km) sin(0.9782 z) with R = 6371 km, fitted by CODE to the extended slab model of JPL
    (Dach et al. 2015, Bernese GNSS Software 5.2, chapter 12).
    """
    return _shell_mapping(elevation_rad, _MODIFIED_HEIGHT_M, BASE_RADIUS_M, _MODIFIED_SCALE)


def _shell_mapping(
    elevation_rad: ArrayLike, shell_height_m: float, base_radius_m: float, scale: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    elevation = within("elevation", elevation_rad, "the mapping of the ionosphere")
    ratio = base_radius_m / _shell_radius_m(shell_height_m, base_radius_m)
    angle = scale * (np.pi / 2 - elevation)
    sine = ratio * np.sin(angle)
    mapping = (1.0 - sine**2) ** -0.5
    return np.asarray(mapping), np.asarray(-scale * mapping**3 * sine * ratio * np.cos(angle))


def pierce_point(
    station_itrf_m: ArrayLike,
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    shell_height_m: float = SHELL_HEIGHT_M,
    base_radius_m: float = BASE_RADIUS_M,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Geocentric latitude and east longitude, rad, at which rays go through the shell.

    Parameters
    ----------
    station_itrf_m : array_like, shape (3,) or (n, 3)
        Station, ITRF, m.
    azimuth_rad, elevation_rad : array_like, shape () or (n,)
        Direction of the ray: from north through east, and above the horizon of the ellipsoid, rad.
    shell_height_m, base_radius_m : float
        Height of the shell and the radius of the sphere above which it is, m.

    Returns
    -------
    latitude_rad, longitude_rad : ndarray, shape (n,)
        Geocentric, as maps of the ionosphere count; longitude in (-pi, pi].

    Raises
    ------
    InputError
        An elevation is outside 3 to 90 degrees, an azimuth is not finite, or the station is not below the shell.
    """
    elevation = within("elevation", elevation_rad, "the pierce point")
    azimuth, elevation = np.broadcast_arrays(np.asarray(azimuth_rad, dtype=np.float64), elevation)
    if not np.isfinite(azimuth).all():
        raise InputError("an azimuth is not a finite number")
    station = np.asarray(station_itrf_m, dtype=np.float64)
    enu = np.stack(
        [np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], axis=-1
    )
    # The transpose of the rotation takes the direction from east, north, up to the ITRF.
    direction = np.einsum("...ji,...j->...i", rot_itrf_to_enu(station), enu)
    upwards = np.sum(station * direction, axis=-1)
    room = _shell_radius_m(shell_height_m, base_radius_m) ** 2 - np.sum(station**2, axis=-1)
    if not (room > 0.0).all():
        raise InputError("a station is not below the shell of the ionosphere; give metres, geocentric")
    # Solution of the quadratic equation for the distance to the sphere ahead.
    distance = room / (upwards + np.sqrt(upwards**2 + room))
    x, y, z = np.moveaxis(station + distance[..., None] * direction, -1, 0)
    return np.asarray(np.arctan2(z, np.hypot(x, y))), np.asarray(np.arctan2(y, x))


def _shell_radius_m(shell_height_m: float, base_radius_m: float) -> float:
    if not (1e5 <= shell_height_m <= 2e6 and 6.3e6 <= base_radius_m <= 6.4e6):
        raise InputError(
            f"a shell {shell_height_m:g} m above a sphere of {base_radius_m:g} m is not of the ionosphere; give "
            "metres: 100 to 2000 km above some 6371 km"
        )
    return base_radius_m + shell_height_m
