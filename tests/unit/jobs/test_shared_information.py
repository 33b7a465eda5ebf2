"""Solutions compared that share observations or a-priori values: recognised by content, whatever the file."""

from dataclasses import replace

import numpy as np
import pytest
from change5_case import NEAR, observations

import radioloc
from radioloc import Observations, Study, compare, write_observations
from radioloc.estimation.combination import TerrainHeight
from radioloc.study import EstimateChoice
from radioloc.study.study import HeightPrior

HEIGHT = HeightPrior(-2550.4, 5.0)
CHOICE = EstimateChoice(height_prior=HEIGHT, range_bias="all", range_bias_sigma_m=10.0, weights="independent")


@pytest.fixture(scope="module")
def tracked(model):
    """Ranges of a day and of another, every two minutes of the first three hours that there are."""
    return observations(model, 120.0, stop="2020-12-02T18:11:00", vlbi=False, bias_m={})


@pytest.fixture(scope="module")
def days(tracked):
    hours = 24.0 * ((tracked.epoch.jd - 2459184.5) + tracked.epoch.fraction)
    return tracked[hours < 18.5], tracked[hours > 39.0]


def located(name, data, choice=CHOICE):
    study = Study(target=NEAR, estimate=choice, name=name, consider_defaults=False)
    return radioloc.locate(study, data)


def in_other_words(data, folder, ending):
    """The same observations out of another file, epochs and values rounded as there."""
    if ending == "rounded.csv":
        epoch = radioloc.time.Epochs.from_jd(
            data.epoch.jd, (86400e3 * data.epoch.fraction).round() / 86400e3, "UTC"
        )
        data = replace(data, epoch=epoch, value_m=data.value_m.round(2))
    path = folder / f"same.{ending}"
    write_observations(path, data, originator="RADIOLOC")
    tdm = radioloc.io.TdmAgreement(sigma_m={"range": 1.0}, range_convention="round_trip")
    return radioloc.read_observations(path, tdm=tdm)


@pytest.mark.parametrize("ending", ["csv", "parquet", "tdm", "rounded.csv"])
def test_the_same_observations_in_another_format_are_not_combined(days, tmp_path, ending):
    item = located("one", days[0])
    comparison = compare([item, located("two", in_other_words(days[0], tmp_path, ending))])
    assert [pair.why for pair in comparison.agreements] == ["they share observations"]
    assert comparison.joint is None


def test_a_part_with_settings_of_its_own_shares_its_observations(tracked):
    choice = replace(CHOICE, height_prior=HeightPrior(-2550.4, 20.0))
    part = located("part", tracked[np.arange(len(tracked)) % 9 == 0], choice)
    assert compare([part, located("whole", tracked)]).joint is None


def test_halves_of_one_file_and_other_noise_share_nothing(tracked, model):
    even = np.arange(len(tracked)) % 2 == 0
    comparison = compare([located("one", tracked[even]), located("two", tracked[~even])])
    assert comparison.joint is not None
    second = replace(tracked, value_m=tracked.value_m + np.random.default_rng(1).normal(size=len(tracked)))
    assert compare([located("one", tracked), located("two", second)]).joint is not None


def test_an_a_priori_value_of_both_counts_once(days):
    """The joint estimate is that of one fit to all data, where the height and the biases have their priors once."""
    item, two = (located(name, data) for name, data in zip("ab", days, strict=True))
    joint = compare([item, two]).joint
    complete = located("whole", Observations.concatenate(days))
    sigma_m, expected_m = np.sqrt(np.diag(joint.covariance_enu_m2)), complete.sigma_enu_m()
    # Three coordinates of each tell a little less than its biases beside them. Counted twice, the height has 3.5 m.
    np.testing.assert_allclose(sigma_m, expected_m, rtol=2e-3)
    np.testing.assert_allclose(joint.position_me_m, complete.position_me_m, atol=0.2)


def test_another_a_priori_value_is_other_information(days):
    second = replace(CHOICE, height_prior=HeightPrior(-2551.0, 5.0))
    item, two = located("a", days[0]), located("b", days[1], second)
    joint = compare([item, two]).joint
    assert np.sqrt(joint.covariance_enu_m2[2, 2]) < 0.8 * item.sigma_enu_m()[2]


def test_roughness_of_a_terrain_is_common_to_near_places_only():
    height = TerrainHeight("height_above_terrain", 0.2, 60.0)
    assert height.correlation(0.0) == 1.0
    assert height.correlation(60.0) == pytest.approx(0.2 + 0.8 / np.e)
    assert height.correlation(1e5) == pytest.approx(0.2)
