"""Rotations between the ICRF and the Moon's axes, positions of Earth and Sun seen from the Moon, and visibility.

The Moon's axes are the principal axes (PA), the mean-Earth axes (ME) or those of the IAU rotation model.

A rotation of the axes about x by the angle a is Rx(a) = [[1, 0, 0], [0, cos a, sin a], [0, -sin a, cos a]],
Ry and Rz by cyclic permutation; ``rot_a_to_b @ vector_in_a`` gives the vector in b.
"""

from __future__ import annotations

import erfa
import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike

from radioloc import vectors
from radioloc.constants import ARCSEC_RAD, J2000_JD, MEAN_LUNAR_RADIUS_M
from radioloc.ephemeris import CONSTANTS, Ephemeris, EphemerisConstants, LunarOrientation
from radioloc.errors import InputError
from radioloc.quantities import EpochsLike, accepts_quantities
from radioloc.time import Epochs, to_scale
from radioloc.units import as_float_array
from radioloc.vectors import Floats, Mask


def earth_elevation_rad(
    ephemeris: Ephemeris, libration: LunarOrientation, tdb: Epochs, point_pa_m: Floats
) -> Floats:
    """Elevation of the Earth's centre above the horizon of a point (principal axes, m) on a sphere, rad, shape (n,)."""
    # Light time, aberration and the Earth's radius, up to 1 degree together, are neglected.
    moon_m, _ = ephemeris.geocentric("moon", tdb)
    angles_rad, _ = libration.angles(tdb)
    to_earth_m = np.einsum("nij,nj->ni", rot_icrf_to_pa(angles_rad), -moon_m) - point_pa_m
    sine = vectors.normalized(to_earth_m) @ vectors.normalized(point_pa_m)
    return np.arcsin(np.clip(sine, -1.0, 1.0))


def sun_position_me_m(epochs: Epochs) -> Floats:
    """Geometric position of the Sun from the Moon's centre, ME_DE421, m, shape (n, 3)."""
    # Aberration is neglected: it moves the Sun by 0.006 degrees, a fiftieth of its apparent radius.
    tdb = to_scale(epochs, "TDB")
    ephemeris = Ephemeris.open("DE421")
    (sun_m, _), (moon_m, _) = (ephemeris.geocentric(body, tdb) for body in ("sun", "moon"))
    return vectors.rotated(rot_icrf_to_me(tdb), sun_m - moon_m)


def hidden_by_moon(
    point_m: ArrayLike, station_m: ArrayLike, radius_m: ArrayLike = MEAN_LUNAR_RADIUS_M
) -> Mask:
    """Return whether a sphere about the Moon's centre blocks the lines from points to stations.

    Parameters
    ----------
    point_m, station_m : array_like, shape (..., 3)
        Positions from the Moon's centre in the same axes, m.
    radius_m : array_like, optional
        Radius of the sphere, m. Points inside the sphere are hidden. For a point below the mean radius, as on most of
        the near side, give its own distance from the centre.
    """
    point = as_float_array(point_m, "m", "point_m")
    ray = as_float_array(station_m, "m", "station_m") - point
    ray_part = -np.sum(point * ray, axis=-1) / np.sum(ray * ray, axis=-1)
    nearest_m = np.linalg.norm(point + np.clip(ray_part, 0.0, 1.0)[..., None] * ray, axis=-1)
    return np.asarray(nearest_m < as_float_array(radius_m, "m", "radius_m"))


def rot_icrf_to_pa(angles_rad: ArrayLike) -> Floats:
    """Rotation from the ICRF to the principal axes of the Moon, Rz(psi) Rx(theta) Rz(phi), shape (..., 3, 3).

    Parameters
    ----------
    angles_rad : array_like, shape (..., 3)
        Euler angles phi, theta, psi, rad (:meth:`radioloc.ephemeris.LunarOrientation.angles`).

    Notes
    -----
    Folkner, Williams and Boggs (2009), IPN Progress Report 42-178, on the orientation of the Moon. The principal axes
    are those of the ephemeris from which the angles come: PA_DE421 and PA_DE440 differ by 1.3 to 1.8 m on the
    surface.

    Examples
    --------
    >>> from radioloc.ephemeris import LunarOrientation
    >>> from radioloc.lunar import rot_icrf_to_pa
    >>> from radioloc.time import epochs_from_strings
    >>> angles_rad, _ = LunarOrientation.open().angles(epochs_from_strings("2020-12-01", "TDB"))
    >>> rot_icrf_to_pa(angles_rad)[0, 2].round(3).tolist()  # the Moon's axis in the ICRF
    [-0.027, -0.394, 0.919]
    """
    phi, theta, psi = _three_components(angles_rad, "rad", "angles_rad")
    return np.asarray(erfa.rz(psi, erfa.rx(theta, erfa.rz(phi, np.eye(3)))))


def angular_velocity_pa(angles_rad: ArrayLike, rates_rad_s: ArrayLike) -> Floats:
    """Angular velocity of the principal axes relative to the ICRF, in principal axes, rad/s, shape (..., 3).

    It follows from the Euler angles and their rates, shape (..., 3) each.
    """
    _, theta, psi = _three_components(angles_rad, "rad", "angles_rad")
    phi_rate, theta_rate, psi_rate = _three_components(rates_rad_s, "rad / s", "rates_rad_s")
    return np.stack(
        [
            phi_rate * np.sin(theta) * np.sin(psi) + theta_rate * np.cos(psi),
            phi_rate * np.sin(theta) * np.cos(psi) - theta_rate * np.sin(psi),
            phi_rate * np.cos(theta) + psi_rate,
        ],
        axis=-1,
    )


