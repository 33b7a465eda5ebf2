"""Fit of a study: position, orbit and other parameters from its observations.

1. Select observations and prepare the model (:mod:`~radioloc.jobs.preparation`).
2. Estimate parameters, reject outliers and estimate variance components. The fit is repeated after faults of counted
   phase are rejected, after stochastic orbits are linearized about the estimate, and after the visibility of the target
   is decided anew at the estimate.
3. Repeat the fit with correlated weights if the study asks for them; add errors that are not in the weights.
4. Test the residuals, decide whether the estimate is usable, and build the solution.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.estimation.consider import NO_ERRORS, UnestimatedErrors
from radioloc.estimation.consistency_results import Consistency, ConsistencyTest
from radioloc.estimation.editing import EditedFit, fit_with_editing, with_reasons
from radioloc.estimation.phase_editing import PhaseCounts, phase_faults
from radioloc.estimation.statistics import Residuals
from radioloc.estimation.status import Doubt, FitStatus
from radioloc.estimation.time_correlation import fit_with_correlated_weights
from radioloc.estimation.variance_components import fit_with_variance_components
from radioloc.jobs.error_columns import GravityErrorOrbits, orbit_state
from radioloc.jobs.mistakes import axes_mistakes, find_mistake
from radioloc.jobs.notes import model_limitations, provenance, study_notes
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.orbit_start import initial_orbit
from radioloc.jobs.preparation import known_positions, prepared_arc, usability, with_model_of_caller
from radioloc.jobs.problem import EstimationProblem
from radioloc.jobs.stochastic import StochasticProblem
from radioloc.jobs.verdict import (
    coordinate_doubts,
    curvature_doubts,
    decide_status,
    misfits,
    search_hints,
    with_considered,
)
from radioloc.labels import USED, Labels
from radioloc.lunar import rot_pa_to_me
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Predictor, blocks
from radioloc.measurements.target_motion import Motions, positions_pa_m
from radioloc.progress import step
from radioloc.results.build import AssessedFit, assess_fit, compare_with
from radioloc.results.estimate import LocatedEstimate, TargetPosition
from radioloc.results.solution import Solution
from radioloc.study.study import Study
from radioloc.study.study_file import as_study
from radioloc.targets.design import ObservationModel
from radioloc.targets.doubts import FittedObservations
from radioloc.targets.orbit_state import OrbitState
from radioloc.vectors import Floats, Mask

logger = logging.getLogger(__name__)

_MAX_SHIFT_M = 1e3  # of a position that keeps its visibility: 0.5 arc seconds of a station's elevation
_MAX_VISIBILITY_DECISIONS = 4  # fits with new visibility: observations at a limit could alternate


def locate(
    study: Study | str | Path, observations: Observations | None = None, model: PhysicalModel | None = None
) -> Solution:
    """Estimate the position and the other parameters of a study.

    Parameters
    ----------
    study : Study or path-like
        Built in Python, from :func:`~radioloc.study.study_file.read_study`, or the path of its file.
    observations : Observations, optional
        Observations in place of the study's files.
    model : PhysicalModel, optional
        Model and station catalogue in place of those of the study (``PhysicalModel.build``).

    Raises
    ------
    RadiolocError
        The input is not usable. The status of the solution, not an error, states a fit that does not converge.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate("examples/apollo15/apollo15.toml")
    >>> solution.converged, len(solution.residuals)
    (True, 153)
    """
    study = with_model_of_caller(as_study(study), model)
    return fit_arc(study, *prepared_arc(study, observations, model=model))


def compute_residuals(
    study: Study | str | Path, observations: Observations | None = None, model: PhysicalModel | None = None
) -> Solution:
    """Compute observed minus computed at the study's position; nothing is fitted or edited.

    Parameters and errors as :func:`locate`.

    Examples
    --------
    >>> import radioloc
    >>> radioloc.compute_residuals("examples/apollo15/apollo15.toml").residuals.residual_m.shape
    (153,)
    """
    study = with_model_of_caller(as_study(study), model)
    return fit_arc(study, *prepared_arc(study, observations, model=model), fixed=True)


@on_one_blas_thread()
def fit_arc(
    study: Study, predictor: Predictor, not_selected: dict[str, int], *, fixed: bool = False
) -> Solution:
    """Fit a prepared arc; if `fixed`, nothing is estimated."""
    return solve(EstimationProblem.from_study(study, predictor, study.estimate, fixed=fixed), not_selected)


@on_one_blas_thread()
def solve(problem: EstimationProblem, not_selected: dict[str, int], *, consistency: bool = True) -> Solution:
    """Fit a problem and build its solution; `not_selected` counts observations of the files by reason."""
    fitted = _fit(problem)
    with step("testing the residuals"):
        assessed, doubts = _assess(fitted, consistency), _doubts(fitted)
        mistake = find_mistake(problem, assessed, doubts) if consistency else None
        status, message = decide_status(assessed, doubts, mistake)
        converged = status is FitStatus.CONVERGED
        return assessed.solution(
            status,
            message,
            states=_states(fitted, assessed.estimate),
            **_comparisons(problem, assessed.estimate),
            consistency=_with_mistakes(fitted, assessed, mistake, converged),
            notes=_notes(fitted, assessed.estimate, not_selected, doubts, converged),
            limitations=model_limitations(fitted.model.predictor),
            provenance=provenance(problem, fitted.model.predictor, not_selected, fitted.motions),
        )


@dataclass(frozen=True, eq=False)
class _Fit:
    """Problem with its fit by final weights."""

    problem: EstimationProblem
    model: ObservationModel  # with the stochastic accelerations of its orbits, if there are any
    edited: EditedFit
    stochastic: StochasticProblem | None
    orbits: GravityErrorOrbits  # with the considered errors of their gravity fields
    unadjusted: UnestimatedErrors  # considered errors that are not in the weights

    @property
    def x(self) -> Floats:
        """Estimate of all parameters."""
        return self.edited.fit.x

    @cached_property
    def motions(self) -> Motions:
        """Motions of the targets at the estimate."""
        return self.model.motions(self.x)

    @cached_property
    def elevation_deg(self) -> Floats:
        """Lower of the stations' elevations, deg, shape (n,)."""
        prediction = self.model.predictor.predict(self.motions)
        elevation_deg = np.empty(len(self.problem.predictor.observations))
        for rows in blocks(self.model.predictor):
            elevation_deg[rows] = np.degrees(prediction.rows(rows).elevation_rad.min(axis=-1))
        elevation_deg.flags.writeable = False
        return elevation_deg


