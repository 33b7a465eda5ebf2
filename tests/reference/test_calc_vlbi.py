"""VLBI delays and their rates against CALC 11 (difxcalc, near-field model of Duev et al. 2012).

CALC was run for the Apollo 15 site as a point of the DE421 Moon without tides, five Chinese stations without velocity,
and five days of Earth orientation. With the same displacements and Earth orientation the largest difference over the
ten baselines and 20 minutes is 3.8 ps, 1.1 mm. All of it has been found, in the published source of CALC and by doing
here as it does; what remains then is 0.3 ps. Largest effect of each on a baseline, ps, and what CALC does:

====  =================================================================================================================
3.3   takes the geocentric vector of the ephemeris for one of the GCRS and so brings the Moon 8.9 m nearer, which the
      curvature of the wave shows, and Lorentz-contracts the whole vector
1.9   has the mean pole of the IERS Conventions (2010) in the pole tide, not the secular pole of 2018
1.2   interpolates the pole and UT1 by a natural spline of five days with zonal tides left in, and enters it with TT
      where the table has UTC
1.1   puts the second station where it is at the TDB, not the TT, of its event, which v_E . r / c^2 separates by up to
      2 microseconds: 0.9 mm of the Earth's rotation
0.2   has the ocean's own pole tide
====  =================================================================================================================

Not part of it, because left out on both sides: CALC computes the diurnal and semidiurnal terms of Earth orientation but
does not add them to the delay; with them the difference is 14 ps.
"""

import dataclasses
import itertools
import json

import numpy as np
import pytest
from arc_cases import observed_at
from mappings import niell
from paths import DATA

from radioloc.constants import ARCSEC_RAD, C_M_S
from radioloc.earth import EarthOrientation, StationCatalogue
from radioloc.earth.eop import EopTable
from radioloc.earth.geodesy import geodetic_from_itrf, rot_itrf_to_enu
from radioloc.earth.solid_tide import pole_tide_displacement, secular_pole_rad
from radioloc.lunar import rot_icrf_to_pa
from radioloc.measurements import ExactPredictor, FixedPoint, Link, PhysicalModel
from radioloc.media.neutral_atmosphere import zenith_hydrostatic_delay_m
from radioloc.time import Epochs, geocentric_tdb_minus_tt, utc_to_tt

GOAL_S = 10e-12
"""What every baseline has to agree within."""

# Reached, with a margin. A rate by the polynomials has their own noise, 0.02 ps/s, and the model's derivative by time
# leaves out how fast the tides lift a station, 1e-5 m/s.
DELAY_S = 5e-12
AS_CALC_DOES_S = 0.5e-12
RATE_S_S = 0.06e-12
GROWTH_S = 0.4e-12
MEAN_RATE_S_S = 0.002e-12

# The point and the stations of the run, m.
POINT_PA_M = np.array([1554678.6593057714, 98094.10236773624, 765004.7260696347])
STATIONS_ITRF_M = {
    "SESHAN25": (-2831686.913, 4675733.666, 3275327.690),
    "TIANMA65": (-2826708.224, 4679237.251, 3274667.699),
    "KUNMING": (-1281151.967, 5640865.079, 2682653.601),
    "URUMQI": (228310.720, 4631922.785, 4367063.969),
    "MIYUN50": (-2201304.721, 4324789.258, 4125367.909),
}
BASELINES = list(itertools.combinations(STATIONS_ITRF_M, 2))

# Earth orientation of the run: MJD (UTC), pole (arcsec), UT1-UTC (s).
EOP_MJD = np.arange(59299.0, 59304.0)
EOP_XP = np.array([0.073774, 0.075004, 0.076603, 0.078237, 0.079567])
EOP_YP = np.array([0.408987, 0.409633, 0.409793, 0.410152, 0.410469])
EOP_UT1 = np.array([-0.1705912, -0.1709208, -0.1714991, -0.1722501, -0.1730419])

