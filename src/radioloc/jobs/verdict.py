"""Whether a fit that has converged can be used: what the sum of squares does not say.

Least squares also settle where no lander can be: far above the Moon, or on its other side, whose ranges are nearly
those of this one. And an additive variance component lets any residuals fit their sigmas, those of a wrong station too.
Without these checks exchanged stations, ranges 100 km too long and points that no station sees converge
(`tests/unit/jobs/test_verdict.py`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import LUNAR_HEIGHT_LIMITS_M, MEAN_LUNAR_RADIUS_M
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.least_squares import FitStatus
from radioloc.estimation.variance_components import part_of_parameters
from radioloc.labels import USED, Labels
from radioloc.lunar.visibility import earth_elevation_rad
from radioloc.measurements.observations import Observations
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import KINDS, is_integrated
from radioloc.measurements.target_motion import Motions
from radioloc.results.build import Doubt
from radioloc.results.solution import Solution
from radioloc.study.study import Study
from radioloc.time import tt_to_tdb, utc_to_tt

LARGEST_MISFIT = 20.0
"""Residuals in stated sigmas that errors of the model no longer explain: laser ranges ask for 5 with DE421, radio
ranges for 10 where the troposphere is not modelled at all."""
_MODEL_M = 0.01
"""Accuracy of modelled ranges and delays: a stated sigma below it, as of laser ranges, counts as this much. What is
common to both ends of a count interval cancels in Doppler, which has no such floor."""
WIDEST_M = 0.1 * MEAN_LUNAR_RADIUS_M
"""Sigma of a position beyond which an error ellipse is none: the ground bends away from it by 9 km."""
LOWEST_EARTH_DEG = -8.0
"""The highest terrain sees 6.4 deg below the horizontal; the Earth's radius, light time and aberration are 1 deg, and
0.6 deg are the Moon's curvature over 20 km of an a-priori position that is off."""
_MIN_CUT_OFF, _MIN_CUT_OFF_FRACTION = 8, 0.05
"""Fewest first or last observations of an orbit, and their least fraction, that are a doubt where all are outliers."""
_MAX_MANOEUVRE_M_S = 200.0
"""Largest change of a round-trip range rate by a manoeuvre; counts that were not locked are off by more."""
NEAR_HOME_M = 1e5
"""Distance of an estimate from the a-priori position up to which any start ends at the same place."""
_EPOCHS = 100
"""The Earth moves in the point's sky with the librations, in days: of an arc so many epochs are looked at."""


def misfits(edited: EditedFit, stated_m: NDArray[np.float64], types: Labels) -> Iterator[Doubt]:
    """Types whose used residuals are far beyond their stated sigmas (n,), or which are mostly outliers."""
    fit = edited.fit
    usable = edited.given.are(USED)
    free_part = part_of_parameters(fit)
    beyond, floored = [], ""
    for name in types.present():
        mine = fit.used & types.are(name)
        count, outliers = int(mine.sum()), int((usable & types.are(name)).sum() - mine.sum())
        if outliers > count:
            yield Doubt(
                FitStatus.MISFIT,
                f"{outliers} of {count + outliers} {name} observations are left out as outliers, more than half: the "
                "others do not prove them wrong; look for a wrong station, target or sign",
            )
        dof = count * (1.0 - free_part)
        if dof < 0.5:  # without redundancy it is zero but for rounding
            continue
        floor_m = 0.0 if is_integrated(np.array(KINDS.index(name))) else _MODEL_M
        residual_m, sigma_m = fit.residual_m[mine], np.maximum(stated_m[mine], floor_m)
        ratio = math.sqrt(float(np.square(residual_m / sigma_m).sum()) / dof)
        if ratio > LARGEST_MISFIT:
            rms_m = math.sqrt(float(np.square(residual_m).mean()))
            beyond.append(f"of {name} {ratio:.4g} times ({rms_m:.3g} m rms)")
            if stated_m[mine].min() < floor_m:
                floored = f", those below {floor_m:g} m taken as {floor_m:g} m"
    if beyond:
        yield Doubt(
            FitStatus.MISFIT,
            f"the residuals are far beyond their stated sigmas{floored}: {', '.join(beyond)}; no model error explains "
            f"more than {LARGEST_MISFIT:g} times: look for a wrong station, target (an orbiter needs a trajectory or "
            "dynamics) or sign, for outliers among few observations, a term switched off, or a "
            "considered parameter to estimate",
        )


