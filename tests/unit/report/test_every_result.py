"""Every type of results writes its folder, and renders its card, its page and its figures."""

import csv
import json
import re
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import rasterio
from html_page import Page
from matplotlib.figure import Figure
from paths import EXAMPLES, ROOT
from toy_moon import LANDER_M, ToyMoon, toy_solution

import radioloc
from radioloc.errors import InputError
from radioloc.estimation.consider import ErrorSource
from radioloc.imaging import BaseMap, locate_images, read_image_study
from radioloc.imaging.solution import ErrorSource as ImageErrorSource
from radioloc.imaging.solution import PointSolution
from radioloc.imaging.strip_adjustment import GroundTies, StripAdjustment
from radioloc.lunar.map_files import new_geotiff
from radioloc.report.figure_types import FIGURES
from radioloc.report.page import write_html
from radioloc.results.accuracy_map import AccuracyMap
from radioloc.results.comparison import StateComparison, StatePair
from radioloc.results.covariance import Contribution, CovarianceStudy, Improvement, PlannedArc
from radioloc.results.monte_carlo import LinearityCheck, MonteCarlo
from radioloc.results.registry import RESULTS, result_type
from radioloc.results.result import Table
from radioloc.results.scores import Score, Scores
from radioloc.results.subsets import Arc, ArcStudy, LeaveOneOut, Omission


@cache
def solution():
    model = ToyMoon(90, 72.0)
    paths = [f"{name}>lander>{name}" for name in model.station]
    toy = toy_solution(model, path=paths, reference_pa_m=LANDER_M, reference_name="truth")
    rows = replace(toy.residuals, elevation_deg=np.linspace(12.0, 78.0, 90))
    return replace(toy, name="toy", residuals=rows, provenance={"kernel": {"name": "none"}})


def trials():
    sides = ("east", "north", "up")
    columns = ["converged", "used", "rejected", *(f"{side}_m" for side in sides)]
    columns += [*(f"sigma_{side}_m" for side in sides), "correlation_east_north", "nees", "nees_horizontal"]
    values = 10.0 * np.abs(np.random.default_rng(2).normal(size=(20, 2, len(columns))))
    values[..., columns.index("converged")] = 1.0
    values[..., columns.index("correlation_east_north")] = 0.2
    proof = LinearityCheck((3, 5), 1e-4, 1e-4, True)
    return MonteCarlo("toy", 5, (24.0, 12.0), (23.5, 11.5), tuple(columns), values, True, proof, ("clock",))


def plan():
    sources = (ErrorSource("measurement noise", "", np.eye(3)), ErrorSource("clock", "A", 0.1 * np.eye(3)))
    arcs = [PlannedArc(hours, hours, int(hours), sources, ()) for hours in (3.0, 6.0)]
    contributions = (Contribution("station", "A", 6, np.inf, 3.0),)
    return CovarianceStudy("toy", tuple(arcs), contributions, (Improvement("clock A known", 2.0),), 1.0)


def omissions():
    omission = Omission(
        *("station", "A", 30, 60, True),
        radius_95_m=5.0,
        shift_enu_m=(1.0, -2.0, 0.5),
        sigma_enu_m=(1.0, 1.0, 1.0),
        sigmas=2.3,
    )
    return LeaveOneOut(solution(), (omission, Omission("station", "B", 30, 60, False)))


def accuracy_map():
    radius_m = np.array([[30.0, 20.0, 40.0], [50.0, 10.0, np.inf]])
    sigma_m = np.repeat(radius_m[..., None], 3, axis=-1)
    edges = np.array([-60.0, 0.0, 60.0]), np.array([30.0, -30.0])
    count = np.array([[5, 5, 5], [5, 5, 0]])
    return AccuracyMap("toy", "ME_DE421", 0.0, 24.0, *edges, count, 0 * count, sigma_m, radius_m)


def point():
    place = radioloc.LunarPosition.from_selenographic(-51.9, 43.0, -2550.0)
    sources = (ImageErrorSource("pixel", np.diag([1.0, 2.0, 0.5])),)
    return PointSolution("toy", "image_point", "", place, sources, (), {"pixel": [1, 2]}, 1)


