"""The problem that a study's arc is: what is solved for, which observations can be used, and why others cannot.

Of clocks that nothing ties together, how they differ is estimated unless a study says otherwise. Three-way Doppler is
counted against the receiving station's frequency standard and transmitted by another's; one-way Doppler has the
target's oscillator at its start. An offset of 1e-12, usual of all but hydrogen masers, moves a lander by hundreds of
metres, a listener's quartz by more than the Moon is large, and the residuals do not show it. Where there are delays of
quasars, the stations' clocks, by which they are off by some microseconds, are in all delays still.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.dynamics import AdjustableOrbit
from radioloc.errors import InputError, named
from radioloc.estimation.consider import Consider, ConsideredErrors
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.linearization import ResidualFunction
from radioloc.estimation.series import SeriesOrder, seconds_since_midnight
from radioloc.estimation.time_correlation import fit_with_correlated_weights
from radioloc.jobs.station_noise import stated_noise
from radioloc.jobs.study_targets import targets_of
from radioloc.jobs.verdict import LOWEST_EARTH_DEG
from radioloc.labels import USED, Labels
from radioloc.lunar.visibility import earth_elevation_rad
from radioloc.measurements.predictor import Predictor, blocks, reasons
from radioloc.measurements.registry import KINDS, kind_of
from radioloc.measurements.target_motion import Motions
from radioloc.media.status import Status
from radioloc.noise import ObservationCovariance
from radioloc.parameters.choice import ParameterChoice, chosen_parameters
from radioloc.parameters.columns import Columns
from radioloc.parameters.considered import resolved
from radioloc.parameters.kind import Scope
from radioloc.parameters.parameter import Parameter, ParameterSet, Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import networks
from radioloc.study.study import EstimateChoice, Study
from radioloc.targets.design import DesignMatrix, ObservationModel
from radioloc.targets.orbit_state import OrbitState
from radioloc.targets.target import Target
from radioloc.time import Epochs, evaluate_smooth, tt_to_tdb, utc_to_tt

_OF_THE_EPHEMERIS = ("moon_position", "moon_position_variation", "libration", "libration_variation")
_RATE_SIGMA = 1e-11
"""Ten times that of a hydrogen maser which nobody has set; from one scan of each target a rate is not told."""


def problem_of(
    study: Study,
    arc: Predictor,
    estimate: EstimateChoice | None,
    considered: Sequence[tuple[Columns, list[Parameter]]] = (),
) -> ObservationModel:
    """Return the parameters of a study's arc, considered ones last; without `estimate` all others are held."""
    choice = study.estimate.held() if estimate is None else estimate
    model = observation_model(arc, targets_of(study, arc, choice), choice, considered)
    if estimate is not None and not any(item.role is Role.ESTIMATED for item in model.parameters):
        raise InputError(
            'nothing to estimate: [estimate] position is "none" and no bias is asked for; '
            "use `radioloc residuals` to see residuals at the given position"
        )
    return model


def observation_model(
    arc: Predictor,
    targets: Sequence[Target],
    choice: EstimateChoice,
    considered: Sequence[tuple[Columns, list[Parameter]]] = (),
) -> ObservationModel:
    """Return the parameters of targets, those of the kinds that are chosen, and considered ones."""
    found = [
        _columns("[estimate]", name, chosen, arc, Role.ESTIMATED, choice)
        for name, chosen in choice.parameters.items()
    ]
    kinds = [*(item for item in found if item is not None), *considered]
    return replace(ObservationModel.of(arc, targets, kinds), considered_kinds=len(considered))


def weighed(
    residual_function: ResidualFunction,
    fitted: EditedFit,
    order: SeriesOrder,
    estimate: EstimateChoice | None,
) -> EditedFit:
    """Repeat the fit with the weights that a study asks for."""
    if estimate is not None and estimate.weights == "correlated":
        return fit_with_correlated_weights(residual_function, fitted, order)
    return fitted


