"""Assemble a :class:`Solution` from an edited fit and plain arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.errors import InputError
from radioloc.estimation.consider import consider
from radioloc.estimation.correlated_weights import SeriesWeight
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.labels import Labels
from radioloc.estimation.least_squares import FitResult, FitStatus
from radioloc.estimation.observability import assess_observability
from radioloc.estimation.residuals import Residuals
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.solution import ReferenceComparison, Solution, TargetPosition
from radioloc.estimation.statistics import (
    SCALING_PROBABILITY,
    FitStatistics,
    chi2_quantile,
    group_statistics,
    statistics_by,
)
from radioloc.estimation.time_correlation import TimeCorrelation, assess_time_correlation
from radioloc.time import Epochs


def build_solution(
    edited: EditedFit,
    *,
    position_pa_m: ArrayLike,
    position_partials: ArrayLike,
    rot_pa_to_me: ArrayLike,
    pa_frame: str,
    me_frame: str,
    epoch_utc: Epochs,
    station: Labels | Sequence[str] | NDArray[np.str_],
    observed_m: ArrayLike,
    path: Labels | Sequence[str] | NDArray[np.str_] | None = None,
    type: Labels | Sequence[str] | NDArray[np.str_] | str = "range",
    elevation_deg: ArrayLike | None = None,
    ephemeris_sigma_enu_m: ArrayLike = (0.0, 0.0, 0.0),
    excess_noise_m: Mapping[str, float] | None = None,
    series_weights: Sequence[SeriesWeight] = (),
    scale_covariance: bool = True,
    reference_pa_m: ArrayLike | None = None,
    reference_name: str = "reference",
    name: str = "solution",
    notes: Sequence[str] = (),
    provenance: Mapping[str, Any] | None = None,
    trajectory: str | None = None,
    targets: Sequence[TargetPosition] = (),
) -> Solution:
    """Put together what a fit has to say.

    Parameters
    ----------
    edited : EditedFit
        The fit with its editing; n observations, p parameters.
    position_pa_m : array_like, shape (3,)
        Position at the estimated parameters in principal axes, m.
    position_partials : array_like, shape (3, p)
        d(position_pa)/d(parameter) there: the identity for cartesian parameters, zeros for others.
    rot_pa_to_me : array_like, shape (3, 3)
        Rotation from principal to mean-Earth axes.
    pa_frame, me_frame : str
        Their names, such as ``"PA_DE421"`` and ``"ME_DE421"``.
    epoch_utc : Epochs
        UTC of the observations, n epochs.
    station, path : Labels, or sequence of str, length n
        Station that statistics are grouped by; participants of the light path (the station if not given).
    observed_m : array_like, shape (n,)
        Observed values, m of the whole light path.
    type : str, Labels, or sequence of str, length n
        Kind of measurement.
    elevation_deg : array_like, shape (n,), optional
        Lower of the stations' elevations, deg.
    ephemeris_sigma_enu_m : array_like, shape (3,)
        Assumed error of ephemeris and orientation as seen in the position, east, north, up, m.
    excess_noise_m : mapping of str to float, optional
        Noise that was added in quadrature to the stated sigmas of each type, m.
    series_weights : sequence of SeriesWeight
        Series that the fit weighs as fewer observations.
    scale_covariance : bool
        Scale the observation noise to what the residuals show, where that is significantly more than stated, and
        allow for residuals of a link that are correlated in time (:mod:`~radioloc.estimation.time_correlation`).
    reference_pa_m : array_like, shape (3,), optional
        A known position in the same principal axes, m.
    reference_name : str
        What it is.
    name : str
        Name of the study or the target.
    notes : sequence of str
        Sentences for the reader.
    provenance : mapping, optional
        Kernels with their hashes, tables, versions, settings.
    trajectory : str, optional
        What the target moves along, if it is no point fixed to the Moon; the position is then an offset from it.
    targets : sequence of TargetPosition
        All targets, where there are several; the first is that of the position.

    Raises
    ------
    InputError
        A column or a matrix is not of the shape that the fit asks for.
    """
    fit = edited.fit
    n, p = len(fit.residual_m), len(fit.parameters)
    stations = _labels("station", station, n)
    residuals = Residuals(
        epoch_utc=epoch_utc,
        stations=stations,
        types=_labels("type", type, n),
        paths=stations if path is None else _labels("path", path, n),
        observed_m=_array("observed_m", observed_m, (n,)),
        residual_m=_array("residual_m", fit.residual_m, (n,)),
        sigma_m=_array("sigma_m", fit.sigma_m, (n,)),
        elevation_deg=None if elevation_deg is None else _array("elevation_deg", elevation_deg, (n,)),
        statuses=edited.status,
    )
    if len(epoch_utc) != n:
        raise InputError(f"there are {len(epoch_utc)} epochs for {n} observations")
    statistics = _fit_statistics(edited, residuals, excess_noise_m or {})
    rotation = _array("rot_pa_to_me", rot_pa_to_me, (3, 3))
    position = _array("position_pa_m", position_pa_m, (3,))
    noise_scale, correlation = 1.0, None
    if scale_covariance:
        noise_scale, correlation = _what_residuals_show(edited, residuals)
    covariance = scaled_covariance(fit, noise_scale)
    if correlation is not None:
        covariance = covariance + correlation.added_covariance
    solution = Solution(
        name=name,
        converged=edited.converged,
        status=fit.status.value if edited.complete else "not converged: the editing did not settle",
        message=edited.message,
        parameters=fit.parameters,
        values=_array("x", fit.x, (p,)),
        formal_covariance=_array("covariance", fit.covariance, (p, p)),
        covariance=_array("covariance", covariance, (p, p)),
        noise_scale=noise_scale,
        time_correlation=correlation,
        series_weights=tuple(series_weights),
        pa_frame=pa_frame,
        me_frame=me_frame,
        position_pa_m=position,
        position_me_m=_array("position_me_m", rotation @ position, (3,)),
        position_partials=_array("position_partials", position_partials, (3, p)),
        rot_pa_to_me=rotation,
        ephemeris_sigma_enu_m=_array("ephemeris_sigma_enu_m", ephemeris_sigma_enu_m, (3,)),
        fit=statistics,
        residuals=residuals,
        observability=assess_observability(fit),
        iterations=fit.iterations,
        passes=edited.passes,
        notes=tuple(notes),
        provenance=dict(provenance or {}),
        consider=consider(fit),
        targets=tuple(targets),
        trajectory=trajectory,
    )
    if reference_pa_m is None:
        return solution
    reference = compare_with(solution, _array("reference_pa_m", reference_pa_m, (3,)), reference_name)
    return replace(solution, reference=reference)


def _what_residuals_show(edited: EditedFit, residuals: Residuals) -> tuple[float, TimeCorrelation | None]:
    """By how much the noise is larger than stated, and which residuals are correlated in time."""
    fit = edited.fit
    if not (edited.complete and fit.status in (FitStatus.CONVERGED, FitStatus.UNOBSERVABLE)):
        return fit.noise_scale, None
    time_s = seconds_since_midnight(residuals.epoch_utc)
    order = SeriesOrder.of(residuals.types, residuals.paths, time_s)
    return fit.noise_scale, assess_time_correlation(fit, order)


def scaled_covariance(fit: FitResult, noise_scale: float) -> NDArray[np.float64]:
    """Covariance of the estimate if the observation noise is larger than stated by a factor, shape (p, p).

    Notes
    -----
    The estimate weighs observations by their stated sigmas and a-priori values by theirs; only the former
    are found too small. With the information A of the observations, P of the a-priori values and C = (A +
    P)^-1, the estimate's covariance is then C (f^2 A + P) C = f^2 C + (1 - f^2) C P C. Without a-priori
    values it is f^2 C.
    """
    formal = np.array(fit.covariance)
    undetermined = np.isinf(np.diag(formal))
    formal[undetermined, undetermined] = 0.0
    prior_information = np.diag(fit.parameters.prior_sigmas**-2.0)
    scaled = noise_scale**2 * formal + (1.0 - noise_scale**2) * formal @ prior_information @ formal
    scaled[undetermined, undetermined] = np.inf
    return scaled


def compare_with(
    solution: Solution, reference_pa_m: NDArray[np.float64], name: str = "reference"
) -> ReferenceComparison:
    """Difference of a solution to a known position, in metres and in total sigmas.

    Parameters
    ----------
    solution : Solution
        The estimate.
    reference_pa_m : ndarray, shape (3,)
        Known position in the same principal axes, m.
    name : str
        What it is.
    """
    difference_m = solution.rot_pa_to_enu @ (solution.position_pa_m - reference_pa_m)
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
    east_m, north_m, up_m = (float(d) for d in difference_m)
    return ReferenceComparison(name, east_m, north_m, up_m, single[0], single[1], single[2], combined)


def _fit_statistics(
    edited: EditedFit, residuals: Residuals, excess_noise_m: Mapping[str, float]
) -> FitStatistics:
    fit = edited.fit
    columns = (residuals.residual_m, residuals.sigma_m, residuals.used)
    bound = chi2_quantile(SCALING_PROBABILITY, fit.dof) / fit.dof if fit.dof > 0 else None
    return FitStatistics(
        total=group_statistics("all", *columns),
        by_station=statistics_by(residuals.stations, *columns),
        by_type=statistics_by(residuals.types, *columns),
        by_path=statistics_by(residuals.series, *columns),
        chi2=fit.chi2,
        dof=fit.dof,
        chi2_per_dof=fit.chi2_per_dof,
        chi2_per_dof_bound=bound,
        robust_scale=edited.robust_scale,
        excess_noise_m=dict(excess_noise_m),
    )


def seconds_since_midnight(epoch: Epochs) -> NDArray[np.float64]:
    """Time since the first midnight, s, shape (n,); a leap second is nothing to how long errors last."""
    first = epoch.jd.min() if len(epoch) else 0.0
    return np.asarray(((epoch.jd - first) + epoch.fraction) * SECONDS_PER_DAY)


def _array(name: str, values: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Read-only array of the right shape; a copy unless it owns its numbers and is read-only already."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise InputError(f"{name} has shape {array.shape}, but {shape} is needed")
    if array.flags.writeable or not array.flags.owndata:
        array = array.copy()
        array.flags.writeable = False
    return array


def _labels(name: str, values: Labels | Sequence[str] | NDArray[np.str_] | str, n: int) -> Labels:
    if isinstance(values, str):
        return Labels(np.zeros(n, dtype=np.int32), (values,))
    labels = Labels.of(values)
    if labels.codes.shape != (n,):
        raise InputError(f"{name} has shape {labels.codes.shape}, but there are {n} observations")
    return labels
