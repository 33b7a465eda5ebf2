"""Comparison of the states of a spacecraft from several solutions, at one epoch."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from radioloc.results.cards import Card, Field, signed_metres
from radioloc.results.comparison import problem_lines, significant_pairs, untested_lines
from radioloc.results.result import Content, Result, Table
from radioloc.vectors import rtn_axes


@dataclass(frozen=True, slots=True)
class StatePair:
    """Difference of two states, along the axes of the orbit of the second, and its significance."""

    first: str
    second: str
    radial_m: float  # the first less the second, as the next two
    along_m: float
    across_m: float
    chi2: float | None = None  # of position and velocity, six degrees of freedom; None without a test
    reason: str = ""  # for the lack of a test

    @property
    def chance(self) -> float | None:
        """Probability of a difference at least as unlikely, if both states and their covariances are right."""
        from scipy.special import chdtrc

        return None if self.chi2 is None else float(chdtrc(6, self.chi2))


@dataclass(frozen=True, slots=True, eq=False)
class StateComparison(Result):
    """States of a spacecraft from several solutions, compared pair by pair."""

    epoch_tdb: str  #: epoch of all states
    solutions: Mapping[str, bool]  #: whether each solution converged, by name
    pairs: tuple[StatePair, ...]  #: differences of all pairs

    @property
    def name(self) -> str:
        """Names of the solutions."""
        return ", ".join(self.solutions)

    @property
    def converged(self) -> bool:
        """True if all solutions converged."""
        return all(self.solutions.values())

    @property
    def consistent(self) -> bool:
        """True if no difference is significant at 0.1 % for all pairs together."""
        return not significant_pairs(self.pairs)

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers, in types that JSON has."""
        return {
            "consistent": self.consistent,
            "epoch_tdb": self.epoch_tdb,
            "converged": dict(self.solutions),
            "states": [asdict(pair) | {"chance": pair.chance} for pair in self.pairs],
        }

    def files(self) -> Mapping[str, Content]:
        """Return all numbers, and a table with a row for each pair."""
        rows = [asdict(pair) for pair in self.pairs]
        table = Table({key: [row[key] for row in rows] for key in rows[0]})
        return {"comparison.json": self.to_dict(), "states.csv": table}

    def card(self) -> Card:
        """Return the card of the comparison."""
        heading = ("difference", "radial, m", "along, m", "across, m", "sigmas", "chance, %")
        return Card(
            (
                Field("comparison", (f"states of {self.name} at {self.epoch_tdb} TDB",)),
                Field("status", self._status()),
                Field("agreement", (), heading, map(_cells, self.pairs)),
            )
        )

    def _status(self) -> Iterator[str]:
        failed = [name for name, converged in self.solutions.items() if not converged]
        different = [f"{pair.first} and {pair.second}" for pair in significant_pairs(self.pairs)]
        yield from problem_lines(failed, different)
        if not failed and not different:
            is_tested = any(pair.chi2 is not None for pair in self.pairs)
            yield "consistent" if is_tested else "no pair could be tested"
        yield from untested_lines((f"{pair.first} and {pair.second}", pair.reason) for pair in self.pairs)


def state_pair(
    names: tuple[str, str], states: tuple[Mapping[str, Any], Mapping[str, Any]], *, share_data: bool
) -> StatePair:
    """Return the difference of two recorded states; those of common observations are not tested."""
    vectors = [np.array([state["position_m"], state["velocity_m_s"]], dtype=np.float64) for state in states]
    difference = vectors[0] - vectors[1]
    pair = StatePair(*names, *(rtn_axes(*vectors[1]) @ difference[0]).tolist())
    covariance = sum(np.array(state["covariance"], dtype=np.float64) for state in states)
    if share_data:
        return replace(pair, reason="they share observations")
    if not np.isfinite(covariance).all():
        return replace(pair, reason="a state is not determined")
    error = difference.ravel()
    return replace(pair, chi2=float(error @ np.linalg.solve(covariance, error)))


def _cells(pair: StatePair) -> tuple[str, ...]:
    sigmas, chance = "-", "-"
    if pair.chi2 is not None and pair.chance is not None:
        sigmas, chance = f"{math.sqrt(pair.chi2):.2f}", f"{100.0 * pair.chance:.2g}"
    sides = map(signed_metres, (pair.radial_m, pair.along_m, pair.across_m))
    return f"{pair.first} - {pair.second}", *sides, sigmas, chance
