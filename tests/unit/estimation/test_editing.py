import numpy as np
import pytest
from toy_moon import LANDER_M, ToyMoon

from radioloc.errors import InputError
from radioloc.estimation import USED, FitStatus, Labels, Parameter, ParameterSet, editing
from radioloc.estimation.editing import fit_with_editing
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.statistics import robust_scale

FAR_OFF_M = np.array([3e4, -3e4, 2.5e4])  # 50 km
# The same observations from another start: the step tolerance, a thousandth of a sigma, and some reserve.
SAME_ANSWER_SIGMAS = 0.01


def observations(model, sigma_m, seed=0, model_error_m=0.0):
    rng = np.random.default_rng(seed)
    truth = np.concatenate([LANDER_M, np.zeros(len(model.biased))])
    # Model errors vary slowly, as tides and atmosphere do, and are not white.
    slow_m = model_error_m * np.sin(model.time_s / 9000.0 + 1.0)
    return model.ranges(truth)[0] + sigma_m * rng.normal(size=len(model.time_s)) + slow_m


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("part", [0.05, 0.15, 0.25])
def test_many_and_huge_blunders_from_50_km_away(seed, part):
    # Blunders of 2 m to 100 km, all of one sign for odd seeds, stated 3 mm, model errors of 2 cm.
    model = ToyMoon(120, 72.0)
    rng = np.random.default_rng(seed)
    observed_m = observations(model, 0.003, seed, 0.02)
    bad = rng.choice(120, int(part * 120), replace=False)
    signs = np.ones(len(bad)) if seed % 2 else rng.choice([-1.0, 1.0], len(bad))
    observed_m[bad] += signs * 10.0 ** rng.uniform(0.3, 5.0, len(bad))
    selected = ~np.isin(np.arange(120), bad)
    parameters = model.parameters(LANDER_M + FAR_OFF_M)
    edited = fit_with_editing(model.residual_function(observed_m), parameters, 0.003)
    assert edited.converged
    np.testing.assert_array_equal(edited.status.are(USED), selected)
    reference = fit_least_squares(model.residual_function(observed_m), parameters, 0.003, used=selected)
    np.testing.assert_allclose(
        edited.fit.x, reference.x, atol=SAME_ANSWER_SIGMAS * reference.sigmas.min(), rtol=0.0
    )


def test_good_points_at_the_limit_come_back():
    # A point at 4.9 sigmas belongs to the data, one at 8 does not, whatever a first fit made of them.
    design = np.ones((100, 1))
    residual = np.random.default_rng(0).normal(size=100)
    residual = (residual - residual.mean()) / residual.std()
    residual *= np.clip(2.0 / np.abs(residual), None, 1.0)
    residual[7], residual[8] = 4.9, 8.0
    parameters = ParameterSet([Parameter("a", "m", "p")])
    edited = fit_with_editing(lambda x: (residual - design @ x, design), parameters, 1.0)
    assert edited.converged
    used = edited.fit.used
    offset = residual - edited.fit.x[0]
    limit = 5.0 * max(1.0, robust_scale(offset, 1))
    np.testing.assert_array_equal(used, np.abs(offset) <= limit)
    assert used[7]
    assert not used[8]


def test_too_many_outliers_are_not_cut_away():
    model = ToyMoon(100, 72.0, biases=False)
    observed_m = observations(model, 0.01)
    observed_m[np.random.default_rng(2).choice(100, 40, replace=False)] += np.linspace(50.0, 500.0, 40)
    edited = fit_with_editing(model.residual_function(observed_m), model.parameters(), 0.01)
    assert not edited.converged
    assert not edited.is_at_minimum
    assert edited.fit.used.all()
    assert "40 of 100 observations exceed 5 sigmas" in edited.message
    assert "check stations, sigmas and model" in edited.message


def heavy_tails():
    """300 residuals of Student's t with two degrees of freedom: 5 of 200 such fits run in a rejection cycle."""
    rng = np.random.default_rng(61)
    design, residual_m = rng.normal(size=(300, 6)), rng.standard_t(2, size=300)
    parameters = ParameterSet([Parameter(f"p.{k}", "m", "p") for k in range(6)])
    return fit_with_editing(lambda x: (residual_m - design @ x, design), parameters, 1.0)


def test_a_rejection_cycle_ends_without_its_observations():
    edited = heavy_tails()
    assert edited.converged
    assert "alternate between used" in edited.message


def test_editing_that_does_not_settle_is_told(monkeypatch):
    monkeypatch.setattr(editing, "_MAX_FIT_COUNT", 2)
    edited = heavy_tails()
    assert edited.message == "the editing did not settle in 2 fits"
    assert edited.fit.converged
    assert not edited.converged


def test_left_out_beforehand_stays_out_with_its_reason():
    model = ToyMoon(60, 72.0, biases=False)
    observed_m = observations(model, 0.01)
    observed_m[10] += 1e7
    observed_m[20] += 5.0
    status = np.full(60, "", dtype=object)
    status[[10, 11]] = "below the horizon"
    edited = fit_with_editing(model.residual_function(observed_m), model.parameters(), 0.01, status=status)
    assert edited.converged
    assert list(edited.status[[10, 11, 12]]) == ["below the horizon", "below the horizon", USED]
    assert edited.status[20].startswith("outlier: ")
    assert edited.fit.used.sum() == 57