def _fit(problem: EstimationProblem) -> _Fit:
    """Estimate the parameters, and add the errors that are not in the weights."""
    status, codes = usability(problem.predictor, problem.prior_motions)
    with step(f"fitting {len(problem.predictor.observations)} observations"):
        edited, stochastic = _estimate(problem, status, codes)
    model = problem.model if stochastic is None else stochastic.with_process
    logger.info(
        "fitted %d parameters to %d of %d observations",
        model.parameters.free.sum(),
        edited.fit.used.sum(),
        len(problem.predictor.observations),
    )
    # The effects of gravity errors on an orbit take seconds; the parameters' sigmas and those over the arc share them.
    orbits = problem.orbits_with_gravity_errors(edited.fit.x)
    if problem.choice.weights == "correlated" and not problem.is_fixed:
        edited = fit_with_correlated_weights(model.linearize, edited, problem.order)
    unadjusted = problem.unadjusted_errors(model, edited.fit.x, orbits)
    return _Fit(problem, model, edited, stochastic, orbits, unadjusted)


def _assess(fitted: _Fit, consistency: bool) -> AssessedFit:
    """Return the reported estimate, residuals and consistency tests of a fit."""
    problem, model, edited, x = fitted.problem, fitted.model, fitted.edited, fitted.x
    predictor = model.predictor
    observations, constants = predictor.observations, predictor.model.ephemeris.constants
    residuals = Residuals(
        epoch_utc=observations.epoch,
        stations=Labels.coded(predictor.stations, predictor.receivers),
        types=problem.order.types,
        paths=Labels.coded([link.path for link in observations.links], observations.link),
        observed_m=observations.value_m,
        residual_m=edited.fit.residual_m,
        sigma_m=edited.fit.sigma_m,
        elevation_deg=fitted.elevation_deg,
        count_s=observations.count_s,
        statuses=edited.status,
    )
    reported, places = ~model.parameters.considered, model.place_indices
    trajectories = [fitted.motions[k].trajectory for k in model.orbit_indices] or predictor.trajectories[:1]
    positions = [
        TargetPosition(
            model.targets[k].name, model.position_pa_m(x, k), model.position_partials(x, k)[:, reported]
        )
        for k in places or [0]
    ]
    return assess_fit(
        edited,
        problem.order,
        residuals,
        considered=fitted.unadjusted,
        candidates=problem.fixed_parameter_errors(model, x, fitted.orbits)
        if consistency and not problem.is_fixed
        else NO_ERRORS,
        stated_m=problem.noise.sigma_m,
        consistency=consistency,
        name=problem.study.name,
        pa_frame=predictor.model.libration.frame,
        me_frame=constants.me_frame,
        position_pa_m=positions[0].position_pa_m,
        position_partials=positions[0].position_partials,
        rot_pa_to_me=rot_pa_to_me(constants),
        ephemeris_sigma_enu_m=np.array(problem.choice.ephemeris_sigma_m),
        trajectory=None if places else ", ".join(map(str, trajectories)),
        targets=tuple(positions) if len(places) > 1 else (),
    )


