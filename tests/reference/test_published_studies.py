"""Covariance studies of papers: their results within the assumptions that the examples state."""

from dataclasses import replace

import numpy as np
import pytest
from paths import EXAMPLES

import radioloc


def sigma_3d_m(study, hours):
    [arc] = radioloc.covariance(study, hours=[hours]).arcs
    return float(np.sqrt(np.trace(arc.covariance_m2)))


@pytest.mark.slow
def test_polar_lander_is_within_a_decimetre_without_librations_only():
    study = radioloc.read_study(EXAMPLES / "papers/polar_lander.toml")
    assert 0.05 < sigma_3d_m(study, 720.0) < 0.10  # Mariani et al. (2026): better than 10 cm
    assert sigma_3d_m(replace(study, consider_defaults=True), 720.0) > 1.0
