"""Tables to print, of positions beside a benchmark as in Wang et al. (2021), table 1, and of solutions."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError, visible
from radioloc.estimation.combination import Ellipse, horizontal_ellipse
from radioloc.estimation.statistics import Residuals, finite_or_none
from radioloc.lunar.local import local_difference
from radioloc.lunar.selenographic import selenographic_to_cartesian
from radioloc.results.cards import Field, metres, sigma_text, to_sigma
from radioloc.results.recorded import check_solution
from radioloc.results.result import Result, Table
from radioloc.targets.orbit_state import EAST_NORTH_UP
from radioloc.text_files import require_ending, spreadsheet_cell, write_text
from radioloc.vectors import Floats

Located = Result | Mapping[str, Any]
"""A solution of tracking or of images, or what its ``solution.json`` holds."""

_RESIDUAL_DECIMALS = {
    "observed_m": 7,
    "computed_m": 7,
    "residual_m": 6,
    "sigma_m": 6,
    "elevation_deg": 4,
}
RESIDUAL_COLUMNS = ("epoch_utc", "type", "path", *_RESIDUAL_DECIMALS, "status", "residual_mm_s")
"""Columns of ``residuals.csv``, in order; the last only where something is counted."""

_LATEX = {
    "\\": r"\textbackslash{}",
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": "$<$",
    ">": "$>$",
    "|": r"\textbar{}",
    "[": "{[}",  # of a row that begins with it the row above would take it for its own
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
    """A table whose cells are text: the first columns of words, to the left, the others of numbers, to the right."""

    heading: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1  # columns

    def to_markdown(self) -> str:
        """The table in Markdown, as GitHub and Pandoc read it."""
        rules = ["---" if k < self.words else "---:" for k in range(len(self.heading))]
        lines = (
            " | ".join(cell.replace("|", r"\|") for cell in cells)
            for cells in (self.heading, rules, *self.rows)
        )
        return visible("".join(f"| {line} |\n" for line in lines))

    def to_latex(self) -> str:
        """The table as a ``tabular`` of LaTeX, which needs no package."""
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
    """Text with LaTeX's own signs escaped, and numbers with minus signs and powers of ten."""
    escaped = _MINUS.sub("$-$", "".join(_LATEX.get(sign, sign) for sign in text))
    return _POWER.sub(lambda found: rf"$\times 10^{{{int(found[1])}}}$", escaped)


def write_table_file(path: str | Path, table: TextTable) -> Path:
    """Write a table by the ending of the name, ``.md`` or ``.tex``; another is an :class:`InputError`."""
    ending = require_ending(path, (".md", ".tex"))
    write_text(path, table.to_markdown() if ending == ".md" else table.to_latex())
    return Path(path)


@dataclass(frozen=True, slots=True)
class PositionRow:
    """Position with its difference to the benchmark, in m along the great circle's arc on the sphere of 1737.4 km."""

    # Longitudes are counted to the west, -180 to 180 deg, as Wang et al. (2021) do. The arc has its direction at the
    # benchmark: over some kilometres R cos(B) dL and R dB. What a reference does not have is None.
    method: str  # one of METHODS, "joint" or "reference"
    name: str  # length of the arc, name of the solution or of the reference
    longitude_west_deg: float  # mean-Earth axes
    latitude_deg: float
    height_m: float
    west_deg: float | None  # this less the benchmark, as the next four; None for the benchmark itself
    north_deg: float | None
    west_m: float | None
    north_m: float | None
    up_m: float | None
    sigma_west_m: float | None = None  # total standard deviation, as the next two; None where not determined
    sigma_north_m: float | None = None
    sigma_up_m: float | None = None
    # Horizontal distance from the longest arc's position; None for that itself.
    from_longest_m: float | None = None
    # The same in the standard deviations that this difference should have.
    from_longest_sigmas: float | None = None
    used: int | None = None
    left_out: int | None = None
    wrms_m: float | None = None
    converged: bool | None = None

    @property
    def sigmas_m(self) -> tuple[float | None, float | None, float | None]:
        """Total standard deviations west (or east), north and up."""
        return self.sigma_west_m, self.sigma_north_m, self.sigma_up_m


def difference(place: Place, benchmark: Place) -> tuple[float, float, float, float, float]:
    """Return the difference to a benchmark: west, north (deg), west, north and up (m, on the sphere of 1737.4 km)."""
    point_m, origin_m = (
        selenographic_to_cartesian(math.radians(longitude_deg), math.radians(latitude_deg), height_m)
        for longitude_deg, latitude_deg, height_m in (place, benchmark)
    )
    apart = local_difference(point_m, origin_m, radius_m=MEAN_LUNAR_RADIUS_M)
    west_deg = -math.remainder(place[0] - benchmark[0], 360.0)
    return west_deg, place[1] - benchmark[1], -apart.east_m, apart.north_m, place[2] - benchmark[2]


