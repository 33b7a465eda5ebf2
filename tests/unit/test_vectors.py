"""Products of many vectors against NumPy's own, however the vectors lie in memory."""

import numpy as np
import pytest

from radioloc.vectors import by_component, cross, dot, length, rotated

# Vectors of some units: rounding.
ROUNDING = 4e-15


@pytest.fixture(params=["by row", "by component"])
def vectors(request):
    random = np.random.default_rng(4)
    a, b, rotation = random.normal(size=(50, 3)), random.normal(size=(50, 3)), random.normal(size=(50, 3, 3))
    return tuple(map(by_component, (a, b, rotation))) if request.param == "by component" else (a, b, rotation)


def test_products(vectors):
    a, b, rotation = vectors
    np.testing.assert_allclose(dot(a, b), (a * b).sum(axis=-1), rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(length(a), np.linalg.norm(a, axis=-1), rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(cross(a, b), np.cross(a, b), rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(
        rotated(rotation, a), (rotation @ a[:, :, None])[..., 0], rtol=0, atol=ROUNDING
    )


def test_one_vector_with_many(vectors):
    a, b, _ = vectors
    np.testing.assert_allclose(dot(a, b[0]), a @ b[0], rtol=0, atol=ROUNDING)
    assert length(np.zeros((0, 3))).shape == (0,)


def test_by_component_keeps_values():
    a = np.arange(24.0).reshape(8, 3)
    laid_out = by_component(a)
    assert laid_out.flags.f_contiguous
    np.testing.assert_array_equal(laid_out, a)
    assert by_component(laid_out) is laid_out
    assert by_component(a[:, 0]).tolist() == a[:, 0].tolist()
