"""Files of gravity fields, sound and not."""

from dataclasses import replace

import numpy as np
import pytest
from paths import ROOT
from reader_cases import GRAVITY, SHADR

from radioloc.dynamics import GravityField
from radioloc.errors import FileFormatError, InputError
from radioloc.lunar import rot_between

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
    "coefficient twice": (GRAVITY + "gfc 2 1 1e-5 0\n", "line 15: degree 2, order 1, is also in line 9"),
    "C00": (GRAVITY + "gfc 0 0 1e6 0\n", "line 15: expected C00 = 1, got 1000000"),
    "off the centre": (GRAVITY + "gfc 1 1 1e-3 0\n", "expected coefficients of degree 1 below"),
    "topography": (
        GRAVITY.replace("modelname TOY", "product_type topography"),
        "line 1: expected product_type",
    ),
    "no number": (GRAVITY.replace("1e-11 1e-11", "1e-11 nan", 1), "line 8: 'nan' is not a number"),
    "order": (GRAVITY.replace("gfc 2 1", "gfc 2 3"), "line 9: has no degree 2, order 3"),
    "too few": (GRAVITY.replace(" 1e-11 1e-11", " 1e-11", 1), "line 8: has 5 numbers"),
    "no header": (GRAVITY.partition("end_of_head\n")[2], "is no gravity field"),
    "no radius": (GRAVITY.replace("radius", "r"), "the header has no radius"),
    "table of other longitudes": (
        SHADR.replace("0.0, 0.0", "90.0, 0.0"),
        "line 1: .* longitude of 0, got 90.0",
    ),
    "other latitudes": (
        SHADR.replace("0.0, 0.0", "0.0, 5.0"),
        "line 1: expected a reference latitude of 0, got 5",
    ),
    "unnormalized table": (SHADR.replace("2, 2, 1,", "2, 2, 0,"), "line 1: normalization is 0"),
    "cut table": (SHADR[: SHADR.index("2, 2, 8")], "is cut: degree 2, order 2, is missing"),
}


@pytest.mark.parametrize(("text", "problem"), CASES.values(), ids=CASES)
def test_files_that_cannot_be_used(text, problem, tmp_path):
    with pytest.raises(FileFormatError, match=rf"field.gfc.*{problem}"):
        opened(tmp_path, text)


def lunar_figure(frame, head="", tide_system="zero_tide"):
    """Text of a file with the Moon's degree 2 in other axes than PA_DE421."""
    lunar = GravityField.open("GRGM660PRIM", degree=2)
    points_m = 1838.0e3 * np.array(
        [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0.8, 0], [0.8, 0, 0.6], [0, 0.6, 0.8]]
    )
    turned_m = points_m @ rot_between(frame, "PA_DE421").T
    names = [("c", 2, 0), ("c", 2, 1), ("s", 2, 1), ("c", 2, 2), ("s", 2, 2)]
    columns = []
    for part, n, m in names:
        unit = {key: np.zeros((3, 3)) for key in ("c", "s")}
        unit[part][n, m] = 1.0
        columns.append(replace(lunar, **unit).potential(points_m))
    potential = lunar.potential(turned_m) - lunar.gm_m3_s2 / 1838.0e3
    found = dict(zip(names, np.linalg.lstsq(np.transpose(columns), potential)[0].tolist(), strict=True))
    lines = [f"gfc 2 {m} {found['c', 2, m]!r} {found.get(('s', 2, m), 0.0)!r}\n" for m in range(3)]
    start = (
        GRAVITY.partition("gfc")[0].replace("max_degree 3", "max_degree 2").replace("tide_free", tide_system)
    )
    return head + start + "".join(lines)


@pytest.mark.parametrize(
    ("frame", "head", "given", "used"),
    [
        ("PA_DE421", "", None, "PA_DE421"),
        ("PA_DE440", "the lunar body-fixed axes are those of de440\n", None, "PA_DE440"),
        ("ME_DE421", "coordinates: mean Earth, polar axis\n", None, "ME_DE421"),
        ("ME_DE421", "", "ME_DE421", "ME_DE421"),
        ("PA_DE440", "compared with DE421 and DE430\n", "PA_DE440", "PA_DE440"),
    ],
)
def test_axes_are_those_stated_by_the_caller_or_named_by_the_header(tmp_path, frame, head, given, used):
    (tmp_path / "field.gfc").write_text(lunar_figure(frame, head))
    field = GravityField.open(tmp_path / "field.gfc", frame=given)
    assert field.frame == used
    assert any("axes" in note for note in field.notes) == (not head and given is None)
    point_m = np.array([1.2e6, -0.9e6, 1.1e6])
    rot = rot_between(field.frame, "PA_DE421")
    expected = GravityField.open("GRGM660PRIM", degree=2).acceleration(rot @ point_m)
    np.testing.assert_allclose(rot @ field.acceleration(point_m), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("frame", "given"), [("ME_DE421", None), ("PA_DE421", "ME_DE421")])
def test_a_field_whose_figure_contradicts_its_axes_is_refused(tmp_path, frame, given):
    (tmp_path / "field.gfc").write_text(lunar_figure(frame))
    with pytest.raises(FileFormatError, match=r"field.gfc: .* got degree 2 of a figure 7[789] arcsec"):
        GravityField.open(tmp_path / "field.gfc", frame=given)


def test_the_label_beside_a_table_names_its_axes(tmp_path):
    (tmp_path / "field.LBL").write_text("DESCRIPTION = The planetary ephemeris is DE 430\n")
    field = opened(tmp_path, SHADR)
    assert field.frame == "PA_DE430"
    assert len(field.notes) == 1


def test_what_is_unknown_of_a_field_is_noted_and_can_be_stated(tmp_path):
    stated = lunar_figure("PA_DE421", "axes of DE421\n", "unknown")
    assert "tide system" in opened(tmp_path, stated).notes[0]
    field = GravityField.open(tmp_path / "field.gfc", tide_system="zero_tide")
    assert (field.tide_system, field.notes) == ("zero_tide", ())
    with pytest.raises(InputError, match="mean_tide"):
        GravityField.open(tmp_path / "field.gfc", tide_system="mean_tide")
