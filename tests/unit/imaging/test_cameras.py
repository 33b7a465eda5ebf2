"""Lens distortion and interior orientation: published formulas, round trips, folds, partials."""

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.imaging import Camera, Distortion

ROUND_TRIP_PX = 1e-7  # far above the end of Newton's method
PARTIALS_RELATIVE = 1e-6  # of central differences

# Of Apollo 15 metric, LRO NAC and Kaguya TC 1.
KAGUYA = [
    -0.0725,
    -0.00096499,
    0.00098441,
    8.5773e-06,
    -3.7438e-06,
    0.0214,
    -0.0013796,
    1.3502e-05,
    2.7251e-06,
    -6.1938e-06,
]
LENSES = {
    "none": [],
    "radial": [-1.3361854e-06, 5.2261757e-10, -5.0728336e-14],
    "brown": [-0.12, 0.03, 1e-3, -2e-3, 0.01],
    "lrolrocnac": [1.81e-05],
    "kaguyalism": KAGUYA,
}


def camera(kind, **changes):
    fields = {
        "focal_length_mm": 72.45,
        "pixel_per_mm": [[1.0, -142.857], [142.857, 0.5]],
        "principal_point_px": [2047.0, 1000.0],
        "distortion": Distortion(kind, LENSES[kind]),
    }
    return Camera(**(fields | changes))


def pixels(rng, n=400):
    return rng.uniform([0.0, 0.0], [4095.0, 2000.0], size=(n, 2))


@pytest.mark.parametrize("kind", LENSES)
@pytest.mark.parametrize("looks_along_z", [1, -1])
def test_pixels_to_directions_and_back(kind, looks_along_z):
    model = camera(kind, looks_along_z=looks_along_z)
    image_px = pixels(np.random.default_rng(1))
    directions = model.directions(image_px)
    assert (directions[:, 2] == looks_along_z).all()
    projected_px, visible = model.pixels(directions * np.linspace(0.1, 1e6, len(image_px))[:, None])
    assert visible.all()
    assert np.abs(projected_px - image_px).max() < ROUND_TRIP_PX


@pytest.mark.parametrize("kind", LENSES)
def test_partials_are_those_of_central_differences(kind):
    model = camera(kind)
    image_px = pixels(np.random.default_rng(2))
    directions, by_pixel = model.directions_and_partials(image_px)
    _, by_direction, _ = model.pixels_and_partials(directions)
    step_px, step = 1e-2, 1e-5
    for k in range(2):
        change = np.eye(2)[k] * step_px
        slope = (model.directions(image_px + change) - model.directions(image_px - change)) / (2 * step_px)
        assert np.abs(by_pixel[:, :, k] - slope).max() < PARTIALS_RELATIVE * np.abs(by_pixel).max()
    for k in range(3):
        change = np.eye(3)[k] * step
        slope = (model.pixels(directions + change)[0] - model.pixels(directions - change)[0]) / (2 * step)
        assert np.abs(by_direction[:, :, k] - slope).max() < PARTIALS_RELATIVE * np.abs(by_direction).max()


def test_distortions_follow_their_published_formulas():
    measured = np.array([[3.0, 4.0]])  # r = 5 mm
    k0, k1, k2 = LENSES["radial"]
    assert Distortion("radial", LENSES["radial"]).ideal(measured)[0] == pytest.approx(
        measured * (1 - k0 - 25 * k1 - 625 * k2), abs=1e-15
    )
    assert Distortion("lrolrocnac", [1.81e-5]).ideal(measured)[0] == pytest.approx(
        np.array([[3.0, 4.0 / (1 + 16 * 1.81e-5)]]), abs=1e-15
    )
    x = 3.0 - 0.0725 - 0.00096499 + 5 * 0.00098441 + 25 * 8.5773e-06 - 125 * 3.7438e-06
    y = 4.0 + 0.0214 - 0.0013796 + 5 * 1.3502e-05 + 25 * 2.7251e-06 - 125 * 6.1938e-06
    assert Distortion("kaguyalism", KAGUYA).ideal(measured)[0] == pytest.approx(np.array([[x, y]]), abs=1e-15)
    k1, k2, p1, p2, k3 = LENSES["brown"]
    radial = 1 + k1 * 0.05 + k2 * 0.05**2 + k3 * 0.05**3
    brown = [
        0.1 * radial + 2 * p1 * 0.02 + p2 * (0.05 + 0.02),
        0.2 * radial + p1 * (0.05 + 0.08) + 2 * p2 * 0.02,
    ]
    assert Distortion("brown", LENSES["brown"]).measured(np.array([[0.1, 0.2]]))[0] == pytest.approx(
        np.array([brown]), abs=1e-15
    )


def test_rays_beyond_a_fold_are_not_visible():
    """The polynomial x (1 - 0.3 x^2) returns to zero at 1.8 focal lengths."""
    model = Camera.of_pinhole(10.0, 10.0, [500.0, 500.0], [-0.3])
    folded, visible = model.pixels([[1.8, 0.0, 1.0], [0.5, 0.0, 1.0]])
    assert abs(folded[0, 0] - 500.0) < 100.0  # apparent pixel
    assert visible.tolist() == [False, True]


def test_pixels_beyond_the_distorted_image_are_refused():
    model = Camera.of_pinhole(10.0, 10.0, [500.0, 500.0], [-0.3])  # its largest radius is 0.70 focal lengths
    with pytest.raises(InputError, match=r"1400.*500"):
        model.directions([[600.0, 500.0], [1400.0, 500.0]])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Distortion("barrel", []), "distortion: expected .* 'barrel'"),
        (lambda: Distortion("brown", [np.nan]), "expected 1 to 5 finite"),
        (lambda: camera("none", pixel_per_mm=[[1.0, 1.0], [1.0, 1.0]]), "pixel_per_mm: expected"),
        (lambda: Camera.of_pinhole(8.3, -6.7, [0.0, 0.0]), "pixel_size_um: expected a positive"),
        (lambda: camera("none").pixels([[1.0, 2.0, np.inf]]), "directions: expected finite numbers"),
    ],
)
def test_invalid_arguments_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
