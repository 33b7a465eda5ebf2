"""Example of a lander tracked by the Deep Space Network: its file is what the script makes, its study finds it."""

import dsn_pass
import numpy as np
import pytest
from odf_files import taken_apart
from paths import EXAMPLES

import radioloc
from radioloc.jobs.locate import fit_arc
from radioloc.jobs.preparation import prepared_arc

EXAMPLE = EXAMPLES / "dsn"

REVISED_HZ = 1e-3
"""Revised Earth orientation would move the stations by some centimetres a day."""


def value(record):
    signed = [record[name] - 2**32 * (record[name] >= 2**31) for name in ("observable", "observable_1e9")]
    return signed[0] + 1e-9 * signed[1]


def test_the_file_is_what_the_script_makes(tmp_path):
    dsn_pass.main(tmp_path)
    simulated, shipped = (taken_apart((folder / "lander.odf").read_bytes()) for folder in (tmp_path, EXAMPLE))
    assert simulated[1] == shipped[1]
    assert len(simulated[0]) == len(shipped[0])
    for item, second in zip(simulated[0], shipped[0], strict=True):
        common = {"observable", "observable_1e9"}
        assert {k: v for k, v in item.items() if k not in common} == {
            k: v for k, v in second.items() if k not in common
        }
        assert abs(value(item) - value(second)) < (REVISED_HZ if item["type"] != 37 else 1.0)


def test_what_was_put_in_is_found():
    study = radioloc.read_study(EXAMPLE / "lander.toml")
    arc, left_out = prepared_arc(study)
    assert left_out == {"left over from averages of Doppler over 60 s": 6}
    solution = fit_arc(study, arc, left_out, study.estimate)
    assert solution.converged
    content = solution.to_dict()
    assert content["reference"]["combined_sigmas"] < 3.0
    assert content["reference"]["distance_m"] < 10.0
    [frequency] = [item for item in content["parameters"] if item["name"].startswith("target_frequency")]
    assert frequency["value"] == pytest.approx(dsn_pass.OSCILLATOR, abs=4.0 * frequency["sigma"])
    # Sums of six counts of 10 s with 1.3 mHz of noise, by X band: 1.1 mm; ranges 2 m.
    residuals = solution.residuals
    for kind, rms_m in (("doppler", 1.13e-3), ("one_way_doppler", 1.13e-3), ("range", 2.0)):
        rows = residuals.type == kind
        assert residuals.used[rows].all()
        assert np.sqrt(np.mean(residuals.residual_m[rows] ** 2)) == pytest.approx(rms_m, rel=0.25)
