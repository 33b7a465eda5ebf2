"""The estimation problem of a study.

A problem holds the observations, the model that predicts them, the targets, the parameters and the noise covariance.
Every job begins with it: a fit, a covariance analysis, the trials of a Monte Carlo study, and fits of parts of an arc.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics import AdjustableOrbit
from radioloc.errors import InputError, error_context
from radioloc.estimation.consider import Consider, ConsideredErrors, owner
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.hypotheses import TERM
from radioloc.estimation.linearization import ResidualFunction
from radioloc.estimation.series import SeriesOrder, seconds_since_midnight
from radioloc.estimation.time_correlation import fit_with_correlated_weights
from radioloc.jobs.selection import EPOCH_ROUNDING_S, since_start_s
from radioloc.jobs.station_noise import noise_of, with_independent_clocks
from radioloc.jobs.study_targets import build_targets
from radioloc.labels import Labels
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import KINDS
from radioloc.measurements.target_motion import Motions
from radioloc.measurements.terms import TERMS
from radioloc.noise import ObservationCovariance
from radioloc.parameters.choice import ParameterChoice, chosen_parameters, with_canonical_names
from radioloc.parameters.columns import Columns, members
from radioloc.parameters.considered import default_sigmas, resolved
from radioloc.parameters.parameter import Parameter, ParameterSet, Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import ObservationRows, middle_epoch
from radioloc.study.orbit_choice import ProcessNoise
from radioloc.study.study import EstimateChoice, Study
from radioloc.targets.design import DesignMatrix, ObservationModel, effects_on_orbit
from radioloc.targets.orbit_state import OrbitState
from radioloc.targets.target import Target
from radioloc.time import tai_to_utc, utc_to_tai

_EPHEMERIS_KINDS = ("moon_position", "moon_position_variation", "libration", "libration_variation")
ParameterBlocks = list[tuple[Columns, list[Parameter]]]
GravityErrorOrbits = Mapping[int, AdjustableOrbit]
"""Orbits with considered errors of their gravity fields, by the index of the target."""


def considered_errors(study: Study, arc: Predictor) -> dict[str, ParameterChoice]:
    """Return the errors that a fit considers, by kind, with their sigmas."""
    return _considered_choices(study, arc, with_independent_clocks(study, study.estimate, arc))[0]


def _considered_choices(
    study: Study, arc: Predictor, estimate: EstimateChoice
) -> tuple[dict[str, ParameterChoice], list[str]]:
    """Return the considered members with their sigmas, by kind, and notes."""
    moon_is_considered = any(estimate.ephemeris_sigma_m) or bool(arc.trajectories)
    with error_context("[estimate]"):
        estimated = {
            name: with_canonical_names(PARAMETERS[name], choice, arc.simple)
            for name, choice in estimate.parameters.items()
        }
    with error_context("[consider]"):
        return resolved(
            study.consider,
            arc,
            estimated,
            defaults=study.consider_defaults,
            excluded=_EPHEMERIS_KINDS if moon_is_considered else (),
        )


@dataclass(frozen=True, slots=True, eq=False)
class ConsideredParameters:
    """Considered parameters of an arc, with their columns of the design matrix."""

    in_weights: ParameterBlocks = field(default_factory=list)
    suboptimal: ParameterBlocks = field(default_factory=list)  # left out of the weights on purpose
    notes: tuple[str, ...] = ()  # on default kinds that are not considered

    @classmethod
    def from_study(
        cls, study: Study, arc: Predictor, estimate: EstimateChoice | None
    ) -> ConsideredParameters:
        """Return those of a study and the defaults of their kinds; none where nothing is estimated."""
        if estimate is None:
            return cls()
        choices, notes = _considered_choices(study, arc, estimate)
        considered = cls(notes=tuple(notes))
        for name, choice in choices.items():
            columns = _columns("[consider]", name, choice, arc, Role.CONSIDERED, estimate)
            if columns is not None:
                kinds = considered.suboptimal if name in study.suboptimal else considered.in_weights
                kinds.append(columns)
        return considered


@dataclass(frozen=True, slots=True, eq=False)
class EstimationProblem:
    """Observations with their predictor, targets, parameters and the covariance of the noise."""

    study: Study
    arc: Predictor
    estimate: EstimateChoice | None  # nothing is estimated where None
    considered: ConsideredParameters
    model: ObservationModel  # considered parameters last
    noise: ObservationCovariance  # as stated
    order: SeriesOrder

    @classmethod
    def from_study(
        cls,
        study: Study,
        arc: Predictor,
        estimate: EstimateChoice | None,
        noise: ObservationCovariance | None = None,
    ) -> EstimationProblem:
        """Assemble the problem of a study's arc, by default with the stated noise; nothing is estimated here."""
        if estimate is not None:
            estimate = with_independent_clocks(study, estimate, arc)
            estimate = with_clock_epoch(estimate, arc)
        observations = arc.observations
        choice = study.estimate.without_estimates() if estimate is None else estimate
        considered = ConsideredParameters.from_study(study, arc, estimate)
        model = observation_model(arc, build_targets(study, arc, choice), choice, considered.in_weights)
        if estimate is not None and not any(item.role is Role.ESTIMATED for item in model.parameters):
            raise InputError(
                'nothing to estimate: [estimate] position is "none" and no bias is asked for; '
                "use `radioloc residuals` to see residuals at the given position"
            )
        paths = Labels.coded([link.path for link in observations.links], observations.link)
        types = Labels.coded(KINDS, observations.kind)
        return cls(
            study,
            arc,
            estimate,
            considered,
            model,
            noise_of(study, arc) if noise is None else noise,
            SeriesOrder.from_labels(types, paths, seconds_since_midnight(observations.epoch)),
        )

    def select(self, rows: NDArray[np.intp]) -> EstimationProblem:
        """Return the problem of some observations, without parameters that act on none of them."""
        arc = self.arc.select(rows)
        estimate = None if self.estimate is None else self.estimate.restricted_to(arc)
        return EstimationProblem.from_study(self.study, arc, estimate, self.noise.select(rows))

    @property
    def start(self) -> Motions:
        """A-priori motions of the targets."""
        return tuple(target.start for target in self.model.targets)

    @property
    def reported_count(self) -> int:
        """Number of parameters that are not considered; they come first."""
        return int((~self.model.parameters.considered).sum())

    @property
    def process_noise(self) -> ProcessNoise | None:
        """Stochastic accelerations of the orbit."""
        if self.estimate is None or self.estimate.orbit is None:
            return None
        return self.estimate.orbit.process_noise

    def orbits_with_gravity_errors(self, x: NDArray[np.float64]) -> GravityErrorOrbits:
        """Return the orbits at parameters x with the considered errors of their gravity fields, by target."""
        if self.process_noise is not None:  # it represents the omitted part of the field
            return {}
        orbits = {
            k: target.gravity_errors(x[self.model.columns_of(k)])
            for k, target in enumerate(self.model.targets)
        }
        return {k: orbit for k, orbit in orbits.items() if orbit is not None}

    def suboptimal_errors(
        self, model: ObservationModel, x: NDArray[np.float64], orbits: GravityErrorOrbits
    ) -> ConsideredErrors | None:
        """Return the errors that stay out of the weights at parameters x of a model, those of gravity last."""
        gravity, errors = _gravity_errors(orbits, model), _errors_of(self.considered.suboptimal, model, x)
        return _joined(errors, gravity)

    def candidate_errors(self, model: ObservationModel, x: NDArray[np.float64]) -> ConsideredErrors | None:
        """Return the parameters that the fit holds at zero, with a usual sigma or their scale, at parameters x."""
        arc, kinds = self.arc.simple, ParameterBlocks()
        items = (*model.parameters, *(item for _, members in self.considered.suboptimal for item in members))
        owners: dict[str, set[str]] = {}
        for item in items:
            owners.setdefault(item.kind, set()).add(owner(item))
        for name, kind in PARAMETERS.items():
            available = arc.more_partials or not kind.more_partials
            if len(kind.components) > 1 or not available or (kind.term and not arc.model.has(kind.term)):
                continue
            present = members(kind, kind.scopes[0], arc)
            if not owners.get(name, set()) <= present.keys():  # parameters of another scope
                continue
            absent = [member for member in present if member not in owners.get(name, ())]
            sigmas, reason = default_sigmas(kind, ObservationRows(arc), present)
            if reason:  # such as signals without a frequency
                continue
            choice = ParameterChoice(
                tuple(absent) if kind.scopes[0].named else "all",
                sigma={member: sigmas.get(member) or kind.scale for member in absent},
            )
            columns = chosen_parameters(kind, choice, arc, Role.CONSIDERED) if absent else None
            kinds += [] if columns is None else [columns]
        return _joined(_errors_of(kinds, model, x), _term_errors(model, x))


