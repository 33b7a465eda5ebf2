"""Columns as comma-separated text: to the letter what Python writes, or what Python reads as the same float."""

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.io import read_observations, write_observations
from radioloc.io.table import batches_of, write_csv
from radioloc.measurements import Link, Observations, Ramps
from radioloc.text_files import text_of_cell
from radioloc.time import epochs_from_strings


def write(path, columns, decimals=None, **options):
    write_csv(path, batches_of(columns, decimals or {}), **options)
    return path.read_text(encoding="utf-8")


def test_decimals_are_those_of_python(tmp_path):
    values = np.array([0.99999999, -9.99999999, 1999.99999996, -0.0, 0.0, 0.5e-7, 2.0**-9, 1e22])
    written = write(tmp_path / "a.csv", {"x": values}, {"x": 7}).splitlines()
    assert written[1:] == [f"{value:.7f}" for value in values]
    assert written[1:5] == ["1.0000000", "-10.0000000", "2000.0000000", "-0.0000000"]


@pytest.mark.parametrize(
    ("name", "words"),
    [("\ud800", "is not text"), ("a\nb", "line break"), ("a,\r\nb", "line break")],
)
def test_invalid_texts_are_refused(tmp_path, name, words):
    with pytest.raises(InputError, match=words):
        write(tmp_path / "a.csv", {"name": [name]})
    with pytest.raises(InputError, match="is not text"):
        write(tmp_path / "a.csv", {"name": ["a"]}, comments=["\ud800"])
    assert not (tmp_path / "a.csv").exists()


def test_texts_with_commas_and_quotes_are_quoted_and_numbers_are_not(tmp_path):
    columns = {
        "name": ["lander, 4 h", 'the "near" side', "plain"],
        "x": [0.1, None, 2.0],
        "used": [True, False, None],
    }
    lines = write(tmp_path / "a.csv", columns | {"y": np.ones(3)}, {"y": 2}).splitlines()
    assert lines[1:] == ['"lander, 4 h",0.1,true,1.00', '"the ""near"" side",,false,1.00', "plain,2,,1.00"]


FORMULAS = ["=cmd|'/C calc'!A0", "+1+1", "-2+3+cmd", "@SUM(A1)", "\t=1", "＝1+1", "'=A1", "''-x"]


def test_names_that_a_spreadsheet_would_compute_are_texts_in_csv_and_come_back(tmp_path):
    texts = ["KASHI", "'quoted", "-", "", "-1.5", "+2e-3", "a=b"]
    written = write(tmp_path / "a.csv", {"name": [*FORMULAS, *texts], "=x": np.arange(15.0) - 8.0})
    heading, *rows = written.split("\n")[:-1]
    assert heading == "name,'=x"
    cells = [row.rpartition(",")[0] for row in rows]
    assert cells == [f"'{name}" for name in FORMULAS] + texts
    assert [text_of_cell(cell) for cell in cells] == [*FORMULAS, *texts]
    assert [row.rpartition(",")[2] for row in rows][:2] == ["-8", "-7"]


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_stations_with_names_of_formulas_are_read_back_by_their_names(tmp_path, ending):
    names = ["=HYPERLINK(0)", "@DSS", "-x", "'=A"]
    observations = Observations.from_columns(
        epoch=epochs_from_strings(["2024-05-02T06:00:00"] * 4, "UTC"),
        links=[Link(name, "lander", name) for name in names], link=np.arange(4), value_m=7.6e8, sigma_m=1.0,
        ramps=Ramps.from_columns(
            names,
            epochs_from_strings(["2024-05-02T06:00:00"] * 4, "UTC"),
            epochs_from_strings(["2024-05-02T07:00:00"] * 4, "UTC"),
            np.full(4, 7.2e9), np.zeros(4)),
    )  # fmt: skip
    files = write_observations(tmp_path / f"a.{ending}", observations)
    reread = read_observations(files)
    assert [link.transmitter for link in reread.links] == names
    assert sorted(reread.ramps.stations) == sorted(names)
    if ending == "csv":
        assert "\n2024-05-02T06:00:00.000000000000,range,'=HYPERLINK(0)>lander" in files[0].read_text()
