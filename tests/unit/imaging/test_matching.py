"""Tie points of two images: real frames and maps, true transformations, and images of different ground."""

from functools import cache, partial

import cv2
import numpy as np
import pytest
import rasterio
from descent_images import BOX, FOLDER, NAMES, change3, image, needs_images
from quick import some
from scenes import frame, frame_matrix, ground
from terrain_maps import write_raster

from radioloc.imaging.frames import find_mask
from radioloc.imaging.homography import transformed
from radioloc.imaging.image_chain import Frame
from radioloc.imaging.matching import MatchStatus, detect, match
from radioloc.imaging.registration import register_chain
from radioloc.lunar.maps import Map

BOX_PX = 3.0  # the drawn boxes are good to 2 pixels each
TRUE_PX = 0.5  # at the edge of the image, of a transformation from some 100 tie points
CORNERS = np.array([[0.0, 0.0], [399.0, 0.0], [0.0, 399.0], [399.0, 399.0], [199.5, 199.5]])


@cache
def scene(seed=1, sun_deg=0.0):
    return ground(seed, sun_deg=sun_deg)


@cache
def real_features():
    images = change3()
    mask = find_mask(list(images.values()))
    return {name: detect(image, mask) for name, image in images.items()}


@needs_images
@pytest.mark.parametrize(("later", "earlier"), [(a, b) for a in NAMES for b in NAMES if a > b])
def test_change3_frames_register_to_each_other(later, earlier):
    """The boxed crater is mapped onto itself; OpenCV's defaults give 53 to 239 tie points."""
    features = real_features()
    matches = match(features[later], features[earlier])
    assert matches.status is MatchStatus.MATCHED
    assert len(matches.first) >= 90
    box = transformed(matches.matrix, np.array([BOX[later]]))[0]
    assert np.abs(box - BOX[earlier]).max() < BOX_PX


@needs_images
def test_ground_is_matched_without_mask_of_the_spacecraft():
    """Tie points of the ground outnumber those of the spacecraft, which do not move."""
    matches = match(*(detect(change3()[name]) for name in ("1831", "1801")))
    assert np.abs(transformed(matches.matrix, np.array([BOX["1831"]]))[0] - BOX["1801"]).max() < BOX_PX


@pytest.mark.slow
@needs_images
def test_kaguya_map_registers_to_the_shaded_elevation_model():
    """The maps differ by a shift of some tens of pixels, without scale and rotation."""
    features = [
        detect(image(name), count=6000) for name in ("kaguya_map_1000px.png", "dem_hillshade_1000px.png")
    ]
    matches = match(*features)
    assert len(matches.first) > 300
    matrix = matches.matrix / matches.matrix[2, 2]
    np.testing.assert_allclose(matrix[:2, :2], np.eye(2), rtol=0, atol=0.01)
    np.testing.assert_allclose(matrix[:2, 2], [0.0, 50.0], rtol=0, atol=3.0)
    mirrored = detect(np.ascontiguousarray(image("kaguya_map_1000px.png")[:, ::-1]), count=6000)
    assert match(mirrored, features[1]).status is MatchStatus.UNMATCHED


