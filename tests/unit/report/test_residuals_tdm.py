"""Residuals as Tracking Data Messages: what comes back is what was left after the fit."""

import numpy as np
import pytest

import radioloc
from radioloc.cli import main
from radioloc.errors import InputError
from radioloc.io.tdm import read_tdm_file
from radioloc.report import write_residuals_tdm

STUDY = "examples/change5/short_arc.toml"
C_M_S = 299792458.0


@pytest.fixture(scope="module")
def fitted():
    predictor, _ = radioloc.studies.arc_of(radioloc.read_study(STUDY))
    return radioloc.residuals(radioloc.read_study(STUDY)), predictor.observations


def by_path(segment):
    """The path as the library writes it, from the participants."""
    return ">".join(segment.participant(leg) for leg in segment.legs())


@pytest.mark.parametrize("ending", ["tdm", "xml"])
def test_residuals_come_back(fitted, tmp_path, ending):
    solution, observations = fitted
    rows = solution.residuals
    file = write_residuals_tdm(solution, observations, tmp_path / f"oc.{ending}", originator="TEST")
    message = read_tdm_file(file)
    assert message.header.comments == (
        f"{solution.name}: the values are residuals, observed minus computed, not observations",
    )
    found = {}
    for segment in message.segments:
        assert segment.data_comments == (
            "the values are residuals, observed minus computed, not observations",
        )
        assert segment.counts().keys() <= {"RANGE", "RECEIVE_FREQ_1", "RECEIVE_FREQ_3", "TRANSMIT_FREQ_1"}
        epochs = segment.epochs("RANGE")
        used = segment.metadata["DATA_QUALITY"] == "VALIDATED"
        for *key, value_m in zip(epochs.jd, epochs.fraction, segment.values("RANGE"), strict=True):
            found[by_path(segment), *key] = (used, value_m)
    assert len(found) == len(rows)
    for path, jd, fraction, used, residual_m in zip(
        rows.path, rows.epoch_utc.jd, rows.epoch_utc.fraction, rows.used, rows.residual_m, strict=True
    ):
        assert found[path, jd, fraction] == (used, residual_m)


def test_delays_are_in_seconds(tmp_path):
    study = radioloc.read_study("examples/change5/change5.toml")
    observations = radioloc.read_observations("examples/change5/change5.csv")
    few = observations.select(np.flatnonzero(observations.kind == 1)[:20])
    solution = radioloc.residuals(study, few)
    file = write_residuals_tdm(solution, few, tmp_path / "oc.tdm", originator="TEST")
    values = np.concatenate([segment.values("VLBI_DELAY") for segment in read_tdm_file(file).segments])
    np.testing.assert_allclose(
        np.sort(values * C_M_S), np.sort(solution.residuals.residual_m), rtol=1e-14, atol=0
    )


def test_other_observations_are_refused(fitted, tmp_path):
    solution, observations = fitted
    for others in (observations.select(slice(1, None)), observations.select(slice(None, None, -1))):
        with pytest.raises(InputError, match="not of these"):
            write_residuals_tdm(solution, others, tmp_path / "oc.tdm", originator="TEST")


def test_the_command(tmp_path, capsys):
    asked = ["residuals", STUDY, "-q", "--residuals-tdm", str(tmp_path / "oc.xml")]
    with pytest.raises(SystemExit, match="2"):
        main(asked)
    assert "--originator" in capsys.readouterr().err
    assert main([*asked, "--originator", "TEST"]) == 0
    assert sum(map(len, [read_tdm_file(tmp_path / "oc.xml")])) > 0