@cache
def base_map():
    rows, ground = np.arange(4), np.array([[1737400.0, 100.0 * k, 200.0 * k] for k in range(4)])
    no_prior = np.full((2, 3), np.nan), np.full(2, np.inf)
    ties = GroundTies(rows % 2, rows // 2, np.ones((4, 2)), np.ones(4), *no_prior)
    residuals = np.full((4, 2), 0.1)
    fields = ((), np.zeros((2, 12)), np.eye(24), np.ones(2, bool), ground, residuals, residuals, 0.3, 5.0)
    mosaic = Path(tempfile.mkdtemp()) / "mosaic.tif"
    transform = rasterio.Affine(50.0, 0.0, -100.0, 0.0, -50.0, 700.0)
    with new_geotiff(mosaic, "+proj=eqc +R=1737400", transform, (16, 16), "uint8") as file:
        file.write(np.arange(256, dtype=np.uint8).reshape(16, 16), 1)
    return BaseMap(
        "toy", ("a.tif", "b.tif"), mosaic, ties, StripAdjustment(*fields), np.ones((2, 2)), {(0, 1): 0.01}
    )


MAKERS = {
    "solution": (solution, {"solution.json", "residuals.csv"}),
    "arcs": (
        lambda: ArcStudy("toy", (Arc(72.0, 72.0, solution()), Arc(24.0, 24.0, solution()))),
        {"arcs.json", "table1.csv", "table1.md", "table1.tex"}
        | {f"{hours}h/{name}" for hours in (72, 24) for name in ("solution.json", "residuals.csv")},
    ),
    "comparison": (
        lambda: radioloc.compare([solution()]),
        {"comparison.json", "table1.csv", "table1.md", "table1.tex"},
    ),
    "state_comparison": (
        lambda: StateComparison(
            "2024-05-02", {"12 h": True, "24 h": True}, (StatePair("12 h", "24 h", 1.0, -2.0, 0.5, 4.0),)
        ),
        {"comparison.json", "states.csv"},
    ),
    "monte_carlo": (trials, {"montecarlo.json", "trials.csv"}),
    "covariance": (plan, {"covariance.json", "covariance.csv"}),
    "accuracy_map": (accuracy_map, {"accuracy_map.json", "accuracy_map.csv", "accuracy_map.tif"}),
    "scores": (
        lambda: Scores(
            {"toy": "a toy"}, (Score("toy", "radioloc", "1", 4, 1.0, 1.2, 0.9, 4, True, "run", 1),), {}
        ),
        {"scores.json", "scores.md"},
    ),
    "leave_one_out": (omissions, {"leave_one_out.json", "leave_one_out.csv"}),
    "image_point": (point, {"solution.json"}),
    "stereo_pair": (
        cache(lambda: locate_images(EXAMPLES / "stereo" / "pair.toml")),
        {"stereo_points.json", "points.csv", "points.ply"},
    ),
    "base_map": (base_map, {"base_map.json", "tie_points.csv"}),
    "images": (
        lambda: locate_images(read_image_study(EXAMPLES / "images" / "descent.toml")),
        {"solution.json", "poses.csv", "tie_points.csv", "images.gpkg", "mosaic.tif"}
        | {f"rectified/{k:03d}_{k:04d}.tif" for k in range(1, 17)},
    ),
}
FIGURES_OF = {
    "solution": {"residuals", "position", "correlations", "budget"},
    "arcs": {"figure2", "arcs"},
    "comparison": {"comparison"},
    "state_comparison": set(),
    "monte_carlo": {"trials"},
    "covariance": {"covariance"},
    "accuracy_map": {"accuracy_map"},
    "scores": set(),
    "leave_one_out": set(),
    "image_point": {"position"},
    "stereo_pair": {"stereo"},
    "base_map": {"base_map"},
    "images": {"images"},
}


def test_every_type_is_here_and_its_figures_are_declared():
    assert set(RESULTS) == set(MAKERS)
    for declared in RESULTS.values():
        assert set(declared.figures) <= set(FIGURES)
    with pytest.raises(InputError, match=r"got a dict"):
        result_type({})


@pytest.mark.study
@pytest.mark.parametrize("name", [*MAKERS])
def test_a_folder_has_all_files_and_figures_and_the_page(name, tmp_path):
    make, files = MAKERS[name]
    result = make()
    assert result_type(result).name == name
    written = radioloc.write_report(tmp_path / "new" / "out", result, html=True)
    folder = tmp_path / "new" / "out"
    figures = {f"{figure}.{ending}" for figure in FIGURES_OF[name] for ending in ("png", "svg")}
    expected = files | figures | {"report.html"}
    assert {path.relative_to(folder).as_posix() for path in written} == expected
    assert {path.relative_to(folder).as_posix() for path in folder.rglob("*.*")} == expected
    for path in written:
        if path.suffix == ".json":
            json.loads(path.read_text(encoding="utf-8"), parse_constant=lambda text: pytest.fail(text))
        elif path.suffix == ".csv":
            rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
            assert len({len(row) for row in rows}) == 1
            assert len(rows) > 1
        elif path.suffix in (".png", ".svg"):
            assert path.read_bytes()[:5] in (b"\x89PNG\r", b"<?xml")
    page = Page((folder / "report.html").read_text(encoding="utf-8"))
    assert len(page.all("img")) >= len(FIGURES_OF[name])
    assert all(image["alt"] for image in page.all("img"))


def names_in(content):
    """Keys of JSON at all levels, columns of tables, except names that belong to the data."""
    if isinstance(content, Table):
        yield from content.columns
    elif isinstance(content, str):
        yield from content.partition("\n")[0].split(",")
    elif isinstance(content, dict):
        for key, value in content.items():
            yield key
            if key != "provenance":
                yield from names_in(value) if not isinstance(value, str) else ()
    elif isinstance(content, list | tuple):
        for item in content:
            yield from names_in(item) if not isinstance(item, str) else ()


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.study] * (name == "images")) for name in MAKERS]
)
def test_every_key_and_column_is_on_the_page_of_output_files(name):
    text = (ROOT / "docs" / "reference" / "output-files.md").read_text(encoding="utf-8")
    quoted = re.findall(r"`([^`\n]+)`", re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL))
    documented = {word for item in quoted for word in re.split(r"[.\s]+", item)}
    files = {
        file: content for file, content in MAKERS[name][0]().files().items() if file.endswith(("json", "csv"))
    }
    names = {item for content in files.values() for item in names_in(content)}
    of_data = {"kernel", "pixel", "clock_m"}
    assert {item for item in names if re.fullmatch("[a-z][a-z0-9_]*", item)} - of_data <= documented


