"""Solutions put beside each other: the paper's table, and what the files must be."""

import csv
import json

import numpy as np
import pytest
from paths import EXAMPLES
from recorded import recorded

from radioloc import compare
from radioloc.cli import main
from radioloc.errors import InputError
from radioloc.jobs.comparison import published_objects

# Wang et al. (2021), table 1: longitude W, latitude N, and differences to the first in m, which it gives to 0.1.
TABLE_1 = {
    "Image matching to Chang'e-2 DOM": (51.9162, 43.0584, None, None),
    "48 h data": (51.9158, 43.0587, -8.9, 9.1),
    "24 h data": (51.9166, 43.0594, 8.9, 30.3),
    "12 h data": (51.9181, 43.0591, 42.1, 21.2),
    "Image matching to LROC NAC DOM": (51.9156, 43.0591, -13.3, 21.2),
    "Direct observation in LROC NAC image": (51.9161, 43.0576, -2.2, -24.3),
}


def solution(name, place, sigma_m=10.0, **extra):
    """What a program writes of a position with equal sigmas."""
    origin = {"study": None, "files": [f"{name}.csv"]}
    return recorded(name, place, (sigma_m,) * 3, provenance=origin) | extra


def written(folder, content):
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "solution.json"
    path.write_text(json.dumps(content))
    return path


@pytest.fixture
def table(tmp_path):
    """The paper's positions as files, each of images or tracking."""
    paths = []
    for k, (name, (west, north, *_)) in enumerate(TABLE_1.items()):
        method = "tracking" if name.endswith("data") else "images"
        paths.append(written(tmp_path / str(k), solution(name, (-west, north, -2550.0), 20.0, method=method)))
    return paths


def test_differences_are_those_of_the_paper(table, tmp_path):
    comparison = compare(table, "Image matching to Chang'e-2 DOM")
    rows = {row.name: row for row in comparison.rows}
    for name, (_, _, west_m, north_m) in TABLE_1.items():
        if west_m is None:
            assert (rows[name].east_m, rows[name].north_m) == (None, None)
        else:
            assert rows[name].east_m == pytest.approx(-west_m, abs=0.0501)
            assert rows[name].north_m == pytest.approx(north_m, abs=0.0501)
    out = tmp_path / "out"
    assert main(["compare", *map(str, table), "--out", str(out), "--quiet"]) == 0
    assert {path.name for path in out.iterdir()} == {
        "comparison.json", "comparison.png", "comparison.svg", "table1.csv", "table1.md", "table1.tex"
    }  # fmt: skip
    with (out / "table1.csv").open() as stream:
        lines = list(csv.DictReader(stream))
    assert [line["method"] for line in lines].count("tracking") == 3
    content = json.loads((out / "comparison.json").read_text())
    assert len(content["agreements"]) == 15
    assert content["joint"]["dof"] == 15
    assert content["consistent"]


def test_stated_positions_are_the_tables_of_both_papers():
    change5 = compare([EXAMPLES / "change5" / "table1.toml"], "Chang'e-2 image map")
    solution = [(-row.east_m, row.north_m) for row in change5.rows[1:]]
    assert np.abs(np.subtract(solution, [row[2:] for row in list(TABLE_1.values())[1:]])).max() < 0.0501
    assert change5.joint is None
    change3 = compare([EXAMPLES / "change3" / "table4.toml"], "VLBI, first value")
    row = change3.rows[0]
    assert (row.east_deg, row.north_deg) == pytest.approx((-0.0056, -0.0012), abs=1e-9)
    # 30.323 km a degree, and that times the cosine of the latitude
    assert (row.east_m, row.north_m) == pytest.approx((-121.9, -36.4), abs=0.05)
    # 127 m are 1.15 of sqrt(100^2 + 46^2 + 5^2) m; a chi-square of two has exp(-x / 2) beyond x.
    [pair] = change3.agreements
    assert pair.chance == pytest.approx(
        np.exp(-0.5 * (121.7**2 + 36.3**2) / (100**2 + 46**2 + 5**2)), abs=1e-3
    )


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "positions: is missing; each position is a table"),
        (
            "[positions.a]\nframe = 'PA_DE421'\nlongitude_deg = 1.0\nlatitude_deg = 1.0\nheight_m = 0.0",
            "expected mean-Earth axes",
        ),
    ],
)
def test_stated_positions_that_cannot_be(tmp_path, text, problem):
    path = tmp_path / "stated.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=problem):
        compare([path])


def test_solutions_of_one_name_are_told_apart_by_their_folders(tmp_path):
    paths = [
        written(tmp_path / name, solution("lander", (-51.9, 43.0, 0.0), provenance={"files": [name]}))
        for name in ("radio", "images")
    ]
    assert [row.name for row in compare(paths).rows[:2]] == ["lander (radio)", "lander (images)"]
    with pytest.raises(InputError, match="rename their studies"):
        compare([paths[0], paths[0]])


def test_other_files_frames_and_references_are_refused(table, tmp_path, capsys):
    text = tmp_path / "notes.json"
    text.write_text("[1, 2")
    assert main(["compare", str(text)]) == 2
    assert f"{text}, line 1: is neither a solution.json nor an arcs.json" in capsys.readouterr().err
    second = solution("other", (0.0, 0.0, 0.0))
    second["position"]["me"]["frame"] = "ME_DE440"
    with pytest.raises(InputError, match="one ephemeris"):
        compare([table[0], written(tmp_path / "other", second)])
    with pytest.raises(InputError, match=r"expected .* got int"):
        compare([3])
    with pytest.raises(InputError, match=r"Image matching.*'LOLA'"):
        compare(table, "LOLA")


def test_all_soft_landers_have_published_positions():
    landers = [f"Apollo {k}" for k in (11, 12, 14, 15, 16, 17)] + [f"Surveyor {k}" for k in (1, 3, 5, 6, 7)]
    landers += [f"Luna {k}" for k in (9, 13, 16, 17, 20, 21, 23, 24)] + [f"Chang'e-{k}" for k in (3, 4, 5, 6)]
    landers += ["Chandrayaan-3", "SLIM", "IM-1", "IM-2", "Blue Ghost 1"]
    assert set(landers) <= set(published_objects())


def test_published_positions_are_compared_with_their_sigmas(tmp_path):
    file = written(tmp_path, solution("mine", (-19.5116, 44.1219, -2640.0)))
    rows = {row.name: row for row in compare([file], "Klopotek 2019", published="change3").rows}
    # Klopotek et al. (2019), abstract
    assert rows["Klopotek 2019"].sigmas_m[:2] == (4.5, 8.9)
    assert rows["Klopotek 2019"].height_m == pytest.approx(-2637.3)
    assert rows["mine"].north_m == pytest.approx(-0.9, abs=0.1)
    assert rows["LROC 637"].height_m == pytest.approx(-2640.0)  # that of the solution
    with pytest.raises(InputError, match="published"):
        compare([file], published="Luna 99")
