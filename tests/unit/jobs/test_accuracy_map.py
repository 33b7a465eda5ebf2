from dataclasses import replace

import numpy as np
import pytest

import radioloc
from radioloc.errors import InputError

SHORT_ARC = "examples/change5/short_arc.toml"


@pytest.fixture(scope="module")
def study():
    study = radioloc.read_study(SHORT_ARC)
    schedule = study.simulation.schedule
    [first, *_] = schedule.sessions
    # Six hours, in which limb sites set; the station that transmits first depends on the site.
    session = replace(first, stop_utc="2020-12-01T21:11:00", step_s=600.0, one_uplink=True)
    scenario = replace(study.simulation, schedule=replace(schedule, sessions=[session]))
    return replace(study, simulation=scenario)


def at_site(study, longitude_deg, latitude_deg, height_m):
    site = radioloc.LunarPosition.from_selenographic(longitude_deg, latitude_deg, height_m)
    scenario = replace(study.simulation, position=site)
    prior = replace(study.estimate.height_prior, height_m=height_m) if study.estimate.height_prior else None
    estimate = replace(study.estimate, height_prior=prior)
    return replace(study, target=site, simulation=scenario, estimate=estimate)


def test_each_site_has_the_accuracy_of_its_own_covariance_analysis(study):
    accuracy = radioloc.accuracy_map(study, 60.0, region_deg=(-90.0, -90.0, 90.0, 90.0))
    assert accuracy.radius_95_m.shape == (3, 3)
    for row, column in ((0, 0), (1, 1), (2, 2)):
        site = at_site(study, accuracy.longitude_deg[column], accuracy.latitude_deg[row], accuracy.height_m)
        longest = radioloc.covariance(site, 6.0).longest
        assert accuracy.count[row, column] == longest.count
        np.testing.assert_allclose(accuracy.sigma_m[row, column], longest.sigma_m, rtol=1e-6)
        assert accuracy.radius_95_m[row, column] == pytest.approx(longest.radius_95_m, rel=1e-6)


def test_the_far_side_is_not_determined(study):
    accuracy = radioloc.accuracy_map(study, 20.0, region_deg=(170.0, -10.0, 190.0, 10.0))
    assert not accuracy.determined
    assert accuracy.count.tolist() == [[0]]
    assert np.isinf(accuracy.sigma_m).all()


def test_a_study_with_two_targets_or_without_a_plan_is_refused(study):
    with pytest.raises(InputError, match="one lander"):
        radioloc.accuracy_map("examples/apollo15/apollo15.toml", 10.0)


@pytest.mark.parametrize(
    ("step_deg", "region_deg"),
    [(0.0, (0, 0, 9, 9)), (20.0, (0, 0, 9, 9)), (1.0, (9, 0, 0, 9)), (1e-3, (0, 0, 9, 9))],
)
def test_a_grid_without_sites_or_with_too_many_is_refused(study, step_deg, region_deg):
    with pytest.raises(InputError):
        radioloc.accuracy_map(study, step_deg, region_deg=region_deg)
