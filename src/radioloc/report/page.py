"""A result as one HTML page that needs nothing beside it: card, figures, residuals to zoom into, tables, provenance."""

from __future__ import annotations

import base64
import gzip
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from radioloc._version import __version__
from radioloc.errors import InputError
from radioloc.estimation.solution import Solution
from radioloc.extras import optional
from radioloc.report.arc_study import ArcStudy
from radioloc.report.cards import Field, metres, more
from radioloc.report.image_solution import ImageSolution
from radioloc.report.map_figure import plot_map
from radioloc.report.point_solution import PointSolution
from radioloc.report.residual_charts import Chart, residual_charts
from radioloc.report.result_figures import Result, figures_of
from radioloc.report.solution_card import MAX_PARAMETERS, left_out_rows, parameter_field, solution_card
from radioloc.text_files import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE = "report.html"
"""Name of the page in an output folder."""
_DPI = 200  # of images, as of the files
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
    "contours": (_OBSERVABILITY, "error ellipses of parameters two by two, and their profiles of chi-square"),
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
_PHOTOGRAPHS = ("images",)


@dataclass(frozen=True, slots=True)
class _Image:
    """A figure within the page; its size is that on a screen of 96 dots per inch."""

    uri: str
    alt: str
    width: int
    height: int
    photograph: bool
    replaced: bool  # by charts, where there can be any


@dataclass(frozen=True, slots=True)
class _Section:
    title: str
    fields: list[Field] = field(default_factory=list)
    images: list[_Image] = field(default_factory=list)
    charts: list[Chart] = field(default_factory=list)
    more: list[tuple[str, Sequence[Field]]] = field(default_factory=list)

    @property
    def shown(self) -> bool:
        """Whether there is anything in it."""
        tables = [*self.fields, *(item for _, items in self.more for item in items)]
        return bool(self.images or self.charts) or any(item.lines or item.rows for item in tables)

    @property
    def anchor(self) -> str:
        """What links within the page call it."""
        return self.title.lower().replace(" ", "-")


def write_html(result: Result, path: str | Path) -> None:
    """Write a result as one HTML page, which needs no network and no other file.

    Parameters
    ----------
    result : Solution, ArcStudy, ImageSolution, PointSolution, Comparison, MonteCarlo, CovarianceStudy or LeaveOneOut
        What to show: its card, figures, and of a solution residuals to zoom into, the error budget, what was left out
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
    drawn = {name: _png(draw()) for name, draw in figures_of(result).items() if draw is not None}
    write_page(result, drawn, path)


def require_page() -> tuple[ModuleType, ModuleType]:
    """jinja2 and plotly, of which the latter's script goes into the page."""
    need = "an HTML report needs jinja2 and plotly:"
    return optional("jinja2", need, "report"), optional("plotly.offline", need, "report")


