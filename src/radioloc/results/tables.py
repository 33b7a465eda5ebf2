"""Printable tables: positions relative to a benchmark, as in Wang et al. (2021), table 1, and solutions."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError, visible
from radioloc.estimation.combination import Ellipse, horizontal_ellipse
from radioloc.estimation.statistics import Residuals, finite_or_none
from radioloc.lunar.local import EAST_NORTH_UP, local_difference
from radioloc.lunar.selenographic import selenographic_to_cartesian
from radioloc.measurements.link import canonical_target
from radioloc.results.cards import Field, metres, sigma_text, value_text
from radioloc.results.names import parameter_name
from radioloc.results.recorded import check_solution
from radioloc.results.result import Content, Result, Table
from radioloc.text_files import require_ending, write_text
from radioloc.vectors import Floats

SolutionLike = Result | Mapping[str, Any]
"""A solution of tracking or of images, or the content of its ``solution.json``."""

_RESIDUAL_DECIMALS = {"observed_m": 7, "computed_m": 7, "residual_m": 6, "sigma_m": 6, "elevation_deg": 4}
RESIDUAL_COLUMNS = ("epoch_utc", "type", "path", *_RESIDUAL_DECIMALS, "status", "residual_mm_s")
"""Columns of ``residuals.csv``, in order; the last only with observations over a count interval."""

_LATEX = {
    "\\": r"\textbackslash{}",
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": "$<$",
    ">": "$>$",
    "|": r"\textbar{}",
    "[": "{[}",  # at the start of a row it would be an option of the row above
    "°": r"$^\circ$",
    "δ": r"$\delta$",
    "±": r"$\pm$",
    "×": r"$\times$",
}
_MINUS, _POWER = re.compile(r"(?<![\w.])-(?=[\d.])"), re.compile(r"(?<=\d)e([+-]\d+)\b")

_HEADING = ("", "L, deg E", "B, deg N", "dL, deg", "dB, deg", "dL, m", "dB, m")

METHODS = ("tracking", "images", "image_point", "stereo")
"""Methods by which positions are determined."""

POSITION_FILES = ("table1.csv", "table1.md", "table1.tex")
"""Files of a table of positions."""

GEOGRAPHIC = ("longitude_deg", "latitude_deg", "height_m")
"""Keys of a place in ``solution.json``."""

Place = tuple[float, float, float]
"""East longitude and latitude, deg, and height, m."""


def finite(values: Iterable[float]) -> list[float | None]:
    """Return numbers for JSON, which has neither infinity nor NaN."""
    return [finite_or_none(value) for value in values]


def by_axis(names: Iterable[str], values_m: Iterable[float]) -> dict[str, float | None]:
    """Return the components of a vector, m, by keys such as ``east_m``."""
    return {f"{name}_m": value for name, value in zip(names, finite(values_m), strict=True)}


def place_record(frame: str, selenographic: tuple[float, float, float], xyz_m: Floats) -> dict[str, Any]:
    """Return the frame of a place, its angles (deg) and height (m), and its components, wherever it is."""
    angles = dict(zip(GEOGRAPHIC, selenographic, strict=True))
    return {"frame": frame, **angles, **by_axis("xyz", xyz_m)}


def ellipse_text(ellipse: Ellipse) -> str:
    """Return the line of a card on the error ellipse that holds 95 %."""
    return (
        f"95 % error ellipse, horizontal: {metres(ellipse.semi_major_m)} m x {metres(ellipse.semi_minor_m)} m, "
        f"azimuth {ellipse.azimuth_deg:.0f} deg"
    )


@dataclass(frozen=True, slots=True)
class TextTable:
    """Table of text cells: first columns of words, aligned to the left, others of numbers, aligned to the right."""

    heading: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1  # columns

    def to_markdown(self) -> str:
        """Return the table in Markdown, as GitHub and Pandoc read it."""
        rules = ["---" if k < self.words else "---:" for k in range(len(self.heading))]
        lines = (
            " | ".join(cell.replace("|", r"\|") for cell in cells)
            for cells in (self.heading, rules, *self.rows)
        )
        return visible("".join(f"| {line} |\n" for line in lines))

    def to_latex(self) -> str:
        """Return the table as a ``tabular`` of LaTeX, which needs no package."""
        columns = "l" * self.words + "r" * (len(self.heading) - self.words)
        heading, *rows = (" & ".join(map(_latex, cells)) + " \\\\" for cells in (self.heading, *self.rows))
        lines = (
            rf"\begin{{tabular}}{{{columns}}}",
            r"\hline",
            heading,
            r"\hline",
            *rows,
            r"\hline",
            r"\end{tabular}",
        )
        return visible("".join(f"{line}\n" for line in lines))


def _latex(text: str) -> str:
    """Return a text for LaTeX: escaped characters, minus signs and powers of ten."""
    escaped = _MINUS.sub("$-$", "".join(_LATEX.get(sign, sign) for sign in text))
    return _POWER.sub(lambda match: rf"$\times 10^{{{int(match[1])}}}$", escaped)


def write_table_file(path: str | Path, table: TextTable) -> Path:
    """Write a table by the ending of the name, ``.md`` or ``.tex``; another is an :class:`InputError`."""
    ending = require_ending(path, (".md", ".tex"))
    write_text(path, table.to_markdown() if ending == ".md" else table.to_latex())
    return Path(path)


@dataclass(frozen=True, slots=True)
class PositionRow:
    """Position with its difference to the benchmark, in m along the great circle's arc on the sphere of 1737.4 km."""

    # The arc has its direction at the benchmark: over some kilometres R cos(B) dL and R dB. A reference has no numbers
    # of a fit, the benchmark no differences.
    method: str  # `tracking`, `images`, `image_point`, `stereo`, `joint` or `reference`
    name: str  # length of the arc, or name of the solution or the reference
    longitude_deg: float  # east, -180 to 180 deg, mean-Earth axes
    latitude_deg: float
    height_m: float  # above 1737.4 km
    east_deg: float | None  # position less benchmark
    north_deg: float | None  # likewise
    east_m: float | None  # the same along the sphere
    north_m: float | None  # likewise
    up_m: float | None  # difference of the heights
    sigma_east_m: float | None = None  # total standard deviation; null if not determined
    sigma_north_m: float | None = None  # likewise
    sigma_up_m: float | None = None  # likewise
    from_longest_m: float | None = None  # horizontal distance from the longest arc's position
    from_longest_sigmas: float | None = None  # the same in standard deviations of the difference
    used: int | None = None  # observations
    rejected: int | None = None  # observations
    wrms_m: float | None = None  # of the used residuals
    converged: bool | None = None  # whether the fit converged

    @property
    def sigmas_m(self) -> tuple[float | None, float | None, float | None]:
        """Total standard deviations east, north and up."""
        return self.sigma_east_m, self.sigma_north_m, self.sigma_up_m


