"""Harmonics of time as observations of any number, with partials row by row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from toy_moon import assessed_fit, solution_of

from radioloc.estimation import Labels, Parameter, ParameterSet
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.variance_components import fit_with_variance_components
from radioloc.results import Solution
from radioloc.time import Epochs


@dataclass
class Series:
    """Harmonics of time with noise and outliers."""

    n: int
    p: int = 6
    excess_m: float = 0.0
    blunders: float = 0.0

    def __post_init__(self) -> None:
        rng = np.random.default_rng(8)
        self.sigma_m = 0.01 * np.exp(0.3 * rng.standard_normal(self.n))
        self.observed_m = np.hypot(self.sigma_m, self.excess_m) * rng.standard_normal(self.n)
        self.bad = rng.random(self.n) < self.blunders
        self.observed_m[self.bad] += 30.0 * rng.standard_normal(self.bad.sum())
        for start in range(0, self.n, 65536):
            rows = np.arange(start, min(start + 65536, self.n))
            self.observed_m[rows] += self.columns(rows) @ self.truth

    @property
    def truth(self) -> np.ndarray:
        return 10.0 * np.arange(1.0, self.p + 1.0)

    @property
    def parameters(self) -> ParameterSet:
        return ParameterSet([Parameter(f"a.{k}", "m", "a") for k in range(self.p)])

    def columns(self, rows: np.ndarray) -> np.ndarray:
        return np.sin((rows[:, None] + 1.0) / self.n * (1.0 + np.arange(self.p)) * 2.0)

    def linearize(self, x: np.ndarray) -> SeriesAt:
        return SeriesAt(self, x)

    def dense(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        matrix = self.columns(np.arange(self.n))
        return self.observed_m - matrix @ x, matrix


class SeriesAt:
    def __init__(self, series: Series, x: np.ndarray) -> None:
        self.series, self.residual_m = series, series.observed_m.copy()
        for start in range(0, series.n, 65536):
            rows = np.arange(start, min(start + 65536, series.n))
            self.residual_m[rows] -= series.columns(rows) @ x

    def partials(self, rows: np.ndarray) -> np.ndarray:
        return self.series.columns(rows)


def solved(series: Series) -> Solution:
    """Fit with outlier rejection and additive noise, and build the solution; six links alternate."""
    n = series.n
    paths = Labels((np.arange(n) % 6).astype(np.int32), tuple(f"S{k}>x>S{k}" for k in range(6)))
    types = Labels(np.zeros(n, dtype=np.int32), ("range",))
    order = SeriesOrder.from_labels(types, paths, np.linspace(0.0, 2.0 * 86400.0, n))
    fit = fit_with_variance_components(series.linearize, series.parameters, series.sigma_m, order=order)
    assessed = assessed_fit(
        fit,
        position_pa_m=np.array([1.7e6, 0.0, 0.0]),
        position_partials=np.eye(3, series.p),
        rot_pa_to_me=np.eye(3),
        pa_frame="PA",
        me_frame="ME",
        epoch_utc=Epochs.from_jd(2459185.5, np.linspace(0.0, 2.0, n), "UTC"),
        station=paths,
        path=paths,
        type=types,
        observed_m=series.observed_m,
    )
    return solution_of(assessed)
