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
from radioloc.io.tdm.message import MessageBuilder, TdmFile

_CHILDREN = {
    "": ("tdm",),
    "tdm": ("header", "body"),
    "body": ("segment",),
    "segment": ("metadata", "data"),
    "data": ("observation", "COMMENT"),
    "header": ("CREATION_DATE", "ORIGINATOR", "MESSAGE_ID", "COMMENT"),
}
_BRANCHES = ("tdm", "header", "body", "segment", "metadata", "data", "observation")
_REPEATED = ("segment", "observation")
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
    return _XmlReader(str(path)).read(text)


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
        self.made = MessageBuilder(path)
        self.parser = expat.ParserCreate(encoding="utf-8")
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = lambda text: self.open[-1].text.append(text)
        self.parser.StartDoctypeDeclHandler = self.doctype
        self.open: list[_Open] = [_Open("", 1)]
        self.version = ""
        # Keyword, epoch, value and line of what is not read in bulk.
        self.observations: list[tuple[str, str, str, int]] = []

    def fail(self, problem: str, line: int | None = None) -> FileFormatError:
        return self.made.fail(problem, line or self.parser.CurrentLineNumber)

    def read(self, text: str) -> TdmFile:
        done, line = 0, 1
        try:
            for start, end, prefix in _observations(text):
                self.parser.Parse(text[done:start].encode(), False)
                line += text.count("\n", done, start)
                done = start
                if self.open[-1].name == "data":
                    self.take_observations()
                    done = self.plain_records(text, start, end, prefix, line)
                    # The parser keeps count of the lines.
                    newlines = text.count("\n", start, done)
                    self.parser.Parse(b"\n" * newlines, False)
                    line += newlines
            self.parser.Parse(text[done:].encode(), True)
        except expat.ExpatError as error:
            problem = f"is not whole XML: {expat.ErrorString(error.code)}; fetch it again"
            raise self.fail(problem, error.lineno) from None
        return self.made.message()

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
        if name == "data" and "metadata" not in self.open[-1].values:
            raise self.fail("<data> comes before <metadata>; put the metadata first")
        self.open.append(_Open(name, line, lines={"": line}))

    def end(self, _: str) -> None:
        done = self.open.pop()
        text = "".join(done.text).strip()
        parent = self.open[-1]
        if done.name == "COMMENT":
            parent.comments.append(text)
            return
        if done.name in _BRANCHES and text:
            raise self.fail(f"{text[:40]!r} stands between the elements of <{done.name}>; remove it")
        if done.name in parent.values and done.name not in _REPEATED:
            raise self.fail(f"<{done.name}> is there twice, first in line {parent.lines[done.name]}")
        parent.values[done.name], parent.lines[done.name] = text, done.line
        match done.name:
            case "header":
                self.made.header(self.version, done.values, done.comments)
            case "segment" if "data" not in done.values:
                raise self.fail("the <segment> has no <data>; add them or leave the segment out", done.line)
            case "metadata":
                self.made.metadata(done.values, done.lines, done.comments)
            case "observation":
                self.observation(done)
            case "data":
                self.take_observations()
                self.made.segment(done.line, done.comments)

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

    def take_observations(self) -> None:
        """Hand on the observations that were kept."""
        if self.observations:
            keywords, epochs, values, lines = zip(*self.observations, strict=True)
            self.made.records(keywords, epochs, values, np.array(lines, dtype=np.int32))
            self.observations = []

    def plain_records(self, text: str, start: int, end: int, prefix: str, line: int) -> int:
        """Take records <observation><EPOCH>t</EPOCH><KEY>v</KEY></observation>, the first in a line; where they end."""
        import pyarrow as pa
        import pyarrow.compute as pc

        opening, closing = f"<{prefix}observation>", f"</{prefix}observation>"
        while start < end:
            stop = text.find(closing, min(start + _CHUNK, end - len(closing))) + len(closing)
            before, *pieces = f"{text[start:stop]}{opening}".split(f"<{prefix}EPOCH>")
            texts = pa.array(pieces, pa.string())
            found = pc.extract_regex(texts, _PLAIN.replace("PREFIX", re.escape(prefix)))
            epochs, keywords, values, closed = found.flatten()
            plain = before.strip() == opening and not found.null_count
            if not (plain and pc.all(pc.equal(keywords, closed)).as_py()):
                return start
            newlines = pc.count_substring(texts, "\n").to_numpy()
            line += before.count("\n")
            lines = line + np.cumsum(newlines) - newlines
            self.made.records(keywords, epochs, values, lines.astype(np.int32))
            line += int(newlines.sum())
            start = stop
        return end


def _observations(text: str) -> Iterator[tuple[int, int, str]]:
    """Where the observations of each data section begin and end, and the prefix of their elements."""
    # What a comment, a CDATA section or an instruction holds may look like elements but is none.
    quoted = "<!" in text or text.count("<?") > 1
    root = None if quoted else re.search(r"<([\w.-]+:)?tdm[\s>]", text)
    if root is None:
        return
    prefix = root[1] or ""
    end, end_tag = 0, f"</{prefix}observation>"
    while (section := text.find(f"<{prefix}data>", end)) >= 0:
        stop = text.find(f"</{prefix}data>", section)
        start = text.find(f"<{prefix}observation>", section, stop)
        end = text.rfind(end_tag, section, stop) + len(end_tag)
        if stop < 0 or start < 0 or end < start:
            return
        yield start, end, prefix
