"""First orbits from Doppler alone, with and without a given plane, of simulated and real tracking."""

from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest
from low_orbit import EPOCH
from tracked_orbit import FIRST_PASS_S, STATE, grail_study, one_way_rms_mm_s, tracked

import radioloc
from radioloc.dynamics import Forces, GravityField
from radioloc.dynamics.elements import equatorial_axes, inclination_and_node_deg
from radioloc.errors import InputError
from radioloc.jobs.orbit_start import turned_state
from radioloc.search import search
from radioloc.search.first_orbit import Candidate, first_orbits, is_ambiguous
from radioloc.study.orbiter import Orbiter, RoughOrbit

SIGMA_M = 2e-4
ALTITUDE_M, INCLINATION_DEG, NODE_DEG = 55e3, 88.8, 115.0


@pytest.fixture(scope="module")
def forces():
    return Forces(GravityField.open("GRGM660PRIM", 20), gradient_degree=20)


def visible_counts(model, forces, state, seconds):
    """Simulate counts of one station while the orbiter is visible."""
    observations, usable, _ = tracked(model, forces, SIGMA_M, seconds, state, handover_s=np.inf)
    return observations.select(usable)


@pytest.fixture(scope="module")
def doppler(model, forces):
    """Simulate an hour of Doppler, half of it hidden by the Moon, with an outlier."""
    observations = visible_counts(model, forces, STATE, FIRST_PASS_S)
    value_m = observations.value_m.copy()
    value_m[10] += 3e4  # count without lock
    return replace(observations, value_m=value_m)


def rough(forces, *plane):
    return Orbiter(EPOCH, None, None, forces, "craft", 0, rough=RoughOrbit(ALTITUDE_M, *plane))


def test_plane_refers_to_the_lunar_equator_and_its_node(model):
    axes = equatorial_axes(model.libration, EPOCH)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[0, 2] == 0.0
    # Archinal et al. (2011): the Moon's pole in 2012 is within 0.1 deg of its mean, with the nutation of 1.5 deg.
    right_ascension, declination = np.degrees([np.arctan2(axes[2, 1], axes[2, 0]), np.arcsin(axes[2, 2])])
    assert right_ascension % 360.0 == pytest.approx(270.0, abs=5.0)
    assert declination == pytest.approx(66.5, abs=2.0)
    velocity = np.cos(np.radians(60.0)) * axes[1] + np.sin(np.radians(60.0)) * axes[2]
    assert inclination_and_node_deg(np.concatenate([axes[0], velocity]), axes) == pytest.approx((60.0, 0.0))
    turned = turned_state(np.concatenate([axes[0], velocity]), np.radians(30.0) * axes[2])
    assert inclination_and_node_deg(turned, axes) == pytest.approx((60.0, 30.0))


def study(forces, *plane):
    return radioloc.Study(rough(forces, *plane), consider_defaults=False, name="first")


@pytest.mark.study
def test_orbit_with_given_altitude_and_plane_is_determined(forces, doppler):
    result = search(study(forces, INCLINATION_DEG, NODE_DEG), doppler)
    assert result.is_usable
    solution = radioloc.locate(result.study, doppler)
    assert solution.converged
    error = np.concatenate([solution.state.position_m, solution.state.velocity_m_s]) - STATE
    assert error @ np.linalg.solve(solution.state.covariance, error) < 22.5
    assert not solution.residuals.used[10]
    assert (~solution.residuals.used).sum() == 1


