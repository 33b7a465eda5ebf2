"""A target that flies: its state at an epoch and the forces on it, and what of them is estimated."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from radioloc.boundary import bare_fields
from radioloc.dynamics import BODIES, STATE, Acceleration, AdjustableOrbit, Forces, GravityField, Impulse
from radioloc.dynamics.disturbed import DisturbedOrbit
from radioloc.dynamics.elements import FORMS, equatorial_axes, state_of_elements
from radioloc.dynamics.gravity import SHIPPED
from radioloc.dynamics.gravity_errors import draw_gravity_errors, errors_along
from radioloc.dynamics.orbit import initial_state
from radioloc.ephemeris import CONSTANTS, Ephemeris, LunarOrientation
from radioloc.errors import InputError
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.parameters.orbit import RTN
from radioloc.studies.landing import Landing
from radioloc.studies.schema import TomlTable, check, entry
from radioloc.time import Epochs, epochs_from_strings, tt_to_tdb, utc_strings, utc_to_tt

EMPIRICAL = ("none", "constant", "once_per_revolution")
EMPIRICAL_NAME = "empirical"
EMPIRICAL_SIGMA_M_S2 = 3e-9
"""What a field to degree 150 leaves out at 50 km is some 1e-8 m/s2, little of it with the period of the orbit."""
GRAVITY_ERRORS = 12
"""Draws by which a sigma is good to a fifth."""
GRAVITY_ERROR_DEGREE = 200
_STATE_FORMS = {"rtn": RTN, **FORMS}
_NEAR_M = 66e6
"""The Moon's sphere of influence."""
_FASTEST_M_S = 3e3
"""What comes from the Earth, or goes there, has less left when it is far from the Moon."""
_SLOWEST = 0.005
"""Of the velocity of escape: what is slower falls."""
_MARGIN_S = 60.0
"""Beyond the first and the last tag: half of a count interval and the light time."""
_HIGHEST_M = 2e6
MOST_SEGMENTS = 1000
_LONGEST_ARC_S = 40.0 * 86400.0


def _gravity(table: TomlTable, key: str) -> str | Path | None:
    """A field that ships, by its name, or a file beside the study."""
    name = table.get(key, str)
    return name if name is None or name in SHIPPED else table.files(key, [name])[0]


@dataclass(frozen=True, slots=True)
class RoughOrbit:
    """What may be known of a nearly circular orbit about the Moon before there is a state.

    Parameters
    ----------
    altitude_m : float
        Above the sphere of the mean lunar radius, good to some 20 km.
    inclination_deg : float or None
        To the Moon's equator, 0 to 180 deg, good to some degrees.
    node_deg : float or None
        Longitude of the ascending node on the Moon's equator, counted eastward from the equator's own ascending node on
        the plane of the ICRF's x and y.
    """

    altitude_m: float
    inclination_deg: float | None = None
    node_deg: float | None = None

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


