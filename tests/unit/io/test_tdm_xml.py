"""XML messages: the same content as KVN; clear errors."""

import numpy as np
import pytest
from tdm_messages import DELAY, RANGES, TWO_WAY, kvn, xml

from radioloc.errors import FileFormatError
from radioloc.io.tdm.kvn import parse_kvn, parse_xml

SEGMENTS = (
    (TWO_WAY, RANGES),
    (DELAY, ["VLBI_DELAY = 2021-03-28T14:00:00 -1.5E-3", "TRANSMIT_FREQ_1 = 2021-03-28T14:00:00 8.4e9"]),
)


def assert_same(first, second):
    assert first.header == second.header
    assert len(first.segments) == len(second.segments)
    for segment, expected in zip(first.segments, second.segments, strict=True):
        assert segment.metadata == expected.metadata
        for name in ("keyword", "value"):
            assert np.array_equal(getattr(segment, name), getattr(expected, name))
        assert np.array_equal(segment.epoch.jd, expected.epoch.jd)
        assert np.array_equal(segment.epoch.fraction, expected.epoch.fraction)


@pytest.mark.parametrize("newline", ["\n", "", "\n   "])
@pytest.mark.parametrize("prefix", ["", "ndm:"])
def test_same_as_kvn(newline, prefix):
    text = xml(*SEGMENTS, prefix=prefix, newline=newline).replace("<body>", "<body><!-- of\ntwo lines -->")
    read = parse_xml("a.xml", text)
    assert_same(read, parse_kvn("a.kvn", kvn(*SEGMENTS)))
    lines = text.split("\n")
    for segment in read.segments:
        for line in segment.line:
            assert f"<{prefix}EPOCH>" in lines[line - 1]
        assert f"<{prefix}MODE>" in lines[segment.line_of("MODE") - 1]


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("</tdm>", "", "complete XML"),
        ("<metadata>", "<metadata><RANGE>1</RANGE>", "metadata keyword"),
        ("<MODE>", '<MODE unit="m">', "attributes"),
        ("<segment>", "<segment><data></data>", "DATA_START"),
        ("<EPOCH>2021-03-28T14:01:00</EPOCH>", "", "record"),
        ("<RANGE>768801.5</RANGE>", "<RANGE>1</RANGE><DOR>1</DOR>", "record"),
        ("<tdm ", '<!DOCTYPE tdm [<!ENTITY a "b">]><tdm ', "DOCTYPE"),
        ("<tdm ", "<ndm><tdm ", "root element"),
    ],
)
def test_wrong_messages_are_refused(old, new, problem):
    text = xml((TWO_WAY, RANGES))
    assert old in text
    place = text.rindex(old)
    with pytest.raises(FileFormatError, match=problem):
        parse_xml("a.xml", text[:place] + new + text[place + len(old) :])
