"""From a study to its solution: select, prepare, fit, report."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics import AdjustableOrbit
from radioloc.ephemeris import EphemerisConstants, Trajectory
from radioloc.errors import CoverageError, FileFormatError, InputError, require_type
from radioloc.estimation.consider import effects_beside_prior
from radioloc.estimation.editing import (
    EditedFit,
    PhaseCounts,
    fit_with_editing,
    phase_faults,
    with_reasons,
)
from radioloc.estimation.observation_noise import ObservationNoise
from radioloc.estimation.series import SeriesOrder, seconds_since_midnight
from radioloc.estimation.variance_components import fit_with_variance_components
from radioloc.io.formats import read_observations
from radioloc.jobs.notes import notes_of, provenance
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.orbit_start import near_orbit
from radioloc.jobs.problem import (
    considered_errors,
    disturbed,
    fitted_orbit,
    needs_more_partials,
    observation_model,
    planned_place,
    position_in_pa,
    start_pa_m,
    status_of,
    targets_in_pa,
    weighed,
    with_independent_clocks,
)
from radioloc.jobs.selection import select_observations, with_target_names
from radioloc.jobs.station_doubts import coordinate_doubts
from radioloc.jobs.station_noise import stated_noise
from radioloc.jobs.stochastic import StochasticProblem
from radioloc.jobs.verdict import cut_off_ends, misfits, nowhere, places, search_that_helps
from radioloc.labels import USED, Labels
from radioloc.lunar import rot_pa_to_me
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.ambiguity import without_ambiguity
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.link import canonical_target
from radioloc.measurements.observations import Observations, without_duplicates
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Predictor, blocks
from radioloc.measurements.quantised import with_rounding_in_sigmas
from radioloc.measurements.registry import KINDS
from radioloc.measurements.sources import read_sources
from radioloc.measurements.terms import TERMS
from radioloc.media.csp import read_csp
from radioloc.media.ionex import read_ionex
from radioloc.media.ionosphere import UniformTec
from radioloc.media.radio_atmosphere import RadioAtmosphere, read_radio_atmosphere
from radioloc.parameters.design import ObservationModel
from radioloc.results.build import build_solution, compare_with
from radioloc.results.solution import Solution, TargetPosition
from radioloc.study.identity import spacecraft_doubts
from radioloc.study.orbiter import Orbiter
from radioloc.study.study import EstimateChoice, ModelChoice, Study
from radioloc.study.study_file import as_study
from radioloc.study.uplinks import with_uplinks
from radioloc.study.weights import require_stations, weighted_observations

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


def arc_of(
    study: Study | str | Path, observations: Observations | None = None
) -> tuple[Predictor, NDArray[np.float64]]:
    """The prepared arc of a study and its a-priori position in principal axes, for predictions and tables of terms.

    Parameters and errors as :func:`locate`.

    Examples
    --------
    >>> import radioloc
    >>> arc, position_pa_m = radioloc.jobs.arc_of("examples/apollo15/apollo15.toml")
    >>> arc.compute(position_pa_m).by_position_pa.shape
    (153, 3)
    """
    study = as_study(study)
    arc, _ = prepared_arc(study, observations)
    return arc, start_pa_m(targets_in_pa(study, arc.model.ephemeris.constants))


@on_one_blas_thread()
def prepared_arc(
    study: Study, observations: Observations | None = None, orbit: AdjustableOrbit | None = None
) -> tuple[Predictor, dict[str, int]]:
    """The prepared arc of a study, and how many observations were not asked for, by reason.

    An orbiter's a-priori orbit over all of them may be given, which then is not integrated anew.
    """
    model = model_of(study)
    constants = model.ephemeris.constants
    targets = targets_in_pa(study, constants)
    _references(study, constants)  # one in a wrong frame is to be told before the work, not after it
    chosen, left_out = chosen_observations(study, observations, model)
    arc = _arc(study, model, chosen, targets, orbit)
    logger.info("prepared the model for %d observations by %s", len(chosen), ", ".join(arc.stations))
    _require_tracked(study, arc)
    return arc, left_out


def _require_tracked(study: Study, arc: Predictor) -> None:
    """Refuse a position on a map of what is not tracked."""
    tracked = [name for k in np.unique(arc.observations.link) for name in arc.observations.links[k].targets]
    for place in study.observations.map_positions:
        if place.known is not None or place.target is None:
            continue
        if canonical_target(place.target) not in map(canonical_target, tracked):
            raise InputError(
                "[[observations.map_positions]] target: expected a target that is tracked "
                f"({', '.join(dict.fromkeys(tracked))}) or a known place (known_deg_m), got {place.target!r}"
            )


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
    targets = targets_in_pa(study, constants)
    aimed = targets or planned_place(study, constants)
    problem = observation_model(arc, aimed, estimate, held=study.estimate)
    noise = stated_noise(arc, study.observations)
    paths = Labels.coded([link.path for link in observations.links], observations.link)
    types = Labels.coded(KINDS, observations.kind)
    order = SeriesOrder.of(types, paths, seconds_since_midnight(observations.epoch))
    orbit = arc.trajectory
    there = arc.along(orbit.coarse()) if isinstance(orbit, AdjustableOrbit) else arc
    status, reason = status_of(there, start_pa_m(targets))
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
    errant = disturbed(study, problem, fitted.fit.x)
    considered, not_considered = considered_errors(study, problem, estimate, fitted.fit.x, errant)
    common = None if considered is None else considered.at_stations
    edited = fitted
    fitted = weighed(problem.linearize, edited, order, estimate, common)
    if considered is not None and estimate is not None and estimate.position_priors:
        common = effects_beside_prior(fitted.fit, considered)
        fitted = weighed(problem.linearize, edited, order, estimate, common)
    x, used = fitted.fit.x, fitted.fit.used
    elevation_deg = _elevation_deg(arc, problem.all_positions_pa_m(x))
    doubts = [] if estimate is None else [*misfits(fitted, noise.sigma_m, types)]
    if estimate is not None and isinstance(study.target, Orbiter):
        doubts += cut_off_ends(fitted, observations)
    fits = not doubts
    # Where the residuals do not fit at all, place and sigmas say nothing of their own.
    if fits and estimate is not None and arc.trajectory is None and estimate.position != "none":
        doubts = [*places(arc, problem.all_positions_pa_m(x), used, elevation_deg)]
    lander_pa_m = problem.position_pa_m(x)
    several = tuple(
        TargetPosition(name, problem.position_pa_m(x, k), problem.position_partials(x, k))
        for k, name in enumerate(targets if len(targets) > 1 else ())
    )
    solution = build_solution(
        fitted,
        position_pa_m=lander_pa_m,
        position_partials=problem.position_partials(x),
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
        notes=(
            *coordinate_doubts(arc, start_pa_m(targets), used, fits),
            *notes_of(study, arc, left_out, estimate, fitted, lander_pa_m, considered),
            *not_considered,
        ),
        provenance=provenance(study, arc, left_out, estimate, problem.all_positions_pa_m(x)),
        considered=considered,
        trajectory=None if arc.trajectory is None or problem.landing is not None else str(there.trajectory),
        targets=several,
    )
    if isinstance(study.target, Orbiter):
        covariance = solution.parameter_covariance()
        state = fitted_orbit(study, problem, x, covariance, solution.consider, errant)
        if stochastic is not None:
            state = stochastic.smoothed(state, fitted.fit, solution, considered)
        if problem.landing is not None:
            solution = replace(solution, state=study.target.before_landing(state))
        else:
            solution = replace(solution, trajectory=str(state.orbit), state=state)
    known = [compare_with(solution, xyz_m, name) for name, xyz_m in _references(study, constants)]
    first = None if study.reference is None else known.pop(0)
    solution = replace(solution, reference=first, references=tuple(known))
    if fits:
        solution = nowhere(solution)
    if estimate is None:
        return solution
    advice = search_that_helps(study, solution, problem.all_positions_pa_m(x), start_pa_m(targets))
    return replace(solution, notes=(*solution.notes, *advice))


def _references(study: Study, constants: EphemerisConstants) -> list[tuple[str, NDArray[np.float64]]]:
    """Names of known positions and these in principal axes, m, that of ``[reference]`` first."""
    given = [] if study.reference is None else [("[reference]", study.reference)]
    given += [(f"[references] {one.name}", one) for one in study.references if one is not study.reference]
    return [(one.name, position_in_pa(table, one.position, constants).xyz_m) for table, one in given]


def model_of(study: Study) -> PhysicalModel:
    """The physical model that a study is fitted with; errors as :func:`locate`."""
    choice = study.model
    uniform = None if choice.tec_tecu is None else UniformTec(choice.tec_tecu)
    return PhysicalModel.build(
        ephemeris=choice.ephemeris,
        libration=choice.libration,
        earth_orientation=choice.earth_orientation,
        eop_beyond=choice.eop_beyond,
        catalogue=study.catalogue,
        ionosphere=read_ionex(choice.ionex) if choice.ionex else uniform,
        radio_atmosphere=_radio_atmosphere(choice),
        media_calibrations=read_csp(choice.csp, choice.csp_scid) if choice.csp else None,
        delays=choice.delays,
        free_clocks=choice.free_clocks,
        sources={name: place for path in choice.sources for name, place in read_sources(path).items()},
        off=set(TERMS) - choice.terms,
    )


def _radio_atmosphere(choice: ModelChoice) -> RadioAtmosphere | None:
    if not choice.vmf3 and choice.gpt3 is None and choice.vmf3_orography is None:
        return None
    try:
        return read_radio_atmosphere(choice.vmf3, choice.vmf3_orography, choice.gpt3)
    except FileFormatError:
        raise
    except InputError as error:
        raise InputError(f"[model] {error}") from None


def chosen_observations(
    study: Study, observations: Observations | None, model: PhysicalModel
) -> tuple[Observations, dict[str, int]]:
    """Return the observations of a study, and how many others there are, by reason; errors as :func:`locate`."""
    study.observations.require_transmitters()
    if observations is None:
        if study.simulation is not None and not study.observations.files:
            raise InputError(
                f"{study.name}: the study has no observations, only a simulation; use `radioloc montecarlo`, or "
                "`radioloc simulate` to make a file of observations and name it as [observations] files"
            )
        if not study.observations.files:
            raise InputError(
                f"{study.path or study.name}: [observations] files is missing; name at least one file (relative to the "
                "study file, globs allowed)"
            )
        observations = read_as(study, study.observations.files, model)
    else:
        require_type("observations", observations, Observations)
        observations = with_rounding_in_sigmas(without_duplicates(observations))
    chosen, left_out = select_observations(
        observations, study.observations, study.catalogue, study.targets, model.sources
    )
    spacecraft_doubts(study, chosen, model)  # identifiers that contradict each other are refused before a fit
    for key in ("vlbi_station_sigma_m", "vlbi_station_rate_sigma_m", "doppler_phase_sigma_m"):
        given = getattr(study.observations, key)
        if isinstance(given, Mapping):
            require_stations(chosen, key, given, study.catalogue)
    weighted = weighted_observations(chosen, study.observations.weights, study.catalogue)
    return with_uplinks(weighted, study.observations.uplinks, study.catalogue), left_out


def read_as(study: Study, files: Sequence[str | Path], model: PhysicalModel | None = None) -> Observations:
    """Observations of files, read by what a study, or its model, says of stations and Tracking Data Messages.

    Errors as of :func:`locate`.
    """
    # What the model has of delays, a file's are not to be taken off as well.
    tdm = replace(study.observations.tdm, modelled=(model or model_of(study)).delays)
    observations = read_observations(
        files,
        catalogue=study.catalogue,
        tdm=tdm,
        lunar=not isinstance(study.target, Trajectory | Orbiter),
        frequencies=study.observations.frequencies,
    )
    renamed = with_target_names(observations, study.observations.target_names)
    return observations if renamed is observations else without_duplicates(renamed)


def _arc(
    study: Study,
    model: PhysicalModel,
    observations: Observations,
    targets: Mapping[str, LunarPosition],
    given: AdjustableOrbit | None,
) -> Predictor:
    start_m, aimed, names = _aim(study, targets, model, observations, given)
    trajectory = aimed.coarse() if isinstance(aimed, AdjustableOrbit) else aimed  # only positions are needed
    more = needs_more_partials(study)
    try:
        if len(rows := np.flatnonzero(~np.isnan(observations.modulus_m))):
            ambiguous = ExactPredictor(model, observations.select(rows), start_m, trajectory, names)
            expected_m = np.full(len(observations), np.nan)
            expected_m[rows] = ambiguous.compute(start_m).value_m
            observations = without_ambiguity(observations, expected_m)
        arc = prepare_predictor(model, observations, start_m, study.model.evaluation, trajectory, names, more)
    except CoverageError:
        # The kernel or table does not know the files: say which observation lies outside, the first or the last.
        order = np.lexsort((observations.epoch.fraction, observations.epoch.jd))
        for row in (int(order[0]), int(order[-1])):
            try:
                prepare_predictor(model, observations.select([row]), start_m, "exact", trajectory, names)
            except CoverageError as error:
                error.args = (f"{observations.origin(row)}: {error}",)
                raise error from None
        raise
    return arc.along(aimed) if isinstance(aimed, AdjustableOrbit) else arc


def _aim(
    study: Study,
    targets: Mapping[str, LunarPosition],
    model: PhysicalModel,
    observations: Observations,
    orbit: AdjustableOrbit | None = None,
) -> tuple[NDArray[np.float64], Trajectory | AdjustableOrbit | None, tuple[str, ...]]:
    """What is predicted: positions or a trajectory, and names of several targets; of one, observations may have any."""
    trajectory: Trajectory | AdjustableOrbit | None = orbit
    if isinstance(study.target, Orbiter) and orbit is None:
        assert study.estimate.orbit is not None  # the study has seen to that
        parameters = study.estimate.orbit.parameters(study.target.forces)
        trajectory = study.target.orbit(model, observations, parameters)
        if study.target.landing is None:
            trajectory = trajectory.reaching_below_ground()
    elif isinstance(study.target, Trajectory):
        trajectory = study.target
    return start_pa_m(targets), trajectory, tuple(targets) if len(targets) > 1 else ()


def _elevation_deg(arc: Predictor, lander_pa_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lower of the stations' elevations, deg, shape (n,)."""
    at = arc.at(lander_pa_m)
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
    noise: ObservationNoise,
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
            "check the target's position and frame, and the stations"
        )
    observations = problem.predictor.observations
    counts = PhaseCounts(observations.count_s, 1e-6 * observations.wavelength_um)
    usable, excluded = status.are(USED), dict[int, str]()
    process_noise = None if estimate.orbit is None else estimate.orbit.process_noise
    start = near_orbit(problem, noise.sigma_m, usable) if problem.landing is None else None
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
    if before is None or problem.predictor.trajectory is not None:
        return False
    moved_m = problem.all_positions_pa_m(x) - problem.all_positions_pa_m(before)
    return bool(np.abs(moved_m).max(initial=0.0) < _SAME_VISIBILITY_M)


def _visibility_at(
    problem: ObservationModel, x: NDArray[np.float64], status: Labels, used: NDArray[np.bool_]
) -> Labels:
    """Decide anew at parameters x which observations can be used; return `status` itself where nothing changes.

    An estimate from which most of the used observations are invisible is not believed: the verdict says so. Without it
    counts behind the Moon as seen from the a-priori orbit are lost (`tests/unit/jobs/test_orbit_study.py`).
    """
    decided, _ = status_of(problem.predictor, problem.all_positions_pa_m(x))
    visible = decided.are(USED)
    if np.array_equal(visible, status.are(USED)) or 2 * (visible & used).sum() < used.sum():
        return status
    return decided
