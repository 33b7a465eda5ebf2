"""Stereo images of a rover with the cameras of Chang'e-3: intersection, and resection from landmarks."""

import numpy as np
import pytest
from scipy.stats import binom

from radioloc.errors import ConvergenceError, InputError
from radioloc.imaging import Camera
from radioloc.imaging.stereo import StereoPair, resect

# Chang'e-3 descent images (2014), table 3: 1024 pixels of 15 micrometres, focal lengths that differ, a baseline.
LEFT_CAMERA = Camera.of_pinhole(17.69, 15.0, [511.5, 511.5], [-0.05, 0.01])
RIGHT_CAMERA = Camera.of_pinhole(17.98, 15.0, [509.0, 514.0], [-0.04, 0.02])
BASELINE_M = np.array([0.26969, 0.0, 0.0])
TURN = np.radians(0.4)
ROTATION = np.array([[np.cos(TURN), 0.0, -np.sin(TURN)], [0.0, 1.0, 0.0], [np.sin(TURN), 0.0, np.cos(TURN)]])
PAIR = StereoPair(LEFT_CAMERA, RIGHT_CAMERA, BASELINE_M, ROTATION)
# Horizontal distances to landmarks a to d in that paper, m; the azimuths are arbitrary.
DISTANCES_M = np.array([15.888, 13.648, 17.584, 15.896])
AZIMUTHS_RAD = np.radians([20.0, 95.0, 190.0, 280.0])
PLACE_M = np.array([3.0, -2.0])
LANDMARKS_M = PLACE_M + DISTANCES_M[:, None] * np.stack([np.sin(AZIMUTHS_RAD), np.cos(AZIMUTHS_RAD)], axis=1)
TRIALS = 1500


def pixels_of(points_m):
    left_px, in_left = LEFT_CAMERA.pixels(points_m)
    right_px, in_right = RIGHT_CAMERA.pixels((points_m - BASELINE_M) @ ROTATION.T)
    assert (in_left & in_right).all()
    return left_px, right_px


def test_points_are_recovered_with_different_focal_lengths():
    points = np.random.default_rng(1).uniform([-3.0, -2.0, 4.0], [3.0, 2.0, 40.0], (200, 3))
    intersection = PAIR.intersect(*pixels_of(points))
    np.testing.assert_allclose(intersection.points_m, points, atol=1e-8)
    np.testing.assert_allclose(intersection.misfit, 0.0, atol=1e-6)


def test_sigma_of_a_distance_follows_the_classic_rule():
    """Compare with Z^2 sigma_disparity / (b f) for a point straight ahead of parallel cameras."""
    camera = Camera.of_pinhole(17.69, 15.0, [511.5, 511.5])
    depth = 15.888
    focal_px = 17.69 / 0.015
    pair = StereoPair(camera, camera, BASELINE_M)
    left_px = np.array([[511.5 + 0.5 * BASELINE_M[0] * focal_px / depth, 511.5]])
    right_px = np.array([[511.5 - 0.5 * BASELINE_M[0] * focal_px / depth, 511.5]])
    intersection = pair.intersect(left_px, right_px, sigma_px=0.3)
    rule = depth**2 * 0.3 * np.sqrt(2.0) / (BASELINE_M[0] * focal_px)
    unit = intersection.points_m[0] / np.linalg.norm(intersection.points_m[0])
    sigma_m = np.sqrt(unit @ intersection.covariance_m2[0] @ unit)
    assert sigma_m == pytest.approx(rule, rel=1e-3)  # half the baseline to the side
    assert rule == pytest.approx(0.337, abs=0.001)


def test_intersections_scatter_by_their_covariance():
    rng = np.random.default_rng(2)
    point = np.array([1.0, 0.5, 15.888])
    left_px, right_px = pixels_of(np.tile(point, (TRIALS, 1)))
    sigma_px = 0.3
    intersection = PAIR.intersect(
        left_px + sigma_px * rng.normal(size=left_px.shape),
        right_px + sigma_px * rng.normal(size=right_px.shape),
        sigma_px,
    )
    errors = intersection.points_m - point
    chi2 = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(intersection.covariance_m2), errors)
    low, high = binom.ppf([1e-5, 1.0 - 1e-5], TRIALS, 0.95)
    assert low <= (chi2 < 7.815).sum() <= high
    assert low <= (intersection.misfit < 1.96).sum() <= high


def test_different_points_in_the_two_images_are_refused():
    left_px, right_px = pixels_of(np.array([[0.0, 0.0, 10.0], [0.5, 0.2, 12.0]]))
    right_px[1, 0] = left_px[1, 0] + 60.0
    with pytest.raises(InputError, match="point 2 do not meet"):
        PAIR.intersect(left_px, right_px)
    with pytest.raises(InputError, match="baseline_m"):
        StereoPair(LEFT_CAMERA, RIGHT_CAMERA, np.zeros(3))


def test_rover_is_located_by_four_distances():
    resection = resect(LANDMARKS_M, DISTANCES_M, 0.3, 0.5)
    np.testing.assert_allclose(resection.position_m, PLACE_M, atol=1e-6)
    # By hand: unit vectors to landmarks as rows, one variance.
    unit = np.stack([np.sin(AZIMUTHS_RAD), np.cos(AZIMUTHS_RAD)], axis=1)
    np.testing.assert_allclose(
        resection.covariance_m2, (0.3**2 + 0.5**2) * np.linalg.inv(unit.T @ unit), rtol=1e-4
    )


@pytest.mark.slow
def test_resections_scatter_by_their_covariance():
    rng = np.random.default_rng(3)
    trials, count = 400, 0
    for _ in range(trials):
        landmarks = LANDMARKS_M + 0.5 * rng.normal(size=LANDMARKS_M.shape)
        resection = resect(landmarks, DISTANCES_M + 0.3 * rng.normal(size=4), 0.3, 0.5)
        error = resection.position_m - PLACE_M
        count += error @ np.linalg.solve(resection.covariance_m2, error) < 5.991
    low, high = binom.ppf([1e-5, 1.0 - 1e-5], trials, 0.95)
    assert low <= count <= high


def test_landmarks_on_a_line_are_ambiguous():
    line = np.array([[0.0, 0.0], [5.0, 0.0], [10.0, 0.0], [15.0, 0.0]])
    with pytest.raises(ConvergenceError, match=r"two places, 8\.0 m"):
        resect(line, np.linalg.norm(line - [6.0, 4.0], axis=1), 0.01, 0.01)
