import re
import subprocess
import sys
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from matplotlib import rc_context
from toy_moon import LANDER_M, ToyMoon, toy_solution

from radioloc.errors import FontWarning, InputError
from radioloc.estimation import Labels
from radioloc.lunar.local import local_difference
from radioloc.report import plot_links, plot_position, plot_residuals, save_figure
from radioloc.report.figures import new_figure
from radioloc.results.build import compare_with


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


def test_one_observation_is_enough():
    single = toy_solution(ToyMoon(1, 1.0, ("A",), biases=False))
    (axes,) = panels_of(plot_residuals(single))
    (line,) = axes.containers[0].lines[:1]
    assert len(line.get_ydata()) == len(single.residuals) == 1


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


def test_position_is_drawn_about_its_first_reference(solution):
    apriori = compare_with(solution, LANDER_M + np.array([0.0, 100.0, 0.0]), "a priori")
    axes = plot_position(replace(solution, reference=apriori)).axes[0]
    assert axes.get_xlabel() == "east of a priori (m)"
    # y is nearly east at this longitude of -0.4 deg.
    assert axes.patches[0].center[0] == pytest.approx(solution.reference.east_m - 100.0, abs=0.1)


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


def test_characters_without_glyphs_give_one_warning(solution, tmp_path):
    figure = plot_position(replace(solution, reference=replace(solution.reference, name="嫦娥五号")))
    with pytest.warns(FontWarning, match=r"4.*'嫦'") as caught:
        save_figure(figure, [tmp_path / "position.png", tmp_path / "position.svg"])
    assert len(caught) == 1


@pytest.mark.study
def test_matplotlib_is_imported_only_when_used_and_pyplot_never():
    code = (
        "import sys, radioloc.report, radioloc.estimation\n"
        "assert not any(name in sys.modules for name in ('matplotlib', 'scipy', 'astropy'))\n"
        "from radioloc.report.figures import length_unit, new_figure\n"
        "assert new_figure(3, 2)._repr_png_()[:4] == b'\\x89PNG'\n"
        "sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_all_references_are_drawn_about_the_first(solution):
    places_m = [LANDER_M + np.array([0.0, 20.0, 0.0]), LANDER_M + np.array([0.0, 0.0, -9.0])]
    references = tuple(compare_with(solution, at_m, name) for at_m, name in zip(places_m, "ab", strict=True))
    axes = plot_position(replace(solution, references=references)).axes[0]
    drawn = {line.get_label(): line.get_xydata()[0] for line in axes.lines}
    assert list(drawn) == ["estimate", "truth", "a", "b"]
    axes_at_estimate = solution.position_pa_m, solution.rot_pa_to_enu
    from_estimate_m = [local_difference(at_m, *axes_at_estimate).enu_m[:2] for at_m in (LANDER_M, *places_m)]
    for name, along_m in zip(("truth", "a", "b"), from_estimate_m, strict=True):
        np.testing.assert_allclose(drawn[name], along_m - from_estimate_m[0], atol=1e-9)
        assert axes.viewLim.contains(*drawn[name])


def test_formats_that_cannot_be_written_are_refused(solution, tmp_path):
    with pytest.raises(InputError, match="'docx'"):
        save_figure(plot_position(solution), tmp_path / "position.docx")


@pytest.mark.parametrize("plot", [plot_position, plot_links])
def test_any_figure_is_drawn_in_the_place_of_axes_given(solution, plot):
    figure = new_figure(9.0, 5.0)
    panel, place = figure.subplots(1, 2)
    panel.plot([0.0, 1.0])
    paths = Labels.from_texts([f"{name}>lander>{name}" for name in solution.residuals.station])
    of_links = replace(solution, residuals=replace(solution.residuals, paths=paths))
    assert plot(of_links, ax=place) is figure
    figure.canvas.draw()
    drawn = [
        axes for axes in [*figure.axes, *(a for sub in figure.subfigs for a in sub.axes)] if axes is not panel
    ]
    edge = panel.bbox.x1
    assert drawn
    assert all(axes.bbox.x0 > edge for axes in drawn)
    assert figure._repr_png_()[:4] == b"\x89PNG"
    assert len(panel.lines) == 1


def test_axes_without_a_place_in_a_grid_are_refused(solution):
    with pytest.raises(InputError, match="axes in a grid"):
        plot_residuals(solution, ax=new_figure(3.0, 3.0).add_axes((0.1, 0.1, 0.8, 0.8)))
