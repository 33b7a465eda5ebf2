"""Light times and pointing against SPICE, ERFA and Skyfield.

Places of Earth and Moon are SPICE's, those of stations ERFA's ``c2t06a`` with daily Earth orientation, light times are
found by a loop of its own. Apparent places are ERFA's ``apco13``, which has an ephemeris of the Earth of its own.
"""

from contextlib import closing
from io import BytesIO

import erfa
import numpy as np
import pytest
import spiceypy
from moon_frame import PA_FRAME, spice_moon

import radioloc
from radioloc import light_times
from radioloc.constants import ARCSEC_RAD, C_M_S
from radioloc.earth import StationCatalogue, geodetic_from_itrf
from radioloc.earth.eop import EopTable
from radioloc.errors import InputError
from radioloc.kernels import find_kernel
from radioloc.measurements.physical_model import TERMS
from radioloc.study import ModelChoice, Study
from radioloc.time import utc_to_tt

LANDER = radioloc.LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
SPAN = {"start_utc": "2020-12-02T00:00:00", "stop_utc": "2020-12-02T22:00:00", "step_s": 2900.0}
STATIONS = ["KASHI", "NEUQUEN", "JIAMUSI"]
# 15 mm: SPICE's epoch is one float, in which the Earth moves by 3.6 mm; subdaily Earth orientation, off here, is not.
LIGHT_S = 5e-11
# Corrections to precession and nutation, 0.3 mas, and light bent by the Sun, of stars, 0.7 mas.
POINTING_ARCSEC = 0.005


@pytest.fixture(scope="module", autouse=True)
def _spice(tmp_path_factory):
    with spice_moon(tmp_path_factory.mktemp("spice")):
        yield


def bare_study():
    """Return a study of geometry alone."""
    return Study(target=LANDER, model=ModelChoice(off=TERMS))


@pytest.fixture(scope="module")
def geometric():
    return light_times(bare_study(), STATIONS, links="all", **SPAN)


def barycentric_m(code, et):
    return 1e3 * np.array(spiceypy.spkgeo(code, et, "J2000", 0)[0])


def lander_m(et):
    place_m = spiceypy.pxform("MOON_PA_DE421", "J2000", et) @ LANDER.to_frame("PA_DE421").xyz_m
    return barycentric_m(301, et)[:3] + place_m


class Site:
    """A station in the barycentric frame around an instant, by ERFA."""

    def __init__(self, name, tt):
        self.itrf_m = StationCatalogue.default().get(name).itrf_m
        eop = EopTable.packaged().interpolate(tt)
        self.ut1 = tt.shifted(eop.ut1_minus_tt_s)
        self.tt, self.pole_rad = tt, (float(eop.xp_rad[0]), float(eop.yp_rad[0]))
        self.dut1_minus_tt_s = float(eop.ut1_minus_tt_s[0])
        self.dtdb_s = float(erfa.dtdb(tt.jd[0], tt.fraction[0], 0.0, 0.0, 0.0, 0.0))
        self.et = ((tt.jd[0] - 2451545.0) + tt.fraction[0]) * 86400.0 + self.dtdb_s

    def gcrs_m(self, after_s):
        epochs = self.tt.shifted(after_s), self.ut1.shifted(after_s)
        dates = (epochs[0].jd[0], epochs[0].fraction[0], epochs[1].jd[0], epochs[1].fraction[0])
        return erfa.c2t06a(*dates, *self.pole_rad).T @ self.itrf_m

    def at_m(self, after_s):
        return barycentric_m(399, self.et + after_s)[:3] + self.gcrs_m(after_s)

    def velocity_m_s(self, after_s):
        return (self.at_m(after_s + 10.0) - self.at_m(after_s - 10.0)) / 20.0


