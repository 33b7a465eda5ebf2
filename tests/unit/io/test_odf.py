"""Orbit data files: every field, what the records mean in metres, hertz and seconds, and files that are damaged."""

import numpy as np
import pytest
from odf_files import ORBIT, RAMP, RAMPS, START_S, doppler, odf, ramp
from paths import DATA

from radioloc.constants import C_M_S
from radioloc.errors import DataQualityWarning, FileFormatError
from radioloc.io import read_observations
from radioloc.io.odf import read_odf, read_odf_file
from radioloc.measurements import ExactPredictor, FixedPoint, PhysicalModel
from radioloc.measurements.ramps import turnaround_ratio
from radioloc.time import epochs_from_strings, utc_to_tai

EXCERPT = DATA / "odf" / "grail_b_2012-04-10.odf"
ROUNDED_M = 1e-12
"""Values of some hundred metres, in doubles."""


@pytest.fixture
def written(tmp_path):
    """A function that writes a file of some records."""

    def write(orbit, *args, **keywords):
        path = tmp_path / "made.odf"
        path.write_bytes(odf(orbit, *args, **keywords))
        return path

    return write


def seconds_since(text, epoch):
    return utc_to_tai(epoch).seconds_since(utc_to_tai(epochs_from_strings([text], "UTC")))


def test_every_field_comes_back(written):
    rng = np.random.default_rng(3)
    # A header ends in five zero words; of these records none does. The highest bit of a signed field is its sign.
    records = [
        {name: int(rng.integers(2**width)) for name, width in ORBIT.items()} | {"format": 2}
        for _ in range(50)
    ]
    ramps = [
        {name: int(rng.integers(2**width)) for name, width in RAMP.items()} | {"station": 24}
        for _ in range(9)
    ]
    clock = {
        "start_s": 7,
        "offset_s": -1,
        "offset_ns": -250,
        "station": 14,
        "second_station": 43,
        "stop_s": 2**31,
    }
    result = read_odf_file(written(records, ramps, [clock]))
    for content, rows, bits in ((result.orbit, records, ORBIT), (result.ramps, ramps, RAMP)):
        for row, item in zip(content, rows, strict=True):
            for name, width in bits.items():
                signed = name in ("observable", "observable_1e9", "item_20", "rate_hz_s", "rate_nhz_s")
                negative = signed and item[name] >= 2 ** (width - 1)
                assert row[name] == item[name] - 2**width * negative, name
    assert {name: result.clocks[0][name] for name in result.clocks.dtype.names} == clock | {
        "start_ns": 0,
        "reserved": 0,
        "stop_ns": 0,
    }
    assert (result.spacecraft, result.reference) == (181, (19500101, 0))
    assert result.orbit_record.tolist() == list(range(6, 56))


def test_two_way_doppler(written):
    """Expected by hand: 240/221 of 2100062003 Hz is the downlink of 2280610320.0 Hz, 1 Hz of which is 0.13145 m/s."""
    result = read_odf(written([doppler(k) for k in range(4)]))
    hertz = -119.651956557 + 3.0 * np.arange(4)
    np.testing.assert_allclose(
        result.value_m, hertz * C_M_S / (240 / 221 * 2100062003.0), rtol=0.0, atol=ROUNDED_M
    )
    assert result.value_m[0] == pytest.approx(-15.7286, abs=1e-4)
    assert result.uplink_hz == pytest.approx(2100062003.0, abs=1e-6)
    assert result.ramped.all()
    assert result.types().tolist() == ["doppler"] * 4
    assert result.paths()[0] == "DSS-24>sc181>DSS-24"
    # The antenna had the signal 77 microseconds before the receiver.
    np.testing.assert_allclose(
        seconds_since("2012-04-09T04:40:42", result.epoch), np.arange(4) - 77e-6, rtol=0.0, atol=1e-10
    )
    assert (result.count_s == 1.0).all()
    assert (result.sigma_m == 0.5e-3).all()
    np.testing.assert_allclose(result.wavelength_um, 1e6 * C_M_S / 2280610320.0, rtol=1e-12)
    assert result.origin(0).endswith("made.odf, line 6")
    # Ramps leave the antenna 77 microseconds after the exciter.
    starts = seconds_since("2012-04-09T04:40:42", result.ramps.start_utc)
    np.testing.assert_allclose(starts, [-600.0 + 77e-6, 5.0 + 77e-6], rtol=0.0, atol=1e-10)
    assert result.ramps.rate_hz_s.tolist() == [0.0, -2.0]


