"""Partials by every parameter of every kind of observation, against differences of the model that it moves in.

Nothing of the columns' own formulas is used for the differences: the point is moved, epochs are shifted, air is added
above a station, the transponder holds longer, and a clock reads what a clock reads.
"""

from __future__ import annotations

import copy
import dataclasses

import numpy as np
import pytest

from radioloc import EquipmentDelays, LunarPosition, StationCatalogue, StationDelay
from radioloc.constants import C_M_S
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.link import Link
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.registry import KINDS
from radioloc.media.ionosphere import UniformTec
from radioloc.studies.nuisance import middle_of
from radioloc.studies.problem import Problem
from radioloc.studies.study import STATION_PARAMETERS, EstimateChoice, TerrainPrior
from radioloc.time import Epochs, tai_to_utc, utc_to_tai

# Of the largest partial of a column. Left out is how tide and gravity change with point and time, up to 4e-7.
RELATIVE = 1e-6
# The hold changes the growth of a range by the closing speed's change, 10 m/s. Differences over a millisecond know that
# to 0.04 m/s, as the last place of the Moon's angle psi is 3 micrometres on its surface. A microsecond of delay makes
# 4e-8 m of it.
GROWTH_BY_HOLD_M_S = 0.05

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
}
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


def arc_of(model, case, tai=TAI):
    kind, path, tag = CASES[case]
    observations = Observations.from_columns(
        epoch=tai_to_utc(tai),
        links=[Link.from_path(path)],
        kind=KINDS.index(kind),
        tag=TIME_TAGS.index(tag),
        value_m=1.0,
        sigma_m=1.0,
        count_s=COUNT_S if kind in ("doppler", "vlbi_delay_rate") else np.nan,
        wavelength_um=35394.6,
        uplink_hz=np.nan if "<" in path else 7.2e9,
    )
    return ExactPredictor(model, observations, SITE.to_axes("PA", model.ephemeris.constants).xyz_m)


def problem_of(arc, **choice):
    start = SITE.to_axes("PA", arc.model.ephemeris.constants)
    return Problem.of(arc, start, EstimateChoice(**choice), StationCatalogue.default())


def slope(value, step):
    """Derivative at zero by differences that are right to the fourth order."""
    one, two = (np.asarray(value(k * step) - value(-k * step)) for k in (1.0, 2.0))
    return (8.0 * one - two) / (12.0 * step)


def assert_same(analytic, numeric, relative=RELATIVE):
    assert np.abs(numeric).max() > 0.0
    assert np.abs(analytic - numeric).max() < relative * np.abs(numeric).max()


def column_of(arc, parameter, **choice):
    """One column of the partials at the a-priori values."""
    problem = problem_of(arc, **choice)
    partials = problem.residuals(problem.parameters.prior_values)[1]
    return partials[:, problem.parameters.index(parameter)]


def value_m(arc):
    return arc.compute(SITE.to_axes("PA", arc.model.ephemeris.constants).xyz_m).value_m


every_case = pytest.mark.parametrize("case", CASES)
FORMS = {
    "geographic": {},
    "cartesian": {"position": "cartesian"},
    "terrain": {"height_prior": TerrainPrior(Hills(), 5.0)},
}


@every_case
@pytest.mark.parametrize("form", FORMS)
def test_position(model, case, form):
    arc = arc_of(model, case)
    problem = problem_of(arc, **FORMS[form])
    x = problem.parameters.prior_values
    partials = problem.residuals(x)[1]
    # Steps that the last place of the values, 1e-7 m, does not show in; the hills' waves are 300 km long.
    steps_m = (2e3, 2e3, 1e4) if form == "terrain" else (1e4, 1e4, 1e4)

    def moved(k):
        return lambda d: arc.compute(problem.position_pa_m(x + d * np.eye(3)[k])).value_m

    # The three together, as a small partial across the path has its error from the large one along it.
    assert_same(partials[:, :3], np.stack([slope(moved(k), steps_m[k]) for k in range(3)], axis=-1))


def stations_of(case):
    _, path, _ = CASES[case]
    link = Link.from_path(path)
    return dict.fromkeys((link.transmitter, link.receiver))


@every_case
def test_time_bias(model, case):
    """All epochs are tags of one station, which a bias moves."""
    _, path, tag = CASES[case]
    link = Link.from_path(path)
    station = link.transmitter if tag == "transmit" or link.differenced else link.receiver
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
    """What stations with wrong clocks read: ``ahead`` gives how far each is ahead at a TAI, s.

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
        # The second station's clock is asked at its own arrival: milliseconds later, in which no clock changes.
        readings_m.append(delay_m + C_M_S * (ahead("JIAMUSI", right) - ahead("KASHI", read)))
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
    middle = middle_of(arc)

    def read(rate):
        return read_delay_m(
            model,
            case,
            lambda name, tai: rate * (name == station) * utc_to_tai(tai_to_utc(tai)).seconds_since(middle),
        )

    column = column_of(arc, f"clock_rate.{station}", clock_rate=[station])
    # Beyond the rate itself, 1e-4, differences see its square.
    assert_same(column, slope(read, 1e-4))


@every_case
def test_zenith_delay(model, case):
    """More wet air above one station."""
    arc = arc_of(model, case)
    for station in stations_of(case):
        index = arc.stations.index(arc.model.catalogue.get(station).name)
        column = column_of(arc, f"zenith_delay.{station}", zenith_delay=[station])

        def with_more(d, index=index):
            # The same arc: one that is prepared anew has other last places of the Moon's angle, micrometres.
            wetter = copy.copy(arc)
            wetter._media = tuple(
                {
                    **prepared,
                    "troposphere": dataclasses.replace(
                        prepared["troposphere"], wet_m=prepared["troposphere"].wet_m + d * (which == index)
                    ),
                }
                for prepared, which in zip(arc._media, (arc._transmitter, arc._receiver), strict=True)
            )
            return value_m(wetter)

        assert_same(column, slope(with_more, 10.0))


@pytest.mark.parametrize("case", [case for case in CASES if not case.startswith("VLBI")])
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


def test_no_kind_of_parameter_is_forgotten():
    tested = {name.removeprefix("test_") for name in globals() if name.startswith("test_")}
    assert {*STATION_PARAMETERS, "position", "transponder_delay"} <= tested
    assert {kind for kind, _, _ in CASES.values()} == set(KINDS[:4])
