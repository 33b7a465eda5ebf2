"""Ramped Doppler as messages and back: the same residuals, whatever the reference frequency."""

import numpy as np
import pytest
from tdm_messages import kvn

from radioloc.constants import C_M_S
from radioloc.errors import InputError
from radioloc.io import TdmAgreement, read_tdm, write_tdm
from radioloc.lunar.position import LunarPosition
from radioloc.measurements import ExactPredictor, FixedPoint, Link, Ramps
from radioloc.measurements.observations import DOPPLER, RANGE, Observations
from radioloc.measurements.registry import KINDS
from radioloc.time import epochs_from_strings

LANDER_PA_M = LunarPosition.from_selenographic(-51.9, 43.0, -2550.0, "ME_DE421").to_frame("PA_DE421").xyz_m
REFERENCE_HZ, DOWN_HZ, COUNT_S = 7.2e9, 8.4592790387e9, 60.0
# A growth in metres is 1e-16 of 60 light-seconds, for each rounding of a frequency.
TOLERANCE_M = 1e-5


def ramps():
    minutes = range(13 * 60 + 50, 14 * 60 + 20, 10)
    dates = [f"2021-03-28T{m // 60:02d}:{m % 60:02d}:00" for m in [*minutes, minutes.stop]]
    ends = epochs_from_strings(dates, "UTC")
    return Ramps.from_columns(
        ["KASHI"] * 3, ends[:-1], ends[1:], REFERENCE_HZ + np.array([0.0, 900.0, 300.0]), [1.5, -1.0, 0.25]
    )


