"""Orbiters as targets of a study: state at an epoch, forces, and landing."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

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
from radioloc.units import set_fields
from radioloc.vectors import Floats

AXES = ("equator", "ICRF")  # Reference axes of the angles of elements
GRAVITY_ERRORS = 12  # Draws that determine a sigma to a fifth
GRAVITY_ERROR_DEGREE = 200
_SPHERE_OF_INFLUENCE_M = 66e6  # The Moon's sphere of influence
_MAX_HYPERBOLIC_EXCESS_M_S = 3e3  # Translunar trajectories have less
_MIN_SPEED_RATIO = 0.005  # Lowest plausible ratio of speed to escape velocity; a slower spacecraft falls
_SPAN_MARGIN_S = 60.0  # Half a count interval and the light time, beyond the first and the last tag
_MAX_ROUGH_ALTITUDE_M = 2e6  # The search for a first orbit assumes a low one
_MAX_ARC_S = 40.0 * 86400.0
_MIN_END_HEIGHT_M, _MAX_END_HEIGHT_M = -20e3, 25e3
"""Heights of the end of an a-priori trajectory: those of the ground, with a margin for errors of the thrust."""
_MAX_END_DISTANCE_M = 200e3  # from the a-priori place


@dataclass(frozen=True, slots=True)
class RoughOrbit:
    """Nearly circular orbit before a state is known; angles refer to the Moon's equator."""

    altitude_m: float
    inclination_deg: float | None = None
    node_deg: float | None = None  # from the equator's ascending node on the ICRF's xy plane

    def __post_init__(self) -> None:
        if not 0.0 < self.altitude_m <= _MAX_ROUGH_ALTITUDE_M:
            raise InputError(
                f"altitude_m: expected more than 0 and at most {_MAX_ROUGH_ALTITUDE_M:g} m, got {self.altitude_m!r}"
            )
        if self.inclination_deg is not None and not 0.0 <= self.inclination_deg <= 180.0:
            raise InputError(f"inclination_deg: expected 0 to 180 deg, got {self.inclination_deg!r}")
        if self.node_deg is not None and not -360.0 <= self.node_deg <= 360.0:
            raise InputError(f"node_deg: expected -360 to 360 deg, got {self.node_deg!r}")

    def __str__(self) -> str:
        plane = {"inclination": self.inclination_deg, "node": self.node_deg}
        parts = [f", {name} {value:g} deg" for name, value in plane.items() if value is not None]
        return f"an altitude of {self.altitude_m / 1e3:g} km{''.join(parts)}"

    @property
    def in_plane(self) -> bool:
        """Return whether inclination and node are given."""
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
            raise InputError(f"epoch of the landing: expected one, got {len(self.epoch)}")

    def __str__(self) -> str:
        return f"touchdown at {utc_strings(self.epoch, 3)[0]} TDB"

    def place_pa_m(self, model: PhysicalModel) -> Floats | None:
        """Return the a-priori place in principal axes, m, if one is given."""
        return None if self.place is None else self.place.to_axes("PA", model.ephemeris.constants).xyz_m

    def forces(self, forces: Forces, epoch: Epochs, state: Floats) -> Forces:
        """Return forces along axes of the a-priori plane, as the orbit's own vanish with the velocity."""
        for item in forces.accelerations:
            for epoch_tdb in (item.start, item.stop):
                if epoch_tdb is not None and not (
                    epoch_tdb.seconds_since(epoch)[0] >= 0.0 and self.epoch.seconds_since(epoch_tdb)[0] >= 0.0
                ):
                    raise InputError(
                        f"acceleration {item.name} starts or stops at {utc_strings(epoch_tdb, 3)[0]} TDB, which is not "
                        f"between the epoch of the state, {utc_strings(epoch, 3)[0]}, and the {self}; correct its "
                        "times"
                    )
        normal = np.cross(state[:3], state[3:])
        x, y, z = (normal / np.linalg.norm(normal)).tolist()
        return replace(
            forces, accelerations=tuple(replace(item, normal=(x, y, z)) for item in forces.accelerations)
        )

    def at_rest(self, flight: AdjustableOrbit, model: PhysicalModel) -> AdjustableOrbit:
        """Return the orbit that comes to rest at the a-priori place."""
        ground, place_pa_m = Ground(model, self.epoch), self.place_pa_m(model)
        if place_pa_m is None:
            place_pa_m = ground.place_pa_m(self.landed(flight, model).state)
        return flight.with_epoch(self.epoch, ground.at_rest(place_pa_m))

    def landed(self, flight: AdjustableOrbit, model: PhysicalModel) -> AdjustableOrbit:
        """Return the a-priori orbit with its state at the touchdown, which an InputError requires near the ground."""
        landed = flight.with_epoch(self.epoch)
        end_pa_m = Ground(model, self.epoch).place_pa_m(landed.state)
        height_m, place_pa_m = float(np.linalg.norm(end_pa_m)) - MEAN_LUNAR_RADIUS_M, self.place_pa_m(model)
        problem = ""
        if not _MIN_END_HEIGHT_M < height_m < _MAX_END_HEIGHT_M:
            problem = f"{height_m / 1e3:.1f} km above the sphere of 1737.4 km"
        elif (
            place_pa_m is not None
            and (away_m := float(np.linalg.norm(end_pa_m - place_pa_m))) > _MAX_END_DISTANCE_M
        ):
            problem = f"{away_m / 1e3:.0f} km from the a-priori place"
        if problem:
            raise InputError(
                f"the a-priori trajectory of {flight.name} is {problem} at the {self}; correct its state, the "
                "accelerations or the epoch of [target.landing]"
            )
        return landed


