"""Observations from messages: every keyword that changes a value or a time tag, and refusals."""

import numpy as np
import pytest
from tdm_messages import DELAY, RANGES, THREE_WAY, TWO_WAY, kvn

from radioloc.constants import C_M_S
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import FileFormatError, InputError
from radioloc.io.tdm import TdmAgreement, tdm_observations
from radioloc.io.tdm.kvn import parse_kvn
from radioloc.lunar.position import LunarPosition
from radioloc.measurements import ExactPredictor, FixedPoint, Link, PhysicalModel
from radioloc.measurements.equipment_delays import EquipmentDelays, StationDelay
from radioloc.media.medium import Status
from radioloc.time import epochs_from_strings, utc_to_tai

SIGMA_M = {
    "range": 2.0,
    "vlbi_delay": 0.3,
    "doppler": 1e-3,
    "one_way_range": 0.7,
    "one_way_doppler": 2e-3,
    "differenced_range": 0.2,
    "differenced_doppler": 3e-3,
}
VALUE_TOLERANCE_M = 5e-7  # some floats of 7.7e8 m
GROWTH_TOLERANCE_M = 8e-6  # a ratio of frequencies rounded four times (1e-16 each), times 60 light-seconds
EPOCH_TOLERANCE_S = 3e-11  # a float of the day's fraction, moved once


def readout(*segments, catalogue=None, path="a.kvn", **agreement):
    message = parse_kvn(path, kvn(*segments))
    agreement = TdmAgreement(**({"sigma_m": SIGMA_M} | agreement))
    return tdm_observations(message, agreement, catalogue=catalogue)


def read(*segments, **options):
    return readout(*segments, **options).observations


def seconds_after(observations, text):
    return utc_to_tai(observations.epoch).seconds_since(utc_to_tai(epochs_from_strings(text, "UTC")))


# Ranges


def test_three_way_range_and_catalogue_names():
    metadata = THREE_WAY | {"PARTICIPANT_1": "ks", "PARTICIPANT_2": "Apollo 15", "TIMETAG_REF": "transmit"}
    got = read((metadata, RANGES), catalogue=StationCatalogue.default())
    assert got.links == (Link("KASHI", "apollo15", "JIAMUSI"),)
    assert got.tags().tolist() == ["transmit"] * 2


def test_all_types_without_a_sigma_are_named_at_once():
    doppler = (TWO_WAY | COUNT, ["DOPPLER_INTEGRATED = 2021-03-28T14:00:00 0.5"])
    with pytest.raises(FileFormatError, match=r"--sigma range=.* --sigma doppler="):
        readout((TWO_WAY, RANGES), doppler, sigma_m={})


def test_units_of_range():
    flight_s = ["RANGE = 2021-03-28T14:00:00 2.5644"]
    assert read((TWO_WAY | {"RANGE_UNITS": "s"}, flight_s)).value_m[0] == C_M_S * 2.5644
    units = ["RANGE = 2021-03-28T14:00:00 2564400"]
    unit = TWO_WAY | {"RANGE_UNITS": "RU"}
    got = read((unit, units), range_unit_s=1e-6)
    assert abs(got.value_m[0] - C_M_S * 2.5644) < VALUE_TOLERANCE_M
    with pytest.raises(FileFormatError, match=r"RANGE_UNITS.*RU,.*range_unit_s"):
        read((unit, units))
    ramp = ["TRANSMIT_FREQ_1 = 2021-03-28T14:00:00 7.1e9", "TRANSMIT_FREQ_1 = 2021-03-28T14:00:01 7.2e9"]
    # With the frequency the unit changes: cycles, in metres by its length at the first.
    cycles = read((unit, [*units, *ramp]), range_unit_s=1e-6)
    assert cycles.value_m[0] == got.value_m[0]
    assert (cycles.ramped[0], cycles.uplink_hz[0], len(cycles.ramps)) == (True, 7.1e9, 1)


