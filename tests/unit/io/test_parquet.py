"""Observations as Parquet: the same there and back, and every mistake named with its row."""

import numpy as np
import pyarrow
import pytest
from arc_cases import observed_at
from pyarrow import parquet as pq

from radioloc.errors import FileFormatError, InputError
from radioloc.io import table as module
from radioloc.io.formats import read_observations, write_observations
from radioloc.io.table import read_parquet, read_table, write_parquet, write_table
from radioloc.measurements import Link
from radioloc.time.dates import utc_from_text

NUMBERS = (
    *("value_m", "sigma_m", "pressure_hpa", "temperature_k", "relative_humidity"),
    *("wavelength_um", "uplink_hz", "count_s"),
)


def assert_same(first, second):
    for name in (*NUMBERS, "tag", "kind", "link"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), name)
    assert first.links == second.links
    np.testing.assert_array_equal(first.epoch.jd, second.epoch.jd)
    np.testing.assert_array_equal(first.epoch.fraction, second.epoch.fraction)


def some_observations(count=6):
    """Return observations of three kinds, one in a leap second, others with 12 decimals."""
    texts = ["2016-12-31T23:59:60.5", "1972-01-01T00:00:00", "2024-02-29T23:59:59.999999999990"]
    texts += [f"2020-12-01T00:{k // 60:02d}:{k % 60:02d}.{7 * k:012d}" for k in range(count - 3)]
    kind = np.arange(count) % 3
    return observed_at(
        utc_from_text(texts),
        ["A>b>Ł", Link("A", "b", "C", differenced=True)],
        link=kind == 1,
        kind=kind,
        value_m=np.choose(kind, [7.9e8 + np.pi * np.arange(count), -1.2e6, -0.0]),
        sigma_m=1.0 / 3.0,
        pressure_hpa=np.where(kind == 0, 950.1, np.nan),
        uplink_hz=7.2e9,
        count_s=np.where(kind == 2, 60.0, np.nan),
    )


def test_round_trip_to_the_last_bit(tmp_path):
    observations = some_observations()
    write_parquet(tmp_path / "a.parquet", observations)
    read = read_observations(tmp_path / "a.parquet")
    assert_same(observations, read)
    assert read.line.tolist() == [1, 2, 3, 4, 5, 6]
    assert read.files == (str(tmp_path / "a.parquet"),)
    # And over the table.
    write_table(tmp_path / "a.csv", read)
    write_observations(tmp_path / "b.parquet", read_observations(tmp_path / "a.csv"))
    assert_same(observations, read_parquet(tmp_path / "b.parquet"))


def test_columns_units_and_version_are_in_the_file(tmp_path):
    write_parquet(tmp_path / "a.parquet", some_observations())
    schema = pq.read_schema(tmp_path / "a.parquet")
    assert schema.names[:7] == ["utc_date", "utc_ps", "type", "path", "observed_m", "sigma_m", "time_tag"]
    units = {name: (schema.field(name).metadata or {}).get(b"unit", b"").decode() for name in schema.names}
    assert units == {
        **{"utc_date": "", "utc_ps": "ps", "type": "", "path": "", "time_tag": ""},
        **{"observed_m": "m", "sigma_m": "m", "pressure_hpa": "hpa", "temperature_k": "k"},
        **{"relative_humidity": "1", "wavelength_um": "um", "uplink_hz": "hz", "count_s": "s"},
    }
    assert b"radioloc" in schema.metadata
    table = pq.read_table(tmp_path / "a.parquet")
    assert table.column("pressure_hpa").null_count == 4
    assert table.column("utc_ps").to_pylist()[0] == 86400500000000000


def columns(**changes):
    """Columns that another program may have written."""
    observations = {
        "epoch_utc": pyarrow.array(["2020-12-01T00:00:00.5", "2020-12-01T00:00:01", "2020-12-01T00:00:02"]),
        "type": pyarrow.array(["range"] * 3),
        "path": pyarrow.array(["A>b>A", "A>b>C", "A>b>A"]),
        "light_time_s": pyarrow.array([2.5, 2.6, 2.7]),
        "sigma_s": pyarrow.array([1e-9, 1e-9, 1e-9]),
        "time_tag": pyarrow.array(["receive"] * 3),
    } | changes
    return {name: values for name, values in observations.items() if values is not None}


def read_columns(folder, **changes):
    pq.write_table(pyarrow.table(columns(**changes)), folder / "a.parquet")
    return read_parquet(folder / "a.parquet")


