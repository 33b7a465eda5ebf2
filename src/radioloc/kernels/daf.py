"""DAF, the container of SPICE's binary kernels: header and segments, checked against the length of the file.

Damaged counts make jplephem request gigabytes, and a damaged list of segments may be endless. The size of the file
and the list are checked before its summaries are read. Source: NAIF's *DAF Required Reading*.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jplephem.daf import DAF

from radioloc.errors import KernelError
from radioloc.vectors import Floats

RECORD_BYTES = 1024
_WORD_BYTES = 8
_N_INTEGERS = {"SPK": 6, "PCK": 5}
_UNREADABLE = (ValueError, TypeError, struct.error, OverflowError, AssertionError, IndexError, OSError)
"""Exceptions of jplephem and numpy for damaged files."""
_MAX_LISTED_SPANS = 3
_KIND_NAMES = {"SPK": "SPK (positions)", "PCK": "binary PCK (orientation)"}


class DafSegment(NamedTuple):
    """Name and summary of one segment with all its words, mapped from the file in its byte order."""

    path: Path
    name: str
    start_s: float
    end_s: float
    integers: tuple[int, ...]
    words: Floats

    def require(self, sound: bool, problem: str) -> None:
        """Raise a :class:`KernelError` about a problem of this segment unless it is sound."""
        if not sound:
            raise KernelError(
                f"{self.path} is damaged: segment {self.integers[0]} ({self.name}) {problem}; fetch the file again"
            )


def read_segments(path: Path, kind: str) -> list[DafSegment]:
    """Return the segments of an SPK or binary PCK, in the file's order; each lies within the file."""
    try:
        with path.open("rb") as file:
            _check_header(file.read(RECORD_BYTES), path, kind)
            daf = DAF(file)
            _check_extent(daf, path)
            segments = [_segment(daf, path, name, summary) for name, summary in daf.summaries()]
    except _UNREADABLE as error:
        raise KernelError(f"{path} is damaged: {error}; fetch or make the file again") from error
    # Thousands of segments over the same words would take hours to check.
    if sum(len(segment.words) for segment in segments) >= daf.free:
        raise KernelError(f"{path} is damaged: its segments overlap; fetch the file again")
    return segments


def kind_of(path: Path) -> str:
    """Return ``"SPK"`` or ``"PCK"`` by the first bytes of a file; other kinds count as SPK."""
    with path.open("rb") as file:
        return "PCK" if file.read(8).startswith(b"DAF/PCK") else "SPK"


def tdb_date(seconds: float) -> str:
    """Return TDB seconds since J2000 as a date, with the time of day to the second unless it is midnight."""
    if not abs(seconds) < 1e11:
        return f"{seconds:g} s after J2000"
    text = str(np.datetime64("2000-01-01T12:00:00", "s") + np.timedelta64(round(seconds), "s"))
    return text[:-9] if text.endswith("T00:00:00") else text


def merge_spans(spans_s: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the union of spans as disjoint spans in the order of time; both ends belong to a span."""
    merged: list[tuple[float, float]] = []
    for start_s, end_s in sorted(spans_s):
        if merged and start_s <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], end_s))
        else:
            merged.append((start_s, end_s))
    return merged


def span_dates(spans_s: Iterable[tuple[float, float]]) -> tuple[str, str]:
    """Return the first and last epoch of a union of spans as dates of TDB, the last with the gaps between the spans."""
    merged = merge_spans(spans_s)
    texts = [f"{tdb_date(start_s)} to {tdb_date(end_s)}" for start_s, end_s in merged]
    remainder = f" and {len(texts) - _MAX_LISTED_SPANS} more" if len(texts) > _MAX_LISTED_SPANS else ""
    gaps = f" with gaps ({', '.join(texts[:_MAX_LISTED_SPANS])}{remainder})" if len(texts) > 1 else ""
    return f"{tdb_date(merged[0][0])} TDB", f"{tdb_date(merged[-1][1])} TDB{gaps}"


def _check_header(header: bytes, path: Path, kind: str) -> None:
    identity = header[:8]
    # Before 1999 SPICE wrote NAIF/DAF whatever the kind; those files are SPK here.
    if identity != f"DAF/{kind}".encode().ljust(8) and not (kind == "SPK" and identity == b"NAIF/DAF"):
        names = {f"DAF/{key}".encode().ljust(8): f"a {name}" for key, name in _KIND_NAMES.items()}
        content = names.get(identity, "not a SPICE binary kernel" if identity else "empty")
        raise KernelError(
            f"{path} is {content}, but a {_KIND_NAMES[kind]} kernel is expected; give a file of that kind"
        )
    if len(header) < RECORD_BYTES:
        raise KernelError(f"{path} is cut short: it has {len(header)} bytes; fetch the file again")
    # jplephem sizes its buffers by these two before it looks at them.
    if (2, _N_INTEGERS[kind]) not in (struct.unpack_from(order + "2i", header, 8) for order in "<>"):
        raise KernelError(f"{path} is damaged: its summaries have the wrong layout; fetch the file again")


def _check_extent(daf: DAF, path: Path) -> None:
    """Raise an error unless the list of segments ends and the file has the length of its header."""
    damage = _list_damage(daf)
    held_bytes = path.stat().st_size
    announced_bytes = (daf.free - 1) * _WORD_BYTES  # jplephem does not fill the last record
    if announced_bytes > held_bytes:
        raise KernelError(
            f"{path} is cut short: it has {held_bytes} bytes of the {announced_bytes} that its header announces; "
            "fetch the file again"
        )
    if damage:
        raise KernelError(f"{path} is damaged: {damage}; fetch the file again")


def _list_damage(daf: DAF) -> str:
    """Describe a defect of the list of segments; empty for a sound one."""
    records: set[int] = set()
    try:
        for number, count, _ in daf.summary_records():
            if number in records:
                return "its segment list runs in a circle"
            if not (0 <= count <= daf.summaries_per_record and count == int(count)):
                return f"it lists {count:g} segments at once"
            records.add(number)
    except _UNREADABLE as error:
        return f"its segment list cannot be read ({error})"
    return ""


def _segment(daf: DAF, path: Path, name: bytes, summary: tuple[Any, ...]) -> DafSegment:
    start_s, end_s, *integers, first, last = summary
    text = " ".join(name.decode("latin-1").strip("\0 ").split())
    segment = DafSegment(path, text, start_s, end_s, tuple(integers), np.empty(0))
    # The first three records are the header and a first list of segments and their names.
    segment.require(3 * RECORD_BYTES // _WORD_BYTES < first <= last < daf.free, "lies outside the file")
    segment.require(
        bool(np.isfinite([start_s, end_s]).all()) and start_s <= end_s,
        f"claims in the directory to span {start_s} to {end_s} s",
    )
    return segment._replace(words=daf.map_array(first, last))
