"""Smooth functions at many epochs: as if evaluated at each, with few evaluations."""

import numpy as np
import pytest

from radioloc.time import Epochs
from radioloc.time.smooth import evaluate_smooth

DAY = 2459184.5


class Wave:
    """An oscillation and its quadrature, which counts the epochs it is asked for."""

    def __init__(self, period_d):
        self.period_d, self.asked = period_d, 0

    def __call__(self, at):
        self.asked += len(at)
        angle = 2.0 * np.pi * ((at.jd - DAY) + at.fraction) / self.period_d
        return np.stack([np.sin(angle), np.cos(angle)], axis=-1)


def epochs(count, days, seed=0):
    return Epochs.from_jd(DAY, np.random.default_rng(seed).uniform(0.0, days, count), "TT")


@pytest.mark.parametrize(("period_d", "missed"), [(2.0, 6e-7), (4.0, 2.5e-9), (13.66, 2e-13)])
def test_error_is_as_stated(period_d, missed):
    wave, at = Wave(period_d), epochs(4000, 10.0)
    values = evaluate_smooth(wave, at)
    assert wave.asked < 100
    error = np.abs(values - Wave(period_d)(at)).max()
    # It is what the formula says, no less: the largest error lies half way between nodes.
    assert 0.5 * missed < error + 1e-15 < 1.1 * missed


def test_nodes_are_those_around_the_epochs():
    wave = Wave(13.66)
    # Two sessions months apart, each of an hour across a node: nine nodes each.
    at = Epochs.concatenate(
        [Epochs.from_jd(day, 0.5 + np.linspace(-0.02, 0.02, 50), "TT") for day in (DAY, DAY + 80.0)]
    )
    values = evaluate_smooth(wave, at)
    assert wave.asked == 18
    np.testing.assert_allclose(values, Wave(13.66)(at), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(("count", "days"), [(1, 1.0), (15, 0.01), (300, 200.0)])
def test_few_epochs_are_evaluated_as_they_are(count, days):
    wave, at = Wave(0.01), epochs(count, days)
    assert (evaluate_smooth(wave, at) == Wave(0.01)(at)).all()
    assert wave.asked == count


def test_order_and_repetition_do_not_matter():
    at = epochs(500, 2.0)
    shuffled = np.random.default_rng(1).permutation(np.repeat(np.arange(500), 2))
    all_values = evaluate_smooth(Wave(5.0), at)
    np.testing.assert_array_equal(evaluate_smooth(Wave(5.0), at[shuffled]), all_values[shuffled])
