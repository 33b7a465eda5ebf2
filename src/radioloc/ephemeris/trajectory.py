"""Where a spacecraft is: a trajectory from an SPK of any type, put beside the Earth and the Moon of an ephemeris.

SPICE's readers are called on the file's own handle, segment by segment. Nothing is loaded into SPICE's pool of
kernels, so what a program has loaded there neither matters here nor changes.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from radioloc.boundary import bare_arguments
from radioloc.constants import J2000_JD, SECONDS_PER_DAY
from radioloc.ephemeris.orientation import LUNAR_AXES, LunarAxes
from radioloc.ephemeris.positions import Ephemeris
from radioloc.errors import CoverageError, InputError, KernelError
from radioloc.kernels import KernelFile, find_kernel, sha256_of
from radioloc.kernels.daf import DafSegment, read_segments, require_sound, tdb_date
from radioloc.time import Epochs

_M_PER_KM = 1000.0
_MAX_SPANS = 3
_ICRF = "J2000"  # SPICE's name
_INERTIAL_CLASS = 1


@runtime_checkable
class AnyTrajectory(Protocol):
    """Where a spacecraft is, as a file has it or as it was integrated."""

    @property
    def name(self) -> str:
        """What it is called in messages."""
        ...

    def geocentric(
        self, ephemeris: Ephemeris, tdb: Epochs
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As :meth:`Trajectory.geocentric`."""
        ...

    def spans_s(self) -> list[tuple[float, float]]:
        """As :meth:`Trajectory.spans_s`."""
        ...


@runtime_checkable
class AdjustableTrajectory(AnyTrajectory, Protocol):
    """A trajectory that follows from parameters, such as the state at an epoch and the forces."""

    def position_partials(self, tdb: Epochs) -> NDArray[np.float64]:
        """Partial derivatives of the position, ICRF axes, by the parameters, shape (n, 3, p)."""
        ...

    def over(self, first: Epochs, last: Epochs) -> AdjustableTrajectory:
        """The same from one epoch to another, TDB, of which more is not wanted."""
        ...

    def corrected(self, x: NDArray[np.float64]) -> AdjustableTrajectory:
        """The trajectory of parameters that are larger by x, shape (p,)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class TrajectorySegment:
    """Where an SPK has the states of a body for some time."""

    center: int  # NAIF code of what the states are relative to
    start_s: float  # TDB seconds since J2000, both ends included
    end_s: float
    descriptor: NDArray[np.float64]  # SPICE's packed summary, shape (5,)
    rot_to_icrf: NDArray[np.float64]  # from the segment's inertial frame, shape (3, 3)
    axes: LunarAxes | None = None  # fixed to the Moon, in the place of an inertial frame


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """The trajectory of a body, as an SPK of any type has it; make one with :meth:`Trajectory.open`."""

    kernel: KernelFile  # its span is from the body's first epoch to its last, gaps or not
    body: int  # NAIF code
    segments: tuple[TrajectorySegment, ...]  # in the file's order

    @classmethod
    def open(cls, path: str | Path, body: int) -> Trajectory:
        """Open a trajectory.

        Parameters
        ----------
        path : path-like
            An SPK of any type that SPICE evaluates by itself, in an inertial frame or in axes of the Moon that have a
            NAIF code (:data:`~radioloc.ephemeris.orientation.LUNAR_AXES`), relative to the Earth, the Moon, the Sun or
            a barycentre.
        body : int
            NAIF code of the body, such as -85.

        Raises
        ------
        KernelError
            The file is missing, damaged or no SPK, does not hold the body, or gives it in another frame.
        InputError
            The code is not an integer.
        """
        if isinstance(body, bool) or not isinstance(body, int):
            raise InputError(f"body must be a NAIF code, an integer such as -85, not {body!r}")
        found = find_kernel(path, "SPK")
        listed = read_segments(found, "SPK")
        held = sorted({segment.integers[0] for segment in listed})
        if body not in held:
            raise KernelError(
                f"{found} has no body with the NAIF code {body}; it holds {', '.join(map(str, held)) or 'none'}"
            )
        own = [segment for segment in listed if segment.integers[0] == body]
        for segment in own:
            require_sound(found, segment, segment.integers[3])
        with _spice_errors(found):
            segments = [_trajectory_segment(found, segment) for segment in own]
        first, last = min(s.start_s for s in segments), max(s.end_s for s in segments)
        file = KernelFile(found, "SPK", sha256_of(found), False, tdb_date(first), tdb_date(last))
        return cls(file, body, tuple(segments))

    @property
    def name(self) -> str:
        """Body and file, such as ``body -85 of orbiter.bsp``."""
        return f"body {self.body} of {self.kernel.path.name}"

    def __str__(self) -> str:
        axes = dict.fromkeys(f" in {segment.axes.frame}" for segment in self.segments if segment.axes)
        return f"{self.name}{' and'.join(axes)}, {self.kernel.start_tdb} to {self.kernel.end_tdb} TDB"

    @bare_arguments
    def geocentric(
        self, ephemeris: Ephemeris, tdb: Epochs
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Geocentric position and velocity, geometric (no light time), in barycentric coordinates, ICRF axes.

        SPICE takes an epoch as one float of seconds since J2000, which resolves 0.12 microseconds: 0.1 mm at 2 km/s.
        The rest of the epoch is made up for with the velocity, to far below a micrometre.

        Raises
        ------
        CoverageError
            An epoch lies outside the trajectory or in a gap of it, or outside the ephemeris, or the Moon's orientation.
        KernelError
            SPICE cannot evaluate the file, or the ephemeris does not hold the centre.
        """
        tdb.require("TDB")
        midnight_s = (tdb.jd - J2000_JD) * SECONDS_PER_DAY
        of_day_s = tdb.fraction * SECONDS_PER_DAY
        et_s = midnight_s + of_day_s
        rest_s = (midnight_s - et_s) + of_day_s
        which = self.segment_at(et_s)
        if (which < 0).any():
            raise self._not_covered(et_s[which < 0])
        states = self.states(et_s, which) * _M_PER_KM
        position_m, velocity_m_s = states[:, :3] + states[:, 3:] * rest_s[:, None], states[:, 3:]
        for center in sorted({segment.center for segment in self.segments}):
            rows = np.flatnonzero([self.segments[k].center == center for k in which])
            if len(rows):
                center_m, center_m_s = ephemeris.geocentric_center(center, tdb[rows])
                position_m[rows] += center_m
                velocity_m_s[rows] += center_m_s
        return position_m, velocity_m_s

    def spans_s(self) -> list[tuple[float, float]]:
        """What the segments cover together, TDB seconds since J2000, in the order of time."""
        spans: list[tuple[float, float]] = []
        for start_s, end_s in sorted((s.start_s, s.end_s) for s in self.segments):
            if spans and start_s <= spans[-1][1]:
                spans[-1] = (spans[-1][0], max(spans[-1][1], end_s))
            else:
                spans.append((start_s, end_s))
        return spans

    def _not_covered(self, outside_s: NDArray[np.float64]) -> CoverageError:
        spans = [f"{tdb_date(start_s)} to {tdb_date(end_s)}" for start_s, end_s in self.spans_s()]
        gaps = ""
        if len(spans) > 1:
            more = f" and {len(spans) - _MAX_SPANS} more" if len(spans) > _MAX_SPANS else ""
            gaps = f" with gaps ({', '.join(spans[:_MAX_SPANS])}{more})"
        return CoverageError(
            f"{self.kernel.path} (NAIF code {self.body})",
            (self.kernel.start_tdb, f"{self.kernel.end_tdb} TDB{gaps}"),
            (f"{tdb_date(outside_s.min())} TDB", f"{tdb_date(outside_s.max())} TDB"),
            "use a trajectory that covers these epochs, or leave them out (start, stop, hours)",
        )

    def segment_at(self, et_s: NDArray[np.float64]) -> NDArray[np.intp]:
        """Index of the segment for each epoch: of several the last, as in SPICE; -1 where there is none."""
        which = np.full(len(et_s), -1)
        for k, segment in enumerate(self.segments):
            which[(segment.start_s <= et_s) & (et_s <= segment.end_s)] = k
        return which

    def states(self, et_s: NDArray[np.float64], which: NDArray[np.intp]) -> NDArray[np.float64]:
        """States relative to the segments' centres in the ICRF, km and km/s, shape (n, 6)."""
        import spiceypy

        out = np.empty((len(et_s), 6))
        with _spice_errors(self.kernel.path), ExitStack() as stack:
            handle = spiceypy.dafopr(str(self.kernel.path))
            stack.callback(spiceypy.dafcls, handle)
            for i, (et, k) in enumerate(zip(et_s.tolist(), which.tolist(), strict=True)):
                out[i] = spiceypy.spkpvn(handle, self.segments[k].descriptor, et)[1]
        rot = np.array([segment.rot_to_icrf for segment in self.segments])[which]
        halves = np.einsum("nij,nkj->nki", rot, out.reshape(-1, 2, 3)).reshape(-1, 6)
        if not np.isfinite(halves).all():
            raise KernelError(f"{self.kernel.path} is damaged: a state is not a number; fetch the file again")
        for k in np.unique(which):
            if (axes := self.segments[k].axes) is not None:
                halves[which == k] = axes.states_to_icrf(halves[which == k], et_s[which == k])
        return np.asarray(halves)


