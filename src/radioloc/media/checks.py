"""One way to refuse what a model of the atmosphere does not hold for."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError

LEAST_ELEVATION_RAD = np.deg2rad(3.0)
"""Below this mapping functions do not hold."""

WAVELENGTH_RANGE_UM = (0.3545, 1.0645)
"""Refraction of light is known from 0.355 to 1.064 micrometres; lasers named so emit at 0.3547 and 1.0642."""

_QUARTER_TURN_RAD = np.pi / 2
QUANTITIES = {
    "pressure": (300.0, 1100.0, "hPa"),
    "temperature": (200.0, 340.0, "K"),
    "relative humidity": (0.0, 1.0, "(a fraction: 45 % is 0.45)"),
    "mean temperature": (200.0, 340.0, "K"),
    "water vapour pressure": (0.0, 100.0, "hPa"),
    "water vapour decrease factor": (0.0, 20.0, "(a number near 3)"),
    "latitude": (-_QUARTER_TURN_RAD, _QUARTER_TURN_RAD, "rad"),
    "longitude": (-np.pi - 1e-12, 2.0 * np.pi + 1e-12, "rad"),
    "height": (-500.0, 9000.0, "m"),
    "elevation": (LEAST_ELEVATION_RAD, _QUARTER_TURN_RAD + 1e-12, "rad (3 to 90 degrees)"),
    "wavelength": (*WAVELENGTH_RANGE_UM, "micrometres"),
    "day of year": (0.0, 367.0, "days, 1 at 0h on 1 January"),
}
"""Least and most that make sense at a station on the ground, and the unit."""


def within(what: str, values: ArrayLike, model: str) -> NDArray[np.float64]:
    """Values of a quantity of :data:`QUANTITIES` as an array, if all lie in its range."""
    array = np.asarray(values, dtype=np.float64)
    least, most, unit = QUANTITIES[what]
    inside = (array >= least) & (array <= most)
    if not inside.all():
        wrong = np.ravel(array)[np.argmin(np.ravel(inside))]
        raise InputError(f"{what} is {wrong:.6g}, but {model} holds from {least:.6g} to {most:.6g} {unit}")
    return array
