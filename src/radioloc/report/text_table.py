"""Tables to print: cells of text, as Markdown or LaTeX."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from radioloc.errors import InputError
from radioloc.text_files import write_text

TABLE_ENDINGS = (".md", ".tex")
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


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table whose cells are text: the first columns of words, to the left, the others of numbers, to the right."""

    heading: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1  # columns

    def to_markdown(self) -> str:
        """The table in Markdown, as GitHub and Pandoc read it."""
        rules = ["---" if k < self.words else "---:" for k in range(len(self.heading))]
        lines = (" | ".join(_markdown(cell) for cell in cells) for cells in (self.heading, rules, *self.rows))
        return "".join(f"| {line} |\n" for line in lines)

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
        return "".join(f"{line}\n" for line in lines)


def _markdown(text: str) -> str:
    return text.replace("|", r"\|")


def _latex(text: str) -> str:
    """Text with LaTeX's own signs escaped, and numbers with minus signs and powers of ten."""
    escaped = _MINUS.sub("$-$", "".join(_LATEX.get(sign, sign) for sign in text))
    return _POWER.sub(lambda found: rf"$\times 10^{{{int(found[1])}}}$", escaped)


def write_table_file(table: TextTable, path: str | Path) -> Path:
    """Write a table by the ending of the name, ``.md`` or ``.tex``; another is an :class:`InputError`."""
    file = Path(path)
    if file.suffix not in TABLE_ENDINGS:
        raise InputError(f"{file}: tables are written as {' or '.join(TABLE_ENDINGS)}")
    write_text(file, table.to_markdown() if file.suffix == ".md" else table.to_latex())
    return file
