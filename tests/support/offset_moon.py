"""Displaced and rotated Moon, displaced stations and changed Earth orientation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.ephemeris import EarthState, Ephemeris, LunarOrientation
from radioloc.time import Epochs

_Vectors = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class OffsetEphemeris(Ephemeris):
    """Ephemeris with the Moon displaced along, across and out of its geocentric orbit.

    Parameters
    ----------
    offset_m : tuple of float
        Away from the Earth, along the orbit, and along its angular momentum, m; constant in these directions.
    """

    offset_m: tuple[float, float, float]

    @classmethod
    def from_model(cls, ephemeris: Ephemeris, offset_m: tuple[float, float, float]) -> OffsetEphemeris:
        """Displace the Moon of an ephemeris."""
        return cls(ephemeris.name, ephemeris.constants, ephemeris.spk, offset_m)

    def geocentric(self, body: str, tdb: Epochs) -> tuple[_Vectors, _Vectors]:
        """Return the geocentric state, as :meth:`radioloc.ephemeris.Ephemeris.geocentric`."""
        return self.states((body,), tdb)[1][body]

    def states(
        self, bodies: Sequence[str], tdb: Epochs
    ) -> tuple[EarthState, dict[str, tuple[_Vectors, _Vectors]]]:
        """Return the states of the Earth and of bodies, as :meth:`radioloc.ephemeris.Ephemeris.states`."""
        earth, states = Ephemeris.states(self, bodies, tdb)
        if "moon" in states:
            position_m, velocity_m_s = states["moon"]
            moved_m, moved_m_s = self._offset(position_m, velocity_m_s)
            states["moon"] = position_m + moved_m, velocity_m_s + moved_m_s
        return earth, states

    def _offset(self, position_m: _Vectors, velocity_m_s: _Vectors) -> tuple[_Vectors, _Vectors]:
        momentum = np.cross(position_m, velocity_m_s)
        radial = position_m / np.linalg.norm(position_m, axis=-1)[:, None]
        cross = momentum / np.linalg.norm(momentum, axis=-1)[:, None]
        moved_m = np.array(self.offset_m) @ np.stack([radial, np.cross(cross, radial), cross], axis=1)
        # The directions turn with the Moon; the rotation of the orbital plane, 500 times slower, is neglected.
        turning_rad_s = momentum / np.sum(position_m**2, axis=-1)[:, None]
        return moved_m, np.cross(turning_rad_s, moved_m)


@dataclass(frozen=True, slots=True, eq=False)
class OffsetOrientation(LunarOrientation):
    """Orientation of the Moon with a constant small rotation about its own axes added.

    Parameters
    ----------
    rotation_rad : tuple of float
        About the principal axes x (to the Earth), y and z (the pole), rad: a point of the Moon at r, in these axes,
        moves by rotation x r. To first order: good to 1e-9 of the point's radius for 1e-5 rad.
    """

    rotation_rad: tuple[float, float, float]

    @classmethod
    def from_model(
        cls, orientation: LunarOrientation, rotation_rad: tuple[float, float, float]
    ) -> OffsetOrientation:
        """Rotate an orientation."""
        return cls(orientation.frame, orientation.frame_code, orientation.pck, rotation_rad)

    def angles(self, tdb: Epochs) -> tuple[_Vectors, _Vectors]:
        """Return the angles and their rates, as :meth:`radioloc.ephemeris.LunarOrientation.angles`.

        Changes of the angles follow from the rotation as their rates from the angular velocity
        (:func:`radioloc.lunar.angular_velocity_pa`).
        """
        angles_rad, rates_rad_s = LunarOrientation.angles(self, tdb)
        _, theta, psi = angles_rad.T
        _, theta_rate, psi_rate = rates_rad_s.T
        x, y, z = self.rotation_rad
        sin, cos, sin_theta = np.sin(psi), np.cos(psi), np.sin(theta)
        node, node_rate = x * sin + y * cos, psi_rate * (x * cos - y * sin)
        phi_change = node / sin_theta
        phi_change_rate = node_rate / sin_theta - phi_change * theta_rate / np.tan(theta)
        change = [phi_change, x * cos - y * sin, z - phi_change * np.cos(theta)]
        change_rate = [
            phi_change_rate,
            -psi_rate * node,
            phi_change * sin_theta * theta_rate - phi_change_rate * np.cos(theta),
        ]
        return angles_rad + np.stack(change, axis=-1), rates_rad_s + np.stack(change_rate, axis=-1)
