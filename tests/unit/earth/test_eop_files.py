import numpy as np
import pytest
from earth_files import C04, finals_row

from radioloc.constants import ARCSEC_RAD
from radioloc.earth.eop import read_eop_rows
from radioloc.errors import FileFormatError


def write(tmp_path, *rows):
    path = tmp_path / "eop.txt"
    path.write_text("\n".join(rows) + "\n")
    return path


def test_c04_is_read(tmp_path):
    columns, sources = read_eop_rows(write(tmp_path, C04.rstrip()))
    assert sources[0].startswith("C04 eop.txt, 2020-01-01 to 2020-01-02, sha256 ")
    np.testing.assert_array_equal(columns["mjd_utc"], [58849.0, 58850.0])
    np.testing.assert_array_equal(columns["xp_rad"], np.array([0.076577, 0.075350]) * ARCSEC_RAD)
    np.testing.assert_array_equal(columns["ut1_minus_utc_s"], [-0.1771554, -0.1775])
    np.testing.assert_array_equal(columns["dy_rad"], np.array([-0.000108, -0.000110]) * ARCSEC_RAD)
    assert not columns["predicted"].any()


@pytest.mark.parametrize("n_characters", [1, 40, 125])
def test_a_row_cut_within_a_number_is_no_shorter_number(tmp_path, n_characters):
    path = tmp_path / "eop.txt"
    path.write_text("\n".join([finals_row(58849), finals_row(58850)])[:-n_characters])
    with pytest.raises(FileFormatError, match="line 2: the last row was cut"):
        read_eop_rows(path)


def test_bulletin_a_is_read_in_arcseconds_with_its_flags_and_blanks(tmp_path):
    path = write(
        tmp_path,
        finals_row(58849),
        finals_row(58850, flags="IIP"),
        finals_row(58851, flags="PP ", dx="", dy=""),
        finals_row(58852, flags="   ", x="", y="", ut1="", dx="", dy=""),
    )
    columns, sources = read_eop_rows(path)
    assert sources[0].startswith("Bulletin A eop.txt, 2020-01-01 to 2020-01-03, sha256 ")
    np.testing.assert_array_equal(columns["mjd_utc"], [58849.0, 58850.0, 58851.0])
    np.testing.assert_allclose(columns["dx_rad"][:2], 0.000101 * ARCSEC_RAD, rtol=1e-15)
    assert np.isnan(columns["dx_rad"][2])
    np.testing.assert_array_equal(columns["predicted"], [False, True, True])


def test_rows_before_a_date_are_left_out(tmp_path):
    assert list(read_eop_rows(write(tmp_path, C04.rstrip()), 58850.0)[0]["mjd_utc"]) == [58850.0]
    assert len(read_eop_rows(write(tmp_path, finals_row(58849)), 60000.0)[0]["mjd_utc"]) == 0
    assert len(read_eop_rows(write(tmp_path, C04.rstrip()), 60000.0)[0]["mjd_utc"]) == 0


@pytest.mark.parametrize(
    ("rows", "line", "words"),
    [
        (["# nothing"], None, "no rows"),
        ([C04.rstrip().replace("0.283000", "0.28x000")], 3, "'    0.28x000'"),
        ([C04.rstrip().replace("58850", "58852")], 3, "daily rows"),
        ([finals_row(58849), finals_row(58850, dx="-104.123")], 2, "1980"),
        ([finals_row(58849, ut1=""), finals_row(58850)], 1, "hold UT1-UTC"),
        ([finals_row(58849), finals_row(58850, x="0.0", y="0.0", ut1="0.0")], 2, "are zero"),
    ],
)
def test_what_cannot_be_used_is_named_with_its_line(tmp_path, rows, line, words):
    with pytest.raises(FileFormatError, match=words) as caught:
        read_eop_rows(write(tmp_path, *rows))
    if line is not None:
        assert caught.value.line == line
