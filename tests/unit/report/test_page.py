"""HTML page of a result: valid, self-contained, and with the numbers of the result."""

import re
import sys
from dataclasses import replace

import pytest
from html_page import Page
from toy_moon import LANDER_M, ToyMoon, toy_solution

from radioloc import cli
from radioloc.errors import InputError
from radioloc.report.page import write_html
from radioloc.results.cards import metres
from radioloc.results.names import parameter_name, source_name

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


@pytest.fixture(scope="module")
def solution():
    model = ToyMoon(90, 72.0)
    paths = [f"{name}>lander>{name}" for name in model.station]
    toy = toy_solution(model, path=paths, blunders_m={4: 19.0, 7: -1e5}, reference_pa_m=LANDER_M)
    return replace(toy, name="toy", provenance=PROVENANCE, notes=(f"a note {NASTY}",))


@pytest.fixture(scope="module")
def written(solution, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "toy.html"
    write_html(path, solution)
    return path


@pytest.fixture(scope="module")
def page(written):
    return Page(written.read_text(encoding="utf-8"))


@pytest.mark.study
def test_a_page_is_valid_html(page):
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
    [policy] = [item["content"] for item in page.all("meta") if "http-equiv" in item]
    assert policy.startswith("default-src 'none'; img-src data:")
    plain = re.sub(r"[A-Za-z0-9+/=]{200,}", "", written.read_text(encoding="utf-8"))
    assert not re.search(r"https?:|url\(|@import|fetch\(|XMLHttp", plain)
    assert written.stat().st_size < LARGEST


def test_text_of_users_is_text_on_the_page(page, written):
    assert not any("onerror" in attributes for _, attributes in page.elements)
    assert f"a note {NASTY}" in page.words
    assert ["study.file", f"/tmp/{NASTY}.toml"] in page.table("key", "value")
    assert "<img src=x" not in written.read_text(encoding="utf-8")


def test_numbers_are_those_of_the_dictionary(page, solution):
    content = solution.to_dict()
    sides = ("east_m", "north_m", "up_m", "total_m")
    expected = [
        [source_name(row["source"]), row["name"] or "-", *(metres(row[k]) for k in sides)]
        for row in content["budget"]
    ]
    assert page.table("1 sigma, m", "of", "east", "north", "up", "3D") == expected
    names = {parameter_name(row["name"]) for row in content["parameters"][3:]}
    listed = page.table("parameter", "unit", "value", "sigma", "a priori")
    assert {row[0] for row in listed} == names
    for row in listed:
        [item] = [item for item in content["parameters"] if parameter_name(item["name"]) == row[0]]
        assert row[1] == item["unit"]
        assert float(row[2]) == pytest.approx(item["value"], abs=0.01 * item["total_sigma"])
    rejected = page.table("UTC", "link", "residual, m", "reason")
    assert sorted(row[3] for row in rejected) == sorted(
        item["reason"] for row in content["rejected"] for item in row["largest"]
    )
    assert [float(row[2]) for row in rejected] == pytest.approx([-1e5, 19.0], rel=0.3)
    assert page.table("key", "value") == [
        ["study.file", f"/tmp/{NASTY}.toml"],
        ["study.sha256", "1" * 64],
        ["study.inputs[0].file", "a.csv"],
        ["study.inputs[0].sha256", "0" * 64],
        ["n", "3"],
    ]


def test_missing_extra_is_named(solution, monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    with pytest.raises(InputError, match=r"pip install 'radioloc\[report\]'$"):
        write_html(tmp_path / "toy.html", solution)
    # Before the work: there is no such study.
    assert cli.main(["locate", "none.toml", "--out", str(tmp_path), "--report"]) == 2
    assert capsys.readouterr().err.count("pip install 'radioloc[report]'\n") == 1
