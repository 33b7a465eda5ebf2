"""From a study to its solution: select, prepare, fit, report."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics import AdjustableOrbit
from radioloc.errors import InputError
from radioloc.estimation.consider import ConsideredErrors
from radioloc.estimation.editing import (
    EditedFit,
    PhaseCounts,
    fit_with_editing,
    phase_faults,
    with_reasons,
)
from radioloc.estimation.least_squares import FitStatus
from radioloc.estimation.variance_components import fit_with_variance_components
from radioloc.jobs.notes import notes_of, provenance
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.orbit_start import near_orbit
from radioloc.jobs.preparation import known_positions, prepared_arc
from radioloc.jobs.problem import (
    EstimationProblem,
    disturbed,
    fitted_orbit,
    status_of,
    weighed,
)
from radioloc.jobs.station_doubts import coordinate_doubts
from radioloc.jobs.stochastic import StochasticProblem
from radioloc.jobs.verdict import cut_off_ends, misfits, nowhere, places, search_that_helps
from radioloc.labels import USED, Labels
from radioloc.lunar import rot_pa_to_me
from radioloc.measurements.observations import Observations
from radioloc.measurements.predictor import Predictor, blocks
from radioloc.measurements.target_motion import Motions, positions_pa_m
from radioloc.results.build import Doubt, build_solution, compare_with
from radioloc.results.solution import Solution, TargetPosition
from radioloc.study.study import EstimateChoice, Study
from radioloc.study.study_file import as_study
from radioloc.targets.design import ObservationModel

logger = logging.getLogger(__name__)

_SAME_VISIBILITY_M = 1e3
"""Change of a fixed position that leaves its visibility as decided: 0.5 arc seconds of a station's elevation."""
_MAX_VISIBILITY_DECISIONS = 4
"""Fits after which visibility is decided anew: observations at a limit could be in and out by turns."""


def locate(study: Study | str | Path, observations: Observations | None = None) -> Solution:
    """Fit the position and what else the study asks for.

    Parameters
    ----------
    study : Study or path-like
        Built in Python, from :func:`~radioloc.study.study_file.read_study`, or the path of its file.
    observations : Observations, optional
        In place of the study's files.

    Raises
    ------
    RadiolocError
        The input is not usable; a fit that does not converge or is not observable is not an error but said in the
        solution.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate("examples/apollo15/apollo15.toml")
    >>> solution.converged, len(solution.residuals)
    (True, 153)
    """
    study = as_study(study)
    return fit_arc(study, *prepared_arc(study, observations), study.estimate)


def compute_residuals(study: Study | str | Path, observations: Observations | None = None) -> Solution:
    """Compute observed minus computed at the study's position; nothing is fitted or edited.

    Parameters and errors as :func:`locate`.

    Examples
    --------
    >>> import radioloc
    >>> radioloc.compute_residuals("examples/apollo15/apollo15.toml").residuals.residual_m.shape
    (153,)
    """
    study = as_study(study)
    return fit_arc(study, *prepared_arc(study, observations), None)


@on_one_blas_thread()
def fit_arc(
    study: Study,
    arc: Predictor,
    left_out: dict[str, int],
    estimate: EstimateChoice | None,
    *,
    consistency: bool = True,
) -> Solution:
    """Fit an arc that has been prepared already; of `estimate` nothing where it is ``None``.

    Groups of observations are tested for `consistency` on request only.
    """
    problem = EstimationProblem.of(study, arc, estimate)
    fitted = _fitted(problem)
    doubts = _doubts(fitted)
    solution = _solution(fitted, left_out, doubts, consistency)
    return _judged(fitted, solution, doubts)


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """A problem with its fit by final weights."""

    problem: EstimationProblem
    model: ObservationModel  # with the stochastic accelerations of its orbit, if there are any
    edited: EditedFit
    stochastic: StochasticProblem | None
    errors: AdjustableOrbit | None  # the orbit with the considered errors of its gravity field
    suboptimal: ConsideredErrors | None  # considered errors that are not in the weights
    elevation_deg: NDArray[np.float64]

    @property
    def x(self) -> NDArray[np.float64]:
        """Estimate of all parameters."""
        return self.edited.fit.x

    @property
    def motions(self) -> Motions:
        """Motions of the targets at the estimate."""
        return self.model.motions(self.x)


