"""Axes fixed to the Moon by their NAIF codes, and states in them turned into the ICRF.

The codes are those of NAIF's frames kernels moon_080317.tf (DE421) and moon_de440_220930.tf.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import ARCSEC_RAD
from radioloc.ephemeris.constants import CONSTANTS
from radioloc.ephemeris.orientation import LunarOrientation
from radioloc.time import Epochs


@dataclass(frozen=True, slots=True)
class LunarAxes:
    """Axes fixed to the Moon."""

    name: str  # NAIF's
    axes: str  # PA or ME
    ephemeris: str  # by whose libration they turn

    @property
    def frame(self) -> str:
        """Name of the axes here, such as ``PA_DE421``."""
        return CONSTANTS[self.ephemeris].me_frame if self.axes == "ME" else f"PA_{self.ephemeris}"


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
"""Axes by NAIF code. Of axes with two codes the first is the one that is written."""


def states_to_icrf(
    states: NDArray[np.float64], et_s: NDArray[np.float64], axes: LunarAxes
) -> NDArray[np.float64]:
    """States relative to the Moon's axes as states in the ICRF, in the same units of length, per second.

    Parameters
    ----------
    states : ndarray, shape (n, 6)
        Positions and velocities; a point at rest on the Moon has no velocity here, and one of up to 4.6 m/s there.
    et_s : ndarray, shape (n,)
        TDB seconds since J2000.
    axes : LunarAxes
        Whose orientation is that of the kernel that ships.

    Raises
    ------
    CoverageError
        An epoch lies outside the orientation's span.
    """
    import spiceypy

    angles_rad, rates_rad_s = LunarOrientation.open(axes.ephemeris).angles(Epochs.from_tdb_seconds(et_s))
    of_axes = np.eye(6)
    if axes.axes == "ME":
        x, y, z = (angle * ARCSEC_RAD for angle in CONSTANTS[axes.ephemeris].pa_to_me_arcsec)
        of_axes = np.kron(np.eye(2), spiceypy.eul2m(x, y, z, 1, 2, 3).T)
    euler = np.ascontiguousarray(np.hstack([angles_rad[:, ::-1], rates_rad_s[:, ::-1]]))
    to_icrf = np.array([spiceypy.invstm(spiceypy.eul2xf(row, 3, 1, 3)) for row in euler])
    return np.asarray(np.einsum("nij,jk,nk->ni", to_icrf.reshape(-1, 6, 6), of_axes, states))
