"""Correlations of parameters as a figure."""

from dataclasses import replace

import numpy as np
import pytest
from paths import EXAMPLES

import radioloc
from radioloc.parameters.registry import PARAMETERS
from radioloc.report.error_figures import plot_correlations

APOLLO = EXAMPLES / "apollo15" / "apollo15.toml"


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
