"""Ambiguous ranges: the multiple of the modulus is the one nearest to the predicted range."""

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.io import write_table
from radioloc.jobs import preparation
from radioloc.jobs.preparation import without_ambiguity
from radioloc.measurements import Link, Observations
from radioloc.study.study_file import read_study
from radioloc.time import epochs_from_strings

MODULUS_M = 293000.0
STUDY = """\
[target]
longitude_deg = {longitude_deg}
latitude_deg = 43.06
height_m = -2500.0
[observations]
files = ["ranges.csv"]
"""


def ranges(value_m, **changes):
    value_m = np.asarray(value_m, dtype=np.float64)
    columns = {
        "epoch": epochs_from_strings(
            [f"2020-12-02T15:{k // 60:02d}:{k % 60:02d}" for k in range(len(value_m))], "UTC"
        ),
        "links": [Link("KASHI", "lander", "KASHI")],
        "tag": "receive",
        "sigma_m": 1.0,
        "modulus_m": MODULUS_M,
        "uplink_hz": 7.2e9,
    }
    return Observations.from_columns(value_m=value_m, **(columns | changes))


def test_full_ranges_are_recovered_from_ambiguous_ones():
    full_m = 7.6e8 + 1000.123 * np.arange(40.0)
    error_m = np.linspace(-0.2, 0.2, 40) * MODULUS_M
    resolved = without_ambiguity(ranges(full_m % MODULUS_M), full_m + error_m)
    np.testing.assert_allclose(resolved.value_m, full_m, rtol=0.0, atol=1e-6)
    assert np.isnan(resolved.modulus_m).all()


def test_other_observations_are_unchanged_and_gross_errors_are_left_to_editing():
    full_m = np.full(20, 7.6e8)
    ambiguous_m = full_m % MODULUS_M
    ambiguous_m[3] += 0.4 * MODULUS_M
    mixed = Observations.concatenate(
        [
            ranges(ambiguous_m),
            ranges([7.7e8], modulus_m=np.nan),
            ranges([9.0], kind="doppler", count_s=1.0, modulus_m=np.nan),
        ]
    )
    resolved = without_ambiguity(mixed, np.append(full_m, [7.6e8, np.nan]))
    assert resolved.value_m[-2:].tolist() == [7.7e8, 9.0]
    assert resolved.value_m[3] - 7.6e8 == pytest.approx(0.4 * MODULUS_M, abs=1e-6)
    assert np.delete(resolved.value_m, [3, 20, 21]) == pytest.approx(7.6e8, abs=1e-6)


def test_prediction_errors_above_a_quarter_of_the_modulus_are_refused():
    with pytest.raises(InputError, match=r"1:.*87900.*9.*9"):
        without_ambiguity(ranges(np.full(9, 1000.0)), np.full(9, 1000.0 + 0.3 * MODULUS_M))


def test_ambiguous_ranges_of_a_study(tmp_path):
    """Ranges of the model, reduced to less than the modulus, are recovered with a position that is 1 km off."""
    path = tmp_path / "study.toml"
    path.write_text(STUDY.format(longitude_deg=-51.92))
    write_table(tmp_path / "ranges.csv", ranges(np.full(20, 7.6e8), modulus_m=np.nan))
    arc = preparation.prepare_arc(path)
    full_m = arc.compute().value_m
    write_table(tmp_path / "ranges.csv", ranges(full_m % MODULUS_M))
    path.write_text(STUDY.format(longitude_deg=-51.97))
    arc, _ = preparation.prepared_arc(read_study(path))
    np.testing.assert_allclose(arc.observations.value_m, full_m, rtol=0.0, atol=1e-6)
    path.write_text(STUDY.format(longitude_deg=-20.0))
    with pytest.raises(InputError, match=r"ranges.csv, line 2"):
        preparation.prepared_arc(read_study(path))