def _trajectory_segment(path: Path, segment: DafSegment) -> TrajectorySegment:
    import spiceypy

    body, center, frame, _ = segment.integers
    packed = spiceypy.dafps(2, 6, [segment.start_s, segment.end_s], [*segment.integers, *segment.addresses])
    # Six integers are packed in three floats; spiceypy leaves room for more.
    found = partial(TrajectorySegment, center, segment.start_s, segment.end_s, np.asarray(packed)[:5])
    if frame in LUNAR_AXES:
        return found(np.eye(3), LUNAR_AXES[frame])
    try:
        inertial = spiceypy.frinfo(frame)[1] == _INERTIAL_CLASS
        name = spiceypy.frmnam(frame)
    except spiceypy.NotFoundError:
        inertial, name = False, ""
    if not inertial:
        raise KernelError(
            f"{path} gives body {body} in the frame {name or 'of NAIF code'} {f'({frame})' if name else frame}, which "
            f"turns or is not known; write the trajectory in an inertial frame such as {_ICRF}, or in axes of the Moon "
            f"({', '.join(dict.fromkeys(axes.name for axes in LUNAR_AXES.values()))})"
        )
    return found(np.asarray(spiceypy.pxform(name, _ICRF, 0.0)))


@contextmanager
def _spice_errors(path: Path) -> Iterator[None]:
    """What SPICE complains of, as one line about the file."""
    from spiceypy.utils.exceptions import SpiceyError

    try:
        yield
    except SpiceyError as error:
        what = " ".join((getattr(error, "long", "") or getattr(error, "short", "") or str(error)).split())
        raise KernelError(f"{path} cannot be evaluated by SPICE: {what}") from error
