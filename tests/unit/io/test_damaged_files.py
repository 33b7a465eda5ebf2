"""A file with an end mark that was cut anywhere is refused, or gives the whole segments before the cut."""

import gzip
from contextlib import suppress

import pytest
from quick import some
from reader_cases import AGREEMENT, CRD, SEGMENTS
from tdm_messages import kvn, xml

from radioloc.errors import InputError
from radioloc.io import read_tdm
from radioloc.io.crd import read_crd

FILES = {
    "crd": (CRD, read_crd, ()),
    "kvn": ("\n".join(kvn(*SEGMENTS)) + "\n", lambda path: read_tdm(path, AGREEMENT), b"DATA_STOP"),
    "xml": (xml(*SEGMENTS), lambda path: read_tdm(path, AGREEMENT), b"</tdm>"),
}


@pytest.mark.parametrize("step", some([1, 13], [13]))
@pytest.mark.parametrize("name", FILES)
@pytest.mark.filterwarnings("ignore:.*is already there")
def test_cut_anywhere(name, step, tmp_path):
    text, read, stop = FILES[name]
    content, path = text.encode(), tmp_path / "cut"
    path.write_bytes(content)
    complete_count = len(read(path))
    zipped = gzip.compress(content)
    ends = [(content, end) for end in range(0, len(content), step)]
    for data, end in ends + [(zipped, end) for end in range(0, len(zipped), 7 * step)]:
        path.write_bytes(data[:end])
        count = None
        with suppress(InputError):
            count = len(read(path))
        if count is not None:
            assert data is content
            assert content[:end].rstrip().endswith(stop) if stop else count == complete_count
