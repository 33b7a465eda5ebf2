"""What the simulated world has that the model of the fit has not: terms, and errors of parameters, known and drawn.

The parameters are those of the registry (:data:`~radioloc.parameters.registry.PARAMETERS`). Their errors act to first
order, by the design matrix; what that leaves out is below 0.2 mm for errors up to the limits that are allowed here.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.boundary import bare_arguments
from radioloc.errors import InputError
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Prediction, Predictor, blocks
from radioloc.measurements.terms import active_terms
from radioloc.parameters.choice import ParameterChoice, chosen_parameters
from radioloc.parameters.design import DesignMatrix, ObservationModel
from radioloc.parameters.kind import Scope
from radioloc.parameters.motion import of_points
from radioloc.parameters.parameter import Parameter, Role
from radioloc.parameters.position import PositionParameters, cartesian
from radioloc.parameters.registry import PARAMETERS
from radioloc.simulation.noise import generator
from radioloc.time import epochs_from_strings, utc_to_tai
from radioloc.vectors import Floats

_LARGEST = {
    "clock": (0.01, "the curvature of a range then is below 4 micrometres"),
    "time_bias": (0.01, "the curvature of a range then is below 4 micrometres"),
    "clock_rate": (1e-8, "its clock then stays within 0.01 s for days"),
    "station_position": (200.0, "the square of it over the distance then is below 0.2 mm"),
    "moon_position": (200.0, "the square of it over the distance then is below 0.2 mm"),
    "libration": (1e-5, "the square of it times the radius then is below 0.2 mm"),
    "pole": (5e-6, "the square of it times the radius then is below 0.2 mm"),
    "ut1": (0.07, "the square of the angle times the radius then is below 0.2 mm"),
}
_LARGEST |= {f"{name}_variation": _LARGEST[name] for name in ("moon_position", "libration")}
"""Errors up to which first order is enough, and why."""
GRAVITY_ERROR = "gravity_error"  # name of drawn errors of gravity, before their number


@dataclass(frozen=True, slots=True, init=False)
class Truth:
    """In what the simulated world differs from the nominal model, real minus modelled.

    Keywords are errors of parameters by the keys that their a-priori values have in a study file, such as
    ``range_bias_m``: a number, or one for each component, of everybody or in a mapping by name; and whom they belong
    to, such as ``clock_per="pass"``. Names of stations are those of the catalogue or aliases; those that observe
    nothing do not matter.
    """

    values: Mapping[str, ParameterChoice]  # errors by kind of parameter
    terms_on: tuple[str, ...]  # terms (TERMS) that the world has and the model not
    terms_off: tuple[str, ...]  # the reverse
    # When the offsets of clocks and frequencies hold that have a rate; the start of the first session where None.
    clock_epoch_utc: str | None

    @bare_arguments
    def __init__(
        self,
        *,
        terms_on: Iterable[str] = (),
        terms_off: Iterable[str] = (),
        clock_epoch_utc: str | None = None,
        **values: Any,
    ) -> None:
        object.__setattr__(self, "values", _choices(values))
        object.__setattr__(self, "terms_on", tuple(terms_on))
        object.__setattr__(self, "terms_off", tuple(terms_off))
        object.__setattr__(self, "clock_epoch_utc", clock_epoch_utc)
        active_terms((*self.terms_on, *self.terms_off))  # knows every name, or says which it does not

    def model(self, nominal: PhysicalModel) -> PhysicalModel:
        """The nominal model with the world's terms."""
        terms = (nominal.terms | set(self.terms_on)) - set(self.terms_off)
        return nominal if terms == nominal.terms else nominal.with_terms(terms)