def test_without_redundancy_nothing_is_cut():
    # With one observation more than parameters nothing tells which is wrong.
    model = ToyMoon(4, 72.0, biases=False)
    observed_m = observations(model, 0.01)
    observed_m[2] += 1000.0
    edited = fit_with_editing(model.residual_function(observed_m), model.parameters(), 0.01)
    assert edited.fit.used.all()
    assert edited.fit.chi2_per_dof > 1e3


def test_undetermined_problems_are_edited_too():
    model = ToyMoon(100, 72.0, biases=False)
    observed_m = observations(model, 0.01)
    observed_m[30] += 100.0
    model_partials = model.residual_function(observed_m)

    def with_double(x):
        residual_m, partials = model_partials(x[:3])
        return residual_m - x[3] - x[4], np.hstack([partials, np.ones((100, 2))])

    parameters = ParameterSet(
        [
            *model.parameters(),
            Parameter("range_bias.A", "m", "range_bias"),
            Parameter("range_bias.B", "m", "range_bias"),
        ]
    )
    edited = fit_with_editing(with_double, parameters, 0.01)
    assert edited.fit.status is FitStatus.UNOBSERVABLE
    assert edited.is_at_minimum
    assert not edited.converged
    assert np.flatnonzero(~edited.fit.used).tolist() == [30]


def test_a_threshold_that_cuts_good_data_is_refused():
    with pytest.raises(InputError, match="threshold"):
        fit_with_editing(
            lambda x: (-x, np.eye(1)), ParameterSet([Parameter("a", "m", "p")]), 1.0, threshold=1.0
        )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("counts", "hours", "wrong_of"),
    [
        ((100, 40, 40), 48.0, "A"),
        ((54, 63, 63), 48.0, "A"),
        ((143, 142, 15), 2.0, "AB"),
        ((130, 10, 10), 12.0, "A"),
    ],
)
def test_three_of_ten_wrong_by_station(seed, counts, hours, wrong_of):
    """All of one station, which may keep no good ones; or of large ones, beside a small one that is all good."""
    stations = np.random.default_rng(5).permutation(np.repeat(list("ABC"), counts))
    model = ToyMoon(len(stations), hours, biases=counts != (54, 63, 63), stations=tuple(stations))
    rng = np.random.default_rng(seed)
    observed_m = observations(model, 0.02, seed)
    candidates = np.flatnonzero(np.isin(stations, list(wrong_of)))
    wrong = np.zeros(len(stations), dtype=bool)
    count = int(0.3 * len(stations))
    wrong[rng.permutation(candidates)[:count] if seed % 2 else candidates[-count:]] = True
    observed_m[wrong] += rng.uniform(20.0, 60.0, count)
    parameters = model.parameters(LANDER_M + FAR_OFF_M)
    edited = fit_with_editing(model.residual_function(observed_m), parameters, 0.02)
    np.testing.assert_array_equal(edited.status.are(USED), ~wrong)
    assert edited.converged


@pytest.mark.parametrize("with_series", [False, True])
def test_more_outliers_than_a_third_are_rejected_if_they_are_a_whole_series(with_series):
    model = ToyMoon(300, 48.0, stations=("A", "B", "B", "C", "C"))
    of_b = model.station == "B"
    observed_m = observations(model, 1.0)
    observed_m[of_b] += 3e5
    order = order_by_station(model) if with_series else None
    parameters = model.parameters(bias_sigma_m=10.0)
    edited = fit_with_editing(model.residual_function(observed_m), parameters, 1.0, order=order)
    assert edited.converged == with_series
    if with_series:
        np.testing.assert_array_equal(edited.fit.used, ~of_b)
        deviation = (edited.fit.x[:3] - LANDER_M) / edited.fit.sigmas[:3]
        assert np.linalg.norm(deviation) < 4.0


def test_series_of_half_the_observations_is_not_rejected():
    model = ToyMoon(300, 48.0, stations=("A", "B", "B", "C"))
    observed_m = observations(model, 1.0)
    observed_m[model.station == "B"] += 3e5
    edited = fit_with_editing(
        model.residual_function(observed_m),
        model.parameters(bias_sigma_m=10.0),
        1.0,
        order=order_by_station(model),
    )
    assert edited.fit.used.all()


def order_by_station(model):
    n = len(model.station)
    return SeriesOrder.from_labels(
        Labels.from_texts(["range"] * n), Labels.from_texts(model.station), np.arange(n)
    )


def test_successive_outliers_of_a_series_are_a_run():
    model = ToyMoon(210, 72.0)
    observed_m = observations(model, 0.3)
    of_b = np.flatnonzero(model.station == "B")
    observed_m[of_b[30:38]] += 20.0
    observed_m[of_b[45:49]] += [20.0, -20.0, 20.0, -20.0]
    observed_m[[3, 60]] -= 15.0
    edited = fit_with_editing(model.residual_function(observed_m), model.parameters(), 0.3)
    order = SeriesOrder.from_labels(
        Labels.from_texts(["range"] * 210), Labels.from_texts(model.station), model.time_s
    )
    [run] = editing.outlier_runs(edited, order)
    assert run.tolist() == of_b[30:38].tolist()
    reasons = editing.run_reasons(edited, [run])
    assert reasons.keys() == {*run.tolist()}
    assert len({*reasons.values()}) == 1
    assert edited.outliers.sum() == 14
