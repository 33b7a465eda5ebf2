"""Comparison of solutions: positions with the joint estimate, and states of a spacecraft at one epoch."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeVar

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.estimation.combination import Agreement, JointEstimate
from radioloc.lunar.position import LunarPosition
from radioloc.results.cards import Card, Field, metres, plural, signed_metres
from radioloc.results.result import Content, Result
from radioloc.results.tables import (
    PositionRow,
    finite,
    place_record,
    position_fields,
    position_files,
    record_table,
)
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
        table = record_table([asdict(pair) for pair in self.pairs])
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
    sides = map(signed_metres, (pair.radial_m, pair.along_m, pair.across_m))
    return f"{pair.first} - {pair.second}", *sides, *_significance_cells(pair)


def _significance_cells(pair: Agreement | StatePair) -> tuple[str, str]:
    """Return the difference in sigmas and the probability of a larger one."""
    if pair.chi2 is None or pair.chance is None:
        return "-", "-"
    return f"{math.sqrt(pair.chi2):.2f}", f"{100.0 * pair.chance:.2g}"


_SIGNIFICANCE_LEVEL = 1e-3  # one comparison of consistent solutions in a thousand is refused
_MAX_NAMED_PAIRS = 3  # that are named one by one


@dataclass(frozen=True, slots=True, eq=False)
class Comparison(Result):
    """Solutions and published positions, tested against each other."""

    frame: str  #: mean-Earth axes of all positions
    benchmark: str  #: name of the row relative to which the others are given
    rows: tuple[PositionRow, ...]  #: solutions, the joint estimate, references
    #: (2, 2), total covariance of solutions, east and north in the axes at the benchmark.
    covariances_en_m2: dict[str, Any]
    agreements: tuple[Agreement, ...]  #: each pair of solutions
    joint: JointEstimate | None  #: estimate from all solutions that do not share observations

    @property
    def estimates(self) -> list[PositionRow]:
        """Rows of estimates, without references."""
        return [row for row in self.rows if row.method != "reference"]

    @property
    def consistent(self) -> bool:
        """True if no difference is significant at 0.1 % for all pairs together, and all solutions converged."""
        return self._agree and all(row.converged is not False for row in self.rows)

    @property
    def _agree(self) -> bool:
        return not self._different and (
            self.joint is None or self.joint.chance is None or self.joint.chance >= _SIGNIFICANCE_LEVEL
        )

    @property
    def _different(self) -> list[Agreement]:
        return significant_pairs(self.agreements)

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers, in types that JSON has."""
        joint = None
        if self.joint is not None:
            place = LunarPosition.from_cartesian(self.joint.position_me_m, self.frame)
            joint = {
                "position": {"me": place_record(place.frame, place.selenographic, place.xyz_m)},
                "covariance": {"enu_m2": list(map(finite, self.joint.covariance_enu_m2))},
                "of": list(self.joint.names),
                "excluded": dict(self.joint.left_out),
                "chi2": self.joint.chi2,
                "dof": self.joint.dof,
                "chance": self.joint.chance,
            }
        return {
            "consistent": self.consistent,
            "frame": self.frame,
            "sphere_radius_m": MEAN_LUNAR_RADIUS_M,
            "benchmark": self.benchmark,
            "positions": [asdict(row) for row in self.rows],
            "agreements": [asdict(pair) | {"chance": pair.chance} for pair in self.agreements],
            "joint": joint,
        }

    def files(self) -> Mapping[str, Content]:
        """Return the table of positions in three formats, and all numbers."""
        return {**position_files(self.rows), "comparison.json": self.to_dict()}

    def card(self) -> Card:
        """Return the card of the comparison."""
        heading = ("1 sigma", "L, m", "B, m", "h, m", "height, m")
        sizes = ((row.name, *map(metres, row.sigmas_m), f"{row.height_m:.1f}") for row in self.estimates)
        pairs = ("difference", "east, m", "north, m", "up, m", "sigmas", "chance, %")
        untested = untested_lines((f"{pair.one} and {pair.two}", pair.why) for pair in self.agreements)
        return Card(
            (
                Field("comparison", (plural(len(self.estimates), "estimate"),)),
                Field("status", self._status()),
                *position_fields(self.rows, self.frame, self.benchmark),
                Field("", (), heading, sizes),
                Field("agreement", (), pairs, map(_pair, self.agreements), untested),
                Field("joint", self._joint()),
            )
        )

    def __repr__(self) -> str:
        names = ", ".join(row.name for row in self.estimates)
        return f"<Comparison {names}: {'consistent' if self.consistent else 'NOT CONSISTENT'}>"

    def _status(self) -> Iterator[str]:
        failed = [row.name for row in self.rows if row.converged is False]
        different = [f"{pair.one} and {pair.two}" for pair in self._different]
        if not (different or self._agree):
            different = ["all estimates together"]
        yield from problem_lines(failed, different)
        if not failed and not different:
            tested = [(pair.chance, pair) for pair in self.agreements if pair.chance is not None]
            yield (
                _agreement_text(*min(tested, key=lambda item: item[0]))
                if tested
                else "no pair could be tested"
            )

    def _joint(self) -> Iterator[str]:
        if self.joint is None:
            return
        row = next(row for row in self.rows if row.method == "joint")
        east, north, up = map(metres, row.sigmas_m)
        yield (
            f"{row.longitude_deg:.5f} deg E, {row.latitude_deg:.5f} deg N, {row.height_m:.1f} m, from "
            f"{' and '.join(self.joint.names)}; sigmas east {east}, north {north}, up {up} m"
        )
        yield f"chi2 {self.joint.chi2:.2f} with {plural(self.joint.dof, 'degree')} of freedom"
        for name, reason in self.joint.left_out.items():
            yield f"{name} excluded: {reason}"


