"""What a solution leaves in a folder."""

import csv
import json

import pytest
from quick import some

import radioloc
import radioloc.report
from radioloc import LunarPosition, Study
from radioloc.errors import InputError
from radioloc.report.files import INCOMPLETE, write_report
from radioloc.study import ObservationChoice


@pytest.fixture(scope="module")
def study(apollo15, near15, tmp_path_factory):
    file = tmp_path_factory.mktemp("data") / "few.csv"
    radioloc.io.table.write_table(file, apollo15.select(slice(None, None, 6)), light_time=True)
    return Study(target=near15, observations=ObservationChoice(files=file))


@pytest.fixture(scope="module")
def solution(study):
    return radioloc.locate(study)


@pytest.fixture(scope="module")
def predictor(study):
    return radioloc.jobs.prepare_arc(study)


@pytest.fixture(scope="module")
def folder(solution, tmp_path_factory):
    folder = tmp_path_factory.mktemp("out") / "deep" / "er"
    assert sorted(write_report(folder, solution)) == sorted(folder.iterdir())
    return folder


def rows_of(file):
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_solution_file(folder, solution):
    text = (folder / "solution.json").read_text(encoding="utf-8")
    content = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    place, fit = content["position"], content["fit"]
    assert (place["pa"]["frame"], place["me"]["frame"]) == ("PA_DE421", "ME_DE421")
    assert [place["pa"][f"{axis}_m"] for axis in "xyz"] == solution.position_pa_m.tolist()
    assert [place["me"][key] for key in ("longitude_deg", "latitude_deg", "height_m")] == [
        *solution.selenographic
    ]
    assert [
        content["sigma"][f"{axis}_m"] for axis in ("east", "north", "up")
    ] == solution.sigma_enu_m().tolist()
    assert fit["used"] + fit["rejected"] == len(solution.residuals)
    made_from = content["provenance"]
    assert made_from["files"] == ["few.csv"]
    assert made_from["ephemeris"]["name"] == "DE421"
    assert len(made_from["ephemeris"]["sha256"]) == 64
    assert made_from["a_priori"]["frame"] == "ME_DE421"
    assert made_from["estimate"]["range_bias"] == "none"
    assert made_from["estimate"]["height_prior"] is None


@pytest.mark.usefixtures("undrawn")
def test_terms_file(predictor, solution, folder, tmp_path):
    path = tmp_path / "new" / "terms.csv"
    assert path in write_report(tmp_path / "new", solution, predictor)
    rows, residuals = rows_of(path), rows_of(folder / "residuals.csv")
    assert list(rows[0]) == [
        "epoch_utc",
        "type",
        "path",
        *(f"{name}_m" for name in radioloc.measurements.TERMS),
    ]
    for key in ("epoch_utc", "type", "path"):
        assert [row[key] for row in rows] == [row[key] for row in residuals]
    assert all(10.0 < float(row["shapiro_m"]) < 30.0 for row in rows)
    assert all(float(row["ionosphere_m"]) == 0.0 for row in rows)
    assert b"\r" not in path.read_bytes()


@pytest.mark.study
@pytest.mark.parametrize("figures", some([False, True], [False]))
def test_again_gives_the_same_bytes(figures, study, folder, tmp_path, request):
    if not figures:
        request.getfixturevalue("undrawn")
    written = write_report(tmp_path, radioloc.locate(study))
    for file in written if figures else written[:2]:
        assert file.read_bytes() == (folder / file.name).read_bytes(), file.name


@pytest.mark.study
def test_no_plot_of_a_position_that_is_not_known(apollo15, near15, tmp_path):
    single = radioloc.locate(Study(target=near15), apollo15.select([0]))
    hidden = LunarPosition.from_selenographic(178.0, 26.0, 0.0)
    distant = radioloc.compute_residuals(Study(target=hidden), apollo15.select([0, 1]))
    for k, solution in enumerate((single, distant)):
        names = {file.name for file in write_report(tmp_path / str(k), solution)}
        drawn = {name.removesuffix(".png") for name in names if name.endswith(".png")}
        assert drawn == {"residuals"}
        json.loads((tmp_path / str(k) / "solution.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", ["solution.json", "residuals.csv", "residuals.png", "position.svg"])
def test_what_cannot_be_written_is_named(name, solution, tmp_path):
    (tmp_path / name).mkdir()
    with pytest.raises(InputError, match=str(tmp_path)):
        write_report(tmp_path, solution)
    assert (tmp_path / INCOMPLETE).exists()
