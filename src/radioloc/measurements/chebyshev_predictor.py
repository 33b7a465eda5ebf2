"""A predictor of dense tracking: the model is computed at nodes and interpolated between them.

What the :class:`~radioloc.measurements.exact_predictor.ExactPredictor` computes for a series of observations of one
path is smooth in time. Here it computes them at the Chebyshev nodes of segments of at most three hours, and polynomials
carry values and partials to the observations. There is no second model: the nodes are observations of the same path,
kind and conditions, and so are the check points between them, at which every segment has to agree with the model.
What does not (a kink of the ionosphere's maps, an elevation near a limit, a passage through the zenith) is halved, and
where that would leave too few observations to a segment, these are computed one by one, as sparse ones are.
"""

from __future__ import annotations

import copy
import itertools
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.ephemeris import Trajectory
from radioloc.errors import PredictedEopWarning
from radioloc.measurements.dense_series import (
    CHECK_POINTS,
    DenseSeries,
    Segments,
)
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.observations import Observations
from radioloc.measurements.participants import stations_of, targets_of
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.piecewise_chebyshev import (
    MOST,
    PiecewiseChebyshev,
    columns_of,
    places,
    width,
)
from radioloc.measurements.predictor import Computed, table_of_terms
from radioloc.measurements.registry import is_differenced, is_integrated

CHECKED_WITHIN_M = 1e4
"""How far from the position at which the segments were checked they are used without checking them again."""
_ROWS_OF_A_THREAD = 32768
"""Rows for which it is worth starting a thread: one millisecond."""


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


