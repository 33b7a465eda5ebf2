"""Scores of entries in cases with drawn errors of known size, and the formats of cases and entries."""

import json

import numpy as np
import pytest
from paths import EXAMPLES
from recorded import recorded

from radioloc import score
from radioloc.cli import main
from radioloc.errors import InputError
from radioloc.jobs.benchmark import read_cases

TRUTH = "[truth.lander]\nlongitude_deg = 10.0\nlatitude_deg = 60.0\nheight_m = 0.0\n"
INDEFINITE = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]
M_PER_DEG = np.pi / 180.0 * 1737400.0


def case(folder, text=TRUTH + "sigma_m = 0.0\n", head=""):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "case.toml").write_text(f'title = "a lander"\n{head}\n{text}')
    return folder


def place(east_m=0.0, north_m=0.0, up_m=0.0):
    return {
        "longitude_deg": 10.0 + east_m / M_PER_DEG / 0.5,
        "latitude_deg": 60.0 + north_m / M_PER_DEG,
        "height_m": up_m,
    }


def entry(file, program="P", **results):
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps({"program": program, "results": results}))
    return file


def only(case_folder, file):
    (row,) = score(case_folder, file).rows
    return row


def test_error_and_sigmas_along_east_north_and_up(tmp_path):
    file = entry(tmp_path / "e.json", lander=place(3.0, 0.0, 4.0) | {"sigma_m": [1.0, 5.0, 2.0]})
    row = only(case(tmp_path / "c"), file)
    assert row.error_m == pytest.approx(5.0, abs=1e-3)
    assert row.claim_m == pytest.approx(np.sqrt(30.0))
    assert row.sigmas == pytest.approx(np.sqrt((9.0 + 0.0 + 4.0) / 3.0), abs=1e-3)


@pytest.mark.parametrize(("sigma_m", "holds"), [(1.0, False), (4.0, True)])
def test_claim_holds_unless_the_error_is_improbable(tmp_path, sigma_m, holds):
    row = only(case(tmp_path / "c"), entry(tmp_path / "e.json", lander=place(10.0) | {"sigma_m": sigma_m}))
    assert row.holds is holds


def test_only_claims_that_hold_are_placed_by_the_greater_of_error_and_claim(tmp_path):
    folder = case(tmp_path / "c")
    for name, error_m, stated in (
        ("wide", 1.0, {"sigma_m": 100.0}),
        ("good", 3.0, {"sigma_m": 4.0}),
        ("false", 0.5, {"sigma_m": 0.01}),
        ("silent", 0.1, {}),
    ):
        entry(folder / "entries" / f"{name}.json", name, lander=place(error_m) | stated)
    scores = score(tmp_path)
    assert scores.files()["scores.md"].count("no claim") == 1
    assert [(row.program, row.place) for row in scores.rows] == [
        ("good", 1),
        ("wide", 2),
        ("false", None),
        ("silent", None),
    ]


@pytest.mark.parametrize(("scale", "holds"), [(1.0, True), (0.4, False)])
def test_coverage_of_draws_decides(tmp_path, scale, holds):
    """Clipped errors of one sigma: a claim of 0.4 sigma fails by its coverage, not by a single error."""
    errors_m = np.clip(np.random.default_rng(1).normal(size=(60, 2)), -1.3, 1.3)
    folder = case(tmp_path / "c", TRUTH + "sigma_m = [1e-6, 1e-6]\n", "draws = 60")
    results = {f"lander#{k}": place(*e) | {"sigma_m": scale} for k, e in enumerate(errors_m, 1)}
    row = only(folder, entry(tmp_path / "e.json", **results))
    assert row.holds is holds
    assert (row.covered > 50) is holds


def test_solution_and_csv_equal_the_json(tmp_path):
    folder = case(tmp_path / "c")
    solution = tmp_path / "solution.json"
    solution.write_text(json.dumps(recorded("lander", (10.001, 60.0, 5.0), (10.0, 20.0, 5.0))))
    table = tmp_path / "e.csv"
    table.write_text(
        "# program: P\n# version: 2\nname,longitude_deg,latitude_deg,height_m,sigma_1_m,sigma_2_m,sigma_3_m\n"
        "lander,10.001,60.0,5.0,10,20,5\n"
    )
    first, second = only(folder, solution), only(folder, table)
    assert (second.program, second.version) == ("P", "2")
    assert (first.error_m, first.sigmas) == pytest.approx((second.error_m, second.sigmas), rel=1e-6)


