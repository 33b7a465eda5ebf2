"""Registration of descents over procedural ground: place of the last image, and status of each image."""

from dataclasses import replace

import numpy as np
import pytest
from image_chains import CENTRE, Chain, drawn_ties
from image_descents import PIXEL_M, Descent, scene
from scenes import frame, frame_matrix

from radioloc.errors import ConvergenceError, InputError
from radioloc.imaging import Distortion, image_chain
from radioloc.imaging.cameras import Camera, undistorted
from radioloc.imaging.frames import find_mask, read_frame
from radioloc.imaging.image_chain import Frame, FrameStatus
from radioloc.imaging.registration import register_chain, relief_covariance_m2
from radioloc.lunar.maps import Map

MAP_M = (5.0, 5.0)
PLACE_M = 0.8  # a fifth of the map's pixels of 4 m, with some hundred features

SHORT = Descent(frames=7)


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    return Map.open(SHORT.write_map(tmp_path_factory.mktemp("map") / "map.tif"))


def statuses(registration):
    return {frame.name: frame.status for frame in registration.frames}


@pytest.mark.slow
def test_place_of_the_last_image_includes_the_shift_of_the_map(tmp_path):
    """Register sixteen images with the spacecraft in view, the last ones far finer than a map 12 m east, 7 m south."""
    descent = Descent(spacecraft=True, shift_m=(12.0, -7.0))
    base = Map.open(descent.write_map(tmp_path / "map.tif"))
    mask = find_mask([descent.image(k) for k in range(0, 12, 2)])
    result = register_chain(descent.list, base, map_sigma_m=(12.0, 7.0), mask=mask)
    assert set(statuses(result).values()) == {FrameStatus.REGISTERED}
    for k in (0, 7, 15):
        point = result.ground_point(f"{k:04d}.png")
        np.testing.assert_allclose(descent.error_m(point, k) - [12.0, -7.0], 0.0, rtol=0, atol=PLACE_M)
    sigma_m = np.sqrt(np.diag(point.covariance_m2))
    assert (sigma_m > [12.0, 7.0]).all()
    assert (sigma_m < [12.5, 7.6]).all()
    last = result.frames[-1]
    assert "map" not in last.matched_to
    assert "map" in result.frames[0].matched_to
    assert last.pixel_m == pytest.approx(2.6 * 0.8**15 * PIXEL_M, abs=0.02)


@pytest.mark.slow
def test_image_outside_the_search_area_is_placed_by_the_next_one(base):
    matrices = [
        frame_matrix((250.0, 250.0), 2.3, shape=(400, 500)),
        frame_matrix((650.0, 650.0), 2.2, shape=(400, 500)),
    ]
    frames = [Frame(f"{k}", lambda m=m: frame(scene(), m, (400, 500))) for k, m in enumerate(matrices)]
    result = register_chain(frames, base, map_sigma_m=MAP_M, search_area=(-19.51, 44.12, 600.0))
    assert [f.matched_to for f in result.frames] == [(), ("0", "map")]
    point = result.ground_point("0")
    place_m = base.plane().from_longitude_latitude([[point.longitude_deg, point.latitude_deg]])[0]
    np.testing.assert_allclose(
        place_m, (250.0 - 999.5) * PIXEL_M * np.array([1.0, -1.0]), rtol=0, atol=5 * PLACE_M
    )


def not_an_image(path):
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(40))
    return read_frame(path)


WRONG = {
    "another scene": (FrameStatus.UNMATCHED, lambda k, _: frame(scene(2), SHORT.matrix(k), SHORT.shape)),
    "black": (FrameStatus.FEATURELESS, lambda k, _: np.zeros(SHORT.shape, np.uint8)),
    "saturated": (FrameStatus.FEATURELESS, lambda k, _: np.full(SHORT.shape, 255, np.uint8)),
    "mirrored": (FrameStatus.UNMATCHED, lambda k, _: np.ascontiguousarray(SHORT.image(k)[:, ::-1])),
    "cut": (FrameStatus.UNREADABLE, lambda k, folder: not_an_image(folder / "cut.png")),
}
ALL_WRONG = {1: "another scene", 2: "black", 4: "saturated", 5: "mirrored", 6: "cut"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frames", "names", "search_area"),
    [
        pytest.param(9, ALL_WRONG, None, marks=pytest.mark.slow, id="all"),
        pytest.param(4, {1: "black", 2: "cut"}, (-19.51, 44.12, 600.0), id="two"),
    ],
)
def test_foreign_images_have_a_status_and_the_others_are_registered(
    base, tmp_path, frames, names, search_area
):
    changed = {k: lambda k=k: WRONG[names[k]][1](k, tmp_path) for k in names}
    descent = Descent(frames=frames, changed=changed)
    result = register_chain(descent.list, base, map_sigma_m=MAP_M, search_area=search_area)
    expected = [WRONG[names[k]][0] if k in names else FrameStatus.REGISTERED for k in range(frames)]
    assert list(statuses(result).values()) == expected
    [cut] = [k for k in names if names[k] == "cut"]
    assert "cut.png" in result.frames[cut].reason
    point = result.ground_point(f"{frames - 1:04d}.png")
    np.testing.assert_allclose(descent.error_m(point, frames - 1), 0.0, rtol=0, atol=PLACE_M)
    with pytest.raises(InputError, match=rf"0001\.png is {expected[1].value}"):
        result.ground_point("0001.png")
    with pytest.raises(InputError, match="elsewhere"):
        result.ground_point("elsewhere.png")


