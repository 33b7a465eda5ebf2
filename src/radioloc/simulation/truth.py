"""Differences between the simulated world and the model of the fit: terms, and errors of parameters, fixed and drawn.

The parameters are those of the registry (:data:`~radioloc.parameters.registry.PARAMETERS`). Their errors act to first
order, by the design matrix; the rest is below 0.2 mm for errors up to the limits given here.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from radioloc.dynamics import AdjustableOrbit
from radioloc.ephemeris.trajectory import SpacecraftTrajectory
from radioloc.errors import InputError
from radioloc.lunar import rot_pa_to_me
from radioloc.lunar.local import EAST_NORTH_UP, rot_pa_to_enu
from radioloc.measurements.physical_model import PhysicalModel, active_terms
from radioloc.measurements.predictor import Prediction, Predictor, blocks
from radioloc.measurements.target_motion import (
    FixedPoint,
    MotionLike,
    TargetMotion,
    TrajectoryMotion,
    as_motion,
)
from radioloc.parameters.choice import ParameterChoice, chosen_parameters
from radioloc.parameters.kind import Scope
from radioloc.parameters.parameter import Parameter, Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import ObservationRows
from radioloc.quantities import DateLike, accepts_quantities
from radioloc.simulation.noise import generator
from radioloc.targets.design import DesignMatrix, ObservationModel
from radioloc.targets.surface_point import SurfacePoint, cartesian
from radioloc.targets.target import TargetDescription
from radioloc.time import epochs_from_strings, utc_to_tai
from radioloc.units import set_fields
from radioloc.vectors import Floats, Indices

_MAX_ERRORS = {
    "clock": (0.01, "the curvature of a range then is below 4 micrometres"),
    "time_bias": (0.01, "the curvature of a range then is below 4 micrometres"),
    "clock_rate": (1e-8, "its clock then stays within 0.01 s for days"),
    "station_position": (200.0, "the square of it over the distance then is below 0.2 mm"),
    "moon_position": (200.0, "the square of it over the distance then is below 0.2 mm"),
    "libration": (1e-5, "the square of it times the radius then is below 0.2 mm"),
    "pole": (5e-6, "the square of it times the radius then is below 0.2 mm"),
    "ut1": (0.07, "the square of the angle times the radius then is below 0.2 mm"),
}
_MAX_ERRORS |= {f"{name}_variation": _MAX_ERRORS[name] for name in ("moon_position", "libration")}
"""Largest errors for which the first order suffices, in units of the kinds, with the reason."""
GRAVITY_ERROR = "gravity_error"  # name of drawn errors of gravity, before their number


@dataclass(frozen=True, slots=True, init=False)
class Truth:
    """Differences of the simulated world from the nominal model, real minus modelled.

    Keywords are errors of parameters by the keys of their a-priori values in a study file, such as ``range_bias_m``:
    a number, or one for each component, for all members or in a mapping by name; and their scopes, such as
    ``clock_per="pass"``. Names of stations are those of the catalogue or aliases; stations without observations are
    ignored.
    """

    values: Mapping[str, ParameterChoice]  #: errors by kind of parameter
    terms_on: tuple[str, ...]  #: terms (TERMS) of the world that the model lacks
    terms_off: tuple[str, ...]  #: terms of the model that the world lacks
    #: Epoch of the offsets of clocks and frequencies with a rate; the middle of the sessions if None.
    clock_epoch_utc: str | None

    @accepts_quantities
    def __init__(
        self,
        *,
        terms_on: Iterable[str] = (),
        terms_off: Iterable[str] = (),
        clock_epoch_utc: DateLike | None = None,
        **values: Any,
    ) -> None:
        set_fields(
            self,
            values=_choices(values),
            terms_on=tuple(terms_on),
            terms_off=tuple(terms_off),
            clock_epoch_utc=clock_epoch_utc,
        )
        active_terms((*self.terms_on, *self.terms_off))  # raises an error for unknown names

    def model(self, nominal: PhysicalModel) -> PhysicalModel:
        """Return the nominal model with the world's terms."""
        terms = (nominal.terms | set(self.terms_on)) - set(self.terms_off)
        return nominal if terms == nominal.terms else nominal.with_terms(terms)


