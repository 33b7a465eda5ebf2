"""Trajectories of spacecraft from an SPK, relative to the Earth and the Moon of an ephemeris.

The file is read without SPICE, and kernels that are loaded there have no effect; only the rotations of inertial frames
other than the ICRF come from SPICE.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from radioloc.constants import J2000_JD, SECONDS_PER_DAY
from radioloc.ephemeris.orientation import LUNAR_AXES, LunarAxes
from radioloc.ephemeris.positions import Ephemeris
from radioloc.errors import CoverageError, InputError, KernelError
from radioloc.kernels import KernelFile, find_kernel
from radioloc.kernels.daf import DafSegment, merge_spans, read_segments, span_dates, tdb_date
from radioloc.kernels.files import sha256_of
from radioloc.kernels.spk_types import StateSeries, read_states
from radioloc.quantities import EpochsLike, accepts_quantities
from radioloc.time import Epochs
from radioloc.vectors import Floats, Indices

_M_PER_KM = 1000.0
_ICRF, _ICRF_CODE = "J2000", 1  # SPICE's name and code of the ICRF
_INERTIAL_CLASS = 1  # of frames in SPICE
_EPHEMERIS_CENTERS = {0, 3, 10, 301, 399}  # NAIF codes of the centres that every ephemeris has
_MAX_NATURAL_CODE = 999  # NAIF codes of the Sun, barycentres, planets and moons are 0 to 999
_UNLIMITED_SPAN_S = (-np.inf, np.inf)
_MAX_CHAIN_LENGTH = 10  # bodies from a spacecraft to the centre of an ephemeris; real files have two or three


@runtime_checkable
class SpacecraftTrajectory(Protocol):
    """Trajectory of a spacecraft, read from a file or integrated."""

    @property
    def name(self) -> str:
        """Name used in messages."""
        ...

    def geocentric(self, ephemeris: Ephemeris, tdb: Epochs) -> tuple[Floats, Floats]:
        """Return geocentric positions and velocities; see :meth:`Trajectory.geocentric`."""
        ...

    def spans_s(self) -> list[tuple[float, float]]:
        """Return the covered spans; see :meth:`Trajectory.spans_s`."""
        ...


@runtime_checkable
class AdjustableTrajectory(SpacecraftTrajectory, Protocol):
    """Trajectory as a function of parameters, such as the state at an epoch and the forces."""

    def position_partials(self, tdb: Epochs) -> Floats:
        """Partial derivatives of the position, ICRF axes, with respect to the parameters, shape (n, 3, p)."""
        ...

    def restricted_to(self, first: Epochs, last: Epochs) -> AdjustableTrajectory:
        """Return the trajectory restricted to an interval of TDB."""
        ...

    def corrected(self, x: Floats) -> AdjustableTrajectory:
        """Return the trajectory with the parameters increased by x, shape (p,)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class TrajectorySegment:
    """States of a body in a span of an SPK."""

    center: int  # NAIF code of the origin of the states
    start_s: float  # TDB seconds since J2000, both ends included
    end_s: float
    series: StateSeries
    rot_to_icrf: Floats  # from the segment's inertial frame, shape (3, 3)
    axes: LunarAxes | None = (
        None  # axes of the states if they are fixed to the Moon; None for an inertial frame
    )


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Trajectory of a body from an SPK, opened by :meth:`Trajectory.open`."""

    kernel: KernelFile  #: its span is from the body's first epoch to its last, including gaps
    body: int  #: NAIF code
    segments: tuple[TrajectorySegment, ...]  #: in the file's order
    center_trajectories: Mapping[int, Trajectory]  #: of centres that the same file gives, by NAIF code
    covered_s: tuple[tuple[float, float], ...]  #: disjoint spans, TDB seconds since J2000, in order

    @classmethod
    def open(cls, path: str | Path, body: int) -> Trajectory:
        """Open a trajectory.

        Parameters
        ----------
        path : path-like
            An SPK with segments of the types 1, 2, 3, 8, 9, 12, 13 or 21, in an inertial frame or in axes of the Moon
            that have a NAIF code (:data:`~radioloc.ephemeris.orientation.LUNAR_AXES`), relative to the Earth, the Moon,
            the Sun, a barycentre, or another body of the same file.
        body : int
            NAIF code of the body, such as -85.

        Raises
        ------
        KernelError
            The file is missing, damaged or of another kind; lacks the body or its centre; or has a frame or a
            type of segment that is not listed above.
        InputError
            The code is not an integer.
        """
        if isinstance(body, bool) or not isinstance(body, int | np.integer):
            raise InputError(f"body: expected a NAIF code, an integer such as -85, got {body!r}")
        kernel_path = find_kernel(path, "SPK")
        segments_by_body: dict[int, list[DafSegment]] = {}
        for segment in read_segments(kernel_path, "SPK"):
            segments_by_body.setdefault(segment.integers[0], []).append(segment)
        if body not in segments_by_body:
            bodies = ", ".join(map(str, sorted(segments_by_body))) or "none"
            raise KernelError(f"{kernel_path} has no body with the NAIF code {body}; it holds {bodies}")
        return _trajectory(kernel_path, sha256_of(kernel_path), segments_by_body, (body,), {})

    @property
    def name(self) -> str:
        """Body and file, such as ``body -85 of orbiter.bsp``."""
        return f"body {self.body} of {self.kernel.path.name}"

    def __str__(self) -> str:
        axes = dict.fromkeys(f" in {segment.axes.frame}" for segment in self.segments if segment.axes)
        return f"{self.name}{' and'.join(axes)}, {self.kernel.start_tdb} to {self.kernel.end_tdb} TDB"

    @accepts_quantities
    def geocentric(self, ephemeris: Ephemeris, tdb: EpochsLike) -> tuple[Floats, Floats]:
        """Return positions and velocities relative to the Earth's centre, ICRF axes, m and m/s, (n, 3) each.

        They are geometric (no light time), in the coordinates of the barycentric system (BCRS) compatible with TDB.

        Raises
        ------
        CoverageError
            An epoch lies outside the trajectory, in a gap of it, outside the ephemeris, or outside the Moon's
            orientation.
        KernelError
            A state is not a number, or the ephemeris lacks the centre.
        """
        tdb.require("TDB")
        midnight_s = (tdb.jd - J2000_JD) * SECONDS_PER_DAY
        seconds_of_day = tdb.fraction * SECONDS_PER_DAY
        et_s = midnight_s + seconds_of_day
        # Segments take an epoch as one float, rounded to 0.06 microseconds: 0.1 mm at 2 km/s.
        rounding_s = (midnight_s - et_s) + seconds_of_day
        indices = self.segment_indices(et_s)
        if (indices < 0).any():
            raise self._coverage_error(et_s[indices < 0])
        states = self.states(et_s, indices) * _M_PER_KM
        position_m, velocity_m_s = states[:, :3] + states[:, 3:] * rounding_s[:, None], states[:, 3:]
        centers = np.array([segment.center for segment in self.segments])[indices]
        for center in np.unique(centers).tolist():
            rows = np.flatnonzero(centers == center)
            center_m, center_m_s = self._center_states(center, ephemeris, tdb[rows])
            position_m[rows] += center_m
            velocity_m_s[rows] += center_m_s
        return position_m, velocity_m_s

    def _center_states(self, code: int, ephemeris: Ephemeris, tdb: Epochs) -> tuple[Floats, Floats]:
        """Return geocentric positions and velocities of a centre of segments."""
        if code in self.center_trajectories:
            return self.center_trajectories[code].geocentric(ephemeris, tdb)
        try:
            return ephemeris.geocentric_center(code, tdb)
        except KernelError as error:
            raise KernelError(
                f"{self.kernel.path} gives body {self.body} relative to body {code}, which is not in that file: {error}"
            ) from error

    def spans_s(self) -> list[tuple[float, float]]:
        """Return the disjoint spans that the segments cover, TDB seconds since J2000, in the order of time."""
        return list(self.covered_s)

    def _coverage_error(self, outside_s: Floats) -> CoverageError:
        return CoverageError(
            f"{self.kernel.path} (NAIF code {self.body})",
            span_dates(self.covered_s),
            (f"{tdb_date(outside_s.min())} TDB", f"{tdb_date(outside_s.max())} TDB"),
            "use a trajectory that covers these epochs, or exclude them (start, stop, hours)",
        )

    def segment_indices(self, et_s: Floats) -> Indices:
        """Return the index of the last segment that covers each epoch, as in SPICE; -1 for uncovered epochs."""
        indices = np.full(len(et_s), -1)
        for k, segment in enumerate(self.segments):
            indices[(segment.start_s <= et_s) & (et_s <= segment.end_s)] = k
        return indices

    def states(self, et_s: Floats, indices: Indices) -> Floats:
        """Return states relative to the segments' centres in the ICRF, km and km/s, shape (n, 6)."""
        states = np.empty((len(et_s), 6))
        for k in np.unique(indices).tolist():
            segment, rows = self.segments[k], np.flatnonzero(indices == k)
            with np.errstate(all="ignore"):
                position_and_velocity = (
                    segment.series.states(et_s[rows]).reshape(-1, 2, 3) @ segment.rot_to_icrf.T
                )
            states[rows] = position_and_velocity.reshape(-1, 6)
            if segment.axes is not None:
                states[rows] = segment.axes.states_to_icrf(states[rows], et_s[rows])
        if not np.isfinite(states).all():
            raise KernelError(f"{self.kernel.path} is damaged: a state is not a number; fetch the file again")
        return states


