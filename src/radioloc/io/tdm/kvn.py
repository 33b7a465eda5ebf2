"""Tracking Data Messages: text to :class:`radioloc.io.tdm.message.TdmFile`.

Source: CCSDS 503.0-B-2 (2020), chapter 4.

The notation is "keyword = value" (KVN). Messages in XML (chapter 5) are rewritten as lines of KVN first.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain, islice, takewhile
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError
from radioloc.io.tdm.message import (
    TdmFile,
    TdmSegment,
    read_header,
    read_metadata,
    read_records,
    require_sound,
)
from radioloc.time import Epochs

_MARKERS = {"metadata": ("META_START", "META_STOP"), "data": ("DATA_START", "DATA_STOP")}
_BRANCHES = {"tdm", "header", "body", "segment", "observation", *_MARKERS}


def looks_like_xml(text: str) -> bool:
    """Return whether a text begins like XML and soon has the element of a Tracking Data Message."""
    start = text[:20_000].lstrip()
    return start.startswith("<") and re.search(r"<(?:[\w.-]+:)?tdm[\s>]", start) is not None


def parse_xml(path: str | Path, text: str) -> TdmFile:
    """Read a message from the text of an XML file; :class:`FileFormatError` names the line that is wrong."""
    lines = _Lines(path)
    try:
        lines.parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        problem = f"is not complete XML: {expat.ErrorString(error.code)}; fetch it again"
        raise FileFormatError(path, problem, error.lineno) from None
    return parse_kvn(path, lines.lines, np.array(lines.numbers, dtype=np.int32))


class _Lines:
    """Lines of KVN of the elements that the parser reports, with the numbers of their lines in the file."""

    def __init__(self, path: str | Path) -> None:
        self.path = path
        self.lines: list[str] = []
        self.numbers: list[int] = []
        self.parser = expat.ParserCreate(encoding="utf-8")
        self.parser.buffer_text = True
        self.parser.StartDoctypeDeclHandler = self._refuse_doctype
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._add_text
        self._text = self._epoch = ""
        self._number = 1

    def _fail(self, problem: str) -> FileFormatError:
        return FileFormatError(self.path, problem, self.parser.CurrentLineNumber)

    def _refuse_doctype(self, *_: object) -> None:
        raise self._fail("expected no document type in a TDM; remove the line <!DOCTYPE ...>")

    def _append(self, line: str) -> None:
        self.lines.append(line)
        self.numbers.append(self._number)

    def _start(self, prefixed: str, attributes: Mapping[str, str]) -> None:
        name, self._text = prefixed.rpartition(":")[2], ""
        if not self._epoch:
            self._number = self.parser.CurrentLineNumber
        if not self.lines:
            if name != "tdm":
                raise self._fail(f"expected the root element tdm, got {name}")
            self._append(f"CCSDS_TDM_VERS = {attributes.get('version', '')}")
        elif name in _MARKERS:
            self._append(_MARKERS[name][0])
        elif attributes:
            raise self._fail(f"{name}: expected an element without attributes, got {', '.join(attributes)}")

    def _add_text(self, text: str) -> None:
        self._text += text

    def _end(self, prefixed: str) -> None:
        name, text = prefixed.rpartition(":")[2], " ".join(self._text.split())
        self._text = ""
        if name in _BRANCHES:
            # Text between elements and an epoch without a value are not lines of KVN, which are refused.
            if text or self._epoch:
                self._append(text or self._epoch)
            self._epoch = ""
            if name in _MARKERS:
                self._append(_MARKERS[name][1])
        elif name == "EPOCH":
            self._epoch = text
        else:
            self._append(f"COMMENT {text}" if name == "COMMENT" else f"{name} = {self._epoch} {text}".strip())
            self._epoch = ""


_HEADER = ("CCSDS_TDM_VERS", "CREATION_DATE", "ORIGINATOR", "MESSAGE_ID")
_OLD_KEYWORDS = {"SYSTEM TIME": "TIME_SYSTEM", "SYSTEM_TIME": "TIME_SYSTEM", "TIME SYSTEM": "TIME_SYSTEM"}
_RECORD = r"^(?P<keyword>[!-<>-~]+)[ \t]*=[ \t]*(?P<epoch>[!-<>-~]+)[ \t]+(?P<value>[!-<>-~]+)$"
_COMMENT_OR_BLANK = r"^(COMMENT(\s|$)|$)"
_BLOCK_LINES = 50_000  # that are parsed at once: fast, with little memory


def looks_like_kvn(lines: Iterable[str]) -> bool:
    """Return whether the first line that is not blank is the version of a KVN message."""
    first = next((line for line in lines if line.strip()), "")
    return first.partition("=")[0].strip() == "CCSDS_TDM_VERS"


def parse_kvn(path: str | Path, lines: Iterable[str], numbers: NDArray[np.int32] | None = None) -> TdmFile:
    """Read a message from lines of KVN; `numbers` are those of lines rewritten from XML."""
    reader = _KvnReader(str(path), lines, numbers)
    fields, _, comments = reader.assignments("META_START", _HEADER)
    header = read_header(reader.path, fields, comments)
    segments: list[TdmSegment] = []
    while True:
        segments.append(reader.segment(segments))
        line = reader.next_not_blank()
        if line is None:
            return TdmFile(reader.path, header, tuple(segments))
        reader.require(line, "META_START")


class _KvnReader:
    """Reader of the lines of one file, section by section."""

    def __init__(self, path: str, lines: Iterable[str], numbers: NDArray[np.int32] | None) -> None:
        self.path = path
        # None is the end of the file.
        self.unread: Iterator[str | None] = chain(map(str.strip, lines), [None])
        self.count = 0  # of the lines read
        self.numbers = numbers

    @property
    def number(self) -> int:
        """Number of the last line read in the file."""
        return self.count if self.numbers is None else int(self.numbers[self.count - 1])

    def fail(self, problem: str, number: int | None = None) -> FileFormatError:
        """Return the error at a line, by default the last one read."""
        return FileFormatError(self.path, problem, max(1, number or self.number))

    def next_line(self) -> str | None:
        line = next(self.unread)
        self.count += line is not None
        return line

    def next_not_blank(self) -> str | None:
        while (line := self.next_line()) == "":
            pass
        return line

    def require(self, line: str | None, marker: str) -> None:
        """Refuse a line other than the next marker of the standard."""
        if line is None:
            raise self.fail(f"expected {marker}, got the end of the file; fetch it again")
        if line != marker:
            raise self.fail(f"expected {marker}, got {line[:40]!r}")

    def assignments(
        self, end: str, allowed: tuple[str, ...] = ()
    ) -> tuple[dict[str, str], dict[str, int], list[str]]:
        """Return keywords with their values, their lines, and comments up to the marker that ends a section."""
        values: dict[str, str] = {}
        lines = {"": self.number}
        comments: list[str] = []
        while (line := self.next_line()) != end:
            if line is None:
                raise self.fail(f"expected {end}, got the end of the file; fetch it again")
            keyword, *comment = line.split(maxsplit=1) or [""]
            if keyword in ("", "COMMENT"):
                comments += comment or [""] * (keyword != "")
                continue
            if self.numbers is None:  # XML allows all characters
                self.require_printable(line, self.number)
            keyword, equals, value = (part.strip() for part in line.partition("="))
            if not equals:
                raise self.fail(f"expected keyword = value or {end}, got {line[:40]!r}")
            keyword = _OLD_KEYWORDS.get(keyword, keyword)
            if keyword in values:
                raise self.fail(f"{keyword} repeats that of line {lines[keyword]}")
            if allowed and keyword not in allowed:
                raise self.fail(f"expected {', '.join(allowed)} in the header, got {keyword!r}")
            values[keyword], lines[keyword] = value, self.number
        return values, lines, comments

    def segment(self, previous: Sequence[TdmSegment]) -> TdmSegment:
        """Read a segment after its line META_START."""
        fields, field_lines, comments = self.assignments("META_STOP")
        metadata = read_metadata(self.path, fields, field_lines, previous)
        self.require(self.next_not_blank(), "DATA_START")
        columns: list[tuple[Any, ...]] = []
        data_comments: list[str] = []
        section = takewhile(partial(operator.ne, "DATA_STOP"), self.unread)
        while lines := list(islice(section, _BLOCK_LINES)):
            # The last line of a cut file is not a record.
            if lines[-1] is None:
                self.count += len(lines) - 1
                raise self.fail("expected DATA_STOP, got the end of the file; fetch it again")
            columns += self.records([line for line in lines if line is not None], metadata, data_comments)
            self.count += len(lines)
        self.count += 1
        if not columns:
            raise self.fail("expected records in the data section, got none; leave the segment out")
        keyword, epoch, value, line = zip(*columns, strict=True)
        segment = TdmSegment(
            self.path,
            metadata,
            np.concatenate(keyword),
            Epochs.concatenate(list(epoch)),
            np.concatenate(value),
            field_lines,
            np.concatenate(line),
            tuple(comments),
            tuple(data_comments),
        )
        require_sound(segment)
        return segment

    def records(
        self, lines: list[str], metadata: Mapping[str, str], comments: list[str]
    ) -> list[tuple[Any, ...]]:
        """Return the columns of the next lines of a data section, and append their comments."""
        import pyarrow as pa
        import pyarrow.compute as pc

        number = np.arange(self.count + 1, self.count + 1 + len(lines), dtype=np.int32)
        if self.numbers is not None:
            number = self.numbers[number - 1]
        texts = pa.array(lines)
        is_comment = pc.match_substring_regex(texts, _COMMENT_OR_BLANK)
        if pc.any(is_comment).as_py():
            comments += [
                line[len("COMMENT") :].strip() for line in texts.filter(is_comment).to_pylist() if line
            ]
            is_record = pc.invert(is_comment)
            texts, number = texts.filter(is_record), number[np.asarray(is_record)]
        if not len(texts):
            return []
        records = pc.extract_regex(texts, _RECORD)
        if records.null_count:
            wrong = int(np.argmax(np.asarray(records.is_null())))
            line = texts[wrong].as_py()
            self.require_printable(line, int(number[wrong]))
            raise self.fail(f"expected a record keyword = epoch value, got {line[:60]!r}", int(number[wrong]))
        keywords, epochs, values = (records.field(name) for name in ("keyword", "epoch", "value"))
        units = metadata.get("RANGE_UNITS", "km")
        read = read_records(
            self.path,
            keywords,
            epochs,
            values,
            number,
            time_system=metadata["TIME_SYSTEM"],
            range_units=units,
        )
        return [(*read, number)]

    def require_printable(self, line: str, number: int) -> None:
        """Refuse a line with characters that are not printable ASCII."""
        # Tabs violate the standard, but are unambiguous.
        wrong = next((c for c in line if not (c.isascii() and (c.isprintable() or c == "\t"))), None)
        if wrong is not None:
            raise self.fail(f"expected printable ASCII characters, got {wrong!r}; correct the line", number)
