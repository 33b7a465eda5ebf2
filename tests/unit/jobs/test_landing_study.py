"""From the last orbit through a powered descent to the lander: simulated, and found again in one least squares."""

import numpy as np
import pytest
from descent import SITE, TOUCHDOWN, Descent

import radioloc
from radioloc.errors import InputError
from radioloc.lunar import LunarPosition
from radioloc.measurements import ExactPredictor, FixedPoint, PhysicalModel
from radioloc.time import epochs_from_strings, tt_to_tdb, utc_to_tt

QUICK = Descent(before_s=1500.0, step_s=30.0, segment_s=30.0, planned_s=60.0, true_s=60.0, degree=4)
PLACE = LunarPosition.from_selenographic(*SITE)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    study = radioloc.read_study(
        QUICK.written(tmp_path_factory.mktemp("descent") / "study.toml", after_s=300.0)
    )
    return study, radioloc.simulate(study, seed=1)


@pytest.fixture(scope="module")
def solution(scene):
    return radioloc.locate(scene[0], scene[1].observations)


def test_after_the_touchdown_it_is_tracked_as_a_lander(scene):
    simulated = scene[1].observations
    tdb = tt_to_tdb(utc_to_tt(simulated.epoch))
    landed = np.flatnonzero(tdb.seconds_since(epochs_from_strings(TOUCHDOWN, "TDB")) > 60.0)
    assert len(landed) > 40
    model = PhysicalModel.build()
    place_pa_m = PLACE.to_axes("PA", model.ephemeris.constants).xyz_m
    fixed = ExactPredictor(model, simulated.select(landed), FixedPoint(place_pa_m)).compute()
    # The tide of the Moon moves on by some tenths of a millimetre in five minutes.
    assert np.abs(scene[1].error_free_m[landed] - fixed.value_m).max() < 1e-3


def test_the_place_and_the_orbit_are_found(scene, solution):
    assert solution.converged, solution.message
    off_m = solution.rot_pa_to_enu @ (solution.position_pa_m - PLACE.to_frame("PA_DE421").xyz_m)
    assert off_m @ np.linalg.solve(solution.position_covariance(), off_m) < 16.3  # 0.999 of three
    truth = scene[1].targets[0].trajectory
    state = np.concatenate([solution.state.position_m, solution.state.velocity_m_s])
    error = state - np.concatenate(truth.states(solution.state.epoch), axis=-1)[0]
    assert error @ np.linalg.solve(solution.state.covariance, error) < 22.5
    assert solution.state.sigma_rtn_m(solution.state.orbit.times(5)).max() < 100.0
    assert 1.0 < solution.sigma_enu_m().max() < 30.0


@pytest.mark.study
def test_before_the_descent_the_place_is_as_uncertain_as_the_thrust(scene, solution):
    observations = scene[1].observations
    after_s = tt_to_tdb(utc_to_tt(observations.epoch)).seconds_since(epochs_from_strings(TOUCHDOWN, "TDB"))
    earlier = radioloc.locate(scene[0], observations.select(np.flatnonzero(after_s < -QUICK.length_s)))
    assert earlier.converged
    # A velocity that walks by 0.05 m/s2 times 30 s in each of 24 segments goes so far; one that ends at zero, half.
    left_s = QUICK.length_s - 30.0 * (np.arange(24) + 0.5)
    walked_m = 0.05 * 30.0 * np.sqrt((left_s**2).sum())
    assert earlier.sigma_enu_m().max() == pytest.approx(0.5 * walked_m, rel=0.1)
    assert (earlier.sigma_enu_m() > 30.0 * solution.sigma_enu_m()).all()


@pytest.mark.study
def test_the_height_of_the_place_may_be_known(tmp_path, scene):
    prior = "[estimate.height_prior]\nheight_m = -2550.4\nsigma_m = 0.5"
    study = radioloc.read_study(QUICK.written(tmp_path / "study.toml", prior, after_s=300.0))
    result = radioloc.locate(study, scene[1].observations)
    assert result.converged
    assert result.sigma_enu_m()[2] < 0.51


@pytest.mark.study
def test_errors_of_gravity_are_in_the_sigmas_of_place_and_orbit(tmp_path, scene, solution):
    text = QUICK.text().replace("gravity_errors = 0", "gravity_errors = 3\ngravity_error_degree = 8")
    (tmp_path / "study.toml").write_text(text)
    result = radioloc.locate(radioloc.read_study(tmp_path / "study.toml"), scene[1].observations)
    # Degrees 5 to 8 move such a flight by hundreds of metres, which the data then tell from the thrust less well.
    assert (result.sigma_enu_m() > solution.sigma_enu_m()).all()
    ends = result.state.orbit.times(3)
    assert (result.state.sigma_rtn_m(ends) > solution.state.sigma_rtn_m(ends)).any()
    assert np.isfinite(result.state.covariance_rtn(ends)).all()
    # Told at the epoch directly, the covariance is that of the state.
    sigma_m = np.sqrt(np.trace(result.state.covariance[:3, :3]))
    assert np.linalg.norm(result.state.sigma_rtn_m(result.state.epoch)) == pytest.approx(sigma_m, rel=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            f'epoch = "{TOUCHDOWN}"',
            'epoch = "2020-12-01T14:00:00"',
            r"touchdown at 2020-12-01T14:00:00.000 TDB is not after",
        ),
        (f'epoch = "{TOUCHDOWN}"', 'epoch = "2020-12-01T15:11:00"', r"plan_12.6 starts or stops at .* not"),
        ("every_s = 10.0, ", "every_s = 0.001, ", r"got 60000"),
    ],
)
def test_mistakes_are_told(tmp_path, old, new, message):
    text = Descent(before_s=1500.0, degree=4).text()
    assert old in text
    path = tmp_path / "study.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=message):
        radioloc.read_study(path)


def test_a_trajectory_that_does_not_end_at_the_ground_is_refused(tmp_path, scene):
    path = tmp_path / "study.toml"
    lines = QUICK.text().splitlines()
    path.write_text("\n".join(line for line in lines if 'name = "plan_' not in line))
    with pytest.raises(InputError, match=r"km (above the sphere|from the a-priori place) .*at the touchdown"):
        radioloc.locate(radioloc.read_study(path), scene[1].observations)


def test_tracking_of_the_lander_alone_is_refused(scene):
    study, simulated = scene
    late = simulated.observations.select(
        np.arange(len(simulated.observations) - 20, len(simulated.observations))
    )
    with pytest.raises(InputError, match="is before all observations"):
        radioloc.locate(study, late)


@pytest.mark.study
def test_covariance_of_a_descent_is_that_of_its_fit(scene, solution):
    """The plan has no values: its sigmas are the formal ones of a fit of simulated values."""
    planned = radioloc.covariance(scene[0])
    assert planned.longest.axes == ("east", "north", "up")
    np.testing.assert_allclose(planned.longest.sigma_m, solution.sigma_enu_m("formal"), rtol=1e-3)
    total_m2 = sum(item.total_m**2 for item in planned.longest.sources)
    assert np.sqrt(total_m2) == pytest.approx(np.linalg.norm(planned.longest.sigma_m), rel=1e-9)
