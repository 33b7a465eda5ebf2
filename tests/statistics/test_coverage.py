"""Coverage of the stated uncertainty: seeded Monte Carlo against exact bounds of chance.

Bounds are those that a right estimator exceeds with a probability of 1e-5 (binomial, chi-square); with
fixed seeds a failure is a change of the code, not of luck.
"""

import numpy as np
import pytest
from quick import some
from toy_moon import LANDER_M, ToyMoon, toy_solution

RUNS = 400
# Binomial of 400 at 0.95: 1e-5 and 1 - 1e-5 quantiles are 359 and 396.
COVERED = (359, 396)
# Chi-square of 400 * 3 degrees of freedom over 400: 1e-5 and 1 - 1e-5 quantiles are 2.506 and 3.551.
NEES_3 = (2.50, 3.55)

pytestmark = pytest.mark.usefixtures("unsearched")
REFERENCE, UNKNOWN = "no biases", "biases with a-priori values"


@pytest.fixture(scope="module", params=some([REFERENCE, UNKNOWN], [UNKNOWN]))
def solutions(request):
    biases = request.param == UNKNOWN
    model = ToyMoon(60, 48.0, biases=biases)
    rng = np.random.default_rng(20)
    result = []
    for seed in range(RUNS):
        parameters = model.parameters(LANDER_M + rng.normal(size=3) * 2e4)
        for name in model.biased:
            # The true bias is zero; its a-priori value scatters about it as the a-priori sigma says.
            parameters = parameters.changed(
                f"range_bias.{name}", prior_value=2.0 * rng.normal(), prior_sigma=2.0
            )
        result.append(toy_solution(model, parameters=parameters, seed=seed, reference_pa_m=LANDER_M))
    return result


def test_sigmas_of_each_component_hold_68_percent(solutions):
    sigmas = np.array(
        [[s.reference.east_sigmas, s.reference.north_sigmas, s.reference.up_sigmas] for s in solutions]
    )
    # The standard deviation of 400 unit normals lies in 1 +- 0.16 but for 1e-5.
    np.testing.assert_allclose(sigmas.std(axis=0), 1.0, atol=0.16)
    # Their mean lies in +- 4.4/20.
    np.testing.assert_allclose(sigmas.mean(axis=0), 0.0, atol=0.22)


def test_normalized_estimation_error_squared(solutions):
    nees = np.mean([solution.reference.combined_sigmas**2 for solution in solutions])
    assert NEES_3[0] < nees < NEES_3[1]


def test_reduced_chi_square_is_one(solutions):
    chi2, dof = (sum(getattr(s.fit, name) for s in solutions) for name in ("chi2", "dof"))
    # Chi-square of 22800 degrees of freedom or more: five standard deviations.
    assert chi2 / dof == pytest.approx(1.0, abs=5.0 * (2.0 / dof) ** 0.5)


def test_good_data_are_hardly_ever_cut(solutions):
    # Beyond five sigmas lies one normal residual in 1.7 million; 24000 were fitted.
    assert sum(solution.fit.total.rejected for solution in solutions) == 0


@pytest.mark.slow
def test_blunders_do_not_spoil_coverage():
    model = ToyMoon(60, 48.0, biases=False)
    held = missing = 0
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        blunders_m = {
            int(k): float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(1.0, 5.0))
            for k in rng.choice(60, 6, replace=False)
        }
        solution = toy_solution(model, seed=seed, blunders_m=blunders_m, reference_pa_m=LANDER_M)
        offset_m = np.array([solution.reference.east_m, solution.reference.north_m])
        covariance = solution.position_covariance("enu", "total")[:2, :2]
        held += offset_m @ np.linalg.solve(covariance, offset_m) < 5.991464547107979
        missing += set(np.flatnonzero(~solution.residuals.used)) != set(blunders_m)
    assert missing == 0
    assert COVERED[0] <= held <= COVERED[1]
