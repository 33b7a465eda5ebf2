"""Received frequencies in hertz, of one, two and three ways, ramped and differenced, against two other computations.

In the geocentric frame (``geocentric_formulation``) stations' clocks are the coordinate time, so that cycles are
counted where the path says they were sent, and the target's clock has its proper time there. And in 40 digits
(``forty_digits``), for a spacecraft whose orbit is a formula.
"""

import mpmath as mp
import numpy as np
import pytest
from arc_cases import observed_at
from forty_digits import DIGITS, FortyDigits, mpf
from geocentric_formulation import GeocentricFormulation
from spk_files import ORBITER, START_S, low_lunar_orbit, write_states

from radioloc.constants import C_M_S
from radioloc.ephemeris import Trajectory
from radioloc.lunar.position import LunarPosition
from radioloc.measurements import (
    ExactPredictor,
    FixedPoint,
    Link,
    PhysicalModel,
    Ramps,
    prepare_predictor,
)
from radioloc.measurements.physical_model import TERMS
from radioloc.time import Epochs, tai_to_utc, utc_to_tt

HZ, RANGE_M = 1e-5, 1e-3
"""What formulations have to agree within, of a count of a minute at X band."""
CONSTRUCTED_HZ = 1e-4
"""Of a count of ten seconds, from 40 digits."""

F0_HZ, RATIO = 7.2e9, 880.0 / 749.0
BEACON_HZ = 8.4e9
COUNT_S = 60.0
COMPARED = {
    "shapiro",
    "tdb_tt",
    "earth_scale",
    "earth_lorentz",
    "lunar_scale",
    "lunar_lorentz",
    "subdaily_eop",
}
START = Epochs.from_jd(2459185.5, 0.6, "TAI")
SINCE_S = np.linspace(0.0, 86400.0, 25)
TAI = START[np.zeros(len(SINCE_S), dtype=int)].shifted(SINCE_S)

# Pieces of a quarter of an hour, with steps between them, in seconds from the start.
_DRAWN = np.random.default_rng(5)
PIECES = [
    (-900.0 + 900.0 * k, F0_HZ + _DRAWN.uniform(-1e5, 1e5), _DRAWN.uniform(-50.0, 50.0)) for k in range(99)
]


def utc(since_s):
    return tai_to_utc(START[np.zeros(np.size(since_s), dtype=int)].shifted(since_s))


def ramps_of(station, pieces, length_s):
    start_s, frequency_hz, rate_hz_s = np.array(pieces).T
    names = [station] * len(pieces)
    return Ramps.from_columns(names, utc(start_s), utc(start_s + length_s), frequency_hz, rate_hz_s)


def excess_cycles(first_s, last_s):
    """Cycles beyond those of the reference frequency between two times: what each piece has of them."""
    cycles = np.zeros(len(first_s))
    for start_s, frequency_hz, rate_hz_s in PIECES:
        begin_s, end_s = np.maximum(first_s, start_s), np.minimum(last_s, start_s + 900.0)
        middle_s = 0.5 * (begin_s + end_s) - start_s
        covered = end_s > begin_s
        cycles += np.where(covered, (frequency_hz - F0_HZ + rate_hz_s * middle_s) * (end_s - begin_s), 0.0)
    return cycles


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build(off=set(TERMS) - COMPARED - {"target_proper_time"})


@pytest.fixture(scope="module")
def point_pa_m(model):
    return (
        LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
        .to_axes("PA", model.ephemeris.constants)
        .xyz_m
    )


@pytest.fixture(scope="module")
def geocentric(model, point_pa_m):
    """Return delays at the ends of the counts and at the tags."""
    return {
        shift_s: GeocentricFormulation(
            model.ephemeris,
            model.libration,
            model.earth,
            utc_to_tt(tai_to_utc(TAI.shifted(shift_s))),
            point_pa_m,
        )
        for shift_s in (-0.5 * COUNT_S, 0.0, 0.5 * COUNT_S)
    }


def ours_m(model, point_pa_m, kind, path, **keys):
    counted = kind.endswith("doppler")
    observations = observed_at(TAI, path, kind=kind, count_s=COUNT_S if counted else np.nan, **keys)
    return prepare_predictor(model, observations, FixedPoint(point_pa_m), "exact").compute().value_m


RAMPED = {"ramped": True, "uplink_hz": F0_HZ}


