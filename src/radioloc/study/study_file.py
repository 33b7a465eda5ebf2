"""Reader of study files; messages name the file, the table and the key."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.dynamics import Impulse
from radioloc.earth.stations import Station, StationCatalogue, frames
from radioloc.errors import InputError, StationError, require_type
from radioloc.io.frequencies import FrequencyAgreement, read_sites
from radioloc.measurements.link import canonical_target
from radioloc.parameters.choice import ParameterChoice
from radioloc.parameters.considered import considered_choices
from radioloc.simulation import Scenario
from radioloc.simulation.simulate import TargetRecord
from radioloc.study.map_positions import PlaceOnMap
from radioloc.study.observation_choice import ObservationChoice, Uplink, Weight
from radioloc.study.orbit_choice import ForcesChoice, OrbitChoice, ProcessNoise, SegmentedAcceleration
from radioloc.study.schema import (
    STUDY_TABLES,
    Hints,
    TomlTable,
    check,
    entry,
    keys_of,
    source_of,
    toml_content,
)
from radioloc.study.simulation_file import scenario
from radioloc.study.study import (
    PARAMETER_KEYS,
    AnyTarget,
    CovarianceChoice,
    EstimateChoice,
    ModelChoice,
    Study,
)
from radioloc.study.target_file import (
    LandingKeys,
    Place,
    Target,
    named_positions,
    read_forces,
    read_target,
    reference_of,
    true_target,
)

_MAX_PLATE_SPEED_M_YR = 1.0  # Plates move by up to 0.1 m a year; more is another unit
_MAX_ALIAS_DISTANCE_KM = 10.0  # Beyond, a station with an alias of the catalogue is a different one
GEODETIC = ("longitude_deg", "latitude_deg", "height_m")  # Keys of a position above an ellipsoid
_STATION_YEARS = (1900.0, 2100.0)  # An epoch outside is a count of days


@dataclass(frozen=True, slots=True)
class Site:
    """Keys of ``[stations.NAME]``: a position in the ITRF, or above the ellipsoid of GRS80 or WGS 84."""

    itrf_m: tuple[float, float, float] | None = None
    longitude_deg: float | None = None
    latitude_deg: float | None = None
    height_m: float | None = None
    frame: str | None = entry(None, choices=frames())
    velocity_m_yr: tuple[float, float, float] | None = None
    epoch: float | None = None
    aliases: tuple[str, ...] = ()
    mount: str | None = None
    axis_offset_m: float | None = None
    sigma_m: float | None = None

    def __post_init__(self) -> None:
        check(self)
        geodetic = [name for name in GEODETIC if getattr(self, name) is not None]
        if self.itrf_m is not None and geodetic:
            raise InputError(f"itrf_m: give either itrf_m or {', '.join(GEODETIC)}, not both")
        if geodetic and len(geodetic) < len(GEODETIC):
            raise InputError(
                f"{geodetic[0]}: a position above the ellipsoid is {', '.join(GEODETIC)}; give all three"
            )
        if self.velocity_m_yr is not None and np.linalg.norm(self.velocity_m_yr) > _MAX_PLATE_SPEED_M_YR:
            raise InputError(
                f"velocity_m_yr: expected at most {_MAX_PLATE_SPEED_M_YR:g} m per year, got {self.velocity_m_yr}"
            )
        if self.epoch is not None and not _STATION_YEARS[0] <= self.epoch <= _STATION_YEARS[1]:
            raise InputError(f"epoch: expected a Julian year such as 2010.0, got {self.epoch!r}")

    def position(self) -> dict[str, Any]:
        """Return the stated position, motion and frame as fields of a station."""
        geodetic = {name: getattr(self, name) for name in GEODETIC} if self.latitude_deg is not None else {}
        motion = {"velocity_m_yr": self.velocity_m_yr, "epoch_year": self.epoch, "frame": self.frame}
        fields = {"itrf_m": self.itrf_m} | geodetic | motion
        return {name: value for name, value in fields.items() if value is not None}


TABLES: dict[str, type] = {
    "target": Target,
    "target.landing": LandingKeys,
    "targets.NAME": Target,
    "forces": ForcesChoice,
    "forces.accelerations": SegmentedAcceleration,
    "forces.impulses": Impulse,
    "reference": Place,
    "references.NAME": Place,
    "observations": ObservationChoice,
    "observations.frequencies": FrequencyAgreement,
    "observations.weights": Weight,
    "observations.map_positions": PlaceOnMap,
    "observations.uplinks": Uplink,
    "estimate": EstimateChoice,
    "estimate.orbit": OrbitChoice,
    "estimate.orbit.process_noise": ProcessNoise,
    "model": ModelChoice,
    "stations.NAME": Site,
    "covariance": CovarianceChoice,
}
"""The records of the tables of a study file; beside them ``[consider]`` and those of ``[simulation]``."""

_TABLES_OF_A_STUDY = tuple(
    dict.fromkeys([*(name.partition(".")[0] for name in TABLES), "consider", "simulation"])
)


def _hints() -> Hints:
    """Return hints on misplaced keys, those of registered kinds of parameter included."""
    return Hints(
        {table: keys_of(TABLES[table]) for table in ("observations", "estimate", "model")},
        {
            (table, field.name): field.metadata["advice"]
            for table, record in TABLES.items()
            for field in dataclasses.fields(record)
            if "advice" in field.metadata
        }
        | {
            ("observations", "sigma_m"): (
                "give a table by type, such as { range = 1.0 }, for files without sigmas; a sigma in place of stated "
                "ones belongs to [[observations.weights]]"
            ),
            ("simulation", "station_masks_deg"): "give a table by station, such as { KASHI = 10.0 }",
        },
    )


def read_study(path: str | Path) -> Study:
    """Read a study file.

    Parameters
    ----------
    path : path-like
        A TOML file, or ``-`` for standard input; paths in it are relative to its folder, or to the working directory.

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
    require_type("path", path, str, Path)
    content: dict[str, Any] = toml_content(Path(path))
    path, file = source_of(path)
    top = TomlTable(path, "", content, _hints())
    extensions = _extensions(top)
    tables = {key: top.table(key) for key in _TABLES_OF_A_STUDY}
    top.finish()  # First, so that a misspelt table is not reported as missing

    def read_table(key: str, make: Callable[[TomlTable], Any]) -> Any:
        table = tables[key]
        return None if table is None else make(table)

    if (tables["target"] is None) == (tables["targets"] is None):
        missing = tables["target"] is None
        problem = (
            "is missing; it gives the a-priori position" if missing else "and [targets] exclude each other"
        )
        raise InputError(f"{path}: [target] {problem}")
    simulated = tables["simulation"] is not None
    observations = read_table("observations", partial(_observations, may_be_missing=simulated))
    catalogue = read_table("stations", _catalogue) or StationCatalogue.default()
    for site in () if observations is None else chain.from_iterable(map(read_sites, observations.sites)):
        if site.name not in catalogue:  # [stations.NAME] of the study takes precedence
            catalogue = catalogue.with_station(site)
    forces = read_table("forces", read_forces)
    places = [content.get("target", {}), *content.get("targets", {}).values()]
    if forces is not None and not any("dynamics" in place for place in places):
        raise InputError(f'{path}: [forces] act on a target with dynamics = "moon"; leave them out')
    model = read_table("model", partial(_model, catalogue=catalogue))
    read = partial(read_target, forces=forces, model=model or ModelChoice())
    targets = read_table("targets", lambda table: {name: read(item) for name, item in table.named().items()})
    if targets == {}:
        raise InputError(f"{path}: [targets] is empty; give at least one [targets.NAME]")
    target = read_table("target", read) or next(iter(targets.values()))
    considered, defaults, suboptimal = read_table("consider", _considered) or ({}, True, ())
    planned = read_table("covariance", lambda table: table.read(CovarianceChoice))
    return top.build(
        Study,
        target=target,
        target_name=content.get("target", {}).get("name"),
        targets=targets,
        observations=observations,
        estimate=read_table("estimate", lambda table: table.read(EstimateChoice)),
        consider=considered,
        consider_defaults=defaults,
        suboptimal=suboptimal,
        model=model,
        catalogue=catalogue,
        reference=read_table("reference", reference_of),
        references=tuple((read_table("references", named_positions) or {}).values()),
        name=path.stem,
        path=file,
        candidates=None if planned is None else planned.candidates,
        extensions={table.name: table.read(record) for table, record in extensions},
        simulation=read_table(
            "simulation",
            partial(
                _simulation,
                targets=targets or {"": target},
                forces=content.get("forces", {}),
                catalogue=catalogue,
            ),
        ),
    )


