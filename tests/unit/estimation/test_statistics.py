import numpy as np
import pytest

from radioloc.estimation.statistics import chi2_quantile, group_statistics, statistics_by

# Quantiles of 95 % and 99.9 % as scipy.stats.chi2.ppf gives them.
CHI2 = {
    1: (3.841458820694124, 10.827566170662733),
    5: (11.070497693516351, 20.515005652432873),
    20: (31.410432844230918, 45.31474661812586),
    200: (233.99426889232492, 267.5405278227572),
    10000: (10233.748897677937, 10442.730565410178),
}


@pytest.mark.parametrize("dof", CHI2)
def test_chi2_quantile_against_scipy(dof):
    q95, q999 = CHI2[dof]
    assert chi2_quantile(0.95, dof) == pytest.approx(q95, rel=1e-12)
    assert chi2_quantile(0.999, dof) == pytest.approx(q999, rel=1e-12)


def test_group_statistics_by_hand():
    group = group_statistics(
        "A", np.array([1.0, -3.0, 100.0]), np.array([1.0, 2.0, 1.0]), np.array([True, True, False])
    )
    assert (group.label, group.used, group.rejected) == ("A", 2, 1)
    assert group.mean_m == -1.0
    assert group.rms_m == pytest.approx(5.0**0.5)
    assert group.wrms_m == pytest.approx(((1.0 + 9.0 / 4.0) / 1.25) ** 0.5)


def test_group_without_used_observations_has_no_numbers():
    group = group_statistics("A", np.array([1.0]), np.array([1.0]), np.array([False]))
    assert (group.used, group.rejected, group.mean_m, group.rms_m, group.wrms_m) == (0, 1, None, None, None)


def test_groups_are_sorted_and_complete():
    labels = ["B", "A", "B", "C"]
    groups = statistics_by(labels, np.arange(4.0), np.ones(4), np.array([True, True, False, True]))
    assert [(group.label, group.used, group.rejected) for group in groups] == [
        ("A", 1, 0),
        ("B", 1, 1),
        ("C", 1, 0),
    ]
