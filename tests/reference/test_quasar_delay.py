"""VLBI delays of quasars against the consensus model, and lander and quasars fitted together.

The consensus model is written here as the IERS Conventions have it, in the geocentric frame, with astropy's own
ephemeris of the Earth. Shared with the library is the rotation of the Earth, nothing of its light path.
"""

import dataclasses
import itertools

import numpy as np
import pytest
from arc_cases import observed_at
from astropy import units as u
from astropy.coordinates import get_body_barycentric_posvel

from radioloc.constants import C_M_S
from radioloc.measurements import TERMS, FixedPoint, Link, PhysicalModel, prepare_predictor
from radioloc.time import Epochs, tai_to_tt

STATIONS = ("SESHAN25", "KUNMING", "URUMQI", "MIYUN50")
# ICRF3 S/X (Charlot et al. 2020), to a milliarcsecond; here any places would do.
SOURCES_DEG = {
    "0059+581": (15.6906771, 58.4030935),
    "1741-038": (265.9952338, -3.8346158),
    "ecliptic": (250.0, -22.0),
}
COMPARED = {"shapiro", "tdb_tt", "earth_scale", "earth_lorentz"}
CONSENSUS_S = 1e-12
"""What the consensus model is made for (IERS Conventions 2010, section 11.1)."""
REACHED_S = 0.2e-12
SITE_M = np.array([1.55e6, 1.0e5, 7.65e5])

TAI = Epochs.from_jd(2459185.5, np.linspace(0.0, 1.0, 13)[:-1], "TAI")


def direction(right_ascension_deg, declination_deg):
    a, d = np.radians([right_ascension_deg, declination_deg])
    return np.array([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])


SOURCES = {name: direction(*place) for name, place in SOURCES_DEG.items()}


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build(sources=SOURCES, off=set(TERMS) - COMPARED)


def delays(model, links, tai=TAI, kind="vlbi_delay", count_s=np.nan):
    utc = Epochs.from_time(tai.to_time().utc)
    n = len(tai)
    observations = observed_at(
        Epochs(np.tile(utc.jd, len(links)), np.tile(utc.fraction, len(links)), "UTC"),
        links,
        link=np.repeat(np.arange(len(links)), n),
        sigma_m=0.01,
        kind=kind,
        wavelength_um=35394.6,
        count_s=count_s,
    )
    return prepare_predictor(model, observations, FixedPoint(SITE_M), "exact", more_partials=True)


def consensus_s(model, first_itrf_m, second_itrf_m, source, tai):
    """Equations 11.9 and 11.1 to 11.2; TT-compatible, as the places are."""
    time = tai.to_time()
    rotation = model.earth.evaluate(tai_to_tt(tai))
    x1, x2 = (rotation.rot_itrf_to_gcrs @ itrf_m for itrf_m in (first_itrf_m, second_itrf_m))
    w2 = rotation.rot_itrf_to_gcrs_rate @ second_itrf_m
    earth, velocity = get_body_barycentric_posvel("earth", time)
    sun, _ = get_body_barycentric_posvel("sun", time)
    v = velocity.xyz.to_value(u.m / u.s).T
    earth_m, sun_m = (body.xyz.to_value(u.m).T for body in (earth, sun))
    gm_sun, gm_earth = 1.32712440018e20, 3.986004356e14
    b, k = x2 - x1, source
    k_b, v_b, k_v, k_w = b @ k, np.sum(v * b, axis=1), v @ k, w2 @ k
    rough_s = -k_b / C_M_S
    gravity_s = np.zeros(len(b))
    for gm, body_m in ((gm_sun, sun_m), (gm_earth, None)):
        r1 = x1 if body_m is None else earth_m + x1 - body_m
        r2 = x2 if body_m is None else earth_m + v * rough_s[:, None] + x2 - body_m
        ends = [np.linalg.norm(r, axis=1) + r @ k for r in (r1, r2)]
        gravity_s += 2.0 * gm / C_M_S**3 * np.log(ends[0] / ends[1])
    potential = gm_sun / np.linalg.norm(earth_m - sun_m, axis=1)
    c2 = C_M_S**2
    scale = 1.0 - 2.0 * potential / c2 - np.sum(v * v, axis=1) / (2.0 * c2) - np.sum(v * w2, axis=1) / c2
    upper = gravity_s - k_b / C_M_S * scale - v_b / c2 * (1.0 + k_v / (2.0 * C_M_S))
    return upper / (1.0 + (k_v + k_w) / C_M_S)


@pytest.mark.parametrize("name", SOURCES)
@pytest.mark.parametrize(("first", "second"), list(itertools.combinations(STATIONS, 2)))
def test_delay_is_that_of_the_consensus_model(model, name, first, second):
    computed = delays(model, [Link(first, name, second, True)]).compute()
    places_m = (model.catalogue[station].itrf_m for station in (first, second))
    apart_s = computed.value_m / C_M_S - consensus_s(model, *places_m, SOURCES[name], TAI)
    assert np.abs(apart_s).max() < REACHED_S < CONSENSUS_S


@pytest.fixture(scope="module")
def every():
    return PhysicalModel.build(sources=SOURCES)


def test_partials_are_differences_of_the_model(every):
    """Partials by time, position of a station, clock of the tag, and air, for a source at infinity."""
    link = Link("KUNMING", "1741-038", "SESHAN25", True)
    tai = TAI[2:5]
    computed = delays(every, [link], tai).compute()
    assert computed.usable.all()
    step_s = 10.0
    late, early = (delays(every, [link], tai.shifted(s)).compute().value_m for s in (step_s, -step_s))
    assert computed.by_time_m_s == pytest.approx((late - early) / (2.0 * step_s), abs=1e-5)
    for end, name in enumerate(("KUNMING", "SESHAN25")):
        station = every.catalogue[name]
        for axis, step_m in enumerate(100.0 * np.eye(3)):
            forward, back = (
                delays(_with_station(every, station, station.itrf_m + sign * step_m), [link], tai)
                .compute()
                .value_m
                for sign in (1.0, -1.0)
            )
            # Of a station that is moved, air and tides are others: 1e-3 of it.
            assert computed.by_station_itrf[:, end, axis] == pytest.approx((forward - back) / 200.0, abs=2e-3)


def _with_station(model, station, itrf_m):
    catalogue = model.catalogue.with_station(dataclasses.replace(station, itrf_m=itrf_m))
    return dataclasses.replace(model, catalogue=catalogue)


def test_a_rate_is_the_change_of_the_delay(every):
    link = Link("KUNMING", "1741-038", "SESHAN25", True)
    tai = TAI[2:5]
    early, late = (delays(every, [link], tai.shifted(s)).compute().value_m for s in (-30.0, 30.0))
    rate = delays(every, [link], tai, "vlbi_delay_rate", count_s=60.0).compute()
    assert np.abs(rate.value_m - (late - early)).max() < 1e-6
    assert np.abs(rate.value_m).max() > 1000.0