def _extensions(top: TomlTable) -> list[tuple[TomlTable, type]]:
    """Take the tables of other packages, each with its record; refuse a study of another kind."""
    extensions = []
    for name, added in STUDY_TABLES.items():
        if added.run is not None and name in top:
            raise InputError(
                f"{top.path}: expected a study of tracking, got one with [{name}]; use radioloc {added.command}"
            )
        if added.run is None and (table := top.table(name)) is not None:
            extensions.append((table, added.record))
    return extensions


def as_study(study: Study | str | Path) -> Study:
    """Return the study, read from a file if a path is given."""
    if isinstance(study, (str, Path)):
        return read_study(study)
    require_type("study", study, Study, str, Path)
    return study


def _considered(table: TomlTable) -> tuple[dict[str, ParameterChoice], bool, tuple[str, ...]]:
    """Read choices by kind, whether other kinds have defaults, and the kinds that the weights neglect."""
    defaults, suboptimal = table.get("defaults", bool), table.get("suboptimal", tuple[str, ...])
    settings = {key: value for key in PARAMETER_KEYS if (value := table.take(key)) is not None}
    choices = table.build(considered_choices, settings=settings)
    table.finish()
    return choices, defaults is not False, suboptimal or ()


def _simulation(
    table: TomlTable, targets: Mapping[str, AnyTarget], forces: Mapping[str, Any], catalogue: StationCatalogue
) -> Scenario:
    """Read ``[simulation]`` of targets by name; the name of a single ``[target]`` is empty."""
    records: TargetRecord | dict[str, TargetRecord]
    if len(targets) == 1:
        [target] = targets.values()
        records = true_target(target, table, forces)
    else:
        changes = table.table("targets")
        records = {canonical_target(name): target for name, target in targets.items()}
        for name, change in ({} if changes is None else changes.named()).items():
            if name not in targets:
                table.fail(f"targets.{name}", f"expected one of [targets], {', '.join(targets)}")
            records[canonical_target(name)] = true_target(targets[name], change, forces)
            change.finish()
    return scenario(table, records, catalogue)


