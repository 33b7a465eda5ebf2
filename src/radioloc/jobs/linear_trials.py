"""Trials by the linear model: all use values and partials that are prepared once at the truth.

A trial is a sum of vectors (noise, and partials times drawn errors) and a linear fit: milliseconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from radioloc.estimation.consider import consider_sensitivity
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.linearization import LinearProblem
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.time_correlation import estimated_covariance, fit_with_correlated_weights
from radioloc.estimation.variance_components import fit_with_variance_components
from radioloc.jobs.verdict import MAX_POSITION_SIGMA_M, misfits
from radioloc.labels import Labels
from radioloc.noise import ObservationCovariance
from radioloc.parameters.parameter import ParameterSet
from radioloc.simulation.noise import NoiseDraws
from radioloc.simulation.truth import DrawnErrors
from radioloc.study.study import EstimateChoice
from radioloc.targets.doubts import height_doubts
from radioloc.targets.orbit_state import ALONG_ACROSS_RADIAL
from radioloc.vectors import Floats, Indices

_OF_PRIORS = 1
"""Number of the random sequence of a-priori values, beside those of noise and drawn errors of the same seed."""


def base_columns(*axes: Sequence[str]) -> tuple[str, ...]:
    """Return the columns of a trial and arc whose errors are along one set of axes, or along several."""
    every = [axis for item in axes for axis in item]
    return (
        *("converged", "used", "rejected"),
        *(f"{axis}_m" for axis in every),
        *(f"sigma_{axis}_m" for axis in every),
        *(f"correlation_{first}_{second}" for first, second, _ in axes),
        *("nees", "nees_horizontal", "noise_scale"),
        *(("nees_state",) if ALONG_ACROSS_RADIAL in axes else ()),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """Comparison of estimates with the truth: q times d numbers from p parameters, k drawn and c considered errors."""

    axes: Sequence[str]
    by_parameters: Floats  # (q, d, p)
    by_drawn: Floats  # (q, d, k), how the truth is moved
    by_considered: Floats  # (q, d, c), in addition to the effect through the parameters
    offset_m: Floats  # (q, d), truth without drawn errors less where the model was linearized
    added_m2: Floats  # (d, d), covariance that is added
    height_m: float | None = None  # of the true position; of none on an orbit


@dataclass(frozen=True, slots=True, eq=False)
class LinearArc:
    """Linear model of an arc, m rows."""

    part: Indices  # of the longest arc
    problem: LinearProblem  # at the true position, the other parameters at their a-priori values
    parameters: ParameterSet
    held_m: Floats  # (m,), their contribution to the computed values
    compared: tuple[Compared, ...]  # one of each target
    noise: ObservationCovariance  # as stated
    status: Labels  # before the fit
    order: SeriesOrder
    estimate: EstimateChoice
    # (m, c), effects of considered errors that are not in the weights, each of one sigma.
    unadjusted_m: Floats
    drawn_sigmas: Floats  # (k,), of the first parameters, whose a-priori values are drawn; zero for others

    def fit(self, residual_m: Floats, seed: int) -> EditedFit:
        """Fit to residuals, as a study does, with the a-priori values of a trial's seed."""
        linear = self.problem.residual_function(residual_m)
        parameters = with_drawn_priors(self.parameters, self.problem.x, self.drawn_sigmas, seed)
        edited = fit_with_variance_components(
            linear,
            parameters,
            self.noise,
            order=self.order,
            groups=self.estimate.component_groups(self.order),
            status=self.status,
            threshold=self.estimate.rejection_sigma,
        )
        if self.estimate.weights == "correlated":
            return fit_with_correlated_weights(linear, edited, self.order)
        return edited


