"""Light times to an orbiter and its occultations by SPICE, which reads the same files with its own code.

The stations are written as trajectories too, so that SPICE's ``spkezr`` finds the whole Newtonian path ("CN").
"""

import numpy as np
import pytest
import spiceypy
from arc_cases import epochs_tai
from spk_files import ORBITER, low_lunar_orbit, tracking, write_chebyshev, write_states

from radioloc.constants import C_M_S, J2000_JD, MEAN_LUNAR_RADIUS_M, SECONDS_PER_DAY
from radioloc.ephemeris import Trajectory
from radioloc.kernels import find_kernel
from radioloc.measurements import TERMS, ExactPredictor, PhysicalModel
from radioloc.media.medium import Status
from radioloc.time import Epochs, geocentric_tdb_minus_tt, tai_to_tt
from radioloc.time.scales import tdb_to_tt

STATIONS = {"KASHI": 399901, "JIAMUSI": 399902}

# SPICE's epoch is one float: 0.06 microseconds to either side, in which the Earth moves 1.8 mm along its orbit, once
# for the end of each leg: 2.8 mm at most here, and no more in the difference of two.
SPICE_EPOCH_M = 5e-3


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build(off=TERMS)


@pytest.fixture(scope="module", params=["type 13", "type 3"])
def orbiter(request, model, tmp_path_factory):
    folder = tmp_path_factory.mktemp("spice")
    states = low_lunar_orbit(model.ephemeris)
    write = write_states if request.param == "type 13" else write_chebyshev
    orbit = write(folder / "orbiter.bsp", states)
    files = [find_kernel("DE421", "SPK"), orbit]
    for name, code in STATIONS.items():
        at = geocentric(model, name)
        files.append(write_states(folder / f"{name}.bsp", at, center=399, body=code, step_s=120.0))
    for file in files:
        spiceypy.furnsh(str(file))
    yield Trajectory.open(orbit, ORBITER)
    spiceypy.kclear()


def geocentric(model, name):
    itrf_m = model.catalogue.get(name).itrf_m

    def states(et_s):
        # Differences of epochs one second apart do for the rate, which the interpolation of type 13 wants.
        rotation = model.earth.evaluate(tdb_to_tt(Epochs.from_tdb_seconds(et_s)))
        rates = rotation.rot_itrf_to_gcrs_rate
        return np.hstack([rotation.rot_itrf_to_gcrs @ itrf_m, rates @ itrf_m])

    return states


def tagged_et(model, name, tai):
    """TDB seconds since J2000 at a station at epochs of its clock, and how much one float of them loses."""
    tt = tai_to_tt(tai)
    tdb_tt_s = geocentric_tdb_minus_tt(tt)
    tdb = Epochs.from_jd(tt.jd, tt.fraction + tdb_tt_s / SECONDS_PER_DAY, "TDB")
    earth = model.ephemeris.earth(tdb)
    place_m = geocentric(model, name)(tdb.centuries_since_j2000() * 36525.0 * SECONDS_PER_DAY)[:, :3]
    tdb = tdb.shifted(np.einsum("ni,ni->n", earth.velocity_m_s, place_m) / C_M_S**2)
    midnight_s, rest_s = (tdb.jd - J2000_JD) * SECONDS_PER_DAY, tdb.fraction * SECONDS_PER_DAY
    et_s = midnight_s + rest_s
    return et_s, (midnight_s - et_s) + rest_s


def round_trips_m(sender, receiver, et_s):
    lengths_m = []
    for et in et_s:
        down_s = spiceypy.spkezr(str(ORBITER), et, "J2000", "CN", str(STATIONS[receiver]))[1]
        up_s = spiceypy.spkezr(str(STATIONS[sender]), et - down_s, "J2000", "CN", str(ORBITER))[1]
        lengths_m.append(C_M_S * (up_s + down_s))
    return np.array(lengths_m)


@pytest.mark.parametrize("receiver", ["KASHI", "JIAMUSI"])
def test_light_time_over_an_orbiter(model, orbiter, receiver):
    tai = epochs_tai(60, 30.0, start_fraction=0.01)
    path = f"KASHI>x>{receiver}"
    computed = ExactPredictor(model, tracking(path, tai), orbiter).compute()
    et_s, lost_s = tagged_et(model, receiver, tai)
    by_spice_m = round_trips_m("KASHI", receiver, et_s) + computed.by_time_m_s * lost_s
    assert np.abs(computed.by_time_m_s).max() > 2000.0
    assert np.abs(computed.value_m - by_spice_m).max() < SPICE_EPOCH_M


def test_doppler_is_the_growth_of_spice_light_times(model, orbiter):
    tai, half_s = epochs_tai(30, 30.0, start_fraction=0.01), 30.0
    table = tracking("KASHI>x>JIAMUSI", tai, kind="doppler", count_s=2.0 * half_s)
    computed = ExactPredictor(model, table, orbiter).compute()
    late, early = (tagged_et(model, "JIAMUSI", tai.shifted(s))[0] for s in (half_s, -half_s))
    grown_m = round_trips_m("KASHI", "JIAMUSI", late) - round_trips_m("KASHI", "JIAMUSI", early)
    assert np.abs(computed.value_m - grown_m).max() < SPICE_EPOCH_M


def test_occultations(model, orbiter):
    """The Moon as SPICE's ellipsoid with three equal axes; which way it is turned does not matter."""
    spiceypy.pdpool("BODY301_RADII", [MEAN_LUNAR_RADIUS_M / 1e3] * 3)
    for name in ("POLE_RA", "POLE_DEC", "PM"):
        spiceypy.pdpool(f"BODY301_{name}", [0.0, 0.0, 0.0])
    # 500 epochs, of which none is closer than some milliseconds to the limb.
    tai = epochs_tai(500, 35.0, start_fraction=0.01)
    predictor = ExactPredictor(model, tracking("KASHI>x>KASHI", tai), orbiter)
    status = predictor.compute().status[:, 0]
    visible = status != Status.BELOW_HORIZON
    et_s, _ = tagged_et(model, "KASHI", tai)
    hidden = [
        spiceypy.occult(
            str(ORBITER), "POINT", " ", "MOON", "ELLIPSOID", "IAU_MOON", "CN", str(STATIONS["KASHI"]), et
        )
        < 0
        for et in et_s[visible]
    ]
    assert 0.3 < np.mean(hidden) < 0.5
    assert ((status[visible] == Status.BEHIND_MOON) == hidden).all()