def cut_off_ends(edited: EditedFit, observations: Observations) -> Iterator[Doubt]:
    """Doubt an orbit whose first or last observations are all outliers, as beyond an undocumented manoeuvre.

    A study of 37 of 138 counts after 0.5 m/s converges without it: they look like counts that were not locked.
    """
    epoch, unlocked = observations.epoch, edited.fit.residual_m / observations.count_s
    rows = np.flatnonzero(edited.given.are(USED) & ~(np.abs(unlocked) > _MAX_MANOEUVRE_M_S))
    used = edited.fit.used[rows[np.lexsort((epoch.fraction[rows], epoch.jd[rows]))]]
    for end, ordered in (("first", used), ("last", used[::-1])):
        count = int(ordered.argmax()) if ordered.any() else 0
        if count >= max(_MIN_CUT_OFF, _MIN_CUT_OFF_FRACTION * len(used)):
            yield Doubt(
                FitStatus.MISFIT,
                f"the {end} {count} observations are left out as outliers, as they are beyond a manoeuvre that the "
                "study does not state",
            )


def heights(height_m: float) -> Iterator[Doubt]:
    """A height above the sphere of 1737.4 km that no place on the Moon has."""
    low_m, high_m = LUNAR_HEIGHT_LIMITS_M
    if not low_m <= height_m <= high_m:
        yield Doubt(
            FitStatus.OFF_THE_MOON,
            f"a height of {height_m / 1e3:.1f} km is outside the Moon's terrain ({low_m / 1e3:g} to "
            f"{high_m / 1e3:g} km): look at its sigma; an a-priori height, or a-priori sigmas of biases, may be "
            "needed",
        )


def places(
    arc: Predictor,
    motions: Motions,
    used: NDArray[np.bool_],
    elevation_deg: NDArray[np.float64],
) -> Iterator[Doubt]:
    """Estimates of points that are off the Moon's surface or that no station sees."""
    model = arc.model
    for target, motion in enumerate(motions):
        if motion.trajectory is not None:
            continue
        place_m = motion.position_pa_m
        yield from heights(float(np.linalg.norm(place_m)) - MEAN_LUNAR_RADIUS_M)
        rows = np.flatnonzero(used & (arc.target == target))
        if not len(rows):
            continue
        some = rows[np.unique(np.linspace(0, len(rows) - 1, _EPOCHS).astype(int))]
        tdb = tt_to_tdb(utc_to_tt(arc.observations.epoch[some]))
        earth_deg = np.degrees(earth_elevation_rad(model.ephemeris, model.libration, tdb, place_m))
        lowest_deg = float(earth_deg.min())
        if lowest_deg < LOWEST_EARTH_DEG:
            yield Doubt(
                FitStatus.HIDDEN,
                f"no station sees the point: the Earth is {-lowest_deg:.1f} deg below its horizon; the estimate is on "
                "the wrong side of the Moon, so start from a closer a-priori position",
            )
    below = np.flatnonzero(used & (elevation_deg < 0.0))
    if len(below):
        row = below[int(elevation_deg[below].argmin())]
        yield Doubt(
            FitStatus.HIDDEN,
            f"{len(below)} used observation{'s are' if len(below) > 1 else ' is'} below a station's horizon "
            f"for a point at the estimate, the lowest by {-elevation_deg[row]:.1f} deg "
            f"({arc.observations.links[arc.observations.link[row]].path}): check the stations and the epochs",
        )


def mark_if_unobservable(solution: Solution) -> Solution:
    """Set UNOBSERVABLE if the sigma of a position exceeds a tenth of the lunar radius."""
    ended = (
        FitStatus.CONVERGED,
        FitStatus.DIVERGED,
        FitStatus.MAX_ITERATIONS,
        FitStatus.OFF_THE_MOON,
    )
    if solution.status not in ended or solution.trajectory is not None or not solution.position_estimated:
        return solution
    several = [solution.of_target(target.name) for target in solution.targets] or [solution]
    sigma_m = max(float(np.linalg.norm(one.sigma_enu_m())) for one in several)
    if not sigma_m > WIDEST_M:
        return solution
    reason = (
        f"the sigma of the position is {1e-3 * sigma_m:.0f} km, more than a tenth of the lunar radius: the "
        "observations do not tell where on the Moon; add ranges, VLBI delays, an a-priori height, more stations or a "
        "longer arc"
    )
    # A height that says nothing needs no word of its own.
    also = "" if solution.status is FitStatus.OFF_THE_MOON else solution.message
    return replace(
        solution, status=FitStatus.UNOBSERVABLE, message="; ".join(text for text in (reason, also) if text)
    )


def search_that_helps(study: Study, solution: Solution, away_m: float) -> Iterator[str]:
    """Name the search that helps where an estimate cannot be used, or is far from the a-priori positions."""
    command = f"`radioloc search {study.path or 'STUDY.toml'}`"
    if study.orbiter is not None:
        if not solution.converged:
            yield f"{command} looks for manoeuvres that the study does not state"
    elif (
        solution.trajectory is None
        and solution.position_estimated
        and (not solution.converged or away_m > NEAR_HOME_M)
    ):
        yield (
            f"the fit ended {away_m / 1e3:.3g} km from the a-priori position: {command} looks for a better one "
            "over the near side"
        )
