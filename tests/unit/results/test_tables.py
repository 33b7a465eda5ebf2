"""Printable tables: astropy reads the LaTeX back, with the numbers of the solutions."""

import json

import pytest
from astropy.io import ascii as astropy_ascii
from recorded import recorded, reference

from radioloc.cli import main
from radioloc.errors import InputError
from radioloc.results.tables import TextTable, solution_table


def parameter(name, unit, value, total_sigma, fixed=False):
    return {
        "name": name,
        "unit": unit,
        "value": value,
        "sigma": total_sigma,
        "total_sigma": total_sigma,
        "fixed": fixed,
    }


CONTENT = recorded(
    "lander 5",
    (-51.91637, 43.05784, -2570.25),
    (10.0, 4.0, 3.0),
    reference=reference("map_1", -51.9, 43.0, east_m=-0.5, north_m=12.25, up_m=1.0),
    fit={"used": 90, "rejected": 3, "wrms_m": 0.512, "chi2_per_dof": None},
    parameters=[
        parameter("position.east", "m", 1.0, 2.0),
        parameter("range_bias.KASHI", "m", 12.3456, 0.123),
        parameter("clock.KASHI", "s", -4.31e-9, 8.08e-9),
        parameter("clock.JIAMUSI", "s", 0.0, None),
        parameter("zenith_delay.KASHI", "m", 0.0, 0.0, fixed=True),
    ],
)
FIXED = CONTENT | {
    "name": "fixed",
    "sigma": dict.fromkeys(("east_m", "north_m", "up_m"), 0.0),
    "covariance": {"enu_m2": [[0.0] * 3] * 3},
    "reference": None,
    "parameters": [],
}


def latex_rows(text):
    """Return rows by their first cells, as astropy reads them."""
    table = astropy_ascii.read(text.replace("\\hline\n", ""), format="latex", fast_reader=False)
    return {row[0]: list(row)[1:] for row in table.as_array().tolist()}


def test_a_solution_is_a_column():
    table = solution_table([CONTENT, FIXED])
    assert table.heading == ("", "lander 5", "fixed")
    rows = {name: cells for name, *cells in table.rows}
    assert rows["longitude, ° E"] == ["-51.91637000", "-51.91637000"]
    assert rows["1 sigma east, m"] == ["10.0", "-"]
    # sqrt(-2 log 0.05) = 2.4477 sigmas
    assert rows["95 % ellipse, m"] == ["24.5 × 9.79", "-"]
    assert rows["its azimuth, °"] == ["90", "-"]
    assert rows["north of map_1, m"] == ["12.2", "-"]
    assert rows["observations used"] == ["90", "90"]
    assert rows["range bias of KASHI, m"] == ["12.346 ± 0.123", "-"]
    assert rows["clock of JIAMUSI, s"] == ["undetermined", "-"]
    assert not {"position east, m", "zenith delay of KASHI, m", "chi2/dof"} & set(rows)
    with pytest.raises(InputError, match="at least one"):
        solution_table([])


def test_latex_contains_the_cells():
    table = solution_table([CONTENT, FIXED])
    text = table.to_latex()
    assert text.startswith("\\begin{tabular}{lrr}\n\\hline\n & lander 5 & fixed \\\\\n\\hline\nstatus & ")
    rows = latex_rows(text)
    assert len(rows) == len(table.rows)
    assert list(map(float, rows[r"latitude, $^\circ$ N"])) == [43.05784] * 2
    assert rows["height, m"] == ["$-$2570.250"] * 2
    assert rows[r"north of map\_1, m"] == ["12.2", "-"]
    assert rows["clock of KASHI, s"] == [r"$-$4.31$\times 10^{-9}$ $\pm$ 8.08$\times 10^{-9}$", "-"]


def test_special_characters_of_the_formats_are_escaped():
    table = TextTable(("name", "a|b"), [("[50 %] {x}_1 & y # $ ~ ^ \\", "-1"), ("KASHI-1 <x> 2e", "a-b -.5")])
    assert table.to_markdown().splitlines()[0] == r"| name | a\|b |"
    assert table.to_markdown().splitlines()[1] == "| --- | ---: |"
    lines = table.to_latex().splitlines()
    assert lines[4] == (
        r"{[}50 \%] \{x\}\_1 \& y \# \$ \textasciitilde{} \textasciicircum{} \textbackslash{} & $-$1 \\"
    )
    assert lines[5] == r"KASHI-1 $<$x$>$ 2e & a-b $-$.5 \\"


@pytest.mark.parametrize(("ending", "first"), [("md", "|  | lander 5 |"), ("tex", r"\begin{tabular}{lr}")])
def test_the_command_writes_tables(tmp_path, ending, first):
    (tmp_path / "solution.json").write_text(json.dumps(CONTENT))
    assert main(["export", str(tmp_path / "solution.json"), str(tmp_path / f"table.{ending}"), "-q"]) == 0
    assert (tmp_path / f"table.{ending}").read_text(encoding="utf-8").splitlines()[0] == first
