"""VLBI delay, its rate and Doppler as differences of ranges and delays."""

import numpy as np
import pytest
from arc_cases import APOLLO15, epochs_tai, observations, with_predictions_after_2_december

from radioloc.constants import C_M_S
from radioloc.errors import PredictedEopWarning
from radioloc.measurements import MEASUREMENTS, ExactPredictor, PhysicalModel
from radioloc.measurements.registry import TIME_TAGS
from radioloc.time import epochs_from_strings, utc_to_tai

# Rounding of a difference of two ranges.
SAME_M = 1e-6

BASELINES = [("SESHAN25", "URUMQI"), ("URUMQI", "SESHAN25"), ("MIYUN50", "KUNMING")]
LINKS = [("KASHI", "KASHI"), ("KASHI", "JIAMUSI"), ("NEUQUEN", "KASHI")]
COUNT_S = 60.0
# The Moon is above the horizon in China, and part of the time at Kashi and Neuquen together.
TAI = epochs_tai(13, 24.0)


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build(off=["troposphere"])


def arc_of(model, kind, ends, tai=TAI, tag="receive", count_s=np.nan):
    path = f"{ends[0]}{'<' if MEASUREMENTS[kind].on_baseline else '>'}apollo15>{ends[1]}"
    return ExactPredictor(model, observations(path, tai, tag, kind, count_s=count_s), APOLLO15)


def compute(model, kind, ends, tai=TAI, **columns):
    return arc_of(model, kind, ends, tai, **columns).compute()


@pytest.mark.parametrize("ends", BASELINES, ids="-".join)
def test_delay_is_the_difference_of_two_ranges(model, ends):
    """The same transmission of the first station is received by both stations; the uplink cancels."""
    first, second = ends
    two_way = compute(model, "range", (first, first), tag="transmit")
    three_way = compute(model, "range", (first, second), tag="transmit")
    arrival = TAI.shifted(two_way.value_m / C_M_S)
    delay = compute(model, "vlbi_delay", ends, arrival)
    np.testing.assert_allclose(delay.value_m, three_way.value_m - two_way.value_m, rtol=0, atol=SAME_M)
    assert 1e5 < np.abs(delay.value_m).max() < 3.3e6
    np.testing.assert_allclose(delay.elevation_rad, three_way.elevation_rad, rtol=0, atol=2e-4)


@pytest.mark.parametrize("tag", TIME_TAGS)
@pytest.mark.parametrize("ends", LINKS, ids="-".join)
def test_doppler_is_range_at_the_end_less_range_at_the_start(model, ends, tag):
    doppler = compute(model, "doppler", ends, tag=tag, count_s=COUNT_S)
    end, start = (compute(model, "range", ends, TAI.shifted(s), tag=tag) for s in (COUNT_S / 2, -COUNT_S / 2))
    np.testing.assert_allclose(doppler.value_m, end.value_m - start.value_m, rtol=0, atol=SAME_M)
    np.testing.assert_allclose(
        doppler.by_position_pa, end.by_position_pa - start.by_position_pa, rtol=0, atol=1e-9
    )
    # The observation is unusable if either end is below the horizon.
    usable = end.usable & start.usable
    assert (doppler.usable == usable).all()


@pytest.mark.parametrize("ends", BASELINES, ids="-".join)
def test_delay_rate_is_delay_at_the_end_less_delay_at_the_start(model, ends):
    rate = compute(model, "vlbi_delay_rate", ends, count_s=COUNT_S)
    end, start = (compute(model, "vlbi_delay", ends, TAI.shifted(s)) for s in (COUNT_S / 2, -COUNT_S / 2))
    np.testing.assert_allclose(rate.value_m, end.value_m - start.value_m, rtol=0, atol=SAME_M)
    for name, tolerance in (("by_position_pa", 1e-9), ("by_time_m_s", 1e-9), ("by_zenith_wet", 1e-9)):
        change = getattr(end, name) - getattr(start, name)
        np.testing.assert_allclose(getattr(rate, name), change, rtol=0, atol=tolerance)
    assert (rate.usable == (end.usable & start.usable)).all()
    assert 30.0 < np.abs(rate.value_m / COUNT_S).max() < 1000.0
    # Error of the central difference: the third derivative 2 x 465 m/s (7.3e-5 / s)^2 times 60^2 / 24.
    delay = compute(model, "vlbi_delay", ends)
    np.testing.assert_allclose(rate.value_m / COUNT_S, delay.by_time_m_s, rtol=0, atol=1e-3)


def test_predicted_orientation_at_the_end_marks_a_doppler_observation(model):
    predicted_model = with_predictions_after_2_december(model)
    tai = utc_to_tai(epochs_from_strings(["2020-12-01T23:59:20", "2020-12-02T00:00:10"], "UTC"))
    with pytest.warns(PredictedEopWarning, match="predicted, not measured, at 1 of"):
        arc = arc_of(predicted_model, "doppler", ("KASHI", "JIAMUSI"), tai, count_s=COUNT_S)
    assert arc.predicted_eop.tolist() == [False, True]
