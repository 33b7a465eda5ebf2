"""Every reader, given a file that is not there, not whole or something else: one clear error.

Clear is one line that names the file and holds nothing unprintable; what else it says the readers' own tests know.
"""

import gzip
import logging
from pathlib import Path

import numpy as np
import pytest
from atmosphere_files import GPT3_CORNERS, VMF3_SITES, ionex_text, orography_text, vmf3_map_text
from earth_files import BLQ_RECORD, finals_row
from tdm_messages import RANGES, TWO_WAY, kvn, xml

from radioloc.earth.blq import read_blq
from radioloc.earth.eop import EopTable
from radioloc.ephemeris import Ephemeris, LunarOrientation, Trajectory
from radioloc.errors import RadiolocError
from radioloc.io.crd import read_crd
from radioloc.io.detect import read_observations
from radioloc.io.mini import read_mini
from radioloc.io.parquet import read_parquet, write_parquet
from radioloc.io.table import read_table
from radioloc.io.tdm import TdmAgreement, read_tdm
from radioloc.kernels import find_kernel
from radioloc.lunar import TerrainModel
from radioloc.media.gpt3 import read_gpt3
from radioloc.media.ionex import read_ionex
from radioloc.media.radio_atmosphere import read_radio_atmosphere
from radioloc.media.vmf3_files import read_vmf3_grids, read_vmf3_sites
from radioloc.studies.study_file import read_study

EXAMPLES = Path(__file__).parents[2] / "examples"
AGREEMENT = TdmAgreement(sigma_m={"range": 1.0})
TABLE = "epoch_utc,type,path,observed_m,sigma_m,time_tag\n" + "".join(
    f"2021-03-28T14:0{k}:00,range,KASHI>lander>KASHI,76880{k}000.0,1.0,receive\n" for k in range(5)
)
CRD = """\
H1 CRD  2 2024 09 03 15
H2 GRSM       7845 78  1  7 ILRS
H3 apollo15   0000103 0103 na 0 1 3
H4  1 2024 05 13 16 11 28 2024 05 13 17 01 47  0 0 0 0 1 0 2 0
C0 0 532.100 me08 las5
11 58591.933300993282 2.581730448437 me08 2 582.0 40 253.2 -0.040 -0.300  na 0.7 0 3.1
H8
H9
"""
MINI = "512006 4 7 62630000000026494326499837370610 44   538 34B 72160   833 5320A 263A\n"
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
TEXTS = {
    "blq": (read_blq, BLQ_RECORD),
    "eop": (EopTable.from_file, "\n".join(finals_row(58849 + day) for day in range(6)) + "\n"),
    "gpt3": (read_gpt3, GPT3_CORNERS),
    "ionex": (
        read_ionex,
        ionex_text(lambda latitude, longitude, hour: 9.0 + 0.0 * longitude, hours=(0, 2), rms=False),
    ),
    "radio_atmosphere": (lambda path: read_radio_atmosphere([path]), VMF3_SITES),
    "vmf3_sites": (lambda path: read_vmf3_sites([path]), VMF3_SITES),
    "vmf3_grids": (lambda path: read_vmf3_grids([path], path.with_name("orography")), vmf3_map_text(0)),
    "orography": (lambda path: read_vmf3_grids([path.with_name("map")], path), orography_text()),
    "crd": (read_crd, CRD),
    "mini": (read_mini, MINI),
    "table": (read_table, TABLE),
    "observations": (read_observations, TABLE),
    "tdm": (lambda path: read_tdm(path, AGREEMENT), "\n".join(kvn((TWO_WAY, RANGES)))),
    "tdm_xml": (lambda path: read_tdm(path, AGREEMENT), xml((TWO_WAY, RANGES))),
    "study": (read_study, STUDY),
}
BINARIES = {
    "spk": Ephemeris.open,
    "pck": LunarOrientation.open,
    "trajectory": lambda path: Trajectory.open(path, -999),
    "terrain": TerrainModel.open,
    "parquet": read_parquet,
}
NO_FILES = {
    "empty": b"",
    "blank": b" \n\n\t\n",
    "words": b"these are words\nand more of them\n",
    "binary": np.random.default_rng(1).integers(0, 256, 3000, dtype=np.uint8).tobytes(),
    "picture": b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\2\0",
}
ALL = [*TEXTS, *BINARIES]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("readers")
    (folder / "orography").write_text(orography_text())
    (folder / "map").write_text(vmf3_map_text(0))
    (folder / "table").write_text(TABLE)
    write_parquet(folder / "rows", read_table(folder / "table"))
    return folder


@pytest.fixture(autouse=True)
def quiet_gdal():
    """GDAL tells a log what it makes of a file."""
    logger = logging.getLogger("rasterio")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    yield
    logger.setLevel(before)


@pytest.fixture(params=ALL)
def case(request, folder):
    """A reader, the path that it is given, and the content of a sound file."""
    name = request.param
    path = folder / f"given.{name}"
    if name in TEXTS:
        read, text = TEXTS[name]
        return read, path, text.encode()
    whole = {
        "spk": find_kernel("DE421", "SPK"),
        "pck": find_kernel("DE421", "PCK"),
        "trajectory": EXAMPLES / "orbiter" / "orbiter.bsp",
        "terrain": EXAMPLES / "change5" / "ldem_4_landing_site.tif",
        "parquet": folder / "rows",
    }[name]
    return BINARIES[name], path, whole.read_bytes()


def refusal(read, path):
    """What a reader says against a file, if it says something."""
    try:
        read(path)
    except RadiolocError as error:
        message = str(error)
        assert path.name in message
        assert message.isprintable(), message
        return message
    return None


def test_sound_files_are_read(case):
    read, path, content = case
    path.write_bytes(content)
    assert refusal(read, path) is None
    path.unlink()


def test_not_there_or_a_directory(case):
    read, path, _ = case
    assert "no such" in (missing := refusal(read, path)) or "neither a file" in missing
    path.mkdir()
    assert "is a directory; give" in refusal(read, path)
    path.rmdir()


@pytest.mark.parametrize("content", NO_FILES.values(), ids=NO_FILES)
def test_something_else(case, content):
    read, path, _ = case
    path.write_bytes(content)
    assert refusal(read, path) is not None
    path.unlink()


@pytest.mark.parametrize("name", TEXTS)
def test_text_in_another_encoding_or_in_a_damaged_gzip(name, folder):
    read, text = TEXTS[name]
    path = folder / f"given.{name}"
    for content in (text.encode("utf-16"), text.encode("utf-16-le"), gzip.compress(text.encode())[:-9]):
        path.write_bytes(content)
        assert refusal(read, path) is not None
    # In a comment, a label or a name, or where none may be.
    path.write_bytes(text.replace("\n", " \xe9\n", 1).encode("latin-1"))
    refusal(read, path)
    path.unlink()


def test_cut_anywhere(case):
    """Most formats have no end mark: a part of a table is a table; but what is refused is refused clearly."""
    read, path, content = case
    sizes = (
        np.unique(np.geomspace(1, len(content) - 2, 30).astype(int)) if len(content) < 5e6 else [1, 8, 5000]
    )
    for size in [*sizes, *(len(content) - np.geomspace(1, 0.3 * len(content), 12).astype(int))]:
        path.write_bytes(content[:size])
        refusal(read, path)
    path.unlink()