def test_the_other_convention_is_recognized_by_its_factor_of_two():
    half = ["RANGE = 2021-03-28T14:00:00 384400.5"]
    with pytest.raises(FileFormatError, match=r'12:.*tdm_range.*"half"'):
        read((TWO_WAY, half))
    with pytest.raises(FileFormatError, match=r'tdm_range.*"round_trip"'):
        read((TWO_WAY, RANGES), range_convention="half")


DELAYS = {
    f"{way}_DELAY_{n}": s
    for way, n, s in zip(
        ("TRANSMIT", "RECEIVE") * 2, (1, 1, 2, 2), ("1e-6", "2e-6", "4e-6", "8e-6"), strict=True
    )
}


def test_delays_are_taken_off_value_and_time_tag():
    got = readout((TWO_WAY | DELAYS, RANGES))
    assert (
        np.abs(got.observations.value_m - (np.array([768800123.4567, 768801500.0]) - C_M_S * 15e-6)).max()
        < VALUE_TOLERANCE_M
    )
    assert abs(seconds_after(got.observations, "2021-03-28T14:00:00.25")[0] + 2e-6) < EPOCH_TOLERANCE_S
    assert any("delay of 1.5e-05 s" in note for note in got.notes)
    sent = read((TWO_WAY | DELAYS | {"TIMETAG_REF": "TRANSMIT"}, RANGES))
    assert abs(seconds_after(sent, "2021-03-28T14:00:00.25")[0] - 1e-6) < EPOCH_TOLERANCE_S
    removed = read((TWO_WAY | DELAYS, RANGES), delays_removed=True)
    assert removed.value_m.tolist() == [768800123.4567, 768801500.0]
    assert seconds_after(removed, "2021-03-28T14:00:00.25")[0] == 0.0


def test_delays_that_the_model_has_stay_in_the_data():
    station = TWO_WAY["PARTICIPANT_1"]
    for modelled, off_s, tag_off_s in (
        (EquipmentDelays(5e-6), 3e-6, 2e-6),
        (EquipmentDelays(stations={station: StationDelay(receive_s=0.0)}), 13e-6, 0.0),
        (EquipmentDelays(0.0, {station: StationDelay(1e-7, 1e-7)}), 0.0, 0.0),
    ):
        got = readout((TWO_WAY | DELAYS, RANGES), modelled=modelled)
        expected_m = np.array([768800123.4567, 768801500.0]) - C_M_S * off_s
        assert np.abs(got.observations.value_m - expected_m).max() < VALUE_TOLERANCE_M
        moved_s = seconds_after(got.observations, "2021-03-28T14:00:00.25")[0]
        assert abs(moved_s + tag_off_s) < EPOCH_TOLERANCE_S
        assert any("stays in the data" in note for note in got.notes)


# One-way

ONE_WAY = TWO_WAY | {"PATH": "2,1"}
ONE_WAY_RANGES = ["RANGE = 2021-03-28T14:00:00 384400.5"]


def test_one_way_range():
    got = read((ONE_WAY, ONE_WAY_RANGES), catalogue=StationCatalogue.default(), range_convention="half")
    assert got.links == (Link("", "lander", "KASHI"),)
    assert got.types().tolist() == ["one_way_range"]
    assert got.value_m.tolist() == [384400500.0]
    assert got.sigma_m.tolist() == [0.7]
    assert read((ONE_WAY | {"TIMETAG_REF": "TRANSMIT"}, ONE_WAY_RANGES)).tags().tolist() == ["transmit"]
    one_way_problem = "RANGE is 768800 km one way, but between Earth and Moon it is 329772 to 419709 km"
    with pytest.raises(FileFormatError, match=f"line 12: {one_way_problem}"):
        read((ONE_WAY, RANGES), catalogue=StationCatalogue.default())
    got = read((ONE_WAY, RANGES), catalogue=StationCatalogue.default(), lunar=False)
    assert got.value_m[1] == 768801500.0


