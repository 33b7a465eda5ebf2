import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.media.grids import LatLonGrid, sort_into_grid

LATITUDES = np.arange(-87.5, 88.0, 5.0)
CENTRES = np.arange(2.5, 360.0, 5.0)
WITH_REPEAT = np.arange(-180.0, 181.0, 5.0)


def interpolate(grid: LatLonGrid, values: np.ndarray, latitude_deg, longitude_deg) -> np.ndarray:
    rows, columns, weights = grid.corners(np.deg2rad(latitude_deg), np.deg2rad(longitude_deg))
    return (values[rows, columns] * weights).sum(axis=-1)


@pytest.mark.parametrize("latitudes", [LATITUDES, LATITUDES[::-1]])
@pytest.mark.parametrize("longitudes", [CENTRES, CENTRES[::-1], WITH_REPEAT, WITH_REPEAT[::-1]])
def test_interpolation_is_exact_for_linear_fields_on_closed_grids(latitudes, longitudes) -> None:
    """Field linear in latitude times a saw tooth of the longitude, which is continuous over 360 degrees."""
    grid = LatLonGrid(latitudes, longitudes, "a map")

    def tooth(longitude_deg):
        return np.abs((np.asarray(longitude_deg) % 360.0) - 182.5)

    kinks = tooth(longitudes)
    values = (3.0 - latitudes)[:, None] * kinks
    latitude = np.array([-87.5, -40.0, 0.1, 33.3, 87.5])
    # Longitudes between columns on one side of the tips of the tooth.
    for longitude in (-170.0, 6.1, 100.0, 243.3, 355.0):
        result = interpolate(grid, values, latitude, longitude)
        np.testing.assert_allclose(result, (3.0 - latitude) * tooth(longitude), rtol=1e-12, atol=1e-9)
        np.testing.assert_allclose(result, interpolate(grid, values, latitude, longitude - 360.0), atol=1e-9)


@pytest.mark.parametrize("longitudes", [CENTRES, CENTRES[::-1], WITH_REPEAT])
def test_between_last_and_first_column(longitudes) -> None:
    values = np.ones((len(LATITUDES), 1)) * np.cos(np.deg2rad(longitudes))
    grid = LatLonGrid(LATITUDES, longitudes, "a map")
    middle = interpolate(grid, values, 10.0, np.array([0.0, 360.0, -1e-9, 179.999, -179.999]))
    # Half a step of 5 degrees from the crest the chord is 1e-3 below.
    np.testing.assert_allclose(middle, [1.0, 1.0, 1.0, -1.0, -1.0], atol=1.1e-3)


def test_edges_of_regional_maps() -> None:
    grid = LatLonGrid(np.array([60.0, 50.0, 40.0]), np.array([-10.0, 0.0, 10.0, 20.0]), "the map")
    values = np.arange(12.0).reshape(3, 4)
    assert interpolate(grid, values, 60.0, -10.0) == pytest.approx(0.0, abs=1e-9)
    assert interpolate(grid, values, 40.0, 20.0) == pytest.approx(11.0, abs=1e-9)
    assert interpolate(grid, values, 45.0, 375.0) == pytest.approx(8.5, abs=1e-9)
    for place in ((50.0, 21.0), (50.0, -11.0), (39.9, 0.0), (60.1, 0.0), (np.nan, 0.0), (50.0, np.nan)):
        with pytest.raises(InputError, match=r"40.*60"):
            grid.corners(*np.deg2rad(place))


@pytest.mark.parametrize(
    ("latitudes", "longitudes", "words"),
    [
        ([0.0], [0.0, 1.0], "latitudes_deg"),
        ([0.0, 1.0, 3.0], [0.0, 1.0], "latitudes_deg"),
        ([0.0, 1.0], np.arange(0.0, 366.0, 5.0), "more than 360"),
    ],
)
def test_unusable_grids(latitudes, longitudes, words: str) -> None:
    with pytest.raises(InputError, match=words):
        LatLonGrid(np.array(latitudes), np.array(longitudes), "a map")


def test_sorts_points_in_any_order() -> None:
    latitude, longitude = (part.ravel() for part in np.meshgrid(LATITUDES, CENTRES, indexing="ij"))
    shuffled = np.random.default_rng(3).permutation(len(latitude))
    values = latitude + 0.001 * longitude
    grid, order = sort_into_grid(latitude[shuffled], longitude[shuffled] - 360.0, "a map")
    np.testing.assert_array_equal(grid.latitudes_deg, LATITUDES)
    np.testing.assert_allclose(grid.longitudes_deg, CENTRES)
    np.testing.assert_array_equal(values[shuffled][order], values.reshape(36, 72))
    for points in (shuffled[1:], np.append(shuffled, shuffled[0])):
        with pytest.raises(InputError, match=r"36.*72"):
            sort_into_grid(latitude[points], longitude[points], "a map")
