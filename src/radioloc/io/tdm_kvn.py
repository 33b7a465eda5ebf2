"""Tracking Data Messages in "keyword = value" notation (KVN): text to :class:`radioloc.io.tdm_file.TdmFile`.

Source: CCSDS 503.0-B-2 (2020), chapter 4.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice, repeat
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError
from radioloc.io.tdm_file import TdmFile, TdmSegment, checked_header, checked_metadata, require_order
from radioloc.io.tdm_records import Records, read_records

_HEADER = ("CCSDS_TDM_VERS", "CREATION_DATE", "ORIGINATOR", "MESSAGE_ID")
# Lines that are taken apart at once: enough to be quick, few enough that their pieces do not fill the memory.
_CHUNK = 50_000


def looks_like_kvn(lines: Sequence[str]) -> bool:
    """Whether the first line that is not blank is a KVN message's version."""
    first = next((line for line in lines if line.strip()), "")
    return first.partition("=")[0].strip() == "CCSDS_TDM_VERS"


def parse_kvn(path: str | Path, lines: Iterable[str]) -> TdmFile:
    """Read a message from the lines of a KVN file.

    Raises
    ------
    FileFormatError
        The file was cut, a section or keyword is unknown, missing or out of place, or a value is not one that
        the standard allows. Names the line.
    """
    return _KvnReader(str(path), lines).read()


