"""The parameters of a study and what they do to the computed ranges."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError, StationError
from radioloc.estimation.parameters import Parameter, ParameterSet
from radioloc.lunar import east_north_up
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.observations import RANGE, TIME_TAGS, VLBI_DELAY
from radioloc.measurements.tracking_arc import TrackingArc
from radioloc.studies.study import EstimateChoice, HeightPrior

PositionFunction = Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]
"""From the three position parameters to the principal-axes position, m, and its partials (3, 3)."""

_NOBODY = -1


@dataclass(frozen=True, slots=True)
class Problem:
    """What is solved for in an arc.

    Parameters
    ----------
    arc : TrackingArc
    parameters : ParameterSet
        Three of the position, then range biases, then time biases.
    position : PositionFunction
    bias_columns : ndarray, shape (n, number of range biases)
        Partials of the range biases.
    time_columns : ndarray, shape (n, number of time biases)
        Which observations a station's time bias shifts.
    """

    arc: TrackingArc
    parameters: ParameterSet
    position: PositionFunction
    bias_columns: NDArray[np.float64]
    time_columns: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        arc: TrackingArc,
        target_pa: LunarPosition,
        estimate: EstimateChoice | None,
        catalogue: StationCatalogue,
    ) -> Problem:
        """Set up the problem of an arc.

        Parameters
        ----------
        arc : TrackingArc
        target_pa : LunarPosition
            A-priori position in principal axes.
        estimate : EstimateChoice or None
            What to estimate; nothing where ``None``.
        catalogue : StationCatalogue
            Resolves the names of stations.

        Raises
        ------
        InputError
            A bias is asked for of a station without observations, or nothing at all is to be estimated.
        """
        choice = EstimateChoice(position="none") if estimate is None else estimate
        if choice.position == "geographic":
            position, function = _on_sphere(target_pa.xyz_m, choice.height_prior)
        else:
            position, function = _cartesian(target_pa.xyz_m, fixed=choice.position == "none")
        rows = arc.observations
        # A range's bias is the receiver's; a delay has none of that kind, and in Doppler it drops out.
        ranging = np.where(rows.kind == RANGE, arc.receivers, _NOBODY)
        # The clock behind a time tag is the transmitter's or the receiver's; of a delay the first station's.
        first = (rows.tag == TIME_TAGS.index("transmit")) | (rows.kind == VLBI_DELAY)
        tagging = np.where(first, arc.transmitters, arc.receivers)
        ranges = _stations_of("range_bias", choice.range_bias, catalogue, arc, ranging)
        times = _stations_of("time_bias", choice.time_bias, catalogue, arc, tagging)
        names = arc.stations
        parameters = [
            *position,
            *_biases("range_bias", [names[i] for i in ranges], "m", choice.range_bias_sigma_m, 1.0),
            *_biases("time_bias", [names[i] for i in times], "s", choice.time_bias_sigma_s, 1e-3),
        ]
        if estimate is not None and all(p.fixed for p in parameters):
            raise InputError(
                'nothing to estimate: [estimate] position is "none" and no bias is asked for; '
                "use `radioloc residuals` to see residuals at the given position"
            )
        return cls(
            arc,
            ParameterSet(parameters),
            function,
            _membership(ranges, ranging),
            _membership(times, tagging),
        )

    def position_pa_m(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Position at parameters x, principal axes, m."""
        return self.position(x[:3])[0]

    def position_partials(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """d(position)/d(parameters), shape (3, p)."""
        partials = np.zeros((3, len(self.parameters)))
        partials[:, :3] = self.position(x[:3])[1]
        return partials

    def residuals(self, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Observed minus computed (n,), m, and partials of the computed (n, p)."""
        lander_pa_m, by_parameters = self.position(x[:3])
        computed = self.arc.compute(lander_pa_m)
        n_range = self.bias_columns.shape[1]
        by_time = self.time_columns * computed.by_time_m_s[:, None]
        total_m = computed.value_m + self.bias_columns @ x[3 : 3 + n_range] + by_time @ x[3 + n_range :]
        partials = np.hstack([computed.by_position_pa @ by_parameters, self.bias_columns, by_time])
        return self.arc.observations.value_m - total_m, partials


def _on_sphere(
    start_pa_m: NDArray[np.float64], prior: HeightPrior | None
) -> tuple[list[Parameter], PositionFunction]:
    """East and north along the 1737.4 km sphere from the a-priori position, and the height above it.

    Longitude and latitude themselves would stop at the poles, where landers stand; in these coordinates the
    a-priori position is on the equator, wherever on the Moon it is, and the height is still a parameter.
    """
    longitude_rad = math.atan2(start_pa_m[1], start_pa_m[0])
    latitude_rad = math.atan2(start_pa_m[2], math.hypot(start_pa_m[0], start_pa_m[1]))
    height_m = float(np.linalg.norm(start_pa_m)) - MEAN_LUNAR_RADIUS_M
    to_pa = east_north_up(longitude_rad, latitude_rad).T
    height = (height_m, math.inf) if prior is None else (prior.height_m, prior.sigma_m)
    parameters = [
        Parameter("position.east", "m", "position", 0.0),
        Parameter("position.north", "m", "position", 0.0),
        Parameter("position.height", "m", "position", *height),
    ]

    def position(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        (cos_e, cos_n), (sin_e, sin_n) = (
            np.cos(x[:2] / MEAN_LUNAR_RADIUS_M),
            np.sin(x[:2] / MEAN_LUNAR_RADIUS_M),
        )
        radius_m = MEAN_LUNAR_RADIUS_M + x[2]
        up = np.array([sin_e * cos_n, sin_n, cos_e * cos_n])
        by_east = np.array([cos_e * cos_n, 0.0, -sin_e * cos_n])
        by_north = np.array([-sin_e * sin_n, cos_n, -cos_e * sin_n])
        ratio = radius_m / MEAN_LUNAR_RADIUS_M
        return radius_m * (to_pa @ up), to_pa @ np.stack([ratio * by_east, ratio * by_north, up], axis=-1)

    return parameters, position


def _cartesian(start_pa_m: NDArray[np.float64], *, fixed: bool) -> tuple[list[Parameter], PositionFunction]:
    """x, y, z in principal axes."""
    parameters = [
        Parameter(f"position.{axis}", "m", "position", float(value), fixed=fixed)
        for axis, value in zip("xyz", start_pa_m, strict=True)
    ]
    return parameters, lambda x: (x, np.eye(3))


def _stations_of(
    key: str,
    names: tuple[str, ...] | str,
    catalogue: StationCatalogue,
    arc: TrackingArc,
    owner: NDArray[np.int32],
) -> list[int]:
    """Indices of the stations that get a parameter of one kind, from whose each observation is, shape (n,)."""
    taking_part = [int(i) for i in np.unique(owner) if i != _NOBODY]
    if names == "none":
        return []
    if names == "all":
        return taking_part
    chosen = set()
    for name in names:
        try:
            station = catalogue.get(name).name
        except StationError as error:
            raise StationError(f"[estimate] {key}: {error}") from None
        if station not in arc.stations or arc.stations.index(station) not in taking_part:
            present = ", ".join(arc.stations[i] for i in taking_part)
            raise InputError(
                f"[estimate] {key}: no observation of {station} that has one; the stations are {present or 'none'}"
            )
        chosen.add(arc.stations.index(station))
    return sorted(chosen)


def _biases(kind: str, names: list[str], unit: str, sigma: float | None, scale: float) -> list[Parameter]:
    prior_sigma = math.inf if sigma is None else sigma
    return [Parameter(f"{kind}.{name}", unit, kind, 0.0, prior_sigma, scale=scale) for name in names]


def _membership(stations: list[int], owner: NDArray[np.int32]) -> NDArray[np.float64]:
    """Ones where an observation is of a station, shape (n, number of stations)."""
    return (owner[:, None] == np.array(stations, dtype=np.int64)).astype(np.float64)
