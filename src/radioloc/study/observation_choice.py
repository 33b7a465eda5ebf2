"""Choice of a study's observations: files, selection, agreements on their content, and changes of their sigmas.

Files of listeners do not record the transmitters and turnaround ratios of received passes. `radioloc search` finds them
among candidates, pass by pass.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from radioloc.constants import C_M_S
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError, error_context
from radioloc.io.frequencies import FrequencyAgreement
from radioloc.io.tdm import TdmAgreement
from radioloc.measurements.link import Link, canonical_target
from radioloc.measurements.observations import DOPPLER, Observations
from radioloc.measurements.registry import KINDS
from radioloc.study.map_positions import PlaceOnMap
from radioloc.study.schema import check, entry
from radioloc.time import Epochs, utc_to_tai
from radioloc.units import set_fields
from radioloc.vectors import Floats, Indices, Mask

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


def rows_by_station(observations: Observations, catalogue: StationCatalogue) -> dict[str, Mask]:
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


def _rows(observations: Observations, weight: Weight, catalogue: StationCatalogue) -> Mask:
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


_TAG_TOLERANCE_S = 1e-3  # Epochs of study files are rounded to milliseconds


@dataclass(frozen=True, slots=True)
class Uplink:
    """Transmitter of Doppler that a station received in a pass: keys of ``[[observations.uplinks]]``."""

    receiver: str
    start: Epochs = entry(moment=True)
    stop: Epochs = entry(moment=True)
    transmitter: str | None = None
    turnaround: tuple[int, int] | None = None
    target: str | None = None

    def __post_init__(self) -> None:
        check(self)
        if self.turnaround is not None and min(self.turnaround) <= 0:
            raise InputError(f"turnaround: expected two numbers above zero, got {self.turnaround}")

    def rows(self, observations: Observations, catalogue: StationCatalogue) -> Indices:
        """Return the rows of Doppler of this pass."""
        receiver = catalogue.get(self.receiver).name
        received = [
            catalogue.get(link.receiver).name == receiver
            and (self.target is None or canonical_target(self.target) == canonical_target(link.target))
            for link in observations.links
        ]
        tai = utc_to_tai(observations.epoch)
        since_start_s, since_stop_s = (
            tai.seconds_since(utc_to_tai(moment)) for moment in (self.start, self.stop)
        )
        in_pass = (since_start_s >= -_TAG_TOLERANCE_S) & (since_stop_s <= _TAG_TOLERANCE_S)
        return np.flatnonzero(
            in_pass & (observations.kind == DOPPLER) & np.array(received, dtype=bool)[observations.link]
        )


def with_uplinks(
    observations: Observations, uplinks: Iterable[Uplink], catalogue: StationCatalogue
) -> Observations:
    """Return observations with the transmitters and turnaround ratios of their passes."""
    for uplink in uplinks:
        with error_context("[[observations.uplinks]]"):
            rows = uplink.rows(observations, catalogue)
            sender = uplink.transmitter and catalogue.get(uplink.transmitter).name
        if sender:
            observations = with_transmitter(observations, rows, sender)
        if uplink.turnaround is not None and len(rows):
            down, up = uplink.turnaround
            columns = {name: getattr(observations, name).copy() for name in ("value_m", "wavelength_um")}
            with error_context("[[observations.uplinks]]"):
                columns["value_m"][rows] = with_turnaround(observations, rows, down / up)
            columns["wavelength_um"][rows] = 1e6 * C_M_S * up / (down * observations.uplink_hz[rows])
            for column in columns.values():
                column.flags.writeable = False
            observations = replace(observations, **columns)
    return observations


def with_transmitter(observations: Observations, rows: Indices, station: str) -> Observations:
    """Return observations with another transmitter in some rows; one-way and differenced links stay."""
    links = {link: k for k, link in enumerate(observations.links)}
    new_links = (
        replace(link, transmitter=station) if link.transmitter and not link.differenced else link
        for link in observations.links
    )
    numbers = [links.setdefault(link, len(links)) for link in new_links]
    column = observations.link.copy()
    column[rows] = np.array(numbers, dtype=column.dtype)[column[rows]]
    column.flags.writeable = False
    return replace(observations, links=tuple(links), link=column)


def with_turnaround(observations: Observations, rows: Indices, ratio: float | None) -> Floats:
    """Return the values of some rows for another turnaround ratio and the same received frequency, m."""
    value_m = observations.value_m[rows]
    if ratio is None:
        return value_m
    if np.isnan(observations.uplink_hz[rows] * observations.wavelength_um[rows]).any():
        raise InputError(
            "turnaround: expected observations with frequencies up and down, got some without; leave it out"
        )
    count_m = C_M_S * observations.count_s[rows]
    recorded = C_M_S / (1e-6 * observations.wavelength_um[rows] * observations.uplink_hz[rows])
    return np.asarray(count_m - recorded / ratio * (count_m - value_m))


_NORMAL_POINT_LIMITS_S = (1e-3, 300.0)
"""The residuals of an a-priori position that is 100 km off depart by 3 cm from a straight line over 300 s."""

TDM_KEYS = {
    "sigma_m": "sigma_m",
    "tdm_range": "range_convention",
    "tdm_doppler": "doppler_convention",
    "tdm_range_unit_s": "range_unit_s",
    "tdm_turnaround": "turnaround",
    "tdm_delays_removed": "delays_removed",
    "tdm_apply_clocks": "apply_clocks",
}
"""Keys of ``[observations]`` that are fields of :class:`~radioloc.io.tdm.TdmAgreement`."""


@dataclass(frozen=True, slots=True)
class ObservationChoice:
    """Keys of ``[observations]``, as the reference of the study file describes them, globs of files already resolved.

    The keys on Tracking Data Messages are those of `tdm` (:data:`TDM_KEYS`).
    """

    files: tuple[Path, ...] = ()
    targets: tuple[str, ...] | None = entry(None, names=True)
    stations: tuple[str, ...] | None = entry(None, names=True)
    target_names: Mapping[str, str] = entry(factory=dict)
    types: tuple[str, ...] | None = entry(None, names=True)
    start: Epochs | None = entry(None, moment=True)
    stop: Epochs | None = entry(None, moment=True)
    hours: float | None = entry(None, positive=True)
    doppler_average_s: float | None = entry(None, positive=True)
    normal_point_s: float | None = entry(None, positive=True)
    extra_sigma_m: float = entry(
        0.0,
        not_negative=True,
        advice="it is of all observations; one by type, station or file belongs to [[observations.weights]]",
    )
    tdm: TdmAgreement = entry(
        factory=TdmAgreement,
        keys=tuple(TDM_KEYS),
        read=lambda table, _: table.read(TdmAgreement, TDM_KEYS, finish=False),
    )
    frequencies: tuple[FrequencyAgreement, ...] = ()
    sites: tuple[Path, ...] = ()
    vlbi_station_sigma_m: float | Mapping[str, float] = entry(0.0, not_negative=True)
    vlbi_station_rate_sigma_m: float | Mapping[str, float] = entry(0.0, not_negative=True)
    doppler_phase_sigma_m: float | Mapping[str, float] = entry(0.0, not_negative=True)
    transmitters: tuple[str, ...] | None = entry(None, names=True)
    turnarounds: tuple[str, ...] | None = entry(None, names=True)
    uplinks: tuple[Uplink, ...] = ()
    weights: tuple[Weight, ...] = entry(
        (),
        advice='they are of chosen observations; how series are weighed ("correlated") is in [estimate] weights',
    )
    map_positions: tuple[PlaceOnMap, ...] = ()

    def __post_init__(self) -> None:
        files = (self.files,) if isinstance(self.files, (str, Path)) else self.files
        set_fields(self, files=tuple(Path(file) for file in files))
        for name in ("weights", "frequencies", "map_positions", "uplinks"):
            set_fields(self, **{name: tuple(getattr(self, name))})
        check(self)
        low_s, high_s = _NORMAL_POINT_LIMITS_S
        if self.normal_point_s is not None and not low_s <= self.normal_point_s <= high_s:
            raise InputError(
                f"normal_point_s: expected {low_s:g} to {high_s:g} s, got {self.normal_point_s:g} s"
            )
        if self.start is not None and self.stop is not None:
            length_s = utc_to_tai(self.stop).seconds_since(utc_to_tai(self.start))
            if not (length_s > 0.0).all():
                raise InputError("stop: expected an epoch after the start")

    def require_transmitters(self) -> None:
        """Raise :class:`InputError` if transmitters or turnaround ratios are given as candidates only."""
        for key in ("transmitters", "turnarounds"):
            if getattr(self, key) is not None:
                raise InputError(
                    f"[observations] {key}: expected one of each pass, [[observations.uplinks]], got candidates; "
                    "`radioloc search STUDY.toml --out completed.toml` finds them"
                )