def test_ramps_have_the_delay_of_the_record_next_in_time(written):
    """Whatever the order of the records; where one ramp ends at a corner the next begins."""
    result = read_odf(written([doppler(9, transmitter_delay_ns=5000), doppler(0)]))
    starts, stops = (
        seconds_since("2012-04-09T04:40:42", utc) for utc in (result.ramps.start_utc, result.ramps.stop_utc)
    )
    np.testing.assert_allclose(starts, [-600.0 + 77e-6, 5.0 + 5e-6], rtol=0.0, atol=1e-10)
    assert stops[0] == pytest.approx(starts[1], abs=1e-10)


def test_three_way_one_way_and_ranges(written):
    x_up = {"reference_2e24_mhz": 7200000000000 >> 24, "reference_mhz": 7200000000000 % 2**24}
    s_level = {"reference_2e24_mhz": 2305036363636 >> 24, "reference_mhz": 2305036363636 % 2**24}
    one_way = {"type": 11, "transmitter": 0, "uplink": 0, "downlink": 2, "transmitter_delay_ns": 0}
    records = [
        doppler(0, type=13, receiver=54, item_21=6000, downlink=3, uplink=2, exciter=2, **x_up),
        doppler(1, **one_way, **s_level),
        doppler(
            2, type=37, channel=14, observable=5000, observable_1e9=0, downlink=2, uplink=2, exciter=2, **x_up
        ),
    ]
    result = read_odf(written(records))
    assert result.types().tolist() == ["doppler", "one_way_doppler", "range"]
    assert result.paths().tolist() == ["DSS-24>sc181>DSS-54", "sc181>DSS-24", "DSS-24>sc181>DSS-24"]
    assert result.ramped.tolist() == [True, False, True]
    hertz = -119.651956557
    assert result.value_m[0] == pytest.approx(60.0 * C_M_S * hertz / (3344 / 749 * 7.2e9), abs=1e-9)
    # GRAIL-B's oscillator sends 8451.8 MHz, and its reference is written at S band, 240/880 of that.
    assert C_M_S / result.wavelength_um[1] * 1e6 == pytest.approx(8451.8e6, abs=0.01)
    assert result.value_m[1] == pytest.approx(C_M_S * (hertz + 3.0) / 8451.8e6, abs=1e-9)
    assert np.isnan(result.uplink_hz[1])
    assert np.isnan(result.modulus_m[:2]).all()
    # 2^20 units are 150 km one way: of X band a unit is 2 * 749 / 221 cycles of the uplink.
    unit_m = C_M_S * 2.0 * 749.0 / 221.0 / 7.2e9
    assert unit_m == pytest.approx(0.28, abs=0.01)
    assert result.value_m[2] == pytest.approx(5000.0 * unit_m, abs=1e-9)
    assert result.modulus_m[2] == pytest.approx(2**20 * unit_m, abs=1e-6)
    assert result.sigma_m.tolist() == pytest.approx([0.15e-3 * 60.0**0.5, 0.15e-3, 2.0])


def test_a_study_changes_sigmas_and_the_catalogue_names_stations(written):
    path = written([doppler(k) for k in range(4)])
    assert (read_odf(path, sigma_m={"doppler": 0.01}).sigma_m == 0.01).all()
    result = read_observations([path])
    assert len(result) == 4
    assert len(result.ramps) == 2


def test_reference_frequency_of_the_exciter(written):
    result = read_odf(written([doppler(0, independent=0)], ramps=[]))
    assert not result.ramped.any()
    assert len(result.ramps) == 0
    with pytest.raises(FileFormatError, match=r"record 6: .*ramped exciter"):
        read_odf(written([doppler(0, independent=0)]))


def test_the_spacecraft_of_the_label_is_that_of_the_records(written):
    with pytest.raises(FileFormatError, match=r"7:.*181.*177"):
        read_odf(written([doppler(0), doppler(1, spacecraft=177)]))


def test_unapplied_clock_offsets_warn(written):
    clock = {"start_s": 10, "offset_ns": 500, "station": 14, "second_station": 24, "stop_s": 20}
    with pytest.warns(DataQualityWarning, match=r"1 records of clock offsets .* are not applied"):
        assert len(read_odf(written([doppler(0)], clocks=[clock]))) == 1


def test_unusable_records_warn_with_counts(written):
    records = [doppler(k) for k in range(3)]
    records += [
        doppler(3, invalid=1),
        doppler(4, invalid=1),
        doppler(5, type=51),
        doppler(6, observable=580000000),
    ]
    records += [doppler(7, type=37, receiver=54)]
    with pytest.warns(DataQualityWarning) as warnings:
        result = read_odf(written(records))
    assert len(result) == 3
    [message] = [str(item.message) for item in warnings]
    for part in (
        "5 of 8 records are left out: ",
        "2 marked as invalid (the first is record 9)",
        "1 of type 51 (angles), which is not modelled (the first is record 11)",
        "1 with a range rate above 300 km/s (the first is record 12)",
        "1 three-way ranges",
    ):
        assert part in message
    with pytest.raises(FileFormatError, match="got none: 1 marked as invalid"):
        read_odf(written([doppler(0, invalid=1)]))


