"""Effects of errors of the simulated world on the observations, against independent formulas and models."""

import numpy as np
import pytest

from radioloc import Study
from radioloc.constants import C_M_S
from radioloc.jobs.prepared_trials import Prepared
from radioloc.simulation import (
    Masks,
    Scenario,
    Schedule,
    Session,
    Truth,
    TruthSigma,
    baselines,
    two_way,
)

START, STOP = "2020-12-01T15:11", "2020-12-02T15:11"
# Changes of 10 m or less: second order is 10 m / 4e8 m of them, light-time cut-offs and rounding 1e-6 m.
TOLERANCE_M = 1e-5
RADIO = {"uplink_hz": 7.2e9, "wavelength_um": 35394.6}


@pytest.fixture(scope="module")
def schedule():
    return Schedule(
        [
            Session(
                "range",
                (*two_way("JIAMUSI", "KASHI", "NEUQUEN"), ("JIAMUSI", "KASHI")),
                START,
                STOP,
                3600,
                1.0,
                **RADIO,
            ),
            Session(
                "vlbi_delay", baselines("SESHAN25", "KUNMING", "URUMQI"), START, STOP, 3600, 1.0, **RADIO
            ),
            Session("doppler", (("JIAMUSI", "KASHI"),), START, STOP, 3600, 1.0, count_s=600.0, **RADIO),
        ],
        Masks(12.0),
    )


@pytest.fixture(scope="module")
def plain(schedule, lander, model):
    return Scenario(schedule, lander).world(model).draw()


@pytest.fixture(scope="module")
def change(schedule, lander, model, plain):
    """Compute the effect of a truth, m."""

    def effect_m(**errors):
        simulated = Scenario(schedule, lander, Truth(**errors)).world(model).draw()
        return simulated.observations.value_m - plain.observations.value_m

    return effect_m


def rows_of(simulated, kind):
    return simulated.observations.types() == kind


def test_clocks_shift_time_tags_and_times_of_flight(change, plain, lander_pa_m, compute, model):
    changed = change(
        clock_s={"KASHI": 2e-6, "URUMQI": -1e-6, "JIAMUSI": 3e-6},
        clock_rate_s_s={"JIAMUSI": 1e-11},
        clock_epoch_utc=START,
    )
    observations = plain.observations
    elapsed_s = (observations.epoch.mjd - observations.epoch.mjd[0]) * 86400.0
    errors = {
        "KASHI": 2e-6 + 0 * elapsed_s,
        "URUMQI": -1e-6 + 0 * elapsed_s,
        "JIAMUSI": 3e-6 + 1e-11 * elapsed_s,
    }
    first, second = (
        np.array(
            [
                errors.get(getattr(observations.links[i], end), 0 * elapsed_s)[row]
                for row, i in enumerate(observations.link)
            ]
        )
        for end in ("transmitter", "receiver")
    )
    delays, doppler = rows_of(plain, "vlbi_delay"), rows_of(plain, "doppler")
    by_time = compute(model, observations, lander_pa_m).by_time_m_s
    expected = -by_time * np.where(delays, first, second) + C_M_S * (second - first)
    # The clock of the transmitter, Jiamusi, gains 8 mm in the 2.57 s of flight.
    round_trips = np.array([link.transmitter == "JIAMUSI" for link in observations.links])[observations.link]
    expected += np.where(round_trips & ~doppler, C_M_S * 1e-11 * plain.observations.value_m / C_M_S, 0.0)
    expected[doppler] = (-by_time * second - C_M_S * 1e-11 * 600.0)[doppler]
    np.testing.assert_allclose(changed, expected, rtol=0.0, atol=TOLERANCE_M)
    assert np.abs(changed[doppler] + by_time[doppler] * 2e-6).min() > 1.0


@pytest.mark.parametrize("tag", ["transmit", "receive", "bounce"])
def test_clock_rate_lengthens_a_time_of_flight_for_each_time_tag(tag, lander, lander_pa_m, compute, model):
    schedule = Schedule(
        [Session("range", two_way("KASHI"), START, "2020-12-01T16:11", 3600, 1.0, time_tag=tag)]
    )
    plain = Scenario(schedule, lander).world(model).draw().observations
    truth = Truth(clock_rate_s_s={"KASHI": 1e-9}, clock_epoch_utc=START)
    drifting = Scenario(schedule, lander, truth).world(model).draw()
    since_s = (plain.epoch.mjd - plain.epoch.mjd[0]) * 86400.0
    moved_m = compute(model, plain, lander_pa_m).by_time_m_s * 1e-9 * since_s * (tag != "bounce")
    np.testing.assert_allclose(drifting.added_m["clock_rate"], 1e-9 * plain.value_m - moved_m, rtol=1e-6)


