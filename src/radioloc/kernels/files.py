"""Registry of kernels; SPK and binary PCK files of Chebyshev type 2, checked for damage.

The registry lists packaged and added kernels with content, place and SHA-256. :mod:`radioloc.kernels.daf` reads the
list of segments; :mod:`radioloc.ephemeris` evaluates them, with second derivatives and without jplephem's
extrapolation outside the span of a segment.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from radioloc.errors import KernelError
from radioloc.kernels.daf import kind_of, merge_spans, read_segments, tdb_date
from radioloc.kernels.spk_types import ChebyshevRecords, read_states
from radioloc.text_files import write_text
from radioloc.vectors import Floats

REGISTRY_NAME = "registry.toml"
_INERTIAL_FRAME = 1  # NAIF's J2000, which the JPL ephemerides use as the name of the ICRF.
_CHEBYSHEV_TYPE = 2


@dataclass(frozen=True, slots=True)
class RegisteredKernel:
    """Entry of the registry of kernels."""

    name: str  # of the file
    kind: str  # SPK (positions) or PCK (orientation)
    ephemeris: str  # source of the excerpt, such as DE421
    sha256: str
    size_bytes: int
    start_tdb: str  # dates at whose midnight (TDB) the span begins and ends
    end_tdb: str
    bodies: tuple[int, ...]  # NAIF codes of the bodies (SPK) or frames (PCK)
    source_package: str = ""  # package of the full kernel
    source_file: str = ""
    source_sha256: str = ""
    folder: Path = Path()

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self.folder / self.name

    def problem(self) -> str:
        """Describe a missing or changed file and the remedy; empty for an unchanged one."""
        origin, advice = "added", "add it again by radioloc kernels add"
        if self.source_package:
            origin, advice = "shipped", "install radioloc again"
        if not self.path.is_file():
            return f"{self.path} is missing; {advice}"
        if sha256_of(self.path) != self.sha256:
            return f"{self.path} is not the file that was {origin}; {advice}"
        return ""


@cache
def kernel_directory() -> Path:
    """Directory of the kernels that ship: inside the installed package, or ``kernels/`` of a source checkout."""
    packaged = Path(__file__).parent / "data"
    checkout = Path(__file__).parents[3] / "kernels"
    for directory in (packaged, checkout):
        if (directory / REGISTRY_NAME).is_file():
            return directory
    raise KernelError(
        f"the kernels that ship with radioloc are not at {packaged} (installed) or {checkout} (source "
        "checkout); install the package again"
    )


@cache
def registered() -> tuple[RegisteredKernel, ...]:
    """Kernels that ship, in the registry's order."""
    return _entries(kernel_directory())


def user_directory() -> Path:
    """Return the directory of added kernels, ``RADIOLOC_KERNELS`` or ``~/.radioloc/kernels``."""
    try:
        return Path(os.environ.get("RADIOLOC_KERNELS") or Path.home() / ".radioloc" / "kernels")
    except RuntimeError as error:
        raise KernelError(
            "the user has no home directory to keep kernels in; set the environment variable RADIOLOC_KERNELS to a "
            "directory"
        ) from error


def added() -> tuple[RegisteredKernel, ...]:
    """Kernels that were added by :func:`add_kernel`, in their order."""
    try:
        folder = user_directory()
    except KernelError:  # without a home directory nothing was added
        return ()
    # Unlike Path.is_file, this takes a directory that the user may not read as empty.
    return _entries(folder) if os.path.isfile(folder / REGISTRY_NAME) else ()  # noqa: PTH113


