"""Reading the ``[simulation]`` tables of a study file: what is tracked when, what the world is like, and the noise."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import RenamedKeyWarning, StationError
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.observations import BASELINE_KINDS
from radioloc.measurements.registry import KINDS
from radioloc.parameters.kind import Scope
from radioloc.parameters.registry import PARAMETERS
from radioloc.simulation import (
    Masks,
    Noise,
    NoiseModel,
    Scenario,
    Schedule,
    Session,
    Truth,
    TruthSigma,
    all_ranges,
    baselines,
    three_way,
    two_way,
)
from radioloc.simulation.schedule import Pair
from radioloc.studies.toml_table import TomlTable
from radioloc.time import utc_strings

LINKS: dict[str, Callable[..., tuple[Pair, ...]]] = {
    "two_way": two_way,
    "three_way": three_way,
    "all": all_ranges,
    "baselines": baselines,
}
"""How the stations of a session are paired."""

_VLBI_STATION = ("vlbi_station", "vlbi_station_rate")
_RENAMED = {
    "moon_m": "moon_position_m",
    "station_enu_m": "station_position_m",
    "tec_tecu": "electron_content_tecu",
    "clock_rate": "clock_rate_s_s",
}
"""Earlier names of errors, which are still read."""


def scenario(
    table: TomlTable, target: LunarPosition, position: LunarPosition | None, catalogue: StationCatalogue
) -> Scenario:
    """Read what is to be simulated.

    Parameters
    ----------
    table : TomlTable
        ``[simulation]``, of which ``position`` has been taken.
    target : LunarPosition
        A-priori position of the study.
    position : LunarPosition or None
        Where the point truly stands; at the a-priori position where ``None``.
    catalogue : StationCatalogue
        Resolves the names of stations.

    Raises
    ------
    InputError
        A key is not known or a value cannot be; the message names file, table and key.
    """
    seed = table.take("seed")
    if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int) or seed < 0):
        table.fail("seed", f"must be a whole number from zero up, not {seed!r}")
    name = table.text("name")
    sessions, truth, truth_sigma, noise = (
        table.table(key) for key in ("sessions", "truth", "truth_sigma", "noise")
    )
    masks = _masks(table, catalogue)
    table.finish()
    entries = [] if sessions is None else sessions.tables()
    if not entries:
        table.fail("sessions", "is missing; give at least one [simulation.sessions.NAME]")
    planned = [_session(entry, catalogue) for entry in entries]
    stations = tuple(dict.fromkeys(end for session in planned for pair in session.pairs for end in pair))
    return table.build(
        Scenario,
        schedule=Schedule(planned, masks),
        position=target if position is None else position,
        truth=None if truth is None else _truth(truth, stations, catalogue),
        noise=None if noise is None else _noise(noise),
        truth_sigma=None if truth_sigma is None else _truth_sigma(truth_sigma, stations, catalogue),
        seed=seed,
        name=name,
    )


def _masks(table: TomlTable, catalogue: StationCatalogue) -> Masks:
    by_station = table.take("station_masks_deg")
    if by_station is not None and not isinstance(by_station, Mapping):
        table.fail(
            "station_masks_deg", f"must be a table by station, such as {{ KASHI = 10.0 }}, not {by_station!r}"
        )
    masks_deg = {
        _station(table, "station_masks_deg", name, catalogue): table.as_number("station_masks_deg", mask_deg)
        for name, mask_deg in (by_station or {}).items()
    }
    if len(masks_deg) < len(by_station or {}):
        table.fail("station_masks_deg", "names a station twice")
    return table.build(
        Masks,
        station_deg=table.number("mask_deg"),
        target_deg=table.number("target_mask_deg"),
        by_station_deg=masks_deg,
    )


def _session(table: TomlTable, catalogue: StationCatalogue) -> Session:
    kind, links = table.text("kind"), table.text("links")
    names = table.texts("stations")
    fields = {
        "start_utc": _utc(table, "start"),
        "stop_utc": _utc(table, "stop"),
        **{key: table.number(key) for key in ("step_s", "sigma_m")},
        "time_tag": table.text("time_tag"),
        **{key: table.number(key) for key in ("count_s", "uplink_hz", "wavelength_um")},
    }
    one_uplink = table.take("one_uplink")
    table.finish()
    for key, value in {"kind": kind, "stations": names, **fields}.items():
        if value is None and key not in ("time_tag", "count_s", "uplink_hz", "wavelength_um"):
            table.fail(key.removesuffix("_utc"), "is missing")
    if one_uplink not in (None, True, False):
        table.fail("one_uplink", f"must be true or false, not {one_uplink!r}")
    links = links or ("baselines" if kind in BASELINE_KINDS else "two_way")
    if links not in LINKS:
        table.fail("links", f"must be one of {', '.join(LINKS)}, not {links!r}")
    if (links == "baselines") != (kind in BASELINE_KINDS):
        table.fail(
            "links",
            f"{links!r} does not go with kind {kind!r}; baselines are of VLBI, all else of ranges",
        )
    stations = [_station(table, "stations", name, catalogue) for name in names or ()]
    return table.build(Session, kind=kind, pairs=LINKS[links](*stations), one_uplink=one_uplink, **fields)


def _utc(table: TomlTable, key: str) -> str | None:
    epoch = table.epoch(key)
    return None if epoch is None else str(utc_strings(epoch, decimals=9)[0]).rstrip("0").rstrip(".")


def _noise(table: TomlTable) -> NoiseModel:
    found = {key: entry for key in (*KINDS, *_VLBI_STATION) if (entry := table.table(key)) is not None}
    table.finish()
    noises = {key: _one_noise(entry) for key, entry in found.items()}
    of_stations = {key: noises.pop(key, Noise()) for key in _VLBI_STATION}
    return NoiseModel(noises, **of_stations)


def _one_noise(table: TomlTable) -> Noise:
    fields = {name: table.number(name) for name in Noise.__slots__}
    table.finish()
    return table.build(Noise, **fields)


def _truth(table: TomlTable, stations: tuple[str, ...], catalogue: StationCatalogue) -> Truth:
    given = _errors(table, stations, catalogue)
    terms = {key: table.texts(key) for key in ("terms_on", "terms_off")}
    table.finish()
    return table.build(Truth, **given, **terms)


def _truth_sigma(table: TomlTable, stations: tuple[str, ...], catalogue: StationCatalogue) -> TruthSigma:
    given = _errors(table, stations, catalogue)
    position = table.vector("position_enu_m")
    table.finish()
    return table.build(TruthSigma, position_enu_m=position, **given)


def _errors(table: TomlTable, stations: tuple[str, ...], catalogue: StationCatalogue) -> dict[str, Any]:
    """Errors of parameters, or their sigmas, by key; those that are not given left out."""
    found: dict[str, Any] = {}
    for kind in PARAMETERS.values():
        key = kind.value_key
        value = table.take(key)
        for old in (old for old, new in _RENAMED.items() if new == key and old in table):
            if value is not None:
                table.fail(old, f"is the earlier name of {key}, which is there, too; leave it out")
            value = table.take(old)
            warnings.warn(
                RenamedKeyWarning(f"[{table.name}] {old} is called {key} now; rename it"), stacklevel=2
            )
        if kind.scopes[0] is Scope.STATION and isinstance(value, Mapping):
            _require_stations(table, key, value, stations, catalogue)
        if value is not None:
            found[key] = value
    found["clock_epoch_utc"] = _utc(table, "clock_epoch")
    return found


def _require_stations(
    table: TomlTable,
    key: str,
    names: Iterable[str],
    stations: tuple[str, ...],
    catalogue: StationCatalogue,
) -> None:
    """Refuse what is not a station of the sessions, and one that is there by two names."""
    found = [_station(table, key, name, catalogue) for name in names]
    for station in found:
        if station not in stations:
            table.fail(key, f"{station} is in no session; the stations are {', '.join(stations)}")
        if found.count(station) > 1:
            table.fail(key, f"{station} is named twice")


def _station(table: TomlTable, key: str, name: str, catalogue: StationCatalogue) -> str:
    try:
        return catalogue.get(name).name
    except StationError as error:
        table.fail(key, str(error))
