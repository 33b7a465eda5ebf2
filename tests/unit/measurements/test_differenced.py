"""VLBI delay, its rate and Doppler: what they are made of."""

import numpy as np
import pytest
from arc_cases import APOLLO15, epochs_tai, observations, with_predictions_after_2_december

from radioloc.constants import C_M_S
from radioloc.errors import PredictedEopWarning
from radioloc.measurements import MEASUREMENTS, ExactPredictor, Observations, PhysicalModel
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.time import epochs_from_strings, utc_to_tai

# The noise of two ranges that are differenced.
SAME_M = 1e-6

BASELINES = [("SESHAN25", "URUMQI"), ("URUMQI", "SESHAN25"), ("MIYUN50", "KUNMING")]
LINKS = [("KASHI", "KASHI"), ("KASHI", "JIAMUSI"), ("NEUQUEN", "KASHI")]
COUNT_S = 60.0
# Over China the Moon is up, and over Kashi and Neuquen together for a while.
TAI = epochs_tai(13, 24.0)


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build(off=["troposphere"])


def arc_of(model, kind, ends, tai=TAI, tag="receive", count_s=np.nan):
    path = f"{ends[0]}{'<' if MEASUREMENTS[kind].on_baseline else '>'}apollo15>{ends[1]}"
    return ExactPredictor(model, observations(path, tai, tag, kind, count_s=count_s), APOLLO15)


def compute(model, kind, ends, tai=TAI, **more):
    return arc_of(model, kind, ends, tai, **more).compute()


@pytest.mark.parametrize("ends", BASELINES, ids="-".join)
def test_delay_is_the_difference_of_two_ranges(model, ends):
    """One wave sent by the first station comes back to it and to the second; the way up is common."""
    first, second = ends
    back = compute(model, "range", (first, first), tag="transmit")
    across = compute(model, "range", (first, second), tag="transmit")
    arrival = TAI.shifted(back.value_m / C_M_S)
    delay = compute(model, "vlbi_delay", ends, arrival)
    np.testing.assert_allclose(delay.value_m, across.value_m - back.value_m, rtol=0, atol=SAME_M)
    assert 1e5 < np.abs(delay.value_m).max() < 3.3e6
    np.testing.assert_allclose(delay.elevation_rad, across.elevation_rad, rtol=0, atol=2e-4)


@pytest.mark.parametrize("tag", TIME_TAGS)
@pytest.mark.parametrize("ends", LINKS, ids="-".join)
def test_doppler_is_range_at_the_end_less_range_at_the_start(model, ends, tag):
    doppler = compute(model, "doppler", ends, tag=tag, count_s=COUNT_S)
    end, start = (compute(model, "range", ends, TAI.shifted(s), tag=tag) for s in (COUNT_S / 2, -COUNT_S / 2))
    np.testing.assert_allclose(doppler.value_m, end.value_m - start.value_m, rtol=0, atol=SAME_M)
    np.testing.assert_allclose(
        doppler.by_position_pa, end.by_position_pa - start.by_position_pa, rtol=0, atol=1e-9
    )
    # Below the horizon at either end is below it.
    up = end.usable & start.usable
    assert (doppler.usable == up).all()


@pytest.mark.parametrize("ends", BASELINES, ids="-".join)
def test_delay_rate_is_delay_at_the_end_less_delay_at_the_start(model, ends):
    rate = compute(model, "vlbi_delay_rate", ends, count_s=COUNT_S)
    end, start = (compute(model, "vlbi_delay", ends, TAI.shifted(s)) for s in (COUNT_S / 2, -COUNT_S / 2))
    np.testing.assert_allclose(rate.value_m, end.value_m - start.value_m, rtol=0, atol=SAME_M)
    for name, tolerance in (("by_position_pa", 1e-9), ("by_time_m_s", 1e-9), ("by_zenith_wet", 1e-9)):
        grown = getattr(end, name) - getattr(start, name)
        np.testing.assert_allclose(getattr(rate, name), grown, rtol=0, atol=tolerance)
    assert (rate.usable == (end.usable & start.usable)).all()
    assert 30.0 < np.abs(rate.value_m / COUNT_S).max() < 1000.0
    # The third derivative, 2 x 465 m/s (7.3e-5 / s)^2, times 60^2 / 24.
    delay = compute(model, "vlbi_delay", ends)
    np.testing.assert_allclose(rate.value_m / COUNT_S, delay.by_time_m_s, rtol=0, atol=1e-3)


def test_kinds_are_each_computed_as_if_alone(model):
    """Ranges, delays and Doppler of different links in one table."""
    cases = [
        ("range", ("KASHI", "JIAMUSI"), np.nan),
        ("vlbi_delay", ("SESHAN25", "URUMQI"), np.nan),
        ("doppler", ("KASHI", "KASHI"), COUNT_S),
        ("vlbi_delay", ("KUNMING", "MIYUN50"), np.nan),
        ("doppler", ("NEUQUEN", "KASHI"), 10.0),
        ("vlbi_delay_rate", ("URUMQI", "SESHAN25"), 30.0),
    ]
    alone = [arc_of(model, kind, ends, count_s=count_s) for kind, ends, count_s in cases]
    order = np.arange(len(cases) * len(TAI)).reshape(len(cases), -1).T.ravel()
    table = Observations.concatenate([arc.observations for arc in alone]).select(order)
    together = ExactPredictor(model, table, APOLLO15).compute()
    apart = [arc.compute() for arc in alone]
    for name, tolerance in (("value_m", SAME_M), ("by_position_pa", 1e-9), ("by_time_m_s", 1e-6)):
        expected = np.concatenate([getattr(one, name) for one in apart])[order]
        np.testing.assert_allclose(getattr(together, name), expected, rtol=0, atol=tolerance)
    assert together.status.tolist() == np.concatenate([one.status for one in apart])[order].tolist()


def test_predicted_orientation_at_the_end_alone_marks_a_doppler_observation(model):
    some = with_predictions_after_2_december(model)
    tai = utc_to_tai(epochs_from_strings(["2020-12-01T23:59:20", "2020-12-02T00:00:10"], "UTC"))
    with pytest.warns(PredictedEopWarning, match="predicted, not measured, at 1 of"):
        arc = arc_of(some, "doppler", ("KASHI", "JIAMUSI"), tai, count_s=COUNT_S)
    assert arc.predicted_eop.tolist() == [False, True]
