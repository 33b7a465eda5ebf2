"""Readers of the tables of a study file for targets: places on the Moon, trajectories, orbiters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial, singledispatch
from pathlib import Path
from typing import Any

from radioloc.dynamics import Forces
from radioloc.dynamics.elements import EQUINOCTIAL, KEPLERIAN
from radioloc.ephemeris import Trajectory
from radioloc.lunar.position import LunarPosition
from radioloc.study.orbit_choice import ForcesChoice
from radioloc.study.orbiter import AXES, Landing, Orbiter, RoughOrbit
from radioloc.study.schema import TomlTable, check, entry, keys_of
from radioloc.study.study import AnyTarget, ModelChoice, Reference
from radioloc.targets.target import TARGET_KINDS
from radioloc.time import epochs_from_strings

_FIT_KEYS = ("empirical", "gravity_errors", "gravity_error_degree")
"""Keys of ``[forces]`` that ``[simulation.forces]`` lacks."""


@dataclass(frozen=True, slots=True)
class Place:
    """Keys of ``[target]``, ``[targets.NAME]``, ``[reference]`` and ``[references.NAME]``: a position on the Moon."""

    name: str | None = None
    frame: str = "ME_DE421"
    position_m: tuple[float, float, float] | None = None
    longitude_deg: float | None = None
    latitude_deg: float | None = None
    height_m: float | None = None


@dataclass(frozen=True, slots=True)
class Target(Place):
    """Keys of ``[target]``: a position, a trajectory, or the state of an orbiter."""

    kind: str | None = None  # of TARGET_KINDS, whose record has the other keys
    trajectory: Path | None = None
    body: int | None = entry(None, advice="it is a NAIF code, such as -85")
    dynamics: str | None = entry(None, choices=("moon",))
    epoch: str | None = None
    velocity_m_s: tuple[float, float, float] | None = None
    altitude_m: float | None = None
    inclination_deg: float | None = None
    node_deg: float | None = None
    semi_major_axis_m: float | None = None
    eccentricity: float | None = None
    periapsis_deg: float | None = None
    true_anomaly_deg: float | None = None
    ex: float | None = None
    ey: float | None = None
    hx: float | None = None
    hy: float | None = None
    true_longitude_deg: float | None = None
    axes: str | None = entry(None, choices=AXES)

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, slots=True)
class LandingKeys(Place):
    """Keys of ``[target.landing]``: epoch (TDB) and a-priori place of the touchdown."""

    epoch: str | None = None


def read_target(
    table: TomlTable, forces: tuple[ForcesChoice, Forces] | None, model: ModelChoice
) -> AnyTarget:
    """Read a position, a trajectory, an orbiter, or a target of a registered kind."""
    if "kind" in table:
        kind, _ = table.need("kind", str), table.get("name", str)
        if kind not in TARGET_KINDS:
            table.fail(
                "kind", f"expected a registered kind ({', '.join(TARGET_KINDS) or 'none'}), got {kind!r}"
            )
        return table.read(TARGET_KINDS[kind].record)
    if "dynamics" in table:
        return _orbiter(table, forces, model)
    if "trajectory" not in table and "body" not in table:
        return position_of(table, table.read(Target))
    for key in keys_of(Place):
        if key != "name" and key in table:
            table.fail(key, "give either a position or a trajectory with its body, not both")
    keys = table.read(Target)
    if keys.trajectory is None or keys.body is None:
        table.fail(
            "trajectory" if keys.trajectory is None else "body",
            "is missing; a trajectory is the name of an SPK file and the NAIF code of the body in it, such as -85",
        )
    return table.build(Trajectory.open, path=keys.trajectory, body=keys.body)


def read_forces(table: TomlTable) -> tuple[ForcesChoice, Forces]:
    """Read ``[forces]``, and return its record and the forces."""
    choice = table.read(ForcesChoice)
    return choice, table.build(choice.forces)


_CARTESIAN = ("position_m", "velocity_m_s")
_ROUGH_ORBIT = ("altitude_m", "inclination_deg", "node_deg")


def _orbiter(table: TomlTable, acting: tuple[ForcesChoice, Forces] | None, model: ModelChoice) -> Orbiter:
    choice, forces = acting or (default := ForcesChoice(), default.forces())
    ending = table.table("landing")
    state_keys = table.read(Target)
    # Needed and possible keys of each kind of state, by the key that identifies the kind.
    kinds: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
        "altitude_m": (_ROUGH_ORBIT[:1], _ROUGH_ORBIT),
        "ex": (EQUINOCTIAL, (*EQUINOCTIAL, "axes")),
        "semi_major_axis_m": (KEPLERIAN, (*KEPLERIAN, "axes")),
        "position_m": (_CARTESIAN, _CARTESIAN),
    }
    kind = next((key for key in kinds if getattr(state_keys, key) is not None), "position_m")
    needed, possible = kinds[kind]
    for key in ("epoch", *needed):
        if getattr(state_keys, key) is None:
            table.fail(
                key,
                "is missing; an orbiter needs epoch (TDB), and position_m and velocity_m_s (Moon-centred ICRF), six "
                "elements, or altitude_m",
            )
    if str(state_keys.epoch).strip().upper().endswith("Z"):
        table.fail("epoch", "is TDB, 64 to 69 s ahead of UTC since 1999: convert it, and leave the Z out")
    for key in dict.fromkeys(key for _, keys in kinds.values() for key in keys):
        if key not in possible and getattr(state_keys, key) is not None:
            table.fail(
                key,
                "give either position_m and velocity_m_s, six elements, or altitude_m (with inclination_deg, node_deg)",
            )
    for key in ("longitude_deg", "latitude_deg", "height_m", "trajectory"):
        if getattr(state_keys, key) is not None:
            table.fail(key, "belongs to a target without dynamics; leave it out")
    fields: dict[str, Any] = {
        "epoch": epochs_from_strings(str(state_keys.epoch), "TDB"),
        "forces": forces,
        "name": state_keys.name,
        "body": state_keys.body,
        "gravity_errors": choice.gravity_errors,
        "gravity_error_degree": choice.gravity_error_degree,
        "landing": None if ending is None else _landing(ending),
    }
    values = {key: getattr(state_keys, key) for key in possible}
    if kind in ("ex", "semi_major_axis_m"):
        return table.build(
            partial(Orbiter.from_elements, ephemeris=model.ephemeris, libration=model.libration),
            elements=[values[key] for key in needed],
            form="equinoctial" if kind == "ex" else "keplerian",
            axes=state_keys.axes,
            **fields,
        )
    if kind == "altitude_m":
        rough = table.build(RoughOrbit, **values)
        return table.build(partial(Orbiter, position_m=None, velocity_m_s=None), rough=rough, **fields)
    return table.build(Orbiter, **values, **fields)


def _landing(table: TomlTable) -> Landing:
    keys = table.read(LandingKeys)
    if keys.epoch is None:
        table.fail("epoch", "is missing; give the touchdown, TDB")
    has_place = any(getattr(keys, key) is not None for key in ("position_m", "longitude_deg", "latitude_deg"))
    place = position_of(table, keys) if has_place else None
    return table.build(Landing, epoch=epochs_from_strings(str(keys.epoch), "TDB"), place=place)


def named_positions(table: TomlTable) -> dict[str, Reference]:
    """Read tables of positions by name."""
    return {name: reference_of(entry, name) for name, entry in table.named().items()}


def references_of(reference: TomlTable | None, references: TomlTable | None) -> tuple[Reference, ...]:
    """Read the known positions of ``[reference]`` and ``[references]``, in this order."""
    first = () if reference is None else (reference_of(reference),)
    return (*first, *(() if references is None else named_positions(references).values()))


def reference_of(table: TomlTable, name: str = "reference") -> Reference:
    """Read a known position with its name, by default that of its table."""
    place = table.read(Place)
    return Reference(position_of(table, place), place.name or name)


def position_of(table: TomlTable, place: Place) -> LunarPosition:
    """Return the position from the keys of a table."""
    geographic = {key: getattr(place, key) for key in ("longitude_deg", "latitude_deg", "height_m")}
    present = [key for key, value in geographic.items() if value is not None]
    if place.position_m is not None:
        if present:
            table.fail(
                "position_m",
                f"give either position_m or longitude and latitude, not both ({', '.join(present)})",
            )
        return table.build(LunarPosition.from_cartesian, xyz_m=place.position_m, frame=place.frame)
    missing = [key for key in geographic if key not in present]
    if missing:
        table.fail(
            missing[0], "is missing; a position is longitude_deg, latitude_deg and height_m, or position_m"
        )
    return table.build(LunarPosition.from_selenographic, **geographic, frame=place.frame)


@singledispatch
def true_target(target: Any, table: TomlTable, forces: Mapping[str, Any]) -> AnyTarget:
    """Return the a-priori target with the true position, state and forces of a table; here of a registered kind."""
    return target if (changes := table.table("position")) is None else changes.replaced(target)


@true_target.register
def _(target: LunarPosition | Trajectory, table: TomlTable, forces: Mapping[str, Any]) -> AnyTarget:
    for key in ("state", "forces"):
        _refuse(table, key, 'a target with dynamics = "moon"', "position")
    position = table.table("position")
    return target if position is None else position_of(position, position.read(Place))


@true_target.register
def _(target: Orbiter, table: TomlTable, forces: Mapping[str, Any]) -> AnyTarget:
    if target.landing is None:
        _refuse(table, "position", "a place", "state")
    else:
        _refuse(table, "state", "a target that does not land", "position")
    position, state, acting = (table.table(key) for key in ("position", "state", "forces"))
    changes: dict[str, Any] = {}
    if state is not None:
        changes = {key: state.get(key, tuple[float, float, float]) for key in _CARTESIAN}
        state.finish()
    if None not in (changes.get("position_m"), changes.get("velocity_m_s")):
        target = replace(target, **changes, rough=None)
    if acting is not None:
        for key in _FIT_KEYS:
            if key in acting:
                acting.fail(key, "belongs to the fit, [forces]; leave it out")
        changes["forces"] = read_forces(acting.with_defaults(forces))[1]
    if target.landing is not None and position is not None:
        changes["landing"] = replace(target.landing, place=position_of(position, position.read(Place)))
    return replace(target, **{key: value for key, value in changes.items() if value is not None})


def _refuse(table: TomlTable, key: str, kind: str, instead: str) -> None:
    """Refuse a key of another kind of target."""
    if key in table:
        table.fail(key, f"belongs to {kind} on the Moon; use [{table.name}.{instead}]")
