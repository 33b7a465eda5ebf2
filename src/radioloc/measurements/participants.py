"""The stations of an arc: which take part, and which one transmits and receives each observation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.stations import Station
from radioloc.errors import InputError, StationError
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.targets import canonical_target


class Participants(NamedTuple):
    """Stations of the observations of an arc.

    Parameters
    ----------
    names : tuple of str
        Of the stations that take part, each once.
    transmitters, receivers : ndarray of int32, shape (n,)
        Index into `names` of each observation's first and second station; without a first one it is the second.
    stations : tuple of Station
        The same as `names`, as they are in the catalogue.
    """

    names: tuple[str, ...]
    transmitters: NDArray[np.int32]
    receivers: NDArray[np.int32]
    stations: tuple[Station, ...]


def targets_of(observations: Observations, targets: Sequence[str]) -> NDArray[np.int32]:
    """Index of each observation's target in a list of names, shape (n,); zero where the list is empty.

    Raises
    ------
    InputError
        An observation is of a target that is not in the list.
    """
    if not targets:
        return np.zeros(len(observations), dtype=np.int32)
    places = {canonical_target(name): k for k, name in enumerate(targets)}
    of_link = np.full(len(observations.links), -1, dtype=np.int32)
    for i in np.unique(observations.link):
        of_link[i] = places.get(canonical_target(observations.links[i].target), -1)
        if of_link[i] < 0:
            row = int(np.argmax(observations.link == i))
            raise InputError(
                f"{observations.origin(row)}: target {observations.links[i].target!r} has no position; "
                f"there are {', '.join(targets)}"
            )
    return np.asarray(of_link[observations.link])


def stations_of(model: PhysicalModel, observations: Observations) -> Participants:
    """The stations that take part, in the order of the links.

    Parameters
    ----------
    model : PhysicalModel
        Has the catalogue.
    observations : Observations

    Raises
    ------
    StationError
        A station is not in the catalogue; the message names the file and line.
    """
    found: dict[str, int] = {}
    stations: list[Station] = []
    ends = np.zeros((len(observations.links), 2), dtype=np.int32)
    for i, link in enumerate(observations.links):
        rows = np.flatnonzero(observations.link == i)
        if len(rows) == 0:
            continue
        for end, name in enumerate((link.transmitter or link.receiver, link.receiver)):
            try:
                station = model.catalogue.get(name)
            except StationError as error:
                raise StationError(f"{observations.origin(int(rows[0]))}: {error}") from None
            if station.name not in found:
                found[station.name] = len(stations)
                stations.append(station)
            ends[i, end] = found[station.name]
    transmitters, receivers = ends[observations.link, 0], ends[observations.link, 1]
    return Participants(tuple(found), transmitters, receivers, tuple(stations))
