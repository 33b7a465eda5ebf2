"""Clocks of stations that nothing steers: their rate by height, and what it does to measurements of two clocks."""

import dataclasses

import numpy as np
import pytest
from arc_cases import APOLLO15, epochs_tai, observations

from radioloc.constants import C_M_S
from radioloc.earth import StationCatalogue
from radioloc.earth.geodesy import itrf_from_geodetic
from radioloc.errors import StationError
from radioloc.measurements import ExactPredictor, PhysicalModel
from radioloc.measurements.proper_time import station_rate
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import ObservationRows
from radioloc.study import ModelChoice
from radioloc.time import Epochs, utc_to_tai

TAI = epochs_tai(8, 5.0, start_fraction=0.6)
COUNT_S = 600.0
SAME_M = 2e-6


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build(free_clocks=["KASHI"])


@pytest.mark.parametrize("latitude_deg", [0.0, 39.5, 90.0])
@pytest.mark.parametrize("height_m", [0.0, 2000.0])
def test_rate_is_the_potential_below_that_of_the_geoid(latitude_deg, height_m):
    """The potential of GRS80 by its harmonics (Moritz 2000, J. Geod. 74, 128), in place of gravity and height."""
    place_m = itrf_from_geodetic(1.0, np.radians(latitude_deg), height_m)
    radius_m = np.linalg.norm(place_m)
    sine, radius_ratio = place_m[2] / radius_m, 6378137.0 / radius_m
    zonal = {2: 1.08263e-3, 4: -2.37091222e-6, 6: 6.08347e-9}
    zonal_sum = 1.0 - sum(
        j * radius_ratio**n * np.polynomial.Legendre.basis(n)(sine) for n, j in zonal.items()
    )
    spin_m2_s2 = 0.5 * (7.292115e-5 * np.hypot(*place_m[:2])) ** 2
    potential_m2_s2 = 3.986005e14 / radius_m * zonal_sum + spin_m2_s2
    station = dataclasses.replace(StationCatalogue.default()["KASHI"], itrf_m=place_m)
    # On GRS80's ellipsoid it is 62636860.850 m^2/s^2.
    expected = (62636860.850 - potential_m2_s2) / C_M_S**2
    assert station_rate(station) == pytest.approx(expected, abs=2e-18)


CASES = {
    "three-way, transmit": ("range", "KASHI>x>JIAMUSI", "transmit"),
    "three-way, receive": ("range", "JIAMUSI>x>KASHI", "receive"),
    "two-way": ("range", "KASHI>x>KASHI", "receive"),
    "VLBI delay": ("vlbi_delay", "KASHI<x>JIAMUSI", "receive"),
    "VLBI delay rate": ("vlbi_delay_rate", "JIAMUSI<x>KASHI", "receive"),
    "three-way Doppler": ("doppler", "JIAMUSI>x>KASHI", "receive"),
    "two-way Doppler": ("doppler", "KASHI>x>KASHI", "receive"),
    "one-way Doppler": ("one_way_doppler", "x>KASHI", "receive"),
    "one-way": ("one_way_range", "x>KASHI", "receive"),
}


@pytest.mark.parametrize("case", CASES)
def test_term_equals_a_clock_rate(model, case):
    """The term has the effect of a clock rate, as given by the partials of the parameter."""
    kind, path, tag = CASES[case]
    count_s = COUNT_S if kind.endswith(("doppler", "rate")) else np.nan
    table = observations(path, TAI, tag, kind=kind, count_s=count_s)
    steered = model.without("station_proper_time")
    arc = ExactPredictor(steered, table, APOLLO15)
    evaluation = arc.predict()
    added_m = ExactPredictor(model, table, APOLLO15).predict().value_m - evaluation.value_m
    rows = ObservationRows(
        arc, reference=utc_to_tai(Epochs.from_jd(2459185.5, 0.0, "UTC")), prediction=evaluation
    )
    by_rate = PARAMETERS["clock_rate"].partials(rows)[..., 0]
    expected_m = (by_rate * (rows.ends == arc.stations.index("KASHI"))).sum(axis=1) * station_rate(
        model.catalogue["KASHI"]
    )
    assert np.abs(added_m - expected_m).max() < SAME_M
    if not case.startswith("two-way"):
        assert np.abs(added_m).max() > 0.01


def test_clocks_of_stations_by_any_of_their_names():
    assert PhysicalModel.build(free_clocks=["7045", "APOLLO"]).free_clocks == ("APOLLO",)
    with pytest.raises(StationError, match=r"free_clocks: .*ATLANTIS"):
        PhysicalModel.build(free_clocks=["ATLANTIS"])
    assert ModelChoice(free_clocks="KASHI").free_clocks == ("KASHI",)
