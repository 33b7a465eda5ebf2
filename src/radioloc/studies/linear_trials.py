"""Trials by the linear model: what is prepared once, values and partials at the truth, serves all of them.

A trial is a sum of vectors (noise, and partials times drawn errors) and a linear fit: milliseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.build import estimated_covariance
from radioloc.estimation.correlated_weights import fit_with_correlated_weights
from radioloc.estimation.factorization import LinearProblem
from radioloc.estimation.labels import Labels
from radioloc.estimation.observation_noise import ObservationNoise
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.variance_components import NoisyFit, fit_with_variance_components
from radioloc.parameters.parameter import ParameterSet
from radioloc.simulation.noise import NoiseDraws
from radioloc.simulation.truth import DrawnErrors, position_error_m
from radioloc.studies.trial_rows import row_of, trial_seed, true_values

_Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class LinearArc:
    """What the linear model knows of one arc, m of its rows.

    Parameters
    ----------
    part : ndarray of int
        Rows of the longest arc.
    problem : LinearProblem
        At the parameters of the true position, the others at their a-priori values.
    parameters : ParameterSet
    held_m : ndarray, shape (m,)
        What those others add to the computed values, m.
    enu_by_parameters : ndarray, shape (3, p)
        d(east, north, up)/d(parameter).
    ephemeris_sigma_m : ndarray, shape (3,)
    noise : ObservationNoise
        As stated.
    status : Labels
        Of the observations, before the fit.
    threshold : float
        Expected sigmas beyond which a residual is an outlier.
    order : SeriesOrder
        Types, paths and times of the observations.
    correlated : bool
        Whether series are weighed as their residuals ask for.
    """

    part: NDArray[np.intp]
    problem: LinearProblem
    parameters: ParameterSet
    held_m: _Floats
    enu_by_parameters: _Floats
    ephemeris_sigma_m: _Floats
    noise: ObservationNoise
    status: Labels
    threshold: float
    order: SeriesOrder
    correlated: bool

    def fit(self, residual_m: _Floats) -> NoisyFit:
        """Fit to residuals, as a study does."""
        linear = self.problem.of(residual_m)
        found = fit_with_variance_components(
            linear,
            self.parameters,
            self.noise,
            groups=self.order.types,
            status=self.status,
            threshold=self.threshold,
        )
        if not self.correlated:
            return found
        weighed = fit_with_correlated_weights(linear, found.edited, self.order)
        return replace(found, edited=weighed.edited)


@dataclass(frozen=True, slots=True, eq=False)
class LinearTrials:
    """Trials by the linear model; all that a worker needs, and nothing of kernels or tables.

    Parameters
    ----------
    draws : NoiseDraws
    rows : ndarray of int, shape (n,)
        Rows of the plan that take part.
    constant_m : ndarray, shape (n,)
        Observed less computed at the true position, without noise and drawn errors, m.
    drawn : DrawnErrors
        Of the rows.
    arcs : tuple of LinearArc
        The longest first.
    columns : tuple of str
    errors : dict of str to float
        Errors of the truth by parameter.
    """

    draws: NoiseDraws
    rows: NDArray[np.intp]
    constant_m: _Floats
    drawn: DrawnErrors
    arcs: tuple[LinearArc, ...]
    columns: tuple[str, ...]
    errors: dict[str, float]

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

    def _row(self, arc: LinearArc, found: NoisyFit, drawn: dict[str, float]) -> _Floats:
        fit = found.edited.fit
        covariance, _ = estimated_covariance(found.edited, arc.order)
        x, sigmas = fit.x, np.sqrt(np.diag(covariance))
        return row_of(
            self.columns,
            converged=found.edited.converged,
            used=int(fit.used.sum()),
            rejected=int((~fit.used).sum()),
            error_m=arc.enu_by_parameters @ (x - arc.problem.x) - position_error_m(drawn),
            covariance_m2=arc.enu_by_parameters @ covariance @ arc.enu_by_parameters.T
            + np.diag(arc.ephemeris_sigma_m**2),
            noise_scale=fit.noise_scale,
            excess_noise_m=found.additive_sigma_m,
            parameters={p.name: (x[j], sigmas[j]) for j, p in enumerate(arc.parameters)},
            true=true_values(self.errors, drawn),
        )
