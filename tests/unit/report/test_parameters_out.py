"""Correlations of parameters as a figure, and the solution as SINEX."""

import re
from dataclasses import replace

import numpy as np
import pytest
from paths import EXAMPLES

import radioloc
from radioloc.cli import main
from radioloc.errors import ConvergenceError, InputError
from radioloc.estimation import FitStatus
from radioloc.io.sinex import write_sinex
from radioloc.parameters.registry import PARAMETERS
from radioloc.report.error_figures import plot_correlations
from radioloc.results.estimate import TargetPosition

APOLLO = EXAMPLES / "apollo15" / "apollo15.toml"


@pytest.fixture(scope="module")
def solution():
    return radioloc.locate(radioloc.read_study(APOLLO))


FREE_BIASES = APOLLO.parents[1] / "change5" / "free_biases.toml"
COLUMNS = {  # of the lines of each block, from the first character on, as the format describes them
    "SITE/ID": "1X,A4,1X,A2,1X,A9,1X,A1,1X,A22,1X,I3,1X,I2,1X,F4.1,1X,I3,1X,I2,1X,F4.1,1X,F7.1",
    "SOLUTION/EPOCHS": "1X,A4,1X,A2,1X,A4,1X,A1,1X,A12,1X,A12,1X,A12",
    "SOLUTION/ESTIMATE": "1X,I5,1X,A6,1X,A4,1X,A2,1X,A4,1X,A12,1X,A4,1X,A1,1X,E21.15,1X,E11.6",
    "SOLUTION/MATRIX_ESTIMATE L COVA": "1X,I5,1X,I5,1X,E21.14,1X,E21.14,1X,E21.14",
}
COLUMNS["SOLUTION/APRIORI"] = COLUMNS["SOLUTION/ESTIMATE"]


@pytest.fixture(scope="module")
def with_biases(tmp_path_factory):
    """A solution with range biases that have an a-priori sigma, and its SINEX file."""
    folder = tmp_path_factory.mktemp("sinex")
    text = FREE_BIASES.read_text().replace("change5.csv", f"{FREE_BIASES.parent}/change5.csv")
    study = folder / "biases.toml"
    study.write_text(text.replace("[estimate]", "[estimate]\nrange_bias_sigma_m = 300.0"))
    assert main(["locate", str(study), "--quiet", "--sinex", str(folder / "biases.snx")]) == 0
    return radioloc.locate(radioloc.read_study(study)), folder / "biases.snx"


def blocks_of(path):
    """Blocks of a SINEX file by name: fields of their lines, cut by columns."""
    lines = path.read_text(encoding="ascii").splitlines()
    assert lines[-1] == "%ENDSNX"
    assert max(map(len, lines)) <= 80
    blocks, name = {}, None
    for line in lines[1:-1]:
        if line[0] == "+":
            assert name is None
            name, blocks[line[1:]] = line[1:], []
        elif line[0] == "-":
            assert line[1:] == name
            name = None
        elif line[0] == " " and name in COLUMNS:
            blocks[name].append(fields(line, COLUMNS[name]))
    assert name is None
    return lines[0], blocks


def fields(line, columns):
    values, at = [], 0
    for kind, width in re.findall(r"(\d?[XAIFE])(\d*)", columns):
        if kind == "1X":
            assert line[at : at + 1] in ("", " ")
            at += 1
            continue
        text = line[at : at + int(width)].strip()
        values.append({"A": str, "I": int, "F": float, "E": float}[kind](text) if text else None)
        at += int(width)
    assert at >= len(line)
    return values


@pytest.mark.study
def test_correlations():
    solution = radioloc.locate(replace(radioloc.read_study(APOLLO), suboptimal=tuple(PARAMETERS)))
    ax = plot_correlations(solution).axes[0]
    shown = np.asarray(ax.get_images()[0].get_array())
    for level, part in (("total", np.tril), ("scaled", np.triu)):
        sigmas = solution.sigmas(level)
        coefficients = solution.parameter_covariance(level) / sigmas / sigmas[:, None]
        np.testing.assert_allclose(part(shown), part(coefficients), atol=1e-12)
    assert shown[1, 2] > 0.95
    assert "position north and position height" in str(solution)  # the card names correlations beyond
    assert abs(shown[2, 1]) < 0.5  # considered errors of the Moon's place hide it
    assert "upper right: without considered errors" in ax.get_title()


