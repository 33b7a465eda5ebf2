"""Solid tide of the Moon: displacement of points of its surface by the Earth and the Sun.

The Earth is nearly fixed in the lunar sky, so most of the tide is constant: with h2 = 0.038, 0.49 m up
under the Earth and 0.24 m down on the great circle 90 degrees away. Its variation of up to 0.2 m, mostly
within a month, follows the distance of the Earth and the librations.

IERS Conventions (2010), eq. 7.5, applied to the Moon (Williams and Boggs 2015, J. Geophys. Res. Planets 120, 689):
with the tide-raising tensor S, the sum of GM_j u_j u_j^T / R_j^3 over the Earth and the Sun, and the unit vector r of
the point, the displacement is

    (a^4 / GM_Moon) [ h2 (3/2 r.S r - 1/2 tr S) r + 3 l2 (S r - (r.S r) r) ]

with the mean radius a. The Sun's part is at most 3 mm. Neglected are degree 3 (R/a = 1/221 of degree 2 and a Love
number about half as large: 1.5 mm, of which all but some 0.4 mm is constant) and the lag by dissipation (quality factor
about 38 at a month: up to 3 mm).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.ephemeris import EphemerisConstants
from radioloc.lunar.frames import rot_pa_to_me
from radioloc.vectors import Floats, dot, length, normalized

# Mean of (a / R)^3 u u^T for the direction u and distance R of the Earth and the Sun, in mean-Earth axes over
# four nodal periods of 18.6 years from 1969 (DE421); elements off the diagonal, below 2e-4, are 0.2 mm of
# displacement.
_EARTH_DISTANCE_M = 384399.0e3
_EARTH_MEAN = np.diag([0.991596, 0.006339, 0.006820])
_SUN_DISTANCE_M = 149597870.7e3
_SUN_MEAN = np.diag([0.500034, 0.500059, 0.000363])


def solid_tide(
    point_pa_m: Floats,
    earth_pa_m: Floats,
    sun_pa_m: Floats,
    constants: EphemerisConstants,
    permanent: Literal["included", "removed"] = "included",
) -> Floats:
    """Displacement of surface points, (3,) or (n, 3), by the degree-2 solid tide, principal axes, m, (n, 3)."""
    # Earth and Sun are Moon-centred, principal axes, m, (n, 3). With the permanent tide "removed", its
    # mean over many years, 0.49 m at most, is part of the coordinates; else these are of a Moon free of tides.
    up = normalized(np.atleast_2d(point_pa_m))
    bodies = ((constants.gm_earth_m3_s2, earth_pa_m), (constants.gm_sun_m3_s2, sun_pa_m))
    # S r and the trace of S.
    pull, trace = np.zeros((1, 3)), np.zeros((1, 1))
    for gm_m3_s2, place_m in bodies:
        unit, strength = normalized(place_m), (gm_m3_s2 / length(place_m) ** 3)[:, np.newaxis]
        pull = pull + strength * dot(unit, up)[:, np.newaxis] * unit
        trace = trace + strength
    if permanent == "removed":
        to_me = rot_pa_to_me(constants)
        # Mean tide-raising tensor in mean-Earth axes, 1/s^2.
        mean = constants.gm_earth_m3_s2 / _EARTH_DISTANCE_M**3 * _EARTH_MEAN
        mean = mean + constants.gm_sun_m3_s2 / _SUN_DISTANCE_M**3 * _SUN_MEAN
        mean = to_me.T @ mean @ to_me
        pull, trace = pull - up @ mean, trace - np.trace(mean)
    along_up = dot(pull, up)[:, np.newaxis]
    radial = constants.h2 * (1.5 * along_up - 0.5 * trace) * up
    tangential = 3.0 * constants.l2 * (pull - along_up * up)
    return MEAN_LUNAR_RADIUS_M**4 / constants.gm_moon_m3_s2 * (radial + tangential)
