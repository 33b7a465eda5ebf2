"""Open SPK and binary PCK files of Chebyshev type 2, with every check that a damaged file could fail.

jplephem reads the layout of the file (the DAF); evaluation is left to :mod:`radioloc.ephemeris`, which needs
second derivatives and refuses epochs outside a segment's own span, where jplephem would extrapolate.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jplephem.daf import DAF
from numpy.typing import NDArray

from radioloc.errors import KernelError
from radioloc.kernels.registry import find_kernel, registered, registered_as, sha256_of

_INERTIAL_FRAME = 1  # NAIF's J2000, which the JPL ephemerides use as the name of the ICRF.
_CHEBYSHEV_TYPE = 2
_WORD_BYTES = 8
_Read = TypeVar("_Read")
_KIND_NAMES = {"SPK": "SPK (positions)", "PCK": "binary PCK (orientation)"}


@dataclass(frozen=True, slots=True)
class KernelFile:
    """Which file was opened: what a solution keeps as provenance.

    Parameters
    ----------
    path : Path
        The file.
    kind : {"SPK", "PCK"}
        Positions, or orientation.
    sha256 : str
        SHA-256 of the file's bytes.
    registered : bool
        Whether the file ships with the library (and its SHA-256 was found right).
    start_tdb, end_tdb : str
        Span common to all segments, as dates.
    """

    path: Path
    kind: str
    sha256: str
    registered: bool
    start_tdb: str
    end_tdb: str


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Chebyshev records of three components, in the file's units.

    Parameters
    ----------
    target : int
        NAIF code of the body (SPK) or the frame (PCK).
    center : int
        NAIF code of the origin (SPK) or of the reference frame (PCK).
    name : str
        The segment's name, such as ``DE-0421LE-0421``.
    start_s, end_s : float
        Span for which the segment may be used, TDB seconds since J2000.
    first_record_s, record_length_s : float
        Start of the first record, TDB seconds since J2000, and the length of each.
    coefficients : ndarray, shape (n_records, 3, n_coefficients)
        Chebyshev coefficients of rising degree.
    """

    target: int
    center: int
    name: str
    start_s: float
    end_s: float
    first_record_s: float
    record_length_s: float
    coefficients: NDArray[np.float64] = field(repr=False)

    @property
    def span(self) -> tuple[str, str]:
        """First and last epoch as dates (TDB)."""
        return tdb_date(self.start_s), tdb_date(self.end_s)


@dataclass(frozen=True, slots=True, eq=False)
class Kernel:
    """An opened kernel.

    Parameters
    ----------
    file : KernelFile
        Which file it is.
    segments : tuple of Segment
        All type 2 segments, in the file's order.
    """

    file: KernelFile
    segments: tuple[Segment, ...] = field(repr=False)

    def has(self, target: int, center: int) -> bool:
        """Whether there is a segment of this target and center."""
        return any((s.target, s.center) == (target, center) for s in self.segments)

    def segment(self, target: int, center: int) -> Segment:
        """Find the segment of this target and center: where there are several, the last, as in SPICE.

        Raises
        ------
        KernelError
            There is none.
        """
        for candidate in reversed(self.segments):
            if (candidate.target, candidate.center) == (target, center):
                return candidate
        held = ", ".join(f"{s.target} relative to {s.center}" for s in self.segments)
        raise KernelError(
            f"{self.file.path} (spanning {self.file.start_tdb} to {self.file.end_tdb}) has no segment for "
            f"NAIF code {target} relative to {center}; it holds {held}. Use a kernel that has it"
        )


def open_spk(name_or_path: str | Path) -> Kernel:
    """Open an SPK.

    Parameters
    ----------
    name_or_path : str or path-like
        As :func:`radioloc.kernels.find_kernel`; ``"DE421"`` is the one that ships.

    Raises
    ------
    KernelError
        The file is missing, damaged, of another kind, or has no segment of type 2 in the ICRF; a file that
        carries the name of a kernel that ships has another SHA-256.
    """
    return _open(name_or_path, "SPK")


def open_pck(name_or_path: str | Path) -> Kernel:
    """Open a binary PCK; parameters and errors as :func:`open_spk`."""
    return _open(name_or_path, "PCK")


def tdb_date(seconds: float) -> str:
    """TDB seconds since J2000 as a date, with the time of day to the second where it is not midnight."""
    moment = np.datetime64("2000-01-01T12:00:00", "s") + np.timedelta64(round(seconds), "s")
    text = str(moment)
    return text[:-9] if text.endswith("T00:00:00") else text


def _open(name_or_path: str | Path, kind: str) -> Kernel:
    path = find_kernel(name_or_path, kind)
    sha256 = sha256_of(path)
    entry = registered_as(path)
    if entry is not None and entry.sha256 != sha256:
        raise KernelError(
            f"{path} (spanning {entry.start_tdb} to {entry.end_tdb}) is damaged: its SHA-256 is {sha256}, "
            f"but {entry.name} ships with {entry.sha256}; install the package again, or rename the file if "
            "it is your own"
        )
    segments = with_daf(path, kind, _read_segments)
    if not segments:
        raise KernelError(
            f"{path} has no segment of Chebyshev type 2 in the ICRF; use a JPL planetary ephemeris (SPK) or "
            "a lunar orientation kernel (binary PCK)"
        )
    alike = [k for k in registered() if k.kind == kind and k.size_bytes == path.stat().st_size]
    if entry is None and alike and alike[0].sha256 != sha256:
        # A kernel of another content has another length, but for a copy with a changed byte.
        raise KernelError(
            f"{path} (spanning {alike[0].start_tdb} to {alike[0].end_tdb}, as {alike[0].name}) is damaged: it has that "
            f"file's length but another SHA-256, {sha256}; copy it again"
        )
    start_s, end_s = max(s.start_s for s in segments), min(s.end_s for s in segments)
    description = KernelFile(path, kind, sha256, entry is not None, tdb_date(start_s), tdb_date(end_s))
    return Kernel(description, segments)


