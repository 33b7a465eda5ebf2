"""Earth orientation against the test cases of the IERS Conventions (2010) software, ERFA and astropy."""

from dataclasses import replace

import astropy.units as u
import astropy_iers_data
import erfa
import numpy as np
import pytest
from astropy.coordinates import EarthLocation
from astropy.time import Time
from astropy.utils import iers

from radioloc.constants import ARCSEC_RAD, SECONDS_PER_DAY
from radioloc.earth import EarthOrientation, eop_tides
from radioloc.earth.eop import EopTable
from radioloc.time import Epochs, utc_to_tt

UAS_RAD = 1e-6 * ARCSEC_RAD

# Inputs and outputs printed in the headers of the IERS Conventions (2010) routines of these names.
RG_ZONT2 = {"centuries": 0.07995893223819302, "ut1_s": 7.983287678576557467e-2, "lod_s": 5.035331113978199e-5}
ORTHO_EOP = {"mjd": 47100.0, "eop": (-162.8386373279636530, 117.7907525842668974, -23.39092370609808214)}
PMSDNUT2 = {"mjd": 54335.0, "pole_uas": (24.83144238273364834, -14.09240692041837661)}
UTLIBR = [
    {"mjd": 44239.1, "ut1_us": 2.441143834386761746, "lod_us": -14.78971247349449492},
    {"mjd": 55227.4, "ut1_us": -2.655705844335680244, "lod_us": 27.39445826599846967},
]

ZONAL_TOL_S = 1e-12  # round-off of the Delaunay arguments, 1e-12 rad, on an amplitude of 0.16 s
ZONAL_LOD_TOL_S = (
    1e-8  # the routine's LOD has coefficients of its own, rounded to 1e-9 s, here it is the derivative
)
OCEAN_TOL_UAS = 1e-8  # round-off of phases over 27 years, 1e-11 rad, on 1e3 uas
LIBRATION_TOL_UAS = 1e-6  # the routine stores coefficients in single precision; see the test of that below
LIBRATION_LOD_TOL_US = 0.4  # coefficients rounded to 0.01 us, times 4 pi in the derivative
SINGLE_PRECISION_TOL_UAS = 1e-9


def test_zonal_tides_give_the_value_of_rg_zont2():
    ut1_s, ut1_rate = eop_tides.zonal_tides(np.atleast_1d(RG_ZONT2["centuries"]))
    assert ut1_s[0] == pytest.approx(RG_ZONT2["ut1_s"], abs=ZONAL_TOL_S)
    assert -ut1_rate[0] * SECONDS_PER_DAY == pytest.approx(RG_ZONT2["lod_s"], abs=ZONAL_LOD_TOL_S)


def test_ocean_tides_give_the_values_of_ortho_eop():
    value, _ = eop_tides.ocean_tides(np.array([ORTHO_EOP["mjd"]]))
    np.testing.assert_allclose(
        value[0] / [UAS_RAD, UAS_RAD, 1e-6], ORTHO_EOP["eop"], rtol=0.0, atol=OCEAN_TOL_UAS
    )


def test_libration_gives_the_values_of_pmsdnut2_and_utlibr():
    value, _ = eop_tides.libration(PMSDNUT2["mjd"])
    np.testing.assert_allclose(value[0, :2] / UAS_RAD, PMSDNUT2["pole_uas"], rtol=0.0, atol=LIBRATION_TOL_UAS)
    for case in UTLIBR:
        value, rate = eop_tides.libration(case["mjd"])
        assert value[0, 2] * 1e6 == pytest.approx(case["ut1_us"], abs=LIBRATION_TOL_UAS)
        lod_us = -rate[0, 2] * SECONDS_PER_DAY * 1e6
        assert lod_us == pytest.approx(case["lod_us"], abs=LIBRATION_LOD_TOL_US)


def test_libration_gives_all_printed_digits_with_coefficients_in_single_precision(monkeypatch):
    table = eop_tides.table_of
    monkeypatch.setattr(
        eop_tides, "table_of", lambda *name: table(*name).astype(np.float32).astype(np.float64)
    )
    pole = eop_tides.libration(PMSDNUT2["mjd"])[0][0, :2] / UAS_RAD
    np.testing.assert_allclose(pole, PMSDNUT2["pole_uas"], rtol=0.0, atol=SINGLE_PRECISION_TOL_UAS)
    for case in UTLIBR:
        ut1_us = eop_tides.libration(case["mjd"])[0][0, 2] * 1e6
        assert ut1_us == pytest.approx(case["ut1_us"], abs=SINGLE_PRECISION_TOL_UAS)


