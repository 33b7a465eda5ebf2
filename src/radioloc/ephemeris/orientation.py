"""Orientation of the Moon: Euler angles of the principal axes in the ICRF, and Moon-fixed axes by NAIF code.

The codes are those of NAIF's frames kernels moon_080317.tf (DE421) and moon_de440_220930.tf.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radioloc.constants import ARCSEC_RAD
from radioloc.ephemeris.constants import CONSTANTS
from radioloc.ephemeris.positions import evaluate
from radioloc.errors import KernelError
from radioloc.kernels import Kernel, KernelFile
from radioloc.kernels.files import open_kernel
from radioloc.quantities import EpochsLike, accepts_quantities
from radioloc.time import Epochs
from radioloc.vectors import Floats

_INERTIAL_FRAME = 1


@dataclass(frozen=True, slots=True)
class LunarAxes:
    """Axes fixed to the Moon."""

    name: str  # NAIF's
    axes: str  # PA or ME
    ephemeris: str  # of the libration

    @property
    def frame(self) -> str:
        """Name of the axes in radioloc, such as ``PA_DE421``."""
        return CONSTANTS[self.ephemeris].me_frame if self.axes == "ME" else f"PA_{self.ephemeris}"

    def states_to_icrf(self, states: Floats, et_s: Floats) -> Floats:
        """Rotate states from these axes to the ICRF, shapes (n, 6), at TDB seconds since J2000."""
        import spiceypy

        angles_rad, rates_rad_s = LunarOrientation.open(self.ephemeris).angles(Epochs.from_tdb_seconds(et_s))
        of_axes = np.eye(6)
        if self.axes == "ME":
            x, y, z = (angle * ARCSEC_RAD for angle in CONSTANTS[self.ephemeris].pa_to_me_arcsec)
            of_axes = np.kron(np.eye(2), spiceypy.eul2m(x, y, z, 1, 2, 3).T)
        euler = np.ascontiguousarray(np.hstack([angles_rad[:, ::-1], rates_rad_s[:, ::-1]]))
        to_icrf = np.array([spiceypy.invstm(spiceypy.eul2xf(row, 3, 1, 3)) for row in euler])
        return np.asarray(np.einsum("nij,jk,nk->ni", to_icrf.reshape(-1, 6, 6), of_axes, states))


LUNAR_AXES = {
    31001: LunarAxes("MOON_ME", "ME", "DE421"),
    31007: LunarAxes("MOON_ME_DE421", "ME", "DE421"),
    31006: LunarAxes("MOON_PA_DE421", "PA", "DE421"),
    31000: LunarAxes("MOON_PA", "PA", "DE421"),
    31008: LunarAxes("MOON_PA_DE440", "PA", "DE440"),
    31010: LunarAxes("MOON_PA", "PA", "DE440"),
    31009: LunarAxes("MOON_ME_DE440_ME421", "ME", "DE440"),
    31011: LunarAxes("MOON_ME", "ME", "DE440"),
}
"""Axes by NAIF code. The first of two codes of the same axes is written."""

_FRAMES = {code: LUNAR_AXES[code].frame for code in (31006, 31008)}  # Axes of binary PCKs


@dataclass(frozen=True, slots=True, eq=False)
class LunarOrientation:
    """Orientation of the principal axes of one ephemeris; opened by :meth:`LunarOrientation.open`."""

    frame: str  #: the axes, such as PA_DE421
    frame_code: int  #: NAIF's code of the axes
    pck: Kernel

    @classmethod
    def open(cls, pck: str | Path = "DE421") -> LunarOrientation:
        """Open the orientation of the Moon: ``"DE421"``, or the path of a binary PCK with exactly one lunar frame."""
        kernel = open_kernel(pck, "PCK")
        held = sorted({s.target for s in kernel.segments})
        codes = [code for code in held if code in _FRAMES]
        if len(codes) != 1:
            supported = ", ".join(f"{code} ({name})" for code, name in _FRAMES.items())
            raise KernelError(
                f"{kernel.file.path} (spanning {kernel.file.start_tdb} to {kernel.file.end_tdb}) holds the "
                f"NAIF frames {held}, but exactly one of {supported} is expected; use NAIF's lunar PCK of "
                "DE421 or DE440"
            )
        return cls(_FRAMES[codes[0]], codes[0], kernel)

    @property
    def kernel(self) -> KernelFile:
        """Path, SHA-256 and span of the file."""
        return self.pck.file

    @accepts_quantities
    def angles(self, tdb: EpochsLike) -> tuple[Floats, Floats]:
        """Euler angles phi, theta, psi of the principal axes, rad, and their rates, rad/s, at epochs of TDB, (n, 3).

        Their order is that of the 3-1-3 rotations from the ICRF to the principal axes, Rz(psi) Rx(theta) Rz(phi)
        (Folkner et al. 2009, lunar orientation; :func:`radioloc.lunar.rot_icrf_to_pa`). psi is continuous; its
        round-off is 1e-12 rad, 2 micrometres on the surface.
        """
        angles_rad, rates_rad_s = evaluate(self.pck, self.frame_code, _INERTIAL_FRAME, tdb)
        return angles_rad, rates_rad_s
