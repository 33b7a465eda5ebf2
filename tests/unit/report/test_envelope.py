"""Figures of very many observations: they are said to be bars, and nothing that was beyond is lost."""

import numpy as np
import pytest

from radioloc.report.figures import new_figure
from radioloc.report.residual_figures import BINS, draw_envelope, time_bins


def dates_of(count):
    milliseconds = np.sort(np.random.default_rng(1).integers(0, 86400000, count))
    return np.datetime64("2020-12-01", "ms") + milliseconds.astype("timedelta64[ms]")


def test_bars_reach_from_the_lowest_to_the_highest_of_each_span():
    dates, values = dates_of(20000), np.random.default_rng(2).normal(3.0, 1.0, 20000)
    values[777], values[15000] = 50.0, -40.0
    dates = np.delete(dates, slice(5000, 7000))  # nothing is drawn where nothing was
    values = np.delete(values, slice(5000, 7000))
    limits = dates.min(), dates.max()
    axes = new_figure(8.0, 3.0).subplots()
    draw_envelope(axes, dates, values, limits, color="k", label="x")
    reach, spread = (line.get_xydata().reshape(-1, 3, 2) for line in axes.lines)
    span = time_bins(dates, limits)
    assert len(reach) == len(np.unique(span)) < BINS
    for bar, dark, number in zip(reach, spread, np.unique(span), strict=True):
        values_m = values[span == number]
        assert (bar[0, 1], bar[1, 1]) == (values_m.min(), values_m.max())
        assert dark[:2, 1] == pytest.approx(
            [values_m.mean() - values_m.std(), values_m.mean() + values_m.std()], abs=1e-9
        )
    assert (reach[:, 0, 1].min(), reach[:, 1, 1].max()) == (-40.0, 50.0)
