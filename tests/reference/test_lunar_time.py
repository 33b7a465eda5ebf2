"""TCL - TDB against published values, and against an integral that takes another way, with SPICE's states."""

import numpy as np
import pytest
import spiceypy
from moon_frame import PA_FRAME
from scipy.integrate import quad_vec

from radioloc.constants import C_M_S, L_B, SECONDS_PER_DAY
from radioloc.ephemeris import CONSTANTS, Ephemeris
from radioloc.errors import CoverageError, InputError
from radioloc.kernels import find_kernel
from radioloc.lunar import LunarPosition, tcl_minus_tdb
from radioloc.lunar.coordinate_time import _START, _tcl_minus_tcg
from radioloc.time import Epochs, epochs_from_strings, geocentric_tdb_minus_tt

# The series for TDB - TT, of 1990, is good to some nanoseconds in a decade and drifts by less than 1e-15.
SERIES_S = 30e-9
# Nodes of the integral differ from call to call.
ROUNDING_S = 1e-12
# LTE440, Lu, Yang and Xie (2025), A&A 704, A76: the drift, and TCL - TDB at J2000.0 from the README of its files.
LTE440_DRIFT = 6.798355238e-10
LTE440_AT_J2000_S = 0.49330749643254945
LANDER = LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)


def days(first, last, step):
    return Epochs.from_jd(2451545.0, np.arange(first, last, step), "TDB")


@pytest.mark.parametrize("ephemeris", ["DE421", "DE440"])
def test_at_j2000_as_the_lunar_time_ephemeris_has_it(ephemeris):
    found_s = tcl_minus_tdb(days(0, 1, 1), ephemeris=ephemeris)
    assert found_s == pytest.approx(LTE440_AT_J2000_S, abs=SERIES_S)


def test_alike_in_1977():
    """All coordinate times are at the origin, when TT is 1977-01-01T00:00:32.184 and TDB 65.5 us less."""
    assert _tcl_minus_tcg(Ephemeris.open(), _START) == pytest.approx(0.0, abs=1e-12)
    origin = Epochs.from_jd(2443144.5, 0.0003725 - 65.5e-6 / SECONDS_PER_DAY, "TDB")
    # The annual term of TDB - TT apart, which then was not at its mean.
    assert tcl_minus_tdb(origin) == pytest.approx(-geocentric_tdb_minus_tt(origin), abs=1e-10)


def test_mean_drift_and_largest_terms():
    tdb = days(-8400, 18200, 2.5)
    found_s = tcl_minus_tdb(tdb)
    t = tdb.centuries_since_j2000() * 36525.0
    # Periods in days of what is larger than 1 us.
    periods = [
        365.2596,
        29.5306,
        398.88,
        182.6298,
        4332.6,
        583.92,
        399.0,
        14.7653,
        10746.1,
        779.9,
        27.2122,
        30686.3,
    ]
    columns = [np.ones_like(t), t * SECONDS_PER_DAY]
    for period in periods:
        columns += [np.cos(2.0 * np.pi * t / period), np.sin(2.0 * np.pi * t / period)]
    fitted = np.linalg.lstsq(np.stack(columns, axis=-1), found_s, rcond=None)[0]
    assert fitted[1] == pytest.approx(LTE440_DRIFT, abs=2e-14)
    assert fitted[1] * SECONDS_PER_DAY == pytest.approx(58.74e-6, abs=0.01e-6)
    # The annual one falls by 4 us a century, with the eccentricity; that of LTE440 is a mean of eleven centuries.
    assert np.hypot(*fitted[2:4]) == pytest.approx(1651e-6, abs=6e-6)
    assert np.hypot(*fitted[4:6]) == pytest.approx(126e-6, abs=1e-6)
    # A clock at rest on the selenoid, of the potential 2821713.3 m2/s2, gains on one on the geoid 56.0256 us a day:
    # Turyshev, Williams, Boggs and Park (2025), arXiv 2406.16147.
    on_selenoid = fitted[1] - 2821713.3 / C_M_S**2
    assert on_selenoid * SECONDS_PER_DAY == pytest.approx(56.0256e-6, abs=0.001e-6)


