"""Fields of a solution's card on its observations: their number, how well they fit, and which do not."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations

import numpy as np

from radioloc.constants import SECONDS_PER_DAY
from radioloc.estimation.consistency import Inconsistency
from radioloc.estimation.statistics import Residuals
from radioloc.labels import Labels
from radioloc.measurements.link import Link
from radioloc.results.cards import (
    REJECTED,
    RESIDUALS,
    Detail,
    Field,
    duration,
    first_of,
    have_paths,
    in_section,
    metres,
    more,
    plural,
    short_names,
    signed_metres,
    table,
)
from radioloc.results.solution import Solution
from radioloc.time import utc_strings

# A card is to fit a screen; to_dict() has all rows.
_MAX_ROWS = 6
_MAX_LINKS = 12  # six baselines of four stations, and some that range
_MAX_OUTLIERS = 3
_MAX_UNFOLDED, _MAX_REJECTED = 20, 300  # on a page
_MAX_SERIES = 3
_MIN_SPLIT_SIGMAS = 3.3
"""Means of two links that differ by more do so by chance in 1 of 1000 cases."""
_MIN_CORRELATION_FACTOR = 1.05
_MIN_ADVISED_FACTOR = 3.0
"""A sigma that grows by more belongs to an estimate that other weights make much better."""


def fit_fields(solution: Solution) -> Iterator[Field]:
    """Fields of the card, in order."""
    yield Field("data", _data(solution), section=RESIDUALS)
    yield Field("fit", _fit(solution), section=RESIDUALS)
    yield Field("misfit", map(str, inconsistent(solution, strongly=False)), section=RESIDUALS)
    yield from in_section(RESIDUALS, *_groups(solution))
    yield Field("left out", _left_out(solution), section="")


def rejected_detail(solution: Solution) -> Detail:
    """Return the observations that were left out as a table."""
    rows, count = left_out_rows(solution, _MAX_REJECTED), solution.fit.total.rejected
    heading = ("UTC", "link", "residual, m", "reason")
    first = f"The first {len(rows)} of {count}" if count > len(rows) else "All of them"
    table = Field("", (), heading, rows)
    return Detail(REJECTED, f"{first}, the largest residuals first", (table,), count <= _MAX_UNFOLDED)


def inconsistent(solution: Solution, *, strongly: bool) -> Iterator[Inconsistency]:
    """Inconsistencies that move the position by more than its sigma, or else all others: a moving target has none."""
    for item in solution.consistency.found:
        shift = item.shift_enu_m
        moves = shift is not None and math.hypot(*shift) > float(np.linalg.norm(solution.sigma_enu_m()))
        if strongly == moves:
            yield item


def _data(solution: Solution) -> Iterator[str]:
    rows = solution.residuals
    if not len(rows):
        yield "no observations"
        return
    ends = rows.epoch_utc[np.lexsort((rows.epoch_utc.fraction, rows.epoch_utc.jd))[[0, -1]]]
    span_s = SECONDS_PER_DAY * float(np.diff(ends.jd)[0] + np.diff(ends.fraction)[0])
    stations = plural(len(_ends(rows)), "station")
    yield f"{plural(len(rows), 'observation')} from {stations} over {duration(span_s)},"
    yield f"{' to '.join(utc_strings(ends, decimals=0))} UTC"


def _fit(solution: Solution) -> Iterator[str]:
    fit = solution.fit
    line = f"{fit.total.used} used, {fit.total.rejected} left out"
    # Types whose metres are of different things have no common one.
    if fit.total.wrms_m is not None and len(fit.by_type) <= 1:
        line += f"; wrms {metres(fit.total.wrms_m)} m"
        if {group.label for group in fit.by_type} == {"range"}:
            line += f" round trip ({metres(0.5 * fit.total.wrms_m)} m one way)"
    yield line
    components = [
        f"additive variance component of {kind}: sigma {metres(added_m)} m, added in quadrature to the stated sigmas"
        if added_m > 0.0
        else f"{kind} has no additive variance component, unlike the others"
        for kind, added_m in fit.excess_noise_m.items()
        if added_m > 0.0 or (" of " in kind and any(fit.excess_noise_m.values()))
    ]
    yield from first_of(components, _MAX_ROWS)
    if fit.shared_noise_m:
        sizes = ", ".join(f"{name} {metres(sigma_m)} m" for name, sigma_m in fit.shared_noise_m.items())
        yield f"delays of one epoch share errors of stations, as their residuals show: sigma {sizes}"
    yield from _time_correlation(solution)
    if solution.consider is not None and solution.consider.in_weights:
        kinds = ", ".join(solution.consider.in_weights)
        yield f"weights allow for considered errors ({kinds}): what one of them moves together counts less"
    if fit.chi2_per_dof is None or fit.chi2_per_dof_bound is None:
        yield "no redundancy: nothing tests the stated sigmas"
        return
    verdict = f"chi2/dof {fit.chi2_per_dof:.3g} with {fit.dof} degrees of freedom"
    if fit.chi2_per_dof > fit.chi2_per_dof_bound:
        verdict += (
            f": the residuals are {math.sqrt(fit.chi2_per_dof):.3g} times larger than stated "
            f"(by chance chi2/dof stays below {fit.chi2_per_dof_bound:.3g} in 99.9 %)"
        )
    yield verdict


def _time_correlation(solution: Solution) -> Iterator[str]:
    """Series whose residuals are correlated in time, the least informative first, and the effect on sigma."""
    if solution.time_correlation is None:
        return
    series = sorted(solution.time_correlation.series, key=lambda item: item.effective_count / item.count)
    lines = [
        f"time-correlated residuals of {item.name} (Gauss-Markov, correlation time "
        f"{duration(item.correlation_time_s)}): {item.count} observations carry the information of "
        f"{max(item.effective_count, 1.0):.0f}"
        for item in series
    ]
    yield from first_of(lines, _MAX_SERIES)
    weights = sorted(solution.series_weights, key=lambda item: -item.sigma_factor)
    lines = [
        f"weight of {item.name}: that of {max(item.weighed_as, 1.0):.0f} independent observations"
        for item in weights
    ]
    yield from first_of(lines, _MAX_SERIES)
    if (
        solution.correlation_factor < _MIN_CORRELATION_FACTOR
    ):  # also where there is no position, or none that is determined
        return
    enlarged = (
        f"the time correlation enlarges the position sigma by a factor of {solution.correlation_factor:.2g}"
    )
    if solution.correlation_factor > _MIN_ADVISED_FACTOR and not weights:
        enlarged += '; [estimate] weights = "correlated" allows for it in the weights too'
    yield enlarged


def _ends(rows: Residuals) -> set[str]:
    """Stations at either end of some path."""
    if not have_paths(rows):
        return set(rows.stations.present())
    return {station for path in rows.paths.present() for station in Link.from_path(path).stations}


def _links(rows: Residuals) -> Labels:
    """Name of the station or link of each observation, with the type where those differ."""
    if not have_paths(rows):
        return rows.stations
    # Of several types a station has no one rms: metres of range and of range difference are not alike.
    several = len(rows.types.present()) > 1
    names = [
        # "one-way" is said by the place already.
        f"{place} {kind.removeprefix('one_way_') if 'one-way' in place else kind}" if several else place
        for place in short_names([Link.from_path(path) for path in rows.paths.texts])
        for kind in rows.types.texts
    ]
    return Labels.coded(names, rows.paths.codes * len(rows.types.texts) + rows.types.codes)


def _groups(solution: Solution) -> Iterator[Field]:
    """Statistics by station; where types differ, or a station has part in several paths, by type and by path."""
    rows, fit = solution.residuals, solution.fit
    if not have_paths(rows) or len(fit.by_path) == len(fit.by_station) == len(_ends(rows)):
        found = {"stations": fit.by_station}
    else:
        found = {"types": fit.by_type} if len(fit.by_type) > 1 else {}
        found["links"] = rows.statistics_by(_links(rows))
    heading = ("residuals, m", "used", "left out", "mean", "rms", "wrms")
    for label, groups in found.items():
        cells = []
        for group in groups:
            sizes = ("-" if x is None else metres(x) for x in (group.mean_m, group.rms_m, group.wrms_m))
            cells.append((group.label, str(group.used), str(group.rejected), *sizes))
        of_links = label == "links"
        most, below = (_MAX_LINKS, _split(solution)) if of_links else (_MAX_ROWS, ())
        yield table(label, heading, cells, most, below)


def _split(solution: Solution) -> Iterator[str]:
    """Ranges of two links of one station whose means differ significantly, which the station's mean can hide."""
    worth = {}
    if solution.time_correlation is not None:
        worth = {item.name: max(item.effective_count, 1.0) for item in solution.time_correlation.series}
    of_station: dict[str, list[tuple[str, float, float]]] = {}
    for group in solution.fit.by_path:
        kind, _, path = group.label.partition(" ")
        if kind != "range" or not group.used or group.mean_m is None or group.rms_m is None:
            continue
        link = Link.from_path(path)
        scatter_m = max(group.rms_m**2 - group.mean_m**2, 0.0) ** 0.5
        count = worth.get(group.label, float(group.used))
        way = "two-way" if link.transmitter == link.receiver else f"from {link.transmitter}"
        of_station.setdefault(link.receiver, []).append((way, group.mean_m, scatter_m / count**0.5))
    for station, means in of_station.items():
        pairs = list(combinations(means, 2))
        apart = [
            (abs(one[1] - two[1]) / max(math.hypot(one[2], two[2]), 1e-9), one, two) for one, two in pairs
        ]
        sigmas, one, two = max(apart, default=(0.0, None, None), key=lambda found: found[0])
        if sigmas > _MIN_SPLIT_SIGMAS and one is not None and two is not None:
            yield (
                f"ranges of {station}, {one[0]} {signed_metres(one[1])} m and {two[0]} {signed_metres(two[1])} m, "
                f'disagree by {sigmas:.1f} sigmas: [estimate] clock = "all" or range_bias_per = "link" would absorb it'
            )


