"""Status of an end of a light path: codes, which become sentences only where they are shown."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from radioloc.vectors import Floats

LEAST_ELEVATION_RAD = np.deg2rad(3.0)
"""Below this mapping functions do not hold."""

WAVELENGTH_RANGE_UM = (0.3545, 1.0645)
"""Refraction of light is known from 0.355 to 1.064 micrometres; lasers named so emit at 0.3547 and 1.0642."""


class Status(IntEnum):
    """Why one end of a light path cannot be used; kept in arrays of int8."""

    OK = 0
    BELOW_HORIZON = 1
    BEHIND_MOON = 2
    EARTH_BELOW_HORIZON = 3
    TOO_LOW = 4
    NO_WAVELENGTH = 5
    WAVELENGTH_OUTSIDE = 6
    NO_PRESSURE = 7
    NO_TEMPERATURE = 8
    NO_HUMIDITY = 9
    NO_FREQUENCY = 10
    OUTSIDE_MODEL = 11
    NO_RAMP = 12

    def text(self, elevation_deg: float = np.nan, station: str = "") -> str:
        """Say what is wrong; empty if nothing is.

        The elevation is that of the target, or of the Earth above the target's horizon.
        """
        return _TEXTS[self].format(e=elevation_deg, below=-elevation_deg, station=station)


_TEXTS = {
    Status.OK: "",
    Status.BELOW_HORIZON: "below the horizon ({e:.1f} deg)",
    Status.BEHIND_MOON: "behind the Moon as seen from {station}",
    Status.EARTH_BELOW_HORIZON: "the Earth is {below:.1f} deg below the target's horizon",
    Status.TOO_LOW: "too low for the troposphere model (below 3 degrees)",
    Status.NO_WAVELENGTH: "no wavelength recorded, which the troposphere model needs",
    Status.WAVELENGTH_OUTSIDE: "no troposphere model but for {}-{} um, or radio".format(*WAVELENGTH_RANGE_UM),
    Status.NO_PRESSURE: "no pressure recorded, which the troposphere model needs",
    Status.NO_TEMPERATURE: "no temperature recorded, which the troposphere model needs",
    Status.NO_HUMIDITY: "no humidity recorded, which the troposphere model needs",
    Status.NO_FREQUENCY: "no frequency recorded, which the ionosphere needs",
    Status.OUTSIDE_MODEL: "outside of what the model of a medium covers",
    Status.NO_RAMP: "sent when no ramp says the transmitted frequency",
}


def first_of(one: NDArray[np.int8], other: NDArray[np.int8]) -> NDArray[np.int8]:
    """Status of rows that need both to be OK: the first that is not."""
    return np.where(one != Status.OK, one, other)


def describe(
    status: NDArray[np.int8],
    elevation_rad: Floats,
    stations: Sequence[str] = (),
    ends: NDArray[np.int32] | None = None,
) -> tuple[NDArray[np.int8], NDArray[np.str_]]:
    """Code and sentence for the first end at which an observation cannot be used; empty where it can."""
    # Status, elevation of the target (rad) and index of the station's name are those at both ends, shape (n, 2).
    end = (status[:, 0] == Status.OK).astype(np.intp)[:, None]
    code = np.take_along_axis(status, end, axis=1)[:, 0]
    texts = np.zeros(len(code), dtype="<U1")
    if not code.any():
        return code, texts
    # Few sentences differ; each is made once. Tenths of a degree are told apart only where they are told.
    place = np.zeros(len(code)) if ends is None else np.take_along_axis(ends, end, axis=1)[:, 0]
    tenths = np.rint(10.0 * np.degrees(np.take_along_axis(elevation_rad, end, axis=1)[:, 0]))
    place = np.where(code == Status.BEHIND_MOON, place, 0)
    tenths = np.where(code == Status.BELOW_HORIZON, tenths, 0.0)
    names = list(stations) or ["a station"]
    told, which = np.unique(np.stack([code, place, tenths]), axis=1, return_inverse=True)
    made = [Status(int(k)).text(tenth / 10.0, names[int(p)]) for k, p, tenth in told.T.tolist()]
    return code, np.array(made, dtype=np.str_)[which]