def test_files_of_other_programs(tmp_path):
    read = read_columns(tmp_path)
    assert read.paths().tolist() == ["A>b>A", "A>b>C", "A>b>A"]
    rows = zip(*(column.to_pylist() for column in columns().values()), strict=True)
    lines = [",".join(columns()), *(",".join(map(str, row)) for row in rows)]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    assert_same(read_table(tmp_path / "a.csv"), read)
    for unit in ("ms", "us", "ns"):
        stamps = np.array(
            ["2020-12-01T00:00:00.5", "2020-12-01T00:00:01", "2020-12-01T00:00:02"], f"M8[{unit}]"
        )
        for zone in (None, "UTC"):
            column = pyarrow.array(stamps).cast(pyarrow.timestamp(unit, tz=zone))
            assert_same(read, read_columns(tmp_path, epoch_utc=column))
    assert_same(
        read, read_columns(tmp_path, path=pyarrow.array(["A>b>A", "A>b>C", "A>b>A"]).dictionary_encode())
    )
    all_columns = read_columns(
        tmp_path, light_time_s=None, observed_m=pyarrow.array([750000000, 760000000, 770000000])
    )
    assert all_columns.value_m.tolist() == [7.5e8, 7.6e8, 7.7e8]


DATES = pyarrow.array(np.array(["2020-12-01"] * 3, "M8[D]"))


@pytest.mark.parametrize(
    ("changes", "row", "words"),
    [
        ({"sigma_s": None}, None, "column sigma_m or sigma_s is missing"),
        ({"epoch_utc": None, "utc_date": DATES}, None, "column 'utc_ps' is missing"),
        ({"utc_date": DATES, "utc_ps": pyarrow.array([1, 2, 3])}, None, "redundant"),
        ({"light_time_s": pyarrow.array(["2.5", "2.6", "2.7"])}, None, "got type string"),
        ({"sigma_s": pyarrow.array([1e-9, None, 1e-9])}, 2, r"sigma_s: missing value"),
        ({"light_time_s": pyarrow.array([2.5, np.nan, 2.7])}, 2, "got nan"),
        ({"epoch_utc": pyarrow.array(["2020-12-01", "2020-13-01", "now"])}, 2, "epoch_utc: .* not a date"),
        (
            {"epoch_utc": None, "utc_date": DATES, "utc_ps": pyarrow.array([0, 86400 * 10**12, 5])},
            2,
            "utc_ps: expected a time of day of 0 to less than 86400e12 ps",
        ),
    ],
)
def test_unusable_rows_are_refused_with_their_number(tmp_path, changes, row, words):
    with pytest.raises(FileFormatError, match=words) as caught:
        read_columns(tmp_path, **changes)
    assert caught.value.line == row
    assert "\n" not in str(caught.value)
    assert "a.parquet" in str(caught.value)


def test_rows_count_on_from_batch_to_batch(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_ROWS_READ", 4)
    observations = some_observations(20)
    write_parquet(tmp_path / "a.parquet", observations)
    read = read_parquet(tmp_path / "a.parquet")
    assert_same(observations, read)
    assert read.line.tolist() == list(range(1, 21))
    table = pq.read_table(tmp_path / "a.parquet")
    sigma_m = np.full(20, 0.1)
    sigma_m[13] = -1.0
    pq.write_table(table.set_column(5, "sigma_m", pyarrow.array(sigma_m)), tmp_path / "a.parquet")
    with pytest.raises(FileFormatError, match=r"14: sigma_m:.*-1"):
        read_parquet(tmp_path / "a.parquet")


def test_endings_say_the_format(tmp_path):
    header = "epoch_utc,type,path,observed_m,sigma_m,time_tag"
    (tmp_path / "given.csv").write_text(f"{header}\n2020-12-01,range,A>b>C,7.5e8,1,receive")
    observations = read_table(tmp_path / "given.csv")
    starts = {"a.csv": b"epoch_utc", "a.parquet": b"PAR1", "a.tdm": b"CCSDS"}
    for name, start in starts.items():
        write_observations(tmp_path / name, observations, originator="X")
        assert (tmp_path / name).read_bytes().startswith(start)
    with pytest.raises(InputError, match="extension"):
        write_observations(tmp_path / "a.txt", observations)
    with pytest.raises(InputError, match="originator"):
        write_observations(tmp_path / "b.tdm", observations)
