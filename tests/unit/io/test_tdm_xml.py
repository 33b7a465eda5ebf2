"""XML messages: the same content as KVN, by the quick way and by the general one; clear errors."""

import numpy as np
import pytest
from tdm_messages import DELAY, RANGES, TWO_WAY, kvn, xml

from radioloc.errors import FileFormatError
from radioloc.io.tdm import xml as tdm_xml
from radioloc.io.tdm.kvn import parse_kvn
from radioloc.io.tdm.xml import looks_like_xml, parse_xml

SEGMENTS = (
    (TWO_WAY, RANGES),
    (DELAY, ["VLBI_DELAY = 2021-03-28T14:00:00 -1.5E-3", "TRANSMIT_FREQ_1 = 2021-03-28T14:00:00 8.4e9"]),
)


def assert_same(first, second):
    assert first.header == second.header
    assert len(first.segments) == len(second.segments)
    for one, other in zip(first.segments, second.segments, strict=True):
        assert one.metadata == other.metadata
        for name in ("keyword", "value"):
            assert np.array_equal(getattr(one, name), getattr(other, name))
        assert np.array_equal(one.epoch.jd, other.epoch.jd)
        assert np.array_equal(one.epoch.fraction, other.epoch.fraction)


def general(text):
    """Read through the parser alone: a comment keeps the quick way out."""
    head, tail = text.split("\n", 1) if "\n" in text else text.split(">", 1)
    return parse_xml(
        "a.xml", f"{head}\n<!-- slow -->{tail}" if "\n" in text else f"{head}><!-- slow -->{tail}"
    )


@pytest.mark.parametrize("newline", ["\n", "", "\n   "])
@pytest.mark.parametrize("prefix", ["", "ndm:"])
def test_same_as_kvn_by_both_ways(newline, prefix, monkeypatch):
    text = xml(*SEGMENTS, prefix=prefix, newline=newline)
    wanted = parse_kvn("a.kvn", kvn(*SEGMENTS))
    assert_same(general(text), wanted)
    for chunk in (1, 100, 10**6):
        monkeypatch.setattr(tdm_xml, "_CHUNK", chunk)
        read = parse_xml("a.xml", text)
        assert_same(read, wanted)
        assert_lines(read, text, prefix)


def assert_lines(read, text, prefix):
    lines = text.split("\n")
    for segment in read.segments:
        for line in segment.line:
            assert f"<{prefix}EPOCH>" in lines[line - 1]
        assert f"<{prefix}MODE>" in lines[segment.line_of("MODE") - 1]


def test_lines_by_the_general_way():
    text = xml(*SEGMENTS)
    read = general(text)
    assert_lines(read, text, "")


def test_quick_way_is_taken(monkeypatch):
    """Plain observations do not reach the handler that takes them one by one."""
    monkeypatch.setattr(tdm_xml._XmlReader, "observation", lambda *_: pytest.fail("went the slow way"))
    assert len(parse_xml("a.xml", xml(*SEGMENTS))) == 4


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (
            "<EPOCH>2021-03-28T14:01:00</EPOCH>\n<RANGE>768801.5</RANGE>",
            "<RANGE>768801.5</RANGE><EPOCH>2021-03-28T14:01:00</EPOCH>",
        ),
        ("<data>", "<data><COMMENT>a &lt; b</COMMENT>"),
        ("<data>", "<data ><COMMENT>c</COMMENT><COMMENT/>"),
        ("768801.5</RANGE>", "\n 768801.5 </RANGE>"),
        ("768801.5</RANGE>", "&#55;68801.5</RANGE>"),
        ("768801.5</RANGE>", "<![CDATA[768801.5]]></RANGE>"),
        ("<RANGE>768801.5", "<RANGE >768801.5"),
        ("<observation>", "<observation >"),
    ],
)
def test_other_ways_of_writing_the_same(old, new, monkeypatch):
    text = xml(*SEGMENTS)
    assert old in text
    for chunk in (10**6, 1):  # with one, observations before it are read the quick way
        monkeypatch.setattr(tdm_xml, "_CHUNK", chunk)
        assert_same(parse_xml("a.xml", text.replace(old, new, 1)), parse_kvn("a.kvn", kvn(*SEGMENTS)))


def test_after_plain_observations_another_has_its_line(monkeypatch):
    monkeypatch.setattr(tdm_xml, "_CHUNK", 1)
    lines = xml((TWO_WAY, RANGES)).split("\n")
    last = max(k for k, line in enumerate(lines) if "<EPOCH>" in line)
    lines[last : last + 2] = lines[last + 1], lines[last]
    read = parse_xml("a.xml", "\n".join(lines))
    wanted = [k + 1 for k, line in enumerate(lines) if "<EPOCH>" in line]
    assert np.concatenate([segment.line for segment in read.segments]).tolist() == wanted


