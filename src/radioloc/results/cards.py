"""Cards: fields of a result, rendered as text for a terminal and as HTML for a notebook and the page.

Formats of numbers and names of links, on cards and in figures, are here too.
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
from pathlib import Path
from typing import Any

from radioloc.errors import visible
from radioloc.estimation.statistics import Residuals
from radioloc.measurements.link import Link

RESULT, POSITION, RESIDUALS, BUDGET = "Result", "Position", "Residuals", "Error budget"
OBSERVABILITY, REJECTED, PROVENANCE = "Parameters and observability", "Left out", "Provenance"
SECTIONS = (RESULT, POSITION, RESIDUALS, BUDGET, OBSERVABILITY, REJECTED, PROVENANCE)
"""Sections of a page, in order."""

WIDTH = 80
_LABEL_WIDTH = 12
_MIN_NAME_CHARACTERS = 12
_NUMBER = re.compile(r"[-+]?\d[\d.]*(e[-+]?\d+)?|-")
_MAX_SHORT_CHARACTERS, _MAX_WORD_CHARACTERS = 16, 30
_STYLE = (
    "dl.radioloc > div {display: grid; grid-template-columns: 8em 1fr} dl.radioloc :is(dt, dd) {margin: 0 0 .3em}"
    " dl.radioloc p {margin: 0} dl.radioloc :is(dt, dd, th, td) {text-align: left}"
    " dl.radioloc .number {text-align: right}"
)
_MIN_SIGMA_AS_DECIMAL = 1e-3  # sigmas below, such as those of clocks, are written with a power of ten


@dataclass(frozen=True, slots=True)
class Field:
    """A label with lines of text, rows of a table under a heading, and lines below it.

    HTML unfolds the rows of `rest`; text counts their names and says `where` they are. `section` is that of a page,
    empty for fields of cards only.
    """

    label: str
    lines: Iterable[str] = ()
    heading: Sequence[str] = ()
    rows: Iterable[Sequence[str]] = ()
    below: Iterable[str] = ()
    rest: Iterable[Sequence[str]] = ()
    where: str = ""
    section: str = RESULT

    def __post_init__(self) -> None:
        for name in ("label", "where"):
            object.__setattr__(self, name, visible(getattr(self, name)))
        for name in ("lines", "heading", "below"):
            object.__setattr__(self, name, tuple(map(visible, getattr(self, name))))
        for name in ("rows", "rest"):
            object.__setattr__(self, name, tuple(tuple(map(visible, row)) for row in getattr(self, name)))

    @property
    def is_empty(self) -> bool:
        """True if there is nothing below the label."""
        return not (self.lines or self.rows or self.below or self.rest)

    def html(self, title: str, verdict: str = "") -> str:
        """Render as an entry of a description list; the title names tables without a label."""
        name = self.label or title
        content = "".join(f"<p>{html.escape(line)}</p>" for line in self.lines)
        content += html_table(self.heading, self.rows, name) if self.rows else ""
        if self.rest:
            content += folded(f"{self._left_out} more", html_table(self.heading, self.rest, name))
        content += "".join(f"<p>{html.escape(line)}</p>" for line in self.below)
        status = f' class="status {verdict}"' if self.label == "status" else ""
        return f"<div{status}><dt>{html.escape(self.label)}</dt><dd>{content}</dd></div>"

    def text(self) -> list[str]:
        """Render as lines of text, without the label."""
        table = text_table(self.heading, self.rows, WIDTH - _LABEL_WIDTH) if self.rows else []
        rest = more(self._left_out, 0, self.where) if self.where else ()
        return [*_wrapped(self.lines), *table, *_wrapped((*rest, *self.below))]

    @property
    def _left_out(self) -> int:
        return len({row[0] for row in self.rest})


def in_section(section: str, *fields: Field) -> tuple[Field, ...]:
    """Assign fields to a section of the page."""
    return tuple(replace(field, section=section) for field in fields)


@dataclass(frozen=True, slots=True)
class Detail:
    """Fields that a section of the page unfolds under a title, such as whole tables; one field is a table alone."""

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
    """Fields in order, but for empty ones, and details for the page; ``str()`` is the card for a terminal."""

    fields: Iterable[Field]
    details: Iterable[Detail] = ()  # made as they are asked for

    def __post_init__(self) -> None:
        object.__setattr__(self, "fields", tuple(field for field in self.fields if not field.is_empty))

    def __str__(self) -> str:
        lines = (
            f"{'' if k else field.label:<{_LABEL_WIDTH}}{line}".rstrip()
            for field in self.fields
            for k, line in enumerate(field.text())
        )
        return "\n".join(lines)

    def html(self) -> str:
        """Render for a notebook."""
        return f"<style>{_STYLE}</style>{html_fields(self.fields)}"


def provenance_detail(provenance: Mapping[str, Any]) -> Detail:
    """Return files, versions and settings as a table; the names of nested keys have dots."""
    origin = Field("", (), ("key", "value"), _flat(provenance))
    return Detail(PROVENANCE, "Files, versions and settings that make this result again", (origin,))


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
    return f'<dl class="radioloc">{"".join(field.html(title, verdict) for field in fields)}</dl>'


def html_table(heading: Sequence[str], rows: Iterable[Sequence[str]], label: str) -> str:
    """Render rows of cells as a table that scrolls; columns have the class ``number``, ``word`` or none."""
    rows = tuple(rows)
    kinds = [_kind(cells) for cells in zip(*rows, strict=True)]
    names = zip(heading, kinds, strict=True)
    head = (f'<th scope="col" class="{kind}">{html.escape(name)}</th>' for name, kind in names)
    body = []
    for first, *others in rows:
        cells = (
            f'<td class="{kind}">{html.escape(cell)}</td>'
            for cell, kind in zip(others, kinds[1:], strict=True)
        )
        body.append(f'<tr><th scope="row" class="{kinds[0]}">{html.escape(first)}</th>{"".join(cells)}</tr>')
    return (
        f'<div class="scroll" role="region" aria-label="{html.escape(label)}" tabindex="0"><table><thead><tr>'
        f"{''.join(head)}</tr></thead><tbody>{''.join(body)}</tbody></table></div>"
    )


def folded(title: str, content: str, is_open: bool = False) -> str:
    """Put HTML into an element that unfolds."""
    return f"<details{' open' if is_open else ''}><summary>{html.escape(title)}</summary>{content}</details>"


def _kind(cells: Sequence[str]) -> str:
    """Class of a column: numbers stand to the right, and neither these nor short texts are broken."""
    numbers = sum(_NUMBER.fullmatch(cell) is not None for cell in cells)
    short = all(
        len(cell) < (_MAX_SHORT_CHARACTERS if " " in cell else _MAX_WORD_CHARACTERS) for cell in cells
    )
    return "number" if 2 * numbers > len(cells) else "word" if short else ""


def text_table(heading: Sequence[str], rows: Iterable[Sequence[str]], width: int) -> list[str]:
    """Align rows of cells as lines of plain text: names to the left and wrapped, numbers to the right and never cut."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="")
    for k, name in enumerate(heading):
        table.add_column(Text(name), justify="right" if k else "left", no_wrap=k > 0, overflow="fold")
    numbers = sum(2 + max(map(len, column)) for column in list(zip(heading, *rows, strict=True))[1:])
    width = max(width, numbers + _MIN_NAME_CHARACTERS)
    for name, *cells in rows:
        shown = name if len(name) <= width - numbers else name.replace(".", ".\n", 1)
        table.add_row(*map(Text, (shown, *cells)))
    console = Console(file=io.StringIO(), width=width, color_system=None, force_jupyter=False)
    with console.capture() as capture:
        console.print(table)
    return capture.get().splitlines()


