"""Geometric light time from a station over a reflector and back, by SPICE's own ephemeris and lunar axes.

SPICE reads the same kernels with its own code and is independent of the library's origin at the geocentre. The station
in the ICRF comes from ERFA's ``c2t06a`` with daily Earth orientation, so that no rotation of the library is used.
"""

import erfa
import numpy as np
import pytest
import spiceypy
from arc_cases import APOLLO15, APOLLO15_PA_M, observations
from moon_frame import spice_moon

from radioloc.constants import C_M_S
from radioloc.earth.eop import EopTable
from radioloc.earth.stations import StationCatalogue
from radioloc.measurements import TERMS, ExactPredictor, PhysicalModel
from radioloc.measurements.registry import TIME_TAGS
from radioloc.time import Epochs, utc_to_tt

# SPICE's epoch is one float: 0.06 to 0.12 microseconds, in which the Earth moves 1.8 to 3.6 mm along its orbit, and
# positions from the barycentre are rounded to 0.03 mm. The path closes between two such epochs: 1.5 mm at most here.
SPICE_EPOCH_M = 5e-3
# With the epoch's remainder made good by the velocities what is left is the round-off of 1.5e11 m, once per vector:
# 0.06 mm at most here.
ROUND_OFF_M = 2e-4


@pytest.fixture(scope="module", autouse=True)
def _spice(tmp_path_factory):
    with spice_moon(tmp_path_factory.mktemp("spice")):
        yield


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build(off=TERMS)


def state_m(code, et):
    return 1e3 * np.array(spiceypy.spkgeo(code, et, "J2000", 0)[0])


def reflector_m(et, rest_s):
    """Barycentric place at et + rest, the rest too small for one float."""
    moon = state_m(301, et)
    rotation = spiceypy.sxform("MOON_PA_DE421", "J2000", et)
    turned = rotation[:3, :3] @ APOLLO15_PA_M
    return moon[:3] + turned + rest_s * (moon[3:] + rotation[3:, :3] @ APOLLO15_PA_M)


class Station:
    """A station that stands still in the ITRF, rotated by ERFA alone."""

    def __init__(self, name, table):
        self.itrf_m = StationCatalogue.default()[name].itrf_m
        self.table = table

    def gcrs_m(self, tt):
        eop = self.table.interpolate(tt)
        days = eop.ut1_minus_tt_s[0] / 86400.0
        x, y, s = erfa.xys06a(tt.jd[0], tt.fraction[0])
        celestial = erfa.c2ixys(x + eop.dx_rad[0], y + eop.dy_rad[0], s)
        spin = erfa.era00(tt.jd[0], tt.fraction[0] + days)
        pole = erfa.pom00(eop.xp_rad[0], eop.yp_rad[0], erfa.sp00(tt.jd[0], tt.fraction[0]))
        return erfa.c2tcio(celestial, spin, pole).T @ self.itrf_m

    def icrf_m(self, et, rest_s):
        """Barycentric place, and TDB - TT there."""
        tdb = Epochs.from_tdb_seconds(et).shifted(rest_s)
        earth = state_m(399, et)
        geocentric_s = erfa.dtdb(tdb.jd, tdb.fraction, 0.0, 0.0, 0.0, 0.0)[0]
        topocentric_s = 0.0
        for _ in range(2):
            place_m = self.gcrs_m(
                Epochs.from_jd(tdb.jd, tdb.fraction, "TT").shifted(-geocentric_s - topocentric_s)
            )
            topocentric_s = earth[3:] @ place_m / C_M_S**2
        return earth[:3] + rest_s * earth[3:] + place_m, geocentric_s + topocentric_s


def split(whole_s, more_s, keep_rest):
    """SPICE's epoch and what it loses, which is put back only where it is asked for."""
    et = whole_s + more_s
    return et, ((whole_s - et) + more_s if keep_rest else 0.0)


def range_by_spice(sender, receiver, tag, tt, keep_rest):
    whole_s = (tt.jd[0] - 2451545.0) * 86400.0 + np.floor(tt.fraction[0] * 86400.0)
    rest_s = tt.fraction[0] * 86400.0 - np.floor(tt.fraction[0] * 86400.0)
    owner = {"transmit": sender, "receive": receiver}.get(tag)
    tagged_s = rest_s
    for _ in range(3):
        if owner is None:
            tdb = Epochs.from_tdb_seconds(whole_s).shifted(tagged_s)
            ahead_s = erfa.dtdb(tdb.jd, tdb.fraction, 0.0, 0.0, 0.0, 0.0)[0]
        else:
            ahead_s = owner.icrf_m(*split(whole_s, tagged_s, True))[1]
        tagged_s = rest_s + ahead_s
    up_s = down_s = 1.3
    for _ in range(6):
        bounce_s = tagged_s + {"transmit": up_s, "receive": -down_s, "bounce": 0.0}[tag]
        there_m = reflector_m(*split(whole_s, bounce_s, keep_rest))
        up_m = there_m - sender.icrf_m(*split(whole_s, bounce_s - up_s, keep_rest))[0]
        down_m = receiver.icrf_m(*split(whole_s, bounce_s + down_s, keep_rest))[0] - there_m
        up_s, down_s = np.linalg.norm(up_m) / C_M_S, np.linalg.norm(down_m) / C_M_S
    return C_M_S * (up_s + down_s)


@pytest.mark.parametrize("tag", TIME_TAGS)
@pytest.mark.parametrize(
    ("sender", "receiver", "jd", "fraction"),
    [
        ("APOLLO", "APOLLO", 2454040.5, 0.31),
        ("GRASSE", "GRASSE", 2441700.5, 0.123456789),
        ("KASHI", "JIAMUSI", 2459185.5, 0.62),
        ("NEUQUEN", "KASHI", 2459186.5, 0.9999),
    ],
)
def test_bare_geometry(model, sender, receiver, jd, fraction, tag):
    table = observations(f"{sender}>apollo15>{receiver}", Epochs.from_jd(jd, fraction, "TAI"), tag)
    ours_m = ExactPredictor(model, table, APOLLO15).compute().value_m[0]
    eop = EopTable.packaged()
    ends = Station(sender, eop), Station(receiver, eop)
    tt = utc_to_tt(table.epoch)
    assert ours_m == pytest.approx(range_by_spice(*ends, tag, tt, keep_rest=False), rel=0, abs=SPICE_EPOCH_M)
    assert ours_m == pytest.approx(range_by_spice(*ends, tag, tt, keep_rest=True), rel=0, abs=ROUND_OFF_M)
