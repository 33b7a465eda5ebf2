"""Residuals and solutions on disk."""

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.estimation.editing import outlier_reason
from radioloc.estimation.statistics import Residuals
from radioloc.labels import Labels
from radioloc.media import Status
from radioloc.report.files import write_content, write_json
from radioloc.results.tables import residual_table
from radioloc.time import Epochs, epochs_from_strings
from radioloc.time.dates import utc_to_text


def two_rows(**changes):
    columns = {
        "epoch_utc": epochs_from_strings(["2006-04-07T06:26:30", "2006-04-07T06:32:30.25"], "UTC"),
        "stations": Labels.from_texts(["A", "C"]),
        "types": Labels.from_texts(["range", "range"]),
        "paths": Labels.from_texts(["A>b>A", "C>b>C"]),
        "observed_m": np.array([794279926.1234567, 7.7e8]),
        "residual_m": np.array([0.0234567, -0.0]),
        "sigma_m": np.array([0.016, 1.0]),
        "elevation_deg": np.array([45.0, -1.25]),
        "statuses": Labels.from_texts(["used", "rejected"]),
    }
    return Residuals(**columns | changes)


def solution_of(count, rng):
    """Rows of several blocks: three links at each instant, some rejected by the fit and some before it."""
    residual_m, sigma_m = rng.normal(0.0, 1.0, count), rng.uniform(0.1, 2.0, count)
    used = rng.random(count) > 0.01
    residual_m[~used] *= 1e3
    reasons = list(map(outlier_reason, residual_m[~used].tolist(), sigma_m[~used].tolist()))
    codes = np.where(rng.random(count) < 0.01, 1, 0)
    codes[~used] = 2 + np.arange(len(reasons))
    statuses = Labels.coded(["used", "JIAMUSI's elevation is -1.2 deg", *reasons], codes)
    second = np.repeat(np.arange(-(-count // 3)), 3)[:count]
    observed_m = rng.uniform(-1.0, 1.0, count) * 10.0 ** rng.integers(0, 9, count)
    return Residuals(
        epoch_utc=Epochs.from_jd(2459184.5, second / 86400.0, "UTC"),
        stations=Labels.coded(["A", "C"], np.arange(count) % 2),
        types=Labels.coded(["range", "vlbi_delay"], np.arange(count) % 2),
        paths=Labels.coded(["A>b>A", "Łódź<b>C"], np.arange(count) % 2),
        observed_m=observed_m,
        residual_m=residual_m,
        sigma_m=sigma_m,
        elevation_deg=rng.uniform(-3.0, 90.0, count),
        statuses=statuses,
    )


def test_many_residuals_are_written_with_the_digits_of_each(tmp_path):
    file, rows = tmp_path / "residuals.csv", solution_of(40_000, np.random.default_rng(8))
    write_content(file, residual_table(rows))
    numbers = {"observed_m": 7, "computed_m": 7, "residual_m": 6, "sigma_m": 6, "elevation_deg": 4}
    expected = zip(
        utc_to_text(rows.epoch_utc),
        rows.type,
        rows.path,
        *([f"{x:.{decimals}f}" for x in getattr(rows, name).tolist()] for name, decimals in numbers.items()),
        rows.status,
        strict=True,
    )
    written = file.read_text(encoding="utf-8").split("\n")
    assert written[0] == "epoch_utc,type,path,observed_m,computed_m,residual_m,sigma_m,elevation_deg,status"
    assert written[1:-1] == [",".join(row) for row in expected]
    assert any("is 1" in line and "outlier" in line for line in written)


@pytest.mark.parametrize("status", [status for status in Status if status.text()])
def test_reasons_with_commas_keep_the_columns(status, tmp_path):
    write_content(
        tmp_path / "residuals.csv",
        residual_table(two_rows(statuses=Labels.from_texts(["used", status.text()]))),
    )
    [heading, *lines] = (tmp_path / "residuals.csv").read_text(encoding="utf-8").splitlines()
    assert [line.count(",") for line in lines] == [heading.count(",")] * 2
    assert lines[1].rpartition(",")[2] == status.text().replace(",", ";")


@pytest.mark.slow
def test_residuals_are_written_block_by_block(tmp_path):
    """The memory beside the columns does not grow with them."""
    rows = solution_of(200_000, np.random.default_rng(8))
    write_content(tmp_path / "warm.csv", residual_table(two_rows()))
    tracemalloc.start()
    write_content(tmp_path / "residuals.csv", residual_table(rows))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (tmp_path / "residuals.csv").stat().st_size > 2e7
    assert peak < 1.5e7


def test_json_contains_the_values(tmp_path):
    file = tmp_path / "solution.json"
    content = {
        "matrix": np.eye(2),
        "counts": [np.int64(3), np.float64(0.25), None],
        "used": np.array([True, False]),
        "nested": {"name": "Łuna ±", "pair": (1, "a"), "file": Path("a/b")},
    }
    write_json(file, content)
    assert json.loads(file.read_text(encoding="utf-8")) == {
        "matrix": [[1.0, 0.0], [0.0, 1.0]],
        "counts": [3, 0.25, None],
        "used": [True, False],
        "nested": {"name": "Łuna ±", "pair": [1, "a"], "file": "a/b"},
    }


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"a": {"b": [0.0, float("nan")]}}, r"a\.b\[1\]: expected a finite"),
        ({"a": np.float32("nan")}, "a: expected a finite"),
        ({"a": 1j}, "got a complex"),
    ],
)
def test_json_refuses_other_types_and_nan(content, words, tmp_path):
    file = tmp_path / "solution.json"
    with pytest.raises(InputError, match=words):
        write_json(file, content)
    assert not file.exists()