def _trajectory(
    path: Path,
    sha256: str,
    segments_by_body: Mapping[int, list[DafSegment]],
    chain: tuple[int, ...],
    opened: dict[int, Trajectory],
) -> Trajectory:
    """Return the trajectory of the last body of a chain, with those of the centres of its segments."""
    body = chain[-1]
    if body in chain[:-1] or len(chain) > _MAX_CHAIN_LENGTH:
        excess = "a cycle" if body in chain[:-1] else f"a chain of more than {_MAX_CHAIN_LENGTH} bodies"
        raise KernelError(
            f"{path} gives body {chain[0]} relative to others in {excess} ({', '.join(map(str, chain))}); write the "
            "trajectory relative to the Moon, the Earth, the Sun or a barycentre"
        )
    if body in opened:
        return opened[body]
    segments = tuple(map(_trajectory_segment, segments_by_body[body]))
    center_trajectories = {}
    for center in sorted({segment.center for segment in segments} - _EPHEMERIS_CENTERS):
        if center in segments_by_body:
            center_trajectories[center] = _trajectory(
                path, sha256, segments_by_body, (*chain, center), opened
            )
        elif not 0 <= center <= _MAX_NATURAL_CODE:
            raise KernelError(
                f"{path} gives body {body} relative to body {center}, which is not in that file (it holds "
                f"{', '.join(map(str, sorted(segments_by_body)))}); add the SPK of {center} to the file, for example "
                "by NAIF's spkmerge"
            )
    spans_s = merge_spans(
        span_s for segment in segments for span_s in _covered_spans_s(segment, center_trajectories)
    )
    if not spans_s:
        raise KernelError(
            f"{path} gives body {body} relative to {', '.join(map(str, center_trajectories))}, but never for the same "
            "time; give a file with both for the same time"
        )
    dates = {"start_tdb": tdb_date(spans_s[0][0]), "end_tdb": tdb_date(spans_s[-1][1])}
    kernel = KernelFile(path, "SPK", sha256, registered=False, **dates)
    opened[body] = Trajectory(kernel, body, segments, center_trajectories, tuple(spans_s))
    return opened[body]


