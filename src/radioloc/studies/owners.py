"""Whom the nuisance parameters of an arc belong to, and what is known of each beforehand.

A kind of parameter belongs to stations, or to passes of stations, or (the transponder's delay) to the point. A station
that is listed is estimated, about its a-priori value; one that has a value and is not listed is held at it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError, StationError
from radioloc.estimation.parameters import Parameter
from radioloc.measurements.observations import RANGE
from radioloc.measurements.predictor import Predictor
from radioloc.studies.nuisance import NUISANCES, Nuisance, Owner, middle_of
from radioloc.studies.study import EstimateChoice
from radioloc.time import utc_strings, utc_to_tai


def owned_parameters(
    nuisance: Nuisance, choice: EstimateChoice, catalogue: StationCatalogue, arc: Predictor
) -> list[tuple[Owner, Parameter]]:
    """The parameters of one kind that an arc gets.

    Raises
    ------
    StationError
        A station is not in the catalogue.
    InputError
        A station has no observation that such a parameter acts on, or a sigma and no parameter.
    """
    if not nuisance.of_stations:
        return _of_the_point(nuisance, choice, arc)
    taking_part = _taking_part(nuisance, choice, arc)
    estimated = _listed(nuisance, getattr(choice, nuisance.key), catalogue, arc, taking_part)
    values = _by_station(nuisance, choice, nuisance.value_key, catalogue, arc, taking_part, taking_part)
    sigmas = _by_station(nuisance, choice, nuisance.sigma_key, catalogue, arc, taking_part, estimated)
    for i in sigmas:
        if i not in estimated:
            raise InputError(
                f"[estimate] {nuisance.sigma_key}: {arc.stations[i]} gets no {nuisance.key}; list it in "
                f"{nuisance.key}, or leave its sigma out"
            )
    found = []
    for i in sorted({*estimated, *values}):
        owners = [Owner(i, arc.stations[i])]
        if i in estimated and nuisance.key == "range_bias" and choice.range_bias_per == "pass":
            owners = _passes(arc, i, choice.pass_gap_h)
        for owner in owners:
            parameter = Parameter(
                f"{nuisance.key}.{owner.name}",
                nuisance.unit,
                nuisance.key,
                values.get(i, 0.0),
                sigmas.get(i, math.inf),
                fixed=i not in estimated,
                scale=nuisance.scale,
                span_utc=owner.span_utc,
            )
            found.append((owner, parameter))
    return found


def of_part(choice: EstimateChoice, part: Predictor, catalogue: StationCatalogue) -> EstimateChoice:
    """What is estimated in a part of an arc: without the stations that have no observations in it.

    That the names are right is known from the whole arc.
    """
    changes: dict[str, object] = {}
    for nuisance in NUISANCES:
        present = nuisance.stations(part)
        if not nuisance.of_stations:
            changes[nuisance.key] = getattr(choice, nuisance.key) and bool(present)
            continue
        names = {part.stations[i] for i in present}

        def stays(name: str, names: set[str] = names) -> bool:
            return catalogue.get(name).name in names

        listed = getattr(choice, nuisance.key)
        if not isinstance(listed, str):
            listed = changes[nuisance.key] = tuple(filter(stays, listed)) or "none"
        for key in (nuisance.value_key, nuisance.sigma_key):
            given = getattr(choice, key)
            if isinstance(given, Mapping):
                changes[key] = {name: number for name, number in given.items() if stays(name)} or None
    return replace(choice, **changes)  # type: ignore[arg-type]


def _of_the_point(
    nuisance: Nuisance, choice: EstimateChoice, arc: Predictor
) -> list[tuple[Owner, Parameter]]:
    if not getattr(choice, nuisance.key):
        return []
    if not nuisance.stations(arc):
        raise InputError(f"[estimate] {nuisance.key}: no observation goes over the point's transponder")
    sigma = getattr(choice, nuisance.sigma_key)
    parameter = Parameter(
        nuisance.key,
        nuisance.unit,
        nuisance.key,
        0.0,
        math.inf if sigma is None else sigma,
        scale=nuisance.scale,
    )
    return [(Owner(None, ""), parameter)]


def _taking_part(nuisance: Nuisance, choice: EstimateChoice, arc: Predictor) -> list[int]:
    """Stations that such a parameter acts on; not looked for where none is asked for."""
    asked = getattr(choice, nuisance.key) != "none" or getattr(choice, nuisance.value_key) is not None
    return nuisance.stations(arc) if asked or getattr(choice, nuisance.sigma_key) is not None else []


def _listed(
    nuisance: Nuisance,
    names: tuple[str, ...] | str,
    catalogue: StationCatalogue,
    arc: Predictor,
    taking_part: list[int],
) -> list[int]:
    """Indices of the stations whose parameter is estimated."""
    if names == "none":
        return []
    if names == "all":
        # Only differences of clocks show: the first station keeps the time for all.
        return taking_part[1:] if nuisance.key.startswith("clock") else taking_part
    return sorted({_index(nuisance.key, name, catalogue, arc, taking_part) for name in names})


def _by_station(
    nuisance: Nuisance,
    choice: EstimateChoice,
    key: str,
    catalogue: StationCatalogue,
    arc: Predictor,
    taking_part: list[int],
    everyone: list[int],
) -> dict[int, float]:
    """Numbers by station: those of a table, or one for everyone."""
    given = getattr(choice, key)
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        return dict.fromkeys(everyone, given)
    found: dict[int, float] = {}
    for name, number in given.items():
        i = _index(key, name, catalogue, arc, taking_part)
        if i in found:
            raise InputError(f"[estimate] {key}: {arc.stations[i]} is there twice, once as {name}")
        found[i] = number
    return found


def _index(key: str, name: str, catalogue: StationCatalogue, arc: Predictor, taking_part: list[int]) -> int:
    try:
        station = catalogue.get(name).name
    except StationError as error:
        raise StationError(f"[estimate] {key}: {error}") from None
    if station not in arc.stations or arc.stations.index(station) not in taking_part:
        present = ", ".join(arc.stations[i] for i in taking_part) or "none"
        raise InputError(
            f"[estimate] {key}: no observation of {station} that has one; the stations are {present}"
        )
    return arc.stations.index(station)


def _passes(arc: Predictor, station: int, gap_h: float) -> list[Owner]:
    """Passes in which a station received ranges: a new one begins where it has long observed nothing at all."""
    mine = np.flatnonzero((arc.receivers == station) | (arc.transmitters == station))
    since_s = utc_to_tai(arc.observations.epoch[mine]).seconds_since(middle_of(arc))
    order = np.argsort(since_s, kind="stable")
    number = np.empty(len(mine), dtype=np.int32)
    number[order] = np.concatenate([[0], np.cumsum(np.diff(since_s[order]) > 3600.0 * gap_h)])
    ranges = (arc.observations.kind[mine] == RANGE) & (arc.receivers[mine] == station)
    owners: list[Owner] = []
    pass_of: NDArray[np.int32] = np.full(len(arc.receivers), -1, dtype=np.int32)
    for k in np.unique(number[ranges]):
        rows = np.flatnonzero(ranges & (number == k))
        ends = rows[[int(since_s[rows].argmin()), int(since_s[rows].argmax())]]
        first, last = utc_strings(arc.observations.epoch[mine[ends]], decimals=0)
        pass_of[mine[rows]] = len(owners)
        name = f"{arc.stations[station]} {len(owners) + 1}"
        owners.append(Owner(station, name, len(owners), pass_of, (str(first), str(last))))
    return owners
