"""The observation model of an arc: from a vector of parameters to residuals and the rows of the design matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics import AdjustableOrbit
from radioloc.dynamics.stochastic import StochasticAccelerations
from radioloc.measurements.combined_predictor import CombinedPrediction
from radioloc.measurements.predictor import ROWS_AT_ONCE, Prediction, Predictor
from radioloc.measurements.target_motion import Motions, OrbitMotion
from radioloc.parameters.columns import Columns
from radioloc.parameters.parameter import Parameter, ParameterSet
from radioloc.parameters.rows import ObservationRows, middle_of
from radioloc.targets.target import Target
from radioloc.time import Epochs
from radioloc.vectors import Floats

Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class ObservationModel:
    """What is solved for in an arc, and how the observations follow from it."""

    predictor: Predictor
    parameters: (
        ParameterSet  # three for the position of each target, or those of its orbit, then kind by kind
    )
    targets: tuple[Target, ...]
    columns: tuple[Columns, ...]  # of the kinds of parameter
    reference: Epochs | None = None  # epoch that rates refer to, TAI; the middle of the arc as a rule
    process: StochasticAccelerations | None = None  # of the orbit
    considered_kinds: int = 0  # number of kinds, the last, whose parameters are considered
    # Partials by these for a long arc, (c, n): they change by parts of 1e-4 while the estimate moves by kilometres.
    kept: list[NDArray[np.float32]] = field(default_factory=list, compare=False, repr=False)

    @classmethod
    def of(
        cls,
        predictor: Predictor,
        targets: Sequence[Target],
        kinds: Sequence[tuple[Columns, list[Parameter]]],
    ) -> ObservationModel:
        """Put targets and kinds of parameter together."""
        parameters = [parameter for target in targets for parameter in target.parameters]
        parameters += [parameter for _, found in kinds for parameter in found]
        return cls(
            predictor,
            ParameterSet(parameters),
            tuple(targets),
            tuple(columns for columns, _ in kinds),
            middle_of(predictor.observations) if len(predictor.observations) else None,
        )

    @property
    def place_indices(self) -> list[int]:
        """Indices of the targets that are, or come to rest, at a place on the Moon."""
        return [k for k, target in enumerate(self.targets) if target.has_place]

    @property
    def orbit_indices(self) -> list[int]:
        """Indices of the targets that move by forces."""
        return [k for k, target in enumerate(self.targets) if target.orbit is not None]

    @property
    def orbit_index(self) -> int | None:
        """Index of the first target that moves by forces; None without any."""
        return next(iter(self.orbit_indices), None)

    @property
    def orbit(self) -> AdjustableOrbit | None:
        """A-priori orbit of the first target that moves by forces; None without any."""
        k = self.orbit_index
        return None if k is None else self.targets[k].orbit

    def orbit_at(self, x: Floats) -> AdjustableOrbit | None:
        """Return the orbit of the first target that moves by forces at parameters x; None without any."""
        k = self.orbit_index
        return None if k is None else self.targets[k].orbit_at(x[self.columns_of(k)])

    @property
    def of_orbit(self) -> bool:
        """Whether a target moves by forces."""
        return bool(self.orbit_indices)

    def with_orbit(self, orbit: AdjustableOrbit) -> ObservationModel:
        """Return the model with another a-priori orbit of the same parameters for the first target that has one."""
        targets, k = list(self.targets), self.orbit_indices[0]
        targets[k] = targets[k].with_orbit(orbit)
        return replace(self, targets=tuple(targets))

    def effects_on_orbit(self, orbit: AdjustableOrbit, target: int | None = None) -> Floats:
        """Return the partials of all observations by the parameters of a target's orbit, or by its errors, (n, k)."""
        k, motions = self.orbit_indices[0] if target is None else target, list(self.predictor.motions)
        motions[k] = OrbitMotion(orbit)
        by_motion = self.predictor.compute(motions).by_motion
        return by_motion[:, self.motion_columns_of(k, by_motion.shape[1])]

    def motion_columns_of(self, target: int, count: int | None = None) -> slice:
        """Return the columns of a target among the partials by all motions, of which there may be another `count`."""
        x = self.parameters.prior_values
        sizes = [len(item.motion(x[self.columns_of(k)])[1]) for k, item in enumerate(self.targets)]
        begin, after = sum(sizes[:target]), sum(sizes[target + 1 :])
        return slice(begin, (sum(sizes) if count is None else count) - after)

    @property
    def first(self) -> int:
        """Index of the first parameter that is of no target."""
        return sum(len(target.parameters) for target in self.targets)

    def columns_of(self, target: int) -> slice:
        """Parameters on which the motion of a target depends."""
        begin = sum(len(other.parameters) for other in self.targets[:target])
        mine = self.targets[target]
        return slice(begin - mine.preceding, begin + len(mine.parameters))

    def position_pa_m(self, x: Floats, target: int = 0) -> Floats:
        """Position of a target at parameters x, principal axes, m, shape (3,); zeros on a trajectory without end."""
        return self.targets[target].position(x[self.columns_of(target)])[0]

    def position_partials(self, x: Floats, target: int = 0) -> Floats:
        """d(position of a target)/d(parameters), shape (3, p); zeros on a trajectory without end."""
        partials, mine = np.zeros((3, len(self.parameters))), self.columns_of(target)
        partials[:, mine] = self.targets[target].position(x[mine])[1]
        return partials

    def motions(self, x: Floats) -> Motions:
        """Motions of the targets at parameters x."""
        return tuple(target.motion(x[self.columns_of(k)])[0] for k, target in enumerate(self.targets))

    def linearize(self, x: Floats) -> DesignMatrix:
        """Residuals of all observations, and the design matrix of those asked for, at parameters x."""
        motions = self.motions(x)
        at = self.predictor.at(motions)
        residual_m = self.predictor.observations.value_m - at.value_m
        if self.process is not None:
            residual_m += self.process.effects_m(self.process.reference)
        here = DesignMatrix(self, at, motions, x, residual_m)
        first = self.first
        if x[first:].any():
            for start in range(0, len(residual_m), ROWS_AT_ONCE):
                rows = np.arange(start, min(start + ROWS_AT_ONCE, len(residual_m)))
                residual_m[rows] -= here.partials(rows, of_kinds_only=True) @ x[first:]
        residual_m.flags.writeable = False
        return here

    def residuals(self, x: Floats) -> tuple[Floats, Floats]:
        """Observed minus computed (n,), m, and partials of the computed (n, p), all at once."""
        here = self.linearize(x)
        return here.residual_m, here.partials(np.arange(len(here.residual_m)))


