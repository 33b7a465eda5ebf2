"""Partials by every parameter of every kind of observation, against differences of the model that it moves in.

Nothing of the columns' own formulas is used for the differences: the point is moved, epochs are shifted, air is added
above a station, the transponder holds longer, and a clock reads what a clock reads.
"""

import copy
import dataclasses

import numpy as np
import pytest
from arc_cases import observations
from offset_moon import OffsetEphemeris, OffsetOrientation
from quick import each_with_one, some

from radioloc import LunarPosition
from radioloc.constants import C_M_S
from radioloc.earth.eop import EopTable
from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.earth.orientation import EarthOrientation
from radioloc.errors import InputError
from radioloc.jobs.problem import observation_model
from radioloc.jobs.study_targets import surface_points
from radioloc.measurements import (
    EquipmentDelays,
    FixedPoint,
    Link,
    PhysicalModel,
    StationDelay,
    prepare_predictor,
)
from radioloc.measurements.registry import KINDS, MEASUREMENTS
from radioloc.media.ionosphere import UniformTec
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import middle_epoch
from radioloc.study.study import EstimateChoice, TerrainPrior
from radioloc.targets.design import ObservationModel
from radioloc.targets.position_prior import with_position_priors
from radioloc.targets.surface_point import SurfacePoint, cartesian
from radioloc.time import Epochs, tai_to_utc, utc_to_tai

# Of the largest partial of a column. Left out is how tide and gravity change with point and time, up to 4e-7.
RELATIVE = 1e-6
# The hold changes the growth of a range by the closing speed's change, 10 m/s. Differences over a millisecond know that
# to 0.04 m/s, as the last place of the Moon's angle psi is 3 micrometres on its surface. A microsecond of delay makes
# 4e-8 m of it.
GROWTH_BY_HOLD_M_S = 0.05
# Of the largest partial of a range, as differences of ranges lose digits. Left out is that a station elsewhere sees the
# Moon a little earlier and that a Moon elsewhere has other tides and velocities.
BY_STATION, BY_MOON = 4e-6, 4e-6

SITE = LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
COUNT_S = 600.0
CASES = {
    "two-way, transmit": ("range", "KASHI>x>KASHI", "transmit"),
    "two-way, receive": ("range", "KASHI>x>KASHI", "receive"),
    "two-way, bounce": ("range", "KASHI>x>KASHI", "bounce"),
    "three-way, transmit": ("range", "KASHI>x>JIAMUSI", "transmit"),
    "three-way, receive": ("range", "KASHI>x>JIAMUSI", "receive"),
    "three-way, bounce": ("range", "KASHI>x>JIAMUSI", "bounce"),
    "VLBI delay": ("vlbi_delay", "KASHI<x>JIAMUSI", "receive"),
    "VLBI delay rate": ("vlbi_delay_rate", "KASHI<x>JIAMUSI", "receive"),
    "two-way Doppler": ("doppler", "KASHI>x>KASHI", "receive"),
    "three-way Doppler": ("doppler", "KASHI>x>JIAMUSI", "receive"),
    "one-way, receive": ("one_way_range", "x>KASHI", "receive"),
    "one-way, transmit": ("one_way_range", "x>KASHI", "transmit"),
    "one-way Doppler": ("one_way_doppler", "x>KASHI", "receive"),
    "differenced range": ("differenced_range", "KASHI<x>JIAMUSI", "receive"),
    "differenced Doppler": ("differenced_doppler", "KASHI<x>JIAMUSI", "receive"),
}
DIFFERENCES = {name for name in CASES if name.startswith("differenced")}
INTEGRATED = {name for name, (kind, _, _) in CASES.items() if MEASUREMENTS[kind].integrated}
# Five hours in which both stations see the Moon 10 degrees high or more.
TAI = Epochs.from_jd(2459185.5, (15.0 + np.arange(8) * 0.7) / 24.0, "TAI")
DELAYS = EquipmentDelays(1.2e-6, {"KASHI": StationDelay(3e-8, 2e-8), "JIAMUSI": StationDelay(1e-8, 5e-8)})


