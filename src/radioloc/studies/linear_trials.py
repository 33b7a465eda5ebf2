"""Trials by the linear model: what is prepared once, values and partials at the truth, serves all of them.

A trial is a sum of vectors (noise, and partials times drawn errors) and a linear fit: milliseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.build import estimated_covariance
from radioloc.estimation.consider import Effects, moved_by
from radioloc.estimation.correlated_weights import fit_with_correlated_weights
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.factorization import LinearProblem
from radioloc.estimation.labels import Labels
from radioloc.estimation.m_estimator import fit_with_huber
from radioloc.estimation.observation_noise import ObservationNoise
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.variance_components import fit_with_variance_components
from radioloc.parameters.parameter import ParameterSet
from radioloc.simulation.noise import NoiseDraws
from radioloc.simulation.truth import DrawnErrors, position_error_m
from radioloc.studies.verdict import WIDEST_M, heights, misfits

_Floats = NDArray[np.float64]


COLUMNS = (
    "converged",
    "used",
    "rejected",
    "east_m",
    "north_m",
    "up_m",
    "sigma_east_m",
    "sigma_north_m",
    "sigma_up_m",
    "correlation_east_north",
    "nees",
    "nees_horizontal",
    "noise_scale",
)
"""What is kept of each trial and arc; then the additive variance component of each type, as a sigma in metres, then
each parameter but the position, its sigma and, of a range bias, its error: the estimate less what was put in."""


@dataclass(frozen=True, slots=True, eq=False)
class LinearArc:
    """What the linear model knows of one arc, m rows."""

    part: NDArray[np.intp]  # of the longest arc
    problem: LinearProblem  # at the true position, the other parameters at their a-priori values
    parameters: ParameterSet
    held_m: _Floats  # (m,), what those others add to the computed values
    enu_by_parameters: _Floats  # (3, p), d(east, north, up)/d(parameter)
    ephemeris_sigma_m: _Floats  # (3,)
    noise: ObservationNoise  # as stated
    status: Labels  # before the fit
    threshold: float  # expected sigmas beyond which a residual is an outlier
    order: SeriesOrder
    groups: Labels | None  # that have a variance component each
    height_m: float  # of the true position
    considered_m: _Floats  # (m, r), effects of independent errors of unit variance that are considered
    count_at_stations: int  # how many of them, the first, are at stations or in the air
    correlated: bool  # whether series are weighed as their residuals ask for
    huber: bool  # whether the last fit is by Huber's loss

    @property
    def at_stations(self) -> Effects | None:
        """Those of them that weights allow for."""
        return (
            (lambda rows: self.considered_m[rows, : self.count_at_stations])
            if self.count_at_stations
            else None
        )

    def fit(self, residual_m: _Floats) -> EditedFit:
        """Fit to residuals, as a study does."""
        linear = self.problem.of(residual_m)
        found = fit_with_variance_components(
            linear,
            self.parameters,
            self.noise,
            order=self.order,
            groups=self.groups,
            status=self.status,
            threshold=self.threshold,
        )
        if self.correlated:
            found = fit_with_correlated_weights(linear, found, self.order, self.at_stations)
        return fit_with_huber(linear, found, self.order) if self.huber else found


@dataclass(frozen=True, slots=True, eq=False)
class LinearTrials:
    """Trials by the linear model; all that a worker needs, and nothing of kernels or tables."""

    draws: NoiseDraws
    rows: NDArray[np.intp]  # (n,), those of the plan that take part
    constant_m: _Floats  # (n,), observed less computed at the true position, without noise and drawn errors
    drawn: DrawnErrors  # of the rows
    arcs: tuple[LinearArc, ...]  # the longest first
    columns: tuple[str, ...]
    errors: dict[str, float]  # of the truth, by parameter

    def run(self, seed: int, trials: Sequence[int]) -> _Floats:
        """Some trials of a study's seed, shape (trials, arcs, columns).

        Each trial comes out the same whatever others are run with it.
        """
        seeds = [trial_seed(seed, trial) for trial in trials]
        noise_m, _ = self.draws.draw(seeds)
        out = np.full((len(seeds), len(self.arcs), len(self.columns)), np.nan)
        drawn = [self.drawn.draw(one) for one in seeds]
        residual_m = self.constant_m + noise_m[:, self.rows]
        for k, errors in enumerate(drawn):
            residual_m[k] += errors @ self.drawn.partials
        # Arc by arc, as what an arc's fits have in common then stays in the processor's cache.
        for i, arc in enumerate(self.arcs):
            for k, errors in enumerate(drawn):
                found = arc.fit(residual_m[k, arc.part] - arc.held_m)
                out[k, i] = self._row(arc, found, self.drawn.by_name(errors))
        return out

    def _row(self, arc: LinearArc, found: EditedFit, drawn: dict[str, float]) -> _Floats:
        fit = found.fit
        covariance, _ = estimated_covariance(found, arc.order, arc.at_stations)
        if arc.considered_m.size:
            moved = moved_by(fit, lambda rows: arc.considered_m[rows], arc.considered_m.shape[1])
            covariance = covariance + moved @ moved.T
        x, sigmas = fit.x, np.sqrt(np.diag(covariance))
        moved_m = arc.enu_by_parameters @ (x - arc.problem.x)
        doubts = [
            *misfits(found, arc.noise.sigma_m, arc.order.types),
            *heights(arc.height_m + moved_m[2]),
        ]
        covariance_m2 = arc.enu_by_parameters @ covariance @ arc.enu_by_parameters.T
        covariance_m2 += np.diag(arc.ephemeris_sigma_m**2)
        known = np.trace(covariance_m2) <= WIDEST_M**2
        return row_of(
            self.columns,
            converged=found.converged and not doubts and bool(known),
            used=int(fit.used.sum()),
            rejected=int((~fit.used).sum()),
            error_m=moved_m - position_error_m(drawn),
            covariance_m2=covariance_m2,
            noise_scale=fit.noise_scale,
            excess_noise_m=dict(found.additive_sigma_m),
            parameters={p.name: (x[j], sigmas[j]) for j, p in enumerate(arc.parameters)},
            true=true_values(self.errors, drawn),
        )


def trial_seed(seed: int, trial: int) -> int:
    """Seed of one trial's noise and drawn errors, as ``SeedSequence(seed).spawn`` gives to its child of that number."""
    words = np.random.SeedSequence(seed, spawn_key=(trial,)).generate_state(4)
    return sum(int(word) << (32 * k) for k, word in enumerate(words))