@dataclass(frozen=True, slots=True, eq=False)
class DesignMatrix:
    """An observation model linearized at parameters x, whose rows are computed when asked for."""

    model: ObservationModel
    at: Prediction
    motions: Motions
    x: Floats
    residual_m: Floats  # observed - computed, of an orbit without its stochastic accelerations

    @property
    def process(self) -> StochasticAccelerations | None:
        """The orbit's stochastic accelerations."""
        return self.model.process

    def partials(self, rows: Rows, *, of_kinds_only: bool = False) -> Floats:
        """d(computed)/d(parameter) of some observations, shape (m, p); or those by all but the positions."""
        columns = partial(self._simple, first=0 if of_kinds_only else len(self.model.targets))
        if isinstance(self.at, CombinedPrediction):
            return self.at.combine(rows, columns)
        if self.model.considered_kinds and not self.model.kept and len(self.residual_m) > ROWS_AT_ONCE:
            self.model.kept.append(self._of_considered())
        return columns(rows, self.at, self.model.predictor)

    def _simple(self, rows: Rows, at: Prediction, predictor: Predictor, first: int) -> Floats:
        """Partials of observations that are not combined, by the first motions and all kinds of parameter."""
        model = self.model
        part = ObservationRows(predictor, rows, model.reference, at, self.motions)
        start = model.first if first else 0
        # Column by column in memory, as the factorization reads them.
        out = np.zeros((start + sum(map(len, model.columns)), len(rows))).T
        begin = 0
        for k, target in enumerate(model.targets[:first]):
            mine = model.columns_of(k)
            by_x = target.motion(self.x[mine])[1]
            end = begin + len(by_x)
            out[:, mine] += part.computed.by_motion[:, begin:end] @ by_x
            begin = end
        kinds = model.columns[: len(model.columns) - model.considered_kinds] if model.kept else model.columns
        for columns in kinds:
            columns.design(part, out[:, start : start + len(columns)])
            start += len(columns)
        if model.kept:
            # A slice is copied several times as fast as rows that are picked.
            contiguous = len(rows) > 0 and bool((np.diff(rows) == 1).all())
            out[:, start:] = model.kept[0][:, slice(rows[0], rows[-1] + 1) if contiguous else rows].T
        return out

    def _of_considered(self) -> NDArray[np.float32]:
        """Partials of all observations by the considered parameters, shape (c, n)."""
        model, n = self.model, len(self.residual_m)
        kinds = model.columns[len(model.columns) - model.considered_kinds :]
        out = np.empty((sum(map(len, kinds)), n), dtype=np.float32)
        for first in range(0, n, ROWS_AT_ONCE):
            rows = np.arange(first, min(first + ROWS_AT_ONCE, n))
            part = ObservationRows(model.predictor, rows, model.reference, self.at, self.motions)
            out[:, rows] = np.hstack([columns.design(part) for columns in kinds]).T
        return out


def orbits_of(predictor: Predictor) -> list[AdjustableOrbit]:
    """Return the a-priori orbits that a predictor was prepared with."""
    return [motion.adjustable for motion in predictor.motions if motion.adjustable is not None]  # type: ignore[misc]


def orbit_of(predictor: Predictor) -> AdjustableOrbit | None:
    """Return the first a-priori orbit that a predictor was prepared with; None without any."""
    return next(iter(orbits_of(predictor)), None)
