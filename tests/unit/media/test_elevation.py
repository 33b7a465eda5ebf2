"""Elevation by hand, and its rate by differences."""

from __future__ import annotations

import numpy as np
import pytest
from arc_cases import APOLLO15_PA_M, LASER, epochs_tai, observations
from legs import end, state

from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.earth.stations import StationCatalogue
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.media.medium import Leg
from radioloc.time import tt_to_tdb, utc_to_tt


def elevation_of(station, target_m, velocity_m_s):
    return Leg(end(1), station, target_m, velocity_m_s).elevation


@pytest.mark.parametrize("degrees", [-90.0, -20.0, 0.0, 1e-7, 45.0, 89.9999999, 90.0])
def test_elevation_by_hand(degrees):
    angle = np.radians(degrees)
    point = 3.8e8 * np.array([[np.cos(angle), 0.0, np.sin(angle)]])
    found = elevation_of(state((0.0, 0.0, 1.0)), point, np.zeros((1, 3)))
    assert found.angle_rad[0] == pytest.approx(angle, rel=0, abs=3e-16)
    assert found.rate_rad_s.tolist() == [0.0]


def test_rate_has_the_points_the_stations_and_the_verticals_part():
    point, r = np.array([[0.0, 3.8e8, 0.0]]), 3.8e8
    moving_point = elevation_of(state((0.0, 0.0, 1.0)), point, np.array([[5.0, 7.0, 1000.0]]))
    assert moving_point.rate_rad_s[0] == pytest.approx(1000.0 / r, rel=1e-12)
    station = state((0.0, 0.0, 1.0), velocity=(0.0, 0.0, 400.0))
    assert elevation_of(station, point, np.zeros((1, 3))).rate_rad_s[0] == pytest.approx(
        -400.0 / r, rel=1e-12
    )
    station = state((0.0, 0.0, 1.0), up_rate=(0.0, 7e-5, 0.0))
    assert elevation_of(station, point, np.zeros((1, 3))).rate_rad_s[0] == pytest.approx(7e-5, rel=1e-12)


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build()


def test_elevation_of_the_moon_against_plain_geometry(model):
    """East, north, up of the Moon's direction by the ITRF, without light time: 1.3 s of turning are 1e-4 rad."""
    tai = epochs_tai(24, 48.0)
    table = observations("GRASSE>x>APOLLO", tai, **LASER)
    found = ExactPredictor(model, table, APOLLO15_PA_M).compute(APOLLO15_PA_M).elevation_rad
    tt = utc_to_tt(table.epoch)
    moon_m, _ = model.ephemeris.geocentric("moon", tt_to_tdb(tt))
    to_itrf = np.swapaxes(model.earth.evaluate(tt).rot_itrf_to_gcrs, -1, -2)
    moon_itrf_m = np.einsum("nij,nj->ni", to_itrf, moon_m)
    for k, name in enumerate(("GRASSE", "APOLLO")):
        itrf_m = StationCatalogue.default()[name].itrf_m
        enu = (moon_itrf_m - itrf_m) @ rot_itrf_to_enu(itrf_m).T
        plain = np.arctan2(enu[:, 2], np.hypot(enu[:, 0], enu[:, 1]))
        # Apollo 15 stands up to 0.26 deg from the Moon's centre; light time 2.6 s turn the Earth by 0.011 deg.
        assert np.abs(np.degrees(found[:, k] - plain)).max() < 0.3
    assert np.abs(found).max() > 0.8


def test_rate_against_differences(model):
    motions = {}
    for shift_s in (-1.0, 0.0, 1.0):
        tai = epochs_tai(24, 48.0).shifted(shift_s)
        arc = ExactPredictor(model, observations("GRASSE>x>APOLLO", tai, **LASER), APOLLO15_PA_M)
        path, relay, *_ = arc._solve(APOLLO15_PA_M)
        motions[shift_s] = arc._lines_of_sight(path, relay).leg.elevation
    numeric = (motions[1.0].angle_rad - motions[-1.0].angle_rad) / 2.0
    # The light time's own change (1e-6 of 7e-5 rad/s) and the curvature over a second are below this.
    np.testing.assert_allclose(motions[0.0].rate_rad_s, numeric, rtol=0, atol=1e-9)
    assert (np.abs(numeric.reshape(2, -1)).max(axis=1) > 3e-5).all()


def test_derivative_by_position():
    station, step_m = state((0.36, -0.48, 0.8)), 100.0
    point = np.array([[2.2e8, -1.9e8, 2.4e8]])
    numeric = [
        (
            elevation_of(station, point + away, np.zeros((1, 3))).angle_rad[0]
            - elevation_of(station, point - away, np.zeros((1, 3))).angle_rad[0]
        )
        / (2.0 * step_m)
        for away in step_m * np.eye(3)
    ]
    found = elevation_of(station, point, np.zeros((1, 3))).by_position_rad_m[0]
    # Angles of 1 rad are rounded to 1e-16, so differences over 200 m to 1e-18 rad/m.
    np.testing.assert_allclose(found, numeric, rtol=0, atol=3e-18)
