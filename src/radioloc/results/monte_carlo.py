"""Monte Carlo studies: simulated realizations of a tracking plan, statistics of their errors, and their card."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.lunar.local import EAST_NORTH_UP
from radioloc.parameters.registry import PARAMETERS
from radioloc.quantities import TableForm, as_table
from radioloc.results.cards import Card, Field, metres, plural
from radioloc.results.names import parameter_name
from radioloc.results.result import Content, Result, Table
from radioloc.targets.orbit_state import ALONG_ACROSS_RADIAL
from radioloc.units import ASTROPY_UNITS, argument_unit
from radioloc.vectors import Floats

_MAX_PARAMETERS = 8  # tables on the card
NORMAL_95, CHI2_2_95, CHI2_6_95 = 1.959963984540054, 5.991464547107979, 12.591587243743977
"""Quantiles: 97.5 % of the normal distribution, 95 % of chi-square of two and of six degrees of freedom."""
_ORBIT_AXES = (
    "T along, N across the orbit, R radial; at the state's epoch, in the middle and at the end of the arc"
)
_SHORT = {"along": "T", "across": "N", "radial": "R", "east": "E", "north": "N", "up": "U"}


@dataclass(frozen=True, slots=True)
class Coverage:
    """Number of trials with the truth in a claimed 95 % region."""

    count: int
    trials: int
    low: float  # bounds of the fraction that chance keeps in 95 % of cases
    high: float

    @property
    def fraction(self) -> float:
        """Fraction of the trials."""
        return self.count / self.trials


@dataclass(frozen=True, slots=True)
class Nees:
    """Normalized estimation error squared, error' covariance^-1 error, over its dimension: mean over the trials."""

    mean: float  # 1 is expected if the claimed covariance is right
    low: float  # bounds that chance keeps in 95 % of cases
    high: float


@dataclass(frozen=True, slots=True)
class ParameterSummary:
    """Mean and standard deviation of a parameter's estimates, rms of their errors, median of the claimed sigma."""

    name: str
    mean: float
    std: float
    rms_error: float | None  # None if the simulation has no true value
    sigma: float


@dataclass(frozen=True, slots=True)
class ArcSummary:
    """Statistics of the converged trials of an arc."""

    hours: float
    span_h: float
    trials: int
    converged: int
    mean_m: tuple[float, ...]  # mean of position less truth, by the axes
    rms_m: tuple[float, ...]  # rms of the same
    sigma_m: tuple[float, ...]  # median of the claimed sigma, by the axes
    rms_horizontal_m: float  # rms of the horizontal error
    radius_68_m: float  # horizontal distance from the truth that 68 % of the trials do not exceed
    radius_95_m: float  # the same for 95 %
    coverage: dict[str, Coverage]  # by the axes, of the horizontal 95 % ellipse, and of the state of an orbit
    nees: Nees  # of the position in space
    nees_horizontal: Nees  # of the position on the sphere
    used: float  # mean number of used observations
    rejected: float  # mean number of rejected observations
    max_rejected: int  # largest number of rejected observations
    # Horizontal distance from the longest arc's position in 95 % of the trials.
    from_longest_95_m: float | None
    parameters: tuple[ParameterSummary, ...]  # of the other parameters
    at_h: float | None = None  # epoch at which an orbit is compared, from the state's epoch
    nees_state: Nees | None = None  # of position and velocity of an orbit

    @property
    def name(self) -> str:
        """Length as text, such as ``12 h``, with the epoch of an orbit."""
        return f"{self.hours:g} h" + ("" if self.at_h is None else f" at {self.at_h:.1f} h")


