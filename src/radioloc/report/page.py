"""A result as one HTML page that needs nothing beside it: card, figures, tables, provenance."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

from radioloc._version import __version__
from radioloc.errors import InputError, visible
from radioloc.lazy import optional
from radioloc.report.figure_types import FigureType, available_figures
from radioloc.report.figures import DPI, to_png
from radioloc.results.cards import SECTIONS, Detail, Field, html_fields, style_sheet
from radioloc.results.result import Result
from radioloc.text_files import write_text

PAGE = "report.html"
"""Name of the page in an output folder."""


@dataclass(frozen=True, slots=True)
class _Section:
    title: str
    fields: list[Field] = field(default_factory=list)
    images: list[dict[str, Any]] = field(default_factory=list)
    details: list[Detail] = field(default_factory=list)

    @property
    def anchor(self) -> str:
        """Target of links within the page."""
        return self.title.lower().replace(" ", "-")


def write_html(
    path: str | Path, result: Result, *, figures: Mapping[str, Path | BytesIO] = MappingProxyType({})
) -> None:
    """Write a result as one HTML page, which needs no network and no other file.

    Parameters
    ----------
    path : path-like
        File to write, ``.html``.
    result : Solution, ArcStudy, MonteCarlo, CovarianceStudy, LeaveOneOut, Comparison or another registered type
        Result to show: its card and figures, and for a solution the error budget, the rejected observations and the
        provenance.
    figures : mapping of str to path-like or BytesIO, optional
        PNG files of figures that are drawn already, by their names without ending.

    Raises
    ------
    InputError
        The extra ``report`` is not installed, or the file cannot be written.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> radioloc.report.write_html("apollo15.html", solution)
    """
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
    text = environment.get_template("report.html").render(
        title=title,
        verdict=result.verdict,
        fields=html_fields,
        card_style=style_sheet(),
        sections=sections,
        version=__version__,
    )
    write_text(path, text)


def require_page() -> ModuleType:
    """Return jinja2, which renders the template of the page."""
    return optional("jinja2", "an HTML report needs jinja2:", "report")


def _sections(result: Result, name: str, figures: Mapping[str, Path | BytesIO]) -> list[_Section]:
    sections = {title: _Section(title) for title in SECTIONS}
    card = result.card()
    for item in card.fields:
        if item.section:
            sections[item.section].fields.append(item)
    for figure_type in available_figures(result):
        section = sections[figure_type.section]
        try:
            for png in _pngs(figure_type, result, figures):
                image = {"alt": f"{name}: {figure_type.caption}", "photograph": figure_type.photograph}
                section.images.append(image | _image(png))
        except InputError as error:
            section.fields.append(Field(figure_type.name, (f"not drawn: {error}",)))
    for detail in card.details:
        if not all(item.is_empty for item in detail.fields):
            sections[detail.section].details.append(detail)
    return [section for section in sections.values() if section.images or section.fields or section.details]


def _pngs(
    figure_type: FigureType, result: Result, figures: Mapping[str, Path | BytesIO]
) -> Iterator[Path | BytesIO]:
    """Yield the images of a figure: existing files, or else drawn ones."""
    pattern = re.compile(rf"{figure_type.stem}(_\d+)?")
    files = [png for stem, png in figures.items() if pattern.fullmatch(stem)]
    yield from files or (to_png(figure, DPI) for _, figure in figure_type.drawn(result))


def _image(png: Path | BytesIO) -> dict[str, Any]:
    """Return the data URI of an image, and its size on a screen of 96 dots per inch."""
    from PIL import Image  # which matplotlib needs

    flat, rich = BytesIO(), BytesIO()
    with Image.open(png) as image:
        width, height = (round(96 * side / DPI) for side in image.size)
        plain = image.convert("RGB")
    # The smaller file is used: the first of lines and letters, the second of photographs. This choice of 256 colours
    # keeps those of colour maps within 2 %.
    palette = plain.quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    palette.save(flat, "webp", lossless=True)
    plain.save(rich, "webp", quality=80)
    data = min(flat.getvalue(), rich.getvalue(), key=len)
    uri = f"data:image/webp;base64,{base64.b64encode(data).decode()}"
    return {"uri": uri, "width": width, "height": height}