def solved(sender, receiver, tt):
    """Light times up and down, and unit vectors from each station to the lander, by repeated substitution."""
    first, second = Site(sender, tt), Site(receiver, tt)
    down_s, up_s = 1.3, 1.3
    for _ in range(8):
        bounce_m = lander_m(second.et - down_s)
        seen_m = bounce_m - second.at_m(0.0)
        sent_m = bounce_m - first.at_m(-down_s - up_s)
        down_s, up_s = np.linalg.norm(seen_m) / C_M_S, np.linalg.norm(sent_m) / C_M_S
    return up_s, down_s, sent_m / np.linalg.norm(sent_m), seen_m / np.linalg.norm(seen_m)


def names_of(path):
    return path.split(">")[0], path.split(">")[2]


def test_light_times_of_both_legs(geometric):
    assert len(geometric) > 60
    assert len(set(geometric.path[:])) == 9
    for row in range(0, len(geometric), 3):
        tt = utc_to_tt(geometric.epoch[row])
        up_s, down_s, _, _ = solved(*names_of(geometric.path[row]), tt)
        assert geometric["uplink_light_time_s"][row] == pytest.approx(up_s, abs=LIGHT_S)
        assert geometric["downlink_light_time_s"][row] == pytest.approx(down_s, abs=LIGHT_S)
        # Without `tdb_tt` the clocks measure durations in TDB.
        assert geometric["range_m"][row] == pytest.approx(C_M_S * (up_s + down_s), abs=2.0 * C_M_S * LIGHT_S)


def arcsec_apart(table, row, prefix, longitude_deg, latitude_deg, vector):
    """Return the angle between a direction of the table and another one."""
    first, second = (
        erfa.s2c(np.radians(longitude), np.radians(latitude))
        for longitude, latitude in (
            (table[f"{prefix}_{vector[0]}_deg"][row], table[f"{prefix}_{vector[1]}_deg"][row]),
            (longitude_deg, latitude_deg),
        )
    )
    return np.linalg.norm(first - second) / ARCSEC_RAD


AZ_EL, RADEC, ICRS = ("azimuth", "elevation"), ("ra", "dec"), ("icrs_ra", "icrs_dec")


def observed(site, astrometric, utc):
    """Azimuth, elevation, apparent right ascension and declination of an astrometric direction, deg, by ERFA."""
    place = geodetic_from_itrf(site.itrf_m)
    dut1_s = site.dut1_minus_tt_s + 32.184 + 37.0
    coordinates = float(place.longitude_rad), float(place.latitude_rad), float(place.height_m)
    star, eo = erfa.apco13(
        utc.jd[0], utc.fraction[0], dut1_s, *coordinates, *site.pole_rad, 0.0, 0.0, 0.0, 0.5
    )
    ra_rad, dec_rad = erfa.atciqz(*erfa.c2s(astrometric), star)
    azimuth_rad, zenith_rad, *_ = erfa.atioq(ra_rad, dec_rad, star)
    angles_rad = azimuth_rad, np.pi / 2.0 - zenith_rad, erfa.anp(ra_rad - eo), dec_rad
    return np.degrees(angles_rad)


def test_pointing_at_reception(geometric):
    for row in range(0, len(geometric), 3):
        utc = geometric.epoch[row]
        sender, receiver = names_of(geometric.path[row])
        *_, astrometric = solved(sender, receiver, utc_to_tt(utc))
        site = Site(receiver, utc_to_tt(utc))
        ra_rad, dec_rad = erfa.c2s(astrometric)
        assert arcsec_apart(geometric, row, "receive", *np.degrees((ra_rad, dec_rad)), ICRS) < 0.001
        azimuth, elevation, ra, dec = observed(site, astrometric, utc)
        assert arcsec_apart(geometric, row, "receive", azimuth, elevation, AZ_EL) < POINTING_ARCSEC
        assert arcsec_apart(geometric, row, "receive", ra, dec, RADEC) < POINTING_ARCSEC


