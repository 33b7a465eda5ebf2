"""Fits of parts of a study's observations: its first hours, and all without each of its stations and links."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from radioloc.errors import InputError
from radioloc.jobs.locate import logger, solve
from radioloc.jobs.preparation import prepared_arc
from radioloc.jobs.problem import EstimationProblem, arc_parts, require_position_or_orbit
from radioloc.jobs.selection import DEFAULT_HOURS, arc_lengths
from radioloc.measurements.observations import Observations
from radioloc.measurements.predictor import Predictor
from radioloc.progress import progress_bar
from radioloc.results.subsets import Arc, ArcStudy, LeaveOneOut, Omission
from radioloc.study.observation_choice import rows_by_station
from radioloc.study.study import Reference, Study
from radioloc.study.study_file import as_study
from radioloc.vectors import Mask


def arcs(
    study: Study | str | Path,
    hours: Iterable[float] = DEFAULT_HOURS,
    observations: Observations | None = None,
) -> ArcStudy:
    """Fit the first hours of a study's observations, for several lengths.

    The model is prepared once, for the longest arc.

    Parameters
    ----------
    study : Study or path-like
        Study, without regard to its ``hours``. Its ``reference``, or else the first of its ``references``, is the
        benchmark.
    hours : iterable of float
        Lengths of the arcs from the study's start, or else from the first observation, h.
    observations : Observations, optional
        Observations in place of the study's files.

    Raises
    ------
    RadiolocError
        The study cannot be fitted, a length is not above zero, or an arc has no observations.

    Examples
    --------
    >>> import radioloc
    >>> study = radioloc.arcs("examples/change5/change5.toml", hours=[6.0, 12.0])
    >>> [arc.solution.converged for arc in study.arcs]
    [True, True]
    """
    study = as_study(study)
    if len(study.trajectories) == len(study.all_targets):
        raise InputError(
            f"{study.name}: an arc-length study compares positions and states, but the motion of each target is "
            "known; use `radioloc residuals`"
        )
    lengths = arc_lengths(hours, study.observations)
    known_places = (() if study.reference is None else (study.reference,)) + study.references
    whole_study = replace(
        study,
        observations=replace(study.observations, hours=lengths[-1]),
        reference=known_places[0] if known_places else None,
    )
    longest, left_out = prepared_arc(whole_study, observations)
    solutions = []
    for part in arc_parts(
        EstimationProblem.from_study(whole_study, longest, whole_study.estimate), reversed(lengths)
    ):
        later = len(longest.observations) - len(part.rows)
        reasons = dict(left_out)
        if later:
            reasons["outside the time span"] = reasons.get("outside the time span", 0) + later
        of_part = replace(whole_study.observations, hours=part.hours)
        part_study = replace(whole_study, name=f"{study.name}, {part.hours:g} h", observations=of_part)
        solution = solve(replace(part.problem, study=part_study), reasons)
        solutions.append(Arc(part.hours, part.span_h, solution))
    constants = longest.model.ephemeris.constants
    references = [Reference(item.position.to_axes("ME", constants), item.name) for item in known_places]
    return ArcStudy(study.name, tuple(solutions), tuple(references))


def leave_one_out(
    study: Study | str | Path, observations: Observations | None = None, *, progress: bool = False
) -> LeaveOneOut:
    """Fit a study without each of its stations, then without each of its links.

    The model is prepared once; each fit has its own editing and weights.

    Parameters
    ----------
    study : Study or path-like
        Study that estimates a position or an orbit.
    observations : Observations, optional
        Observations in place of the study's files.
    progress : bool
        Whether to show a progress bar of the fits on standard error.

    Raises
    ------
    RadiolocError
        The study cannot be fitted, estimates no position or orbit, or has a single link.

    Examples
    --------
    >>> from radioloc import leave_one_out
    >>> [item.name for item in leave_one_out("examples/change5/short_arc.toml").omissions]
    ['JIAMUSI', 'KASHI']
    """
    study = as_study(study)
    require_position_or_orbit(study, "leaving stations out")
    predictor, left_out = prepared_arc(study, observations)
    groups = _groups(predictor, study)
    if not groups:
        raise InputError(f"{study.name}: all observations are of one station or link; use `radioloc locate`")
    problem = EstimationProblem.from_study(study, predictor, study.estimate)
    solution = solve(problem, left_out)
    omissions = list[Omission]()
    for (kind, name), mask in progress_bar(groups.items(), shown=progress, unit="fit"):
        logger.info("without %s", name)
        count = int(mask.sum())
        part = problem.select(np.flatnonzero(~mask))
        omitted = solve(part, left_out | {f"of {name}": count}, consistency=False)
        omissions += Omission.from_solutions(kind, name, count, omitted, solution)
    return LeaveOneOut(solution, tuple(omissions))


def _groups(predictor: Predictor, study: Study) -> dict[tuple[str, str], Mask]:
    """Return the masks of the observations of each station, and of each link of a station with several."""
    observations = predictor.observations
    by_station = rows_by_station(observations, study.catalogue)
    groups = {("station", name): mask for name, mask in by_station.items()}
    for k in np.unique(observations.link):
        groups["link", observations.links[k].path] = observations.link == k
    distinct: dict[bytes, tuple[str, str]] = {}
    for key, mask in groups.items():
        distinct.setdefault(mask.tobytes(), key)
    return {key: groups[key] for key in distinct.values() if not groups[key].all()}