def counts(**changes):
    columns = {
        "epoch": epochs_from_strings([f"2021-03-28T14:{minute:02d}:30" for minute in range(15)], "UTC"),
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


def computed(model, observations):
    return ExactPredictor(model, observations, FixedPoint(LANDER_PA_M)).compute()


def test_round_trip_of_ramped_doppler(model, tmp_path):
    modelled = computed(model, counts())
    assert (modelled.status == 0).all()
    noise_m = np.random.default_rng(3).normal(0.0, 0.01, 15)
    observed = counts(value_m=modelled.value_m + noise_m)
    # Cycles of the ramps are kilometres beyond the growth of the path.
    assert np.abs(np.diff(observed.value_m)).max() > 1e3
    write_tdm(tmp_path / "a.kvn", observed, originator="TEST")
    assert (tmp_path / "a.kvn").read_text().count("TURNAROUND_NUMERATOR") in (2, 4)
    read = read_tdm(tmp_path / "a.kvn", TdmAgreement(sigma_m={"doppler": 1e-3}))
    assert read.ramped.all()
    assert set(read.paths()) == set(observed.paths())
    order = np.argsort(read.epoch.fraction)
    residual_m = (read.value_m - computed(model, read).value_m)[order]
    assert np.abs(residual_m - noise_m).max() < TOLERANCE_M


def test_the_same_by_another_reference_frequency(model, tmp_path):
    """Values read are in metres by the first frequency of the message, whatever the written reference."""
    shifted = counts(uplink_hz=REFERENCE_HZ + 12345.0)
    observed = counts(uplink_hz=REFERENCE_HZ + 12345.0, value_m=computed(model, shifted).value_m)
    write_tdm(tmp_path / "a.kvn", observed, originator="TEST")
    read = read_tdm(tmp_path / "a.kvn", TdmAgreement(sigma_m={"doppler": 1e-3}))
    assert set(read.uplink_hz) == {REFERENCE_HZ}
    assert np.abs(read.value_m - computed(model, read).value_m).max() < TOLERANCE_M


def test_round_trip_of_ramped_ranges(model, tmp_path):
    """Ranges are in units of a nanosecond at the first frequency, ambiguous by a modulus."""
    ranges = counts(kind=RANGE, link=0, count_s=np.nan, value_m=7.7e8, modulus_m=3e5)
    modelled_m = computed(model, ranges).value_m
    observed = counts(kind=RANGE, link=0, count_s=np.nan, value_m=modelled_m % 3e5, modulus_m=3e5)
    write_tdm(tmp_path / "a.kvn", observed, originator="TEST")
    text = (tmp_path / "a.kvn").read_text()
    assert "RANGE_UNITS = RU" in text
    assert text.count("TRANSMIT_FREQ_RATE_1 = ") == 3
    read = read_tdm(tmp_path / "a.kvn", TdmAgreement(sigma_m={"range": 1.0}, range_unit_s=1e-9))
    assert read.ramped.all()
    off_m = computed(model, read).value_m - read.value_m
    assert np.abs(off_m - read.modulus_m * np.rint(off_m / read.modulus_m)).max() < TOLERANCE_M


BEACON_HZ, STEP_HZ = 8.4592790387e9, 5000.0


def heard_hz(model):
    """Return the received frequency offset of a lander that sends 5 kHz more from 14:07:00 on."""
    of_beacon = {"links": [Link("", "lander", "KASHI")], "link": 0, "uplink_hz": np.nan}
    of_beacon |= {"wavelength_um": 1e6 * C_M_S / BEACON_HZ, "ramped": False, "ramps": None}
    growth_m = computed(model, counts(kind=KINDS.index("one_way_doppler"), **of_beacon)).value_m
    ranges = counts(kind=KINDS.index("one_way_range"), **of_beacon | {"count_s": np.nan, "value_m": 3.8e8})
    light_s = computed(model, ranges).value_m[7] / C_M_S
    minute = np.arange(15)  # counts last from 14:mm:00 to the next minute
    part = np.select([minute < 7, minute == 7], [0.0, 1.0 - light_s / COUNT_S], 1.0)
    return STEP_HZ * part - (BEACON_HZ + STEP_HZ * part) * growth_m / (C_M_S * COUNT_S)


def test_a_beacon_that_changes_its_frequency(model, tmp_path):
    metadata = {
        "TIME_SYSTEM": "UTC",
        "PARTICIPANT_1": "KASHI",
        "PARTICIPANT_2": "lander",
        "MODE": "SEQUENTIAL",
        "PATH": "2,1",
        "INTEGRATION_INTERVAL": "60",
        "INTEGRATION_REF": "MIDDLE",
        "FREQ_OFFSET": repr(BEACON_HZ),
    }
    sent = [
        f"TRANSMIT_FREQ_2 = 2021-03-28T13:50:00 {BEACON_HZ!r}",
        f"TRANSMIT_FREQ_2 = 2021-03-28T14:07:00 {BEACON_HZ + STEP_HZ!r}",
    ]
    received = [
        f"RECEIVE_FREQ_1 = 2021-03-28T14:{m:02d}:30 {hz!r}" for m, hz in enumerate(heard_hz(model).tolist())
    ]
    (tmp_path / "a.kvn").write_text("\n".join(kvn((metadata, [*sent, *received]))) + "\n")
    agreement = TdmAgreement(sigma_m={"one_way_doppler": 1e-3})
    read = read_tdm(tmp_path / "a.kvn", agreement)
    assert read.ramped.all()
    modelled = computed(model, read)
    assert (modelled.status == 0).all()
    residual_m = read.value_m - modelled.value_m
    complete = np.arange(15) != 7
    assert np.abs(residual_m[complete]).max() < TOLERANCE_M
    # In half a minute the light time grows by 30 microseconds.
    assert abs(residual_m[7]) < STEP_HZ * 1e-4 * C_M_S / BEACON_HZ
    write_tdm(tmp_path / "b.kvn", read, originator="TEST")
    reread = read_tdm(tmp_path / "b.kvn", agreement)
    np.testing.assert_allclose(reread.value_m - computed(model, reread).value_m, residual_m, atol=TOLERANCE_M)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"ramps": Ramps.empty()}, "ramp of KASHI"),
        ({"wavelength_um": np.nan}, "frequencies down"),
        ({"wavelength_um": 41000.0}, "frequencies down"),
    ],
)
def test_ramped_counts_without_ramps_or_bands_are_refused(changes, problem, tmp_path):
    with pytest.raises(InputError, match=problem):
        write_tdm(tmp_path / "a.kvn", counts(**changes), originator="TEST")