def _doubts(fitted: _Fit) -> list[Doubt]:
    """Return reasons why the estimate cannot be used although the fit converged."""
    problem, model, edited = fitted.problem, fitted.model, fitted.edited
    if problem.is_fixed:
        return []
    doubts = [*misfits(edited, with_considered(problem.noise.sigma_m, fitted.unadjusted), problem.order)]
    usable, fit = edited.initial_status.are(USED), edited.fit
    interval_s = problem.study.observations.normal_point_s
    if interval_s is not None:
        doubts += curvature_doubts(interval_s, _moved_m(fitted), problem.noise.sigma_m[fit.used].min())
    for k, target in enumerate(model.targets):
        observations = FittedObservations(
            model.predictor, k, usable, fit.used, fit.residual_m, fitted.elevation_deg
        )
        doubts += target.doubts(fitted.x[model.columns_of(k)], observations)
    # Doubts about a place follow from residuals that do not fit.
    return [doubt for doubt in doubts if doubt.status is FitStatus.MISFIT] or doubts


def _states(fitted: _Fit, estimate: LocatedEstimate) -> dict[str, OrbitState]:
    """Return the estimated states of spacecraft by the names of the targets."""
    model, covariance, consider = fitted.model, estimate.parameter_covariance(), estimate.consider
    states = {
        k: orbit_state(model, k, fitted.x, covariance, consider, fitted.orbits) for k in model.orbit_indices
    }
    if fitted.stochastic is not None:
        states |= fitted.stochastic.smoothed(states, fitted.edited, fitted.problem.order, fitted.unadjusted)
    return {model.targets[k].name: state for k, state in states.items()}


def _comparisons(problem: EstimationProblem, estimate: LocatedEstimate) -> dict[str, Any]:
    """Return the differences to known positions."""
    study, constants = problem.study, problem.predictor.model.ephemeris.constants
    comparisons = [compare_with(estimate, xyz_m, name) for name, xyz_m in known_positions(study, constants)]
    reference = None if study.reference is None else comparisons.pop(0)
    return {"reference": reference, "references": tuple(comparisons)}


def _with_mistakes(
    fitted: _Fit, assessed: AssessedFit, mistake: ConsistencyTest | None, converged: bool
) -> Consistency:
    """Return the consistency tests, with a mistake in place of their findings, or with axes that are mistaken."""
    findings = assessed.consistency.findings if mistake is None else (mistake,)
    if fitted.model.place_indices and converged:
        constants = fitted.model.predictor.model.ephemeris.constants
        findings = (*axes_mistakes(fitted.problem.study, assessed, constants), *findings)
    return replace(assessed.consistency, findings=findings)


def _notes(
    fitted: _Fit,
    estimate: LocatedEstimate,
    not_selected: dict[str, int],
    doubts: list[Doubt],
    converged: bool,
) -> tuple[str, ...]:
    """Return all notes: mistaken stations, data and model, searches that help."""
    problem, predictor = fitted.problem, fitted.model.predictor
    notes = [*coordinate_doubts(predictor, problem.prior_motions, fitted.edited.fit.used, doubts)]
    notes += study_notes(problem, predictor, not_selected, fitted.edited, estimate.consider.parameters)
    notes += problem.notes
    if not problem.is_fixed:
        notes += search_hints(problem.study, estimate, _moved_m(fitted), converged=converged)
    return tuple(notes)


def _moved_m(fitted: _Fit) -> float:
    """Return the largest distance of a target from its a-priori position, m."""
    moved_m = positions_pa_m(fitted.motions) - positions_pa_m(fitted.problem.prior_motions)
    return float(np.linalg.norm(moved_m, axis=-1).max())


