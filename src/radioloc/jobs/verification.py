"""Verification of a solution: computed again from the files of its provenance, and compared."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError, require_type
from radioloc.jobs.arcs import arcs
from radioloc.jobs.locate import compute_residuals, locate
from radioloc.kernels.files import sha256_of
from radioloc.report.files import INCOMPLETE, json_text
from radioloc.results.cards import Card, Field
from radioloc.results.recorded import read_recorded
from radioloc.results.result import Result
from radioloc.study.record import study_origin, versions
from radioloc.study.schema import run_study_file
from radioloc.study.study_file import read_study
from radioloc.time import epochs_from_strings

_TOLERANCE_SIGMAS = 1e-3
"""Tolerance of values in sigmas, and relative tolerance of sigmas: above the rounding of other processors and
libraries in iterations, below the digits of a card."""
_TOLERANCE_M = 1e-4  # Tolerance of positions with a tiny sigma: error of interpolated observations
_NOT_COMPARED = ("provenance", "notes", "message")
"""Keys of versions and settings, which are compared separately, and of prose."""


@dataclass(frozen=True, slots=True)
class Difference:
    """Value that differs from the file; None if absent."""

    name: str
    recorded: Any
    now: Any


@dataclass(frozen=True, slots=True)
class Verification(Result):
    """Comparison of a solution with its repetition: differences beyond rounding, and other versions."""

    name: str
    compared: int
    differences: tuple[Difference, ...]
    environment: tuple[Difference, ...]

    @property
    def same(self) -> bool:
        """True if all values agree."""
        return not self.differences

    is_usable = same

    def card(self) -> Card:
        """Return the status, the values that differ and other versions."""
        state = f"DIFFERS in {len(self.differences)} of {self.compared} values"
        heading, now = ("", "recorded", "now"), "with other versions than the recorded ones"
        return Card(
            [
                Field("solution", [self.name]),
                Field("status", [f"SAME in all of {self.compared} values" if self.same else state]),
                Field("differs", (), heading, [_row(item) for item in self.differences]),
                Field("made now", [now] if self.environment else ()),
                Field("", (), heading, [_row(item) for item in self.environment]),
            ]
        )


def verify(path: str | Path, study: str | Path | None = None) -> Verification:
    """Compute a solution again from the files of its provenance, and compare every number.

    Parameters
    ----------
    path : path-like
        A ``solution.json`` of ``locate``, ``residuals``, ``arcs`` or ``images``.
    study : path-like, optional
        The study file, if it was moved.

    Raises
    ------
    InputError
        The file has no solution, or one of its input files is missing or has changed.

    Examples
    --------
    >>> import radioloc
    >>> study = radioloc.read_study("examples/apollo15/apollo15.toml")
    >>> written = radioloc.write_report("out", radioloc.locate(study))
    >>> radioloc.verify("out/solution.json").same
    True
    """
    require_type("path", path, str, Path)
    require_type("study", study, str, Path, type(None))
    recorded = _recorded(Path(path))
    repeated = _repeated(Path(path), recorded["provenance"], study)
    provenance = recorded["provenance"]
    environment = [
        Difference(name, provenance.get(name), value)
        for name, value in versions().items()
        if provenance.get(name) != value
    ]
    pairs = list(_pairs(recorded, json.loads(json_text(repeated))))
    differences = (
        Difference(name, old, new) for name, old, new, allowed in pairs if _differ(old, new, allowed)
    )
    return Verification(str(path), len(pairs), tuple(differences), tuple(environment))


def _recorded(path: Path) -> Mapping[str, Any]:
    for folder in (path.parent, path.parent.parent):
        if (folder / INCOMPLETE).is_file():
            raise InputError(f"{path}: {folder / INCOMPLETE} marks a folder that was not written completely")
    content = read_recorded(path)
    if path.name == "arcs.json" or "positions" in content:
        raise InputError(
            f"{path}: expected a solution.json, got an arcs.json; give that in the folder of one arc"
        )
    if content["provenance"].get("study") is None:
        raise InputError(
            f"{path}: expected a solution of a study file and its observations, got one that was computed in Python or "
            "from standard input; it cannot be repeated"
        )
    return content


def _repeated(path: Path, recorded: Mapping[str, Any], file: str | Path | None) -> dict[str, Any]:
    """Return the repeated solution as a dictionary; missing or changed input files are errors."""
    origin = recorded["study"]
    study_file = Path(origin["file"] if file is None else file)
    if not study_file.is_file():
        raise InputError(f"{path}: its study file {study_file} is missing; give its new place (--study FILE)")
    if sha256_of(study_file) != origin["sha256"]:
        raise InputError(
            f"{path}: {study_file} has changed since the solution was computed; restore the study file"
        )
    problem = f"{path}: cannot be repeated from {study_file}"
    if "settings" not in origin:  # a study of another kind, such as of images, has all settings in its file
        repeated = run_study_file(study_file).to_dict()
        _require_unchanged(problem, origin, repeated["provenance"]["study"])
        return repeated
    full_study, hours = read_study(study_file), origin.get("hours")
    study = replace(full_study, observations=replace(full_study.observations, hours=hours))
    _require_unchanged(problem, origin, study_origin(study))
    estimate = recorded.get("estimate")
    if estimate is not None and estimate.get("clock_epoch"):  # of the complete arc; this may be a part of it
        clock_epoch = epochs_from_strings([estimate["clock_epoch"]], "UTC")
        full_study, study = (
            replace(item, estimate=replace(item.estimate, clock_epoch=clock_epoch))
            for item in (full_study, study)
        )
    if hours != full_study.observations.hours:
        return arcs(full_study, [hours]).arcs[0].solution.to_dict()
    return (compute_residuals if estimate is None else locate)(study).to_dict()


def _require_unchanged(problem: str, recorded: Mapping[str, Any], origin: Mapping[str, Any]) -> None:
    """Raise an error if the input files or the settings of a study have changed."""
    old_files, new_files = (
        Counter((item["file"], item["sha256"]) for item in study["inputs"]) for study in (recorded, origin)
    )
    missing, new = (
        sorted({name for name, _ in files}) for files in (old_files - new_files, new_files - old_files)
    )
    if missing or new:
        changes = [f"{name} {'has another content' if name in new else 'is missing'}" for name in missing]
        changes += [f"{name} is new" for name in new if name not in missing]
        raise InputError(f"{problem}: {', '.join(changes)}")
    settings = recorded.get("settings", {}).items()
    if changed := [key for key, digest in settings if origin["settings"].get(key) != digest]:
        raise InputError(
            f"{problem}: its settings differ ({', '.join(changed)}); they were changed in Python, or another version "
            "of radioloc reads them differently"
        )


Pair = tuple[str, Any, Any, float]
"""Name of a number, its values then and now, and their tolerance."""


def _pairs(old: Any, new: Any, name: str = "", scale: float = 0.0) -> Iterator[Pair]:
    """Pair every value of two results, named by its keys joined by dots; `scale` is the sigma of a number."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in dict.fromkeys([*old, *new]):
            if key not in _NOT_COMPARED:
                place = f"{name}.{key}" if name else str(key)
                yield from _pairs(old.get(key), new.get(key), place, _scale(key, old, scale))
    elif isinstance(old, list) and isinstance(new, list):
        # Rows with names are paired by name, others by index.
        old_rows, new_rows = (_rows_by_name(rows) for rows in (old, new))
        largest = max((abs(item) for item in old if _is_number(item)), default=scale)
        for key in dict.fromkeys([*old_rows, *new_rows]):
            yield from _pairs(old_rows.get(key), new_rows.get(key), f"{name}.{key}", max(scale, largest))
    else:
        size = abs(old) if _is_number(old) else 0.0
        floor = _TOLERANCE_M if name.endswith("_m") else 0.0
        yield name, old, new, max(_TOLERANCE_SIGMAS * (scale or size), 1e-9 * size, floor)


