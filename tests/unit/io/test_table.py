"""The project's own table: lossless there and back, and every mistake named with its line."""

import numpy as np
import pytest
from arc_cases import observed_at
from hypothesis import given, settings
from hypothesis import strategies as st

from radioloc.constants import C_M_S
from radioloc.errors import FileFormatError, InputError
from radioloc.io import read_table, table, write_table
from radioloc.text_files import read_blocks
from radioloc.time import Epochs

NUMBERS = ("value_m", "sigma_m", "pressure_hpa", "temperature_k", "relative_humidity", "wavelength_um")
# Text with 12 decimals rounds by half of the last one, the float then by half its own width, here below that.
EPOCH_TOLERANCE_S = 1e-12


def parse_table(path, lines, catalogue):
    return table._from_blocks(path, [(1, "\n".join(lines).encode())], catalogue)


def assert_same(first, second, epoch_tolerance_s=0.0):
    for name in (*NUMBERS, "tag", "kind"):
        assert np.array_equal(getattr(first, name), getattr(second, name), equal_nan=name in NUMBERS), name
    assert first.paths().tolist() == second.paths().tolist()
    days = (first.epoch.jd - second.epoch.jd) + (first.epoch.fraction - second.epoch.fraction)
    assert np.abs(days).max() * 86400.0 <= epoch_tolerance_s


def test_values_of_each_row(table_lines):
    read = parse_table("a.csv", table_lines, None)
    assert read.line.tolist() == [3, 5, 6]
    assert read.paths().tolist() == [
        "APOLLO>apollo15>APOLLO",
        "APOLLO>apollo11>APOLLO",
        "GRASSE>apollo15>GRASSE",
    ]
    assert read.tags().tolist() == ["transmit", "receive", "bounce"]
    assert read.value_m[0] == C_M_S * 2.6494326499837
    assert read.sigma_m[0] == C_M_S * 5.38e-11
    assert read.pressure_hpa[0] == 721.6
    assert np.isnan(read.pressure_hpa).tolist() == [False, True, True]
    assert np.isnan(read.wavelength_um).tolist() == [False, True, False]


@pytest.mark.parametrize("light_time", [False, True])
def test_round_trip_of_a_table(crd_lines, tmp_path, light_time):
    from radioloc.io.crd import parse_crd

    first = parse_crd("a.np2", crd_lines, None)
    file = tmp_path / "a.csv"
    write_table(file, first, light_time=light_time, comments=["one\ntwo", "three"])
    second = read_table(file)
    assert_same(first, second)
    assert file.read_text(encoding="utf-8").startswith("# one\n# two\n# three\nepoch_utc,type,path,")
    if light_time:
        assert ",2.581730448437," in file.read_text(encoding="utf-8")
    second_file = tmp_path / "b.csv"
    write_table(second_file, second, light_time=light_time, comments=["one", "two", "three"])
    assert second_file.read_bytes() == file.read_bytes()


finite = st.floats(1e-3, 1e12, allow_nan=False)


@given(
    days=st.lists(st.integers(0, 20000), min_size=1, max_size=5),
    fraction=st.floats(0.0, 1.0, exclude_max=True),
    value=st.floats(6.6e8, 8.3e8),  # round trips between Earth and Moon
    sigma=finite,
    pressure=st.one_of(st.just(np.nan), st.floats(100.0, 1100.0)),
    tag=st.integers(0, 2),
)
def test_any_observations_come_back(days, fraction, value, sigma, pressure, tag, tmp_path_factory):
    n = len(days)
    observations = observed_at(
        Epochs.from_jd(2441317.5 + np.array(days), fraction, "UTC"),
        "A>b c>Ł",
        value_m=value + np.arange(n),
        sigma_m=sigma,
        pressure_hpa=pressure,
        tag=tag,
    )
    # Rows that fall together would be refused: one observation has one value.
    observations = observations.select(np.sort(np.unique(observations.epoch.jd, return_index=True)[1]))
    file = tmp_path_factory.mktemp("table") / "a.csv"
    write_table(file, observations)
    first = read_table(file)
    assert_same(observations, first, EPOCH_TOLERANCE_S)
    write_table(file, first)
    assert_same(first, read_table(file))


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        (",sigma_s,", ",sigma,", 2, "unknown column 'sigma'"),
        (",pressure_hpa,", ",observed_m,", 2, "observed_m and light_time_s"),
        ("epoch_utc,", "", 2, "epoch_utc is missing"),
        (",5.38e-11,", ",5.38f-11,", 3, "got '5.38f-11'"),
        (",721.6,", ",72160,", 3, "100 to 1100"),
        ("2006-12-01T00:26:56Z", "1971-12-01", 6, "before 1972"),
        ("GRASSE>AP15>GRASSE", '"GRASSE>AP15>GRASSE', 6, "quotes|fields"),
    ],
)
def test_unusable_rows_are_refused_with_their_line(table_lines, old, new, line, words):
    text = "\n".join(table_lines)
    assert old in text
    with pytest.raises(FileFormatError, match=words) as caught:
        parse_table("a.csv", text.replace(old, new, 1).split("\n"), None)
    assert caught.value.line == line


