"""A result as one HTML page that needs nothing beside it: card, figures, tables, provenance."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from radioloc._version import __version__
from radioloc.errors import InputError, visible
from radioloc.extras import optional
from radioloc.report.estimate_figures import has_correlations, plot_budget, plot_correlations
from radioloc.report.figures import DPI, png_of
from radioloc.report.map_figures import plot_images, plot_map
from radioloc.report.position_figures import plot_arcs, plot_comparison, plot_point, plot_position
from radioloc.report.residual_figures import plot_distribution, plot_links, plot_residuals
from radioloc.report.study_figures import (
    plot_covariance,
    plot_covariance_on_arc,
    plot_error_by_length,
    plot_trials,
)
from radioloc.results.cards import Field, metres, more
from radioloc.results.comparison import Comparison
from radioloc.results.covariance import CovarianceStudy
from radioloc.results.fit_card import left_out_rows
from radioloc.results.image_solution import ImageSolution, PointSolution
from radioloc.results.monte_carlo import MonteCarlo
from radioloc.results.solution import Solution
from radioloc.results.solution_card import solution_card
from radioloc.results.subsets import ArcStudy, LeaveOneOut
from radioloc.text_files import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Result = (
    Solution
    | ArcStudy
    | ImageSolution
    | PointSolution
    | Comparison
    | MonteCarlo
    | CovarianceStudy
    | LeaveOneOut
)
"""What has an output folder."""

PAGE = "report.html"
"""Name of the page in an output folder."""
_FEW_LEFT_OUT, _MOST_LEFT_OUT = 20, 300
_NUMBER = re.compile(r"[-+]?\d[\d.]*(e[-+]?\d+)?|-")
_SHORT, _LONG_WORD = 16, 30

_RESULT, _POSITION, _RESIDUALS, _BUDGET = "Result", "Position", "Residuals", "Error budget"
_OBSERVABILITY, _LEFT_OUT, _PROVENANCE = "Parameters and observability", "Left out", "Provenance"
_TITLES = (_RESULT, _POSITION, _RESIDUALS, _BUDGET, _OBSERVABILITY, _LEFT_OUT, _PROVENANCE)
_SECTION_OF = {
    **dict.fromkeys(("data", "fit", "misfit", "types", "links", "stations"), _RESIDUALS),
    **dict.fromkeys(("estimated", "passes", "held", "observable"), _OBSERVABILITY),
    "budget": _BUDGET,
    "left out": _LEFT_OUT,
}
"""Where a field of a card goes, by its label; others are the result."""
_FIGURES = {
    "residuals": (_RESIDUALS, "residuals over time, by link"),
    "figure2": (_RESIDUALS, "residuals of the longest arc over time, by link"),
    "distribution": (_RESIDUALS, "residuals over their sigmas against elevation, and their histogram"),
    "terms": (_RESIDUALS, "what each term of the model adds over time"),
    "arcs": (
        _RESULT,
        "positions of the arcs with ellipses of 95 %, and each coordinate by the length of the arc",
    ),
    "budget": (_BUDGET, "sigmas east, north and up by source of error"),
    "map": (_POSITION, "map with error ellipses of one and three sigma, and where on the Moon it is"),
    "position": (_POSITION, "the estimate beside what it is compared with, with error ellipses"),
    "correlations": (_OBSERVABILITY, "matrix of the correlations of estimated parameters"),
    "images": (_RESULT, "the images laid over the map, from all that the highest shows down to the lander"),
    "comparison": (_RESULT, "positions east and north of the benchmark, with ellipses of 95 %"),
    "trials": (_RESULT, "horizontal errors of the trials, with claimed and found ellipses of 95 %"),
    "error_by_length": (_RESULT, "errors and claimed sigmas by length of the arc"),
    "covariance": (_RESULT, "sigmas by length of the arc, and what they are made of"),
    "covariance_on_arc": (
        _RESULT,
        "sigmas of the orbit over the plan, radial, along and across, by length of the arc",
    ),
}
"""Which section shows a figure, and what it shows, for those who do not see it."""


@dataclass(frozen=True, slots=True)
class _Section:
    title: str
    fields: list[Field] = field(default_factory=list)
    images: list[dict[str, Any]] = field(default_factory=list)
    more: list[tuple[str, Sequence[Field]]] = field(default_factory=list)

    @property
    def shown(self) -> bool:
        """Whether there is anything in it."""
        tables = [*self.fields, *(item for _, items in self.more for item in items)]
        return bool(self.images) or any(item.lines or item.rows for item in tables)

    @property
    def anchor(self) -> str:
        """What links within the page call it."""
        return self.title.lower().replace(" ", "-")


def figures_of(result: Result) -> dict[str, Callable[[], Figure] | None]:
    """What draws each figure of a result, by name; None for those that such a result can have, and this one has not."""
    match result:
        case Solution():
            return _of_a_solution(result)
        case ArcStudy():
            of_arcs: dict[str, Callable[[], Figure] | None] = {"figure2": partial(plot_links, result.longest)}
            for k, one in enumerate(result.by_target, start=1):
                of_arcs["arcs" if k == 1 else f"arcs_{k}"] = partial(plot_arcs, one)
            return of_arcs
        case ImageSolution():
            return {"images": partial(plot_images, result), "position": None}
        case PointSolution():
            return {"images": None, "position": partial(plot_point, result)}
        case Comparison():
            return {"comparison": partial(plot_comparison, result)}
        case MonteCarlo():
            some = bool((result["converged"] == 1.0).any())
            drawn = {"trials": plot_trials, "error_by_length": plot_error_by_length}
            return {name: partial(draw, result) if some else None for name, draw in drawn.items()}
        case CovarianceStudy():
            on_arc = result.longest.state is not None
            return {
                "covariance": partial(plot_covariance, result) if result.determined else None,
                "covariance_on_arc": partial(plot_covariance_on_arc, result) if on_arc else None,
            }
        case LeaveOneOut():
            return {}


def _of_a_solution(solution: Solution) -> dict[str, Callable[[], Figure] | None]:
    rows = solution.residuals
    # Ranges and Doppler of a station have no common scale, and a delay belongs to two stations.
    apart = len(rows.types.present()) > 1 or any("<" in path for path in rows.paths.present())
    located = solution.position_estimated and solution.position_determined
    over_elevation = rows.elevation_deg is not None and rows.used.any()
    return {
        "residuals": partial(plot_links if apart else plot_residuals, solution),
        "position": partial(plot_position, solution) if located else None,
        "correlations": partial(plot_correlations, solution) if has_correlations(solution) else None,
        "distribution": partial(plot_distribution, solution) if over_elevation else None,
        "budget": partial(plot_budget, solution) if solution.budget else None,
        "terms": None,  # only where they were asked for
    }


def write_html(result: Result, path: str | Path) -> None:
    """Write a result as one HTML page, which needs no network and no other file.

    Parameters
    ----------
    result : Solution, ArcStudy, ImageSolution, PointSolution, Comparison, MonteCarlo, CovarianceStudy or LeaveOneOut
        What to show: its card, figures, and of a solution the error budget, what was left out
        and why, and the provenance.
    path : path-like
        The file, ``.html``.

    Raises
    ------
    InputError
        The extra ``report`` is not installed, or the file cannot be written.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> radioloc.report.write_html(solution, "apollo15.html")
    """
    require_page()
    drawn = {name: png_of(draw(), DPI) for name, draw in figures_of(result).items() if draw is not None}
    write_page(result, drawn, path)


def require_page() -> ModuleType:
    """Return jinja2, which makes the page of a template."""
    return optional("jinja2", "an HTML report needs jinja2:", "report")


def write_page(result: Result, figures: Mapping[str, Path | BytesIO], path: str | Path) -> None:
    """As :func:`write_html`, with the result's figures as PNG."""
    jinja2 = require_page()
    title = visible(str(getattr(result, "name", "Comparison")))
    sections = _sections(result, title, figures)
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("radioloc.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["kinds"] = _kinds
    text = environment.get_template("report.html").render(
        title=title,
        verdict=_verdict(result),
        sections=sections,
        version=__version__,
    )
    write_text(path, text)


def _kinds(rows: Sequence[Sequence[str]]) -> list[str]:
    """Of each column: numbers stand to the right, and neither these nor what is short is broken."""
    kinds = []
    for cells in zip(*rows, strict=True):
        numbers = sum(_NUMBER.fullmatch(cell) is not None for cell in cells)
        short = all(len(cell) < (_SHORT if " " in cell else _LONG_WORD) for cell in cells)
        kinds.append("number" if 2 * numbers > len(cells) else "word" if short else "")
    return kinds


def _verdict(result: Result) -> str:
    """Whether the result can be used as it is; of a solution without a fit there is nothing to say."""
    if isinstance(result, Solution) and not result.parameters.free.any():
        return ""
    return "good" if is_usable(result) else "failed"


def is_usable(result: Result) -> bool:
    """Whether a result converged, is determined and consistent, as far as it says so."""
    return all(getattr(result, name, True) for name in ("converged", "consistent", "determined"))


def _sections(result: Result, name: str, figures: Mapping[str, Path | BytesIO]) -> list[_Section]:
    """What the page shows, in order."""
    found = {title: _Section(title) for title in _TITLES}
    of = _RESULT
    sections = _SECTION_OF if isinstance(result, Solution | ArcStudy) else {}
    card = solution_card(result) if isinstance(result, Solution) else result.card()
    for item in card.fields:
        of = sections.get(item.label, _RESULT) if item.label else of
        found[of].fields.append(item)
    drawn = dict(figures)
    try:
        drawn |= {} if "map" in drawn else _map(result)
    except InputError as error:
        found[_POSITION].fields.append(Field("map", (f"not drawn: {error}",)))
    solution = result.longest if isinstance(result, ArcStudy) else result
    for key, figure in drawn.items():
        title, alt = _FIGURES.get(key, (_RESULT, key.replace("_", " ")))
        found[title].images.append({"alt": f"{name}: {alt}", "photograph": key == "images", **_image(figure)})
    if isinstance(solution, Solution):
        rows, count = left_out_rows(solution, _MOST_LEFT_OUT), solution.fit.total.rejected
        heading = ("UTC", "link", "residual, m", "reason")
        table = Field("largest first", (), heading, rows, more(count, len(rows), "residuals.csv"))
        if count <= _FEW_LEFT_OUT:
            found[_LEFT_OUT].fields[:] = [table]
        else:
            found[_LEFT_OUT].more.append(("More of them, the largest residuals first", (table,)))
    if isinstance(result, Solution):
        for title, what, table in _tables(result):
            found[title].more.append((what, (table,)))
    if isinstance(result, ArcStudy):
        for arc in result.arcs:
            found[_RESULT].more.append((f"The arc of {arc.name}", tuple(solution_card(arc.solution).fields)))
    provenance = getattr(getattr(result, "solution", solution), "provenance", {})
    origin = Field("", (), ("key", "value"), _flat(provenance))
    found[_PROVENANCE].more.append(("Files, versions and settings that make this result again", (origin,)))
    return [one for one in found.values() if one.shown]


def _map(result: Result) -> dict[str, BytesIO]:
    """The position, or those of all arcs, on a map."""
    located: dict[str, Solution | ImageSolution | PointSolution] = {}
    if isinstance(result, ArcStudy):
        several = len(result.by_target) > 1
        located = {
            f"{arc.solution.name}, {arc.name}" if several else arc.name: arc.solution
            for one in result.by_target
            for arc in one.arcs
        }
    elif isinstance(result, Solution):
        located = {result.targets[0].name if result.targets else result.name: result}
    elif isinstance(result, ImageSolution | PointSolution):
        located = {result.name: result}
    where = [one.to_dict() | {"name": name} for name, one in located.items() if _on_map(one)]
    return {"map": png_of(plot_map(where), DPI)} if where else {}


def _on_map(one: Solution | ImageSolution | PointSolution) -> bool:
    if not isinstance(one, Solution):
        return True
    return one.trajectory is None and one.position_estimated and one.position_determined


def _image(png: Path | BytesIO) -> dict[str, Any]:
    """A figure within the page; its size is that on a screen of 96 dots per inch."""
    from PIL import Image  # which matplotlib needs

    flat, rich = BytesIO(), BytesIO()
    with Image.open(png) as image:
        width, height = (round(96 * side / DPI) for side in image.size)
        plain = image.convert("RGB")
    # What is smaller: of lines and letters it is the first, of clouds of dots and of photographs the second. Among the
    # ways to choose 256 colours, this one keeps those of maps of colours too, within 2 %.
    few = plain.quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few.save(flat, "webp", lossless=True)
    plain.save(rich, "webp", quality=80)
    data = min(flat.getvalue(), rich.getvalue(), key=len)
    uri = f"data:image/webp;base64,{base64.b64encode(data).decode()}"
    return {"uri": uri, "width": width, "height": height}


def _tables(solution: Solution) -> Iterator[tuple[str, str, Field]]:
    """Whole tables of which the card has the beginning: the section of each, what it is, and its rows."""
    rows = [
        (item.source, item.name or "-", *map(metres, (item.east_m, item.north_m, item.up_m, item.total_m)))
        for item in solution.budget
    ]
    yield _BUDGET, "Every source", Field("", (), ("1 sigma, m", "of", "east", "north", "up", "3D"), rows)
    pairs = solution.observability.correlations
    rows = [(pair.first, pair.second, f"{pair.coefficient:+.4f}") for pair in pairs]
    yield _OBSERVABILITY, "All large correlations", Field("", (), ("parameter", "and", "correlation"), rows)


def _flat(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Keys and values of nested mappings, names with a dot for what is nested, as the documentation writes them."""
    nested = isinstance(value, list | tuple) and any(isinstance(item, Mapping) for item in value)
    if isinstance(value, Mapping) and (value or not key):
        for name, item in value.items():
            yield from _flat(item, f"{key}.{name}" if key else str(name))
    elif nested:
        for place, item in enumerate(value):
            yield from _flat(item, f"{key}[{place}]")
    elif isinstance(value, str | Path):
        yield key, str(value)
    else:
        yield key, json.dumps(value, default=str, ensure_ascii=False)
