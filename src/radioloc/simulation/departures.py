"""Departures of the world from the model that are not known: drawn anew in every trial of a Monte Carlo study.

A spread says how large each departure is, one standard deviation; :class:`~radioloc.simulation.truth.Truth` says what
they are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.simulation.model_errors import NO_OFFSET, ModelErrors
from radioloc.simulation.noise import generator
from radioloc.simulation.truth import Clock, Truth

POSITION = "position_enu_m"
"""The one departure that is not of :class:`~radioloc.simulation.truth.Truth`: where the point itself stands."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread(ModelErrors):
    """Standard deviations of departures, about the values of a truth.

    Parameters
    ----------
    position_enu_m : tuple of float
        Of the point itself about its nominal place, to the east, to the north and up (selenocentric), m: how far a
        terrain map's height may be wrong, where the study has a prior on the height.
    moon_m, libration_rad, station_enu_m, ut1_s, pole_rad, range_bias_m, zenith_delay_m, tec_tecu
        As in :class:`~radioloc.simulation.model_errors.ModelErrors`.
    clock_s, clock_rate : mapping of str to float
        Of the stations' clocks, s and s/s.
    clock_epoch_utc : str, optional
        When the drawn offsets hold of clocks whose truth has no epoch; needed with rates.

    Raises
    ------
    InputError
        A number is negative or not finite, or rates come without an epoch.
    """

    position_enu_m: tuple[float, float, float] = NO_OFFSET
    clock_s: Mapping[str, float] = field(default_factory=dict)
    clock_rate: Mapping[str, float] = field(default_factory=dict)
    clock_epoch_utc: str | None = None

    def __post_init__(self) -> None:
        for departure, sigma in self.sigmas().items():
            if not (math.isfinite(sigma) and sigma >= 0.0):
                raise InputError(f"the sigma of {departure} is {sigma!r}; give a number that is not negative")
        if any(self.clock_rate.values()) and self.clock_epoch_utc is None:
            raise InputError("drawn clock rates need a clock_epoch_utc, at which the offsets hold")

    def sigmas(self) -> dict[Departure, float]:
        """Standard deviation of each single departure, in the unit of its quantity; those of zero included."""
        found: dict[Departure, float] = {}
        of_the_world = (f.name for f in fields(self) if f.name not in (POSITION, "clock_epoch_utc"))
        for quantity in (POSITION, *of_the_world):
            value = getattr(self, quantity)
            by_station = value if isinstance(value, Mapping) else {"": value}
            for station, sigma in by_station.items():
                if isinstance(sigma, Sequence):
                    found |= {Departure(quantity, station, k): float(s) for k, s in enumerate(sigma)}
                else:
                    found[Departure(quantity, station)] = float(sigma)
        return found

    def draw(self, seed: int) -> dict[Departure, float]:
        """One realization of all departures whose sigma is above zero.

        Parameters
        ----------
        seed : int
            Not negative; that of the trial.
        """
        return {
            departure: sigma * float(generator(seed, f"departure {departure}").standard_normal())
            for departure, sigma in self.sigmas().items()
            if sigma > 0.0
        }


@dataclass(frozen=True, slots=True)
class Departure:
    """One number by which the world departs from the model.

    Parameters
    ----------
    quantity : str
        Field of :class:`Spread` that it belongs to.
    station : str
        Catalogue name, or empty.
    axis : int or None
        Index into the quantity's components, where there are several.
    """

    quantity: str
    station: str = ""
    axis: int | None = None

    def __str__(self) -> str:
        axis = "" if self.axis is None else str(self.axis)
        return " ".join(part for part in (self.quantity, self.station, axis) if part)


def departed(
    truth: Truth, departures: Mapping[Departure, float], clock_epoch_utc: str | None = None
) -> Truth:
    """A truth with departures added to it; that of the position (:func:`position_departure_m`) has no part in it.

    Parameters
    ----------
    truth : Truth
    departures : mapping of Departure to float
        Each in the unit of its quantity.
    clock_epoch_utc : str, optional
        When offsets hold of clocks that have no epoch of their own; needed with rates.
    """
    changes: dict[str, Any] = {}
    for departure, value in departures.items():
        name, station, axis = departure.quantity, departure.station, departure.axis
        if name == POSITION:
            continue
        if name in ("clock_s", "clock_rate"):
            clocks = changes.setdefault("clock", dict(truth.clock))
            clock = clocks.get(station, Clock())
            clocks[station] = Clock(
                clock.offset_s + (value if name == "clock_s" else 0.0),
                clock.rate + (value if name == "clock_rate" else 0.0),
                clock.epoch_utc or clock_epoch_utc,
            )
        elif name == "station_enu_m":
            stations = changes.setdefault(name, dict(truth.station_enu_m))
            stations[station] = _added(stations.get(station, NO_OFFSET), axis, value)
        elif station:
            by_station = changes.setdefault(name, dict(getattr(truth, name)))
            by_station[station] = by_station.get(station, 0.0) + value
        else:
            before = changes.get(name, getattr(truth, name))
            changes[name] = _added(before, axis, value) if isinstance(before, tuple) else before + value
    return replace(truth, **changes)


def position_departure_m(departures: Mapping[Departure, float]) -> NDArray[np.float64]:
    """By how much the point stands off its nominal place, east, north and up, m, shape (3,)."""
    return np.array([departures.get(Departure(POSITION, axis=k), 0.0) for k in range(3)])


def _added(values: tuple[float, ...], axis: int | None, value: float) -> tuple[float, ...]:
    axis = axis or 0
    return (*values[:axis], values[axis] + value, *values[axis + 1 :])
