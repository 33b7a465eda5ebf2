"""Elevations against the measurement model and astropy; rise and set against the elevations."""

import numpy as np
import pytest

from radioloc.errors import InputError, StationError
from radioloc.lunar.position import LunarPosition
from radioloc.simulation import Masks, Schedule, Session, elevations, hidden_by_moon, two_way, windows
from radioloc.time import Epochs, epochs_from_strings, utc_strings, utc_to_tt

# Of the model, which has tides and the aberration of a moving station too; the sending differs by 2 arcsec more.
RECEIVED_RAD, SENT_RAD = 1e-6, 2e-5
# astropy's built-in Moon is good to some 10 arcsec, and refers to the geocentre's light time.
ASTROPY_RAD = 1e-4


def test_elevations_are_those_of_the_measurement_model(model, lander_pa_m, compute):
    stations = ("JIAMUSI", "KASHI", "NEUQUEN")
    session = Session("range", two_way(*stations), "2020-12-01T00:00", "2020-12-03T00:00", 1800.0, 1.0)
    observations = Schedule([session], Masks(5.0)).plan(model, lander_pa_m).observations
    predicted = compute(model, observations, lander_pa_m).elevation_rad
    which = [stations.index(observations.links[i].receiver) for i in observations.link]
    assert len(observations) > 50
    assert len(set(which)) == 3
    # A signal was sent 2.56 to 2.6 s before, in which the target rises by 1e-4 rad.
    for end, earlier_s, tolerance_rad in ((1, 0.0, RECEIVED_RAD), (0, 2.58, SENT_RAD)):
        tt = utc_to_tt(observations.epoch).shifted(-earlier_s)
        found = elevations(model, lander_pa_m, stations, tt).at_station_rad
        at_station = found[np.arange(len(observations)), which]
        np.testing.assert_allclose(at_station, predicted[:, end], rtol=0.0, atol=tolerance_rad)


def test_elevation_of_the_moons_centre_as_astropy_has_it(model):
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
    found = elevations(model, np.array([1.0, 0.0, 0.0]), [name], utc_to_tt(utc)).at_station_rad[:, 0]
    np.testing.assert_allclose(found, altitude_rad, rtol=0.0, atol=ASTROPY_RAD)


def test_the_earth_stands_high_in_the_middle_of_the_near_side_and_below_the_horizon_of_the_far_side(model):
    tt = utc_to_tt(Epochs.from_jd(2459184.5, np.linspace(0.0, 28.0, 57), "UTC"))

    def at_target_deg(longitude_deg, latitude_deg):
        point = LunarPosition.from_selenographic(longitude_deg, latitude_deg, 0.0)
        point_pa_m = point.to_axes("PA", model.ephemeris.constants).xyz_m
        return np.degrees(elevations(model, point_pa_m, ["KASHI", "NEUQUEN"], tt).at_target_rad)

    # Optical libration is up to 7.9 deg in longitude, 6.9 deg in latitude; the stations are 1 deg off the geocentre.
    assert at_target_deg(0.0, 0.0).min() > 90.0 - 11.5
    assert at_target_deg(180.0, 0.0).max() < -90.0 + 11.5
    # At the pole the Earth stands as high as the libration in latitude is; it has both signs in a month.
    pole = at_target_deg(0.0, 90.0)
    assert -8.0 < pole.min() < -4.0 < 4.0 < pole.max() < 8.0
    np.testing.assert_allclose(pole, -at_target_deg(0.0, -90.0), atol=0.6)


def test_rise_and_set_are_good_to_the_second(model, lander_pa_m):
    masks = Masks(10.0, by_station_deg={"NEUQUEN": 15.0})
    found = windows(
        model, lander_pa_m, ["Kashgar", "ZAPALA"][:1], "2020-12-01T00:00", "2020-12-04T00:00", masks
    )
    found += windows(model, lander_pa_m, ["ZAPALA"], "2020-12-01T00:00", "2020-12-04T00:00", masks)
    assert sum(w.rises for w in found) >= 5
    assert sum(w.sets for w in found) >= 5
    for station, window in zip(["KASHI"] * 4 + ["NEUQUEN"] * 3, found, strict=True):
        limits = utc_to_tt(epochs_from_strings([window.start_utc, window.stop_utc], "UTC"))
        inside = elevations(model, lander_pa_m, [station], limits)
        # Rounded into the window, but for the tenth of a second to which the crossing is known.
        assert (inside.margin_rad(masks) > -np.radians(0.1 * 15.0 / 3600.0)).all()
        outside = elevations(model, lander_pa_m, [station], limits.shifted([-1.1, 1.1])).margin_rad(masks)
        assert (outside[:, 0] < 0.0).tolist() == [window.rises, window.sets]


def test_windows_in_common_are_the_overlap(model, lander_pa_m):
    limits = "2020-12-01T15:11:00", "2020-12-03T15:10:00"
    one, two, both = (
        windows(model, lander_pa_m, names, *limits)
        for names in (["JIAMUSI"], ["KASHI"], ["JIAMUSI", "KASHI"])
    )
    overlaps = [
        (max(a.start_utc, b.start_utc), min(a.stop_utc, b.stop_utc))
        for a in one
        for b in two
        if max(a.start_utc, b.start_utc) < min(a.stop_utc, b.stop_utc)
    ]
    assert [(w.start_utc, w.stop_utc) for w in both] == overlaps
    assert both[0].start_utc == limits[0]
    assert not both[0].rises
    assert both[-1].stop_utc == limits[1]
    assert not both[-1].sets


def test_no_window_where_the_target_looks_away(model):
    far = LunarPosition.from_selenographic(180.0, 0.0, 0.0).to_axes("PA", model.ephemeris.constants)
    assert windows(model, far.xyz_m, ["KASHI"], "2020-12-01", "2020-12-03") == []
    (always,) = windows(model, far.xyz_m, ["KASHI"], "2020-12-01", "2020-12-03", Masks(-90.0, -90.0))
    assert (always.rises, always.sets) == (False, False)
    assert (always.start_utc, always.stop_utc) == ("2020-12-01T00:00:00", "2020-12-03T00:00:00")


def test_what_cannot_be_searched_is_refused(model, lander_pa_m):
    with pytest.raises(InputError, match="got 2020-12-01"):
        windows(model, lander_pa_m, ["KASHI"], "2020-12-02", "2020-12-01")
    with pytest.raises(InputError, match="expected at least one, got none"):
        windows(model, lander_pa_m, [], "2020-12-01", "2020-12-02")
    with pytest.raises(StationError, match="KASHY"):
        windows(model, lander_pa_m, ["KASHY"], "2020-12-01", "2020-12-02")
    with pytest.raises(InputError, match="91"):
        Masks(by_station_deg={"KASHI": 91.0})


def test_the_moon_hides_what_is_behind_it():
    station_m = np.array([3.8e8, 0.0, 0.0])
    points_m = np.array(
        [
            [1.8e6, 0.0, 0.0],  # before it
            [-1.8e6, 0.0, 0.0],  # behind it
            [-1.8e6, 1.8e6, 0.0],  # behind, but beside
            [0.0, 0.0, 1.7375e6],  # over the limb
            [-2.0e5, 0.0, 1.7374e6],  # a little behind the limb
            [5.0e8, 0.0, 0.0],  # beyond the station
        ]
    )
    assert hidden_by_moon(points_m, station_m).tolist() == [False, True, False, False, True, False]
