"""Monte Carlo studies: many simulated realizations of a tracking plan, what their errors say, and the card of that."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.parameters.registry import PARAMETERS
from radioloc.report.cards import Card, Field, Shown, metres, plural
from radioloc.report.trial_statistics import ArcSummary, Nees, sides_of, summarize
from radioloc.tables import TableForm, as_table
from radioloc.units import ASTROPY_UNITS, unit_of

_Floats = NDArray[np.float64]
_MAX_PARAMETERS = 8
_OF_AN_ORBIT = (
    "T along, N across the orbit, R radial; hours from the state's epoch: there, in the middle and at the end"
)
_SHORT = {"along": "T", "across": "N", "radial": "R", "east": "E", "north": "N", "up": "U"}


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
class MonteCarlo(Shown):
    """The trials of a study and what they say together.

    Parameters
    ----------
    name : str
        The study's.
    seed : int
    hours, span_h : tuple of float
        Lengths of the arcs asked for and found, the longest first, h; of an orbit each three times.
    columns : tuple of str
        What is known of each trial and arc.
    values : ndarray, shape (trials, arcs, columns)
        NaN where an arc has no such number.
    linear : bool
        Whether the trials are those of the linear model, or full fits.
    proof : Proof or None
        How the linear model was proved; None where there could be none.
    drawn : tuple of str
        Quantities that departed by lot.
    at_h : tuple of float
        Of an orbit when its position is compared with the truth, from the state's epoch, for each of `hours`: at the
        epoch, in the middle and at the end of the tracking. Else empty.
    """

    name: str
    seed: int
    hours: tuple[float, ...]
    span_h: tuple[float, ...]
    columns: tuple[str, ...]
    values: _Floats
    linear: bool
    proof: Proof | None
    drawn: tuple[str, ...]
    at_h: tuple[float, ...] = ()

    def __getitem__(self, column: str) -> _Floats:
        """One column of all trials and arcs, shape (trials, arcs).

        Raises
        ------
        InputError
            There is no such column.
        """
        if column not in self.columns:
            raise InputError(f"there is no column {column!r}; there are {', '.join(self.columns)}")
        return np.asarray(self.values[..., self.columns.index(column)])

    @property
    def trials(self) -> int:
        """Number of trials."""
        return len(self.values)

    @property
    def converged(self) -> bool:
        """Whether all arcs of all trials did."""
        return bool((self["converged"] == 1.0).all())

    @property
    def errors_m(self) -> _Floats:
        """Position less truth by the axes, shape (trials, arcs, 3)."""
        return np.stack([self[f"{side}_m"] for side in self.sides], axis=-1)

    @property
    def sigmas_m(self) -> _Floats:
        """Claimed sigmas of the position by the axes, shape (trials, arcs, 3)."""
        return np.stack([self[f"sigma_{side}_m"] for side in self.sides], axis=-1)

    @property
    def sides(self) -> tuple[str, ...]:
        """The axes: east, north and up, or of an orbit along, across and radial."""
        return sides_of(self.columns)

    @property
    def arcs(self) -> tuple[ArcSummary | None, ...]:
        """What the trials of each arc say together, the longest first; None where none converged."""
        epochs = self.hours.count(self.hours[0])  # of an orbit several
        return tuple(
            summarize(
                length,
                span,
                self.columns,
                self.values[:, k],
                self.values[:, k % epochs] if k >= epochs else None,
                self.at_h[k] if self.at_h else None,
            )
            for k, (length, span) in enumerate(zip(self.hours, self.span_h, strict=True))
        )

    def to_dict(self) -> dict[str, Any]:
        """All numbers but the single trials, in types that JSON has."""
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
        """All that is known of the trials by name, one row for each trial and arc."""
        n, arcs, _ = self.values.shape
        columns = {"trial": np.repeat(np.arange(n), arcs), "hours": np.tile(self.hours, n)}
        if self.at_h:
            columns["at_h"] = np.tile(self.at_h, n)
        return columns | dict(zip(self.columns, self.values.reshape(n * arcs, -1).T, strict=True))

    def to_table(self, form: TableForm = "astropy") -> Any:
        """All trials as a ``QTable`` of astropy, with units, or a ``DataFrame``, one row for each trial and arc.

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
    """What the trials of each arc say together, as tables with a row for each arc."""

    def table(label: str, heading: tuple[str, ...], cells: Callable[[ArcSummary], Iterable[str]]) -> Field:
        return Field(label, (), ("", *heading), ((arc.name, *cells(arc)) for arc in arcs))

    places = list(arcs[0].inside)
    first, *others = (_SHORT[place] for place in places[:3])
    yield table(
        "error, m",
        (f"mean {first}", *others, f"rms {first}", *others, "68 %", "95 %"),
        lambda arc: map(metres, (*arc.mean_m, *arc.rms_m, arc.radius_68_m, arc.radius_95_m)),
    )
    yield table(
        "1 sigma, m",
        (f"claimed {first}", *others, f"rms/sigma {first}", *others, f"95 % from {arcs[0].hours:g} h"),
        lambda arc: (
            *map(metres, arc.sigma_m),
            *(f"{r / s:.2f}" for r, s in zip(arc.rms_m, arc.sigma_m, strict=True)),
            "-" if arc.from_longest_95_m is None else metres(arc.from_longest_95_m),
        ),
    )
    yield table(
        "inside 95 %",
        (*places, "expected"),
        lambda arc: (
            *(f"{100.0 * inside.fraction:.1f} %" for inside in arc.inside.values()),
            f"{100.0 * arc.inside['horizontal'].low:.1f} to {100.0 * arc.inside['horizontal'].high:.1f} %",
        ),
    )
    yield table(
        "nees",
        (
            "in space",
            "expected",
            "horizontal",
            "expected",
            *(["state", "expected"] if "state" in places else []),
        ),
        lambda arc: (
            *_nees(arc.nees),
            *_nees(arc.nees_horizontal),
            *(() if arc.nees_state is None else _nees(arc.nees_state)),
        ),
    )
    once = [replace(arc, at_h=None) for arc in {arc.hours: arc for arc in arcs}.values()]
    rows = (
        (arc.name, f"{arc.span_h:.2f}", f"{arc.used:.1f}", f"{arc.rejected:.1f}", str(arc.rejected_most))
        for arc in once
    )
    yield Field("data", (), ("", "span, h", "used", "left out", "at most"), rows)
    found: dict[str, list[tuple[str, ...]]] = {}
    for arc in once:
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


def _nees(nees: Nees) -> tuple[str, str]:
    return f"{nees.mean:.3g}", f"{nees.low:.3f} to {nees.high:.3f}"


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
