"""Scores of entries in benchmark cases: errors, claimed sigmas, and the places of entries whose claims hold."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from radioloc.results.cards import Card, Field, metres
from radioloc.results.result import Content, Result
from radioloc.results.tables import TextTable

_HEADING = ("entry", "error, m", "claim, m", "sigmas", "in 95 %", "place")


@dataclass(frozen=True, slots=True)
class Score:
    """Score of an entry in a case."""

    case: str  #: name of the case; program of the entry and its version
    program: str  #: likewise
    version: str  #: likewise
    results: int  #: number of results that have a truth
    error_m: float  #: distance from the truth, root mean square over the results, m
    claim_m: float | None  #: claimed sigma of this distance, root mean square; None if a result states none
    #: Root mean square error of a component, in sigmas of claim and truth together; 1 is expected.
    sigmas: float | None
    covered: int | None  #: number of results whose 95 % region contains the truth
    holds: bool  #: true if the errors are not larger than the claim allows
    source: str  #: origin of the entry: ``"run"`` or the name of its file
    place: int | None = None  #: place among the entries of the case whose claims hold

    @property
    def size_m(self) -> float:
        """Greater of error and claim, by which places are given."""
        return math.inf if self.claim_m is None else max(self.error_m, self.claim_m)

    def cells(self) -> tuple[str, ...]:
        """Return the cells of the row of a table."""
        verdict = "no claim" if self.claim_m is None else "claim fails"
        return (
            f"{self.program} {self.version}".rstrip(),
            metres(self.error_m),
            metres(self.claim_m),
            "-" if self.sigmas is None else f"{self.sigmas:.2f}",
            "-" if self.covered is None else f"{self.covered}/{self.results}",
            str(self.place) if self.holds else verdict,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Scores(Result):
    """Scores of all entries in one or several cases."""

    titles: Mapping[str, str]  #: titles of the cases by name, in the order of the table
    rows: tuple[Score, ...]  #: scores, those of a case in the order of their places
    missing: Mapping[str, str]  #: reasons why studies of cases were not run, by case

    @property
    def consistent(self) -> bool:
        """True unless a single entry was scored and its claim does not hold."""
        return len(self.rows) != 1 or self.rows[0].holds

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers, in types that JSON has."""
        return {"scores": [asdict(row) for row in self.rows], "missing": dict(self.missing)}

    def table(self) -> TextTable:
        """Return the table of all cases."""
        return TextTable(
            ("case", *_HEADING, "source"), [(row.case, *row.cells(), row.source) for row in self.rows], 2
        )

    def files(self) -> Mapping[str, Content]:
        """Return the table as Markdown, and all numbers."""
        return {"scores.md": self.table().to_markdown(), "scores.json": self.to_dict()}

    def card(self) -> Card:
        """Return the card of the scores."""
        return Card((Field("status", self._status()), *self._cases()))

    def _status(self) -> Iterator[str]:
        failed = sum(not row.holds for row in self.rows)
        yield f"claims hold: {len(self.rows) - failed} of {len(self.rows)}"

    def _cases(self) -> Iterator[Field]:
        for name, title in self.titles.items():
            rows: Sequence[Score] = [row for row in self.rows if row.case == name]
            yield Field("case", (name, title), _HEADING, [row.cells() for row in rows], self._reason(name))

    def _reason(self, name: str) -> Iterator[str]:
        if name in self.missing:
            yield f"study not run: {self.missing[name]}"