@dataclass(frozen=True, slots=True, init=False)
class TruthSigma:
    """Standard deviations of errors that are drawn anew in every trial, about those of the truth; keywords as there."""

    sigmas: Mapping[str, ParameterChoice]
    # Of the point itself about its nominal place, to the east, to the north and up (selenocentric): how far a terrain
    # map's height may be wrong, where the study has a prior on the height.
    position_enu_m: tuple[float, float, float]
    clock_epoch_utc: str | None
    # Of an orbiter: how many drawn errors of its gravity field those of a trial are made of; none where zero.
    gravity_errors: int

    @bare_arguments
    def __init__(
        self,
        *,
        position_enu_m: Iterable[float] = (0.0, 0.0, 0.0),
        gravity_errors: int = 0,
        clock_epoch_utc: str | None = None,
        **sigmas: Any,
    ) -> None:
        east, north, up = (float(sigma) for sigma in position_enu_m)
        if not (min(east, north, up) >= 0.0 and max(east, north, up) <= 200.0):
            raise InputError(
                f"position_enu_m is {(east, north, up)!r}; give sigmas that are not negative and up to 200 m"
            )
        if isinstance(gravity_errors, bool) or not isinstance(gravity_errors, int) or gravity_errors < 0:
            raise InputError(f"gravity_errors is {gravity_errors!r}; give a whole number from zero up")
        object.__setattr__(self, "gravity_errors", gravity_errors)
        object.__setattr__(self, "sigmas", _choices(sigmas, sigma=True))
        object.__setattr__(self, "position_enu_m", (east, north, up))
        object.__setattr__(self, "clock_epoch_utc", clock_epoch_utc)

    @property
    def keys(self) -> tuple[str, ...]:
        """What is drawn, by the keys."""
        position = ("position_enu_m",) if any(self.position_enu_m) else ()
        return (
            *position,
            *(("gravity_errors",) if self.gravity_errors else ()),
            *(PARAMETERS[k].value_key for k, choice in self.sigmas.items() if any(_numbers(choice.value))),
        )


@dataclass(frozen=True, slots=True, eq=False)
class DrawnErrors:
    """Errors that are drawn: one standard normal number for each of k parameters."""

    names: tuple[str, ...]
    sigmas: Floats
    partials: Floats  # of the observed values by the parameters, shape (k, n)

    def draw(self, seed: int) -> Floats:
        """Errors of one trial's seed, shape (k,); one parameter more does not change those of others."""
        normal = [generator(seed, f"truth_sigma {name}").standard_normal() for name in self.names]
        return self.sigmas * np.array(normal)

    def with_gravity(self, effects: Floats) -> DrawnErrors:
        """And errors of gravity, each by one sigma, with their effects on the observed values, shape (n, k)."""
        count = effects.shape[1]
        return DrawnErrors(
            (*self.names, *(f"{GRAVITY_ERROR}.{k + 1}" for k in range(count))),
            np.concatenate([self.sigmas, np.ones(count)]),
            np.concatenate([self.partials, effects.T]),
        )

    def rows(self, rows: NDArray[np.intp]) -> DrawnErrors:
        """Of some of the observations."""
        return replace(self, partials=self.partials[:, rows])

    def by_name(self, errors: Floats) -> dict[str, float]:
        """What was drawn, by parameter."""
        return dict(zip(self.names, errors.tolist(), strict=True))


def position_error_m(drawn: Mapping[str, float]) -> Floats:
    """By how much the point stands off its nominal place, east, north and up, m, shape (3,)."""
    return np.array([drawn.get(f"position.{axis}", 0.0) for axis in ("east", "north", "up")])


def fixed_errors(
    truth: Truth, predictor: Predictor, at: Prediction, target_pa_m: Floats, start_utc: str
) -> tuple[dict[str, Floats], dict[str, float]]:
    """Additions of the truth to each observation, m, by kind of parameter, and its errors by parameter."""
    where = cartesian(target_pa_m, role=Role.FIXED)  # rates refer to `start_utc` where the truth has no epoch
    design = _design(truth.values, predictor, at, where, truth.clock_epoch_utc or start_utc)
    parameters = design.model.parameters
    added = {columns.kind.name: np.zeros(len(predictor.observations)) for columns in design.model.columns}
    if added:
        for rows in blocks(predictor):
            partials = design.partials(rows)
            for name, added_m in added.items():
                mine = list(parameters.of_kind(name))
                added_m[rows] = partials[:, mine] @ design.x[mine]
    return added, {p.name: p.prior_value for p in parameters if p.kind != "position"}


