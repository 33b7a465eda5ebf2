"""Combinations are sums of what they combine, whatever stands beside them in a table and in whatever order."""

import dataclasses

import numpy as np
import pytest
from arc_cases import APOLLO15, REFLECTORS_PA_M, epochs_tai, observations, with_predictions_after_2_december

from radioloc.errors import InputError, PredictedEopWarning
from radioloc.measurements import FixedPoint, Observations, prepare_predictor
from radioloc.measurements.predictor import reasons
from radioloc.time import epochs_from_strings

SAME_M = 1e-6
"""Rounding of the legs that are differenced."""

# Type, path, count interval; of a combination also the parts: weight, type, path.
CASES = (
    ("range", "KASHI>a>JIAMUSI", None, None),
    (
        "differenced_delay", "SESHAN25<a|b>URUMQI", None,
        ((1.0, "vlbi_delay", "SESHAN25<a>URUMQI"), (-1.0, "vlbi_delay", "SESHAN25<b>URUMQI")),
    ),
    (
        "differenced_range", "KASHI<a>NEUQUEN", None,
        ((1.0, "one_way_range", "a>NEUQUEN"), (-1.0, "one_way_range", "a>KASHI")),
    ),
    (
        "differenced_doppler", "JIAMUSI<b>KASHI", 60.0,
        ((1.0, "one_way_doppler", "b>KASHI"), (-1.0, "one_way_doppler", "b>JIAMUSI")),
    ),
    ("doppler", "KASHI>b>KASHI", 60.0, None),
)  # fmt: skip
TARGETS = ("a", "b")
POSITIONS = [APOLLO15, FixedPoint(REFLECTORS_PA_M["luna17"])]
TAI = epochs_tai(9, 24.0)
N = len(TAI)


def tracking(kind, path, count_s):
    uplink_hz = 7.2e9 if path.count(">") == 2 else np.nan
    count_s = np.nan if count_s is None else count_s
    return observations(
        path, TAI, "receive", kind, wavelength_um=35394.6, uplink_hz=uplink_hz, count_s=count_s
    )


def predictor(table, model):
    return prepare_predictor(model, table, POSITIONS, "exact", targets=TARGETS)


@pytest.fixture(scope="module")
def arc(model):
    """All cases in one table, by turns."""
    order = np.arange(len(CASES) * N).reshape(len(CASES), N).T.ravel()
    table = Observations.concatenate([tracking(*case[:3]) for case in CASES])
    return predictor(table.select(order), model)


@pytest.fixture(scope="module")
def by_hand(model):
    """Weights and predictions of the parts of each case."""
    return [
        [
            (weight, predictor(tracking(kind, path, case[2]), model))
            for weight, kind, path in (case[3] or ((1.0, *case[:2]),))
        ]
        for case in CASES
    ]


def test_values_and_partials_are_those_of_the_parts(arc, by_hand):
    found, value_m = arc.compute(), arc.at().value_m
    for k, parts in enumerate(by_hand):
        mine = slice(k, None, len(CASES))
        computed = [(weight, part.compute()) for weight, part in parts]
        for name in ("value_m", "by_time_m_s", "by_transponder_delay_m_s"):
            expected = sum(weight * getattr(one, name) for weight, one in computed)
            np.testing.assert_allclose(getattr(found, name)[mine], expected, rtol=0, atol=SAME_M)
        np.testing.assert_array_equal(value_m[mine], found.value_m[mine])
        by_target = arc.at().combine(
            np.arange(len(CASES) * N)[mine], lambda rows, inner, _: inner.rows(rows).by_position_pa
        )
        expected = sum(weight * one.by_position_pa for weight, one in computed)
        np.testing.assert_allclose(by_target, expected, rtol=0, atol=1e-9)


def test_each_target_is_at_its_own_position(model):
    table = tracking("range", "KASHI>b>JIAMUSI", None)
    of_a, of_b = (prepare_predictor(model, table, position, "exact").at().value_m for position in POSITIONS)
    together = predictor(table, model).at().value_m
    np.testing.assert_allclose(together, of_b, rtol=0, atol=SAME_M)
    assert np.abs(of_a - of_b).min() > 1000.0


def test_a_combination_is_as_low_and_as_unusable_as_its_parts(arc, by_hand):
    found = arc.compute()
    for k, parts in enumerate(by_hand):
        mine = slice(k, None, len(CASES))
        computed = [part.compute() for _, part in parts]
        lowest = np.min([one.elevation_rad for one in computed], axis=0)
        np.testing.assert_allclose(found.elevation_rad[mine], lowest, rtol=0, atol=1e-9)
        assert (found.usable[mine] == np.all([one.usable for one in computed], axis=0)).all()
    of_ranges = found.usable[2 :: len(CASES)]
    one_way = [part.compute().usable for _, part in by_hand[2]]
    assert [int(each.sum()) for each in (*one_way, of_ranges)] == [3, 6, 1]  # far apart


def test_a_target_without_a_position_is_named(model):
    table = tracking(*CASES[1][:3])
    with pytest.raises(InputError, match="expected a, got 'b'"):
        prepare_predictor(model, table, POSITIONS[:1], "exact", targets=("a",))


@pytest.mark.parametrize("which", [slice(3, 33, 3), np.array([40, 2, 2, 21]), slice(0, 0)])
def test_parts_of_an_arc(arc, which):
    whole, part = arc.compute(), arc.select(which)
    found = part.compute()
    for name in ("value_m", "by_time_m_s", "elevation_rad", "status"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name)[which])
    assert (part.observations.kind == arc.observations.kind[which]).all()
    np.testing.assert_array_equal(reasons(part, found)[1], reasons(arc, arc.at().rows(which), which)[1])


def test_predicted_orientation_of_a_part_marks_a_combination(model):
    with pytest.warns(PredictedEopWarning):
        arc = predictor(
            dataclasses.replace(
                tracking(*CASES[3][:3]).select([0, 1]),
                epoch=epochs_from_strings(["2020-12-01T23:59:20", "2020-12-02T00:00:10"], "UTC"),
            ),
            with_predictions_after_2_december(model),
        )
    assert arc.predicted_eop.tolist() == [False, True]


def test_another_model_changes_a_combination_as_it_does_its_parts(arc, by_hand, model):
    airless, differences = model.without("troposphere"), arc.select(slice(2, None, len(CASES)))
    found_m = differences.with_model(airless).at().value_m
    expected_m = sum(weight * part.with_model(airless).at().value_m for weight, part in by_hand[2])
    np.testing.assert_allclose(found_m, expected_m, rtol=0, atol=SAME_M)
    assert np.abs(found_m - differences.at().value_m).max() > 1.0
