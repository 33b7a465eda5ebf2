"""Open an SPK of any type for one body: what is left to SPICE because JPL's ephemerides do not need it.

SPICE's readers are called on the file's own handle, segment by segment. Nothing is loaded into SPICE's pool of
kernels, so what a program has loaded there neither matters here nor changes.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import KernelError
from radioloc.kernels.daf import DafSegment, read_segments, tdb_date
from radioloc.kernels.files import KernelFile
from radioloc.kernels.registry import find_kernel, sha256_of
from radioloc.kernels.segment_checks import segment_damage

_ICRF = "J2000"  # SPICE's name
_INERTIAL_CLASS = 1


@dataclass(frozen=True, slots=True, eq=False)
class TrajectorySegment:
    """Where an SPK has the states of a body for some time.

    Parameters
    ----------
    center : int
        NAIF code of what the states are relative to.
    start_s, end_s : float
        Span, TDB seconds since J2000, both ends included.
    descriptor : ndarray, shape (5,)
        SPICE's packed summary.
    rot_to_icrf : ndarray, shape (3, 3)
        Rotation from the segment's inertial frame to the ICRF.
    """

    center: int
    start_s: float
    end_s: float
    descriptor: NDArray[np.float64]
    rot_to_icrf: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryFile:
    """An SPK with the segments of one body, in the file's order.

    Parameters
    ----------
    file : KernelFile
        Which file it is; its span reaches from the body's first epoch to its last, gaps or not.
    body : int
        NAIF code.
    segments : tuple of TrajectorySegment
    """

    file: KernelFile
    body: int
    segments: tuple[TrajectorySegment, ...]

    def spans_s(self) -> list[tuple[float, float]]:
        """What the segments cover together, TDB seconds since J2000, in the order of time."""
        spans: list[tuple[float, float]] = []
        for start_s, end_s in sorted((s.start_s, s.end_s) for s in self.segments):
            if spans and start_s <= spans[-1][1]:
                spans[-1] = (spans[-1][0], max(spans[-1][1], end_s))
            else:
                spans.append((start_s, end_s))
        return spans

    def segment_at(self, et_s: NDArray[np.float64]) -> NDArray[np.intp]:
        """Index of the segment for each epoch: of several the last, as in SPICE; -1 where there is none."""
        which = np.full(len(et_s), -1)
        for k, segment in enumerate(self.segments):
            which[(segment.start_s <= et_s) & (et_s <= segment.end_s)] = k
        return which

    def states(self, et_s: NDArray[np.float64], which: NDArray[np.intp]) -> NDArray[np.float64]:
        """States relative to the segments' centres in the ICRF, km and km/s, shape (n, 6).

        Parameters
        ----------
        et_s : ndarray, shape (n,)
            TDB seconds since J2000.
        which : ndarray of int, shape (n,)
            Segment of each, from :meth:`segment_at`.

        Raises
        ------
        KernelError
            The file is gone, or SPICE cannot evaluate a segment.
        """
        import spiceypy

        out = np.empty((len(et_s), 6))
        with _spice_errors(self.file.path), _handle(self.file.path) as handle:
            for i, (et, k) in enumerate(zip(et_s.tolist(), which.tolist(), strict=True)):
                out[i] = spiceypy.spkpvn(handle, self.segments[k].descriptor, et)[1]
        rot = np.array([segment.rot_to_icrf for segment in self.segments])[which]
        halves = np.einsum("nij,nkj->nki", rot, out.reshape(-1, 2, 3)).reshape(-1, 6)
        if not np.isfinite(halves).all():
            raise KernelError(f"{self.file.path} is damaged: a state is not a number; fetch the file again")
        return np.asarray(halves)


def open_trajectory_file(path: str | Path, body: int) -> TrajectoryFile:
    """Open an SPK of any type that SPICE reads.

    Parameters
    ----------
    path : path-like
        The file, or ``"DE421"``.
    body : int
        NAIF code, such as -85.

    Raises
    ------
    KernelError
        The file is missing, damaged or no SPK, does not hold the body, or gives it in a frame that turns.
    """
    found = find_kernel(path, "SPK")
    listed = read_segments(found, "SPK")
    held = sorted({segment.integers[0] for segment in listed})
    if body not in held:
        raise KernelError(
            f"{found} has no body with the NAIF code {body}; it holds {', '.join(map(str, held)) or 'none'}"
        )
    own = [segment for segment in listed if segment.integers[0] == body]
    for segment in own:
        _, _, _, spk_type = segment.integers
        damage = segment_damage(spk_type, segment.words, segment.start_s, segment.end_s)
        if damage:
            raise KernelError(
                f"{found} is damaged: segment {body} ({segment.name}) {damage}; fetch the file again"
            )
    with _spice_errors(found):
        segments = [_trajectory_segment(found, segment) for segment in own]
    first, last = min(s.start_s for s in segments), max(s.end_s for s in segments)
    file = KernelFile(found, "SPK", sha256_of(found), False, tdb_date(first), tdb_date(last))
    return TrajectoryFile(file, body, tuple(segments))


def _trajectory_segment(path: Path, segment: DafSegment) -> TrajectorySegment:
    import spiceypy

    body, center, frame, _ = segment.integers
    packed = spiceypy.dafps(2, 6, [segment.start_s, segment.end_s], [*segment.integers, *segment.addresses])
    # Six integers are packed in three floats; spiceypy leaves room for more.
    descriptor = np.asarray(packed)[:5]
    rot = _rotation(path, body, frame)
    return TrajectorySegment(center, segment.start_s, segment.end_s, descriptor, rot)


def _rotation(path: Path, body: int, frame: int) -> NDArray[np.float64]:
    """From a segment's frame to the ICRF."""
    import spiceypy

    try:
        inertial = spiceypy.frinfo(frame)[1] == _INERTIAL_CLASS
        name = spiceypy.frmnam(frame)
    except spiceypy.NotFoundError:
        inertial, name = False, ""
    if not inertial:
        raise KernelError(
            f"{path} gives body {body} in the frame {name or 'of NAIF code'} {f'({frame})' if name else frame}, which "
            f"turns or is not known; write the trajectory in an inertial frame such as {_ICRF}"
        )
    return np.asarray(spiceypy.pxform(name, _ICRF, 0.0))


@contextmanager
def _handle(path: Path) -> Iterator[int]:
    import spiceypy

    handle = spiceypy.dafopr(str(path))
    try:
        yield handle
    finally:
        spiceypy.dafcls(handle)


@contextmanager
def _spice_errors(path: Path) -> Iterator[None]:
    """What SPICE complains of, as one line about the file."""
    from spiceypy.utils.exceptions import SpiceyError

    try:
        yield
    except SpiceyError as error:
        what = " ".join((getattr(error, "long", "") or getattr(error, "short", "") or str(error)).split())
        raise KernelError(f"{path} cannot be evaluated by SPICE: {what}") from error
