"""Noise of the phase that counts are of: claimed sigmas against drawn errors."""

import numpy as np
import pytest
from change5_case import LANDER, NEAR
from dense_noise import information

import radioloc
from radioloc import Study
from radioloc.errors import InputError
from radioloc.estimation import Labels, Parameter, ParameterSet
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.time_correlation import fit_with_correlated_weights
from radioloc.estimation.variance_components import fit_with_variance_components
from radioloc.jobs.preparation import prepared_arc
from radioloc.jobs.station_noise import stated_noise
from radioloc.measurements import FixedPoint, PhysicalModel
from radioloc.noise import ALONE, DopplerPhase, ObservationCovariance, White
from radioloc.simulation import Noise, NoiseModel, Scenario, Schedule, Session, Truth, two_way
from radioloc.study import EstimateChoice, ObservationChoice

PHASE_M = 1.0


def drawn(rng, n, white_m):
    phase = PHASE_M * rng.standard_normal(n + 1)
    return np.diff(phase) + white_m * rng.standard_normal(n)


def chain(n):
    """Contiguous counts with hardly any noise of their own, and their series."""
    start = np.arange(n)
    phases = DopplerPhase(np.full(n, PHASE_M), np.zeros(n, dtype=int), start, start + 1)
    noise = ObservationCovariance((White(np.full(n, 1e-4)), phases))
    item = SeriesOrder.from_labels(
        Labels.from_texts(["doppler"] * n), Labels.from_texts(["A>x>A"] * n), np.arange(float(n))
    )
    return noise, item


def test_a_rate_is_known_as_the_slope_of_the_phases():
    """The sigma of a rate from n counts falls by n^(3/2), as of linear regression of n + 1 phases."""
    noise, _ = chain(400)
    parameters = ParameterSet([Parameter("offset", "m", "bias")])
    design, rng = np.ones((400, 1)), np.random.default_rng(2)
    result = []
    for _ in range(200):
        observed_m = drawn(rng, 400, 0.0)
        fit = fit_least_squares(lambda x, o=observed_m: (o - design @ x, design), parameters, noise)
        result.append(fit.x[0])
    assert fit.sigmas[0] == pytest.approx(PHASE_M * np.sqrt(12.0 / (400 * 401 * 402)), rel=1e-3)
    # Of 200 the rms is within 13 % but for a chance of 1 %
    assert np.std(result) == pytest.approx(fit.sigmas[0], rel=0.13)


@pytest.mark.parametrize("white_m", [0.0, 0.5])
def test_frequency_noise_beyond_the_phase_is_found(white_m):
    """The variance component is that of the white part; without one nothing is added."""
    n = 2000
    noise, series = chain(n)
    design = np.column_stack([np.ones(n), np.linspace(-1.0, 1.0, n)])
    parameters = ParameterSet([Parameter("offset", "m", "bias"), Parameter("drift", "m", "bias")])
    observed_m = drawn(np.random.default_rng(3), n, white_m)

    def residuals(x):
        return observed_m - design @ x, design

    result = fit_with_variance_components(residuals, parameters, noise, order=series)
    assert result.fit.used.all()
    assert result.additive_sigma_m["doppler"] == pytest.approx(white_m, rel=0.1)
    assert not fit_with_correlated_weights(residuals, result, series).series_weights


def session(step_s, count_s):
    return Session(
        "doppler",
        two_way("KUNMING"),
        "2020-12-01T15:00:00",
        "2020-12-01T17:00:00",
        step_s,
        0.0005,
        count_s=count_s,
    )


@pytest.mark.parametrize(("count_s", "lag"), [(60.0, 1), (120.0, 2), (50.0, 0)])
def test_drawn_counts_share_the_phase_between_them(count_s, lag):
    plan = Schedule([session(60.0, count_s)]).plan(PhysicalModel.build(), FixedPoint(LANDER_PA_M))
    model = NoiseModel({"doppler": Noise(phase_m=PHASE_M)})
    errors_m = np.array([model.draw(plan, seed)[0] for seed in range(150)])
    n = len(plan.observations)
    dense = np.zeros((n, n))
    for k in range(n):
        dense[k, k] = 2.0
        if lag and k >= lag:
            dense[k, k - lag] = dense[k - lag, k] = -1.0
    by_lag = [np.mean(errors_m[:, k:] * errors_m[:, : n - k]) for k in range(4)]
    np.testing.assert_allclose(by_lag, [dense[k, 0] for k in range(4)], atol=0.08)
    columns = np.random.default_rng(1).standard_normal((n, 3))
    covariance = model.covariance(plan).plus(White(np.full(n, 1e-2)))
    dense[np.diag_indices(n)] += 1e-4
    expected = columns.T @ np.linalg.solve(dense, columns)
    assert information(covariance.whitener(), columns) == pytest.approx(expected, rel=1e-6)


LANDER_PA_M = LANDER.to_axes("PA", PhysicalModel.build().ephemeris.constants).xyz_m


def planned(phase_sigma_m, step_s=60.0):
    sessions = [session(step_s, 60.0), Session("range", two_way("KUNMING"), START, STOP, 600.0, 1.0)]
    noise = NoiseModel({"doppler": Noise(phase_m=0.003, white_m=0.0005), "range": Noise(white_m=1.0)})
    return Study(
        target=NEAR,
        estimate=EstimateChoice(),
        observations=ObservationChoice(doppler_phase_sigma_m=phase_sigma_m),
        consider_defaults=False,
        simulation=Scenario(Schedule(sessions), LANDER, Truth(), noise, seed=5),
        name="plan",
    )


START, STOP = "2020-12-01T15:00:00", "2020-12-01T21:00:00"


def test_contiguous_counts_of_a_link_are_joined():
    world = planned(0.003).simulation.world(PhysicalModel.build())
    study = planned({"KUNMING": 0.003})
    arc, _ = prepared_arc(study, world.plan.observations)
    [phase] = stated_noise(arc, study.observations).of_type(DopplerPhase)
    doppler = np.flatnonzero(arc.observations.types() == "doppler")
    np.testing.assert_array_equal(phase.start[doppler[1:]], phase.end[doppler[:-1]])
    assert (phase.link[arc.observations.types() == "range"] == ALONE).all()
    with pytest.raises(InputError, match=r"doppler_phase_sigma_m:.*URUMQI"):
        prepared_arc(planned({"URUMQI": 0.003}), world.plan.observations)


@pytest.mark.slow
def test_claimed_sigmas_are_those_of_drawn_errors():
    result = radioloc.monte_carlo(planned(0.003), 200, (6.0,))
    assert result.converged
    # Binomial of 200 at 0.95: 182 to 197 but for a chance of 1 %
    assert 182 <= result.arcs[0].coverage["horizontal"].count <= 197
    claimed_m = radioloc.covariance(planned(0.003), (6.0,)).arcs[0].sigma_m
    # Of 200 trials an rms is within 13 % but for a chance of 1 %
    assert result.arcs[0].rms_m == pytest.approx(claimed_m, rel=0.13)
