"""Readers of the ``[simulation]`` tables of a study file: sessions, noise, and errors of the model."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, TypeVar

from radioloc.earth.stations import StationCatalogue
from radioloc.ephemeris import Trajectory
from radioloc.errors import InputError, StationError
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.link import canonical_target
from radioloc.measurements.registry import KINDS, MEASUREMENTS
from radioloc.parameters.kind import Scope
from radioloc.parameters.registry import PARAMETERS
from radioloc.simulation import Masks, Noise, NoiseModel, Scenario, Schedule, Session, Truth, TruthSigma
from radioloc.simulation.schedule import LINKS
from radioloc.study.orbiter import Orbiter
from radioloc.study.schema import TomlTable
from radioloc.time import Epochs, epochs_from_strings, utc_strings

_Record = TypeVar("_Record")
_MASKS = {
    "mask_deg": "station_deg",
    "target_mask_deg": "target_deg",
    "station_masks_deg": "by_station_deg",
}
_VLBI_STATION = ("vlbi_station", "vlbi_station_rate")
# Keys beside those of parameters
_TRUTH_KEYS = {"terms_on": tuple[str, ...], "terms_off": tuple[str, ...]}
_TRUTH_SIGMA_KEYS = {"position_enu_m": tuple[float, float, float], "gravity_errors": int}


def scenario(
    table: TomlTable, position: LunarPosition | Trajectory | Orbiter, catalogue: StationCatalogue
) -> Scenario:
    """Read ``[simulation]`` of one target, whose true position has been taken from the table."""
    name = table.get("name", str)
    name = position.name if name is None and isinstance(position, Orbiter) else name or "lander"
    [planned] = scenarios(table, {name: position}, catalogue).values()
    orbits = isinstance(position, Orbiter)
    if orbits and any(planned.truth_sigma.position_enu_m):
        raise InputError(
            f"{table.path}: [simulation.truth_sigma] position_enu_m belongs to a place on the Moon, but the target "
            "is an orbiter; leave it out"
        )
    if planned.truth_sigma.gravity_errors and not orbits:
        raise InputError(
            f"{table.path}: [simulation.truth_sigma] gravity_errors belongs to an orbiter; leave it out"
        )
    return planned


def scenarios(
    table: TomlTable, truths: Mapping[str, LunarPosition | Trajectory | Orbiter], catalogue: StationCatalogue
) -> dict[str, Scenario]:
    """Read ``[simulation]`` of targets with their true positions; errors of stations are common to all targets."""
    seed = table.get("seed", int)
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
    items = [] if sessions is None else list(sessions.named().values())
    tracked = [_tracked(item, truths) for item in items]
    planned = [_session(item, catalogue) for item in items]
    if not planned:
        table.fail("sessions", "is missing; give at least one [simulation.sessions.NAME]")
    stations = tuple(dict.fromkeys(end for session in planned for pair in session.pairs for end in pair))
    # Offsets of clocks are common to all targets, so their epoch is, too.
    starts = sorted(
        (session.start_utc for session in planned), key=lambda date: epochs_from_strings(date, "UTC").mjd[0]
    )
    epoch_utc = starts[0] if len(truths) > 1 else None
    settings: dict[str, Any] = {
        "truth": _errors(truth, Truth, _TRUTH_KEYS, stations, catalogue, epoch_utc),
        "noise": None if noise is None else _noise(noise),
        "truth_sigma": _errors(truth_sigma, TruthSigma, _TRUTH_SIGMA_KEYS, stations, catalogue, epoch_utc),
        "seed": seed,
    }
    if len(truths) > 1 and settings["truth_sigma"] and any(settings["truth_sigma"].position_enu_m):
        table.fail("truth_sigma", "position_enu_m is of one target; give [simulation.targets.NAME.position]")
    masks = replace(masks, by_station_deg=by_station_deg)
    sessions_of = {
        name: [s for s, names in zip(planned, tracked, strict=True) if name in names] for name in truths
    }
    return {
        name: table.build(
            Scenario, schedule=Schedule(sessions_of[name], masks), position=position, name=name, **settings
        )
        for name, position in truths.items()
        if sessions_of[name]
    }


def _tracked(table: TomlTable, truths: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the targets of a session: by default all of the study."""
    if len(truths) < 2:
        return tuple(truths)
    names = tuple(canonical_target(name) for name in table.get("targets", tuple[str, ...]) or truths)
    for name in names:
        if name not in truths:
            table.fail("targets", f"expected some of [targets], {', '.join(truths)}, got {name!r}")
    return names


def _session(table: TomlTable, catalogue: StationCatalogue) -> Session:
    kind = table.need("kind", str)
    form = MEASUREMENTS[kind].form if kind in KINDS else ""
    possible = [name for name, (of_form, _) in LINKS.items() if of_form == form]
    links = table.get("links", str) or (possible or ["two_way"])[0]
    if links not in LINKS:
        table.fail("links", f"must be one of {', '.join(LINKS)}, not {links!r}")
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
    epoch_utc: str | None,
) -> _Record | None:
    """Read a record of errors of parameters, or of their sigmas, and of its further keys."""
    if table is None:
        return None
    fields: dict[str, Any] = {"clock_epoch_utc": _utc(table.get("clock_epoch", Epochs)) or epoch_utc}
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