class Hills:
    """A terrain of long waves, with its slopes: that of map files is tested with their readers."""

    def height_m(self, longitude, latitude):
        return 1500.0 * np.sin(20.0 * longitude) * np.cos(15.0 * latitude)

    def height_and_slope(self, longitude, latitude):
        by_longitude = 3e4 * np.cos(20.0 * longitude) * np.cos(15.0 * latitude)
        by_latitude = -22500.0 * np.sin(20.0 * longitude) * np.sin(15.0 * latitude)
        return self.height_m(longitude, latitude), by_longitude, by_latitude

    def sigma_m(self, longitude, latitude, own_m):
        return own_m


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build(ionosphere=UniformTec(20.0), delays=DELAYS)


@pytest.fixture(scope="module")
def airless():
    """Model without effects that change with a station's height and with the tide above it: 1e-3 of a displacement."""
    off = ("troposphere", "ionosphere", "solid_earth_tide", "pole_tide", "ocean_loading", "tidal_geocentre")
    return PhysicalModel.build(delays=DELAYS, off=off)


def arc_of(model, case, tai=TAI):
    kind, path, tag = CASES[case]
    count_s = COUNT_S if MEASUREMENTS[kind].integrated else np.nan
    uplink_hz = 7.2e9 if path.count(">") == 2 else np.nan
    table = observations(path, tai, tag, kind, count_s=count_s, wavelength_um=35394.6, uplink_hz=uplink_hz)
    site_pa_m = SITE.to_axes("PA", model.ephemeris.constants).xyz_m
    return prepare_predictor(model, table, FixedPoint(site_pa_m), "exact", more_partials=True)


def problem_of(arc, **choice):
    start = SITE.to_axes("PA", arc.model.ephemeris.constants)
    chosen = EstimateChoice(**choice)
    return observation_model(arc, surface_points({"": start}, arc.model, chosen), chosen)


def slope(value, step):
    """Derivative at zero by differences that are right to the fourth order."""
    one, two = (np.asarray(value(k * step) - value(-k * step)) for k in (1.0, 2.0))
    return (8.0 * one - two) / (12.0 * step)


def assert_same(analytic, numeric, relative=RELATIVE, scale=0.0):
    assert np.abs(numeric).max() > 0.0
    assert np.abs(analytic - numeric).max() < relative * max(np.abs(numeric).max(), scale)


def column_of(arc, parameter, **choice):
    """Column of the partials at the a-priori values."""
    problem = problem_of(arc, **choice)
    partials = problem.residuals(problem.parameters.prior_values)[1]
    return partials[:, problem.parameters.index(parameter)]


def value_m(arc):
    return arc.compute(FixedPoint(SITE.to_axes("PA", arc.model.ephemeris.constants).xyz_m)).value_m


# One of each geometry in seconds, with one component each; all of them with the slow studies.
SAMPLE_CASES = (
    "three-way, receive",
    "VLBI delay",
    "two-way Doppler",
    "one-way, transmit",
    "differenced Doppler",
)
few_cases = pytest.mark.parametrize("case", some(CASES, SAMPLE_CASES))
few_cases_undifferenced = pytest.mark.parametrize(
    "case", some([case for case in CASES if case not in DIFFERENCES], SAMPLE_CASES)
)


def few_cases_with(name, values):
    return pytest.mark.parametrize(("case", name), each_with_one(CASES, SAMPLE_CASES, values))


FORMS = {
    "geographic": {},
    "cartesian": {"position": "cartesian"},
    "terrain": {"height_prior": TerrainPrior(Hills(), 5.0)},
}


@few_cases_with("form", FORMS)
def test_position(model, case, form):
    arc = arc_of(model, case)
    problem = problem_of(arc, **FORMS[form])
    x = problem.parameters.prior_values
    partials = problem.residuals(x)[1]
    # Steps that the last place of the values, 1e-7 m, does not show in; the hills' waves are 300 km long.
    steps_m = (2e3, 2e3, 1e4) if form == "terrain" else (1e4, 1e4, 1e4)

    def moved(k):
        return lambda d: arc.compute(FixedPoint(problem.position_pa_m(x + d * np.eye(3)[k]))).value_m

    # The three together, as a small partial across the path has its error from the large one along it.
    assert_same(partials[:, :3], np.stack([slope(moved(k), steps_m[k]) for k in range(3)], axis=-1))


