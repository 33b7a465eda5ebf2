"""Group delays of equipment in the data: of stations, and of the target's transponder.

A clock reads time tags and times of flight, but the light path is between reference points. A station's *transmit
delay* is from the clock to the reference point of the outgoing signal, its *receive delay* from the reference point to
the clock. A signal tagged with its transmission leaves the reference point later than the tag by the transmit delay,
and a signal tagged with its reception arrives there earlier by the receive delay. The time of flight contains both.
Without delays, tags and values refer to the reference point. A tag of the bounce does not refer to a clock of a station
and is unchanged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError, StationError
from radioloc.measurements.light_path import RECEIVE, TRANSMIT, split_ends
from radioloc.quantities import convert_fields
from radioloc.vectors import Floats

MAX_DELAY_S = 1e-3  # delays of real equipment are microseconds; motions are straight for a millisecond


@dataclass(frozen=True, slots=True)
class StationDelay:
    """Group delay of a station's equipment between its clock and its reference point.

    Raises
    ------
    InputError
        A delay is outside of 0 to 1 ms.
    """

    #: Delays of the outgoing and the incoming signal, s; ``None``, unstated, counts as zero.
    transmit_s: float | None = None
    receive_s: float | None = None  #: likewise

    def __post_init__(self) -> None:
        convert_fields(self)
        for key in ("transmit_s", "receive_s"):
            _require_delay(key, getattr(self, key))


@dataclass(frozen=True, slots=True)
class PathDelays:
    """Delays of equipment on n paths, s."""

    hold_s: Floats  # of the transponder
    after_tag_s: Floats  # from the tag to the event at the reference point
    in_value_s: Floats  # total in the value beside the two legs
    transmit_s: Floats  # from the transmitter's clock to its reference point


@dataclass(frozen=True, slots=True)
class EquipmentDelays:
    """Delays of equipment that the data contain.

    Raises
    ------
    InputError
        A delay is outside of 0 to 1 ms.
    """

    #: Hold of the target's transponder for ranges and Doppler, s; ``None`` is unstated.
    transponder_s: float | None = None
    #: Delays by the catalogue's names of the stations (:meth:`with_catalogue_names` converts aliases).
    stations: Mapping[str, StationDelay] = field(default_factory=dict)

    def __post_init__(self) -> None:
        convert_fields(self)
        _require_delay("transponder_delay_s", self.transponder_s)

    def with_catalogue_names(self, catalogue: StationCatalogue) -> EquipmentDelays:
        """Return the delays by the catalogue's names; raise a StationError for unknown or duplicate stations."""
        stations: dict[str, StationDelay] = {}
        for name, delay in self.stations.items():
            try:
                station = catalogue.get(name).name
            except StationError as error:
                raise StationError(f"station_delay_s: {error}") from None
            if station in stations:
                raise StationError(f"station_delay_s: {name} duplicates {station}; remove one of them")
            stations[station] = delay
        return EquipmentDelays(self.transponder_s, stations)

    def delays_on_paths(
        self,
        stations: Sequence[str],
        station_index: NDArray[np.int32],
        tag: NDArray[np.int8],
        sign: Floats,
        terms: frozenset[str],
    ) -> PathDelays:
        """Return the delays on paths for the active terms; `station_index` has all first and then all second ends.

        `tag` and `sign` are those of :func:`~radioloc.measurements.light_path.solve_light_path`.
        """
        hold_s, by_station_s = np.zeros(len(tag)), np.zeros((len(stations), 2))
        if "transponder_delay" in terms and self.transponder_s is not None:
            hold_s[sign > 0.0] = self.transponder_s
        if "station_delay" in terms:
            for k, name in enumerate(stations):
                delay = self.stations.get(name, StationDelay())
                by_station_s[k] = delay.transmit_s or 0.0, delay.receive_s or 0.0
        transmitter, receiver = split_ends(station_index)
        # The arrival at the reference point of the first station precedes the tag, and reduces the difference.
        transmit_s, receive_s = by_station_s[transmitter].T
        first_s = np.where(sign > 0.0, transmit_s, np.where(sign < 0.0, -receive_s, 0.0))
        second_s = by_station_s[receiver, 1]
        after_tag_s = np.where(tag == TRANSMIT, first_s, np.where(tag == RECEIVE, -second_s, 0.0))
        return PathDelays(
            hold_s, after_tag_s, first_s + hold_s + second_s, np.where(sign > 0.0, transmit_s, 0.0)
        )


def _require_delay(key: str, delay_s: float | None) -> None:
    if delay_s is not None and not 0.0 <= delay_s <= MAX_DELAY_S:
        raise InputError(f"{key}: expected 0 to {MAX_DELAY_S:g} s, got {delay_s!r}")
