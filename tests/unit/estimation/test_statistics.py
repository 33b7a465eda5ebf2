from dataclasses import replace

import numpy as np
import pytest

from radioloc.errors import ConvergenceError, InputError
from radioloc.estimation.statistics import Residuals, chi2_quantile, root_between
from radioloc.labels import Labels
from radioloc.time import Epochs

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


def residuals(residual_m, sigma_m, used):
    n = len(used)
    labels = Labels.from_texts(["A"] * n)
    statuses = Labels.from_texts(np.where(used, "used", "outlier"))
    epochs = Epochs.from_jd(2459185.5, np.zeros(n), "UTC")
    return Residuals(epochs, labels, labels, labels, np.zeros(n), residual_m, sigma_m, statuses)


def test_group_statistics_by_hand():
    group = residuals([1.0, -3.0, 100.0], [1.0, 2.0, 1.0], [True, True, False]).statistics("A")
    assert (group.label, group.used, group.rejected) == ("A", 2, 1)
    assert group.mean_m == -1.0
    assert group.rms_m == pytest.approx(5.0**0.5)
    assert group.wrms_m == pytest.approx(((1.0 + 9.0 / 4.0) / 1.25) ** 0.5)


@pytest.mark.parametrize("elevation_deg", [None, np.array([10.0, 20.0, 30.0])])
def test_selected_rows_keep_all_that_is_told_of_them(elevation_deg):
    residuals = Residuals(
        Epochs.from_jd(2459185.5, np.array([0.1, 0.2, 0.3]), "UTC"),
        *(Labels.from_texts([f"{column}{k}" for k in range(3)]) for column in ("station", "type", "path")),
        *(np.array([1.0, 2.0, 3.0]) * size for size in (1e8, 1.0, 0.1)),
        Labels.from_texts(["used", "outlier", "used"]),
        elevation_deg,
    )
    part = residuals.select([2, 1])
    assert len(part) == 2
    assert part.epoch_utc.fraction.tolist() == [0.3, 0.2]
    assert (part.station[0], part.type[0], part.path[0]) == ("station2", "type2", "path2")
    assert part.computed_m.tolist() == [3e8 - 3.0, 2e8 - 2.0]
    assert part.sigma_m.tolist() == residuals.sigma_m[[2, 1]].tolist()
    assert part.used.tolist() == [True, False]
    assert (
        part.elevation_deg is None if elevation_deg is None else part.elevation_deg.tolist() == [30.0, 20.0]
    )
    assert ("elevation_deg" in part.to_table().colnames) == (elevation_deg is not None)
    with pytest.raises(InputError, match=r"sigma_m.*1.*3"):
        replace(residuals, sigma_m=np.ones(1))


def test_rejected_observations_are_counted_by_reason_and_pass():
    n = 4000
    hour = np.where(np.arange(n) < n // 2, 0.0, 12.0) + np.arange(n) / n
    elevation = [f"below the horizon ({-k / n:.3f} deg)" for k in range(n - 1)]
    labels = Labels.from_texts(["KASHI>lander>KASHI"] * n)
    residual_m = np.arange(n) * 1.0
    rows = Residuals(
        Epochs.from_jd(2459185.5, hour / 24.0, "UTC"),
        *(labels,) * 3,
        *(np.zeros(n), residual_m, np.ones(n)),
        Labels.from_texts([*elevation, "outlier: 9 m is 9 times its expected 1 m"]),
    )
    first, second, outlier = rows.rejected()
    assert [group["count"] for group in (first, second, outlier)] == [n // 2, n // 2 - 1, 1]
    assert first["reason"] == second["reason"] == "below the horizon"
    assert first["last_utc"] < second["first_utc"]
    assert [item["residual_m"] for item in first["largest"]] == [n / 2 - 1.0, n / 2 - 2.0, n / 2 - 3.0]
    assert outlier["largest"][0]["reason"].startswith("outlier: 9 m")


@pytest.mark.parametrize(
    ("function", "low", "high", "root"),
    [
        (np.cos, 0.0, 3.0, 0.5 * np.pi),
        (lambda x: x**3 - 8.0, -1.0, 50.0, 2.0),
        (lambda x: 100.0 / (1e-6 + x**2) - 1.0, 0.0, 1e3, np.sqrt(100.0 - 1e-6)),
        (lambda x: x - 1.0, 0.0, 2.0, 1.0),
    ],
)
def test_root_between_two_arguments(function, low, high, root):
    assert root_between(function, low, high, 1e-12) == pytest.approx(root, abs=1e-11)


def test_a_function_without_numbers_has_no_root():
    with pytest.raises(ConvergenceError):
        root_between(lambda x: np.nan, 0.0, 1.0, 1e-12)
