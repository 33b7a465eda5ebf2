"""Target ``kind = "sliding_lander"``: a point on the Moon that moves at a constant velocity, as down a slope."""

from dataclasses import dataclass, replace

import numpy as np

from radioloc.lunar import LunarPosition
from radioloc.lunar.local import rot_pa_to_enu
from radioloc.measurements import OrbitMotion
from radioloc.measurements.lunar_motion import lunar_motion
from radioloc.parameters import Parameter, Role
from radioloc.targets import TargetKind, WithoutForces, place_doubts
from radioloc.time import epochs_from_strings

AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Slide:
    """Motion in principal axes: position and velocity at an epoch."""

    model: object
    epoch: object  # TDB
    state: np.ndarray  # m and m/s
    name = "sliding lander"

    def _moon(self, tdb):
        return lunar_motion(self.model, tdb, self.model.ephemeris.earth(tdb), np.zeros(len(tdb)))

    def geocentric(self, ephemeris, tdb):
        moon, since_s = self._moon(tdb), tdb.seconds_since(self.epoch)
        point = moon.point(self.model, self.state[:3] + np.outer(since_s, self.state[3:]))
        position_m, velocity_m_s = moon.geocentric(point, np.zeros(len(tdb)))
        return position_m, velocity_m_s + moon.rot_pa_to_icrf @ self.state[3:]

    def position_partials(self, tdb):
        rot, since_s = self._moon(tdb).rot_pa_to_icrf, tdb.seconds_since(self.epoch)
        return np.concatenate([rot, since_s[:, None, None] * rot], axis=-1)

    def spans_s(self):
        return [(-3e9, 3e9)]

    def restricted_to(self, first, last):
        return self

    def corrected(self, x):
        return replace(self, state=self.state + x)


@dataclass(frozen=True)
class SlidingTarget(WithoutForces):
    """Target of the state at the epoch; its place is that at the epoch."""

    name: str
    parameters: list
    slide: Slide
    preceding, has_place, local_axes = 0, True, ("east", "north", "up")

    @property
    def start(self):
        return OrbitMotion(self.slide)

    def motion(self, x):
        return OrbitMotion(self.slide, x - self.slide.state), np.eye(6)

    def position(self, x):
        return x[:3], np.eye(3, 6)

    def local_partials(self, x, tdb, rot_pa_to_me):
        return (rot_pa_to_enu(x[:3], rot_pa_to_me) @ np.eye(3, 6))[None]

    def solved(self, target_values, x):
        return target_values

    def doubts(self, x, fitted):
        return place_doubts(x[:3], fitted)


@dataclass(frozen=True)
class SlidingLander:
    """Keys of ``[target]``: place at an epoch (TDB), and velocity in principal axes."""

    longitude_deg: float
    latitude_deg: float
    height_m: float
    epoch: str
    velocity_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def target(self, name, model, role=Role.ESTIMATED):
        place = LunarPosition.from_selenographic(self.longitude_deg, self.latitude_deg, self.height_m)
        place_m = place.to_axes("PA", model.ephemeris.constants).xyz_m
        state = np.concatenate([place_m, self.velocity_m_s])
        owner = f".{name}" if name else ""
        units = [("position", "m", 1.0)] * 3 + [("slide", "m/s", 1e-5)] * 3
        parameters = [
            Parameter(f"{kind}{owner}.{axis}", unit, kind, float(value), role=role, scale=scale)
            for axis, value, (kind, unit, scale) in zip(2 * AXES, state, units, strict=True)
        ]
        return SlidingTarget(name, parameters, Slide(model, epochs_from_strings(self.epoch, "TDB"), state))


SLIDING_LANDER = TargetKind("sliding_lander", SlidingLander)
