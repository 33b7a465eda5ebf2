from pathlib import Path

import numpy as np
import pytest

from radioloc.earth.blq import CONSTITUENTS, BlqCoefficients, parse_blq, read_blq
from radioloc.errors import FileFormatError, InputError

ROWS = """\
  .00352 .00123 .00080 .00032 .00187 .00112 .00063 .00003 .00082 .00044 .00037
  .00144 .00035 .00035 .00008 .00053 .00049 .00018 .00009 .00012 .00005 .00006
  .00086 .00023 .00023 .00006 .00029 .00028 .00010 .00007 .00004 .00002 .00001
   -64.7  -52.0  -96.2  -55.2  -58.8 -151.4  -65.6 -138.1    8.4    5.2    2.1
    85.5  114.5   56.5  113.6   99.4   19.1   94.1  -10.4 -167.4 -170.0 -177.7
   109.5  147.0   92.7  148.8   50.5  -55.1   36.4 -170.4  -15.0    2.3    5.2
"""
RECORD = "  ONSALA\n$$ CSR4.0_f_PP ID: 2009-06-25 17:43:24\n$$ Computed by OLMPP\n" + ROWS


def test_reads_a_record(tmp_path: Path) -> None:
    path = tmp_path / "my.blq"
    path.write_text("$$ COLUMN ORDER:  M2 S2 N2 K2 K1 O1 P1 Q1 MF MM SSA\n$$\n" + RECORD)
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
    for text in (RECORD, head + RECORD + tail, "\n" + RECORD + "\n  REYKJAVIK\n" + ROWS):
        assert "ONSALA" in parse_blq(text, "x.blq")


def test_model_of_the_header_serves_sites_without_one() -> None:
    text = "$$ Ocean tide model: FES2014b\n  SITE\n" + ROWS
    assert parse_blq(text, "x.blq")["SITE"].source == "FES2014b"


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("$$ nothing\n", None, "no site"),
        ("$$ COLUMN ORDER: M2 S2 N2 K2 K1 O1 P1 Q1 MF MM SA\n" + RECORD, 1, "only 'M2 S2"),
        (RECORD + RECORD, 10, "twice"),
        (RECORD.rsplit("\n", 2)[0], 1, "5 rows"),
        (RECORD.replace(".00352", "0.0.35"), 4, "reads"),
        (RECORD.replace(" .00352", ""), 4, "has 10"),
        (RECORD.replace(".00352", "-.0352"), 1, "between 0 and"),
        (RECORD.replace(".00352", "3.5200"), 1, "give metres"),
        (RECORD.replace(".00352", "nan   "), 1, "finite"),
        (RECORD.replace("-151.4", "-451.4"), 7, "360 degrees"),
        (RECORD.replace("-151.4", "   nan"), 7, "360 degrees"),
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
