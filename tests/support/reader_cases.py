"""Readers of files with the content of small valid files."""

from pathlib import Path

from atmosphere_files import GPT3_CORNERS, VMF3_SITES, ionex_text, orography_text, vmf3_map_text
from earth_files import BLQ_RECORD, finals_row
from tdm_messages import DELAY, RANGES, THREE_WAY, TWO_WAY, kvn, xml

from radioloc.dynamics import GravityField
from radioloc.earth.blq import read_blq
from radioloc.earth.eop import EopTable
from radioloc.ephemeris import Ephemeris, LunarOrientation, Trajectory
from radioloc.io import TdmAgreement, read_observations, read_tdm
from radioloc.io.crd import read_crd
from radioloc.io.frequencies import FrequencyAgreement, read_sites, read_strf
from radioloc.io.mini import read_mini
from radioloc.io.odf import read_odf
from radioloc.io.table import read_parquet, read_table
from radioloc.lunar import TerrainModel
from radioloc.measurements.sources import read_sources
from radioloc.media import read_csp, read_radio_atmosphere
from radioloc.media.air_files import read_gpt3, read_vmf3_grids, read_vmf3_sites
from radioloc.media.ionex import read_ionex
from radioloc.study.study_file import read_study

EXAMPLES = Path(__file__).parents[2] / "examples"
AGREEMENT = TdmAgreement(sigma_m={"range": 1.0, "vlbi_delay": 1.0, "doppler": 1.0}, turnaround=(880, 749))
BEACON = [FrequencyAgreement(transmit_hz=2216.5e6, sigma_hz=0.5, count_s=10.0)]
COUNT = {"INTEGRATION_INTERVAL": "60.0", "INTEGRATION_REF": "START", "FREQ_OFFSET": "0.0"}
SEGMENTS = (
    (
        TWO_WAY | {"RANGE_MODULUS": "0.0", "RECEIVE_DELAY_1": "1e-6", "CORRECTIONS_APPLIED": "YES"},
        [*RANGES, "PRESSURE = 2021-03-28T14:00:00 870.5"],
    ),
    (
        THREE_WAY | COUNT,
        [
            "TRANSMIT_FREQ_1 = 2021-03-28T13:00:00 7.2e9",
            "TRANSMIT_FREQ_RATE_1 = 2021-03-28T13:00:00 0.5",
            "RECEIVE_FREQ_3 = 2021-087T14:00:00 8459278000.5",
        ],
    ),
    (DELAY, ["DOR = 2021-03-28T14:00:00 -1.5E-03"]),
    (
        {"TIME_SYSTEM": "UTC", "PARTICIPANT_1": "SESHAN25", "PARTICIPANT_2": "KUNMING"},
        ["CLOCK_BIAS = 2021-03-28T13:00:00 -4.59e-7", "CLOCK_DRIFT = 2021-03-28T13:00:00 1e-13"],
    ),
)
TABLE = "epoch_utc,type,path,observed_m,sigma_m,time_tag\n" + "".join(
    f"2021-03-28T14:0{k}:00,range,KASHI>lander>KASHI,76880{k}000.0,1.0,receive\n" for k in range(5)
)
CRD = """\
H1 CRD  2 2024 09 03 15
H2 GRSM       7845 78  1  7 ILRS
H3 apollo15   0000103 0103 na 0 1 3
H4  1 2024 05 13 16 11 28 2024 05 13 17 01 47  0 0 0 0 1 0 2 0
H5  0 24 051100 OPA 6331
C0 0 532.100 me08 las5 det1 tim2 none nm01 met1 na
C1 0 las5 Nd-Yag 1064.20 10.00 150.00 150.0 5.00 1
20 58288.178257980457 871.95 287.25 63  0
40 58579.518409743439 0 me08 383 357 3.716 103371.0 317.0 64.2 0.154 -0.245 na 3 3 0 4 19.6
30 58591.933 170.2484 70.1426 0 2 0 0.0108740 0.0004620
11 58591.933300993282 2.581730448437 me08 2 582.0 40 253.2 -0.040 -0.300  na 0.7 0 3.1
20 59697.657519922454 871.85 287.45 64  0
11 59977.950832485437 2.582208383656 me08 2 590.0 85 202.8 0.046 -0.568  na 1.4 0 7.6
50 me08 236.4 0.272 -0.092 na 0
00 a comment with a sign that is not ASCII: ±
H8
h1 crd  2 2025  6 26 21
h2       APOL 7045 95  1  4       ILRS
h3 apollo11        100  100       na 0 1  3
h4  1 2024  4 12  2 15 23 2024  4 12  2 18 19  1 0 0 0 1 0 2 0
c0 0     532.0 std3 lpd apd4 cesm  na  na  na  na
11  8215.0000000 2.4614224083999 std3 2  176.0    147     180.2      na      na       na    na 0  43.0
20  8215.000  728.75 282.17   18 1
50 std3  180.2     na     na   na 1
h8
h9
"""

