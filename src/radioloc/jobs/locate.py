"""From a study to its solution: select, prepare, fit, report."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.estimation.editing import (
    EditedFit,
    PhaseCounts,
    fit_with_editing,
    phase_faults,
    with_reasons,
)
from radioloc.estimation.series import SeriesOrder, seconds_since_midnight
from radioloc.estimation.variance_components import fit_with_variance_components
from radioloc.jobs.notes import notes_of, provenance
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.orbit_start import near_orbit
from radioloc.jobs.preparation import known_positions, prepared_arc
from radioloc.jobs.problem import (
    ConsideredParameters,
    disturbed,
    fitted_orbit,
    problem_of,
    status_of,
    weighed,
    with_independent_clocks,
)
from radioloc.jobs.station_doubts import coordinate_doubts
from radioloc.jobs.station_noise import stated_noise
from radioloc.jobs.stochastic import StochasticProblem
from radioloc.jobs.verdict import cut_off_ends, misfits, nowhere, places, search_that_helps
from radioloc.labels import USED, Labels
from radioloc.lunar import rot_pa_to_me
from radioloc.measurements.observations import Observations
from radioloc.measurements.predictor import Predictor, blocks
from radioloc.measurements.registry import KINDS
from radioloc.measurements.target_motion import Motions, positions_pa_m
from radioloc.noise import ObservationCovariance
from radioloc.results.build import build_solution, compare_with
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


def residuals(study: Study | str | Path, observations: Observations | None = None) -> Solution:
    """Observed minus computed at the study's position, nothing fitted, nothing edited.

    Parameters and errors as :func:`locate`.

    Examples
    --------
    >>> import radioloc
    >>> radioloc.residuals("examples/apollo15/apollo15.toml").residuals.residual_m.shape
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
    model, observations = arc.model, arc.observations
    constants = model.ephemeris.constants
    if estimate is not None:
        estimate = with_independent_clocks(study, estimate, arc)
    considered = ConsideredParameters.of(study, arc, estimate)
    problem = problem_of(study, arc, estimate, considered.in_weights)
    reported = ~problem.parameters.considered
    noise = stated_noise(arc, study.observations)
    paths = Labels.coded([link.path for link in observations.links], observations.link)
    types = Labels.coded(KINDS, observations.kind)
    order = SeriesOrder.of(types, paths, seconds_since_midnight(observations.epoch))
    start = tuple(target.start for target in problem.targets)
    status, reason = status_of(arc, start)
    fitted, stochastic = _fit(problem, noise, order, estimate, status, reason)
    if stochastic is not None:
        problem = stochastic.here
        arc = problem.predictor
    logger.info(
        "fitted %d parameters to %d of %d observations",
        problem.parameters.free.sum(),
        fitted.fit.used.sum(),
        len(observations),
    )
    # What errors of gravity do to an orbit takes seconds, and serves the parameters' sigmas and those over the arc.
    errant = disturbed(problem, fitted.fit.x)
    fitted = weighed(problem.linearize, fitted, order, estimate)
    suboptimal = considered.suboptimal_errors(problem, fitted.fit.x, errant)
    x, used = fitted.fit.x, fitted.fit.used
    elevation_deg = _elevation_deg(arc, problem.motions(x))
    doubts = [] if estimate is None else [*misfits(fitted, noise.sigma_m, types)]
    if estimate is not None and problem.of_orbit:
        doubts += cut_off_ends(fitted, observations)
    fits = not doubts
    # Where the residuals do not fit at all, place and sigmas say nothing of their own.
    if fits and estimate is not None and study.points and estimate.position != "none":
        doubts = [*places(arc, problem.motions(x), used, elevation_deg)]
    has_place = bool(study.points) or study.lands
    lander_pa_m = problem.position_pa_m(x)
    several = tuple(
        TargetPosition(name, problem.position_pa_m(x, k), problem.position_partials(x, k)[:, reported])
        for k, name in enumerate(study.points if len(study.points) > 1 else ())
    )
    solution = build_solution(
        fitted,
        position_pa_m=lander_pa_m,
        position_partials=problem.position_partials(x)[:, reported],
        rot_pa_to_me=rot_pa_to_me(constants),
        pa_frame=model.libration.frame,
        me_frame=constants.me_frame,
        epoch_utc=observations.epoch,
        station=Labels.coded(arc.stations, arc.receivers),
        observed_m=observations.value_m,
        path=paths,
        type=types,
        elevation_deg=elevation_deg,
        count_s=observations.count_s,
        doubts=doubts,
        order=order,
        consistency=consistency,
        ephemeris_sigma_enu_m=np.zeros(3) if estimate is None else np.array(estimate.ephemeris_sigma_m),
        name=study.name,
        provenance=provenance(study, arc, left_out, estimate, problem.motions(x)),
        considered=suboptimal,
        trajectory=None if has_place else str(arc.trajectories[0]),
        targets=several,
    )
    of_errors = None if solution.consider is None else solution.consider.parameters
    solution = replace(
        solution,
        notes=(
            *coordinate_doubts(arc, start, used, fits),
            *notes_of(study, arc, left_out, estimate, fitted, lander_pa_m, of_errors),
            *considered.notes,
        ),
    )
    state = fitted_orbit(problem, x, solution.parameter_covariance(), solution.consider, errant)
    if state is not None:
        if stochastic is not None:
            state = stochastic.smoothed(state, fitted, order, suboptimal)
        solution = replace(solution, trajectory=None if has_place else str(state.orbit), state=state)
    known = [compare_with(solution, xyz_m, name) for name, xyz_m in known_positions(study, constants)]
    first = None if study.reference is None else known.pop(0)
    solution = replace(solution, reference=first, references=tuple(known))
    if fits:
        solution = nowhere(solution)
    if estimate is None:
        return solution
    moved_m = positions_pa_m(problem.motions(x)) - positions_pa_m(start)
    advice = search_that_helps(study, solution, float(np.linalg.norm(moved_m, axis=-1).max()))
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
    problem: ObservationModel,
    noise: ObservationCovariance,
    order: SeriesOrder,
    estimate: EstimateChoice | None,
    status: Labels,
    reason: NDArray[np.int8],
) -> tuple[EditedFit, StochasticProblem | None]:
    """The fit, and its problem if the orbit has stochastic accelerations."""
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
