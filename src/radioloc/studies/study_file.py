"""Reading a study from a TOML file: every mistake in it is one sentence naming the file, the table and the key."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.earth.stations import MOUNTS, Station, StationCatalogue
from radioloc.ephemeris import Trajectory
from radioloc.errors import InputError, StationError
from radioloc.io.tdm import TdmAgreement
from radioloc.io.tdm.message import TYPES
from radioloc.lunar import TerrainModel
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.equipment_delays import EquipmentDelays, StationDelay
from radioloc.measurements.terms import active_terms
from radioloc.parameters.choice import ParameterChoice, parameter_choices
from radioloc.parameters.registry import PARAMETERS
from radioloc.simulation import Scenario
from radioloc.studies.simulation_file import scenario
from radioloc.studies.study import (
    EstimateChoice,
    HeightPrior,
    ModelChoice,
    ObservationChoice,
    Reference,
    Study,
    TerrainPrior,
)
from radioloc.studies.toml_table import TomlTable
from radioloc.studies.weights import Weight

_FASTEST_PLATE_M_YR = 1.0
"""Plates move by up to 0.1 m a year; more is another unit."""
_STATION_YEARS = (1900.0, 2100.0)
"""An epoch outside is no Julian year but another count of days."""


def read_study(path: str | Path) -> Study:
    """Read a study file.

    Parameters
    ----------
    path : path-like
        A TOML file; paths in it are relative to its folder.

    Raises
    ------
    InputError
        The file cannot be read, is not TOML, or has an unknown key or an unusable value; the message names it.

    Examples
    --------
    >>> import radioloc
    >>> study = radioloc.read_study("examples/apollo15/apollo15.toml")
    >>> study.target.frame
    'ME_DE421'
    """
    path = Path(path)
    top = TomlTable(path, "", _content(path))
    keys = (
        "target",
        "targets",
        "observations",
        "estimate",
        "consider",
        "model",
        "stations",
        "reference",
        "references",
        "simulation",
    )
    target, targets, observations, estimate, consider, model, stations, reference, references, simulation = (
        map(top.table, keys)
    )
    top.finish()  # before anything else, so that a misspelt table is not called missing
    if (target is None) == (targets is None):
        problem = (
            "is missing; it gives the a-priori position"
            if target is None
            else "and [targets] exclude each other"
        )
        raise InputError(f"{path}: [target] {problem}")
    if observations is None and simulation is None:
        raise InputError(f"{path}: [observations] is missing; it names the files to read")
    catalogue = StationCatalogue.default() if stations is None else _catalogue(stations)
    positions = {} if targets is None else _targets(targets)
    position = next(iter(positions.values())) if target is None else _target(target, path.parent)
    tracking = None
    if simulation is not None:
        if isinstance(position, Trajectory):
            raise InputError(
                f"{path}: [simulation] is of a position on the Moon, but [target] is a trajectory; leave it out"
            )
        tracking = _simulation(simulation, position, catalogue)
    return top.build(
        Study,
        target=position,
        observations=(
            ObservationChoice()
            if observations is None
            else _observations(observations, path.parent, needs_files=simulation is None)
        ),
        estimate=EstimateChoice() if estimate is None else _estimate(estimate, path.parent),
        model=ModelChoice() if model is None else _model(model, path.parent, catalogue),
        catalogue=catalogue,
        reference=None if reference is None else Reference(*_position(reference)),
        references=() if references is None else _references(references),
        name=path.stem,
        simulation=tracking,
        targets=positions,
        consider={} if consider is None else _considered(consider),
    )


def _content(path: Path) -> dict[str, object]:
    try:
        # Some editors put a byte order mark in front, which TOML does not know.
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such study file; check the name and the directory") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a directory; give the study file in it") from None
    except OSError as error:
        raise InputError(f"{path}: the study file cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: byte 0x{error.object[error.start]:02x} is not UTF-8; save the study file as UTF-8"
        ) from None
    except (ValueError, RecursionError) as error:  # of the former TOMLDecodeError is one
        raise InputError(f"{path}: not valid TOML: {error}") from None


def _target(table: TomlTable, folder: Path) -> LunarPosition | Trajectory:
    file, body = table.text("trajectory"), table.number("body")
    if file is None and body is None:
        return _position(table)[0]
    table.text("name")
    for key in ("frame", "position_m", "longitude_deg", "latitude_deg", "height_m"):
        if key in table:
            table.fail(key, "give either a position or a trajectory with its body, not both")
    table.finish()
    if file is None or body is None:
        table.fail(
            "trajectory" if file is None else "body",
            "is missing; a trajectory is the name of an SPK file and the NAIF code of the body in it, such as -85",
        )
    if not body.is_integer():
        table.fail("body", f"must be a NAIF code, an integer such as -85, not {body!r}")
    if not (folder / file).is_file():
        table.fail("trajectory", f"there is no file {file!r} in {folder.resolve()}")
    return table.build(Trajectory.open, path=folder / file, body=int(body))


def _position(table: TomlTable) -> tuple[LunarPosition, str]:
    name = table.text("name") or table.name
    frame = table.text("frame") or "ME_DE421"
    xyz_m = table.vector("position_m")
    geographic = {key: table.number(key) for key in ("longitude_deg", "latitude_deg", "height_m")}
    table.finish()
    given = [key for key, value in geographic.items() if value is not None]
    if xyz_m is not None and given:
        table.fail(
            "position_m", f"give either position_m or longitude and latitude, not both ({', '.join(given)})"
        )
    if xyz_m is not None:
        return table.build(LunarPosition.from_cartesian, xyz_m=xyz_m, frame=frame), name
    missing = [key for key in geographic if key not in given]
    if missing:
        table.fail(
            missing[0], "is missing; a position is longitude_deg, latitude_deg and height_m, or position_m"
        )
    return table.build(LunarPosition.from_selenographic, **geographic, frame=frame), name


def _references(table: TomlTable) -> tuple[Reference, ...]:
    found = [_position(entry) for entry in table.tables()]
    return tuple(Reference(position, name.removeprefix("references.")) for position, name in found)


def _targets(table: TomlTable) -> dict[str, LunarPosition]:
    found = {entry.name.removeprefix("targets."): _position(entry)[0] for entry in table.tables()}
    if not found:
        raise InputError(f"{table.path}: [targets] names none; give at least one [targets.NAME]")
    return found


def _considered(table: TomlTable) -> dict[str, ParameterChoice]:
    keys = _parameters(table)
    table.finish()
    return table.build(parameter_choices, given=keys)


def _simulation(table: TomlTable, target: LunarPosition, catalogue: StationCatalogue) -> Scenario:
    true = table.table("position")
    return scenario(table, target, None if true is None else _position(true)[0], catalogue)


def _observations(table: TomlTable, folder: Path, *, needs_files: bool) -> ObservationChoice:
    patterns = table.texts("files")
    fields = {
        "targets": table.texts("targets"),
        "stations": table.texts("stations"),
        "start": table.epoch("start"),
        "stop": table.epoch("stop"),
        "hours": table.number("hours"),
        "extra_sigma_m": table.number("extra_sigma_m"),
        "vlbi_station_sigma_m": _by_station(table, "vlbi_station_sigma_m"),
        "vlbi_station_rate_sigma_m": _by_station(table, "vlbi_station_rate_sigma_m"),
        "weights": tuple(_weight(entry) for entry in table.table_list("weights")),
    }
    sigmas = table.table("sigma_m")
    agreed = {
        "range_convention": table.text("tdm_range"),
        "doppler_convention": table.text("tdm_doppler"),
        "range_unit_s": table.number("tdm_range_unit_s"),
        "turnaround": table.whole_numbers("tdm_turnaround", 2),
        "delays_removed": table.flag("tdm_delays_removed"),
        "apply_clocks": table.flag("tdm_apply_clocks"),
    }
    table.finish()
    sigma_m = {} if sigmas is None else {kind: sigmas.number(kind) for kind in TYPES}
    if sigmas is not None:
        sigmas.finish()
    tdm = table.build(TdmAgreement, sigma_m={k: v for k, v in sigma_m.items() if v is not None}, **agreed)
    if not patterns and needs_files:
        table.fail("files", "is missing; name at least one file (relative to the study file, globs allowed)")
    files = _found(table, "files", patterns or (), folder, may_be_missing=not needs_files)
    return table.build(ObservationChoice, files=files, tdm=tdm, **fields)


def _by_station(table: TomlTable, key: str) -> float | dict[str, float] | None:
    """Take a number for all stations, or a table of numbers by station."""
    value = table.take(key)
    if isinstance(value, dict):
        return {name: table.as_number(f"{key}.{name}", number) for name, number in value.items()}
    return None if value is None else table.as_number(key, value)


def _weight(table: TomlTable) -> Weight:
    fields = {
        **{key: table.texts(key) for key in ("type", "stations", "files")},
        **{key: table.number(key) for key in ("sigma_m", "factor", "extra_sigma_m")},
    }
    table.finish()
    return table.build(Weight, **fields)


def _files(table: TomlTable, key: str, folder: Path) -> tuple[Path, ...]:
    """Take the files of a name, a glob or a list of them; none where the key is absent."""
    return _found(table, key, table.texts(key) or (), folder)


def _found(
    table: TomlTable, key: str, patterns: tuple[str, ...], folder: Path, *, may_be_missing: bool = False
) -> tuple[Path, ...]:
    """Files of names and globs; a name may be that of a file which is still to be made, if it may be missing."""
    files: list[Path] = []
    for pattern in patterns:
        found = _matches(folder, pattern)
        if not found and (folder / pattern).is_dir():
            table.fail(key, f"{pattern!r} is a directory; give the files in it, such as {pattern}/*.csv")
        if not found and may_be_missing and not set(pattern) & set("*?["):
            found = [folder / pattern]
        if not found:
            table.fail(key, f"{pattern!r} matches no file in {folder.resolve()}")
        files += [file for file in found if file not in files]
    return tuple(files)


def _matches(folder: Path, pattern: str) -> list[Path]:
    """Files of a name or a glob, sorted; none also for what pathlib does not take as either."""
    try:
        plain = folder / pattern
        if plain.is_file():
            return [plain]
        start = Path(plain.anchor) if Path(pattern).is_absolute() else folder
        relative = str(Path(pattern).relative_to(start)) if Path(pattern).is_absolute() else pattern
        return sorted(found for found in start.glob(relative) if found.is_file())
    except (ValueError, IndexError, NotImplementedError):
        return []


def _estimate(table: TomlTable, folder: Path) -> EstimateChoice:
    prior = table.table("height_prior")
    fields = {
        "position": table.text("position"),
        "pass_gap_h": table.number("pass_gap_h"),
        "ephemeris_sigma_m": _east_north_up(table, "ephemeris_sigma_m"),
        "rejection_sigma": table.number("rejection_sigma"),
        "weights": table.text("weights"),
        **_parameters(table),
    }
    table.finish()
    return table.build(
        EstimateChoice, height_prior=None if prior is None else _height_prior(prior, folder), **fields
    )


def _parameters(table: TomlTable) -> dict[str, Any]:
    """Take the keys of all kinds of parameter."""
    taken: dict[str, Any] = {}
    for name, kind in PARAMETERS.items():
        keys = (name, kind.value_key, kind.sigma_key, kind.per_key)
        found = {key: table.take(key) for key in keys}
        taken |= {key: value for key, value in found.items() if value is not None}
    return taken


def _height_prior(table: TomlTable, folder: Path) -> HeightPrior | TerrainPrior:
    dem, interpolation = table.text("dem"), table.text("interpolation")
    height_m, sigma_m = table.number("height_m"), table.number("sigma_m")
    table.finish()
    if dem is not None:
        if height_m is not None:
            table.fail("height_m", "give either dem or height_m, not both")
        if sigma_m is None:
            table.fail("sigma_m", "is missing; give the error of the terrain model, in metres")
        terrain = table.build(TerrainModel.open, path=folder / dem, interpolation=interpolation or "bilinear")
        return table.build(TerrainPrior, terrain=terrain, sigma_m=sigma_m)
    if interpolation is not None:
        table.fail("interpolation", "belongs to a terrain model; name one as dem")
    if height_m is None or sigma_m is None:
        table.fail("height_m" if height_m is None else "sigma_m", "is missing; give both, in metres")
    return table.build(HeightPrior, height_m=height_m, sigma_m=sigma_m)


def _east_north_up(table: TomlTable, key: str) -> tuple[float, ...] | None:
    """Take three numbers, or one for all three."""
    value = table.take(key)
    if value is None:
        return None
    values = value if isinstance(value, list) else [value] * 3
    return tuple(table.as_number(key, v) for v in values)


def _model(table: TomlTable, folder: Path, catalogue: StationCatalogue) -> ModelChoice:
    off = table.texts("off") or ()
    fields = {key: _kernel(table.text(key), folder) for key in ("ephemeris", "libration")}
    eop = table.text("earth_orientation")
    maps, tec_tecu = _files(table, "ionex", folder), table.number("tec_tecu")
    vmf3, orography, gpt3 = (_files(table, key, folder) for key in ("vmf3", "vmf3_orography", "gpt3"))
    transponder_s, by_station = table.number("transponder_delay_s"), table.table("station_delay_s")
    evaluation = table.text("evaluation") or "auto"
    table.finish()
    for key, found in (("vmf3_orography", orography), ("gpt3", gpt3)):
        if len(found) > 1:
            table.fail(key, f"one file is wanted, but there are {len(found)}")
    stations = {} if by_station is None else _station_delays(by_station)
    try:
        delays = table.build(EquipmentDelays, transponder_s=transponder_s, stations=stations).named(catalogue)
    except StationError as error:
        table.fail("station_delay_s", str(error).removeprefix("station_delay_s: "))
    if eop is not None and not (folder / eop).is_file():
        table.fail("earth_orientation", f"there is no file {eop!r} in {folder.resolve()}")
    try:
        terms = active_terms(off)
    except InputError as error:
        table.fail("off", str(error))
    return table.build(
        ModelChoice,
        terms=terms,
        earth_orientation=None if eop is None else folder / eop,
        ionex=maps,
        tec_tecu=tec_tecu,
        vmf3=vmf3,
        vmf3_orography=orography[0] if orography else None,
        gpt3=gpt3[0] if gpt3 else None,
        delays=delays,
        evaluation=evaluation,
        **fields,
    )


def _station_delays(table: TomlTable) -> dict[str, StationDelay]:
    """Delays by the names of stations as the study gives them."""
    found = {}
    for entry in table.tables():
        transmit_s, receive_s = entry.number("transmit"), entry.number("receive")
        entry.finish()
        name = entry.name.removeprefix("model.station_delay_s.")
        found[name] = entry.build(StationDelay, transmit_s=transmit_s, receive_s=receive_s)
    return found


def _kernel(name: str | None, folder: Path) -> str | None:
    """A registered name as it is; anything that looks like a file relative to the study file."""
    if name is None or not Path(name).suffix:
        return name
    return str(folder / name)


def _catalogue(table: TomlTable) -> StationCatalogue:
    """The catalogue that ships, with the stations of the study added or in the place of those of the same name."""
    catalogue = StationCatalogue.default()
    for entry in table.tables():
        name = entry.name.removeprefix("stations.")
        itrf_m, velocity_m_yr = entry.vector("itrf_m"), entry.vector("velocity_m_yr")
        epoch_year = entry.number("epoch")
        aliases = entry.texts("aliases") or ()
        mount, axis_offset_m = entry.text("mount"), entry.number("axis_offset_m")
        entry.finish()
        known = catalogue.get(name) if name in catalogue else None
        if mount is None:
            mount = MOUNTS[0] if known is None else known.mount
        if axis_offset_m is None and known is not None:
            axis_offset_m = known.axis_offset_m
        if known is not None and itrf_m is None and velocity_m_yr is None and epoch_year is None:
            names = tuple(dict.fromkeys([*known.aliases, *aliases]))
            changed = entry.build(
                partial(replace, known), aliases=names, mount=mount, axis_offset_m=axis_offset_m
            )
            catalogue = entry.build(catalogue.with_station, station=changed)
            continue
        if itrf_m is None:
            entry.fail("itrf_m", "is missing; give the station's ITRF x, y, z in metres")
        if velocity_m_yr is not None and float(np.linalg.norm(velocity_m_yr)) > _FASTEST_PLATE_M_YR:
            entry.fail("velocity_m_yr", f"no station moves like {velocity_m_yr}; give metres per year")
        if epoch_year is not None and not _STATION_YEARS[0] <= epoch_year <= _STATION_YEARS[1]:
            entry.fail("epoch", f"must be a Julian year such as 2010.0, not {epoch_year!r}")
        # Data name stations by codes and pads; those, the antenna's axes and the loading of the site stay with a
        # station that only gets another position.
        station = entry.build(
            Station,
            name=name if known is None else known.name,
            aliases=tuple(dict.fromkeys([*(() if known is None else known.aliases), *aliases])),
            kind="ttc" if known is None else known.kind,
            itrf_m=np.array(itrf_m),
            epoch_year=2000.0 if epoch_year is None else epoch_year,
            quality="survey",
            source="study file",
            velocity_m_yr=None if velocity_m_yr is None else np.array(velocity_m_yr),
            ocean_loading=None if known is None else known.ocean_loading,
            mount=mount,
            axis_offset_m=axis_offset_m,
        )
        catalogue = entry.build(catalogue.with_station, station=station)
    return catalogue