def difference(place: Place, benchmark: Place) -> tuple[float, float, float, float, float]:
    """Return the difference to a benchmark: east, north (deg), east, north and up (m, on the sphere of 1737.4 km)."""
    point_m, origin_m = (
        selenographic_to_cartesian(math.radians(longitude_deg), math.radians(latitude_deg), height_m)
        for longitude_deg, latitude_deg, height_m in (place, benchmark)
    )
    local = local_difference(point_m, origin_m, radius_m=MEAN_LUNAR_RADIUS_M)
    east_deg = math.remainder(place[0] - benchmark[0], 360.0)
    return east_deg, place[1] - benchmark[1], local.east_m, local.north_m, place[2] - benchmark[2]


def place_fields(place: Place, benchmark: Place | None) -> dict[str, Any]:
    """Return a position and its differences to the benchmark, as fields of a row."""
    names = ("east_deg", "north_deg", "east_m", "north_m", "up_m")
    differences = (None,) * 5 if benchmark is None else difference(place, benchmark)
    return {
        "longitude_deg": math.remainder(place[0], 360.0),
        "latitude_deg": place[1],
        "height_m": place[2],
        **dict(zip(names, differences, strict=True)),
    }


def residual_table(rows: Residuals) -> Table:
    """Return residuals as a table, one row for each observation, with the columns :data:`RESIDUAL_COLUMNS`."""
    if rows.elevation_deg is None:
        raise InputError(
            "residuals.csv: expected elevations of the solution; give elevation_deg to its residuals"
        )
    columns: dict[str, Any] = {"epoch_utc": rows.epoch_utc, "type": rows.types, "path": rows.paths}
    columns |= {name: getattr(rows, name) for name in _RESIDUAL_DECIMALS}
    # Cells have no quotation marks, so that tools which split lines at commas read them.
    columns["status"] = replace(
        rows.statuses, texts=tuple(text.replace(",", ";") for text in rows.statuses.texts)
    )
    if rows.count_s is not None and not np.isnan(rows.count_s).all():
        columns["residual_mm_s"] = rows.residual_mm_s
    for name in ("observed_m", "computed_m", "residual_m", "sigma_m"):
        if not np.isfinite(columns[name]).all():
            k = int(np.argmin(np.isfinite(columns[name])))
            raise InputError(
                f"{name} of observation {k + 1}: expected a finite number, got {columns[name][k]}"
            )
    return Table(columns, _RESIDUAL_DECIMALS | {"residual_mm_s": 5})


