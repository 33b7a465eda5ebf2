"""Monte Carlo studies: simulated realizations of a tracking plan, statistics of their errors, and their card."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.parameters.registry import PARAMETERS
from radioloc.results.cards import Card, Field, metres, plural
from radioloc.results.result import Content, Result, Table
from radioloc.tables import TableForm, as_table
from radioloc.targets.orbit_state import ALONG_ACROSS_RADIAL, EAST_NORTH_UP
from radioloc.units import ASTROPY_UNITS, unit_of
from radioloc.vectors import Floats

_MAX_PARAMETERS = 8
NORMAL_95, CHI2_2_95, CHI2_6_95 = 1.959963984540054, 5.991464547107979, 12.591587243743977
"""Quantile of 97.5 % of the normal distribution; of 95 % of chi-square of two and of six degrees of freedom."""
_OF_AN_ORBIT = (
    "T along, N across the orbit, R radial; hours from the state's epoch: there, in the middle and at the end"
)
_SHORT = {"along": "T", "across": "N", "radial": "R", "east": "E", "north": "N", "up": "U"}


def sides_of(columns: Sequence[str]) -> tuple[str, ...]:
    """Axes of the errors that results have: of a place, or of an orbit."""
    return EAST_NORTH_UP if "east_m" in columns else ALONG_ACROSS_RADIAL


@dataclass(frozen=True, slots=True)
class Inside:
    """Trials with the truth inside a claimed interval of 95 %; `low` to `high` is expected of the fraction in 95 %."""

    count: int
    trials: int
    low: float
    high: float

    @property
    def fraction(self) -> float:
        """Part of the trials."""
        return self.count / self.trials


@dataclass(frozen=True, slots=True)
class Nees:
    """Normalized estimation error squared over its dimension, mean over trials; `low` to `high` is expected in 95 %."""

    # error' covariance^-1 error; 1 is expected if the claimed covariance is right.
    mean: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class ParameterSummary:
    """Mean and standard deviation of a parameter's estimates, rms of their errors, median of the claimed sigma."""

    name: str
    mean: float
    std: float
    rms_error: float | None  # None where the truth of the parameter is not known
    sigma: float


@dataclass(frozen=True, slots=True)
class ArcSummary:
    """One arc's trials; statistics are of those that converged."""

    hours: float
    span_h: float
    trials: int
    converged: int
    mean_m: tuple[
        float, ...
    ]  # position less truth by the axes, as the next two; the claimed sigma is the median
    rms_m: tuple[float, ...]
    sigma_m: tuple[float, ...]
    rms_horizontal_m: float
    radius_68_m: float  # horizontal distance from the truth that 68 % are within; of 95 % likewise
    radius_95_m: float
    # By the axes: the claimed interval of 95 %; horizontal: the claimed ellipse of 95 %; of an orbit also the state.
    inside: dict[str, Inside]
    nees: Nees  # of the position in space; of that on the sphere the next
    nees_horizontal: Nees
    used: float  # mean number of observations that took part; of those that did not the mean and the largest
    rejected: float
    rejected_most: int
    # Horizontal distance from the longest arc's position that 95 % are within; None for that itself.
    from_longest_95_m: float | None
    parameters: tuple[ParameterSummary, ...]
    at_h: float | None = None  # of an orbit when its position is compared, from the state's epoch
    nees_state: Nees | None = None  # of an orbit's position and velocity

    @property
    def name(self) -> str:
        """Length as text, such as ``12 h``, and of an orbit when."""
        return f"{self.hours:g} h" + ("" if self.at_h is None else f" at {self.at_h:.1f} h")