@pytest.fixture(scope="module")
def spice(tmp_path_factory):
    frames = tmp_path_factory.mktemp("frames") / "moon.tf"
    frames.write_text(PA_FRAME)
    for path in (find_kernel("DE421", "SPK"), find_kernel("DE421", "PCK"), frames):
        spiceypy.furnsh(str(path))
    yield
    spiceypy.kclear()


# Gravitational parameters, m^3/s^2, and mean distances from the Moon, m, of bodies that the kernels lack.
DISTANT_BODIES = {
    "mercury": (2.2e13, 1.6e11),
    "mars": (4.28e13, 2.5e11),
    "uranus": (5.79e15, 2.87e12),
    "neptune": (6.84e15, 4.50e12),
}


def test_against_the_definition(spice):
    """d(TCL)/d(TCB) = 1 - (v^2/2 + U)/c^2 itself, integrated over two months; TCB ticks by 1 - L_B against TDB."""
    constants = CONSTANTS["DE421"]
    bodies = {"10": "sun", "399": "earth", "2": "venus", "5": "jupiter", "6": "saturn"}

    def rate(et_s):
        state = 1e3 * np.array(spiceypy.spkssb(301, et_s, "J2000"))
        potential = 0.5 * state[3:] @ state[3:] + sum(
            gm / distance_m for gm, distance_m in DISTANT_BODIES.values()
        )
        for code, name in bodies.items():
            away_m = 1e3 * np.linalg.norm(spiceypy.spkpos(code, et_s, "J2000", "NONE", "301")[0])
            potential += constants.gm_m3_s2(name) / away_m
        return np.array([(L_B - potential / C_M_S**2) / (1.0 - L_B)])

    start_s = 650_000_000.0
    for length_d in (11.0, 60.0):
        end_s = start_s + length_d * SECONDS_PER_DAY
        integral_s = quad_vec(
            rate, start_s, end_s, epsabs=1e-13, points=np.linspace(start_s, end_s, 12)[1:-1]
        )[0][0]
        ends_s = tcl_minus_tdb(Epochs.from_tdb_seconds([start_s, end_s]))
        # Distances of the far ones vary; so 1e-14 of the time.
        assert ends_s[1] - ends_s[0] == pytest.approx(integral_s, abs=1e-14 * (end_s - start_s))


def test_at_a_place(spice):
    et_s = np.array([6.5e8, 6.6e8, 6.71e8])
    at = Epochs.from_tdb_seconds(et_s)
    offset_s = tcl_minus_tdb(at, LANDER) - tcl_minus_tdb(at)
    for et, found_s in zip(et_s, offset_s, strict=True):
        velocity_m_s = 1e3 * np.array(spiceypy.spkssb(301, et, "J2000"))[3:]
        place_m = spiceypy.pxform("MOON_PA_DE421", "J2000", et) @ LANDER.to_frame("PA_DE421").xyz_m
        assert found_s == pytest.approx(-velocity_m_s @ place_m / C_M_S**2, abs=1e-15)
    assert np.abs(offset_s).max() < 0.6e-6
    # A place in axes of the other ephemeris is a decimetre off, 3e-14 s.
    other_s = tcl_minus_tdb(at, LANDER, "DE440") - tcl_minus_tdb(at, ephemeris="DE440")
    assert other_s == pytest.approx(offset_s, abs=2e-13)


@pytest.mark.study
def test_any_order_and_number_of_epochs_and_what_an_ephemeris_does_not_hold():
    dates = epochs_from_strings(["2031-05-05", "1992-01-01", "2000-01-01T12:00:00"], "TDB")
    one_by_one = [tcl_minus_tdb(dates[k])[0] for k in range(3)]
    assert tcl_minus_tdb(dates) == pytest.approx(one_by_one, abs=ROUNDING_S)
    assert tcl_minus_tdb(dates.to_time()) == pytest.approx(one_by_one, abs=ROUNDING_S)
    assert tcl_minus_tdb(dates[[]]).shape == (0,)
    with pytest.raises(CoverageError, match="1989"):
        tcl_minus_tdb(epochs_from_strings("1989-01-01", "TDB"), ephemeris="DE440")
    with pytest.raises(InputError, match="ME_DE430"):
        tcl_minus_tdb(dates, LunarPosition("ME_DE430", LANDER.xyz_m))
