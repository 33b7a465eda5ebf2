"""Status of a fit that has converged: whether its residuals and sigmas allow its use.

An additive variance component lets any residuals fit their sigmas, those of a wrong station too. Without these checks
exchanged stations and ranges 100 km too long converge (`tests/unit/jobs/test_verdict.py`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.earth.stations import Station, StationCatalogue, reordered_coordinates
from radioloc.errors import InputError
from radioloc.estimation.adaptation import MAX_SHIFT_SIGMAS
from radioloc.estimation.consider import UnestimatedErrors
from radioloc.estimation.consistency_results import ConsistencyTest
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.stated_sigmas import noise_over_stated
from radioloc.estimation.status import Doubt, FitStatus
from radioloc.estimation.variance_components import mean_leverage
from radioloc.jobs.normal_points import CURVATURE_PER_S2
from radioloc.labels import USED
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import KINDS, is_integrated
from radioloc.measurements.target_motion import Motions
from radioloc.noise.whitening import slices
from radioloc.results.build import AssessedFit
from radioloc.results.estimate import LocatedEstimate
from radioloc.study.study import Study
from radioloc.targets.design import a_priori_orbits
from radioloc.vectors import Floats, Indices, Mask

MAX_MISFIT_RATIO = 20.0
"""Largest ratio of residuals to stated sigmas that errors of the model explain: 5 for laser ranges with DE421, 10 for
radio ranges without any model of the troposphere."""
_MIN_SIGMA_M = 0.01
"""Accuracy of modelled ranges and delays, to which smaller stated sigmas, as of laser ranges, are raised. Doppler has
no such floor, as errors common to both ends of a count interval cancel."""
_MAX_OUTLIER_FRACTION = 0.2
"""Largest fraction of outliers of a station: blunders are a few per cent, more are an error of the station."""
_MIN_OUTLIER_COUNT = 3  # fewer are blunders, whatever their fraction of few observations
MAX_POSITION_SIGMA_M = 0.1 * MEAN_LUNAR_RADIUS_M
"""Largest sigma of a position with a meaningful error ellipse: the ground bends away from it by 9 km."""
_ENDED = (FitStatus.CONVERGED, FitStatus.DIVERGED, FitStatus.MAX_ITERATIONS, FitStatus.OFF_THE_MOON)
"""Status of fits whose cause may be a position that is not observable."""
_MAX_CURVATURE_SIGMAS = 0.1  # error of normal points by curved residuals, which they have in common
_SAMPLE_ROWS = 20  # of a station
_MIN_IMPROVEMENT = 10.0  # ratio of the rms of residuals with other axes or signs of a station's coordinates
_MAX_RMS_M = 1.0e5  # with them, at an a-priori position some tens of kilometres off
MAX_START_DISTANCE_M = 1e5
"""Largest distance of an estimate from the a-priori position within which all starts end at one place."""


def with_considered(sigma_m: Floats, errors: UnestimatedErrors) -> Floats:
    """Return sigmas (n,) with considered errors outside the weights, which the residuals contain, m."""
    if not errors.parameters:
        return sigma_m
    variance_m2, prior_sigmas = np.square(sigma_m), errors.parameters.prior_sigmas
    for part in slices(len(sigma_m)):
        rows = np.arange(part.start, min(part.stop, len(sigma_m)))
        variance_m2[rows] += np.square(errors.partials(rows) * prior_sigmas).sum(axis=1)
    return np.sqrt(variance_m2)


def misfits(edited: EditedFit, stated_m: Floats, order: SeriesOrder) -> Iterator[Doubt]:
    """Doubt types with used residuals far beyond their sigmas (n,), and stations with many outliers."""
    fit, types = edited.fit, order.types
    yield from _rejected_stations(edited, order)
    free_part = mean_leverage(fit)
    beyond, floored = [], ""
    for name in types.present():
        rows = fit.used & types.are(name)
        count = int(rows.sum())
        dof = count * (1.0 - free_part)
        if dof < 0.5:  # without redundancy it is zero but for rounding
            continue
        floor_m = 0.0 if is_integrated(np.array(KINDS.index(name))) else _MIN_SIGMA_M
        residual_m, sigma_m = fit.residual_m[rows], np.maximum(stated_m[rows], floor_m)
        ratio = math.sqrt(float(np.square(residual_m / sigma_m).sum()) / dof)
        # Noise larger than stated is in the variance components and leaves the estimate usable.
        if ratio > MAX_MISFIT_RATIO:
            noise_ratio = noise_over_stated(edited, stated_m, order)[order.code[rows]]
            ratio = math.sqrt(float(np.square(residual_m / (noise_ratio * sigma_m)).sum()) / dof)
        if ratio > MAX_MISFIT_RATIO:
            rms_m = math.sqrt(float(np.square(residual_m).mean()))
            beyond.append(f"of {name} {ratio:.4g} times ({rms_m:.3g} m rms)")
            if stated_m[rows].min() < floor_m:
                floored = f", those below {floor_m:g} m taken as {floor_m:g} m"
    if beyond:
        yield Doubt(
            FitStatus.MISFIT,
            f"the residuals are far beyond their stated sigmas{floored}: {', '.join(beyond)}; errors of the model "
            f"explain up to {MAX_MISFIT_RATIO:g} times. If no likely cause is named, look for a wrong station, target "
            "(an orbiter needs a trajectory or dynamics) or sign, for outliers among few observations, a term switched "
            "off, or a considered parameter to estimate",
        )


def _rejected_stations(edited: EditedFit, order: SeriesOrder) -> Iterator[Doubt]:
    """Doubt types of observation of stations or baselines with many outliers."""
    series_count = len(order.series)
    outliers = np.bincount(order.code, edited.outliers, series_count)
    usable = np.bincount(order.code, edited.initial_status.are(USED), series_count)
    receivers = (sorted(station for station, sign in item.signs.items() if sign) for item in order.series)
    names = [
        f"{item.kind} observations of {'-'.join(stations)}"
        for item, stations in zip(order.series, receivers, strict=True)
    ]
    rejected = list[str]()
    for name in dict.fromkeys(names):
        codes = [code for code, series_name in enumerate(names) if series_name == name]
        count, total = int(outliers[codes].sum()), int(usable[codes].sum())
        if count >= _MIN_OUTLIER_COUNT and count > _MAX_OUTLIER_FRACTION * total:
            rejected.append(f"{count} of {total} {name}")
    if rejected:
        yield Doubt(
            FitStatus.MISFIT,
            f"{', '.join(rejected)} are rejected as outliers, more than {_MAX_OUTLIER_FRACTION:.0%}; correct or "
            "exclude them, or look for a wrong station, target or sign",
        )


def decide_status(
    assessed: AssessedFit, doubts: Sequence[Doubt], mistake: ConsistencyTest | None = None
) -> tuple[FitStatus, str]:
    """Return the status of a fit and its message: end of the fit, doubts, findings, sigma of the position."""
    edited = assessed.edited
    status = edited.fit.status if edited.is_settled else FitStatus.UNSETTLED
    reasons, remark = list(doubts), edited.message
    if status is FitStatus.CONVERGED:
        reasons = reasons or [*_finding_doubts(assessed, mistake)][:1]
        status = reasons[0].status if reasons else status
    if status in _ENDED and _residuals_fit(doubts):
        for doubt in _sigma_doubts(assessed.estimate):
            if status is FitStatus.OFF_THE_MOON:  # such a sigma explains the height
                reasons, remark = [], ""
            status, reasons = doubt.status, [doubt, *reasons]
    return status, "; ".join(filter(None, (*(doubt.reason for doubt in reasons), remark)))


def _residuals_fit(doubts: Sequence[Doubt]) -> bool:
    """Return whether all doubts concern the place."""
    return all(doubt.status is not FitStatus.MISFIT for doubt in doubts)


def _finding_doubts(assessed: AssessedFit, mistake: ConsistencyTest | None) -> Iterator[Doubt]:
    """Doubt an estimate that moves by the errors found, and observations with a mistake."""
    adapted = assessed.estimate.adapted
    # Unmodelled forces leave similar traces, so that a finding does not refute the estimate.
    has_forces = any(item.kind == "force" and not item.fixed for item in assessed.estimate.parameters)
    if adapted is not None and adapted.shift_sigmas > MAX_SHIFT_SIGMAS and not has_forces:
        yield Doubt(
            FitStatus.MISFIT,
            f"the errors found move the estimate by {adapted.shift_sigmas:.1f} sigmas, more than {MAX_SHIFT_SIGMAS:g}: "
            "correct, exclude or estimate what is named",
        )
    if mistake is not None:
        yield Doubt(FitStatus.MISFIT, "the observations have a mistake: correct what is named")


def _sigma_doubts(estimate: LocatedEstimate) -> Iterator[Doubt]:
    """Doubt a position whose sigma exceeds a tenth of the lunar radius."""
    if estimate.trajectory is not None or not estimate.position_estimated:
        return
    sigma_m = max(float(np.linalg.norm(place.sigma_enu_m())) for place in estimate.places)
    if sigma_m > MAX_POSITION_SIGMA_M:
        yield Doubt(
            FitStatus.UNOBSERVABLE,
            f"the sigma of the position is {1e-3 * sigma_m:.0f} km, more than a tenth of the lunar radius: the "
            "observations do not determine the position; add ranges, VLBI delays, an a-priori height, more stations or "
            "a longer arc",
        )


def curvature_doubts(interval_s: float, away_m: float, min_sigma_m: float) -> Iterator[Doubt]:
    """Doubt normal points that were condensed too far from the estimate for straight lines."""
    error_m = CURVATURE_PER_S2 * away_m * interval_s**2
    if error_m > _MAX_CURVATURE_SIGMAS * min_sigma_m:
        yield Doubt(
            FitStatus.MISFIT,
            f"normal points of {interval_s:g} s, condensed {away_m / 1e3:.3g} km from the estimate, have errors of up "
            f"to {error_m:.2g} m: give the estimate as the a-priori position in [target], or a shorter normal_point_s",
        )


def search_hints(study: Study, estimate: LocatedEstimate, away_m: float, *, converged: bool) -> Iterator[str]:
    """Name what helps where an estimate cannot be used, or is far from the a-priori positions."""
    if study.orbiter is not None:
        if not converged:
            command = f"`radioloc search {study.path or 'STUDY.toml'}`"
            yield f"{command} looks for manoeuvres that the study does not state"
    elif estimate.trajectory is None and estimate.position_estimated and away_m > MAX_START_DISTANCE_M:
        yield (
            f"the fit ended {away_m / 1e3:.0f} km from the a-priori position: check its unit, signs and order (degrees "
            "east and north), or give a better one in [target]"
        )


def coordinate_doubts(
    predictor: Predictor, motions: Motions, used: Mask, doubts: Sequence[Doubt]
) -> Iterator[str]:
    """Yield a warning for each station that fits, or sees the target, only with exchanged axes or signs."""
    fits = _residuals_fit(doubts)
    # Without it a station with x and y exchanged is only far off (tests/unit/jobs/test_station_doubts.py).
    observations, shipped = predictor.observations, StationCatalogue.default()
    for name in () if a_priori_orbits(predictor) else predictor.stations:
        station = predictor.model.catalogue.get(name)
        if station.name in shipped and np.array_equal(shipped[station.name].itrf_m, station.itrf_m):
            continue
        of_link = np.array([name in link.stations for link in observations.links])
        rows = np.flatnonzero(of_link[observations.link])
        if not len(rows) or (fits and used[rows].any()):
            continue
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, _SAMPLE_ROWS).astype(int))]
        given_m = _rms_m(predictor, motions, rows, station)
        rms_by_mistake_m = {
            mistake: _rms_m(predictor, motions, rows, station, itrf_m)
            for mistake, itrf_m in reordered_coordinates(station.itrf_m).items()
        }
        mistake, rms_m = min(rms_by_mistake_m.items(), key=lambda item: item[1])
        if rms_m < min(given_m / _MIN_IMPROVEMENT, _MAX_RMS_M):
            stated = "it does not see the target" if np.isinf(given_m) else f"{1e-3 * given_m:.0f} km"
            yield (
                f"WARNING: with {mistake}, observations of {name} fit an a-priori position to {1e-3 * rms_m:.3g} km "
                f"(as given: {stated}): check the coordinates in [stations.{name}]"
            )


def _rms_m(
    predictor: Predictor, motions: Motions, rows: Indices, station: Station, itrf_m: Floats | None = None
) -> float:
    """Return the rms of residuals with other coordinates of a station; infinite without a model or a visible target."""
    stations = [item for item in predictor.model.catalogue if item.name != station.name]
    some = predictor.observations.select(rows)
    try:
        changed = station if itrf_m is None else replace(station, itrf_m=itrf_m)
        model = replace(predictor.model, catalogue=StationCatalogue([*stations, changed]))
        computed = prepare_predictor(model, some, motions, "exact", predictor.targets).compute()
    except InputError:  # such as a height outside the model of the troposphere
        return np.inf
    if not computed.usable.any():
        return np.inf
    return float(np.sqrt(np.square((some.value_m - computed.value_m)[computed.usable]).mean()))
