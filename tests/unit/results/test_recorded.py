"""Recorded results: what the library writes passes the schema, and each value that other jobs read is checked."""

import copy
import json

import pytest
from toy_moon import LANDER_M, ToyMoon, toy_solution

import radioloc
from radioloc.errors import InputError
from radioloc.report.files import json_text
from radioloc.results.recorded import check_solution, read_recorded
from radioloc.results.subsets import Arc, ArcStudy
from radioloc.results.tables import solution_table


@pytest.fixture(scope="module")
def solution():
    return toy_solution(ToyMoon(90, 72.0), reference_pa_m=LANDER_M, reference_name="truth")


@pytest.fixture(scope="module")
def content(solution):
    return json.loads(json_text(solution.to_dict()))


def changed(content, key, value):
    """Return a copy with another value at a dotted key; without it for the value `KeyError`."""
    copied = copy.deepcopy(content)
    *parents, last = key.split(".")
    item = copied
    for parent in parents:
        item = item[int(parent) if parent.isdecimal() else parent]
    if value is KeyError:
        del item[last]
    else:
        item[int(last) if last.isdecimal() else last] = value
    return copied


def test_written_results_pass(solution, content, tmp_path):
    check_solution(solution.to_dict())
    path = tmp_path / "solution.json"
    path.write_text(json_text(solution.to_dict()), encoding="utf-8")
    assert read_recorded(path) == content
    path.write_text(json_text(ArcStudy("toy", (Arc(72.0, 72.0, solution),)).to_dict()), encoding="utf-8")
    assert len(read_recorded(path)["arcs"]) == 1


@pytest.mark.parametrize(
    ("key", "value", "place"),
    [
        ("name", KeyError, "name"),
        ("converged", "yes", "converged"),
        ("position.me", KeyError, "position.me"),
        ("position.me.latitude_deg", 91.0, "position.me.latitude_deg"),
        ("position.me.height_m", 10**400, "position.me.height_m"),
        ("position.me.frame", "PA_DE421", "position.me.frame"),
        ("position.pa.x_m", float("nan"), "position.pa.x_m"),
        ("position.me.y_m", 5e6, "position.me"),
        ("sigma.east_m", -1.0, "sigma.east_m"),
        ("covariance.enu_m2", [[1.0]], "covariance.enu_m2"),
        ("covariance.enu_m2.0.1", 1e9, "covariance.enu_m2"),
        ("parameters.0.value", [], "parameters[0].value"),
        ("provenance", "none", "provenance"),
        ("considered", [{"name": "a", "position_enu_m": [1.0]}], "considered[0].position_enu_m"),
        ("observations.0.utc_s", [1.0], "observations[0].observed_m"),
        (
            "priors",
            [{"name": "p.height_above_terrain", "value": 0.0, "sigma": 1.0, "position_enu_m": [0, 0, 1]}],
            "provenance",
        ),
    ],
)
def test_a_wrong_value_is_named_in_every_job(content, key, value, place, tmp_path):
    path = tmp_path / "solution.json"
    wrong = changed(content, key, value)
    with pytest.raises(InputError) as refusal:
        check_solution(wrong)
    assert str(refusal.value).startswith(place)
    path.write_text(json.dumps(wrong), encoding="utf-8")
    jobs = [
        lambda: radioloc.compare([path]),
        lambda: radioloc.verify(path),
        lambda: radioloc.io.write_gis(tmp_path / "a.geojson", [wrong]),
        lambda: solution_table([wrong]),
    ]
    for job in jobs:
        with pytest.raises(InputError):
            job()
    assert not (tmp_path / "a.geojson").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 100_000, "neither a solution.json"),
        ('{"name": ' + "9" * 5000 + "}", "neither a solution.json"),
        ('{"name": NaN}', "NaN"),
        ("[]", "neither a solution.json"),
        ("{}", "name: the key is missing"),
    ],
)
def test_hostile_text_is_refused(text, words, tmp_path):
    path = tmp_path / "solution.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=words) as refusal:
        read_recorded(path)
    assert str(path) in str(refusal.value)
    assert len(str(refusal.value)) < len(str(path)) + 500


@pytest.mark.parametrize("key", ["longitude_deg", "latitude_deg", "height_m"])
def test_a_reference_of_arcs_has_a_place(key, solution, tmp_path):
    content = json.loads(json_text(ArcStudy("toy", (Arc(72.0, 72.0, solution),)).to_dict()))
    place = {"longitude_deg": 3.0, "latitude_deg": 2.0, "height_m": 1.0}
    content["positions"].append({"name": "published", "method": "reference"} | place)
    row = len(content["positions"]) - 1
    path = tmp_path / "arcs.json"
    path.write_text(json.dumps(changed(content, f"positions.{row}.{key}", KeyError)), encoding="utf-8")
    with pytest.raises(InputError, match=rf"arcs\.json.*positions\[{row}\]\.{key}"):
        read_recorded(path)