def _entries(folder: Path) -> tuple[RegisteredKernel, ...]:
    path = folder / REGISTRY_NAME
    try:
        entries = tomllib.loads(path.read_text(encoding="utf-8"))["kernel"]
        return tuple(
            RegisteredKernel(**entry | {"bodies": tuple(entry["bodies"]), "folder": folder})
            for entry in entries
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise KernelError(f"{path} is damaged ({error}); remove it and add its kernels again") from error


def find_kernel(name_or_path: str | Path, kind: str | None = None) -> Path:
    """Return the path of a file, or of a packaged or added kernel by its name or its ephemeris (``"DE421"``).

    An ephemeris with a `kind` names one file. Packaged kernels have priority over added ones.

    Examples
    --------
    >>> from radioloc.kernels import find_kernel
    >>> find_kernel("DE421", "PCK").name
    'moon_pa_de421_1969_2050.bpc'
    """
    path = Path(name_or_path)
    if path.is_file():
        return path
    name = str(name_or_path)
    fits: list[RegisteredKernel] = []
    for entries in (registered(), added()):
        fits = fits or [
            entry
            for entry in entries
            if name == entry.name or (name.upper() == entry.ephemeris and kind in (None, entry.kind))
        ]
    if len(fits) == 1:
        return fits[0].path
    choices = ", ".join(
        f"{entry.name} ({entry.ephemeris} {entry.kind})" for entry in (*registered(), *added())
    )
    if path.is_dir():
        raise KernelError(f"{name} is a directory; give a kernel file in it")
    if fits:
        raise KernelError(f"{name!r} stands for more than one kernel; name the file, one of {choices}")
    raise KernelError(
        f"{name!r} is neither a file nor a kernel that ships or was added; give the path of a kernel file, "
        f"or one of {choices}"
    )


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file, 64 hexadecimal digits."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise KernelError(f"{path} cannot be read: {error.strerror}") from error


@dataclass(frozen=True, slots=True)
class KernelFile:
    """Record of an opened file, the provenance in a solution."""

    path: Path
    kind: str  #: SPK (positions) or PCK (orientation)
    sha256: str
    registered: bool  #: ships with the library, with the right SHA-256
    start_tdb: str  #: span common to all bodies, each of the union of its segments, as dates
    end_tdb: str


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Chebyshev records of three components, in the file's units."""

    target: int  #: NAIF code of the body (SPK) or the frame (PCK)
    center: int  #: NAIF code of the origin (SPK) or of the reference frame (PCK)
    name: str  #: such as DE-0421LE-0421
    start_s: float  #: span for which it may be used, TDB seconds since J2000
    end_s: float
    first_record_s: float  #: its start, TDB seconds since J2000
    record_length_s: float
    coefficients: Floats = field(repr=False)  #: (records, 3, rising degree)


@dataclass(frozen=True, slots=True, eq=False)
class Kernel:
    """An opened kernel and all its type 2 segments, in the file's order."""

    file: KernelFile
    segments: tuple[Segment, ...] = field(repr=False)

    def segments_of(self, target: int, center: int) -> tuple[Segment, ...]:
        """Return the segments of a target and center, at least one; the last one that covers an epoch has priority."""
        segments = tuple(s for s in self.segments if (s.target, s.center) == (target, center))
        if segments:
            return segments
        held = ", ".join(f"{s.target} relative to {s.center}" for s in self.segments)
        raise KernelError(
            f"{self.file.path} (spanning {self.file.start_tdb} to {self.file.end_tdb}) has no segment for "
            f"NAIF code {target} relative to {center}; it holds {held}. Use a kernel that has it"
        )


def add_kernel(path: str | Path) -> RegisteredKernel:
    """Copy a kernel to ``RADIOLOC_KERNELS``, or else ``~/.radioloc/kernels``, and register its name.

    Its SHA-256 is checked whenever it is opened. A damaged kernel, or a registered name, is a
    :class:`KernelError`.
    """
    path = Path(path)
    if not path.is_file():
        raise KernelError(f"{path}: expected a kernel file; check the name and the directory")
    kind = kind_of(path)
    entries = (*registered(), *added())
    if path.name in {entry.name for entry in entries}:
        raise KernelError(f"a kernel of the name {path.name} exists already; rename the file")
    opened = open_kernel(path, kind)
    # SPKs call themselves DE-0440LE-0440, lunar PCKs de421.nio or MOON_PA_DE440.
    labels = (*(segment.name for segment in opened.segments), path.stem)
    matches = (re.search(r"DE-?0*(\d{3})", label, re.IGNORECASE) for label in labels)
    number = next((match[1] for match in matches if match), None)
    folder = user_directory()
    entry = RegisteredKernel(
        path.name,
        kind,
        "" if number is None else f"DE{number}",
        opened.file.sha256,
        path.stat().st_size,
        opened.file.start_tdb,
        opened.file.end_tdb,
        tuple(sorted({segment.target for segment in opened.segments})),
        folder=folder,
    )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, entry.path)
    except OSError as error:
        raise KernelError(f"{entry.path} cannot be written: {error.strerror}") from error
    keys = ("name", "kind", "ephemeris", "sha256", "size_bytes", "start_tdb", "end_tdb", "bodies")
    tables = (
        "\n".join(["[[kernel]]", *(f"{key} = {json.dumps(getattr(kernel, key))}" for key in keys)])
        for kernel in (*added(), entry)
    )
    write_text(folder / REGISTRY_NAME, "\n\n".join(tables) + "\n")
    return entry