def test_a_table_without_rows_is_refused(table_lines):
    with pytest.raises(FileFormatError, match="expected observations"):
        parse_table("a.csv", table_lines[:2], None)
    with pytest.raises(FileFormatError, match="no header"):
        parse_table("a.csv", table_lines[:1], None)


def test_two_values_of_one_observation_are_refused(table_lines):
    other_line = table_lines[4].replace("2.4053617732419", "2.4053617732519")
    with pytest.raises(InputError, match=r"7:.*5 \(1"):
        parse_table("a.csv", [*table_lines[:-1], other_line, ""], None)
    # At another wavelength or over another count interval it is another observation.
    assert len(parse_table("a.csv", [*table_lines[:-1], f"{other_line}1.064", ""], None)) == 4


def test_cut_inside_the_last_number():
    """0.75 instead of 0.752 is a wavelength too."""
    header = "epoch_utc,type,path,light_time_s,sigma_s,time_tag,wavelength_um\n"
    row = "2006-04-07T06:26:30.0,range,APOLLO>apollo15>APOLLO,2.4053617732419,4.74e-11,receive,0.752"
    assert parse_table("a.csv", f"{header}{row}\n".split("\n"), None).wavelength_um[0] == 0.752
    with pytest.raises(FileFormatError, match=r"2:.*wavelength_um"):
        parse_table("a.csv", f"{header}{row}"[:-1].split("\n"), None)
    # A cut time tag is refused.
    complete = f"{header}{row}\n".replace(",wavelength_um", "").replace(",0.752\n", "")
    assert len(parse_table("a.csv", complete.split("\n"), None)) == 1


HEADER = "epoch_utc,type,path,observed_m,sigma_m,time_tag"


def rows(count):
    return [
        f"2020-01-{1 + k % 28:02d}T{k % 24:02d}:00:{k % 60:02d}.{k:03d},"
        f"range,A>b>{'AC'[k % 2]},7.{k:05d}1234567e8,0.01,receive"
        for k in range(count)
    ]


@pytest.mark.parametrize("number", [0, 57, 199])
def test_error_far_down_names_its_line(tmp_path, monkeypatch, number):
    monkeypatch.setattr(table, "read_blocks", lambda path: read_blocks(path, 1000))
    lines = rows(200)
    lines[number] = lines[number].replace("range", "rnage")
    file = tmp_path / "a.csv"
    file.write_text("\n".join(["# comment", "", HEADER, *lines]))
    with pytest.raises(FileFormatError, match="got 'rnage'") as caught:
        read_table(file)
    assert caught.value.line == number + 4


def read_values(*texts, column="observed_m"):
    """Numbers of a column; ranges of a spacecraft, which may have any length above zero."""
    lines = [HEADER, *rows(len(texts))]
    for k, text in enumerate(texts, start=1):
        fields = lines[k].split(",")
        fields[HEADER.split(",").index(column)] = text
        lines[k] = ",".join(fields)
    blocks = [(1, "\n".join(lines).encode())]
    return table._from_blocks("a.csv", blocks, None, lunar=False)


@settings(deadline=None)
@given(st.lists(st.floats(1e-300, 1e300), min_size=1, max_size=9), st.integers(0, 20))
def test_numbers_of_any_size_and_length_are_the_nearest_floats(values, decimals):
    for texts in (
        [repr(v) for v in values],
        [f"{v:.{decimals}e}" for v in values],
        [f" +{v!r}\t" for v in values],
    ):
        np.testing.assert_array_equal(read_values(*texts).value_m, [float(text) for text in texts])


@pytest.mark.parametrize(
    "text", ["", "-", "e5", "1e", "1e+", "1.2.3", "1e5.5", "1_0", "٣", "1 2", "--5", "0x10", "1d5"]
)
def test_invalid_numbers(text):
    with pytest.raises(FileFormatError, match="expected a number") as caught:
        read_values("1.5", text, "2.5")
    assert caught.value.line == 3