def true_values(fixed: dict[str, float], drawn: dict[str, float]) -> dict[str, float]:
    """Errors of parameters that are in a trial."""
    return fixed | {name: fixed.get(name, 0.0) + value for name, value in drawn.items()}


def row_of(
    columns: Sequence[str],
    *,
    converged: bool,
    used: int,
    rejected: int,
    error_m: _Floats,
    covariance_m2: _Floats,
    noise_scale: float,
    excess_noise_m: dict[str, float],
    parameters: dict[str, tuple[float, float]],
    true: dict[str, float],
) -> _Floats:
    """One row of results in the order of the columns; NaN where an arc has no such number."""
    sigma_m = np.sqrt(np.diag(covariance_m2))
    correlation = nees = nees_horizontal = np.nan
    if np.isfinite(covariance_m2).all():
        correlation = covariance_m2[0, 1] / (sigma_m[0] * sigma_m[1])
        nees = float(error_m @ np.linalg.solve(covariance_m2, error_m))
        nees_horizontal = float(error_m[:2] @ np.linalg.solve(covariance_m2[:2, :2], error_m[:2]))
    known = dict(
        zip(
            COLUMNS,
            (converged, used, rejected, *error_m, *sigma_m, correlation, nees, nees_horizontal, noise_scale),
            strict=True,
        )
    )
    known |= {f"excess_noise_m.{kind}": value for kind, value in excess_noise_m.items()}
    for name, (value, sigma) in parameters.items():
        known[name], known[f"{name}.sigma"] = value, sigma
        # A bias of a pass is the station's.
        known[f"{name}.error"] = value - true.get(name, true.get(name.rpartition(" ")[0], 0.0))
    return np.array([float(known.get(column, np.nan)) for column in columns])