class _KvnReader:
    """Goes through the lines of one file, section by section, with some of them in memory."""

    def __init__(self, path: str, lines: Iterable[str]) -> None:
        self.path = path
        self.rest = map(str.strip, lines)
        self.ahead: list[str] = []
        self.used = 0
        # Of the line that was read last.
        self.number = 0

    def fail(self, problem: str, number: int | None = None) -> FileFormatError:
        """Error that names a line, the one that was read last by default."""
        return FileFormatError(self.path, problem, max(1, self.number if number is None else number))

    def read(self) -> TdmFile:
        fields, _, comments = self.assignments("META_START", _HEADER)
        header = checked_header(self.path, fields.pop("CCSDS_TDM_VERS", ""), fields, tuple(comments))
        segments: list[TdmSegment] = []
        while True:
            system = segments[-1].metadata["TIME_SYSTEM"] if segments else None
            segments.append(self.segment(system))
            line = self.next_not_blank()
            if line is None:
                break
            self.require(line, "META_START")
        return TdmFile(self.path, header, tuple(segments))

    def more(self) -> list[str]:
        """The next lines of the file; none at its end."""
        return list(islice(self.rest, _CHUNK))

    def next_line(self) -> str | None:
        """The next line, None at the end."""
        if self.used == len(self.ahead):
            self.ahead, self.used = self.more(), 0
            if not self.ahead:
                return None
        self.used += 1
        self.number += 1
        return self.ahead[self.used - 1]

    def next_not_blank(self) -> str | None:
        """The next line that is not blank, None at the end."""
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
        self, end: str, allowed: Sequence[str] | None = None
    ) -> tuple[dict[str, str], dict[str, int], list[str]]:
        """Keywords, their values and lines, and comments up to the marker that ends a section."""
        values: dict[str, str] = {}
        where = {"": self.number}
        comments: list[str] = []
        while (line := self.next_line()) != end:
            if line is None:
                raise self.fail(f"the file ends before {end}: it was cut; fetch it again")
            if not line:
                continue
            if _is_comment(line):
                comments.append(line[len("COMMENT") :].strip())
                continue
            self.require_printable(line, self.number)
            keyword, equals, value = (part.strip() for part in line.partition("="))
            if not equals:
                raise self.fail(f"{line[:40]!r} is not a line keyword = value, nor {end}")
            if keyword in values:
                raise self.fail(f"{keyword} is there twice, first in line {where[keyword]}")
            if allowed is not None and keyword not in allowed:
                raise self.fail(f"{keyword!r} is not a keyword of the header; use {', '.join(allowed)}")
            values[keyword], where[keyword] = value, self.number
        return values, where, comments

    def segment(self, time_system: str | None) -> TdmSegment:
        """Segment of which the line META_START has just been read."""
        fields, where, comments = self.assignments("META_STOP")
        metadata = checked_metadata(self.path, fields, where, time_system)
        self.require(self.next_not_blank(), "DATA_START")
        data_comments: list[str] = []
        parts = []
        for lines in self.data_lines():
            first = self.number - len(lines) + 1
            part = self.records(lines, first, metadata, data_comments)
            if part is not None:
                parts.append(part)
        if not parts:
            raise self.fail("the data section has no record; leave the segment out")
        segment = TdmSegment(
            metadata=metadata,
            lines=where,
            comments=tuple(comments),
            data_comments=tuple(data_comments),
            **Records.join(parts)._asdict(),
        )
        require_order(self.path, segment)
        return segment

    def data_lines(self) -> Iterator[list[str]]:
        """Lines of a data section, many at once, up to its end, which is read as well."""
        while True:
            try:
                stop = self.ahead.index("DATA_STOP", self.used)
            except ValueError:
                stop = len(self.ahead)
            lines = self.ahead[self.used : stop]
            if stop < len(self.ahead):
                self.number += len(lines)
                self.used = stop + 1
                if lines:
                    yield lines
                self.number += 1
                return
            # The last line of a file that was cut is not read as a record: first whether more follows.
            more = self.more()
            self.number += len(lines)
            if not more:
                raise self.fail("the file ends before DATA_STOP: it was cut; fetch it again")
            self.ahead, self.used = more, 0
            if lines:
                yield lines

    def records(
        self, lines: list[str], first: int, metadata: dict[str, str], comments: list[str]
    ) -> Records | None:
        """Records of some of the lines of a data section; None where there is none among them."""
        number: NDArray[np.int32] = np.arange(first, first + len(lines), dtype=np.int32)
        if "" in lines or any(map(str.startswith, lines, repeat("COMMENT"))):
            comments += [line[len("COMMENT") :].strip() for line in lines if _is_comment(line)]
            kept = [i for i, line in enumerate(lines) if line and not _is_comment(line)]
            lines, number = [lines[i] for i in kept], number[kept]
        if not lines:
            return None
        tokens = self.tokens(lines, number)
        return read_records(
            self.path,
            tokens[0::4],
            tokens[2::4],
            tokens[3::4],
            number,
            time_system=metadata["TIME_SYSTEM"],
            range_units=metadata.get("RANGE_UNITS", "km"),
        )

    def tokens(self, lines: list[str], number: NDArray[np.int32]) -> list[str]:
        """Keyword, equals sign, epoch and value of each line, one after another."""
        text = "\n".join(lines)
        tokens = text.replace("=", " = ").split()
        # Each line starts with what should be its keyword: so no field has slipped from one line to the next.
        if (
            _is_printable(text)
            and len(tokens) == 4 * len(lines)
            and tokens[1::4] == ["="] * len(lines)
            and all(map(str.startswith, lines, tokens[0::4]))
        ):
            return tokens
        for line, where in zip(lines, number.tolist(), strict=True):
            self.require_printable(line, where)
            fields = line.replace("=", " = ").split()
            if len(fields) != 4 or fields[1] != "=":
                raise self.fail(f"{line[:60]!r} is not a record keyword = epoch value", where)
        raise self.fail("the data section cannot be read as records keyword = epoch value", int(number[0]))

    def require_printable(self, line: str, number: int) -> None:
        """Refuse a line with what is not printable ASCII."""
        if not _is_printable(line):
            wrong = next(c for c in line if not _is_printable(c))
            raise self.fail(f"{wrong!r} is not a printable ASCII character; correct the line", number)


def _is_comment(line: str) -> bool:
    return line.startswith("COMMENT") and (len(line) == len("COMMENT") or line[len("COMMENT")].isspace())


def _is_printable(text: str) -> bool:
    # Tabs are not allowed by the standard, but cannot be misunderstood.
    return text.isascii() and text.replace("\n", " ").replace("\t", " ").isprintable()
