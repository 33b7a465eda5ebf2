"""The HTML page of a result: that it is sound HTML, needs nothing else, and says what the result says."""

import base64
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from html import escape
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from html_page import Page
from PIL import Image
from toy_moon import LANDER_M, ToyMoon, toy_solution

from radioloc import cli
from radioloc.errors import InputError
from radioloc.estimation import Labels
from radioloc.report.estimate_figures import plot_correlations
from radioloc.report.page import write_html, write_page
from radioloc.results.cards import Card, Field, metres
from radioloc.results.result import Result
from radioloc.results.subsets import Arc, ArcStudy

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
LARGEST = 0.9e6
"""Largest page with figures, bytes."""
NASTY = '<img src=x onerror="alert(1)">&amp;{{ 7 * 7 }}'
PROVENANCE = {
    "study": {
        "file": f"/tmp/{NASTY}.toml",
        "sha256": "1" * 64,
        "inputs": [{"file": "a.csv", "sha256": "0" * 64}],
    },
    "n": 3,
}


def ranges_of(count, span_h, **given):
    """A solution of two-way ranges."""
    model = ToyMoon(count, span_h)
    return toy_solution(model, path=[f"{name}>lander>{name}" for name in model.station], **given)


@pytest.fixture(scope="module")
def solution():
    found = ranges_of(
        90,
        72.0,
        blunders_m={4: 19.0, 7: -1e5},
        reference_pa_m=LANDER_M,
        reference_name="truth",
    )
    return replace(found, name="toy", provenance=PROVENANCE, notes=(f"a note {NASTY}",))