@dataclass(frozen=True, slots=True, eq=False)
class ArcPart:
    """The first hours of an arc."""

    hours: float  # length asked for
    span_h: float  # from the start to the last observation
    rows: NDArray[np.intp]  # in the whole arc
    problem: EstimationProblem


def arc_parts(whole: EstimationProblem, lengths: Iterable[float]) -> list[ArcPart]:
    """Return the first parts of an arc with several lengths, h; a part without observations is an error."""
    since_s = since_start_s(whole.arc.observations, whole.study.observations)
    parts = []
    for length in lengths:
        rows = np.flatnonzero(since_s <= 3600.0 * length + EPOCH_ROUNDING_S)
        if not len(rows):
            raise InputError(
                f"the arc of {length:g} h has no observations: the first is {since_s.min() / 3600.0:.2f} h after the "
                "start; give a longer arc or a later start"
            )
        problem = whole if len(rows) == len(since_s) else whole.select(rows)
        parts.append(ArcPart(length, float(since_s[rows].max()) / 3600.0, rows, problem))
    return parts


def observation_model(
    arc: Predictor,
    targets: Sequence[Target],
    choice: EstimateChoice,
    considered: ParameterBlocks | None = None,
) -> ObservationModel:
    """Return the parameters of targets, those of the chosen kinds, and considered ones."""
    kinds = [
        columns
        for name, chosen in choice.parameters.items()
        if (columns := _columns("[estimate]", name, chosen, arc, Role.ESTIMATED, choice)) is not None
    ]
    considered = considered or []
    model = ObservationModel.from_targets(arc, targets, [*kinds, *considered])
    if choice.clock_epoch is not None:
        model = replace(model, reference=utc_to_tai(choice.clock_epoch))
    return replace(model, considered_kinds=len(considered))