def _observations(table: TomlTable, may_be_missing: bool) -> ObservationChoice:
    patterns = table.get("files", tuple[str, ...]) or ()
    return table.read(ObservationChoice, files=table.files("files", patterns, may_be_missing=may_be_missing))


def _model(table: TomlTable, catalogue: StationCatalogue) -> ModelChoice:
    model = table.read(ModelChoice)
    try:
        return replace(model, delays=model.delays.with_catalogue_names(catalogue))
    except StationError as error:
        table.fail("station_delay_s", str(error).removeprefix("station_delay_s: "))


def _catalogue(table: TomlTable) -> StationCatalogue:
    """Return the shipped catalogue with the stations of the study, which replace those of the same name."""
    catalogue = StationCatalogue.default()
    for name, site in table.named().items():
        catalogued = catalogue.get(name) if name in catalogue else None
        station = _station(name, site, catalogued)
        if catalogued is not None and name not in StationCatalogue([replace(catalogued, aliases=())]):
            distance_km = 1e-3 * float(np.linalg.norm(station.itrf_m - catalogued.itrf_m))
            if distance_km > _MAX_ALIAS_DISTANCE_KM:
                problem = (
                    f"is also called {name}, and stands {distance_km:.0f} km from here; take another name"
                )
                site.fail(name, f"{catalogued.name} of the catalogue {problem}")
        catalogue = site.build(catalogue.with_station, station=station)
    return catalogue


def _station(name: str, table: TomlTable, catalogued: Station | None) -> Station:
    """Read a new station, or changes of one of the catalogue."""
    site = table.read(Site)
    position = site.position()
    if (position or catalogued is None) and not {"itrf_m", *GEODETIC} & {*position}:
        table.fail(
            "itrf_m", f"is missing; give the station's ITRF x, y, z in metres, or {', '.join(GEODETIC)}"
        )
    fields: dict[str, Any] = {"name": name, "kind": "ttc", "aliases": ()}
    if catalogued is not None:
        # Codes in data, the axes of the antenna and the loading of the site do not depend on the position.
        replaced = ("itrf_m", "velocity_m_yr", "frame", "sigma_m") if position else ()
        names = (f.name for f in dataclasses.fields(Station) if f.name not in replaced)
        fields = {name: getattr(catalogued, name) for name in names}
    if position:
        fields |= {"epoch_year": 2000.0, "quality": "survey", "source": "study file"} | position
    stated = {key: getattr(site, key) for key in ("mount", "axis_offset_m", "sigma_m")}
    fields |= {key: value for key, value in stated.items() if value is not None}
    fields["aliases"] = tuple(dict.fromkeys([*fields["aliases"], *site.aliases]))
    return table.build(Station.from_geodetic if "latitude_deg" in position else Station, **fields)
