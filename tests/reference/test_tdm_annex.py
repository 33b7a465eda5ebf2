"""The examples in annex E of CCSDS 503.0-B-2 (June 2020) that hold range, Doppler or VLBI data.

Six of them are read from files; of the others a few records are carried here, with the
metadata that matter. What is expected of each follows from the text of the standard, by hand.
"""

from pathlib import Path

import numpy as np
import pytest
from tdm_messages import growth_m, kvn, xml

from radioloc.constants import C_M_S
from radioloc.errors import DataQualityWarning, FileFormatError
from radioloc.io.tdm import TdmAgreement, read_tdm, read_tdm_file, tdm_observations
from radioloc.io.tdm.kvn import parse_kvn, parse_xml
from radioloc.io.tdm.write import write_tdm, write_tdm_file
from radioloc.time import epochs_from_strings, utc_to_tai

DATA = Path(__file__).resolve().parents[1] / "data" / "tdm"

SIGMA_M = {"range": 1.0, "vlbi_delay": 0.1} | dict.fromkeys(
    ("doppler", "one_way_doppler", "differenced_doppler"), 1e-3
)
EPOCH_TOLERANCE_S = 3e-11  # a float of the day's fraction, moved once
VALUE_TOLERANCE_M = 1e-9  # some floats of 4e6 m
GROWTH_TOLERANCE_M = 1e-6  # a ratio of frequencies rounded some times (1e-16 each), times one light-second
FILES = {"e1.kvn": 31, "e5.kvn": 41, "e6.kvn": 40, "e9.kvn": 41, "e11.kvn": 6, "e21.xml": 8}


def seconds_after(observations, text):
    return utc_to_tai(observations.epoch).seconds_since(utc_to_tai(epochs_from_strings(text, "UTC")))


@pytest.mark.parametrize("name", FILES)
def test_records_are_read_and_written(name, tmp_path):
    message = read_tdm_file(DATA / f"annex_{name}")
    assert len(message) == FILES[name]
    if name == "e21.xml":
        # Its participant's name stands in typographic quotes, which are not ASCII.
        message.segments[0].metadata["PARTICIPANT_1"] = "DSS-25"
    write_tdm_file(tmp_path / "a.kvn", message)
    read = read_tdm_file(tmp_path / "a.kvn")
    assert read.header == message.header
    for original, copy in zip(message.segments, read.segments, strict=True):
        assert original.metadata == copy.metadata
        for first, second in (
            (original.keyword, copy.keyword),
            (original.value, copy.value),
            (original.epoch.mjd, copy.epoch.mjd),
        ):
            assert np.array_equal(first, second)


@pytest.mark.parametrize("name", FILES)
def test_ccsds_ndm_finds_the_same_numbers(name):
    ndm_io = pytest.importorskip("ccsds_ndm.ndm_io")
    ours, theirs = read_tdm_file(DATA / f"annex_{name}"), ndm_io.NdmIo().from_path(DATA / f"annex_{name}")
    for segment, reference in zip(ours.segments, theirs.body.segment, strict=True):
        observations = [
            value
            for record in reference.data.observation
            for field, value in vars(record).items()
            if value is not None and field != "epoch"
        ]
        scale = np.where(segment.keyword == 0, 1e-3, 1.0)  # keyword 0 is RANGE, in km there
        assert np.array([float(getattr(v, "value", v)) for v in observations]) == pytest.approx(
            segment.value * scale, rel=3e-16
        )


