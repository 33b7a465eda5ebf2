from pathlib import Path

import numpy as np
import pytest
from earth_files import BLQ_RECORD, BLQ_ROWS

from radioloc.earth.blq import CONSTITUENTS, BlqCoefficients, parse_blq, read_blq
from radioloc.errors import FileFormatError, InputError


def test_reads_a_record(tmp_path: Path) -> None:
    path = tmp_path / "my.blq"
    path.write_text(
        "$$ COLUMN ORDER:  M2 S2 N2 K2 K1 O1 P1 Q1 MF MM SSA\n$$\n" + BLQ_RECORD + "$$ END TABLE\n"
    )
    sites = read_blq(path)
    assert list(sites) == ["ONSALA"]
    onsala = sites["ONSALA"]
    assert onsala.source == "CSR4.0_f_PP ID: 2009-06-25 17:43:24"
    assert onsala.amplitude_m.shape == (3, 11)
    assert onsala.amplitude_m[1, CONSTITUENTS.index("K1")] == 0.00053
    assert onsala.phase_lag_rad[2, 0] == np.deg2rad(109.5)
    with pytest.raises(ValueError, match="read-only"):
        onsala.amplitude_m[0, 0] = 1.0


def test_starts_at_once_with_a_site_or_after_a_mail_head() -> None:
    head = "To: someone\nSubject: Ocean loading values\nContent-type: text/plain\n\n$$ Ocean loading\n$$\n"
    tail = "$$ END TABLE\nErrors:\nWarnings:\n"
    for text in (BLQ_RECORD, head + BLQ_RECORD + tail, "\n" + BLQ_RECORD + "\n  REYKJAVIK\n" + BLQ_ROWS):
        assert "ONSALA" in parse_blq(text, "x.blq")


def test_model_of_the_header_serves_sites_without_one() -> None:
    text = "$$ Ocean tide model: FES2014b\n  SITE\n" + BLQ_ROWS
    assert parse_blq(text, "x.blq")["SITE"].source == "FES2014b"


def test_the_mark_of_the_centre_of_mass_is_that_of_the_header_or_of_the_site() -> None:
    site = "  {}\n$$ lon/lat: 1 2 3\n{}" + BLQ_ROWS
    yes, no = "$$ CMC:  YES (corr.tide centre of mass)\n", "$$ CMC: no\n"
    for header, of_sites, expected in (
        ("", ("", yes, ""), [False, True, False]),
        (no, ("", yes, ""), [False, True, False]),
        (yes, ("", no, ""), [True, False, True]),
    ):
        text = header + "".join(site.format(name, mark) for name, mark in zip("ABC", of_sites, strict=True))
        assert [record.geocentre_included for record in parse_blq(text, "x.blq").values()] == expected
    merged = yes + site.format("A", "") + "$$\n" + no + site.format("B", "")
    assert [record.geocentre_included for record in parse_blq(merged, "x.blq").values()] == [True, False]


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("$$ nothing\n", None, "no site"),
        (BLQ_RECORD + BLQ_RECORD, 10, "twice"),
        ("$$ AMPLITUDES (nm/s^2)\n" + BLQ_RECORD, 1, "amplitudes in m, got 'nm/s"),
        (BLQ_RECORD.rsplit("\n", 2)[0], 1, "5 rows"),
        (BLQ_RECORD.replace(" .00352", ""), 4, "has 10"),
        (BLQ_RECORD.replace(".00352", "3.5200"), 1, "give metres"),
        (BLQ_RECORD.replace("-151.4", "-451.4"), 7, "360 degrees"),
    ],
)
def test_refuses(text: str, line: int | None, message: str) -> None:
    with pytest.raises(FileFormatError, match=message) as caught:
        parse_blq(text, "bad.blq")
    assert caught.value.line == line
    assert "bad.blq" in str(caught.value)


def test_coefficients_need_their_shape() -> None:
    with pytest.raises(InputError, match="3 x 11"):
        BlqCoefficients("A", np.zeros((3, 8)), np.zeros((3, 11)), "none")
