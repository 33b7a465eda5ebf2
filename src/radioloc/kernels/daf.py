"""The container of SPICE's binary kernels, the DAF: header and list of segments, checked before a library reads them.

A damaged count makes jplephem ask for gigabytes and SPICE write past its buffers, which ends the interpreter. So
every address and count is checked against the length of the file first.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jplephem.daf import DAF
from numpy.typing import NDArray

from radioloc.errors import KernelError

_WORD_BYTES, _RECORD_BYTES = 8, 1024
_N_INTEGERS = {"SPK": 6, "PCK": 5}
_UNREADABLE = (ValueError, TypeError, struct.error, OverflowError, AssertionError, IndexError, OSError)
"""What jplephem and numpy raise."""
_KIND_NAMES = {"SPK": "SPK (positions)", "PCK": "binary PCK (orientation)"}


class DafSegment(NamedTuple):
    """Name and summary of one segment; `words` is all it holds, mapped from the file, from and to `addresses`."""

    name: str
    start_s: float
    end_s: float
    integers: tuple[int, ...]
    addresses: tuple[int, int]
    words: NDArray[np.float64]

    def damaged(self, path: Path, what: str) -> KernelError:
        """What to raise of a segment in which something is wrong."""
        return KernelError(
            f"{path} is damaged: segment {self.integers[0]} ({self.name}) {what}; fetch the file again"
        )


def read_segments(path: Path, kind: str) -> list[DafSegment]:
    """Segments of an SPK or binary PCK, in the file's order; each lies within the file."""
    try:
        with path.open("rb") as file:
            _check_header(file.read(_RECORD_BYTES), path, kind)
            daf = DAF(file)
            _check_extent(daf, path)
            return [_segment(daf, path, name, summary) for name, summary in daf.summaries()]
    except _UNREADABLE as error:
        raise KernelError(f"{path} is damaged: {error}; fetch or make the file again") from error


def kind_of(path: Path) -> str:
    """``"SPK"`` or ``"PCK"``, by the first bytes of a file; what is neither is taken for an SPK."""
    with path.open("rb") as file:
        return "PCK" if file.read(8).startswith(b"DAF/PCK") else "SPK"


def tdb_date(seconds: float) -> str:
    """TDB seconds since J2000 as a date, with the time of day to the second where it is not midnight."""
    if not abs(seconds) < 1e11:
        return f"{seconds:g} s after J2000"
    text = str(np.datetime64("2000-01-01T12:00:00", "s") + np.timedelta64(round(seconds), "s"))
    return text[:-9] if text.endswith("T00:00:00") else text


def _check_header(header: bytes, path: Path, kind: str) -> None:
    identity = header[:8]
    # Before 1999 SPICE wrote NAIF/DAF whatever the kind; those files are SPK here.
    if identity != f"DAF/{kind}".encode().ljust(8) and not (kind == "SPK" and identity == b"NAIF/DAF"):
        names = {f"DAF/{key}".encode().ljust(8): f"a {name}" for key, name in _KIND_NAMES.items()}
        found = names.get(identity, "not a SPICE binary kernel" if identity else "empty")
        raise KernelError(
            f"{path} is {found}, but a {_KIND_NAMES[kind]} kernel is wanted; give a file of that kind"
        )
    if len(header) < _RECORD_BYTES:
        raise KernelError(f"{path} is cut short: it has {len(header)} bytes; fetch the file again")
    # jplephem sizes its buffers by these two before it looks at them.
    if (2, _N_INTEGERS[kind]) not in (struct.unpack_from(order + "2i", header, 8) for order in "<>"):
        raise KernelError(f"{path} is damaged: its summaries have the wrong layout; fetch the file again")


def _check_extent(daf: DAF, path: Path) -> None:
    """Whether the file is as long as it says, and its list of segments ends."""
    if (daf.nd, daf.ni) not in ((2, n) for n in _N_INTEGERS.values()):
        raise KernelError(f"{path} is damaged: its summaries have the wrong layout; fetch the file again")
    held_bytes = path.stat().st_size
    announced_bytes = (daf.free - 1) * _WORD_BYTES
    if announced_bytes > held_bytes:
        raise KernelError(
            f"{path}{_announced_span(daf)} is cut short: it has {held_bytes} bytes of the "
            f"{announced_bytes} that its header announces; fetch the file again"
        )
    seen: set[int] = set()
    for number, count, _ in daf.summary_records():
        if number in seen:
            raise KernelError(f"{path} is damaged: its segment list runs in a circle; fetch the file again")
        if not (0 <= count <= daf.summaries_per_record and count == int(count)):
            raise KernelError(f"{path} is damaged: it lists {count:g} segments at once; fetch the file again")
        seen.add(number)


def _announced_span(daf: DAF) -> str:
    """What the summaries of a file that cannot be read whole say of its span, if they can be read."""
    try:
        spans = [values[:2] for _, values in daf.summaries()]
        return f" (spanning {tdb_date(max(s[0] for s in spans))} to {tdb_date(min(s[1] for s in spans))})"
    except _UNREADABLE:
        return ""


def _segment(daf: DAF, path: Path, name: bytes, summary: tuple[Any, ...]) -> DafSegment:
    start_s, end_s, *integers, first, last = summary
    text = " ".join(name.decode("latin-1").strip("\0 ").split())
    segment = DafSegment(text, start_s, end_s, tuple(integers), (first, last), np.empty(0))
    # The first three records are the header and a first list of segments and their names.
    if not 3 * _RECORD_BYTES // _WORD_BYTES < first <= last < daf.free:
        raise segment.damaged(path, "lies outside the file")
    if not (np.isfinite([start_s, end_s]).all() and start_s <= end_s):
        raise segment.damaged(path, f"claims in the directory to span {start_s} to {end_s} s")
    return segment._replace(words=daf.map_array(first, last))