def problem_lines(failed: Sequence[str], different: Sequence[str]) -> Iterator[str]:
    """Yield lines that name solutions that did not converge, and those that differ."""
    if failed:
        yield f"NOT CONVERGED: {', '.join(failed)}"
    if different:
        yield f"NOT CONSISTENT: {'; '.join(different)} differ by more than their sigmas allow"


def untested_lines(pairs: Iterable[tuple[str, str]]) -> Iterator[str]:
    """Yield a line for each reason why pairs, of names with a reason, are not tested."""
    by_reason = dict[str, list[str]]()
    for name, reason in pairs:
        by_reason.setdefault(reason, []).append(name)
    for reason, names in by_reason.items():
        if reason:
            named = "; ".join(names) if len(names) <= _MAX_NAMED_PAIRS else plural(len(names), "pair")
            yield f"{named} are not tested: {reason}"


_AnyPair = TypeVar("_AnyPair", Agreement, StatePair)


def significant_pairs(pairs: Iterable[_AnyPair]) -> list[_AnyPair]:
    """Return the pairs that differ significantly, the level divided by the number of tested pairs (Bonferroni)."""
    tested = [(pair.chance, pair) for pair in pairs if pair.chance is not None]
    return [pair for chance, pair in tested if chance * len(tested) < _SIGNIFICANCE_LEVEL]


def _agreement_text(chance: float, pair: Agreement) -> str:
    """Return the statement that the estimates agree, for the pair with the most significant difference."""
    distance_m = math.hypot(*pair.difference_enu_m[:2])
    return (
        f"consistent: {pair.one} and {pair.two}, {distance_m:.0f} m apart, differ by "
        f"{math.sqrt(pair.chi2 or 0.0):.2g} sigmas, which chance exceeds in {100.0 * chance:.2g} % of cases"
    )


def _pair(pair: Agreement) -> tuple[str, ...]:
    components = (f"{round(value, 1) + 0.0:.1f}" for value in pair.difference_enu_m)
    return f"{pair.one} - {pair.two}", *components, *_significance_cells(pair)
