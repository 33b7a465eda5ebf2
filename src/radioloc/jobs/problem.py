"""Estimation problem of a study: observations, model, parameters and covariance of the noise.

    y = c(x) + B b + e,    cov(e) = R,    cov(b) = C

The observations y have computed values c(x) of parameters x with a-priori values and sigmas. Systematic errors, such as
those of station coordinates, enter in one of two ways. By default they are adjusted: they are the last components of x,
with their a-priori sigmas, and are not reported (nuisance parameters). Errors that the study lists under ``[consider]
suboptimal``, and those of the gravity field, are not adjusted: the errors b with their design matrix B change the
estimate by S b, with the sensitivity matrix S = P A^T R^-1 B, the design matrix A of the parameters and the covariance
P of the estimate. Tapley, Schutz and Born (2004), section 6.2, call these consider parameters.

This problem is the input of a fit, a covariance analysis, a Monte Carlo trial and the fit of a part of an arc.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from radioloc.errors import InputError, error_context
from radioloc.estimation.consider import UnestimatedErrors
from radioloc.estimation.series import SeriesOrder, seconds_since_midnight
from radioloc.jobs.error_columns import (
    GravityErrorOrbits,
    ParameterBlock,
    fixed_parameter_blocks,
    force_errors,
    gravity_errors,
    parameter_errors,
    term_errors,
)
from radioloc.jobs.selection import EPOCH_ROUNDING_S, since_start_s
from radioloc.jobs.station_noise import observation_covariance, with_independent_clocks
from radioloc.jobs.study_targets import build_targets
from radioloc.labels import Labels
from radioloc.measurements.observations import Observations
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import KINDS
from radioloc.measurements.target_motion import Motions
from radioloc.noise import ObservationCovariance
from radioloc.parameters.choice import ParameterChoice, chosen_parameters, with_canonical_names
from radioloc.parameters.considered import resolve_considered
from radioloc.parameters.parameter import Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import ObservationRows, middle_epoch
from radioloc.study.study import EstimateChoice, Study
from radioloc.targets.design import ObservationModel
from radioloc.targets.target import Target
from radioloc.time import tai_to_utc, utc_to_tai
from radioloc.vectors import Floats, Indices

_MOON_KINDS = ("moon_position", "moon_position_variation", "libration", "libration_variation")


@dataclass(frozen=True, slots=True, eq=False)
class EstimationProblem:
    """Observations with their predictor, targets, parameters and the covariance of the noise."""

    study: Study
    predictor: Predictor  # with the observations
    choice: EstimateChoice
    model: ObservationModel  # targets and adjusted parameters, nuisance parameters last
    noise: ObservationCovariance  # R as stated
    order: SeriesOrder  # observations by series and time
    unadjusted_blocks: tuple[ParameterBlock, ...]  # systematic errors that are not adjusted
    notes: tuple[str, ...]  # on systematic errors
    is_fixed: bool  # whether all parameters are fixed at their a-priori values

    @classmethod
    def from_study(
        cls,
        study: Study,
        predictor: Predictor,
        choice: EstimateChoice,
        noise: ObservationCovariance | None = None,
        *,
        fixed: bool = False,
    ) -> EstimationProblem:
        """Assemble the problem of a study's arc, by default with the stated noise; nothing is estimated here."""
        considered, notes = dict[str, ParameterBlock](), list[str]()
        if fixed:
            choice = choice.without_estimates()
        else:
            choice = _with_clock_epoch(with_independent_clocks(study, choice, predictor), predictor)
            rows = ObservationRows(predictor.uncombined)
            choices, notes = _considered_choices(study, rows, choice)
            considered = _parameter_blocks("[consider]", choices, rows, Role.CONSIDERED, choice.pass_gap_h)
        adjusted = [block for name, block in considered.items() if name not in study.suboptimal]
        unadjusted = tuple(block for name, block in considered.items() if name in study.suboptimal)
        targets = build_targets(study, predictor, choice)
        model = observation_model(predictor, targets, choice, adjusted)
        if not fixed and not any(item.role is Role.ESTIMATED for item in model.parameters):
            raise InputError(
                'nothing to estimate: [estimate] position is "none", and no other parameter is chosen; '
                "use `radioloc residuals` to see residuals at the given position"
            )
        noise = observation_covariance(study, predictor) if noise is None else noise
        order = _series_order(predictor.observations)
        return cls(study, predictor, choice, model, noise, order, unadjusted, tuple(notes), fixed)

    def select(self, rows: Indices) -> EstimationProblem:
        """Return the problem of some observations, without parameters that act on none of them."""
        predictor = self.predictor.select(rows)
        choice, noise = self.choice.restricted_to(predictor), self.noise.select(rows)
        return EstimationProblem.from_study(self.study, predictor, choice, noise, fixed=self.is_fixed)

    @property
    def prior_motions(self) -> Motions:
        """A-priori motions of the targets."""
        return tuple(target.start for target in self.model.targets)

    @property
    def reported_count(self) -> int:
        """Number of parameters that are reported; they come before the nuisance parameters."""
        return int((~self.model.parameters.considered).sum())

    @property
    def has_process_noise(self) -> bool:
        """True if an orbit has stochastic accelerations."""
        return any(target.process_noise is not None for target in self.model.targets)

    def orbits_with_gravity_errors(self, x: Floats) -> GravityErrorOrbits:
        """Return orbits at parameters x for the partials of errors of the gravity field, by the index of the target."""
        orbits = {
            k: target.gravity_errors(x[self.model.columns_of(k)])
            for k, target in enumerate(self.model.targets)
            if target.process_noise is None  # process noise represents the errors of gravity already
        }
        return {k: orbit for k, orbit in orbits.items() if orbit is not None}

    def unadjusted_errors(
        self, model: ObservationModel, x: Floats, orbits: GravityErrorOrbits
    ) -> UnestimatedErrors:
        """Return the errors b with their partials B at parameters x of a model, those of gravity last."""
        return parameter_errors(self.unadjusted_blocks, model, x).joined(gravity_errors(orbits, model))

    def fixed_parameter_errors(
        self, model: ObservationModel, x: Floats, orbits: GravityErrorOrbits
    ) -> UnestimatedErrors:
        """Return the errors of parameters, terms and forces that the fit holds fixed, with their partials at x."""
        parameters = [*model.parameters, *(item for _, items in self.unadjusted_blocks for item in items)]
        blocks = fixed_parameter_blocks(self.predictor.uncombined, parameters)
        errors = parameter_errors(blocks, model, x).joined(term_errors(model, x))
        if self.has_process_noise or orbits:  # errors of the forces are in the covariance
            return errors
        return errors.joined(force_errors(model, x))