@dataclass(frozen=True, slots=True)
class Proof:
    """Trials that were fitted both ways: those farthest from where the model was linearized, then some at random."""

    trials: tuple[int, ...]
    largest_m: float  # largest difference of a position east, north or up
    # The same in parts of the sigma claimed; of sigmas themselves, by how much they differ, if that is more.
    largest_sigmas: float
    # All differences are within 1 mm or 1 % of sigma, whichever is larger, and all sigmas within 2 %.
    passed: bool


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarlo(Result):
    """Trials of a study and their statistics.

    Parameters
    ----------
    name : str
        The study's.
    seed : int
    hours, span_h : tuple of float
        Lengths of the arcs asked for and found, the longest first, h; of an orbit each three times.
    columns : tuple of str
        Names of the numbers of each trial and arc.
    values : ndarray, shape (trials, arcs, columns)
        NaN where an arc has no such number.
    linear : bool
        Whether the trials are those of the linear model, or full fits.
    proof : Proof or None
        Test of the linear model against full fits; None where it was not possible.
    drawn : tuple of str
        Parameters drawn at random.
    at_h : tuple of float
        Of an orbit when its position is compared with the truth, from the state's epoch, for each of `hours`: at the
        epoch, in the middle and at the end of the tracking. Else empty.
    """

    name: str
    seed: int
    hours: tuple[float, ...]
    span_h: tuple[float, ...]
    columns: tuple[str, ...]
    values: Floats
    linear: bool
    proof: Proof | None
    drawn: tuple[str, ...]
    at_h: tuple[float, ...] = ()

    def __getitem__(self, column: str) -> Floats:
        """One column of all trials and arcs, shape (trials, arcs).

        Raises
        ------
        InputError
            There is no such column.
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
        """The axes: east, north and up, or of an orbit along, across and radial."""
        return sides_of(self.columns)

    @property
    def arcs(self) -> tuple[ArcSummary | None, ...]:
        """Statistics of each arc's trials, the longest first; None where none converged."""
        return tuple(map(self._arc, range(len(self.hours))))

    def _arc(self, k: int) -> ArcSummary | None:
        good = self["converged"][:, k] == 1.0
        n = int(good.sum())
        if not n:
            return None
        sides = self.sides
        found = dict(zip(self.columns, self.values[good, k].T, strict=True))
        error_m, sigma_m = self.errors_m[good, k], self.sigmas_m[good, k]
        horizontal_m = np.hypot(error_m[:, 0], error_m[:, 1])
        held = np.abs(error_m) <= NORMAL_95 * sigma_m
        counts = dict(zip(sides, held.sum(axis=0).tolist(), strict=True))
        counts["horizontal"] = int((found["nees_horizontal"] <= CHI2_2_95).sum())
        if self.at_h:
            counts["state"] = int((found["nees_state"] <= CHI2_6_95).sum())
        low, high = binomial_bounds(n, 0.95)
        apart = None
        epochs = self.hours.count(self.hours[0])  # of an orbit several
        both = good & (self["converged"][:, k % epochs] == 1.0)
        if k >= epochs and both.any():
            moved_m = (self.errors_m[:, k] - self.errors_m[:, k % epochs])[both]
            apart = float(np.quantile(np.hypot(moved_m[:, 0], moved_m[:, 1]), 0.95))
        parameters = (
            ParameterSummary(
                name,
                float(found[name].mean()),
                float(found[name].std()),
                _rms(found[f"{name}.error"]) if f"{name}.error" in found else None,
                float(np.median(found[f"{name}.sigma"])),
            )
            for name in self.columns
            # NaN in an arc without observations that the parameter acts on.
            if f"{name}.sigma" in found and not np.isnan(found[name]).any()
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
            inside={key: Inside(count, n, low, high) for key, count in counts.items()},
            nees=_nees(found["nees"], 3),
            nees_horizontal=_nees(found["nees_horizontal"], 2),
            used=float(found["used"].mean()),
            rejected=float(found["rejected"].mean()),
            rejected_most=int(found["rejected"].max()),
            from_longest_95_m=apart,
            parameters=tuple(parameters),
            at_h=self.at_h[k] if self.at_h else None,
            nees_state=_nees(found["nees_state"], 6) if self.at_h else None,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers but the single trials, in types that JSON has."""
        proof = self.proof
        return {
            "name": self.name,
            "seed": self.seed,
            "trials": self.trials,
            "converged": self.converged,
            "drawn": ["noise", *self.drawn],
            "linear": self.linear,
            "proof": None if proof is None else asdict(proof) | {"trials": list(proof.trials)},
            "arcs": [
                {"hours": hours, "converged": 0} if arc is None else asdict(arc)
                for hours, arc in zip(self.hours, self.arcs, strict=True)
            ],
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
            else unit_of(kind)
            for name, kind in kinds.items()
        }
        return as_table(columns, form, units)

    def files(self) -> Mapping[str, Content]:
        """Return the statistics, and a table with a row for each trial and arc."""
        return {"montecarlo.json": self.to_dict(), "trials.csv": Table(self.columns_of_trials())}

    def card(self) -> Card:
        """Card of the study."""
        arcs = [arc for arc in self.arcs if arc is not None]
        return Card(
            (
                Field("monte carlo", (self.name,)),
                Field("status", _status(self)),
                Field("drawn", (f"{', '.join(['noise', *self.drawn])}; seed {self.seed}",)),
                Field("axes", (_OF_AN_ORBIT,) if self.at_h else ()),
                *(_tables(arcs) if arcs else ()),
                Field("notes", (note for arc in arcs for note in _notes(arc))),
            )
        )

    def __repr__(self) -> str:
        hours = ", ".join(f"{length:g}" for length in self.hours)
        return f"<MonteCarlo {self.name}: {self.trials} trials of {hours} h>"


def _tables(arcs: list[ArcSummary]) -> Iterator[Field]:
    """Yield the statistics of each arc's trials as tables with a row for each arc."""
    places = list(arcs[0].inside)
    first, *others = (_SHORT[place] for place in places[:3])
    moved = f"95 % from {arcs[0].hours:g} h"
    headings = {
        "error, m": (f"mean {first}", *others, f"rms {first}", *others, "68 %", "95 %"),
        "1 sigma, m": (f"claimed {first}", *others, f"rms/sigma {first}", *others, moved),
        "inside 95 %": (*places, "expected"),
        "nees": (
            "in space",
            "expected",
            "horizontal",
            "expected",
            *("state", "expected") * ("state" in places),
        ),
    }
    for (label, heading), rows in zip(headings.items(), zip(*map(_cells, arcs), strict=True), strict=True):
        named = ((arc.name, *row) for arc, row in zip(arcs, rows, strict=True))
        yield Field(label, (), ("", *heading), named)
    once = [replace(arc, at_h=None) for arc in {arc.hours: arc for arc in arcs}.values()]
    counts = (
        (arc.name, f"{arc.span_h:.2f}", f"{arc.used:.1f}", f"{arc.rejected:.1f}", str(arc.rejected_most))
        for arc in once
    )
    yield Field("data", (), ("", "span, h", "used", "left out", "at most"), counts)
    yield from _parameter_tables(once)


def _cells(arc: ArcSummary) -> tuple[tuple[str, ...], ...]:
    """Cells of one arc in the tables of errors, of sigmas, of intervals and of NEES."""
    horizontal = arc.inside["horizontal"]
    nees = (item for item in (arc.nees, arc.nees_horizontal, arc.nees_state) if item is not None)
    return (
        tuple(map(metres, (*arc.mean_m, *arc.rms_m, arc.radius_68_m, arc.radius_95_m))),
        (
            *map(metres, arc.sigma_m),
            *(f"{rms_m / sigma_m:.2f}" for rms_m, sigma_m in zip(arc.rms_m, arc.sigma_m, strict=True)),
            "-" if arc.from_longest_95_m is None else metres(arc.from_longest_95_m),
        ),
        (
            *(f"{100.0 * inside.fraction:.1f} %" for inside in arc.inside.values()),
            f"{100.0 * horizontal.low:.1f} to {100.0 * horizontal.high:.1f} %",
        ),
        tuple(cell for x in nees for cell in (f"{x.mean:.3g}", f"{x.low:.3f} to {x.high:.3f}")),
    )


def _parameter_tables(arcs: Iterable[ArcSummary]) -> Iterator[Field]:
    """Yield a table of each parameter with a row for each arc; of many the first."""
    found: dict[str, list[tuple[str, ...]]] = {}
    for arc in arcs:
        for item in arc.parameters:
            error = "-" if item.rms_error is None else f"{item.rms_error:.3g}"
            row = (arc.name, f"{item.mean:.4g}", f"{item.std:.3g}", error, f"{item.sigma:.3g}")
            found.setdefault(item.name, []).append(row)
    heading = ("mean", "std", "rms error", "sigma claimed")
    for k, (name, lines) in enumerate(list(found.items())[:_MAX_PARAMETERS]):
        yield Field("" if k else "estimated", (), (name, *heading), lines)
    rest = [(name, *row) for name, lines in list(found.items())[_MAX_PARAMETERS:] for row in lines]
    yield Field("", (), ("parameter", "arc", *heading), rest=rest, where="montecarlo.json")


def _status(study: MonteCarlo) -> Iterator[str]:
    lost = int((study["converged"] != 1.0).any(axis=1).sum())
    state = f"NOT CONVERGED in {lost} of the trials" if lost else "all converged"
    yield f"{study.trials} trials, {plural(len(set(study.hours)), 'arc')}: {state}"
    proof = study.proof
    if proof is None:
        yield "every trial fitted in full"
        return
    off_m, off_percent = metres(proof.largest_m), f"{100.0 * proof.largest_sigmas:.2g} % of sigma"
    if study.linear:
        checked = f"linear model, checked by {len(proof.trials)} full fits: positions and sigmas agree to"
        yield f"{checked} {off_m} m and {off_percent}"
    else:
        yield f"every trial fitted in full: the linear model is off by up to {off_m} m, {off_percent}"


def _notes(arc: ArcSummary) -> Iterator[str]:
    inside, nees = arc.inside["horizontal"], arc.nees
    holds = f"{arc.name}: the claimed 95 % ellipse holds the truth in {100.0 * inside.fraction:.1f} %"
    if nees.mean > nees.high and inside.fraction < inside.low:
        yield (
            f"{holds}; the sigmas are too small by a factor of about {math.sqrt(nees.mean):.2g}: there are systematic "
            "or time-correlated errors that the fit does not model"
        )
    elif nees.mean < nees.low and inside.fraction > inside.high:
        yield f"{holds}; the sigmas are too large"


def binomial_bounds(n: int, probability: float) -> tuple[float, float]:
    """Fractions that the successes in n > 0 trials lie within in 95 % of cases, both ends included."""
    from scipy.special import bdtr

    below = bdtr(np.arange(n + 1), n, probability)
    low, high = (int(np.searchsorted(below, quantile)) for quantile in (0.025, 0.975))
    return low / n, min(high, n) / n


def _rms(values: Floats) -> float:
    return float(np.sqrt((values**2).mean()))


def _nees(values: Floats, dimension: int) -> Nees:
    from scipy.special import chdtri

    dof = dimension * len(values)
    low, high = (float(chdtri(dof, 1.0 - quantile)) / dof for quantile in (0.025, 0.975))
    return Nees(float(values.mean()) / dimension, low, high)
