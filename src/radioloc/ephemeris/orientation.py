"""Orientation of the Moon's principal axes in the ICRF: the Euler angles of the ephemeris and their rates."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.boundary import bare_arguments
from radioloc.ephemeris.chebyshev import evaluate
from radioloc.errors import KernelError
from radioloc.kernels import Kernel, KernelFile, open_pck
from radioloc.time import Epochs

_INERTIAL_FRAME = 1
_FRAMES = {31006: "PA_DE421", 31008: "PA_DE440"}


@dataclass(frozen=True, slots=True, eq=False)
class LunarOrientation:
    """Orientation of the principal axes of one ephemeris; make one with :meth:`LunarOrientation.open`."""

    frame: str  # the axes, such as PA_DE421
    frame_code: int  # NAIF's code of the axes
    pck: Kernel

    @classmethod
    def open(cls, pck: str | Path = "DE421") -> LunarOrientation:
        """Open the orientation of the Moon: ``"DE421"``, which ships, or the path of a lunar binary PCK.

        It has to hold exactly one of the known lunar frames.
        """
        kernel = open_pck(pck)
        held = sorted({s.target for s in kernel.segments})
        codes = [code for code in held if code in _FRAMES]
        if len(codes) != 1:
            known = ", ".join(f"{code} ({name})" for code, name in _FRAMES.items())
            raise KernelError(
                f"{kernel.file.path} (spanning {kernel.file.start_tdb} to {kernel.file.end_tdb}) holds the "
                f"NAIF frames {held}, but exactly one of {known} is wanted; use NAIF's lunar PCK of "
                "DE421 or DE440"
            )
        return cls(_FRAMES[codes[0]], codes[0], kernel)

    @property
    def kernel(self) -> KernelFile:
        """Path, SHA-256 and span of the file."""
        return self.pck.file

    @bare_arguments
    def angles(self, tdb: Epochs) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Euler angles phi, theta, psi of the principal axes, rad, and their rates, rad/s, at epochs of TDB, (n, 3).

        They are in the order of the 3-1-3 rotations that take the ICRF into the principal axes, Rz(psi) Rx(theta)
        Rz(phi) (Folkner et al. 2009, section on lunar orientation; :func:`radioloc.lunar.rot_icrf_to_pa`). psi runs on
        without jumps; its round-off is 1e-12 rad, 2 micrometres on the surface.
        """
        angles_rad, rates_rad_s = evaluate(self.pck, self.pck.segment(self.frame_code, _INERTIAL_FRAME), tdb)
        return angles_rad, rates_rad_s