def test_pointing_at_transmission(geometric):
    """The direction in which light is sent, as the station that moves has it: a boost of its four-vector."""
    for row in range(0, len(geometric), 5):
        utc = geometric.epoch[row]
        sender, receiver = names_of(geometric.path[row])
        up_s, down_s, sent, _ = solved(sender, receiver, utc_to_tt(utc))
        site = Site(sender, utc_to_tt(utc))
        beta = site.velocity_m_s(-up_s - down_s) / C_M_S
        gamma = 1.0 / np.sqrt(1.0 - beta @ beta)
        boosted = sent + ((gamma - 1.0) * (beta @ sent) / (beta @ beta) - gamma) * beta
        direction = boosted / np.linalg.norm(boosted)
        emission = utc_to_tt(utc).shifted(-up_s - down_s)
        of_date = erfa.pnm06a(emission.jd[0], emission.fraction[0]) @ direction
        assert arcsec_apart(geometric, row, "transmit", *np.degrees(erfa.c2s(of_date)), RADEC) < 0.001
        # Light that comes from there is aberrated the other way: twice 20 arcseconds and the Moon's way between.
        assert arcsec_apart(geometric, row, "transmit", *np.degrees(erfa.c2s(sent)), ICRS) < 0.001
        rot_to_itrf = erfa.c2t06a(
            emission.jd[0],
            emission.fraction[0],
            site.ut1.jd[0],
            site.ut1.fraction[0] - (up_s + down_s) / 86400.0,
            *site.pole_rad,
        )
        place = geodetic_from_itrf(site.itrf_m)
        enu = radioloc.lunar.east_north_up(place.longitude_rad, place.latitude_rad) @ rot_to_itrf @ direction
        azimuth, elevation = np.arctan2(enu[0], enu[1]), np.arcsin(enu[2])
        assert (
            arcsec_apart(geometric, row, "transmit", *np.degrees((azimuth, elevation)), AZ_EL)
            < POINTING_ARCSEC
        )


def test_against_skyfield():
    """Skyfield has no motion of the pole, 0.33 arcseconds then, which turns what is horizontal and vertical."""
    from skyfield.api import load, load_file, wgs84
    from skyfield.planetarylib import PlanetaryConstants, PlanetTopos
    from skyfield.units import Angle, Distance

    table = light_times(Study(target=LANDER), ["KASHI", "NEUQUEN"], links="one_way", **SPAN)
    longitude_deg, latitude_deg, height_m = LANDER.to_frame("PA_DE421").selenographic
    axes = PlanetaryConstants()
    with (
        find_kernel("DE421", "PCK").open("rb") as libration,
        closing(load_file(str(find_kernel("DE421", "SPK")))) as bodies,
    ):
        axes.read_text(BytesIO(PA_FRAME.encode()))
        axes.read_binary(libration)
        place = PlanetTopos.from_latlon_distance(
            axes.build_frame_named("MOON_PA_DE421"),
            Angle(degrees=latitude_deg),
            Angle(degrees=longitude_deg),
            Distance(m=1737400.0 + height_m),
        )
        for row in range(0, len(table), 4):
            name = table.path[row].split(">")[1]
            site = geodetic_from_itrf(StationCatalogue.default().get(name).itrf_m)
            degrees = np.degrees((site.latitude_rad, site.longitude_rad))
            station = bodies["earth"] + wgs84.latlon(*degrees, site.height_m)
            epoch = load.timescale(builtin=True).from_astropy(table.epoch[row].to_time()[0])
            astrometric = station.at(epoch).observe(bodies["moon"] + place)
            assert astrometric.light_time * 86400.0 == pytest.approx(
                table["downlink_light_time_s"][row], abs=1e-7
            )
            right, declination, _ = astrometric.radec()
            assert (
                arcsec_apart(table, row, "receive", right._degrees, declination.degrees, ICRS)
                < POINTING_ARCSEC
            )
            right, declination, _ = astrometric.apparent().radec("date")
            assert (
                arcsec_apart(table, row, "receive", right._degrees, declination.degrees, RADEC)
                < POINTING_ARCSEC
            )
            altitude, azimuth, _ = astrometric.apparent().altaz()
            assert arcsec_apart(table, row, "receive", azimuth.degrees, altitude.degrees, AZ_EL) < 0.34
    bodies.close()


