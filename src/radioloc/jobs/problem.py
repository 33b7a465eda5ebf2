"""Estimation problem of a study: observations, model, parameters and covariance of the noise.

    y = c(x) + B b + e,    x: estimated and considered parameters,    cov(e) = R,    cov(b) = C

The parameters x have a-priori values and sigmas. Considered parameters are its last components: they are adjusted with
their a-priori sigmas and not reported. Errors b that a study leaves out of the weights (suboptimal consider parameters)
and errors of the gravity field change the estimate by S b with the sensitivity S = P A^T W B (Tapley, Schutz and Born
2004, section 6.2).

A fit, a covariance analysis, a trial of a Monte Carlo study and the fit of a part of an arc begin with this problem.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError, error_context
from radioloc.estimation.consider import ConsideredErrors
from radioloc.estimation.series import SeriesOrder, seconds_since_midnight
from radioloc.jobs.error_columns import (
    GravityErrorOrbits,
    ParameterBlock,
    fixed_parameter_blocks,
    force_errors,
    gravity_errors,
    join_errors,
    parameter_errors,
    term_errors,
)
from radioloc.jobs.selection import EPOCH_ROUNDING_S, since_start_s
from radioloc.jobs.station_noise import noise_of, with_independent_clocks
from radioloc.jobs.study_targets import build_targets
from radioloc.labels import Labels
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import KINDS
from radioloc.measurements.target_motion import Motions
from radioloc.noise import ObservationCovariance
from radioloc.parameters.choice import ParameterChoice, chosen_parameters, with_canonical_names
from radioloc.parameters.considered import resolved
from radioloc.parameters.parameter import Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import middle_epoch
from radioloc.study.orbit_choice import ProcessNoise
from radioloc.study.study import EstimateChoice, Study
from radioloc.targets.design import ObservationModel
from radioloc.targets.target import Target
from radioloc.time import tai_to_utc, utc_to_tai
from radioloc.vectors import Floats

_EPHEMERIS_KINDS = ("moon_position", "moon_position_variation", "libration", "libration_variation")


@dataclass(frozen=True, slots=True, eq=False)
class EstimationProblem:
    """Observations with their predictor, targets, parameters and the covariance of the noise."""

    study: Study
    predictor: Predictor  # observations, and the model that predicts them
    estimate: EstimateChoice | None  # nothing is estimated where None
    model: ObservationModel  # targets and parameters; considered parameters are the last
    noise: ObservationCovariance  # R as stated
    order: SeriesOrder  # observations by series and time
    suboptimal: tuple[
        ParameterBlock, ...
    ]  # considered parameters that are left out of the weights on purpose
    notes: tuple[str, ...]  # on kinds of parameter that are usually considered

    @classmethod
    def from_study(
        cls,
        study: Study,
        predictor: Predictor,
        estimate: EstimateChoice | None,
        noise: ObservationCovariance | None = None,
    ) -> EstimationProblem:
        """Assemble the problem of a study's arc, by default with the stated noise; nothing is estimated here."""
        if estimate is None:
            choice = study.estimate.without_estimates()
        else:
            choice = estimate = with_clock_epoch(
                with_independent_clocks(study, estimate, predictor), predictor
            )
        in_weights, suboptimal, notes = list[ParameterBlock](), list[ParameterBlock](), list[str]()
        if estimate is not None:
            considered, notes = _considered_choices(study, predictor, estimate)
            for name, item in considered.items():
                block = _parameter_block("[consider]", name, item, predictor, Role.CONSIDERED, estimate)
                if block is not None:
                    (suboptimal if name in study.suboptimal else in_weights).append(block)
        model = observation_model(predictor, build_targets(study, predictor, choice), choice, in_weights)
        if estimate is not None and not any(item.role is Role.ESTIMATED for item in model.parameters):
            raise InputError(
                'nothing to estimate: [estimate] position is "none", and no other parameter is chosen; '
                "use `radioloc residuals` to see residuals at the given position"
            )
        observations = predictor.observations
        paths = Labels.coded([link.path for link in observations.links], observations.link)
        types = Labels.coded(KINDS, observations.kind)
        order = SeriesOrder.from_labels(types, paths, seconds_since_midnight(observations.epoch))
        noise = noise_of(study, predictor) if noise is None else noise
        return cls(study, predictor, estimate, model, noise, order, tuple(suboptimal), tuple(notes))

    def select(self, rows: NDArray[np.intp]) -> EstimationProblem:
        """Return the problem of some observations, without parameters that act on none of them."""
        predictor = self.predictor.select(rows)
        estimate = None if self.estimate is None else self.estimate.restricted_to(predictor)
        return EstimationProblem.from_study(self.study, predictor, estimate, self.noise.select(rows))

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

    def orbits_with_gravity_errors(self, x: Floats) -> GravityErrorOrbits:
        """Return the orbits at parameters x with the considered errors of their gravity fields, by target."""
        if self.process_noise is not None:  # it represents the omitted part of the field
            return {}
        targets = enumerate(self.model.targets)
        orbits = {k: target.gravity_errors(x[self.model.columns_of(k)]) for k, target in targets}
        return {k: orbit for k, orbit in orbits.items() if orbit is not None}

    def suboptimal_errors(
        self, model: ObservationModel, x: Floats, orbits: GravityErrorOrbits
    ) -> ConsideredErrors | None:
        """Return the errors b with their partials B at parameters x of a model, those of gravity last."""
        return join_errors(parameter_errors(self.suboptimal, model, x), gravity_errors(orbits, model))

    def fixed_parameter_errors(
        self, model: ObservationModel, x: Floats, orbits: GravityErrorOrbits
    ) -> ConsideredErrors | None:
        """Return the parameters, terms and forces that the fit holds at zero, with their partials at parameters x."""
        parameters = [*model.parameters, *(item for _, items in self.suboptimal for item in items)]
        blocks = fixed_parameter_blocks(self.predictor.simple, parameters)
        errors = join_errors(parameter_errors(blocks, model, x), term_errors(model, x))
        if self.process_noise is not None or orbits:  # errors of the forces are in the covariance
            return errors
        return join_errors(errors, force_errors(model, x))


