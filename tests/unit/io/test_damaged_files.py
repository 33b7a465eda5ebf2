"""A file of observations that was cut anywhere gives whole observations or one of the library's errors."""

import gzip
import warnings

import numpy as np
import pytest
from quick import some
from reader_cases import AGREEMENT, SEGMENTS
from tdm_messages import kvn, xml

from radioloc.errors import DataQualityWarning, InputError
from radioloc.io.formats import read_observations
from radioloc.io.tdm import read_tdm

MESSAGES = {"kvn": "\n".join(kvn(*SEGMENTS)) + "\n", "xml": xml(*SEGMENTS)}
OTHERS = ["crd", "mini", "table"]


@pytest.fixture(params=[*OTHERS, *MESSAGES])
def damaged(request, tmp_path):
    """Text of a file, and how and where to read what becomes of it."""
    name = request.param
    if name in MESSAGES:
        text, read = MESSAGES[name], lambda path: read_tdm(path, AGREEMENT)
    else:
        text, read = request.getfixturevalue("texts")[name], read_observations
    return text, (read, tmp_path / "damaged")


def read_or_refuse(file, content):
    read, path = file
    path.write_bytes(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)
            observations = read(path)
    except InputError as error:
        if path.name not in str(error):
            pytest.fail(f"the message does not name the file: {error}")
        return None
    assert len(observations) > 0
    assert np.isfinite(observations.value_m).all()
    assert (observations.sigma_m > 0.0).all()
    assert ((observations.epoch.fraction >= 0.0) & (observations.epoch.fraction < 1.0)).all()
    return observations


def test_undamaged(damaged):
    text, file = damaged
    assert len(read_or_refuse(file, text.encode())) >= 3


@pytest.mark.parametrize("step", some([1, 13], [13]))
def test_cut_anywhere(damaged, step):
    text, file = damaged
    content = text.encode()
    whole = read_or_refuse(file, content)
    for end in range(0, len(content), step):
        part = read_or_refuse(file, content[:end])
        assert part is None or len(part) <= len(whole)
        # CRD and messages have end marks; KVN has one of each segment, and whole segments are a message.
        if text.startswith("H1"):
            assert part is None or len(part) == len(whole)
        elif text in MESSAGES.values():
            assert part is None or content[:end].rstrip().endswith((b"DATA_STOP", b"</tdm>"))
    zipped = gzip.compress(content)
    for end in range(0, len(zipped), 7 * step):
        assert read_or_refuse(file, zipped[:end]) is None