@pytest.mark.parametrize("path", ["KASHI>lander>KASHI", "KASHI>lander>JIAMUSI", "NEUQUEN>lander>KASHI"])
def test_ramped_doppler(model, point_pa_m, geocentric, path):
    link = Link.from_path(path)
    places_m = [model.catalogue[name].itrf_m for name in (link.transmitter, link.receiver)]
    early_m, late_m = (
        geocentric[shift_s].range_m(*places_m, "receive") for shift_s in (-0.5 * COUNT_S, 0.5 * COUNT_S)
    )
    sent_s = SINCE_S - 0.5 * COUNT_S - early_m / C_M_S
    for_s = COUNT_S - (late_m - early_m) / C_M_S
    # F Tc = M times the cycles sent; here less those of the reference frequency in Tc.
    cycles = excess_cycles(sent_s, sent_s + for_s) - F0_HZ * (late_m - early_m) / C_M_S
    ramps = ramps_of(link.transmitter, PIECES, 900.0)
    value_m = ours_m(model, point_pa_m, "doppler", path, ramps=ramps, **RAMPED)
    our_cycles = -F0_HZ * value_m / C_M_S
    assert np.abs(RATIO * (our_cycles - cycles) / COUNT_S).max() < HZ
    assert np.abs(cycles).max() > 1e6


def test_ramped_range(model, point_pa_m, geocentric):
    place_m = model.catalogue["KASHI"].itrf_m
    range_m = geocentric[0.0].range_m(place_m, place_m, "receive")
    expected_m = range_m + C_M_S / F0_HZ * excess_cycles(SINCE_S - range_m / C_M_S, SINCE_S)
    ramps = ramps_of("KASHI", PIECES, 900.0)
    value_m = ours_m(model, point_pa_m, "range", "KASHI>lander>KASHI", ramps=ramps, **RAMPED)
    assert np.abs(value_m - expected_m).max() < RANGE_M
    assert np.abs(value_m - range_m).max() > 1000.0


@pytest.mark.parametrize("path", ["KASHI>lander>KASHI", "KASHI>lander>NEUQUEN"])
def test_doppler_at_one_frequency(model, point_pa_m, geocentric, path):
    link = Link.from_path(path)
    places_m = [model.catalogue[name].itrf_m for name in (link.transmitter, link.receiver)]
    early_m, late_m = (
        geocentric[shift_s].range_m(*places_m, "receive") for shift_s in (-0.5 * COUNT_S, 0.5 * COUNT_S)
    )
    apart_m = ours_m(model, point_pa_m, "doppler", path) - (late_m - early_m)
    assert np.abs(RATIO * F0_HZ * apart_m / C_M_S / COUNT_S).max() < HZ


def by_own_clock_m(model, geocentric, station, shift_s):
    """Return one-way times at shifted tags; the clock is set once for all of them."""
    since = utc_to_tt(tai_to_utc(START))
    return geocentric[shift_s].one_way_by_own_clock_m(model.catalogue[station].itrf_m, since)


def grown_m(model, geocentric, station):
    early_m, late_m = (
        by_own_clock_m(model, geocentric, station, shift_s) for shift_s in (-0.5 * COUNT_S, 0.5 * COUNT_S)
    )
    return late_m - early_m


def test_one_way_doppler_by_the_targets_oscillator(model, point_pa_m, geocentric):
    apart_m = ours_m(model, point_pa_m, "one_way_doppler", "lander>KASHI") - grown_m(
        model, geocentric, "KASHI"
    )
    assert np.abs(BEACON_HZ * apart_m / C_M_S / COUNT_S).max() < HZ


def test_differenced_one_way_doppler_and_range(model, point_pa_m, geocentric):
    apart_m = ours_m(model, point_pa_m, "differenced_doppler", "KASHI<lander>NEUQUEN") - (
        grown_m(model, geocentric, "NEUQUEN") - grown_m(model, geocentric, "KASHI")
    )
    assert np.abs(BEACON_HZ * apart_m / C_M_S / COUNT_S).max() < HZ
    apart_m = ours_m(model, point_pa_m, "differenced_range", "KASHI<lander>NEUQUEN") - (
        by_own_clock_m(model, geocentric, "NEUQUEN", 0.0) - by_own_clock_m(model, geocentric, "KASHI", 0.0)
    )
    assert np.abs(apart_m).max() < RANGE_M