def position_cells(row: PositionRow) -> tuple[str, ...]:
    """Return longitude and latitude with their differences in deg and m as text."""
    cells = (f"{row.longitude_deg:z.5f}", f"{row.latitude_deg:.5f}")
    if row.east_deg is None or row.east_m is None:
        return (*cells, "benchmark", "-", "-", "-")
    differences = f"{row.east_deg:z.5f}", f"{row.north_deg:z.5f}"
    return (*cells, *differences, f"{row.east_m:z.1f}", f"{row.north_m:z.1f}")


def position_fields(rows: Iterable[PositionRow], axes: str, benchmark: str) -> tuple[Field, Field]:
    """Return the fields of a card with positions relative to a benchmark, and their axes."""
    explanation = (
        f"{axes}; L east longitude, B latitude; dL, dB relative to {benchmark}, on the sphere of "
        f"{MEAN_LUNAR_RADIUS_M / 1e3:.1f} km"
    )
    cells = ((row.name, *position_cells(row)) for row in rows)
    return Field("axes", (explanation,)), Field("positions", (), _HEADING, cells)


def position_table(rows: Iterable[PositionRow], names: Mapping[str, str] | None = None) -> TextTable:
    """Return the printable table; `names` replace names of rows."""
    heading = ("Method", "", "L (°E)", "B (°N)", "δL (°E)", "δB (°N)", "δL (m)", "δB (m)")
    cells = [(row.method, (names or {}).get(row.name, row.name), *position_cells(row)) for row in rows]
    return TextTable(heading, cells, words=2)


def position_files(
    rows: Sequence[PositionRow],
    names: Mapping[str, str] | None = None,
    more: Sequence[Mapping[str, Any]] = (),
) -> dict[str, Content]:
    """Return the table of positions in three formats by file name; only the CSV has the columns of `more`."""
    table = position_table(rows, names)
    records = [asdict(row) for row in rows]
    for record, columns in zip(records, more, strict=False):
        record |= columns
    contents = (record_table(records), table.to_markdown(), table.to_latex())
    return dict(zip(POSITION_FILES, contents, strict=True))


def record_table(records: Sequence[Mapping[str, Any]]) -> Table:
    """Return a table with a row for each record; keys that a record lacks are empty cells."""
    names = dict.fromkeys(name for record in records for name in record)
    columns = {name: [record.get(name) for record in records] for name in names}
    return Table(
        {
            name: [visible(item) if isinstance(item, str) else item for item in column]
            for name, column in columns.items()
        }
    )


def solution_content(result: SolutionLike) -> Mapping[str, Any]:
    """Return the content of the ``solution.json`` of a solution; a mapping is checked."""
    if not isinstance(result, Mapping):
        return result.to_dict()
    check_solution(result)
    return result


def contents_by_target(results: Iterable[SolutionLike], target: str | None = None) -> list[Mapping[str, Any]]:
    """Return the contents of ``solution.json`` for each target of solutions; the first has the references.

    With the name of a `target`, only those of this target are returned.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate("examples/apollo15/apollo15.toml")
    >>> [content["name"] for content in radioloc.results.contents_by_target([solution])]
    ['apollo15']
    """
    contents: list[Mapping[str, Any]] = []
    for content in map(solution_content, results):
        references = {key: content[key] for key in ("reference", "references") if key in content}
        for name, record in (content.get("targets") or {}).items():
            named = {"name": f"{content['name']}, {name}", "target": name, "targets": {}}
            contents.append({**content, **record, **named, "reference": None, "references": [], **references})
            references = {}
        contents += [] if content.get("targets") else [content]
    if target is None:
        return contents
    chosen = [item for item in contents if canonical_target(_target_name(item)) == canonical_target(target)]
    if contents and not chosen:
        raise InputError(f"--target: expected {', '.join(map(_target_name, contents))}, got {target}")
    return chosen


