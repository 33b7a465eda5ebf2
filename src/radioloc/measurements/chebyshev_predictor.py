"""A predictor of dense tracking: the model is computed at nodes and interpolated between them.

The :class:`~radioloc.measurements.exact_predictor.ExactPredictor` computes the Chebyshev nodes of segments of at most
three hours, and check points between them, as observations of the same path, kind and conditions. Segments that deviate
(a kink of the ionosphere's maps, an elevation near a limit, a passage through the zenith) are divided; where too few
observations are left to a segment, these are computed one by one.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial
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
from radioloc.measurements.target_motion import GivenMotions, Motions, partials_of_points, positions_pa_m
from radioloc.quantities import accepts_quantities
from radioloc.time import Epochs, utc_to_tt
from radioloc.vectors import Floats

MAX_UNCHECKED_DISTANCE_M = 1e4  # distance from the position of the last check that is allowed without another
_MIN_ROWS_PER_THREAD = 32768  # rows for which it is worth starting a thread: one millisecond


@dataclass(frozen=True, slots=True)
class InterpolationAccuracy:
    """Largest deviations of an interpolated arc from the model at its check points; zero where there are none."""

    range_m: float  # of ranges
    delay_s: float  # of VLBI delays
    integrated_m: float  # of integrated Doppler and delay rates
    by_position: float  # of a partial by position, m/m
    interpolated: int  # observations
    exact: int  # observations that are computed one by one
    segments: int
    nodes: int  # of all segments


class ChebyshevPredictor(Predictor):
    """The observations of one arc, dense series of them interpolated.

    Parameters and errors are those of :func:`prepare_predictor`; ``series`` is the observations' order, where it has
    been found already.

    Notes
    -----
    A value is within 0.09 mm (0.3 ps of delay) of the model's, a partial within 1e-6 of the largest of its kind in the
    segment. A segment is accepted if it is four times as good at its check points and its last two Chebyshev
    coefficients are as small; docs/architecture.md derives the bound.
    """

    @accepts_quantities
    def __init__(
        self,
        model: PhysicalModel,
        observations: Observations,
        motions: GivenMotions,
        series: DenseSeries | None = None,
        targets: Sequence[str] = (),
        more_partials: bool = False,
        clock_epoch: Epochs | None = None,
    ) -> None:
        super().__init__(model, observations, motions, targets, more_partials)
        if self.trajectories:
            raise InputError(
                'the tracking of a spacecraft is not interpolated; evaluation is "exact" or "auto"'
            )
        self._clock_epoch = clock_epoch or clock_epoch_of(observations)
        self._plan(self.motions, series)
        model.earth.warn_of_predictions(utc_to_tt(observations.epoch), self.predicted_eop)

    @property
    def predicted_eop(self) -> NDArray[np.bool_]:
        """Whether an observation rests on predicted Earth orientation, shape (n,)."""
        first = first_nodes(self._degree)
        # A segment was refused whose nodes do not all agree in this.
        row = np.where(self._segment < 0, first[-1] - 1 - self._segment, first[np.maximum(self._segment, 0)])
        return self._computed.predicted_eop[row]

    @property
    def accuracy(self) -> InterpolationAccuracy:
        """Agreement with the model at the check points, at the position at which it was checked last."""
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

    def check(self, motions: GivenMotions | None = None) -> InterpolationAccuracy:
        """Compare with the model at the check points for other positions, and divide anew if that asks for it."""
        given = self._given(motions)
        good, deviation = compare(self._degree, self._computed, self._checks, given)
        if good.all():
            self._deviation, self._checked_pa_m = deviation, positions_pa_m(given)
        else:
            self._plan(given)
        return self.accuracy

    def at(self, motions: GivenMotions | None = None) -> ChebyshevPrediction:
        """Predict for points on the Moon: all values at once, partials of the rows that are asked for."""
        given = self._given(motions)
        if (
            np.linalg.norm(positions_pa_m(given) - self._checked_pa_m, axis=-1).max()
            > MAX_UNCHECKED_DISTANCE_M
        ):
            self.check(given)
        computed = self._computed.compute(given)
        return ChebyshevPrediction(self._segment, self._x, self._degree, computed, self.target, len(given))

    def select(self, which: Any) -> ChebyshevPredictor:
        """The arc of some of the observations (a mask, a slice or indices), already prepared."""
        part = copy.copy(self)
        part._take(self.observations.select(which))
        segment, part._x = np.atleast_1d(self._segment[which]), np.ascontiguousarray(self._x[which])
        few = segment < 0
        kept = np.zeros(len(self._degree), dtype=bool)
        kept[segment[~few]] = True
        part._segment = np.empty_like(segment)
        part._segment[~few] = (np.cumsum(kept) - 1)[segment[~few]]
        part._segment[few] = -1 - np.arange(int(few.sum()))
        part._degree, part._deviation = self._degree[kept], self._deviation[kept]
        part._checks = self._checks.select(np.repeat(kept, CHECK_POINT_COUNT))
        rows = np.flatnonzero(np.repeat(kept, self._degree + 1))
        exact = first_nodes(self._degree)[-1] - 1 - segment[few]
        part._computed = self._computed.select(np.concatenate([rows, exact]))
        return part

    def with_model(self, model: PhysicalModel, motions: GivenMotions | None = None) -> ChebyshevPredictor:
        """The same observations prepared with another model, for values only."""
        given = self._given(motions)
        return ChebyshevPredictor(
            model, self.observations, given, targets=self.targets, clock_epoch=self._clock_epoch
        )

    def _plan(self, motions: Motions, series: DenseSeries | None = None) -> None:
        """Divide the series into segments that agree with the model, and prepare their nodes."""

        def exact(observations: Observations) -> ExactPredictor:
            with warnings.catch_warnings():
                # Predictions of Earth orientation are told of the observations, not of nodes level by level.
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
            good, deviation = compare(pending.degree, at_nodes, checks, motions)
            of_good = good[of_point]
            segments.append(rows_of(pending, good))
            of_nodes.append(at_nodes.select(of_good[~is_check]))
            of_checks.append(checks.select(of_good[is_check]))
            deviations.append(deviation[good])
            pending = series.divided(rows_of(pending, ~good))
        accepted = joined(segments)
        self._degree = accepted.degree
        self._segment, self._x = series.place(accepted)
        rest = np.flatnonzero(self._segment < 0)
        self._segment[rest] = -1 - np.arange(len(rest), dtype=np.int32)
        # What is computed for each position, at once: the nodes, then what is not interpolated.
        self._computed = ExactPredictor.concatenate([*of_nodes, exact(self.observations.select(rest))])
        self._checks = ExactPredictor.concatenate(of_checks)
        self._deviation = np.concatenate(deviations)
        self._checked_pa_m = positions_pa_m(motions)


class ChebyshevPrediction:
    """Predictions of an interpolated arc for points on the Moon, so many, of which each row is of a `target`."""

    # `segment` is that of each observation, or -1 - k for the k-th that is computed exactly, and `x` the place within
    # it, -1 to 1; `computed` are the nodes of the segments, of this `degree`, and then what is computed exactly.

    def __init__(
        self,
        segment: NDArray[np.int32],
        x: Floats,
        degree: NDArray[np.intp],
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

    @cached_property
    def value_m(self) -> Floats:
        """Computed value of every observation, m, shape (n,)."""
        out = np.empty((1, len(self._segment)))
        _in_threads(self._segment, self._x, np.ascontiguousarray(self._coefficients[:, :1]), out)
        if len(self._exact.value_m):
            few = np.flatnonzero(self._segment < 0)
            out[0, few] = self._exact.value_m[-1 - self._segment[few]]
        return np.asarray(out[0])

    def rows(self, which: Any) -> Computed:
        """Values and partials of the rows chosen by a mask, a slice or indices, in that order."""
        segment = np.ascontiguousarray(self._segment[which])
        out = np.empty((self._coefficients.shape[1], len(segment)))
        _in_threads(segment, np.ascontiguousarray(self._x[which]), self._coefficients, out)
        status = np.zeros((len(segment), 2), dtype=np.int8)
        if self._status.any():
            smooth = np.flatnonzero(segment >= 0)
            status[smooth] = self._status[segment[smooth]]
        computed = unstacked(out, self._layout, status)
        few = np.flatnonzero(segment < 0)
        if len(few):
            exact = self._exact.rows(-1 - segment[few])
            for name in (*self._layout, "status"):
                getattr(computed, name)[few] = getattr(exact, name)
        if self._count == 1:
            return computed
        by_motion = partials_of_points(computed.by_position_pa, self._target[which], self._count)
        return replace(computed, by_motion=by_motion)


def _in_threads(
    segment: NDArray[np.int32],
    x: Floats,
    coefficients: Floats,
    out: Floats,
) -> None:
    """Evaluate all rows, parts of them at the same time; each row's result is the same however they are divided."""
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
        list(parts)  # raises what one of them did
