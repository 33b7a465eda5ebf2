"""Each error of the simulated world does to the observations what it should, by independent reckoning."""

import numpy as np
import pytest
from offset_moon import changed_model

from radioloc.constants import C_M_S
from radioloc.earth.geodesy import geodetic_from_itrf, rot_itrf_to_enu
from radioloc.errors import InputError, StationError
from radioloc.lunar import rot_icrf_to_pa
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.media.mapping_functions import day_of_year, mapping_factors, niell_coefficients
from radioloc.simulation import (
    Masks,
    Scenario,
    Schedule,
    Session,
    Truth,
    TruthSigma,
    baselines,
    elevations,
    simulate,
    two_way,
)
from radioloc.time import Epochs, utc_to_tt

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


@pytest.fixture(scope="module")
def directions(plain, lander_pa_m, model):
    """Unit vectors from first and second station to the point, ICRF, good to the Moon's way in a light time."""
    observations = plain.observations
    tt = utc_to_tt(observations.epoch)
    moon_m, _ = model.ephemeris.geocentric("moon", Epochs(tt.jd, tt.fraction, "TDB"))
    rot = model.earth.evaluate(tt).rot_itrf_to_gcrs
    to_pa = rot_icrf_to_pa(model.libration.angles(Epochs(tt.jd, tt.fraction, "TDB"))[0])
    point_m = moon_m + np.einsum("nji,j->ni", to_pa, lander_pa_m)
    out = []
    for end in ("transmitter", "receiver"):
        itrf_m = np.array([model.catalogue.get(getattr(link, end)).itrf_m for link in observations.links])
        away = point_m - np.einsum("nij,nj->ni", rot, itrf_m[observations.link])
        out.append(away / np.linalg.norm(away, axis=-1)[:, None])
    return out


def of_kind(simulated, kind):
    return simulated.observations.types() == kind


# The directions leave out the motion in a light time: 2e-5 rad.
ROUGHLY = 5e-5


def test_a_moon_further_out(change, plain, directions, model):
    radial = change(moon_position_m=(10.0, 0.0, 0.0))
    ranges, delays = of_kind(plain, "range"), of_kind(plain, "vlbi_delay")
    tt = utc_to_tt(plain.observations.epoch)
    moon_m, _ = model.ephemeris.geocentric("moon", Epochs(tt.jd, tt.fraction, "TDB"))
    out = moon_m / np.linalg.norm(moon_m, axis=-1)[:, None]
    first, second = (np.einsum("ni,ni->n", out, d) for d in directions)
    np.testing.assert_allclose(
        radial[ranges], 10.0 * (first + second)[ranges], rtol=0.0, atol=10.0 * 2 * ROUGHLY
    )
    np.testing.assert_allclose(
        radial[delays], 10.0 * (second - first)[delays], rtol=0.0, atol=10.0 * 2 * ROUGHLY
    )
    assert np.abs(change(moon_position_m=(0.0, 10.0, 0.0))[ranges]).max() < 1.0


def test_a_turned_moon_is_a_point_moved_in_its_axes(change, plain, lander_pa_m, compute, model):
    rotation = np.array([0.5e-6, -0.7e-6, 1e-6])
    turned = change(libration_rad=tuple(rotation.tolist()))
    moved_m = np.cross(rotation, lander_pa_m)
    predicted = compute(model, plain.observations, lander_pa_m).by_position_pa @ moved_m
    assert np.linalg.norm(moved_m) > 0.2
    np.testing.assert_allclose(turned, predicted, rtol=0.0, atol=TOLERANCE_M)


def test_a_station_elsewhere(change, plain, directions, model):
    moved = change(station_position_m={"KS": (1.0, -2.0, 3.0)})
    observations = plain.observations
    rot = model.earth.evaluate(utc_to_tt(observations.epoch)).rot_itrf_to_gcrs
    itrf_m = rot_itrf_to_enu(model.catalogue.get("KASHI").itrf_m).T @ [1.0, -2.0, 3.0]
    shift = np.einsum("nij,j->ni", rot, itrf_m)
    ends = [
        np.array([getattr(link, end) == "KASHI" for link in observations.links])[observations.link]
        for end in ("transmitter", "receiver")
    ]
    expected = -sum(np.einsum("ni,ni->n", shift, d) * at for d, at in zip(directions, ends, strict=True))
    ranges = of_kind(plain, "range")
    np.testing.assert_allclose(moved[ranges], expected[ranges], rtol=0.0, atol=4.0 * 2 * 2e-4)
    assert not moved[of_kind(plain, "vlbi_delay")].any()


def test_later_ut1_turns_every_station_to_the_east(change, model):
    ut1_s = 1e-4
    spin = 2 * np.pi * 1.00273781191135448 / 86400.0 * ut1_s
    eastward = {s.name: (float(spin * np.hypot(*s.itrf_m[:2])), 0.0, 0.0) for s in model.catalogue}
    turned = change(ut1_s=ut1_s)
    assert np.abs(turned).max() > 0.01
    # The pole is 1.5e-6 rad off the axis of rotation, and tides feel UT1 a little.
    np.testing.assert_allclose(turned, change(station_position_m=eastward), rtol=0.0, atol=1e-6)


