"""Barycentric motion of targets near the instants at which signals meet them.

Targets are points fixed to the Moon, or spacecraft. Positions of a spacecraft are coordinates of the BCRS in TDB units
already, so the terms of points on the Moon (``lunar_tide``, ``lunar_scale``, ``lunar_lorentz``) do not apply.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from radioloc.constants import C_M_S, L_B, L_G, MEAN_LUNAR_RADIUS_M
from radioloc.ephemeris import EarthState
from radioloc.ephemeris.trajectory import SpacecraftTrajectory
from radioloc.errors import InputError
from radioloc.lunar import rot_icrf_to_pa
from radioloc.lunar.frames import rot_icrf_to_pa_rate
from radioloc.lunar.tide import solid_tide
from radioloc.measurements.light_path import PLANETS_MM, MovingPoint
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.station_motion import geocentre_displacement_m
from radioloc.time import Epochs
from radioloc.vectors import Floats, Indices, Mask, dot, length, rotated

Rows = Indices | slice

_MAX_DISTANCE_M = 2e10  # in 67 s of light time the Earth's motion departs from a parabola by 0.06 mm


@dataclass(frozen=True, slots=True)
class LunarMotion:
    """Motion of the Moon near an instant of each observation, and of spacecraft."""

    centre: MovingPoint  # in the BCRS, from the geocentre at the reference epoch
    rot_pa_to_icrf: Floats  # orientation of the principal axes, shape (n, 3, 3)
    rot_pa_to_icrf_rate: Floats  # 1/s
    geocentre_m: Floats  # from the geocentre at the reference epoch
    geocentric_velocity_m_s: Floats  # of the Moon's centre
    moon_gcrs_m: Floats  # the Moon's centre from the geocentre
    earth_pa_m: Floats  # from the Moon's centre, as the Sun, principal axes
    sun_pa_m: Floats
    length_scale: Floats  # U/c^2 + L_B - L_G, potential U of Sun and Earth at the Moon's centre
    bodies_m: dict[str, Floats]  # Sun and planets, from the geocentre at the reference epoch
    craft: MovingPoint | None = None  # spacecraft; the Moon's centre for other targets
    is_craft: Mask | None = None  # whether the target is a spacecraft, shape (n,)

    @property
    def origin(self) -> MovingPoint:
        """Origin of positions: the Moon's centre, or the spacecraft."""
        return self.centre if self.craft is None else self.craft

    def point(self, model: PhysicalModel, lander_pa_m: Floats) -> MovingPoint:
        """Return the motion of points by principal-axes coordinates, or offsets from spacecraft, (3,) or (n, 3), m."""
        pa_m = np.broadcast_to(lander_pa_m, self.earth_pa_m.shape)
        if self.craft is None or self.is_craft is None:
            return self._surface_motion(model, lander_pa_m)
        flying = MovingPoint(
            self.craft.offset_s,
            self.craft.position_m + rotated(self.rot_pa_to_icrf, pa_m),
            self.craft.velocity_m_s + rotated(self.rot_pa_to_icrf_rate, pa_m),
        )
        if self.is_craft.all():
            return flying
        # The tide is undefined at the Moon's centre: rows of spacecraft have an arbitrary other place.
        mask = self.is_craft[:, None]
        ground = self._surface_motion(model, np.where(mask, [MEAN_LUNAR_RADIUS_M, 0.0, 0.0], pa_m))
        return MovingPoint(
            self.centre.offset_s,
            np.where(mask, flying.position_m, ground.position_m),
            np.where(mask, flying.velocity_m_s, ground.velocity_m_s),
        )

    def _surface_motion(self, model: PhysicalModel, lander_pa_m: Floats) -> MovingPoint:
        """Return the motion of points fixed to the Moon, with the tide, in barycentric coordinates."""
        pa_m = np.broadcast_to(lander_pa_m, self.earth_pa_m.shape)
        if model.has("lunar_tide"):
            permanent: Literal["included", "removed"] = (
                "included" if model.has("lunar_tide_constant") else "removed"
            )
            pa_m = pa_m + solid_tide(
                lander_pa_m, self.earth_pa_m, self.sun_pa_m, model.ephemeris.constants, permanent
            )
        r_m = rotated(self.rot_pa_to_icrf, pa_m)
        velocity_m_s = self.centre.velocity_m_s + rotated(self.rot_pa_to_icrf_rate, pa_m)
        v_m_s = self.centre.velocity_m_s
        bcrs_m = r_m
        if model.has("lunar_scale"):
            bcrs_m = bcrs_m - r_m * self.length_scale[:, None]
        if model.has("lunar_lorentz"):
            bcrs_m = bcrs_m - v_m_s * (dot(v_m_s, r_m) / (2.0 * C_M_S**2))[:, None]
        return MovingPoint(self.centre.offset_s, self.centre.position_m + bcrs_m, velocity_m_s)

    def with_craft(
        self,
        trajectory: SpacecraftTrajectory,
        model: PhysicalModel,
        reference: Epochs,
        rows: Rows = slice(None),
    ) -> LunarMotion:
        """Return the motion with a spacecraft on a trajectory as the target of some rows."""
        offset_s = self.centre.offset_s[rows]
        position_m, velocity_m_s = trajectory.geocentric(model.ephemeris, reference[rows].shifted(offset_s))
        distance_m = float(length(position_m).max(initial=0.0))
        if distance_m > _MAX_DISTANCE_M:
            raise InputError(
                f"{trajectory.name}: expected a target within {_MAX_DISTANCE_M / 1e9:.0f} million km of the Earth, got "
                f"{distance_m / 1e9:.1f} million km"
            )
        earth_m_s = (self.centre.velocity_m_s - self.geocentric_velocity_m_s)[rows]
        position_m, velocity_m_s = self.geocentre_m[rows] + position_m, earth_m_s + velocity_m_s
        if len(offset_s) == len(self.centre.offset_s):
            is_craft = np.ones(len(offset_s), dtype=bool)
            return replace(self, craft=MovingPoint(offset_s, position_m, velocity_m_s), is_craft=is_craft)
        origin = self.origin
        of_all_m, of_all_m_s = origin.position_m.copy(), origin.velocity_m_s.copy()
        is_craft = np.zeros(len(of_all_m), dtype=bool) if self.is_craft is None else self.is_craft.copy()
        of_all_m[rows], of_all_m_s[rows], is_craft[rows] = position_m, velocity_m_s, True
        return replace(self, craft=MovingPoint(origin.offset_s, of_all_m, of_all_m_s), is_craft=is_craft)

    def geocentric(self, point: MovingPoint, offset_s: Floats) -> tuple[Floats, Floats]:
        """Return geocentric position and velocity of a target at a near instant, shapes (n, 3)."""
        earth_velocity_m_s = self.centre.velocity_m_s - self.geocentric_velocity_m_s
        velocity_m_s = point.velocity_m_s - earth_velocity_m_s
        elapsed_s = (offset_s - point.offset_s)[:, None]
        return point.position_m - self.geocentre_m + velocity_m_s * elapsed_s, velocity_m_s