def _require_usable(problem: EstimationProblem, status: Labels, codes: NDArray[np.int8]) -> None:
    """Refuse an arc without usable observations, with a count and an example of each reason."""
    if status.are(USED).any():
        return
    observations, reasons = problem.predictor.observations, list[str]()
    paths = observations.paths()
    _, firsts, counts = np.unique(codes, return_index=True, return_counts=True)
    for k in np.argsort(-counts, kind="stable").tolist():
        first = int(firsts[k])
        reasons.append(f"{counts[k]} as {paths[first]} of {observations.origin(first)}, {status[[first]][0]}")
    raise InputError(
        f"no observations left: all {len(status)} are rejected: {', '.join(reasons)}; "
        "check the target's position and frame, and the stations"
    )


def _estimate(
    problem: EstimationProblem, status: Labels, codes: NDArray[np.int8]
) -> tuple[EditedFit, StochasticProblem | None]:
    """Return the edited fit, and its problem if an orbit has stochastic accelerations."""
    model, estimate = problem.model, problem.choice
    if problem.is_fixed:
        fit = fit_with_editing(
            model.linearize, model.parameters, problem.noise, status=status, threshold=None
        )
        return fit, None
    _require_usable(problem, status, codes)
    observations = problem.predictor.observations
    counts = PhaseCounts(observations.count_s, observations.wavelength_um)
    usable, phase_reasons = status.are(USED), dict[int, str]()
    start = initial_orbit(model, problem.noise.sigma_m, usable)
    if start is not None:
        status = _updated_visibility(model, start, status, usable)
    stochastic = None
    if problem.has_process_noise:
        start = _with_points(problem, model.parameters.prior_values if start is None else start, status)
        stochastic = StochasticProblem.linearized_about(model, start)
    # Positions with a prior begin there, not where visibility was decided.
    visibility_x = start if start is not None or estimate.position_priors else model.parameters.prior_values
    decision_count = 0
    while True:
        model = model if stochastic is None else stochastic.with_process
        visible = status.are(USED)
        edited = fit_with_variance_components(
            model.linearize,
            model.parameters,
            problem.noise,
            order=problem.order,
            groups=estimate.component_groups(problem.order),
            status=with_reasons(status, {row: text for row, text in phase_reasons.items() if visible[row]}),
            threshold=estimate.rejection_sigma,
            start=start,
        )
        x = edited.fit.x
        faults = phase_faults(edited, problem.order, counts) if edited.is_at_minimum else {}
        used_faults = {row: reason for row, reason in faults.items() if edited.fit.used[row]}
        phase_reasons |= used_faults
        if stochastic is not None and edited.is_at_minimum and not stochastic.is_linear(edited.fit):
            stochastic, start = stochastic.relinearized(edited.fit), x
            continue
        if used_faults:
            continue
        is_final = not edited.is_at_minimum or decision_count == _MAX_VISIBILITY_DECISIONS
        if not is_final and not _is_near(model, visibility_x, x):
            decision_count, visibility_x = decision_count + 1, x
            new_status = _updated_visibility(model, x, status, edited.fit.used)
            if new_status is not status:
                status, start = new_status, x
                continue
        return replace(edited, reasons=faults), stochastic


def _with_points(problem: EstimationProblem, x: Floats, status: Labels) -> Floats:
    """Replace the parameters of targets other than orbits by those of a fit without process noise.

    The first selection with process noise is at the start. At an a-priori position that is 1.7 km off all observations
    of a lander beside an orbiter are rejected (`tests/unit/jobs/test_combinations.py`).
    """
    model = problem.model
    points = set(model.estimated_indices) - set(model.orbit_indices)
    if not points:
        return x
    fitted = fit_with_editing(model.linearize, model.parameters, problem.noise, status=status, start=x).fit
    x = x.copy()
    for k in points:
        x[model.columns_of(k)] = fitted.x[model.columns_of(k)]
    return x


def _is_near(model: ObservationModel, previous_x: Floats | None, x: Floats) -> bool:
    """Return whether visibility at parameters x is that at previous parameters."""
    if previous_x is None or model.predictor.trajectories:
        return False
    moved_m = positions_pa_m(model.motions(x)) - positions_pa_m(model.motions(previous_x))
    return bool(np.abs(moved_m).max(initial=0.0) < _MAX_SHIFT_M)


def _updated_visibility(model: ObservationModel, x: Floats, status: Labels, used: Mask) -> Labels:
    """Decide at parameters x which observations can be used; return `status` itself if that is the same.

    An estimate from which most of the used observations are invisible is ignored; the verdict states it. Otherwise
    counts behind the Moon as seen from the a-priori orbit are lost (`tests/unit/jobs/test_orbit_study.py`).
    """
    decided, _ = usability(model.predictor, model.motions(x))
    visible = decided.are(USED)
    if np.array_equal(visible, status.are(USED)) or 2 * (visible & used).sum() < used.sum():
        return status
    return decided
