"""Readers of the ``[simulation]`` tables of a study file: sessions, noise, and errors of the model."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, TypeVar

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import StationError
from radioloc.measurements.registry import KINDS, MEASUREMENTS
from radioloc.parameters.kind import Scope
from radioloc.parameters.registry import PARAMETERS
from radioloc.simulation import Masks, Noise, NoiseModel, Scenario, Schedule, Session, Truth, TruthSigma
from radioloc.simulation.schedule import LINKS
from radioloc.simulation.simulate import TargetRecord
from radioloc.study.orbiter import Orbiter
from radioloc.study.schema import TomlTable
from radioloc.time import Epochs, utc_strings

_Record = TypeVar("_Record")
_MASKS = {"mask_deg": "station_deg", "target_mask_deg": "target_deg", "station_masks_deg": "by_station_deg"}
_VLBI_STATION = ("vlbi_station", "vlbi_station_rate")
# Keys beside those of parameters
_TRUTH_KEYS = {"terms_on": tuple[str, ...], "terms_off": tuple[str, ...]}
_TRUTH_SIGMA_KEYS = {"position_enu_m": tuple[float, float, float], "gravity_errors": int, "considered": bool}


def scenario(
    table: TomlTable, position: TargetRecord | Mapping[str, TargetRecord], catalogue: StationCatalogue
) -> Scenario:
    """Read ``[simulation]`` without `position`, the true positions or orbits, which are read separately."""
    seed, name = table.get("seed", int), table.get("name", str)
    sessions, truth, truth_sigma, noise = (
        table.table(key) for key in ("sessions", "truth", "truth_sigma", "noise")
    )
    masks = table.read(Masks, _MASKS)
    by_station_deg = {
        _station(table, "station_masks_deg", station, catalogue): mask_deg
        for station, mask_deg in masks.by_station_deg.items()
    }
    if len(by_station_deg) < len(masks.by_station_deg):
        table.fail("station_masks_deg", "names a station twice")
    planned = [] if sessions is None else [_session(item, catalogue) for item in sessions.named().values()]
    if not planned:
        table.fail("sessions", "is missing; give at least one [simulation.sessions.NAME]")
    stations = tuple(dict.fromkeys(end for session in planned for pair in session.pairs for end in pair))
    return table.build(
        Scenario,
        schedule=Schedule(planned, replace(masks, by_station_deg=by_station_deg)),
        position=position,
        truth=_errors(truth, Truth, _TRUTH_KEYS, stations, catalogue),
        noise=None if noise is None else _noise(noise),
        truth_sigma=_errors(truth_sigma, TruthSigma, _TRUTH_SIGMA_KEYS, stations, catalogue),
        seed=seed,
        name=position.name if name is None and isinstance(position, Orbiter) else name,
    )


def _session(table: TomlTable, catalogue: StationCatalogue) -> Session:
    kind = table.need("kind", str)
    form = MEASUREMENTS[kind].form if kind in KINDS else ""
    possible = [name for name, (of_form, _) in LINKS.items() if of_form == form]
    links = table.get("links", str) or (possible or ["two_way"])[0]
    if links not in LINKS:
        table.fail("links", f"expected one of {', '.join(LINKS)}, got {links!r}")
    if possible and links not in possible:
        table.fail("links", f"{links!r} does not go with kind {kind!r}; use {' or '.join(possible)}")
    try:
        stations = [
            station.name
            for name in table.need("stations", tuple[str, ...])
            for station in catalogue.members(name)
        ]
    except StationError as error:
        table.fail("stations", str(error))
    start_utc, stop_utc = (_utc(table.need(key, Epochs)) for key in ("start", "stop"))
    pairs = LINKS[links][1](*stations)
    return table.read(Session, kind=kind, pairs=pairs, start_utc=start_utc, stop_utc=stop_utc)


def _utc(epoch: Epochs | None) -> str | None:
    return None if epoch is None else str(utc_strings(epoch, decimals=9)[0]).rstrip("0").rstrip(".")


def _noise(table: TomlTable) -> NoiseModel:
    links, stations = (
        {key: noise for key in keys if (noise := table.get(key, Noise)) is not None}
        for keys in (KINDS, _VLBI_STATION)
    )
    table.finish()
    return NoiseModel(links, **stations)


def _errors(
    table: TomlTable | None,
    make: Callable[..., _Record],
    keys: Mapping[str, Any],
    stations: tuple[str, ...],
    catalogue: StationCatalogue,
) -> _Record | None:
    """Read a record of errors of parameters, or of their sigmas, and of its further keys."""
    if table is None:
        return None
    fields: dict[str, Any] = {"clock_epoch_utc": _utc(table.get("clock_epoch", Epochs))}
    for kind in PARAMETERS.values():
        key = kind.value_key
        fields[key] = table.take(key)
        per = kind.keys["per"]
        fields[per] = table.get(per, str)
        of_stations = kind.scopes[0] is Scope.STATION and fields[per] in (None, "station", "pass")
        if of_stations and isinstance(fields[key], Mapping):
            _require_stations(table, key, fields[key], stations, catalogue)
    fields |= {key: table.get(key, kind) for key, kind in keys.items()}
    table.finish()
    return table.build(make, **fields)


def _require_stations(
    table: TomlTable, key: str, names: Iterable[str], stations: tuple[str, ...], catalogue: StationCatalogue
) -> None:
    """Require stations of the sessions, each by one name."""
    named = [_station(table, key, name, catalogue) for name in names]
    for station in named:
        if station not in stations:
            table.fail(
                key, f"{station} is in no session; the stations are {', '.join(filter(None, stations))}"
            )
        if named.count(station) > 1:
            table.fail(key, f"{station} is named twice")


def _station(table: TomlTable, key: str, name: str, catalogue: StationCatalogue) -> str:
    try:
        return catalogue.get(name).name
    except StationError as error:
        table.fail(key, str(error))
