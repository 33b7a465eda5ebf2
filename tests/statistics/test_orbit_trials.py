"""Claims of fits of an orbit, with considered errors of its gravity field, in trials with others that are drawn."""

from dataclasses import replace

import numpy as np
import pytest

import radioloc
from radioloc.results.monte_carlo import binomial_bounds

TRIALS = 150
STUDY = """
[target]
name = "craft"
dynamics = "moon"
epoch = "2012-04-09T04:30:00"
position_m = [697000.0, -560900.0, -1975300.0]
velocity_m_s = [-522.0, 1318.4, -551.8]
[forces]
degree = 30
gravity_errors = {considered}
gravity_error_degree = 45
[consider]
defaults = false
[simulation.truth_sigma]
gravity_errors = 60
[simulation.sessions.doppler]
kind = "doppler"
stations = ["DSS-24", "DSS-65"]
start = 2012-04-09T04:40:00
stop = 2012-04-09T10:40:00
step_s = 60.0
count_s = 60.0
sigma_m = 0.003
wavelength_um = 36000.0
[simulation.noise.doppler]
white_m = 0.003
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("trials") / "orbit.toml"
    path.write_text(STUDY.format(considered=60))
    return radioloc.read_study(path)


@pytest.mark.slow
def test_positions_on_the_arc_are_within_what_is_claimed(study):
    result = radioloc.monte_carlo(study, trials=TRIALS, hours=6.0)
    assert result.linear
    without_gravity = replace(study, target=replace(study.target, gravity_errors=0))
    noise_m = radioloc.covariance(without_gravity, hours=6.0).longest.sigma_m[0]
    low, _ = binomial_bounds(TRIALS, 0.95)
    for arc in result.arcs:
        # Errors of gravity are most of it; who leaves them out claims far too little.
        assert arc.rms_m[0] > 3.0 * noise_m
        # Claims are a little large: the residuals that such errors leave count as noise as well.
        ratio = np.divide(arc.rms_m, arc.sigma_m)
        assert (ratio > 0.7).all()
        assert (ratio < 1.2).all()
        for place in ("along", "across", "horizontal", "state"):
            assert arc.coverage[place].fraction >= low, (arc.name, place)
