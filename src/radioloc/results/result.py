"""Base class of the results of jobs, and the declaration of a type of results.

A result class derives from :class:`Result`. A :class:`ResultType` registers it, with the names of its figures
(:class:`radioloc.report.figure_types.FigureType`), so that the output folder, the page and the command line show it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from radioloc.dynamics.orbit import Orbit
from radioloc.results.cards import Card
from radioloc.vectors import Floats


@dataclass(frozen=True, slots=True)
class Table:
    """Columns of a CSV file by name, of equal lengths, and the decimals of those that are rounded."""

    columns: Mapping[str, Any]
    decimals: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class OrbitFile:
    """Integrated orbit of a spacecraft of a NAIF ID, and the covariance of its state where that is known."""

    orbit: Orbit
    body: int
    covariance: Floats | None = None


@dataclass(frozen=True, slots=True)
class Raster:
    """Bands (k, m) of a GeoTIFF by name, in square cells of longitude and latitude on the sphere of 1737.4 km."""

    bands: Mapping[str, Floats]
    west_deg: float
    north_deg: float
    step_deg: float


Content = str | Mapping[str, Any] | Table | OrbitFile | Raster | Callable[[Path], object]
"""Content of a file: text, a mapping for JSON, a table for CSV, an orbit in the format of the ending, a GeoTIFF, or a
function that writes the file."""


class Result:
    """Base class of results: ``str()`` is a card for a terminal, and a notebook shows the same fields as HTML."""

    __slots__ = ()

    def card(self) -> Card:
        """Return the fields that describe the result."""
        raise NotImplementedError

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers in types that JSON has."""
        raise NotImplementedError

    def files(self) -> Mapping[str, Content]:
        """Return the contents of the files of an output folder by name, which may begin with a folder."""
        raise NotImplementedError

    def positions(self) -> Mapping[str, Result]:
        """Return the located positions that a map shows, by their labels; a result of another kind has none."""
        return {}

    @property
    def verdict(self) -> str:
        """Class of the status on the page: ``good``, ``failed``, or empty where nothing was fitted."""
        return "good" if self.is_usable else "failed"

    @property
    def is_usable(self) -> bool:
        """True if the result converged, is determined and consistent, as far as it states so."""
        return all(getattr(self, name, True) for name in ("converged", "consistent", "determined"))

    def failures(self) -> Iterator[tuple[str, str]]:
        """Yield name and status of each part of the result that cannot be used."""
        if not self.is_usable:
            status = "; ".join(
                line for item in self.card().fields if item.label == "status" for line in item.lines
            )
            yield getattr(self, "name", ""), status

    def __str__(self) -> str:
        return str(self.card())

    def _repr_html_(self) -> str:
        return self.card().html(self.verdict)


@dataclass(frozen=True, slots=True)
class ResultType:
    """Declaration of a type of results.

    Results of types that have a file pattern or a figure in common replace each other in a folder; those of other types
    can stand beside each other.
    """

    name: str  #: unique name, such as ``"solution"``
    type: type[Result]  #: class of the results, derived from :class:`Result`
    #: Names of the figures, in order (entries of :data:`radioloc.report.figure_types.FIGURES`).
    figures: tuple[str, ...] = ()
    #: Names or patterns of all files that such a result can have in its folder, apart from the figures.
    file_patterns: tuple[str, ...] = ()
