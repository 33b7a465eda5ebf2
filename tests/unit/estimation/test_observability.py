import numpy as np
import pytest
from toy_moon import LANDER_M, ToyMoon

from radioloc.estimation import Parameter, ParameterSet
from radioloc.estimation.least_squares import fit_least_squares
from radioloc.estimation.observability import assess_observability
from radioloc.parameters.parameter import Role


def assess(design, names=None, sigma_m=1.0, **changes):
    p = design.shape[1]
    names = names or [f"range_bias.{letter}" for letter in "ABCDEFG"[:p]]
    parameters = ParameterSet([Parameter(name, "m", "range_bias", **changes) for name in names])
    fit = fit_least_squares(lambda x: (-design @ x, design), parameters, sigma_m)
    return assess_observability(fit)


def test_two_separate_defects_are_not_mixed():
    # Any mixture of the two directions is undetermined too; the report keeps them apart.
    design = np.random.default_rng(1).normal(size=(20, 5))
    design[:, 1] = 2.0 * design[:, 0]
    design[:, 4] = 0.0
    result = assess(design)
    assert {direction.names for direction in result.undetermined} == {
        ("range_bias.E",),
        ("range_bias.A", "range_bias.B"),
    }
    assert "the data do not determine range_bias.E" in result.describe()
    assert "the data do not determine 0.89 range_bias.A - 0.45 range_bias.B" in result.describe()


def test_three_free_biases_over_half_a_day_are_weak():
    model = ToyMoon(200, 12.0)
    observed_m, _ = model.ranges(np.concatenate([LANDER_M, np.zeros(3)]))
    fit = fit_least_squares(model.residual_function(observed_m), model.parameters(), 0.3)
    result = assess_observability(fit)
    assert fit.converged
    assert result.undetermined == ()
    assert {"range_bias.A", "range_bias.B", "range_bias.C"} == set(result.weak[0].names[:3])
    assert 300.0 < result.weak[0].sigma < 600.0
    # Counts are no measure of it.
    assert assess_observability(fit, np.ones(len(observed_m), dtype=bool)).weak == ()
    assert result.advice().startswith("would help: an a-priori sigma for range_bias.A, range_bias.B")


def three_biases(hours, prior_sigma_m):
    model = ToyMoon(200, hours)
    observed_m, _ = model.ranges(np.concatenate([LANDER_M, np.zeros(3)]))
    parameters = model.parameters()
    for name in "ABC":
        parameters = parameters.changed(f"range_bias.{name}", prior_sigma=prior_sigma_m)
    return fit_least_squares(model.residual_function(observed_m), parameters, 0.3)


@pytest.mark.parametrize("prior_sigma_m", [np.inf, 10.0])
def test_what_biases_have_in_common_and_what_it_does_to_the_position(prior_sigma_m):
    fit = three_biases(12.0, prior_sigma_m)
    (part,) = assess_observability(fit).common
    assert (part.kind, part.count, part.unit) == ("range_bias", 3, "m")
    rows, mean = np.eye(6)[3:], np.full(3, 1.0 / 3.0)
    assert part.sigma == pytest.approx(np.sqrt(mean @ rows @ fit.covariance @ rows.T @ mean))
    assert part.prior_sigma == pytest.approx(prior_sigma_m / 3.0**0.5)
    component = fit.covariance[:3, 3:] @ mean / part.sigma / np.sqrt(np.diag(fit.covariance)[:3])
    assert part.correlated_with == fit.parameters.names[int(np.argmax(np.abs(component)))]
    assert part.correlation == pytest.approx(component[np.argmax(np.abs(component))])
    # Held at one sigma more, the biases drag the position along just so far.
    model = ToyMoon(200, 12.0)
    observed_m, _ = model.ranges(np.concatenate([LANDER_M, np.zeros(3)]))
    held = fit.parameters
    for k, name in enumerate("ABC"):
        held = held.changed(
            f"range_bias.{name}", prior_value=fit.x[3 + k] + part.sigma, prior_sigma=np.inf, role=Role.FIXED
        )
    moved = fit_least_squares(model.residual_function(observed_m), held, 0.3)
    assert part.position_m == pytest.approx(np.linalg.norm(moved.x[:3] - fit.x[:3]), rel=0.02)


@pytest.mark.parametrize("count", [1, 2])
def test_a_common_part_is_that_of_two_or_more(count):
    """The data tell the biases to 1 m, as was known before; the position moves with them."""
    design = np.column_stack([np.ones(count), np.eye(count)])
    parameters = ParameterSet(
        [
            Parameter("position.x", "m", "position"),
            *(Parameter(f"range_bias.{k}", "m", "range_bias", 0.0, 1.0) for k in range(count)),
        ]
    )
    fit = fit_least_squares(lambda x: (-design @ x, design), parameters, 0.01)
    assert [part.count for part in assess_observability(fit).common] == [2] * (count == 2)


def test_a_good_geometry_has_nothing_to_report():
    result = assess(np.random.default_rng(1).normal(size=(50, 4)))
    assert result.describe() == ()
    assert result.advice() == ""
    assert result.condition_number == pytest.approx(result.singular_values[0] / result.singular_values[-1])


def test_scales_make_units_comparable():
    # A longitude in rad and a height in metres that are not told apart: equal weights, one metre of each.
    radius_m = 1737400.0
    column = np.linspace(1.0, 2.0, 9)
    design = np.stack([column * radius_m, column], axis=1)
    parameters = ParameterSet(
        [
            Parameter("position.longitude_rad", "rad", "position", scale=1.0 / radius_m),
            Parameter("position.height_m", "m", "position"),
        ]
    )
    fit = fit_least_squares(lambda x: (-design @ x, design), parameters, 1.0)
    (direction,) = assess_observability(fit).undetermined
    np.testing.assert_allclose(np.abs(list(direction.weights.values())), 0.5**0.5, rtol=1e-9)
    assert direction.unit == "scales"
    assert "a longer arc, more stations" in assess_observability(fit).advice()
