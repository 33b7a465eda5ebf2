"""How the position depends on the length of the tracking arc: the same study with its first hours only."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from radioloc.ephemeris import Trajectory
from radioloc.errors import InputError
from radioloc.estimation.cards import render_html
from radioloc.estimation.solution import Solution
from radioloc.extras import astropy_table
from radioloc.measurements.observations import Observations
from radioloc.studies.arc_parts import DEFAULT_HOURS, arc_lengths, arc_parts
from radioloc.studies.arcs_table import PositionRow, card_fields, card_text, comparison, table_dict
from radioloc.studies.locate import fit_arc, prepared_arc
from radioloc.studies.owners import of_part
from radioloc.studies.study import Reference, Study


@dataclass(frozen=True, slots=True, eq=False)
class Predictor:
    """One arc of a study.

    Parameters
    ----------
    hours : float
        Length asked for.
    span_h : float
        From the start to the last observation, h.
    solution : Solution
    """

    hours: float
    span_h: float
    solution: Solution

    @property
    def name(self) -> str:
        """Length as text, such as ``12 h``."""
        return f"{self.hours:g} h"


@dataclass(frozen=True, slots=True, eq=False)
class ArcStudy:
    """The arcs of a study, beside reference positions.

    ``str()`` is a card with the table of positions, what each arc is made of, and the other parameters;
    ``_repr_html_`` shows the same.

    Parameters
    ----------
    name : str
        Name of the study.
    arcs : tuple of Predictor
        The longest first.
    references : tuple of Reference
        Known positions in mean-Earth axes. The first is the benchmark that all others are compared with; where there
        is none, that is the longest arc.
    """

    name: str
    arcs: tuple[Predictor, ...]
    references: tuple[Reference, ...] = ()

    @property
    def longest(self) -> Solution:
        """Solution of the longest arc."""
        return self.arcs[0].solution

    @property
    def converged(self) -> bool:
        """Whether all arcs did."""
        return all(arc.solution.converged for arc in self.arcs)

    @property
    def rows(self) -> tuple[PositionRow, ...]:
        """Positions with their differences to the benchmark: arcs, the longest first, then references."""
        return comparison(self)

    def to_dict(self) -> dict[str, Any]:
        """All numbers but the single residuals, in types that JSON has."""
        return table_dict(self)

    def to_table(self) -> Any:
        """:attr:`rows` as an ``astropy.table.Table``; NaN where a row has no such number.

        Raises
        ------
        InputError
            astropy is not installed.
        """
        records = [row.to_dict() for row in self.rows]
        return astropy_table().Table(
            {key: [np.nan if r[key] is None else r[key] for r in records] for key in records[0]}
        )

    def __str__(self) -> str:
        return card_text(card_fields(self))

    def __repr__(self) -> str:
        hours = ", ".join(f"{arc.hours:g}" for arc in self.arcs)
        return f"<ArcStudy {self.name}: {hours} h, {'converged' if self.converged else 'NOT CONVERGED'}>"

    def _repr_html_(self) -> str:
        return render_html(card_fields(self))


def arcs(
    study: Study, hours: Iterable[float] = DEFAULT_HOURS, observations: Observations | None = None
) -> ArcStudy:
    """Fit the first hours of a study's observations, for several lengths.

    The model is prepared once, for the longest arc.

    Parameters
    ----------
    study : Study
        Its own ``hours`` are replaced. Its ``reference``, or else the first of its ``references``, is the benchmark.
    hours : iterable of float
        Lengths of the arcs from the study's start, or else from the first observation, h.
    observations : Observations, optional
        In place of the study's files.

    Raises
    ------
    InputError
        No length is given, one is not above zero, an arc holds no observation, or the target is a trajectory.
    RadiolocError
        As :func:`~radioloc.studies.locate.locate`.
    """
    if isinstance(study.target, Trajectory):
        raise InputError(
            f"{study.name}: an arc-length study compares positions, but the target is a trajectory; "
            "use locate or residuals"
        )
    lengths = arc_lengths(hours, study.observations)
    known = (() if study.reference is None else (study.reference,)) + study.references
    whole = replace(
        study,
        observations=replace(study.observations, hours=lengths[-1]),
        reference=known[0] if known else None,
    )
    longest, left_out = prepared_arc(whole, observations)
    found = []
    for length, span_h, rows in arc_parts(longest.observations, whole.observations, reversed(lengths)):
        later = len(longest.observations) - len(rows)
        reasons = dict(left_out)
        if later:
            reasons["outside the time span"] = reasons.get("outside the time span", 0) + later
        one = replace(whole, name=f"{study.name}, {length:g} h")
        arc = longest if not later else longest.select(rows)
        estimate = study.estimate if not later else of_part(study.estimate, arc, study.catalogue)
        found.append(Predictor(length, span_h, fit_arc(one, arc, reasons, estimate)))
    constants = longest.model.ephemeris.constants
    references = [Reference(item.position.to_axes("ME", constants), item.name) for item in known]
    return ArcStudy(study.name, tuple(found), tuple(references))
