"""Benchmark: cases of tracking data with a true position or orbit, and scores of the entries of any program.

An entry claims a covariance P for each result, and the truth has the covariance T. If the claim holds, the error e has
the statistic e^T (P + T)^-1 e, distributed as chi-square. A claim fails if the largest statistic has a probability
below 0.1 %, divided by the number of results, or if of many draws too few 95 % regions contain the truth.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from radioloc._version import __version__
from radioloc.errors import InputError, error_context, require_type
from radioloc.kernels.files import sha256_of
from radioloc.lunar.local import axes_at
from radioloc.lunar.position import LunarPosition
from radioloc.results.recorded import check_solution
from radioloc.results.result import Result
from radioloc.results.scores import Score, Scores
from radioloc.study.schema import Hints, TomlTable, entry, toml_content
from radioloc.study.study_file import read_study
from radioloc.study.target_file import Place, position_of
from radioloc.text_files import json_file, read_text
from radioloc.time import epochs_from_strings
from radioloc.vectors import Floats

SIGNIFICANCE_LEVEL = 1e-3
"""Probability of refusing a claim that holds."""

MAX_EPOCH_DIFFERENCE_S = 1e-6
"""Bound of rounding in the text of an epoch: 2 mm of a lunar orbit."""

CASE_FILE = "case.toml"
_ICRF = "ICRF"
_DRAW_MARK = "#"  # between the name of a result and the number of its draw


@dataclass(frozen=True, slots=True)
class StatedResult(Place):
    """Keys of ``[truth.NAME]`` of a case and of a result of an entry."""

    epoch_tdb: str | None = None
    sigma_m: Floats | None = entry(None, read=lambda table, key: _array(table, key, (), (2,), (3,)))
    covariance_m2: Floats | None = entry(None, read=lambda table, key: _array(table, key, (3, 3)))
    source: str | None = None


@dataclass(frozen=True, slots=True)
class DataFile:
    """Keys of ``[[data]]``: a file that the user downloads into the folder of the case."""

    file: str
    source: str
    bytes: int | None = None
    sha256: str | None = None


@dataclass(frozen=True, slots=True)
class Point:
    """Position with its covariance, NaN where it is unknown.

    The axes of the covariance are east, north and up for a point on the Moon, and the ICRF for a spacecraft.
    """

    frame: str
    xyz_m: Floats
    covariance_m2: Floats
    epoch_tdb: str | None = None

    def error_from(self, truth: Point) -> Floats:
        """Return the difference from the truth along the axes of the covariance, m, shape (3,)."""
        if (self.frame == _ICRF) != (truth.frame == _ICRF) or not self._is_at(truth):
            raise InputError(f"frame and epoch: expected {truth._label()}, got {self._label()}")
        if truth.frame == _ICRF:
            return self.xyz_m - truth.xyz_m
        moved = LunarPosition.from_cartesian(self.xyz_m, self.frame).to_frame(truth.frame)
        return axes_at(truth.xyz_m) @ (moved.xyz_m - truth.xyz_m)

    def _is_at(self, truth: Point) -> bool:
        if self.epoch_tdb is None or truth.epoch_tdb is None:
            return self.epoch_tdb is truth.epoch_tdb
        first, second = (epochs_from_strings(item, "TDB") for item in (self.epoch_tdb, truth.epoch_tdb))
        return abs(float(first.seconds_since(second)[0])) < MAX_EPOCH_DIFFERENCE_S

    def _label(self) -> str:
        return f"{self.frame} at {self.epoch_tdb}" if self.epoch_tdb else self.frame


@dataclass(frozen=True, slots=True)
class Case:
    """Case of a benchmark, read from the ``case.toml`` of its folder."""

    folder: Path
    title: str
    truths: Mapping[str, Point]
    studies: tuple[Path, ...] = ()
    data: tuple[DataFile, ...] = ()
    draws: int = 0
    is_agreement: bool = False  # of the results with each other, in place of a truth

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.name

    def problem(self) -> str:
        """Return the reason why the studies cannot be run; empty if they can."""
        for item in self.data:
            path = self.folder / item.file
            if not path.is_file():
                return f"download {item.file} from {item.source}"
            if item.sha256 and sha256_of(path) != item.sha256:
                return f"{item.file} differs from the published file; download it again from {item.source}"
        return ""


@dataclass(frozen=True, slots=True)
class BenchmarkEntry:
    """Results of a program, by the name of a truth or this name with the number of a draw (``lander#7``)."""

    program: str
    version: str
    results: Mapping[str, Point]
    source: str


def score(case: str | Path, result: str | Path | Result | None = None) -> Scores:
    """Score entries of a benchmark.

    Parameters
    ----------
    case : path-like
        Folder of a case, with its ``case.toml``, or a folder of such folders.
    result : path-like, Solution, optional
        Entry of one case: ``solution.json``, a JSON or CSV file of any program, or a solution. By default the studies
        of the cases are run, and the files in their ``entries`` folders read.

    Returns
    -------
    Scores
        Errors, claims and places; only an entry whose claim holds has a place.

    Raises
    ------
    InputError
        A file has another format, or an entry lacks a result.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate("examples/apollo15/apollo15.toml")
    >>> [row.holds for row in radioloc.score("examples/benchmark/apollo15-2006", solution).rows]
    [True]
    """
    cases = read_cases(Path(case))
    if result is not None and len(cases) > 1:
        raise InputError(f"{case}: expected the folder of one case for an entry, got {len(cases)} cases")
    rows, missing = list[Score](), dict[str, str]()
    for item in cases:
        if result is not None:
            entries = [read_entry(result, item)]
        else:
            entries = [read_entry(file, item) for file in sorted((item.folder / "entries").glob("*.[jc]s*"))]
            if item.studies and (problem := item.problem()):
                missing[item.name] = problem
            elif item.studies:  # in place of the recorded entry
                entries = [recorded for recorded in entries if recorded.program != "radioloc"] + [_run(item)]
        rows += _ranked(_score(item, scored) for scored in entries)
    return Scores({item.name: item.title for item in cases}, tuple(rows), missing)


def read_cases(path: Path) -> list[Case]:
    """Return the case of a folder, or the cases of the folders in it, sorted by name."""
    folders = (
        [path] if (path / CASE_FILE).is_file() else [file.parent for file in path.glob(f"*/{CASE_FILE}")]
    )
    if not folders:
        raise InputError(f"{path}: expected a folder with a {CASE_FILE}, or one of such folders")
    return [_read_case(folder) for folder in sorted(folders)]


def _read_case(folder: Path) -> Case:
    path = folder / CASE_FILE
    top = TomlTable(path, "", toml_content(path), Hints())
    top.get("task", str)  # for readers
    truth = top.table("truth")
    case = Case(
        folder.resolve(),
        top.need("title", str),
        {} if truth is None else {name: _point(table) for name, table in truth.named().items()},
        top.get("studies", tuple[Path, ...]) or (),
        top.get("data", tuple[DataFile, ...]) or (),
        top.get("draws", int) or 0,
        bool(top.get("agreement", bool)),
    )
    top.finish()
    if bool(case.truths) == case.is_agreement:
        top.fail("truth", "expected tables [truth.NAME] or agreement = true, got both or neither")
    return case


def _point(table: TomlTable) -> Point:
    stated = table.read(StatedResult)
    if stated.frame == _ICRF:
        if stated.position_m is None or stated.epoch_tdb is None:
            table.fail("frame", "ICRF needs position_m, relative to the Moon's centre, and epoch_tdb")
        xyz_m = np.array(stated.position_m)
    else:
        xyz_m = position_of(table, stated).xyz_m
    covariance_m2 = stated.covariance_m2
    if covariance_m2 is None:
        sigma_m = np.full(3, math.nan)
        if stated.sigma_m is not None:
            sigma_m[: 2 if stated.sigma_m.size == 2 else 3] = stated.sigma_m
        if (sigma_m < 0.0).any():
            table.fail("sigma_m", "expected zero or more")
        covariance_m2 = np.diag(sigma_m**2)
    elif not np.allclose(covariance_m2, covariance_m2.T) or np.linalg.eigvalsh(covariance_m2)[0] < 0.0:
        table.fail("covariance_m2", "expected a symmetric matrix without negative eigenvalues")
    return Point(stated.frame, xyz_m, covariance_m2, stated.epoch_tdb)


def _array(table: TomlTable, key: str, *shapes: tuple[int, ...]) -> Floats | None:
    """Take finite numbers in one of several shapes."""
    if (value := table.take(key)) is None:
        return None
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.array(math.nan)
    if array.shape not in shapes or not np.isfinite(array).all():
        sizes = " or ".join(" x ".join(map(str, shape)) or "one" for shape in shapes)
        table.fail(key, f"expected numbers ({sizes}), got {value!r}")
    return array


def read_entry(source: str | Path | Result, case: Case) -> BenchmarkEntry:
    """Return an entry from a solution, a ``solution.json``, or a JSON or CSV file of another program."""
    require_type("entry", source, str, Path, Result)
    if isinstance(source, Result):
        return BenchmarkEntry("radioloc", __version__, _results_of(source.to_dict(), case), "run")
    path = Path(source)
    if path.suffix == ".csv":
        return _csv_entry(path)
    with json_file(path, "is neither a solution.json nor an entry of a benchmark") as content:
        if not isinstance(content, Mapping):
            raise InputError("expected an object")
        if "provenance" in content:
            check_solution(content)
            version = str(content["provenance"].get("versions", {}).get("radioloc", ""))
            return BenchmarkEntry("radioloc", version, _results_of(content, case), str(path))
    return _entry(path, content)


def _entry(path: Path, content: Mapping[str, Any]) -> BenchmarkEntry:
    top = TomlTable(path, "", content, Hints())
    results = top.table("results")
    program, version = top.need("program", str), top.get("version", str) or ""
    top.get("method", str)  # for readers
    top.finish()
    if results is None:
        top.fail("results", "is missing; expected an object of results by name")
    points = {name: _point(table) for name, table in results.named().items()}
    return BenchmarkEntry(program, version, points, path.name)


def _csv_entry(path: Path) -> BenchmarkEntry:
    """Return the entry of a table with a column for each key; comments of the first lines name the program."""
    lines = read_text(path).splitlines()
    heads = dict(line[1:].split(":", 1) for line in lines if line.startswith("#") and ":" in line)
    content = {
        key.strip(): text.strip() for key, text in heads.items() if key.strip() in ("program", "version")
    }
    rows = csv.DictReader(io.StringIO("\n".join(line for line in lines if not line.startswith("#"))))
    results = dict[str, dict[str, Any]]()
    for row in rows:
        texts = {key: text.strip() for key, text in row.items() if key and text and text.strip()}
        keys = {key: text if key in ("frame", "epoch_tdb") else _number(path, key, text)
                for key, text in texts.items() if key != "name"}  # fmt: skip
        for name, parts in (
            ("position_m", ("x_m", "y_m", "z_m")),
            ("sigma_m", ("sigma_1_m", "sigma_2_m", "sigma_3_m")),
        ):
            if all(part in keys for part in parts):
                keys[name] = [keys.pop(part) for part in parts]
        results[texts.get("name", "")] = keys
    return _entry(path, {**content, "results": results})


def _number(path: Path, key: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{path}: column {key}: expected a number, got {text!r}") from None


def _run(case: Case) -> BenchmarkEntry:
    """Return radioloc's entry: the solutions of the studies, or of all draws."""
    from radioloc.jobs.locate import locate
    from radioloc.jobs.simulate import simulate

    results = dict[str, Point]()
    for path in case.studies:
        study = read_study(path)
        if not case.draws:
            results |= _results_of(locate(study).to_dict(), case, path.stem)
        for draw in range(1, case.draws + 1):
            drawn = simulate(study, draw, draw_errors=True)
            points = _results_of(locate(study, drawn.observations).to_dict(), case)
            results |= {f"{name}{_DRAW_MARK}{draw}": point for name, point in points.items()}
    return BenchmarkEntry("radioloc", __version__, results, "run")


def _results_of(content: Mapping[str, Any], case: Case, stem: str = "") -> dict[str, Point]:
    """Return the results of a solution: targets by name, a single one by the only truth or the study."""
    if state := content.get("state"):
        covariance = np.array(state["covariance"], dtype=np.float64)[:3, :3]
        points = {"": Point(_ICRF, np.array(state["position_m"]), covariance, state["epoch_tdb"])}
    else:
        points = {
            name: Point(
                item["position"]["me"]["frame"],
                np.array([item["position"]["me"][f"{axis}_m"] for axis in "xyz"]),
                np.array(item["covariance"]["enu_m2"], dtype=np.float64),
            )
            for name, item in (content.get("targets") or {"": content}).items()
            if item["position"] is not None
        }
    single = next(iter(case.truths)) if len(case.truths) == 1 else stem
    return {name or single: point for name, point in points.items()}


def _pairs(case: Case, entry: BenchmarkEntry) -> Iterator[tuple[str, Point, Point]]:
    """Yield the name of each result, the result and its truth, or each two results of a case of agreement."""
    if case.is_agreement:
        for (name, first), (_, second) in combinations(entry.results.items(), 2):
            yield name, first, second
        return
    for name, truth in case.truths.items():
        for draw in range(1, case.draws + 1) if case.draws else (None,):
            key = name if draw is None else f"{name}{_DRAW_MARK}{draw}"
            if key not in entry.results:
                raise InputError(f"{entry.source}: the result {key!r} of the case {case.name} is missing")
            yield key, entry.results[key], truth


def _score(case: Case, entry: BenchmarkEntry) -> Score:
    """Return the score of an entry without its place."""
    from scipy.special import bdtr, chdtrc

    squares, variances, statistics = list[float](), list[float](), list[tuple[float, int]]()
    for name, result, truth in _pairs(case, entry):
        with error_context(f"{entry.source}: result {name!r}:"):
            error_m = result.error_from(truth)
        # The truth selects the components: an unknown height is not scored.
        used = np.isfinite(np.diag(truth.covariance_m2))
        total = (result.covariance_m2 + truth.covariance_m2)[np.ix_(used, used)]
        claim = np.diag(result.covariance_m2)[used].sum()
        if case.is_agreement:
            claim = np.trace(total)
        squares.append(float(error_m[used] @ error_m[used]))
        variances.append(float(claim))
        if np.isfinite(total).all():
            if np.linalg.eigvalsh(total)[0] <= 0.0:
                raise InputError(f"{entry.source}: result {name!r}: expected sigmas above zero")
            statistics.append((float(error_m[used] @ np.linalg.solve(total, error_m[used])), int(used.sum())))
    count = len(squares)
    if not count:
        raise InputError(f"{entry.source}: expected two results or more, got {len(entry.results)}")
    base = Score(case.name, entry.program, entry.version, count, math.sqrt(np.mean(squares)), None, None, None,
                 False, entry.source)  # fmt: skip
    if len(statistics) < count:
        return base
    chances = [float(chdtrc(dof, statistic)) for statistic, dof in statistics]
    covered = sum(chance > 0.05 for chance in chances)
    # Results of one fit share their errors; only draws are independent.
    covers = not case.draws or bdtr(covered, count, 0.95) > SIGNIFICANCE_LEVEL
    return replace(
        base,
        claim_m=math.sqrt(np.mean(variances)),
        sigmas=math.sqrt(sum(item for item, _ in statistics) / sum(dof for _, dof in statistics)),
        covered=covered,
        holds=bool(covers and min(chances) * count >= SIGNIFICANCE_LEVEL),
    )


def _ranked(scores: Iterable[Score]) -> list[Score]:
    """Return scores in order: claims that hold by the greater of error and claim, then the others."""
    rows = sorted(scores, key=lambda row: (not row.holds, row.size_m, row.error_m))
    return [replace(row, place=place) if row.holds else row for place, row in enumerate(rows, 1)]
