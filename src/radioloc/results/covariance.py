"""Predicted accuracy of a tracking plan: sigmas by length, error budget, contributions and possible improvements.

Sigmas of an orbit are along, across and radial, from the mean of its covariance over the arc.

The 95 % radius is that of the horizontal circle around the estimate that holds the true point in 95 % of cases. With
the covariance C of east and north, a direction u and k = u^T C^-1 u, the probability within a radius R is the mean over
all directions of (1 - exp(-R^2 k / 2)) / (k sqrt(det C)).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from radioloc.estimation.consider import NOISE, ErrorSource, sum_by_source
from radioloc.estimation.statistics import finite_or_none, root_between
from radioloc.lunar.local import EAST_NORTH_UP
from radioloc.results.cards import Card, Field, metres, table
from radioloc.results.names import error_name, source_name
from radioloc.results.result import Content, Result, Table
from radioloc.results.tables import record_table
from radioloc.targets.orbit_state import ALONG_ACROSS_RADIAL, RTN, OrbitState
from radioloc.time import utc_strings
from radioloc.vectors import Floats

_DIRECTIONS = np.linspace(0.0, np.pi, 721)[:-1]
_MAX_SOURCES, _MAX_IMPROVEMENTS = 8, 12
_FILE = "covariance.json"
_MIN_IMPROVEMENT = 0.005  # part of the 95 % radius below which the card does not show an improvement


def radius_95_m(covariance_m2: Floats) -> float:
    """Return the radius of the circle with 95 % of a plane normal distribution, m; infinite for infinite variances."""
    if not np.isfinite(covariance_m2).all():
        return math.inf
    variances = np.linalg.eigvalsh(covariance_m2)
    if variances[1] <= 0.0:
        return 0.0
    minor, major = np.sqrt(np.maximum(variances, 1e-4 * variances[1]))
    k = (np.cos(_DIRECTIONS) / minor) ** 2 + (np.sin(_DIRECTIONS) / major) ** 2

    def excess(radius_m: float) -> float:
        probability = -np.expm1(-0.5 * radius_m**2 * k) / (k * minor * major)
        return float(probability.mean()) - 0.95

    # Between the radii of a line and of a circle with the major axis.
    return root_between(excess, 1.9 * major, 2.5 * major, 1e-9 * major)


@dataclass(frozen=True, slots=True, eq=False)
class PlannedArc:
    """Predicted accuracy of the first hours of tracking."""

    hours: float
    span_h: float  # from the start to the last observation
    count: int  # observations
    sources: tuple[ErrorSource, ...]  # the largest first, with the covariance as sum; empty if not determined
    missing: tuple[str, ...]  # undetermined quantities in words
    axes: tuple[str, ...] = EAST_NORTH_UP  # or along, across, radial of an orbit: means over the arc
    state: OrbitState | None = None  # of an orbit that is determined

    @property
    def determined(self) -> bool:
        """True if the observations determine the position."""
        return bool(self.sources)

    @property
    def covariance_m2(self) -> Floats:
        """Covariance by the axes, shape (3, 3); infinite if not determined."""
        if not self.sources:
            return np.full((3, 3), np.inf)
        return np.asarray(sum(source.covariance_m2 for source in self.sources))

    @property
    def sigma_m(self) -> Floats:
        """Standard deviations by the axes, shape (3,)."""
        return np.sqrt(np.diag(self.covariance_m2))

    @property
    def radius_95_m(self) -> float:
        """Radius of the horizontal circle that contains the true point in 95 % of cases, m."""
        return radius_95_m(self.covariance_m2[:2, :2])

    def radius_95_without_m(self, *sources: ErrorSource) -> float:
        """Return the 95 % radius if some sources had no error."""
        return radius_95_m(
            sum((s.covariance_m2 for s in self.sources if s not in sources), np.zeros((3, 3)))[:2, :2]
        )

    def by_source(self) -> dict[str, Floats]:
        """Return variances by the axes, shape (3,), by kind of source; the largest horizontal ones first."""
        variances = {item.source: np.diag(item.covariance_m2) for item in sum_by_source(self.sources)}
        return dict(sorted(variances.items(), key=lambda item: -float(item[1][:2].sum())))

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers, in types that JSON has."""
        axes = zip(self.axes, self.sigma_m.tolist(), strict=True)
        is_orbit = self.axes == ALONG_ACROSS_RADIAL
        return {
            "hours": self.hours,
            "span_h": self.span_h,
            "observations": self.count,
            "determined": self.determined,
            "missing": list(self.missing),
            **{f"sigma_{axis}_m": finite_or_none(sigma) for axis, sigma in axes},
            "radius_95_m": finite_or_none(self.radius_95_m),
            f"covariance_{'acr' if is_orbit else 'enu'}_m2": self.covariance_m2.tolist()
            if self.determined
            else None,
            "budget": [source.to_dict(self.axes) for source in self.sources],
            **({"state": self.state and self.state.to_dict()} if is_orbit else {}),
        }


