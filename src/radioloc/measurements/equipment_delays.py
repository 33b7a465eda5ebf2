"""Group delays in equipment that the data still contain: of the stations on the ground, of the point's transponder.

A time tag and a time of flight are read by a clock; the light path is between reference points. A station's *transmit
delay* is from the clock to the reference point on the way out, its *receive delay* from there to the clock on the way
in. So a signal tagged with its transmission leaves the reference point the transmit delay after the tag, and one tagged
with its reception arrives there the receive delay before it; the time of flight by the clock contains both. With no
delay given, tags and values are those at the reference point. A tag that names the bounce is of no station's clock and
is not moved.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError, StationError
from radioloc.measurements.light_path import RECEIVE, TRANSMIT, halves
from radioloc.quantities import convert_fields
from radioloc.vectors import Floats

MAX_DELAY_S = 1e-3  # real equipment has microseconds; motions are straight for a millisecond


@dataclass(frozen=True, slots=True)
class StationDelay:
    """Group delay of a station's equipment between its clock and its reference point.

    Parameters
    ----------
    transmit_s, receive_s : float or None
        On the way out and on the way in, s; ``None`` says nothing, and counts as zero.

    Raises
    ------
    InputError
        A delay is not from 0 to 1 ms.
    """

    transmit_s: float | None = None
    receive_s: float | None = None

    def __post_init__(self) -> None:
        convert_fields(self)
        for key in ("transmit_s", "receive_s"):
            _require_delay(key, getattr(self, key))


@dataclass(frozen=True, slots=True)
class PathDelays:
    """Delays of equipment on each of n paths, s."""

    hold_s: Floats  # how long the point holds the signal
    after_tag_s: Floats  # how long after the tag the event happens at the reference point
    in_value_s: Floats  # all that the value contains beside the two legs
    transmit_s: Floats  # from the transmitter's clock to its reference point


@dataclass(frozen=True, slots=True)
class EquipmentDelays:
    """Delays that are in the data and are to be modelled.

    Parameters
    ----------
    transponder_s : float or None
        How long the point's transponder holds the signal of a range or of Doppler, s; ``None`` says nothing.
    stations : mapping of str to StationDelay
        By the catalogue's names of the stations (:meth:`named` makes aliases these).

    Raises
    ------
    InputError
        A delay is not from 0 to 1 ms.
    """

    transponder_s: float | None = None
    stations: Mapping[str, StationDelay] = field(default_factory=dict)

    def __post_init__(self) -> None:
        convert_fields(self)
        _require_delay("transponder_delay_s", self.transponder_s)

    def named(self, catalogue: StationCatalogue) -> EquipmentDelays:
        """The same under the catalogue's names; a StationError where one is not in it, or has two names here."""
        found: dict[str, StationDelay] = {}
        for name, delay in self.stations.items():
            try:
                station = catalogue.get(name).name
            except StationError as error:
                raise StationError(f"station_delay_s: {error}") from None
            if station in found:
                raise StationError(
                    f"station_delay_s: {name} is another name of {station}, which has its delays"
                )
            found[station] = delay
        return EquipmentDelays(self.transponder_s, found)

    def on_paths(
        self,
        stations: Sequence[str],
        which: NDArray[np.int32],
        tag: NDArray[np.int8],
        sign: Floats,
        terms: frozenset[str],
    ) -> PathDelays:
        """What the delays do to paths between stations, whose names are the catalogue's, with some active terms.

        `which` are all first stations and then all second ones; `tag` and `sign` are those of
        :func:`~radioloc.measurements.light_path.solve_light_path`.
        """
        hold_s, by_station_s = np.zeros(len(tag)), np.zeros((len(stations), 2))
        if "transponder_delay" in terms and self.transponder_s is not None:
            hold_s[sign > 0.0] = self.transponder_s
        if "station_delay" in terms:
            for k, name in enumerate(stations):
                delay = self.stations.get(name, StationDelay())
                by_station_s[k] = delay.transmit_s or 0.0, delay.receive_s or 0.0
        transmitter, receiver = halves(which)
        # The first station's arrival comes at its reference point before the tag, and is taken off the difference.
        transmit_s, receive_s = by_station_s[transmitter].T
        first_s = np.where(sign > 0.0, transmit_s, np.where(sign < 0.0, -receive_s, 0.0))
        second_s = by_station_s[receiver, 1]
        after_tag_s = np.where(tag == TRANSMIT, first_s, np.where(tag == RECEIVE, -second_s, 0.0))
        return PathDelays(
            hold_s, after_tag_s, first_s + hold_s + second_s, np.where(sign > 0.0, transmit_s, 0.0)
        )


def _require_delay(key: str, delay_s: float | None) -> None:
    if delay_s is not None and not 0.0 <= delay_s <= MAX_DELAY_S:
        raise InputError(f"{key}: {delay_s!r} is no delay of equipment; give seconds, 0 to {MAX_DELAY_S:g}")
