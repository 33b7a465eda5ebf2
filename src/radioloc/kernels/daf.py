"""The container of SPICE's binary kernels, the DAF: header and segments, checked before a library reads them.

A damaged count makes jplephem ask for gigabytes and SPICE write past its buffers, which ends the interpreter. So
every address and count is checked against the length of the file first. SPICE trusts a segment's directory, too: the
layouts are those of NAIF's SPK Required Reading, by type. All numbers must be finite, counts whole and such that the
parts fill the segment exactly, tables of epochs in order, and records no longer than SPICE's buffers.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jplephem.daf import DAF
from numpy.typing import NDArray

from radioloc.constants import J2000_JD, SECONDS_PER_DAY
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


_Words = NDArray[np.float64]
_DIRECTORY_STEP = 100
_MAX_RECORD_WORDS = 197
"""SPICE's buffer of 198 words, of which one is the length."""
_MAX_STATES_LAGRANGE, _MAX_STATES_HERMITE = 28, 14  # polynomials of degree 27
_MAX_MDA_TERMS = 25
_HUGE = 1e30
_GENERIC_META_WORDS = 17


class _Damage(Exception):  # noqa: N818
    """What is wrong with a segment."""


def require_sound(path: Path, segment: DafSegment, spk_type: int) -> None:
    """Raise a :class:`KernelError` that says what is wrong with a segment, if anything is."""
    words = segment.words
    try:
        known = ", ".join(map(str, sorted(_CHECKS)))
        _require(spk_type in _CHECKS, f"is of type {spk_type}, which cannot be read here (types {known} can)")
        # Infinity and what becomes infinite when squared stop SPICE, and the process, in its error message.
        _require(
            bool(words.max() < _HUGE and words.min() > -_HUGE),  # nor NaN; without a copy of gigabytes
            "holds what is not a number, or far too large, in its records or directory",
        )
        _CHECKS[spk_type](words, segment.start_s, segment.end_s)
    except _Damage as damage:
        raise segment.damaged(path, str(damage)) from None


def _require(sound: bool, problem: str) -> None:
    if not sound:
        raise _Damage(problem)


def _count(word: float, least: int, most: float, what: str) -> int:
    """A whole number within bounds."""
    _require(least <= word <= most and word == round(word), f"has {word:g} in its directory as {what}")
    return int(word)


def _require_length(words: _Words, expected: int) -> None:
    _require(len(words) == expected, f"has {len(words)} words where its directory asks for {expected}")


def _tail(words: _Words, n: int) -> list[float]:
    _require(len(words) > n, "is shorter than its own directory")
    return [float(word) for word in words[-n:]]


def _require_covered(
    start_s: float, end_s: float, first_s: float, last_s: float, slack_s: float = 0.0
) -> None:
    _require(
        first_s - slack_s <= start_s and end_s <= last_s + slack_s,
        f"claims {tdb_date(start_s)} to {tdb_date(end_s)}, but its data span {tdb_date(first_s)} to {tdb_date(last_s)}",
    )


def _epochs(table: _Words, count: int, n_directory: int, strictly: bool = True) -> _Words:
    """Epochs followed by every hundredth of them."""
    epochs, directory = table[:count], table[count : count + n_directory]
    steps = np.diff(epochs)
    _require(bool((steps > 0 if strictly else steps >= 0).all()), "has epochs that are not in order")
    sampled = epochs[_DIRECTORY_STEP - 1 :: _DIRECTORY_STEP][:n_directory]
    _require(np.array_equal(directory, sampled), "has a directory of epochs that are not its own")
    return epochs


def _chebyshev(words: _Words, start_s: float, end_s: float, fixed: int, rows: int) -> None:
    """Types 2 and 3: records of one length in time, each of middle and half length and some series; 20, in days."""
    in_days = fixed == 0
    *first, length, size, count = _tail(words, 7 if in_days else 4)
    n_words = _count(size, fixed + rows, _MAX_RECORD_WORDS, "the length of a record")
    _require((n_words - fixed) % rows == 0, f"has a directory with records of {n_words} words")
    n = _count(count, 1, len(words), "the number of records")
    _require_length(words, n * n_words + len(first) + 3)
    _require(length > 0, f"has a directory with records of {length:g} {'days' if in_days else 's'}")
    if in_days:
        first_s, length_s = ((first[2] - J2000_JD) + first[3]) * SECONDS_PER_DAY, length * SECONDS_PER_DAY
        _require_covered(start_s, end_s, first_s, first_s + n * length_s, slack_s=1e-4)
    else:
        _require_covered(start_s, end_s, first[0], first[0] + n * length)


