"""The state of an orbit that was determined, and how well it is known at the epoch and elsewhere on the arc."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radioloc.boundary import bare_arguments
from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.estimation.statistics import finite_or_none
from radioloc.lunar import rot_icrf_to_pa
from radioloc.time import Epochs, utc_strings

if TYPE_CHECKING:
    from radioloc.dynamics import AdjustableOrbit
    from radioloc.dynamics.disturbed import DisturbedOrbit
    from radioloc.ephemeris import LunarOrientation

Floats = NDArray[np.float64]

RTN = ("radial", "along", "across")
_MAPPED = 25
"""Epochs at which the covariance is mapped, the ends of the arc included."""


def equatorial_axes(libration: LunarOrientation, tdb: Epochs) -> Floats:
    """Axes of the Moon's equator in the ICRF at an epoch, shape (3, 3), one a row.

    The first points to the equator's ascending node on the plane of the ICRF's x and y, the third to the Moon's north
    pole (principal axes).
    """
    pole = rot_icrf_to_pa(libration.angles(tdb)[0])[0, 2]
    to_node = np.array([-pole[1], pole[0], 0.0]) / np.hypot(pole[0], pole[1])
    return np.stack([to_node, np.cross(pole, to_node), pole])


def plane_deg(state: Floats, axes: Floats) -> tuple[float, float]:
    """Inclination and longitude of the ascending node, 0 to 360 deg, of a state's plane by such axes."""
    x, y, z = axes @ np.cross(state[:3], state[3:])
    return float(np.degrees(np.arctan2(np.hypot(x, y), z))), float(np.degrees(np.arctan2(x, -y)) % 360.0)


@dataclass(frozen=True, slots=True, eq=False)
class OrbitState:
    """The state at the epoch of an orbit that was fitted.

    Parameters
    ----------
    orbit : AdjustableOrbit
        The orbit of the estimated values.
    parameter_covariance : ndarray, shape (p, p)
        Total covariance of the orbit's parameters, those of the state first; m, m/s and the forces' units.
    disturbed : DisturbedOrbit or None
        The orbit with the errors of its gravity field that were considered.
    sensitivity : ndarray, shape (p, k)
        What they, each by one sigma, do to the parameters.
    body : int
        NAIF code of the spacecraft in kernels.
    """

    orbit: AdjustableOrbit
    parameter_covariance: Floats
    disturbed: DisturbedOrbit | None = None
    sensitivity: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    body: int = -999

    @property
    def epoch(self) -> Epochs:
        """TDB, one."""
        return self.orbit.epoch

    @property
    def position_m(self) -> Floats:
        """Relative to the Moon's centre, ICRF axes, shape (3,)."""
        return self.orbit.state[:3]

    @property
    def velocity_m_s(self) -> Floats:
        """Likewise, shape (3,)."""
        return self.orbit.state[3:]

    @property
    def covariance(self) -> Floats:
        """Of position and velocity, m and m/s, ICRF axes, shape (6, 6)."""
        return self.parameter_covariance[:6, :6]

    @bare_arguments
    def covariance_rtn(self, tdb: Epochs) -> Floats:
        """Covariance of position and velocity at epochs, radial, along and across the orbit, shape (n, 6, 6).

        Errors of gravity count by what they did to the parameters and by what they do from the epoch on.

        Raises
        ------
        CoverageError
            An epoch lies outside the arc.
        """
        position_m, velocity_m_s = self.orbit.states(tdb)
        partials = self.orbit.partials(tdb)
        radial = position_m / np.linalg.norm(position_m, axis=-1)[:, None]
        across = np.cross(position_m, velocity_m_s)
        across = across / np.linalg.norm(across, axis=-1)[:, None]
        axes = np.stack([radial, np.cross(across, radial), across], axis=1)
        turned = np.concatenate([axes @ partials[:, :3], axes @ partials[:, 3:]], axis=1)
        covariance = self.parameter_covariance
        if self.disturbed is None:
            return np.asarray(turned @ covariance @ np.swapaxes(turned, 1, 2))
        covariance = covariance - self.sensitivity @ self.sensitivity.T
        direct = self.disturbed.effects.at(tdb)
        direct = np.concatenate([axes @ direct[:, :3], axes @ direct[:, 3:]], axis=1)
        moved = turned @ self.sensitivity + direct
        return np.asarray(turned @ covariance @ np.swapaxes(turned, 1, 2) + moved @ np.swapaxes(moved, 1, 2))

    @bare_arguments
    def sigma_rtn_m(self, tdb: Epochs) -> Floats:
        """Standard deviations of the position radial, along and across at epochs, m, shape (n, 3)."""
        return np.sqrt(np.diagonal(self.covariance_rtn(tdb), axis1=1, axis2=2)[:, :3])

    def elements(self) -> dict[str, float]:
        """Osculating elements at the epoch: size and shape of the orbit, its plane against the Moon's equator."""
        gm, r, v = self.orbit.gm_m3_s2, self.position_m, self.velocity_m_s
        distance, square = np.linalg.norm(r), v @ v
        momentum = np.cross(r, v)
        axis_m = 1.0 / (2.0 / distance - square / gm)
        eccentricity = float(np.linalg.norm(np.cross(v, momentum) / gm - r / distance))
        inclination_deg, node_deg = plane_deg(
            self.orbit.state, equatorial_axes(self.orbit.libration, self.epoch)
        )
        return {
            "semi_major_axis_m": float(axis_m),
            "eccentricity": eccentricity,
            "inclination_deg": inclination_deg,
            "node_deg": node_deg,
            "lowest_m": float(axis_m * (1.0 - eccentricity) - MEAN_LUNAR_RADIUS_M),
            "highest_m": float(axis_m * (1.0 + eccentricity) - MEAN_LUNAR_RADIUS_M),
        }

    def to_dict(self) -> dict[str, Any]:
        """In types that JSON has."""
        mapped = self.orbit.times(_MAPPED)
        determined = bool(np.isfinite(self.parameter_covariance).all())
        sigmas = self.sigma_rtn_m(mapped) if determined else np.full((_MAPPED, 3), np.inf)
        at_epoch = self.sigma_rtn_m(self.epoch)[0] if determined else np.full(3, np.inf)
        return {
            "name": self.orbit.name,
            "frame": "Moon-centred ICRF",
            "epoch_tdb": str(utc_strings(self.epoch, 6)[0]),
            "position_m": self.position_m.tolist(),
            "velocity_m_s": self.velocity_m_s.tolist(),
            "elements": self.elements(),
            "sigma_m": _by_axis(at_epoch),
            "covariance": [[finite_or_none(value) for value in row] for row in self.covariance],
            "mapped": [
                {"epoch_tdb": str(date), **_by_axis(sigma)}
                for date, sigma in zip(utc_strings(mapped, 3), sigmas, strict=True)
            ],
        }


def _by_axis(sigma_m: Floats) -> dict[str, float | None]:
    return {f"{axis}_m": finite_or_none(value) for axis, value in zip(RTN, sigma_m.tolist(), strict=True)}