def write_page(result: Result, figures: Mapping[str, Path | BytesIO], path: str | Path) -> None:
    """As :func:`write_html`, with the result's figures as PNG."""
    jinja2, plotly = require_page()
    sections = _sections(result, figures)
    charts = [chart for section in sections for chart in section.charts]
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("radioloc.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["kinds"] = _kinds
    text = environment.get_template("report.html").render(
        title=_title(result),
        verdict=_verdict(result),
        sections=sections,
        library=_packed(plotly.get_plotlyjs()) if charts else "",
        charts=_packed(json.dumps([chart.content for chart in charts], allow_nan=False)) if charts else "",
        version=__version__,
    )
    write_text(path, text)


def _packed(text: str) -> str:
    """A third of a script's size, which the page unpacks by itself."""
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()


def _kinds(rows: Sequence[Sequence[str]]) -> list[str]:
    """Of each column: numbers stand to the right, and neither these nor what is short is broken."""
    return [
        "number" if _mostly_numbers(cells) else "word" if _short(cells) else ""
        for cells in zip(*rows, strict=True)
    ]


def _mostly_numbers(cells: Sequence[str]) -> bool:
    return 2 * sum(_NUMBER.fullmatch(cell) is not None for cell in cells) > len(cells)


def _short(cells: Sequence[str]) -> bool:
    return all(len(cell) < (_SHORT if " " in cell else _LONG_WORD) for cell in cells)


def _title(result: Result) -> str:
    return str(getattr(result, "name", "Comparison"))


def _verdict(result: Result) -> str:
    """Whether the result can be used as it is; of a solution without a fit there is nothing to say."""
    if isinstance(result, Solution) and not result.parameters.free.any():
        return ""
    good = all(getattr(result, name, True) for name in ("converged", "consistent", "determined"))
    return "good" if good else "failed"


def _sections(result: Result, figures: Mapping[str, Path | BytesIO]) -> list[_Section]:
    """What the page shows, in order."""
    found = {title: _Section(title) for title in _TITLES}
    of = _RESULT
    sections = _SECTION_OF if isinstance(result, Solution | ArcStudy) else {}
    card = solution_card(result, parameters=MAX_PARAMETERS) if isinstance(result, Solution) else result.card()
    for item in card.fields:
        of = sections.get(item.label, _RESULT) if item.label else of
        found[of].fields.append(item)
    drawn = dict(figures)
    try:
        drawn |= {} if "map" in drawn else _map(result)
    except InputError as error:
        found[_POSITION].fields.append(Field("map", (f"not drawn: {error}",)))
    solution = result.longest if isinstance(result, ArcStudy) else result
    if isinstance(solution, Solution) and len(solution.residuals):
        found[_RESIDUALS].charts.extend(residual_charts(solution))
    for name, figure in drawn.items():
        title, alt = _FIGURES.get(name, (_RESULT, name.replace("_", " ")))
        replaced = name in ("residuals", "figure2") and bool(found[title].charts)
        found[title].images.append(_image(figure, f"{_title(result)}: {alt}", name in _PHOTOGRAPHS, replaced))
    if isinstance(solution, Solution):
        table = _left_out(solution)
        if solution.fit.total.rejected <= _FEW_LEFT_OUT:
            found[_LEFT_OUT].fields[:] = [table]
        else:
            found[_LEFT_OUT].more.append(("More of them, the largest residuals first", (table,)))
    if isinstance(result, Solution):
        for title, name, table in _tables(result):
            found[title].more.append((name, (table,)))
    if isinstance(result, ArcStudy):
        for arc in result.arcs:
            whole = solution_card(arc.solution, parameters=len(arc.solution.parameters))
            found[_RESULT].more.append((f"The arc of {arc.name}", tuple(whole.fields)))
    provenance = getattr(getattr(result, "solution", solution), "provenance", {})
    origin = Field("", (), ("key", "value"), _flat(provenance))
    found[_PROVENANCE].more.append(("Files, versions and settings that make this result again", (origin,)))
    return [one for one in found.values() if one.shown]


def _map(result: Result) -> dict[str, BytesIO]:
    """The position, or those of all arcs, on a map."""
    if isinstance(result, ArcStudy):
        where = [arc.solution.to_dict() | {"name": arc.name} for arc in result.arcs if _located(arc.solution)]
        return {"map": _png(plot_map(where))} if where else {}
    if isinstance(result, Solution) and _located(result):
        name = result.targets[0].name if result.targets else result.name
        return {"map": _png(plot_map(result.to_dict() | {"name": name}))}
    if isinstance(result, ImageSolution | PointSolution):
        return {"map": _png(plot_map(result.to_dict()))}
    return {}


def _located(solution: Solution) -> bool:
    return solution.trajectory is None and solution.position_estimated and solution.position_determined


def _png(figure: Figure) -> BytesIO:
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=_DPI)
    stream.seek(0)
    return stream


def _image(png: Path | BytesIO, alt: str, photograph: bool, replaced: bool) -> _Image:
    from PIL import Image  # which matplotlib needs

    flat, rich = BytesIO(), BytesIO()
    with Image.open(png) as image:
        width, height = (round(96 * side / _DPI) for side in image.size)
        plain = image.convert("RGB")
    # What is smaller: of lines and letters it is the first, of clouds of dots and of photographs the second. Among the
    # ways to choose 256 colours, this one keeps those of maps of colours too, within 2 %.
    few = plain.quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few.save(flat, "webp", lossless=True)
    plain.save(rich, "webp", quality=80)
    data = min(flat.getvalue(), rich.getvalue(), key=len)
    uri = f"data:image/webp;base64,{base64.b64encode(data).decode()}"
    return _Image(uri, alt, width, height, photograph, replaced)


def _tables(solution: Solution) -> Iterator[tuple[str, str, Field]]:
    """Whole tables of which the card has the beginning: the section of each, what it is, and its rows."""
    rows = [
        (item.source, item.name or "-", *map(metres, (item.east_m, item.north_m, item.up_m, item.total_m)))
        for item in solution.budget
    ]
    yield _BUDGET, "Every source", Field("", (), ("1 sigma, m", "of", "east", "north", "up", "3D"), rows)
    yield _OBSERVABILITY, "All parameters", parameter_field(solution, len(solution.parameters))
    pairs = solution.observability.correlations
    rows = [(pair.first, pair.second, f"{pair.coefficient:+.4f}") for pair in pairs]
    yield _OBSERVABILITY, "All large correlations", Field("", (), ("parameter", "and", "correlation"), rows)


def _left_out(solution: Solution) -> Field:
    """More of what was left out than the card has."""
    rows = left_out_rows(solution, _MOST_LEFT_OUT)
    heading = ("UTC", "link", "residual, m", "reason")
    return Field(
        "largest first", (), heading, rows, more(solution.fit.total.rejected, len(rows), "residuals.csv")
    )


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