def _rows_by_name(rows: list[Any]) -> dict[str, Any]:
    names = [str(row.get("name", "")) if isinstance(row, Mapping) else "" for row in rows]
    if "" in names or len(set(names)) < len(names):
        names = [str(place) for place in range(len(rows))]
    return dict(zip(names, rows, strict=True))


def _scale(key: str, parent: Mapping[str, Any], scale: float) -> float:
    """Return the standard deviation of a value, or the size that its tolerance refers to."""
    if key in ("position", "targets"):  # the sigmas of all targets are similar
        sigmas = [value or 0.0 for value in (parent.get("sigma") or {}).values() if _is_number(value)]
        return min(sigmas, default=0.0)
    if key in ("longitude_deg", "latitude_deg"):
        return math.degrees(max(scale, _TOLERANCE_M / _TOLERANCE_SIGMAS) / MEAN_LUNAR_RADIUS_M)
    if key in ("value", "prior_value"):
        return float(parent.get("sigma") or 0.0)
    if key == "mean_m":
        return float(parent.get("rms_m") or 0.0)
    return 1.0 if key.endswith(("_sigmas", "coefficient", "chance")) else scale


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _differ(old: Any, new: Any, allowed: float) -> bool:
    if isinstance(old, float) and _is_number(new):
        return not abs(old - new) <= allowed
    return bool(old != new)


def _row(item: Difference) -> tuple[str, str, str]:
    return item.name, _text(item.recorded), _text(item.now)


def _text(value: Any) -> str:
    return f"{value:.10g}" if isinstance(value, float) else str(value)
