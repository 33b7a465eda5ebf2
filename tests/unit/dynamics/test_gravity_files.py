"""Files of gravity fields, sound and not."""

from pathlib import Path

import numpy as np
import pytest
from reader_cases import GRAVITY, SHADR

from radioloc.dynamics import GravityField
from radioloc.errors import FileFormatError

ROOT = Path(__file__).parents[3]
PUBLISHED = next(
    (
        file
        for folder in ROOT.parents
        if (file := folder / "shared/data/gravity/GRGM660PRIM_to150.gfc").is_file()
    ),
    None,
)


def opened(tmp_path, text):
    file = tmp_path / "field.gfc"
    file.write_text(text)
    return GravityField.open(file)


def test_icgem(tmp_path):
    field = opened(tmp_path, GRAVITY)
    assert (field.name, field.degree, field.tide_system) == ("TOY", 3, "tide_free")
    assert (field.gm_m3_s2, field.radius_m) == (4902.799806931690e9, 1738.0e3)
    assert (field.c[0, 0], field.c[2, 1], field.s[3, 2]) == (1.0, 5e-5, 2e-6)
    assert (field.sigma_c[2, 0], field.sigma_c[0, 0]) == (1e-11, 0.0)


def test_shadr(tmp_path):
    field = opened(tmp_path, SHADR)
    assert (field.name, field.degree, field.tide_system) == ("field", 2, "unknown")
    assert (field.gm_m3_s2, field.radius_m) == (4902.8e9, 1738.0e3)
    assert (field.c[0, 0], field.c[2, 1], field.s[2, 2]) == (1.0, 9e-5, 2e-6)


def test_without_sigmas(tmp_path):
    field = opened(tmp_path, GRAVITY.replace(" 1e-11 1e-11", ""))
    assert field.c[2, 1] == 5e-5
    assert not field.sigma_c.any()


@pytest.mark.skipif(PUBLISHED is None, reason="GRGM660PRIM_to150.gfc is not in shared/data/gravity")
def test_the_field_that_ships_is_that_of_the_file():
    own, published = GravityField.open("GRGM660PRIM"), GravityField.open(PUBLISHED)
    assert (own.gm_m3_s2, own.radius_m) == (published.gm_m3_s2, published.radius_m)
    np.testing.assert_array_equal(own.c, published.c)
    np.testing.assert_array_equal(own.s, published.s)
    np.testing.assert_allclose(own.sigma_c, published.sigma_c, rtol=1e-7)
    np.testing.assert_allclose(own.sigma_s, published.sigma_s, rtol=1e-7)


CASES = {
    "cut between lines": (
        GRAVITY[: GRAVITY.index("gfc 3 2")],
        "is cut: degree 3, order 2, is missing of a field to 3",
    ),
    "cut in a line": (GRAVITY[:-30], "line 14: the last line has no line end"),
    "Earth": (GRAVITY.replace("0.4902799806931690D+13", "3.986e14"), "is of another body: GM is 3.986e"),
    "radius": (GRAVITY.replace("1738000.0", "6378136.3"), "another body: .* the radius 6.378"),
    "not normalized": (GRAVITY.replace("fully_", "un"), "line 6: norm is unnormalized"),
    "in time": (GRAVITY.replace("gfc 3 1", "gfct 3 1"), "line 12: begins with 'gfct'"),
    "tides": (GRAVITY.replace("tide_free", "mean_tide"), "line 5: tide_system is mean_tide"),
    "no number": (GRAVITY.replace("1e-11 1e-11", "1e-11 nan", 1), "line 8: 'nan' is not a number"),
    "order": (GRAVITY.replace("gfc 2 1", "gfc 2 3"), "line 9: has no degree 2, order 3"),
    "too few": (GRAVITY.replace(" 1e-11 1e-11", " 1e-11", 1), "line 8: has 5 numbers"),
    "no header": (GRAVITY.partition("end_of_head\n")[2], "is no gravity field"),
    "no radius": (GRAVITY.replace("radius", "r"), "the header has no radius"),
    "unnormalized table": (SHADR.replace("2, 2, 1,", "2, 2, 0,"), "line 1: normalization is 0"),
    "cut table": (SHADR[: SHADR.index("2, 2, 8")], "is cut: degree 2, order 2, is missing"),
}


@pytest.mark.parametrize(("text", "problem"), CASES.values(), ids=CASES)
def test_files_that_cannot_be_used(text, problem, tmp_path):
    with pytest.raises(FileFormatError, match=rf"field.gfc.*{problem}"):
        opened(tmp_path, text)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(FileFormatError, match="no such file"):
        GravityField.open(tmp_path / "none.gfc")
