"""Gravitational delay against the formula in 40 digits and against its well-known sizes."""

import mpmath as mp
import numpy as np
import pytest

from radioloc.constants import C_M_S
from radioloc.ephemeris import CONSTANTS
from radioloc.measurements.light_path import gravitational_delay_m
from radioloc.vectors import length

AU_M, MOON_M = 1.495978707e11, 3.844e8
GM_SUN, GM_EARTH = CONSTANTS["DE421"].gm_sun_m3_s2, CONSTANTS["DE421"].gm_earth_m3_s2
# 2.9e3 m times the relative round-off of r1 + r2 - r12, some 1e-16 of 3e11 m against 3e11 m, is 1e-12 m.
ROUND_OFF_M = 1e-10


def delay_m(start_m, end_m, body_m, gm):
    r1, r2, r12 = length(start_m - body_m), length(end_m - body_m), length(end_m - start_m)
    return gravitational_delay_m(r1, r2, r12, gm)


def case(body_m, start_m=(0.0, 0.0, 0.0), end_m=(MOON_M, 0.0, 0.0)):
    return np.array([start_m]), np.array([end_m]), np.array([body_m])


CASES = {
    "sun aside": (case((0.0, AU_M, 0.0)), GM_SUN),
    "sun behind the moon": (case((AU_M, 1e7, 0.0)), GM_SUN),
    "sun behind the earth": (case((-AU_M, 0.0, 0.0)), GM_SUN),
    "earth, station below the moon": (case((-6.4e6, 0.0, 0.0)), GM_EARTH),
    "earth, moon at the horizon": (case((0.0, -6.4e6, 0.0)), GM_EARTH),
    "grazing the sun": (case((AU_M, 7e8, 0.0), end_m=(2 * AU_M, 0.0, 0.0)), GM_SUN),
}


def delay_to_40_digits(start_m, end_m, body_m, gm, bending=True):
    with mp.workdps(40):

        def distance(a, b):
            return mp.sqrt(sum((mp.mpf(float(x)) - mp.mpf(float(y))) ** 2 for x, y in zip(a, b, strict=True)))

        k = 2 * mp.mpf(gm) / mp.mpf(C_M_S) ** 2
        r1, r2, r12 = (
            distance(start_m[0], body_m[0]),
            distance(end_m[0], body_m[0]),
            distance(start_m[0], end_m[0]),
        )
        extra = k if bending else 0
        return float(k * mp.log((r1 + r2 + r12 + extra) / (r1 + r2 - r12 + extra)))


@pytest.mark.parametrize("name", [n for n in CASES if n != "grazing the sun"])
def test_against_40_digits(name):
    points, gm = CASES[name]
    assert delay_m(*points, gm) == pytest.approx([delay_to_40_digits(*points, gm)], rel=0, abs=ROUND_OFF_M)


def test_bending_matters_at_the_limb_of_the_sun():
    """Moyer: beside the Sun the bending shortens the delay by some 8 m of 35 km, which k in the logarithm gives."""
    points, gm = CASES["grazing the sun"]
    computed_m = float(delay_m(*points, gm)[0])
    # r1 + r2 - r12 is 3e6 m and rounded to 6e-5 m.
    assert computed_m == pytest.approx(delay_to_40_digits(*points, gm), abs=1e-6)
    assert 1.0 < delay_to_40_digits(*points, gm, bending=False) - computed_m < 10.0
