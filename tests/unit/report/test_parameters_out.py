"""Correlations and contours of parameters as figures, and the solution as SINEX."""

from pathlib import Path

import numpy as np
import pytest

import radioloc
from radioloc.errors import InputError
from radioloc.report import plot_contours, plot_correlations, write_sinex

APOLLO = Path(__file__).resolve().parents[3] / "examples" / "apollo15" / "apollo15.toml"


@pytest.fixture(scope="module")
def solution():
    return radioloc.locate(radioloc.read_study(APOLLO))


def test_correlations(solution):
    [image] = plot_correlations(solution).axes[0].get_images()
    shown = np.asarray(image.get_array())
    sigmas = solution.sigmas("scaled")
    np.testing.assert_allclose(shown, solution.covariance / sigmas / sigmas[:, None], atol=1e-12)
    assert shown[1, 2] > 0.99  # the card names this one


def test_contours(solution):
    names = ["position.north", "position.height"]
    profile, pair, _ = plot_contours(solution, names).axes
    x, chi2 = profile.get_lines()[0].get_data()
    sigma = solution.sigmas("scaled")[1]
    np.testing.assert_allclose(chi2, (x / sigma) ** 2, atol=1e-9)
    inverse = np.linalg.inv(solution.covariance[1:, 1:])
    for line, level in zip(pair.get_lines(), (1.0, -2.0 * np.log(0.05)), strict=True):
        points = np.stack(line.get_data())
        np.testing.assert_allclose(np.einsum("im,ij,jm->m", points, inverse, points), level, rtol=1e-6)
    with pytest.raises(InputError, match=r"1 parameters cannot be drawn; give 2 to 8"):
        plot_contours(solution, names[:1])


def test_sinex(solution, tmp_path):
    lines = write_sinex(solution, tmp_path / "a.snx").read_text().splitlines()
    assert lines[0] == "%=SNX 2.02 RLC 07:170:09515 RLC 06:097:23190 07:170:09515 C 00003 2 S"
    assert lines[-1] == "%ENDSNX"
    at = lines.index("+SOLUTION/ESTIMATE") + 2
    found = [line.split() for line in lines[at : at + 3]]
    np.testing.assert_allclose([float(one[-2]) for one in found], solution.position_pa_m, rtol=1e-14)
    begin = lines.index("+SOLUTION/MATRIX_ESTIMATE L COVA") + 2
    covariance = np.zeros((3, 3))
    for line in lines[begin : begin + 3]:
        row, column, *values = line.split()
        covariance[int(row) - 1, int(column) - 1 : int(column) - 1 + len(values)] = [float(v) for v in values]
    np.testing.assert_allclose(covariance, np.tril(solution.position_covariance("pa")), rtol=1e-12)
    assert max(map(len, lines)) <= 80
    with pytest.raises(InputError, match="this solution has none"):
        write_sinex(radioloc.residuals(radioloc.read_study(APOLLO)), tmp_path / "b.snx")
