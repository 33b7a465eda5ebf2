"""Status of an end of a light path: codes in arrays, and their texts."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from radioloc.vectors import Floats

MIN_ELEVATION_RAD = np.deg2rad(3.0)
"""Lowest elevation at which the mapping functions are valid."""

WAVELENGTH_RANGE_UM = (0.3545, 1.0645)
"""Validity of the refraction of light, 0.355 to 1.064 micrometres; lasers named so emit at 0.3547 and 1.0642."""


class Status(IntEnum):
    """Reason for which an end of a light path cannot be used; kept in arrays of int8."""

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
        """Return the reason in words; empty for OK. The elevation is the target's, or the Earth's at the target."""
        return _TEXTS[self].format(e=elevation_deg, below=-elevation_deg, station=station)


_TEXTS = {
    Status.OK: "",
    Status.BELOW_HORIZON: "below the horizon ({e:.1f} deg)",
    Status.BEHIND_MOON: "behind the Moon as seen from {station}",
    Status.EARTH_BELOW_HORIZON: "the Earth is {below:.1f} deg below the target's horizon",
    Status.TOO_LOW: "too low for the troposphere model (below 3 degrees)",
    Status.NO_WAVELENGTH: "no wavelength recorded, which the troposphere model needs",
    Status.WAVELENGTH_OUTSIDE: "outside of the troposphere model's {}-{} um, or radio".format(
        *WAVELENGTH_RANGE_UM
    ),
    Status.NO_PRESSURE: "no pressure recorded, which the troposphere model needs",
    Status.NO_TEMPERATURE: "no temperature recorded, which the troposphere model needs",
    Status.NO_HUMIDITY: "no humidity recorded, which the troposphere model needs",
    Status.NO_FREQUENCY: "no frequency recorded, which the ionosphere needs",
    Status.OUTSIDE_MODEL: "outside of the validity of a medium's model",
    Status.NO_RAMP: "transmitted at a time without a ramp",
}


def first_failure(first: NDArray[np.int8], second: NDArray[np.int8]) -> NDArray[np.int8]:
    """Return the first status, or the second one where the first is OK."""
    return np.where(first != Status.OK, first, second)


def describe(
    status: NDArray[np.int8],
    elevation_rad: Floats,
    stations: Sequence[str] = (),
    ends: NDArray[np.int32] | None = None,
) -> tuple[NDArray[np.int8], NDArray[np.str_]]:
    """Return code and text of the first end at which an observation cannot be used; OK and empty if usable."""
    # Status, elevation of the target (rad) and index of the station's name are those at both ends, shape (n, 2).
    end = (status[:, 0] == Status.OK).astype(np.intp)[:, None]
    code = np.take_along_axis(status, end, axis=1)[:, 0]
    texts = np.zeros(len(code), dtype="<U1")
    if not code.any():
        return code, texts
    # Each different text is made once. Tenths of a degree count only in texts that show them.
    place = np.zeros(len(code)) if ends is None else np.take_along_axis(ends, end, axis=1)[:, 0]
    tenths = np.rint(10.0 * np.degrees(np.take_along_axis(elevation_rad, end, axis=1)[:, 0]))
    place = np.where(code == Status.BEHIND_MOON, place, 0)
    tenths = np.where(code == Status.BELOW_HORIZON, tenths, 0.0)
    names = list(stations) or ["a station"]
    different, text_of_row = np.unique(np.stack([code, place, tenths]), axis=1, return_inverse=True)
    shown = [Status(int(k)).text(tenth / 10.0, names[int(p)]) for k, p, tenth in different.T.tolist()]
    return code, np.array(shown, dtype=np.str_)[text_of_row]
