"""Tables in memory: conversion to observations, and errors that name column and row."""

import astropy.units as u
import numpy as np
import pandas
import polars
import pyarrow
import pytest
from arc_cases import observed_at
from astropy.table import MaskedColumn, QTable, Table
from astropy.time import Time
from paths import EXAMPLES

import radioloc
from radioloc import Observations
from radioloc.constants import C_M_S
from radioloc.errors import DataQualityWarning, FileFormatError, InputError
from radioloc.measurements import Link
from radioloc.time import epochs_from_strings

RANGES = EXAMPLES / "apollo15" / "apollo15_apollo_2006-2007.csv"
DATES = ["2024-05-02T06:00:00.25", "2024-05-02T06:10:00.5"]
PATH = "KASHI>lander>KASHI"
COLUMNS = {
    "epoch_utc": DATES, "type": ["range"] * 2, "path": [PATH] * 2, "observed_m": [765432100.5, 765400200.25],
    "sigma_m": [2.5, 2.0], "time_tag": ["receive"] * 2, "pressure_hpa": [870.0, np.nan],
}  # fmt: skip


@pytest.fixture(scope="module")
def expected():
    return observed_at(
        DATES,
        "KASHI>lander>KASHI",
        value_m=[765432100.5, 765400200.25],
        sigma_m=[2.5, 2.0],
        pressure_hpa=[870.0, np.nan],
    )


def in_time_zone():
    dates = pandas.to_datetime(DATES).tz_localize("UTC").tz_convert("Asia/Shanghai")
    return pandas.DataFrame(COLUMNS | {"epoch_utc": dates})


def nullable():
    frame = pandas.DataFrame(COLUMNS).convert_dtypes()
    return frame.astype({"path": "category", "type": "category"})


def masked():
    pressure = MaskedColumn([87000.0, 1.0], mask=[False, True], unit="Pa")
    return Table(COLUMNS | {"pressure_hpa": pressure, "path": np.array([PATH, PATH], dtype="S")})


TABLES = {
    "a dictionary of lists": lambda: COLUMNS,
    "a dictionary of arrays": lambda: {name: np.array(column) for name, column in COLUMNS.items()},
    "pandas": lambda: pandas.DataFrame(COLUMNS),
    "pandas by dates": lambda: pandas.DataFrame(COLUMNS).assign(
        epoch_utc=pandas.to_datetime(DATES)).set_index("epoch_utc"),
    "pandas with selected rows": lambda: pandas.DataFrame(COLUMNS).iloc[[1, 0]].iloc[[1, 0]],
    "pandas in a time zone": in_time_zone,
    "pandas with nulls and categories": nullable,
    "Arrow": lambda: pyarrow.table({name: list(column) for name, column in COLUMNS.items()}),
    "Arrow with units": lambda: pyarrow.table(
        [pyarrow.array(column) for column in (COLUMNS | {"observed_m": [765432.1005, 765400.20025]}).values()],
        pyarrow.schema([
            pyarrow.field(name, pyarrow.array(column).type, metadata={"unit": "km"} if name == "observed_m" else None)
            for name, column in COLUMNS.items()
        ]),
    ),
    "Arrow with views of texts": lambda: pyarrow.table({
        name: pyarrow.array(column, pyarrow.string_view() if isinstance(column[0], str) else None)
        for name, column in COLUMNS.items()}),
    "polars": lambda: polars.DataFrame(COLUMNS),
    "polars with categories and dates": lambda: polars.DataFrame(COLUMNS).with_columns(
        polars.col("path").cast(polars.Categorical), polars.col("type").cast(polars.Enum(["range", "doppler"])),
        polars.col("epoch_utc").str.to_datetime(time_unit="us")),
    "polars in several pieces": lambda: polars.concat(
        [polars.DataFrame(COLUMNS)[:1], polars.DataFrame(COLUMNS)[1:]], rechunk=False),
    "astropy": lambda: Table(COLUMNS),
    "astropy with units": lambda: QTable(
        COLUMNS | {"observed_m": [765432.1005, 765400.20025] * u.km, "sigma_m": [25, 20] * u.dm}),
    "astropy with a masked column": masked,
    "a Time in TDB": lambda: COLUMNS | {"epoch_utc": Time(DATES, scale="utc").tdb},
    "Epochs": lambda: COLUMNS | {"epoch_utc": epochs_from_strings(DATES, "UTC")},
}  # fmt: skip


