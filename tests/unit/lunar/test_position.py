"""A point on the Moon with its frame: what is refused, and that the forms agree."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import AltAz, CartesianRepresentation, SphericalRepresentation
from astropy.time import Time
from astropy.utils import iers

from radioloc.ephemeris import Ephemeris
from radioloc.errors import InputError
from radioloc.lunar.position import LunarPosition
from radioloc.measurements import PhysicalModel
from radioloc.simulation import elevations
from radioloc.time import Epochs, utc_to_tt

# JPL's position of the Apollo 15 reflector, PA_DE421 (JPL IOM 335-JW,DB,WF-20080314-001, 2008).
PA_M = (1554678.949, 98094.118, 765004.906)
# From mean-Earth to principal axes of DE421 by turns about x, y and z (Folkner, Williams and Boggs 2009, IPN Progress
# Report 42-178).
ME_TO_PA_ARCSEC = (0.30, 78.56, 67.92)
ROUNDING_M = 1e-8


@pytest.fixture(scope="module")
def constants():
    return Ephemeris.open().constants


def test_frames_are_the_published_turns_apart(constants):
    a, b, c = np.radians(np.array(ME_TO_PA_ARCSEC) / 3600.0)
    about_x = np.array([[1, 0, 0], [0, np.cos(a), np.sin(a)], [0, -np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, -np.sin(b)], [0, 1, 0], [np.sin(b), 0, np.cos(b)]])
    about_z = np.array([[np.cos(c), np.sin(c), 0], [-np.sin(c), np.cos(c), 0], [0, 0, 1]])
    in_me = LunarPosition.from_cartesian(PA_M, "PA_DE421").to_axes("ME", constants)
    assert in_me.frame == "ME_DE421"
    assert about_z @ about_y @ about_x @ in_me.xyz_m == pytest.approx(PA_M, abs=ROUNDING_M)
    assert np.linalg.norm(in_me.xyz_m - PA_M) > 500.0  # not the same axes


@pytest.mark.parametrize(
    ("xyz_m", "message"),
    [
        ((1554.7, 98.1, 765.0), "1.735 km from the Moon's centre.*in metres"),
        ((1e9, 0.0, 0.0), "from the Moon's centre"),
        ((1.7e6, 0.0), "three finite numbers"),
        ("here", "three finite numbers"),
    ],
)
def test_what_is_no_point_of_the_surface(xyz_m, message):
    with pytest.raises(InputError, match=message):
        LunarPosition.from_cartesian(xyz_m, "PA_DE421")


@pytest.mark.parametrize("frame", ["", "PA", "PA_", "ME", "IAU_MOON", "pa_de421", "MOON_PA", None, 3])
def test_unknown_frame(frame):
    with pytest.raises(InputError, match="PA_DE421"):
        LunarPosition.from_cartesian(PA_M, frame)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (("3.6 E", 0.0, 0.0), "longitude_deg"),
        ((361.0, 0.0, 0.0), "longitude_deg"),
        ((0.0, 90.001, 0.0), "latitude_deg"),
        ((0.0, 0.0, 20001.0), "height_m"),
    ],
)
def test_impossible_coordinates(values, message):
    with pytest.raises(InputError, match=message):
        LunarPosition.from_selenographic(*values)


@pytest.mark.parametrize("frame", ["PA_DE430", "ME_DE430"])
def test_position_of_another_ephemeris(frame, constants):
    with pytest.raises(InputError, match=f"expected PA_DE421 or ME_DE421.*got {frame}"):
        LunarPosition.from_cartesian(PA_M, frame).to_axes("PA", constants)


@pytest.mark.parametrize("axes", ["PA", "ME"])
def test_position_of_an_ephemeris_with_the_same_mean_earth_axes_is_turned(axes, constants):
    point = LunarPosition.from_cartesian(PA_M, "PA_DE440")
    turned = point.to_axes(axes, constants)
    assert turned.frame == f"{axes}_DE421"
    assert turned.xyz_m == pytest.approx(point.to_frame(turned.frame).xyz_m, abs=ROUNDING_M)
    # Constant angles: 0.1 to 0.3 arcseconds about y and z.
    assert 1.0 < np.linalg.norm(point.to_axes("PA", constants).xyz_m - PA_M) < 2.0


def test_frames_of_other_ephemerides_are_those_published():
    # Apollo 11's reflector in principal and mean-Earth axes of DE430 (JPL IOM 335-JW,DB,WF-20130722-016, tables 6, 7).
    mean = LunarPosition.from_cartesian((1591966.550, 690699.375, 21003.866), "PA_DE430").to_frame("ME_DE430")
    assert mean.selenographic[:2] == pytest.approx((23.4730244, 0.6734595), abs=1e-7)
    # From DE421's mean-Earth axes to the principal ones of DE440 (NAIF's moon_de440_200625.tf).
    point = LunarPosition.from_cartesian(PA_M, "PA_DE421")
    a, b, c = np.radians(np.array((0.2785, 78.6944, 67.8526)) / 3600.0)
    small = np.array([[0.0, c, -b], [-c, 0.0, a], [b, -a, 0.0]])
    expected = np.array(point.to_frame("ME_DE421").xyz_m) @ (np.eye(3) + small + 0.5 * small @ small).T
    assert point.to_frame("PA_DE440").xyz_m == pytest.approx(
        expected, abs=0.2
    )  # of the second order's sequence
    assert point.to_frame("PA_DE440").to_frame("PA_DE421").xyz_m == pytest.approx(PA_M, abs=ROUNDING_M)


@pytest.mark.parametrize(("frame", "message"), [("PA_DE999", "not known"), ("ME_DE430", "not available")])
def test_frames_to_which_nothing_leads_are_refused(frame, message):
    with pytest.raises(InputError, match=message):
        LunarPosition.from_cartesian(PA_M, "PA_DE421").to_frame(frame)


def test_a_representation_of_astropy_is_converted():
    point = LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
    place = CartesianRepresentation(point.xyz_m, unit="m").represent_as(SphericalRepresentation)
    assert place.lon.wrap_at(180 * u.deg).deg == pytest.approx(-51.9162, abs=1e-9)
    assert place.lat.deg == pytest.approx(43.0584, abs=1e-9)
    assert place.distance.to_value("m") == pytest.approx(1737400.0 - 2550.4, abs=1e-6)
    assert LunarPosition("ME_DE421", place).xyz_m == pytest.approx(point.xyz_m, abs=ROUNDING_M)


ARCSECOND_RAD = np.radians(1.0 / 3600.0)
"""Diurnal aberration, 0.3 arcseconds, and polar motion are what pointing leaves out."""


@pytest.mark.parametrize("frame", ["ME_DE421", "PA_DE440"])
def test_the_sky_of_astropy_has_the_elevations_of_tracking(frame):
    point = LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4).to_frame(frame)
    model = PhysicalModel.build(off=["troposphere"])
    time = Time(["2020-12-01T15:11:00", "2020-12-01T18:00:00", "2020-12-02T15:11:00"], scale="utc")
    kashi = model.catalogue.get("KASHI")
    with iers.conf.set_temp("auto_download", False):
        direction = point.to_gcrs(time).transform_to(AltAz(obstime=time, location=kashi.location))
    ours = elevations(model, point, ["KASHI"], utc_to_tt(Epochs.from_time(time)))
    assert direction.alt.rad == pytest.approx(ours.at_station_rad[:, 0], abs=ARCSECOND_RAD)
    assert (direction.distance.to_value("m") > 3.4e8).all()
