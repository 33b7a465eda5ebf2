"""Trials by the linear model: what is prepared once, values and partials at the truth, serves all of them.

A trial is a sum of vectors (noise, and responses to what departs) and a linear fit: milliseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.build import scaled_by
from radioloc.estimation.correlated_weights import fit_with_correlated_weights
from radioloc.estimation.editing import USED, EditingSettings
from radioloc.estimation.excess_noise import fit_with_excess_noise
from radioloc.estimation.factorization import Factor
from radioloc.estimation.labels import Labels
from radioloc.estimation.least_squares import FitResult, FitStatus
from radioloc.estimation.linearization import DenseLinearization
from radioloc.estimation.observation_noise import ObservationNoise
from radioloc.estimation.repeated_fit import RepeatedFit, RepeatedOutcome
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.statistics import SCALING_PROBABILITY, chi2_quantile
from radioloc.estimation.time_correlation import assess_time_correlation
from radioloc.measurements.registry import KINDS
from radioloc.parameters.parameter import ParameterSet
from radioloc.simulation import Departure, Spread
from radioloc.simulation.departures import position_departure_m
from radioloc.simulation.noise import NoiseDraws
from radioloc.studies.trial_rows import row_of, trial_seed, true_biases_m

_Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class GeneralFit:
    """As :class:`~radioloc.estimation.repeated_fit.RepeatedFit`, but slower.

    For observations that share errors, and, where `series` has their types, paths and times, weighed as their residuals
    ask for (:func:`~radioloc.estimation.correlated_weights.fit_with_correlated_weights`).
    """

    partials: _Floats
    parameters: ParameterSet
    x: _Floats
    noise: ObservationNoise
    group: NDArray[np.int32]
    usable: NDArray[np.bool_]
    editing: EditingSettings
    series: tuple[Labels, Labels, _Floats] | None = None

    def fit(self, residual_m: _Floats) -> RepeatedOutcome:
        """Fit to residuals at the values x."""

        def linear(x: _Floats) -> tuple[_Floats, _Floats]:
            return residual_m - self.partials @ (x - self.x), self.partials

        found = fit_with_excess_noise(
            linear,
            self.parameters,
            self.noise,
            groups=np.array(KINDS)[self.group],
            status=np.where(self.usable, USED, "not usable"),
            editing=self.editing,
        )
        edited = found.edited
        if self.series is not None:
            edited = fit_with_correlated_weights(linear, edited, *self.series).edited
        fit = edited.fit
        scale = 1.0
        if (
            fit.series_noise is None
            and fit.chi2_per_dof is not None
            and fit.chi2 > chi2_quantile(SCALING_PROBABILITY, fit.dof)
        ):
            scale = float(np.sqrt(fit.chi2_per_dof))
        return RepeatedOutcome(
            step=fit.x - self.x,
            covariance=fit.covariance,
            noise_scale=scale,
            root=fit.factor.root_covariance(),
            used=fit.used,
            left_m=fit.residual_m,
            excess_noise_m=np.array([found.excess_noise_m.get(kind, 0.0) for kind in KINDS]),
            converged=edited.converged,
            weighed=None if self.series is None else fit,
        )


@dataclass(frozen=True, slots=True, eq=False)
class LinearArc:
    """What the linear model knows of one arc.

    Parameters
    ----------
    part : ndarray of int
        Rows of the longest arc.
    fit : RepeatedFit or GeneralFit
    parameters : ParameterSet
    x : ndarray, shape (p,)
        Parameters of the true position; the others at their a-priori values.
    held_m : ndarray, shape (m,)
        What those others add to the computed values, m.
    enu_by_parameters : ndarray, shape (3, p)
        d(east, north, up)/d(parameter).
    ephemeris_sigma_m : ndarray, shape (3,)
    partials : ndarray, shape (m, p)
    noise : ObservationNoise
        As stated.
    types, paths : Labels
        Of the observations.
    time_s : ndarray, shape (m,)
        When each was made, s.
    order : SeriesOrder
        Of the observations.
    """

    part: NDArray[np.intp]
    fit: RepeatedFit | GeneralFit
    parameters: ParameterSet
    x: _Floats
    held_m: _Floats
    enu_by_parameters: _Floats
    ephemeris_sigma_m: _Floats
    partials: _Floats
    noise: ObservationNoise
    types: Labels
    paths: Labels
    time_s: _Floats
    order: SeriesOrder = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "order", SeriesOrder.of(self.types, self.paths, self.time_s))

    def covariance(self, found: RepeatedOutcome) -> _Floats:
        """Covariance of the parameters as :func:`~radioloc.estimation.build.build_solution` has it, shape (p, p)."""
        scaled = scaled_by(found.covariance, self.parameters.prior_sigmas, found.noise_scale)
        if not found.converged:
            return scaled
        fit = self._as_fit(found) if found.weighed is None else found.weighed
        correlation = assess_time_correlation(fit, self.types, self.paths, self.time_s, self.order)
        return scaled if correlation is None else scaled + correlation.added_covariance

    def _as_fit(self, found: RepeatedOutcome) -> FitResult:
        """What is known of a fit, its sums of squares left out."""
        q = found.root.shape[1]
        excess_m = found.excess_noise_m[self.types.codes]
        return FitResult(
            parameters=self.parameters,
            x=self.x + found.step,
            covariance=found.covariance,
            linearization=DenseLinearization(found.left_m, self.partials),
            noise=self.noise.with_excess(excess_m) if excess_m.any() else self.noise,
            used=found.used,
            chi2=0.0,
            dof=0,
            status=FitStatus.CONVERGED,
            iterations=(),
            factor=Factor(
                np.ones(len(found.root)), np.ones(q), found.root, np.zeros(q), np.ones(q, dtype=bool)
            ),
        )


@dataclass(frozen=True, slots=True, eq=False)
class LinearTrials:
    """Trials by the linear model; all that a worker needs, and nothing of kernels or tables.

    Parameters
    ----------
    draws : NoiseDraws
    rows : ndarray of int, shape (n,)
        Rows of the plan that take part.
    constant_m : ndarray, shape (n,)
        Observed less computed at the true position, without noise and drawn departures, m.
    spread : Spread
    responses : dict of Departure to ndarray, shape (n,)
        What a unit of each drawn departure adds.
    arcs : tuple of LinearArc
        The longest first.
    columns : tuple of str
    range_bias_m : dict of str to float
        Fixed biases of ranges that are put in, by station, m.
    """

    draws: NoiseDraws
    rows: NDArray[np.intp]
    constant_m: _Floats
    spread: Spread
    responses: dict[Departure, _Floats] = field(repr=False)
    arcs: tuple[LinearArc, ...]
    columns: tuple[str, ...]
    range_bias_m: dict[str, float]

    def run(self, seed: int, trials: Sequence[int]) -> _Floats:
        """Some trials of a study's seed, shape (trials, arcs, columns).

        Each trial comes out the same whatever others are run with it.
        """
        seeds = [trial_seed(seed, trial) for trial in trials]
        noise_m, _ = self.draws.draw(seeds)
        out = np.full((len(seeds), len(self.arcs), len(self.columns)), np.nan)
        drawn = [self.spread.draw(one) for one in seeds]
        residual_m = self.constant_m + noise_m[:, self.rows]
        for k, departures in enumerate(drawn):
            for departure, value in departures.items():
                residual_m[k] += value * self.responses[departure]
        # Predictor by arc, as what an arc's fits have in common then stays in the processor's cache.
        for i, arc in enumerate(self.arcs):
            for k, departures in enumerate(drawn):
                found = arc.fit.fit(residual_m[k, arc.part] - arc.held_m)
                off_m, biases_m = (
                    position_departure_m(departures),
                    true_biases_m(self.range_bias_m, departures),
                )
                out[k, i] = self._row(arc, found, off_m, biases_m)
        return out

    def _row(
        self, arc: LinearArc, found: RepeatedOutcome, off_m: _Floats, biases_m: dict[str, float]
    ) -> _Floats:
        covariance = arc.covariance(found)
        x, sigmas = arc.x + found.step, np.sqrt(np.diag(covariance))
        return row_of(
            self.columns,
            converged=found.converged,
            used=int(found.used.sum()),
            rejected=int((~found.used).sum()),
            error_m=arc.enu_by_parameters @ found.step - off_m,
            covariance_m2=arc.enu_by_parameters @ covariance @ arc.enu_by_parameters.T
            + np.diag(arc.ephemeris_sigma_m**2),
            noise_scale=found.noise_scale,
            excess_noise_m=dict(zip(KINDS, found.excess_noise_m.tolist(), strict=False)),
            parameters={p.name: (x[j], sigmas[j]) for j, p in enumerate(arc.parameters)},
            biases_m=biases_m,
        )
