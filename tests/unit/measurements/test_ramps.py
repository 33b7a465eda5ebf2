"""Ramps: frequency and cycles of a station, and what they do to Doppler and ranges."""

import dataclasses

import numpy as np
import pytest
from arc_cases import observed_at

from radioloc.constants import C_M_S
from radioloc.errors import FileFormatError, InputError
from radioloc.io import read_observations
from radioloc.io.table import read_ramps, write_ramps
from radioloc.measurements import ExactPredictor, FixedPoint, Link, Observations, Ramps, prepare_predictor
from radioloc.measurements.observations import DOPPLER, RANGE
from radioloc.time import Epochs, epochs_from_strings, tai_to_utc, utc_to_tai
from radioloc.time.dates import utc_to_text

LANDER_PA_M = np.array([1554678.949, 98094.118, 765004.906])
LANDER = FixedPoint(LANDER_PA_M)
START = epochs_from_strings(["2024-05-02T02:00:00"], "UTC")
F0_HZ = 7.2e9
COUNT_S = 60.0


def at(seconds):
    return tai_to_utc(utc_to_tai(START)[np.zeros(np.size(seconds), dtype=int)].shifted(seconds))


def ramps(*pieces, station="KASHI"):
    """Pieces of (start, stop, frequency, rate), s and Hz."""
    start, stop, frequency, rate = np.array(pieces, dtype=float).T
    return Ramps.from_columns([station] * len(pieces), at(start), at(stop), frequency, rate)


TUNED = ramps(
    (-600.0, 95.5, F0_HZ + 1000.0, 0.5), (95.5, 200.25, F0_HZ + 5e4, -3.0), (200.25, 900.0, F0_HZ - 2e4, 1.25)
)


def observations(links, kind=DOPPLER, seconds=(0.0, 60.0, 120.0, 200.0, 300.0), ramped=True, of=TUNED):
    return observed_at(
        at(np.array(seconds)),
        links,
        kind=kind,
        count_s=COUNT_S if kind == DOPPLER else np.nan,
        uplink_hz=F0_HZ,
        wavelength_um=C_M_S / 8.4e9 * 1e6,
        ramped=ramped,
        ramps=of,
    )


TWO_WAY, THREE_WAY = Link("KASHI", "lander", "KASHI"), Link("KASHI", "lander", "JIAMUSI")


def frequency_hz(seconds):
    for begin, f_hz, rate in (
        (200.25, F0_HZ - 2e4, 1.25),
        (95.5, F0_HZ + 5e4, -3.0),
        (-600.0, F0_HZ + 1000.0, 0.5),
    ):
        if seconds >= begin:
            return f_hz + rate * (seconds - begin)
    raise AssertionError


@pytest.mark.parametrize("kind", [DOPPLER, RANGE])
def test_partials_agree_with_differences(model, kind):
    predictor = ExactPredictor(model, observations([TWO_WAY], kind), LANDER)
    computed = predictor.compute()
    # Partials leave out tides and the scale of lengths on the Moon, up to 5e-7; ramps scale them by up to 7e-6.
    for axis in np.eye(3):
        step_m = 50.0 * axis
        change_m = (
            predictor.predict(FixedPoint(LANDER_PA_M + step_m)).value_m
            - predictor.predict(FixedPoint(LANDER_PA_M - step_m)).value_m
        )
        np.testing.assert_allclose(computed.by_position_pa @ axis, change_m / 100.0, rtol=0.0, atol=6e-7)
    if kind == RANGE:
        plain = ExactPredictor(model, observations([TWO_WAY], kind, ramped=False), LANDER).predict()
        scale = [frequency_hz(t - 2.6) / F0_HZ for t in (0.0, 60.0, 120.0, 200.0, 300.0)]
        expected = plain.by_position_pa * np.array(scale)[:, np.newaxis]
        np.testing.assert_allclose(computed.by_position_pa, expected, rtol=1e-9)
    shifted = [
        ExactPredictor(
            model,
            dataclasses.replace(
                predictor.observations, epoch=at(np.array([0.0, 60.0, 120.0, 200.0, 300.0]) + shift_s)
            ),
            LANDER,
        ).predict()
        for shift_s in (-0.05, 0.05)
    ]
    # Media's delays change with the tag as well as the path.
    np.testing.assert_allclose(
        (shifted[1].value_m - shifted[0].value_m) / 0.1, computed.by_time_m_s, rtol=1e-6, atol=2e-5
    )