def rot_icrf_to_pa_rate(angles_rad: ArrayLike, rates_rad_s: ArrayLike) -> Floats:
    """Time derivative of :func:`rot_icrf_to_pa`, -[w] R with the angular velocity w, 1/s, shape (..., 3, 3)."""
    return -vectors.cross_matrices(angular_velocity_pa(angles_rad, rates_rad_s)) @ rot_icrf_to_pa(angles_rad)


def rot_pa_to_me(constants: EphemerisConstants) -> Floats:
    """Rotation from the principal to the mean-Earth axes of an ephemeris, Rx Ry Rz of constant angles, shape (3, 3).

    With DE421's angles the coordinates of a point on the surface change by up to 875 m (the literature often quotes
    860 m, from older angles). Frame kernels give the inverse, from ME to PA, as angles of opposite sign that are
    applied in reverse order.

    Examples
    --------
    >>> from radioloc.ephemeris import CONSTANTS
    >>> from radioloc.lunar import rot_pa_to_me
    >>> (rot_pa_to_me(CONSTANTS["DE421"]) @ [1737400.0, 0.0, 0.0]).round().tolist()
    [1737400.0, 572.0, -662.0]
    """
    about_x, about_y, about_z = (angle * ARCSEC_RAD for angle in constants.pa_to_me_arcsec)
    return np.asarray(erfa.rx(about_x, erfa.ry(about_y, erfa.rz(about_z, np.eye(3)))))


def rot_icrf_to_me(tdb: Epochs) -> Floats:
    """Rotation from the ICRF (J2000) to ME_DE421, the axes of lunar maps, at epochs of TDB, shape (n, 3, 3)."""
    return rot_pa_to_me(CONSTANTS["DE421"]) @ rot_icrf_to_pa(LunarOrientation.open("DE421").angles(tdb)[0])


# Archinal et al. (2011), table 2, Moon (NAIF's pck00010.tpc and pck00011.tpc); the WGCCRE report of 2015
# (Archinal et al. 2018) recommends the ephemeris instead and gives no newer series.
_IAU_POLE_RA_DEG = (269.9949, 0.0031)  # at J2000; change per century
_IAU_POLE_DEC_DEG = (66.5392, 0.0130)
_IAU_PRIME_MERIDIAN_DEG = (38.3213, 13.17635815, -1.4e-12)  # at J2000; per day; per day^2
# Degrees; rates of the arguments per day. Columns: argument, its rate, amplitudes in pole RA (sine), pole declination
# (cosine), prime meridian (sine).
_IAU_TERMS = np.array(
    [
        [125.045, -0.0529921, -3.8787, 1.5419, 3.5610],
        [250.089, -0.1059842, -0.1204, 0.0239, 0.1208],
        [260.008, 13.0120009, 0.0700, -0.0278, -0.0642],
        [176.625, 13.3407154, -0.0172, 0.0068, 0.0158],
        [357.529, 0.9856003, 0.0, 0.0, 0.0252],
        [311.589, 26.4057084, 0.0072, -0.0029, -0.0066],
        [134.963, 13.0649930, 0.0, 0.0009, -0.0047],
        [276.617, 0.3287146, 0.0, 0.0, -0.0046],
        [34.226, 1.7484877, 0.0, 0.0, 0.0028],
        [15.134, -0.1589763, -0.0052, 0.0008, 0.0052],
        [119.743, 0.0036096, 0.0, 0.0, 0.0040],
        [239.961, 0.1643573, 0.0, 0.0, 0.0019],
        [25.053, 12.9590088, 0.0043, -0.0009, -0.0044],
    ]
)


@accepts_quantities
def rot_icrf_to_iau_moon(tdb: EpochsLike) -> Floats:
    """Rotation from the ICRF to the axes of the IAU rotation model of the Moon, SPICE's IAU_MOON, shape (n, 3, 3).

    Rz(W) Rx(90 deg - delta) Rz(90 deg + alpha) of the pole's right ascension alpha and declination delta and the prime
    meridian W (Archinal et al. 2011, table 2) at epochs of TDB. On the surface the axes are up to 155 m from ME_DE421;
    they are for comparison with data given in them, not for tracking.

    Examples
    --------
    >>> from radioloc.lunar import rot_icrf_to_iau_moon
    >>> from radioloc.time import epochs_from_strings
    >>> rot_icrf_to_iau_moon(epochs_from_strings("2020-12-01", "TDB")).shape
    (1, 3, 3)
    """
    tdb.require("TDB")
    days = (tdb.jd - J2000_JD) + tdb.fraction
    centuries = days / 36525.0
    arguments = np.radians(_IAU_TERMS[:, 0] + np.multiply.outer(days, _IAU_TERMS[:, 1]))
    sines, cosines = np.sin(arguments), np.cos(arguments)
    pole_ra_deg = polyval(centuries, _IAU_POLE_RA_DEG) + sines @ _IAU_TERMS[:, 2]
    pole_dec_deg = polyval(centuries, _IAU_POLE_DEC_DEG) + cosines @ _IAU_TERMS[:, 3]
    prime_meridian_deg = polyval(days, _IAU_PRIME_MERIDIAN_DEG) % 360.0 + sines @ _IAU_TERMS[:, 4]
    euler_deg = np.stack([90.0 + pole_ra_deg, 90.0 - pole_dec_deg, prime_meridian_deg], axis=-1)
    return rot_icrf_to_pa(np.radians(euler_deg))


def _three_components(values: ArrayLike, unit: str, name: str) -> Floats:
    """Return values (..., 3), or quantities of the same dimension, as an array (3, ...) in a unit."""
    array = as_float_array(values, unit, name)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InputError(f"{name}: expected shape (..., 3), got {array.shape}")
    return np.moveaxis(array, -1, 0)
