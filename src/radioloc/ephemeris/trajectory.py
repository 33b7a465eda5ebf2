"""Where a spacecraft is: a trajectory from an SPK, put beside the Earth and the Moon of an ephemeris."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import J2000_JD, SECONDS_PER_DAY
from radioloc.ephemeris.positions import Ephemeris
from radioloc.errors import CoverageError, InputError
from radioloc.kernels import KernelFile, TrajectoryFile, open_trajectory_file
from radioloc.kernels.daf import tdb_date
from radioloc.time import Epochs

_M_PER_KM = 1000.0
_MAX_SPANS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """The trajectory of a body, as an SPK of any type has it; make one with :meth:`open`.

    Parameters
    ----------
    source : TrajectoryFile
        The file and the body's segments in it.
    """

    source: TrajectoryFile

    @classmethod
    def open(cls, path: str | Path, body: int) -> Trajectory:
        """Open a trajectory.

        Parameters
        ----------
        path : path-like
            An SPK of any type that SPICE reads, in an inertial frame, relative to the Earth, the Moon, the Sun or a
            barycentre.
        body : int
            NAIF code of the body, such as -85.

        Raises
        ------
        KernelError
            The file is missing, damaged or no SPK, does not hold the body, or gives it in a frame that turns.
        InputError
            The code is not an integer.
        """
        if isinstance(body, bool) or not isinstance(body, int):
            raise InputError(f"body must be a NAIF code, an integer such as -85, not {body!r}")
        return cls(open_trajectory_file(path, body))

    @property
    def body(self) -> int:
        """NAIF code."""
        return self.source.body

    @property
    def kernel(self) -> KernelFile:
        """Path, SHA-256 and span of the file."""
        return self.source.file

    @property
    def name(self) -> str:
        """Body and file, such as ``body -85 of orbiter.bsp``."""
        return f"body {self.body} of {self.kernel.path.name}"

    def __str__(self) -> str:
        return f"{self.name}, {self.kernel.start_tdb} to {self.kernel.end_tdb} TDB"

    def geocentric(
        self, ephemeris: Ephemeris, tdb: Epochs
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Geocentric position and velocity, geometric (no light time), in barycentric coordinates.

        Parameters
        ----------
        ephemeris : Ephemeris
            Where the centre is that the trajectory is relative to.
        tdb : Epochs
            Epochs in TDB, n of them.

        Returns
        -------
        position_m, velocity_m_s : ndarray, shape (n, 3)
            ICRF axes; velocity with respect to TDB.

        Raises
        ------
        CoverageError
            An epoch lies outside the trajectory or in a gap of it, or outside the ephemeris.
        KernelError
            SPICE cannot evaluate the file, or the ephemeris does not hold the centre.
        InputError
            The epochs are not in TDB.

        Notes
        -----
        SPICE takes an epoch as one float of seconds since J2000, which resolves 0.12 microseconds: 0.1 mm at 2 km/s.
        The rest of the epoch is made up for with the velocity, to far below a micrometre.
        """
        tdb.require("TDB")
        midnight_s = (tdb.jd - J2000_JD) * SECONDS_PER_DAY
        of_day_s = tdb.fraction * SECONDS_PER_DAY
        et_s = midnight_s + of_day_s
        rest_s = (midnight_s - et_s) + of_day_s
        which = self.source.segment_at(et_s)
        self._require_covered(et_s, which)
        states = self.source.states(et_s, which) * _M_PER_KM
        position_m, velocity_m_s = states[:, :3] + states[:, 3:] * rest_s[:, None], states[:, 3:]
        for center in sorted({segment.center for segment in self.source.segments}):
            rows = np.flatnonzero([self.source.segments[k].center == center for k in which])
            if len(rows):
                center_m, center_m_s = ephemeris.geocentric_center(center, tdb[rows])
                position_m[rows] += center_m
                velocity_m_s[rows] += center_m_s
        return position_m, velocity_m_s

    def _require_covered(self, et_s: NDArray[np.float64], which: NDArray[np.intp]) -> None:
        outside = et_s[which < 0]
        if not len(outside):
            return
        spans = [f"{tdb_date(start_s)} to {tdb_date(end_s)}" for start_s, end_s in self.source.spans_s()]
        gaps = ""
        if len(spans) > 1:
            more = f" and {len(spans) - _MAX_SPANS} more" if len(spans) > _MAX_SPANS else ""
            gaps = f" with gaps ({', '.join(spans[:_MAX_SPANS])}{more})"
        raise CoverageError(
            f"{self.kernel.path} (NAIF code {self.body})",
            (self.kernel.start_tdb, f"{self.kernel.end_tdb} TDB{gaps}"),
            (f"{tdb_date(outside.min())} TDB", f"{tdb_date(outside.max())} TDB"),
            "use a trajectory that covers these epochs, or leave them out (start, stop, hours)",
        )
