"""Polynomials of segments: the coefficients that follow from the model at nodes, and how well they agree with it.

The rule by which a segment is accepted is here; docs/architecture.md says what bound follows from it. The quantities
that are interpolated are the columns of :class:`~radioloc.measurements.predictor.Computed` but the status, one below
the other, shape (width, n).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields
from functools import cache

import numpy as np
from numpy.polynomial import chebyshev, polynomial
from numpy.typing import NDArray

from radioloc.measurements.dense_series import CHECK_POINTS, DEGREES, check_points, nodes
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.predictor import Computed

SAFETY = 4.0
"""By how much the deviation found at the check points must stay below what is allowed."""
ALLOWED_M = 0.9e-4
"""Allowed deviation of a value from the model, m: 0.3 ps of delay."""
ALLOWED_RELATIVE = 1e-6
"""Allowed deviation of partials, of the largest in the segment; of an elevation, in rad."""
MOST = DEGREES[-1][1] + 1
"""Most coefficients of a quantity."""
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

Layout = dict[str, tuple[slice, tuple[int, ...]]]
"""Where each column lies among the quantities, and the shape of its rows."""


def layout(computed: Computed) -> Layout:
    """How columns are laid out as quantities."""
    places, end = {}, 0
    for field in fields(Computed):
        if field.name != "status":
            shape = getattr(computed, field.name).shape[1:]
            begin, end = end, end + math.prod(shape)
            places[field.name] = slice(begin, end), shape
    return places


def stacked(computed: Computed) -> NDArray[np.float64]:
    """Columns as quantities, shape (width, n)."""
    n = len(computed.value_m)
    columns = [(getattr(computed, name), shape) for name, (_, shape) in layout(computed).items()]
    return np.concatenate([column.reshape(n, math.prod(shape)).T for column, shape in columns])


def unstacked(quantities: NDArray[np.float64], places: Layout, status: NDArray[np.int8]) -> Computed:
    """Quantities (width, n) as columns, without copying."""
    n = quantities.shape[1]
    columns = {name: quantities[place].T.reshape(n, *shape) for name, (place, shape) in places.items()}
    return Computed(**columns, status=status)


def first_nodes(degree: NDArray[np.intp]) -> NDArray[np.intp]:
    """Row of the first node of each segment; with that after the last of all."""
    return np.concatenate([[0], np.cumsum(degree + 1)])


def polynomials(
    degree: NDArray[np.intp], at_nodes: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Powers descending, (m, width, MOST), and sizes of the last two Chebyshev coefficients, (m, width)."""
    size = len(at_nodes)
    coefficients, tail = np.zeros((len(degree), size, MOST)), np.zeros((len(degree), size))
    for n, of_degree, rows in _by_degree(degree):
        values = np.moveaxis(at_nodes[:, rows].reshape(size, -1, n + 1), 0, 1)
        # Without its value in the middle, a range keeps its digits in the sums.
        middle = values[..., n // 2].copy()
        series = (values - middle[..., None]) @ _to_chebyshev(n)
        tail[of_degree] = np.abs(series[..., -2:]).sum(axis=-1)
        powers = series @ _to_powers(n)
        powers[..., -1] += middle
        coefficients[of_degree, :, -(n + 1) :] = powers
    return coefficients, tail


def compare(
    degree: NDArray[np.intp], nodes: ExactPredictor, checks: ExactPredictor, lander_pa_m: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which segments agree with the model at their check points, (m,), and how far each quantity deviates, (m, width).

    Nodes and check points follow segment after segment; what comes after the nodes is not looked at.
    """
    m, n_nodes = len(degree), int((degree + 1).sum())
    at_nodes, at_checks = nodes.compute(lander_pa_m).rows(slice(n_nodes)), checks.compute(lander_pa_m)
    values, places = stacked(at_nodes), layout(at_nodes)
    size = len(values)
    model = np.moveaxis(stacked(at_checks).reshape(size, m, CHECK_POINTS), 0, 1)
    coefficients, tail = polynomials(degree, values)
    good, deviation = np.ones(m, dtype=bool), np.zeros((m, size))
    # Elevations have to stay away from limits; what is integrated ends elsewhere than its tag says.
    limits_rad = {0.0}.union(*(medium.limits_rad for medium in nodes.model.media))
    margin_rad = _MARGIN_RAD + _SPIN_RAD_S * np.nan_to_num(checks.observations.count_s[::CHECK_POINTS])
    for n, of_degree, rows in _by_degree(degree):
        mine = coefficients[of_degree]
        here = np.abs(model[of_degree] - _evaluate(mine, check_points(n))).max(axis=-1)
        deviation[of_degree] = here
        largest = np.abs(values[:, rows].reshape(size, -1, n + 1)).max(axis=-1)
        agrees = _allowed(largest, places) >= np.maximum(here, tail[of_degree]).T
        content = places["by_electron_content_m"][0]
        agrees[content] |= np.isnan(largest[content])  # of signals whose frequency is not recorded
        good[of_degree] &= agrees.all(axis=0)
        # The elevations between the nodes stay on one side of every limit, so that the status is that of the nodes.
        grid = np.linspace(-1.0, 1.0, 4 * n + 1)
        elevation_rad = _evaluate(mine[:, places["elevation_rad"][0]], grid)
        for limit_rad in limits_rad:
            clear = elevation_rad - limit_rad
            side = np.sign(clear[:, :, :1])
            good[of_degree] &= (clear * side > margin_rad[of_degree, None, None]).all(axis=(1, 2))
    # All points of a segment have the same status, and the same source of Earth orientation.
    first = first_nodes(degree)[:-1]
    predicted = nodes.predicted_eop[:n_nodes], checks.predicted_eop
    of_node, of_check = np.repeat(np.arange(m), degree + 1), np.repeat(np.arange(m), CHECK_POINTS)
    at_first = np.column_stack([at_nodes.status, predicted[0]])[first]
    for at, points, of_point in ((at_nodes, predicted[0], of_node), (at_checks, predicted[1], of_check)):
        differs = np.column_stack([at.status, points]) != at_first[of_point]
        good[of_point[differs.any(axis=1)]] = False
    return good, deviation


def _by_degree(degree: NDArray[np.intp]) -> Iterator[tuple[int, NDArray[np.intp], NDArray[np.intp]]]:
    """Each degree, its segments and their nodes."""
    of_node = np.repeat(degree, degree + 1)
    for n in np.unique(degree):
        yield int(n), np.flatnonzero(degree == n), np.flatnonzero(of_node == n)


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
    return np.asarray(polynomial.polyval(x, np.moveaxis(coefficients[..., ::-1], -1, 0)))


def _allowed(size: NDArray[np.float64], places: Layout) -> NDArray[np.float64]:
    """Deviations allowed at check points, from the largest sizes of the quantities at the nodes; shapes (width, m)."""
    allowed = np.full_like(size, ALLOWED_RELATIVE / SAFETY)
    allowed[places["value_m"][0]] = ALLOWED_M / SAFETY
    for name, rounding in _ROUNDING.items():
        place, _ = places[name]
        if name == "by_position_pa":
            relative = ALLOWED_RELATIVE / SAFETY * np.linalg.norm(size[place], axis=0)
            allowed[place] = np.clip(relative, rounding, _POSITION_MOST)
        else:
            relative = ALLOWED_RELATIVE / SAFETY * size[place].max(axis=0, initial=0.0)
            allowed[place] = np.maximum(relative, rounding)
    return allowed
