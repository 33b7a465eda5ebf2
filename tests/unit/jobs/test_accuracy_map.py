from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import radioloc
from radioloc.errors import InputError
from radioloc.jobs.trial_folder import TrialFolder
from radioloc.simulation import Masks, Schedule

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


def until_moonset(study, mask_deg):
    [session] = study.simulation.schedule.sessions
    span = {"start_utc": "2020-12-01T21:11:00", "stop_utc": "2020-12-02T02:11:00"}
    session = replace(session, one_uplink=False, **span)
    schedule = Schedule([session], Masks(mask_deg))
    return replace(study, simulation=replace(study.simulation, schedule=schedule))


def test_observations_below_the_limit_of_the_troposphere_are_counted_by_site(study):
    lower, usual = (
        radioloc.accuracy_map(until_moonset(study, mask_deg), 60.0, region_deg=(-90, -30, 90, 30))
        for mask_deg in (0.0, 3.0)
    )
    assert lower.refused.any()
    assert not usual.refused.any()
    assert (lower.count == usual.count).all()
    np.testing.assert_allclose(lower.radius_95_m, usual.radius_95_m, rtol=1e-9)
    assert "too low" in str(lower)


@pytest.fixture(scope="module")
def strip(study):
    """A map of 18 sites, two chunks."""
    return partial(radioloc.accuracy_map, study, 10.0, region_deg=(-90.0, 0.0, 90.0, 10.0))


def test_an_executor_gives_the_same_bits(strip):
    sequential = strip()
    with ThreadPoolExecutor(2) as pool:
        shared = strip(workers=pool)
    np.testing.assert_array_equal(shared.radius_95_m, sequential.radius_95_m)
    np.testing.assert_array_equal(shared.sigma_m, sequential.sigma_m)


def test_an_interrupted_map_is_resumed(strip, tmp_path, monkeypatch):
    add = TrialFolder.add

    def add_once(*arguments):
        add(*arguments)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(TrialFolder, "add", add_once)
        with pytest.raises(KeyboardInterrupt):
            strip(out=tmp_path)
    [part] = (tmp_path / "parts").glob("sites-*.npz")
    stamp = part.stat().st_mtime_ns
    np.testing.assert_array_equal(strip(out=tmp_path, resume=True).radius_95_m, strip().radius_95_m)
    assert part.stat().st_mtime_ns == stamp
    with pytest.raises(InputError, match="what differs: grid_deg"):
        strip(region_deg=(-90.0, 0.0, 80.0, 10.0), out=tmp_path, resume=True)


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