MINI = """\
512006 4 7 62630000000026494326499837370610 44   538 34B 72160   833 5320A 263A
51200612 1 02655000000024053617732419070610 39   474 11B 72483 -8126 5320A 495A
512007 3 3 74030000000026246951655405470610 39   727 19B 72154 -8438 5320A 499A
"""
GRAVITY = """\
modelname TOY
gravity_constant 0.4902799806931690D+13
radius 1738000.0
max_degree 3
tide_system tide_free
norm fully_normalized
end_of_head
""" + "".join(
    f"gfc {n} {m} {1e-4 / n:.6e} {m * 1e-6:.6e} 1e-11 1e-11\n" for n in (2, 3) for m in range(n + 1)
)
SHADR = "1738.0, 4902.8, 2.0e-05, 2, 2, 1, 0.0, 0.0\n" + "".join(
    f"2, {m}, {1e-4 - 1e-5 * m:.6E}, {m * 1e-6:.6E}, 1E-11, 1E-11\n" for m in range(3)
)
STRF = "59902.606603\t2216497878.100\t   9.610\t8049\n59902.6067 2216497877.1 0.0002 4171 9999\n"
SOURCES = "source,right_ascension_deg,declination_deg\n0059+581,15.690677,58.403093\n1741-038,265.995234,-3.834616\n"
ICRF = """\
ICRF Designation        IERS Des. Inf.  Right Ascension       Declination
ICRF J010245.7+582411   0059+581   D    01 02 45.76238240   58 24 11.1366050
ICRF J174358.8-035004   1741-038   D    17 43 58.85613350  -03 50 04.6166750
"""
SITES = "# No ID Latitude Longitude Elev Observer\n4171 CB   52.8344    6.3785     10    An Observer\n"
STUDY = """\
[target]
longitude_deg = 3.5
latitude_deg = 26.0
height_m = -1000.0
[simulation.sessions.night]
kind = "range"
stations = ["APOLLO"]
start = 2006-04-07
stop = 2006-04-08
step_s = 60
sigma_m = 0.02
"""
CSP = """\
ADJUST(ALL) BY NRMPOW(-.0048, .0077) MODEL(WET NUPART) FROM(20/12/02,12:00:00.001)
  TO(20/12/02,18:00:00) DSN(C10).   # one of many
ADJUST(DOPRNG) BY TRIG(7200., 0.7, .1, -.2) MODEL(CHPART) FROM(20/12/02,01:21) DSN(C10) SCID(177).
"""
TEXTS = {
    "blq": (read_blq, BLQ_RECORD),
    "eop": (EopTable.from_file, "\n".join(finals_row(58849 + day) for day in range(6)) + "\n"),
    "gpt3": (read_gpt3, GPT3_CORNERS),
    "icrf": (read_sources, ICRF),
    "sources": (read_sources, SOURCES),
    "ionex": (
        read_ionex,
        ionex_text(lambda latitude, longitude, hour: 9.0 + 0.0 * longitude, hours=(0, 2), rms=False),
    ),
    "csp": (read_csp, CSP),
    "radio_atmosphere": (lambda path: read_radio_atmosphere([path]), VMF3_SITES),
    "vmf3_sites": (lambda path: read_vmf3_sites([path]), VMF3_SITES),
    "vmf3_grids": (lambda path: read_vmf3_grids([path], path.with_name("orography")), vmf3_map_text(0)),
    "orography": (lambda path: read_vmf3_grids([path.with_name("map")], path), orography_text()),
    "icgem": (GravityField.open, GRAVITY),
    "shadr": (GravityField.open, SHADR),
    "crd": (read_crd, CRD),
    "mini": (read_mini, MINI),
    "table": (read_table, TABLE),
    "observations": (read_observations, TABLE),
    "tdm": (lambda path: read_tdm(path, AGREEMENT), "\n".join(kvn((TWO_WAY, RANGES)))),
    "tdm_xml": (lambda path: read_tdm(path, AGREEMENT), xml((TWO_WAY, RANGES))),
    "strf": (lambda path: read_strf(path, BEACON), STRF),
    "sites": (read_sites, SITES),
    "study": (read_study, STUDY),
}
BINARIES = {
    "spk": Ephemeris.open,
    "pck": LunarOrientation.open,
    "trajectory": lambda path: Trajectory.open(path, -999),
    "terrain": TerrainModel.open,
    "parquet": read_parquet,
    "odf": read_odf,
}