class ChebyshevPredictor:
    """The observations of one arc, dense series of them interpolated.

    Parameters and errors are those of :class:`~radioloc.measurements.exact_predictor.ExactPredictor`; ``series`` is the
    observations' order, where it has been found already.

    Notes
    -----
    A value is within 0.09 mm (0.3 ps of delay) of the model's, a partial within 1e-6 of the largest of its kind in the
    segment. A segment is accepted if it is four times as good at its check points and its last two Chebyshev
    coefficients are as small; docs/architecture.md derives the bound.
    """

    trajectory: Trajectory | None = None

    def __init__(
        self,
        model: PhysicalModel,
        observations: Observations,
        approximate_pa_m: NDArray[np.float64],
        series: DenseSeries | None = None,
        targets: Sequence[str] = (),
        more_partials: bool = False,
    ) -> None:
        self.model = model
        self.targets, self.more_partials = tuple(targets), more_partials
        self.observations = observations
        self.stations, self.transmitters, self.receivers, _ = stations_of(model, observations)
        self.target = targets_of(observations, self.targets)
        with _predictions_told_once():
            self._plan(np.asarray(approximate_pa_m, dtype=np.float64), series)

    @property
    def predicted_eop(self) -> NDArray[np.bool_]:
        """Whether an observation rests on predicted Earth orientation, shape (n,)."""
        out = np.zeros(len(self.observations), dtype=bool)
        smooth = self._segment >= 0
        # A segment was refused whose nodes do not all agree in this.
        if self._piecewise is not None:
            out[smooth] = self._piecewise.predicted_eop[self._segment[smooth]]
        if self._computed is not None:
            of_exact = self._computed.predicted_eop[len(self._computed.observations) - self._n_exact :]
            out[~smooth] = of_exact[-1 - self._segment[~smooth]]
        return out

    @property
    def accuracy(self) -> InterpolationAccuracy:
        """Agreement with the model at the check points, at the position at which it was checked last."""
        exact = self._n_exact
        interpolated = len(self.observations) - exact
        if self._piecewise is None:
            return InterpolationAccuracy(0.0, 0.0, 0.0, 0.0, interpolated, exact, 0, 0)
        kind = self._piecewise.checks.observations.kind[::CHECK_POINTS]
        differenced, integrated = is_differenced(kind), is_integrated(kind)
        value_m = self._deviation[:, 0]
        return InterpolationAccuracy(
            range_m=float(value_m[~differenced & ~integrated].max(initial=0.0)),
            delay_s=float(value_m[differenced & ~integrated].max(initial=0.0)) / C_M_S,
            integrated_m=float(value_m[integrated].max(initial=0.0)),
            by_position=float(self._deviation[:, 1:4].max(initial=0.0)),
            interpolated=interpolated,
            exact=exact,
            segments=len(kind),
            nodes=len(self._piecewise.nodes.observations),
        )

    def check(self, lander_pa_m: NDArray[np.float64]) -> InterpolationAccuracy:
        """Compare with the model at the check points for another position, and divide anew if that asks for it."""
        if self._piecewise is not None:
            found = self._piecewise.compare(lander_pa_m)
            if not found.good.all():
                with _predictions_told_once():
                    self._plan(lander_pa_m)
                return self.accuracy
            self._deviation = found.deviation
        self._checked_pa_m = np.array(lander_pa_m, dtype=np.float64)
        return self.accuracy

    def at(self, lander_pa_m: NDArray[np.float64]) -> ChebyshevPrediction:
        """Predict for a position in principal axes, m: all values at once, partials of the rows that are asked for."""
        if np.linalg.norm(lander_pa_m - self._checked_pa_m, axis=-1).max() > CHECKED_WITHIN_M:
            self.check(lander_pa_m)
        coefficients, status, exact = (
            np.zeros((0, width(self.more_partials), MOST)),
            np.zeros((0, 2), dtype=np.int8),
            None,
        )
        if self._computed is not None:
            computed = self._computed.compute(lander_pa_m)
            n_nodes = len(computed.value_m) - self._n_exact
            exact = computed.rows(slice(n_nodes, None))
            if self._piecewise is not None:
                coefficients, status = self._piecewise.polynomials(computed.rows(slice(0, n_nodes)))
        return ChebyshevPrediction(self._segment, self._x, coefficients, status, exact, self.more_partials)

    def compute(self, lander_pa_m: NDArray[np.float64]) -> Computed:
        """Predict all observations for a position, with partials; parameters and errors as :meth:`at`."""
        return self.at(lander_pa_m).rows(slice(None))

    def select(self, which: Any) -> ChebyshevPredictor:
        """The arc of some of the observations (a mask, a slice or indices), already prepared."""
        part = copy.copy(self)
        part.observations = self.observations.select(which)
        part.stations, part.transmitters, part.receivers, _ = stations_of(self.model, part.observations)
        part.target = targets_of(part.observations, self.targets)
        segment = np.atleast_1d(self._segment[which])
        part._x = np.atleast_1d(self._x[which])
        part._segment = segment.copy()
        nodes = np.zeros(0, dtype=np.intp)
        if self._piecewise is not None:
            kept = np.unique(segment[segment >= 0])
            nodes = self._piecewise.nodes_of(kept)
            number = np.zeros(len(self._piecewise), dtype=np.int32)
            number[kept] = np.arange(len(kept))
            part._segment[segment >= 0] = number[segment[segment >= 0]]
            part._piecewise = self._piecewise.select(kept) if len(kept) else None
            part._deviation = self._deviation[kept]
        rows = -1 - segment[segment < 0]
        part._segment[segment < 0] = -1 - np.arange(len(rows))
        part._n_exact = len(rows)
        if self._computed is not None:
            first = len(self._computed.observations) - self._n_exact
            part._computed = self._computed.select(np.concatenate([nodes, first + rows]))
        return part

    def with_values(self, value_m: NDArray[np.float64]) -> ChebyshevPredictor:
        """The same arc with other measured values, shape (n,), m; nothing is prepared again."""
        other = copy.copy(self)
        other.observations = replace(self.observations, value_m=value_m)
        return other

    def terms(self, lander_pa_m: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Table of terms at a position: :func:`~radioloc.measurements.predictor.table_of_terms`."""

        def prepare(
            model: PhysicalModel, observations: Observations, pa_m: NDArray[np.float64]
        ) -> ChebyshevPredictor:
            return ChebyshevPredictor(model, observations, pa_m, targets=self.targets)

        return table_of_terms(self, lander_pa_m, prepare)

    def _plan(self, lander_pa_m: NDArray[np.float64], series: DenseSeries | None = None) -> None:
        """Divide the series into segments that agree with the model, and prepare their nodes."""
        if series is None:
            series = DenseSeries(self.model, self.observations, self.more_partials)
        pending = series.segments()
        fits: list[PiecewiseChebyshev] = []
        accepted: list[Segments] = []
        while len(pending):
            fit = PiecewiseChebyshev.prepare(
                self.model, self.observations, pending, lander_pa_m, self.targets, self.more_partials
            )
            good = fit.compare(lander_pa_m).good
            if good.any():
                fits.append(fit.select(np.flatnonzero(good)))
                accepted.append(pending[good])
            pending = series.divided(pending[~good])
        self._piecewise = PiecewiseChebyshev.concatenate(fits) if fits else None
        self._segment, self._x = series.place(accepted)
        rest = np.flatnonzero(self._segment < 0)
        self._segment[rest] = -1 - np.arange(len(rest), dtype=np.int32)
        # What is computed for each position, at once: the nodes, then what is not interpolated.
        parts = [] if self._piecewise is None else [self._piecewise.nodes]
        if len(rest):
            parts.append(
                ExactPredictor(
                    self.model,
                    self.observations.select(rest),
                    lander_pa_m,
                    targets=self.targets,
                    more_partials=self.more_partials,
                )
            )
        self._n_exact = len(rest)
        self._computed = ExactPredictor.concatenate(parts) if parts else None
        self._deviation = np.zeros((0, width(self.more_partials)))
        if self._piecewise is not None:
            self._deviation = self._piecewise.compare(lander_pa_m).deviation
        self._checked_pa_m = np.array(lander_pa_m)


class ChebyshevPrediction:
    """An interpolated arc's predictions for one position; a :class:`~radioloc.measurements.predictor.Prediction`.

    `segment` is that of each observation, or -1 - k for the k-th that is computed exactly, and `x` the place within it,
    -1 to 1. `coefficients`, powers descending, have the shape (n_segments, n_quantities, n_coefficients).
    """

    def __init__(
        self,
        segment: NDArray[np.int32],
        x: NDArray[np.float64],
        coefficients: NDArray[np.float64],
        status: NDArray[np.int8],
        exact: Computed | None,
        more_partials: bool = False,
    ) -> None:
        self._segment, self._x = segment, x
        self._more_partials = more_partials
        self._coefficients, self._status = coefficients, status
        self._exact = exact if exact is not None and len(exact.value_m) else None

    @cached_property
    def value_m(self) -> NDArray[np.float64]:
        """Computed value of every observation, m, shape (n,)."""
        out = np.empty((1, len(self._segment)))
        _in_threads(self._segment, self._x, np.ascontiguousarray(self._coefficients[:, :1]), out)
        if self._exact is not None:
            few = np.flatnonzero(self._segment < 0)
            out[0, few] = self._exact.value_m[-1 - self._segment[few]]
        return np.asarray(out[0])

    def rows(self, which: Any) -> Computed:
        """Values and partials of the rows chosen by a mask, a slice or indices, in that order."""
        segment = np.ascontiguousarray(self._segment[which])
        out = np.empty((width(self._more_partials), len(segment)))
        _in_threads(segment, np.ascontiguousarray(self._x[which]), self._coefficients, out)
        status = np.zeros((len(segment), 2), dtype=np.int8)
        if self._status.any():
            smooth = np.flatnonzero(segment >= 0)
            status[smooth] = self._status[segment[smooth]]
        computed = Computed(**columns_of(out, self._more_partials), status=status)
        if self._exact is not None:
            few = np.flatnonzero(segment < 0)
            exact = self._exact.rows(-1 - segment[few])
            for name in (*places(self._more_partials), "status"):
                getattr(computed, name)[few] = getattr(exact, name)
        return computed


def _in_threads(
    segment: NDArray[np.int32],
    x: NDArray[np.float64],
    coefficients: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Evaluate all rows, parts of them at the same time; each row's result is the same however they are divided."""
    import numba

    from radioloc.measurements._kernels import quantities

    n = len(segment)
    threads = min(int(numba.config.NUMBA_NUM_THREADS), n // _ROWS_OF_A_THREAD)  # type: ignore[attr-defined]
    if threads < 2:
        quantities(segment, x, coefficients, out, 0, n)
        return
    bounds = itertools.pairwise(np.linspace(0, n, threads + 1).astype(int).tolist())
    mine = next(bounds)
    with ThreadPoolExecutor(threads - 1) as pool:
        others = [pool.submit(quantities, segment, x, coefficients, out, *rows) for rows in bounds]
        quantities(segment, x, coefficients, out, *mine)
        for other in others:
            other.result()


@contextmanager
def _predictions_told_once() -> Iterator[None]:
    """Let the first warning of predicted Earth orientation through, of the many of the levels of segments."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    told = False
    for warning in caught:
        predicted = issubclass(warning.category, PredictedEopWarning)
        if not (predicted and told):
            warnings.warn(warning.message, stacklevel=3)
        told |= predicted