def test_states_of_spacecraft_at_one_epoch(tmp_path):
    state = {"frame": "ICRF", "epoch_tdb": "2022-01-01T01:00:00", "position_m": [1.8e6, 0.0, 3.0]}
    epoch = 'frame = "ICRF"\nepoch_tdb = "2022-01-01T01:00:00"\n'
    truth = f"[truth.t]\n{epoch}position_m = [1.8e6, 0.0, 0.0]\nsigma_m = 1.0\n"
    folder = case(tmp_path / "c", truth)
    assert only(folder, entry(tmp_path / "e.json", t=state | {"sigma_m": 2.0})).error_m == 3.0
    with pytest.raises(InputError, match="epoch"):
        score(folder, entry(tmp_path / "e.json", t=state | {"epoch_tdb": "2022-01-01T02:00:00"}))


def test_results_of_disjoint_data_are_tested_against_each_other(tmp_path):
    folder = case(tmp_path / "c", "", "agreement = true")
    results = {"first": place(3.0) | {"sigma_m": 1.0}, "second": place(-1.0) | {"sigma_m": 1.0}}
    row = only(folder, entry(tmp_path / "e.json", **results))
    assert (row.error_m, row.claim_m) == pytest.approx((4.0, np.sqrt(6.0)), abs=1e-3)


def test_missing_or_changed_data_are_reported_and_the_recorded_entry_scored(tmp_path):
    data = '[[data]]\nfile = "d.odf"\nsource = "PDS"\nsha256 = "00"\n'
    folder = case(tmp_path / "c", TRUTH + "sigma_m = 0.0\n" + data, 'studies = ["s.toml"]')
    (folder / "s.toml").write_text("")
    entry(folder / "entries" / "radioloc.json", "radioloc", lander=place() | {"sigma_m": 1.0})
    for content, word in ((None, "download"), ("x", "differs")):
        if content is not None:
            (folder / "d.odf").write_text(content)
        scores = score(folder)
        assert word in scores.missing["c"]
        assert [row.source for row in scores.rows] == ["radioloc.json"]


@pytest.mark.parametrize(
    ("content", "match"),
    [
        ({"results": {}}, "program"),
        ({"program": "P", "results": {"other": place()}}, "lander"),
        ({"program": "P", "results": {"lander": place() | {"sigma_m": "x"}}}, "sigma_m"),
        ({"program": "P", "results": {"lander": place() | {"sigma_m": 0.0}}}, "above zero"),
        ({"program": "P", "results": {"lander": place() | {"covariance_m2": INDEFINITE}}}, "covariance_m2"),
        ({"program": "P", "results": {"lander": {"frame": "ICRF"}}}, "ICRF"),
    ],
)
def test_bad_entries_are_one_error(tmp_path, content, match):
    file = tmp_path / "e.json"
    file.write_text(json.dumps(content))
    with pytest.raises(InputError, match=match):
        score(case(tmp_path / "c"), file)


def test_bad_cases_are_one_error(tmp_path):
    with pytest.raises(InputError, match=r"case\.toml"):
        score(tmp_path)
    with pytest.raises(InputError, match="truth"):
        score(case(tmp_path / "c", ""))


def test_every_case_of_the_benchmark_is_read_and_its_recorded_entries_score():
    for item in read_cases(EXAMPLES / "benchmark"):
        for file in (item.folder / "entries").glob("*.json"):
            assert score(item.folder, file).rows[0].results > 0


def test_command_prints_places_and_ends_with_3_for_a_claim_that_fails(tmp_path, capsys):
    folder = case(tmp_path / "c")
    good, bad = (entry(tmp_path / f"{s}.json", lander=place(9.0) | {"sigma_m": s}) for s in (5.0, 0.5))
    assert main(["score", str(good), str(folder), "--out", str(tmp_path / "out")]) == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"scores.json", "scores.md"}
    assert main(["score", str(bad), str(folder)]) == 3
    assert "claim fails" in capsys.readouterr().out
    assert main(["score", str(good)]) == 2
    entry(folder / "entries" / "good.json", lander=place(9.0) | {"sigma_m": 5.0})
    assert main(["score", str(tmp_path)]) == 0


@pytest.mark.slow
def test_studies_of_a_case_are_run_for_each_draw(tmp_path):
    source = EXAMPLES / "benchmark" / "drawn-ranges"
    (tmp_path / "study.toml").write_text((source / "study.toml").read_text())
    text = (source / "case.toml").read_text().replace("draws = 40", "draws = 2")
    (tmp_path / "case.toml").write_text(text)
    (row,) = score(tmp_path).rows
    assert (row.source, row.results, row.holds) == ("run", 2, True)
    assert 0.3 < row.sigmas < 2.0