def test_one_way_delays_and_clocks():
    delays = {"TRANSMIT_DELAY_2": "4e-6", "RECEIVE_DELAY_1": "2e-6", "RECEIVE_DELAY_2": "1.0"}
    # The station's clock is 3 microseconds behind UTC, the lander's 5 ahead.
    clocks = (CLOCK | {"PARTICIPANT_1": "KASHI", "PARTICIPANT_2": "UTC"}, [CLOCK_BIAS.format("3e-6")])
    lander = (CLOCK | {"PARTICIPANT_1": "UTC", "PARTICIPANT_2": "lander"}, [CLOCK_BIAS.format("5e-6")])
    for modelled in (EquipmentDelays(), EquipmentDelays(1e-6)):
        got = read((ONE_WAY | delays, ONE_WAY_RANGES), clocks, lander, modelled=modelled)
        assert abs(got.value_m[0] - (384400500.0 - C_M_S * (6e-6 - 8e-6))) < VALUE_TOLERANCE_M
        assert abs(seconds_after(got, "2021-03-28T14:00:00")[0] - (3e-6 - 2e-6)) < EPOCH_TOLERANCE_S


def test_one_way_doppler():
    record = ["DOPPLER_INTEGRATED = 2021-03-28T14:00:00 0.5"]
    got = read((ONE_WAY | COUNT, record), doppler_convention="half")
    assert got.types().tolist() == ["one_way_doppler"]
    assert (got.value_m[0], got.count_s[0], got.sigma_m[0]) == (30000.0, 60.0, 2e-3)
    value = received_hz(30000.0, 60.0, up_hz=8.4e9, ratio=1.0)
    sent = ["TRANSMIT_FREQ_2 = 2021-03-28T13:00:00 8.4e9"]
    records = [f"RECEIVE_FREQ_1 = 2021-03-28T14:00:00 {value!r}"]
    for segments in (
        [(ONE_WAY | COUNT, [*sent, *records])],
        [(ONE_WAY | COUNT, records), (ONE_WAY | {"PARTICIPANT_1": "JIAMUSI"}, sent), (ONE_WAY, sent)],
    ):
        got = read(*segments, turnaround=(880, 749))
        assert abs(got.value_m[0] - 30000.0) < GROWTH_TOLERANCE_M
        assert np.isnan(got.uplink_hz[0])
        assert got.wavelength_um[0] == 1e6 * C_M_S / value


# VLBI delays


# Clocks

CLOCK = {"TIME_SYSTEM": "UTC", "PARTICIPANT_1": "SESHAN25", "PARTICIPANT_2": "KUNMING"}
CLOCK_BIAS = "CLOCK_BIAS = 2021-03-28T13:00:00 {}"
VLBI = (DELAY, ["VLBI_DELAY = 2021-03-28T14:00:00 -1.5e-3", "VLBI_DELAY = 2021-03-28T14:00:10 -1.5e-3"])


def test_clock_difference_of_two_stations():
    records = [
        "CLOCK_BIAS = 2021-03-28T13:59:00 -4e-7",
        "CLOCK_DRIFT = 2021-03-28T13:59:00 1e-9",
        "CLOCK_BIAS = 2021-03-28T14:00:05 2e-7",
    ]
    for metadata, sign in (
        (CLOCK, 1.0),
        (CLOCK | {"PARTICIPANT_1": "KUNMING", "PARTICIPANT_2": "seshan25"}, -1.0),
    ):
        got = readout(VLBI, (metadata, records), catalogue=StationCatalogue.default())
        clock_s = sign * np.array([-4e-7 + 60e-9, 2e-7])
        assert np.abs(got.observations.value_m - C_M_S * (-1.5e-3 - clock_s)).max() < VALUE_TOLERANCE_M
        assert seconds_after(got.observations, "2021-03-28T14:00:00")[0] == 0.0
        assert not got.ignored
    uncorrected = readout(VLBI, (CLOCK, records), apply_clocks=False)
    assert uncorrected.observations.value_m.tolist() == [C_M_S * -1.5e-3] * 2
    assert uncorrected.ignored == {"CLOCK_BIAS": 2, "CLOCK_DRIFT": 1}


