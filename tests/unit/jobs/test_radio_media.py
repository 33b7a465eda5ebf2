"""Files of VMF3 and GPT3, and calibrations of the Deep Space Network, in a study: keys, notes and provenance."""

import hashlib

import pytest
from arc_cases import observed_at

import radioloc
from radioloc.constants import C_M_S
from radioloc.measurements import Link

LINES = """\
SESHAN25  59185.50  0.00123000  0.00055000  2.3200  0.1200  1021.00  10.00  9.00
URUMQI    59185.50  0.00120000  0.00050000  1.8000  0.0200   795.00  -9.00  2.00
SESHAN25  59185.75  0.00124000  0.00057000  2.3300  0.2400  1023.00   9.00  9.50
URUMQI    59185.75  0.00121000  0.00052000  1.8100  0.0300   797.00 -11.00  1.50
"""

STUDY = """\
[target]
frame = "PA_DE421"
position_m = [1554678.949, 98094.118, 765004.906]

[observations]
files = ["delays.csv"]

[model]
vmf3 = ["2020*.vmf3_r"]
"""


def delays(date="2020-12-02T15:00:00", first="URUMQI"):
    return observed_at([date], Link(first, "lander", "SESHAN25", True), value_m=1e6, kind="vlbi_delay")


@pytest.fixture
def read(tmp_path):
    """Reads the study, after a change of its text."""
    (tmp_path / "2020337.vmf3_r").write_text(LINES)
    (tmp_path / "delays.csv").touch()

    def reader(old="", new=""):
        (tmp_path / "study.toml").write_text(STUDY.replace(old, new))
        return radioloc.read_study(tmp_path / "study.toml")

    return reader


def test_notes_and_provenance_say_where_the_air_comes_from(read):
    study = read()
    assert [path.name for path in study.model.vmf3] == ["2020337.vmf3_r"]
    solution = radioloc.compute_residuals(study, delays())
    assert (
        "troposphere of radio signals from VMF3 for URUMQI, SESHAN25, beside recorded pressure"
        in solution.limitations
    )
    assert solution.provenance["troposphere"] == {
        "vmf3": [{"name": "2020337.vmf3_r", "sha256": hashlib.sha256(LINES.encode()).hexdigest()}],
        "vmf3_orography": [],
        "gpt3": [],
    }
    plain = radioloc.compute_residuals(read('vmf3 = ["2020*.vmf3_r"]', ""), delays())
    assert not any("VMF3" in note for note in plain.limitations)
    changed_m = solution.residuals.residual_m - plain.residuals.residual_m
    assert 0.02 < abs(changed_m[0]) < 2.0


CARDS = """\
ADJUST(ALL) BY NRMPOW(.05, .01) MODEL(WET NUPART) FROM(20/12/02,12:00) TO(20/12/02,18:00) DSN(C10).
ADJUST(ALL) BY CONST(.002) MODEL(DRY NUPART) FROM(20/12/02,12:00) TO(20/12/02,18:00) DSN(C10).
ADJUST(DOPRNG) BY CONST(1.5) MODEL(CHPART) FROM(20/12/02,12:00) TO(20/12/02,18:00) DSN(C10) SCID(177).
ADJUST(DOPRNG) BY CONST(9.5) MODEL(CHPART) FROM(20/12/02,12:00) TO(20/12/02,18:00) DSN(C10) SCID(178).
"""


@pytest.fixture
def calibrated(tmp_path, read):
    """A study with the cards, and ranges of DSS-24, or of DSS-24 to KASHI, at S band."""
    (tmp_path / "cards.csp").write_text(CARDS)

    def reader(keys='csp = ["cards.csp"]\ncsp_scid = 177', date="2020-12-02T12:30:00", second="DSS-24"):
        ranges = observed_at(
            [date],
            Link("DSS-24", "lander", second),
            value_m=8e8,
            uplink_hz=2.1e9,
            wavelength_um=C_M_S / 2.28e9 * 1e6,
        )
        return radioloc.compute_residuals(read('vmf3 = ["2020*.vmf3_r"]', keys), ranges)

    return reader


def test_calibrations_of_the_deep_space_network_serve_its_stations(calibrated):
    plain, solution = calibrated(""), calibrated()
    assert "troposphere of radio signals from calibrations of the DSN for DSS-24" in solution.limitations
    assert "ionosphere of radio signals from calibrations of the DSN for DSS-24" in solution.limitations
    assert not any("no ionospheric delay" in note for note in solution.notes)
    assert solution.provenance["media_calibrations"] == {
        "csp": [{"name": "cards.csp", "sha256": hashlib.sha256(CARDS.encode()).hexdigest()}],
        "scid": 177,
    }
    charged_m = 1.5 * ((2295 / 2100) ** 2 + (2295 / 2280) ** 2)
    air_m = plain.residuals.residual_m - solution.residuals.residual_m - charged_m
    assert 0.0 < abs(air_m[0]) < 1.0
    assert not any("no calibration of the" in note for note in solution.notes)
    second = calibrated(second="KASHI")
    assert "no ionospheric delay of radio signals for KASHI: give maps or a content" in " ".join(second.notes)
