"""Positions from parts of the data: from arcs of several lengths, and without each station and link.

The table of arcs and known positions has the form of table 1 of Wang et al. (2021).
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.estimation.combination import Agreement, PositionEstimate, agreement
from radioloc.estimation.consistency_results import ConsistencyTest
from radioloc.estimation.statistics import chi2_quantile, finite_or_none
from radioloc.lunar.local import EAST_NORTH_UP
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.link import Link
from radioloc.parameters.parameter import Parameter
from radioloc.quantities import TableForm, as_table
from radioloc.results.cards import (
    OBSERVABILITY,
    RESIDUALS,
    RESULT,
    Card,
    Detail,
    Field,
    in_section,
    metres,
    provenance_detail,
    sigma_text,
    signed_metres,
    table,
    value_text,
)
from radioloc.results.covariance import radius_95_m
from radioloc.results.fit_card import rejected_detail
from radioloc.results.names import link_ways, parameter_name, with_parameter_names
from radioloc.results.result import Content, Result, Table
from radioloc.results.solution import Solution
from radioloc.results.solution_card import sigma_levels
from radioloc.results.tables import (
    PositionRow,
    difference,
    place_fields,
    position_fields,
    position_files,
    record_table,
    residual_table,
)
from radioloc.targets.orbit_state import RTN, OrbitState
from radioloc.time import utc_strings

_MAX_ARC_COLUMNS = 2  # arcs side by side within the width of a terminal
_MAX_PARAMETERS = 12  # a card fits a screen; to_dict() has all of them
_MIN_FILLED_FRACTION = 0.95
"""Least part of an arc that its data cover, with the time between two observations as tolerance."""
_NO_FALSE_ALARM_PROBABILITY = 0.999  # that none of the differences in a table exceeds the bound by chance


@dataclass(frozen=True, slots=True, eq=False)
class Arc:
    """Arc of a study: its nominal length, and the span from the start to the last observation."""

    hours: float
    span_h: float
    solution: Solution

    @property
    def name(self) -> str:
        """Length as text, such as ``12 h``."""
        return f"{self.hours:g} h"

    def parameter(self, name: str) -> tuple[float, float] | None:
        """Return value and total sigma of a parameter, or None if the arc has no such parameter."""
        names = self.solution.parameters.names
        if name not in names:
            return None
        k = names.index(name)
        return float(self.solution.values[k]), float(self.solution.sigmas()[k])


@dataclass(frozen=True, slots=True)
class Reference:
    """A known position to compare with."""

    position: LunarPosition
    name: str = "reference"


@dataclass(frozen=True, slots=True)
class StateRow:
    """State of a spacecraft from an arc, at its epoch, with its difference to that from the longest arc, m."""

    target: str
    name: str  # length of the arc
    sigma_radial_m: float | None  # total standard deviation, as the next two; None where not determined
    sigma_along_m: float | None
    sigma_across_m: float | None
    radial_m: float | None  # this less the longest arc's, as the next two; None for that itself
    along_m: float | None
    across_m: float | None
    # Length of the difference of position and velocity in the standard deviations that it should have.
    from_longest_sigmas: float | None
    used: int
    rejected: int
    converged: bool

    @classmethod
    def from_arc(cls, target: str, arc: Arc, longest: OrbitState) -> StateRow:
        """Return the row of an arc."""
        state, total = arc.solution.states[target], arc.solution.fit.total
        is_determined = np.isfinite(state.parameter_covariance).all()
        sigma_m = state.sigma_rtn_m(state.epoch)[0] if is_determined else np.full(3, np.nan)
        from_longest = None if state is longest else state.difference_from_all(longest)
        differences_m = np.full(3, np.nan) if from_longest is None else np.array(from_longest.rtn_m)
        sigmas, differences = (map(finite_or_none, item.tolist()) for item in (sigma_m, differences_m))
        return cls(
            target=target,
            name=arc.name,
            **dict(zip((f"sigma_{axis}_m" for axis in RTN), sigmas, strict=True)),
            **dict(zip((f"{axis}_m" for axis in RTN), differences, strict=True)),
            from_longest_sigmas=None if from_longest is None else from_longest.sigmas,
            used=total.used,
            rejected=total.rejected,
            converged=arc.solution.converged,
        )


@dataclass(frozen=True, slots=True, eq=False)
class ArcStudy(Result):
    """Solutions of arcs of several lengths, and reference positions."""

    name: str  #: of the study
    arcs: tuple[Arc, ...]  #: the longest first
    #: Known positions in mean-Earth axes. The first is the benchmark of all others; without references the
    #: longest arc is.
    references: Sequence[Reference] = ()

    @property
    def longest(self) -> Solution:
        """Solution of the longest arc."""
        return self.arcs[0].solution

    @property
    def converged(self) -> bool:
        """True if all arcs converged."""
        return all(arc.solution.converged for arc in self.arcs)

    @property
    def by_target(self) -> tuple[ArcStudy, ...]:
        """Studies of each target with a position, the references with the first; this study if it has one target."""
        names = [target.name for target in self.longest.targets]
        if not names:
            return (self,) if self.longest.trajectory is None else ()
        return tuple(
            replace(
                self,
                name=f"{self.name}, {name}",
                arcs=tuple(replace(arc, solution=arc.solution.of_target(name)) for arc in self.arcs),
                references=self.references if name == names[0] else (),
            )
            for name in names
        )

    @property
    def benchmark(self) -> str:
        """Name of the benchmark."""
        return self.references[0].name if self.references else f"the arc of {self.arcs[0].name}"

    @property
    def rows(self) -> tuple[PositionRow, ...]:
        """Positions with their differences to the benchmark: arcs, the longest first, then references."""
        if self.longest.targets:
            names = [target.name for target in self.longest.targets]
            return tuple(
                row if row.method == "reference" else replace(row, name=f"{name}, {row.name}")
                for name, study in zip(names, self.by_target, strict=True)
                for row in study.rows
            )
        if not self.by_target:
            return ()
        longest = self.longest.selenographic
        benchmark = self.references[0].position.selenographic if self.references else longest
        rows = []
        for k, arc in enumerate(self.arcs):
            place, total = arc.solution.selenographic, arc.solution.fit.total
            cells = place_fields(place, None if k == 0 and not self.references else benchmark)
            cells |= {"used": total.used, "rejected": total.rejected, "wrms_m": total.wrms_m}
            if arc.solution.position_estimated:
                sigmas_m = map(finite_or_none, arc.solution.sigma_enu_m())
                cells |= zip(("sigma_east_m", "sigma_north_m", "sigma_up_m"), sigmas_m, strict=True)
            if k:
                cells["from_longest_m"] = math.hypot(*difference(place, longest)[2:4])
                cells["from_longest_sigmas"] = horizontal_sigmas(arc.solution, self.longest)
            rows.append(PositionRow("tracking", arc.name, **cells, converged=arc.solution.converged))
        for k, reference in enumerate(self.references):
            cells = place_fields(reference.position.selenographic, None if k == 0 else benchmark)
            rows.append(PositionRow("reference", reference.name, **cells))
        return tuple(rows)

    @property
    def states(self) -> tuple[StateRow, ...]:
        """States of spacecraft from each arc, the longest first, with their differences from that of the longest."""
        return tuple(
            StateRow.from_arc(name, arc, state)
            for name, state in self.longest.states.items()
            for arc in self.arcs
            if name in arc.solution.states
        )

    @property
    def other_parameters(self) -> dict[str, Parameter]:
        """Estimated parameters except the position's by name, in the order of the longest arcs."""
        items = [item for arc in reversed(self.arcs) for item in arc.solution.parameters]
        by_name = {item.name: item for item in items if item.kind != "position" and not item.fixed}
        return {
            name: by_name[name]
            for arc in self.arcs
            for name in arc.solution.parameters.names
            if name in by_name
        }

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers except single residuals, in types that JSON has."""
        return {
            "name": self.name,
            "converged": self.converged,
            "benchmark": self.benchmark,
            "frame": self.longest.me_frame,
            "sphere_radius_m": MEAN_LUNAR_RADIUS_M,
            "positions": [asdict(row) for row in self.rows],
            "states": [asdict(row) for row in self.states],
            "arcs": [
                {"hours": arc.hours, "span_h": arc.span_h, "solution": arc.solution.to_dict()}
                for arc in self.arcs
            ],
        }

    def to_table(self, form: TableForm = "astropy") -> Any:
        """Return :attr:`rows`, or else :attr:`states`, as a ``QTable`` of astropy or a ``DataFrame``; NaN for None."""
        rows = [asdict(row) for row in self.rows or self.states]
        return as_table(
            {key: [np.nan if row[key] is None else row[key] for row in rows] for key in rows[0]}, form
        )

    def files(self) -> Mapping[str, Content]:
        """Return the table of positions, all numbers, and a folder for each arc, such as ``12h``."""
        names = {arc.name: f"{arc.name} data" for arc in self.arcs}
        parameters = [
            {
                key: number
                for name in self.other_parameters
                if (estimate := arc.parameter(name))
                for key, number in zip((name, f"{name}.sigma"), estimate, strict=True)
            }
            for arc in self.arcs
        ]
        files: dict[str, Content] = {"arcs.json": self.to_dict()}
        if self.rows:
            files |= position_files(self.rows, names, parameters)
        if states := [asdict(row) for row in self.states]:
            files["states.csv"] = record_table(states)
        for arc in self.arcs:
            files[f"{arc.hours:g}h/solution.json"] = arc.solution.to_dict()
            files[f"{arc.hours:g}h/residuals.csv"] = residual_table(arc.solution.residuals)
        return files

    def positions(self) -> Mapping[str, Result]:
        """Return the position of each arc and target."""
        several = len(self.by_target) > 1
        return {
            f"{arc.solution.name}, {arc.name}" if several else arc.name: arc.solution
            for study in self.by_target
            for arc in study.arcs
            if arc.solution.positions()
        }

    def failures(self) -> Iterator[tuple[str, str]]:
        """Yield name and status of each arc that cannot be used."""
        for arc in self.arcs:
            yield from arc.solution.failures()

    def card(self) -> Card:
        """Return the card of the study."""
        longest, studies = self.longest, self.by_target
        failed = [arc.name for arc in self.arcs if not arc.solution.converged]
        axes = f"{longest.me_frame}, fitted in {longest.pa_frame}"
        counts = ("", "span, h", "used", "rejected", "wrms, m", "chi2/dof")
        return Card(
            (
                Field("arc lengths", (self.name,)),
                Field("status", (f"NOT CONVERGED: {', '.join(failed)}" if failed else "all arcs converged",)),
                *(
                    field
                    for study in studies
                    for field in study._position_fields(axes, of_several=len(studies) > 1)
                ),
                *self._state_fields(),
                Field("data", (), counts, map(_data_cells, self.arcs), section=RESIDUALS),
                *in_section(OBSERVABILITY, *_parameter_fields(self), Field("observable", _observable(self))),
                Field("notes", _notes(self, self.rows)),
            ),
            self._details(),
        )

    def _details(self) -> Iterator[Detail]:
        """Yield the rejected observations and the provenance of the longest arc, and the card of each arc."""
        yield rejected_detail(self.longest)
        for arc in self.arcs:
            yield Detail(RESULT, f"The arc of {arc.name}", tuple(arc.solution.card().fields))
        yield provenance_detail(self.longest.provenance)

    def _position_fields(self, axes: str, *, of_several: bool) -> Iterator[Field]:
        if of_several:
            yield Field("target", (self.name,))
        sizes = ("", "L, m", "B, m", "h, m", "height, m", f"from {self.arcs[0].name}, m", "in sigmas")
        yield from position_fields(self.rows, axes, self.benchmark)
        yield Field("1 sigma", (), sizes, map(_sigma_cells, self.arcs, self.rows))

    def _state_fields(self) -> Iterator[Field]:
        """Sigmas of the states of spacecraft, and differences from those of the longest arc."""
        longest = self.arcs[0].name
        heading = (
            "",
            *(f"{axis}, m" for axis in RTN),
            *(f"from {longest}: {RTN[0]}, m", *RTN[1:]),
            "in sigmas",
        )
        for name, state in self.longest.states.items():
            text = f"of {state.orbit.name}, 1 sigma at {utc_strings(state.epoch, 0)[0]} TDB"
            rows = [_state_cells(row) for row in self.states if row.target == name]
            yield Field("state", (text,), heading, rows)

    def __repr__(self) -> str:
        hours = ", ".join(f"{arc.hours:g}" for arc in self.arcs)
        return f"<ArcStudy {self.name}: {hours} h, {'converged' if self.converged else 'NOT CONVERGED'}>"


def horizontal_sigmas(part: Solution, longest: Solution) -> float | None:
    """Return the horizontal difference of two solutions in its standard deviations, None if they are not defined."""
    # Mahalanobis distance in two dimensions: below 2.45 in 95 % and below 3.72 in 99.9 % of cases.
    chi2 = compare_with_complete(part, longest, horizontal=True).chi2
    return None if chi2 is None else math.sqrt(chi2)


def compare_with_complete(part: Solution, complete: Solution, *, horizontal: bool = False) -> Agreement:
    """Compare a solution from a part of the data with that from all, as :func:`~.combination.agreement` does."""
    estimates = [PositionEstimate.from_solution(solution.to_dict()) for solution in (part, complete)]
    pair = (replace(estimate, study="", hours=float(k)) for k, estimate in enumerate(estimates))
    return agreement(*pair, horizontal=horizontal)


def _sigma_cells(arc: Arc, row: PositionRow) -> tuple[str, ...]:
    return (
        arc.name,
        *(metres(sigma) if arc.solution.position_estimated else "fixed" for sigma in row.sigmas_m),
        *(
            "-" if x is None else f"{x:z.1f}"
            for x in (row.height_m, row.from_longest_m, row.from_longest_sigmas)
        ),
    )


def _state_cells(row: StateRow) -> tuple[str, ...]:
    sigmas = (row.sigma_radial_m, row.sigma_along_m, row.sigma_across_m)
    differences = (row.radial_m, row.along_m, row.across_m)
    distance = "-" if row.from_longest_sigmas is None else f"{row.from_longest_sigmas:.1f}"
    cells = ("-" if value is None else signed_metres(value) for value in differences)
    return (row.name, *map(metres, sigmas), *cells, distance)


def _data_cells(arc: Arc) -> tuple[str, ...]:
    total, chi2 = arc.solution.fit.total, arc.solution.fit.chi2_per_dof
    wrms = "-" if total.wrms_m is None else metres(total.wrms_m)
    counts = (f"{arc.span_h:.2f}", str(total.used), str(total.rejected))
    return (arc.name, *counts, wrms, "-" if chi2 is None else f"{chi2:.3g}")


def _parameter_fields(study: ArcStudy) -> Iterator[Field]:
    """Yield tables of the other parameters with their sigmas, except those of passes, some arcs side by side."""
    for start in range(0, len(study.arcs), _MAX_ARC_COLUMNS):
        arcs = study.arcs[start : start + _MAX_ARC_COLUMNS]
        rows = [
            (
                f"{parameter_name(name)}, {item.unit}",
                *(_with_sigma(arc.parameter(name)) for arc in arcs),
                "free" if math.isinf(item.prior_sigma) else f"+- {item.prior_sigma:.4g}",
            )
            for name, item in study.other_parameters.items()
            if item.span_utc is None
        ]
        heading = ("value +- 1 sigma", *(arc.name for arc in arcs), "a priori")
        # Only the last table counts the rows that are not shown.
        file = "arcs.json" if start + _MAX_ARC_COLUMNS >= len(study.arcs) else ""
        yield table("" if start else "estimated", heading, rows, _MAX_PARAMETERS, file=file)


def _with_sigma(estimate: tuple[float, float] | None) -> str:
    if estimate is None:
        return "-"
    value, sigma = estimate
    return f"{value_text(value, sigma)} +- {sigma_text(sigma)}" if math.isfinite(sigma) else "undetermined"


def _observable(study: ArcStudy) -> Iterator[str]:
    """Yield the first sentence on the observability of each arc."""
    for arc in study.arcs:
        for sentence in arc.solution.observability.describe()[:1]:
            yield f"{arc.name}: {with_parameter_names(sentence, arc.solution.parameters)}"
    yield from sigma_levels(arc.solution for arc in study.arcs)


def _max_chance_sigmas(dof: int, count: int) -> float:
    """Bound in sigmas of the largest of some differences of `dof` coordinates (Sidak correction)."""
    return math.sqrt(chi2_quantile(_NO_FALSE_ALARM_PROBABILITY ** (1.0 / max(count, 1)), dof))


def _notes(study: ArcStudy, rows: tuple[PositionRow, ...]) -> Iterator[str]:
    for arc in study.arcs:
        if arc.solution.message:
            yield f"{arc.name}: {arc.solution.message}"
    for arc in study.arcs:
        if arc.span_h < _MIN_FILLED_FRACTION * arc.hours:
            yield f"the arc of {arc.name} is longer than its data, which end after {arc.span_h:.2f} h"
    longest = study.arcs[0].name
    positions = [
        (row.from_longest_sigmas, f"{row.name} and {longest} are {row.from_longest_m:.1f} m apart")
        for row in rows
        if row.from_longest_sigmas is not None
    ]
    states = [
        (
            row.from_longest_sigmas,
            f"states of {row.target or 'the orbiter'} from {row.name} and {longest} differ",
        )
        for row in study.states
        if row.from_longest_sigmas is not None
    ]
    for dof, differences in ((2, positions), (6, states)):
        limit = _max_chance_sigmas(dof, len(differences))
        for sigmas, text in differences:
            if sigmas > limit:
                yield (
                    f"{text}, by {sigmas:.1f} sigmas (99.9 % are below {limit:.2f}): the sigmas are too small, as "
                    "errors of the data are correlated or the model is incomplete"
                )
    # Notes are those of the longest arc; the counts of observations differ from arc to arc.
    yield from (note for note in study.longest.notes if "not selected:" not in note)


@dataclass(frozen=True, slots=True)
class Omission:
    """Position or state of a target without a station or a link; undetermined quantities are None."""

    kind: str  # "station" or "link"
    name: str  # the station, or the path of the link
    omitted: int  # observations of the station or the link
    used: int  # observations in the fit without them
    converged: bool
    target: str = ""  # name where there are several
    quantity: str = "position"  # or "state" of a spacecraft
    radius_95_m: float | None = None  # of the horizontal position of a place
    shift_enu_m: tuple[float, float, float] | None = None  # the place without it less that with all
    sigma_enu_m: tuple[float | None, ...] | None = None  # of that shift
    shift_rtn_m: tuple[float, float, float] | None = None  # of a state at its epoch, radial, along and across
    sigma_rtn_m: tuple[float, float, float] | None = None
    # Length of the shift in standard deviations of it, over the components of a place or of position and velocity.
    sigmas: float | None = None

    @classmethod
    def from_solutions(
        cls, kind: str, name: str, omitted: int, part: Solution, complete: Solution
    ) -> Iterator[Omission]:
        """Yield the places and states of a solution without some observations, compared with those with all."""
        row = cls(kind, name, omitted, part.fit.total.used, part.converged)
        for target in _place_names(complete):
            places = [solution.of_target(target) if target else solution for solution in (part, complete)]
            yield replace(row, target=target)._with_place(*places)
        for target, state in complete.states.items():
            yield replace(row, target=target, quantity="state")._with_state(part.states[target], state)

    def _with_place(self, part: Solution, complete: Solution) -> Omission:
        if not (part.position_determined and complete.position_determined):
            return self
        shift = compare_with_complete(part, complete)
        return replace(
            self,
            radius_95_m=finite_or_none(radius_95_m(part.position_covariance()[:2, :2])),
            shift_enu_m=shift.difference_enu_m,
            sigma_enu_m=shift.sigma_enu_m,
            sigmas=None if shift.chi2 is None else math.sqrt(shift.chi2),
        )

    def _with_state(self, part: OrbitState, complete: OrbitState) -> Omission:
        if not (np.isfinite(part.covariance).all() and np.isfinite(complete.covariance).all()):
            return self
        shift = part.difference_from_all(complete)
        return replace(self, shift_rtn_m=shift.rtn_m, sigma_rtn_m=shift.sigma_rtn_m, sigmas=shift.sigmas)

    @property
    def shift_m(self) -> tuple[float, float, float] | None:
        """Shift of the place, east, north and up, or of the state, radial, along and across."""
        return self.shift_enu_m or self.shift_rtn_m

    @property
    def label(self) -> str:
        """Name on the card, such as ``KASHI two-way`` of a link."""
        if self.kind == "station":
            return self.name
        link = Link.from_path(self.name)
        return f"{link.place} {link_ways([link])[0]}".rstrip()


@dataclass(frozen=True, slots=True, eq=False)
class LeaveOneOut(Result):
    """Solution, and the positions and states without each of its stations and links; ``str()`` is a card."""

    solution: Solution  # from all observations
    omissions: tuple[Omission, ...]  # stations, then links; of each, those of all targets

    @property
    def name(self) -> str:
        """Name of the study."""
        return self.solution.name

    @property
    def converged(self) -> bool:
        """True if the fit to all observations converged."""
        return self.solution.converged

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns of the table by name; NaN where there is no number."""
        rows = [asdict(row) for row in self.omissions]
        several = ("target", "quantity") if len(self._compared) > 1 else ()
        keys = ("kind", "name", *several, "omitted", "used")
        columns = {key: np.array([row[key] for row in rows]) for key in keys}
        columns["converged"] = np.array([int(row.converged) for row in self.omissions])
        numbers: dict[str, Any] = {"radius_95_m": [row.radius_95_m for row in self.omissions]}
        quantities = {row.quantity for row in self.omissions}
        axes = {"enu": EAST_NORTH_UP} if "position" in quantities else {}
        axes |= {"rtn": RTN} if "state" in quantities else {}
        for key, (of_axes, names) in itertools.product(("shift", "sigma"), axes.items()):
            values = np.array([row[f"{key}_{of_axes}_m"] or (None,) * 3 for row in rows]).reshape(-1, 3)
            numbers |= {f"{key}_{axis}_m": values[:, k] for k, axis in enumerate(names)}
        numbers["sigmas"] = [row.sigmas for row in self.omissions]
        return columns | {key: np.array(column, dtype=np.float64) for key, column in numbers.items()}

    def to_table(self, form: TableForm = "astropy") -> Any:
        """Return a row for each omission as a ``QTable`` of astropy, with units, or a ``DataFrame`` of pandas."""
        return as_table(self.columns(), form)

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers except single residuals, in types that JSON has."""
        return {"solution": self.solution.to_dict(), "omissions": [asdict(row) for row in self.omissions]}

    def files(self) -> Mapping[str, Content]:
        """Return all numbers, and a table with a row for each station and link."""
        return {"leave_one_out.json": self.to_dict(), "leave_one_out.csv": Table(self.columns())}

    def failures(self) -> Iterator[tuple[str, str]]:
        """Yield name and status of the solution from all observations, if it cannot be used."""
        yield from self.solution.failures()

    def card(self) -> Card:
        """Card of the shifts of each target without each station and link."""
        used = f"{self.solution.fit.total.used} observations used"
        names = _place_names(self.solution)
        places = [self.solution.of_target(name) if name else self.solution for name in names]
        radii = (
            f"95 % {f'of {name} ' if name else ''}within {metres(radius_95_m(place.position_covariance()[:2, :2]))} m"
            for name, place in zip(names, places, strict=True)
        )
        return Card(
            [
                Field("omissions", [f"each station and link of {self.solution.name}"]),
                Field("all", ["; ".join((used, *radii))]),
                *self._shifts(),
                Field("notes", self._notes()),
            ],
            [provenance_detail(self.solution.provenance)],
        )

    @property
    def _compared(self) -> list[tuple[str, str]]:
        """Targets and quantities that are compared."""
        return list(dict.fromkeys((row.target, row.quantity) for row in self.omissions))

    def _shifts(self) -> Iterator[Field]:
        """Yield the table of each target and quantity."""
        for target, quantity in self._compared:
            rows = [row for row in self.omissions if (row.target, row.quantity) == (target, quantity)]
            of_state = quantity == "state"
            sides = (f"{axis}, m" for axis in (RTN if of_state else EAST_NORTH_UP))
            heading = ("without", "used", *sides, "sigmas", *(() if of_state else ("95 %, m",)))
            cells = ((self._label(row), *_shift_cells(row))[: len(heading)] for row in rows)
            of_target = f"of the {quantity}{f' of {target}' if target else ''}"
            yield Field("shift", (of_target,) if len(self._compared) > 1 else (), heading, cells)

    def _label(self, row: Omission) -> str:
        """Name of a station or a link, of several targets with those of the link."""
        several = row.kind == "link" and len(self._compared) > 1
        return f"{row.label}, {', '.join(Link.from_path(row.name).targets)}" if several else row.label

    def _notes(self) -> Iterator[str]:
        yield from (f"consistency tests of all observations: {item.cause}" for item in self._findings)
        counts = Counter(row.quantity for row in self.omissions if row.sigmas is not None)
        for row in self.omissions:
            quantity = f"{row.quantity}{f' of {row.target}' if row.target else ''}"
            limit = _max_chance_sigmas(6 if row.quantity == "state" else 3, counts[row.quantity])
            if row.shift_m is None:
                yield f"without {self._label(row)} the {quantity} is not determined"
            elif not row.converged:
                yield f"without {self._label(row)} the fit does not converge"
            elif row.sigmas is not None and row.sigmas > limit:
                yield (
                    f"without {self._label(row)} the {quantity} moves by {math.hypot(*row.shift_m):.3g} m, "
                    f"{row.sigmas:.1f} sigmas of that shift (99.9 % are below {limit:.2f}): {self._reason(row)}"
                )
        yield from sigma_levels([self.solution])

    @property
    def _findings(self) -> tuple[ConsistencyTest, ...]:
        return self.solution.consistency.findings

    def _reason(self, row: Omission) -> str:
        """Return the reason for a shift, which agrees with the findings of the consistency tests."""
        if not self._findings:
            return "its observations are inconsistent with the others, or the sigmas are too small"
        link = None if row.kind == "station" else Link.from_path(row.name)
        stations = {row.name} if link is None else {link.transmitter, link.receiver}
        if any(stations & item.participants for item in self._findings):
            return "the consistency tests of all observations name it too"
        return "a consequence of what the consistency tests of all observations name"


def _place_names(solution: Solution) -> list[str]:
    """Return the names of the targets whose places are estimated; empty of the only one."""
    places = solution.places if solution.trajectory is None else []
    return [place.name * bool(solution.targets) for place in places if place.position_estimated]


def _shift_cells(row: Omission) -> tuple[str, ...]:
    if row.shift_m is None:
        return (str(row.used), *("-" * 5))
    sigmas = "-" if row.sigmas is None else f"{row.sigmas:.1f}"
    return (str(row.used), *map(signed_metres, row.shift_m), sigmas, metres(row.radius_95_m))