DAY_MJD = 59301.0
# UTC seconds of 2021-03-28 at the geocentre, then for each station by how much the wavefront arrives there earlier (us)
# and the derivative of that (us/s): CALC's polynomials in the middle of their intervals.
CALC = {
    50460.0: (
        (16279.247248819, 0.617838227256),
        (16270.400646158, 0.619142768167),
        (13264.414215825, 0.998709565814),
        (7405.895971103, 0.955818349999),
        (13960.485409313, 0.614532801151),
    ),
    50940.0: (
        (16566.629684696, 0.579467517736),
        (16558.414351080, 0.580793012903),
        (13736.331244190, 0.967416467610),
        (7860.706808104, 0.939040402044),
        (14247.680574269, 0.581992803155),
    ),
    51420.0: (
        (16835.423457872, 0.540393026309),
        (16827.849081374, 0.541737925581),
        (14192.949759818, 0.934971769568),
        (8307.197295167, 0.921153347907),
        (14519.085457907, 0.548746326448),
    ),
    51780.0: (
        (17024.622519274, 0.510652810945),
        (17017.534767266, 0.512011231245),
        (14525.046081614, 0.909904603400),
        (8636.287091797, 0.907021848953),
        (14712.077611285, 0.523371067470),
    ),
}

# What CALC leaves out, or was run without (offsets of antenna axes are nought in its input): the Moon's tide and the
# shrinking of lengths on it, and the motion of the geocentre.
NOT_IN_CALC = (
    "troposphere",
    "ionosphere",
    "antenna_axis_offset",
    "lunar_tide",
    "lunar_tide_constant",
    "lunar_scale",
    "lunar_lorentz",
    "station_velocity",
    "tidal_geocentre",
)

# Ocean pole tide of CALC's stations (Desai 2002; its file has no MIYUN50): up, north, east, real and imaginary part.
OCEAN_POLE_TIDE = {
    "SESHAN25": (-0.082179, 0.046688, -0.019084, -0.001201, 0.057011, 0.042462),
    "TIANMA65": (-0.081560, 0.045759, -0.019055, -0.001176, 0.056907, 0.042522),
    "KUNMING": (-0.034552, -0.012615, -0.013992, 0.000893, 0.041498, 0.038434),
    "URUMQI": (-0.027824, -0.022538, 0.003070, 0.025613, 0.029362, 0.024282),
    "MIYUN50": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
}

# At 50400 s: elevation (deg) and delay by dry air (us) of each station.
CALC_DRY = {
    "SESHAN25": (49.38839580069, 0.01010493380982),
    "TIANMA65": (49.35082820228, 0.01008734973090),
    "KUNMING": (37.93038672113, 0.009894087623169),
    "URUMQI": (19.69994472405, 0.01776253794561),
    "MIYUN50": (40.43308961188, 0.01160664637738),
}
DRY_S = 0.6e-12
"""Of delays of 10 to 18 ns."""

VLBI_FOLDER = DATA / "vlbi"


def orientation(table=None, *, subdaily=False, zonal_tides=True):
    if table is None:
        zeros = np.zeros(len(EOP_MJD))
        pole = EOP_XP * ARCSEC_RAD, EOP_YP * ARCSEC_RAD
        table = EopTable(EOP_MJD, *pole, EOP_UT1, zeros, zeros, zeros.astype(bool), ("CALC",))
    return EarthOrientation(table, subdaily_tides=subdaily, libration=subdaily, zonal_tides=zonal_tides)


def model_of(earth, moved_itrf_m=None, off=NOT_IN_CALC):
    """The library's model with the run's stations and Earth orientation; stations may be moved."""
    catalogue = StationCatalogue.default()
    for name, itrf_m in STATIONS_ITRF_M.items():
        place = np.array(itrf_m) + (0.0 if moved_itrf_m is None else moved_itrf_m[name])
        station = dataclasses.replace(catalogue[name], itrf_m=place, velocity_m_yr=None)
        catalogue = catalogue.with_station(station)
    return dataclasses.replace(PhysicalModel.build(catalogue=catalogue, off=off), earth=earth)