def table(
    label: str,
    heading: Sequence[str],
    rows: Sequence[Sequence[str]],
    most: int,
    below: Iterable[str] = (),
    where: str = "solution.json",
) -> Field:
    """A field that is a table, of whose rows a card has the first, and says where the others are."""
    return Field(label, (), heading, rows[:most], below, rows[most:], where)


def more(count: int, most: int, where: str = "solution.json") -> tuple[str, ...]:
    """Say how many are not shown."""
    return (f"{count - most} more in {where}",) if count > most else ()


def first_of(lines: Sequence[str], most: int) -> list[str]:
    """The first lines, and how many there are that say the same."""
    rest = len(lines) - most
    return [*lines[:most], *([f"likewise {rest} more"] if rest > 0 else [])]


def plural(count: int, noun: str, ending: str = "s") -> str:
    """A count with its noun."""
    return f"{count} {noun}{'' if count == 1 else ending}"


def metres(value_m: float | None) -> str:
    """Text of a length to three digits, to a tenth of a millimetre at the finest."""
    if value_m is None or not math.isfinite(value_m):
        return "undetermined"
    if value_m == 0.0:
        return "0"
    decimals = min(4, max(0, 2 - math.floor(math.log10(abs(value_m)))))
    return f"{round(value_m, decimals) + 0.0:.{decimals}f}"


