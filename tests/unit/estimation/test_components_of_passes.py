"""A variance component for each link, or each link and pass."""

from dataclasses import replace

import change5_case
import numpy as np
import pytest

import radioloc
from radioloc import Study
from radioloc.estimation import Labels, Parameter, ParameterSet
from radioloc.estimation.noise_structure import by_link
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.variance_components import fit_with_variance_components
from radioloc.measurements import PhysicalModel
from radioloc.study import EstimateChoice

NOISE_M = (1.0, 30.0, 5.0, 1.0)
"""Of four passes of 100 counts, of which 1 m is stated: two links, two passes each."""
PER_PASS = 100
PASS = np.repeat(np.arange(4), PER_PASS)
TIME_S = 10.0 * (np.arange(4 * PER_PASS) % (2 * PER_PASS)) + 40000.0 * (PASS % 2)
PATHS = Labels.from_texts([("A>x>A", "B>x>B")[k // 2] for k in PASS])
ORDER = SeriesOrder.from_labels(Labels.from_texts(["doppler"] * len(PASS)), PATHS, TIME_S)
PASSES = by_link(ORDER, 14400.0)


def drawn(seed, outliers=()):
    """Observations of an offset and a drift, and the fit with a component for each pass."""
    rng = np.random.default_rng(seed)
    design = np.column_stack([np.ones(len(PASS)), (TIME_S - TIME_S.mean()) / TIME_S.std()])
    observed_m = rng.standard_normal(len(PASS)) * np.array(NOISE_M)[PASS]
    observed_m[list(outliers)] += 300.0
    parameters = ParameterSet([Parameter("offset", "m", "bias"), Parameter("drift", "m", "bias")])
    return lambda groups: fit_with_variance_components(
        lambda x: (observed_m - design @ x, design), parameters, 1.0, order=ORDER, groups=groups
    )


def test_groups_are_links_and_their_passes():
    names = [f"doppler of {path} {k}" for path in ("A>x>A", "B>x>B") for k in (1, 2)]
    assert [PASSES[k] for k in (0, 150, 250, 399)] == names
    assert by_link(ORDER).present() == ("doppler of A>x>A", "doppler of B>x>B")


def test_passes_of_few_observations_are_those_of_their_type():
    selected = np.flatnonzero((PASS != 1) | (np.arange(len(PASS)) % 20 == 0))
    reduced = SeriesOrder.from_labels(ORDER.types.select(selected), PATHS.select(selected), TIME_S[selected])
    assert set(by_link(reduced, 14400.0).present()) == {"doppler", *PASSES.present()} - {"doppler of A>x>A 2"}


def test_each_pass_is_weighed_as_its_residuals_are():
    result = drawn(1)(PASSES)
    assert result.converged
    # A sigma is known from 100 observations to 7 %
    expected_m = {
        name: np.sqrt(noise_m**2 - 1.0) for name, noise_m in zip(PASSES.texts, NOISE_M, strict=True)
    }
    for name, added_m in result.additive_sigma_m.items():
        assert added_m == pytest.approx(expected_m[name], rel=0.25, abs=0.5)


def test_a_pass_thirty_times_as_noisy_as_stated_is_not_left_out_but_outliers_are():
    assert np.flatnonzero(~drawn(2, outliers=(5, 250))(PASSES).fit.used).tolist() == [5, 250]


@pytest.fixture(scope="module")
def tracking():
    return change5_case.observations(PhysicalModel.build(), 300.0, stop="2020-12-02T03:11:00", vlbi=False)


def test_a_study_asks_for_them(tracking):
    value_m = tracking.value_m + 20.0 * np.random.default_rng(1).normal(size=len(tracking)) * (
        tracking.paths() == "KASHI>lander>KASHI"
    )
    observations = replace(tracking, value_m=value_m)
    estimate = EstimateChoice(range_bias="all", range_bias_sigma_m=10.0, variance_components="link and pass")
    solution = radioloc.locate(Study(target=change5_case.NEAR, estimate=estimate), observations)
    added = solution.fit.excess_noise_m
    noisy_ones = [size for name, size in added.items() if "KASHI>lander>KASHI" in name]
    remaining = [size for name, size in added.items() if "KASHI>lander>KASHI" not in name]
    assert min(noisy_ones) > 10.0 > 3.0 > max(remaining)
    assert solution.to_dict()["provenance"]["estimate"]["variance_components"] == "link and pass"
    assert "noise added in quadrature" in str(solution)
    quiet = radioloc.locate(Study(target=change5_case.NEAR, estimate=estimate), tracking)
    assert not any(quiet.fit.excess_noise_m.values())
    assert "variance component" not in str(quiet)
