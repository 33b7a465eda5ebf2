"""Comparison of solutions with a benchmark, tests of their agreement, and their joint estimate.

Published positions with their sigmas, in a TOML file, are compared like solutions.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import combinations, compress
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.errors import InputError, error_context, require_type
from radioloc.estimation.combination import (
    JointEstimate,
    PositionEstimate,
    agreement,
    joint_estimate,
    rotated_covariance,
)
from radioloc.estimation.shared_observations import SampledSeries, share_observations
from radioloc.estimation.statistics import finite_or_none
from radioloc.lunar.local import EAST_NORTH_UP, rot_enu_between
from radioloc.lunar.position import LunarPosition
from radioloc.results.comparison import Comparison, StateComparison, state_pair
from radioloc.results.recorded import read_recorded
from radioloc.results.result import Result
from radioloc.results.tables import (
    GEOGRAPHIC,
    METHODS,
    Place,
    PositionRow,
    by_axis,
    place_fields,
    place_record,
)
from radioloc.study.schema import Hints, TomlTable, check, entry, toml_content
from radioloc.study.target_file import Place as PositionTable
from radioloc.study.target_file import position_of
from radioloc.targets.position_prior import map_tie_names
from radioloc.text_files import read_rows
from radioloc.vectors import Floats

_JOINT = "joint estimate"
_PUBLISHED = Path(str(files("radioloc.lunar"))) / "data" / "published_positions.csv"
_PUBLISHED_SIGMAS = ("sigma_east_m", "sigma_north_m", "sigma_up_m")
_PUBLISHED_COLUMNS = ("object", "name", *GEOGRAPHIC, *_PUBLISHED_SIGMAS, "method", "source")


def compare(
    solutions: Iterable[str | Path | Result],
    reference: str | None = None,
    target: str | None = None,
    published: str | None = None,
) -> Comparison | StateComparison:
    """Compare solutions as table 1 of Wang et al. (2021) does, test each pair, and combine them.

    Parameters
    ----------
    solutions : iterable of path-like, Solution, ArcStudy or other result with a position
        Results, where an arc study has a solution for each arc, or files: ``solution.json`` of :command:`locate` and
        :command:`images`, ``arcs.json`` of :command:`arcs`, or TOML files of published positions.
    reference : str, optional
        Benchmark: the name of a solution, or of a reference in one of the files. By default the first reference,
        or else the first solution.
    target : str, optional
        Target to compare, if solutions have several.
    published : str, optional
        Object of the table of published positions, such as ``"Chang'e-3"``, whose positions are compared too.

    Returns
    -------
    Comparison or StateComparison
        Of positions, or of the states of a spacecraft, which have one epoch.

    Raises
    ------
    InputError
        A file has another format, another frame or several targets of which none is named, or no file has the
        reference.

    Examples
    --------
    >>> import radioloc
    >>> study = radioloc.read_study("examples/apollo15/apollo15.toml")
    >>> [row.name for row in radioloc.compare([radioloc.locate(study)]).rows]
    ['apollo15', 'JPL, DE421 solution']
    """
    if isinstance(solutions, str | Path | Result):
        solutions = (solutions,)
    require_type("solutions", solutions, Iterable)
    solutions = tuple(solutions)
    if (states := _recorded_states(solutions, target)) is not None:
        return _compare_states(states)
    recorded, references = _read_all(solutions, target)
    if published is not None:
        recorded += _read_published(published, recorded[0].place[2])
    frame = _common_frame(recorded)
    names = _distinct_names(recorded)
    estimates = [replace(item.estimate, name=name) for item, name in zip(recorded, names, strict=True)]
    converged = [item.content["converged"] for item in recorded]
    joint = joint_estimate(list(compress(estimates, converged)))

    places = references | {name: item.place for name, item in zip(names, recorded, strict=True)}
    if joint is not None:
        places[_JOINT] = LunarPosition.from_cartesian(joint.position_me_m, frame).selenographic
    benchmark = reference or next(iter(places))
    if benchmark not in places:
        raise InputError(f"reference: expected one of {', '.join(places)}, got {benchmark!r}")

    def differences(name: str) -> dict[str, Any]:
        return place_fields(places[name], None if name == benchmark else places[benchmark])

    rows = [_row(item.content, name, differences(name)) for item, name in zip(recorded, names, strict=True)]
    if joint is not None:
        sigmas = [finite_or_none(math.sqrt(variance)) for variance in np.diag(joint.covariance_enu_m2)]
        rows.append(PositionRow("joint", _JOINT, **differences(_JOINT), **_sigmas(sigmas)))
    rows += [PositionRow("reference", name, **differences(name)) for name in references if name not in names]
    origin_m = LunarPosition.from_selenographic(*places[benchmark], frame).xyz_m
    agreements = tuple(agreement(first, second) for first, second in combinations(estimates, 2))
    return Comparison(
        frame, benchmark, tuple(rows), _covariances_en_m2(estimates, joint, origin_m), agreements, joint
    )


def _recorded_states(
    solutions: Sequence[str | Path | Result], target: str | None
) -> list[tuple[Mapping[str, Any], Mapping[str, Any]]] | None:
    """Return solutions and their states of a spacecraft; None if a solution has a position or no such state."""
    recorded = []
    for source in solutions:
        require_type("solutions", source, str, Path, Result)
        # Standard input can be read only once.
        if isinstance(source, str | Path) and (str(source) == "-" or Path(source).suffix == ".toml"):
            return None
        content = source.to_dict() if isinstance(source, Result) else read_recorded(source)
        for arc in content.get("arcs", [{"solution": content}]):
            solution = arc.get("solution", {})
            states = solution.get("states") or {}
            state = states.get(target) if states else solution.get("state")
            if solution.get("position") or state is None:
                return None
            recorded.append((solution, state))
    return recorded or None


def _compare_states(recorded: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> StateComparison:
    epochs = list(dict.fromkeys(state["epoch_tdb"] for _, state in recorded))
    if len(epochs) > 1:
        raise InputError(
            f"solutions: expected states at one epoch, got {', '.join(epochs)}; give their studies the same epoch in "
            "[target]"
        )
    names = [solution["name"] for solution, _ in recorded]
    if len(set(names)) < len(names):
        raise InputError("solutions: expected different names, got one name twice; rename their studies")
    samples = [tuple(map(SampledSeries.from_dict, solution["observations"])) for solution, _ in recorded]
    pairs = [
        state_pair(
            (names[first], names[second]),
            (recorded[first][1], recorded[second][1]),
            share_data=share_observations(samples[first], samples[second]),
        )
        for first, second in combinations(range(len(recorded)), 2)
    ]
    converged = {solution["name"]: solution["converged"] for solution, _ in recorded}
    return StateComparison(epochs[0], converged, tuple(pairs))


def _read_all(
    solutions: Iterable[str | Path | Result], target: str | None
) -> tuple[list[RecordedSolution], dict[str, Place]]:
    """Return the solutions of a target from all files and results, and the references to it."""
    recorded: list[RecordedSolution] = []
    references: dict[str, Place] = {}
    has_several_targets = False
    for source in solutions:
        is_stated = isinstance(source, str | Path) and Path(source).suffix == ".toml"
        items, places = (_read_stated(Path(str(source))), {}) if is_stated else read_solutions(source)
        recorded += [item.of_target(target) for item in items]
        targets = [[*item.content["targets"]] for item in items if item.content.get("targets")]
        has_several_targets |= bool(targets)
        if all(target == first for first, *_ in targets):  # references are of the first target
            references = places | references
    if not recorded:
        raise InputError("solutions: expected solution.json, arcs.json or TOML files, got none")
    if target is not None and not has_several_targets:
        raise InputError(f"target: expected a solution of several targets, got none; leave out {target!r}")
    return recorded, references


def _common_frame(recorded: Iterable[RecordedSolution]) -> str:
    frames = {item.content["position"]["me"]["frame"]: item.where for item in recorded}
    if len(frames) > 1:
        listed = ", ".join(f"{where} in {frame}" for frame, where in frames.items())
        raise InputError(
            f"solutions: expected positions in the same axes, got {listed}; use one ephemeris for all"
        )
    return next(iter(frames))


def _covariances_en_m2(
    estimates: Sequence[PositionEstimate], joint: JointEstimate | None, origin_m: Floats
) -> dict[str, Floats]:
    """Return covariances east and north in the axes at the origin of the ellipses, where they are finite."""
    # Near a pole, the axes at the benchmark are not those at the estimates.
    covariances = {item.name: item.carried_to(origin_m).total_enu_m2 for item in estimates}
    if joint is not None:
        rotation = rot_enu_between(joint.position_me_m, origin_m)
        covariances[_JOINT] = rotated_covariance(rotation, joint.covariance_enu_m2)
    return {name: matrix[:2, :2] for name, matrix in covariances.items() if np.isfinite(matrix[:2, :2]).all()}


@dataclass(frozen=True, slots=True)
class RecordedSolution:
    """Solution of a file or a result, and its estimate of the position."""

    where: str  # its name in messages
    content: Mapping[str, Any]
    estimate: PositionEstimate

    @property
    def place(self) -> Place:
        """East longitude and latitude, deg, and height, m, in mean-Earth axes."""
        me = self.content["position"]["me"]
        return me["longitude_deg"], me["latitude_deg"], me["height_m"]

    def of_target(self, target: str | None) -> RecordedSolution:
        """Return the solution of one of several targets; a solution of a single target is returned unchanged."""
        targets = self.content.get("targets")
        if not targets:
            return self
        if target not in targets:
            got = "none" if target is None else repr(target)
            raise InputError(
                f"{self.where}: expected the name of a target ({', '.join(targets)}), got {got}; "
                "give it as --target, or target= in Python"
            )
        content = {**self.content, **targets[target], "targets": {}}
        # In a solution of one target the parameter is named position.
        names = [item["name"].replace(f"position.{target}.", "position.", 1) for item in content["priors"]]
        content["priors"] = [
            {**item, "name": name} for item, name in zip(content["priors"], names, strict=True)
        ]
        return RecordedSolution(self.where, content, PositionEstimate.from_solution(content))


def read_solutions(source: str | Path | Result) -> tuple[list[RecordedSolution], dict[str, Place]]:
    """Return the solutions of a ``solution.json``, an ``arcs.json`` or a result, and its references."""
    require_type("solutions", source, str, Path, Result)
    content = read_recorded(source) if isinstance(source, str | Path) else source.to_dict()
    if not {"position", "positions"} & content.keys():
        raise InputError(f"solutions: expected results with a position, got {type(source).__name__}")
    arcs = content["arcs"] if "positions" in content else [{"solution": content}]
    references = {
        row["name"]: (row["longitude_deg"], row["latitude_deg"], row["height_m"])
        for row in content.get("positions", ())
        if row["method"] == "reference"
    }
    recorded = [arc["solution"]["reference"] for arc in arcs]
    places = {
        item["name"]: (item["longitude_deg"], item["latitude_deg"], item["height_m"])
        for item in filter(None, recorded)
    }
    with error_context(f"{source}:") if isinstance(source, str | Path) else nullcontext():
        solutions = [
            RecordedSolution(
                f"{source}, {arc['hours']:g} h" if "hours" in arc else str(source),
                arc["solution"],
                PositionEstimate.from_solution(arc["solution"]),
            )
            for arc in arcs
        ]
    return solutions, references or places


def _distinct_names(solutions: Sequence[RecordedSolution]) -> list[str]:
    """Return names of solutions, followed by the folder where several have one name."""
    counts = Counter(item.content["name"] for item in solutions)
    names = [item.content["name"] for item in solutions]
    names = [
        name if counts[name] == 1 else f"{name} ({Path(item.where).parent.name})"
        for name, item in zip(names, solutions, strict=True)
    ]
    if len(set(names)) < len(names):
        name, _ = Counter(names).most_common(1)[0]
        places = [item.where for item, label in zip(solutions, names, strict=True) if label == name]
        raise InputError(
            f"{' and '.join(places[:2])}: expected solutions of different names, got {name!r} twice; "
            "rename their studies"
        )
    return names


def _row(content: Mapping[str, Any], name: str, place: Mapping[str, Any]) -> PositionRow:
    fit = content["fit"]
    return PositionRow(
        content.get("method", "tracking"),
        name,
        **place,
        **_sigmas([content["sigma"][f"{axis}_m"] for axis in EAST_NORTH_UP]),
        used=fit["used"],
        rejected=fit["rejected"],
        wrms_m=fit.get("wrms_m"),
        converged=content["converged"],
    )


def _sigmas(values: Iterable[float | None]) -> dict[str, Any]:
    return dict(zip(("sigma_east_m", "sigma_north_m", "sigma_up_m"), values, strict=True))


@dataclass(frozen=True, slots=True)
class StatedPosition(PositionTable):
    """Keys of ``[positions.NAME]``: sigmas east and north, of the height, and of the tie of a map to the axes."""

    method: str = entry("tracking", choices=METHODS)
    sigma_m: tuple[float, float] | None = entry(None, positive=True, both=True)
    sigma_up_m: float | None = entry(None, positive=True)
    map: str | None = None
    map_sigma_m: tuple[float, float] | None = entry(None, positive=True, both=True)

    def __post_init__(self) -> None:
        check(self)


def _read_stated(path: Path) -> list[RecordedSolution]:
    """Return the published positions of a file, with the keys of ``solution.json``."""
    top = TomlTable(path, "", toml_content(path), Hints())
    positions = top.table("positions")
    top.finish()
    if positions is None:
        top.fail("positions", "is missing; each position is a table [positions.NAME]")
    contents = [_content(table, name) for name, table in positions.named().items()]
    return [RecordedSolution(str(path), item, PositionEstimate.from_solution(item)) for item in contents]


def published_objects() -> dict[str, list[dict[str, str]]]:
    """Return the rows of the table of published positions by object."""
    objects = dict[str, list[dict[str, str]]]()
    for _, row in read_rows(_PUBLISHED, _PUBLISHED_COLUMNS, "the table of published positions"):
        objects.setdefault(row["object"], []).append(row)
    return objects


def _read_published(name: str, height_m: float) -> list[RecordedSolution]:
    """Return the published positions of an object; those without a height have the given one, without a sigma."""
    objects = {_letters(key): rows for key, rows in published_objects().items()}
    if _letters(name) not in objects:
        raise InputError(f"published: expected one of {', '.join(published_objects())}, got {name!r}")
    recorded = []
    for row in objects[_letters(name)]:
        numbers = {key: float(row[key]) for key in (*GEOGRAPHIC, *_PUBLISHED_SIGMAS) if row[key]}
        stated = {key: numbers[key] for key in GEOGRAPHIC if key in numbers}
        sigmas_m = [numbers[key] for key in _PUBLISHED_SIGMAS[:2] if key in numbers]
        keys = {"height_m": height_m, **stated, "name": row["name"]}
        keys |= {"sigma_m": sigmas_m} if sigmas_m else {}
        keys |= {"sigma_up_m": numbers["sigma_up_m"]} if "sigma_up_m" in numbers else {}
        content = _content(TomlTable(_PUBLISHED, row["object"], keys), row["object"])
        recorded.append(RecordedSolution(str(_PUBLISHED), content, PositionEstimate.from_solution(content)))
    return recorded


def _letters(name: str) -> str:
    return "".join(filter(str.isalnum, name)).lower()


def _content(table: TomlTable, name: str) -> dict[str, Any]:
    stated = table.read(StatedPosition)
    place = position_of(table, stated)
    if not place.frame.startswith("ME_"):
        table.fail("frame", f"expected mean-Earth axes, such as ME_DE421, got {place.frame!r}")
    if (stated.map is None) != (stated.map_sigma_m is None):
        table.fail("map", "belongs to map_sigma_m; give both or neither")
    sigma_m = np.array([*(stated.sigma_m or (math.nan,) * 2), stated.sigma_up_m or math.nan])
    ties_m = stated.map_sigma_m or ()
    total_m2 = sigma_m**2
    total_m2[: len(ties_m)] += np.square(ties_m)
    determined = np.isfinite(total_m2)
    covariance = np.where(np.outer(determined, determined), np.diag(total_m2), math.nan)
    return {
        "name": stated.name or name,
        "method": stated.method,
        "converged": True,
        "position": {"me": place_record(place.frame, place.selenographic, place.xyz_m)},
        "sigma": by_axis(EAST_NORTH_UP, np.sqrt(total_m2)),
        "covariance": {"enu_m2": covariance},
        "considered": [
            {"name": name, "position_enu_m": tie_m * side}
            for name, tie_m, side in zip(map_tie_names(stated.map or ""), ties_m, np.eye(3), strict=False)
        ],
        "fit": {"used": None, "rejected": None},
        "reference": None,
        "provenance": {},
    }