def test_a_second_receiver_and_calibrated_ranges(written):
    records = [doppler(0), doppler(0, channel=7, observable=-120), doppler(1), doppler(1, channel=7)]
    records += [doppler(2, type=37, channel=3, observable=value, observable_1e9=0) for value in (-12,)]
    with pytest.warns(DataQualityWarning, match=r"2.*\(the.*7\)"):
        result = read_odf(written(records))
    assert result.line.tolist() == [6, 8, 10]
    unit_m = 2.0 * C_M_S / 2100062003.0
    assert result.value_m[2] == pytest.approx((512.0 - 12.0) * unit_m, abs=1e-9)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"type": 60}, "record 6: unknown data type 60"),
        ({"downlink": 2, "exciter": 2}, "record 6: .*in X band follows from its reference frequency at"),
    ],
)
def test_invalid_records_are_refused(written, change, problem):
    with pytest.raises(FileFormatError, match=problem):
        read_odf(written([doppler(0, **change)]))


def test_files_that_were_cut_or_changed(written):
    records = [doppler(k) for k in range(4)]
    path = written(records)
    complete = path.read_bytes()

    def problem(content):
        path.write_bytes(content)
        with pytest.raises(FileFormatError) as raised:
            read_odf(path)
        return str(raised.value)

    assert "ends 10 bytes into record 16: it was cut" in problem(complete[:-26])
    assert "without its last record" in problem(complete[: 9 * 36])
    assert "record 9: the header of the group ramps says that it is record 10" in problem(
        complete[: 6 * 36] + complete[7 * 36 :]
    )
    assert "only zeros after the end of file" in problem(complete[:-1] + b"\x01")
    assert "record 14: expected only zeros" in problem(
        complete[: 13 * 36] + b"\x01" + complete[13 * 36 + 1 :]
    )
    assert "got 110" in problem(complete[: 4 * 36] + b"\0\0\0\x6e" + complete[4 * 36 + 4 :])
    clock_group = complete[: 2 * 36] + b"\0\0\x07\xf8" + complete[2 * 36 + 4 :]  # a group of clock offsets
    assert "the group identifier has 0 records" in problem(clock_group)


def test_wrong_ramps_and_labels(written):
    records = [doppler(0)]
    stray = [RAMPS[0], RAMPS[1]]
    content = bytearray(odf(records, stray))
    content[8 * 36 + 19] = 25  # the station's last bits
    path = written(records)
    path.write_bytes(bytes(content))
    with pytest.raises(FileFormatError, match=r"9:.*25.*24"):
        read_odf(path)
    with pytest.raises(FileFormatError, match="contradict each other"):
        read_odf(written(records, [RAMPS[0], ramp(24, START_S, START_S + 9, 2100062999)]))
    with pytest.raises(FileFormatError, match=r"19501301 000000"):
        read_odf(written(records, label=(181, 1120410, 152917, 19501301, 0)))


def test_turnaround_ratios():
    """DSN handbook 810-005, module 201: ratios of S, X and Ka band."""
    assert float(turnaround_ratio("S", "S")) == pytest.approx(1.085973, abs=1e-6)
    assert float(turnaround_ratio("X", "X")) == pytest.approx(1.174900, abs=1e-6)
    assert str(turnaround_ratio("Ka", "Ka")) == "3344/3599"


def test_real_doppler_under_ramps_and_that_of_the_beacon_agree():
    """GRAIL-B, seen by DSS-34: two-way in S band, over two corners of the ramps, and the beacon in X band.

    Both speeds change by 100 m/s in the 200 s. Once the model, of a point that stands still, is taken off, two-way less
    twice one-way is the offset of the beacon's oscillator and noise: no step of a ramp is left.
    """
    result = read_odf(EXCERPT)
    still_pa_m = np.array([1737.4e3, 0.0, 0.0])
    rest_m = (
        result.value_m
        - ExactPredictor(PhysicalModel.build(), result, FixedPoint(still_pa_m)).compute().value_m
    )
    two_way, one_way = result.ramped, ~result.ramped
    assert (result.epoch.fraction[two_way] == result.epoch.fraction[one_way]).all()
    assert np.ptp(result.value_m[two_way] - 2.0 * result.value_m[one_way]) > 100.0
    offset_m = rest_m[two_way] - 2.0 * rest_m[one_way]
    assert offset_m.mean() == pytest.approx(-0.255, abs=1e-3)
    assert offset_m.std() < 0.7e-3  # noise of single counts in S band, 0.4 to 0.6 mm
    # A minute after a corner the ramp before it would be 5 m/s off.
    thirds = [part.mean() for part in np.split(offset_m[:198], 3)]
    assert np.ptp(thirds) < 0.5e-3