def test_range_biases_apply_to_ranges_by_receiver(change, plain):
    changed = change(range_bias_m={"KS": 5.0, "NM": -7.0})
    receivers = np.array([link.receiver for link in plain.observations.links])[plain.observations.link]
    ranges = rows_of(plain, "range")
    expected = np.where(ranges & (receivers == "KASHI"), 5.0, 0.0)
    expected = np.where(ranges & (receivers == "NEUQUEN"), -7.0, expected)
    np.testing.assert_allclose(changed, expected, rtol=0.0, atol=2e-7)
    assert set(expected.tolist()) == {5.0, -7.0, 0.0}


def test_terms_are_switched_on_and_off(change, plain, lander_pa_m, predict_m, model):
    off = change(terms_off=["shapiro"])
    without_m = predict_m(model.without("shapiro"), plain.observations, lander_pa_m)
    np.testing.assert_array_equal(off, without_m - plain.observations.value_m)
    # The part of the Sun is 2 * 2954 m * (distance of the Moon over that of the Sun), 15 m.
    ranges = rows_of(plain, "range")
    assert off[ranges].min() > -17.0
    assert off[ranges].max() < -14.0
    world = Truth(terms_off=["shapiro", "subdaily_eop"]).model(model)
    assert world.terms == model.without("shapiro", "subdaily_eop").terms
    assert not world.earth.subdaily_tides
    restored = Truth(terms_on=["shapiro", "subdaily_eop"]).model(world)
    assert restored.terms == model.terms
    assert restored.earth.subdaily_tides


ALL = {
    "moon_position_m": (1.0, 1.0, 1.0),
    "libration_rad": (1e-7, 1e-7, 1e-7),
    "pole_rad": (1e-8, 1e-8),
    "ut1_s": 1e-4,
    "station_position_m": dict.fromkeys(("JIAMUSI", "NEUQUEN", "URUMQI"), (0.3, 0.3, 0.3)),
}


@pytest.fixture(scope="module")
def drawn(schedule, lander, model):
    sigma = TruthSigma(position_enu_m=(10.0, 10.0, 10.0), range_bias_m=5.0, clock_s=1e-8, **ALL)
    return Scenario(schedule, lander, truth_sigma=sigma).world(model).drawn


def test_drawn_errors_have_their_sigma(drawn):
    errors = np.array([drawn.draw(seed) for seed in range(400)]) / drawn.sigmas
    # The standard deviation of 400 unit normals is within 16 % (all but 1e-5).
    np.testing.assert_allclose(errors.std(axis=0), 1.0, atol=0.16)
    assert np.abs(np.corrcoef(errors.T) - np.eye(len(drawn.names))).max() < 0.25


def test_clocks_of_trials_and_fits_refer_to_one_epoch(lander, model):
    """A-priori sigmas of an offset and a rate at the middle of two days are another covariance at their start."""
    sessions = [Session("vlbi_delay", baselines("SESHAN25", "URUMQI"), START, STOP, 3600.0, 1.0)]
    sigma = TruthSigma(clock_s={"URUMQI": 1e-10}, clock_rate_s_s={"URUMQI": 1e-15})
    study = Study(target=lander, simulation=Scenario(Schedule(sessions), lander, truth_sigma=sigma))
    ready = Prepared.from_study(study, (6.0, 12.0))
    drawn = ready.world.drawn.rows(ready.rows)
    rates = drawn.partials[drawn.names.index("clock_rate.URUMQI")]
    for part in ready.parts:
        fitted = part.problem.model
        column = fitted.parameters.names.index("clock_rate.URUMQI")
        x = fitted.parameters.prior_values
        partials = fitted.linearize(x).partials(np.arange(len(part.rows)))[:, column]
        np.testing.assert_allclose(partials, rates[part.rows], rtol=0.0, atol=1e-3 * np.abs(rates).max())
