"""How the position depends on the length of the tracking arc: the same study with its first hours only."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from radioloc.ephemeris import Trajectory
from radioloc.errors import InputError
from radioloc.measurements.observations import Observations
from radioloc.report.arc_study import Arc, ArcStudy
from radioloc.studies.locate import fit_arc, prepared_arc
from radioloc.studies.orbiter import Orbiter
from radioloc.studies.selection import DEFAULT_HOURS, arc_lengths, arc_parts
from radioloc.studies.study import Reference, Study
from radioloc.studies.study_file import as_study


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
        Its own ``hours`` are replaced. Its ``reference``, or else the first of its ``references``, is the benchmark.
    hours : iterable of float
        Lengths of the arcs from the study's start, or else from the first observation, h.
    observations : Observations, optional
        In place of the study's files.

    Raises
    ------
    RadiolocError
        As :func:`~radioloc.studies.locate.locate`; a length is not above zero, or an arc holds no observation.

    Examples
    --------
    >>> import radioloc
    >>> found = radioloc.arcs("examples/change5/change5.toml", hours=[6.0, 12.0])
    >>> [arc.solution.converged for arc in found.arcs]
    [True, True]
    """
    study = as_study(study)
    if isinstance(study.target, Trajectory | Orbiter):
        raise InputError(
            f"{study.name}: an arc-length study compares positions, but the target is a trajectory; use locate or "
            "residuals, and of an orbiter `radioloc covariance` for what each length tells"
        )
    lengths = arc_lengths(hours, study.observations)
    known = (() if study.reference is None else (study.reference,)) + study.references
    whole = replace(
        study,
        observations=replace(study.observations, hours=lengths[-1]),
        reference=known[0] if known else None,
    )
    longest, left_out = prepared_arc(whole, observations)
    found = []
    for part in arc_parts(longest, whole, reversed(lengths)):
        later = len(longest.observations) - len(part.rows)
        reasons = dict(left_out)
        if later:
            reasons["outside the time span"] = reasons.get("outside the time span", 0) + later
        of_part = replace(whole.observations, hours=part.hours)
        one = replace(whole, name=f"{study.name}, {part.hours:g} h", observations=of_part)
        found.append(Arc(part.hours, part.span_h, fit_arc(one, part.arc, reasons, part.estimate)))
    constants = longest.model.ephemeris.constants
    references = [Reference(item.position.to_axes("ME", constants), item.name) for item in known]
    return ArcStudy(study.name, tuple(found), tuple(references), study.longitude_to_360)
