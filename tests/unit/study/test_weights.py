"""Sigmas changed by type, station and file."""

import numpy as np
import pytest
from arc_cases import observed_at

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError
from radioloc.measurements import Link
from radioloc.study.observation_choice import Weight, require_stations, weighted_observations
from radioloc.time import Epochs

CATALOGUE = StationCatalogue.default()
# Sums of squares, and products.
ROUNDING = 1e-15


def observations():
    links = (Link("KASHI", "x", "KASHI"), Link("KASHI", "x", "JIAMUSI"), Link("SESHAN25", "x", "KASHI", True))
    return observed_at(
        Epochs.from_jd(2459185.5, np.linspace(0.0, 0.5, 4), "UTC"),
        links,
        link=[0, 1, 2, 1],
        kind=[0, 0, 1, 0],
        value_m=[7.5e8, 7.5e8, 1e6, 7.6e8],
        sigma_m=[1.0, 2.0, 3.0, 4.0],
        files=("data/a.csv", "data/b.tdm"),
        file=[0, 0, 1, 1],
    )


@pytest.mark.parametrize(
    ("weights", "expected_m"),
    [
        ([], [1, 2, 3, 4]),
        ([Weight(type="range", sigma_m=5.0)], [5, 5, 3, 5]),
        ([Weight(stations=["JIAMUSI"], factor=2.0)], [1, 4, 3, 8]),
        ([Weight(stations="KASHI", type=["vlbi_delay"], extra_sigma_m=4.0)], [1, 2, 5, 4]),
        ([Weight(files="b.*", factor=10.0)], [1, 2, 30, 40]),
        ([Weight(files="data/*.csv", sigma_m=0.1)], [0.1, 0.1, 3, 4]),
        ([Weight(sigma_m=1.0, factor=3.0, extra_sigma_m=4.0)], [5, 5, 5, 5]),
        ([Weight(factor=2.0), Weight(type="range", factor=2.0)], [4, 8, 6, 16]),
        ([Weight(sigma_m=9.0), Weight(files="a.csv", sigma_m=1.0)], [1, 1, 9, 9]),
    ],
)
def test_entries_apply_in_order_to_rows_that_all_selectors_match(weights, expected_m):
    stated = observations()
    result = weighted_observations(stated, weights, CATALOGUE)
    np.testing.assert_allclose(result.sigma_m, expected_m, rtol=ROUNDING)
    np.testing.assert_array_equal(stated.sigma_m, [1, 2, 3, 4])
    np.testing.assert_array_equal(result.value_m, stated.value_m)
    assert not result.sigma_m.flags.writeable


@pytest.mark.parametrize(
    ("weight", "words"),
    [
        (Weight(type="doppler", factor=2.0), "number 2 .doppler: times 2. applies to no .* by JIAMUSI"),
        (Weight(stations="ATLANTIS", factor=2.0), "number 2 .*ATLANTIS"),
    ],
)
def test_inapplicable_entries_are_refused(weight, words):
    with pytest.raises(InputError, match=words):
        weighted_observations(observations(), [Weight(factor=100.0), weight], CATALOGUE)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"type": "ranging", "factor": 2.0}, "type: expected one of .*, got 'ranging'"),
        ({"type": "range"}, "expected sigma_m, factor or extra_sigma_m"),
    ],
)
def test_invalid_entries_are_refused(fields, words):
    with pytest.raises(InputError, match=words):
        Weight(**fields)


def test_a_noise_of_a_station_without_observations_is_an_error():
    require_stations(observations(), "vlbi_station_sigma_m", ["SESHAN25", "KASHI"], CATALOGUE)
    with pytest.raises(InputError, match=r"vlbi_station_sigma_m:.*URUMQI;.*JIAMUSI, KASHI"):
        require_stations(observations(), "vlbi_station_sigma_m", ["URUMQI"], CATALOGUE)
    with pytest.raises(InputError, match=r"vlbi_station_sigma_m: .*ATLANTIS"):
        require_stations(observations(), "vlbi_station_sigma_m", ["ATLANTIS"], CATALOGUE)


def test_the_provenance_has_the_keys_that_are_given():
    weight = Weight(type="range", stations="APOLLO", factor=3.0)
    assert weight.record() == {"type": ("range",), "stations": ("APOLLO",), "factor": 3.0}