def _left_out(solution: Solution) -> Iterator[str]:
    """The largest outliers; counts with one fault, such as those before the lock, together."""
    rows = left_out_rows(solution, solution.fit.total.rejected)
    alike: dict[tuple[str, str], list[str]] = {}
    for epoch, name, _, reason in rows:
        alike.setdefault((name, reason), []).append(epoch)
    shown = 0
    for (name, reason), epochs in list(alike.items())[:_MAX_OUTLIERS]:
        shown += len(epochs)
        times = f"{min(epochs)} and {len(epochs) - 1} later" if len(epochs) > 1 else epochs[0]
        yield f"{times} {name}: {reason}"
    yield from more(len(rows), shown)


def left_out_rows(solution: Solution, most: int) -> list[tuple[str, ...]]:
    """Epoch, link, residual (m) and reason of observations left out, those with the largest residuals first."""
    rows = solution.residuals
    out = np.flatnonzero(~rows.used)
    # The largest outliers say most; what was left out from the beginning has its own reasons.
    out = out[np.argsort(-np.abs(rows.residual_m[out] / rows.sigma_m[out]), kind="stable")][:most]
    sizes = (f"{value:.4g}" for value in rows.residual_m[out])
    columns = utc_strings(rows.epoch_utc[out], decimals=0), _links(rows)[out], sizes, rows.statuses[out]
    return list(zip(*columns, strict=True))
