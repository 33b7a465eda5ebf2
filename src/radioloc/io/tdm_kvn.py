"""Tracking Data Messages in "keyword = value" notation (KVN): text to :class:`radioloc.io.tdm_file.TdmFile`.

Source: CCSDS 503.0-B-2 (2020), chapter 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import repeat
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError
from radioloc.io.tdm_file import TdmFile, TdmSegment, checked_header, checked_metadata, require_order
from radioloc.io.tdm_records import Records, read_records

_HEADER = ("CCSDS_TDM_VERS", "CREATION_DATE", "ORIGINATOR", "MESSAGE_ID")
# Lines that are taken apart at once: enough to be quick, few enough that their pieces do not fill the memory.
_CHUNK = 100_000


def looks_like_kvn(lines: Sequence[str]) -> bool:
    """Whether the first line that is not blank is a KVN message's version."""
    first = next((line for line in lines if line.strip()), "")
    return first.partition("=")[0].strip() == "CCSDS_TDM_VERS"


def parse_kvn(path: str | Path, lines: Sequence[str]) -> TdmFile:
    """Read a message from the lines of a KVN file.

    Raises
    ------
    FileFormatError
        The file was cut, a section or keyword is unknown, missing or out of place, or a value is not one that
        the standard allows. Names the line.
    """
    return _KvnReader(str(path), [line.strip() for line in lines]).read()


class _KvnReader:
    """Goes through the stripped lines of one file, section by section."""

    def __init__(self, path: str, lines: list[str]) -> None:
        self.path = path
        self.lines = lines
        self.next = 0

    def fail(self, index: int, problem: str) -> FileFormatError:
        return FileFormatError(self.path, problem, min(index, len(self.lines) - 1) + 1)

    def read(self) -> TdmFile:
        fields, _, comments = self.assignments("META_START", _HEADER)
        header = checked_header(self.path, fields.pop("CCSDS_TDM_VERS", ""), fields, tuple(comments))
        segments: list[TdmSegment] = []
        while True:
            system = segments[-1].metadata["TIME_SYSTEM"] if segments else None
            segments.append(self.segment(system))
            self.skip_blank()
            if self.next == len(self.lines):
                break
            self.expect("META_START")
        return TdmFile(self.path, header, tuple(segments))

    def skip_blank(self) -> None:
        while self.next < len(self.lines) and not self.lines[self.next]:
            self.next += 1

    def expect(self, marker: str) -> None:
        """Go past a line that must come next."""
        self.skip_blank()
        if self.next == len(self.lines):
            raise self.fail(self.next, f"the file ends where {marker} must come: it was cut; fetch it again")
        if self.lines[self.next] != marker:
            raise self.fail(self.next, f"{self.lines[self.next][:40]!r} stands where {marker} must come")
        self.next += 1

    def assignments(
        self, end: str, allowed: Sequence[str] | None = None
    ) -> tuple[dict[str, str], dict[str, int], list[str]]:
        """Keywords, their values and lines, and comments up to the marker that ends a section."""
        values: dict[str, str] = {}
        where = {"": self.next}
        comments: list[str] = []
        for index in range(self.next, len(self.lines)):
            line = self.lines[index]
            if line == end:
                self.next = index + 1
                return values, where, comments
            if not line:
                continue
            if _is_comment(line):
                comments.append(line[len("COMMENT") :].strip())
                continue
            _require_printable(self, index, index + 1)
            keyword, equals, value = (part.strip() for part in line.partition("="))
            if not equals:
                raise self.fail(index, f"{line[:40]!r} is not a line keyword = value, nor {end}")
            if keyword in values:
                raise self.fail(index, f"{keyword} is there twice, first in line {where[keyword]}")
            if allowed is not None and keyword not in allowed:
                raise self.fail(
                    index, f"{keyword!r} is not a keyword of the header; use {', '.join(allowed)}"
                )
            values[keyword], where[keyword] = value, index + 1
        raise self.fail(len(self.lines), f"the file ends before {end}: it was cut; fetch it again")

    def segment(self, time_system: str | None) -> TdmSegment:
        """Segment of which the line META_START has just been read."""
        fields, where, comments = self.assignments("META_STOP")
        metadata = checked_metadata(self.path, fields, where, time_system)
        self.expect("DATA_START")
        first = self.next
        try:
            stop = self.lines.index("DATA_STOP", first)
        except ValueError:
            problem = "the file ends before DATA_STOP: it was cut; fetch it again"
            raise self.fail(len(self.lines), problem) from None
        self.next = stop + 1
        data_comments: list[str] = []
        parts = []
        for start in range(first, stop, _CHUNK):
            part = self.records(start, min(start + _CHUNK, stop), metadata, data_comments)
            if part is not None:
                parts.append(part)
        if not parts:
            raise self.fail(stop, "the data section has no record; leave the segment out")
        segment = TdmSegment(
            metadata=metadata,
            lines=where,
            comments=tuple(comments),
            data_comments=tuple(data_comments),
            **Records.join(parts)._asdict(),
        )
        require_order(self.path, segment)
        return segment

    def records(self, start: int, stop: int, metadata: dict[str, str], comments: list[str]) -> Records | None:
        """Records of some of the lines of a data section; None where there is none among them."""
        lines = self.lines[start:stop]
        number: NDArray[np.int32] = np.arange(start + 1, stop + 1, dtype=np.int32)
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
            _require_printable(self, where - 1, where)
            fields = line.replace("=", " = ").split()
            if len(fields) != 4 or fields[1] != "=":
                raise self.fail(where - 1, f"{line[:60]!r} is not a record keyword = epoch value")
        raise self.fail(
            int(number[0]) - 1, "the data section cannot be read as records keyword = epoch value"
        )


def _is_comment(line: str) -> bool:
    return line.startswith("COMMENT") and (len(line) == len("COMMENT") or line[len("COMMENT")].isspace())


def _is_printable(text: str) -> bool:
    # Tabs are not allowed by the standard, but cannot be misunderstood.
    return text.isascii() and text.replace("\n", " ").replace("\t", " ").isprintable()


def _require_printable(reader: _KvnReader, start: int, stop: int) -> None:
    for index in range(start, stop):
        line = reader.lines[index]
        if not _is_printable(line):
            wrong = next(c for c in line if not _is_printable(c))
            raise reader.fail(index, f"{wrong!r} is not a printable ASCII character; correct the line")