def _require_orbit(state: Floats) -> None:
    """Require a plausible velocity of a spacecraft near the Moon."""
    distance_m, speed_m_s = np.linalg.norm(state.reshape(2, 3), axis=1).tolist()
    escape_m_s = math.sqrt(2.0 * CONSTANTS["DE421"].gm_m3_s2("moon") / distance_m)
    flies_past = distance_m < _SPHERE_OF_INFLUENCE_M and speed_m_s > math.hypot(
        escape_m_s, _MAX_HYPERBOLIC_EXCESS_M_S
    )
    if flies_past or speed_m_s < _MIN_SPEED_RATIO * escape_m_s:
        raise InputError(
            f"velocity_m_s: expected less than {escape_m_s:.0f} m/s at {distance_m / 1e3:.0f} km from the Moon's "
            f"centre, got {speed_m_s:.4g} m/s; check its unit, and that it is relative to the Moon"
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
            raise InputError(f"name: expected printable ASCII text, as orbit files need, got {self.name!r}")
        if not -(2**31) < self.body < 0:
            raise InputError(
                f"body: expected a negative NAIF code of a spacecraft such as -181, got {self.body!r}"
            )
        self.epoch.require("TDB")
        if (self.rough is None) == (self.position_m is None) or (self.position_m is None) != (
            self.velocity_m_s is None
        ):
            raise InputError("give either position_m and velocity_m_s, or a rough orbit, altitude_m")
        if len(self.epoch) != 1:
            raise InputError(f"epoch: expected one, got {len(self.epoch)}")
        if self.landing is not None:
            if not self.landing.epoch.seconds_since(self.epoch)[0] > 0.0:
                raise InputError(
                    f"the {self.landing} is not after the epoch of the state; correct one of them"
                )
            set_fields(self, forces=self.landing.forces(self.forces, self.epoch, self.state))

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
        **fields: Any,
    ) -> Orbiter:
        """Return an orbiter from osculating elements, m and deg, with angles to the Moon's equator or to the ICRF."""
        if axes not in AXES:
            raise InputError(f"axes of the elements: expected {' or '.join(AXES)}, got {axes!r}")
        gm = forces.gm_m3_s2 or Ephemeris.open(ephemeris).constants.gm_m3_s2("moon")
        rot_icrf_to_axes = (
            np.eye(3) if axes == "ICRF" else equatorial_axes(LunarOrientation.open(libration), epoch)
        )
        x, y, z, vx, vy, vz = state_from_elements(elements, gm, rot_icrf_to_axes, form).tolist()
        return cls(epoch, (x, y, z), (vx, vy, vz), forces, **fields)

    def __repr__(self) -> str:
        content = "state" if self.rough is None else f"{self.rough}"
        return f"<Orbiter {self.name}, {content} at {self.epoch.day_strings()[0]}>"

    @property
    def state(self) -> Floats:
        """Position, m, and velocity, m/s, shape (6,); an InputError for a rough orbit."""
        if self.position_m is None or self.velocity_m_s is None:
            raise InputError(
                f"[target] altitude_m: expected an a-priori state of {self.name}, got a rough orbit; `radioloc search "
                "STUDY.toml --out completed.toml` finds a state, or give position_m and velocity_m_s, or elements"
            )
        return np.array([*self.position_m, *self.velocity_m_s], dtype=np.float64)

    def with_state(self, state: Floats) -> Orbiter:
        """Return the orbiter with a state, shape (6,)."""
        x, y, z, vx, vy, vz = state.tolist()
        return replace(self, position_m=(x, y, z), velocity_m_s=(vx, vy, vz), rough=None)

    def with_gravity_errors(
        self, orbit: AdjustableOrbit, count: int | None = None, seed: Generator | int = 0
    ) -> AdjustableOrbit | None:
        """Return the orbit with drawn errors of gravity, by default the considered ones; None without any."""
        return GravityErrors(self.gravity_errors, self.gravity_error_degree).draw(orbit, count, seed)

    def record(self) -> dict[str, Any]:
        """Return state and forces, in types that JSON has."""
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
        if flight.span_s[0] + _SPAN_MARGIN_S > self.landing.epoch.seconds_since(self.epoch)[0]:
            raise InputError(
                f"the {self.landing} is before all observations; with none of the flight, locate the place as a "
                "[target] with longitude_deg, latitude_deg and height_m"
            )
        return self.landing.landed(flight, model)

    def orbit_spanning(
        self, model: PhysicalModel, utc: Epochs | None, count_s: float, parameters: tuple[str, ...] = ()
    ) -> AdjustableOrbit:
        """Return the true orbit over a span of time tags; one that lands comes to rest at its place."""
        flight = self._flight(model, utc, count_s, parameters)
        return flight if self.landing is None else self.landing.at_rest(flight, model)

    def _flight(
        self, model: PhysicalModel, utc: Epochs | None, count_s: float, parameters: tuple[str, ...]
    ) -> AdjustableOrbit:
        """Return the orbit from the state at the epoch over a span of time tags, or of none."""
        tdb_s = np.zeros(1) if utc is None else tt_to_tdb(utc_to_tt(utc)).seconds_since(self.epoch)
        if abs(tdb_s).max() > _MAX_ARC_S:
            raise InputError(
                f"[target] epoch: expected a state of {self.name} within 40 days of the observations, got one "
                f"{abs(tdb_s).max() / 86400.0:.0f} days off"
            )
        span_s = (
            float(tdb_s.min() - count_s - _SPAN_MARGIN_S),
            float(tdb_s.max() + count_s + _SPAN_MARGIN_S),
        )
        if self.landing is not None:  # The observations may end before the touchdown
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
        """Require manoeuvres that act within the arc, TDB seconds from the epoch."""
        forces = self.forces
        for kind, name, start, stop in (
            *(("impulses", item.name, item.epoch, item.epoch) for item in forces.impulses),
            *(("accelerations", item.name, item.start, item.stop) for item in forces.accelerations),
        ):
            late = start is not None and start.seconds_since(self.epoch)[0] > end_s
            if late or (stop is not None and stop.seconds_since(self.epoch)[0] < begin_s):
                first, last = utc_strings(self.epoch[[0, 0]].shifted(np.array([begin_s, end_s])), 0)
                raise InputError(
                    f"[[forces.{kind}]] {name} acts {'after' if late else 'before'} the arc, which is from {first} to "
                    f"{last} TDB (epoch and observations); correct its time, or leave it out"
                )