@pytest.mark.parametrize("make", TABLES.values(), ids=TABLES.keys())
def test_tables_of_all_kinds(make, expected):
    observations = Observations.from_table(make())
    # Conversion by TDB rounds an epoch to a tenth of a nanosecond, conversion of units the last digit.
    off_s = 86400.0 * np.abs(observations.epoch.fraction - expected.epoch.fraction)
    assert off_s.max() < 1e-9
    np.testing.assert_allclose(observations.value_m, expected.value_m, rtol=1e-15)
    np.testing.assert_allclose(observations.sigma_m, expected.sigma_m, rtol=1e-15)
    np.testing.assert_allclose(observations.pressure_hpa, expected.pressure_hpa, rtol=1e-15, equal_nan=True)
    assert observations.paths().tolist() == [PATH, PATH]
    assert observations.tags().tolist() == ["receive", "receive"]


def test_columns_of_other_names_with_units_and_constants(expected):
    frame = pandas.DataFrame(
        {
            "t": DATES,
            "rho": [765432.1005, 765400.20025],
            "s": [8.0, 7.0],
            "p": [87.0, np.nan],
            "remark": ["", "low"],
        }
    )
    observations = Observations.from_table(
        frame,
        columns={"epoch_utc": "t", "observed_m": "rho", "sigma_s": "s", "pressure_hpa": "p"},
        units={"rho": "km", "s": "ns", "p": "kPa"},
        type="range",
        path=PATH,
        time_tag="receive",
    )
    np.testing.assert_allclose(observations.value_m, expected.value_m, rtol=1e-15)
    np.testing.assert_allclose(observations.sigma_m, C_M_S * np.array([8e-9, 7e-9]), rtol=1e-15)
    np.testing.assert_allclose(observations.pressure_hpa, [870.0, np.nan], equal_nan=True)
    by_time = Observations.from_table(
        {"epoch_utc": DATES, "light_time_s": [2.553, 2.554] * u.s},
        type="range", path=PATH, time_tag="receive", sigma_m=25.0 * u.dm,
    )  # fmt: skip
    np.testing.assert_allclose(by_time.value_m, C_M_S * np.array([2.553, 2.554]), rtol=1e-15)
    assert by_time.sigma_m.tolist() == [2.5, 2.5]


def test_station_names_of_the_catalogue():
    observations = Observations.from_table(COLUMNS | {"path": ["Kashi>LANDER>kashi"] * 2})
    assert observations.links == (Link("KASHI", "lander", "KASHI"),)


@pytest.mark.parametrize("form", ["astropy", "pandas"])
def test_round_trip_of_tables(form):
    observations = radioloc.read_observations(RANGES)
    back = Observations.from_table(observations.to_table(form))
    off_s = 86400.0 * np.abs(back.epoch.fraction - observations.epoch.fraction)
    assert off_s.max() <= {"astropy": 1e-11, "pandas": 0.6e-9}[form]
    assert np.array_equal(back.value_m, observations.value_m)
    assert np.array_equal(back.wavelength_um, observations.wavelength_um)
    assert np.array_equal(back.line, np.arange(1, 154))


