"""Tracking Data Messages in "keyword = value" notation (KVN): text to :class:`radioloc.io.tdm.message.TdmFile`.

Source: CCSDS 503.0-B-2 (2020), chapter 4.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain, islice, takewhile
from pathlib import Path
from typing import Any

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

_HEADER = ("CCSDS_TDM_VERS", "CREATION_DATE", "ORIGINATOR", "MESSAGE_ID")
_OLD_KEYWORDS = {"SYSTEM TIME": "TIME_SYSTEM", "SYSTEM_TIME": "TIME_SYSTEM", "TIME SYSTEM": "TIME_SYSTEM"}
_RECORD = r"^(?P<keyword>[!-<>-~]+)[ \t]*=[ \t]*(?P<epoch>[!-<>-~]+)[ \t]+(?P<value>[!-<>-~]+)$"
_COMMENT_OR_BLANK = r"^(COMMENT(\s|$)|$)"
# Lines that are taken apart at once: enough to be quick, few enough that their pieces do not fill the memory.
_CHUNK = 50_000


def looks_like_kvn(lines: Iterable[str]) -> bool:
    """Whether the first line that is not blank is a KVN message's version."""
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
    """Reader of the lines of one file, section by section, with some of them in memory."""

    def __init__(self, path: str, lines: Iterable[str], numbers: NDArray[np.int32] | None) -> None:
        self.path = path
        # None is the end of the file.
        self.rest: Iterator[str | None] = chain(map(str.strip, lines), [None])
        self.count = 0  # of the lines that were read
        self.numbers = numbers

    @property
    def number(self) -> int:
        """Number in the file of the line that was read last."""
        return self.count if self.numbers is None else int(self.numbers[self.count - 1])

    def fail(self, problem: str, number: int | None = None) -> FileFormatError:
        """Error that names a line, the one that was read last by default."""
        return FileFormatError(self.path, problem, max(1, number or self.number))

    def next_line(self) -> str | None:
        line = next(self.rest)
        self.count += line is not None
        return line

    def next_not_blank(self) -> str | None:
        while (line := self.next_line()) == "":
            pass
        return line

    def require(self, line: str | None, marker: str) -> None:
        """Refuse any other line than the one that must come next."""
        if line is None:
            raise self.fail(f"the file ends where {marker} must come: it was cut; fetch it again")
        if line != marker:
            raise self.fail(f"{line[:40]!r} stands where {marker} must come")

    def assignments(
        self, end: str, allowed: tuple[str, ...] = ()
    ) -> tuple[dict[str, str], dict[str, int], list[str]]:
        """Keywords, their values and lines, and comments up to the marker that ends a section."""
        values: dict[str, str] = {}
        where = {"": self.number}
        comments: list[str] = []
        while (line := self.next_line()) != end:
            if line is None:
                raise self.fail(f"the file ends before {end}: it was cut; fetch it again")
            keyword, *rest = line.split(maxsplit=1) or [""]
            if keyword in ("", "COMMENT"):
                comments += rest or [""] * (keyword != "")
                continue
            if self.numbers is None:  # XML may have any characters
                self.require_printable(line, self.number)
            keyword, equals, value = (part.strip() for part in line.partition("="))
            if not equals:
                raise self.fail(f"{line[:40]!r} is not a line keyword = value, nor {end}")
            keyword = _OLD_KEYWORDS.get(keyword, keyword)
            if keyword in values:
                raise self.fail(f"{keyword} is there twice, first in line {where[keyword]}")
            if allowed and keyword not in allowed:
                raise self.fail(f"{keyword!r} is not a keyword of the header; use {', '.join(allowed)}")
            values[keyword], where[keyword] = value, self.number
        return values, where, comments

    def segment(self, before: Sequence[TdmSegment]) -> TdmSegment:
        """Read a segment of which the line META_START has just been read."""
        fields, where, comments = self.assignments("META_STOP")
        metadata = read_metadata(self.path, fields, where, before)
        self.require(self.next_not_blank(), "DATA_START")
        columns: list[tuple[Any, ...]] = []
        data_comments: list[str] = []
        section = takewhile(partial(operator.ne, "DATA_STOP"), self.rest)
        while lines := list(islice(section, _CHUNK)):
            # The last line of a file that was cut is not read as a record.
            if lines[-1] is None:
                self.count += len(lines) - 1
                raise self.fail("the file ends before DATA_STOP: it was cut; fetch it again")
            columns += self.records([line for line in lines if line is not None], metadata, data_comments)
            self.count += len(lines)
        self.count += 1
        if not columns:
            raise self.fail("the data section has no record; leave the segment out")
        keyword, epoch, value, line = zip(*columns, strict=True)
        made = TdmSegment(
            self.path,
            metadata,
            np.concatenate(keyword),
            Epochs.concatenate(list(epoch)),
            np.concatenate(value),
            where,
            np.concatenate(line),
            tuple(comments),
            tuple(data_comments),
        )
        require_sound(made)
        return made

    def records(
        self, lines: list[str], metadata: Mapping[str, str], comments: list[str]
    ) -> list[tuple[Any, ...]]:
        """Read columns of the next lines of a data section, none of comments alone, which are appended."""
        import pyarrow as pa
        import pyarrow.compute as pc

        number = np.arange(self.count + 1, self.count + 1 + len(lines), dtype=np.int32)
        if self.numbers is not None:
            number = self.numbers[number - 1]
        texts = pa.array(lines)
        passed = pc.match_substring_regex(texts, _COMMENT_OR_BLANK)
        if pc.any(passed).as_py():
            comments += [line[len("COMMENT") :].strip() for line in texts.filter(passed).to_pylist() if line]
            kept = pc.invert(passed)
            texts, number = texts.filter(kept), number[np.asarray(kept)]
        if not len(texts):
            return []
        found = pc.extract_regex(texts, _RECORD)
        if found.null_count:
            wrong = int(np.argmax(np.asarray(found.is_null())))
            line = texts[wrong].as_py()
            self.require_printable(line, int(number[wrong]))
            raise self.fail(f"{line[:60]!r} is not a record keyword = epoch value", int(number[wrong]))
        keywords, epochs, values = (found.field(name) for name in ("keyword", "epoch", "value"))
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
        """Refuse a line with what is not printable ASCII."""
        # Tabs are not allowed by the standard, but cannot be misunderstood.
        wrong = next((c for c in line if not (c.isascii() and (c.isprintable() or c == "\t"))), None)
        if wrong is not None:
            raise self.fail(f"{wrong!r} is not a printable ASCII character; correct the line", number)
