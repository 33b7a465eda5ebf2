"""Cards: fields of a result, rendered as text for a terminal and as HTML for a notebook and the page.

The formats of numbers, on cards and in figures, are defined in the same module.
"""

from __future__ import annotations

import html
import io
import json
import math
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from radioloc.errors import visible
from radioloc.units import set_fields

RESULT, POSITION, RESIDUALS, BUDGET = "Result", "Position", "Residuals", "Error budget"
OBSERVABILITY, REJECTED, PROVENANCE = "Parameters and observability", "Rejected", "Provenance"
SECTIONS = (RESULT, POSITION, RESIDUALS, BUDGET, OBSERVABILITY, REJECTED, PROVENANCE)
"""Sections of the page, in order."""

WIDTH = 80
_LABEL_WIDTH = 12
_MIN_NAME_CHARACTERS = 12
_NUMBER = re.compile(r"[-+]?\d[\d.]*(e[-+]?\d+)?|-")
_MAX_SHORT_CHARACTERS, _MAX_WORD_CHARACTERS = 16, 30
_MIN_SIGMA_AS_DECIMAL = 1e-3  # sigmas below, such as those of clocks, are written with a power of ten


@dataclass(frozen=True, slots=True)
class Field:
    """Label with lines of text, rows of a table under a heading, and lines below it.

    HTML unfolds the `hidden` rows; text counts their names and gives the `file` that contains them. `section` is that
    of the page, empty for fields of cards only.
    """

    label: str
    lines: Iterable[str] = ()
    heading: Sequence[str] = ()
    rows: Iterable[Sequence[str]] = ()
    remarks: Iterable[str] = ()
    hidden: Iterable[Sequence[str]] = ()
    file: str = ""
    section: str = RESULT

    def __post_init__(self) -> None:
        for name in ("label", "file"):
            set_fields(self, **{name: visible(getattr(self, name))})
        for name in ("lines", "heading", "remarks"):
            set_fields(self, **{name: tuple(map(visible, getattr(self, name)))})
        for name in ("rows", "hidden"):
            set_fields(self, **{name: tuple(tuple(map(visible, row)) for row in getattr(self, name))})

    @property
    def is_empty(self) -> bool:
        """True if the field has a label only."""
        return not (self.lines or self.rows or self.remarks or self.hidden)

    def html(self, title: str, verdict: str = "") -> str:
        """Render as an entry of a description list; the title names tables without a label."""
        name = self.label or title
        content = "".join(f"<p>{html.escape(line)}</p>" for line in self.lines)
        content += html_table(self.heading, self.rows, name) if self.rows else ""
        if self.hidden:
            content += folded(f"{self._hidden_count} more", html_table(self.heading, self.hidden, name))
        content += "".join(f"<p>{html.escape(line)}</p>" for line in self.remarks)
        status = f' class="status {verdict}"' if self.label == "status" else ""
        return f"<div{status}><dt>{html.escape(self.label)}</dt><dd>{content}</dd></div>"

    def text(self) -> list[str]:
        """Render as lines of text, without the label."""
        table = text_table(self.heading, self.rows, WIDTH - _LABEL_WIDTH) if self.rows else []
        count = remaining_line(self._hidden_count, 0, self.file) if self.file else ()
        return [*_wrapped(self.lines), *table, *_wrapped((*count, *self.remarks))]

    @property
    def _hidden_count(self) -> int:
        return len({row[0] for row in self.hidden})


def in_section(section: str, *fields: Field) -> tuple[Field, ...]:
    """Assign fields to a section of the page."""
    return tuple(replace(field, section=section) for field in fields)


@dataclass(frozen=True, slots=True)
class Detail:
    """Fields, such as complete tables, that a section of the page unfolds under a title; a single field is a table."""

    section: str
    title: str
    fields: Sequence[Field]
    is_open: bool = False

    def html(self) -> str:
        """Render as an element that unfolds."""
        if len(self.fields) > 1:
            return folded(self.title, html_fields(self.fields, self.title), self.is_open)
        table = html_table(self.fields[0].heading, self.fields[0].rows, self.title)
        return folded(self.title, table, self.is_open)