@dataclass(frozen=True, slots=True, eq=False)
class ArcPart:
    """The first hours of an arc."""

    hours: float  # length asked for
    span_h: float  # from the start to the last observation
    rows: NDArray[np.intp]  # in the whole arc
    problem: EstimationProblem


def arc_parts(problem: EstimationProblem, lengths_h: Iterable[float]) -> list[ArcPart]:
    """Return the problems of the first hours of an arc; a part without observations is an error."""
    since_s = since_start_s(problem.predictor.observations, problem.study.observations)
    parts = []
    for length_h in lengths_h:
        rows = np.flatnonzero(since_s <= 3600.0 * length_h + EPOCH_ROUNDING_S)
        if not len(rows):
            raise InputError(
                f"the arc of {length_h:g} h has no observations: the first is {since_s.min() / 3600.0:.2f} h after "
                "the start; give a longer arc or a later start"
            )
        part = problem if len(rows) == len(since_s) else problem.select(rows)
        parts.append(ArcPart(length_h, float(since_s[rows].max()) / 3600.0, rows, part))
    return parts


def observation_model(
    predictor: Predictor,
    targets: Sequence[Target],
    choice: EstimateChoice,
    considered: Sequence[ParameterBlock] = (),
) -> ObservationModel:
    """Return the model of an arc with the parameters of targets, chosen parameters and considered ones."""
    blocks = [
        block
        for name, item in choice.parameters.items()
        if (block := _parameter_block("[estimate]", name, item, predictor, Role.ESTIMATED, choice))
        is not None
    ]
    model = ObservationModel.from_targets(predictor, targets, [*blocks, *considered])
    if choice.clock_epoch is not None:
        model = replace(model, reference=utc_to_tai(choice.clock_epoch))
    return replace(model, considered_kind_count=len(considered))


def considered_choices(study: Study, predictor: Predictor) -> dict[str, ParameterChoice]:
    """Return the considered parameters of a study, by kind, with their a-priori sigmas."""
    return _considered_choices(study, predictor, with_independent_clocks(study, study.estimate, predictor))[0]


def with_clock_epoch(estimate: EstimateChoice, predictor: Predictor) -> EstimateChoice:
    """Set the epoch of clock offsets and rates, by default the middle of the arc; parts of the arc keep it.

    The same a-priori sigmas of clock offset and rate imply a different covariance at another epoch.
    """
    if estimate.clock_epoch is not None or not len(predictor.observations):
        return estimate
    return replace(estimate, clock_epoch=tai_to_utc(middle_epoch(predictor.observations)))


def require_position_or_orbit(study: Study, job: str) -> None:
    """Refuse a study in which neither a position nor an orbit is estimated."""
    if not study.orbiters and study.estimate.position == "none":
        raise InputError(f'{job} needs the position estimated: [estimate] position is "none"')


def _considered_choices(
    study: Study, predictor: Predictor, estimate: EstimateChoice
) -> tuple[dict[str, ParameterChoice], list[str]]:
    """Return the considered parameters with their sigmas, by kind, and notes."""
    moon_is_considered = any(estimate.ephemeris_sigma_m) or bool(predictor.trajectories)
    with error_context("[estimate]"):
        estimated = {
            name: with_canonical_names(PARAMETERS[name], choice, predictor.simple)
            for name, choice in estimate.parameters.items()
        }
    with error_context("[consider]"):
        return resolved(
            study.consider,
            predictor,
            estimated,
            defaults=study.consider_defaults,
            excluded=_EPHEMERIS_KINDS if moon_is_considered else (),
        )


def _parameter_block(
    table: str, name: str, choice: ParameterChoice, predictor: Predictor, role: Role, estimate: EstimateChoice
) -> ParameterBlock | None:
    with error_context(table):
        return chosen_parameters(PARAMETERS[name], choice, predictor.simple, role, estimate.pass_gap_h)