def _require_orbit(state: NDArray[np.float64]) -> None:
    """Raise an InputError of a velocity that no spacecraft near the Moon has."""
    distance_m, speed_m_s = np.linalg.norm(state.reshape(2, 3), axis=1).tolist()
    escape_m_s = math.sqrt(2.0 * CONSTANTS["DE421"].gm_m3_s2("moon") / distance_m)
    flies_past = distance_m < _NEAR_M and speed_m_s > math.hypot(escape_m_s, _FASTEST_M_S)
    if flies_past or speed_m_s < _SLOWEST * escape_m_s:
        raise InputError(
            f"velocity_m_s is {speed_m_s:.4g} m/s at {distance_m / 1e3:.0f} km from the Moon's centre, where orbits "
            f"are below {escape_m_s:.0f} m/s; is it in other units, or relative to another body?"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Orbiter:
    """A spacecraft about the Moon whose orbit follows from its state and the forces.

    Parameters
    ----------
    epoch : Epochs
        TDB, one.
    position_m, velocity_m_s : tuple of float or None
        A-priori state at the epoch relative to the Moon's centre, ICRF axes.
    forces : Forces
    name : str
        What it is called in messages and files, printable ASCII.
    gravity_errors : int
        How many drawn errors of the gravity field stand for all in the sigmas; zero leaves them out.
    gravity_error_degree : int
        To which degree: what the field leaves out is drawn by Kaula's rule.
    rough : RoughOrbit, optional
        In place of the state: it is then searched for.
    body : int
        NAIF code of the spacecraft in kernels, negative, such as -181.
    landing : Landing, optional
        Where its flight ends on the Moon.
    arcs_hours : float or None
        About how long arcs are, each with a state of its own and all with common forces; one arc where ``None``.
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
    arcs_hours: float | None = None

    def __post_init__(self) -> None:
        bare_fields(self)
        if self.position_m is not None and self.velocity_m_s is not None:
            _require_orbit(initial_state(self.position_m, self.velocity_m_s))
        if not (self.name.strip() and self.name.isascii() and self.name.isprintable()):
            raise InputError(f"name {self.name!r} cannot stand in orbit files; give printable ASCII text")
        if self.arcs_hours is not None and not 0.0 < self.arcs_hours < math.inf:
            raise InputError(f"arcs_hours must be above zero, not {self.arcs_hours!r}")
        if self.arcs_hours is not None and self.landing is not None:
            raise InputError(
                "arcs_hours: a flight that ends on the ground is one arc; leave it or landing out"
            )
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
        """An orbiter whose a-priori state has osculating elements.

        Parameters
        ----------
        epoch : Epochs
            TDB, one.
        elements : array_like, shape (6,)
            Named by ``KEPLERIAN`` or ``EQUINOCTIAL`` of :mod:`radioloc.dynamics.elements`; m and deg.
        forces : Forces
            Whose GM they belong to.
        axes : {"equator", "ICRF"}
            That angles are counted in: the Moon's equator at the epoch, from its ascending node on the ICRF's xy plane.
        form : {"keplerian", "equinoctial"}
        ephemeris, libration : str or path-like
            Of whose Moon, as of :meth:`~radioloc.measurements.PhysicalModel.build`.
        **rest
            Further parameters of the class.

        Raises
        ------
        InputError
            The elements are not those of an ellipse.
        """
        gm = forces.gm_m3_s2 or Ephemeris.open(ephemeris).constants.gm_m3_s2("moon")
        turned = np.eye(3) if axes == "ICRF" else equatorial_axes(LunarOrientation.open(libration), epoch)
        x, y, z, vx, vy, vz = state_of_elements(elements, gm, turned, form).tolist()
        return cls(epoch, (x, y, z), (vx, vy, vz), forces, **rest)

    def __repr__(self) -> str:
        known = "state" if self.rough is None else f"{self.rough}"
        return f"<Orbiter {self.name}, {known} at {self.epoch.day_strings()[0]}>"

    @property
    def state(self) -> NDArray[np.float64]:
        """Position, m, and velocity, m/s, shape (6,); an InputError of an orbiter without."""
        if self.position_m is None or self.velocity_m_s is None:
            raise InputError(
                f"{self.name} has no state before one was searched for; give position_m and velocity_m_s"
            )
        return np.array([*self.position_m, *self.velocity_m_s], dtype=np.float64)

    def at(self, state: NDArray[np.float64]) -> Orbiter:
        """The same with a state, shape (6,)."""
        x, y, z, vx, vy, vz = state.tolist()
        return replace(self, position_m=(x, y, z), velocity_m_s=(vx, vy, vz), rough=None)

    def disturbed(
        self, orbit: AdjustableOrbit, count: int | None = None, seed: Generator | int = 0
    ) -> DisturbedOrbit | None:
        """Its orbit with the errors of gravity that are considered, or with others, if there are any."""
        field, count = self.forces.gravity, self.gravity_errors if count is None else count
        if not count or field.degree < 2:
            return None
        errors = draw_gravity_errors(field, count, max(field.degree, self.gravity_error_degree), seed)
        return DisturbedOrbit(orbit, errors_along(orbit.nearest()[0], errors, orbit.libration).at)

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
            **({} if self.arcs_hours is None else {"arcs_hours": self.arcs_hours}),
            "forces": {
                "gravity": {"name": field.name, "degree": field.degree, "axes": field.frame},
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
        """The a-priori orbit over the observations, with partials by some parameters of the forces.

        The epoch of one that lands is the touchdown.
        """
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


@dataclass(frozen=True, slots=True)
class GivenAcceleration:
    """Keys of ``[[forces.accelerations]]``: an empirical acceleration, or the thrust of a finite manoeuvre.

    Parameters are those of :class:`~radioloc.dynamics.Acceleration`; dates are TDB. With `every_s` it is divided into
    segments of about this length, NAME.1, NAME.2 and so on, each with its own parameters.
    """

    name: str
    axes: str = entry("RTN", choices=("RTN", "ICRF"))
    constant_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    cosine_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sine_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    start: str | None = None
    stop: str | None = None
    sigma_m_s2: float | None = entry(None, positive=True)
    every_s: float | None = entry(None, positive=True)

    def __post_init__(self) -> None:
        check(self)

    def read(self) -> list[Acceleration]:
        """It, as a force, or as one for each of its segments."""
        given: dict[str, Any] = asdict(self)
        every_s = given.pop("every_s")
        for key in ("start", "stop"):
            given[key] = None if given[key] is None else epochs_from_strings(given[key], "TDB")
        whole = Acceleration(**given)
        if every_s is None:
            return [whole]
        if whole.start is None or whole.stop is None:
            raise InputError(f"acceleration {self.name}: every_s divides it from start to stop; give both")
        length_s = float(whole.stop.seconds_since(whole.start)[0])
        count = max(1, round(length_s / every_s))
        if count > MOST_SEGMENTS:
            raise InputError(
                f"acceleration {self.name}: every_s makes {count} segments; {MOST_SEGMENTS} are the most"
            )
        ends = [whole.start.shifted(length_s * k / count) for k in range(count)] + [whole.stop]
        return [
            replace(whole, name=f"{self.name}.{k + 1}", start=ends[k], stop=ends[k + 1]) for k in range(count)
        ]


@dataclass(frozen=True, slots=True)
class GivenImpulse:
    """Keys of ``[[forces.impulses]]``: a manoeuvre that changes the velocity at once; the epoch is TDB."""

    name: str
    epoch: str
    delta_v_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axes: str = entry("RTN", choices=("RTN", "ICRF"))

    def read(self) -> Impulse:
        """It, as a force."""
        given: dict[str, Any] = asdict(self)
        return Impulse(**given | {"epoch": epochs_from_strings(self.epoch, "TDB")})


@dataclass(frozen=True, slots=True)
class ForcesChoice:
    """What acts on an orbiter.

    Parameters
    ----------
    gravity : str
        ``"GRGM660PRIM"``, or the path of a gravity field of the Moon (ICGEM ``.gfc``, SHADR ``.tab``).
    degree : int or None
        Highest degree and order; all of the field where ``None``.
    gm_m3_s2 : float or None
        GM of the Moon; that of the ephemeris where ``None``.
    bodies : tuple of str
        Point masses beside the Moon.
    tides : bool
        Whether Earth and Sun raise tides on the Moon.
    k2 : float or None
        Their Love number, where it is not that of :class:`~radioloc.dynamics.Forces`.
    figures, relativity : bool
        The figures of Earth and Moon under the other's pull; post-Newtonian terms.
    radiation_m2_kg : float
        C_R A/m of sunlight, m2/kg; zero leaves it out.
    moonlight : bool
        Whether light and heat of the Moon's ground press, too.
    empirical : {"none", "constant", "once_per_revolution"}
        Empirical acceleration along radial, transverse and normal, zero a priori, to be estimated.
    accelerations, impulses : tuple
        Thrust, further empirical accelerations and manoeuvres.
    gradient_degree : int or None
        Highest degree of the harmonics in the partials; that of the field where ``None``.
    gravity_errors, gravity_error_degree : int
        As of :class:`Orbiter`.
    """

    gravity: str | Path = entry("GRGM660PRIM", read=_gravity)
    degree: int | None = entry(None, positive=True)
    gm_m3_s2: float | None = entry(None, positive=True)
    bodies: tuple[str, ...] = BODIES
    tides: bool = True
    k2: float | None = None
    figures: bool = True
    relativity: bool = True
    radiation_m2_kg: float = entry(0.0, not_negative=True)
    moonlight: bool = True
    empirical: str = entry("none", choices=EMPIRICAL)
    accelerations: tuple[GivenAcceleration, ...] = ()
    impulses: tuple[GivenImpulse, ...] = ()
    gradient_degree: int | None = None
    gravity_errors: int = entry(GRAVITY_ERRORS, not_negative=True)
    gravity_error_degree: int = entry(GRAVITY_ERROR_DEGREE, positive=True)

    def __post_init__(self) -> None:
        check(self)

    def forces(self) -> Forces:
        """What acts, with its gravity field read."""
        accelerations = [segment for one in self.accelerations for segment in one.read()]
        if self.empirical != "none":
            accelerations.append(Acceleration(EMPIRICAL_NAME))
        k2 = {} if self.k2 is None and self.tides else {"k2": (self.k2 or 0.0) * self.tides}
        field = GravityField.open(self.gravity, self.degree)
        return Forces(
            field,
            gm_m3_s2=self.gm_m3_s2,
            bodies=self.bodies,
            **k2,
            figures=self.figures,
            relativity=self.relativity,
            radiation_m2_kg=self.radiation_m2_kg,
            moonlight=self.moonlight,
            accelerations=tuple(accelerations),
            impulses=tuple(one.read() for one in self.impulses),
            gradient_degree=field.degree if self.gradient_degree is None else self.gradient_degree,
        )


@dataclass(frozen=True, slots=True)
class ProcessNoise:
    """Keys of ``[estimate.orbit] process_noise``: stochastic accelerations, constant over intervals from the epoch on.

    Parameters
    ----------
    radial_m_s2, along_m_s2, across_m_s2 : float
        Their sigmas.
    interval_s : float
        For how long each lasts.
    correlation_s : float
        Correlation time (first-order Gauss-Markov); zero where each interval's is independent of the others.
    """

    radial_m_s2: float = entry(0.0, not_negative=True)
    along_m_s2: float = entry(0.0, not_negative=True)
    across_m_s2: float = entry(0.0, not_negative=True)
    interval_s: float = entry(600.0, positive=True)
    correlation_s: float = entry(0.0, not_negative=True)

    def __post_init__(self) -> None:
        check(self)
        if not any(self.sigma_m_s2):
            raise InputError(
                "process_noise needs a sigma above zero: radial_m_s2, along_m_s2 or across_m_s2; docs/dynamics.md has "
                "sizes"
            )

    @property
    def sigma_m_s2(self) -> NDArray[np.float64]:
        """Radial, along, across, shape (3,)."""
        return np.array([self.radial_m_s2, self.along_m_s2, self.across_m_s2])

    @property
    def persistence(self) -> float:
        """Correlation of an acceleration with that of the next interval."""
        return math.exp(-self.interval_s / self.correlation_s) if self.correlation_s else 0.0


@dataclass(frozen=True, slots=True)
class OrbitChoice:
    """Keys of ``[estimate.orbit]``: what is estimated of an orbit.

    Parameters
    ----------
    state : bool
        Whether the state at the epoch is.
    state_sigma_m, state_sigma_m_s : float or None
        A-priori sigmas of each component; free where ``None``.
    state_sigma : mapping of str to float
        In their place sigmas by name, of one of three forms, whose components then are the parameters: radial, along
        and across (``radial_m`` to ``across_m_s``), Keplerian or equinoctial elements to the Moon's equator
        (:data:`~radioloc.dynamics.elements.FORMS`). What is left out is free.
    touchdown_sigma_m_s : float
        A-priori sigma of each component of the velocity at a touchdown, relative to the ground and zero a priori.
    forces : tuple of str or None
        Names of parameters of the forces (:meth:`~radioloc.dynamics.Forces.parameters`), or of accelerations and
        impulses, all components of which then are. By default the radiation coefficient and the empirical
        acceleration, where there are such, and all given impulses.
    sigma : mapping of str to float
        Their a-priori sigmas by the same names, SI units. By default of the radiation coefficient half its value, of
        the empirical acceleration 3e-9 m/s2; all others are free.
    process_noise : ProcessNoise or None
        Stochastic accelerations. They take the place of weights that allow for correlation in time, and of considered
        errors of the gravity field.
    """

    state: bool = True
    state_sigma_m: float | None = entry(None, positive=True)
    state_sigma_m_s: float | None = entry(None, positive=True)
    state_sigma: Mapping[str, float] = entry(factory=dict, positive=True)
    touchdown_sigma_m_s: float = entry(1.0, positive=True)
    forces: tuple[str, ...] | None = None
    sigma: Mapping[str, float] = entry(factory=dict, positive=True)
    process_noise: ProcessNoise | None = None

    def __post_init__(self) -> None:
        check(self)
        if self.state_sigma and (self.state_sigma_m or self.state_sigma_m_s):
            raise InputError(
                "[estimate.orbit] state_sigma: give either it or state_sigma_m and state_sigma_m_s"
            )
        if self.state_sigma and self.form == "cartesian":
            known = "; ".join(", ".join(names) for names in _STATE_FORMS.values())
            raise InputError(
                f"[estimate.orbit] state_sigma: {', '.join(self.state_sigma)} are not of one form; there are {known}"
            )

    @property
    def form(self) -> str:
        """Of the state's parameters: that of the sigmas' names."""
        fits = (form for form, names in _STATE_FORMS.items() if {*self.state_sigma} <= {*names})
        return next(fits, "cartesian") if self.state_sigma else "cartesian"

    def parameters(self, forces: Forces) -> tuple[str, ...]:
        """Parameters of the forces that are estimated; an InputError where a name is of none."""
        known = forces.parameters()
        groups = tuple(dict.fromkeys(one.rpartition(".")[0] or one for one in known))
        asked = self.forces
        if asked is None:
            impulses = tuple(one.name for one in forces.impulses)
            asked = (*(("radiation",) if forces.radiation_m2_kg else ()), *impulses)
            asked += (EMPIRICAL_NAME,) if EMPIRICAL_NAME in groups else ()
        found: dict[str, None] = {}
        for one in forces.accelerations:
            found |= dict.fromkeys(one.names()[0] if one.sigma_m_s2 is not None else ())
        for name in (*asked, *self.sigma):
            mine = [one for one in known if one == name or one.rpartition(".")[0] == name]
            if not mine:
                raise InputError(
                    f"[estimate.orbit] forces: there is no {name!r}; there are {', '.join(groups)}"
                )
            found |= dict.fromkeys(mine) if name in asked else {}
        return tuple(found)

    def sigmas(self, forces: Forces) -> dict[str, float]:
        """A-priori sigmas of all parameters that have one."""
        given = dict(self.sigma)
        if forces.radiation_m2_kg:
            given.setdefault("radiation", 0.5 * forces.radiation_m2_kg)
        given.setdefault(EMPIRICAL_NAME, EMPIRICAL_SIGMA_M_S2)
        for one in forces.accelerations:
            given |= {} if one.sigma_m_s2 is None else dict.fromkeys(one.names()[0], one.sigma_m_s2)
        state = dict.fromkeys(STATE[:3], self.state_sigma_m) | dict.fromkeys(STATE[3:], self.state_sigma_m_s)
        by_name = {one: given.get(one, given.get(one.rpartition(".")[0])) for one in self.parameters(forces)}
        by_name |= self.state_sigma or state
        return {name: sigma for name, sigma in by_name.items() if sigma is not None}
