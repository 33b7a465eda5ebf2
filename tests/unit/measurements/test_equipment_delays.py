"""Delays of stations and transponder: what they do to each kind of observation and to what its tag means."""

import dataclasses

import numpy as np
import pytest
from arc_cases import APOLLO15, epochs_tai, observations

from radioloc.constants import C_M_S
from radioloc.errors import InputError, StationError
from radioloc.measurements import ExactPredictor, PhysicalModel
from radioloc.measurements.equipment_delays import EquipmentDelays, StationDelay

# The chain's noise is half a micrometre.
SAME_M = 2e-6
HOLD_S = 1.2e-6
STATIONS = {"KASHI": StationDelay(3e-8, 2e-8), "JIAMUSI": StationDelay(transmit_s=7e-5, receive_s=5e-5)}
TAI = epochs_tai(7, 6.0)


@pytest.fixture(scope="module")
def plain():
    return PhysicalModel.build()


def with_delays(model, transponder_s=None, stations=None):
    return dataclasses.replace(model, delays=EquipmentDelays(transponder_s, stations or {}))


def computed(model, path, tag="transmit", tai=TAI, **columns):
    return ExactPredictor(model, observations(path, tai, tag, **columns), APOLLO15).compute()


def vlbi(model, tai=TAI):
    return computed(model, "KASHI<x>JIAMUSI", "receive", tai, kind="vlbi_delay")


@pytest.mark.parametrize("tag", ["transmit", "receive", "bounce"])
def test_transponder_delay_lengthens_a_range(plain, tag):
    """The range grows by c times the delay and by the motion of the other station during the delay."""
    model = with_delays(plain, HOLD_S)
    reference, delayed = computed(plain, "KASHI>x>JIAMUSI", tag), computed(model, "KASHI>x>JIAMUSI", tag)
    added_m = delayed.value_m - reference.value_m
    np.testing.assert_allclose(added_m, HOLD_S * reference.by_transponder_delay_m_s, rtol=0, atol=SAME_M)
    # A leg closes at up to 400 m/s of the station and some of the Moon.
    assert 1e-5 < np.abs(added_m - C_M_S * HOLD_S).max() < 800.0 * HOLD_S


@pytest.mark.parametrize("tag", ["transmit", "receive", "bounce"])
def test_station_delay_shifts_the_event_and_adds_to_the_value(plain, tag):
    model = with_delays(plain, stations=STATIONS)
    shift_s = {"transmit": 3e-8, "receive": -5e-5, "bounce": 0.0}[tag]
    event_m = computed(plain, "KASHI>x>JIAMUSI", tag, TAI.shifted(shift_s)).value_m
    clock_m = computed(model, "KASHI>x>JIAMUSI", tag).value_m
    np.testing.assert_allclose(clock_m, event_m + C_M_S * (3e-8 + 5e-5), rtol=0, atol=1e-5)


def test_vlbi_delay_depends_on_receive_delays_only(plain):
    model = with_delays(plain, HOLD_S, STATIONS)
    event_m = vlbi(plain, TAI.shifted(-2e-8)).value_m
    np.testing.assert_allclose(vlbi(model).value_m, event_m + C_M_S * (5e-5 - 2e-8), rtol=0, atol=1e-5)
    assert not vlbi(model).by_transponder_delay_m_s.any()


@pytest.mark.parametrize(("term", "size_s"), [("transponder_delay", HOLD_S), ("station_delay", 3e-8 + 5e-5)])
def test_terms_switch_the_delays_off(plain, term, size_s):
    model = with_delays(plain, HOLD_S, STATIONS)
    without_m = computed(model.without(term), "KASHI>x>JIAMUSI").value_m
    assert computed(model, "KASHI>x>JIAMUSI").value_m - without_m == pytest.approx(C_M_S * size_s, abs=1e-3)
    neither_m = computed(model.without("transponder_delay", "station_delay"), "KASHI>x>JIAMUSI").value_m
    assert neither_m.tolist() == computed(plain, "KASHI>x>JIAMUSI").value_m.tolist()


def test_station_names_are_those_of_the_catalogue(plain):
    catalogue = plain.catalogue
    named = EquipmentDelays(stations={"7045": StationDelay(1e-8)}).with_catalogue_names(catalogue)
    assert dict(named.stations) == {"APOLLO": StationDelay(1e-8)}
    with pytest.raises(StationError, match=r"station_delay_s: .*ATLANTIS"):
        EquipmentDelays(stations={"ATLANTIS": StationDelay()}).with_catalogue_names(catalogue)
    with pytest.raises(StationError, match="7045 duplicates APOLLO"):
        EquipmentDelays(stations={"APOLLO": StationDelay(), "7045": StationDelay()}).with_catalogue_names(
            catalogue
        )


@pytest.mark.parametrize("delay_s", [-1e-9, 1.2, float("nan")])
def test_invalid_delays(delay_s):
    with pytest.raises(InputError, match="transponder_delay_s: expected 0"):
        EquipmentDelays(delay_s)
    with pytest.raises(InputError, match="receive_s: expected 0"):
        StationDelay(receive_s=delay_s)


@pytest.mark.parametrize("path", ["KASHI>x>JIAMUSI", "NEUQUEN>x>NEUQUEN", "KASHI<x>JIAMUSI"])
def test_delay_of_the_air_is_in_its_own_frame(plain, path):
    """The air moves at 30 km/s in the barycentric frame; the clocks beside it see its delay as it is.

    Left are the 1.5 km/s between station and point during a delay of 20 m: up to 0.1 mm. Without the air's motion it
    is 0.5 mm here between stations of which one sees the Moon lower.
    """
    differenced = "<" in path
    columns = {"kind": "vlbi_delay"} if differenced else {}
    arc = ExactPredictor(plain, observations(path, epochs_tai(49, 24.0), "receive", **columns), APOLLO15)
    vacuum = ExactPredictor(plain.without("troposphere"), arc.observations, APOLLO15)
    solved, relay, *_ = arc._solve()
    views = arc._lines_of_sight(solved, relay)
    up_m, down_m = np.split(views.delay_m, 2)
    seen_m = arc.compute().value_m - vacuum.compute().value_m
    high = (views.leg.elevation.angle_rad > 0.1).reshape(2, -1).all(axis=0)
    sign = -1.0 if differenced else 1.0
    assert high.sum() > 5
    assert np.abs(seen_m - (sign * up_m + down_m))[high].max() < 1.5e-4
