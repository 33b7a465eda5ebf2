"""Clock of the target: its rate on the Moon and in orbit, and its effect on one-way measurements.

The lander's clock is compared with proper time in the geocentric frame in ``test_geocentric_formulation``.
"""

import numpy as np
import pytest
from arc_cases import APOLLO15_PA_M, epochs_tai, observations
from spk_files import ORBITER, START_S, lander, low_lunar_orbit, write_states

from radioloc.constants import C_M_S
from radioloc.ephemeris import Trajectory
from radioloc.errors import CoverageError
from radioloc.measurements import ExactPredictor, FixedPoint, PhysicalModel
from radioloc.measurements.proper_time import clock_epoch, target_clock
from radioloc.time import Epochs, tai_to_utc

ORIGIN_M = np.zeros(3)
SAME_M = 2e-6
HOUR_S = 3600.0


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build().without("troposphere")


@pytest.fixture(scope="module")
def orbiter(model, tmp_path_factory):
    file = tmp_path_factory.mktemp("spk") / "orbiter.bsp"
    return Trajectory.open(write_states(file, low_lunar_orbit(model.ephemeris)), ORBITER)


def one_way(tai, kind="one_way_range", tag="receive", count_s=np.nan):
    return observations("x>KASHI", tai, tag, kind=kind, count_s=count_s)


def values_m(model, table, at_m=APOLLO15_PA_M, trajectory=None):
    motion = FixedPoint(at_m) if trajectory is None else trajectory
    return ExactPredictor(model, table, motion).compute().value_m


def gained_s(model, tdb, radius_m=1737.4e3, trajectory=None):
    selected = np.ones(len(tdb), dtype=bool)
    clock = target_clock(model, tdb, selected, np.full(len(tdb), radius_m), tdb[:1], trajectory)
    return clock.offset_s - clock.offset_s[0], clock.rate


def test_clock_on_the_moon_gains_56_microseconds_a_day(model):
    """Ashby and Patla (2024, Astron. J. 168, 112): 56.0199 a day at the selenoid, against a clock on the geoid."""
    months, count = 13 * 27.554550, 4000
    tdb = Epochs.from_jd(2459185.5, np.linspace(0.0, months, count), "TDB")
    gained, rate = gained_s(model, tdb, 1738.1e3)
    slope_s_d = np.polynomial.Polynomial.fit(np.linspace(0.0, months, count), gained, 1).deriv()(0.0)
    # The Moon's orbit is not the Keplerian one of that paper, and 130 microseconds are periodic with the month.
    assert slope_s_d == pytest.approx(56.02e-6, abs=0.1e-6)
    assert np.allclose(np.diff(gained), 0.5 * (rate[1:] + rate[:-1]) * np.diff(tdb.mjd) * 86400.0, atol=1e-9)


def test_clock_in_a_circular_orbit(model, orbiter):
    """Compared with a clock at the Moon's centre its rate is lower by 3/2 GM / (r c^2), with periodic v.r / c^2."""
    tdb = Epochs.from_tdb_seconds(START_S + np.linspace(60.0, 12 * HOUR_S, 500))
    in_orbit, _ = gained_s(model, tdb, trajectory=orbiter)
    at_rest, _ = gained_s(model, tdb, 1e30)
    elapsed_s = tdb.seconds_since(tdb[:1])
    radius_m, gm = 1837.4e3, model.ephemeris.constants.gm_moon_m3_s2
    moon_m, moon_m_s = model.ephemeris.geocentric("moon", tdb)
    orbiter_m, _ = orbiter.geocentric(model.ephemeris, tdb)
    v_m_s = model.ephemeris.earth(tdb).velocity_m_s + moon_m_s
    periodic_s = np.einsum("ni,ni->n", v_m_s, orbiter_m - moon_m) / C_M_S**2
    expected_s = at_rest - 1.5 * gm / radius_m / C_M_S**2 * elapsed_s - (periodic_s - periodic_s[0])
    assert np.ptp(periodic_s) > 5e-7
    # Tides of the Earth and the Sun, 3e-16 of the time.
    assert np.abs(in_orbit - expected_s).max() < 2e-11


@pytest.mark.parametrize(("kind", "count_s"), [("one_way_range", np.nan), ("one_way_doppler", 60.0)])
def test_lander_and_its_trajectory_have_the_same_clock(model, tmp_path, kind, count_s):
    table = one_way(epochs_tai(20, 30.0, start_fraction=0.01), kind, count_s=count_s)
    surface = model.without("lunar_tide", "lunar_scale", "lunar_lorentz")
    file = write_states(tmp_path / "lander.bsp", lander(model.libration, APOLLO15_PA_M), step_s=600.0)
    trajectory = Trajectory.open(file, ORBITER)
    difference_m = values_m(model, table, ORIGIN_M, trajectory) - values_m(surface, table)
    if kind == "one_way_range":
        # The clocks are set at the time of the Moon's centre and of the lander, respectively.
        assert np.abs(difference_m).max() < 10.0
        difference_m = difference_m - difference_m[0]
        linear_m = np.linspace(difference_m[0], difference_m[-1], len(difference_m))
        assert np.abs(difference_m - linear_m).max() < 1e-4
    # Tide and rotation, which the lander's clock leaves out: 3.6e-16 of 30 hours at most.
    assert np.abs(difference_m).max() < 0.012
    assert np.ptp(values_m(surface, table) - values_m(surface.without("target_proper_time"), table)) > 1e-3


def test_counts_need_no_trajectory_between_passes(model, tmp_path):
    spans = ((START_S, START_S + 2 * HOUR_S), (START_S + 20 * HOUR_S, START_S + 22 * HOUR_S))
    file = write_states(tmp_path / "gap.bsp", low_lunar_orbit(model.ephemeris), spans_s=spans)
    gappy, full = (
        Trajectory.open(path, ORBITER)
        for path in (file, write_states(tmp_path / "all.bsp", low_lunar_orbit(model.ephemeris)))
    )
    first = epochs_tai(5, 1.0, start_fraction=0.01)
    tai = Epochs.concatenate([first, first.shifted(20 * HOUR_S)])
    counts = one_way(tai, "one_way_doppler", count_s=60.0)
    difference_m = values_m(model, counts, ORIGIN_M, gappy) - values_m(model, counts, ORIGIN_M, full)
    assert np.abs(difference_m).max() < SAME_M
    with pytest.raises(CoverageError, match="with gaps"):
        values_m(model, one_way(tai), ORIGIN_M, gappy)


def test_clock_is_set_at_the_start_of_the_first_day(orbiter):
    tai = epochs_tai(3, 30.0, start_fraction=0.6)
    [set_at] = tai_to_utc(tai[:1]).day_strings()
    assert clock_epoch(one_way(tai)).day_strings() == [set_at]
    # 0h UTC of 2 December is 69 s into the trajectory; the clock of the day before is set at its start.
    early = one_way(epochs_tai(3, 0.001, start_fraction=0.0005))
    assert clock_epoch(early, orbiter).seconds_since(Epochs.from_tdb_seconds(START_S)) == pytest.approx(
        69.183, abs=2e-3
    )
    assert clock_epoch(one_way(tai)[:0]) is None