def test_one_way_frequencies():
    """Figure E-1: a spacecraft's reference frequency as received at DSS-25; 77 microseconds of receiver delay."""
    with pytest.warns(DataQualityWarning):
        read = read_tdm(DATA / "annex_e1.kvn", TdmAgreement(sigma_m=SIGMA_M))
    assert read.types().tolist() == ["one_way_doppler"] * 30
    assert set(read.paths()) == {"yyyy-nnna>DSS-25"}
    assert seconds_after(read, "2005-06-08T17:41:00") == pytest.approx(
        np.arange(30.0) - 77e-6, abs=EPOCH_TOLERANCE_S
    )
    for second, received_hz in {0: 32021034790.7265, 16: 32021035400.0304}.items():
        wanted_m = growth_by_hand_m(received_hz, 0.0, 32023442781.733, 0.0, 0.0, 1.0)
        assert abs(read.value_m[second] - wanted_m) < GROWTH_TOLERANCE_M
    assert np.isnan(read.uplink_hz).all()


def growth_by_hand_m(received_hz, light_s, start_hz, rate_hz_s, since_s, ratio):
    """Growth of a path in a second: the mean of the frequency sent in the (T - D) that arrived in T is F / ratio."""
    sent_hz = start_hz + rate_hz_s * (since_s - light_s)
    return C_M_S * (1.0 - received_hz / (ratio * sent_hz))


def test_three_way_frequencies():
    """Figure E-5: a ramped uplink, the light time being the difference of the first tags (2 h 47 min 4.27 s)."""
    agreement = TdmAgreement(sigma_m=SIGMA_M, turnaround=(880, 749))
    read = read_tdm(DATA / "annex_e5.kvn", agreement)
    assert read.paths()[0] == "DSS-55>yyyy-nnna>DSS-15"
    assert read.types().tolist() == ["doppler"] * 14
    assert seconds_after(read, "2005-07-03T13:59:27.27") == pytest.approx(
        np.arange(14.0), abs=EPOCH_TOLERANCE_S
    )
    received_hz = {1: 8429749428.196568, 13: 8429749420.824186}
    for second, frequency_hz in received_hz.items():
        wanted_m = growth_by_hand_m(
            frequency_hz, 10023.7, 7175173383.615373, 0.4022, 10024.27 + second, 880 / 749
        )
        # Sent in the second that ended 10023.7 s before the count did; given at each second to 1e-6 Hz.
        sent_s = second + 0.07 + np.array([0.0, 1.0 - wanted_m / C_M_S])
        assert abs(growth_m(read[[second]], "2005-07-03T11:12:23", *sent_s)[0] - wanted_m) < 2e-6
    with pytest.raises(FileFormatError, match="needs the transponder's ratio"):
        read_tdm(DATA / "annex_e5.kvn", TdmAgreement(sigma_m=SIGMA_M))


def test_range_tagged_at_transmission():
    """Figure E-9: the modulus of 1e7 km is longer than any path, and the correction is applied already."""
    read = read_tdm(DATA / "annex_e9.kvn", TdmAgreement(sigma_m=SIGMA_M))
    assert read.tags().tolist() == ["transmit"] * 41
    assert read.paths()[0] == "USC1>yyyy-nnna>USC1"
    assert read.value_m[[0, -1]].tolist() == [3198036.79519614, 3270464.40460551]
    assert seconds_after(read, "2005-09-17T00:41:38")[-1] == pytest.approx(80.0, abs=EPOCH_TOLERANCE_S)
    half = read_tdm(DATA / "annex_e9.kvn", TdmAgreement(sigma_m=SIGMA_M, range_convention="half"))
    assert half.value_m.tolist() == (2.0 * read.value_m).tolist()