def calc_delays(table=CALC):
    """Per baseline: tags (UTC seconds of the day at the first station), delays (s) and their rates."""
    at_geocentre_s = np.array(list(table))
    early_s, early_rate = np.moveaxis(np.array(list(table.values())), -1, 0) * 1e-6
    delays = {}
    for (i, first), (j, second) in itertools.combinations(enumerate(STATIONS_ITRF_M), 2):
        tag_per_geocentre = 1.0 - early_rate[:, i]
        delays[first, second] = (
            at_geocentre_s - early_s[:, i],
            early_s[:, i] - early_s[:, j],
            (early_rate[:, i] - early_rate[:, j]) / tag_per_geocentre,
        )
    return delays


def predict(model, baseline, tags_s, point_pa_m=POINT_PA_M):
    """Delays and their derivatives by time, s and s/s."""
    observations = observed_at(
        Epochs.from_jd(2400000.5 + DAY_MJD, tags_s / 86400.0, "UTC"),
        Link(baseline[0], "apollo15", baseline[1], True),
        value_m=0.0,
        kind="vlbi_delay",
    )
    computed = ExactPredictor(model, observations, FixedPoint(point_pa_m)).compute()
    return computed.value_m / C_M_S, computed.by_time_m_s / C_M_S


def differences(model, point_pa_m=POINT_PA_M, table=CALC):
    """CALC's delays less the model's, s, by baseline."""
    return {
        baseline: delay_s - predict(model, baseline, tags_s, point_pa_m)[0]
        for baseline, (tags_s, delay_s, _) in calc_delays(table).items()
    }


def largest(by_baseline):
    return max(np.abs(value).max() for value in by_baseline.values())


@pytest.fixture(scope="module")
def model():
    return model_of(orientation())


@pytest.mark.parametrize("baseline", BASELINES, ids="-".join)
def test_delay(model, baseline):
    tags_s, delay_s, _ = calc_delays()[baseline]
    assert np.abs(delay_s - predict(model, baseline, tags_s)[0]).max() < DELAY_S < GOAL_S


@pytest.mark.parametrize("baseline", BASELINES, ids="-".join)
def test_delay_rate(model, baseline):
    tags_s, delay_s, rate = calc_delays()[baseline]
    computed_s, computed_rate = predict(model, baseline, tags_s)
    assert np.abs(rate - computed_rate).max() < RATE_S_S
    growth_s = (delay_s - computed_s)[-1] - (delay_s - computed_s)[0]
    assert abs(growth_s) / (tags_s[-1] - tags_s[0]) < MEAN_RATE_S_S


@pytest.mark.parametrize("baseline", BASELINES, ids="-".join)
def test_growth_of_the_delay(model, baseline):
    """Delay rates as they are observed: by how much CALC's delay grows from one tag to the next, 6 or 8 minutes."""
    tags_s, delay_s, _ = calc_delays()[baseline]
    count_s = np.diff(tags_s)
    observations = observed_at(
        Epochs.from_jd(2400000.5 + DAY_MJD, (tags_s[:-1] + 0.5 * count_s) / 86400.0, "UTC"),
        Link(*baseline[:1], "apollo15", *baseline[1:], True),
        value_m=0.0,
        kind="vlbi_delay_rate",
        count_s=count_s,
    )
    computed_s = ExactPredictor(model, observations, FixedPoint(POINT_PA_M)).compute().value_m / C_M_S
    assert np.abs(np.diff(delay_s) - computed_s).max() < GROWTH_S


def test_subdaily_orientation_is_not_in_calc(model):
    with_it_s = differences(model_of(orientation(subdaily=True)))
    assert DELAY_S < 12e-12 < largest(with_it_s) < 16e-12


def middle():
    """The middle of the run in TT and TDB, and the Earth's barycentric velocity."""
    tt = utc_to_tt(Epochs.from_jd(2400000.5 + DAY_MJD, 51120.0 / 86400.0, "UTC"))
    return tt, Epochs.from_jd(tt.jd, tt.fraction + geocentric_tdb_minus_tt(tt) / 86400.0, "TDB")


