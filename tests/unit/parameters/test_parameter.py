import pickle
import re
from dataclasses import replace

import numpy as np
import pytest
from arc_cases import observed_at

import radioloc
from radioloc.errors import InputError
from radioloc.estimation import Parameter
from radioloc.parameters import ObservationRows, Scope
from radioloc.parameters.biases import RANGE_BIAS
from radioloc.parameters.columns import Columns, columns_of, members
from radioloc.parameters.registry import PARAMETERS


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"prior_sigma": 0.0}, "a-priori sigma of p is 0.0"),
        ({"prior_value": float("inf")}, "a-priori value of p is inf"),
        ({"name": ""}, "needs a name"),
    ],
)
def test_unusable_parameters_are_refused(changes, words):
    with pytest.raises(InputError, match=words):
        Parameter(**({"name": "p", "unit": "m", "kind": "x"} | changes))


def test_workers_look_kinds_up_by_name():
    assert all(pickle.loads(pickle.dumps(kind)) is kind for kind in PARAMETERS.values())


def arc_of(*dates):
    observations = observed_at(dates, "KASHI>lander>KASHI", tag="transmit", value_m=7.6e8)
    lander = radioloc.LunarPosition.from_selenographic(-51.9, 43.0, -2500.0)
    return radioloc.jobs.prepare_arc(radioloc.Study(target=lander), observations)


def test_partials_of_another_shape_are_refused():
    """Refuse partials of the complete table, or without the axis of the components."""
    arc = arc_of("2020-12-01T15:00:00", "2020-12-01T16:00:00")
    for shape in ((2, 2), (3, 2, 1), (2, 2, 2)):
        kind = replace(RANGE_BIAS, partials=lambda rows, shape=shape: np.zeros(shape))
        columns = Columns(kind, Scope.STATION, ("KASHI",), ("KASHI",), (None,), np.array([0, -1], np.int32))
        words = re.escape(f"expected the shape (2, ends, 1) for the observations rows.rows, got {shape}")
        with pytest.raises(InputError, match=words):
            columns.design(ObservationRows(arc))


def test_failing_functions_of_a_kind_are_named():
    def fails(rows):
        return np.zeros(len(rows))[7]

    arc = arc_of("2020-12-01T15:00:00")
    groups = ("KASHI",), ("KASHI",), (None,), np.array([0, -1], np.int32)
    columns = Columns(replace(RANGE_BIAS, partials=fails), Scope.STATION, *groups)
    with pytest.raises(InputError, match=r"range_bias.*IndexError:.*7"):
        columns.design(ObservationRows(arc))
    with pytest.raises(InputError, match=r"range_bias.*acts_on.*IndexError:.*7"):
        members(replace(RANGE_BIAS, acts_on=fails), Scope.STATION, ObservationRows(arc))
    with pytest.raises(InputError, match=r"acts_on.*range_bias:.*\(1, ends\).*\(1,\)"):
        members(
            replace(RANGE_BIAS, acts_on=lambda rows: np.ones(len(rows), bool)),
            Scope.STATION,
            ObservationRows(arc),
        )


def test_each_of_many_sessions_has_columns_of_its_own():
    """Seventy sessions of three components have more columns than a byte counts."""
    dates = [f"2020-{month:02d}-{day:02d}T15:00:00" for month in (10, 11, 12) for day in range(1, 25)][:70]
    rows = ObservationRows(arc_of(*dates))
    kind = replace(PARAMETERS["moon_position"], partials=lambda rows: np.ones((len(rows), 1, 3)))
    columns = columns_of(kind, Scope.SESSION, rows, members(kind, Scope.SESSION, rows))
    np.testing.assert_array_equal(columns.design(rows), np.kron(np.eye(70), np.ones(3)))