def test_transmissions_in_a_gap_or_outside_the_ramps_are_unusable(model):
    gappy = ramps((-600.0, 40.0, F0_HZ, 0.0), (70.0, 280.0, F0_HZ, 0.0))
    predictor = prepare_predictor(model, observations([TWO_WAY], of=gappy), LANDER)
    assert predictor.compute().usable.tolist() == [True, False, True, True, False]
    of_other_station = dataclasses.replace(gappy, stations=("JIAMUSI",))
    predictor = prepare_predictor(model, observations([TWO_WAY], of=of_other_station), LANDER)
    assert not predictor.compute().usable.any()


def test_overlapping_tables_are_joined_and_contradictions_are_named():
    halves = [ramps((0.0, 100.0, F0_HZ, 1.0)), ramps((60.0, 300.0, F0_HZ + 60.0, 1.0))]
    joined = Ramps.concatenate(halves)
    assert (len(joined), joined.duration_s.tolist()) == (1, [pytest.approx(300.0)])
    with pytest.raises(InputError, match=r"2024-05-02T02:01:00\S* UTC"):
        Ramps.concatenate([halves[0], ramps((60.0, 300.0, F0_HZ, 1.0))])
    with pytest.raises(InputError, match=r"over -1 s"):
        ramps((0.0, -1.0, F0_HZ, 0.0))


def test_epochs_in_utc_are_rounded_to_microseconds():
    """Conversion between UTC and TAI keeps full microseconds, also on a day with a leap second."""
    microseconds = np.random.default_rng(1).integers(0, 86400 * 10**6, 2000)
    start, stop = (
        Epochs.from_jd(np.full(2000, jd), microseconds / (1e6 * length_s), "UTC")
        for jd, length_s in ((2457753.5, 86401), (2457754.5, 86400))
    )
    written = Ramps.from_columns(
        [f"S{k}" for k in range(2000)], start, stop, np.full(2000, 2e9), np.zeros(2000)
    )
    for utc in (written.start_utc, written.stop_utc):
        assert {text[-6:] for text in utc_to_text(utc)} == {"000000"}


def test_observations_keep_their_ramps_and_need_a_reference_frequency():
    joined = Observations.concatenate([observations([TWO_WAY]), observations([TWO_WAY], seconds=[600.0])])
    assert len(joined.ramps) == 3
    assert joined[:2].ramps is joined.ramps
    assert joined.ramped.all()
    with pytest.raises(InputError, match="ramped: expected a reference"):
        observed_at(START, TWO_WAY, kind=DOPPLER, count_s=1.0, ramped=True)
    with pytest.raises(InputError, match="two-way ranges"):
        observations([THREE_WAY], RANGE)


def test_round_trip_of_ramps_and_observations(tmp_path, model):
    from radioloc.io import write_table

    original = observations([TWO_WAY])
    write_table(tmp_path / "doppler.csv", original)
    write_ramps(tmp_path / "ramps.csv", original.ramps)
    back = read_observations([tmp_path / "doppler.csv", tmp_path / "ramps.csv"], lunar=False)
    assert back.ramped.all()
    for name in ("frequency_hz", "rate_hz_s", "station"):
        assert getattr(back.ramps, name).tolist() == getattr(original.ramps, name).tolist()
    np.testing.assert_allclose(back.ramps.duration_s, original.ramps.duration_s, rtol=0.0, atol=1e-9)
    values = [prepare_predictor(model, obs, LANDER).compute().value_m for obs in (original, back)]
    np.testing.assert_allclose(values[0], values[1], rtol=0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("KASHI,2024-05-02T06:00:00,2024-05-02T06:10:00,7.2e9", "line 2: has 4 fields, but the header has 5"),
        ("KASHI,2024-13-02T06:00:00,2024-05-02T06:10:00,7.2e9,0", "line 2: "),
    ],
)
def test_damaged_table_of_ramps(tmp_path, line, message):
    path = tmp_path / "ramps.csv"
    path.write_text(f"station,start_utc,stop_utc,frequency_hz,rate_hz_s\n{line}\n")
    with pytest.raises(FileFormatError, match=message):
        read_ramps(path)
