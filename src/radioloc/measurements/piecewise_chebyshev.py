"""Polynomials of segments: the model at nodes, the coefficients that follow, and how well they agree with the model.

The rule by which a segment is accepted is here; docs/architecture.md says what bound follows from it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from radioloc.measurements.dense_series import (
    CHECK_POINTS,
    DEGREES,
    Segments,
    check_points,
    nodes,
)
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Computed

SAFETY = 4.0
"""By how much the deviation found at the check points must stay below what is allowed."""
ALLOWED_M = 0.9e-4
"""Allowed deviation of a value from the model, m: 0.3 ps of delay."""
ALLOWED_RELATIVE = 1e-6
"""Allowed deviation of partials, of the largest in the segment; of an elevation, in rad."""

_SHAPES: dict[str, tuple[int, ...]] = {
    "value_m": (),
    "by_position_pa": (3,),
    "by_time_m_s": (),
    "by_transponder_delay_m_s": (),
    "by_zenith_wet": (2,),
    "elevation_rad": (2,),
    "by_station_itrf": (2, 3),
    "by_electron_content_m": (2,),
    "mean_by_position_pa": (3,),
}
"""Columns of :class:`~radioloc.measurements.predictor.Computed` that are interpolated, and the shape of their rows."""
_ON_REQUEST = ("by_station_itrf", "by_electron_content_m", "mean_by_position_pa")
MOST = DEGREES[-1][1] + 1
"""Most coefficients of a quantity."""


@cache
def places(more_partials: bool) -> dict[str, slice]:
    """Where each column lies among the quantities that are interpolated."""
    names = [name for name in _SHAPES if more_partials or name not in _ON_REQUEST]
    ends = np.cumsum([math.prod(_SHAPES[name]) for name in names]).tolist()
    return {name: slice(end - math.prod(_SHAPES[name]), end) for name, end in zip(names, ends, strict=True)}


def width(more_partials: bool) -> int:
    """Numbers that are interpolated for each observation."""
    return next(reversed(places(more_partials).values())).stop


ELEVATION = places(False)["elevation_rad"]
_ROUNDING = {
    "by_position_pa": 2e-12,
    "by_time_m_s": 1e-6,
    "by_transponder_delay_m_s": 1e-5,
    "by_zenith_wet": 1e-9,
    "by_station_itrf": 2e-12,
    "by_electron_content_m": 1e-9,
    "mean_by_position_pa": 2e-12,
}
"""Rounding of the partials themselves, which no interpolation can undercut."""
_POSITION_MOST = 1e-9
"""Largest deviation of a partial by position, m/m: over 10 km it moves the value by 0.01 mm."""
_MARGIN_RAD = np.radians(0.05)
"""An elevation this near a limit may cross it between nodes, or for a point 10 km away."""
_SPIN_RAD_S = 7.3e-5


@dataclass(frozen=True, slots=True)
class Comparison:
    """Which segments agree with the model, and by how much each quantity deviates, shapes (m,) and (m, width)."""

    good: NDArray[np.bool_]
    deviation: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PiecewiseChebyshev:
    """Nodes and check points of segments, as observations of the model, segment after segment."""

    degree: NDArray[np.intp]  # of each segment's polynomial, which has one node more
    nodes: ExactPredictor
    checks: ExactPredictor

    @classmethod
    def prepare(
        cls,
        model: PhysicalModel,
        observations: Observations,
        segments: Segments,
        lander_pa_m: NDArray[np.float64],
        targets: Sequence[str] = (),
        more_partials: bool = False,
    ) -> PiecewiseChebyshev:
        """Compute what does not depend on the position for nodes and check points of segments."""
        at = [np.concatenate([nodes(d), check_points(d)]) for d in segments.degree.tolist()]
        arc = ExactPredictor(
            model,
            segments.observations_at(observations, at),
            lander_pa_m,
            targets=targets,
            more_partials=more_partials,
        )
        last = np.cumsum(segments.degree + 1 + CHECK_POINTS)
        is_check = np.zeros(last[-1], dtype=bool)
        is_check[last[:, None] - np.arange(1, CHECK_POINTS + 1)] = True
        return cls(segments.degree, arc.select(~is_check), arc.select(is_check))

    @staticmethod
    def concatenate(fits: list[PiecewiseChebyshev]) -> PiecewiseChebyshev:
        """Join, in order."""
        return PiecewiseChebyshev(
            np.concatenate([fit.degree for fit in fits]),
            ExactPredictor.concatenate([fit.nodes for fit in fits]),
            ExactPredictor.concatenate([fit.checks for fit in fits]),
        )

    def __len__(self) -> int:
        return len(self.degree)

    def select(self, which: NDArray[np.intp]) -> PiecewiseChebyshev:
        """Some of the segments."""
        checks = which[:, None] * CHECK_POINTS + np.arange(CHECK_POINTS)
        return PiecewiseChebyshev(
            self.degree[which], self.nodes.select(self.nodes_of(which)), self.checks.select(checks.ravel())
        )

    def nodes_of(self, which: NDArray[np.intp]) -> NDArray[np.intp]:
        """Rows of the nodes of some segments."""
        first = self._first_nodes()
        rows = [np.arange(first[k], first[k] + self.degree[k] + 1) for k in which]
        return np.concatenate([np.zeros(0, dtype=np.intp), *rows])

    @property
    def predicted_eop(self) -> NDArray[np.bool_]:
        """Whether each segment rests on predicted Earth orientation, shape (m,)."""
        return self.checks.predicted_eop[::CHECK_POINTS]

    def polynomials(self, computed: Computed) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
        """Coefficients of all quantities, powers descending, and the status of each segment, of computed nodes."""
        coefficients, _ = self._coefficients(computed)
        return coefficients, computed.status[self._first_nodes()]

    def _first_nodes(self) -> NDArray[np.intp]:
        return np.cumsum(self.degree + 1) - (self.degree + 1)

    def compare(self, lander_pa_m: NDArray[np.float64]) -> Comparison:
        """Compare the polynomials with the model at the check points."""
        at_nodes, at_checks = self.nodes.compute(lander_pa_m), self.checks.compute(lander_pa_m)
        coefficients, tail = self._coefficients(at_nodes)
        model = _stacked(at_checks, self.nodes.more_partials)
        size = len(model)
        model = model.reshape(size, len(self), CHECK_POINTS)
        deviation = np.zeros((len(self), size))
        good = np.ones(len(self), dtype=bool)
        limits = self._limits_rad()
        margin_rad = self._margins_rad()
        for degree, of_degree, rows in self._groups():
            values = _evaluate(coefficients[of_degree], check_points(degree))
            here = np.abs(np.moveaxis(model[:, of_degree], 0, 1) - values).max(axis=-1)
            deviation[of_degree] = here
            scales = _stacked(at_nodes, self.nodes.more_partials)[:, rows].reshape(size, -1, degree + 1)
            good[of_degree] &= (
                np.maximum(here, tail[of_degree]) <= _allowed(scales, self.nodes.more_partials)
            ).all(axis=-1)
            # The elevations between the nodes stay on one side of every limit, so that the status is that of the nodes.
            grid = np.linspace(-1.0, 1.0, 4 * degree + 1)
            elevation_rad = _evaluate(coefficients[of_degree][:, ELEVATION], grid)
            for limit_rad in limits:
                clear = elevation_rad - limit_rad
                side = np.sign(clear[:, :, :1])
                good[of_degree] &= (clear * side > margin_rad[of_degree, None, None]).all(axis=(1, 2))
        starts = self._first_nodes()
        for of_nodes, of_checks in (
            (at_nodes.status, at_checks.status),
            (self.nodes.predicted_eop[:, None], self.checks.predicted_eop[:, None]),
        ):
            first = of_nodes[starts]
            same = of_checks.reshape(-1, CHECK_POINTS, of_checks.shape[1]) == first[:, None]
            good &= same.all(axis=(1, 2))
            same = (of_nodes == np.repeat(first, self.degree + 1, axis=0)).all(axis=1)
            good &= np.logical_and.reduceat(same, starts)
        return Comparison(good, deviation)

    def _limits_rad(self) -> list[float]:
        """Elevations at which the model begins or ends to hold."""
        return sorted({0.0}.union(*(medium.limits_rad for medium in self.nodes.model.media)))

    def _margins_rad(self) -> NDArray[np.float64]:
        """How far elevations have to stay from limits; integrated types end elsewhere than their tag says."""
        count_s = self.checks.observations.count_s[::CHECK_POINTS]
        return _MARGIN_RAD + _SPIN_RAD_S * np.where(np.isnan(count_s), 0.0, count_s)

    def _groups(self) -> Iterator[tuple[int, NDArray[np.intp], NDArray[np.intp]]]:
        """Each degree, its segments and their nodes."""
        of_node = np.repeat(self.degree, self.degree + 1)
        for degree in np.unique(self.degree):
            yield int(degree), np.flatnonzero(self.degree == degree), np.flatnonzero(of_node == degree)

    def _coefficients(self, computed: Computed) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Powers descending, (m, width, MOST), and sizes of the last two Chebyshev coefficients, (m, width)."""
        values = _stacked(computed, self.nodes.more_partials)
        size = len(values)
        coefficients, tail = np.zeros((len(self), size, MOST)), np.zeros((len(self), size))
        for degree, of_degree, rows in self._groups():
            at_nodes = np.moveaxis(values[:, rows].reshape(size, -1, degree + 1), 0, 1)
            # Without its value in the middle, a range keeps its digits in the sums.
            middle = at_nodes[..., degree // 2].copy()
            series = (at_nodes - middle[..., None]) @ _to_chebyshev(degree)
            tail[of_degree] = np.abs(series[..., -2:]).sum(axis=-1)
            powers = series @ _to_powers(degree)
            powers[..., -1] += middle
            coefficients[of_degree, :, -(degree + 1) :] = powers
        return coefficients, tail


def columns_of(out: NDArray[np.float64], more_partials: bool) -> dict[str, NDArray[np.float64]]:
    """Quantities (width, n) as columns, without copying."""
    n = out.shape[1]
    columns = {name: out[:0].T.reshape(n, 0, *_SHAPES[name][1:]) for name in _ON_REQUEST}
    for name, place in places(more_partials).items():
        columns[name] = out[place].T.reshape(n, *_SHAPES[name]) if _SHAPES[name] else out[place.start]
    return columns


def _stacked(computed: Computed, more_partials: bool) -> NDArray[np.float64]:
    """Columns as quantities, shape (width, n)."""
    n = len(computed.value_m)
    columns = (getattr(computed, name) for name in places(more_partials))
    return np.concatenate([column.reshape(n, -1).T for column in columns])


@cache
def _to_chebyshev(degree: int) -> NDArray[np.float64]:
    """Matrix from values at the nodes to Chebyshev coefficients."""
    matrix = chebyshev.chebvander(nodes(degree), degree) * (2.0 / (degree + 1))
    matrix[:, 0] *= 0.5
    return np.asarray(matrix)


@cache
def _to_powers(degree: int) -> NDArray[np.float64]:
    """Matrix from Chebyshev coefficients to those of powers, descending."""
    matrix = np.zeros((degree + 1, degree + 1))
    for k, unit in enumerate(np.eye(degree + 1)):
        powers = chebyshev.cheb2poly(unit)
        matrix[k, degree + 1 - len(powers) :] = powers[::-1]
    return matrix


def _evaluate(coefficients: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Polynomials at the same places of all segments, shape (m, n_quantities, len(x))."""
    total = np.zeros((*coefficients.shape[:-1], len(x)))
    for k in range(coefficients.shape[-1]):
        total = total * x + coefficients[..., k, None]
    return total


def _allowed(at_nodes: NDArray[np.float64], more_partials: bool) -> NDArray[np.float64]:
    """Deviations allowed at check points, from the quantities' sizes at the nodes (width, m, k); shape (m, width)."""
    size = np.abs(at_nodes).max(axis=-1)
    allowed = np.empty_like(size)
    where = places(more_partials)
    for name, place in where.items():
        largest = np.linalg.norm(size[place], axis=0) if name == "by_position_pa" else size[place].max(axis=0)
        allowed[place] = np.maximum(ALLOWED_RELATIVE / SAFETY * largest, _ROUNDING.get(name, 0.0))
    allowed[where["value_m"]] = ALLOWED_M / SAFETY
    allowed[where["by_position_pa"]] = np.minimum(allowed[where["by_position_pa"]], _POSITION_MOST)
    allowed[ELEVATION] = ALLOWED_RELATIVE / SAFETY
    return allowed.T
