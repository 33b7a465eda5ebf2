"""Files of gravity fields."""

from dataclasses import replace

import numpy as np
import pytest
from paths import LARGE_DATA
from reader_cases import GRAVITY, SHADR

from radioloc.dynamics import GravityField
from radioloc.errors import FileFormatError, InputError
from radioloc.lunar import rot_between

PUBLISHED = LARGE_DATA / "gravity" / "GRGM660PRIM_to150.gfc"


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


@pytest.mark.skipif(not PUBLISHED.is_file(), reason=f"needs {PUBLISHED}")
def test_packaged_field_equals_the_published_file():
    packaged, published = GravityField.open("GRGM660PRIM"), GravityField.open(PUBLISHED)
    assert (packaged.gm_m3_s2, packaged.radius_m) == (published.gm_m3_s2, published.radius_m)
    np.testing.assert_array_equal(packaged.c, published.c)
    np.testing.assert_array_equal(packaged.s, published.s)
    np.testing.assert_allclose(packaged.sigma_c, published.sigma_c, rtol=1e-7)
    np.testing.assert_allclose(packaged.sigma_s, published.sigma_s, rtol=1e-7)


CASES = {
    "missing lines": (GRAVITY[: GRAVITY.index("gfc 3 2")], None, "degree 3, order 2"),
    "truncated line": (GRAVITY[:-30], 14, "no line end"),
    "Earth": (GRAVITY.replace("0.4902799806931690D+13", "3.986e14"), None, "got 3.986e"),
    "not normalized": (GRAVITY.replace("fully_", "un"), 6, "got unnormalized"),
    "time-variable": (GRAVITY.replace("gfc 3 1", "gfct 3 1"), 12, "got 'gfct'"),
    "tides": (GRAVITY.replace("tide_free", "mean_tide"), 5, "got mean_tide"),
    "off the centre": (GRAVITY + "gfc 1 1 1e-3 0\n", None, "degree 1 below"),
    "order": (GRAVITY.replace("gfc 2 1", "gfc 2 3"), 9, "got 2, 3"),
    "without header": (GRAVITY.partition("end_of_head\n")[2], None, "expected a gravity field"),
    "table of other longitudes": (SHADR.replace("0.0, 0.0", "90.0, 0.0"), 1, "got 90.0"),
    "unnormalized table": (SHADR.replace("2, 2, 1,", "2, 2, 0,"), 1, "got 0"),
}


@pytest.mark.parametrize(("text", "line", "words"), CASES.values(), ids=CASES)
def test_unusable_files(text, line, words, tmp_path):
    with pytest.raises(FileFormatError, match=words) as caught:
        opened(tmp_path, text)
    assert caught.value.line == line


def lunar_figure(frame, head="", tide_system="zero_tide"):
    """Return the text of a file with the Moon's degree 2 in axes other than PA_DE421."""
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
    coefficients = dict(
        zip(names, np.linalg.lstsq(np.transpose(columns), potential)[0].tolist(), strict=True)
    )
    lines = [
        f"gfc 2 {m} {coefficients['c', 2, m]!r} {coefficients.get(('s', 2, m), 0.0)!r}\n" for m in range(3)
    ]
    start = (
        GRAVITY.partition("gfc")[0].replace("max_degree 3", "max_degree 2").replace("tide_free", tide_system)
    )
    return head + start + "".join(lines)


@pytest.mark.parametrize(
    ("frame", "head", "stated", "expected_frame"),
    [
        ("PA_DE421", "", None, "PA_DE421"),
        ("PA_DE440", "the lunar body-fixed axes are those of de440\n", None, "PA_DE440"),
        ("ME_DE421", "coordinates: mean Earth, polar axis\n", None, "ME_DE421"),
        ("ME_DE421", "", "ME_DE421", "ME_DE421"),
        ("PA_DE440", "compared with DE421 and DE430\n", "PA_DE440", "PA_DE440"),
    ],
)
def test_axes_of_the_caller_or_the_header(tmp_path, frame, head, stated, expected_frame):
    (tmp_path / "field.gfc").write_text(lunar_figure(frame, head))
    field = GravityField.open(tmp_path / "field.gfc", frame=stated)
    assert field.frame == expected_frame
    assert any("axes" in note for note in field.notes) == (not head and stated is None)
    point_m = np.array([1.2e6, -0.9e6, 1.1e6])
    rot = rot_between(field.frame, "PA_DE421")
    expected = GravityField.open("GRGM660PRIM", degree=2).acceleration(rot @ point_m)
    np.testing.assert_allclose(rot @ field.acceleration(point_m), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("frame", "stated"), [("ME_DE421", None), ("PA_DE421", "ME_DE421")])
def test_figure_in_other_axes_than_stated_is_an_error(tmp_path, frame, stated):
    (tmp_path / "field.gfc").write_text(lunar_figure(frame))
    with pytest.raises(FileFormatError, match=r"figure 7[789] arcsec"):
        GravityField.open(tmp_path / "field.gfc", frame=stated)


def test_axes_of_the_label_of_a_table(tmp_path):
    (tmp_path / "field.LBL").write_text("DESCRIPTION = The planetary ephemeris is DE 430\n")
    field = opened(tmp_path, SHADR)
    assert field.frame == "PA_DE430"
    assert len(field.notes) == 1


def test_unknown_tide_system_is_noted_unless_stated(tmp_path):
    stated = lunar_figure("PA_DE421", "axes of DE421\n", "unknown")
    assert "tide system" in opened(tmp_path, stated).notes[0]
    field = GravityField.open(tmp_path / "field.gfc", tide_system="zero_tide")
    assert (field.tide_system, field.notes) == ("zero_tide", ())
    with pytest.raises(InputError, match="mean_tide"):
        GravityField.open(tmp_path / "field.gfc", tide_system="mean_tide")