def test_delay_of_two_stations(tmp_path):
    """Figure E-11: 77 microseconds of receiver delay at DSS-25, whose clock is 0.459 microseconds behind."""
    agreement = TdmAgreement(sigma_m=SIGMA_M)
    read = read_tdm(DATA / "annex_e11.kvn", agreement)
    assert read.paths().tolist() == ["DSS-55<voyager1>DSS-25"] * 2 + ["DSS-55<ctd 20>DSS-25"]
    delays_s = np.array([-4.911896106591159e-03, 1.467382930436399e-02, -1.911896106591159e-03])
    assert np.abs(read.value_m - C_M_S * (delays_s - 77e-6 + 4.59e-7)).max() < VALUE_TOLERANCE_M
    assert seconds_after(read, "2004-05-15T15:42:00") == pytest.approx(
        [0.0, 1200.0, 600.0], abs=EPOCH_TOLERANCE_S
    )
    assert read.wavelength_um == pytest.approx(
        1e6 * C_M_S / np.array([8.415123456e9] * 2 + [8.415123e9]), rel=1e-15
    )
    write_tdm(tmp_path / "a.kvn", read, originator="TEST")
    restored = read_tdm(tmp_path / "a.kvn", agreement)
    assert restored.value_m.tolist() == read.value_m.tolist()
    assert restored.wavelength_um.tolist() == read.wavelength_um.tolist()


# Figures of which some records are carried here

UTC = {"TIME_SYSTEM": "UTC", "MODE": "SEQUENTIAL", "PATH": "1,2,1"}


def observations(metadata, records, **agreement):
    message = parse_kvn("a.kvn", kvn((UTC | metadata, records)))
    return tdm_observations(message, TdmAgreement(**({"sigma_m": SIGMA_M} | agreement)))


def test_two_way_frequencies():
    """Figure E-3: as E-5, without spaces about the equals signs."""
    names = {
        "PARTICIPANT_1": "DSS-55",
        "PARTICIPANT_2": "yyyy-nnnA",
        "INTEGRATION_INTERVAL": "1.0",
        "INTEGRATION_REF": "MIDDLE",
    }
    records = [
        "TRANSMIT_FREQ_1=2005-184T11:12:23     7175173383.615373",
        "TRANSMIT_FREQ_RATE_1=2005-184T11:12:23 0.40220",
        "TRANSMIT_FREQ_1=2005-184T11:12:24     7175173384.017573",
        "TRANSMIT_FREQ_RATE_1=2005-184T11:12:24 0.40220",
        "RECEIVE_FREQ_1=2005-184T13:59:28.27 8429749428.196568",
    ]
    read = observations(names, records, turnaround=(880, 749)).observations
    wanted_m = growth_by_hand_m(8429749428.196568, 10024.0, 7175173383.615373, 0.4022, 10025.27, 880 / 749)
    sent_s = 0.77 + np.array([0.0, 1.0 - wanted_m / C_M_S])
    assert abs(growth_m(read, "2005-07-03T11:12:23", *sent_s)[0] - wanted_m) < GROWTH_TOLERANCE_M
    assert read.paths()[0] == "DSS-55>yyyy-nnna>DSS-55"


def test_range_units_of_a_changing_uplink():
    """Figure E-4: range units, which follow the uplink; figure E-19: of an unknown length, with a modulus."""
    names = {
        "PARTICIPANT_1": "DSS-24",
        "PARTICIPANT_2": "yyyy-nnnA",
        "RANGE_MODE": "COHERENT",
        "RANGE_UNITS": "RU",
    }
    ramp = [
        "TRANSMIT_FREQ_1       = 2005-191T00:31:51    7180064367.3536",
        "TRANSMIT_FREQ_RATE_1 = 2005-191T00:31:51     0.59299",
        "RANGE                 = 2005-191T00:31:51    39242998.5151986",
        "PR_N0                 = 2005-191T00:31:51    28.52538",
    ]
    with pytest.raises(FileFormatError, match="range_unit_s"):
        observations(names | {"RANGE_MODULUS": "2.0e+26"}, ramp)
    read = observations(names | {"RANGE_MODULUS": "2.0e+26"}, ramp, range_unit_s=1e-9).observations
    assert (read.ramped[0], read.uplink_hz[0]) == (True, 7180064367.3536)
    assert read.value_m[0] == pytest.approx(C_M_S * 39242998.5151986e-9, rel=1e-15)
    single = ["RANGE = 2010-215T20:04:24.000   65249.6771931631", "PR_N0 = 2010-215T20:04:24.000   30.2351"]
    modulus = names | {"RANGE_MODULUS": "262144", "TRANSMIT_DELAY_1": "2.1E-07", "RECEIVE_DELAY_1": "2.1E-07"}
    assert observations(modulus, single, range_unit_s=1e-9).observations.modulus_m[0] == 262144 * C_M_S * 1e-9
    got = observations(modulus, single, range_unit_s=1e-9)
    assert got.observations.value_m[0] == pytest.approx(C_M_S * (65249.6771931631e-9 - 4.2e-7), rel=1e-15)
    assert got.ignored == {"PR_N0": 1}