def _covered_spans_s(
    segment: TrajectorySegment, center_trajectories: Mapping[int, Trajectory]
) -> Iterator[tuple[float, float]]:
    """Yield the parts of a segment's span that its centre's trajectory covers; all of it for other centres."""
    center = center_trajectories.get(segment.center)
    for start_s, end_s in [_UNLIMITED_SPAN_S] if center is None else center.covered_s:
        if start_s <= segment.end_s and segment.start_s <= end_s:
            yield max(segment.start_s, start_s), min(segment.end_s, end_s)


def _trajectory_segment(segment: DafSegment) -> TrajectorySegment:
    body, center, frame, spk_type = segment.integers
    series, axes = read_states(segment, spk_type), LUNAR_AXES.get(frame)
    rotation = np.eye(3) if axes is not None else _rotation_to_icrf(segment.path, body, frame)
    return TrajectorySegment(center, segment.start_s, segment.end_s, series, rotation, axes)


def _rotation_to_icrf(path: Path, body: int, frame: int) -> Floats:
    """Return the rotation from one of SPICE's inertial frames, by its code, to the ICRF."""
    if frame == _ICRF_CODE:
        return np.eye(3)
    import spiceypy

    try:
        is_inertial = spiceypy.frinfo(frame)[1] == _INERTIAL_CLASS
        name = spiceypy.frmnam(frame)
    except spiceypy.NotFoundError:
        is_inertial, name = False, ""
    if not is_inertial:
        raise KernelError(
            f"{path} gives body {body} in the frame {name or 'of NAIF code'} {f'({frame})' if name else frame}, which "
            f"rotates or is unknown; write the trajectory in an inertial frame such as {_ICRF}, or in axes of the Moon "
            f"({', '.join(dict.fromkeys(axes.name for axes in LUNAR_AXES.values()))})"
        )
    return np.asarray(spiceypy.pxform(name, _ICRF, 0.0))
