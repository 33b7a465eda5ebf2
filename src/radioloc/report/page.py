"""A result as one HTML page that needs nothing beside it: card, figures, tables, provenance."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import Any

from radioloc._version import __version__
from radioloc.errors import InputError, visible
from radioloc.extras import optional
from radioloc.report.figure_types import FigureType, figures_of
from radioloc.report.figures import DPI, png_of
from radioloc.results.cards import (
    BUDGET,
    OBSERVABILITY,
    PROVENANCE,
    REJECTED,
    RESIDUALS,
    RESULT,
    SECTIONS,
    Field,
    metres,
    more,
)
from radioloc.results.fit_card import left_out_rows
from radioloc.results.result import Result
from radioloc.results.solution import Solution
from radioloc.results.subsets import ArcStudy
from radioloc.text_files import write_text

PAGE = "report.html"
"""Name of the page in an output folder."""
_FEW_LEFT_OUT, _MOST_LEFT_OUT = 20, 300
_NUMBER = re.compile(r"[-+]?\d[\d.]*(e[-+]?\d+)?|-")
_SHORT, _LONG_WORD = 16, 30

_SECTION_OF = {
    **dict.fromkeys(("data", "fit", "misfit", "types", "links", "stations"), RESIDUALS),
    **dict.fromkeys(("estimated", "passes", "held", "observable"), OBSERVABILITY),
    "budget": BUDGET,
    "left out": REJECTED,
}
"""Where a field of a card goes, by its label; others are the result."""


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


def write_html(result: Result, path: str | Path) -> None:
    """Write a result as one HTML page, which needs no network and no other file.

    Parameters
    ----------
    result : Solution, ArcStudy, MonteCarlo, CovarianceStudy, LeaveOneOut, Comparison, ImageSolution or PointSolution
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
    drawn = {
        stem: png_of(figure, DPI)
        for figure_type in figures_of(result)
        if not figure_type.page_only
        for stem, figure in figure_type.drawn(result)
    }
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
    return "good" if result.is_usable else "failed"


def _sections(result: Result, name: str, figures: Mapping[str, Path | BytesIO]) -> list[_Section]:
    """What the page shows, in order."""
    found = {title: _Section(title) for title in SECTIONS}
    of = RESULT
    sections = _SECTION_OF if isinstance(result, Solution | ArcStudy) else {}
    card = result.card()
    for item in card.fields:
        of = sections.get(item.label, RESULT) if item.label else of
        found[of].fields.append(item)
    for figure_type in figures_of(result):
        try:
            for png in _pngs(figure_type, result, figures):
                image = {"alt": f"{name}: {figure_type.caption}", "photograph": figure_type.photograph}
                found[figure_type.section].images.append(image | _image(png))
        except InputError as error:
            found[figure_type.section].fields.append(Field(figure_type.name, (f"not drawn: {error}",)))
    solution = result.longest if isinstance(result, ArcStudy) else result
    if isinstance(solution, Solution):
        rows, count = left_out_rows(solution, _MOST_LEFT_OUT), solution.fit.total.rejected
        heading = ("UTC", "link", "residual, m", "reason")
        table = Field("largest first", (), heading, rows, more(count, len(rows), "residuals.csv"))
        if count <= _FEW_LEFT_OUT:
            found[REJECTED].fields[:] = [table]
        else:
            found[REJECTED].more.append(("More of them, the largest residuals first", (table,)))
    if isinstance(result, Solution):
        for title, what, table in _tables(result):
            found[title].more.append((what, (table,)))
    if isinstance(result, ArcStudy):
        for arc in result.arcs:
            found[RESULT].more.append((f"The arc of {arc.name}", tuple(arc.solution.card().fields)))
    provenance = getattr(getattr(result, "solution", solution), "provenance", {})
    origin = Field("", (), ("key", "value"), _flat(provenance))
    found[PROVENANCE].more.append(("Files, versions and settings that make this result again", (origin,)))
    return [one for one in found.values() if one.shown]


def _pngs(
    figure_type: FigureType, result: Result, figures: Mapping[str, Path | BytesIO]
) -> Iterator[Path | BytesIO]:
    """Yield the pictures of a figure: those given by their file names, or drawn if the page alone shows them."""
    pattern = re.compile(rf"{figure_type.stem}(_\d+)?")
    given = [png for stem, png in figures.items() if pattern.fullmatch(stem)]
    if given or not figure_type.page_only:
        yield from given
    else:
        yield from (png_of(figure, DPI) for _, figure in figure_type.drawn(result))


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
    yield BUDGET, "Every source", Field("", (), ("1 sigma, m", "of", "east", "north", "up", "3D"), rows)
    pairs = solution.observability.correlations
    rows = [(pair.first, pair.second, f"{pair.coefficient:+.4f}") for pair in pairs]
    yield OBSERVABILITY, "All large correlations", Field("", (), ("parameter", "and", "correlation"), rows)


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