def open_kernel(name_or_path: str | Path, kind: str) -> Kernel:
    """Open an SPK or PCK (`kind`) by name or path; a damaged file or another kind is a :class:`KernelError`."""
    path = find_kernel(name_or_path, kind)
    sha256 = sha256_of(path)
    entry = next((kernel for kernel in registered() if kernel.name == path.name), None)
    if entry is not None and entry.sha256 != sha256:
        raise KernelError(
            f"{path} (spanning {entry.start_tdb} to {entry.end_tdb}) is damaged: its SHA-256 is {sha256}, "
            f"but {entry.name} ships with {entry.sha256}; install the package again, or rename the file if "
            "it is your own"
        )
    added_entry = next((kernel for kernel in added() if kernel.path == path), None)
    if added_entry is not None and (problem := added_entry.problem()):
        raise KernelError(problem)
    segments = tuple(_read_segments(path, kind))
    if not segments:
        hint = "; the SPK of a spacecraft or lander is not added but named as [target] trajectory" * (
            kind == "SPK"
        )
        raise KernelError(
            f"{path} has no segment of Chebyshev type 2 in the ICRF; use a JPL planetary ephemeris (SPK) or "
            f"a lunar orientation kernel (binary PCK){hint}"
        )
    pairs = {(s.target, s.center) for s in segments}
    spans_s = [
        merge_spans((s.start_s, s.end_s) for s in segments if (s.target, s.center) == p) for p in pairs
    ]
    start_s, end_s = max(span[0][0] for span in spans_s), min(span[-1][1] for span in spans_s)
    description = KernelFile(path, kind, sha256, entry is not None, tdb_date(start_s), tdb_date(end_s))
    return Kernel(description, segments)


def _read_segments(path: Path, kind: str) -> Iterator[Segment]:
    """Segments of Chebyshev type 2 in the ICRF, each checked against its directory."""
    read: set[tuple[int, int]] = set()
    passed_over: dict[tuple[int, int], str] = {}
    for segment in read_segments(path, kind):
        target, *integers = segment.integers
        center, frame, data_type = integers if kind == "SPK" else (integers[0], integers[0], integers[1])
        if data_type != _CHEBYSHEV_TYPE or frame != _INERTIAL_FRAME:
            # A PCK's center is its frame.
            passed_over[target, center if kind == "SPK" else _INERTIAL_FRAME] = (
                f"of type {data_type} in the frame {frame}"
            )
            continue
        read.add((target, center))
        records = read_states(segment, _CHEBYSHEV_TYPE)
        assert isinstance(records, ChebyshevRecords)
        series = records.first_s, records.length_s, records.coefficients
        yield Segment(target, center, segment.name, segment.start_s, segment.end_s, *series)
    for pair in read & set(passed_over):
        raise KernelError(
            f"{path} gives NAIF code {pair[0]} relative to {pair[1]} in segments of type {_CHEBYSHEV_TYPE} and in one "
            f"{passed_over[pair]}; expected type {_CHEBYSHEV_TYPE} in the ICRF alone. Use a kernel without the other"
        )