def test_rates_and_doppler_are_how_ranges_change():
    span = {"start_utc": "2020-12-02T16:00:00", "stop_utc": "2020-12-02T16:00:06", "step_s": 3.0}
    for links in ("two_way", "three_way", "one_way"):
        table = light_times(
            Study(target=LANDER), ["KASHI", "JIAMUSI"], links=links, frequency_hz=8.47e9, **span
        )
        for path in table.path.texts:
            previous, row, following = np.flatnonzero(table.path.are(path))
            rate_m_s = (table["range_m"][following] - table["range_m"][previous]) / 6.0
            # The third derivative, 4e-6 m/s^3, over seconds.
            assert table["range_rate_m_s"][row] == pytest.approx(rate_m_s, abs=8e-6)
            # By frequencies: what leaves in a time arrives in another one.
            arrives_s = 6.0
            leaves_s = arrives_s - (table["range_m"][following] - table["range_m"][previous]) / C_M_S
            received_hz = 8.47e9 * leaves_s / arrives_s
            assert table["doppler_hz"][row] == pytest.approx(received_hz - 8.47e9, abs=3e-4)
        if links == "one_way":
            assert np.isnan(table["uplink_light_time_s"]).all()
            assert np.isnan(table["transmit_azimuth_deg"]).all()


def test_clocks_differ_from_light_times_by_tdb_less_tt():
    span = SPAN | {"step_s": 7200.0}
    table = light_times(Study(target=LANDER), STATIONS, links="all", **span)
    by_clock_m = table["range_m"] - C_M_S * (table["uplink_light_time_s"] + table["downlink_light_time_s"])
    is_single = np.array([len(set(names_of(path))) == 1 for path in table.path[:]])
    assert 0.1 < np.abs(by_clock_m[is_single]).max() < 0.36
    assert np.abs(by_clock_m[~is_single]).max() > 400.0


def test_epochs_without_the_target_are_counted_and_other_arguments_refused():
    everything = light_times(bare_study(), ["KASHI"], mask_deg=-90.0, **SPAN)
    table = light_times(bare_study(), ["KS"], **SPAN)
    assert table["receive_elevation_deg"].min() > 0.0 > everything["receive_elevation_deg"].min()
    assert len(everything) == len(table) + table.unseen == 28
    for keys, message in (
        ({"links": "baselines"}, "links: expected one of two_way.* got 'baselines'"),
        ({"links": "three_way"}, "links = 'three_way' needs two or more, got KASHI"),
        ({"frequency_hz": 5e14}, "--frequency"),
        ({"frequency_hz": 8470.0}, "--frequency"),
        ({"step_s": 0.0}, "step_s: .* 0.0"),
        ({"mask_deg": 89.9}, "below the horizon or a mask"),
    ):
        with pytest.raises(InputError, match=message):
            light_times(bare_study(), ["KASHI"], **(SPAN | keys))


def test_every_target_of_a_study_has_its_rows():
    rover = radioloc.LunarPosition.from_selenographic(-51.9, 43.1, -2550.0)
    study = Study(target=LANDER, targets={"lander": LANDER, "rover": rover})
    table = light_times(study, ["KASHI"], links="one_way", **SPAN)
    assert set(table.path[:]) == {"lander>KASHI", "rover>KASHI"}
    for name, place in (("lander", LANDER), ("rover", rover)):
        single = light_times(Study(target=place), ["KASHI"], links="one_way", **SPAN)
        rows = table.path.are(f"{name}>KASHI")
        assert table["downlink_light_time_s"][rows] == pytest.approx(
            single["downlink_light_time_s"], abs=1e-15
        )
    assert len(table) == 2 * len(single)
    assert table.unseen == 2 * single.unseen
