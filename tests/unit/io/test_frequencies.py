"""Received frequencies of STRF files: what becomes of each field, what the study adds, what is refused."""

import numpy as np
import pytest

from radioloc.constants import C_M_S
from radioloc.earth import geodetic_from_itrf
from radioloc.errors import DataQualityWarning, FileFormatError, InputError
from radioloc.io import FrequencyAgreement, read_observations, read_sites
from radioloc.io.frequencies import read_strf
from radioloc.time import utc_strings

BEACON_HZ, COUNT_S, SIGMA_HZ = 2.2165e9, 10.0, 0.5
BEACON = FrequencyAgreement(transmit_hz=BEACON_HZ, sigma_hz=SIGMA_HZ, count_s=COUNT_S)
# As rffit writes: MJD, Hz, flux, site; the last line has a second site, whose signal is reflected.
READINGS = (
    "59902.606603\t2216497878.100\t   9.610\t8049\n"
    "59902.606719 2216497877.100 0.000218 4171\n"
    "# peaks read off by hand\n"
    "\n"
    "59902.606835\t2216497876.000\t   8.097\t8049\t9999\n"
)


def write(path, text):
    path.write_text(text)
    return path


def growth_m(received_hz, sent_hz, ratio=1.0, count_s=COUNT_S):
    return C_M_S * count_s * (1.0 - received_hz / (ratio * sent_hz))


# Rounding of a frequency at 2.2 GHz, 2e-7 Hz, over ten seconds.
TOLERANCE_M = 5e-7


def test_readings_of_strf(tmp_path):
    got = read_strf(write(tmp_path / "a.dat", READINGS), [BEACON])
    assert got.paths().tolist() == [
        "lander>COSPAR 8049",
        "lander>COSPAR 4171",
        "COSPAR 9999>lander>COSPAR 8049",
    ]
    assert got.types().tolist() == ["one_way_doppler", "one_way_doppler", "doppler"]
    assert got.tags().tolist() == ["receive"] * 3
    # 0.606603 of 86400 s is 52410.4992 s.
    assert utc_strings(got.epoch, 4)[0] == "2022-11-19T14:33:30.4992"
    wanted_m = growth_m(np.array([2216497878.1, 2216497877.1, 2216497876.0]), BEACON_HZ)
    assert got.value_m == pytest.approx(wanted_m, abs=TOLERANCE_M)
    assert got.sigma_m == pytest.approx(C_M_S * COUNT_S * SIGMA_HZ / BEACON_HZ, rel=1e-15)
    assert got.count_s.tolist() == [COUNT_S] * 3
    assert np.isnan(got.uplink_hz).tolist() == [True, True, False]
    assert got.wavelength_um == pytest.approx(1e6 * C_M_S / BEACON_HZ, rel=1e-15)
    assert [got.origin(row).rpartition(" ")[2] for row in range(3)] == ["1", "2", "5"]


def test_a_heading_and_an_order_that_is_none(tmp_path):
    """Spreadsheets write a heading without a comment, readings out of order and other line ends."""
    lines = [line for line in READINGS.splitlines() if line[:2] == "59"]
    path = tmp_path / "a.dat"
    path.write_bytes("\r\n".join(["MJD Freq Flux Site", *reversed(lines), ""]).encode())
    got = read_observations(path, frequencies=[BEACON])
    in_order = read_strf(write(tmp_path / "b.dat", READINGS), [BEACON])
    assert got.value_m.tolist() == in_order.value_m.tolist()[::-1]
    assert got.line.tolist() == [2, 3, 4]


def test_dates_of_older_readings(tmp_path):
    """An instant in both forms: 0.606603 of 86400 s is 14:33:30.4992."""
    newer = write(tmp_path / "a.dat", "59902.606603\t2216497878.100\t9.6\t8049\n")
    older = write(tmp_path / "b.dat", "22/11/19 14:33:30.4992 2216497878.100 nan 8049\n")
    observations = [read_strf(path, [BEACON]) for path in (newer, older)]
    assert utc_strings(observations[1].epoch, 4).tolist() == ["2022-11-19T14:33:30.4992"]
    assert observations[0].value_m.tolist() == observations[1].value_m.tolist()
    assert len(read_observations(older, frequencies=[BEACON])) == 1
    older.write_text("22/02/30 14:33:30.4 2216497878.100 1.0 8049\n")
    with pytest.raises(FileFormatError, match=r"b.dat, line 1: .*2022-02-30"):
        read_strf(older, [BEACON])