def place_fields(place: Place, benchmark: Place | None) -> dict[str, Any]:
    """A position and its differences to the benchmark, as fields of a row."""
    names = ("west_deg", "north_deg", "west_m", "north_m", "up_m")
    differences = (None,) * 5 if benchmark is None else difference(place, benchmark)
    return {
        "longitude_west_deg": -math.remainder(place[0], 360.0),
        "latitude_deg": place[1],
        "height_m": place[2],
        **dict(zip(names, differences, strict=True)),
    }


def residual_table(rows: Residuals) -> Table:
    """Return residuals as a table, one row for each observation, with the columns :data:`RESIDUAL_COLUMNS`."""
    if rows.elevation_deg is None:
        raise InputError(
            "the solution has no elevations, which residuals.csv lists; give them to build_solution"
        )
    columns: dict[str, Any] = {"epoch_utc": rows.epoch_utc, "type": rows.types, "path": rows.paths}
    columns |= {name: getattr(rows, name) for name in _RESIDUAL_DECIMALS} | {"status": rows.statuses}
    if rows.count_s is not None and not np.isnan(rows.count_s).all():
        columns["residual_mm_s"] = rows.residual_mm_s
    for name in ("observed_m", "computed_m", "residual_m", "sigma_m"):
        if not np.isfinite(columns[name]).all():
            bad = int(np.argmin(np.isfinite(columns[name])))
            raise InputError(
                f"{name} of observation {bad + 1} is {columns[name][bad]}; residuals must be finite"
            )
    return Table(columns, _RESIDUAL_DECIMALS | {"residual_mm_s": 5})


def east_longitude_deg(row: PositionRow, to_360: bool = False) -> float:
    """East longitude, -180 to 180 or 0 to 360 deg."""
    return -row.longitude_west_deg % 360.0 if to_360 else -row.longitude_west_deg


def position_cells(row: PositionRow, *, east: bool = True, to_360: bool = False) -> tuple[str, ...]:
    """Longitude (to the east, or as the row has it) and latitude with their differences in deg and m, as text."""
    sign = -1.0 if east else 1.0
    longitude_deg = east_longitude_deg(row, to_360) if east else row.longitude_west_deg
    cells = (f"{longitude_deg:z.5f}", f"{row.latitude_deg:.5f}")
    if row.west_deg is None or row.west_m is None:
        return (*cells, "benchmark", "-", "-", "-")
    differences = f"{sign * row.west_deg:z.5f}", f"{row.north_deg:z.5f}"
    return (*cells, *differences, f"{sign * row.west_m:z.1f}", f"{row.north_m:z.1f}")


def position_fields(
    rows: Iterable[PositionRow], axes: str, benchmark: str, to_360: bool = False
) -> tuple[Field, Field]:
    """Fields of a card: positions beside a benchmark, and their axes."""
    explained = (
        f"{axes}; L east longitude, B latitude; dL, dB relative to {benchmark}, on the sphere of "
        f"{MEAN_LUNAR_RADIUS_M / 1e3:.1f} km"
    )
    cells = ((row.name, *position_cells(row, to_360=to_360)) for row in rows)
    return Field("axes", (explained,)), Field("positions", (), _HEADING, cells)


def position_table(rows: Iterable[PositionRow], names: Mapping[str, str] | None = None) -> TextTable:
    """The table to print; ``names`` of rows that are called otherwise there."""
    heading = ("Method", "", "L (°W)", "B (°N)", "δL (°W)", "δB (°N)", "δL (m)", "δB (m)")
    cells = [
        (row.method, (names or {}).get(row.name, row.name), *position_cells(row, east=False)) for row in rows
    ]
    return TextTable(heading, cells, words=2)


def position_files(
    rows: Sequence[PositionRow],
    names: Mapping[str, str] | None = None,
    more: Sequence[Mapping[str, Any]] = (),
) -> dict[str, str]:
    """Return the table of positions in three formats by the names of files; further columns are in the CSV only."""
    table = position_table(rows, names)
    texts = (csv_table(rows, more), table.to_markdown(), table.to_latex())
    return dict(zip(POSITION_FILES, texts, strict=True))


def csv_table(rows: Sequence[PositionRow], more: Sequence[Mapping[str, Any]] = ()) -> str:
    """The table as comma-separated text, with further columns of some rows."""
    records = [asdict(row) for row in rows]
    for record, added in zip(records, more, strict=False):
        record |= added
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(dict.fromkeys(k for r in records for k in r)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {
            key: spreadsheet_cell(visible(cell)) if isinstance(cell, str) else cell
            for key, cell in record.items()
        }
        for record in records
    )
    return stream.getvalue()