class CraftInFortyDigits(FortyDigits):
    """A circular orbit about the Moon, in place of the point on it."""

    def reflector(self, pa_m, t):
        return self.body(301, t)[0] + self.orbit_m(t - mpf(START_S))

    def orbit_m(self, since_s):
        """Return the state of ``spk_files.circular``."""
        radius_m = 1737.4e3 + 100e3
        angle = mpf(np.sqrt(self.constants.gm_moon_m3_s2 / radius_m**3)) * since_s
        i, node = mpf(np.radians(85.0)), mpf(np.radians(40.0))
        node_axis = mp.matrix([mp.cos(node), mp.sin(node), 0])
        across = mp.matrix([-mp.sin(node) * mp.cos(i), mp.cos(node) * mp.cos(i), mp.sin(i)])
        return mpf(radius_m) * (mp.cos(angle) * node_axis + mp.sin(angle) * across)


SHORT_S = 10.0
# Two ramps that meet while the count's signal is sent, and one after them.
THREE = ((-100.0, 7.2e9 + 123.5, 137.25), (98.0, 7.2e9 + 27299.0, -88.5), (400.0, 7.2e9 + 572.0, 3.0))


@pytest.mark.parametrize("receiver", ["KASHI", "JIAMUSI"])
def test_constructed_doppler_with_ramps(tmp_path, receiver):
    """The cycles that are received, from the phase sent at transmissions that 40 digits give."""
    model = PhysicalModel.build(off=set(TERMS) - {"tdb_tt", "earth_scale", "earth_lorentz", "subdaily_eop"})
    file = write_states(tmp_path / "orbiter.bsp", low_lunar_orbit(model.ephemeris))
    tag_s = 103.0
    since_s = 7 * 3600.0
    start = Epochs.from_jd(2459185.5, since_s / 86400.0, "TAI")
    pieces = [
        (start.shifted(begin_s), start.shifted(end_s), f_hz, rate)
        for (begin_s, f_hz, rate), end_s in zip(THREE, (98.0, 400.0, 900.0), strict=True)
    ]
    ramps = Ramps.from_columns(
        ["KASHI"] * 3,
        tai_to_utc(Epochs.concatenate([piece[0] for piece in pieces])),
        tai_to_utc(Epochs.concatenate([piece[1] for piece in pieces])),
        np.array([piece[2] for piece in pieces]),
        np.array([piece[3] for piece in pieces]),
    )
    observations = observed_at(
        start.shifted(tag_s),
        Link("KASHI", "x", receiver),
        kind="doppler",
        count_s=SHORT_S,
        uplink_hz=F0_HZ,
        ramped=True,
        ramps=ramps,
    )
    trajectory = Trajectory.open(file, ORBITER)
    value_m = ExactPredictor(model, observations, trajectory).compute().value_m[0]
    with mp.workdps(DIGITS):
        craft = CraftInFortyDigits(model.terms)
        places_m = [model.catalogue[name].itrf_m for name in ("KASHI", receiver)]
        ends_s = [tag_s - 0.5 * SHORT_S, tag_s + 0.5 * SHORT_S]
        tags = [utc_to_tt(tai_to_utc(start.shifted(end_s))) for end_s in ends_s]
        flight_s = [craft.value_m(*places_m, None, "receive", tag) / mpf(C_M_S) for tag in tags]
        sent_s = [mpf(end_s) - flight for end_s, flight in zip(ends_s, flight_s, strict=True)]
        assert sent_s[0] < 98 < sent_s[1]
        received_hz = mpf(880) / 749 * (phase(sent_s[1]) - phase(sent_s[0])) / mpf(SHORT_S)
        ours_hz = mpf(880) / 749 * mpf(F0_HZ) * (1 - mpf(value_m) / (mpf(C_M_S) * mpf(SHORT_S)))
        assert abs(float(ours_hz - received_hz)) < CONSTRUCTED_HZ


def phase(until_s):
    """Cycles sent from the first ramp's beginning on."""
    cycles = mp.mpf(0)
    for (begin_s, f_hz, rate), end_s in zip(THREE, (98.0, 400.0, 900.0), strict=True):
        lasts = min(until_s, mpf(end_s)) - mpf(begin_s)
        if lasts > 0:
            cycles += mpf(f_hz) * lasts + mpf(rate) * lasts**2 / 2
    return cycles
