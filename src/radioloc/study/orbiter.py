"""A target that flies: its state at an epoch, the forces on it, and where it lands."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.dynamics import AdjustableOrbit, Forces
from radioloc.dynamics.elements import equatorial_axes, state_from_elements
from radioloc.dynamics.orbit import initial_state
from radioloc.ephemeris import CONSTANTS, Ephemeris, LunarOrientation
from radioloc.errors import InputError
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.quantities import convert_fields
from radioloc.targets.descent import Ground
from radioloc.targets.orbit import GravityErrors
from radioloc.time import Epochs, tt_to_tdb, utc_strings, utc_to_tt

Floats = NDArray[np.float64]

AXES = ("equator", "ICRF")  # Axes in which angles of elements are counted
GRAVITY_ERRORS = 12  # Draws by which a sigma is good to a fifth
GRAVITY_ERROR_DEGREE = 200
_SPHERE_OF_INFLUENCE_M = 66e6  # The Moon's sphere of influence
_MAX_HYPERBOLIC_EXCESS_M_S = 3e3  # Translunar trajectories have less
_MIN_SPEED_RATIO = 0.005  # Lowest plausible ratio of speed to escape velocity; a slower spacecraft falls
_MARGIN_S = 60.0  # Half a count interval and the light time, beyond the first and the last tag
_HIGHEST_M = 2e6
_LONGEST_ARC_S = 40.0 * 86400.0
_LOWEST_END_M, _HIGHEST_END_M = -20e3, 25e3
"""Heights at which a-priori trajectories may end: those of the ground, give or take what the thrust may be wrong."""
_FARTHEST_M = 200e3


@dataclass(frozen=True, slots=True)
class RoughOrbit:
    """Nearly circular orbit before a state is known; angles refer to the Moon's equator."""

    altitude_m: float
    inclination_deg: float | None = None
    node_deg: float | None = None  # from the equator's ascending node on the ICRF's xy plane

    def __post_init__(self) -> None:
        if not 0.0 < self.altitude_m <= _HIGHEST_M:
            raise InputError(
                f"altitude_m must be above 0 and at most {_HIGHEST_M:g} m, not {self.altitude_m!r}; first orbits are "
                "sought of low ones"
            )
        if self.inclination_deg is not None and not 0.0 <= self.inclination_deg <= 180.0:
            raise InputError(f"inclination_deg must be from 0 to 180, not {self.inclination_deg!r}")
        if self.node_deg is not None and not -360.0 <= self.node_deg <= 360.0:
            raise InputError(f"node_deg must be from -360 to 360, not {self.node_deg!r}")

    def __str__(self) -> str:
        plane = {"inclination": self.inclination_deg, "node": self.node_deg}
        given = [f", {name} {value:g} deg" for name, value in plane.items() if value is not None]
        return f"an altitude of {self.altitude_m / 1e3:g} km{''.join(given)}"

    @property
    def in_plane(self) -> bool:
        """Whether the plane is known."""
        return self.inclination_deg is not None and self.node_deg is not None