def test_clocks_against_utc():
    """Clock 2 less clock 1: with UTC as second, UTC less the station's clock."""
    first = (CLOCK | {"PARTICIPANT_2": "UTC-NIST"}, ["CLOCK_BIAS = 2021-03-28T13:00:00 3e-6"])
    second = (CLOCK | {"PARTICIPANT_1": "UTC"}, ["CLOCK_BIAS = 2021-03-28T13:00:00 5e-6"])
    got = read(VLBI, first, second)
    # The first station's clock is 3 microseconds behind UTC, the second's 5 ahead: 8 between them.
    assert np.abs(got.value_m - C_M_S * (-1.5e-3 - 8e-6)).max() < VALUE_TOLERANCE_M
    assert abs(seconds_after(got, "2021-03-28T14:00:00")[0] - 3e-6) < EPOCH_TOLERANCE_S


def test_clocks_of_ranges():
    station = CLOCK | {"PARTICIPANT_1": "JIAMUSI", "PARTICIPANT_2": "UTC"}
    bias = (station, ["CLOCK_BIAS = 2021-03-28T13:00:00 -2e-6"])
    three_way = read((THREE_WAY, RANGES), bias)
    # The receiver's clock is ahead of UTC: it read later than it was.
    assert abs(three_way.value_m[1] - (768801500.0 - C_M_S * 2e-6)) < VALUE_TOLERANCE_M
    assert abs(seconds_after(three_way, "2021-03-28T14:01:00")[1] + 2e-6) < EPOCH_TOLERANCE_S
    station_clock = (station | {"PARTICIPANT_1": "KASHI"}, bias[1])
    two_way = read((TWO_WAY, RANGES), station_clock)
    assert two_way.value_m[1] == 768801500.0
    assert abs(seconds_after(two_way, "2021-03-28T14:01:00")[1] + 2e-6) < EPOCH_TOLERANCE_S


def test_clock_before_its_first_record():
    late = (CLOCK, ["CLOCK_BIAS = 2021-03-28T14:00:05 2e-7"])
    with pytest.raises(FileFormatError, match=r"VLBI_DELAY precedes"):
        read(VLBI, late)


def test_two_values_of_one_epoch_in_two_segments():
    of_clock = [(CLOCK, [CLOCK_BIAS.format(value)]) for value in ("2e-7", "3e-7")]
    assert len(read(VLBI, of_clock[0], of_clock[0])) == 2
    with pytest.raises(FileFormatError, match=r"CLOCK_BIAS.*, 2e-07.*3e-07"):
        read(VLBI, *of_clock)


def test_drift_without_bias():
    with pytest.raises(FileFormatError, match="CLOCK_DRIFT"):
        read(VLBI, (CLOCK, ["CLOCK_DRIFT = 2021-03-28T13:00:05 2e-7"]))
    with pytest.raises(FileFormatError, match="PARTICIPANT_2 is missing"):
        read(VLBI, (CLOCK | {"PARTICIPANT_2": None}, ["CLOCK_BIAS = 2021-03-28T13:00:05 2e-7"]))


# Doppler

COUNT = {"INTEGRATION_INTERVAL": "60.0", "INTEGRATION_REF": "MIDDLE"}
RATIO = {"TURNAROUND_NUMERATOR": "880", "TURNAROUND_DENOMINATOR": "749"}


