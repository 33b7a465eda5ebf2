"""Every reader, given a file that is not there, not whole or something else: one clear error.

Clear is one line that names the file and holds nothing unprintable; what else it says the readers' own tests know.
"""

import logging

import numpy as np
import pytest
from atmosphere_files import orography_text, vmf3_map_text
from odf_files import doppler, odf
from reader_cases import BINARIES, EXAMPLES, TABLE, TEXTS

from radioloc.errors import RadiolocError
from radioloc.io.table import read_table, write_parquet
from radioloc.kernels import find_kernel

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
    (folder / "orbit_data").write_bytes(odf([doppler(k) for k in range(9)]))
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
        "odf": folder / "orbit_data",
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