@pytest.mark.parametrize("name", [name for name in MAKERS if name != "images"])
def test_card_and_page_and_notebook_have_the_same_fields(name, tmp_path, monkeypatch):
    result = MAKERS[name][0]()
    text = str(result)
    assert max(map(len, text.splitlines())) <= 80
    assert "-0.0 " not in text
    json.dumps(result.to_dict(), allow_nan=False)
    monkeypatch.setattr("radioloc.report.page.available_figures", lambda _: [])
    write_html(tmp_path / "page.html", result)
    page, notebook = Page((tmp_path / "page.html").read_text(encoding="utf-8")), Page(result._repr_html_())
    for shown, fields in (
        (page, [f for f in result.card().fields if f.section]),
        (notebook, result.card().fields),
    ):
        words = " ".join(" ".join(shown.words).split())
        for field in fields:
            assert field.label in words
            for line in (*field.lines, *(cell for row in field.rows for cell in row)):
                assert " ".join(line.split()) in words
    classes = [element["class"] for element in page.all("div") if "status" in element.get("class", "")]
    assert classes[:1] in ([], [f"status {'good' if result.is_usable else 'failed'}"])
    assert bool([*result.failures()]) is not result.is_usable


def test_a_figure_is_drawn_by_its_name_in_axes_given():
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    first, right = figure.subplots(1, 2)
    assert radioloc.report.plot(solution(), "position", ax=first) is figure
    assert radioloc.report.plot(solution(), "correlations", ax=right) is figure
    assert len(first.patches) == 2
    for name, words in (("trials", "expected one of residuals, position"), ("terms", "nothing to draw")):
        with pytest.raises(InputError, match=words):
            radioloc.report.plot(solution(), name)
    held = replace(solution(), position_partials=np.zeros_like(solution().position_partials))
    with pytest.raises(InputError, match="estimated and determined"):
        radioloc.report.plot(held, "budget")