@dataclass(frozen=True, slots=True)
class Card:
    """Fields in order, without empty ones, and details for the page; ``str()`` is the card for a terminal."""

    fields: Iterable[Field]
    details: Iterable[Detail] = ()  #: an iterator, as only the page needs them

    def __post_init__(self) -> None:
        set_fields(self, fields=tuple(field for field in self.fields if not field.is_empty))

    def __str__(self) -> str:
        lines = (
            f"{'' if k else field.label:<{_LABEL_WIDTH}}{line}".rstrip()
            for field in self.fields
            for k, line in enumerate(field.text())
        )
        return "\n".join(lines)

    def html(self, verdict: str = "") -> str:
        """Render with the style sheet, for a notebook."""
        fields = html_fields(self.fields, verdict=verdict)
        style = " ".join(style_sheet().split())  # in one line, as notebooks store each line by itself
        return f'<style>{style}</style><div class="radioloc">{fields}</div>'


@cache
def style_sheet() -> str:
    """Return the style sheet of cards, for light and dark surroundings."""
    return files("radioloc.results").joinpath("card.css").read_text(encoding="utf-8")


def provenance_detail(provenance: Mapping[str, Any]) -> Detail:
    """Return files, versions and settings as a table; the names of nested keys have dots."""
    origin = Field("", (), ("key", "value"), _flat(provenance))
    return Detail(PROVENANCE, "Files, versions and settings that reproduce this result", (origin,))


def _flat(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping) and (value or not key):
        for name, item in value.items():
            yield from _flat(item, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list | tuple) and any(isinstance(item, Mapping) for item in value):
        for place, item in enumerate(value):
            yield from _flat(item, f"{key}[{place}]")
    elif isinstance(value, str | Path):
        yield key, str(value)
    else:
        yield key, json.dumps(value, default=str, ensure_ascii=False)


def html_fields(fields: Iterable[Field], title: str = "", verdict: str = "") -> str:
    """Render fields as a description list; the status has the class of the verdict, ``good`` or ``failed``."""
    return f"<dl>{''.join(field.html(title, verdict) for field in fields)}</dl>"


def html_table(heading: Sequence[str], rows: Iterable[Sequence[str]], label: str) -> str:
    """Render rows of cells as a table that scrolls; columns have the class ``number``, ``word`` or none."""
    rows = tuple(rows)
    kinds = [_kind(cells) for cells in zip(*rows, strict=True)]
    names = zip(heading, kinds, strict=True)
    head = (f'<th scope="col" class="{kind}">{html.escape(name)}</th>' for name, kind in names)
    body = []
    for first, *cells in rows:
        columns = zip(cells, kinds[1:], strict=True)
        row = "".join(f'<td class="{kind}">{html.escape(cell)}</td>' for cell, kind in columns)
        body.append(f'<tr><th scope="row" class="{kinds[0]}">{html.escape(first)}</th>{row}</tr>')
    return (
        f'<div class="scroll" role="region" aria-label="{html.escape(label)}" tabindex="0"><table><thead><tr>'
        f"{''.join(head)}</tr></thead><tbody>{''.join(body)}</tbody></table></div>"
    )


def folded(title: str, content: str, is_open: bool = False) -> str:
    """Put HTML into an element that unfolds."""
    return f"<details{' open' if is_open else ''}><summary>{html.escape(title)}</summary>{content}</details>"


def _kind(cells: Sequence[str]) -> str:
    """Class of a column: numbers are aligned to the right, and neither these nor short texts are broken."""
    numbers = sum(_NUMBER.fullmatch(cell) is not None for cell in cells)
    short = all(
        len(cell) < (_MAX_SHORT_CHARACTERS if " " in cell else _MAX_WORD_CHARACTERS) for cell in cells
    )
    return "number" if 2 * numbers > len(cells) else "word" if short else ""