def test_leap_seconds_in_astropy_but_not_in_pandas():
    leap = epochs_from_strings(["2016-12-31T23:59:60.5", "2016-12-31T12:00:00"], "UTC")
    observations = observed_at(leap, "KASHI>lander>KASHI", tag="transmit", value_m=7.6e8)
    table = observations.to_table()
    assert table["epoch_utc"].isot.tolist() == ["2016-12-31T23:59:60.500", "2016-12-31T12:00:00.000"]
    back = Observations.from_table(table).epoch
    assert np.abs(86401.0 * (back.fraction - leap.fraction)).max() < 1e-11
    with pytest.raises(InputError, match=r"2016-12-31T23:59:60\.500"):
        observations.to_table("pandas")
    noon = observations[1:].to_table("pandas")["epoch_utc"][0]
    assert noon.isoformat() == "2016-12-31T12:00:00+00:00"


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (3.0, "got float"),
        (COLUMNS | {"presure": [870.0, 870.0]}, "unknown column 'presure'"),
        (COLUMNS | {"observed_m": [7.65e8, np.nan]}, "table, line 2: observed_m"),
        (COLUMNS | {"observed_m": [2.5, 2.6] * u.s}, "observed_m is in s; give m"),
        (COLUMNS | {"epoch_utc": [2460432.75, 2460432.76]}, "epoch_utc: .* got type double"),
    ],
)
def test_unusable_tables(table, words):
    with pytest.raises(InputError, match=words):
        Observations.from_table(table)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"columns": {"observed_m": "rho"}}, "columns: observed_m: .*got 'rho'"),
        ({"units": {"observed_m": "parsnip"}}, "observed_m: .* got 'parsnip'"),
        ({"units": {"path": "km"}}, "units: path"),
    ],
)
def test_unusable_arguments(arguments, words):
    with pytest.raises(InputError, match=words):
        Observations.from_table(COLUMNS, **arguments)


def test_file_with_columns_of_its_own(tmp_path):
    path = tmp_path / "own.csv"
    rows = ["time;site;rho km;note", f"{DATES[0]};KASHI;765432.1005;a, b", f"{DATES[1]};APOLLO;765400.20025;"]
    path.write_text("\n".join(["# log", *rows]), encoding="utf-8")
    settings = {
        "columns": {"epoch_utc": "time", "observed_m": "rho km"},
        "units": {"rho km": "km"},
        "type": "range",
        "time_tag": "receive",
        "sigma_m": 2.5,
    }
    observations = Observations.from_table(path, path="{site}>lander>{site}", **settings)
    assert observations.paths().tolist() == [PATH, "APOLLO>lander>APOLLO"]
    assert observations.value_m == pytest.approx(COLUMNS["observed_m"], abs=1e-6)
    assert observations.epoch.fraction == pytest.approx(epochs_from_strings(DATES, "UTC").fraction, abs=1e-15)
    with pytest.raises(InputError, match="got 'station'"):
        Observations.from_table(path, path="{station}>lander>{site}", **settings)
    path.write_text(path.read_text().replace("765400.20025", "inf"), encoding="utf-8")
    with pytest.raises(FileFormatError, match=r"own\.csv") as caught:
        Observations.from_table(path, path="{site}>lander>{site}", **settings)
    assert caught.value.line == 4


@pytest.mark.parametrize("header", ["time,rho,err", "epoch_utc,type,path,rho"])
def test_error_of_a_file_with_other_columns_names_the_function_that_reads_it(header, tmp_path):
    (tmp_path / "own.csv").write_text(f"{header}\n", encoding="utf-8")
    first = header.partition(",")[0]
    with pytest.raises(FileFormatError, match=f"from_table.'own.csv', columns=.'epoch_utc': '{first}'"):
        radioloc.read_observations(tmp_path / "own.csv")


def test_duplicate_columns():
    frame = pandas.concat([pandas.DataFrame(COLUMNS), pandas.DataFrame({"sigma_m": [3.0, 3.0]})], axis=1)
    arrow = pyarrow.Table.from_arrays(
        [*map(pyarrow.array, COLUMNS.values()), [3.0, 3.0]], [*COLUMNS, "sigma_m"]
    )
    for table in (frame, arrow, arrow.to_batches()[0]):
        with pytest.raises(InputError, match="sigma_m"):
            Observations.from_table(table)


def test_columns_of_mixed_types():
    mixed = COLUMNS | {"path": np.array([PATH, 3], dtype=object)}
    for table in (mixed, pandas.DataFrame(mixed)):
        with pytest.raises(InputError, match="path"):
            Observations.from_table(table)


def test_duplicate_rows_are_removed():
    duplicated = {name: [column[0]] * 2 for name, column in COLUMNS.items()}
    with pytest.warns(DataQualityWarning, match="duplicate"):
        assert len(Observations.from_table(duplicated)) == 1