def content_of(result: Located) -> Mapping[str, Any]:
    """Return what ``solution.json`` holds of a solution, or the mapping given in its place, checked."""
    if not isinstance(result, Mapping):
        return result.to_dict()
    check_solution(result)
    return result


def contents_by_target(results: Iterable[Located]) -> list[Mapping[str, Any]]:
    """Return the contents of solutions as in ``solution.json``, one for each target; the first has the references.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate("examples/apollo15/apollo15.toml")
    >>> [content["name"] for content in radioloc.results.contents_by_target([solution])]
    ['apollo15']
    """
    contents: list[Mapping[str, Any]] = []
    for content in map(content_of, results):
        references = {key: content[key] for key in ("reference", "references") if key in content}
        for name, target in (content.get("targets") or {}).items():
            named = {"name": f"{content['name']}, {name}", "targets": {}}
            contents.append({**content, **target, **named, "reference": None, "references": [], **references})
            references = {}
        contents += [] if content.get("targets") else [content]
    return contents


def references_of(content: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return all references in the content of a ``solution.json``, in order."""
    first = content.get("reference")
    return [*([] if first is None else [first]), *content.get("references", ())]


def position_of(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """The position of what ``solution.json`` holds, in principal and mean-Earth axes; an error where there is none."""
    if not content["position"]:
        raise InputError(
            f"{content['name']}: there is no fixed position on the Moon; it has a trajectory already"
        )
    found: Mapping[str, Any] = content["position"]
    return found


def horizontal_covariance_of(content: Mapping[str, Any]) -> NDArray[np.float64] | None:
    """Covariance of east and north, m^2, shape (2, 2); None where the position is not determined."""
    covariance = np.array(content["covariance"]["enu_m2"], dtype=np.float64)[:2, :2]
    return covariance if np.isfinite(covariance).all() else None


def solution_table(solutions: Iterable[Located]) -> TextTable:
    """Position, sigmas, fit and other estimated parameters of solutions, one column each."""
    contents = contents_by_target(solutions)
    if not contents:
        raise InputError("there is no solution to make a table of")
    columns = [_column(content) for content in contents]
    names = dict.fromkeys(name for column in columns for name in column)
    rows = [(name, *(column.get(name, "-") for column in columns)) for name in names]
    return TextTable(("", *(content["name"] for content in contents)), rows)


def _column(content: Mapping[str, Any]) -> dict[str, str]:
    """Cells of one solution by the names of their rows."""
    fit = content["fit"]
    cells = {"status": "converged" if content["converged"] else "not converged"}
    if content["position"]:
        cells |= _position(content)
    if "used" in fit:
        cells |= {"observations used": str(fit["used"]), "left out": str(fit["rejected"])}
    if fit.get("wrms_m") is not None:
        cells["wrms, m"] = metres(fit["wrms_m"])
    if fit.get("chi2_per_dof") is not None:
        cells["chi2/dof"] = f"{fit['chi2_per_dof']:.3g}"
    for item in content.get("parameters", ()):
        if not item["fixed"] and item["name"].split(".")[0] != "position":
            sigma = item["total_sigma"]
            value = (
                "undetermined" if sigma is None else f"{to_sigma(item['value'], sigma)} ± {sigma_text(sigma)}"
            )
            cells[f"{item['name']}, {item['unit']}"] = value
    return cells


def _position(content: Mapping[str, Any]) -> dict[str, str]:
    me = content["position"]["me"]
    cells = {
        "axes": me["frame"],
        "longitude, ° E": f"{me['longitude_deg']:.8f}",
        "latitude, ° N": f"{me['latitude_deg']:.8f}",
        "height, m": f"{me['height_m']:.3f}",
    }
    if any(content["sigma"][f"{axis}_m"] != 0.0 for axis in EAST_NORTH_UP):  # the position was not held
        for axis in EAST_NORTH_UP:
            cells[f"1 sigma {axis}, m"] = metres(content["sigma"][f"{axis}_m"])
        if (covariance := horizontal_covariance_of(content)) is not None:
            ellipse = horizontal_ellipse(covariance)
            axes = f"{metres(ellipse.semi_major_m)} × {metres(ellipse.semi_minor_m)}"
            cells |= {"95 % ellipse, m": axes, "its azimuth, °": f"{ellipse.azimuth_deg:.0f}"}
    if (known := content.get("reference")) is not None and "east_m" in known:
        for axis in EAST_NORTH_UP:
            cells[f"{axis} of {known['name']}, m"] = metres(known[f"{axis}_m"])
    return cells
