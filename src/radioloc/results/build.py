"""Assemble a :class:`Solution` from an edited fit and plain arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.boundary import bare_arguments
from radioloc.estimation.combination import ReferenceComparison
from radioloc.estimation.consider import ConsideredErrors, consider, prior_effects
from radioloc.estimation.consistency import assess_consistency
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.least_squares import FitStatus
from radioloc.estimation.observability import assess_observability
from radioloc.estimation.series import SeriesOrder, seconds_since_midnight
from radioloc.estimation.statistics import FitStatistics, Residuals
from radioloc.estimation.time_correlation import estimated_covariance
from radioloc.labels import Labels
from radioloc.lunar.local import local_difference
from radioloc.lunar.selenographic import cartesian_to_selenographic
from radioloc.results.solution import Solution
from radioloc.time import Epochs


@dataclass(frozen=True, slots=True)
class Doubt:
    """Why an estimate cannot be used although the fit converged: a status, and a sentence with numbers."""

    status: FitStatus
    reason: str


def build_solution(
    edited: EditedFit,
    *,
    epoch_utc: Epochs,
    station: Labels | Sequence[str] | NDArray[np.str_],
    path: Labels | Sequence[str] | NDArray[np.str_],
    type: Labels | Sequence[str] | NDArray[np.str_],
    observed_m: NDArray[np.float64],
    elevation_deg: NDArray[np.float64] | None = None,
    count_s: NDArray[np.float64] | None = None,
    reference_pa_m: ArrayLike | None = None,
    reference_name: str = "reference",
    considered: ConsideredErrors | None = None,
    doubts: Sequence[Doubt] = (),
    order: SeriesOrder | None = None,
    consistency: bool = True,
    **described: Any,
) -> Solution:
    """Put together what a fit has to say.

    The observation noise is scaled to what the residuals show, where that is significantly more than stated, and
    residuals of a link that are correlated in time are allowed for (:mod:`~radioloc.estimation.time_correlation`).

    Parameters
    ----------
    edited : EditedFit
        The fit with its editing; n observations, p parameters.
    epoch_utc : Epochs
        UTC of the observations, n epochs.
    station, path, type : Labels, or sequence of str, length n
        Station that statistics are grouped by; participants of the light path; kind of measurement.
    observed_m : array_like, shape (n,)
        Observed values, m; ranges and Doppler are of the round trip.
    elevation_deg : array_like, shape (n,), optional
        Lower of the stations' elevations, deg.
    count_s : array_like, shape (n,), optional
        Count intervals, s; NaN of what is not counted.
    reference_pa_m : array_like, shape (3,), optional
        A known position in the same principal axes, m.
    reference_name : str
        What it is.
    considered : ConsideredErrors, optional
        Errors that the data do not tell, with their partials.
    doubts : sequence of Doubt
        Why the estimate cannot be used although the fit converged.
    order : SeriesOrder, optional
        The observations by series, where they are sorted already.
    consistency : bool
        Whether to look for who does not fit, which takes a third of the time of a fit.
    **described
        Fields of :class:`Solution` as they are: `position_pa_m`, `position_partials`, `rot_pa_to_me`, `pa_frame` and
        `me_frame` always; where there are any, `name`, `ephemeris_sigma_enu_m`, `notes`, `provenance`,
        `trajectory` and `targets`.

    Raises
    ------
    InputError
        A column or a matrix is not of the shape that the fit asks for.

    Examples
    --------
    >>> import numpy as np
    >>> from radioloc.estimation import Parameter, ParameterSet, fit_with_editing
    >>> from radioloc.results import build_solution
    >>> from radioloc.time import Epochs
    >>> parameters = ParameterSet([Parameter(f"position.{axis}", "m", "position") for axis in "xyz"])
    >>> directions = np.column_stack([np.cos(np.arange(9.0)), np.sin(np.arange(9.0)), np.arange(9.0) % 2])
    >>> observed_m = directions @ [1737400.0, 0.0, 0.0] + 0.1 * np.cos(3.0 * np.arange(9.0))
    >>> edited = fit_with_editing(lambda x: (observed_m - directions @ x, directions), parameters, 0.1)
    >>> solution = build_solution(
    ...     edited, epoch_utc=Epochs.from_jd(2460432.5, np.arange(9) / 9, "UTC"), station=["A"] * 9, path=["A"] * 9,
    ...     type=["range"] * 9, observed_m=observed_m, position_pa_m=edited.fit.x, position_partials=np.eye(3),
    ...     rot_pa_to_me=np.eye(3), pa_frame="PA_DE421", me_frame="ME_DE421",
    ... )
    >>> solution.converged, solution.sigma_enu_m().shape
    (True, (3,))
    """
    fit = edited.fit
    statuses = [fit.status if edited.complete else FitStatus.UNSETTLED, *(doubt.status for doubt in doubts)]
    types, paths = Labels.of(type), Labels.of(path)
    residuals = Residuals(
        epoch_utc=epoch_utc,
        stations=Labels.of(station),
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
        order = SeriesOrder.of(types, paths, seconds_since_midnight(epoch_utc))
    common = None if considered is None else considered.at_stations
    covariance, correlation = estimated_covariance(edited, order, common)
    solution = Solution(
        status=next(
            (status for status in statuses if status is not FitStatus.CONVERGED), FitStatus.CONVERGED
        ),
        message="; ".join(text for text in (*(doubt.reason for doubt in doubts), edited.message) if text),
        parameters=fit.parameters,
        values=fit.x,
        formal_covariance=fit.covariance,
        covariance=covariance,
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
        prior_effects=prior_effects(fit),
        iterations=fit.iterations,
        passes=edited.passes,
        series_weights=edited.series_weights,
        consider=None if considered is None else consider(fit, considered),
        **described,
    )
    if consistency:
        by_parameters = None if solution.trajectory is not None else solution.enu_by_parameters
        found = assess_consistency(edited, order, correlation, epoch_utc, by_parameters, considered)
        solution = replace(solution, consistency=found)
    if reference_pa_m is None:
        return solution
    return replace(solution, reference=compare_with(solution, reference_pa_m, reference_name))


@bare_arguments
def compare_with(
    solution: Solution, reference_pa_m: ArrayLike, name: str = "reference"
) -> ReferenceComparison:
    """Difference of a solution to a known position along the sphere and in height, in metres and in total sigmas.

    Parameters
    ----------
    solution : Solution
        The estimate.
    reference_pa_m : array_like, shape (3,)
        Known position in the same principal axes, m.
    name : str
        What it is.

    Examples
    --------
    >>> import radioloc
    >>> from radioloc.results import compare_with
    >>> solution = radioloc.locate("examples/apollo15/apollo15.toml")
    >>> published = compare_with(solution, [1554678.949, 98094.118, 765004.906], "JPL")
    >>> round(published.distance_m, 1)
    0.4
    """
    reference_pa_m = np.asarray(reference_pa_m)
    longitude_rad, latitude_rad, height_m = cartesian_to_selenographic(solution.rot_pa_to_me @ reference_pa_m)
    # The arc to the reference, reversed: its direction is that at the estimate, where the covariance is given.
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
            combined = None  # a direction is held: there is no inverse
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
