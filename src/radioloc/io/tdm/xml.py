"""Tracking Data Messages in XML: text to :class:`radioloc.io.tdm.message.TdmFile`.

The observations of a data section, which may be a million, are read in bulk where they have the plain form that
programs write; everything else, and they too where they have another form, goes through an XML parser. That refuses a
document type and with it all entities of a file's own.

Source: CCSDS 503.0-B-2 (2020), chapter 5.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import numpy as np

from radioloc.errors import FileFormatError
from radioloc.io.tdm.message import (
    Records,
    TdmFile,
    TdmHeader,
    TdmSegment,
    checked_header,
    checked_metadata,
    checked_segment,
)
from radioloc.io.tdm.records import read_records

_CHILDREN = {
    "": ("tdm",),
    "tdm": ("header", "body"),
    "body": ("segment",),
    "segment": ("metadata", "data"),
    "data": ("observation", "COMMENT"),
    "header": ("CREATION_DATE", "ORIGINATOR", "MESSAGE_ID", "COMMENT"),
}
_BRANCHES = ("tdm", "header", "body", "segment", "metadata", "data", "observation")
# What follows <EPOCH> of an observation that holds nothing but an epoch and a value; PREFIX is that of its names.
_PLAIN = (
    r"^(?P<epoch>VALUE+)</PREFIXEPOCH>\s*<PREFIX(?P<keyword>\w+)>(?P<value>VALUE*)</PREFIX(?P<close>\w+)>"
    r"\s*</PREFIXobservation>\s*<PREFIXobservation>\s*$"
).replace("VALUE", "[!-%'-;=?-~]")
# Characters that are taken apart at once: enough to be quick, few enough not to fill the memory.
_CHUNK = 4_000_000


def looks_like_xml(text: str) -> bool:
    """Whether a text begins like XML and soon has the element of a Tracking Data Message."""
    start = text[:20_000].lstrip()
    return start.startswith("<") and re.search(r"<(?:[\w.-]+:)?tdm[\s>]", start) is not None


def parse_xml(path: str | Path, text: str) -> TdmFile:
    """Read a message from the text of an XML file; :class:`FileFormatError` names the line that is wrong."""
    try:
        return _XmlReader(str(path)).read(text, bulk=True)
    except _NotPlainError:
        return _XmlReader(str(path)).read(text, bulk=False)


class _NotPlainError(Exception):
    """Observations are not in the form that can be read in bulk."""


@dataclass(slots=True)
class _Open:
    """An element that has begun: its name, line, what it says and what its children say."""

    name: str
    line: int
    text: list[str] = field(default_factory=list)
    values: dict[str, str] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)
    comments: list[str] = field(default_factory=list)


class _XmlReader:
    """Handlers of an XML parser that build a message."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.parser = expat.ParserCreate(encoding="utf-8")
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = lambda text: self.open[-1].text.append(text)
        self.parser.StartDoctypeDeclHandler = self.doctype
        self.open: list[_Open] = [_Open("", 1)]
        self.version = ""
        self.header: TdmHeader | None = None
        self.metadata: _Open | None = None
        self.checked: dict[str, str] = {}
        self.observations: list[tuple[str, str, str, int]] = []
        self.records: list[Records] = []
        self.segments: list[TdmSegment] = []

    def fail(self, problem: str, line: int | None = None) -> FileFormatError:
        return FileFormatError(self.path, problem, line or self.parser.CurrentLineNumber)

    def read(self, text: str, *, bulk: bool) -> TdmFile:
        done, line = 0, 1
        try:
            for start, end, prefix in _observations(text) if bulk else ():
                self.parser.Parse(text[done:start].encode(), False)
                if self.open[-1].name != "data" or self.records:
                    raise _NotPlainError
                line += text.count("\n", done, start)
                self.plain_records(text, start, end, prefix, line)
                # The parser keeps count of the lines.
                newlines = text.count("\n", start, end)
                self.parser.Parse(b"\n" * newlines, False)
                done, line = end, line + newlines
            self.parser.Parse(text[done:].encode(), True)
        except expat.ExpatError as error:
            problem = f"is not whole XML: {expat.ErrorString(error.code)}; fetch it again"
            raise FileFormatError(self.path, problem, error.lineno) from None
        if self.header is None or not self.segments:
            raise self.fail("the message has no header or no segment; add what is missing")
        return TdmFile(self.path, self.header, tuple(self.segments))

    def doctype(self, *_: object) -> None:
        raise self.fail("a document type is not part of a TDM; remove the line <!DOCTYPE ...>")

    def start(self, qualified: str, attributes: dict[str, str]) -> None:
        name, line = qualified.rpartition(":")[2], self.parser.CurrentLineNumber
        parent = self.open[-1].name
        if parent not in _BRANCHES and parent:
            raise self.fail(f"<{name}> stands inside of <{parent}>, which holds a value only")
        allowed = _CHILDREN.get(parent)
        if allowed is not None and name not in allowed:
            inside = f"inside of <{parent}>" if parent else "as the first element"
            raise self.fail(f"<{name}> stands {inside}; only {', '.join(allowed)} can")
        if allowed is None and name in _BRANCHES:
            raise self.fail(f"<{name}> stands inside of <{parent}>; close that first")
        if name == "tdm":
            self.version = attributes.get("version", "")
        elif attributes:
            raise self.fail(f"<{name}> has attributes ({', '.join(attributes)}); a TDM has none there")
        if name == "segment":
            self.metadata = None
        if name == "data" and self.metadata is None:
            raise self.fail("<data> comes before <metadata>; put the metadata first")
        self.open.append(_Open(name, line, lines={"": line}))

    def end(self, _: str) -> None:
        done = self.open.pop()
        text = "".join(done.text).strip()
        parent = self.open[-1]
        if done.name == "COMMENT":
            parent.comments.append(text)
        elif done.name not in _BRANCHES:
            if done.name in parent.values:
                raise self.fail(f"<{done.name}> is there twice, first in line {parent.lines[done.name]}")
            parent.values[done.name], parent.lines[done.name] = text, done.line
        elif text:
            raise self.fail(f"{text[:40]!r} stands between the elements of <{done.name}>; remove it")
        elif done.name == "header":
            if self.header is not None:
                raise self.fail("a second <header>; leave one out", done.line)
            self.header = checked_header(self.path, self.version, done.values, done.comments)
        elif done.name == "metadata":
            if self.metadata is not None:
                raise self.fail("a second <metadata> in one segment; leave one out", done.line)
            self.metadata = done
            self.checked = checked_metadata(self.path, done.values, done.lines, self.segments)
        elif done.name == "observation":
            self.observation(done)
        elif done.name == "data":
            self.data(done)

    def observation(self, done: _Open) -> None:
        """Keep an observation that is not read in bulk."""
        others = [name for name in done.values if name != "EPOCH"]
        if "EPOCH" not in done.values or len(others) != 1:
            held = ", ".join(done.values) or "nothing"
            raise self.fail(f"an <observation> holds an EPOCH and one value; here it is {held}", done.line)
        texts = (others[0], done.values["EPOCH"], done.values[others[0]])
        for text in texts:
            if not (text.isascii() and text.isprintable()):
                raise self.fail(f"{text[:40]!r} is not printable ASCII; correct it", done.lines["EPOCH"])
        self.observations.append((*texts, done.lines["EPOCH"]))

    def data(self, done: _Open) -> None:
        """Make the segment of a data section that ends here."""
        assert self.metadata is not None  # seen to where the section began
        if self.segments and self.segments[-1].lines is self.metadata.lines:
            raise self.fail("a second <data> in one segment; leave one out", done.line)
        if self.records and self.observations:
            raise _NotPlainError
        if self.observations:
            keywords, epochs, values, lines = (list(x) for x in zip(*self.observations, strict=True))
            self.read_records(keywords, epochs, values, np.array(lines, dtype=np.int32))
        if not self.records:
            raise self.fail("the data section has no observation; leave the segment out", done.line)
        comments = {"comments": tuple(self.metadata.comments), "data_comments": tuple(done.comments)}
        self.segments.append(
            checked_segment(self.path, self.records, self.checked, self.metadata.lines, **comments)
        )
        self.observations, self.records = [], []

    def read_records(self, keywords: object, epochs: object, values: object, lines: np.ndarray) -> None:
        system, units = self.checked["TIME_SYSTEM"], self.checked.get("RANGE_UNITS", "km")
        part = read_records(self.path, keywords, epochs, values, lines, time_system=system, range_units=units)
        self.records.append(part)

    def plain_records(self, text: str, start: int, end: int, prefix: str, line: int) -> None:
        """Records of observations <observation><EPOCH>t</EPOCH><KEY>v</KEY></observation>, the first in a line."""
        import pyarrow as pa
        import pyarrow.compute as pc

        opening, closing = f"<{prefix}observation>", f"</{prefix}observation>"
        while start < end:
            stop = text.find(closing, min(start + _CHUNK, end - len(closing))) + len(closing)
            before, *pieces = f"{text[start:stop]}{opening}".split(f"<{prefix}EPOCH>")
            texts = pa.array(pieces, pa.string())
            found = pc.extract_regex(texts, _PLAIN.replace("PREFIX", re.escape(prefix)))
            keywords, closed = found.field("keyword"), found.field("close")
            if (
                before.strip() != opening
                or found.null_count
                or not pc.all(pc.equal(keywords, closed)).as_py()
            ):
                raise _NotPlainError
            newlines = pc.count_substring(texts, "\n").to_numpy()
            line += before.count("\n")
            lines = line + np.cumsum(newlines) - newlines
            self.read_records(keywords, found.field("epoch"), found.field("value"), lines.astype(np.int32))
            line += int(newlines.sum())
            start = stop


def _observations(text: str) -> Iterator[tuple[int, int, str]]:
    """Where the observations of each data section begin and end, and the prefix of their elements."""
    # What a comment, a CDATA section or an instruction holds may look like elements but is none.
    quoted = "<!" in text or text.count("<?") > 1
    root = None if quoted else re.search(r"<([\w.-]+:)?tdm[\s>]", text)
    prefix = (root[1] or "") if root else ""
    section = 0 if root else -1
    while section >= 0 and (section := text.find(f"<{prefix}data>", section)) >= 0:
        stop = text.find(f"</{prefix}data>", section)
        start, end_tag = text.find(f"<{prefix}observation>", section, stop), f"</{prefix}observation>"
        end = text.rfind(end_tag, section, stop) + len(end_tag)
        if stop < 0 or start < 0 or end < start:
            return
        yield start, end, prefix
        section = end