def point_as_calc_places_it(model):
    """The point nearer by what the change from GCRS to BCRS takes off a geocentric vector, principal axes."""
    _, tdb = middle()
    rot = rot_icrf_to_pa(model.libration.angles(tdb)[0])[0]
    earth_m_s = model.ephemeris.earth(tdb).velocity_m_s[0]
    sun_m = model.ephemeris.geocentric("sun", tdb)[0][0]
    vector_m = model.ephemeris.geocentric("moon", tdb)[0][0] + rot.T @ POINT_PA_M
    potential = model.ephemeris.constants.gm_sun_m3_s2 / np.linalg.norm(sun_m) / C_M_S**2
    shrunk_m = vector_m * (potential + 1.48082686741e-8)
    contracted_m = earth_m_s * (earth_m_s @ vector_m) / (2.0 * C_M_S**2)
    assert np.linalg.norm(shrunk_m) == pytest.approx(8.9, abs=0.1)
    return POINT_PA_M - rot @ (shrunk_m + contracted_m)


def orientation_as_calc_interpolates_it():
    """A natural spline of the five days, entered with TT instead of UTC."""
    days = np.arange(EOP_MJD[1], EOP_MJD[-2] + 0.05, 0.1)
    columns = natural_spline(np.column_stack([EOP_XP, EOP_YP, EOP_UT1]), days + 69.184 / 86400.0 - EOP_MJD[0])
    zeros = np.zeros(len(days))
    pole = columns[:, 0] * ARCSEC_RAD, columns[:, 1] * ARCSEC_RAD
    table = EopTable(days, *pole, columns[:, 2], zeros, zeros, zeros.astype(bool), ("spline",))
    return orientation(table, zonal_tides=False)


def natural_spline(values, at):
    """Cubic spline through equidistant values, straight at its ends."""
    inner = len(values) - 2
    matrix = 4.0 * np.eye(inner) + np.eye(inner, k=1) + np.eye(inner, k=-1)
    bend = np.zeros_like(values)
    bend[1:-1] = np.linalg.solve(matrix, 6.0 * np.diff(values, 2, axis=0))
    k = np.floor(at).astype(int)
    b = (at - k)[:, None]
    a = 1.0 - b
    cubic = ((a**3 - a) * bend[k] + (b**3 - b) * bend[k + 1]) / 6.0
    return a * values[k] + b * values[k + 1] + cubic


def stations_as_calc_places_them(earth):
    """Return the difference of CALC's stations and those of the library, ITRF, m."""
    tt, tdb = middle()
    years = 100.0 * tt.centuries_since_j2000()
    mean_pole = np.array([23.513 + 7.6141 * years[0], 358.891 - 0.6287 * years[0]]) * 1e-3 * ARCSEC_RAD
    rotation = earth.evaluate(tt)
    pole = np.array([rotation.xp_table_rad[0], rotation.yp_table_rad[0]])
    # The same pole tide as with CALC's mean pole, by a pole as far from the secular one.
    other_pole = pole - mean_pole + secular_pole_rad(tt)[0]
    wobble = (pole - mean_pole) * [1.0, -1.0]
    earth_m_s = PhysicalModel.build().ephemeris.earth(tdb).velocity_m_s[0]
    moved = {}
    for name, itrf in STATIONS_ITRF_M.items():
        itrf_m = np.array(itrf)
        solid_m = [pole_tide_displacement(itrf_m[None], p[:1], p[1:], tt)[0] for p in (other_pole, pole)]
        ocean_m = ocean_pole_tide_enu(wobble, OCEAN_POLE_TIDE[name]) @ rot_itrf_to_enu(itrf_m)
        topocentric_s = earth_m_s @ rotation.rot_itrf_to_gcrs[0] @ itrf_m / C_M_S**2
        turned_m = rotation.rot_itrf_to_gcrs[0].T @ rotation.rot_itrf_to_gcrs_rate[0] @ itrf_m * topocentric_s
        moved[name] = solid_m[0] - solid_m[1] + ocean_m + turned_m
    return moved


