"""Assess an edited fit: reported estimate, residuals and consistency tests, from which a :class:`Solution` is built."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from radioloc.estimation.adaptation import AdaptedEstimate
from radioloc.estimation.combination import ReferenceComparison
from radioloc.estimation.consider import (
    NO_ERRORS,
    UNMODELLED_ERROR,
    Consider,
    UnestimatedErrors,
    reported_estimate,
)
from radioloc.estimation.consistency import assess_consistency, outlier_run_findings
from radioloc.estimation.consistency_results import Consistency
from radioloc.estimation.editing import EditedFit, outlier_runs, run_reasons, with_reasons
from radioloc.estimation.gauss_markov import TimeCorrelation
from radioloc.estimation.hypotheses import Hypotheses
from radioloc.estimation.observability import assess_observability
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.stated_sigmas import wrong_sigmas
from radioloc.estimation.statistics import FitStatistics, Residuals
from radioloc.estimation.status import FitStatus
from radioloc.estimation.time_correlation import estimated_covariance
from radioloc.lunar.local import local_difference
from radioloc.lunar.selenographic import cartesian_to_selenographic
from radioloc.parameters.parameter import Parameter, ParameterSet, Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.results.estimate import LocatedEstimate
from radioloc.results.solution import Solution
from radioloc.vectors import Floats


@dataclass(frozen=True, slots=True, eq=False)
class AssessedFit:
    """Edited fit with the reported estimate, residuals and consistency tests: all that its status depends on."""

    edited: EditedFit
    order: SeriesOrder
    residuals: Residuals
    estimate: LocatedEstimate  # its total covariance includes the errors that the tests find
    consistency: Consistency
    time_correlation: TimeCorrelation | None

    def solution(self, status: FitStatus, message: str, **described: Any) -> Solution:
        """Return the solution; `described` are further fields, or others in place of those of the fit."""
        edited, fit, residuals = self.edited, self.edited.fit, self.residuals
        counted = None if residuals.count_s is None else ~np.isnan(residuals.count_s)
        content = _fields(self.estimate) | {
            "consistency": self.consistency,
            "noise_scale": fit.noise_scale,
            "time_correlation": self.time_correlation,
            "fit": FitStatistics(
                total=residuals.statistics("all"),
                by_station=residuals.statistics_by(residuals.stations),
                by_type=residuals.statistics_by(residuals.types),
                by_path=residuals.statistics_by(self.order.links),
                chi2=fit.chi2,
                dof=fit.dof,
                robust_scale=edited.robust_scale,
                excess_noise_m=dict(edited.additive_sigma_m),
                shared_noise_m=dict(edited.shared_sigma_m),
            ),
            "residuals": residuals,
            "observability": assess_observability(fit, counted),
            "iterations": fit.iterations,
            "fit_count": edited.fit_count,
            "series_weights": edited.series_weights,
        }
        return Solution(status=status, message=message, **(content | described))


def assess_fit(
    edited: EditedFit,
    order: SeriesOrder,
    residuals: Residuals,
    *,
    considered: UnestimatedErrors = NO_ERRORS,
    candidates: UnestimatedErrors = NO_ERRORS,
    stated_m: Floats | None = None,
    consistency: bool = True,
    **located: Any,
) -> AssessedFit:
    """Assess an edited fit of n observations, its noise scaled to larger residuals.

    `considered` are the errors outside the weights of the fit, `candidates` the parameters that it holds at zero,
    `stated_m` (n,) the sigmas without variance components. `located` are the fields of :class:`LocatedEstimate`.
    """
    fit, epoch_utc, count_s = edited.fit, residuals.epoch_utc, residuals.count_s
    runs = outlier_runs(edited, order)
    residuals = replace(residuals, statuses=with_reasons(edited.status, run_reasons(edited, runs)))
    covariance, correlation = estimated_covariance(edited, order)
    if correlation is not None:
        added = correlation.added_covariance[np.ix_(*[~fit.parameters.considered] * 2)]
        correlation = replace(correlation, added_covariance=added)
    estimate = LocatedEstimate(**_fields(reported_estimate(fit, covariance, considered)), **located)
    tests = Consistency()
    if consistency:
        by_parameters = None if estimate.trajectory is not None else estimate.enu_partials
        hypotheses = Hypotheses.from_fit(edited, order, correlation, considered, candidates, count_s, runs)
        rejected = tuple(outlier_run_findings(edited, order, runs, epoch_utc, count_s))
        is_axis = [[item.name == f"state.{axis}" for item in estimate.parameters] for axis in "xyz"]
        by_state = np.array(is_axis, dtype=np.float64) if np.any(is_axis) else None
        tests = assess_consistency(hypotheses, epoch_utc, by_parameters, rejected, by_state)
        sigmas = () if stated_m is None else wrong_sigmas(edited, stated_m, order)
        tests = replace(tests, findings=(*tests.findings, *sigmas))
    estimate = with_findings(estimate, tests)
    tests = replace(tests, adapted=estimate.adapted)
    return AssessedFit(edited, order, residuals, estimate, tests, correlation)


def with_findings(estimate: LocatedEstimate, tests: Consistency) -> LocatedEstimate:
    """Return an estimate whose total covariance allows for the errors that the consistency tests find."""
    if tests.adapted is None:
        return estimate
    adapted = replace(tests.adapted, shift_sigmas=_shift_sigmas(estimate, tests.adapted))
    name = f"{UNMODELLED_ERROR}.{tests.findings[0].name}"
    error = Parameter(name, "1", UNMODELLED_ERROR, prior_sigma=1.0, role=Role.CONSIDERED)
    effect = Consider(ParameterSet([error]), adapted.shift[:, None])
    return replace(estimate, consider=estimate.consider.joined(effect), adapted=adapted)


def _fields(record: Any) -> dict[str, Any]:
    """Return the fields of a dataclass by name."""
    return {item.name: getattr(record, item.name) for item in fields(record)}


def _shift_sigmas(estimate: LocatedEstimate, adapted: AdaptedEstimate) -> float:
    """Largest shift of a target, in total sigmas (Mahalanobis distance) of the estimate in whose it is shorter.

    An adapted estimate without most of the observations is far away by chance in a direction that these determined.
    """
    if estimate.trajectory is not None:
        of_target = np.array([item.kind not in PARAMETERS for item in estimate.parameters])
        of_target &= estimate.parameters.free
        maps = [
            (np.eye(len(of_target))[of_target], estimate.parameter_covariance()[np.ix_(of_target, of_target)])
        ]
    else:
        maps = [(place.enu_partials, place.position_covariance()) for place in estimate.places]
    return max(
        min(
            _distance_sigmas(by @ adapted.shift, item)
            for item in (covariance, by @ adapted.covariance @ by.T)
        )
        for by, covariance in maps
    )


def _distance_sigmas(difference: Floats, covariance: Floats) -> float:
    """Length of a difference (k,) in standard deviations; directions without variance do not count."""
    sigmas = np.sqrt(np.diag(covariance))
    free = sigmas > 0.0
    scaled, sigmas = difference[free] / sigmas[free], sigmas[free]
    correlation = covariance[np.ix_(free, free)] / np.outer(sigmas, sigmas)
    return math.sqrt(max(float(scaled @ np.linalg.pinv(correlation, hermitian=True) @ scaled), 0.0))


def compare_with(
    estimate: LocatedEstimate, reference_pa_m: ArrayLike, name: str = "reference"
) -> ReferenceComparison:
    """Compare an estimate with a known position along the sphere and in height, in metres and in total sigmas."""
    reference_pa_m = np.asarray(reference_pa_m)
    longitude_rad, latitude_rad, height_m = cartesian_to_selenographic(estimate.rot_pa_to_me @ reference_pa_m)
    # The direction is that of the arc at the estimate, the origin of the covariance.
    axes = estimate.rot_pa_to_enu
    difference_m = 0.0 - local_difference(reference_pa_m, estimate.position_pa_m, axes).enu_m
    covariance = estimate.position_covariance("enu")
    sigmas = np.sqrt(np.diag(covariance))
    single = [float(d / s) if 0.0 < s < np.inf else None for d, s in zip(difference_m, sigmas, strict=True)]
    combined = None
    if None not in single:
        try:
            root = np.linalg.cholesky(covariance)
            combined = float(np.linalg.norm(np.linalg.solve(root, difference_m)))
        except np.linalg.LinAlgError:
            combined = None  # a fixed direction makes the covariance singular
    east, north, up = single
    return ReferenceComparison(
        *difference_m.tolist(),
        name=name,
        longitude_deg=math.degrees(longitude_rad),
        latitude_deg=math.degrees(latitude_rad),
        height_m=float(height_m),
        east_sigmas=east,
        north_sigmas=north,
        up_sigmas=up,
        combined_sigmas=combined,
    )