@pytest.mark.slow
def test_last_images_that_only_match_each_other_are_untied(base):
    """Append two images of another scene to three registered ones."""
    changed = {k: lambda k=k: frame(scene(2), SHORT.matrix(k), SHORT.shape) for k in (3, 4)}
    result = register_chain(Descent(frames=5, changed=changed).list, base, map_sigma_m=MAP_M)
    expected = [FrameStatus.REGISTERED] * 3 + [FrameStatus.UNMATCHED, FrameStatus.UNTIED]
    assert list(statuses(result).values()) == expected
    assert result.frames[4].matched_to == ("0003.png",)
    # Feature noise on flat ground averages out: less than a tenth of a pixel is common to all points.
    assert np.sqrt(np.diag(result.common_m2)).max() < 0.1 * base.resolution_m
    with pytest.raises(InputError, match=r"0004\.png is untied"):
        result.ground_point("0004.png")


def test_errors_of_a_plane_with_correlated_displacement_have_their_sigma():
    """Displace places on the map by 4 m, alike within some 120 m, and count errors in sigmas."""
    chain, squares, independent_m = Chain(images=3, map_below=3, on_map=150), [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        ties = drawn_ties(chain, rng, sigma_px=0.6, map_sigma_m=3.0, outliers=0.0)
        independent_m.append(np.sqrt(np.trace(relief_covariance_m2(ties, chain.adjusted(ties), 2))))
        waves, phases = rng.normal(0.0, 1.0 / 120.0, (2, 50)), rng.uniform(0.0, 2.0 * np.pi, 50)
        moved_m = 4.0 / 5.0 * np.cos(ties.map_m @ waves + phases) @ rng.normal(size=(50, 2))
        ties = replace(ties, map_m=ties.map_m + moved_m)
        result = chain.adjusted(ties)
        place, covariance = result.place(2, CENTRE)
        covariance = covariance + relief_covariance_m2(ties, result, 2)
        error_m = place - chain.ground(2, CENTRE)
        squares.append(error_m @ np.linalg.solve(covariance, error_m))
    assert 0.7 < 0.5 * np.mean(squares) < 1.4
    assert np.median(independent_m) < 0.3


@pytest.mark.slow
@pytest.mark.parametrize(
    "frames",
    [
        Descent(frames=3, seed=2).list,
        [Frame(f"{k}", lambda: np.zeros((400, 500), np.uint8)) for k in range(3)],
        [Frame(f"{k}", lambda k=k: np.ascontiguousarray(SHORT.image(k)[:, ::-1])) for k in range(3)],
    ],
    ids=["another place", "black", "mirrored"],
)
def test_no_image_on_the_map_is_an_error(base, frames):
    with pytest.raises(ConvergenceError, match=r"no image .*map\.tif"):
        register_chain(frames, base, map_sigma_m=MAP_M)


@pytest.mark.study
def test_images_in_reversed_order_are_refused(base):
    with pytest.raises(InputError, match=r"reversed order: .*0006\.png"):
        register_chain(SHORT.list[:3:-1], base, map_sigma_m=MAP_M)


@pytest.mark.slow
def test_distortion_of_the_camera_is_removed(base):
    """Distort frames toward the middle by up to 9 pixels."""
    lens = Camera(1000.0, np.eye(2), [249.5, 199.5], Distortion("radial", [0.0, -3e-7, 0.0]))
    ideal = undistorted(lens)

    def distorted(k):
        import cv2

        grid = np.stack(np.meshgrid(np.arange(500.0), np.arange(400.0)), axis=-1)
        x, y = np.moveaxis(ideal(grid.reshape(-1, 2)).reshape(grid.shape).astype(np.float32), -1, 0)
        return cv2.remap(SHORT.image(k), x, y, cv2.INTER_CUBIC)

    frames = [Frame(f"{k}", lambda k=k: distorted(k), lambda _: lens) for k in range(3)]
    result = register_chain(frames, base, map_sigma_m=MAP_M)
    corner = np.array([[20.0, 30.0]])
    point = result.ground_point("2", corner[0])
    expected = SHORT.truth_deg(2, ideal(corner)[0])
    np.testing.assert_allclose([point.longitude_deg, point.latitude_deg], expected, rtol=0, atol=2e-5)


def test_mask_of_another_size_is_refused(base):
    with pytest.raises(InputError, match=r"the mask \(4, 5\)"):
        register_chain(SHORT.list[:1], base, map_sigma_m=MAP_M, mask=np.ones((4, 5), bool))


def test_products_of_homographies_along_hundreds_of_images_do_not_underflow():
    matrix = np.array([[0.9, 0.1, 300.0], [-0.1, 0.9, -500.0], [0.0, 0.0, 1.0]])
    to_plane = np.eye(3)
    for _ in range(500):
        to_plane = image_chain._product(to_plane, matrix / np.linalg.norm(matrix))
    assert np.linalg.norm(to_plane) == pytest.approx(1.0)
    np.testing.assert_allclose(
        to_plane[:2, 2] / to_plane[2, 2],
        np.linalg.solve(np.eye(2) - matrix[:2, :2], matrix[:2, 2]),
        rtol=1e-9,
    )
