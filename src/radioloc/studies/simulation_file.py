"""Reading the ``[simulation]`` tables of a study file: what is tracked when, how the world departs, and the noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import StationError
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.observations import BASELINE_KINDS
from radioloc.measurements.registry import KINDS
from radioloc.simulation import (
    Clock,
    Masks,
    Noise,
    NoiseModel,
    Scenario,
    Schedule,
    Session,
    Spread,
    Truth,
    all_ranges,
    baselines,
    three_way,
    two_way,
)
from radioloc.simulation.schedule import Pair
from radioloc.studies.toml_table import TomlTable
from radioloc.time import epochs_from_strings, utc_strings

LINKS: dict[str, Callable[..., tuple[Pair, ...]]] = {
    "two_way": two_way,
    "three_way": three_way,
    "all": all_ranges,
    "baselines": baselines,
}
"""How the stations of a session are paired."""

_VLBI_STATION = ("vlbi_station", "vlbi_station_rate")
_VECTORS = {"moon_m": 3, "libration_rad": 3, "pole_rad": 2}
_OF_STATIONS = ("range_bias_m", "zenith_delay_m", "tec_tecu", "clock_s", "clock_rate")


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
    sessions, truth, spread, noise = (
        table.table(key) for key in ("sessions", "truth", "truth_sigma", "noise")
    )
    masks = _masks(table, catalogue)
    table.finish()
    entries = [] if sessions is None else sessions.tables()
    if not entries:
        table.fail("sessions", "is missing; give at least one [simulation.sessions.NAME]")
    planned = [_session(entry, catalogue) for entry in entries]
    stations = tuple(dict.fromkeys(end for session in planned for pair in session.pairs for end in pair))
    first = min(planned, key=lambda session: epochs_from_strings(session.start_utc, "UTC").mjd[0]).start_utc
    return table.build(
        Scenario,
        schedule=Schedule(planned, masks),
        position=target if position is None else position,
        truth=None if truth is None else _truth(truth, stations, catalogue, first),
        noise=None if noise is None else _noise(noise),
        spread=None if spread is None else _spread(spread, stations, catalogue, first),
        seed=seed,
        name=name,
    )


def _masks(table: TomlTable, catalogue: StationCatalogue) -> Masks:
    by_station = _by_station(table, "station_masks_deg", (), catalogue, 1)
    return table.build(
        Masks,
        station_deg=table.number("mask_deg"),
        target_deg=table.number("target_mask_deg"),
        by_station_deg=by_station,
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


def _truth(table: TomlTable, stations: tuple[str, ...], catalogue: StationCatalogue, start: str) -> Truth:
    fields = _departures(table, stations, catalogue)
    terms = {key: table.texts(key) for key in ("terms_on", "terms_off")}
    epoch = _utc(table, "clock_epoch") or start
    table.finish()
    offsets, rates = fields.pop("clock_s") or {}, fields.pop("clock_rate") or {}
    clocks = {
        name: table.build(
            Clock,
            offset_s=offsets.get(name, 0.0),
            rate=rates.get(name, 0.0),
            epoch_utc=epoch if rates.get(name) else None,
        )
        for name in dict.fromkeys([*offsets, *rates])
    }
    return table.build(Truth, clock=clocks, **fields, **terms)


def _spread(table: TomlTable, stations: tuple[str, ...], catalogue: StationCatalogue, start: str) -> Spread:
    fields = _departures(table, stations, catalogue)
    position = table.vector("position_enu_m")
    epoch = _utc(table, "clock_epoch") or start
    table.finish()
    return table.build(Spread, position_enu_m=position, clock_epoch_utc=epoch, **fields)


def _departures(table: TomlTable, stations: tuple[str, ...], catalogue: StationCatalogue) -> dict[str, Any]:
    """What a truth and its sigmas have in common, by field; ``None`` where not given."""
    fields: dict[str, Any] = {key: table.numbers(key, length) for key, length in _VECTORS.items()}
    fields["ut1_s"] = table.number("ut1_s")
    fields["station_enu_m"] = _by_station(table, "station_enu_m", stations, catalogue, 3)
    for key in _OF_STATIONS:
        fields[key] = _by_station(table, key, stations, catalogue, 1)
    return fields


def _by_station(
    table: TomlTable, key: str, stations: tuple[str, ...], catalogue: StationCatalogue, length: int
) -> dict[str, Any] | None:
    """Take a table of values by station; where `stations` are given, a single value is that of each of them."""
    value = table.take(key)
    if value is None:
        return None
    if not isinstance(value, Mapping):
        if not stations:
            table.fail(key, f"must be a table by station, such as {{ KASHI = 10.0 }}, not {value!r}")
        value = dict.fromkeys(stations, value)
    out: dict[str, Any] = {}
    for name, item in value.items():
        station = _station(table, key, name, catalogue)
        if stations and station not in stations:
            table.fail(key, f"{station} is in no session; the stations are {', '.join(stations)}")
        if station in out:
            table.fail(key, f"{station} is named twice")
        out[station] = table.as_number(key, item) if length == 1 else table.as_numbers(key, item, length)
    return out


def _station(table: TomlTable, key: str, name: str, catalogue: StationCatalogue) -> str:
    try:
        return catalogue.get(name).name
    except StationError as error:
        table.fail(key, str(error))