def test_range_doppler_and_angles_in_one_segment():
    """Figure E-8, second segment: intervals end at the tags."""
    names = {
        "PARTICIPANT_1": "WHM1",
        "PARTICIPANT_2": "SAT",
        "INTEGRATION_INTERVAL": "1.0",
        "INTEGRATION_REF": "END",
        "RANGE_MODE": "CONSTANT",
        "RANGE_MODULUS": "1.000000E+07",
        "ANGLE_TYPE": "AZEL",
        "DATA_QUALITY": "RAW",
    }
    records = [
        "RANGE                  = 2007-08-29T06:00:02.000   4.00165248953670E+04",
        "DOPPLER_INTEGRATED     = 2007-08-29T06:00:02.000           -0.885640091",
        "ANGLE_1                = 2007-08-29T06:00:02.000            99.53204250",
        "ANGLE_2                = 2007-08-29T06:00:02.000             1.26724167",
    ]
    got = observations(names, records, range_convention="half", doppler_convention="half")
    assert got.observations.types().tolist() == ["range", "doppler"]
    assert got.observations.value_m == pytest.approx([2 * 40016524.8953670, 2 * -885.640091], rel=1e-15)
    assert seconds_after(got.observations, "2007-08-29T06:00:02") == pytest.approx(
        [0.0, -0.5], abs=EPOCH_TOLERANCE_S
    )
    assert got.ignored == {"ANGLE_1": 1, "ANGLE_2": 1}


def test_differenced_doppler():
    """Figure E-10 (one epoch of which lacks a colon in the standard), its path of two stations of Goldstone."""
    metadata = {
        "PARTICIPANT_1": "yyyy-nnnA",
        "PARTICIPANT_2": "DSS-24",
        "PARTICIPANT_3": "DSS-25",
        "MODE": "SINGLE_DIFF",
        "PATH": None,
        "PATH_1": "1,2",
        "PATH_2": "1,3",
        "INTEGRATION_INTERVAL": "10.0",
        "INTEGRATION_REF": "MIDDLE",
    }
    records = [
        "TRANSMIT_FREQ_1 = 2003-07-08T04:10:00.0000          8.435360E+09",
        "RECEIVE_FREQ = 2003-07-08T04:45:25.0000          8.738750457763670E+00",
    ]
    got = observations(metadata, records).observations
    assert got.paths().tolist() == ["DSS-24<yyyy-nnna>DSS-25"]
    assert got.types().tolist() == ["differenced_doppler"]
    # More cycles arrive at the second station: the path to it is the one that gets shorter.
    assert got.value_m[0] == pytest.approx(-10.0 * C_M_S * 8.738750457763670 / 8.435360e9, rel=1e-15)
    with pytest.raises(FileFormatError, match="not a date"):
        observations(metadata, ["TRANSMIT_FREQ_1 = 2003-07-08T04:10:0000          8.435360E+09"])