@pytest.mark.parametrize(("reference", "middle_s"), [("START", 30.0), ("MIDDLE", 0.0), ("END", -30.0)])
def test_mean_range_rate(reference, middle_s):
    record = ["DOPPLER_INTEGRATED = 2021-03-28T14:00:00 0.5"]
    metadata = TWO_WAY | COUNT | {"INTEGRATION_REF": reference}
    got = read((metadata, record))
    assert got.types().tolist() == ["doppler"]
    assert (got.value_m[0], got.count_s[0], got.sigma_m[0]) == (30000.0, 60.0, 1e-3)
    assert abs(seconds_after(got, "2021-03-28T14:00:00")[0] - middle_s) < EPOCH_TOLERANCE_S
    assert read((metadata, record), doppler_convention="half").value_m[0] == 60000.0
    correction = {"CORRECTION_DOPPLER": "0.25", "CORRECTIONS_APPLIED": "NO"}
    assert read((metadata | correction, record)).value_m[0] == 45000.0


def test_instantaneous_range_rate():
    got = read((TWO_WAY, ["DOPPLER_INSTANTANEOUS = 2021-03-28T14:00:00 -0.5"]))
    assert (got.value_m[0], got.count_s[0]) == (-500.0, 1.0)


def received_hz(growth_m, count_s, up_hz=7.2e9, ratio=880 / 749):
    return ratio * up_hz * (1.0 - growth_m / (C_M_S * count_s))


def test_a_transmitted_frequency_holds_from_its_time_tag_on():
    """Two-way counts of 10 s: of what was transmitted before the tag the model does not know the frequency."""
    metadata = TWO_WAY | RATIO | {"INTEGRATION_INTERVAL": "10", "INTEGRATION_REF": "MIDDLE"}
    records = [
        f"RECEIVE_FREQ_1 = 2021-03-28T14:00:{s} {received_hz(300.0, 10.0)!r}" for s in (20, 30, 40, 50)
    ]
    records += ["TRANSMIT_FREQ_1 = 2021-03-28T14:00:30 7.2e9"]
    later = (TWO_WAY, ["TRANSMIT_FREQ_1 = 2021-03-28T16:00:00 7.2e9"])
    lander_pa_m = (
        LunarPosition.from_selenographic(-51.9, 43.0, -2550.0, "ME_DE421").to_frame("PA_DE421").xyz_m
    )

    def status(got):
        return ExactPredictor(PhysicalModel.build(), got, FixedPoint(lander_pa_m)).compute().status[:, 0]

    observations = readout((metadata, records))
    got, notes = observations.observations, observations.notes
    assert got.ramped.tolist() == [True, True, True, False]  # the third may have been transmitted before
    assert np.abs(got.value_m - 300.0).max() < GROWTH_TOLERANCE_M
    assert status(got).tolist() == [Status.NO_RAMP, Status.NO_RAMP, Status.OK, Status.OK]
    assert any(
        "1 RECEIVE_FREQ_1 are before the first transmitted frequency (a.kvn, line" in note for note in notes
    )
    assert (status(read((metadata, records[:-1]), later)) == Status.NO_RAMP).all()


def test_a_beacon_frequency_holds_from_its_time_tag_on():
    paths = {
        "PATH": None,
        "MODE": "SINGLE_DIFF",
        "PATH_1": "2,1",
        "PATH_2": "2,3",
        "PARTICIPANT_3": "JIAMUSI",
    }
    counts = ["RECEIVE_FREQ = 2021-03-28T14:00:00 100.0", "TRANSMIT_FREQ_2 = 2021-03-28T14:00:01 8.4e9"]
    with pytest.raises(FileFormatError, match="RECEIVE_FREQ precedes"):
        read((TWO_WAY | COUNT | paths, counts))