def _two_body(words: _Words, start_s: float, end_s: float) -> None:
    """Type 5: states and their epochs, between which the motion is Keplerian."""
    n = _count(_tail(words, 2)[1], 1, len(words), "the number of states")
    _require_length(words, 7 * n + n // _DIRECTORY_STEP + 2)
    _epochs(words[6 * n :], n, n // _DIRECTORY_STEP)


def _states(words: _Words, count: float, window: float, hermite: bool) -> int:
    n = _count(count, 1, len(words), "the number of states")
    most = _MAX_STATES_HERMITE if hermite else _MAX_STATES_LAGRANGE
    _count(window, 1, min(n, most), "the number of states to interpolate between")
    return n


def _equal_steps(words: _Words, start_s: float, end_s: float, hermite: bool) -> None:
    """Types 8 and 12: states at equal steps, interpolated."""
    first_s, step_s, window_less_1, count = _tail(words, 4)
    n = _states(words, count, window_less_1 + 1, hermite)
    _require_length(words, 6 * n + 4)
    _require(step_s > 0, f"has steps of {step_s:g} s")
    _require_covered(start_s, end_s, first_s, first_s + (n - 1) * step_s, slack_s=1e-6 * step_s)


def _unequal_steps(words: _Words, start_s: float, end_s: float, hermite: bool | None = None) -> None:
    """Types 9 and 13: states and their epochs, interpolated; 18 and mini-segments of 19, which say themselves how."""
    packet, directory = 6, 2
    *_, window, count = _tail(words, 2)
    if hermite is None:  # with rates of its own, Lagrange, or Hermite
        subtype = _count(_tail(words, 3)[0], 0, 2, "its subtype")
        packet, directory, hermite = 12 if subtype == 0 else 6, 3, subtype != 1
    else:
        window += 1
    n = _states(words, count, window, hermite)
    n_directory = (n - 1) // _DIRECTORY_STEP
    _require_length(words, (packet + 1) * n + n_directory + directory)
    epochs = _epochs(words[packet * n :], n, n_directory)
    _require_covered(start_s, end_s, epochs[0], epochs[-1])


def _esoc_piecewise(words: _Words, start_s: float, end_s: float) -> None:
    """Type 19: mini-segments, the bounds of their intervals, where each begins."""
    latest, count = _tail(words, 2)
    _count(latest, 0, 1, "the choice at a boundary")
    n = _count(count, 1, len(words), "the number of intervals")
    n_directory = n // _DIRECTORY_STEP
    table = len(words) - 2 - 2 * (n + 1) - n_directory
    _require(table > 0, "is shorter than its own directory")
    bounds_s = _epochs(words[table:], n + 1, n_directory)
    _require_covered(start_s, end_s, bounds_s[0], bounds_s[-1])
    pointers = words[table + n + 1 + n_directory : -2]
    whole = bool((pointers == np.round(pointers)).all() and (np.diff(pointers) > 0).all())
    _require(
        whole and pointers[0] == 1 and pointers[-1] == table + 1, "points to parts that are not where it says"
    )
    for k, (first, after) in enumerate(itertools.pairwise(pointers.astype(int).tolist())):
        _unequal_steps(words[first - 1 : after - 1], float(bounds_s[k]), float(bounds_s[k + 1]))


def _difference_arrays(words: _Words, start_s: float, end_s: float, extended: bool) -> None:
    """Types 1 and 21: modified difference arrays, each with the orders to which it is summed."""
    *size, count = _tail(words, 2 if extended else 1)
    terms = _count(size[0], 1, _MAX_MDA_TERMS, "the number of differences") if extended else 15
    record = 4 * terms + 11
    n = _count(count, 1, len(words), "the number of records")
    _require_length(words, n * (record + 1) + n // _DIRECTORY_STEP + len(size) + 1)
    epochs = _epochs(words[n * record :], n, n // _DIRECTORY_STEP, strictly=False)
    _require(end_s <= epochs[-1], "claims to reach beyond its last record")
    records = words[: n * record].reshape(n, record)
    highest, orders = records[:, -4:-3], records[:, -4:]
    least, most = np.array([2, 0, 0, 0]), terms + np.array([1, 0, 0, 0])
    sound = (orders == np.round(orders)) & (orders >= least) & (orders <= most)
    _require(bool(sound.all()), "has an order of integration that does not fit its differences")
    used = np.arange(terms) < highest - 2
    _require(not (used & (records[:, 1 : 1 + terms] == 0)).any(), "has a step of no length")


def _generic(words: _Words, start_s: float, end_s: float) -> None:
    """Type 14: Chebyshev series in SPICE's generic segment of constants, packets and the epochs they start at."""
    room = len(words) - _GENERIC_META_WORDS
    *meta, n_meta = _tail(words, _GENERIC_META_WORDS)
    entries = [_count(word, 0, room, "an entry of its directory") for word in meta]
    _require(n_meta == _GENERIC_META_WORDS, f"has {n_meta:g} as the length of its directory")
    constants, n_constants, directory, n_directory, _, epochs, n_epochs = entries[:7]
    packets, n_packets, _, _, size, offset = entries[10:]
    _require(
        n_constants >= 1 and n_packets >= 1 and n_epochs == n_packets, "lacks constants, series or epochs"
    )
    parts = ((constants, n_constants), (packets, n_packets * (size + offset)), (epochs, n_epochs))
    ends = [base + n for base, n in parts]
    _require(
        ends[0] <= packets and ends[1] <= epochs and ends[2] == directory and directory + n_directory <= room,
        "points to parts that are not where it says",
    )
    _require(
        n_directory == (n_epochs - 1) // _DIRECTORY_STEP, "has a directory of epochs that are not its own"
    )
    starts_s = _epochs(words[epochs:], n_epochs, n_directory)
    _require(starts_s[0] <= start_s, "claims to begin before its first series")
    n_coefficients = _count(float(words[constants]), 1, 32, "the number of coefficients")
    _require(size == 2 + 6 * n_coefficients, f"has series of {size} words for {n_coefficients} coefficients")


_CHECKS: dict[int, Callable[[_Words, float, float], None]] = {
    1: partial(_difference_arrays, extended=False),
    2: partial(_chebyshev, fixed=2, rows=3),
    3: partial(_chebyshev, fixed=2, rows=6),
    5: _two_body,
    8: partial(_equal_steps, hermite=False),
    9: partial(_unequal_steps, hermite=False),
    12: partial(_equal_steps, hermite=True),
    13: partial(_unequal_steps, hermite=True),
    14: _generic,
    15: lambda words, *_: _require_length(words, 16),  # one set of orbital elements, as 17
    17: lambda words, *_: _require_length(words, 12),
    18: _unequal_steps,
    19: _esoc_piecewise,
    20: partial(_chebyshev, fixed=0, rows=3),
    21: partial(_difference_arrays, extended=True),
}