def test_another_pole_moves_every_station(change, model):
    xp, yp = 1e-8, -2e-8
    itrf_m = {s.name: s.itrf_m for s in model.catalogue}
    # First order of R2(xp) R1(yp) (IERS Conventions 2010, eq. 5.3).
    shifts = {n: np.array([-xp * z, yp * z, xp * x - yp * y]) for n, (x, y, z) in itrf_m.items()}
    local = {n: tuple((rot_itrf_to_enu(itrf_m[n]) @ shift).tolist()) for n, shift in shifts.items()}
    moved = change(pole_rad=(xp, yp))
    assert np.abs(moved).max() > 0.05
    # The pole tide feels it too: 33 mm per arcsecond, 0.2 mm over two legs.
    np.testing.assert_allclose(moved, change(station_position_m=local), rtol=0.0, atol=3e-4)


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


def test_air_lengthens_ranges_and_delays_the_later_station(schedule, lander, lander_pa_m):
    model = PhysicalModel.build()
    plain = simulate(schedule, lander, model=model)
    stations = ("JIAMUSI", "KASHI", "NEUQUEN", "SESHAN25", "KUNMING", "URUMQI")
    zenith = dict(zip(stations, (0.05, 0.1, -0.2, 0.03, 0.06, 0.0), strict=True))
    tec = dict(zip(stations, (1.0, 2.0, -3.0, 4.0, 0.0, 5.0), strict=True))
    observations = plain.observations
    tt = utc_to_tt(observations.epoch)

    def wet(name, elevation_rad):
        place = geodetic_from_itrf(model.catalogue.get(name).itrf_m)
        day = day_of_year(observations.epoch)
        seen_rad = np.maximum(elevation_rad, np.radians(5.0))
        return mapping_factors(seen_rad, place.height_m, *niell_coefficients(place.latitude_rad, day)).wet

    def shell(name, elevation_rad):
        # Dach et al. (2015), chapter 12: sin z' = 6371 / 6877.7 sin(0.9782 z).
        return 1.0 / np.sqrt(1.0 - (6371.0 / 6877.7 * np.sin(0.9782 * (np.pi / 2 - elevation_rad))) ** 2)

    def at(shift_s, values, mapping):
        # Value times mapping at both ends.
        found = elevations(model, lander_pa_m, stations, tt.shifted(shift_s)).at_station_rad
        slant = np.stack([values[n] * mapping(n, found[:, k]) for k, n in enumerate(stations)], axis=-1)
        which = [
            np.array([stations.index(getattr(link, end)) for link in observations.links])[observations.link]
            for end in ("transmitter", "receiver")
        ]
        return [slant[np.arange(len(tt)), k] for k in which]

    up_m, down_m = 40.308e16 / 7.2e9**2, 40.308e16 / (C_M_S / 35394.6e-6) ** 2
    for name, values, mapping, sent_m, received_m, phase in (
        ("zenith_delay_m", zenith, wet, 1.0, 1.0, 1.0),
        ("electron_content_tecu", tec, shell, up_m, down_m, -1.0),
    ):
        changed = simulate(schedule, lander, Truth(**{name: values}), model=model).observations.value_m
        changed = changed - observations.value_m
        first, second = at(0.0, values, mapping)
        late, early = (
            sent_m * a + received_m * b for a, b in (at(s, values, mapping) for s in (300.0, -300.0))
        )
        expected = {
            "range": sent_m * first + received_m * second,
            "vlbi_delay": received_m * (second - first),
            "doppler": phase * (late - early),
        }
        for kind, values_m in expected.items():
            rows = of_kind(plain, kind)
            # A signal goes up 2.6 s before it comes down: 2e-4 rad of elevation, of which 5 times its cotangent.
            np.testing.assert_allclose(
                changed[rows],
                values_m[rows],
                rtol=0.0,
                atol=1e-3 * np.abs(values_m[rows]).max(),
                err_msg=kind,
            )
            assert np.abs(values_m[rows]).max() > 1e-4


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


def test_nothing_departs_by_itself(plain, lander_pa_m, predict_m, model):
    assert (plain.observations.value_m == predict_m(model, plain.observations, lander_pa_m)).all()
    world = Truth().model(model)
    assert world is model


def test_truths_that_cannot_be(schedule, lander, model):
    with pytest.raises(
        InputError, match=r"clock_s: 5.0 is too large .* at most 0.01 s: the curvature of a range"
    ):
        Truth(clock_s=5.0)
    with pytest.raises(InputError, match=r"station_position_m: -300.0 is too large"):
        Truth(station_position_m={"KASHI": (0.0, -300.0, 0.0)})
    with pytest.raises(InputError, match=r"the sigma is -1.0"):
        TruthSigma(ut1_s=-1.0)
    with pytest.raises(
        InputError, match="'range_bias' is no error of a parameter; did you mean 'range_bias_m'"
    ):
        Truth(range_bias="all")
    with pytest.raises(InputError, match="'shapira' is not a term"):
        Truth(terms_off=["shapira"])
    with pytest.raises(StationError, match="KASHY"):
        simulate(schedule, lander, Truth(range_bias_m={"KASHY": 1.0}), model=model)
    no_frequency = Schedule([Session("range", two_way("KASHI"), START, STOP, 3600, 1.0)])
    with pytest.raises(InputError, match="give uplink_hz and wavelength_um"):
        simulate(no_frequency, lander, Truth(electron_content_tecu={"KASHI": 1.0}), model=model)
    with pytest.raises(
        InputError, match="zenith_delay: it acts by the term troposphere, which is switched off"
    ):
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