def ramped(count, rate=1.0):
    """Message with an uplink that changes."""
    received = f"{880 / 749 * 7.2e9!r}"
    records = [f"RECEIVE_FREQ_3 = 2021-03-28T14:{k + 1:02d}:30 {received}" for k in range(count)]
    for minute in range(0, 10):
        f = 7.2e9 + rate * 60.0 * minute
        records += [
            f"TRANSMIT_FREQ_1 = 2021-03-28T14:{minute:02d}:00 {f!r}",
            f"TRANSMIT_FREQ_RATE_1 = 2021-03-28T14:{minute:02d}:00 {rate}",
        ]
    return (THREE_WAY | COUNT | RATIO, records)


def test_frequencies_of_another_segment_and_band():
    received = (
        TWO_WAY | COUNT | RATIO | {"TRANSMIT_BAND": "X"},
        [f"RECEIVE_FREQ_1 = 2021-03-28T14:00:00 {received_hz(600.0, 60.0)!r}"],
    )
    x_band = (TWO_WAY | {"TRANSMIT_BAND": "X"}, ["TRANSMIT_FREQ_1 = 2021-03-28T14:00:00 7.2e9"])
    s_band = (TWO_WAY | {"TRANSMIT_BAND": "S"}, ["TRANSMIT_FREQ_1 = 2021-03-28T14:00:00 2.1e9"])
    assert read(received, s_band, x_band).value_m[0] == pytest.approx(600.0, abs=1e-4)
    unsaid = (received[0] | {"TRANSMIT_BAND": None}, received[1])
    assert read(unsaid, x_band).value_m[0] == pytest.approx(600.0, abs=1e-4)
    with pytest.raises(FileFormatError, match="TRANSMIT_BAND"):
        read(unsaid, s_band, x_band)


def test_received_frequency_beside_range_rates_is_no_second_measurement():
    records = [
        "DOPPLER_INTEGRATED = 2021-03-28T14:00:00 0.5",
        "RECEIVE_FREQ_1 = 2021-03-28T14:00:00 8.4e9",
        "TRANSMIT_FREQ_1 = 2021-03-28T14:00:00 7.2e9",
    ]
    got = readout((TWO_WAY | COUNT, records))
    assert len(got.observations) == 1
    assert got.observations.wavelength_um[0] == 1e6 * C_M_S / 8.4e9
    assert got.observations.uplink_hz[0] == 7.2e9
    assert got.ignored == {}


# Weather


def test_weather_of_the_station():
    weather = ({"TIME_SYSTEM": "UTC", "PARTICIPANT_1": "kashi"}, [
        "PRESSURE = 2021-03-28T13:00:00 870.0",
        "PRESSURE = 2021-03-28T15:00:00 872.0",
        "TEMPERATURE = 2021-03-28T11:00:00 290.0",
        "RHUMIDITY = 2021-03-28T13:30:00 45",
    ])  # fmt: skip
    got = readout((TWO_WAY, RANGES), weather, catalogue=StationCatalogue.default())
    assert got.observations.pressure_hpa[1] == pytest.approx(870.0 + 2.0 * 61 / 120, abs=1e-9)
    assert np.isnan(got.observations.temperature_k).all()
    assert got.observations.relative_humidity.tolist() == [0.45, 0.45]
    assert got.ignored == {}
    bistatic = readout((THREE_WAY, RANGES), weather, catalogue=StationCatalogue.default())
    assert np.isnan(bistatic.observations.pressure_hpa).all()
    assert bistatic.ignored == {"TEMPERATURE": 1, "PRESSURE": 2, "RHUMIDITY": 1}


# What is accounted for, and what is refused