# Rows of Tables 8.2 and 8.3 of the IERS Conventions (2010): frequency of O1, M2 and S2 in cycles per day,
# amplitudes of xp (sin, cos; uas) and UT1 (sin, cos; us).
@pytest.mark.parametrize(
    ("cycles_per_day", "xp_sin_cos_uas", "ut1_sin_cos_us"),
    [
        (0.92953570674, (48.82, 132.91), (16.020, -12.069)),
        (1.93227361, (-330.15, -26.96), (-16.195, -7.140)),
        (2.0, (-144.13, 63.56), (-7.547, -0.159)),
    ],
    ids=["O1", "M2", "S2"],
)
def test_ocean_tide_lines_have_the_amplitudes_of_tables_8_2_and_8_3(
    cycles_per_day, xp_sin_cos_uas, ut1_sin_cos_us
):
    frequency = eop_tides.table_of("radioloc.earth", "rotation_tide_lines.csv")[:, 3] / (2 * np.pi)
    line = int(np.argmin(np.abs(frequency - cycles_per_day)))
    sine, cosine = eop_tides._ocean_tide_coefficients()
    # The phases of the two differ by quarters of a turn and signs, so amplitudes are compared; the tables
    # are rounded to 0.01 uas and 0.001 us.
    assert np.hypot(sine[line, 0], cosine[line, 0]) == pytest.approx(np.hypot(*xp_sin_cos_uas), abs=0.02)
    assert np.hypot(sine[line, 2], cosine[line, 2]) == pytest.approx(np.hypot(*ut1_sin_cos_us), abs=0.002)


NODES_MJD = np.array([44239.0, 50083.0, 51544.0, 53736.0, 57753.0, 57754.0, 59180.0, 60310.0])
ASTROPY_TOL_RAD = 1e-12  # 6 um on the ground; astropy's UT1 is rounded


def at_0h_utc_without_subdaily_terms(table):
    # astropy interpolates linearly and adds no subdaily terms: the two agree at 0h UTC, ours switched off.
    tt = utc_to_tt(Epochs.from_jd(NODES_MJD + 2400000.5, 0.0, "UTC"))
    model = EarthOrientation(table, subdaily_tides=False, libration=False)
    return tt, model.evaluate(tt).rot_itrf_to_gcrs


def test_rotation_at_table_days_agrees_with_erfa_on_astropys_c04():
    tt, ours = at_0h_utc_without_subdaily_terms(EopTable.packaged())
    c04 = iers.IERS_B.open(astropy_iers_data.IERS_B_FILE)
    times = Time(NODES_MJD, format="mjd", scale="utc")
    times.delta_ut1_utc = c04.ut1_utc(times)
    xp, yp = (angle.to_value(u.rad) for angle in c04.pm_xy(times))
    dx, dy = (angle.to_value(u.rad) for angle in c04.dcip_xy(times))
    x, y, s = erfa.xys06a(tt.jd, tt.fraction)
    polar_motion = erfa.pom00(xp, yp, erfa.sp00(tt.jd, tt.fraction))
    angle = erfa.era00(times.ut1.jd1, times.ut1.jd2)
    gcrs_to_itrf = erfa.c2tcio(erfa.c2ixys(x + dx, y + dy, s), angle, polar_motion)
    assert np.abs(dx).max() > 1e-10
    np.testing.assert_allclose(ours, np.swapaxes(gcrs_to_itrf, -1, -2), rtol=0.0, atol=ASTROPY_TOL_RAD)


def test_rotation_at_table_days_agrees_with_astropys_frames():
    # astropy's frames leave out the celestial pole offsets, up to 1.5e-9 rad (1 cm) on these days.
    table = EopTable.packaged()
    zero = np.zeros(len(table.mjd_utc))
    _, ours = at_0h_utc_without_subdaily_terms(replace(table, dx_rad=zero, dy_rad=zero))
    with iers.earth_orientation_table.set(iers.IERS_B.open(astropy_iers_data.IERS_B_FILE)):
        times = Time(NODES_MJD, format="mjd", scale="utc")
        columns = []
        for axis in np.eye(3):
            place = EarthLocation.from_geocentric(*(axis * 6.4e6), unit=u.m)
            position, _ = place.get_gcrs_posvel(times)
            columns.append(position.xyz.to_value(u.m).T / 6.4e6)
    np.testing.assert_allclose(ours, np.stack(columns, axis=-1), rtol=0.0, atol=ASTROPY_TOL_RAD)


ERFA_TOL_RAD = 5e-14  # ERFA's Earth rotation angle, which rounds the days since J2000


def test_whole_chain_agrees_with_erfa_c2t06a():
    # ERFA's one-call chain lacks dX, dY; they are zero in the table.
    days = np.arange(57750.0, 57760.0)
    zero = np.zeros(len(days))
    table = EopTable(days, zero + 1e-6, zero + 2e-6, zero - 0.2 + (days >= 57754.0), zero, zero, zero > 0)
    model = EarthOrientation(table, subdaily_tides=False, libration=False)
    tt = Epochs.from_jd(2457755.5, np.linspace(0.1, 0.9, 7), "TT")
    earth = model.evaluate(tt)
    erfa_matrix = erfa.c2t06a(
        tt.jd, tt.fraction, earth.ut1.jd, earth.ut1.fraction, earth.xp_rad, earth.yp_rad
    )
    np.testing.assert_allclose(
        earth.rot_itrf_to_gcrs, np.swapaxes(erfa_matrix, -1, -2), rtol=0.0, atol=ERFA_TOL_RAD
    )
