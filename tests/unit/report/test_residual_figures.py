"""The figure by links: which panels there are, and that they show what they say."""

from dataclasses import replace

import numpy as np
import pytest
from toy_moon import ToyMoon, toy_solution

from radioloc.errors import InputError
from radioloc.estimation import Labels
from radioloc.measurements.link import Link
from radioloc.report import plot_links, plot_residuals
from radioloc.report.residual_figures import MAX_LINKS
from radioloc.results.names import link_names

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


def test_a_panel_for_each_baseline_and_each_receiver(rows):
    assert list(panels_of(plot_links(rows))) == [
        f"delay SESHAN25{DASH}URUMQI",
        f"delay URUMQI{DASH}KUNMING",
        "range JIAMUSI",
        "range KASHI",
        "Doppler KASHI",
    ]


@pytest.mark.study
def test_of_too_many_links_those_with_the_most_observations(rows):
    """Forty receivers, the last with more observations than the others: it is there; that others are not is said."""
    receivers = [f"S{k:02d}" for k in range(40)] * 2 + ["S39"] * 10
    links = replace(
        rows,
        types=Labels.from_texts(["range"] * 90),
        paths=Labels.from_texts([f"{name}>lander>{name}" for name in receivers]),
        stations=Labels.from_texts(receivers),
    )
    for figure, limit, text in (
        (plot_links(links), MAX_LINKS, "links"),
        (plot_residuals(links), 12, "stations"),
    ):
        shown = [axes for axes in figure.axes if axes.get_visible() and axes.get_title(loc="left")]
        assert len(shown) == limit
        assert any("S39" in axes.get_title(loc="left") for axes in shown)
        assert f"{limit} of 40 {text}, those with the most observations" in figure.get_supxlabel()


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


def test_rejected_observations_are_marked_within_their_panel(rows):
    # Rows 10 and 11 belong to the fifth and sixth link: ranges and Doppler.
    panels = panels_of(plot_links(rows))
    for title, marker, value in (("range JIAMUSI", "^", None), ("Doppler KASHI", "x", -0.05)):
        axes = panels[title]
        assert axes.get_title(loc="right").endswith(", 1 rejected")
        [line] = [item for item in axes.lines if item.get_marker() == marker and len(item.get_ydata())]
        low, high = axes.get_ylim()
        [y] = line.get_ydata()
        assert low < y < high
        if value is not None:
            assert y == pytest.approx(
                value * {"m": 1.0, "cm": 100.0}[axes.get_ylabel().removeprefix("residual (").rstrip(")")]
            )
    assert "rejected" not in panels["range KASHI"].get_title(loc="right")


def test_panels_of_a_kind_share_a_scale_if_they_can(rows):
    panels = panels_of(plot_links(rows))
    assert panels["range KASHI"].get_ylim() == panels["range JIAMUSI"].get_ylim()
    wild = np.where((rows.path == PATHS["range"][2]) & rows.used, 100.0, 1.0) * rows.residual_m
    panels = panels_of(plot_links(replace(rows, residual_m=wild)))
    # Residuals of 10 m and of 10 cm each fill their panel.
    assert [panels[f"range {name}"].get_ylabel() for name in ("JIAMUSI", "KASHI")] == [
        "residual (m)",
        "residual (cm)",
    ]


def test_nothing_and_unknown_types_are_refused(rows):
    for plot in (plot_links, plot_residuals):
        with pytest.raises(InputError, match="at least one observation"):
            plot(rows.select(slice(0)))
    with pytest.raises(InputError, match="got 'phase'"):
        plot_links(replace(rows, types=Labels.from_texts(np.full(90, "phase"))))


def test_one_way_links_and_several_targets_are_told_apart(rows):
    """Links that differ in their way or their target only have colours of their own, and none hides another."""
    paths = ["KASHI>lander>KASHI", "KASHI>rover>KASHI", "lander>KASHI"]
    kinds = ["range", "range", "one_way_range"]
    some = replace(
        rows,
        types=Labels.from_texts([kinds[k % 3] for k in range(90)]),
        paths=Labels.from_texts([paths[k % 3] for k in range(90)]),
    )
    panels = panels_of(plot_links(some))
    assert list(panels) == ["range KASHI", "one-way range KASHI"]
    assert {text.get_text() for text in panels["range KASHI"].get_legend().get_texts()} == {
        "two-way lander",
        "two-way rover",
    }
    assert sum(len(line.get_ydata()) for axes in panels.values() for line in dots(axes).values()) == 88
    links = [Link.from_path(path) for path in ("A>x>A", "B>x>A", "x>A", "A<x>B")]
    assert link_names(links) == ["A", "A from B", "A one-way", f"A{DASH}B"]


def test_rejected_observations_beyond_a_panel_are_at_its_edge(rows):
    link_rows = rows.select((rows.path == PATHS["range"][0]) & (rows.type == "range"))
    residual_m, status = link_rows.residual_m + 500.0, np.full(len(link_rows), "used", dtype="U40")
    residual_m[[2, 3]], status[[2, 3]] = (900.0, 0.0), "outlier"
    [axes] = plot_links(replace(link_rows, residual_m=residual_m, statuses=Labels.from_texts(status))).axes
    low, high = axes.get_ylim()
    markers = {
        line.get_marker(): float(line.get_ydata()[0]) for line in axes.lines if len(line.get_ydata()) == 1
    }
    assert 500.0 < markers["^"] < high
    assert low < markers["v"] < 500.0


def test_stations_tell_their_links_apart(rows):
    ranges = rows.select(rows.type == "range")
    panels = panels_of(plot_residuals(ranges))
    assert list(panels) == ["JIAMUSI", "KASHI"]
    kashi = {bars.get_label(): len(bars.lines[0].get_ydata()) for bars in panels["KASHI"].containers}
    station_rows = ranges.select((ranges.station == "KASHI") & ranges.used)
    assert kashi == {
        "two-way": int((station_rows.path == PATHS["range"][0]).sum()),
        "from JIAMUSI": int((station_rows.path == PATHS["range"][1]).sum()),
    }
    legend = [text.get_text() for text in panels["KASHI"].get_legend().get_texts()]
    assert legend[0].startswith(f"{len(station_rows)} used, wrms ")
    assert legend[1:3] == ["two-way", "from JIAMUSI"]
