"""The offset of an antenna's axes: its geometry, its sign in each observable, and its derivatives."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arc_cases import APOLLO15_PA_M

from radioloc.constants import C_M_S
from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.earth.stations import MOUNTS, StationCatalogue
from radioloc.errors import StationError
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.link import Link
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.registry import KINDS, MEASUREMENTS
from radioloc.time import epochs_from_strings, tai_to_utc, utc_to_tai

OFFSET_M = 8.0
REFRACTED = 2e-3
"""Refraction at 15 degrees and more turns the direction by up to 1.2 mrad, of which a root may show all."""
SAME_M = 2e-6
IN_FLIGHT_M = 2e-3
"""The antenna turns by 2e-4 rad in the 2.6 s between sending and receiving."""

TAI = utc_to_tai(epochs_from_strings(["2020-12-01T13:00:00"]))[np.zeros(9, dtype=int)].shifted(
    3600.0 * np.arange(9)
)
BASELINE = ("SESHAN25", "KUNMING")


def model_of(mount="azimuth_elevation", offset_m=OFFSET_M, name="KUNMING", moved_m=None):
    """One station with an offset, all others without."""
    catalogue = StationCatalogue.default()
    for station in catalogue:
        mine = station.name == name
        changed = dataclasses.replace(
            station,
            mount=mount if mine else "azimuth_elevation",
            axis_offset_m=offset_m if mine else None,
            itrf_m=station.itrf_m + (moved_m if mine and moved_m is not None else 0.0),
        )
        catalogue = catalogue.with_station(changed)
    return PhysicalModel.build(catalogue=catalogue, off=["troposphere", "ionosphere"])


def compute(model, kind="vlbi_delay", ends=BASELINE, tai=TAI, count_s=np.nan):
    table = Observations.from_columns(
        epoch=tai_to_utc(tai),
        links=[Link(ends[0], "apollo15", ends[1], MEASUREMENTS[kind].on_baseline)],
        value_m=1.0,
        sigma_m=1.0,
        kind=KINDS.index(kind),
        tag=TIME_TAGS.index("receive"),
        count_s=count_s,
    )
    return ExactPredictor(model, table, APOLLO15_PA_M).compute(APOLLO15_PA_M)


def enu_of(model, tai=TAI):
    """Direction from KUNMING to the point: azimuth from how the delay changes as the station moves, and elevation."""
    step_m = 100.0
    plain_m = compute(model, tai=tai).value_m
    axes = rot_itrf_to_enu(StationCatalogue.default()["KUNMING"].itrf_m)
    moved = [
        compute(model_of(offset_m=None, moved_m=step_m * axis), tai=tai).value_m - plain_m for axis in axes
    ]
    direction = -np.stack(moved, axis=-1) / step_m
    return direction / np.linalg.norm(direction, axis=-1)[:, None]


@pytest.fixture(scope="module")
def plain():
    return model_of(offset_m=None)


@pytest.fixture(scope="module")
def east_north_up(plain):
    return enu_of(plain)


def sine_to_fixed_axis(mount, enu):
    latitude_rad = np.radians(24.88)
    fixed = {
        "azimuth_elevation": [0.0, 0.0, 1.0],
        "equatorial": [0.0, np.cos(latitude_rad), np.sin(latitude_rad)],
        "xy_north": [0.0, 1.0, 0.0],
        "xy_east": [1.0, 0.0, 0.0],
    }[mount]
    return np.linalg.norm(np.cross(enu, fixed), axis=-1)


@pytest.mark.parametrize("mount", MOUNTS)
def test_the_axis_is_nearer_by_what_is_across_the_fixed_one(mount, plain, east_north_up):
    without = compute(plain)
    with_it = compute(model_of(mount))
    high = np.degrees(without.elevation_rad[:, 1]) > 15.0
    assert high.sum() >= 6
    added_m = (with_it.value_m - without.value_m)[high]
    expected_m = -OFFSET_M * sine_to_fixed_axis(mount, east_north_up)[high]
    # Against the pole the Moon moves by its declination alone.
    assert np.ptp(expected_m) > (0.001 if mount == "equatorial" else 0.1)
    np.testing.assert_allclose(added_m, expected_m, rtol=0.0, atol=REFRACTED * OFFSET_M)


def test_refraction_shortens_it_by_three_parts_in_ten_thousand(plain):
    without, with_it = compute(plain), compute(model_of())
    elevation_rad = without.elevation_rad[:, 1]
    high = np.degrees(elevation_rad) > 15.0
    shortened = 1.0 + (with_it.value_m - without.value_m)[high] / (OFFSET_M * np.cos(elevation_rad[high]))
    # The event follows, 1e-6; and the sine levels off near the horizon.
    np.testing.assert_allclose(shortened, 3.1e-4, rtol=0.0, atol=0.1e-4)


def test_sign_and_legs(plain):
    """Each leg of a range is shorter; of a delay the second arrival earlier, the first adds."""
    model = model_of()
    one_leg_m = compute(model, "range", ("SESHAN25", "KUNMING")).value_m
    one_leg_m = one_leg_m - compute(plain, "range", ("SESHAN25", "KUNMING")).value_m
    assert (one_leg_m < 0.0).all()
    two_legs_m = compute(model, "range", ("KUNMING", "KUNMING")).value_m
    two_legs_m = two_legs_m - compute(plain, "range", ("KUNMING", "KUNMING")).value_m
    np.testing.assert_allclose(two_legs_m, 2.0 * one_leg_m, rtol=0.0, atol=IN_FLIGHT_M)
    first_m = compute(model, ends=BASELINE[::-1]).value_m - compute(plain, ends=BASELINE[::-1]).value_m
    np.testing.assert_allclose(first_m, -one_leg_m, rtol=0.0, atol=IN_FLIGHT_M)
    opposite_m = compute(model_of(offset_m=-OFFSET_M), "range", ("SESHAN25", "KUNMING")).value_m
    opposite_m = opposite_m - compute(plain, "range", ("SESHAN25", "KUNMING")).value_m
    np.testing.assert_allclose(opposite_m, -one_leg_m, rtol=0.0, atol=SAME_M)


@pytest.mark.parametrize("kind", ["doppler", "vlbi_delay_rate"])
def test_what_is_counted_has_its_growth(kind, plain):
    whole = {"doppler": "range", "vlbi_delay_rate": "vlbi_delay"}[kind]
    ends = ("KUNMING", "KUNMING") if kind == "doppler" else BASELINE
    late, early = (
        compute(model_of(), whole, ends, TAI.shifted(s)).value_m
        - compute(plain, whole, ends, TAI.shifted(s)).value_m
        for s in (300.0, -300.0)
    )
    grown_m = (
        compute(model_of(), kind, ends, count_s=600.0).value_m
        - compute(plain, kind, ends, count_s=600.0).value_m
    )
    np.testing.assert_allclose(grown_m, late - early, rtol=0.0, atol=SAME_M)
    assert np.abs(grown_m).max() > 0.05


@pytest.mark.parametrize("mount", MOUNTS)
def test_partials(mount, plain):
    """Only what the offset adds to them; the rest is tested elsewhere."""
    model, step_s = model_of(mount), 30.0
    added = compute(model).by_time_m_s - compute(plain).by_time_m_s
    values = [compute(m, tai=TAI.shifted(s)).value_m for m in (model, plain) for s in (step_s, -step_s)]
    numeric = ((values[0] - values[1]) - (values[2] - values[3])) / (2.0 * step_s)
    high = np.degrees(compute(plain).elevation_rad[:, 1]) > 15.0
    # 8 m at the rate of the sky are 6e-4 m/s; refraction, left out of the derivative, is 3e-4 of it.
    at_least = {"azimuth_elevation": 1e-4, "equatorial": 1e-6, "xy_north": 3e-5, "xy_east": 1e-4}
    assert np.abs(numeric[high]).max() > at_least[mount]
    # Near the zenith the root bends, within the minute of the difference by 1e-6 m/s.
    np.testing.assert_allclose(added[high], numeric[high], rtol=0.0, atol=1e-6)
    by_position = compute(model).by_position_pa - compute(plain).by_position_pa
    assert 1e-10 < np.abs(by_position).max() < 1.1 * OFFSET_M / 3.5e8 + 1e-9


def test_off_and_unknown_are_the_same(plain):
    model = model_of()
    off = compute(model.without("antenna_axis_offset")).value_m
    assert (off == compute(plain).value_m).all()
    assert (off == compute(model_of(offset_m=0.0)).value_m).all()
    assert np.abs(compute(model).value_m - off).max() > 1e-3 * C_M_S * 1e-9


def test_catalogue_has_what_is_published():
    """antenna-info.txt of the IVS; beam waveguide and 70 m antennas of the DSN have none by construction."""
    known = {s.name: s.axis_offset_m for s in StationCatalogue.default() if s.axis_offset_m}
    assert known == {
        **{"SESHAN25": 0.00017, "TIANMA65": 0.0071, "KUNMING": -0.0031, "URUMQI": -0.0024},
        **{"EFLSBERG": 0.0103, "MEDICINA": 1.8301, "METSAHOV": -0.0015, "NOTO": 1.8285, "ONSALA60": -0.006},
        **{"WETTZELL20": -0.0001, "YEBES40M": 1.9968, "ZELENCHK": -0.0115, "BADARY": 0.0025},
        **{"HARTRAO": 6.6945, "HART15M": 1.4901, "HOBART12": 0.0021, "HOBART26": 8.1905, "KATH12M": 0.0031},
        **{"YARRA12M": 0.001, "PARKES": 0.0006, "WARK12M": 0.001},
        **{"DSS-13": 0.0081, "DSS-15": -0.0026, "DSS-45": -0.0005, "DSS-65": -0.0053, "UCHINOURA34": -0.001},
    }
    others = {s.name: s.mount for s in StationCatalogue.default() if s.mount != "azimuth_elevation"}
    assert others == {"HARTRAO": "equatorial", "HOBART26": "xy_east"}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"mount": "altaz"}, "mount 'altaz' is not one of azimuth_elevation, equatorial"),
        ({"axis_offset_m": 2130.0}, "no antenna has an axis offset of 2130"),
        ({"axis_offset_m": np.nan}, "axis_offset_m must be a finite number, but is nan"),
    ],
)
def test_what_no_antenna_has(changes, words):
    with pytest.raises(StationError, match=words):
        dataclasses.replace(StationCatalogue.default()["KUNMING"], **changes)