@pytest.fixture(scope="module")
def written(solution, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "toy.html"
    write_html(solution, path)
    return path


@pytest.fixture(scope="module")
def page(written):
    return Page(written.read_text(encoding="utf-8"))


@pytest.mark.study
def test_a_page_is_sound_html(page):
    assert page.all("html") == [{"lang": "en"}]
    assert page.headings[0] == "h1"
    assert page.headings.count("h1") == 1
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(set(ids)) == len(ids)
    links = [attributes["href"] for attributes in page.all("a")]
    assert {link.removeprefix("#") for link in links} <= set(ids)
    for attributes in page.all("section"):
        assert attributes["aria-labelledby"] in ids
        assert f"#{attributes['id']}" in links
    for attributes in page.all("img"):
        assert attributes["alt"].startswith("toy: ")
        assert int(attributes["width"]) > 100 < int(attributes["height"])
    # Whatever can be scrolled or zoomed is reached by the keyboard and has a name.
    reached = [attributes for tag, attributes in page.elements if tag == "div" and "tabindex" in attributes]
    assert len(reached) == len(page.tables)
    assert all(attributes["aria-label"] for attributes in reached)


def test_a_page_needs_no_network_and_no_other_file(page, written):
    for tag, attributes in page.elements:
        for name in ("src", "href", "srcset", "data", "action"):
            assert attributes.get(name, "#").startswith(("#", "data:image/webp;base64,")), tag
    assert not page.all("link")
    [policy] = [one["content"] for one in page.all("meta") if "http-equiv" in one]
    assert policy.startswith("default-src 'none'; img-src data:")
    plain = re.sub(r"[A-Za-z0-9+/=]{200,}", "", written.read_text(encoding="utf-8"))
    assert not re.search(r"https?:|url\(|@import|fetch\(|XMLHttp", plain)
    assert written.stat().st_size < LARGEST


def test_text_of_users_is_text_on_the_page(page, written):
    assert not any("onerror" in attributes for _, attributes in page.elements)
    assert f"a note {NASTY}" in page.words
    assert ["study.file", f"/tmp/{NASTY}.toml"] in page.table("key", "value")
    assert "<img src=x" not in written.read_text(encoding="utf-8")


def page_of(result, folder):
    write_page(result, {}, folder / "page.html")
    return Page((folder / "page.html").read_text(encoding="utf-8"))


def test_numbers_are_those_of_the_dictionary(page, solution):
    content = solution.to_dict()
    place = content["position"]["me"]
    text = " ".join(page.words)
    for number in (
        f"{place['longitude_deg']:.8f} deg E",
        f"{place['height_m']:.3f} m",
        f"{place['x_m']:.3f}",
    ):
        assert number in text
    sides = ("east_m", "north_m", "up_m", "total_m")
    expected = [
        [row["source"], row["name"] or "-", *(metres(row[k]) for k in sides)] for row in content["budget"]
    ]
    assert page.table("1 sigma, m", "of", "east", "north", "up", "3D") == expected
    names = {row["name"] for row in content["parameters"]} - set(solution.parameters.names[:3])
    listed = page.table("parameter", "value", "sigma", "unit", "a priori")
    assert {row[0] for row in listed} == names
    for row in listed:
        [mine] = [one for one in content["parameters"] if one["name"] == row[0]]
        assert float(row[1]) == pytest.approx(mine["value"], abs=0.01 * mine["total_sigma"])
    left_out = page.table("UTC", "link", "residual, m", "reason")
    assert sorted(row[3] for row in left_out) == sorted(row["reason"] for row in content["rejected"])
    assert [float(row[2]) for row in left_out] == pytest.approx([-1e5, 19.0], rel=0.3)
    assert page.table("key", "value") == [
        ["study.file", f"/tmp/{NASTY}.toml"],
        ["study.sha256", "1" * 64],
        ["study.inputs[0].file", "a.csv"],
        ["study.inputs[0].sha256", "0" * 64],
        ["n", "3"],
    ]


@pytest.mark.study
def test_images_on_the_page_have_the_colours_of_the_figure(solution, tmp_path):
    stream = BytesIO()
    plot_correlations(solution).savefig(stream, format="png", dpi=200)
    write_page(solution, {"correlations": stream}, tmp_path / "page.html")
    shown = Page((tmp_path / "page.html").read_text(encoding="utf-8")).all("img")
    [uri] = [image["src"] for image in shown if "correlations" in image["alt"]]
    image = Image.open(BytesIO(base64.b64decode(uri.partition(",")[2])))
    drawn, kept = (np.asarray(one.convert("RGB"), dtype=int) for one in (Image.open(stream), image))
    assert np.abs(drawn - kept).max() < 0.03 * 255


@pytest.mark.study
def test_an_arc_study_has_the_card_of_each_arc(solution, tmp_path):
    short = ranges_of(30, 24.0)
    page = page_of(ArcStudy("toy", (Arc(72.0, 72.0, solution), Arc(24.0, 24.0, short))), tmp_path)
    assert {"The arc of 72 h", "The arc of 24 h"} <= set(page.words)
    assert "toy: map with error ellipses of one and three sigma, and where on the Moon it is" in (
        image["alt"] for image in page.all("img")
    )


@pytest.mark.study
def test_many_that_were_left_out_are_folded(solution, tmp_path):
    statuses = np.where(np.arange(90) < 30, "behind the Moon", "used")
    rows = replace(solution.residuals, statuses=Labels.of(statuses))
    total = replace(solution.fit.total, rejected=30, used=60)
    page = page_of(replace(solution, residuals=rows, fit=replace(solution.fit, total=total)), tmp_path)
    assert "All of them, the largest residuals first" in page.words
    left_out = page.table("UTC", "link", "residual, m", "reason")
    assert [row[3] for row in left_out] == ["behind the Moon"] * 30


def test_what_a_card_leaves_out_is_unfolded(tmp_path, monkeypatch):
    monkeypatch.setattr("radioloc.report.page.figures_of", lambda _: [])

    class Planned(Result):
        def card(self):
            rest = [("clock", "0.2"), ("pole", "0.1")]
            return Card([Field("budget", (), ("of", "m"), [("ut1", "0.4")], (), rest, "covariance.json")])

    page = page_of(Planned(), tmp_path)
    assert page.table("of", "m") == [["ut1", "0.4"], ["clock", "0.2"], ["pole", "0.1"]]
    assert "2 more" in page.words
    assert "covariance.json" not in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_without_the_extra_one_line_says_what_to_install(solution, monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    with pytest.raises(InputError, match=r"pip install 'radioloc\[report\]'$"):
        write_html(solution, tmp_path / "toy.html")
    # Before the work: there is no such study.
    assert cli.main(["locate", "none.toml", "--out", str(tmp_path), "--report"]) == 2
    assert capsys.readouterr().err.count("pip install 'radioloc[report]'\n") == 1


def test_a_page_needs_a_folder(capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(["locate", "none.toml", "--report"])
    assert end.value.code == 2
    assert "--report needs --out DIR" in capsys.readouterr().err


@pytest.fixture(scope="module")
def change5(tmp_path_factory):
    folder = tmp_path_factory.mktemp("change5")
    study = str(EXAMPLES / "change5" / "change5.toml")
    assert cli.main(["locate", study, "--out", str(folder), "--report", "--quiet"]) == 0
    return folder


@pytest.mark.slow
def test_the_page_of_a_real_study_is_small(change5):
    page = Page((change5 / "report.html").read_text(encoding="utf-8"))
    assert (change5 / "report.html").stat().st_size < LARGEST
    content = json.loads((change5 / "solution.json").read_text(encoding="utf-8"))
    assert "more in solution.json" not in (change5 / "report.html").read_text(encoding="utf-8")
    assert len(page.table("UTC", "link", "residual, m", "reason")) == content["fit"]["rejected"]
    assert ["ephemeris.sha256", content["provenance"]["ephemeris"]["sha256"]] in page.table("key", "value")


CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
@pytest.mark.parametrize("width", [390, 1280])
def test_in_a_browser_nothing_is_wider_than_the_screen(written, width, tmp_path):
    # In a frame, as a window is never as narrow as a telephone; measured each second, as a busy machine takes longer.
    copy = tmp_path / "page.html"
    copy.write_text(
        f'<iframe style="width: {width}px; height: 9000px; border: 0" srcdoc="{escape(written.read_text())}"></iframe>'
        "<script>setInterval(() => { const { contentDocument: page, contentWindow: there } = document.querySelector("
        "'iframe'); document.title = [page.documentElement.scrollWidth, there.innerWidth].join(' ') }, 1000)</script>",
        encoding="utf-8",
    )
    flags = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking")
    size, profile = "--window-size=1400,9000", f"--user-data-dir={tmp_path / 'profile'}"
    command = [CHROMIUM, *flags, size, profile, "--virtual-time-budget=60000", "--dump-dom", copy.as_uri()]
    shown = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300).stdout
    needed, available = map(int, re.search(r"<title>(\d+) (\d+)</title>", shown).groups())
    assert needed <= available == width