def test_sinex(solution, tmp_path):
    header, blocks = blocks_of(write_sinex(tmp_path / "a.snx", solution))
    assert header == "%=SNX 2.02 RLC 00:000:00000 RLC 06:097:23190 07:170:09515 C 00003 2 S"
    estimate = blocks["SOLUTION/ESTIMATE"]
    assert [line[:5] for line in estimate] == [
        [k, axis, "APOL", "A", "1"] for k, axis in enumerate(("STAX", "STAY", "STAZ"), 1)
    ]
    np.testing.assert_allclose([line[-2] for line in estimate], solution.position_pa_m, rtol=1e-14)
    sigmas_m = np.sqrt(np.diag(solution.position_covariance("pa")))
    np.testing.assert_allclose([line[-1] for line in estimate], sigmas_m, rtol=1e-5)
    # The place by degrees, minutes and seconds is good to a tenth of a second, 1 m.
    [(_, _, _, _, _, *place, height_m)] = blocks["SITE/ID"]
    longitude_deg, latitude_deg, expected_m = solution.selenographic
    assert np.dot(place[:3], (1.0, 1.0 / 60.0, 1.0 / 3600.0)) == pytest.approx(longitude_deg, abs=2e-5)
    assert np.dot(place[3:], (1.0, 1.0 / 60.0, 1.0 / 3600.0)) == pytest.approx(latitude_deg, abs=2e-5)
    assert height_m == pytest.approx(expected_m, abs=0.051)
    assert "SOLUTION/APRIORI" not in blocks


def test_sinex_of_several_parameters(with_biases):
    solution, path = with_biases
    header, blocks = blocks_of(path)
    assert header.endswith(" C 00006 1 S")
    estimate = blocks["SOLUTION/ESTIMATE"]
    assert [(line[1], line[2], line[6], line[7]) for line in estimate[3:]] == [
        ("RBIAS", "JIAM", "m", "1"),
        ("RBIAS", "KASH", "m", "1"),
        ("RBIAS", "NEUQ", "m", "1"),
    ]
    np.testing.assert_allclose([line[-2] for line in estimate[3:]], solution.values[3:], rtol=1e-13)
    assert [(line[0], *line[-2:]) for line in blocks["SOLUTION/APRIORI"]] == [
        (4, 0.0, 300.0),
        (5, 0.0, 300.0),
        (6, 0.0, 300.0),
    ]
    covariance = np.zeros((6, 6))
    for row, column, *values in blocks["SOLUTION/MATRIX_ESTIMATE L COVA"]:
        finite = [value for value in values if value is not None]
        covariance[row - 1, column - 1 : column - 1 + len(finite)] = finite
    assert not np.triu(covariance, 1).any()
    covariance += np.tril(covariance, -1).T
    np.testing.assert_allclose([line[-1] for line in estimate], np.sqrt(np.diag(covariance)), rtol=1e-5)
    # In east, north and height, of which the solution's parameters are small changes.
    turn = np.eye(6)
    turn[:3, :3] = np.linalg.inv(solution.position_partials[:, :3])
    np.testing.assert_allclose(
        turn @ covariance @ turn.T, solution.parameter_covariance(), rtol=1e-6, atol=1e-6
    )


def test_sinex_of_several_targets(solution, tmp_path):
    """Two names that begin alike, and an error of the ephemeris that moves both targets."""
    first = TargetPosition("apollo11", solution.position_pa_m, solution.position_partials)
    joint = replace(
        solution,
        targets=(first, TargetPosition("apollo15", *(1.01 * first.position_pa_m, first.position_partials))),
        ephemeris_sigma_enu_m=np.array([1.0, 2.0, 3.0]),
    )
    _, blocks = blocks_of(write_sinex(tmp_path / "a.snx", joint))
    assert [(line[1], line[2]) for line in blocks["SOLUTION/ESTIMATE"]] == [
        (axis, code) for code in ("AP11", "AP15") for axis in ("STAX", "STAY", "STAZ")
    ]
    sigmas_m = np.sqrt(np.diag(joint.position_covariance("pa")))
    np.testing.assert_allclose(
        [line[-1] for line in blocks["SOLUTION/ESTIMATE"]], np.tile(sigmas_m, 2), rtol=1e-5
    )
    matrix = {(row, column): values for row, column, *values in blocks["SOLUTION/MATRIX_ESTIMATE L COVA"]}
    np.testing.assert_allclose(matrix[4, 1], joint.position_covariance("pa")[0], rtol=1e-12)


def test_solutions_without_a_position_have_no_sinex(solution, tmp_path):
    with pytest.raises(InputError, match="estimated position"):
        write_sinex(tmp_path / "b.snx", radioloc.compute_residuals(radioloc.read_study(APOLLO)))
    with pytest.raises(ConvergenceError):
        write_sinex(tmp_path / "b.snx", replace(solution, status=FitStatus.UNOBSERVABLE))
    assert not list(tmp_path.iterdir())
