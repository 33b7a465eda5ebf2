"""Predictor of dense tracking, which interpolates the model between nodes.

The :class:`~radioloc.measurements.exact_predictor.ExactPredictor` computes the Chebyshev nodes of segments of at most
three hours, and check points between them, as observations of the same path, kind and conditions. Segments with
deviations (a kink of the ionosphere's maps, an elevation near a limit, a passage through the zenith) are divided.
Observations of segments with too few rows are computed individually.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.errors import InputError, PredictedEopWarning
from radioloc.measurements.dense_series import (
    CHECK_POINT_COUNT,
    DenseSeries,
    Segments,
    check_points,
    compare,
    first_nodes,
    layout,
    nodes,
    polynomials,
    stacked,
    unstacked,
)
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Computed, Predictor
from radioloc.measurements.prepared_paths import joined, rows_of
from radioloc.measurements.proper_time import clock_epoch as clock_epoch_of
from radioloc.measurements.registry import is_differenced, is_integrated
from radioloc.measurements.target_motion import Motions, MotionsLike, partials_of_points, positions_pa_m
from radioloc.quantities import accepts_quantities
from radioloc.time import Epochs, utc_to_tt
from radioloc.vectors import Floats, Indices, Mask

MAX_UNCHECKED_DISTANCE_M = 1e4  # from the position of the last check; larger distances need another check
_MIN_ROWS_PER_THREAD = 32768  # a millisecond of work, which justifies a thread


@dataclass(frozen=True, slots=True)
class InterpolationAccuracy:
    """Largest deviations of an interpolated arc from the model at its check points; zero without check points."""

    range_m: float  # of ranges
    delay_s: float  # of VLBI delays
    integrated_m: float  # of integrated Doppler and delay rates
    by_position: float  # of a partial by position, m/m
    interpolated: int  # observations
    exact: int  # observations computed individually
    segments: int
    nodes: int  # of all segments


class ChebyshevPredictor(Predictor):
    """Predictor that interpolates dense series of an arc.

    Parameters and errors are those of :func:`prepare_predictor`; ``series`` is the order of the observations, if it is
    available already.

    Notes
    -----
    Values are within 0.09 mm (0.3 ps of delay) of the model, partials within 1e-6 of the largest of their kind in the
    segment. A segment is accepted if its deviations at the check points, and its last two Chebyshev coefficients, are
    four times smaller; docs/architecture.md derives the bound.
    """

    @accepts_quantities
    def __init__(
        self,
        model: PhysicalModel,
        observations: Observations,
        motions: MotionsLike,
        series: DenseSeries | None = None,
        targets: Sequence[str] = (),
        more_partials: bool = False,
        clock_epoch: Epochs | None = None,
    ) -> None:
        super().__init__(model, observations, motions, targets, more_partials)
        if self.trajectories:
            raise InputError('evaluation: expected "exact" or "auto" for a spacecraft, got "interpolated"')
        self._clock_epoch = clock_epoch or clock_epoch_of(observations)
        self._plan(self.motions, series)
        model.earth.warn_of_predictions(utc_to_tt(observations.epoch), self.predicted_eop)

    @property
    def predicted_eop(self) -> Mask:
        """Mask of observations with predicted Earth orientation, shape (n,)."""
        first = first_nodes(self._degree)
        # All nodes of an accepted segment agree in it.
        row = np.where(self._segment < 0, first[-1] - 1 - self._segment, first[np.maximum(self._segment, 0)])
        return self._computed.predicted_eop[row]

    @property
    def accuracy(self) -> InterpolationAccuracy:
        """Agreement with the model at the check points, at the position of the last check."""
        kind = self._checks.observations.kind[::CHECK_POINT_COUNT]
        differenced, integrated = is_differenced(kind), is_integrated(kind)
        value_m = self._deviation[:, 0]
        exact = int((self._segment < 0).sum())
        return InterpolationAccuracy(
            range_m=float(value_m[~differenced & ~integrated].max(initial=0.0)),
            delay_s=float(value_m[differenced & ~integrated].max(initial=0.0)) / C_M_S,
            integrated_m=float(value_m[integrated].max(initial=0.0)),
            by_position=float(self._deviation[:, 1:4].max(initial=0.0)),
            interpolated=len(self.observations) - exact,
            exact=exact,
            segments=len(self._degree),
            nodes=int(first_nodes(self._degree)[-1]),
        )

    def check(self, motions: MotionsLike | None = None) -> InterpolationAccuracy:
        """Compare with the model at the check points for other positions, and divide segments anew if necessary."""
        all_motions = self._given(motions)
        accepted, deviation = compare(self._degree, self._computed, self._checks, all_motions)
        if accepted.all():
            self._deviation, self._checked_pa_m = deviation, positions_pa_m(all_motions)
        else:
            self._plan(all_motions)
        return self.accuracy

    def predict(self, motions: MotionsLike | None = None) -> ChebyshevPrediction:
        """Predict values for points on the Moon, and partials of rows on request."""
        all_motions = self._given(motions)
        distances_m = np.linalg.norm(positions_pa_m(all_motions) - self._checked_pa_m, axis=-1)
        if distances_m.max() > MAX_UNCHECKED_DISTANCE_M:
            self.check(all_motions)
        computed = self._computed.compute(all_motions)
        return ChebyshevPrediction(
            self._segment, self._x, self._degree, computed, self.target, len(all_motions)
        )

    def select(self, rows: Any) -> ChebyshevPredictor:
        """Return the prepared arc of some observations by a mask, a slice or indices."""
        part = copy.copy(self)
        part._set_observations(self.observations.select(rows))
        segment, part._x = np.atleast_1d(self._segment[rows]), np.ascontiguousarray(self._x[rows])
        is_exact = segment < 0
        is_used = np.zeros(len(self._degree), dtype=bool)
        is_used[segment[~is_exact]] = True
        part._segment = np.empty_like(segment)
        part._segment[~is_exact] = (np.cumsum(is_used) - 1)[segment[~is_exact]]
        part._segment[is_exact] = -1 - np.arange(int(is_exact.sum()))
        part._degree, part._deviation = self._degree[is_used], self._deviation[is_used]
        part._checks = self._checks.select(np.repeat(is_used, CHECK_POINT_COUNT))
        node_rows = np.flatnonzero(np.repeat(is_used, self._degree + 1))
        exact_rows = first_nodes(self._degree)[-1] - 1 - segment[is_exact]
        part._computed = self._computed.select(np.concatenate([node_rows, exact_rows]))
        return part

    def with_model(self, model: PhysicalModel, motions: MotionsLike | None = None) -> ChebyshevPredictor:
        """Prepare the same observations with another model, for values only."""
        all_motions = self._given(motions)
        return ChebyshevPredictor(
            model, self.observations, all_motions, targets=self.targets, clock_epoch=self._clock_epoch
        )

    def _plan(self, motions: Motions, series: DenseSeries | None = None) -> None:
        """Divide the series into segments that agree with the model, and prepare their nodes."""

        def exact(observations: Observations) -> ExactPredictor:
            with warnings.catch_warnings():
                # The warning of predicted Earth orientation is for the observations, not for each set of nodes.
                warnings.simplefilter("ignore", PredictedEopWarning)
                return ExactPredictor(
                    self.model,
                    observations,
                    motions,
                    targets=self.targets,
                    more_partials=self.more_partials,
                    clock_epoch=self._clock_epoch,
                )

        def points(degree: int) -> Floats:
            return np.concatenate([nodes(degree), check_points(degree)])

        if series is None:
            series = DenseSeries(self.model, self.observations, self.more_partials)
        pending = series.segments()
        segments: list[Segments] = []
        of_nodes: list[ExactPredictor] = []
        of_checks: list[ExactPredictor] = []
        deviations: list[Floats] = []
        while len(pending) or not segments:
            observations, of_point = series.observations_at(pending, points)
            prepared = exact(observations)
            last = np.cumsum(np.bincount(of_point, minlength=len(pending)))
            is_check = np.zeros(len(of_point), dtype=bool)
            is_check[last[:, None] - np.arange(1, CHECK_POINT_COUNT + 1)] = True
            at_nodes, checks = prepared.select(~is_check), prepared.select(is_check)
            accepted, deviation = compare(pending.degree, at_nodes, checks, motions)
            is_accepted = accepted[of_point]
            segments.append(rows_of(pending, accepted))
            of_nodes.append(at_nodes.select(is_accepted[~is_check]))
            of_checks.append(checks.select(is_accepted[is_check]))
            deviations.append(deviation[accepted])
            pending = series.divided(rows_of(pending, ~accepted))
        all_segments = joined(segments)
        self._degree = all_segments.degree
        self._segment, self._x = series.segments_of_rows(all_segments)
        exact_rows = np.flatnonzero(self._segment < 0)
        self._segment[exact_rows] = -1 - np.arange(len(exact_rows), dtype=np.int32)
        # Computed together for each position: the nodes, then the observations that are not interpolated.
        self._computed = ExactPredictor.concatenate([*of_nodes, exact(self.observations.select(exact_rows))])
        self._checks = ExactPredictor.concatenate(of_checks)
        self._deviation = np.concatenate(deviations)
        self._checked_pa_m = positions_pa_m(motions)


class ChebyshevPrediction:
    """Predictions of an interpolated arc for `count` points on the Moon; `target` is the point of each row."""

    # `segment` is that of each observation, or -1 - k for the k-th exact observation, and `x` the place in it, -1 to 1;
    # `computed` has the nodes of the segments, of this `degree`, and then the exact observations.

    def __init__(
        self,
        segment: NDArray[np.int32],
        x: Floats,
        degree: Indices,
        computed: Computed,
        target: NDArray[np.int32],
        count: int,
    ) -> None:
        self._segment, self._x, self._target, self._count = segment, x, target, count
        first = first_nodes(degree)
        at_nodes, self._exact = computed.rows(slice(first[-1])), computed.rows(slice(first[-1], None))
        self._layout, self._status = layout(at_nodes), at_nodes.status[first[:-1]]
        # Powers descending, shape (n_segments, n_quantities, n_coefficients).
        self._coefficients, _ = polynomials(degree, stacked(at_nodes), self._layout)

    @property
    def value_m(self) -> Floats:
        """Values of all observations, m, shape (n,)."""
        out = np.empty((1, len(self._segment)))
        _in_threads(self._segment, self._x, np.ascontiguousarray(self._coefficients[:, :1]), out)
        if len(self._exact.value_m):
            exact_rows = np.flatnonzero(self._segment < 0)
            out[0, exact_rows] = self._exact.value_m[-1 - self._segment[exact_rows]]
        return np.asarray(out[0])

    def rows(self, rows: Any) -> Computed:
        """Return values and partials of rows by a mask, a slice or indices, in that order."""
        segment = np.ascontiguousarray(self._segment[rows])
        out = np.empty((self._coefficients.shape[1], len(segment)))
        _in_threads(segment, np.ascontiguousarray(self._x[rows]), self._coefficients, out)
        status = np.zeros((len(segment), 2), dtype=np.int8)
        if self._status.any():
            smooth = np.flatnonzero(segment >= 0)
            status[smooth] = self._status[segment[smooth]]
        computed = unstacked(out, self._layout, status)
        exact_rows = np.flatnonzero(segment < 0)
        if len(exact_rows):
            exact = self._exact.rows(-1 - segment[exact_rows])
            for name in (*self._layout, "status"):
                getattr(computed, name)[exact_rows] = getattr(exact, name)
        if self._count == 1:
            return computed
        by_motion = partials_of_points(computed.by_position_pa, self._target[rows], self._count)
        return replace(computed, by_motion=by_motion)


def _in_threads(segment: NDArray[np.int32], x: Floats, coefficients: Floats, out: Floats) -> None:
    """Evaluate all rows in parallel; results do not depend on the number of threads."""
    from radioloc.compiled import numba
    from radioloc.measurements._kernels import quantities

    n = len(segment)
    threads = min(int(numba.config.NUMBA_NUM_THREADS), n // _MIN_ROWS_PER_THREAD)  # type: ignore[attr-defined]
    if threads < 2:
        quantities(segment, x, coefficients, out, 0, n)
        return
    bounds = np.linspace(0, n, threads + 1).astype(int).tolist()
    with ThreadPoolExecutor(threads) as pool:
        parts = pool.map(partial(quantities, segment, x, coefficients, out), bounds[:-1], bounds[1:])
        list(parts)  # raises exceptions of threads
