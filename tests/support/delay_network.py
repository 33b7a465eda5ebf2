"""Linear delays between stations at many epochs, with dense algebra for comparison.

A delay has the arrival time of its second station less that of its first.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation import Parameter, ParameterSet
from radioloc.noise import ALONE, ObservationCovariance, SharedAtEpoch, White

OWN_M, STATION_M = 0.1, 0.4


@dataclass(frozen=True)
class DelayNetwork:
    """Delays in the order of their epochs, then ranges with independent errors."""

    first: NDArray[np.intp]
    second: NDArray[np.intp]
    epoch: NDArray[np.intp]
    design: NDArray[np.float64]
    own_m: NDArray[np.float64]
    station_m: float

    @classmethod
    def make(cls, epochs=20, stations=4, ranges=0, own_m=OWN_M, station_m=STATION_M, seed=0, columns=3):
        rng = np.random.default_rng(seed)
        pairs = np.array(list(itertools.combinations(range(stations), 2)))
        first, second = np.tile(pairs, (epochs, 1)).T
        epoch = np.repeat(np.arange(epochs), len(pairs))
        arrival = rng.normal(size=(epochs, stations, columns))
        design = np.vstack(
            [arrival[epoch, second] - arrival[epoch, first], rng.normal(size=(ranges, columns))]
        )
        ungrouped = np.full(ranges, ALONE)
        return cls(
            np.append(first, ungrouped), np.append(second, ungrouped), np.append(epoch, ungrouped), design,
            np.full(len(design), own_m), station_m,
        )  # fmt: skip

    def select(self, rows) -> DelayNetwork:
        return DelayNetwork(
            *(c[rows] for c in (self.first, self.second, self.epoch, self.design, self.own_m)), self.station_m
        )

    @property
    def incidence(self) -> NDArray[np.float64]:
        """Effect of the error of every station at every epoch, shape (n, epochs * stations)."""
        stations = int(self.second.max()) + 1
        matrix = np.zeros((len(self.epoch), stations * (int(self.epoch.max()) + 1)))
        rows = np.flatnonzero(self.epoch != ALONE)
        np.add.at(matrix, (rows, self.epoch[rows] * stations + self.second[rows]), 1.0)
        np.add.at(matrix, (rows, self.epoch[rows] * stations + self.first[rows]), -1.0)
        return matrix

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Dense covariance of all rows."""
        a = self.station_m * self.incidence
        return np.diag(self.own_m**2) + a @ a.T

    @property
    def noise(self) -> ObservationCovariance:
        effect_m = np.broadcast_to(np.array([-1.0, 1.0]) * self.station_m, (len(self.epoch), 2))
        ends = np.stack([self.first, self.second], axis=-1)
        return ObservationCovariance((White(self.own_m), SharedAtEpoch(self.epoch, ends, effect_m)))

    def errors_m(self, rng) -> NDArray[np.float64]:
        incidence = self.incidence
        of_stations = self.station_m * incidence @ rng.normal(size=incidence.shape[1])
        return self.own_m * rng.normal(size=len(self.own_m)) + of_stations

    def parameters(self) -> ParameterSet:
        return ParameterSet([Parameter(f"x{k}", "m", "p") for k in range(self.design.shape[1])])

    def residual_function(self, observed_m):
        return lambda x: (observed_m - self.design @ x, self.design)

    def generalized(self, observed_m):
        """Return the generalized least squares estimate, its covariance and the sum of squares."""
        weight = np.linalg.inv(self.covariance)
        covariance = np.linalg.inv(self.design.T @ weight @ self.design)
        x = covariance @ self.design.T @ weight @ observed_m
        residual_m = observed_m - self.design @ x
        return x, covariance, float(residual_m @ weight @ residual_m)