@dataclass(frozen=True, slots=True)
class LinearityCheck:
    """Trials fitted with the linear and the full model: those farthest from the linearization, and random ones."""

    trials: tuple[int, ...]
    largest_m: float  # largest difference of a position east, north or up
    # The same in claimed sigmas, or the largest relative difference of a sigma if that is larger.
    largest_sigmas: float
    passed: bool  # differences within 1 mm or 1 % of sigma, whichever is larger, and sigmas within 2 %


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarlo(Result):
    """Trials of a study and their statistics."""

    name: str  #: of the study
    seed: int
    #: Nominal and actual lengths of the arcs, the longest first, h; three times each for an orbit.
    hours: tuple[float, ...]
    span_h: tuple[float, ...]  #: likewise
    columns: tuple[str, ...]  #: names of the numbers of each trial and arc
    values: Floats  #: (trials, arcs, columns), NaN for a missing number
    linear: bool  #: whether the trials are those of the linear model, or full fits
    #: Test of the linear model against full fits; None if all trials were full fits from the start.
    linearity: LinearityCheck | None
    drawn: tuple[str, ...]  #: parameters drawn at random
    #: Epochs, from the state's epoch, at which an orbit is compared with the truth, for each of `hours`: the
    #: state's epoch, the middle and the end of the tracking. Empty for a place.
    at_h: tuple[float, ...] = ()
    others: tuple[MonteCarlo, ...] = ()  #: results of further targets in the same trials
    notes: tuple[str, ...] = ()  #: types of measurement that are simulated without noise

    def __getitem__(self, column: str) -> Floats:
        """Return a column of all trials and arcs, shape (trials, arcs).

        Raises
        ------
        InputError
            The name is not that of a column.
        """
        if column not in self.columns:
            raise InputError(f"column: expected one of {', '.join(self.columns)}, got {column!r}")
        return np.asarray(self.values[..., self.columns.index(column)])

    @property
    def trials(self) -> int:
        """Number of trials."""
        return len(self.values)

    @property
    def converged(self) -> bool:
        """True if all arcs of all trials converged."""
        return bool((self["converged"] == 1.0).all())

    @property
    def errors_m(self) -> Floats:
        """Position less truth by the axes, shape (trials, arcs, 3)."""
        return np.stack([self[f"{side}_m"] for side in self.sides], axis=-1)

    @property
    def sigmas_m(self) -> Floats:
        """Claimed sigmas of the position by the axes, shape (trials, arcs, 3)."""
        return np.stack([self[f"sigma_{side}_m"] for side in self.sides], axis=-1)

    @property
    def sides(self) -> tuple[str, ...]:
        """Axes of the errors: east, north and up, or of an orbit along, across and radial."""
        return EAST_NORTH_UP if "east_m" in self.columns else ALONG_ACROSS_RADIAL

    @property
    def arcs(self) -> tuple[ArcSummary | None, ...]:
        """Statistics of each arc's trials, the longest first; None if no trial converged."""
        return tuple(map(self._arc, range(len(self.hours))))

    def _arc(self, k: int) -> ArcSummary | None:
        good = self["converged"][:, k] == 1.0
        n = int(good.sum())
        if not n:
            return None
        sides = self.sides
        columns = dict(zip(self.columns, self.values[good, k].T, strict=True))
        error_m, sigma_m = self.errors_m[good, k], self.sigmas_m[good, k]
        horizontal_m = np.hypot(error_m[:, 0], error_m[:, 1])
        covered = np.abs(error_m) <= NORMAL_95 * sigma_m
        counts = dict(zip(sides, covered.sum(axis=0).tolist(), strict=True))
        counts["horizontal"] = int((columns["nees_horizontal"] <= CHI2_2_95).sum())
        if self.at_h:
            counts["state"] = int((columns["nees_state"] <= CHI2_6_95).sum())
        low, high = binomial_bounds(n, 0.95)
        from_longest_95_m = None
        epochs = self.hours.count(self.hours[0])  # several for an orbit
        compared = good & (self["converged"][:, k % epochs] == 1.0)
        if k >= epochs and compared.any():
            shift_m = (self.errors_m[:, k] - self.errors_m[:, k % epochs])[compared]
            from_longest_95_m = float(np.quantile(np.hypot(shift_m[:, 0], shift_m[:, 1]), 0.95))
        parameters = (
            ParameterSummary(
                name,
                float(columns[name].mean()),
                float(columns[name].std()),
                _rms(columns[f"{name}.error"]) if f"{name}.error" in columns else None,
                float(np.median(columns[f"{name}.sigma"])),
            )
            for name in self.columns
            # NaN in an arc without observations that depend on the parameter.
            if f"{name}.sigma" in columns and not np.isnan(columns[name]).any()
        )
        return ArcSummary(
            hours=self.hours[k],
            span_h=self.span_h[k],
            trials=self.trials,
            converged=n,
            mean_m=tuple(error_m.mean(axis=0).tolist()),
            rms_m=tuple(np.sqrt((error_m**2).mean(axis=0)).tolist()),
            sigma_m=tuple(np.median(sigma_m, axis=0).tolist()),
            rms_horizontal_m=_rms(horizontal_m),
            radius_68_m=float(np.quantile(horizontal_m, 0.68)),
            radius_95_m=float(np.quantile(horizontal_m, 0.95)),
            coverage={key: Coverage(count, n, low, high) for key, count in counts.items()},
            nees=_nees(columns["nees"], 3),
            nees_horizontal=_nees(columns["nees_horizontal"], 2),
            used=float(columns["used"].mean()),
            rejected=float(columns["rejected"].mean()),
            max_rejected=int(columns["rejected"].max()),
            from_longest_95_m=from_longest_95_m,
            parameters=tuple(parameters),
            at_h=self.at_h[k] if self.at_h else None,
            nees_state=_nees(columns["nees_state"], 6) if self.at_h else None,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers except single trials, in types that JSON has."""
        check = self.linearity
        return {
            "name": self.name,
            "seed": self.seed,
            "trials": self.trials,
            "converged": self.converged,
            "drawn": ["noise", *self.drawn],
            "notes": list(self.notes),
            "linear": self.linear,
            "linearity": None if check is None else asdict(check) | {"trials": list(check.trials)},
            "arcs": [
                {"hours": hours, "converged": 0} if arc is None else asdict(arc)
                for hours, arc in zip(self.hours, self.arcs, strict=True)
            ],
            **({"others": [study.to_dict() for study in self.others]} if self.others else {}),
        }

    def columns_of_trials(self) -> dict[str, NDArray[Any]]:
        """Return all columns of the trials by name, one row for each trial and arc."""
        n, arcs, _ = self.values.shape
        columns = {"trial": np.repeat(np.arange(n), arcs), "hours": np.tile(self.hours, n)}
        if self.at_h:
            columns["at_h"] = np.tile(self.at_h, n)
        return columns | dict(zip(self.columns, self.values.reshape(n * arcs, -1).T, strict=True))

    def to_table(self, form: TableForm = "astropy") -> Any:
        """Return all trials as a ``QTable`` with units or a ``DataFrame``, one row for each trial and arc.

        Parameters have the units of their kinds, :data:`~radioloc.parameters.registry.PARAMETERS`.
        """
        columns = self.columns_of_trials()
        kinds = {name: name.partition(".")[0] for name in columns}
        units = {
            name: ASTROPY_UNITS.get(PARAMETERS[kind].unit, PARAMETERS[kind].unit)
            if kind in PARAMETERS
            else argument_unit(kind)
            for name, kind in kinds.items()
        }
        return as_table(columns, form, units)

    def files(self) -> Mapping[str, Content]:
        """Return the statistics, and for each target a table with a row for each trial and arc."""
        targets = (self, *self.others)
        tables = {
            f"trials{f'_{k}' if k > 1 else ''}.csv": Table(study.columns_of_trials())
            for k, study in enumerate(targets, 1)
        }
        return {"montecarlo.json": self.to_dict(), **tables}

    def card(self) -> Card:
        """Return the card of the study."""
        arcs = [arc for arc in self.arcs if arc is not None]
        return Card(
            (
                Field("monte carlo", (self.name,)),
                Field("status", (*_status(self), *self.notes)),
                Field("drawn", (f"{', '.join(['noise', *self.drawn])}; seed {self.seed}",)),
                Field("axes", (_ORBIT_AXES,) if self.at_h else ()),
                *(_tables(arcs) if arcs else ()),
                Field("notes", (note for arc in arcs for note in _notes(arc))),
                *(field for study in self.others for field in study.card().fields),
            )
        )

    def __repr__(self) -> str:
        hours = ", ".join(f"{length:g}" for length in self.hours)
        return f"<MonteCarlo {self.name}: {self.trials} trials of {hours} h>"


def _tables(arcs: list[ArcSummary]) -> Iterator[Field]:
    """Yield the statistics of each arc's trials as tables with a row for each arc."""
    regions = list(arcs[0].coverage)
    first, *others = (_SHORT[region] for region in regions[:3])
    shift = f"95 % from {arcs[0].hours:g} h"
    headings = {
        "error, m": (f"mean {first}", *others, f"rms {first}", *others, "68 %", "95 %"),
        "1 sigma, m": (f"claimed {first}", *others, f"rms/sigma {first}", *others, shift),
        "inside 95 %": (*regions, "expected"),
        "nees": (
            "in space",
            "expected",
            "horizontal",
            "expected",
            *("state", "expected") * ("state" in regions),
        ),
    }
    for (label, heading), rows in zip(headings.items(), zip(*map(_cells, arcs), strict=True), strict=True):
        cells = ((arc.name, *row) for arc, row in zip(arcs, rows, strict=True))
        yield Field(label, (), ("", *heading), cells)
    by_length = [replace(arc, at_h=None) for arc in {arc.hours: arc for arc in arcs}.values()]
    counts = (
        (arc.name, f"{arc.span_h:.2f}", f"{arc.used:.1f}", f"{arc.rejected:.1f}", str(arc.max_rejected))
        for arc in by_length
    )
    yield Field("data", (), ("", "span, h", "used", "rejected", "at most"), counts)
    yield from _parameter_tables(by_length)


def _cells(arc: ArcSummary) -> tuple[tuple[str, ...], ...]:
    """Return the cells of an arc in the tables of errors, sigmas, coverage and NEES."""
    horizontal = arc.coverage["horizontal"]
    nees = (item for item in (arc.nees, arc.nees_horizontal, arc.nees_state) if item is not None)
    return (
        tuple(map(metres, (*arc.mean_m, *arc.rms_m, arc.radius_68_m, arc.radius_95_m))),
        (
            *map(metres, arc.sigma_m),
            *(f"{rms_m / sigma_m:.2f}" for rms_m, sigma_m in zip(arc.rms_m, arc.sigma_m, strict=True)),
            "-" if arc.from_longest_95_m is None else metres(arc.from_longest_95_m),
        ),
        (
            *(f"{100.0 * item.fraction:.1f} %" for item in arc.coverage.values()),
            f"{100.0 * horizontal.low:.1f} to {100.0 * horizontal.high:.1f} %",
        ),
        tuple(cell for x in nees for cell in (f"{x.mean:.3g}", f"{x.low:.3f} to {x.high:.3f}")),
    )


def _parameter_tables(arcs: Iterable[ArcSummary]) -> Iterator[Field]:
    """Yield tables of the first parameters, with a row for each arc, and one of all others."""
    tables: dict[str, list[tuple[str, ...]]] = {}
    for arc in arcs:
        for item in arc.parameters:
            error = "-" if item.rms_error is None else f"{item.rms_error:.3g}"
            row = (arc.name, f"{item.mean:.4g}", f"{item.std:.3g}", error, f"{item.sigma:.3g}")
            tables.setdefault(_with_unit(item.name), []).append(row)
    heading = ("mean", "std", "rms error", "sigma claimed")
    for k, (name, lines) in enumerate(list(tables.items())[:_MAX_PARAMETERS]):
        yield Field("" if k else "estimated", (), (name, *heading), lines)
    hidden = [(name, *row) for name, lines in list(tables.items())[_MAX_PARAMETERS:] for row in lines]
    yield Field("", (), ("parameter", "arc", *heading), hidden=hidden, file="montecarlo.json")


def _with_unit(identifier: str) -> str:
    kind = identifier.partition(".")[0]
    return (
        f"{parameter_name(identifier)}, {PARAMETERS[kind].unit}"
        if kind in PARAMETERS
        else parameter_name(identifier)
    )


def _status(study: MonteCarlo) -> Iterator[str]:
    failed = int((study["converged"] != 1.0).any(axis=1).sum())
    state = f"NOT CONVERGED in {failed} of the trials" if failed else "all converged"
    yield f"{study.trials} trials, {plural(len(set(study.hours)), 'arc')}: {state}"
    check = study.linearity
    if check is None:
        yield "every trial fitted in full"
        return
    size = f"{metres(check.largest_m)} m and {100.0 * check.largest_sigmas:.2g} % of sigma"
    if study.linear:
        yield f"linear model, checked by {len(check.trials)} full fits: positions and sigmas agree to {size}"
    else:
        yield f"every trial fitted in full, as the linear model differs by up to {size}"


def _notes(arc: ArcSummary) -> Iterator[str]:
    coverage, nees = arc.coverage["horizontal"], arc.nees
    statement = (
        f"{arc.name}: the claimed 95 % ellipse contains the truth in {100.0 * coverage.fraction:.1f} %"
    )
    if nees.mean > nees.high and coverage.fraction < coverage.low:
        yield (
            f"{statement}; the sigmas are too small by a factor of about {math.sqrt(nees.mean):.2g}: the fit does not "
            "model systematic or time-correlated errors"
        )
    elif nees.mean < nees.low and coverage.fraction > coverage.high:
        yield f"{statement}; the sigmas are too large"


def binomial_bounds(n: int, probability: float) -> tuple[float, float]:
    """Return the bounds, included, of the fraction of successes in n > 0 trials in 95 % of cases."""
    from scipy.special import bdtr

    cumulative = bdtr(np.arange(n + 1), n, probability)
    low, high = (int(np.searchsorted(cumulative, quantile)) for quantile in (0.025, 0.975))
    return low / n, min(high, n) / n


def _rms(values: Floats) -> float:
    return float(np.sqrt((values**2).mean()))


def _nees(values: Floats, dimension: int) -> Nees:
    from scipy.special import chdtri

    dof = dimension * len(values)
    low, high = (float(chdtri(dof, 1.0 - quantile)) / dof for quantile in (0.025, 0.975))
    return Nees(float(values.mean()) / dimension, low, high)