def lunar_motion(
    model: PhysicalModel, reference: Epochs, reference_earth: EarthState, offset_s: Floats
) -> LunarMotion:
    """Return the Moon's motion at offsets from the reference epochs (TDB), from the geocentre there."""
    # Lengths on the Moon are local lengths in the units of TT, like those on the Earth. In the BCRS they are shorter by
    # U/c^2 + L_B - L_G (43 mm of the radius) and along the velocity by the Lorentz contraction -v (v . r) / (2 c^2), up
    # to 9 mm (IERS Conventions 2010, section 11.1, applied to the Moon). The straight motion of a spacecraft in a low
    # lunar orbit (1.6 m/s^2) has an error of 0.8 micrometres after 1e-3 s, and of 1e-16 m after nanoseconds.
    tdb = reference.shifted(offset_s)
    planets = [body for body in PLANETS_MM if body in model.ephemeris.bodies]
    earth, bodies = model.ephemeris.states(("moon", "sun", *planets), tdb)
    moon_m, moon_velocity_m_s = bodies.pop("moon")
    sun_m = bodies["sun"][0]
    angles_rad, rates_rad_s = model.libration.angles(tdb)
    rot = rot_icrf_to_pa(angles_rad)
    constants = model.ephemeris.constants
    potential = constants.gm_sun_m3_s2 / length(sun_m - moon_m)
    potential = potential + constants.gm_earth_m3_s2 / length(moon_m)
    geocentre_m = geocentre_displacement_m(reference_earth, offset_s)
    return LunarMotion(
        centre=MovingPoint(offset_s, geocentre_m + moon_m, earth.velocity_m_s + moon_velocity_m_s),
        rot_pa_to_icrf=np.swapaxes(rot, -1, -2),
        rot_pa_to_icrf_rate=np.swapaxes(rot_icrf_to_pa_rate(angles_rad, rates_rad_s), -1, -2),
        geocentre_m=geocentre_m,
        geocentric_velocity_m_s=moon_velocity_m_s,
        moon_gcrs_m=moon_m,
        earth_pa_m=np.einsum("nij,nj->ni", rot, -moon_m),
        sun_pa_m=np.einsum("nij,nj->ni", rot, sun_m - moon_m),
        length_scale=potential / C_M_S**2 + (L_B - L_G),
        bodies_m={body: geocentre_m + body_m for body, (body_m, _) in bodies.items()},
    )