def test_comments_are_kept():
    text = xml((TWO_WAY, RANGES)).replace("<data>", "<data><COMMENT>a &lt; b</COMMENT>")
    text = text.replace("<header>", "<header><COMMENT>h</COMMENT>").replace(
        "<metadata>", "<metadata><COMMENT>m</COMMENT>"
    )
    read = parse_xml("a.xml", text)
    (segment,) = read.segments
    assert (read.header.comments, segment.comments, segment.data_comments) == (("h",), ("m",), ("a < b",))


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("</tdm>", "", "not whole XML: no element found"),
        ("</data>", "", "not whole XML: mismatched tag|stands inside of"),
        ("</header>", "", "stands inside of|mismatched tag"),
        ("<metadata>", "<metadata><x><y/></x>", "<y> stands inside of <x>, which holds a value only"),
        ("<metadata>", "<metadata><RANGE>1</RANGE>", "RANGE: is not a metadata keyword"),
        ("<MODE>", '<MODE unit="m">', "<MODE> has attributes"),
        ("<body>", "<body>text", "'text' stands between the elements of <body>"),
        ("<body>", "<body><data/>", "<data> stands inside of <body>; only segment can"),
        ("<segment>", "<segment><data></data>", "<data> comes before <metadata>"),
        (
            "</segment>",
            "<data><observation/></data></segment>",
            "an <observation> holds an EPOCH and one value",
        ),
        ("</header>", "</header><header></header>", "header has no CREATION_DATE|<header> is there twice"),
        ("<EPOCH>2021-03-28T14:01:00</EPOCH>", "", "holds an EPOCH and one value; here it is RANGE"),
        ("<RANGE>768801.5</RANGE>", "<RANGE>1</RANGE><DOR>1</DOR>", "here it is EPOCH, RANGE, DOR"),
        ("<RANGE>768801.5</RANGE>", "<RANGE>1</RANGE><RANGE>1</RANGE>", "<RANGE> is there twice"),
        ("<RANGE>768801.5</RANGE>", "<RANGE>NaN</RANGE>", "'NaN' is not a finite number"),
        ("<RANGE>768801.5</RANGE>", "<RANGE></RANGE>", "'' is not a finite number"),
        ("<RANGE>768801.5</RANGE>", "<RANGE>٣</RANGE>", "not printable ASCII"),
        ("<RANGE>768801.5</RANGE>", "<WHAT>1</WHAT>", "'WHAT' is not a data keyword"),
        ("<tdm ", '<!DOCTYPE tdm [<!ENTITY a "b">]><tdm ', "document type is not part of a TDM"),
        ('version="2.0"', 'version="4.0"', "versions 1.0 and 2.0 are read"),
        ("<tdm ", "<ndm><tdm ", "<ndm> stands as the first element; only tdm can"),
    ],
)
def test_wrong_messages(old, new, problem):
    text = xml((TWO_WAY, RANGES))
    assert old in text
    place = text.rindex(old) if old != 'version="2.0"' else text.index(old, 30)
    with pytest.raises(FileFormatError, match=problem):
        parse_xml("a.xml", text[:place] + new + text[place + len(old) :])


def test_a_segment_without_data_is_not_passed_over():
    whole = xml(*SEGMENTS)
    start = whole.index("<data>", whole.index("<data>") + 1)
    text = whole[:start] + whole[whole.index("</data>", start) + len("</data>") :]
    with pytest.raises(FileFormatError, match=r"the <segment> has no <data>; add them") as caught:
        parse_xml("a.xml", text)
    assert text.splitlines()[caught.value.line - 1].strip() == "<segment>"


def test_no_segment_and_no_observation():
    with pytest.raises(FileFormatError, match="no header or no segment"):
        parse_xml("a.xml", '<tdm id="CCSDS_TDM_VERS" version="2.0"><body></body></tdm>')
    with pytest.raises(FileFormatError, match="has no record"):
        parse_xml("a.xml", xml((TWO_WAY, [])))


def test_wrong_value_names_its_line():
    text = xml((TWO_WAY, RANGES)).replace("768801.5", "x")
    for read in (lambda t: parse_xml("a.xml", t), general):
        with pytest.raises(FileFormatError, match="'x' is not a finite number") as caught:
            read(text)
        assert "T14:01:00<" in text.split("\n")[caught.value.line - 1]


def test_what_looks_like_xml():
    assert looks_like_xml(xml((TWO_WAY, RANGES)))
    assert looks_like_xml(xml((TWO_WAY, RANGES), prefix="ndm:"))
    assert not looks_like_xml("<html><body></body></html>")
    assert not looks_like_xml("CCSDS_TDM_VERS = 2.0 <tdm>")
