"""Reasons why the estimate of a target cannot be used although the fit has converged.

Least squares also settle where no lander can be: far above the Moon, or on its far side, whose ranges are nearly those
of the near side. Without these checks points that no station sees converge (`tests/unit/jobs/test_verdict.py`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from radioloc.constants import LUNAR_HEIGHT_LIMITS_M, MEAN_LUNAR_RADIUS_M
from radioloc.estimation.status import Doubt, FitStatus
from radioloc.lunar.frames import earth_elevation_rad
from radioloc.measurements.predictor import Predictor
from radioloc.time import tt_to_tdb, utc_to_tt
from radioloc.vectors import Floats, Indices, Mask

MIN_EARTH_ELEVATION_DEG = -8.0
"""Lowest elevation of the Earth for a point that sees it: 6.4 deg below the horizontal from the highest terrain, 1 deg
for the Earth's radius, light time and aberration, 0.6 deg for an a-priori position that is 20 km off."""
_SAMPLED_EPOCH_COUNT = 100  # The Earth moves in a point's sky with the librations, in days
_MIN_CUT_OFF_COUNT, _MIN_CUT_OFF_FRACTION = 8, 0.05
"""Fewest first or last observations of an orbit, and their least fraction, that are a doubt where all are outliers."""
_MAX_MANOEUVRE_M_S = 200.0  # Change of a round-trip range rate; counts without lock are off by more


@dataclass(frozen=True, slots=True, eq=False)
class FittedObservations:
    """Observations after a fit, and the index of the target that is judged by them."""

    predictor: Predictor
    target: int
    usable: Mask  # (n,), of all targets, as the next three
    used: Mask
    residual_m: Floats
    elevation_deg: Floats  # lower of the stations' elevations

    @property
    def rows(self) -> Indices:
        """Observations of the target."""
        return np.flatnonzero(self.predictor.target == self.target)


def height_doubts(height_m: float) -> Iterator[Doubt]:
    """Doubt a height above the sphere of 1737.4 km that no place on the Moon has."""
    low_m, high_m = LUNAR_HEIGHT_LIMITS_M
    if not low_m <= height_m <= high_m:
        yield Doubt(
            FitStatus.OFF_THE_MOON,
            f"a height of {height_m / 1e3:.1f} km is outside the Moon's terrain ({low_m / 1e3:g} to "
            f"{high_m / 1e3:g} km): look at its sigma; an a-priori height, or a-priori sigmas of biases, may be "
            "needed",
        )


def place_doubts(position_pa_m: Floats, fitted: FittedObservations) -> Iterator[Doubt]:
    """Doubt a point that is off the Moon's surface or that no station sees.

    Parameters
    ----------
    position_pa_m : ndarray, shape (3,)
        Position in principal axes, m.
    fitted : FittedObservations
        Observations after the fit, as :meth:`Target.doubts` receives them.

    Yields
    ------
    Doubt
        Reason why the estimate cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> import radioloc
    >>> from radioloc.jobs.preparation import prepared_arc
    >>> from radioloc.targets.doubts import FittedObservations, place_doubts
    >>> arc, _ = prepared_arc(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> used, zeros = np.ones(153, dtype=bool), np.zeros(153)
    >>> fitted = FittedObservations(arc, 0, used, used, zeros, zeros)
    >>> [doubt.status.name for doubt in place_doubts(np.array([-1737.4e3, 0.0, 0.0]), fitted)]
    ['HIDDEN']
    """
    yield from height_doubts(float(np.linalg.norm(position_pa_m)) - MEAN_LUNAR_RADIUS_M)
    observations, model = fitted.predictor.observations, fitted.predictor.model
    rows = fitted.rows[fitted.used[fitted.rows]]
    if not len(rows):
        return
    sample = rows[np.unique(np.linspace(0, len(rows) - 1, _SAMPLED_EPOCH_COUNT).astype(int))]
    tdb = tt_to_tdb(utc_to_tt(observations.epoch[sample]))
    earth_deg = np.degrees(earth_elevation_rad(model.ephemeris, model.libration, tdb, position_pa_m))
    if (lowest_deg := float(earth_deg.min())) < MIN_EARTH_ELEVATION_DEG:
        yield Doubt(
            FitStatus.HIDDEN,
            f"no station sees the point: the Earth is {-lowest_deg:.1f} deg below its horizon; the estimate is on the "
            "wrong side of the Moon, so start from a closer a-priori position",
        )
    low_rows = rows[fitted.elevation_deg[rows] < 0.0]
    if len(low_rows):
        row = low_rows[int(fitted.elevation_deg[low_rows].argmin())]
        path = observations.links[observations.link[row]].path
        yield Doubt(
            FitStatus.HIDDEN,
            f"{len(low_rows)} used observation{'s are' if len(low_rows) > 1 else ' is'} below a station's horizon for "
            f"a point at the estimate, the lowest by {-fitted.elevation_deg[row]:.1f} deg ({path}): check the stations "
            "and the epochs",
        )


def cut_off_doubts(fitted: FittedObservations) -> Iterator[Doubt]:
    """Doubt an orbit whose first or last observations are all outliers, as beyond an undocumented manoeuvre."""
    # A study of 37 of 138 counts after 0.5 m/s converges without it: they look like counts that were not locked.
    observations, rows = fitted.predictor.observations, fitted.rows
    rate_m_s = np.abs(fitted.residual_m[rows] / observations.count_s[rows])
    rows = rows[fitted.usable[rows] & ~(rate_m_s > _MAX_MANOEUVRE_M_S)]
    epoch = observations.epoch
    used = fitted.used[rows[np.lexsort((epoch.fraction[rows], epoch.jd[rows]))]]
    for end, ordered in (("first", used), ("last", used[::-1])):
        count = int(ordered.argmax()) if ordered.any() else 0
        if count >= max(_MIN_CUT_OFF_COUNT, _MIN_CUT_OFF_FRACTION * len(used)):
            yield Doubt(
                FitStatus.MISFIT,
                f"the {end} {count} observations are left out as outliers, as they are beyond a manoeuvre that the "
                "study does not state",
            )
