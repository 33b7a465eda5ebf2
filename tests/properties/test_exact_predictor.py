"""Ranges of any station pair, tag, epoch and point: partials, consistency of tags, independence of preparation."""

import numpy as np
import pytest
from arc_cases import observations
from hypothesis import given
from hypothesis import strategies as st

from radioloc.lunar import selenographic_to_cartesian
from radioloc.measurements import ExactPredictor, FixedPoint, PhysicalModel
from radioloc.measurements.registry import TIME_TAGS
from radioloc.time import Epochs

# Noise of both ranges that are compared, the surface's by the last place of the lunar angle psi (3 micrometres) first.
SAME_M = 1e-5
# The analytic partials leave out how the lunar tide and gravity change with the point: 4e-7 for a point in the middle
# of the near side, where the path points along the vertical and the tide's own change across it. Over the whole near
# side, at any hour, also below the horizon where the Earth's own gravity bends most:
PARTIALS_RELATIVE = 2e-6

STATIONS = ("APOLLO", "GRASSE", "MATERA", "SESHAN25", "JIAMUSI", "KASHI", "NEUQUEN")
CASES = st.fixed_dictionaries(
    {
        "sender": st.sampled_from(STATIONS),
        "receiver": st.sampled_from(STATIONS),
        "tag": st.sampled_from(TIME_TAGS),
        "day": st.integers(2441330, 2460600),  # 1972-01 to 2024-10, measured Earth orientation
        "fraction": st.floats(0.0, 1.0, exclude_max=True),
        "longitude": st.floats(-1.3, 1.3),
        "latitude": st.floats(-1.3, 1.3),
        "height": st.floats(-8e3, 1e4),
    }
)


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build(off=["troposphere"])


def arc_and_point(model, case, prepared_off_m=(0.0, 0.0, 0.0), shift_s=0.0, tag=None):
    tai = Epochs.from_jd(case["day"] + 0.5, case["fraction"], "TAI").shifted(shift_s)
    table = observations(f"{case['sender']}>x>{case['receiver']}", tai, tag or case["tag"])
    point_pa_m = selenographic_to_cartesian(case["longitude"], case["latitude"], case["height"])
    return ExactPredictor(model, table, FixedPoint(point_pa_m + prepared_off_m)), point_pa_m


@given(case=CASES)
def test_partials_by_position(model, case):
    arc, point_pa_m = arc_and_point(model, case)
    step_m = 100.0
    numeric = [
        (
            arc.compute(FixedPoint(point_pa_m + away)).value_m[0]
            - arc.compute(FixedPoint(point_pa_m - away)).value_m[0]
        )
        / (2 * step_m)
        for away in step_m * np.eye(3)
    ]
    analytic = arc.compute(FixedPoint(point_pa_m)).by_position_pa[0]
    assert np.linalg.norm(analytic - numeric) < PARTIALS_RELATIVE * np.linalg.norm(numeric)


@given(case=CASES)
def test_partials_by_time(model, case):
    arc, point_pa_m = arc_and_point(model, case)
    step_s = 0.5
    ahead, behind = (
        arc_and_point(model, case, shift_s=s)[0].compute(FixedPoint(point_pa_m)).value_m[0]
        for s in (step_s, -step_s)
    )
    analytic = arc.compute(FixedPoint(point_pa_m)).by_time_m_s[0]
    # Gravity of the Earth below the horizon changes at up to 2e-4 m/s, solid tides at 5e-5 m/s.
    assert abs(analytic - (ahead - behind) / (2 * step_s)) < 4e-4


@given(case=CASES, away=st.tuples(*[st.floats(-3e4, 3e4)] * 3))
def test_preparation_does_not_matter(model, case, away):
    prepared, point_pa_m = arc_and_point(model, case)
    prepared_far, _ = arc_and_point(model, case, prepared_off_m=away)
    prediction, far_prediction = (
        prepared.compute(FixedPoint(point_pa_m)),
        prepared_far.compute(FixedPoint(point_pa_m)),
    )
    assert abs(prediction.value_m - far_prediction.value_m)[0] < SAME_M
    np.testing.assert_allclose(prediction.by_position_pa, far_prediction.by_position_pa, rtol=0, atol=1e-8)
    assert (
        prediction.status.tolist() == far_prediction.status.tolist()
        or abs(prediction.elevation_rad).min() < 1e-3
    )
