"""Changes of the sigmas of observations by type, station and file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError, error_context
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations
from radioloc.measurements.registry import KINDS
from radioloc.study.schema import check, entry

_WEIGHT_ADVICE = (
    "it is of the observations that type, stations and files choose; sigmas by type, of files that state none, belong "
    "to [observations] sigma_m"
)


@dataclass(frozen=True, slots=True)
class Weight:
    """Keys of ``[[observations.weights]]``, as the reference of the study file describes them."""

    type: tuple[str, ...] | None = entry(None, names=True, choices=KINDS)
    stations: tuple[str, ...] | None = entry(None, names=True)
    files: tuple[str, ...] | None = entry(None, names=True)
    sigma_m: float | None = entry(None, positive=True, advice=_WEIGHT_ADVICE)
    factor: float | None = entry(None, positive=True, advice=_WEIGHT_ADVICE)
    extra_sigma_m: float | None = entry(None, positive=True, advice=_WEIGHT_ADVICE)

    def __post_init__(self) -> None:
        check(self)
        if self.sigma_m is None and self.factor is None and self.extra_sigma_m is None:
            raise InputError("expected sigma_m, factor or extra_sigma_m, got none")

    def __str__(self) -> str:
        chosen = [" or ".join(names) for names in (self.type, self.stations, self.files) if names is not None]
        changes = [
            form.format(value)
            for form, value in (
                ("{:g} m", self.sigma_m),
                ("times {:g}", self.factor),
                ("plus {:g} m", self.extra_sigma_m),
            )
            if value is not None
        ]
        return f"{', '.join(chosen) or 'all'}: {', '.join(changes)}"

    def record(self) -> dict[str, Any]:
        """Return the keys that are given, for the provenance."""
        return {key: value for key, value in asdict(self).items() if value is not None}


def weighted_observations(
    observations: Observations, weights: Iterable[Weight], catalogue: StationCatalogue
) -> Observations:
    """Return observations with changed sigmas; weights are applied in order."""
    weights = tuple(weights)
    if not weights:
        return observations
    sigma_m = observations.sigma_m.copy()
    for number, weight in enumerate(weights, start=1):
        name = f"[[observations.weights]] number {number} ({weight})"
        with error_context(f"{name}:"):
            rows = _rows(observations, weight, catalogue)
        if not rows.any():
            raise InputError(
                f"{name} applies to no observation; the observations are of {_present(observations)}"
            )
        if weight.sigma_m is not None:
            sigma_m[rows] = weight.sigma_m
        with np.errstate(over="ignore", under="ignore"):
            if weight.factor is not None:
                sigma_m[rows] *= weight.factor
            if weight.extra_sigma_m is not None:
                sigma_m[rows] = np.hypot(sigma_m[rows], weight.extra_sigma_m)
        if not (np.isfinite(sigma_m) & (sigma_m > 0.0)).all():
            raise InputError(f"{name} makes a sigma that is zero or not finite")
    sigma_m.flags.writeable = False
    return replace(observations, sigma_m=sigma_m)


def rows_by_station(observations: Observations, catalogue: StationCatalogue) -> dict[str, NDArray[np.bool_]]:
    """Return masks of the observations of each station, by its name."""
    ends = link_stations(observations.links, catalogue)
    names = sorted(set().union(*(ends[k] for k in np.unique(observations.link))))
    return {name: np.array([name in of for of in ends])[observations.link] for name in names}


def link_stations(links: Iterable[Link], catalogue: StationCatalogue) -> list[set[str]]:
    """Return the stations of each link by their names in the catalogue, or as they are if it lacks them."""
    return [
        {catalogue.get(name).name if name in catalogue else name for name in link.stations} for link in links
    ]


def require_stations(
    observations: Observations, key: str, names: Iterable[str], catalogue: StationCatalogue
) -> None:
    """Require that each station with a noise is in the catalogue and in an observation."""
    present = set().union(*link_stations(_links(observations), catalogue))
    for name in names:
        with error_context(f"[observations] {key}:"):
            station = catalogue.get(name).name
        if station not in present:
            raise InputError(
                f"[observations] {key}: no observation by {name}; the observations are of {_present(observations)}"
            )


def _rows(observations: Observations, weight: Weight, catalogue: StationCatalogue) -> NDArray[np.bool_]:
    rows = np.ones(len(observations), dtype=bool)
    if weight.type is not None:
        rows &= np.isin(observations.kind, [KINDS.index(kind) for kind in weight.type])
    if weight.stations is not None:
        stations = {station.name for name in weight.stations for station in catalogue.members(name)}
        of_link = [bool(names & stations) for names in link_stations(observations.links, catalogue)]
        rows &= np.array(of_link)[observations.link]
    if weight.files is not None:
        matches = [any(PurePath(file).match(glob) for glob in weight.files) for file in observations.files]
        rows &= np.array(matches)[observations.file]
    return rows


def _present(observations: Observations) -> str:
    kinds = ", ".join(KINDS[k] for k in np.unique(observations.kind))
    stations = sorted({name for link in _links(observations) for name in link.stations})
    return f"{kinds} by {', '.join(stations)}"


def _links(observations: Observations) -> list[Link]:
    return [observations.links[k] for k in np.unique(observations.link)]