@needs_images
@pytest.mark.parametrize("scale", some([0.5, 0.7, 1.0, 1.4, 2.0], [1.0]))
def test_change3_frame_on_the_nac_map_is_right_at_each_scale(scale):
    """Two craters of a map with another Sun and scale, measured by eye within 4 pixels, coincide."""
    drawn = cv2.imread(str(FOLDER / "change3_lro.png"))
    nac = cv2.cvtColor(drawn, cv2.COLOR_BGR2GRAY)[:, 475:922]
    clean = cv2.dilate((np.ptp(drawn, axis=2) > 40).astype(np.uint8), np.ones((9, 9)))[:, 475:922] == 0
    size = (round(nac.shape[1] * scale), round(nac.shape[0] * scale))
    usable = cv2.resize(clean.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(bool)
    matches = match(real_features()["1801"], detect(cv2.resize(nac, size), usable, count=4000))
    assert matches.status is MatchStatus.MATCHED
    craters = np.array([[207.0, 235.0], [152.0, 295.0]])  # in frame 1801
    mapped_craters = (transformed(matches.matrix, craters) + 0.5) / scale - 0.5
    np.testing.assert_allclose(mapped_craters, [[212.0, 215.0], [251.0, 147.0]], rtol=0, atol=5.0)


@needs_images
def test_change3_frames_are_tied_to_both_sides_of_a_cylindrical_map(tmp_path):
    nac = image("change3_lro.png")[:, 461:]
    path, pixel_m = tmp_path / "map.tif", 30.0
    crs = "+proj=eqc +lat_ts=44 +lon_0=-19.51 +R=1737400"
    north_m = np.radians(44.12) * 1737400.0 + pixel_m * nac.shape[0] / 2
    to_xy = rasterio.Affine(pixel_m, 0.0, -pixel_m * nac.shape[1] / 2, 0.0, -pixel_m, north_m)
    write_raster(path, nac, transform=to_xy, crs=crs)
    frames = [Frame(name, partial(image, f"change3_{name}.png")) for name in NAMES[:2]]
    mask = find_mask(list(change3().values()))
    east_m = register_chain(frames, Map.open(path), map_sigma_m=(10.0, 10.0), mask=mask).map_places_m[:, 0]
    assert (east_m < 0.0).sum() > 20
    assert (east_m > 0.0).sum() > 20


@pytest.mark.parametrize(
    ("pixel", "turn_deg", "tilt"),
    [(1.0, 0.0, (0.0, 0.0)), (2.0, 30.0, (0.0, 0.0)), (1.4, 200.0, (2e-4, -3e-4)), (0.6, -75.0, (0.0, 0.0))],
)
def test_true_transformation_is_recovered(pixel, turn_deg, tilt):
    first = frame_matrix((740.0, 760.0), 1.5)
    second = frame_matrix((760.0, 735.0), pixel, turn_deg, tilt)
    matches = match(*(detect(frame(scene(), m, seed=k)) for k, m in enumerate((first, second))))
    assert matches.status is MatchStatus.MATCHED
    in_first = transformed(np.linalg.solve(first, second), CORNERS)
    errors_px = np.abs(transformed(matches.matrix, in_first) - CORNERS)
    assert errors_px.max() < TRUE_PX * max(1.0, 1.5 / pixel)


@pytest.mark.slow
@pytest.mark.parametrize("factor", some([2, 3], [3]))
def test_no_bias_between_scales(factor):
    """Features of an image and of its means over squares of pixels; 0.13 to 0.18 pixel apart with OpenCV's default."""
    large = scene()[:1200, :1200]
    small = cv2.resize(large, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    features = detect(large, count=8000), detect(small, count=4000)
    matches = match(*features)
    expected = (features[0].pixels[matches.first] + 0.5) / factor - 0.5
    assert len(matches.first) > 150
    assert np.abs(np.median(features[1].pixels[matches.second] - expected, axis=0)).max() < 0.04


def other_scene():
    return frame(scene(2), frame_matrix((740.0, 760.0), 1.5), seed=3)


def mirrored():
    return np.ascontiguousarray(frame(scene(), frame_matrix((740.0, 760.0), 1.5))[:, ::-1])


@pytest.mark.parametrize(
    ("image", "status"),
    [
        (other_scene, MatchStatus.UNMATCHED),
        (mirrored, MatchStatus.UNMATCHED),
        (lambda: np.zeros((400, 400), np.uint8), MatchStatus.FEATURELESS),
        (lambda: np.full((400, 400), 255, np.uint8), MatchStatus.FEATURELESS),
        (lambda: np.tile(np.linspace(90, 130, 400).astype(np.uint8), (400, 1)), MatchStatus.FEATURELESS),
        (
            lambda: np.random.default_rng(3).integers(0, 255, (400, 400)).astype(np.uint8),
            MatchStatus.UNMATCHED,
        ),
    ],
    ids=["another place", "mirrored", "black", "saturated", "a ramp", "noise"],
)
def test_images_of_different_ground_do_not_match(image, status):
    first, second = detect(frame(scene(), frame_matrix((740.0, 760.0), 1.5))), detect(image())
    for matches in (match(first, second), match(second, first)):
        assert matches.status is status
        assert matches.matrix is None
        assert not len(matches.first)


@pytest.mark.study
def test_random_partners_do_not_match():
    """Accept none of 200 draws of random partners for as many features as real images have."""
    rng = np.random.default_rng(8)
    features = detect(frame(scene(), frame_matrix((740.0, 760.0), 1.5)), count=300)
    for _ in range(200):
        shuffled = features._replace(pixels=rng.uniform(0.0, 400.0, features.pixels.shape))
        assert match(features, shuffled).status is MatchStatus.UNMATCHED


def test_impossible_views_are_refused_despite_agreement():
    features = detect(frame(scene(), frame_matrix((740.0, 760.0), 1.5)))
    flipped = features._replace(pixels=features.pixels * [-1.0, 1.0] + [399.0, 0.0])
    assert match(features, flipped).status is MatchStatus.UNMATCHED
    flattened = features._replace(pixels=features.pixels * [1.0, 0.1])
    assert match(features, flattened).status is MatchStatus.IMPLAUSIBLE


def test_masked_pixels_give_no_features():
    image = frame(scene(), frame_matrix((740.0, 760.0), 1.5))
    mask = np.zeros(image.shape, bool)
    mask[:, 150:] = True
    assert detect(image, mask).pixels[:, 0].min() > 149.0
    assert not len(detect(image, np.zeros(image.shape, bool)).pixels)


def test_features_are_spread_over_the_image():
    """A half with more than twice the contrast of the other does not have all features."""
    image = frame(scene(), frame_matrix((740.0, 760.0), 1.5)).astype(float)
    image[200:] = 110.0 + 0.4 * (image[200:] - 110.0)
    pixels = detect(np.clip(image, 0, 255).astype(np.uint8), count=400).pixels
    assert np.mean(pixels[:, 1] > 200) > 0.25
