"""Figures of a budget, of arcs and of residuals by links show the numbers that they are of."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from toy_moon import LANDER_M, ToyMoon, toy_solution

from radioloc import LunarPosition
from radioloc.errors import InputError
from radioloc.estimation import Labels
from radioloc.report import plot_links, plot_residuals
from radioloc.report.error_figures import plot_budget
from radioloc.report.position_figures import plot_arcs
from radioloc.results.subsets import Arc, ArcStudy


@pytest.fixture(scope="module")
def solution():
    return toy_solution(
        ToyMoon(90, 72.0, biases=False),
        blunders_m={4: 19.0},
        reference_pa_m=LANDER_M,
        elevation_deg=np.linspace(12.0, 78.0, 90),
        ephemeris_sigma_enu_m=np.array([0.3, 0.4, 0.5]),
    )


def test_bars_of_the_budget_are_its_sigmas(solution):
    axes = plot_budget(solution).axes[0]
    assert [text.get_text() for text in axes.get_yticklabels()] == ["total", "measurement noise", "ephemeris"]
    factor = {"m": 1.0, "cm": 100.0}[axes.get_xlabel()[9:].split(")")[0]]
    drawn = np.array([[bar.get_width() for bar in bars] for bars in axes.containers]).T / factor
    np.testing.assert_allclose(drawn[0], solution.sigma_enu_m())
    np.testing.assert_allclose(drawn[2], [0.3, 0.4, 0.5])
    assert axes.get_xlim()[1] > factor * drawn.max()
    held = toy_solution(ToyMoon(1, 1.0, ("A",), biases=False))
    with pytest.raises(InputError, match="estimated and determined"):
        plot_budget(held)


@pytest.fixture(scope="module")
def arc_study(solution):
    shorter = replace(solution, position_pa_m=LANDER_M + np.array([0.0, 15.0, -6.0]))
    place = LunarPosition.from_cartesian(solution.rot_pa_to_me @ LANDER_M, "ME_DE421")
    references = (SimpleNamespace(name="truth", position=place),)
    return ArcStudy("toy", (Arc(48.0, 47.0, solution), Arc(12.0, 11.5, shorter)), references)


def test_arcs_are_drawn_where_the_table_has_them(arc_study):
    plane, *panels = plot_arcs(arc_study).axes
    drawn = {line.get_label(): line.get_xydata()[0] for line in plane.lines}
    for row in arc_study.rows:
        np.testing.assert_allclose(drawn[row.name], [row.east_m or 0.0, row.north_m or 0.0])
        assert plane.viewLim.contains(*drawn[row.name])
    assert [patch.height for patch in plane.patches] == pytest.approx(
        [2.0 * arc.solution.ellipse(0.95).semi_major_m for arc in arc_study.arcs]
    )
    for axes, side in zip(panels, ("east", "north", "up"), strict=True):
        for bars, row, hours in zip(axes.containers, arc_study.rows, (48.0, 12.0), strict=False):
            [x], [y] = bars.lines[0].get_data()
            assert (x, y) == pytest.approx((hours, getattr(row, f"{side}_m")))
            [[low, high]] = [segment[:, 1] for segment in bars.lines[2][0].get_segments()]
            assert high - low == pytest.approx(2.0 * 1.959964 * getattr(row, f"sigma_{side}_m"), rel=1e-6)


DASH = "\N{EN DASH}"
PATHS = {
    "vlbi_delay": ("URUMQI<lander>KUNMING", "SESHAN25<lander>URUMQI"),
    "range": ("KASHI>lander>KASHI", "JIAMUSI>lander>KASHI", "JIAMUSI>lander>JIAMUSI"),
    "doppler": ("KASHI>lander>KASHI",),
}


@pytest.fixture(scope="module")
def rows():
    """Ninety residuals of 0.1 m over six links of three kinds, the tenth and eleventh observation left out."""
    toy = toy_solution(ToyMoon(90, 72.0, biases=False)).residuals
    links = [(kind, path) for kind, paths in PATHS.items() for path in paths]
    kind, path = (np.array(column)[np.arange(90) % len(links)] for column in zip(*links, strict=True))
    residual_m = np.random.default_rng(5).uniform(-0.1, 0.1, 90)
    residual_m[:6], residual_m[10], residual_m[11] = 0.1, 70.0, -0.05
    status = np.full(90, "used", dtype="U40")
    status[[10, 11]] = "outlier"
    return replace(
        toy,
        types=Labels.from_texts(kind),
        paths=Labels.from_texts(path),
        stations=Labels.from_texts([p.split(">")[-1] for p in path]),
        residual_m=residual_m,
        sigma_m=np.full(90, 0.05),
        statuses=Labels.from_texts(status),
    )


def panels_of(figure):
    return {axes.get_title(loc="left"): axes for axes in figure.axes if axes.get_visible()}


def test_panels_show_the_used_residuals_of_their_links(rows):
    panels = panels_of(plot_links(rows))
    for title, kind, labels in (
        (f"delay URUMQI{DASH}KUNMING", "vlbi_delay", {"": PATHS["vlbi_delay"][0]}),
        ("range KASHI", "range", {"two-way": PATHS["range"][0], "from JIAMUSI": PATHS["range"][1]}),
        ("Doppler KASHI", "doppler", {"two-way": PATHS["doppler"][0]}),
    ):
        axes = panels[title]
        factor = {"m": 1.0, "cm": 100.0}[axes.get_ylabel().removeprefix("residual (").rstrip(")")]
        lines = {line.get_label(): line for line in axes.lines if line.get_marker() == "."}
        for label, path in labels.items():
            shown = (rows.type == kind) & (rows.path == path) & rows.used
            line = lines[label] if label else next(iter(lines.values()))
            np.testing.assert_allclose(line.get_ydata(), factor * rows.residual_m[shown])
        shown = (rows.type == kind) & np.isin(rows.path, list(labels.values())) & rows.used
        rms = factor * np.sqrt(np.mean(rows.residual_m[shown] ** 2))
        assert axes.get_title(loc="right").startswith(f"{shown.sum()} used, rms {rms:#.3g} ")
    legend = [text.get_text() for text in panels["range KASHI"].get_legend().get_texts()]
    assert legend == ["two-way", "from JIAMUSI"]
    assert panels[f"delay URUMQI{DASH}KUNMING"].get_legend() is None


def test_nothing_and_unknown_types_are_refused(rows):
    for plot in (plot_links, plot_residuals):
        with pytest.raises(InputError, match="at least one observation"):
            plot(rows.select(slice(0)))
    with pytest.raises(InputError, match="got 'phase'"):
        plot_links(replace(rows, types=Labels.from_texts(np.full(90, "phase"))))
