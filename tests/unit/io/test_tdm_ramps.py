"""Ramped Doppler as messages and back: the same residuals, whatever the reference frequency."""

import numpy as np
import pytest

from radioloc.constants import C_M_S
from radioloc.errors import InputError
from radioloc.io import TdmAgreement, read_tdm, write_tdm
from radioloc.lunar.position import LunarPosition
from radioloc.measurements import ExactPredictor, PhysicalModel, Ramps
from radioloc.measurements.link import Link
from radioloc.measurements.observations import DOPPLER, RANGE, Observations
from radioloc.time import epochs_from_strings

LANDER_PA_M = LunarPosition.from_selenographic(-51.9, 43.0, -2550.0, "ME_DE421").to_frame("PA_DE421").xyz_m
REFERENCE_HZ, DOWN_HZ, COUNT_S = 7.2e9, 8.4592790387e9, 60.0
# A growth in metres is 1e-16 of 60 light-seconds, for each rounding of a frequency.
TOLERANCE_M = 1e-5


def ramps():
    minutes = range(13 * 60 + 50, 14 * 60 + 20, 10)
    dates = [f"2021-03-28T{m // 60:02d}:{m % 60:02d}:00" for m in [*minutes, minutes.stop]]
    ends = epochs_from_strings(dates)
    return Ramps.of(
        ["KASHI"] * 3, ends[:-1], ends[1:], REFERENCE_HZ + np.array([0.0, 900.0, 300.0]), [1.5, -1.0, 0.25]
    )


def counts(**changes):
    columns = {
        "epoch": epochs_from_strings([f"2021-03-28T14:{minute:02d}:30" for minute in range(15)]),
        "links": [Link("KASHI", "lander", "KASHI"), Link("KASHI", "lander", "JIAMUSI")],
        "link": np.arange(15) % 2,
        "kind": DOPPLER,
        "tag": 1,
        "value_m": 0.0,
        "sigma_m": 1e-3,
        "count_s": COUNT_S,
        "uplink_hz": REFERENCE_HZ,
        "wavelength_um": 1e6 * C_M_S / DOWN_HZ,
        "ramped": True,
        "ramps": ramps(),
    }
    return Observations.from_columns(**columns | changes)


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build()


def computed(model, observations):
    return ExactPredictor(model, observations, LANDER_PA_M).compute(LANDER_PA_M)


@pytest.mark.parametrize("suffix", ["kvn", "xml"])
def test_ramped_doppler_there_and_back(suffix, model, tmp_path):
    modelled = computed(model, counts())
    assert (modelled.status == 0).all()
    noise_m = np.random.default_rng(3).normal(0.0, 0.01, 15)
    observed = counts(value_m=modelled.value_m + noise_m)
    # Cycles of the ramps are kilometres beyond the growth of the path.
    assert np.abs(np.diff(observed.value_m)).max() > 1e3
    write_tdm(tmp_path / f"a.{suffix}", observed, originator="TEST")
    text = (tmp_path / f"a.{suffix}").read_text()
    assert text.count("TURNAROUND_NUMERATOR") in (2, 4)
    read = read_tdm(tmp_path / f"a.{suffix}", TdmAgreement(sigma_m={"doppler": 1e-3}))
    assert read.ramped.all()
    assert set(read.paths()) == set(observed.paths())
    order = np.argsort(read.epoch.fraction)
    residual_m = (read.value_m - computed(model, read).value_m)[order]
    assert np.abs(residual_m - noise_m).max() < TOLERANCE_M


def test_the_same_by_another_reference_frequency(model, tmp_path):
    """What is read is in metres by the first frequency of the message, whatever it was before."""
    other = counts(uplink_hz=REFERENCE_HZ + 12345.0)
    observed = counts(uplink_hz=REFERENCE_HZ + 12345.0, value_m=computed(model, other).value_m)
    write_tdm(tmp_path / "a.kvn", observed, originator="TEST")
    read = read_tdm(tmp_path / "a.kvn", TdmAgreement(sigma_m={"doppler": 1e-3}))
    assert set(read.uplink_hz) == {REFERENCE_HZ}
    assert np.abs(read.value_m - computed(model, read).value_m).max() < TOLERANCE_M


def test_ambiguous_ranges_there_and_back(tmp_path):
    ranges = Observations.from_columns(
        epoch=epochs_from_strings(["2021-03-28T14:00:00", "2021-03-28T14:01:00"]),
        links=[Link("KASHI", "lander", "KASHI")],
        kind=RANGE,
        tag=1,
        value_m=[801500.0, 400.0],
        sigma_m=1.0,
        modulus_m=[1e6, 5e5],
    )
    write_tdm(tmp_path / "a.kvn", ranges, originator="TEST")
    read = read_tdm(tmp_path / "a.kvn", TdmAgreement(sigma_m={"range": 1.0}))
    assert sorted(zip(read.value_m, read.modulus_m, strict=True)) == [(400.0, 5e5), (801500.0, 1e6)]


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        (
            {"ramps": Ramps.none()},
            "KASHI>lander>KASHI: there is no ramp of what KASHI sent by in memory, line 1",
        ),
        ({"wavelength_um": np.nan}, "line 1: the frequency down is not recorded; use write_table"),
        ({"wavelength_um": 41000.0}, "1.01.* times that up, no ratio of S, X and Ka band"),
        (
            {"kind": RANGE, "link": 0, "count_s": np.nan, "value_m": 7.7e8},
            "is a range in cycles of a changing frequency; use write_table",
        ),
    ],
)
def test_what_a_message_cannot_hold(changes, problem, tmp_path):
    with pytest.raises(InputError, match=problem):
        write_tdm(tmp_path / "a.kvn", counts(**changes), originator="TEST")
