"""Arcs of 12, 24 and 48 hours over many realizations of the noise: where they lie, and whether their sigmas are right.

The problem is linear over the size of the errors: the partials of one prepared arc, of which shorter ones are parts,
serve all realizations; that whole fits give the same is tested beside.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from change5_case import LANDER, NOISE, world

import radioloc
from radioloc import EstimateChoice, HeightPrior, ObservationChoice, Study
from radioloc.lunar import rot_pa_to_me
from radioloc.simulation import World
from radioloc.studies.problem import Problem

pytestmark = pytest.mark.slow

RUNS = 200
HOURS = (12.0, 24.0, 48.0)
BIAS_SIGMA_M, HEIGHT_SIGMA_M = 10.0, 5.0
ESTIMATE = EstimateChoice(
    range_bias="all", range_bias_sigma_m=BIAS_SIGMA_M, height_prior=HeightPrior(-2550.4, HEIGHT_SIGMA_M)
)
NEES_3 = (532.019 / RUNS, 667.981 / RUNS)
"""Chi-square of 200 * 3 degrees of freedom over 200: quantiles of 2.5 and 97.5 %."""
HELD_95 = (184, 196)
"""Binomial of 200 at 0.95: quantiles of 2.5 and 97.5 %."""
EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "change5" / "simulation.toml"


@dataclass
class Estimator:
    """Linear estimate of an arc about the truth: errors of observations and a-priori values to errors of parameters."""

    rows: np.ndarray
    gain: np.ndarray
    prior_gain: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of(cls, partials, sigma_m, prior_sigmas, rows):
        weighted = partials[rows] / sigma_m[rows, None] ** 2
        prior = prior_sigmas**-2.0
        covariance = np.linalg.inv(weighted.T @ partials[rows] + np.diag(prior))
        return cls(rows, covariance @ weighted.T, covariance * prior, covariance)

    def error(self, observation_m, prior):
        return self.gain @ observation_m[self.rows] + self.prior_gain @ prior


@dataclass
class Linear:
    """A simulated world beside the model it is fitted with."""

    world: World
    problem: Problem
    truth: np.ndarray
    to_enu: np.ndarray
    arcs: list[Estimator]

    @classmethod
    def of(cls, simulated, nominal):
        plan = simulated.plan.observations
        arc = radioloc.TrackingArc(nominal, plan, simulated.target_pa_m)
        target = radioloc.LunarPosition.from_cartesian(simulated.target_pa_m)
        problem = Problem.of(arc, target, ESTIMATE, nominal.catalogue)
        truth = np.zeros(len(problem.parameters))
        truth[2] = -2550.4
        _, partials = problem.residuals(truth)
        hours = 24.0 * (plan.epoch.jd - plan.epoch.jd[0] + plan.epoch.fraction - plan.epoch.fraction[0])
        arcs = [
            Estimator.of(
                partials,
                plan.sigma_m,
                problem.parameters.prior_sigmas,
                np.flatnonzero(hours <= length + 1e-6),
            )
            for length in HOURS
        ]
        return cls(simulated, problem, truth, enu_of(target, nominal) @ problem.position(truth[:3])[1], arcs)


def enu_of(target, nominal):
    """Rotation from principal axes to east, north, up of mean-Earth axes."""
    longitude_deg, latitude_deg, _ = target.to_axes("ME", nominal.ephemeris.constants).selenographic
    longitude, latitude = np.radians(longitude_deg), np.radians(latitude_deg)
    return radioloc.lunar.east_north_up(longitude, latitude) @ rot_pa_to_me(nominal.ephemeris.constants)


def position_errors(linear, residuals_m, priors):
    """East, north, up of each arc in each run, m, shape (runs, arcs, 3)."""
    return np.array(
        [
            [linear.to_enu @ arc.error(residual_m, prior)[:3] for arc in linear.arcs]
            for residual_m, prior in zip(residuals_m, priors, strict=True)
        ]
    )


@pytest.fixture(scope="module")
def nominal():
    return radioloc.PhysicalModel.build(off=["ionosphere"])


@pytest.fixture(scope="module")
def matched(nominal):
    """White noise as stated, biases and height as their a-priori values say; 3000 observations."""
    return Linear.of(world(nominal, 240.0, bias_m={}), nominal)


@pytest.fixture(scope="module")
def matched_errors(matched):
    rng = np.random.default_rng(20201201)
    plan = matched.world.plan.observations
    priors = np.zeros((RUNS, len(matched.truth)))
    # The a-priori value is zero, and the truth scatters about it, or the other way round.
    priors[:, 2] = HEIGHT_SIGMA_M * rng.standard_normal(RUNS)
    priors[:, 3:] = BIAS_SIGMA_M * rng.standard_normal((RUNS, len(matched.truth) - 3))
    residuals_m = plan.sigma_m * rng.standard_normal((RUNS, len(plan)))
    return position_errors(matched, residuals_m, priors)


@pytest.mark.parametrize("k", range(len(HOURS)))
def test_errors_are_as_large_as_stated(k, matched, matched_errors):
    covariance = matched.to_enu @ matched.arcs[k].covariance[:3, :3] @ matched.to_enu.T
    errors = matched_errors[:, k]
    nees = np.einsum("ri,ij,rj->r", errors, np.linalg.inv(covariance), errors)
    assert NEES_3[0] < nees.mean() < NEES_3[1]
    horizontal = np.einsum("ri,ij,rj->r", errors[:, :2], np.linalg.inv(covariance[:2, :2]), errors[:, :2])
    assert HELD_95[0] <= (horizontal < 5.991464547107979).sum() <= HELD_95[1]


def test_differences_between_arcs_are_as_large_as_they_should_be(matched, matched_errors):
    """The variance of the difference is that of the part less that of the whole."""
    long = matched.arcs[-1].covariance[:3, :3]
    for k, arc in enumerate(matched.arcs[:-1]):
        covariance = matched.to_enu[:2] @ (arc.covariance[:3, :3] - long) @ matched.to_enu[:2].T
        apart = (matched_errors[:, k] - matched_errors[:, -1])[:, :2]
        squares = np.einsum("ri,ij,rj->r", apart, np.linalg.inv(covariance), apart)
        # Chi-square of 400 degrees of freedom over 200: quantiles of 1e-5 and 1 - 1e-5.
        assert 1.43 < squares.mean() < 2.65


def test_whole_fits_are_the_linear_ones(matched, nominal):
    plan = matched.world.plan.observations
    priors = np.zeros(len(matched.truth))
    study = Study(
        target=LANDER,
        estimate=ESTIMATE,
        reference=radioloc.Reference(LANDER, "truth"),
        observations=ObservationChoice(),
        model=radioloc.ModelChoice(terms=nominal.terms),
    )
    for seed in range(3):
        drawn = matched.world.draw(NOISE, seed=seed)
        found = radioloc.arcs(study, HOURS, drawn.observations)
        residual_m = drawn.observations.value_m - matched.world.error_free_m
        assert not drawn.is_outlier.any()
        for arc, row in zip(reversed(matched.arcs), found.arcs, strict=True):
            enu_m = matched.to_enu @ arc.error(residual_m, priors)[:3]
            reference, sigma_m = row.solution.reference, row.solution.sigma_enu_m("formal")
            fitted_m = np.array([reference.east_m, reference.north_m, reference.up_m])
            assert len(row.solution.residuals) == len(arc.rows)
            np.testing.assert_allclose(fitted_m, enu_m, rtol=0.0, atol=0.02 * sigma_m.min())
            own = matched.to_enu @ arc.covariance[:3, :3] @ matched.to_enu.T
            np.testing.assert_allclose(np.sqrt(np.diag(own)), sigma_m, rtol=1e-3)
    assert len(plan) > 2500


@pytest.fixture(scope="module")
def lasting_errors(nominal):
    """The example's world: its departures from the model, and noise that lasts for hours."""
    example = radioloc.read_study(EXAMPLE).simulation
    prepared = example.world(nominal)
    linear = Linear.of(prepared, nominal)
    computed_m = linear.problem.arc.compute(prepared.target_pa_m).value_m
    constant_m = prepared.error_free_m + sum(prepared.added_m.values()) - computed_m
    residuals_m = []
    for seed in range(RUNS):
        noise_m, wild = example.noise.draw(prepared.plan, seed)
        # What editing leaves out is left out of the residuals; the rest is what remains to be fitted.
        residuals_m.append(np.where(wild, 0.0, constant_m + noise_m))
    return position_errors(linear, residuals_m, np.zeros((RUNS, len(linear.truth))))


def test_arcs_of_realistic_data_agree_as_those_of_the_paper(lasting_errors):
    """Wang et al. (2021), section 3: all arcs within 100 m of each other; 48 h within 30 m of the truth."""
    horizontal_m = np.hypot(lasting_errors[..., 0], lasting_errors[..., 1])
    apart_m = np.hypot(*np.moveaxis(lasting_errors[:, :-1] - lasting_errors[:, -1:], -1, 0)[:2])
    assert np.mean((apart_m < 100.0).all(axis=1)) >= 0.95
    assert np.mean((horizontal_m < 100.0).all(axis=1)) >= 0.95
    assert np.mean(horizontal_m[:, -1] < 30.0) >= 0.95
