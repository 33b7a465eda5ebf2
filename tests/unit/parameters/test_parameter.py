import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.estimation import Parameter, ParameterSet
from radioloc.parameters.parameter import Role


def test_order_and_lookup():
    parameters = ParameterSet(
        [
            Parameter("position.x_m", "m", "position", 5.0),
            Parameter("range_bias.A", "m", "range_bias", 1.0, prior_sigma=2.0),
            Parameter("range_bias.B", "m", "range_bias", role=Role.FIXED),
        ]
    )
    assert parameters.names == ("position.x_m", "range_bias.A", "range_bias.B")
    assert parameters.index("range_bias.B") == 2
    assert parameters["range_bias.A"].prior_sigma == 2.0
    assert "range_bias.A" in parameters
    assert parameters.of_kind("range_bias") == (1, 2)
    assert parameters.of_kind("time_bias") == ()
    np.testing.assert_array_equal(parameters.free, [True, True, False])
    np.testing.assert_array_equal(parameters.prior_values, [5.0, 1.0, 0.0])
    np.testing.assert_array_equal(parameters.prior_sigmas, [np.inf, 2.0, np.inf])


def test_changed_copies():
    before = ParameterSet([Parameter("a", "m", "x"), Parameter("b", "m", "x")])
    after = before.changed("b", role=Role.FIXED, prior_value=3.0)
    assert (before["b"].fixed, after["b"].fixed, after["b"].prior_value) == (False, True, 3.0)
    assert after.names == before.names


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"prior_sigma": 0.0}, "a-priori sigma of p is 0.0"),
        ({"prior_sigma": float("nan")}, "a-priori sigma of p is nan"),
        ({"prior_value": float("inf")}, "a-priori value of p is inf"),
        ({"scale": -1.0}, "scale of p is -1.0"),
        ({"name": ""}, "needs a name"),
    ],
)
def test_unusable_parameters_are_refused(changes, words):
    with pytest.raises(InputError, match=words):
        Parameter(**({"name": "p", "unit": "m", "kind": "x"} | changes))


def test_sets_refuse_doubles_and_emptiness():
    with pytest.raises(InputError, match="more than once: a"):
        ParameterSet([Parameter("a", "m", "x"), Parameter("a", "m", "x")])
    with pytest.raises(InputError, match="at least one"):
        ParameterSet([])
    with pytest.raises(InputError, match="no parameter 'c'; there are a"):
        ParameterSet([Parameter("a", "m", "x")])["c"]
