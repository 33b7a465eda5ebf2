"""Part of the printed summary of a solution that describes the observations and their residuals."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from radioloc.constants import SECONDS_PER_DAY
from radioloc.estimation.consistency_results import ConsistencyTest
from radioloc.estimation.statistics import GroupStatistics, Residuals, chi2_quantile
from radioloc.labels import Labels
from radioloc.measurements.link import Link
from radioloc.results.cards import (
    REJECTED,
    RESIDUALS,
    Detail,
    Field,
    duration,
    first_lines,
    in_section,
    metres,
    plural,
    remaining_line,
    signed_metres,
    table,
)
from radioloc.results.names import link_names
from radioloc.results.reliability_card import reliability_lines
from radioloc.results.solution import Solution
from radioloc.time import utc_strings
from radioloc.vectors import Indices

# A card fits a screen; to_dict() has all rows.
_MAX_TABLE_ROWS = 6
_MAX_LINK_ROWS = 12  # six baselines of four stations, and some links of ranges
_MAX_SERIES_ROWS = 3
_MAX_REJECTED_LINES = 3
_MAX_PAGE_ROWS = 300  # rejected observations in the table of a page
_MAX_UNFOLDED_ROWS = 20  # the page folds a longer table
_RANGE_SIGNIFICANCE_LEVEL = 1e-3  # for all pairs of links of a card together
_ELLIPSOID_PROBABILITY = 0.683
_RELATIVE_ROUNDING = 1e-14  # of variances
_MIN_REPORTED_SIGMA_FACTOR = 1.05  # the card states a time correlation that enlarges the sigma by more
_MIN_ADVISED_SIGMA_FACTOR = 3.0  # above it, correlated weights give a much better estimate


def fit_fields(solution: Solution) -> Iterator[Field]:
    """Yield the fields on observations, fit, time correlation, findings, residuals and rejected observations."""
    yield from in_section(
        RESIDUALS,
        Field("data", _data_lines(solution.residuals)),
        Field("fit", _fit_lines(solution)),
        _correlation_field(solution),
        Field("misfit", finding_lines(solution, serious=False)),
        Field("reliability", reliability_lines(solution.consistency.reliability)),
        *_residual_fields(solution),
    )
    yield Field("rejected", _rejected_lines(solution.residuals), section="")


def rejected_detail(solution: Solution) -> Detail:
    """Return the rejected observations as a table."""
    residuals, count = solution.residuals, solution.fit.total.rejected
    rows = _rejected_rows(residuals)[:_MAX_PAGE_ROWS]
    epochs, links = utc_strings(residuals.epoch_utc[rows], decimals=0), _link_labels(residuals)[rows]
    sizes = (f"{value:.4g}" for value in residuals.residual_m[rows])
    cells = zip(epochs, links, sizes, residuals.statuses[rows], strict=True)
    title = f"{len(rows)} of {count}" if count > len(rows) else "All"
    field = Field("", heading=("UTC", "link", "residual, m", "reason"), rows=cells)
    heading = f"{title}, the largest residuals in sigmas first"
    return Detail(REJECTED, heading, (field,), is_open=count <= _MAX_UNFOLDED_ROWS)


def finding_lines(solution: Solution, *, serious: bool) -> Iterator[str]:
    """Yield the serious findings, for the lines below the status, or the others, for the section on residuals.

    The position that is estimated together with all errors follows.
    """
    texts = [str(item) for item in select_findings(solution, serious=serious)]
    prefix = "WARNING: " if solution.converged else "likely cause: "
    yield from (f"{prefix if serious else ''}{text}" for text in texts)
    adapted, count = solution.with_findings(), len(solution.consistency.findings)
    if adapted is None or not texts or not (serious or len(texts) == count):
        return
    longitude_deg, latitude_deg, height_m = adapted.selenographic
    errors = f"all {count} errors" if count > 1 else "this error"
    yield (
        f"position with {errors} estimated: {longitude_deg:.8f} deg E, {latitude_deg:+.8f} deg N, "
        f"height {height_m:.3f} m; 1 sigma east, north, up {', '.join(map(metres, adapted.sigma_enu_m()))} m. "
        "The total sigma includes the difference of this position from the estimate"
    )


def select_findings(solution: Solution, *, serious: bool) -> Iterator[ConsistencyTest]:
    """Yield the serious findings, or all others.

    A finding is serious if it moves the position out of its 68 % ellipsoid, or if the solution is not usable.
    """
    for finding in solution.consistency.findings:
        if serious == (not solution.converged or _is_outside_ellipsoid(solution, finding.shift_enu_m)):
            yield finding


def _is_outside_ellipsoid(solution: Solution, shift_enu_m: tuple[float, float, float] | None) -> bool:
    """Return whether d^T P^-1 d of a shift d exceeds the 68 % quantile of chi-square.

    P is the total covariance of the position minus the outer product of the joint shift by all findings, which that
    covariance includes. A moving target has no shift.
    """
    if shift_enu_m is None or not solution.position_determined:
        return False
    shift_m, covariance_m2 = np.array(shift_enu_m), solution.position_covariance()
    if (adapted := solution.adapted) is not None:
        joint_shift_m = solution.enu_partials @ adapted.shift
        covariance_m2 = covariance_m2 - np.outer(joint_shift_m, joint_shift_m)
    variances_m2, axes = np.linalg.eigh(covariance_m2)
    is_free = variances_m2 > _RELATIVE_ROUNDING * variances_m2.max()  # a fixed direction has zero variance
    chi2 = float(((shift_m @ axes[:, is_free]) ** 2 / variances_m2[is_free]).sum())
    return bool(is_free.any()) and chi2 > chi2_quantile(_ELLIPSOID_PROBABILITY, int(is_free.sum()))


def _data_lines(residuals: Residuals) -> Iterator[str]:
    """Yield number, stations and time span of the observations."""
    epochs = residuals.epoch_utc
    if not len(residuals):
        yield "no observations"
        return
    ends = epochs[np.lexsort((epochs.fraction, epochs.jd))[[0, -1]]]
    span_s = SECONDS_PER_DAY * float(np.diff(ends.jd)[0] + np.diff(ends.fraction)[0])
    stations = plural(len(_stations(residuals)), "station")
    yield f"{plural(len(residuals), 'observation')} from {stations} over {duration(span_s)},"
    yield f"{' to '.join(utc_strings(ends, decimals=0))} UTC"


def _fit_lines(solution: Solution) -> Iterator[str]:
    """Yield counts and wrms, noise beyond the stated sigmas, and the test of chi-square."""
    fit, types = solution.fit, solution.residuals.types.present()
    line = f"{fit.total.used} used, {fit.total.rejected} rejected"
    # Ranges and Doppler, both in metres, have no common rms.
    if fit.total.wrms_m is not None and len(types) <= 1:
        line += f"; wrms {metres(fit.total.wrms_m)} m"
        if types == ("range",):
            line += f" round trip ({metres(0.5 * fit.total.wrms_m)} m one way)"
    yield line
    for text, sigmas_m in (
        ("noise added in quadrature to the stated sigmas", fit.excess_noise_m),
        ("errors of stations common to the delays of one epoch, 1 sigma", fit.shared_noise_m),
    ):
        sizes = [f"{name} {metres(sigma_m)} m" for name, sigma_m in sigmas_m.items() if sigma_m > 0.0]
        if sizes:
            yield f"{text}: {', '.join(first_lines(sizes, _MAX_TABLE_ROWS))}"
    if fit.chi2_per_dof is None or fit.chi2_per_dof_bound is None:
        yield "no redundancy: the stated sigmas cannot be tested"
        return
    line = f"chi2/dof {fit.chi2_per_dof:.3g} with {fit.dof} degrees of freedom"
    if fit.chi2_per_dof > fit.chi2_per_dof_bound:
        line += (
            f": the residuals are {math.sqrt(fit.chi2_per_dof):.3g} times their sigmas "
            f"(with correct sigmas chi2/dof is below {fit.chi2_per_dof_bound:.3g} in 99.9 % of cases)"
        )
    yield line


def _correlation_field(solution: Solution) -> Field:
    """Return the series with time-correlated residuals, the least informative first, and the effect on sigma."""
    if solution.time_correlation is None:
        return Field("correlated")
    weighted_counts = {item.name: item.weighed_as for item in solution.series_weights}
    heading = ["series", "correlation time", "used", "independent"]
    if weighted_counts:
        heading.append("weight")
    rows = []
    for item in sorted(solution.time_correlation.series, key=lambda item: item.effective_count / item.count):
        counts = [item.effective_count]
        if weighted_counts:
            counts.append(weighted_counts.get(item.name, item.count))
        cells = (f"{max(count, 1.0):.0f}" for count in counts)
        rows.append((item.name, duration(item.correlation_time_s), str(item.count), *cells))
    notes, factor = [], solution.correlation_factor  # 1 if the position is not determined
    if factor >= _MIN_REPORTED_SIGMA_FACTOR:
        notes.append(f"the time correlation enlarges the position sigma by a factor of {factor:.2g}")
    if factor > _MIN_ADVISED_SIGMA_FACTOR and not weighted_counts:
        notes.append('[estimate] weights = "correlated" includes it in the weights too')
    return table("correlated", heading, rows, _MAX_SERIES_ROWS, notes)


def _residual_fields(solution: Solution) -> Iterator[Field]:
    """Yield residual statistics by station; with several types or links of a station, by type and by link."""
    residuals, fit = solution.residuals, solution.fit
    if len(fit.by_path) == len(fit.by_station) == len(_stations(residuals)):
        yield _residual_table("stations", fit.by_station)
        return
    if len(fit.by_type) > 1:
        yield _residual_table("types", fit.by_type)
    links = residuals.statistics_by(_link_labels(residuals))
    yield _residual_table("links", links, _MAX_LINK_ROWS, _disagreement_lines(solution))


def _residual_table(
    label: str,
    groups: tuple[GroupStatistics, ...],
    max_rows: int = _MAX_TABLE_ROWS,
    notes: Iterable[str] = (),
) -> Field:
    rows = []
    for group in groups:
        sizes = ("-" if x is None else metres(x) for x in (group.mean_m, group.rms_m, group.wrms_m))
        rows.append((group.label, str(group.used), str(group.rejected), *sizes))
    return table(label, ("residuals, m", "used", "rejected", "mean", "rms", "wrms"), rows, max_rows, notes)


@dataclass(frozen=True, slots=True)
class _RangeMean:
    """Mean residual of the ranges of one link."""

    way: str
    mean_m: float
    variance_m2: float

    def sigmas_below(self, higher: _RangeMean) -> float:
        """Difference from a higher mean, in standard deviations of the difference."""
        return (higher.mean_m - self.mean_m) / math.sqrt(self.variance_m2 + higher.variance_m2)


def _disagreement_lines(solution: Solution) -> Iterator[str]:
    """Yield for each station the two links whose mean range residuals differ most, if the difference is significant.

    The mean of the station can hide the difference. Its p-value is that of a normal distribution times the number of
    pairs (Bonferroni correction).
    """
    means = _range_means(solution)
    pair_count = sum(math.comb(len(station_means), 2) for station_means in means.values())
    for station, station_means in means.items():
        if len(station_means) < 2:
            continue
        pairs = combinations(sorted(station_means, key=lambda item: item.mean_m), 2)
        low, high = max(pairs, key=lambda pair: pair[0].sigmas_below(pair[1]))
        sigmas = low.sigmas_below(high)
        if pair_count * math.erfc(sigmas / math.sqrt(2.0)) < _RANGE_SIGNIFICANCE_LEVEL:
            yield (
                f"ranges of {station}, {low.way} {signed_metres(low.mean_m)} m and {high.way} "
                f"{signed_metres(high.mean_m)} m, disagree by {sigmas:.1f} sigmas: "
                'estimate a bias of each link ([estimate] range_bias_per = "link") or the clocks (clock = "all")'
            )


def _range_means(solution: Solution) -> dict[str, list[_RangeMean]]:
    """Return the means of the ranges of each link by receiver, with their variances."""
    residuals, correlation = solution.residuals, solution.time_correlation
    series = () if correlation is None else correlation.series
    effective_counts = {item.name: max(item.effective_count, 1.0) for item in series}
    is_range, means = residuals.used & residuals.types.are("range"), defaultdict[str, list[_RangeMean]](list)
    for path in residuals.paths.present():
        rows, link = np.flatnonzero(is_range & residuals.paths.are(path)), Link.from_path(path)
        if not len(rows):
            continue
        residual_m = residuals.residual_m[rows]
        # The scatter of few residuals is smaller than their sigmas.
        scatter_m2 = max(residual_m.var(), np.square(residuals.sigma_m[rows]).mean())
        variance_m2 = float(scatter_m2) / effective_counts.get(f"range {path}", len(rows))
        way = "two-way" if link.transmitter == link.receiver else f"from {link.transmitter}"
        means[link.receiver].append(_RangeMean(way, float(residual_m.mean()), variance_m2))
    return means


def _rejected_lines(residuals: Residuals) -> Iterator[str]:
    """Yield a line for each of a few rejected observations, or for each link and reason if there are many."""
    rejected, links, reasons = _rejected_rows(residuals), _link_labels(residuals), residuals.reasons
    keys = links.codes[rejected] * len(reasons.texts) + reasons.codes[rejected]
    if len(rejected) <= _MAX_REJECTED_LINES:
        keys = np.arange(len(rejected))
    _, first_index, group = np.unique(keys, return_index=True, return_inverse=True)
    epochs, listed_count = residuals.epoch_utc, 0
    for index in np.argsort(first_index)[:_MAX_REJECTED_LINES].tolist():
        rows = rejected[group == index]
        earliest = rows[np.lexsort((epochs.fraction[rows], epochs.jd[rows]))[:1]]
        epoch, reason = utc_strings(epochs[earliest], decimals=0)[0], residuals.statuses[rows[0]]
        if len(rows) > 1:
            epoch += f" and {len(rows) - 1} more"
        if len(set(residuals.statuses.codes[rows].tolist())) > 1:
            _, _, figures = reason.partition(": ")
            reason = f"{reasons[rows[0]]}, the largest: {figures}" if figures else reasons[rows[0]]
        yield f"{epoch} {links[rows[0]]}: {reason}"
        listed_count += len(rows)
    yield from remaining_line(len(rejected), listed_count)


def _rejected_rows(residuals: Residuals) -> Indices:
    """Return the rows of the rejected observations, the largest residuals in sigmas first."""
    rejected = np.flatnonzero(~residuals.used)
    size = np.abs(residuals.residual_m[rejected] / residuals.sigma_m[rejected])
    return rejected[np.argsort(-size, kind="stable")]


def _stations(residuals: Residuals) -> set[str]:
    """Return the stations at either end of the paths."""
    return {station for path in residuals.paths.present() for station in Link.from_path(path).stations}


def _link_labels(residuals: Residuals) -> Labels:
    """Return the link of each observation, with the type if there are several."""
    links, types = [Link.from_path(path) for path in residuals.paths.texts], residuals.types
    names = link_names(links)
    if len(types.present()) < 2:
        return Labels.coded(names, residuals.paths.codes)
    names = [
        f"{name} {kind if link.transmitter else kind.removeprefix('one_way_')}"  # the name says "one-way" already
        for link, name in zip(links, names, strict=True)
        for kind in types.texts
    ]
    return Labels.coded(names, residuals.paths.codes * len(types.texts) + types.codes)