def single_content(results: Iterable[SolutionLike]) -> Mapping[str, Any]:
    """Return the content of ``solution.json`` for the only target of solutions."""
    contents = contents_by_target(results)
    if len(contents) != 1:
        raise InputError(
            f"expected one position for this format, got {', '.join(map(_target_name, contents))}; give one, or a "
            "target by --target"
        )
    return contents[0]


def _target_name(content: Mapping[str, Any]) -> str:
    return str(content.get("target") or content["name"])


def references_of(content: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return all references in the content of a ``solution.json``, in order."""
    first = content.get("reference")
    return [*([] if first is None else [first]), *content.get("references", ())]


def position_of(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the position of a content of ``solution.json``; a target on a trajectory is an :class:`InputError`."""
    if not content["position"]:
        raise InputError(f"{content['name']}: expected a position on the Moon, got a target on a trajectory")
    position: Mapping[str, Any] = content["position"]
    return position


def horizontal_covariance_of(content: Mapping[str, Any]) -> Floats | None:
    """Return the covariance of east and north, m^2, shape (2, 2); None if the position is not determined."""
    covariance = np.array(content["covariance"]["enu_m2"], dtype=np.float64)[:2, :2]
    return covariance if np.isfinite(covariance).all() else None


def solution_table(solutions: Iterable[SolutionLike]) -> TextTable:
    """Return position, sigmas, fit and other estimated parameters of solutions, one column each."""
    contents = contents_by_target(solutions)
    if not contents:
        raise InputError("solutions: expected at least one")
    columns = [_column(content) for content in contents]
    names = dict.fromkeys(name for column in columns for name in column)
    rows = [(name, *(column.get(name, "-") for column in columns)) for name in names]
    return TextTable(("", *(content["name"] for content in contents)), rows)


def _column(content: Mapping[str, Any]) -> dict[str, str]:
    """Return the cells of one solution by row."""
    fit = content["fit"]
    cells = {"status": "converged" if content["converged"] else "not converged"}
    if content["position"]:
        cells |= _position(content)
    if "used" in fit:
        cells |= {"observations used": str(fit["used"]), "rejected": str(fit["rejected"])}
    if fit.get("wrms_m") is not None:
        cells["wrms, m"] = metres(fit["wrms_m"])
    if fit.get("chi2_per_dof") is not None:
        cells["chi2/dof"] = f"{fit['chi2_per_dof']:.3g}"
    for item in content.get("parameters", ()):
        if not item["fixed"] and item["name"].split(".")[0] != "position":
            sigma = item["total_sigma"]
            value = (
                "undetermined"
                if sigma is None
                else f"{value_text(item['value'], sigma)} ± {sigma_text(sigma)}"
            )
            cells[f"{parameter_name(item['name'])}, {item['unit']}"] = value
    return cells


def _position(content: Mapping[str, Any]) -> dict[str, str]:
    me = content["position"]["me"]
    cells = {
        "axes": me["frame"],
        "longitude, ° E": f"{me['longitude_deg']:.8f}",
        "latitude, ° N": f"{me['latitude_deg']:.8f}",
        "height, m": f"{me['height_m']:.3f}",
    }
    if any(content["sigma"][f"{axis}_m"] != 0.0 for axis in EAST_NORTH_UP):  # zero for a fixed position
        for axis in EAST_NORTH_UP:
            cells[f"1 sigma {axis}, m"] = metres(content["sigma"][f"{axis}_m"])
        if (covariance := horizontal_covariance_of(content)) is not None:
            ellipse = horizontal_ellipse(covariance)
            axes = f"{metres(ellipse.semi_major_m)} × {metres(ellipse.semi_minor_m)}"
            cells |= {"95 % ellipse, m": axes, "its azimuth, °": f"{ellipse.azimuth_deg:.0f}"}
    if (reference := content.get("reference")) is not None and "east_m" in reference:
        for axis in EAST_NORTH_UP:
            cells[f"{axis} of {reference['name']}, m"] = metres(reference[f"{axis}_m"])
    return cells
