"""Assemble a :class:`Solution` from an edited fit and plain arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.estimation.adaptation import MAX_SHIFT_SIGMAS, AdaptedEstimate
from radioloc.estimation.combination import ReferenceComparison
from radioloc.estimation.consider import UNMODELLED_ERROR, Consider, UnestimatedErrors, reported_estimate
from radioloc.estimation.consistency import assess_consistency, outlier_run_findings
from radioloc.estimation.editing import EditedFit, outlier_runs, run_reasons, with_reasons
from radioloc.estimation.hypotheses import Hypotheses
from radioloc.estimation.observability import assess_observability
from radioloc.estimation.series import SeriesOrder, seconds_since_midnight
from radioloc.estimation.stated_sigmas import wrong_sigmas
from radioloc.estimation.statistics import FitStatistics, Residuals
from radioloc.estimation.status import Doubt, FitStatus
from radioloc.estimation.time_correlation import estimated_covariance
from radioloc.labels import Labels
from radioloc.lunar.local import local_difference
from radioloc.lunar.selenographic import cartesian_to_selenographic
from radioloc.parameters.parameter import Parameter, ParameterSet, Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.results.solution import Solution
from radioloc.time import Epochs
from radioloc.vectors import Floats


def build_solution(
    edited: EditedFit,
    *,
    epoch_utc: Epochs,
    station: Labels | Sequence[str] | NDArray[np.str_],
    path: Labels | Sequence[str] | NDArray[np.str_],
    type: Labels | Sequence[str] | NDArray[np.str_],
    observed_m: Floats,
    elevation_deg: Floats | None = None,
    count_s: Floats | None = None,
    considered: UnestimatedErrors | None = None,
    candidates: UnestimatedErrors | None = None,
    doubts: Sequence[Doubt] = (),
    order: SeriesOrder | None = None,
    stated_m: Floats | None = None,
    consistency: bool = True,
    **described: Any,
) -> Solution:
    """Assemble a solution of an edited fit of n observations, its noise scaled to larger residuals.

    `considered` are the errors outside the weights of the fit, `candidates` the parameters that it holds at zero,
    `stated_m` (n,) the sigmas without variance components.
    """
    # `elevation_deg` is the lower of the stations' elevations, `count_s` NaN of types that are not counted. `described`
    # are further fields of Solution, among them position_pa_m, position_partials, rot_pa_to_me, pa_frame and me_frame.
    fit = edited.fit
    statuses = [fit.status if edited.is_settled else FitStatus.UNSETTLED, *(doubt.status for doubt in doubts)]
    types, paths = Labels.from_texts(type), Labels.from_texts(path)
    residuals = Residuals(
        epoch_utc=epoch_utc,
        stations=Labels.from_texts(station),
        types=types,
        paths=paths,
        observed_m=observed_m,
        residual_m=fit.residual_m,
        sigma_m=fit.sigma_m,
        elevation_deg=elevation_deg,
        count_s=count_s,
        statuses=edited.status,
    )
    if order is None:
        order = SeriesOrder.from_labels(types, paths, seconds_since_midnight(epoch_utc))
    runs = outlier_runs(edited, order)
    residuals = replace(residuals, statuses=with_reasons(edited.status, run_reasons(edited, runs)))
    covariance, correlation = estimated_covariance(edited, order)
    estimate = reported_estimate(fit, covariance, considered)
    if correlation is not None:
        added = correlation.added_covariance[np.ix_(*[~fit.parameters.considered] * 2)]
        correlation = replace(correlation, added_covariance=added)
    solution = Solution(
        status=next(
            (status for status in statuses if status is not FitStatus.CONVERGED), FitStatus.CONVERGED
        ),
        message="; ".join(text for text in (*(doubt.reason for doubt in doubts), edited.message) if text),
        parameters=estimate.parameters,
        values=estimate.values,
        formal_covariance=estimate.formal_covariance,
        covariance=estimate.covariance,
        noise_scale=fit.noise_scale,
        time_correlation=correlation,
        fit=FitStatistics(
            total=residuals.statistics("all"),
            by_station=residuals.statistics_by(residuals.stations),
            by_type=residuals.statistics_by(types),
            by_path=residuals.statistics_by(order.links),
            chi2=fit.chi2,
            dof=fit.dof,
            robust_scale=edited.robust_scale,
            excess_noise_m=dict(edited.additive_sigma_m),
            shared_noise_m=dict(edited.shared_sigma_m),
        ),
        residuals=residuals,
        observability=assess_observability(fit, None if count_s is None else ~np.isnan(count_s)),
        prior_effects=estimate.prior_effects,
        iterations=fit.iterations,
        fit_count=edited.fit_count,
        series_weights=edited.series_weights,
        consider=estimate.consider,
        **described,
    )
    if consistency:
        by_parameters = None if solution.trajectory is not None else solution.enu_partials
        hypotheses = Hypotheses.from_fit(edited, order, correlation, considered, candidates, count_s, runs)
        rejected = tuple(outlier_run_findings(edited, order, runs, epoch_utc, count_s))
        is_axis = [[item.name == f"state.{axis}" for item in solution.parameters] for axis in "xyz"]
        by_state = np.array(is_axis, dtype=np.float64) if np.any(is_axis) else None
        tests = assess_consistency(hypotheses, epoch_utc, by_parameters, rejected, by_state)
        sigmas = () if stated_m is None else wrong_sigmas(edited, stated_m, order)
        tests = replace(tests, findings=(*tests.findings, *sigmas))
        solution = with_findings(replace(solution, consistency=tests))
    return solution


def with_findings(solution: Solution) -> Solution:
    """Return a solution whose covariance and status allow for the errors that the consistency tests find."""
    adapted = solution.consistency.adapted
    if adapted is None:
        return solution
    sigmas = _shift_sigmas(solution, adapted)
    name = f"{UNMODELLED_ERROR}.{solution.consistency.findings[0].name}"
    error = Parameter(name, "1", UNMODELLED_ERROR, prior_sigma=1.0, role=Role.CONSIDERED)
    effect = Consider(ParameterSet([error]), adapted.shift[:, None])
    solution = replace(
        solution,
        consider=effect if solution.consider is None else solution.consider.joined(effect),
        consistency=replace(solution.consistency, adapted=replace(adapted, shift_sigmas=sigmas)),
    )
    # Unmodelled forces leave similar traces, so that a finding does not refute the estimate.
    has_forces = any(item.kind == "force" and not item.fixed for item in solution.parameters)
    if has_forces or not (solution.converged and sigmas > MAX_SHIFT_SIGMAS):
        return solution
    reason = (
        f"the errors found move the estimate by {sigmas:.1f} sigmas, more than {MAX_SHIFT_SIGMAS:g}: correct, exclude "
        "or estimate what is named"
    )
    message = "; ".join(text for text in (reason, solution.message) if text)
    return replace(solution, status=FitStatus.MISFIT, message=message)


def _shift_sigmas(solution: Solution, adapted: AdaptedEstimate) -> float:
    """Largest shift of a target, in total sigmas (Mahalanobis distance) of the estimate in whose it is shorter.

    An adapted estimate without most of the observations is far away by chance in a direction that these determined.
    """
    if solution.trajectory is not None:
        of_target = np.array([item.kind not in PARAMETERS for item in solution.parameters])
        of_target &= solution.parameters.free
        maps = [
            (np.eye(len(of_target))[of_target], solution.parameter_covariance()[np.ix_(of_target, of_target)])
        ]
    else:
        places = [solution.of_target(target.name) for target in solution.targets] or [solution]
        maps = [(place.enu_partials, place.position_covariance()) for place in places]
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
    solution: Solution, reference_pa_m: ArrayLike, name: str = "reference"
) -> ReferenceComparison:
    """Compare a solution with a known position along the sphere and in height, in metres and in total sigmas."""
    reference_pa_m = np.asarray(reference_pa_m)
    longitude_rad, latitude_rad, height_m = cartesian_to_selenographic(solution.rot_pa_to_me @ reference_pa_m)
    # The direction is that of the arc at the estimate, the origin of the covariance.
    axes = solution.rot_pa_to_enu
    difference_m = 0.0 - local_difference(reference_pa_m, solution.position_pa_m, axes).enu_m
    covariance = solution.position_covariance("enu")
    sigmas = np.sqrt(np.diag(covariance))
    single = [float(d / s) if 0.0 < s < np.inf else None for d, s in zip(difference_m, sigmas, strict=True)]
    combined = None
    if None not in single:
        try:
            root = np.linalg.cholesky(covariance)
            combined = float(np.linalg.norm(np.linalg.solve(root, difference_m)))
        except np.linalg.LinAlgError:
            combined = None  # a fixed direction makes the covariance singular
    east_m, north_m, up_m = difference_m.tolist()
    return ReferenceComparison(
        name=name,
        longitude_deg=math.degrees(longitude_rad),
        latitude_deg=math.degrees(latitude_rad),
        height_m=float(height_m),
        east_m=east_m,
        north_m=north_m,
        up_m=up_m,
        east_sigmas=single[0],
        north_sigmas=single[1],
        up_sigmas=single[2],
        combined_sigmas=combined,
    )
