"""Readers take a file piece by piece: of one that never ends they find the mistake near its start."""

from itertools import chain, cycle

import pytest
from tdm_messages import TWO_WAY, kvn

from radioloc.errors import FileFormatError
from radioloc.io.crd import parse_crd
from radioloc.io.mini import parse_mini
from radioloc.io.tdm.kvn import parse_kvn


def test_crd(crd_lines):
    lines = chain(crd_lines[:-2], ["unknown"], cycle(crd_lines))
    with pytest.raises(FileFormatError, match="not known in CRD") as caught:
        parse_crd("a.np2", lines, None)
    assert caught.value.line == len(crd_lines) - 1


def test_mini(mini_lines):
    lines = chain(mini_lines, ["52"], cycle(mini_lines))
    with pytest.raises(FileFormatError, match="'52' is not a MINI normal point") as caught:
        parse_mini("a.np", lines, None)
    assert caught.value.line == len(mini_lines) + 1


def test_kvn():
    record = "RANGE = 2021-03-01T00:00:00 768800.1"
    whole = kvn((TWO_WAY, [record]))
    stop = whole.index("DATA_STOP")
    lines = chain(whole[:stop], ["RANGE = 2021-03-01T00:00:01 nothing"], cycle([record]))
    with pytest.raises(FileFormatError, match="'nothing' is not a finite number") as caught:
        parse_kvn("a.kvn", lines)
    assert caught.value.line == stop + 1
