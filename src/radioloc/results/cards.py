"""Cards: what a result says, as one list of fields with two renderers, text for a terminal and HTML for a notebook.

What numbers and links are called on them, and in figures, is here too.
"""

from __future__ import annotations

import html
import io
import math
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from radioloc.errors import visible
from radioloc.estimation.statistics import Residuals
from radioloc.measurements.link import Link

RESULT, POSITION, RESIDUALS, BUDGET = "Result", "Position", "Residuals", "Error budget"
OBSERVABILITY, REJECTED, PROVENANCE = "Parameters and observability", "Left out", "Provenance"
SECTIONS = (RESULT, POSITION, RESIDUALS, BUDGET, OBSERVABILITY, REJECTED, PROVENANCE)
"""Sections of a page, in order."""

WIDTH = 80
_LABEL_WIDTH = 12
_SHORTEST_NAME = 12
_FINE = 1e-3  # sigmas below, such as those of clocks, are written with a power of ten


@dataclass(frozen=True, slots=True)
class Field:
    """A label and what it says: lines of text, rows of a table under a heading, lines below it.

    The `rest` are rows that a page unfolds; a card says how many names they have, and `where` they are.
    """

    label: str
    lines: Iterable[str] = ()
    heading: Sequence[str] = ()
    rows: Iterable[Sequence[str]] = ()
    below: Iterable[str] = ()
    rest: Iterable[Sequence[str]] = ()
    where: str = ""

    def __post_init__(self) -> None:
        for name in ("label", "where"):
            object.__setattr__(self, name, visible(getattr(self, name)))
        for name in ("lines", "heading", "below"):
            object.__setattr__(self, name, tuple(map(visible, getattr(self, name))))
        for name in ("rows", "rest"):
            object.__setattr__(self, name, tuple(tuple(map(visible, row)) for row in getattr(self, name)))

    @property
    def left_out(self) -> int:
        """How many names the rest have."""
        return len({row[0] for row in self.rest})

    @property
    def after(self) -> tuple[str, ...]:
        """Lines below the table of a card, which does not have the rest."""
        return (*(more(self.left_out, 0, self.where) if self.where else ()), *self.below)


@dataclass(frozen=True, slots=True)
class Card:
    """Fields in order, but for empty ones; ``str()`` is the card for a terminal."""

    fields: Iterable[Field]

    def __post_init__(self) -> None:
        kept = (field for field in self.fields if field.lines or field.rows or field.below or field.rest)
        object.__setattr__(self, "fields", tuple(kept))

    def __str__(self) -> str:
        out = []
        for field in self.fields:
            table = text_table(field.heading, field.rows, WIDTH - _LABEL_WIDTH) if field.rows else []
            for k, line in enumerate([*_wrapped(field.lines), *table, *_wrapped(field.after)]):
                out.append(f"{'' if k else field.label:<{_LABEL_WIDTH}}{line}".rstrip())
        return "\n".join(out)

    def html(self) -> str:
        """The same fields as an HTML table."""
        left = 'style="text-align:left"'
        rows = []
        for field in self.fields:
            content = "<br>".join(html.escape(line) for line in field.lines)
            if field.rows:
                head = "".join(f"<th>{html.escape(cell)}</th>" for cell in field.heading)
                cells = ["".join(f"<td>{html.escape(cell)}</td>" for cell in row) for row in field.rows]
                body = "".join(f"<tr>{row}</tr>" for row in cells)
                content += f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
            content += "<br>".join(html.escape(line) for line in field.after)
            rows.append(f"<tr><th {left}>{html.escape(field.label)}</th><td {left}>{content}</td></tr>")
        return f"<table>{''.join(rows)}</table>"


def text_table(heading: Sequence[str], rows: Iterable[Sequence[str]], width: int) -> list[str]:
    """Rows of cells as aligned lines of plain text: names to the left, numbers to the right.

    Names are wrapped where they are too long, between words or after the kind of a parameter, not within; numbers
    never are: where they leave no room, the table is wider.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="")
    for k, name in enumerate(heading):
        table.add_column(Text(name), justify="right" if k else "left", no_wrap=k > 0, overflow="fold")
    numbers = sum(2 + max(map(len, column)) for column in list(zip(heading, *rows, strict=True))[1:])
    width = max(width, numbers + _SHORTEST_NAME)
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
    """As :func:`metres`, with a sign."""
    return metres(value_m) if value_m < 0.0 else f"+{metres(value_m)}"


def to_sigma(value: float, sigma: float) -> str:
    """Text of a value with the digits that its sigma, given to three of them, asks for; nought far below it."""
    if not (math.isfinite(sigma) and sigma > 0.0 and math.isfinite(value) and value):
        return f"{value + 0.0:.6g}"
    decimals = 2 - math.floor(math.log10(sigma))
    if sigma >= _FINE:
        return f"{round(value, max(decimals, 0)) + 0.0:.{max(decimals, 0)}f}"
    digits = math.floor(math.log10(abs(value))) + decimals + 1
    return f"{value:#.{min(digits, 15)}g}".replace(".e", "e").rstrip(".") if digits > 0 else "0"


def sigma_text(sigma: float) -> str:
    """Text of a sigma to three digits."""
    if not math.isfinite(sigma):
        return "undetermined"
    return metres(sigma) if sigma >= _FINE else f"{sigma:.3g}"


def duration(seconds: float) -> str:
    """Text of a time span in minutes, hours or days."""
    if seconds < 0.95 * 3600.0:
        return f"{seconds / 60.0:.1f} min"
    return f"{seconds / 3600.0:.1f} h" if seconds < 72.0 * 3600.0 else f"{seconds / 86400.0:.1f} days"


def have_paths(rows: Residuals) -> bool:
    """Whether paths are those of observations, not names of stations in their place."""
    return all(">" in path for path in rows.paths.present())


def ways(links: Sequence[Link]) -> list[str]:
    """What tells links of one place apart: one- or two-way or from where, and of several targets which.

    That all links to several targets are two-way is not said.
    """
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