RECEIVED = ["RECEIVE_FREQ_1 = 2021-03-28T14:00:00 8.4e9", "TRANSMIT_FREQ_1 = 2021-03-28T14:00:00 7.2e9"]
VLBI_RECORD = ["VLBI_DELAY = 2021-03-28T14:00:00 1e-3"]
REFUSED = {
    "target at the end": (TWO_WAY | {"PATH": "1,1,2"}, RANGES, "the target among the stations"),
    "no mode": (TWO_WAY | {"MODE": None}, RANGES, "MODE is missing"),
    "unknown target": (TWO_WAY | {"PARTICIPANT_2": "UNKNOWN"}, RANGES, "the target is UNKNOWN"),
    "whole frequency of two paths": (
        DELAY | COUNT,
        ["RECEIVE_FREQ = 2021-03-28T14:00:00 8.4e9", "TRANSMIT_FREQ_1 = 2021-03-28T13:00:00 8.4e9"],
        "two received frequencies",
    ),
    "delay without difference": (TWO_WAY, VLBI_RECORD, "got VLBI_DELAY"),
    "one station": (DELAY | {"PATH_2": "1,2"}, VLBI_RECORD, "last station"),
    "one-way range": (TWO_WAY | {"RANGE_MODE": "ONE_WAY"}, RANGES, "RANGE_MODE is ONE_WAY"),
    "no interval": (TWO_WAY, RECEIVED, "RECEIVE_FREQ_1 needs INTEGRATION_INTERVAL"),
    "no uplink": (TWO_WAY | COUNT | RATIO, RECEIVED[:1], "RECEIVE_FREQ_1 needs TRANSMIT_FREQ_1 of KASHI"),
    "no ratio": (TWO_WAY | COUNT, RECEIVED, "needs the transponder's ratio"),
    "half a ratio": (TWO_WAY | COUNT | {"TURNAROUND_NUMERATOR": "880"}, RECEIVED, "TURNAROUND_DENOMINATOR"),
    "wrong ratio": (
        TWO_WAY | COUNT | RATIO,
        [RECEIVED[0], RECEIVED[1].replace("7.2", "2.1")],
        "cannot be received of 2100000000.0 Hz sent, with a turnaround of 880/749",
    ),
    "wrong receiver": (
        TWO_WAY | COUNT | RATIO,
        [RECEIVED[0].replace("_1", "_2")],
        "PATH ends at participant 1",
    ),
    "rate alone": (
        TWO_WAY,
        [*RANGES, "TRANSMIT_FREQ_RATE_1 = 2021-03-28T14:00:00 1"],
        "TRANSMIT_FREQ_RATE_1",
    ),
    "absurd delay": (DELAY, ["VLBI_DELAY = 2021-03-28T14:00:00 1"], "below the Earth"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    metadata, records, problem = REFUSED[name]
    with pytest.raises(FileFormatError, match=problem) as caught:
        read((metadata, records))
    assert caught.value.line is not None


SPAN = {"START_TIME": "2021-03-28T14:00:00", "STOP_TIME": "2021-03-28T14:01:00"}


def test_measurements_outside_of_start_and_stop():
    assert len(read((TWO_WAY | SPAN, RANGES))) == len(RANGES)
    # Bounds are rounded to seconds, and in the message's time system.
    assert len(read((TWO_WAY | SPAN | {"START_TIME": "2021-03-28T14:00:01"}, RANGES))) == len(RANGES)
    for keyword, wrong, line in (
        ("START_TIME", "2021-03-28T14:00:02", 14),
        ("STOP_TIME", "2021-087T14:00:30", 15),
    ):
        with pytest.raises(FileFormatError, match=f"line {line}: RANGE .* outside of {keyword} = {wrong}"):
            read((TWO_WAY | SPAN | {keyword: wrong}, RANGES))
    with pytest.raises(FileFormatError, match=r"13: RANGE.*37\.25.*STOP_TIME"):
        read((TWO_WAY | {"TIME_SYSTEM": "TAI", "STOP_TIME": "2021-03-28T13:59:23"}, RANGES))


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"sigma_m": {"ranges": 1.0}}, "ranges"),
        ({"range_convention": "one_way"}, "range_convention"),
        ({"turnaround": (880, 0)}, "two whole numbers"),
    ],
)
def test_invalid_agreements_are_refused(fields, problem):
    with pytest.raises(InputError, match=problem):
        TdmAgreement(**fields)
