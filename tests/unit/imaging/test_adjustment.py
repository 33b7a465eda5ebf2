"""Adjustment of all images: exact data, covariance, undetermined images."""

from dataclasses import replace

import numpy as np
import pytest
from image_chains import CENTRE, Chain, drawn_ties

from radioloc.errors import InputError
from radioloc.imaging.homography import derivative, transformed

EXACT_M = 1e-6
CHAIN = Chain(images=5, map_below=3)


def exact(chain=CHAIN, stated=1.0):
    ties = drawn_ties(chain, np.random.default_rng(0), sigma_px=1e-6, map_sigma_m=1e-6, outliers=0.0)
    return replace(
        ties,
        sigma_px=np.full(len(ties.point), 0.5 * stated),
        map_sigma_m=np.full(len(ties.map_point), 2.0 * stated),
    )


@pytest.mark.parametrize("tilt", [-2e-4, 3e-4])
def test_low_images_converge_from_distant_tilted_starts(tilt):
    """The lowest image shows 8 m; all but the first three start 200 m away."""
    chain = Chain(images=10, map_below=3, part=0.5, drift_m=(0.0, 0.0))
    shift = np.array([[1.0, 0.0, 200.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    tilted = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [tilt, 0.0, 1.0 - tilt * CENTRE[0]]])
    start = [chain.matrix(k) if k < 3 else tilted @ chain.matrix(k) @ shift for k in range(chain.images)]
    result = chain.adjusted(exact(chain), np.array(start))
    assert result.used.all()
    np.testing.assert_allclose(result.place(9, CENTRE)[0], chain.ground(9, CENTRE), rtol=0, atol=10 * EXACT_M)


def central(function, at, relative, minimum):
    """Return derivatives by central differences, a column for each argument."""
    columns = []
    for k, step in enumerate(relative * np.maximum(np.abs(at), minimum)):
        change = step * np.eye(len(at))[k]
        columns.append((function(at + change) - function(at - change)) / (2.0 * step))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("doubled", [0, 10])
def test_covariance_is_that_of_dense_normal_equations(doubled):
    """Include homographies and places, with partials by differences; some pixels are observed twice."""
    chain = Chain(images=3, map_below=2, tied=8, on_map=8)
    ties = drawn_ties(chain, np.random.default_rng(2), sigma_px=0.5, map_sigma_m=2.0, outliers=0.0)
    columns = {
        name: np.concatenate([getattr(ties, name), getattr(ties, name)[:doubled]])
        for name in ("image", "point", "pixels", "sigma_px")
    }
    ties = replace(ties, **columns)
    result = chain.adjusted(ties)
    keep, on_map = result.used, result.map_used
    image, point = ties.image[keep], ties.point[keep]

    def parameters_and_places(unknown):
        parameters = unknown[:24].reshape(3, 8)
        return [np.append(p, 1.0).reshape(3, 3) for p in parameters], unknown[24:].reshape(-1, 2)

    def observed(unknown):
        matrices, places = parameters_and_places(unknown)
        pixels = [transformed(matrices[i], places[j][None])[0] for i, j in zip(image, point, strict=True)]
        return np.concatenate([np.ravel(pixels), places[ties.map_point[on_map]].ravel()])

    used_points = np.unique(point)
    parameters = [(m / m[2, 2]).ravel()[:8] for m in result.model.matrices]
    design = central(observed, np.concatenate([*parameters, result.places_m.ravel()]), 1e-6, 1e-5)
    of_places = 24 + (2 * used_points[:, np.newaxis] + np.arange(2)).ravel()
    sigma = [
        result.sigma_factors[0] * ties.sigma_px[keep],
        result.sigma_factors[1] * ties.map_sigma_m[on_map],
    ]
    weighted = design[:, [*range(24), *of_places]] / np.repeat(np.concatenate(sigma), 2)[:, np.newaxis]
    scale = np.linalg.norm(weighted, axis=0)
    covariance = np.linalg.inv((weighted / scale).T @ (weighted / scale)) / np.outer(scale, scale)

    def ground(p):
        return transformed(np.linalg.inv(np.append(p, 1.0).reshape(3, 3)), CENTRE[None])[0]

    by_parameters = central(ground, parameters[2], 1e-5, 1e-6)
    expected = by_parameters @ covariance[16:24, 16:24] @ by_parameters.T
    _, of_centre = result.place(2, CENTRE)
    np.testing.assert_allclose(of_centre, expected, rtol=0, atol=1e-3 * expected.max())  # of differences


def test_images_without_ties_to_the_map_are_refused():
    ties = exact()
    empty = np.zeros(0, np.int64)
    loose = replace(ties, map_point=empty, map_m=np.zeros((0, 2)), map_sigma_m=np.zeros(0))
    with pytest.raises(InputError, match="do not determine"):
        CHAIN.adjusted(loose)


# From pixels of a frame 1000 pixels wide to metres, 3 km east of the origin, seen 20 degrees off the vertical.
MATRIX = np.array([[1.9, 0.3, 3000.0], [-0.25, -2.1, 800.0], [1.0e-4, -2.0e-4, 1.0]])
PIXELS = np.random.default_rng(5).uniform(0.0, 1000.0, (60, 2))


def test_derivatives_are_central_differences():
    step = 1e-3
    numeric = np.stack(
        [
            (transformed(MATRIX, PIXELS + d) - transformed(MATRIX, PIXELS - d)) / (2 * step)
            for d in step * np.eye(2)
        ],
        axis=-1,
    )
    np.testing.assert_allclose(derivative(MATRIX, PIXELS), numeric, rtol=0, atol=1e-7)