def text_table(heading: Sequence[str], rows: Iterable[Sequence[str]], width: int) -> list[str]:
    """Align rows of cells as plain text: wrapped names to the left, numbers to the right and never cut."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="")
    for k, name in enumerate(heading):
        table.add_column(Text(name), justify="right" if k else "left", no_wrap=k > 0, overflow="fold")
    numbers = sum(2 + max(map(len, column)) for column in list(zip(heading, *rows, strict=True))[1:])
    width = max(width, numbers + _MIN_NAME_CHARACTERS)
    for name, *cells in rows:
        shown = name if len(name) <= width - numbers else re.sub(r"\.(?=[^\d ])", ".\n", name, count=1)
        table.add_row(*map(Text, (shown, *cells)))
    console = Console(file=io.StringIO(), width=width, color_system=None, force_jupyter=False)
    with console.capture() as capture:
        console.print(table)
    return capture.get().splitlines()


def table(
    label: str,
    heading: Sequence[str],
    rows: Sequence[Sequence[str]],
    max_rows: int,
    remarks: Iterable[str] = (),
    file: str = "solution.json",
) -> Field:
    """Return a field with a table, whose rows beyond the first are in a file."""
    return Field(label, (), heading, rows[:max_rows], remarks, rows[max_rows:], file)


def remaining_line(count: int, shown: int, file: str = "solution.json") -> tuple[str, ...]:
    """Return a line with the number of items that are not shown."""
    return (f"{count - shown} more in {file}",) if count > shown else ()


def first_lines(lines: Sequence[str], max_lines: int) -> tuple[str, ...]:
    """Return the first lines, and one with the number of further lines."""
    return (*lines[:max_lines], *remaining_line(len(lines), max_lines))


def plural(count: int, noun: str, ending: str = "s") -> str:
    """Return a count with its noun."""
    return f"{count} {noun}{'' if count == 1 else ending}"


def metres(value_m: float | None) -> str:
    """Return a length with three digits, at most four decimals."""
    if value_m is None or not math.isfinite(value_m):
        return "undetermined"
    if value_m == 0.0:
        return "0"
    decimals = min(4, max(0, 2 - math.floor(math.log10(abs(value_m)))))
    return f"{round(value_m, decimals) + 0.0:.{decimals}f}"


def signed_metres(value_m: float) -> str:
    """Return a length with its sign and the digits of :func:`metres`."""
    return metres(value_m) if value_m < 0.0 else f"+{metres(value_m)}"


def value_text(value: float, sigma: float) -> str:
    """Return a value with the decimals of its sigma to three digits; zero if it is far below the sigma."""
    if not (math.isfinite(sigma) and sigma > 0.0 and math.isfinite(value) and value):
        return f"{value + 0.0:.6g}"
    decimals = 2 - math.floor(math.log10(sigma))
    if sigma >= _MIN_SIGMA_AS_DECIMAL:
        return f"{round(value, max(decimals, 0)) + 0.0:.{max(decimals, 0)}f}"
    digits = math.floor(math.log10(abs(value))) + decimals + 1
    return f"{value:#.{min(digits, 15)}g}".replace(".e", "e").rstrip(".") if digits > 0 else "0"


def sigma_text(sigma: float) -> str:
    """Return a sigma with three digits."""
    if not math.isfinite(sigma):
        return "undetermined"
    return metres(sigma) if sigma >= _MIN_SIGMA_AS_DECIMAL else f"{sigma:.3g}"


def duration(seconds: float) -> str:
    """Return a time span in minutes, hours or days."""
    if seconds < 0.95 * 3600.0:
        return f"{seconds / 60.0:.1f} min"
    return f"{seconds / 3600.0:.1f} h" if seconds < 72.0 * 3600.0 else f"{seconds / 86400.0:.1f} days"


def _wrapped(lines: Iterable[str]) -> list[str]:
    wrapper = textwrap.TextWrapper(WIDTH - _LABEL_WIDTH, subsequent_indent="  ", break_on_hyphens=False)
    return [part for line in lines for part in wrapper.wrap(line) or [""]]
