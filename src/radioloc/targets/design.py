"""The observation model of an arc: from a vector of parameters to residuals and the rows of the design matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from radioloc.dynamics import AdjustableOrbit
from radioloc.dynamics.stochastic import StochasticAccelerations
from radioloc.estimation.smooth_partials import Cells, SmoothPartials
from radioloc.lunar import rot_pa_to_me
from radioloc.measurements.combined_predictor import CombinedPrediction
from radioloc.measurements.predictor import Prediction, Predictor
from radioloc.measurements.target_motion import Motions, OrbitMotion, TargetMotion, TrajectoryMotion
from radioloc.noise.whitening import slices
from radioloc.parameters.columns import Columns
from radioloc.parameters.parameter import Parameter, ParameterSet, Role
from radioloc.parameters.rows import ObservationRows, elapsed_s, middle_epoch
from radioloc.targets.target import Target
from radioloc.time import Epochs
from radioloc.vectors import Floats, Indices

Rows = Indices

_MAX_KEPT_ELEMENTS = 2**20  # of partials that are computed once for each linearization, 8 MB
_MIN_SMOOTH_ROWS = 2**16  # of an arc whose partials are polynomials of time: fewer take little time


@dataclass(frozen=True, slots=True)
class ObservationModel:
    """Parameters of an arc, and the observations as a function of them."""

    predictor: Predictor
    # Three for the position of each target, or those of its orbit, then kind by kind.
    parameters: ParameterSet
    targets: tuple[Target, ...]
    columns: tuple[Columns, ...]  # of the kinds of parameter
    rows: ObservationRows = field(compare=False, repr=False)  # before they are combined, without a prediction
    processes: tuple[StochasticAccelerations, ...] = ()  # of each orbit that has some
    considered_kind_count: int = 0  # number of kinds, the last, whose parameters are considered

    @classmethod
    def from_targets(
        cls,
        predictor: Predictor,
        targets: Sequence[Target],
        kinds: Sequence[tuple[Columns, list[Parameter]]],
        reference: Epochs | None = None,
    ) -> ObservationModel:
        """Put targets and kinds of parameter together; rates refer to an epoch, TAI, or to the middle of the arc."""
        parameters = [parameter for target in targets for parameter in target.parameters]
        parameters += [parameter for _, items in kinds for parameter in items]
        if reference is None and len(predictor.observations):
            reference = middle_epoch(predictor.observations)
        return cls(
            predictor,
            ParameterSet(parameters),
            tuple(targets),
            tuple(columns for columns, _ in kinds),
            ObservationRows(predictor.uncombined, reference=reference),
        )

    @property
    def estimated_kinds(self) -> int:
        """Number of kinds, the first, whose parameters are not considered."""
        return len(self.columns) - self.considered_kind_count

    @property
    def estimated_indices(self) -> list[int]:
        """Indices of the targets with estimated parameters."""
        return [
            k
            for k, target in enumerate(self.targets)
            if any(item.role is Role.ESTIMATED for item in target.parameters)
        ]

    @property
    def place_indices(self) -> list[int]:
        """Indices of the targets that are, or come to rest, at a place on the Moon."""
        return [k for k, target in enumerate(self.targets) if target.has_place]

    @property
    def orbit_indices(self) -> list[int]:
        """Indices of the targets that move by forces."""
        return [k for k, target in enumerate(self.targets) if target.orbit is not None]

    def with_orbit(self, orbit: AdjustableOrbit, target: int) -> ObservationModel:
        """Return the model with another a-priori orbit of a target."""
        targets = list(self.targets)
        targets[target] = targets[target].with_orbit(orbit)
        return replace(self, targets=tuple(targets))

    def motion_columns_of(self, target: int) -> slice:
        """Return the columns of a target among the partials with respect to all motions."""
        x = self.parameters.prior_values
        sizes = [len(item.motion(x[self.columns_of(k)])[1]) for k, item in enumerate(self.targets)]
        return slice(sum(sizes[:target]), sum(sizes[: target + 1]))

    @property
    def first(self) -> int:
        """Index of the first parameter that is of no target."""
        return sum(len(target.parameters) for target in self.targets)

    def columns_of(self, target: int) -> slice:
        """Parameters on which the motion of a target depends."""
        begin = sum(len(preceding.parameters) for preceding in self.targets[:target])
        item = self.targets[target]
        return slice(begin - item.preceding, begin + len(item.parameters))

    def position_pa_m(self, x: Floats, target: int = 0) -> Floats:
        """Position of a target at parameters x, principal axes, m, shape (3,); zeros on a trajectory without end."""
        return self.targets[target].position(x[self.columns_of(target)])[0]

    def position_partials(self, x: Floats, target: int = 0) -> Floats:
        """d(position of a target)/d(parameters), shape (3, p); zeros on a trajectory without end."""
        partials, columns = np.zeros((3, len(self.parameters))), self.columns_of(target)
        partials[:, columns] = self.targets[target].position(x[columns])[1]
        return partials

    def local_partials(self, x: Floats, tdb: Epochs, target: int = 0) -> Floats:
        """Return d(position or state of a target along its axes)/d(all parameters), (q, d, p)."""
        columns, rot = self.columns_of(target), rot_pa_to_me(self.predictor.model.ephemeris.constants)
        by_x = self.targets[target].local_partials(x[columns], tdb, rot)
        partials = np.zeros((*by_x.shape[:2], len(self.parameters)))
        partials[..., columns] = by_x
        return partials

    def motions(self, x: Floats) -> Motions:
        """Motions of the targets at parameters x."""
        return tuple(target.motion(x[self.columns_of(k)])[0] for k, target in enumerate(self.targets))

    def linearize(self, x: Floats) -> DesignMatrix:
        """Residuals of all observations, and the design matrix of those asked for, at parameters x."""
        motions = self.motions(x)
        prediction = self.predictor.predict(motions)
        residual_m = self.predictor.observations.value_m - prediction.value_m
        for process in self.processes:
            residual_m += process.effects_m(process.reference)
        design = DesignMatrix(self, prediction, motions, x, residual_m)
        n, first = len(residual_m), self.first
        if n * len(x) <= _MAX_KEPT_ELEMENTS:
            design = replace(design, all_partials=design.partials(np.arange(n)))
        elif n >= _MIN_SMOOTH_ROWS and not self.processes:
            design = replace(design, smooth=self._smooth(design))
        if x[first:].any():
            of_kinds = np.append(np.zeros(first), x[first:])[:, None]
            effects = None if design.smooth is None else design.smooth.combined(of_kinds)
            for part in slices(n):
                rows = np.arange(part.start, min(part.stop, n))
                if effects is None:
                    residual_m[part] -= design.partials(rows, of_kinds_only=True) @ x[first:]
                else:
                    residual_m[part] -= effects(rows)[:, 0]
        residual_m.flags.writeable = False
        return design

    def _smooth(self, design: DesignMatrix) -> SmoothPartials | None:
        """Return the partials of a long arc as polynomials; None of combined or sparse observations."""
        if isinstance(design.prediction, CombinedPrediction):
            return None
        cells = self.rows.evaluate(_cells)
        return SmoothPartials.from_nodes(cells, design.partials) if len(cells.nodes) else None

    def residuals(self, x: Floats) -> tuple[Floats, Floats]:
        """Observed minus computed (n,), m, and partials of the computed (n, p), all at once."""
        design = self.linearize(x)
        return design.residual_m, design.partials(np.arange(len(design.residual_m)))


@dataclass(frozen=True, slots=True, eq=False)
class DesignMatrix:
    """An observation model linearized at parameters x, whose rows are computed when asked for."""

    model: ObservationModel
    prediction: Prediction
    motions: Motions
    x: Floats
    residual_m: Floats  # observed - computed, of orbits without their stochastic accelerations
    smooth: SmoothPartials | None = None  # of a long arc
    all_partials: Floats | None = None  # partials of all observations of a short arc

    @property
    def processes(self) -> tuple[StochasticAccelerations, ...]:
        """Stochastic accelerations of the orbits."""
        return self.model.processes

    def partials(self, rows: Rows, *, of_kinds_only: bool = False) -> Floats:
        """d(computed)/d(parameter) of some observations, shape (m, p); or those by all but the positions."""
        if of_kinds_only:
            return self._partials(rows, 0, len(self.model.columns))
        return self._partials(rows, len(self.model.targets), len(self.model.columns))

    def estimated_partials(self, rows: Rows) -> Floats:
        """Return the partials with respect to all parameters but the considered ones, the last, shape (m, p - c)."""
        return self._partials(rows, len(self.model.targets), self.model.estimated_kinds)

    def _partials(self, rows: Rows, targets: int, kinds: int) -> Floats:
        """Return partials with respect to the first targets and kinds of parameter."""
        if self.all_partials is not None:
            first = 0 if targets else self.model.first
            last = self.model.first + sum(map(len, self.model.columns[:kinds]))
            return self.all_partials.T[first:last].take(rows, axis=1).T
        columns = partial(self._simple, first=targets, kinds=self.model.columns[:kinds])
        if isinstance(self.prediction, CombinedPrediction):
            return self.prediction.combine(rows, columns)
        return columns(rows, self.prediction)

    def _simple(self, rows: Rows, prediction: Prediction, first: int, kinds: Sequence[Columns]) -> Floats:
        """Return partials of observations that are not combined, by the first motions and some kinds of parameter."""
        model = self.model
        part = model.rows.predicted(rows, prediction, self.motions)
        start = model.first if first else 0
        # Column by column in memory, as the factorization reads them.
        out = np.zeros((start + sum(map(len, kinds)), len(rows))).T
        begin = 0
        for k, target in enumerate(model.targets[:first]):
            of_target = model.columns_of(k)
            by_x = target.motion(self.x[of_target])[1]
            end = begin + len(by_x)
            out[:, of_target] += part.computed.by_motion[:, begin:end] @ by_x
            begin = end
        for columns in kinds:
            columns.design(part, out[:, start : start + len(columns)])
            start += len(columns)
        return out


def _cells(rows: ObservationRows) -> Cells:
    items = rows.observations
    keys = (items.link, items.kind, items.tag, items.count_s, items.wavelength_um, items.uplink_hz)
    return Cells.from_keys(keys, elapsed_s(rows))


def effects_on_orbit(predictor: Predictor, orbit: AdjustableOrbit, target: int) -> Floats:
    """Return the partials of all observations with respect to the parameters, or errors, of an orbit, (n, k)."""
    motions: list[TargetMotion] = [
        motion if motion.trajectory is None else TrajectoryMotion(motion.trajectory)
        for motion in predictor.motions
    ]
    motions[target] = OrbitMotion(orbit)
    by_motion = predictor.compute(motions).by_motion
    # The motions of the others have three parameters each.
    return by_motion[:, 3 * target : by_motion.shape[1] - 3 * (len(motions) - target - 1)]


def a_priori_orbits(predictor: Predictor) -> list[AdjustableOrbit]:
    """Return the a-priori orbits that a predictor was prepared with."""
    adjustable = [motion.adjustable for motion in predictor.motions]
    return [orbit for orbit in adjustable if isinstance(orbit, AdjustableOrbit)]