def stations_of(case):
    _, path, _ = CASES[case]
    return dict.fromkeys(Link.from_path(path).stations)


@few_cases_undifferenced
def test_time_bias(model, case):
    """All epochs are tags of one station, which a bias moves."""
    _, path, tag = CASES[case]
    link = Link.from_path(path)
    first = link.transmitter and (tag == "transmit" or link.differenced)
    station = link.transmitter if first else link.receiver
    numeric = slope(lambda d: value_m(arc_of(model, case, TAI.shifted(d))), 20.0)
    assert_same(column_of(arc_of(model, case), f"time_bias.{station}", time_bias=[station]), numeric)


@pytest.mark.parametrize("case", [case for case in CASES if case.split(",")[0].endswith("way")])
def test_range_bias(model, case):
    """Ranges that a station receives read more by it, those that it sends do not."""
    kind, path, tag = CASES[case]
    del kind, tag
    column = column_of(arc_of(model, case), f"range_bias.{Link.from_path(path).receiver}", range_bias="all")
    assert column.tolist() == [1.0] * len(TAI)


def read_delay_m(model, case, ahead):
    """Readings of stations with wrong clocks: ``ahead`` gives how far each is ahead at a TAI, s.

    Each arrival is read too late by as much, the first one's reading is the tag, and a count interval is one by the
    first station's clock.
    """
    kind = CASES[case][0]
    halves_s = (-0.5 * COUNT_S, 0.5 * COUNT_S) if kind == "vlbi_delay_rate" else (0.0,)
    readings_m = []
    for half_s in halves_s:
        read = TAI.shifted(half_s)
        right = read.shifted(-ahead("KASHI", read))
        delay_m = value_m(arc_of(model, "VLBI delay", right))
        # The second station's clock is asked at its own arrival, milliseconds later.
        arrived = right.shifted(delay_m / C_M_S)
        readings_m.append(delay_m + C_M_S * (ahead("JIAMUSI", arrived) - ahead("KASHI", read)))
    return readings_m[-1] - readings_m[0] if len(readings_m) == 2 else readings_m[0]


@pytest.mark.parametrize("station", ["KASHI", "JIAMUSI"])
def test_clock(model, station):
    def read(offset_s):
        return read_delay_m(
            model, "VLBI delay", lambda name, tai: np.full(len(tai), offset_s * (name == station))
        )

    column = column_of(arc_of(model, "VLBI delay"), f"clock.{station}", clock=[station])
    # Two seconds are as good as a microsecond to a clock, and better for differences.
    assert_same(column, slope(read, 1.0), 1e-9)


@pytest.mark.parametrize("case", ["VLBI delay", "VLBI delay rate"])
@pytest.mark.parametrize("station", ["KASHI", "JIAMUSI"])
def test_clock_rate(model, case, station):
    arc = arc_of(model, case)
    middle = middle_epoch(arc.observations)

    def read(rate):
        return read_delay_m(
            model,
            case,
            lambda name, tai: rate * (name == station) * utc_to_tai(tai_to_utc(tai)).seconds_since(middle),
        )

    column = column_of(arc, f"clock_rate.{station}", clock_rate=[station])
    # Beyond the rate itself, 1e-4, differences see its square.
    assert_same(column, slope(read, 1e-4))


@few_cases_undifferenced
def test_zenith_delay(model, case):
    """More wet air above one station."""
    arc = arc_of(model, case)
    for station in stations_of(case):
        index = arc.stations.index(arc.model.catalogue.get(station).name)
        column = column_of(arc, f"zenith_delay.{station}", zenith_delay=[station])

        def with_more(d, index=index):
            # The same arc: one that is prepared anew has other last places of the Moon's angle, micrometres.
            wetter = copy.copy(arc)
            air = arc._media["troposphere"]
            wetter_air = dataclasses.replace(air, wet_m=air.wet_m + d * (arc._station_index == index))
            wetter._media = {**arc._media, "troposphere": wetter_air}
            return value_m(wetter)

        assert_same(column, slope(with_more, 10.0))