def ocean_pole_tide_enu(wobble, coefficients):
    """IERS Conventions (2010), eq. 7.29, m, for the wobble m1, m2 in rad."""
    up, north, east = np.array(coefficients).reshape(3, 2)
    height_m = np.sqrt(8 * np.pi / 15) * 7.292115e-5**2 * 6378136.6**4 / 3.986004418e14
    factor_m = 4 * np.pi * 6.673e-11 * 6378136.6 * 1025.0 * height_m / (3 * 9.7803278)
    gamma = 0.6870 + 0.0036j
    real = (wobble[0] * gamma.real + wobble[1] * gamma.imag) * factor_m
    imaginary = (wobble[1] * gamma.real - wobble[0] * gamma.imag) * factor_m
    return np.array([real * part[0] + imaginary * part[1] for part in (east, north, up)])


def test_the_rest_is_what_calc_does_otherwise(model):
    """The table of the module: done as CALC does, the difference goes."""
    point_pa_m = point_as_calc_places_it(model)
    by_the_point = {
        baseline: np.abs(was - current).max()
        for baseline, was, current in zip(
            BASELINES, differences(model).values(), differences(model, point_pa_m).values(), strict=True
        )
    }
    assert 3.0e-12 < max(by_the_point.values()) < 3.5e-12
    earth = orientation_as_calc_interpolates_it()
    as_calc = model_of(earth, stations_as_calc_places_them(earth))
    assert largest(differences(as_calc, point_pa_m)) < AS_CALC_DOES_S


@pytest.mark.parametrize("name", CALC_DRY)
def test_delay_by_dry_air(name):
    """Compare the dry delay of CALC's default weather and Niell's mapping function."""
    elevation_deg, dry_us = CALC_DRY[name]
    place = geodetic_from_itrf(np.array(STATIONS_ITRF_M[name]))
    pressure_hpa = 1013.25 * (1.0 - 6.5e-3 * place.height_m / 293.15) ** 5.26
    zenith_m = zenith_hydrostatic_delay_m(pressure_hpa, place.latitude_rad, place.height_m)
    day_of_year = 87.583
    mapping = niell(np.radians(elevation_deg), place.latitude_rad, place.height_m, day_of_year)
    assert abs(zenith_m * mapping.hydrostatic / C_M_S - 1e-6 * dry_us) < DRY_S


@pytest.fixture(scope="module")
def polynomials():
    differences: dict[float, list] = {}
    for line in (VLBI_FOLDER / "a15_delays.csv").read_text().splitlines()[3:]:
        start, station, *coefficients = line.split(",")
        row = differences.setdefault(float(start), [])
        assert station == list(STATIONS_ITRF_M)[len(row)]
        row.append(np.polynomial.Polynomial([float(x) for x in coefficients]))
    return differences


def test_table_is_that_of_the_file(polynomials):
    inputs = json.loads((VLBI_FOLDER / "a15.json").read_text())
    assert inputs["sites_itrf_m"] == {name: list(itrf_m) for name, itrf_m in STATIONS_ITRF_M.items()}
    np.testing.assert_array_equal(1e3 * np.array(inputs["lander_PA_km"]), POINT_PA_M)
    for time_s, row in CALC.items():
        station_polynomials = polynomials[time_s - 60.0]
        assert [p(60.0) for p in station_polynomials] == pytest.approx([d for d, _ in row], rel=0, abs=1e-9)
        assert [p.deriv()(60.0) for p in station_polynomials] == pytest.approx(
            [r for _, r in row], rel=0, abs=1e-12
        )


def test_whole_file(model, polynomials):
    assert len(polynomials) == 12
    table = {
        start + elapsed_s: [(p(elapsed_s), p.deriv()(elapsed_s)) for p in row]
        for start, row in polynomials.items()
        for elapsed_s in (0.0, 60.0)
    }
    assert largest(differences(model, table=table)) < DELAY_S < GOAL_S
