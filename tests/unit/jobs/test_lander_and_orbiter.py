"""A lander and an orbiter in one study: both are fitted together, with what they have in common."""

from dataclasses import replace

import numpy as np
import pytest
from arc_cases import observed_at
from low_orbit import EPOCH
from tracked_orbit import STATE, craft

import radioloc
from radioloc import LunarPosition, Study
from radioloc.dynamics import Forces, GravityField
from radioloc.measurements import ExactPredictor, Link, PhysicalModel
from radioloc.measurements.observations import DOPPLER, RANGE
from radioloc.parameters.choice import ParameterChoice
from radioloc.study import EstimateChoice
from radioloc.time.scales import tdb_to_tt, tt_to_tai

LANDER = LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
APRIORI = LunarPosition.from_selenographic(-51.90, 43.05, -2500.0)
OFF = np.array([100.0, -80.0, 60.0, 0.1, -0.08, 0.05])
SECONDS = np.arange(1200.0, 9000.0, 60.0)
SIGMA_M = {RANGE: 2.0, DOPPLER: 0.005}
BIAS_M = 12.0
CASES = (
    (RANGE, "DSS-24", "lander"),
    (RANGE, "DSS-65", "lander"),
    (RANGE, "DSS-65", "craft"),
    (DOPPLER, "DSS-24", "craft"),
    (DOPPLER, "DSS-65", "craft"),
    (DOPPLER, "DSS-65", "lander"),
)


@pytest.fixture(scope="module")
def forces():
    return Forces(GravityField.open("GRGM660PRIM", degree=20), gradient_degree=20)


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build()


@pytest.fixture(scope="module")
def tracking(model, forces):
    """Error-free tracking of both where it can be used, with a bias of the ranges of one station."""
    links = [Link(station, target, station) for _, station, target in CASES]
    n = len(SECONDS)
    tai = tt_to_tai(tdb_to_tt(EPOCH.shifted(np.tile(SECONDS, len(CASES)))))
    kind = np.repeat([case[0] for case in CASES], n)
    table = observed_at(
        tai,
        links,
        link=np.repeat(np.arange(len(CASES)), n),
        kind=kind,
        sigma_m=np.array([SIGMA_M[k] for k in kind]),
        count_s=np.where(kind == DOPPLER, 60.0, np.nan),
        wavelength_um=3.6e4,
    )
    orbit = craft(STATE, forces).orbit(model, table, ())
    computed = ExactPredictor(model, table, (LANDER, orbit), targets=("lander", "craft")).compute()
    biased = (kind == RANGE) & (np.repeat([case[1] for case in CASES], n) == "DSS-65")
    return replace(table, value_m=computed.value_m + BIAS_M * biased).select(computed.usable)


def study_of(forces, **extra):
    choice = EstimateChoice(position="geographic", parameters={"range_bias": ParameterChoice(("DSS-65",))})
    return Study(
        targets={"lander": APRIORI, "craft": craft(STATE + OFF, forces)},
        estimate=choice,
        consider_defaults=False,
        **extra,
    )


def noisy(tracking, seed):
    noise_m = np.random.default_rng(seed).normal(size=len(tracking))
    return replace(tracking, value_m=tracking.value_m + tracking.sigma_m * noise_m)


@pytest.mark.study
def test_both_and_the_bias_that_they_share_are_found(tracking, forces):
    solution = radioloc.locate(study_of(forces), noisy(tracking, 30))
    assert solution.converged, solution.message
    assert solution.trajectory is None
    truth_pa_m = LANDER.to_axes("PA", PhysicalModel.build().ephemeris.constants).xyz_m
    error_m = solution.rot_pa_to_enu @ (solution.position_pa_m - truth_pa_m)
    covariance = solution.position_covariance("enu")
    assert error_m @ np.linalg.solve(covariance, error_m) < 16.3  # 0.1 % of three numbers
    error = np.concatenate([solution.state.position_m, solution.state.velocity_m_s]) - STATE
    assert error @ np.linalg.solve(solution.state.covariance, error) < 22.5  # 0.1 % of six
    [k] = solution.parameters.of_kind("range_bias")
    assert abs(solution.values[k] - BIAS_M) < 3.3 * solution.sigmas()[k]


@pytest.mark.study
def test_predicted_sigmas_of_both_are_those_of_the_fit(tracking, forces):
    """The plan is linearized at the a-priori orbit, 140 m away, which changes sigmas by less than a percent."""
    study = study_of(forces)
    planned = radioloc.covariance(study, 2.2, tracking)
    fitted = radioloc.locate(study, tracking)
    np.testing.assert_allclose(planned.longest.sigma_m, fitted.sigma_enu_m("formal"), rtol=0.02)
    [orbiter] = planned.others
    assert orbiter.longest.axes == ("along", "across", "radial")
    np.testing.assert_allclose(
        np.sqrt(np.diag(orbiter.longest.state.covariance)),
        np.sqrt(np.diag(fitted.state.covariance)),
        rtol=0.02,
    )
    assert {item.name for item in orbiter.contributions} >= {"DSS-24", "DSS-65"}


@pytest.mark.study
def test_lander_is_better_known_with_the_orbiter_that_shares_its_station(tracking, forces):
    joint = radioloc.locate(study_of(forces), tracking)
    lander = np.array([link.target == "lander" for link in tracking.links])[tracking.link]
    study = study_of(forces)
    separate_solution = radioloc.locate(
        replace(
            study, targets={"lander": APRIORI}, target=APRIORI, estimate=replace(study.estimate, orbit=None)
        ),
        tracking.select(lander),
    )
    np.testing.assert_allclose(joint.position_pa_m, separate_solution.position_pa_m, rtol=0.0, atol=0.2)
    [k], [second] = (item.parameters.of_kind("range_bias") for item in (joint, separate_solution))
    assert joint.sigmas()[k] < separate_solution.sigmas()[second]


def test_a_study_file_names_a_lander_and_an_orbiter(tmp_path):
    (tmp_path / "table.csv").touch()
    (tmp_path / "both.toml").write_text(
        """
[targets.lander]
longitude_deg = -51.9
latitude_deg = 43.05
height_m = -2500.0
[targets.craft]
dynamics = "moon"
epoch = "2012-04-09T04:30:00"
position_m = [575739.0, -463249.0, -1631639.0]
velocity_m_s = [-567.864, 1434.223, -600.209]
[forces]
degree = 20
[estimate]
position = "geographic"
[estimate.orbit]
state_sigma_m = 1000.0
[observations]
files = ["table.csv"]
""",
        encoding="utf-8",
    )
    study = radioloc.read_study(tmp_path / "both.toml")
    assert len(study.points) == 1
    assert study.names_in_order == tuple(study.targets)
    assert study.orbiter.position_m[0] == 575739.0
    assert study.estimate.position == "geographic"
    assert study.estimate.orbit.state_sigma_m == 1000.0