def test_several_files_of_one_night(tmp_path):
    """Each file has its transmitted frequency; a reading in two files counts once."""
    first = write(tmp_path / "one.dat", READINGS)
    second = write(
        tmp_path / "two.dat", READINGS.splitlines(keepends=True)[0] + "59902.7 8459278000.5 1 4171\n"
    )
    third = write(tmp_path / "three.txt", "59903.25\t8412000000.0\t10.0\t4171\n")
    agreements = [
        FrequencyAgreement(8412e6, 0.1, 1.0, files="three*"),
        FrequencyAgreement(BEACON_HZ, SIGMA_HZ, COUNT_S),
    ]
    with pytest.raises(FileFormatError, match=r"2: 8459278000.5 Hz.*2216500000.0 Hz"):
        read_observations([first, second, third], frequencies=agreements)
    second.write_text(READINGS.splitlines(keepends=True)[0])
    with pytest.warns(DataQualityWarning, match=r"1:.*one.dat.*1"):
        got = read_observations([first, second, third], frequencies=agreements)
    assert len(got) == 4
    assert got.value_m[-1] == 0.0


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"transmit_hz": 0.0}, "transmit_hz: expected a finite number above zero, got 0.0"),
        ({"turnaround": (880, 749)}, "give both or neither"),
        ({"target": "a>b"}, "got 'a>b'"),
    ],
)
def test_invalid_agreements_are_refused(fields, problem):
    with pytest.raises(InputError, match=problem):
        FrequencyAgreement(**{"transmit_hz": 2.2e9, "sigma_hz": 1.0} | fields)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("59902.6 2216497878.1 9.6 8049\n59902.6 nonsense 9.6 8049\n", "line 2: expected date"),
        ("19902.6 2216497878.1 9.6 8049\n", "line 1: expected a year from 1972 to 2100, got the date 1913"),
    ],
)
def test_files_that_are_refused(text, problem, tmp_path):
    path = write(tmp_path / "a.txt", text)
    with pytest.raises(FileFormatError, match=problem):
        read_observations(path, frequencies=[BEACON])


def test_missing_transmitted_frequency_is_refused(tmp_path):
    path = write(tmp_path / "a.dat", READINGS)
    with pytest.raises(FileFormatError, match=r"give transmit_hz .* \[\[observations.frequencies\]\]"):
        read_observations(path, frequencies=[FrequencyAgreement(2e9, 1.0, files="*.txt")])


def test_sites(tmp_path):
    path = write(
        tmp_path / "sites.txt",
        "# No ID   Latitude Longitude   Elev   Observer\n4171 CB   52.8344    6.3785     10    Cees Bassa\n"
        "0699 PC  -14.4733  132.2369    108    Paul Camilleri\n",
    )
    first, second = read_sites(path)
    assert (first.name, second.name) == ("COSPAR 4171", "COSPAR 0699")
    place = geodetic_from_itrf(second.itrf_m)
    shown = [*np.degrees([place.longitude_rad, place.latitude_rad]), float(place.height_m)]
    assert shown == pytest.approx([132.2369, -14.4733, 108.0], abs=1e-6)
    assert first.position_sigma_m == 100.0  # four decimals of a degree, and a height above the sea
    for line, problem in (
        ("4171 CB 52.8 6.4 10 Other\n", "site 4171 is repeated"),
        ("4172 CB 92.8 6.4 10\n", "up to 90 and 360 degrees"),
        ("4172 CB 52.8 6.4\n", "expected number, initials"),
    ):
        wrong = write(tmp_path / "wrong.txt", path.read_text() + line)
        with pytest.raises(FileFormatError, match=rf"line 4: .*{problem}"):
            read_sites(wrong)


STUDY = """
[target]
longitude_deg = -51.9
latitude_deg = 43.0
height_m = -2550.0
[observations]
files = ["*.dat"]
sites = ["sites.txt"]
[[observations.frequencies]]
transmit_hz = 2216.5e6
sigma_hz = 0.5
count_s = 10
"""


def test_a_study_of_frequencies(tmp_path):
    """Sites are stations of the study; a reading of an hour is compared with the model along the way."""
    import radioloc

    write(tmp_path / "sites.txt", "8049 ST   49.4348 -123.6685     40.   Scott Tilley\n")
    rows = [f"{59902.6 + k / 1440:.6f}\t2216500000.000\t 1.0\t8049\n" for k in range(10)]
    write(tmp_path / "night.dat", "".join(rows))
    study = radioloc.read_study(write(tmp_path / "study.toml", STUDY))
    result = radioloc.compute_residuals(study)
    assert set(result.residuals.station) == {"COSPAR 8049"}
    # The Earth turns and the Moon goes round: hundreds of metres a second, which a beacon at rest does not show.
    assert 100.0 < np.abs(result.residuals.residual_m / COUNT_S).max() < 1000.0
    with pytest.raises(InputError, match=r"\[observations.frequencies\] transmit_hz: .* got 0"):
        radioloc.read_study(write(tmp_path / "study.toml", STUDY.replace("2216.5e6", "0.0")))