@pytest.mark.parametrize(
    "case", some([case for case in CASES if case[:5] in ("two-w", "three")], SAMPLE_CASES)
)
def test_transponder_delay(model, case):
    def held(d):
        delays = dataclasses.replace(DELAYS, transponder_s=5e-4 + d)
        return value_m(arc_of(dataclasses.replace(model, delays=delays), case))

    column = column_of(arc_of(model, case), "transponder_delay", transponder_delay=True)
    numeric = slope(held, 2e-4)
    if CASES[case][0] == "doppler":
        assert np.abs(column - numeric).max() < GROWTH_BY_HOLD_M_S
    else:
        assert_same(column, numeric)


@few_cases_with("component", range(3))
def test_station_position(airless, case, component):
    model = airless
    for station in stations_of(case):
        entry = model.catalogue.get(station)
        enu = rot_itrf_to_enu(entry.itrf_m)

        def moved(d, entry=entry, enu=enu):
            catalogue = model.catalogue.with_station(
                dataclasses.replace(entry, itrf_m=entry.itrf_m + d * enu[component])
            )
            return value_m(arc_of(dataclasses.replace(model, catalogue=catalogue), case))

        name = f"station_position.{entry.name}.{('east', 'north', 'up')[component]}"
        column = column_of(arc_of(model, case), name, station_position=[station])
        assert_same(column, slope(moved, 300.0), BY_STATION, 2.0)


def turned(model, **shifts):
    """A model with another Earth orientation."""
    table = model.earth.table
    names = ("xp_rad", "yp_rad", "ut1_minus_utc_s", "dx_rad", "dy_rad")
    columns = [getattr(table, name) + shifts.get(name, 0.0) for name in names]
    shifted = EopTable(table.mjd_utc, *columns, table.predicted, table.sources)
    return dataclasses.replace(model, earth=EarthOrientation(shifted))


@few_cases
def test_ut1(airless, case):
    numeric = slope(lambda d: value_m(arc_of(turned(airless, ut1_minus_utc_s=d), case)), 0.05)
    assert_same(column_of(arc_of(airless, case), "ut1", ut1=True), numeric, BY_STATION, 700.0)


@few_cases_with("axis", ["x", "y"])
def test_pole(airless, case, axis):
    numeric = slope(lambda d: value_m(arc_of(turned(airless, **{f"{axis}p_rad": d}), case)), 5e-6)
    assert_same(column_of(arc_of(airless, case), f"pole.{axis}", pole=True), numeric, BY_STATION, 1e7)


@few_cases_with("component", range(3))
def test_moon_position(model, case, component):
    def moved(d):
        ephemeris = OffsetEphemeris.from_model(model.ephemeris, tuple(d * np.eye(3)[component]))
        return value_m(arc_of(dataclasses.replace(model, ephemeris=ephemeris), case))

    name = f"moon_position.{('radial', 'along', 'normal')[component]}"
    column = column_of(arc_of(model, case), name, moon_position=True)
    assert_same(column, slope(moved, 1e4), BY_MOON, 2.0)


@few_cases_with("component", range(3))
def test_libration(model, case, component):
    def moved(d):
        libration = OffsetOrientation.from_model(model.libration, tuple(d * np.eye(3)[component]))
        return value_m(arc_of(dataclasses.replace(model, libration=libration), case))

    column = column_of(arc_of(model, case), f"libration.{'xyz'[component]}", libration=True)
    assert_same(column, slope(moved, 1e-5), BY_MOON, 2.4e6)


