"""Transformation of earlier realizations of the ITRF to ITRF2020, the frame of Earth orientation.

Seven parameters and their rates transform ITRF2020 to each earlier frame (Altamimi et al. 2023; IERS Conventions 2010,
equation 4.3):

    x_earlier = x + T + D x + R x,    R x = (-R3 y + R2 z, R3 x - R1 z, -R2 x + R1 y),

all at the epoch of the position. The inverse uses the opposite signs, accurate to some nanometres.

The ITRF93 of the Deep Space Network has the orientation of ITRF93, which rotates against the others by 7 mm a year, but
origin and scale of later frames: with the rotations alone its coordinates (DSN 810-005, module 301) agree with
those of GSFC's VLBI solution 2019d to 3 to 10 cm in 2020, with all of the parameters to 13 to 16 cm only. So
``"ITRF93_DSN"`` is a frame of its own.
"""

from __future__ import annotations

import csv
from functools import cache
from importlib.resources import files

import numpy as np

from radioloc.constants import ARCSEC_RAD
from radioloc.vectors import Floats

_EPOCH_YEAR = 2015.0
_UNITS = np.array([1e-3, 1e-3, 1e-3, 1e-9, *3 * [1e-3 * ARCSEC_RAD]])


@cache
def _parameters() -> dict[str, Floats]:
    """Return parameters from ITRF2020 at 2015.0 and their rates by frame, m and rad, shape (2, 7)."""
    text = (files("radioloc.earth") / "data" / "itrf2020_to_itrf.csv").read_text(encoding="utf-8")
    rows = csv.reader(line for line in text.splitlines() if not line.startswith(("#", "frame")))
    published = {name: np.array(numbers, dtype=np.float64).reshape(2, 7) * _UNITS for name, *numbers in rows}
    return {"ITRF2020": np.zeros((2, 7))} | published


def frames() -> tuple[str, ...]:
    """Return the names of the frames, the latest first."""
    return tuple(_parameters())


def to_itrf2020(
    frame: str, itrf_m: Floats, velocity_m_yr: Floats, epoch_year: float
) -> tuple[Floats, Floats]:
    """Transform position (m) and velocity (m per Julian year) at an epoch from one of :func:`frames` to ITRF2020."""
    at_2015, rate = _parameters()[frame]
    away_m = _difference(at_2015 + (epoch_year - _EPOCH_YEAR) * rate, itrf_m)
    return itrf_m - away_m, velocity_m_yr - _difference(rate, itrf_m)


def _difference(parameters: Floats, itrf_m: Floats) -> Floats:
    return np.asarray(parameters[:3] + parameters[3] * itrf_m + np.cross(parameters[4:], itrf_m))