def with_clock_epoch(estimate: EstimateChoice, arc: Predictor) -> EstimateChoice:
    """Return an estimate with an epoch of its clocks, by default the middle of the arc; parts of the arc keep it.

    The same a-priori sigmas of clock offset and rate imply a different covariance at another epoch.
    """
    if estimate.clock_epoch is not None or not len(arc.observations):
        return estimate
    return replace(estimate, clock_epoch=tai_to_utc(middle_epoch(arc.observations)))


def with_weights(
    residual_function: ResidualFunction,
    edited: EditedFit,
    order: SeriesOrder,
    estimate: EstimateChoice | None,
) -> EditedFit:
    """Repeat the fit with the weights of time-correlated series, if a study asks for them."""
    if estimate is not None and estimate.weights == "correlated":
        return fit_with_correlated_weights(residual_function, edited, order)
    return edited


def require_position_or_orbit(study: Study, job: str) -> None:
    """Refuse a study in which neither a position nor an orbit is estimated."""
    if not study.orbiters and study.estimate.position == "none":
        raise InputError(f'{job} needs the position estimated: [estimate] position is "none"')


def _columns(
    table: str, name: str, chosen: ParameterChoice, arc: Predictor, role: Role, estimate: EstimateChoice
) -> tuple[Columns, list[Parameter]] | None:
    with error_context(table):
        return chosen_parameters(PARAMETERS[name], chosen, arc.simple, role, estimate.pass_gap_h)


def _errors_of(
    kinds: ParameterBlocks, model: ObservationModel, x: NDArray[np.float64]
) -> ConsideredErrors | None:
    """Return considered parameters with their partials at the parameters x of a model; None of no kinds."""
    if not kinds:
        return None
    errors = replace(ObservationModel.from_targets(model.predictor, (), kinds), reference=model.reference)
    motions = model.motions(x)
    prediction, residual_m = model.predictor.predict(motions), np.zeros(0)  # residuals are not asked for
    design = DesignMatrix(errors, prediction, motions, errors.parameters.prior_values, residual_m)
    return ConsideredErrors(errors.parameters, design.partials)


