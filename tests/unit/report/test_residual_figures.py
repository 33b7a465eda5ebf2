"""The figure by links: which panels there are, and that they show what they say."""

from dataclasses import replace

import numpy as np
import pytest
from toy_moon import ToyMoon, toy_solution

from radioloc.errors import InputError
from radioloc.estimation import Labels
from radioloc.report import plot_links, plot_residuals

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
    rng = np.random.default_rng(5)
    residual_m = rng.uniform(-0.1, 0.1, 90)
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


def dots(axes):
    return {line.get_label(): line for line in axes.lines if line.get_marker() == "."}


def test_panels_show_the_used_residuals_of_their_links(rows):
    panels = panels_of(plot_links(rows))
    for title, kind, labels in (
        (f"delay URUMQI{DASH}KUNMING", "vlbi_delay", {"": PATHS["vlbi_delay"][0]}),
        ("range KASHI", "range", {"two-way": PATHS["range"][0], "from JIAMUSI": PATHS["range"][1]}),
        ("Doppler KASHI", "doppler", {"two-way": PATHS["doppler"][0]}),
    ):
        axes = panels[title]
        factor = {"m": 1.0, "cm": 100.0}[axes.get_ylabel().removeprefix("residual (").rstrip(")")]
        lines = dots(axes)
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
