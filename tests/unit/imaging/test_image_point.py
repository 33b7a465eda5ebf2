"""A point measured in one image: its covariance against drawn errors, and by hand."""

from dataclasses import replace

import numpy as np
import pytest
from ldem import write_ldem_4
from paths import ISDS
from plane_surface import Plane

from radioloc.imaging import (
    Camera,
    ConstantOrientation,
    FrameModel,
    ImagePointSigmas,
    Terrain,
    locate_image_point,
    read_isd,
)
from radioloc.imaging.ground_points import image_to_ground
from radioloc.imaging.orientation import (
    matrices_from_quaternions,
    quaternions_from_matrices,
    rotation_matrices,
)
from radioloc.lunar import TerrainModel, cartesian_to_selenographic, east_north_up

DRAWS = 1500
SAMPLING = 4.5 / np.sqrt(
    DRAWS
)  # relative error of a sampled covariance, 4.5 standard deviations over sqrt(2)

SIGMAS = ImagePointSigmas(
    pixel=0.7, position_m=(20.0, 10.0, 5.0), attitude_rad=(3e-5, 5e-5, 1e-4), height_m=12.0
)


@pytest.fixture(scope="module")
def ldem_4(tmp_path_factory):
    return Terrain(TerrainModel.open(write_ldem_4(tmp_path_factory.mktemp("ldem"))))


def lro():
    return read_isd(ISDS / "lro_nac.json.gz", axes="ME_DE421").model


def disturbed(model, shift_m, angles_rad):
    """Add errors of the position and of the attitude about the camera's axes to a model."""
    orientation = model.orientation
    turned = matrices_from_quaternions(orientation.quaternions) @ rotation_matrices(angles_rad[None])
    changed = replace(
        orientation,
        positions_m=orientation.positions_m + shift_m,
        quaternions=quaternions_from_matrices(turned),
    )
    return replace(model, orientation=changed)


@pytest.mark.slow
def test_covariance_is_that_of_drawn_errors(ldem_4):
    """Draw errors of all sources, propagated without partials."""
    model, pixel = lro(), np.array([3000.0, 200.0])
    point = locate_image_point(model, pixel, ldem_4, SIGMAS)
    to_enu = east_north_up(*cartesian_to_selenographic(point.position_me.xyz_m)[:2])
    rng = np.random.default_rng(20)
    points = []
    for _ in range(DRAWS):
        draw = {
            name: rng.standard_normal(n)
            for name, n in (("pixel", 2), ("place", 3), ("turn", 3), ("height", 1))
        }
        shift_m = to_enu.T @ (draw["place"] * SIGMAS.position_m)
        wrong = disturbed(model, shift_m, draw["turn"] * SIGMAS.attitude_rad)
        ground = replace(ldem_4, raised_m=float(draw["height"][0] * SIGMAS.height_m))
        points.append(image_to_ground(wrong, [pixel + draw["pixel"] * SIGMAS.pixel], ground)[0])
    errors = (np.array(points) - point.position_me.xyz_m) @ to_enu.T
    drawn = errors.T @ errors / DRAWS
    # Compared with the unit matrix after whitening.
    whiten = np.linalg.inv(np.linalg.cholesky(point.covariance_enu_m2))
    assert np.abs(whiten @ drawn @ whiten.T - np.eye(3)).max() < SAMPLING
    assert np.abs(errors.mean(axis=0) / point.sigma_enu_m).max() < SAMPLING


def test_sigmas_by_hand():
    """Seen at 10 km and 30 degrees off nadir, a height error shifts the point horizontally by its tan(30 degrees)."""
    camera = Camera.of_pinhole(8.3, 6.7, [511.5, 511.5])
    down = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    tilt = rotation_matrices(np.radians([[0.0, -30.0, 0.0]]))[0]
    model = FrameModel(camera, ConstantOrientation([1737400.0 + 1e4, 0.0, 0.0], down @ tilt), (1024, 1024))
    ground = Plane([1737400.0, 0.0, 0.0], [1.0, 0.0, 0.0])

    def sigma_m(**sigmas):
        zero = {"pixel": 0.0, "position_m": 0.0, "attitude_rad": 0.0, "height_m": 0.0}
        return locate_image_point(
            model, [511.5, 511.5], ground, ImagePointSigmas(**(zero | sigmas))
        ).sigma_enu_m

    # The point is 5774 m west: up is 0.19 degrees from the normal of the plane, which mixes 0.0033 of each sigma.
    tangent, cosine = np.tan(np.radians(30.0)), np.cos(np.radians(30.0))
    assert sigma_m(height_m=10.0) == pytest.approx([10.0 * tangent, 0.0, 10.0], abs=0.04)
    assert sigma_m(position_m=(0.0, 3.0, 0.0)) == pytest.approx([0.0, 3.0, 0.0], abs=1e-6)
    assert sigma_m(position_m=(0.0, 0.0, 3.0)) == pytest.approx([3.0 * tangent, 0.0, 0.0], abs=0.02)
    # 1 mrad about y at 11547 m, on ground inclined by 30 degrees to the image plane
    assert sigma_m(attitude_rad=(0.0, 1e-3, 0.0)) == pytest.approx([11.547 / cosine, 0.0, 0.0], abs=0.05)
    assert sigma_m(pixel=(0.0, 1.0)) == pytest.approx([0.0, 11547.0 * 6.7e-3 / 8.3, 0.0], abs=1e-2)


def test_point_is_on_the_elevation_model(ldem_4):
    point = locate_image_point(lro(), [3000.0, 200.0], ldem_4, SIGMAS)
    assert point.position_me.frame == "ME_DE421"
    longitude_deg, latitude_deg, height_m = point.position_me.selenographic
    expected_m = ldem_4.model.height_m(*np.radians([longitude_deg, latitude_deg]))
    assert height_m == pytest.approx(expected_m, abs=1e-3)
    assert point.pixel_size_m == pytest.approx((1.5, 1.5), abs=0.1)