@dataclass(frozen=True, slots=True, eq=False)
class Landing:
    """Touchdown: one epoch, TDB, and the a-priori place, by default where the a-priori trajectory ends."""

    epoch: Epochs
    place: LunarPosition | None = None

    def __post_init__(self) -> None:
        convert_fields(self)
        self.epoch.require("TDB")
        if len(self.epoch) != 1:
            raise InputError(f"epoch of the landing must be one, not {len(self.epoch)}")

    def __str__(self) -> str:
        return f"touchdown at {utc_strings(self.epoch, 3)[0]} TDB"

    def place_pa_m(self, model: PhysicalModel) -> Floats | None:
        """The a-priori place in principal axes, m, if it is given."""
        return None if self.place is None else self.place.to_axes("PA", model.ephemeris.constants).xyz_m

    def forces(self, given: Forces, epoch: Epochs, state: Floats) -> Forces:
        """Return forces along axes of the a-priori plane, as the orbit's own vanish with the velocity."""
        for one in given.accelerations:
            for moment in (one.start, one.stop):
                if moment is not None and not (
                    moment.seconds_since(epoch)[0] >= 0.0 and self.epoch.seconds_since(moment)[0] >= 0.0
                ):
                    raise InputError(
                        f"acceleration {one.name} starts or stops at {utc_strings(moment, 3)[0]} TDB, which is not "
                        f"between the epoch of the state, {utc_strings(epoch, 3)[0]}, and the {self}; correct its "
                        "times"
                    )
        normal = np.cross(state[:3], state[3:])
        x, y, z = (normal / np.linalg.norm(normal)).tolist()
        return replace(
            given, accelerations=tuple(replace(one, normal=(x, y, z)) for one in given.accelerations)
        )

    def at_rest(self, flight: AdjustableOrbit, model: PhysicalModel) -> AdjustableOrbit:
        """The orbit that comes to rest at the a-priori place."""
        ground, place_pa_m = Ground(model, self.epoch), self.place_pa_m(model)
        if place_pa_m is None:
            place_pa_m = ground.place_pa_m(self.landed(flight, model).state)
        return flight.moved_to(self.epoch, ground.at_rest(place_pa_m))

    def landed(self, flight: AdjustableOrbit, model: PhysicalModel) -> AdjustableOrbit:
        """The orbit of an a-priori state, with its end as the state; an InputError where that is not at the ground."""
        landed = flight.moved_to(self.epoch)
        end_pa_m = Ground(model, self.epoch).place_pa_m(landed.state)
        height_m, place_pa_m = float(np.linalg.norm(end_pa_m)) - MEAN_LUNAR_RADIUS_M, self.place_pa_m(model)
        off = ""
        if not _LOWEST_END_M < height_m < _HIGHEST_END_M:
            off = f"{height_m / 1e3:.1f} km above the sphere of 1737.4 km"
        elif (
            place_pa_m is not None and (away_m := float(np.linalg.norm(end_pa_m - place_pa_m))) > _FARTHEST_M
        ):
            off = f"{away_m / 1e3:.0f} km from the a-priori place"
        if off:
            raise InputError(
                f"the a-priori trajectory of {flight.name} is {off} at the {self}; correct its state, the "
                "accelerations or the epoch of [target.landing]"
            )
        return landed


