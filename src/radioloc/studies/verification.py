"""A solution verified: made again from what its provenance names, and compared."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from radioloc.errors import InputError
from radioloc.kernels import sha256_of
from radioloc.report.cards import Card, Field
from radioloc.report.files import INCOMPLETE
from radioloc.studies.arcs import arcs
from radioloc.studies.image_study import read_image_study
from radioloc.studies.images import locate_images
from radioloc.studies.locate import fit_arc, prepared_arc
from radioloc.studies.record import study_origin, versions
from radioloc.studies.study import Study
from radioloc.studies.study_file import read_study
from radioloc.text_files import json_file

_OF_SIGMA = 1e-3
"""How far values may differ in parts of their sigmas, and sigmas in parts of themselves: more than iterations leave
that end elsewhere as other processors and libraries round, less than anyone could see on a card."""
_ALLOWED_M = 1e-4
"""The same for positions with a tiny sigma, m: what interpolated observations may be off by."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A number of the file that came out otherwise; None where there is none."""

    name: str
    recorded: Any
    now: Any


@dataclass(frozen=True, slots=True)
class Verification:
    """What came out when a solution was made again; ``str()`` is a card.

    Parameters
    ----------
    name : str
        The file of the solution.
    compared : int
        How many numbers were compared.
    differences : tuple of Difference
        Those that differ by more than rounding.
    environment : tuple of Difference
        Versions that are not those of then.
    """

    name: str
    compared: int
    differences: tuple[Difference, ...]
    environment: tuple[Difference, ...]

    @property
    def same(self) -> bool:
        """Whether the solution came out as it was."""
        return not self.differences

    def __str__(self) -> str:
        state = f"DIFFERS in {len(self.differences)} of {self.compared} values"
        heading, now = ("", "recorded", "now"), "with other versions than then"
        return str(
            Card(
                [
                    Field("solution", [self.name]),
                    Field("status", [f"SAME in all of {self.compared} values" if self.same else state]),
                    Field("differs", (), heading, [_row(item) for item in self.differences]),
                    Field("made now", [now] if self.environment else ()),
                    Field("", (), heading, [_row(item) for item in self.environment]),
                ]
            )
        )


def verify(path: str | Path, study: str | Path | None = None) -> Verification:
    """Make a solution again from what its provenance names, and compare positions, parameters, sigmas and counts.

    Parameters
    ----------
    path : path-like
        A ``solution.json``, as ``locate``, ``residuals``, ``arcs`` or ``images`` wrote it.
    study : path-like, optional
        The study file, where it is no longer where it was.

    Raises
    ------
    InputError
        The file is none of a solution, or a file that it was made from is missing or has another content.

    Examples
    --------
    >>> import radioloc
    >>> study = radioloc.read_study("examples/apollo15/apollo15.toml")
    >>> written = radioloc.write_report(radioloc.locate(study), "out")
    >>> radioloc.studies.verify("out/solution.json").same
    True
    """
    before = _recorded(Path(path))
    now = _again(Path(path), before["provenance"], study)
    then = before["provenance"]
    environment = [
        Difference(name, then.get(name), value)
        for name, value in versions().items()
        if then.get(name) != value
    ]
    pairs = list(_pairs(before, now))
    differences = (
        Difference(name, one, two) for name, one, two, allowed in pairs if _differ(one, two, allowed)
    )
    return Verification(str(path), len(pairs), tuple(differences), tuple(environment))


def _recorded(path: Path) -> dict[str, Any]:
    for folder in (path.parent, path.parent.parent):
        if (folder / INCOMPLETE).is_file():
            raise InputError(f"{path}: {folder / INCOMPLETE} says that the folder was not written to the end")
    what = "is no solution.json, or one of a version that did not record what it was made from"
    with json_file(path, what) as content:
        made_from = content["provenance"]["study"]
    if made_from is None:
        raise InputError(
            f"{path}: was made from no study file (but in Python or from standard input), or with other observations "
            "than the file's; there is nothing to make it from again"
        )
    return dict(content)