def drawn_errors(
    sigma: TruthSigma,
    predictor: Predictor,
    at: Prediction,
    target_pa_m: Floats,
    enu_pa: Floats,
    start_utc: str,
) -> DrawnErrors:
    """What is drawn, with its partials at a position; `enu_pa` are the directions there, rows."""
    place = [
        Parameter(f"position.{axis}", "m", "position", size, role=Role.FIXED)
        for axis, size in zip(("east", "north", "up"), sigma.position_enu_m, strict=True)
    ]
    where = place, lambda _: (target_pa_m, enu_pa.T)
    design = _design(sigma.sigmas, predictor, at, where, sigma.clock_epoch_utc or start_utc)
    drawn = np.flatnonzero(design.x)
    partials = np.zeros((len(drawn), len(predictor.observations)))
    if len(drawn):
        for rows in blocks(predictor):
            partials[:, rows] = design.partials(rows)[:, drawn].T
    names = design.model.parameters.names
    return DrawnErrors(tuple(names[k] for k in drawn), design.x[drawn], partials)


def _design(
    choices: Mapping[str, ParameterChoice],
    predictor: Predictor,
    at: Prediction,
    position: PositionParameters,
    epoch_utc: str,
) -> DesignMatrix:
    """The design matrix of the position and of the parameters that have a value, which is their error or its sigma."""
    simple = predictor.simple
    catalogue = predictor.model.catalogue
    kinds = []
    for name, choice in choices.items():
        kind = PARAMETERS[name]
        if choice.scope(kind).owner is Scope.STATION and isinstance(choice.value, Mapping):
            # Stations that see nothing do not matter.
            seen = {n: v for n, v in choice.value.items() if catalogue.get(n).name in simple.stations}
            choice = replace(choice, value=seen)
        found = chosen_parameters(kind, choice, simple, Role.FIXED)
        if found is not None:
            kinds.append(found)
    # Offsets hold where their rates begin to count.
    epoch = utc_to_tai(epochs_from_strings([epoch_utc], "UTC"))
    model = replace(ObservationModel.of(predictor, [of_points(position)], kinds), reference=epoch)
    x = model.parameters.prior_values
    return DesignMatrix(model, at, model.motions(x), x, predictor.observations.value_m)


def _choices(given: Mapping[str, Any], *, sigma: bool = False) -> dict[str, ParameterChoice]:
    kinds = {kind.value_key: kind for kind in PARAMETERS.values()}
    whose = {kind.keys["per"]: kind for kind in PARAMETERS.values()}
    for key, per in given.items():
        if key in whose:
            if per is not None and given.get(whose[key].value_key) is None:
                raise InputError(
                    f"{key} needs {whose[key].value_key}, the error of which it says whose it is"
                )
            continue
        if key not in kinds:
            near = difflib.get_close_matches(key, kinds, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else f"; there are {', '.join(kinds)}"
            raise InputError(f"{key!r} is no error of a parameter{hint}")
    choices = {}
    for kind in PARAMETERS.values():
        key = kind.value_key
        if key not in given:
            continue
        try:
            choices[kind.name] = ParameterChoice.of(
                kind, "none", value=given[key], per=given.get(kind.keys["per"])
            )
        except InputError as error:
            text, names, _ = str(error).partition(f"; {kind.name} says whose it is")
            where = f"; whose the fit solves for is said in [estimate] {kind.name}" if names else ""
            raise InputError(text + where) from None
        largest, why = _LARGEST.get(kind.name, (np.inf, ""))
        for value in _numbers(choices[kind.name].value):
            if sigma and value < 0.0:
                raise InputError(f"{key}: the sigma is {value!r}; give a number that is not negative")
            if abs(value) > largest:
                raise InputError(
                    f"{key}: {value!r} is too large for errors that act to first order; at most {largest:g} "
                    f"{kind.unit}: {why}"
                )
    return choices


def _numbers(value: Any) -> list[float]:
    """All numbers of an error."""
    if isinstance(value, Mapping):
        return [number for item in value.values() for number in _numbers(item)]
    return list(value) if isinstance(value, tuple) else [] if value is None else [value]