def test_radar_range_with_a_correction_to_apply():
    """Figure E-17, with its name of an ephemeris that has no number, and an epoch of RCS that is there twice."""
    names = {
        "PARTICIPANT_1": "CAMRA",
        "PARTICIPANT_2": "CRYOSAT",
        "EPHEMERIS_NAME": "3203_2013-11-09T23-02-30",
        "RANGE_UNITS": "km",
        "ANGLE_TYPE": "AZEL",
        "CORRECTION_RANGE": "-1.48",
        "CORRECTIONS_APPLIED": "NO",
    }
    records = [
        "RANGE =          2011-05-11T10:26:33.7008     2803.1731",
        "RCS =            2011-05-11T10:26:33.7008        2.992",
        "RANGE =          2011-05-11T10:26:33.9686     2799.8754",
        "CARRIER_POWER = 2011-05-11T10:26:33.9686       -36.67897415",
        "RCS =            2011-05-11T10:26:33.7008      2.986",
    ]
    got = observations(names, records)
    assert np.abs(got.observations.value_m - [2801693.1, 2798395.4]).max() < VALUE_TOLERANCE_M
    assert got.ignored == {"CARRIER_POWER": 1, "RCS": 2}


def test_two_way_frequency_with_offset():
    """Figure E-20, to which the standard gives no uplink: here one that makes the first path stand still."""
    names = {
        "PARTICIPANT_1": "DSS-26",
        "PARTICIPANT_2": "CAS",
        "TURNAROUND_NUMERATOR": "880",
        "TURNAROUND_DENOMINATOR": "749",
        "TIMETAG_REF": "RECEIVE",
        "INTEGRATION_INTERVAL": "60.0",
        "INTEGRATION_REF": "MIDDLE",
        "FREQ_OFFSET": "8427221784.667",
        "RECEIVE_DELAY_1": "0.00000556",
        "DATA_QUALITY": "DEGRADED",
    }
    records = [
        "RECEIVE_FREQ_1 = 2010-049T16:49:43.000   60255.16982",
        "RECEIVE_FREQ_1 = 2010-049T16:50:43.000   60271.18801",
    ]
    with (
        pytest.warns(DataQualityWarning),
        pytest.raises(FileFormatError, match="needs TRANSMIT_FREQ_1 of DSS-26"),
    ):
        observations(names, records)
    received_hz = 8427221784.667 + 60255.16982
    uplink_hz = received_hz * 749 / 880
    with pytest.warns(DataQualityWarning):
        got = observations(
            names, [*records, f"TRANSMIT_FREQ_1 = 2010-049T16:00:00 {uplink_hz!r}"]
        ).observations
    wanted_m = -C_M_S * 60.0 * np.array([0.0, 60271.18801 - 60255.16982]) / received_hz
    assert np.abs(got.value_m - wanted_m).max() < 60.0 * GROWTH_TOLERANCE_M
    assert seconds_after(got, "2010-02-18T16:49:43")[0] == pytest.approx(-5.56e-6, abs=EPOCH_TOLERANCE_S)


def test_one_way_frequency_with_offset():
    """Figure E-2: as E-1, the received frequency less an offset."""
    names = {
        "PARTICIPANT_1": "DSS-25",
        "PARTICIPANT_2": "yyyy-nnnA",
        "PATH": "2,1",
        "INTEGRATION_INTERVAL": "1.0",
        "INTEGRATION_REF": "MIDDLE",
        "FREQ_OFFSET": "32021035200.0",
    }
    records = [
        "TRANSMIT_FREQ_2 = 2005-159T17:41:00 32023442781.733",
        "RECEIVE_FREQ_1 = 2005-159T17:41:00 -409.2735",
    ]
    read = observations(names, records).observations
    wanted_m = growth_by_hand_m(32021035200.0 - 409.2735, 0.0, 32023442781.733, 0.0, 0.0, 1.0)
    assert abs(read.value_m[0] - wanted_m) < GROWTH_TOLERANCE_M
    assert read.types().tolist() == ["one_way_doppler"]


def test_clocks_alone_are_no_observations():
    """Figure E-15: offsets and rates of clocks, without MODE or PATH."""
    names = {"PARTICIPANT_1": "DSS-10", "PARTICIPANT_2": "UTC-NIST", "MODE": None, "PATH": None}
    records = [
        "CLOCK_BIAS = 2005-142T12:00:00 9.56e-7",
        "CLOCK_DRIFT = 2005-142T12:00:00 6.944e-14",
        "CLOCK_BIAS = 2005-143T12:00:00 9.62e-7",
    ]
    with pytest.raises(FileFormatError, match="got CLOCK_BIAS"):
        observations(names, records)