def _again(path: Path, then: Mapping[str, Any], file: str | Path | None) -> dict[str, Any]:
    """The same solution made now, as a dictionary; an error where what it was made from is not there any more."""
    found = Path(then["study"]["file"] if file is None else file)
    if not found.is_file():
        raise InputError(f"{path}: its study file {found} is missing; give where it is now (--study FILE)")
    if sha256_of(found) != then["study"]["sha256"]:
        raise InputError(
            f"{path}: {found} is not the study file that it was made from; its content is another"
        )
    problem = f"{path}: cannot be made again from {found}"
    if "settings" not in then["study"]:  # all of a study of images is in its file
        now = locate_images(read_image_study(found)).to_dict()
        _require_same_files(problem, then["study"], now["provenance"]["study"])
        return now
    whole, hours = read_study(found), then["study"]["hours"]
    study = replace(whole, observations=replace(whole.observations, hours=hours))
    _require_same(problem, then["study"], study)
    if hours != whole.observations.hours:
        return arcs(whole, [hours]).arcs[0].solution.to_dict()
    arc, left_out = prepared_arc(study)
    return fit_arc(study, arc, left_out, None if then["estimate"] is None else study.estimate).to_dict()


def _require_same(problem: str, then: Mapping[str, Any], study: Study) -> None:
    """Raise an error where the files or the settings of a study are not those of then."""
    origin = study_origin(study)
    _require_same_files(problem, then, origin)
    changed = [key for key, digest in then["settings"].items() if origin["settings"].get(key) != digest]
    if changed:
        raise InputError(
            f"{problem}: its settings are others ({', '.join(changed)}), changed in Python, or read otherwise by "
            "another version of radioloc"
        )


def _require_same_files(problem: str, then: Mapping[str, Any], origin: Mapping[str, Any]) -> None:
    before, now = (
        Counter((item["file"], item["sha256"]) for item in one["inputs"]) for one in (then, origin)
    )
    gone, new = sorted({name for name, _ in before - now}), sorted({name for name, _ in now - before})
    if gone or new:
        found = [f"{name} {'has another content' if name in new else 'is missing'}" for name in gone]
        found += [f"{name} was not there" for name in new if name not in gone]
        raise InputError(f"{problem}: {', '.join(found)}")


Pair = tuple[str, Any, Any, float]
"""Name of a number, its values then and now, and by how much they may differ."""


def _pairs(then: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[Pair]:
    for key in ("converged", "status"):
        yield key, then[key], now[key], 0.0
    for key in ("used", "rejected"):
        yield f"fit.{key}", then["fit"][key], now["fit"][key], 0.0
    yield from _position_pairs("", then, now)
    for name in sorted({*then.get("targets", {}), *now.get("targets", {})}):
        yield from _position_pairs(f"{name} ", *(one.get("targets", {}).get(name, {}) for one in (then, now)))
    rows = [{row["name"]: row for row in one.get("parameters", ())} for one in (then, now)]
    for name in dict.fromkeys([*rows[0], *rows[1]]):
        one, two = (row.get(name, {}) for row in rows)
        sigma = one.get("sigma") or 0.0
        value = one.get("value")
        yield name, value, two.get("value"), _OF_SIGMA * sigma + 1e-9 * abs(value or 0.0)
        yield f"{name} sigma", one.get("sigma"), two.get("sigma"), _OF_SIGMA * sigma


def _position_pairs(of: str, then: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[Pair]:
    if not (then.get("position") and now.get("position")):
        yield f"{of}position", then.get("position"), now.get("position"), 0.0
        return
    sigmas = [value or 0.0 for value in (then["sigma"][f"{axis}_m"] for axis in ("east", "north", "up"))]
    allowed_m = max(_ALLOWED_M, _OF_SIGMA * min(sigmas))
    for axis in "xyz":
        key = f"{axis}_m"
        yield f"{of}position {key}", then["position"]["pa"][key], now["position"]["pa"][key], allowed_m
    for axis, sigma in zip(("east", "north", "up"), sigmas, strict=True):
        key = f"{axis}_m"
        yield f"{of}sigma {key}", then["sigma"][key], now["sigma"][key], _OF_SIGMA * sigma


def _differ(one: Any, two: Any, allowed: float) -> bool:
    if isinstance(one, float) and isinstance(two, float):
        return not abs(one - two) <= allowed
    return bool(one != two)


def _row(item: Difference) -> tuple[str, str, str]:
    return item.name, _text(item.recorded), _text(item.now)


def _text(value: Any) -> str:
    return f"{value:.10g}" if isinstance(value, float) else str(value)
