"""Every reader, given a file that is not there or something else: one clear error. Damaged files are the fuzzer's."""

import logging

import numpy as np
import pytest
from fuzz_readers import cases
from reader_cases import BINARIES, TEXTS

from radioloc.errors import RadiolocError

NO_FILES = {
    "empty": b"",
    "blank": b" \n\n\t\n",
    "words": b"these are words\nand more of them\n",
    "binary": np.random.default_rng(1).integers(0, 256, 3000, dtype=np.uint8).tobytes(),
    "picture": b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\2\0",
}


@pytest.fixture(scope="module")
def readers(tmp_path_factory):
    folder = tmp_path_factory.mktemp("readers")
    return folder, cases(folder)


@pytest.fixture(autouse=True)
def quiet_gdal():
    """Silence the log of GDAL."""
    logger = logging.getLogger("rasterio")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    yield
    logger.setLevel(level)


def refusal(read, path):
    with pytest.raises(RadiolocError) as caught:
        read(path)
    message = str(caught.value)
    assert path.name in message
    assert message.isprintable(), message
    return message


@pytest.mark.parametrize("name", [*TEXTS, *BINARIES])
def test_no_file_a_directory_and_something_else(name, readers):
    folder, names = readers
    (read, _), path = names[name], folder / f"given.{name}"
    assert "no such" in (missing := refusal(read, path)) or "neither a file" in missing
    path.mkdir()
    assert "is a directory; give" in refusal(read, path)
    path.rmdir()
    for content in NO_FILES.values():
        path.write_bytes(content)
        refusal(read, path)
