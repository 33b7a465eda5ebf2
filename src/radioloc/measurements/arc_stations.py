"""The stations of an arc: which take part, and which one transmits and receives each observation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.stations import Station
from radioloc.errors import StationError
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel


def stations_of(
    model: PhysicalModel, observations: Observations
) -> tuple[tuple[Station, ...], NDArray[np.int32], NDArray[np.int32]]:
    """The stations that take part, and for each observation which one transmits and which receives."""
    found: dict[str, int] = {}
    stations: list[Station] = []
    ends = np.zeros((len(observations.links), 2), dtype=np.int32)
    for i, link in enumerate(observations.links):
        rows = np.flatnonzero(observations.link == i)
        if len(rows) == 0:
            continue
        for end, name in enumerate((link.transmitter, link.receiver)):
            try:
                station = model.catalogue.get(name)
            except StationError as error:
                raise StationError(f"{observations.origin(int(rows[0]))}: {error}") from None
            if station.name not in found:
                found[station.name] = len(stations)
                stations.append(station)
            ends[i, end] = found[station.name]
    return tuple(stations), ends[observations.link, 0], ends[observations.link, 1]