@pytest.mark.slow
def test_candidates_without_plane_include_a_mirror_image(model, forces, doppler):
    best, *alternatives = first_orbits(rough(forces), model, doppler)
    assert np.linalg.norm(best.state[:3] - STATE[:3]) < 2e3
    assert (best.inclination_deg, best.node_deg) == pytest.approx((88.8, 114.8), abs=0.1)
    assert any(candidate.mirrored for candidate in alternatives)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("altitude_m", "inclination_deg", "node_deg", "phase_deg"),
    [(65e3, 118.4, 270.1, 100.0), (193e3, 63.3, 194.8, 200.0), (40e3, 86.7, 165.4, 300.0)],
)
def test_eccentric_orbits_are_determined_from_their_altitude(
    model, forces, altitude_m, inclination_deg, node_deg, phase_deg
):
    """The eccentricity is 0.3 %, the data a pass and a half."""
    radius_m, speed_m_s = 1737.4e3 + altitude_m, np.sqrt(4.9028e12 / (1737.4e3 + altitude_m))
    tilt, phase, node = np.radians([inclination_deg, phase_deg, node_deg])
    turns = (np.array([0.0, 0.0, phase]), np.array([tilt, 0.0, 0.0]), np.array([0.0, 0.0, node]))
    state = np.array([radius_m, 0.0, 0.0, 0.0, 1.0015 * speed_m_s, 0.0])
    for turn in turns:
        state = turned_state(state, turn)
    state = (state.reshape(2, 3) @ equatorial_axes(model.libration, EPOCH)).ravel()
    observations = visible_counts(model, forces, state, np.arange(60.0, 9000.0, 60.0))
    orbiter = Orbiter(EPOCH, None, None, forces, "craft", 0, rough=RoughOrbit(altitude_m + 8e3))
    best, *_ = first_orbits(orbiter, model, observations)
    assert np.linalg.norm(best.state[:3] - state[:3]) < 2e3


def test_candidates_of_similar_misfit_are_ambiguous():
    pair = [Candidate(STATE, misfit, 88.8, 115.0) for misfit in (1e-4, 1.2e-4)]
    assert is_ambiguous(pair)
    assert not is_ambiguous([pair[0], replace(pair[1], misfit_m_s=2e-4)])


PLAN = """
[target]
dynamics = "moon"
epoch = "2012-04-09T04:30:00"
altitude_m = 55e3
[simulation.sessions.doppler]
kind = "doppler"
stations = ["DSS-24"]
start = 2012-04-09T04:40:00
stop = 2012-04-09T05:40:00
step_s = 60.0
sigma_m = 0.01
wavelength_um = 36000.0
"""


@pytest.mark.parametrize("name", ["covariance", "monte_carlo", "simulate", "visibility", "light_times"])
def test_jobs_of_plans_need_a_state(tmp_path, name):
    (tmp_path / "plan.toml").write_text(PLAN)
    job = attrgetter(name)(radioloc)
    with pytest.raises(InputError, match="got a rough orbit"):
        job(radioloc.read_study(tmp_path / "plan.toml"))


@pytest.mark.parametrize("job", [radioloc.locate, radioloc.compute_residuals])
def test_jobs_of_data_need_a_state(forces, doppler, job):
    with pytest.raises(InputError, match="got a rough orbit"):
        job(study(forces), doppler)


TARGET = '[target]\nname = "GRAIL-B"\ndynamics = "moon"\nepoch = "2012-04-09T04:30:00"\n'


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("altitude_m = -3.0", "altitude_m: expected more than 0"),
        ("altitude_m = 55e3\nnode_deg = 900.0", "node_deg: expected -360 to 360"),
        ("inclination_deg = 88.8", "position_m: is missing"),
    ],
)
def test_invalid_rough_orbits_are_refused(tmp_path, keys, message):
    (tmp_path / "a.csv").touch()
    (tmp_path / "study.toml").write_text(
        f'{TARGET}{keys}\n[forces]\ndegree = 4\n[observations]\nfiles = ["a.csv"]\n'
    )
    with pytest.raises(InputError, match=message):
        radioloc.read_study(tmp_path / "study.toml")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::radioloc.errors.DataQualityWarning")
@pytest.mark.parametrize(
    ("plane", "hours"), [(f"inclination_deg = {INCLINATION_DEG}\nnode_deg = {NODE_DEG}", 6.5), ("", 1.5)]
)
def test_real_orbit_of_grail_is_determined_from_its_altitude(tmp_path, plane, hours):
    result = search(grail_study(tmp_path, f"altitude_m = {ALTITUDE_M}\n{plane}", hours))
    assert result.manoeuvres == ()
    solution = radioloc.locate(result.write(tmp_path / "completed.toml"))
    assert solution.converged
    # The error of the published state is about 100 m.
    assert np.linalg.norm(solution.state.position_m - [575750.0, -463261.0, -1631634.0]) < 300.0
    # From the published state, six hours and a half leave 0.464 mm/s, the error of the field.
    assert one_way_rms_mm_s(solution) < (0.08 if hours < 2.0 else 0.47)
    assert any(candidate.mirrored for candidate in result.orbits) == (not plane)