def _require_orbit(state: Floats) -> None:
    """Raise an InputError of a velocity that no spacecraft near the Moon has."""
    distance_m, speed_m_s = np.linalg.norm(state.reshape(2, 3), axis=1).tolist()
    escape_m_s = math.sqrt(2.0 * CONSTANTS["DE421"].gm_m3_s2("moon") / distance_m)
    flies_past = distance_m < _SPHERE_OF_INFLUENCE_M and speed_m_s > math.hypot(
        escape_m_s, _MAX_HYPERBOLIC_EXCESS_M_S
    )
    if flies_past or speed_m_s < _MIN_SPEED_RATIO * escape_m_s:
        raise InputError(
            f"velocity_m_s is {speed_m_s:.4g} m/s at {distance_m / 1e3:.0f} km from the Moon's centre, where orbits "
            f"are below {escape_m_s:.0f} m/s; is it in other units, or relative to another body?"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Orbiter:
    """Spacecraft about the Moon whose orbit follows from its state at an epoch (TDB, ICRF axes) and the forces.

    `gravity_errors` drawn errors of the field stand for all in the sigmas, up to `gravity_error_degree`; what the field
    lacks is drawn by Kaula's rule. `rough` takes the place of a state that is searched for.
    """

    epoch: Epochs
    position_m: tuple[float, float, float] | None
    velocity_m_s: tuple[float, float, float] | None
    forces: Forces
    name: str = "orbiter"
    gravity_errors: int = GRAVITY_ERRORS
    gravity_error_degree: int = GRAVITY_ERROR_DEGREE
    rough: RoughOrbit | None = None
    body: int = -999
    landing: Landing | None = None

    def __post_init__(self) -> None:
        convert_fields(self)
        if self.position_m is not None and self.velocity_m_s is not None:
            _require_orbit(initial_state(self.position_m, self.velocity_m_s))
        if not (self.name.strip() and self.name.isascii() and self.name.isprintable()):
            raise InputError(f"name {self.name!r} cannot stand in orbit files; give printable ASCII text")
        if not -(2**31) < self.body < 0:
            raise InputError(
                f"body {self.body!r} is no NAIF code of a spacecraft; give a negative integer such as -181"
            )
        self.epoch.require("TDB")
        if (self.rough is None) == (self.position_m is None) or (self.position_m is None) != (
            self.velocity_m_s is None
        ):
            raise InputError("give either position_m and velocity_m_s, or a rough orbit, altitude_m")
        if len(self.epoch) != 1:
            raise InputError(f"epoch must be one, not {len(self.epoch)}")
        if self.landing is not None:
            if not self.landing.epoch.seconds_since(self.epoch)[0] > 0.0:
                raise InputError(
                    f"the {self.landing} is not after the epoch of the state; correct one of them"
                )
            object.__setattr__(self, "forces", self.landing.forces(self.forces, self.epoch, self.state))

    @classmethod
    def from_elements(
        cls,
        epoch: Epochs,
        elements: ArrayLike,
        forces: Forces,
        *,
        axes: str = "equator",
        form: str = "keplerian",
        ephemeris: str | Path = "DE421",
        libration: str | Path = "DE421",
        **rest: Any,
    ) -> Orbiter:
        """Return an orbiter from osculating elements, m and deg, with angles to the Moon's equator or to the ICRF."""
        if axes not in AXES:
            raise InputError(f"axes {axes!r} of the elements is not known; use {' or '.join(AXES)}")
        gm = forces.gm_m3_s2 or Ephemeris.open(ephemeris).constants.gm_m3_s2("moon")
        turned = np.eye(3) if axes == "ICRF" else equatorial_axes(LunarOrientation.open(libration), epoch)
        x, y, z, vx, vy, vz = state_from_elements(elements, gm, turned, form).tolist()
        return cls(epoch, (x, y, z), (vx, vy, vz), forces, **rest)

    def __repr__(self) -> str:
        known = "state" if self.rough is None else f"{self.rough}"
        return f"<Orbiter {self.name}, {known} at {self.epoch.day_strings()[0]}>"

    @property
    def state(self) -> Floats:
        """Position, m, and velocity, m/s, shape (6,); an InputError of an orbiter without."""
        if self.position_m is None or self.velocity_m_s is None:
            raise InputError(
                f"[target] altitude_m: expected an a-priori state of {self.name}, got a rough orbit; `radioloc search "
                "STUDY.toml --out completed.toml` finds a state, or give position_m and velocity_m_s, or elements"
            )
        return np.array([*self.position_m, *self.velocity_m_s], dtype=np.float64)

    def at(self, state: Floats) -> Orbiter:
        """The same with a state, shape (6,)."""
        x, y, z, vx, vy, vz = state.tolist()
        return replace(self, position_m=(x, y, z), velocity_m_s=(vx, vy, vz), rough=None)

    def disturbed(
        self, orbit: AdjustableOrbit, count: int | None = None, seed: Generator | int = 0
    ) -> AdjustableOrbit | None:
        """Its orbit with the errors of gravity that are considered, or with others, if there are any."""
        return GravityErrors(self.gravity_errors, self.gravity_error_degree).of(orbit, count, seed)

    def record(self) -> dict[str, Any]:
        """State and forces, in types that JSON has."""
        field, forces = self.forces.gravity, self.forces
        return {
            "epoch_tdb": str(utc_strings(self.epoch, 6)[0]),
            **(
                {"position_m": self.state[:3].tolist(), "velocity_m_s": self.state[3:].tolist()}
                if self.rough is None
                else asdict(self.rough)
            ),
            **({} if self.landing is None else {"landing_tdb": str(utc_strings(self.landing.epoch, 6)[0])}),
            "forces": {
                "gravity": {
                    "name": field.name,
                    "degree": field.degree,
                    "axes": field.frame,
                    "tide_system": field.tide_system,
                },
                "bodies": list(forces.bodies),
                "figures": forces.figures,
                "relativity": forces.relativity,
                "moonlight": forces.moonlight and forces.radiation_m2_kg > 0.0,
                **forces.parameters(),
            },
        }

    def orbit(
        self, model: PhysicalModel, observations: Observations, parameters: tuple[str, ...]
    ) -> AdjustableOrbit:
        """Return the a-priori orbit with partials; the epoch of one that lands is the touchdown."""
        count_s = float(np.nan_to_num(observations.count_s).max(initial=0.0))
        flight = self._flight(model, observations.span() if len(observations) else None, count_s, parameters)
        if self.landing is None:
            return flight
        if flight.span_s[0] + _MARGIN_S > self.landing.epoch.seconds_since(self.epoch)[0]:
            raise InputError(
                f"the {self.landing} is before all observations; with none of the flight, locate the place as a "
                "[target] with longitude_deg, latitude_deg and height_m"
            )
        return self.landing.landed(flight, model)

    def orbit_over(
        self, model: PhysicalModel, utc: Epochs | None, count_s: float, parameters: tuple[str, ...] = ()
    ) -> AdjustableOrbit:
        """The true orbit, over time tags from one epoch to another; one that lands comes to rest at its place."""
        flight = self._flight(model, utc, count_s, parameters)
        return flight if self.landing is None else self.landing.at_rest(flight, model)

    def _flight(
        self, model: PhysicalModel, utc: Epochs | None, count_s: float, parameters: tuple[str, ...]
    ) -> AdjustableOrbit:
        """From the state at the epoch, over time tags from one epoch to another, or none; of counts of a length."""
        tdb_s = np.zeros(1) if utc is None else tt_to_tdb(utc_to_tt(utc)).seconds_since(self.epoch)
        if abs(tdb_s).max() > _LONGEST_ARC_S:
            raise InputError(
                f"the state of {self.name} is of {abs(tdb_s).max() / 86400.0:.0f} days from the observations; give one "
                "within 40 days"
            )
        span_s = (float(tdb_s.min() - count_s - _MARGIN_S), float(tdb_s.max() + count_s + _MARGIN_S))
        if self.landing is not None:  # data may end before
            span_s = (span_s[0], max(span_s[1], float(self.landing.epoch.seconds_since(self.epoch)[0])))
        self._require_acting(min(0.0, span_s[0]), max(0.0, span_s[1]))
        return AdjustableOrbit(
            self.epoch,
            self.state,
            self.forces,
            span_s,
            parameters,
            model.ephemeris,
            model.libration,
            self.name,
            touchdown=None if self.landing is None else self.landing.epoch,
        )

    def _require_acting(self, begin_s: float, end_s: float) -> None:
        """Refuse manoeuvres that are not on the arc at all, TDB seconds from the epoch."""
        forces = self.forces
        for kind, name, start, stop in (
            *(("impulses", one.name, one.epoch, one.epoch) for one in forces.impulses),
            *(("accelerations", one.name, one.start, one.stop) for one in forces.accelerations),
        ):
            late = start is not None and start.seconds_since(self.epoch)[0] > end_s
            if late or (stop is not None and stop.seconds_since(self.epoch)[0] < begin_s):
                first, last = utc_strings(self.epoch[[0, 0]].shifted(np.array([begin_s, end_s])), 0)
                raise InputError(
                    f"[[forces.{kind}]] {name} acts {'after' if late else 'before'} the arc, which is from {first} to "
                    f"{last} TDB (epoch and observations); correct its time, or leave it out"
                )