def _fitted(problem: EstimationProblem) -> _Fitted:
    """Fit, weigh dense series by their time correlation, and find what considered errors outside the weights do."""
    status, reason = status_of(problem.arc, problem.start)
    edited, stochastic = _fit(problem, status, reason)
    model = problem.model if stochastic is None else stochastic.here
    logger.info(
        "fitted %d parameters to %d of %d observations",
        model.parameters.free.sum(),
        edited.fit.used.sum(),
        len(problem.arc.observations),
    )
    # What errors of gravity do to an orbit takes seconds, and serves the parameters' sigmas and those over the arc.
    errors = disturbed(model, edited.fit.x)
    edited = weighed(model.linearize, edited, problem.order, problem.estimate)
    x = edited.fit.x
    suboptimal = problem.considered.suboptimal_errors(model, x, errors)
    elevation_deg = _elevation_deg(model.predictor, model.motions(x))
    return _Fitted(problem, model, edited, stochastic, errors, suboptimal, elevation_deg)


def _doubts(fitted: _Fitted) -> list[Doubt]:
    """Reasons why the estimate cannot be used although the fit converged."""
    problem, edited = fitted.problem, fitted.edited
    if problem.estimate is None:
        return []
    doubts = [*misfits(edited, problem.noise.sigma_m, problem.order.types)]
    if problem.model.of_orbit:
        doubts += cut_off_ends(edited, problem.arc.observations)
    # Where the residuals do not fit at all, place and sigmas are no reasons of their own.
    if not doubts and problem.study.points and problem.estimate.position != "none":
        doubts += places(fitted.model.predictor, fitted.motions, edited.fit.used, fitted.elevation_deg)
    return doubts


def _solution(
    fitted: _Fitted, left_out: dict[str, int], doubts: Sequence[Doubt], consistency: bool
) -> Solution:
    """Build the solution, with the state of an orbit and the differences to known positions."""
    problem, model, x = fitted.problem, fitted.model, fitted.x
    study, estimate, arc = problem.study, problem.estimate, model.predictor
    observations, constants = arc.observations, arc.model.ephemeris.constants
    reported = ~model.parameters.considered
    places = model.place_indices
    several = tuple(
        TargetPosition(
            model.targets[k].name, model.position_pa_m(x, k), model.position_partials(x, k)[:, reported]
        )
        for k in places
        if len(places) > 1
    )
    shown = next(iter(places), 0)
    solution = build_solution(
        fitted.edited,
        position_pa_m=model.position_pa_m(x, shown),
        position_partials=model.position_partials(x, shown)[:, reported],
        rot_pa_to_me=rot_pa_to_me(constants),
        pa_frame=arc.model.libration.frame,
        me_frame=constants.me_frame,
        epoch_utc=observations.epoch,
        station=Labels.coded(arc.stations, arc.receivers),
        observed_m=observations.value_m,
        path=Labels.coded([link.path for link in observations.links], observations.link),
        type=problem.order.types,
        elevation_deg=fitted.elevation_deg,
        count_s=observations.count_s,
        doubts=doubts,
        order=problem.order,
        consistency=consistency,
        ephemeris_sigma_enu_m=np.zeros(3) if estimate is None else np.array(estimate.ephemeris_sigma_m),
        name=study.name,
        provenance=provenance(study, arc, left_out, estimate, fitted.motions),
        considered=fitted.suboptimal,
        trajectory=None if places else str(arc.trajectories[0]),
        targets=several,
    )
    of_errors = None if solution.consider is None else solution.consider.parameters
    solution = replace(
        solution,
        notes=(
            *coordinate_doubts(arc, problem.start, fitted.edited.fit.used, _fits(doubts)),
            *notes_of(study, arc, left_out, estimate, fitted.edited, solution.position_pa_m, of_errors),
            *problem.considered.notes,
        ),
    )
    state = fitted_orbit(model, x, solution.parameter_covariance(), solution.consider, fitted.errors)
    if state is not None:
        if fitted.stochastic is not None:
            state = fitted.stochastic.smoothed(state, fitted.edited, problem.order, fitted.suboptimal)
        solution = replace(solution, trajectory=None if places else str(state.orbit), state=state)
    known = [compare_with(solution, xyz_m, name) for name, xyz_m in known_positions(study, constants)]
    first = None if study.reference is None else known.pop(0)
    return replace(solution, reference=first, references=tuple(known))


def _fits(doubts: Sequence[Doubt]) -> bool:
    """Return whether the residuals fit: the doubts, if there are any, are of the place only."""
    return all(doubt.status is not FitStatus.MISFIT for doubt in doubts)


def _judged(fitted: _Fitted, solution: Solution, doubts: Sequence[Doubt]) -> Solution:
    """Mark a position that the observations do not determine, and name the search that helps."""
    if _fits(doubts):
        solution = nowhere(solution)
    problem = fitted.problem
    if problem.estimate is None:
        return solution
    moved_m = positions_pa_m(fitted.motions) - positions_pa_m(problem.start)
    advice = search_that_helps(problem.study, solution, float(np.linalg.norm(moved_m, axis=-1).max()))
    return replace(solution, notes=(*solution.notes, *advice))


