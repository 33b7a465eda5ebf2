"""Tracking Data Messages in XML: text to :class:`radioloc.io.tdm_file.TdmFile`.

The observations of a data section, which may be a million, are cut out as text and read in bulk where they have
the plain form that programs write; everything else, and they too where they have another form, goes through
an XML parser.

Source: CCSDS 503.0-B-2 (2020), chapter 5.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

import numpy as np

from radioloc.errors import FileFormatError
from radioloc.io.tdm_file import (
    TdmFile,
    TdmHeader,
    TdmSegment,
    checked_header,
    checked_metadata,
    require_order,
)
from radioloc.io.tdm_records import Records, read_records

_HEADER = ("CREATION_DATE", "ORIGINATOR", "MESSAGE_ID", "COMMENT")
_CHILDREN = {
    "": ("tdm",),
    "tdm": ("header", "body"),
    "body": ("segment",),
    "segment": ("metadata", "data"),
    "data": ("observation", "COMMENT"),
    "header": _HEADER,
}
_BRANCHES = ("tdm", "header", "body", "segment", "metadata", "data", "observation")
# Stands, as a processing instruction, where observations were cut out.
_CUT = "observations-cut-out"
# Characters that are taken apart at once: enough to be quick, few enough not to fill the memory.
_CHUNK = 4_000_000


def looks_like_xml(text: str) -> bool:
    """Whether a text begins like XML and soon has the element of a Tracking Data Message."""
    start = text[:20_000].lstrip()
    return start.startswith("<") and re.search(r"<(?:[\w.-]+:)?tdm[\s>]", start) is not None


def parse_xml(path: str | Path, text: str) -> TdmFile:
    """Read a message from the text of an XML file.

    Raises
    ------
    FileFormatError
        The text is not XML, has a document type, an element is unknown, missing or out of place, or a value is
        not one that the standard allows. Names the line.
    """
    skeleton, blocks = _cut(text)
    if blocks:
        try:
            return _XmlReader(str(path), blocks).read(skeleton)
        except _NotPlainError:
            pass
    return _XmlReader(str(path), []).read(text)


class _NotPlainError(Exception):
    """Observations are not in the form that can be read in bulk."""


class _Block(NamedTuple):
    """Observations of one data section: where in the text they are, and the line on which they start."""

    text: str
    start: int
    end: int
    line: int
    prefix: str


def _cut(text: str) -> tuple[str, list[_Block]]:
    """Text with the observations of each data section cut out, its lines kept; and what was cut out."""
    # What a comment or a CDATA section holds may look like elements but is none.
    root = None if "<!" in text or _CUT in text else re.search(r"<([\w.-]+:)?tdm[\s>]", text)
    if root is None:
        return text, []
    prefix = root[1] or ""
    kept, blocks = [], []
    done, line = 0, 1
    while True:
        section = text.find(f"<{prefix}data>", done)
        stop = text.find(f"</{prefix}data>", section)
        if section < 0 or stop < 0:
            break
        start = text.find(f"<{prefix}observation>", section, stop)
        end_tag = f"</{prefix}observation>"
        end = text.rfind(end_tag, section, stop) + len(end_tag)
        if start < 0 or end < start:
            return text, []
        line += text.count("\n", done, start)
        newlines = text.count("\n", start, end)
        block = _Block(text, start, end, line, prefix)
        blocks.append(block)
        line += newlines
        kept += [text[done:start], f"<?{_CUT} {len(blocks) - 1}?>", "\n" * newlines]
        done = end
    return "".join([*kept, text[done:]]), blocks


def _plain_records(path: str, block: _Block, metadata: dict[str, str]) -> Records:
    """Records of observations that all have the form <observation><EPOCH>t</EPOCH><KEY>v</KEY></observation>."""
    prefix, text = block.prefix, block.text
    end_tag = f"</{prefix}observation>"
    parts = []
    start, line = block.start, block.line
    while start < block.end:
        end = text.find(end_tag, min(start + _CHUNK, block.end - len(end_tag))) + len(end_tag)
        part = text[start:end]
        if not part.isascii() or "&" in part:
            raise _NotPlainError
        tokens = part.replace("<", " <").replace(">", "> ").split()
        n = len(tokens) // 8
        marks = {0: "observation", 1: "EPOCH", 3: "/EPOCH", 7: "/observation"}
        tags = {
            i: f"<{mark[:1]}{prefix}{mark[1:]}>" if mark[0] == "/" else f"<{prefix}{mark}>"
            for i, mark in marks.items()
        }
        keywords = [token[len(prefix) + 1 : -1] for token in tokens[4::8]]
        if len(tokens) != 8 * n or any(tokens[i::8] != [tag] * n for i, tag in tags.items()):
            raise _NotPlainError
        closing = {keyword: f"</{prefix}{keyword}>" for keyword in set(keywords)}
        opening = {keyword: f"<{prefix}{keyword}>" for keyword in closing}
        if tokens[6::8] != [closing[k] for k in keywords] or tokens[4::8] != [opening[k] for k in keywords]:
            raise _NotPlainError
        breaks = np.flatnonzero(np.frombuffer(part.encode(), dtype=np.uint8) == ord("\n"))
        places = np.array([match.start() for match in re.finditer(re.escape(tags[1]), part)])
        lines = (line + np.searchsorted(breaks, places)).astype(np.int32)
        parts.append(_records(path, metadata, keywords, tokens[2::8], tokens[5::8], lines))
        line += len(breaks)
        start = end
    return Records.join(parts)


def _records(
    path: str,
    metadata: dict[str, str],
    keywords: list[str],
    epochs: list[str],
    values: list[str],
    lines: np.ndarray,
) -> Records:
    return read_records(
        path,
        keywords,
        epochs,
        values,
        lines,
        time_system=metadata["TIME_SYSTEM"],
        range_units=metadata.get("RANGE_UNITS", "km"),
    )


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
    """Handlers of an XML parser that build a message; ``blocks`` are observations that were cut out."""

    def __init__(self, path: str, blocks: list[_Block]) -> None:
        self.path = path
        self.blocks = blocks
        self.parser = expat.ParserCreate(encoding="utf-8")
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = self.characters
        self.parser.StartDoctypeDeclHandler = self.doctype
        self.parser.ProcessingInstructionHandler = self.instruction
        self.block: _Block | None = None
        self.open: list[_Open] = [_Open("", 1)]
        self.version = ""
        self.header: TdmHeader | None = None
        self.metadata: _Open | None = None
        self.checked: dict[str, str] = {}
        self.observations: list[tuple[str, str, str, int]] = []
        self.segments: list[TdmSegment] = []

    def fail(self, problem: str, line: int | None = None) -> FileFormatError:
        return FileFormatError(self.path, problem, line or self.parser.CurrentLineNumber)

    def read(self, text: str) -> TdmFile:
        try:
            self.parser.Parse(text.encode("utf-8"), True)
        except expat.ExpatError as error:
            reason = expat.ErrorString(error.code)
            raise FileFormatError(
                self.path, f"is not whole XML: {reason}; fetch it again", error.lineno
            ) from None
        if self.header is None or not self.segments:
            raise self.fail("the message has no header or no segment; add what is missing")
        return TdmFile(self.path, self.header, tuple(self.segments))

    def doctype(self, *_: object) -> None:
        raise self.fail("a document type is not part of a TDM; remove the line <!DOCTYPE ...>")

    def instruction(self, name: str, content: str) -> None:
        if name == _CUT and self.blocks:
            self.block = self.blocks[int(content)]

    def characters(self, text: str) -> None:
        self.open[-1].text.append(text)

    def start(self, qualified: str, attributes: dict[str, str]) -> None:
        name = qualified.rpartition(":")[2]
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
        self.open.append(_Open(name, self.parser.CurrentLineNumber))
        self.open[-1].lines[""] = self.parser.CurrentLineNumber

    def end(self, _: str) -> None:
        done = self.open.pop()
        text = "".join(done.text).strip()
        if done.name not in _BRANCHES:
            parent = self.open[-1]
            if done.name == "COMMENT":
                parent.comments.append(text)
                return
            if done.name in parent.values:
                raise self.fail(f"<{done.name}> is there twice, first in line {parent.lines[done.name]}")
            parent.values[done.name], parent.lines[done.name] = text, done.line
            return
        if text:
            raise self.fail(f"{text[:40]!r} stands between the elements of <{done.name}>; remove it")
        match done.name:
            case "header":
                if self.header is not None:
                    raise self.fail("a second <header>; leave one out", done.line)
                comments = tuple(done.comments)
                self.header = checked_header(self.path, self.version, done.values, comments)
            case "metadata":
                if self.metadata is not None:
                    raise self.fail("a second <metadata> in one segment; leave one out", done.line)
                system = self.segments[-1].metadata["TIME_SYSTEM"] if self.segments else None
                self.metadata = done
                self.checked = checked_metadata(self.path, done.values, done.lines, system)
            case "observation":
                self.observation(done)
            case "data":
                self.data(done)

    def observation(self, done: _Open) -> None:
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
        if self.metadata is None or (self.segments and self.segments[-1].lines is self.metadata.lines):
            raise self.fail("a second <data> in one segment; leave one out", done.line)
        if self.block is not None and self.observations:
            raise _NotPlainError
        if self.block is not None:
            records = _plain_records(self.path, self.block, self.checked)
        elif self.observations:
            keywords, epochs, values, lines = (
                list(column) for column in zip(*self.observations, strict=True)
            )
            records = _records(
                self.path, self.checked, keywords, epochs, values, np.array(lines, dtype=np.int32)
            )
        else:
            raise self.fail("the data section has no observation; leave the segment out", done.line)
        self.observations, self.block = [], None
        segment = TdmSegment(
            metadata=self.checked,
            lines=self.metadata.lines,
            comments=tuple(self.metadata.comments),
            data_comments=tuple(done.comments),
            **records._asdict(),
        )
        require_order(self.path, segment)
        self.segments.append(segment)
