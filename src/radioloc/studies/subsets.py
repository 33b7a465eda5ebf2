"""What a position rests on: the same study without each of its stations and links."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.ephemeris import Trajectory
from radioloc.errors import InputError
from radioloc.estimation.solution import Solution
from radioloc.estimation.statistics import finite_or_none
from radioloc.measurements.predictor import Predictor
from radioloc.progress import progress_bar
from radioloc.report.arc_study import apart
from radioloc.report.covariance import radius_95_m
from radioloc.report.leave_one_out import LeaveOneOut, Without
from radioloc.studies.locate import fit_arc, logger, prepared_arc
from radioloc.studies.orbiter import Orbiter
from radioloc.studies.study import Study
from radioloc.studies.study_file import as_study
from radioloc.studies.weights import ends_of

_Mask = NDArray[np.bool_]


def leave_one_out(study: Study | str | Path, *, progress: bool = False) -> LeaveOneOut:
    """Fit a study without each of its stations and, where they are others, without each of its links.

    The model is prepared once; each fit has its own editing and weights.

    Parameters
    ----------
    study : Study or path-like
        Of one position on the Moon, which is estimated.
    progress : bool
        Whether a bar on standard error tells how many fits are done.

    Raises
    ------
    RadiolocError
        As :func:`~radioloc.studies.locate.locate`; the study is of another kind, or all observations are of one link.

    Examples
    --------
    >>> from radioloc.studies import leave_one_out
    >>> [one.name for one in leave_one_out("examples/change5/short_arc.toml").without]
    ['JIAMUSI', 'KASHI']
    """
    study = as_study(study)
    if (
        isinstance(study.target, Trajectory | Orbiter)
        or len(study.targets) > 1
        or study.estimate.position == "none"
    ):
        raise InputError(
            f"{study.name}: leaving stations out needs one position on the Moon that is estimated; of an orbiter "
            "`radioloc covariance` says what each station tells"
        )
    arc, left_out = prepared_arc(study)
    groups = _groups(arc, study)
    if not groups:
        raise InputError(
            f"{study.name}: all observations are of one station or link, without which there are none; "
            "use `radioloc locate`"
        )
    whole = fit_arc(study, arc, left_out, study.estimate)
    found = []
    for (kind, name), mine in progress_bar(groups.items(), wanted=progress, unit="fit"):
        logger.info("without %s", name)
        part = arc.select(np.flatnonzero(~mine))
        reasons = left_out | {f"of {name}": int(mine.sum())}
        solution = fit_arc(study, part, reasons, study.estimate.of_part(part), consistency=False)
        found.append(_without(kind, name, int(mine.sum()), solution, whole))
    return LeaveOneOut(whole, tuple(found))


def _groups(arc: Predictor, study: Study) -> dict[tuple[str, str], _Mask]:
    """Which observations are of each station, and of each link that is no station's only one."""
    observations = arc.observations
    ends = ends_of(observations.links, study.catalogue)
    present = np.unique(observations.link)
    found: dict[tuple[str, str], _Mask] = {}
    for name in sorted(set().union(*(ends[k] for k in present))):
        found["station", name] = np.array([name in of for of in ends])[observations.link]
    for k in present:
        found["link", observations.links[k].path] = observations.link == k
    distinct: dict[bytes, tuple[str, str]] = {}
    for key, mine in found.items():
        distinct.setdefault(mine.tobytes(), key)
    return {key: found[key] for key in distinct.values() if not found[key].all()}


def _without(kind: str, name: str, count: int, part: Solution, whole: Solution) -> Without:
    used, converged = part.fit.total.used, part.converged
    if not (part.position_determined and whole.position_determined):
        return Without(kind, name, count, used, converged)
    shift = apart(part, whole)
    return Without(
        kind,
        name,
        count,
        used,
        converged,
        finite_or_none(radius_95_m(part.position_covariance()[:2, :2])),
        shift.difference_enu_m,
        shift.sigma_enu_m,
        None if shift.chi2 is None else math.sqrt(shift.chi2),
    )