EVERY_METADATA = {
    "TRACK_ID": "a",
    "DATA_TYPES": "RANGE,DOPPLER_INTEGRATED",
    "START_TIME": "2021-03-28T14:00:00",
    "STOP_TIME": "2021-03-28T15:00:00",
    "PARTICIPANT_1": "KASHI",
    "PARTICIPANT_2": "lander",
    "EPHEMERIS_NAME_2": "e",
    "TRANSMIT_BAND": "X",
    "RECEIVE_BAND": "X",
    "TURNAROUND_NUMERATOR": "880",
    "TURNAROUND_DENOMINATOR": "749",
    "TIMETAG_REF": "RECEIVE",
    "INTEGRATION_INTERVAL": "60",
    "INTEGRATION_REF": "MIDDLE",
    "FREQ_OFFSET": "0.0",
    "RANGE_MODE": "COHERENT",
    "RANGE_MODULUS": "0",
    "RANGE_UNITS": "km",
    "ANGLE_TYPE": "AZEL",
    "REFERENCE_FRAME": "EME2000",
    "INTERPOLATION": "LAGRANGE",
    "INTERPOLATION_DEGREE": "7",
    "DOPPLER_COUNT_BIAS": "1",
    "DOPPLER_COUNT_SCALE": "1000",
    "DOPPLER_COUNT_ROLLOVER": "NO",
    "TRANSMIT_DELAY_1": "0",
    "RECEIVE_DELAY_1": "0",
    "DATA_QUALITY": "VALIDATED",
    **{
        f"CORRECTION_{name}": "1"
        for name in (
            *("ANGLE_1", "ANGLE_2", "DOPPLER", "MAG", "RANGE", "RCS", "RECEIVE", "TRANSMIT"),
            *("ABERRATION_YEARLY", "ABERRATION_DIURNAL"),
        )
    },
    "CORRECTIONS_APPLIED": "YES",
}
NOT_MEASURED = (
    "ANGLE_1",
    "ANGLE_2",
    "CARRIER_POWER",
    "MAG",
    "PC_N0",
    "PR_N0",
    "RCS",
    "STEC",
    "TROPO_DRY",
    "TROPO_WET",
)


@pytest.mark.parametrize("form", ["kvn", "xml"])
def test_every_keyword_is_read(form):
    """Tables 3-3 and 3-5: all metadata of a sequential segment, and all data beside ranges and range rates."""
    date = "2021-03-28T14:00:00"
    helping = {
        "TRANSMIT_FREQ_1": 7.2e9,
        "TRANSMIT_FREQ_RATE_1": 0,
        "RECEIVE_FREQ_1": 8.459e9,
        "PRESSURE": 900,
        "TEMPERATURE": 290,
        "RHUMIDITY": 50,
    }
    values = {"RANGE": 768800.1, "DOPPLER_INTEGRATED": 0.1} | helping | dict.fromkeys(NOT_MEASURED, 1)
    segment = (UTC | EVERY_METADATA, [f"{keyword} = {date} {value}" for keyword, value in values.items()])
    message = parse_kvn("a.kvn", kvn(segment)) if form == "kvn" else parse_xml("a.xml", xml(segment))
    got = tdm_observations(message, TdmAgreement(sigma_m=SIGMA_M))
    assert dict(zip(got.observations.types().tolist(), got.observations.value_m.tolist(), strict=True)) == {
        "range": 768800100.0,
        "doppler": 6000.0,
    }
    assert got.ignored == dict.fromkeys(NOT_MEASURED, 1)
    assert set(got.observations.uplink_hz) == {7.2e9}
    assert set(got.observations.pressure_hpa) == {900.0}