@dataclass(frozen=True, slots=True, eq=False)
class ConsideredParameters:
    """Considered parameters of an arc, with their columns of the design matrix."""

    in_weights: list[tuple[Columns, list[Parameter]]] = field(default_factory=list)
    suboptimal: list[tuple[Columns, list[Parameter]]] = field(default_factory=list)  # left out of the weights
    notes: tuple[str, ...] = ()  # on those that are not considered

    @classmethod
    def of(cls, study: Study, predictor: Predictor, estimate: EstimateChoice | None) -> ConsideredParameters:
        """Return those of a study and the defaults of their kinds; none where nothing is estimated."""
        if estimate is None:
            return cls()
        moon_is_in = any(estimate.ephemeris_sigma_m) or bool(predictor.trajectories)
        with named("[consider]"):
            choices, notes = resolved(
                study.consider,
                predictor,
                estimate.parameters,
                defaults=study.consider_defaults,
                excluded=_OF_THE_EPHEMERIS if moon_is_in else (),
            )
        found = cls(notes=tuple(notes))
        for name, choice in choices.items():
            columns = _columns("[consider]", name, choice, predictor, Role.CONSIDERED, estimate)
            if columns is not None:
                (found.suboptimal if name in study.suboptimal else found.in_weights).append(columns)
        return found

    def suboptimal_errors(
        self, problem: ObservationModel, x: NDArray[np.float64], errant: AdjustableOrbit | None
    ) -> ConsideredErrors | None:
        """Return the errors that stay out of the weights, those of the gravity field last, at parameters x."""
        gravity, errors = gravity_errors(errant, problem), errors_of(self.suboptimal, problem, x)
        if gravity is None or errors is None:
            return errors if gravity is None else gravity
        return ConsideredErrors(
            ParameterSet([*errors.parameters, *gravity.parameters]),
            lambda rows: np.hstack([errors.partials(rows), gravity.partials(rows)]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class EstimationProblem:
    """What is estimated from an arc: observations with predictor, targets, parameters and covariance of the noise."""

    study: Study
    arc: Predictor
    estimate: EstimateChoice | None  # nothing is estimated where None
    considered: ConsideredParameters
    model: ObservationModel
    noise: ObservationCovariance  # as stated
    order: SeriesOrder

    @classmethod
    def of(cls, study: Study, arc: Predictor, estimate: EstimateChoice | None) -> EstimationProblem:
        """Assemble the problem of a study's arc; nothing is estimated here."""
        if estimate is not None:
            estimate = with_independent_clocks(study, estimate, arc)
        observations = arc.observations
        considered = ConsideredParameters.of(study, arc, estimate)
        paths = Labels.coded([link.path for link in observations.links], observations.link)
        types = Labels.coded(KINDS, observations.kind)
        return cls(
            study,
            arc,
            estimate,
            considered,
            problem_of(study, arc, estimate, considered.in_weights),
            stated_noise(arc, study.observations),
            SeriesOrder.of(types, paths, seconds_since_midnight(observations.epoch)),
        )

    @property
    def start(self) -> Motions:
        """A-priori motions of the targets."""
        return tuple(target.start for target in self.model.targets)


def errors_of(
    kinds: Sequence[tuple[Columns, list[Parameter]]], problem: ObservationModel, x: NDArray[np.float64]
) -> ConsideredErrors | None:
    """Return considered parameters with their partials at the parameters x of a problem; None of no kinds."""
    if not kinds:
        return None
    model, motions = ObservationModel.of(problem.predictor, (), kinds), problem.motions(x)
    at, residual_m = problem.predictor.at(motions), np.zeros(0)  # residuals are not asked for
    design = DesignMatrix(model, at, motions, model.parameters.prior_values, residual_m)
    return ConsideredErrors(model.parameters, design.partials)


def disturbed(problem: ObservationModel, x: NDArray[np.float64]) -> AdjustableOrbit | None:
    """The orbit at parameters x, with the errors of its gravity field that are considered, if it is one."""
    k = problem.orbit_index
    if problem.process is not None or k is None:
        return None  # process noise stands for what the field leaves out
    return problem.targets[k].gravity_errors(x[problem.columns_of(k)])


def require_position_or_orbit(study: Study, what: str) -> None:
    """Refuse a study in which neither a position nor an orbit is estimated."""
    if study.orbiter is None and study.estimate.position == "none":
        raise InputError(f'{what} needs the position estimated: [estimate] position is "none"')


def fitted_orbit(
    problem: ObservationModel,
    x: NDArray[np.float64],
    covariance: NDArray[np.float64],
    consider: Consider | None,
    errant: AdjustableOrbit | None,
) -> OrbitState | None:
    """The state of the orbit that is estimated, from the `covariance` of x, which is of all that is uncertain."""
    k = problem.orbit_index
    if k is None:
        return None
    mine = problem.columns_of(k)
    sensitivity = np.zeros((mine.stop - mine.start, 0))
    if consider is not None:
        sensitivity = consider.sensitivity[mine][:, list(consider.parameters.of_kind("gravity_error"))]
    return problem.targets[k].estimate(x[mine], covariance[mine, mine], sensitivity, errant)


def gravity_errors(orbit: AdjustableOrbit | None, problem: ObservationModel) -> ConsideredErrors | None:
    """Errors of an orbit's gravity field, with what they do to the observations."""
    if orbit is None:
        return None
    effects = problem.effects_on_orbit(orbit)
    names = [f"gravity_error.{k + 1}" for k in range(effects.shape[1])]
    parameters = [Parameter(name, "1", "gravity_error", 0.0, 1.0, role=Role.CONSIDERED) for name in names]
    return ConsideredErrors(ParameterSet(parameters), lambda rows: effects[rows])


def _columns(
    table: str, name: str, chosen: ParameterChoice, predictor: Predictor, role: Role, estimate: EstimateChoice
) -> tuple[Columns, list[Parameter]] | None:
    kind = PARAMETERS[name]
    with named(table):
        return chosen_parameters(kind, chosen, predictor.simple, role, estimate.pass_gap_h)


def status_of(arc: Predictor, motions: Motions | None = None) -> tuple[Labels, NDArray[np.int8]]:
    """Return why observations cannot be used for motions, by default those of the arc, as text and by code."""
    motions = arc.motions if motions is None else motions
    at, model = arc.at(motions), arc.model
    # The Moon hides spacecraft in the predictions themselves.
    earth_rad = {
        k: partial(earth_elevation_rad, model.ephemeris, model.libration, point_pa_m=motion.position_pa_m)
        for k, motion in enumerate(motions)
        if motion.trajectory is None
    }
    epoch = arc.observations.epoch
    may_set = [k for k, above in earth_rad.items() if _lowest_deg(above, epoch) < LOWEST_EARTH_DEG + 1.0]
    reason = np.zeros(len(arc.observations), dtype=np.int8)
    labels = np.zeros(len(arc.observations), dtype=np.int32)
    places = {USED: 0}
    for rows in blocks(arc):
        computed = at.rows(rows)
        bad = np.flatnonzero(~computed.usable)
        reason[rows[bad]], sentences = reasons(arc, computed.rows(bad), rows[bad])
        texts, which = np.unique(sentences, return_inverse=True)
        new = [places.setdefault(str(text), len(places)) for text in texts]
        labels[rows[bad]] = np.array(new, dtype=np.int32)[which]
        for target in may_set:
            mine = rows[(arc.target[rows] == target) & (reason[rows] == Status.OK)]
            # The Earth moves in the lander's sky with the librations, in days.
            tdb = tt_to_tdb(utc_to_tt(arc.observations.epoch[mine]))
            above_deg = np.degrees(evaluate_smooth(earth_rad[target], tdb))
            for k in np.flatnonzero(above_deg < LOWEST_EARTH_DEG):
                text = Status.EARTH_BELOW_HORIZON.text(above_deg[k])
                reason[mine[k]] = Status.EARTH_BELOW_HORIZON
                labels[mine[k]] = places.setdefault(text, len(places))
    return Labels(labels, tuple(places)), reason


def _lowest_deg(earth_rad: Callable[[Epochs], NDArray[np.float64]], epoch_utc: Epochs) -> float:
    """Return the lowest elevation of the Earth every six hours, in which it moves half a degree."""
    if not len(epoch_utc):
        return math.inf
    ends = epoch_utc[[int(epoch_utc.mjd.argmin()), int(epoch_utc.mjd.argmax())]]
    first, last = (tt_to_tdb(utc_to_tt(ends))[[k]] for k in (0, 1))
    span_d = last.seconds_since(first)[0] / SECONDS_PER_DAY
    count = int(4.0 * span_d) + 2
    if count > len(epoch_utc):
        return -math.inf
    epochs = Epochs.from_jd(first.jd, first.fraction + np.linspace(0.0, span_d, count), "TDB")
    return float(np.degrees(earth_rad(epochs).min()))


def with_independent_clocks(study: Study, estimate: EstimateChoice, arc: Predictor) -> EstimateChoice:
    """Return the study with offsets of independent clocks, unless ``[consider] defaults = false``.

    Held at zero, offsets of 1e-11 put the lander where it is not (`tests/unit/jobs/test_independent_clocks.py`).
    """
    if not study.consider_defaults:
        return estimate
    estimated, considered = set(estimate.parameters), set(study.consider)
    chosen = _frequency_offsets(estimated | (considered & {"frequency_offset"}), arc)
    chosen |= _clocks(estimated | considered, arc)
    return replace(estimate, parameters={**estimate.parameters, **chosen}) if chosen else estimate


def _frequency_offsets(said: set[str], tracking: Predictor) -> dict[str, ParameterChoice]:
    """Return a free offset for each link and pass of one- and three-way Doppler, unless the study has its own."""
    if said & {"frequency_offset", "clock_rate"}:
        return {}
    observations = tracking.observations
    three_way = [bool(link.transmitter) and link.transmitter != link.receiver for link in observations.links]
    free = (observations.kind == kind_of("doppler")) & np.array(three_way)[observations.link]
    if "target_frequency" not in said:
        free |= observations.kind == kind_of("one_way_doppler")
    paths = tuple(observations.links[k].path for k in np.unique(observations.link[free]))
    return {"frequency_offset": ParameterChoice(paths, per=Scope.LINK_AND_PASS)} if paths else {}


def _clocks(said: set[str], tracking: Predictor) -> dict[str, ParameterChoice]:
    """Offsets, free, and rates of the stations that have delays of quasars, but for the first, unless any are said."""
    of_quasars = (tracking.target < 0) & (tracking.observations.kind == kind_of("vlbi_delay"))
    if said & {"clock", "clock_rate"} or not of_quasars.any():
        return {}
    ends = np.stack([tracking.transmitters, tracking.receivers], axis=-1)[of_quasars]
    network, there = networks(ends, len(tracking.stations)), np.unique(ends)
    first = {network[k]: k for k in there[::-1]}
    names = tuple(tracking.stations[k] for k in there if first[network[k]] != k)
    return {"clock": ParameterChoice(names), "clock_rate": ParameterChoice(names, sigma=_RATE_SIGMA)}
