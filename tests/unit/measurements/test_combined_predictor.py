"""Combined observations are weighted sums of their parts, independent of other rows and of the order."""

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

# Type, path, count interval and, for combinations, the parts: weight, type, path.
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
    """Return an arc of all cases, row by row in turn."""
    order = np.arange(len(CASES) * N).reshape(len(CASES), N).T.ravel()
    table = Observations.concatenate([tracking(*case[:3]) for case in CASES])
    return predictor(table.select(order), model)


@pytest.fixture(scope="module")
def by_hand(model):
    """Return weights and predictors of the parts of each case."""
    return [
        [
            (weight, predictor(tracking(kind, path, case[2]), model))
            for weight, kind, path in (case[3] or ((1.0, *case[:2]),))
        ]
        for case in CASES
    ]


def test_values_and_partials_are_those_of_the_parts(arc, by_hand):
    combined, value_m = arc.compute(), arc.predict().value_m
    for case_index, parts in enumerate(by_hand):
        rows = slice(case_index, None, len(CASES))
        computed = [(weight, part.compute()) for weight, part in parts]
        for name in ("value_m", "by_time_m_s", "by_transponder_delay_m_s"):
            expected = sum(weight * getattr(part, name) for weight, part in computed)
            np.testing.assert_allclose(getattr(combined, name)[rows], expected, rtol=0, atol=SAME_M)
        np.testing.assert_array_equal(value_m[rows], combined.value_m[rows])
        by_target = arc.predict().combine(
            np.arange(len(CASES) * N)[rows], lambda part_rows, part: part.rows(part_rows).by_position_pa
        )
        expected = sum(weight * part.by_position_pa for weight, part in computed)
        np.testing.assert_allclose(by_target, expected, rtol=0, atol=1e-9)


def test_combination_has_the_lowest_elevation_and_the_problems_of_its_parts(arc, by_hand):
    combined = arc.compute()
    for case_index, parts in enumerate(by_hand):
        rows = slice(case_index, None, len(CASES))
        computed = [part.compute() for _, part in parts]
        lowest = np.min([part.elevation_rad for part in computed], axis=0)
        np.testing.assert_allclose(combined.elevation_rad[rows], lowest, rtol=0, atol=1e-9)
        assert (combined.usable[rows] == np.all([part.usable for part in computed], axis=0)).all()
    range_usable = combined.usable[2 :: len(CASES)]
    part_usable = [part.compute().usable for _, part in by_hand[2]]
    assert [int(usable.sum()) for usable in (*part_usable, range_usable)] == [3, 6, 1]  # far apart


def test_target_without_a_position_is_named(model):
    table = tracking(*CASES[1][:3])
    with pytest.raises(InputError, match="expected a, got 'b'"):
        prepare_predictor(model, table, POSITIONS[:1], "exact", targets=("a",))


@pytest.mark.parametrize("selection", [slice(3, 33, 3), np.array([40, 2, 2, 21]), slice(0, 0)])
def test_selected_rows_have_the_values_of_the_full_arc(arc, selection):
    full, part = arc.compute(), arc.select(selection)
    computed = part.compute()
    for name in ("value_m", "by_time_m_s", "elevation_rad", "status"):
        np.testing.assert_array_equal(getattr(computed, name), getattr(full, name)[selection])
    assert (part.observations.kind == arc.observations.kind[selection]).all()
    np.testing.assert_array_equal(
        reasons(part, computed)[1], reasons(arc, arc.predict().rows(selection), selection)[1]
    )


def test_predicted_orientation_of_one_part_marks_the_combination(model):
    with pytest.warns(PredictedEopWarning):
        arc = predictor(
            dataclasses.replace(
                tracking(*CASES[3][:3]).select([0, 1]),
                epoch=epochs_from_strings(["2020-12-01T23:59:20", "2020-12-02T00:00:10"], "UTC"),
            ),
            with_predictions_after_2_december(model),
        )
    assert arc.predicted_eop.tolist() == [False, True]


def test_another_model_applies_to_the_parts_of_a_combination(arc, by_hand, model):
    airless, differences = model.without("troposphere"), arc.select(slice(2, None, len(CASES)))
    value_m = differences.with_model(airless).predict().value_m
    expected_m = sum(weight * part.with_model(airless).predict().value_m for weight, part in by_hand[2])
    np.testing.assert_allclose(value_m, expected_m, rtol=0, atol=SAME_M)
    assert np.abs(value_m - differences.predict().value_m).max() > 1.0