def _joined(first: ConsideredErrors | None, second: ConsideredErrors | None) -> ConsideredErrors | None:
    """Return both sets of errors as one."""
    if first is None or second is None:
        return second if first is None else first
    return ConsideredErrors(
        ParameterSet([*first.parameters, *second.parameters]),
        lambda rows: np.hstack([first.partials(rows), second.partials(rows)]),
    )


def _term_errors(model: ObservationModel, x: NDArray[np.float64]) -> ConsideredErrors | None:
    """Return the terms that are switched off as parameters, 1 where the observations contain the term."""
    predictor, motions = model.predictor, model.motions(x)
    physical, effects, names = predictor.model, list[NDArray[np.float64]](), list[str]()
    for name in TERMS:
        if physical.has(name) or (name == "ionosphere" and physical.ionosphere is None):
            continue
        changed = predictor.with_model(physical.with_terms(physical.terms | {name}), motions)
        effect_m = changed.predict(motions).value_m - predictor.predict(motions).value_m
        if effect_m.any():
            names.append(name)
            effects.append(effect_m)
    if not names:
        return None
    effects_m = np.nan_to_num(np.column_stack(effects))
    items = [
        Parameter(f"{TERM}.{name}", "1", TERM, 0.0, 1.0, scale=1.0, role=Role.CONSIDERED) for name in names
    ]
    return ConsideredErrors(ParameterSet(items), lambda rows: effects_m[rows])


def _gravity_errors(orbits: GravityErrorOrbits, model: ObservationModel) -> ConsideredErrors | None:
    """Return the errors of gravity fields with their effects on the observations, common to orbits in one field."""
    if not orbits:
        return None
    effects = dict[str, NDArray[np.float64]]()
    for k, prefix in _gravity_error_prefixes(orbits, model).items():
        effects[prefix] = effects.get(prefix, 0.0) + effects_on_orbit(model.predictor, orbits[k], k)
    parameters = [
        Parameter(f"{prefix}{j + 1}", "1", "gravity_error", 0.0, 1.0, role=Role.CONSIDERED)
        for prefix, of_field in effects.items()
        for j in range(of_field.shape[1])
    ]
    effects_m = np.hstack(list(effects.values()))
    return ConsideredErrors(ParameterSet(parameters), lambda rows: effects_m[rows])


def _gravity_error_prefixes(orbits: GravityErrorOrbits, model: ObservationModel) -> dict[int, str]:
    """Return prefixes of the names of each orbit's gravity errors; that of the first field omits the target."""
    fields, prefixes = dict[tuple[str, int], str](), dict[int, str]()
    for k, orbit in orbits.items():
        field = orbit.forces.gravity
        of_others = f"gravity_error.{model.targets[k].name}." if fields else "gravity_error."
        prefixes[k] = fields.setdefault((field.name, field.degree), of_others)
    return prefixes


def own_gravity_errors(
    parameters: ParameterSet, orbits: GravityErrorOrbits, model: ObservationModel, target: int
) -> list[int]:
    """Return the indices of the considered errors of the gravity field that a target moves in."""
    prefix = _gravity_error_prefixes(orbits, model).get(target)
    return [k for k, name in enumerate(parameters.names) if prefix == f"{name.rpartition('.')[0]}."]


def orbit_states(
    model: ObservationModel,
    x: NDArray[np.float64],
    covariance: NDArray[np.float64],
    consider: Consider | None,
    orbits: GravityErrorOrbits,
) -> dict[int, OrbitState]:
    """Return the states of the estimated orbits by target, from the total `covariance` of x."""
    return {k: orbit_state(model, k, x, covariance, consider, orbits) for k in model.orbit_indices}


def orbit_state(
    model: ObservationModel,
    target: int,
    x: NDArray[np.float64],
    covariance: NDArray[np.float64],
    consider: Consider | None,
    orbits: GravityErrorOrbits,
) -> OrbitState:
    """Return the state of the orbit of a target."""
    columns = model.columns_of(target)
    sensitivity = np.zeros((columns.stop - columns.start, 0))
    if consider is not None:
        errors = own_gravity_errors(consider.parameters, orbits, model, target)
        sensitivity = consider.sensitivity[columns][:, errors]
    state = model.targets[target].estimate(
        x[columns], covariance[columns, columns], sensitivity, orbits.get(target)
    )
    assert state is not None  # the target moves by forces
    return state
