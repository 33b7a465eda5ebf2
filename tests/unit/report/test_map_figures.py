"""What the map shows stands where it is: ellipses, references, degrees, the ground."""

import math

import numpy as np
import pytest
from paths import EXAMPLES
from recorded import recorded, reference

from radioloc.errors import InputError
from radioloc.report import plot_map

EXAMPLE = EXAMPLES / "images"
PLACE = (-51.9162, 43.0584)
PER_DEG_M = math.radians(1737400.0)


def content(name="lander", place=PLACE, frame="ME_DE421"):
    benchmark = reference("benchmark", PLACE[0], PLACE[1] + 0.001)
    return recorded(name, (*place, -2550.0), frame=frame, reference=benchmark)


def labelled(figure):
    """Lines with a label by it, m."""
    return {
        line.get_label(): line.get_xydata()[0]
        for line in figure.axes[0].get_lines()
        if not line.get_label().startswith("_")
    }


def test_positions_ellipses_and_references_are_in_metres_about_the_first():
    figure = plot_map([content(), content("other", (PLACE[0] + 0.001, PLACE[1]))])
    labels = labelled(figure)
    assert labels["lander, 1 and 3 sigma"] == pytest.approx((0.0, 0.0), abs=1e-6)
    east_m = 0.001 * PER_DEG_M * math.cos(math.radians(PLACE[1]))
    assert labels["other, 1 and 3 sigma"] == pytest.approx((east_m, 0.0), abs=1e-3)
    assert labels["benchmark"] == pytest.approx((0.0, 0.001 * PER_DEG_M), abs=1e-3)
    sizes = sorted({(round(p.width, 6), round(p.height, 6)) for p in figure.axes[0].patches})
    assert {tuple(sorted(size)) for size in sizes} == {(20.0, 40.0), (60.0, 120.0)}


def test_the_ground_is_under_the_position():
    rasterio = pytest.importorskip("rasterio")
    image = (
        plot_map(content(), base_map=EXAMPLE / "map.tif", reach_m=400.0).axes[0].get_images()[0].get_array()
    )
    with rasterio.open(EXAMPLE / "map.tif") as dataset:
        x, y = rasterio.warp.transform("IAU_2015:30100", dataset.crs, [PLACE[0]], [PLACE[1]])
        row, column = map(int, dataset.index(x[0], y[0]))  # rasterio 1.4.0 gives floats
        pixels = dataset.read(1)[row - 30 : row + 31, column - 30 : column + 31].astype(float)
    middle = len(image) // 2
    reach = round(30 * 8.0 * len(image) / 800.0)
    drawn = np.asarray(image, dtype=float)[
        middle - reach : middle + reach + 1, middle - reach : middle + reach + 1
    ]
    at = np.linspace(0, len(drawn) - 1, 61).round().astype(int)
    assert np.corrcoef(drawn[np.ix_(at, at)].ravel(), pixels.ravel())[0, 1] > 0.9


def test_default_map_ends_with_the_elevation_model():
    """Sixty cells of 7.6 km are more than the model has about the place."""
    pytest.importorskip("rasterio")
    axes = plot_map(content(), dem=EXAMPLES / "change5" / "ldem_4_landing_site.tif").axes[0]
    assert 40.0 < axes.get_xlim()[1] < 120.0  # km


def test_map_beyond_the_elevation_model_names_the_option():
    pytest.importorskip("rasterio")
    with pytest.raises(InputError, match="--reach"):
        plot_map(content(), dem=EXAMPLE / "dem.tif", reach_m=2e5)
