"""Elevations against the measurement model and astropy; rise and set against elevations."""

import numpy as np
import pytest

from radioloc.lunar.frames import hidden_by_moon
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.target_motion import FixedPoint
from radioloc.simulation import Masks, Schedule, Session, elevations, two_way, visibility, windows
from radioloc.simulation.visibility import Sight, horizon_notes
from radioloc.time import Epochs, epochs_from_strings, utc_strings, utc_to_tt

# From the model, which also has tides and the aberration of a moving station; 2 arcsec more at transmission.
RECEPTION_RAD, TRANSMISSION_RAD = 1e-6, 2e-5
# Error of the built-in Moon of astropy, with the light time of the geocentre.
ASTROPY_RAD = 1e-4


def test_elevations_are_those_of_the_measurement_model(model, lander, lander_pa_m, compute):
    stations = ("JIAMUSI", "KASHI", "NEUQUEN")
    session = Session("range", two_way(*stations), "2020-12-01T00:00", "2020-12-03T00:00", 1800.0, 1.0)
    observations = Schedule([session], Masks(5.0)).plan(model, lander).observations
    predicted = compute(model, observations, lander_pa_m).elevation_rad
    station = [stations.index(observations.links[i].receiver) for i in observations.link]
    assert len(observations) > 50
    assert len(set(station)) == 3
    # Transmission is 2.56 to 2.6 s earlier, in which the target rises by 1e-4 rad.
    for end, earlier_s, tolerance_rad in ((1, 0.0, RECEPTION_RAD), (0, 2.58, TRANSMISSION_RAD)):
        tt = utc_to_tt(observations.epoch).shifted(-earlier_s)
        elevation_rad = elevations(model, lander, stations, tt).at_station_rad
        at_station = elevation_rad[np.arange(len(observations)), station]
        np.testing.assert_allclose(at_station, predicted[:, end], rtol=0.0, atol=tolerance_rad)


def test_elevation_of_the_centre_of_the_moon_agrees_with_astropy(model):
    coordinates = pytest.importorskip("astropy.coordinates")
    from astropy import units
    from astropy.time import Time
    from astropy.utils import iers

    utc = Epochs.from_jd(2459184.5, np.linspace(0.0, 0.99, 25), "UTC")
    name = "SESHAN25"
    place = coordinates.EarthLocation.from_geocentric(*model.catalogue.get(name).itrf_m, unit=units.m)
    with iers.conf.set_temp("auto_download", False):
        time = Time(utc_strings(utc).tolist(), scale="utc")
        moon = coordinates.get_body("moon", time, place, ephemeris="builtin")
        altitude_rad = moon.transform_to(coordinates.AltAz(obstime=time, location=place)).alt.rad
    centre = FixedPoint(np.array([1.0, 0.0, 0.0]))
    elevation_rad = elevations(model, centre, [name], utc_to_tt(utc)).at_station_rad[:, 0]
    np.testing.assert_allclose(elevation_rad, altitude_rad, rtol=0.0, atol=ASTROPY_RAD)


def test_elevation_of_the_earth_follows_the_librations(model):
    tt = utc_to_tt(Epochs.from_jd(2459184.5, np.linspace(0.0, 28.0, 57), "UTC"))

    def at_target_deg(longitude_deg, latitude_deg):
        point = LunarPosition.from_selenographic(longitude_deg, latitude_deg, 0.0)
        return np.degrees(elevations(model, point, ["KASHI", "NEUQUEN"], tt).at_target_rad)

    # Optical libration is up to 7.9 deg in longitude, 6.9 deg in latitude; the stations are 1 deg off the geocentre.
    assert at_target_deg(0.0, 0.0).min() > 90.0 - 11.5
    assert at_target_deg(180.0, 0.0).max() < -90.0 + 11.5
    # At a pole the elevation of the Earth is the libration in latitude, of both signs in a month.
    pole = at_target_deg(0.0, 90.0)
    assert -8.0 < pole.min() < -4.0 < 4.0 < pole.max() < 8.0
    np.testing.assert_allclose(pole, -at_target_deg(0.0, -90.0), atol=0.6)


def test_rise_and_set_are_exact_to_the_second(model, lander):
    masks = Masks(10.0, by_station_deg={"NEUQUEN": 15.0})
    intervals = windows(model, lander, ["Kashgar"], "2020-12-01T00:00", "2020-12-04T00:00", masks)
    intervals += windows(model, lander, ["ZAPALA"], "2020-12-01T00:00", "2020-12-04T00:00", masks)
    assert sum(w.rises for w in intervals) >= 5
    assert sum(w.sets for w in intervals) >= 5
    for station, window in zip(["KASHI"] * 4 + ["NEUQUEN"] * 3, intervals, strict=True):
        limits = utc_to_tt(epochs_from_strings([window.start_utc, window.stop_utc], "UTC"))
        at_limits = elevations(model, lander, [station], limits)
        # Rounded into the window, up to the tolerance of the crossing, a tenth of a second.
        assert (at_limits.margin_rad(masks) > -np.radians(0.1 * 15.0 / 3600.0)).all()
        margin_rad = elevations(model, lander, [station], limits.shifted([-1.1, 1.1])).margin_rad(masks)
        assert (margin_rad[:, 0] < 0.0).tolist() == [window.rises, window.sets]