def _elevation_deg(arc: Predictor, motions: Motions) -> NDArray[np.float64]:
    """Lower of the stations' elevations, deg, shape (n,)."""
    at = arc.at(motions)
    elevation_deg = np.empty(len(arc.observations))
    for rows in blocks(arc):
        elevation_deg[rows] = np.degrees(at.rows(rows).elevation_rad.min(axis=-1))
    elevation_deg.flags.writeable = False
    return elevation_deg


def _reasons(status: Labels, reason: NDArray[np.int8], observations: Observations) -> str:
    """Why observations are rejected: how many for each reason, with the first of them as an example."""
    _, firsts, counts = np.unique(reason, return_index=True, return_counts=True)
    paths = observations.paths()
    return ", ".join(
        f"{count} as {paths[first]} of {observations.origin(first)}, {status[[first]][0]}"
        for first, count in sorted(zip(firsts.tolist(), counts.tolist(), strict=True), key=lambda p: -p[1])
    )


def _fit(
    given: EstimationProblem, status: Labels, reason: NDArray[np.int8]
) -> tuple[EditedFit, StochasticProblem | None]:
    """The fit, and its problem if the orbit has stochastic accelerations."""
    problem, noise, order, estimate = given.model, given.noise, given.order, given.estimate
    if estimate is None:
        plain = fit_with_editing(problem.linearize, problem.parameters, noise, status=status, threshold=None)
        return plain, None
    if not status.are(USED).any():
        raise InputError(
            f"no observations left: all {len(status)} are rejected: "
            f"{_reasons(status, reason, problem.predictor.observations)}; "
            "check the target's position and frame, and the stations, or look for a position by `radioloc search "
            "STUDY.toml`"
        )
    observations = problem.predictor.observations
    counts = PhaseCounts(observations.count_s, 1e-6 * observations.wavelength_um)
    usable, excluded = status.are(USED), dict[int, str]()
    process_noise = None if estimate.orbit is None else estimate.orbit.process_noise
    start = near_orbit(problem, noise.sigma_m, usable)
    if start is not None:
        status = _visibility_at(problem, start, status, usable)
    stochastic = None
    if process_noise is not None:
        x = problem.parameters.prior_values if start is None else start
        stochastic = StochasticProblem.about(problem, process_noise, x)
    # Positions with a prior of their own begin there, not where visibility was decided.
    decided_at = start if start is not None or estimate.position_priors else problem.parameters.prior_values
    decisions = 0
    while True:
        problem = problem if stochastic is None else stochastic.here
        visible = status.are(USED)
        fitted = fit_with_variance_components(
            problem.linearize,
            problem.parameters,
            noise,
            order=order,
            groups=estimate.component_groups(order),
            status=with_reasons(status, {row: why for row, why in excluded.items() if visible[row]}),
            threshold=estimate.rejection_sigma,
            start=start,
        )
        faults = phase_faults(fitted, order, counts) if fitted.ended else {}
        hidden = {row: reason for row, reason in faults.items() if fitted.fit.used[row]}
        excluded |= hidden
        if stochastic is not None and fitted.ended and not stochastic.near(fitted.fit):
            stochastic, start = stochastic.again(fitted.fit), fitted.fit.x
        elif not hidden:
            decided = status
            if (
                fitted.ended
                and not _is_near(problem, decided_at, fitted.fit.x)
                and decisions < _MAX_VISIBILITY_DECISIONS
            ):
                decisions, decided_at = decisions + 1, fitted.fit.x
                decided = _visibility_at(problem, fitted.fit.x, status, fitted.fit.used)
            if decided is status:
                return replace(fitted, reasons=faults), stochastic
            status, start = decided, fitted.fit.x


def _is_near(problem: ObservationModel, before: NDArray[np.float64] | None, x: NDArray[np.float64]) -> bool:
    """Return whether fixed positions at parameters x have the visibility that was decided at those before."""
    if before is None or problem.predictor.trajectories:
        return False
    moved_m = positions_pa_m(problem.motions(x)) - positions_pa_m(problem.motions(before))
    return bool(np.abs(moved_m).max(initial=0.0) < _SAME_VISIBILITY_M)


def _visibility_at(
    problem: ObservationModel, x: NDArray[np.float64], status: Labels, used: NDArray[np.bool_]
) -> Labels:
    """Decide anew at parameters x which observations can be used; return `status` itself where nothing changes.

    An estimate from which most of the used observations are invisible is not believed: the verdict says so. Without it
    counts behind the Moon as seen from the a-priori orbit are lost (`tests/unit/jobs/test_orbit_study.py`).
    """
    decided, _ = status_of(problem.predictor, problem.motions(x))
    visible = decided.are(USED)
    if np.array_equal(visible, status.are(USED)) or 2 * (visible & used).sum() < used.sum():
        return status
    return decided