@dataclass(frozen=True, slots=True, init=False)
class TruthSigma:
    """Standard deviations of errors about the truth, drawn anew in every trial, by the keywords of :class:`Truth`."""

    sigmas: Mapping[str, ParameterChoice]
    #: Of each point about its nominal position, east, north and up (selenocentric): up is the error of a terrain map
    #: if the study has an a-priori height.
    position_enu_m: tuple[float, float, float]
    clock_epoch_utc: str | None
    #: Number of drawn error fields that the gravity error of an orbiter's trial combines; zero for no gravity error.
    gravity_errors: int
    #: Whether errors that the fit considers are drawn with its sigmas where nothing is stated.
    considered: bool

    @accepts_quantities
    def __init__(
        self,
        *,
        position_enu_m: Iterable[float] = (0.0, 0.0, 0.0),
        gravity_errors: int = 0,
        considered: bool = True,
        clock_epoch_utc: DateLike | None = None,
        **sigmas: Any,
    ) -> None:
        east, north, up = (float(sigma) for sigma in position_enu_m)
        if not (min(east, north, up) >= 0.0 and max(east, north, up) <= 200.0):
            raise InputError(f"position_enu_m: expected sigmas from 0 to 200 m, got {(east, north, up)!r}")
        if isinstance(gravity_errors, bool) or not isinstance(gravity_errors, int) or gravity_errors < 0:
            raise InputError(f"gravity_errors: expected a whole number from zero up, got {gravity_errors!r}")
        set_fields(
            self,
            gravity_errors=gravity_errors,
            considered=considered,
            sigmas=_choices(sigmas, sigma=True),
            position_enu_m=(east, north, up),
            clock_epoch_utc=clock_epoch_utc,
        )

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the errors that are stated here."""
        position = ("position_enu_m",) if any(self.position_enu_m) else ()
        return (
            *position,
            *(("gravity_errors",) if self.gravity_errors else ()),
            *(PARAMETERS[k].value_key for k, choice in self.sigmas.items() if any(_numbers(choice.value))),
        )


@dataclass(frozen=True, slots=True, eq=False)
class DrawnErrors:
    """Drawn errors: one standard normal number for each of k parameters."""

    names: tuple[str, ...]
    sigmas: Floats
    partials: Floats  # of the observed values by the parameters, shape (k, n)

    def draw(self, seed: int) -> Floats:
        """Return the errors of a trial by its seed, shape (k,); they do not depend on the other parameters."""
        normal = [generator(seed, f"truth_sigma {name}").standard_normal() for name in self.names]
        return self.sigmas * np.array(normal)

    def with_gravity(self, effects: Floats) -> DrawnErrors:
        """Return the errors together with errors of gravity, whose effects on the values by one sigma are (n, k)."""
        count = effects.shape[1]
        return DrawnErrors(
            (*self.names, *(f"{GRAVITY_ERROR}.{k + 1}" for k in range(count))),
            np.concatenate([self.sigmas, np.ones(count)]),
            np.concatenate([self.partials, effects.T]),
        )

    def rows(self, rows: Indices) -> DrawnErrors:
        """Return the errors for some of the observations."""
        return replace(self, partials=self.partials[:, rows])

    def by_name(self, errors: Floats) -> dict[str, float]:
        """Return drawn errors by parameter."""
        return dict(zip(self.names, errors.tolist(), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class TrueTarget:
    """A target of a simulated world."""

    name: str  # in the observations
    # True position, principal axes, shape (3,); of a spacecraft the offset from its trajectory, zeros.
    position_pa_m: Floats
    enu_pa: Floats  # east, north and up at the position, in principal axes, as rows, shape (3, 3)
    trajectory: SpacecraftTrajectory | None = None  # of a spacecraft
    with_gravity_errors: AdjustableOrbit | None = None  # orbit with the drawn errors of gravity
    position_name: str = "position"  # before the axes in the names of errors of the position
    values: Floats | None = None  # true parameters of a target of a registered kind

    @classmethod
    def declared(
        cls, name: str, record: MotionLike | TargetDescription, model: PhysicalModel, several: bool
    ) -> Self:
        """Return a target at a position, on a trajectory, or of a registered kind at its a-priori parameters."""
        values = None
        if isinstance(record, TargetDescription):
            target = record.target(name * several, model)
            values = np.array([item.prior_value for item in target.parameters])
            motion, position_pa_m, has_place = target.start, target.position(values)[0], target.has_place
        else:
            motion = as_motion(record, model)
            position_pa_m, has_place = motion.position_pa_m, motion.trajectory is None
        rot = rot_pa_to_me(model.ephemeris.constants)
        enu_pa = rot_pa_to_enu(position_pa_m, rot) if has_place else np.eye(3)
        position_name = f"position.{name}" if several else "position"
        return cls(name, position_pa_m, enu_pa, motion.trajectory, position_name=position_name, values=values)

    @property
    def motion(self) -> TargetMotion:
        """Motion without drawn errors."""
        return (
            FixedPoint(self.position_pa_m) if self.trajectory is None else TrajectoryMotion(self.trajectory)
        )

    @property
    def position_errors(self) -> tuple[str, ...]:
        """Names of the errors of the position."""
        return tuple(f"{self.position_name}.{axis}" for axis in EAST_NORTH_UP)

    def displaced(self, drawn: Mapping[str, float]) -> TrueTarget:
        """Return the target at the position with drawn errors."""
        offset_m = np.array([drawn.get(name, 0.0) for name in self.position_errors])
        return replace(self, position_pa_m=self.position_pa_m + offset_m @ self.enu_pa)


def fixed_errors(
    truth: Truth, predictor: Predictor, at: Prediction, targets: Sequence[TrueTarget], middle_utc: str
) -> tuple[dict[str, Floats], dict[str, float]]:
    """Return effects of the truth on each observation, m, by kind of parameter, and its errors by parameter."""
    # Rates refer to `middle_utc` if the truth has no epoch.
    points = [
        SurfacePoint("", *cartesian(item.position_pa_m, role=Role.FIXED, name=item.position_name))
        for item in targets
    ]
    design = _design(truth.values, predictor, at, points, truth.clock_epoch_utc or middle_utc)
    parameters = design.model.parameters
    added = {item.kind.name: np.zeros(len(predictor.observations)) for item in design.model.columns}
    if added:
        for rows in blocks(predictor):
            partials = design.partials(rows)
            for name, added_m in added.items():
                columns = list(parameters.of_kind(name))
                added_m[rows] = partials[:, columns] @ design.x[columns]
    return added, {p.name: p.prior_value for p in parameters if p.kind != "position"}


def drawn_errors(
    sigma: TruthSigma,
    predictor: Predictor,
    at: Prediction,
    targets: Sequence[TrueTarget],
    middle_utc: str,
    considered: Mapping[str, ParameterChoice],
) -> DrawnErrors:
    """Return drawn errors with their partials at the true positions; `considered` are those of the fit."""
    points = [_displaceable(item, sigma.position_enu_m) for item in targets]
    choices = {name: ParameterChoice(value=item.sigma, per=item.per) for name, item in considered.items()}
    design = _design({**choices, **sigma.sigmas}, predictor, at, points, sigma.clock_epoch_utc or middle_utc)
    drawn = np.flatnonzero(design.x)
    partials = np.zeros((len(drawn), len(predictor.observations)))
    if len(drawn):
        for rows in blocks(predictor):
            partials[:, rows] = design.partials(rows)[:, drawn].T
    names = design.model.parameters.names
    return DrawnErrors(tuple(names[k] for k in drawn), design.x[drawn], partials)


def _displaceable(target: TrueTarget, sigma_enu_m: Sequence[float]) -> SurfacePoint:
    """Return a target whose parameters are its errors east, north and up; those of a spacecraft are zero."""
    sizes = sigma_enu_m if target.trajectory is None else (0.0, 0.0, 0.0)
    parameters = [
        Parameter(name, "m", "position", size, role=Role.FIXED)
        for name, size in zip(target.position_errors, sizes, strict=True)
    ]
    return SurfacePoint("", parameters, lambda _: (target.position_pa_m, target.enu_pa.T))


def _design(
    choices: Mapping[str, ParameterChoice],
    predictor: Predictor,
    at: Prediction,
    points: Sequence[SurfacePoint],
    epoch_utc: str,
) -> DesignMatrix:
    """Return the design matrix of the positions and of all parameters with a value, which is their error or sigma."""
    rows = ObservationRows(predictor.uncombined)
    catalogue = predictor.model.catalogue
    kinds = []
    for name, choice in choices.items():
        kind = PARAMETERS[name]
        if choice.scope(kind).owner is Scope.STATION and isinstance(choice.value, Mapping):
            # Stations without observations are ignored.
            observed = {
                n: v for n, v in choice.value.items() if catalogue.get(n).name in rows.predictor.stations
            }
            choice = replace(choice, value=observed)
        if (chosen := chosen_parameters(kind, choice, rows, Role.FIXED)) is not None:
            kinds.append(chosen)
    # Rates contribute nothing at the epoch of the offsets.
    epoch = utc_to_tai(epochs_from_strings([epoch_utc], "UTC"))
    model = ObservationModel.from_targets(predictor, points, kinds, epoch)
    x = model.parameters.prior_values
    return DesignMatrix(model, at, model.motions(x), x, predictor.observations.value_m)


def _choices(values: Mapping[str, Any], *, sigma: bool = False) -> dict[str, ParameterChoice]:
    """Sort errors, or their sigmas, by kind of parameter, and check their size."""
    keys = [key for kind in PARAMETERS.values() for key in (kind.value_key, kind.keys["per"])]
    for key in filter(lambda key: key not in keys, values):
        matches = difflib.get_close_matches(key, keys, n=1)
        hint = f"did you mean {matches[0]!r}?" if matches else f"expected one of {', '.join(keys)}"
        raise InputError(f"{key!r}: unknown error of a parameter; {hint}")
    choices = {}
    for kind in PARAMETERS.values():
        key, per = kind.value_key, values.get(kind.keys["per"])
        if per is not None and values.get(key) is None:
            raise InputError(f"{kind.keys['per']} needs {key}, the error that it divides")
        if key not in values:
            continue
        choices[kind.name] = ParameterChoice.from_values(kind, "none", value=values[key], per=per)
        largest, reason = _MAX_ERRORS.get(kind.name, (np.inf, ""))
        for value in _numbers(choices[kind.name].value):
            if sigma and value < 0.0:
                raise InputError(f"{key}: expected a sigma that is not negative, got {value!r}")
            if abs(value) > largest:
                raise InputError(
                    f"{key}: expected an error of at most {largest:g} {kind.unit}, which acts to first order "
                    f"({reason}), got {value!r}"
                )
    return choices


def _numbers(value: Any) -> list[float]:
    if isinstance(value, Mapping):
        return [number for item in value.values() for number in _numbers(item)]
    return list(value) if isinstance(value, tuple) else [] if value is None else [value]