@dataclass(frozen=True, slots=True)
class Contribution:
    """Information in the observations of a type or of a station."""

    group: str  # "type" or "station"
    name: str
    count: int
    alone_m: float  # 95 % radius from these observations only; infinite if they do not determine the position
    without_m: float  # 95 % radius from all others


@dataclass(frozen=True, slots=True)
class Improvement:
    """Improvement of the longest arc by a station, a link or the elimination of an error."""

    change: str  # such as "station TIANMA65" or "station_position KASHI known"
    radius_95_m: float


@dataclass(frozen=True, slots=True, eq=False)
class CovarianceStudy(Result):
    """Predicted accuracy of a position or an orbit from a tracking plan."""

    name: str
    arcs: tuple[PlannedArc, ...]  #: the shortest first
    contributions: tuple[Contribution, ...]
    improvements: tuple[Improvement, ...]  #: the best first
    reach_m: float | None = None  #: 95 % radius to be reached
    reach_h: float | None = None  #: hours after which it is reached; None if it is not
    notes: tuple[str, ...] = ()
    others: tuple[CovarianceStudy, ...] = ()  #: of further targets in the same problem

    @property
    def longest(self) -> PlannedArc:
        """Arc of all the tracking."""
        return self.arcs[-1]

    @property
    def determined(self) -> bool:
        """True if the longest arc determines the position."""
        return self.longest.determined

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers, in types that JSON has."""
        return {
            "name": self.name,
            "determined": self.determined,
            "reach": None if self.reach_m is None else {"radius_95_m": self.reach_m, "hours": self.reach_h},
            "arcs": [arc.to_dict() for arc in self.arcs],
            "contributions": [
                {
                    item.group: item.name,
                    "observations": item.count,
                    "alone_radius_95_m": finite_or_none(item.alone_m),
                    "without_radius_95_m": finite_or_none(item.without_m),
                }
                for item in self.contributions
            ],
            "improvements": [
                asdict(item) | {"radius_95_m": finite_or_none(item.radius_95_m)} for item in self.improvements
            ],
            "notes": list(self.notes),
            **({"others": [other.to_dict() for other in self.others]} if self.others else {}),
        }

    def table(self) -> Table:
        """Return a row for each length, with the standard deviation by kind of source over all axes."""
        records = []
        for arc in reversed(self.arcs):  # the longest has all sources
            sigmas_m = zip((f"sigma_{axis}_m" for axis in arc.axes), arc.sigma_m.tolist(), strict=True)
            sources = {f"{kind}_m": math.sqrt(by_axis.sum()) for kind, by_axis in arc.by_source().items()}
            numbers = {**dict(sigmas_m), "radius_95_m": arc.radius_95_m, **sources}
            record: dict[str, Any] = {
                "hours": arc.hours,
                "span_h": round(arc.span_h, 4),
                "observations": arc.count,
            }
            records.append(record | {name: finite_or_none(value) for name, value in numbers.items()})
        return record_table(records[::-1])

    def files(self) -> Mapping[str, Content]:
        """Return all numbers, and a table with a row for each length."""
        others = {f"covariance_{k}.csv": other.table() for k, other in enumerate(self.others, 2)}
        return {"covariance.json": self.to_dict(), "covariance.csv": self.table(), **others}

    def card(self) -> Card:
        """Return the card of the study."""
        longest = self.longest
        heading = ("length", "span, h", "obs.", *longest.axes, "95 % radius")
        means = "; all are means over the arc" if longest.state else ""
        radius = f"95 % radius: horizontal circle that contains the true point in 95 % of cases{means}"
        sources = [
            (error_name(item), *map(metres, (*item.sigma_m.tolist(), item.total_m)))
            for item in longest.sources
        ]
        source_heading = (f"of {longest.hours:g} h, m", *longest.axes, "3D")
        contributions = (
            (f"{item.group} {item.name}", str(item.count), _radius(item.alone_m), _radius(item.without_m))
            for item in self.contributions
        )
        return Card(
            (
                Field("covariance", (self.name,)),
                Field("status", _status(self)),
                Field("1 sigma, m", (), heading, map(_length_cells, self.arcs)),
                Field("", (radius,)),
                *_state(longest),
                table("budget", source_heading, sources, _MAX_SOURCES, file=_FILE),
                Field("information", (), ("95 % radius, m", "obs.", "alone", "without"), contributions),
                _improvements(self),
                Field("notes", self.notes),
                *(field for other in self.others for field in other.card().fields),
            )
        )

    def __repr__(self) -> str:
        return f"<CovarianceStudy {self.name}: 95 % within {metres(self.longest.radius_95_m)} m>"


def plans_card(plans: Iterable[CovarianceStudy]) -> Card:
    """Return a card that compares several plans."""
    plans = tuple(plans)
    reach_m = plans[0].reach_m
    heading = ["", "span, h", "obs.", *plans[0].longest.axes, "95 % radius"]
    lines = ["1 sigma, m, of each complete plan"]
    if reach_m is not None:
        heading.append(f"{metres(reach_m)} m after")
        lines.append(f"last column: length with a 95 % radius of {metres(reach_m)} m or less")
    rows = (
        (plan.name, *_length_cells(plan.longest)[1:], *([] if reach_m is None else [_hours(plan.reach_h)]))
        for plan in plans
    )
    return Card((Field("plans", lines, heading, rows),))


def _hours(hours: float | None) -> str:
    return "never" if hours is None else f"{hours:.2f} h" if hours < 1.0 else f"{hours:.1f} h"


def _status(study: CovarianceStudy) -> Iterator[str]:
    arc = study.longest
    if not arc.determined:
        yield f"NOT OBSERVABLE: {'; '.join(arc.missing)}"
        return
    yield f"{arc.hours:g} h: 95 % within {metres(arc.radius_95_m)} m"
    if study.reach_m is not None and study.reach_h is None:
        yield f"a 95 % radius of {metres(study.reach_m)} m is not reached: {_first_measure(arc)}"
    elif study.reach_m is not None:
        yield f"a 95 % radius of {metres(study.reach_m)} m is reached after {_hours(study.reach_h)}"


def _first_measure(arc: PlannedArc) -> str:
    source = next(iter(arc.by_source()))
    return "add observations first" if source == NOISE else f"improve {source_name(source)} first"


def _length_cells(arc: PlannedArc) -> tuple[str, ...]:
    sigmas = map(metres, arc.sigma_m.tolist()) if arc.determined else ("-", "-", "-")
    radius = metres(arc.radius_95_m) if arc.determined else "not observable"
    return (f"{arc.hours:g} h", f"{arc.span_h:.2f}", str(arc.count), *sigmas, radius)


def _state(arc: PlannedArc) -> Iterator[Field]:
    """Yield the sigmas of the state at its epoch, radial, along and across."""
    if arc.state is None:
        return
    sigma = np.sqrt(np.diag(arc.state.covariance_rtn(arc.state.epoch)[0]))
    rows = (
        ("position, m", *map(metres, sigma[:3].tolist())),
        ("velocity, mm/s", *map(metres, (1e3 * sigma[3:]).tolist())),
    )
    yield Field("state", (), (f"of {arc.hours:g} h, at {utc_strings(arc.state.epoch, 0)[0]} TDB", *RTN), rows)


def _radius(radius_m: float) -> str:
    return metres(radius_m) if math.isfinite(radius_m) else "not observable"


def _improvements(study: CovarianceStudy) -> Field:
    radius_m = study.longest.radius_95_m
    rows = [
        (
            _change_text(item),
            metres(item.radius_95_m),
            f"-{100.0 * (1.0 - item.radius_95_m / radius_m):.0f} %",
        )
        for item in study.improvements
        if item.radius_95_m < (1.0 - _MIN_IMPROVEMENT) * radius_m
    ]
    small = len(study.improvements) - len(rows)
    below = [f"{small} others improve it by less than {100.0 * _MIN_IMPROVEMENT:g} %"] if small else []
    return table("improvement", ("95 % radius, m, with", "", ""), rows, _MAX_IMPROVEMENTS, below, _FILE)


def _change_text(item: Improvement) -> str:
    source, _, rest = item.change.partition(" ")
    return f"{source_name(source)} {rest}"
