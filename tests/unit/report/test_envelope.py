"""Figures of very many observations: they are said to be bars, and nothing that was beyond is lost."""

import numpy as np
import pytest

from radioloc.labels import Labels
from radioloc.measurements.registry import KINDS
from radioloc.report import plot_links, plot_residuals
from radioloc.report.figures import new_figure
from radioloc.report.residual_figures import ENVELOPE_NOTE, draw_envelope
from radioloc.report.residual_panels import BINS, time_bins
from radioloc.results.solution import Residuals
from radioloc.time import Epochs

PATHS = ("KASHI>x>KASHI", "JIAMUSI>x>KASHI")


def residuals(count, rejected=0.01):
    rng = np.random.default_rng(4)
    codes = rng.integers(0, 2, count)
    residual_m, sigma_m = rng.normal(0.0, 1.0, count), np.ones(count)
    used = rng.random(count) > rejected
    residual_m[~used] *= 40.0
    return Residuals(
        Epochs.from_jd(2459185.5, np.sort(rng.random(count)), "UTC"),
        Labels.coded(["KASHI"], np.zeros(count, dtype=int)),
        Labels(np.zeros(count, dtype=np.int32), KINDS),
        Labels.coded(PATHS, codes),
        np.full(count, 7.5e8),
        residual_m,
        sigma_m,
        Labels.coded(["used", "outlier"], ~used * 1),
        np.full(count, 30.0),
    )


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


@pytest.mark.parametrize("plot", [plot_residuals, plot_links])
def test_thousands_rejected_are_all_drawn(plot):
    rows = residuals(60_000, rejected=0.05)
    rejected = int((~rows.used).sum())
    figure = plot(rows, "t")
    assert ENVELOPE_NOTE in figure._supxlabel.get_text()
    [axes] = [axes for axes in figure.axes if axes.get_title(loc="left")]
    marks = {line.get_marker(): len(line.get_xdata()) for line in axes.lines if line.get_marker() != "None"}
    assert sum(count for marker, count in marks.items() if marker in "x^v") == rejected > 1000


def test_one_instant_is_one_span():
    instants = np.full(6000, np.datetime64("2020-12-01", "ms"))
    assert set(time_bins(instants, (instants[0], instants[0]))) == {0}