@dataclass(frozen=True, slots=True, eq=False)
class ArcPart:
    """The first hours of an arc."""

    hours: float  # nominal length
    span_h: float  # from the start to the last observation
    rows: Indices  # in the whole arc
    problem: EstimationProblem


def arc_parts(problem: EstimationProblem, lengths_h: Iterable[float]) -> list[ArcPart]:
    """Return a problem for each length, with the observations from the start of the arc; each needs some."""
    since_s = since_start_s(problem.predictor.observations, problem.study.observations)
    first_h = float(since_s.min(initial=math.inf)) / 3600.0
    parts = []
    for length_h in lengths_h:
        rows = np.flatnonzero(since_s <= 3600.0 * length_h + EPOCH_ROUNDING_S)
        if not len(rows):
            raise InputError(
                f"the arc of {length_h:g} h has no observations: the first is {first_h:.2f} h after "
                "the start; give a longer arc or a later start"
            )
        part_problem = problem if len(rows) == len(since_s) else problem.select(rows)
        parts.append(ArcPart(length_h, float(since_s[rows].max()) / 3600.0, rows, part_problem))
    return parts


def observation_model(
    predictor: Predictor,
    targets: Sequence[Target],
    choice: EstimateChoice,
    considered: Sequence[ParameterBlock] = (),
) -> ObservationModel:
    """Return the model of an arc with the parameters of targets, chosen parameters and nuisance parameters."""
    rows = ObservationRows(predictor.uncombined)
    blocks = _parameter_blocks("[estimate]", choice.parameters, rows, Role.ESTIMATED, choice.pass_gap_h)
    reference = None if choice.clock_epoch is None else utc_to_tai(choice.clock_epoch)
    model = ObservationModel.from_targets(predictor, targets, [*blocks.values(), *considered], reference)
    return replace(model, considered_kind_count=len(considered))


def considered_parameters(study: Study, predictor: Predictor) -> dict[str, ParameterChoice]:
    """Return the systematic errors of a study, by kind of parameter, with their a-priori sigmas."""
    choice = with_independent_clocks(study, study.estimate, predictor)
    return _considered_choices(study, ObservationRows(predictor.uncombined), choice)[0]


def require_position_or_orbit(study: Study, job: str) -> None:
    """Refuse a study in which neither a position nor an orbit is estimated."""
    if not study.orbiters and study.estimate.position == "none":
        raise InputError(f'{job} needs the position estimated: [estimate] position is "none"')


def _with_clock_epoch(choice: EstimateChoice, predictor: Predictor) -> EstimateChoice:
    """Set the epoch of clock offsets and rates, by default the middle of the arc; parts of the arc keep it.

    The same a-priori sigmas of clock offset and rate imply a different covariance at another epoch.
    """
    if choice.clock_epoch is not None or not len(predictor.observations):
        return choice
    return replace(choice, clock_epoch=tai_to_utc(middle_epoch(predictor.observations)))


def _considered_choices(
    study: Study, rows: ObservationRows, choice: EstimateChoice
) -> tuple[dict[str, ParameterChoice], list[str]]:
    """Return the systematic errors with their a-priori sigmas, by kind of parameter, and notes."""
    with error_context("[estimate]"):
        estimated = {
            name: with_canonical_names(PARAMETERS[name], item, rows.predictor)
            for name, item in choice.parameters.items()
        }
    # `ephemeris_sigma_m` includes the errors of the Moon already; a trajectory has errors of its own in their place.
    is_replaced = any(choice.ephemeris_sigma_m) or rows.predictor.trajectories
    kinds_without_default = _MOON_KINDS if is_replaced else ()
    with error_context("[consider]"):
        return resolve_considered(
            study.consider,
            rows,
            estimated,
            defaults=study.consider_defaults,
            without_defaults=kinds_without_default,
        )


def _parameter_blocks(
    table: str, choices: Mapping[str, ParameterChoice], rows: ObservationRows, role: Role, pass_gap_h: float
) -> dict[str, ParameterBlock]:
    """Return the chosen parameters by kind, without kinds that act on no observation."""
    blocks = {}
    for name, choice in choices.items():
        with error_context(table):
            block = chosen_parameters(PARAMETERS[name], choice, rows, role, pass_gap_h)
        if block is not None:
            blocks[name] = block
    return blocks


def _series_order(observations: Observations) -> SeriesOrder:
    paths = Labels.coded([link.path for link in observations.links], observations.link)
    types = Labels.coded(KINDS, observations.kind)
    return SeriesOrder.from_labels(types, paths, seconds_since_midnight(observations.epoch))
