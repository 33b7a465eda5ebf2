"""Coverage of the ellipses of a chain of images."""

import numpy as np
import pytest
from image_chains import CENTRE, Chain, drawn_ties
from scipy.stats import chi2 as chi_squared

DRAWS = 100
THREE_SIGMA = 3.0 * np.sqrt(0.95 * 0.05 / DRAWS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "map_below", [10, 4], ids=["map seen by most images", "map seen by the highest four"]
)
def test_ellipses_of_the_last_image_hold_95_percent(map_below):
    """Pixels, features of the map and outliers are drawn; sigmas are stated a half too small and found."""
    chain = Chain(images=10, map_below=map_below)
    distances = []
    for draw in range(DRAWS):
        ties = drawn_ties(chain, np.random.default_rng(draw), sigma_px=0.6, map_sigma_m=3.0, stated=2.0 / 3.0)
        place, covariance = chain.adjusted(ties).place(9, CENTRE)
        error = place - chain.ground(9, CENTRE)
        distances.append(error @ np.linalg.solve(covariance, error))
    assert np.mean(np.array(distances) < chi_squared.ppf(0.95, 2)) == pytest.approx(0.95, abs=THREE_SIGMA)
    assert np.mean(distances) == pytest.approx(2.0, abs=3.0 * 2.0 / np.sqrt(DRAWS))