@few_cases_with("component", range(6))
def test_longitude_libration(model, case, component):
    # Arguments at the middle of the arc (IERS 2010 eq. 5.43); they turn by less than 4e-3 rad in its five hours.
    years = (TAI.mjd.mean() - 51544.5) / 365.25
    anomaly, sun, latitude, elongation = np.radians(
        np.array([134.96340, 357.52911, 93.27209, 297.85020])
        + np.array([4771.9886753, 359.9905029, 4832.0201746, 4452.6711145]) * years
    )
    angle = (sun, 2 * (anomaly - elongation), 2 * (latitude - anomaly))[component // 2]
    about_z = column_of(arc_of(model, case), "libration.z", libration=True)
    period, wave = ("365d", "206d", "1095d")[component // 2], ("cos", "sin")[component % 2]
    column = column_of(arc_of(model, case), f"longitude_libration.{wave}_{period}", longitude_libration=True)
    np.testing.assert_allclose(
        column, about_z * (np.cos, np.sin)[component % 2](angle), atol=4e-3 * abs(about_z).max()
    )


@few_cases_with("number", ["h2", "l2"])
def test_love_numbers(model, case, number):
    constants = model.ephemeris.constants

    def other(d):
        changed = dataclasses.replace(constants, **{number: getattr(constants, number) + d})
        ephemeris = dataclasses.replace(model.ephemeris, constants=changed)
        return value_m(arc_of(dataclasses.replace(model, ephemeris=ephemeris), case))

    column = column_of(arc_of(model, case), f"love_numbers.{number}", love_numbers=True)
    assert_same(column, slope(other, 500.0), BY_MOON, 27.0)


@few_cases
def test_lunar_lengths(model, case):
    arc = arc_of(model, case)
    site_pa_m = SITE.to_axes("PA", model.ephemeris.constants).xyz_m
    numeric = slope(lambda d: arc.compute(FixedPoint(site_pa_m * (1.0 + d))).value_m, 5e-3)
    assert_same(column_of(arc, "lunar_lengths", lunar_lengths=True), numeric)


@few_cases
def test_electron_content(model, case):
    """The same content above all stations."""
    arc = arc_of(model, case)
    columns = [
        column_of(arc, f"electron_content.{model.catalogue.get(name).name}", electron_content="all")
        for name in stations_of(case)
    ]

    def with_more(d):
        changed = dataclasses.replace(model, ionosphere=UniformTec(100.0 + d))
        return value_m(arc_of(changed, case))

    assert_same(sum(columns), slope(with_more, 40.0), scale=0.03)


@pytest.mark.parametrize("case", [case for case in CASES if case in INTEGRATED and case not in DIFFERENCES])
def test_frequency_offset_and_frequency_rate(model, case):
    """A reference that is high by a fraction misses that part of the cycles that were received."""
    arc, path = arc_of(model, case), CASES[case][1]
    received_m = C_M_S * COUNT_S - value_m(arc)
    offset = column_of(arc, f"frequency_offset.{path}", frequency_offset="all")
    np.testing.assert_allclose(offset, received_m, rtol=1e-15)
    since_s = TAI.seconds_since(middle_epoch(arc.observations))
    drift = column_of(arc, f"frequency_rate.{path}", frequency_rate="all")
    np.testing.assert_allclose(drift, received_m * since_s, rtol=1e-12)


@pytest.mark.parametrize("case", [case for case in CASES if case.startswith("one-way")])
@pytest.mark.parametrize("kind", ["target_clock", "target_frequency", "target_frequency_rate"])
def test_target_clock_and_target_frequency_and_target_frequency_rate(model, case, kind):
    """The transmission is read by a clock that is ahead, and tagged by it where the tag names it."""
    _, _, tag = CASES[case]
    arc = arc_of(model, case)
    if case in INTEGRATED and kind == "target_clock":
        with pytest.raises(InputError, match="target_clock: expected observations"):
            column_of(arc, kind, **{kind: True})
        return
    middle = middle_epoch(arc.observations)
    halves_s = (-0.5 * COUNT_S, 0.5 * COUNT_S) if case in INTEGRATED else (0.0,)

    def ahead_s(d, tai):
        since_s = tai.seconds_since(middle)
        of_time = {"target_clock": np.ones(len(tai)), "target_frequency": since_s}
        return d * of_time.get(kind, 0.5 * since_s**2)

    def read_m(d):
        readings = []
        for half_s in halves_s:
            read = TAI.shifted(half_s)
            right = read.shifted(-ahead_s(d, read)) if tag == "transmit" else read
            range_m = value_m(arc_of(model, f"one-way, {tag}", right))
            sent = right if tag == "transmit" else right.shifted(-range_m / C_M_S)
            # By the tag's own reading where the clock is the one that tags.
            error_s = ahead_s(d, read) if tag == "transmit" else ahead_s(d, sent)
            readings.append(range_m - C_M_S * error_s)
        return readings[-1] - readings[0] if len(readings) == 2 else readings[0]

    step = {"target_clock": 1.0, "target_frequency": 1e-4, "target_frequency_rate": 1e-9}[kind]
    numeric = slope(read_m, step)
    column = column_of(arc, kind, **{kind: True})
    if kind == "target_frequency_rate" and case in INTEGRATED:
        # Its zero is at the transmission to what the light time is known without the path.
        np.testing.assert_allclose(column, numeric, rtol=0.0, atol=0.03 * C_M_S * COUNT_S)
        return
    assert_same(column, numeric)


def test_station_delay(model):
    """A receiving chain that is longer by so much, in the model's own delays of equipment."""
    for case, station in (
        ("three-way, receive", "JIAMUSI"),
        ("VLBI delay", "KASHI"),
        ("VLBI delay", "JIAMUSI"),
    ):

        def longer(d, case=case, station=station):
            delays = DELAYS.stations[station]
            changed = {**DELAYS.stations, station: dataclasses.replace(delays, receive_s=5e-4 + d)}
            delays = dataclasses.replace(DELAYS, stations=changed)
            return value_m(arc_of(dataclasses.replace(model, delays=delays), case))

        column = column_of(arc_of(model, case), f"station_delay.{station}", station_delay=[station])
        assert_same(column, slope(longer, 2e-4))


@pytest.mark.parametrize("case", ["three-way, receive", "VLBI delay"])
def test_scale_factor(model, case):
    """A scale of one part in 1e9 changes the value by that part."""
    arc = arc_of(model, case)
    column = column_of(arc, f"scale_factor.{arc.observations.links[0].path}", scale_factor="all")
    assert_same(column, slope(lambda d: (1.0 + d) * value_m(arc), 1e-9))


def test_two_targets(model):
    """Partials of a differenced delay by the position of each target are those of its delay."""
    constants = model.ephemeris.constants
    other = LunarPosition.from_selenographic(-40.0, 38.0, -1500.0)
    positions_m = np.array([place.to_axes("PA", constants).xyz_m for place in (SITE, other)])
    table = observations("KASHI<x|y>JIAMUSI", TAI, "receive", "differenced_delay", wavelength_um=35394.6)
    arc = prepare_predictor(
        model, table, [FixedPoint(one) for one in positions_m], "exact", targets=("x", "y")
    )
    delay = observations("KASHI<x>JIAMUSI", TAI, "receive", "vlbi_delay", wavelength_um=35394.6)
    delays = [prepare_predictor(model, delay, FixedPoint(place_m), "exact") for place_m in positions_m]
    places = [cartesian(p, name=name) for p, name in zip(positions_m, "xy", strict=True)]
    positions = with_position_priors(places, [None, None], constants)
    targets = [SurfacePoint("xy"[k], *one) for k, one in enumerate(positions)]
    problem = ObservationModel.from_targets(arc, targets, [])
    partials = problem.residuals(problem.parameters.prior_values)[1]
    for target, sign in ((0, 1.0), (1, -1.0)):
        expected = delays[target].compute(FixedPoint(positions_m[target])).by_position_pa
        assert np.abs(partials[:, 3 * target : 3 * target + 3] - sign * expected).max() < 1e-12


def test_no_kind_of_parameter_is_forgotten():
    tested = "_and_".join(name.removeprefix("test_") for name in globals() if name.startswith("test_"))
    # Those of a session are the constant ones in some rows.
    kinds = {name.removesuffix("_variation") for name in (*PARAMETERS, "position")}
    assert kinds <= set(tested.split("_and_"))
    tested_separately = {"differenced_delay"}
    assert {kind for kind, _, _ in CASES.values()} == set(KINDS) - tested_separately
