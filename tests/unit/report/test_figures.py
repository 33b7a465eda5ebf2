import re
import subprocess
import sys
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from matplotlib import rc_context
from matplotlib.figure import Figure
from toy_moon import LANDER_M, ToyMoon, toy_solution

from radioloc.errors import InputError
from radioloc.report import plot_position, plot_residuals, save_figure
from radioloc.report.figures import NARROW_TICKS, WIDE_TICKS, date_axes


@pytest.fixture(scope="module")
def solution():
    return toy_solution(
        ToyMoon(90, 72.0, biases=False),
        blunders_m={4: 19.0, 7: -1e5},
        reference_pa_m=LANDER_M,
        reference_name="truth",
    )


def panels_of(figure):
    return [axes for axes in figure.axes if axes.get_title(loc="left")]


def test_residuals_drawn_are_those_of_the_solution(solution):
    (line,) = panels_of(plot_residuals(solution))[2].containers[0].lines[:1]
    shown = (solution.residuals.station == "C") & solution.residuals.used
    np.testing.assert_allclose(line.get_ydata(), solution.residuals.residual_m[shown])
    dates = line.get_xdata().astype("datetime64[ms]")
    assert str(dates[0])[:10] == "2013-12-24"
    epochs = solution.residuals.epoch_utc[shown]
    since_first_s = 86400.0 * ((epochs.jd - epochs.jd[0]) + (epochs.fraction - epochs.fraction[0]))
    np.testing.assert_allclose((dates - dates[0]).astype(float) / 1e3, since_first_s, atol=1.1e-3)


def test_position_ellipse_is_that_of_the_solution(solution):
    axes = plot_position(solution).axes[0]
    outer, inner = axes.patches
    expected = solution.ellipse(0.95)
    assert axes.get_xlabel() == "east of truth (m)"
    assert outer.height == pytest.approx(2.0 * expected.semi_major_m)
    assert outer.width == pytest.approx(2.0 * expected.semi_minor_m)
    assert inner.height == pytest.approx(outer.height / 5.991464547107979**0.5, rel=1e-6)
    np.testing.assert_allclose(outer.center, [solution.reference.east_m, solution.reference.north_m])
    # The end of the long axis, turned by the drawn angle, lies at the azimuth of the ellipse.
    angle = np.radians(outer.angle)
    end = np.array([-np.sin(angle), np.cos(angle)])
    azimuth = np.radians(expected.azimuth_deg)
    np.testing.assert_allclose(end, [np.sin(azimuth), np.cos(azimuth)], atol=1e-12)


def test_undetermined_position_cannot_be_drawn():
    with pytest.raises(InputError, match="estimated and determined"):
        plot_position(toy_solution(ToyMoon(1, 1.0, ("A",), biases=False)))


@pytest.mark.parametrize("settings", [{}, {"text.usetex": True, "axes.formatter.use_mathtext": True}])
@pytest.mark.parametrize("name", ["run $a^b^c$", "A $12 to $34 B", "50 % of a_b & c#d \\x"])
def test_names_are_drawn_as_they_are_written(solution, name, settings, tmp_path):
    with rc_context(settings | {"svg.fonttype": "none"}):
        figure = plot_position(replace(solution, reference=replace(solution.reference, name=name)))
        save_figure(figure, tmp_path / "position.svg")
    drawn = unescape((tmp_path / "position.svg").read_text())
    assert {f">{text}<" for text in (name, f"east of {name} (m)")} <= set(re.findall(">[^<>]+<", drawn))


@pytest.mark.study
@pytest.mark.parametrize("ticks", [WIDE_TICKS, NARROW_TICKS])
def test_arcs_of_any_length_have_dates_without_warnings(ticks):
    panel = Figure().subplots()
    start = np.datetime64("2020-12-01T15:11:00.000")
    for hours in (
        *np.arange(0.02, 1.0, 0.02),
        *np.arange(1.0, 120.0, 1.5),
        *np.arange(150.0, 20000.0, 250.0),
    ):
        dates = start + np.array([0, 3.6e6 * hours]).astype("timedelta64[ms]")
        date_axes([panel], dates, ticks)
        panel.set_xlim(*dates)
        # Seven minutes can have one multiple of five minutes in them.
        assert (1 if hours < 0.2 else 2) <= len(panel.get_xticks()) <= ticks[1]


def test_matplotlib_is_imported_only_when_used_and_pyplot_never():
    code = (
        "import sys, radioloc.report, radioloc.estimation\n"
        "assert not any(name in sys.modules for name in ('matplotlib', 'scipy', 'astropy'))\n"
        "from radioloc.report.figures import length_unit, new_figure\n"
        "assert new_figure(3, 2)._repr_png_()[:4] == b'\\x89PNG'\n"
        "sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
