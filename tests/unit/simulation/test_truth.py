"""Each error of the simulated world does to the observations what it should, by independent reckoning."""

import numpy as np
import pytest
from offset_moon import changed_model

from radioloc.constants import C_M_S
from radioloc.errors import InputError, StationError
from radioloc.lunar.position import LunarPosition
from radioloc.simulation import (
    Masks,
    Scenario,
    Schedule,
    Session,
    Truth,
    TruthSigma,
    baselines,
    simulate,
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
    return simulate(schedule, lander, model=model)


@pytest.fixture(scope="module")
def change(schedule, lander, model, plain):
    """What a truth changes, m."""

    def of(**errors):
        made = simulate(schedule, lander, Truth(**errors), model=model)
        return made.observations.value_m - plain.observations.value_m

    return of


def of_kind(simulated, kind):
    return simulated.observations.types() == kind


# The directions leave out the motion in a light time: 2e-5 rad.


def test_clocks_shift_the_tag_and_the_times_of_flight(change, plain, lander_pa_m, compute, model):
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
    delays, doppler = of_kind(plain, "vlbi_delay"), of_kind(plain, "doppler")
    by_time = compute(model, observations, lander_pa_m).by_time_m_s
    expected = -by_time * np.where(delays, first, second) + C_M_S * (second - first)
    # In the 2.57 s of flight Jiamusi's clock, the sender's in all of these, gains 8 mm.
    two_ways = np.array([link.transmitter == "JIAMUSI" for link in observations.links])[observations.link]
    expected += np.where(two_ways & ~doppler, C_M_S * 1e-11 * plain.observations.value_m / C_M_S, 0.0)
    expected[doppler] = (-by_time * second - C_M_S * 1e-11 * 600.0)[doppler]
    np.testing.assert_allclose(changed, expected, rtol=0.0, atol=TOLERANCE_M)
    assert np.abs(changed[doppler] + by_time[doppler] * 2e-6).min() > 1.0


@pytest.mark.parametrize("tag", ["transmit", "receive", "bounce"])
def test_a_clocks_rate_lengthens_a_time_of_flight_whatever_the_tag(tag, lander, lander_pa_m, compute, model):
    schedule = Schedule(
        [Session("range", two_way("KASHI"), START, "2020-12-01T16:11", 3600, 1.0, time_tag=tag)]
    )
    plain = simulate(schedule, lander, model=model).observations
    other = simulate(schedule, lander, Truth(clock_rate_s_s={"KASHI": 1e-9}), model=model)
    since_s = (plain.epoch.mjd - plain.epoch.mjd[0]) * 86400.0
    moved_m = compute(model, plain, lander_pa_m).by_time_m_s * 1e-9 * since_s * (tag != "bounce")
    np.testing.assert_allclose(other.added_m["clock_rate"], 1e-9 * plain.value_m - moved_m, rtol=1e-6)


def test_biases_belong_to_the_receiver_and_to_ranges(change, plain):
    changed = change(range_bias_m={"KS": 5.0, "NM": -7.0})
    receivers = np.array([link.receiver for link in plain.observations.links])[plain.observations.link]
    ranges = of_kind(plain, "range")
    expected = np.where(ranges & (receivers == "KASHI"), 5.0, 0.0)
    expected = np.where(ranges & (receivers == "NEUQUEN"), -7.0, expected)
    np.testing.assert_allclose(changed, expected, rtol=0.0, atol=2e-7)
    assert set(expected.tolist()) == {5.0, -7.0, 0.0}


def test_terms_are_switched(change, plain, lander_pa_m, predict_m, model):
    off = change(terms_off=["shapiro"])
    without_m = predict_m(model.without("shapiro"), plain.observations, lander_pa_m)
    np.testing.assert_array_equal(off, without_m - plain.observations.value_m)
    # The Sun's alone is 2 * 2954 m * (distance of the Moon over that of the Sun), 15 m.
    ranges = of_kind(plain, "range")
    assert off[ranges].min() > -17.0
    assert off[ranges].max() < -14.0
    world = Truth(terms_off=["shapiro", "subdaily_eop"]).model(model)
    assert world.terms == model.without("shapiro", "subdaily_eop").terms
    assert not world.earth.subdaily_tides
    back = Truth(terms_on=["shapiro", "subdaily_eop"]).model(world)
    assert back.terms == model.terms
    assert back.earth.subdaily_tides


def test_truths_that_cannot_be(schedule, lander, model):
    with pytest.raises(InputError, match=r"clock_s: .* at most 0.01 s, .*the curvature of a range.* got 5.0"):
        Truth(clock_s=5.0)
    with pytest.raises(InputError, match=r"station_position_m: .* got -300.0"):
        Truth(station_position_m={"KASHI": (0.0, -300.0, 0.0)})
    with pytest.raises(InputError, match=r"ut1_s: expected a sigma .* got -1.0"):
        TruthSigma(ut1_s=-1.0)
    with pytest.raises(InputError, match=r"'range_bias': .*; did you mean 'range_bias_m'"):
        Truth(range_bias="all")
    with pytest.raises(InputError, match="'shapira' is not a term"):
        Truth(terms_off=["shapira"])
    with pytest.raises(StationError, match="KASHY"):
        simulate(schedule, lander, Truth(range_bias_m={"KASHY": 1.0}), model=model)
    no_frequency = Schedule([Session("range", two_way("KASHI"), START, STOP, 3600, 1.0)])
    with pytest.raises(InputError, match="give uplink_hz and wavelength_um"):
        simulate(no_frequency, lander, Truth(electron_content_tecu={"KASHI": 1.0}), model=model)
    with pytest.raises(InputError, match=r"zenith_delay: .* the term troposphere, which is switched off"):
        simulate(schedule, lander, Truth(zenith_delay_m=0.1), model=model)


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


@pytest.mark.parametrize("key", ALL)
def test_drawn_errors_are_what_other_models_do(key, drawn, plain, lander_pa_m, predict_m, model):
    """The nominal model's partials against models with the Moon, the Earth and the stations elsewhere."""
    name = key.rpartition("_")[0]
    components = {"moon_position_m": ("radial", "along", "normal"), "libration_rad": "xyz", "pole_rad": "xy"}
    given = ALL[key]
    by_station = given if isinstance(given, dict) else {"": given}
    for station, sizes in by_station.items():
        names = ("east", "north", "up") if station else components.get(key, ("",))
        for k, component in enumerate(names):
            one = tuple(np.eye(len(names))[k] * sizes) if len(names) > 1 else sizes
            changed = changed_model(model, **{key: {station: one} if station else one})
            changed_m = predict_m(changed, plain.observations, lander_pa_m) - plain.observations.value_m
            row = drawn.names.index(".".join(part for part in (name, station, component) if part))
            predicted_m = drawn.sigmas[row] * drawn.partials[row]
            # Tides feel the change, the pole tide most of all; rounding of ranges and epochs.
            atol = (3e-3 if name == "pole" else 3e-4) * np.abs(changed_m).max() + 3e-6
            np.testing.assert_allclose(predicted_m, changed_m, rtol=0.0, atol=atol, err_msg=component)
            assert np.abs(changed_m).max() > 1e-6


def test_a_drawn_position(drawn, plain, lander, predict_m, model):
    up = lander.xyz_m / np.linalg.norm(lander.xyz_m)
    higher = (
        LunarPosition(lander.frame, lander.xyz_m + 10.0 * up).to_axes("PA", model.ephemeris.constants).xyz_m
    )
    changed_m = predict_m(model, plain.observations, higher) - plain.observations.value_m
    row = drawn.names.index("position.up")
    np.testing.assert_allclose(drawn.sigmas[row] * drawn.partials[row], changed_m, rtol=0.0, atol=TOLERANCE_M)


def test_one_error_more_leaves_the_others(schedule, lander, model, drawn):
    few = (
        Scenario(schedule, lander, truth_sigma=TruthSigma(ut1_s=2e-4, range_bias_m={"KASHI": 5.0}))
        .world(model)
        .drawn
    )
    one, other = few.by_name(few.draw(3)), drawn.by_name(drawn.draw(3))
    assert set(one) == {"ut1", "range_bias.KASHI"}
    assert one["ut1"] == pytest.approx(2.0 * other["ut1"], rel=1e-14)
    assert one["range_bias.KASHI"] == other["range_bias.KASHI"]


def test_drawn_errors_have_their_sigma(drawn):
    errors = np.array([drawn.draw(seed) for seed in range(400)]) / drawn.sigmas
    # The standard deviation of 400 unit normals lies in 1 +- 0.16 but for 1e-5.
    np.testing.assert_allclose(errors.std(axis=0), 1.0, atol=0.16)
    assert np.abs(np.corrcoef(errors.T) - np.eye(len(drawn.names))).max() < 0.25