def signed_metres(value_m: float) -> str:
    """Text of a length with its sign, digits as in :func:`metres`."""
    return metres(value_m) if value_m < 0.0 else f"+{metres(value_m)}"


def to_sigma(value: float, sigma: float) -> str:
    """Text of a value with the digits that its sigma, given to three of them, asks for; nought far below it."""
    if not (math.isfinite(sigma) and sigma > 0.0 and math.isfinite(value) and value):
        return f"{value + 0.0:.6g}"
    decimals = 2 - math.floor(math.log10(sigma))
    if sigma >= _MIN_SIGMA_AS_DECIMAL:
        return f"{round(value, max(decimals, 0)) + 0.0:.{max(decimals, 0)}f}"
    digits = math.floor(math.log10(abs(value))) + decimals + 1
    return f"{value:#.{min(digits, 15)}g}".replace(".e", "e").rstrip(".") if digits > 0 else "0"


def sigma_text(sigma: float) -> str:
    """Text of a sigma to three digits."""
    if not math.isfinite(sigma):
        return "undetermined"
    return metres(sigma) if sigma >= _MIN_SIGMA_AS_DECIMAL else f"{sigma:.3g}"


def duration(seconds: float) -> str:
    """Text of a time span in minutes, hours or days."""
    if seconds < 0.95 * 3600.0:
        return f"{seconds / 60.0:.1f} min"
    return f"{seconds / 3600.0:.1f} h" if seconds < 72.0 * 3600.0 else f"{seconds / 86400.0:.1f} days"


def have_paths(rows: Residuals) -> bool:
    """Return whether paths are those of observations, not names of stations in their place."""
    return all(">" in path for path in rows.paths.present())


def ways(links: Sequence[Link]) -> list[str]:
    """Words that tell links of one place apart; that all links to several targets are two-way is not said."""
    several = len({link.targets for link in links}) > 1
    out = []
    for link in links:
        if link.differenced:
            way = ""
        elif link.transmitter:
            way = "two-way" if link.transmitter == link.receiver else f"from {link.transmitter}"
        else:
            way = "one-way"
        out.append(f"{way} {'-'.join(link.targets)}".strip() if several else way)
    two_way = several and all(name.startswith("two-way ") for name in out)
    return [name.removeprefix("two-way ") for name in out] if two_way else out


def short_names(links: Sequence[Link]) -> list[str]:
    """Place and way in one; ``two-way`` is understood."""
    return [
        f"{link.place} {way.removeprefix('two-way')}".rstrip()
        for link, way in zip(links, ways(links), strict=True)
    ]


def _wrapped(lines: Iterable[str]) -> list[str]:
    wrapper = textwrap.TextWrapper(WIDTH - _LABEL_WIDTH, subsequent_indent="  ", break_on_hyphens=False)
    return [part for line in lines for part in wrapper.wrap(line) or [""]]