@dataclass(frozen=True, slots=True, eq=False)
class LinearTrials:
    """Trials by the linear model; all that a worker needs, and nothing of kernels or tables."""

    draws: NoiseDraws
    rows: Indices  # (n,), those of the plan that take part
    constant_m: Floats  # (n,), observed less computed at the true position, without noise and drawn errors
    drawn: DrawnErrors  # of the rows
    arcs: tuple[LinearArc, ...]  # the longest first
    columns: tuple[str, ...]
    errors: dict[str, float]  # of the truth, by parameter

    def run(self, seed: int, trials: Sequence[int]) -> Floats:
        """Return trials of a seed, shape (trials, arcs, columns); each is the same whatever others are run with it."""
        seeds = [trial_seed(seed, trial) for trial in trials]
        noise_m, _ = self.draws.draw(seeds)
        count = sum(len(item.offset_m) for item in self.arcs[0].compared)
        out = np.full((len(seeds), len(self.arcs), count, len(self.columns)), np.nan)
        drawn = [self.drawn.draw(value) for value in seeds]
        residual_m = self.constant_m + noise_m[:, self.rows]
        for k, errors in enumerate(drawn):
            residual_m[k] += errors @ self.drawn.partials
        # Arc by arc, so that data common to the fits of an arc stay in the processor's cache.
        for i, arc in enumerate(self.arcs):
            for k, errors in enumerate(drawn):
                edited = arc.fit(residual_m[k, arc.part] - arc.held_m, seeds[k])
                out[k, i] = self._rows(arc, edited, errors)
        return out.reshape(len(seeds), -1, len(self.columns))

    def _rows(self, arc: LinearArc, edited: EditedFit, errors: Floats) -> list[Floats]:
        fit, count = edited.fit, arc.compared[0].by_parameters.shape[-1]
        covariance = estimated_covariance(edited, arc.order)[0][:count, :count]
        moved = consider_sensitivity(fit, lambda rows: arc.unadjusted_m[rows], arc.unadjusted_m.shape[1])[
            :count
        ]
        x, sigmas = fit.x[:count], np.sqrt(np.diag(covariance + moved @ moved.T))
        doubts = list(
            misfits(edited, np.hypot(arc.noise.sigma_m, np.linalg.norm(arc.unadjusted_m, axis=1)), arc.order)
        )
        results, determined = list[tuple[Floats, Floats]](), True
        for compared in arc.compared:
            by = compared.by_parameters
            moved_m = by @ (x - arc.problem.x[:count])
            if compared.height_m is not None:
                doubts += height_doubts(compared.height_m + moved_m[0, 2])
            considered_m = by @ moved + compared.by_considered
            covariances_m2 = by @ covariance @ np.swapaxes(by, 1, 2) + compared.added_m2
            covariances_m2 += considered_m @ np.swapaxes(considered_m, 1, 2)
            determined &= bool(np.trace(covariances_m2[0, :3, :3]) <= MAX_POSITION_SIGMA_M**2)
            results.append((moved_m - compared.offset_m - compared.by_drawn @ errors, covariances_m2))
        outcome = (edited.converged and not doubts and determined, fit.used.sum(), (~fit.used).sum())
        parameters = {p.name: (x[j], sigmas[j]) for j, p in enumerate(arc.parameters.parameters[:count])}
        truth = true_values(self.errors, self.drawn.by_name(errors))
        return [
            row
            for compared, result in zip(arc.compared, results, strict=True)
            for row in rows_of(
                self.columns,
                compared.axes,
                *result,
                outcome,
                fit.noise_scale,
                edited.additive_sigma_m,
                parameters,
                truth,
            )
        ]


def trial_seed(seed: int, trial: int) -> int:
    """Seed of one trial's noise and drawn errors, as ``SeedSequence(seed).spawn`` gives to its child of that number."""
    words = np.random.SeedSequence(seed, spawn_key=(trial,)).generate_state(4)
    return sum(int(word) << (32 * k) for k, word in enumerate(words))


def with_drawn_priors(parameters: ParameterSet, x: Floats, sigmas: Floats, seed: int) -> ParameterSet:
    """Draw the a-priori values of a trial about the true parameters x, by sigmas of the first ones; zero draws none."""
    if not sigmas.any():
        return parameters
    drawn = x[: len(sigmas)] + sigmas * np.random.default_rng([seed, _OF_PRIORS]).standard_normal(len(sigmas))
    items = list(parameters)
    for k in np.flatnonzero(sigmas).tolist():
        items[k] = replace(items[k], prior_value=float(drawn[k]))
    return ParameterSet(items)


def true_values(fixed: dict[str, float], drawn: dict[str, float]) -> dict[str, float]:
    """Errors of parameters that are in a trial."""
    return fixed | {name: fixed.get(name, 0.0) + value for name, value in drawn.items()}


def rows_of(
    columns: Sequence[str],
    axes: Sequence[str],
    errors_m: Floats,
    covariances_m2: Floats,
    outcome: tuple[float, float, float],
    noise_scale: float,
    excess_noise_m: Mapping[str, float],
    parameters: Mapping[str, tuple[float, float]],
    true: Mapping[str, float],
) -> list[Floats]:
    """Return a row in the order of the columns for each place of comparison; errors (q, d), covariances (q, d, d)."""
    values = {f"excess_noise_m.{kind}": value for kind, value in excess_noise_m.items()}
    for name, (value, sigma) in parameters.items():
        # A bias of a pass is the station's.
        error = value - true.get(name, true.get(name.rpartition(" ")[0], 0.0))
        values |= {name: value, f"{name}.sigma": sigma, f"{name}.error": error}
    names, rows = base_columns(axes), []
    for error_m, covariance_m2 in zip(errors_m, covariances_m2, strict=True):
        sigma_m = np.sqrt(np.diag(covariance_m2))[:3]
        correlation, nees = np.nan, dict.fromkeys((2, 3, len(error_m)), np.nan)
        if np.isfinite(covariance_m2).all():
            correlation = covariance_m2[0, 1] / (sigma_m[0] * sigma_m[1])
            nees = {n: error_m[:n] @ np.linalg.solve(covariance_m2[:n, :n], error_m[:n]) for n in nees}
        of_state = (nees[6],) if 6 in nees else ()
        base = (*outcome, *error_m[:3], *sigma_m, correlation, nees[3], nees[2], noise_scale, *of_state)
        row = values | dict(zip(names, base, strict=True))
        rows.append(np.array([float(row.get(column, np.nan)) for column in columns]))
    return rows
