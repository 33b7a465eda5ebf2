"""Tables of a study file for orbits: forces, and parameters to be estimated."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from radioloc.dynamics import BODIES, STATE, Acceleration, Forces, GravityField, Impulse
from radioloc.dynamics.elements import ELEMENT_NAMES
from radioloc.dynamics.gravity import PACKAGED
from radioloc.errors import InputError
from radioloc.study.orbiter import GRAVITY_ERROR_DEGREE, GRAVITY_ERRORS
from radioloc.study.schema import TomlTable, check, entry
from radioloc.targets.orbit import RTN
from radioloc.vectors import Floats

EMPIRICAL = ("none", "constant", "once_per_revolution")
EMPIRICAL_NAME = "empirical"
EMPIRICAL_SIGMA_M_S2 = 3e-9
"""A field to degree 150 leaves out some 1e-8 m/s2 at 50 km, little of it with the period of the orbit."""
MAX_SEGMENT_COUNT = 1000  # of an acceleration
_STATE_FORMS = {"rtn": RTN, **ELEMENT_NAMES}


def _gravity(table: TomlTable, key: str) -> str | Path | None:
    """Return the name of a field that ships, or the path of a file beside the study."""
    name = table.get(key, str)
    return name if name is None or name in PACKAGED else table.files(key, [name])[0]


@dataclass(frozen=True, slots=True, eq=False)
class SegmentedAcceleration(Acceleration):
    """Keys of ``[[forces.accelerations]]``; `every_s` divides it into segments NAME.1, NAME.2, ..."""

    normal: tuple[float, float, float] | None = entry(None, keys=(), read=lambda *_: None)
    sigma_m_s2: float | None = entry(None, positive=True)
    every_s: float | None = entry(None, positive=True)

    def __post_init__(self) -> None:
        Acceleration.__post_init__(self)
        check(self)

    def segments(self) -> list[Acceleration]:
        """Return the acceleration, or one for each of its segments."""
        settings = {f.name: getattr(self, f.name) for f in fields(Acceleration)}
        if self.every_s is None:
            return [Acceleration(**settings)]
        if self.start is None or self.stop is None:
            raise InputError(f"acceleration {self.name}: every_s needs start and stop; give both")
        length_s = float(self.stop.seconds_since(self.start)[0])
        segment_count = max(1, round(length_s / self.every_s))
        if segment_count > MAX_SEGMENT_COUNT:
            raise InputError(
                f"acceleration {self.name}: expected at most {MAX_SEGMENT_COUNT} segments, got {segment_count}; "
                "give a longer every_s"
            )
        ends = [self.start.shifted(length_s * k / segment_count) for k in range(segment_count)] + [self.stop]
        return [
            Acceleration(**settings | {"name": f"{self.name}.{k + 1}", "start": ends[k], "stop": ends[k + 1]})
            for k in range(segment_count)
        ]


@dataclass(frozen=True, slots=True)
class ForcesChoice:
    """Keys of ``[forces]``, as the reference of the study file describes them."""

    gravity: str | Path = entry("GRGM660PRIM", read=_gravity)
    gravity_axes: str | None = None
    gravity_tide_system: str | None = entry(None, choices=("tide_free", "zero_tide"))
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
    accelerations: tuple[SegmentedAcceleration, ...] = ()
    impulses: tuple[Impulse, ...] = ()
    gradient_degree: int | None = None
    gravity_errors: int = entry(GRAVITY_ERRORS, not_negative=True)
    gravity_error_degree: int = entry(GRAVITY_ERROR_DEGREE, positive=True)

    def __post_init__(self) -> None:
        check(self)

    def forces(self) -> Forces:
        """Return the forces, with the gravity field read."""
        field = GravityField.open(self.gravity, self.degree, self.gravity_axes, self.gravity_tide_system)
        acting = {f.name: getattr(self, f.name) for f in fields(Forces) if f.name != "k2"}
        if self.k2 is not None or not self.tides:
            acting["k2"] = (self.k2 or 0.0) * self.tides
        accelerations = [segment for item in self.accelerations for segment in item.segments()]
        if self.empirical != "none":
            accelerations.append(Acceleration(EMPIRICAL_NAME))
        gradient_degree = field.degree if self.gradient_degree is None else self.gradient_degree
        return Forces(
            **acting
            | {"gravity": field, "accelerations": tuple(accelerations), "gradient_degree": gradient_degree}
        )


@dataclass(frozen=True, slots=True)
class ProcessNoise:
    """Keys of ``[estimate.orbit] process_noise``: sigmas of accelerations that are constant over intervals."""

    radial_m_s2: float = entry(0.0, not_negative=True)
    along_m_s2: float = entry(0.0, not_negative=True)
    across_m_s2: float = entry(0.0, not_negative=True)
    interval_s: float = entry(60.0, positive=True)
    correlation_s: float = entry(0.0, not_negative=True)

    def __post_init__(self) -> None:
        check(self)
        if not any(self.sigma_m_s2):
            raise InputError(
                "process_noise needs a sigma above zero: radial_m_s2, along_m_s2 or across_m_s2; docs/dynamics.md has "
                "sizes"
            )

    @property
    def sigma_m_s2(self) -> Floats:
        """Sigmas of the radial, along and across accelerations, m/s2, shape (3,)."""
        return np.array([self.radial_m_s2, self.along_m_s2, self.across_m_s2])

    @property
    def velocity_within_m_s(self) -> float:
        """Rms departure of the velocity from its course by constant accelerations, m/s, for white noise."""
        # White noise of the spectral density S = sigma^2 T makes the velocity within an interval T a Brownian bridge
        # about that course, of the mean variance S T / 6. A Gauss-Markov process longer than an interval is smooth.
        is_white = self.correlation_s < self.interval_s
        return float(self.sigma_m_s2.max()) * self.interval_s / math.sqrt(6.0) * is_white

    @property
    def persistence(self) -> float:
        """Correlation of an acceleration with that of the next interval."""
        return math.exp(-self.interval_s / self.correlation_s) if self.correlation_s else 0.0


@dataclass(frozen=True, slots=True)
class OrbitChoice:
    """Keys of ``[estimate.orbit]``, as the reference of the study file describes them."""

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
                "[estimate.orbit]: give either state_sigma, or state_sigma_m and state_sigma_m_s"
            )
        if self.state_sigma and self.form == "cartesian":
            forms = "; ".join(", ".join(names) for names in _STATE_FORMS.values())
            raise InputError(
                f"[estimate.orbit] state_sigma: expected keys of one form ({forms}), got {', '.join(self.state_sigma)}"
            )

    @property
    def form(self) -> str:
        """Form of the state's parameters, as named by the sigmas."""
        fits = (form for form, names in _STATE_FORMS.items() if {*self.state_sigma} <= {*names})
        return next(fits, "cartesian") if self.state_sigma else "cartesian"

    def parameters(self, forces: Forces) -> tuple[str, ...]:
        """Return the estimated parameters of the forces; an unknown name is an InputError."""
        names = forces.parameters()
        groups = tuple(dict.fromkeys(item.rpartition(".")[0] or item for item in names))
        chosen_names = self.forces
        if chosen_names is None:
            impulses = tuple(item.name for item in forces.impulses)
            chosen_names = (*(("radiation",) if forces.radiation_m2_kg else ()), *impulses)
            chosen_names += (EMPIRICAL_NAME,) if EMPIRICAL_NAME in groups else ()
        selected: dict[str, None] = {}
        for acceleration in forces.accelerations:
            selected |= dict.fromkeys(acceleration.names()[0] if acceleration.sigma_m_s2 is not None else ())
        for name in (*chosen_names, *self.sigma):
            matches = [
                parameter for parameter in names if parameter == name or parameter.rpartition(".")[0] == name
            ]
            if not matches:
                raise InputError(
                    f"[estimate.orbit] forces: expected some of {', '.join(groups)}, got {name!r}"
                )
            selected |= dict.fromkeys(matches) if name in chosen_names else {}
        return tuple(selected)

    def sigmas(self, forces: Forces) -> dict[str, float]:
        """Return the a-priori sigmas of all parameters that have one."""
        sigmas = dict(self.sigma)
        if forces.radiation_m2_kg:
            sigmas.setdefault("radiation", 0.5 * forces.radiation_m2_kg)
        sigmas.setdefault(EMPIRICAL_NAME, EMPIRICAL_SIGMA_M_S2)
        for acceleration in forces.accelerations:
            sigmas |= (
                {}
                if acceleration.sigma_m_s2 is None
                else dict.fromkeys(acceleration.names()[0], acceleration.sigma_m_s2)
            )
        state = dict.fromkeys(STATE[:3], self.state_sigma_m) | dict.fromkeys(STATE[3:], self.state_sigma_m_s)
        by_name = {
            parameter: sigmas.get(parameter, sigmas.get(parameter.rpartition(".")[0]))
            for parameter in self.parameters(forces)
        }
        by_name |= self.state_sigma or state
        return {name: sigma for name, sigma in by_name.items() if sigma is not None}
