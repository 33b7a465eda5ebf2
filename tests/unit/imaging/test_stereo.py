"""Stereo of a rover: intersection, distances to landmarks, and the body's place, with the Chang'e-3 rover's cameras."""

import numpy as np
import pytest
from scipy.stats import binom

from radioloc.errors import ConvergenceError, InputError
from radioloc.imaging import Camera
from radioloc.imaging.stereo import StereoPair, resect

# Chang'e-3 descent images (2014), table 3: 1024 pixels of 15 micrometres, focal lengths that differ, a baseline.
LEFT = Camera.of_pinhole(17.69, 15.0, [511.5, 511.5], [-0.05, 0.01])
RIGHT = Camera.of_pinhole(17.98, 15.0, [509.0, 514.0], [-0.04, 0.02])
BASELINE_M = np.array([0.26969, 0.0, 0.0])
TURN = np.radians(0.4)
ROTATION = np.array([[np.cos(TURN), 0.0, -np.sin(TURN)], [0.0, 1.0, 0.0], [np.sin(TURN), 0.0, np.cos(TURN)]])
PAIR = StereoPair(LEFT, RIGHT, BASELINE_M, ROTATION)
# Horizontal distances to landmarks a to d that it prints, m. Where they lie is in a figure without coordinates: these
# azimuths are of our choice.
DISTANCES_M = np.array([15.888, 13.648, 17.584, 15.896])
AZIMUTHS_RAD = np.radians([20.0, 95.0, 190.0, 280.0])
PLACE_M = np.array([3.0, -2.0])
LANDMARKS_M = PLACE_M + DISTANCES_M[:, None] * np.stack([np.sin(AZIMUTHS_RAD), np.cos(AZIMUTHS_RAD)], axis=1)
TRIALS = 1500


def pixels_of(points_m):
    left, seen_left = LEFT.pixels(points_m)
    right, seen_right = RIGHT.pixels((points_m - BASELINE_M) @ ROTATION.T)
    assert (seen_left & seen_right).all()
    return left, right


def test_points_come_back_through_cameras_of_unlike_focal_lengths():
    points = np.random.default_rng(1).uniform([-3.0, -2.0, 4.0], [3.0, 2.0, 40.0], (200, 3))
    found = PAIR.intersect(*pixels_of(points))
    np.testing.assert_allclose(found.points_m, points, atol=1e-8)
    np.testing.assert_allclose(found.misfit, 0.0, atol=1e-6)


def test_distances_are_as_good_as_the_classic_rule_says():
    """sigma_Z = Z^2 sigma_disparity / (b f), for a point straight ahead of parallel cameras."""
    camera = Camera.of_pinhole(17.69, 15.0, [511.5, 511.5])
    depth = 15.888
    focal_px = 17.69 / 0.015
    pair = StereoPair(camera, camera, BASELINE_M)
    left = np.array([[511.5 + 0.5 * BASELINE_M[0] * focal_px / depth, 511.5]])
    right = np.array([[511.5 - 0.5 * BASELINE_M[0] * focal_px / depth, 511.5]])
    found = pair.intersect(left, right, sigma_px=0.3)
    rule = depth**2 * 0.3 * np.sqrt(2.0) / (BASELINE_M[0] * focal_px)
    unit = found.points_m[0] / np.linalg.norm(found.points_m[0])
    sigma_m = np.sqrt(unit @ found.covariance_m2[0] @ unit)
    assert sigma_m == pytest.approx(rule, rel=1e-3)  # the half baseline to the side
    assert rule == pytest.approx(0.337, abs=0.001)


def test_intersections_scatter_as_their_covariance_says():
    rng = np.random.default_rng(2)
    point = np.array([1.0, 0.5, 15.888])
    left, right = pixels_of(np.tile(point, (TRIALS, 1)))
    sigma_px = 0.3
    found = PAIR.intersect(
        left + sigma_px * rng.normal(size=left.shape),
        right + sigma_px * rng.normal(size=right.shape),
        sigma_px,
    )
    apart = found.points_m - point
    inside = np.einsum("ni,nij,nj->n", apart, np.linalg.inv(found.covariance_m2), apart) < 7.815
    low, high = binom.ppf([1e-5, 1.0 - 1e-5], TRIALS, 0.95)
    assert low <= inside.sum() <= high
    low, high = binom.ppf([1e-5, 1.0 - 1e-5], TRIALS, 0.95)
    assert low <= (found.misfit < 1.96).sum() <= high


def test_a_point_that_is_another_in_the_right_image_is_refused():
    points = np.array([[0.0, 0.0, 10.0], [0.5, 0.2, 12.0]])
    left, right = pixels_of(points)
    right[1, 0] = left[1, 0] + 60.0
    with pytest.raises(InputError, match="point 2 do not meet"):
        PAIR.intersect(left, right)
    with pytest.raises(InputError, match="baseline_m"):
        StereoPair(LEFT, RIGHT, np.zeros(3))


def test_a_rover_is_located_by_its_four_distances():
    found = resect(LANDMARKS_M, DISTANCES_M, 0.3, 0.5)
    np.testing.assert_allclose(found.position_m, PLACE_M, atol=1e-6)
    # By hand: unit vectors to landmarks as rows, one variance.
    unit = np.stack([np.sin(AZIMUTHS_RAD), np.cos(AZIMUTHS_RAD)], axis=1)
    np.testing.assert_allclose(
        found.covariance_m2, (0.3**2 + 0.5**2) * np.linalg.inv(unit.T @ unit), rtol=1e-4
    )


@pytest.mark.slow
def test_places_by_distances_scatter_as_their_covariance_says():
    rng = np.random.default_rng(3)
    trials, inside = 400, 0
    for _ in range(trials):
        landmarks = LANDMARKS_M + 0.5 * rng.normal(size=LANDMARKS_M.shape)
        found = resect(landmarks, DISTANCES_M + 0.3 * rng.normal(size=4), 0.3, 0.5)
        apart = found.position_m - PLACE_M
        inside += apart @ np.linalg.solve(found.covariance_m2, apart) < 5.991
    low, high = binom.ppf([1e-5, 1.0 - 1e-5], trials, 0.95)
    assert low <= inside <= high


def test_landmarks_on_a_line_leave_two_places():
    line = np.array([[0.0, 0.0], [5.0, 0.0], [10.0, 0.0], [15.0, 0.0]])
    with pytest.raises(ConvergenceError, match=r"two places, 8\.0 m"):
        resect(line, np.linalg.norm(line - [6.0, 4.0], axis=1), 0.01, 0.01)