def with_daf(path: Path, kind: str, read: Callable[[DAF, Path, str], _Read]) -> _Read:
    """What a function reads from an opened file of the right kind; a damaged one is a :class:`KernelError`."""
    _check_kind(path, kind)
    try:
        with path.open("rb") as file:
            return read(DAF(file), path, kind)
    except KernelError:
        raise
    except (ValueError, TypeError, struct.error, OverflowError, AssertionError, IndexError, OSError) as error:
        raise KernelError(f"{path} is damaged: {error}; fetch or make the file again") from error


def _check_kind(path: Path, kind: str) -> None:
    with path.open("rb") as file:
        identity = file.read(8)
    wanted = f"DAF/{kind}".encode().ljust(8)
    # Before 1999 SPICE wrote NAIF/DAF whatever the kind; those files are SPK here.
    if identity == wanted or (kind == "SPK" and identity == b"NAIF/DAF"):
        return
    names = {f"DAF/{key}".encode().ljust(8): f"a {name}" for key, name in _KIND_NAMES.items()}
    found = names.get(identity, "not a SPICE binary kernel" if identity else "empty")
    raise KernelError(
        f"{path} is {found}, but a {_KIND_NAMES[kind]} kernel is wanted; give a file of that kind"
    )


def _announced_span(daf: DAF) -> str:
    """What the summaries of a file that cannot be read whole say of its span, if they can be read."""
    try:
        spans = [values[:2] for _, values in daf.summaries()]
        return f" (spanning {tdb_date(max(s[0] for s in spans))} to {tdb_date(min(s[1] for s in spans))})"
    except (ValueError, TypeError, struct.error, OverflowError, AssertionError, IndexError, OSError):
        return ""


def segment_summaries(daf: DAF, path: Path, kind: str) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Name and summary of each segment of a file whose list of segments is sound, in the file's order."""
    integers = {"SPK": 6, "PCK": 5}[kind]
    if (daf.nd, daf.ni) != (2, integers):
        raise KernelError(f"{path} is damaged: its summaries have the wrong layout; fetch the file again")
    held_bytes = path.stat().st_size
    if (daf.free - 1) * _WORD_BYTES > held_bytes:
        raise KernelError(
            f"{path}{_announced_span(daf)} is cut short: it has {held_bytes} bytes of the "
            f"{(daf.free - 1) * _WORD_BYTES} that its header announces; fetch the file again"
        )
    seen: set[int] = set()
    for number, _, _ in daf.summary_records():
        if number in seen:
            raise KernelError(f"{path} is damaged: its segment list runs in a circle; fetch the file again")
        seen.add(number)
    for name, summary in daf.summaries():
        yield name.decode("latin-1").strip("\0 "), summary


def _read_segments(daf: DAF, path: Path, kind: str) -> tuple[Segment, ...]:
    segments = []
    for text, summary in segment_summaries(daf, path, kind):
        start_s, end_s, target, *others, first_word, last_word = summary
        center, frame, data_type = others if kind == "SPK" else (others[0], others[0], others[1])
        if data_type == _CHEBYSHEV_TYPE and frame == _INERTIAL_FRAME:
            words = (first_word, last_word)
            records = _read_records(daf, path, (start_s, end_s), words, f"{target} ({text})")
            segments.append(Segment(target, center, text, start_s, end_s, *records))
    return tuple(segments)


def _read_records(
    daf: DAF, path: Path, span_s: tuple[float, float], words: tuple[int, int], label: str
) -> tuple[float, float, NDArray[Any]]:
    """First record's start, record length and coefficients of one segment, checked against its directory."""
    first, last = words
    problem = f"{path} is damaged: segment {label} "
    if not 1 <= first < last - 3 or last >= daf.free:
        raise KernelError(problem + "lies outside the file; fetch the file again")
    init_s, length_s, words_per_record, count = daf.read_array(last - 3, last).tolist()
    n_coefficients, remainder = divmod(words_per_record - 2, 3)
    if (
        not (np.isfinite([init_s, length_s, *span_s]).all() and length_s > 0 and n_coefficients >= 1)
        or remainder != 0
        or words_per_record * count != last - 3 - first
    ):
        raise KernelError(problem + "has a directory that does not fit its length; fetch the file again")
    n_records = int(count)
    if not init_s <= span_s[0] < span_s[1] <= init_s + n_records * length_s:
        raise KernelError(
            problem + f"claims {tdb_date(span_s[0])} to {tdb_date(span_s[1])}, but its records span "
            f"{tdb_date(init_s)} to {tdb_date(init_s + n_records * length_s)}; fetch the file again"
        )
    records = daf.map_array(first, last - 4).reshape(n_records, int(words_per_record))
    middles_s = init_s + (np.arange(n_records) + 0.5) * length_s
    rounding_s = 1e-6 * length_s
    in_place = np.abs(records[:, 0] - middles_s) <= rounding_s
    if not (in_place & (np.abs(records[:, 1] - length_s / 2) <= rounding_s)).all():
        raise KernelError(problem + "has a record whose epoch is not where it belongs; fetch the file again")
    coefficients = records[:, 2:].reshape(n_records, 3, int(n_coefficients))
    if not np.isfinite(coefficients).all():
        raise KernelError(problem + "has a coefficient that is not a number; fetch the file again")
    return init_s, length_s, coefficients