def test_windows_of_two_stations_are_the_overlap(model, lander):
    limits = "2020-12-01T15:11:00", "2020-12-03T15:10:00"
    jiamusi, kashi, common = (
        windows(model, lander, names, *limits) for names in (["JIAMUSI"], ["KASHI"], ["JIAMUSI", "KASHI"])
    )
    overlaps = [
        (max(a.start_utc, b.start_utc), min(a.stop_utc, b.stop_utc))
        for a in jiamusi
        for b in kashi
        if max(a.start_utc, b.start_utc) < min(a.stop_utc, b.stop_utc)
    ]
    assert [(w.start_utc, w.stop_utc) for w in common] == overlaps
    assert common[0].start_utc == limits[0]
    assert not common[0].rises
    assert common[-1].stop_utc == limits[1]
    assert not common[-1].sets


def test_far_side_has_no_windows(model):
    target = LunarPosition.from_selenographic(180.0, 0.0, 0.0)
    assert windows(model, target, ["KASHI"], "2020-12-01", "2020-12-03") == []
    (window,) = windows(model, target, ["KASHI"], "2020-12-01", "2020-12-03", Masks(-90.0, -90.0))
    assert (window.rises, window.sets) == (False, False)
    assert (window.start_utc, window.stop_utc) == ("2020-12-01T00:00:00", "2020-12-03T00:00:00")


def test_points_behind_the_moon_are_hidden():
    station_m = np.array([3.8e8, 0.0, 0.0])
    points_m = np.array(
        [
            [1.8e6, 0.0, 0.0],  # in front of the Moon
            [-1.8e6, 0.0, 0.0],  # behind the Moon
            [-1.8e6, 1.8e6, 0.0],  # behind and beside the Moon
            [0.0, 0.0, 1.7375e6],  # above the limb
            [-2.0e5, 0.0, 1.7374e6],  # slightly behind the limb
            [5.0e8, 0.0, 0.0],  # beyond the station
        ]
    )
    assert hidden_by_moon(points_m, station_m).tolist() == [False, True, False, False, True, False]


STATIONS = ["KASHI", "NEUQUEN", "SESHAN25"]


def every_s(step_s, hours):
    return utc_to_tt(Epochs.from_jd(2459185.1, np.arange(0.0, hours * 3600.0, step_s) / 86400.0, "UTC"))


@pytest.mark.parametrize("mask_deg", [10.0, 40.0])
def test_visibility_is_that_of_the_elevations_at_each_epoch(model, lander, lander_pa_m, mask_deg):
    tt, masks = every_s(5.0, 30.0), Masks(mask_deg, by_station_deg={"NEUQUEN": 25.0})
    visible = Sight(model, STATIONS, tt).is_visible(FixedPoint(lander_pa_m), masks)
    np.testing.assert_array_equal(visible, elevations(model, lander, STATIONS, tt).margin_rad(masks) >= 0.0)
    assert (np.diff(visible, axis=0).sum(axis=0) >= 2).all()


@pytest.mark.study
def test_a_culmination_of_seconds_above_the_mask_is_not_missed(model, lander, lander_pa_m):
    tt = every_s(1.0, 26.0)
    highest_rad = elevations(model, lander, ["KASHI"], tt).at_station_rad.max()
    masks = Masks(float(np.degrees(highest_rad)) - 1e-7)
    assert 0 < Sight(model, ["KASHI"], tt).is_visible(FixedPoint(lander_pa_m), masks).sum() < 60


def test_elevations_change_less_than_the_bound(model, lander):
    angles = elevations(model, lander, STATIONS, every_s(600.0, 24.0 * 28.0))
    for elevation_rad in (angles.at_station_rad, angles.at_target_rad):
        assert np.abs(np.diff(elevation_rad, axis=0)).max() / 600.0 < visibility._MAX_ELEVATION_RATE_RAD_S


@pytest.mark.parametrize(
    ("latitude_deg", "target_deg", "count"), [(-89.5, 0.0, 1), (-89.5, 5.0, 0), (43.0, 0.0, 0)]
)
def test_plan_near_the_limb_without_a_mask_of_terrain_has_a_note(latitude_deg, target_deg, count):
    point = LunarPosition.from_selenographic(0.0, latitude_deg, 0.0)
    assert len(horizon_notes(Masks(target_deg=target_deg), [point.xyz_m])) == count
