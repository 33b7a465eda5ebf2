"""Part of a solution's card on the observations: counts, residuals, rejections and reliability."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.estimation.consistency_results import ConsistencyTest
from radioloc.estimation.hypotheses import ALL, TERM
from radioloc.estimation.reliability import POWER, Reliability
from radioloc.estimation.statistics import Residuals, chi2_quantile
from radioloc.labels import Labels
from radioloc.measurements.link import Link
from radioloc.measurements.registry import KINDS
from radioloc.parameters.registry import PARAMETERS
from radioloc.results.cards import (
    REJECTED,
    RESIDUALS,
    Detail,
    Field,
    duration,
    first_lines,
    have_paths,
    in_section,
    metres,
    more,
    plural,
    signed_metres,
    table,
)
from radioloc.results.names import link_names, parameter_name, source_name
from radioloc.results.solution import Solution
from radioloc.time import utc_strings

# A card fits a screen; to_dict() has all rows.
_MAX_ROWS = 6
_MAX_LINK_ROWS = 12  # six baselines of four stations, and some links of ranges
_MAX_REJECTED = 3
_MAX_UNFOLDED, _MAX_PAGE_ROWS = 20, 300  # rows of rejected observations on a page
_MAX_SERIES = 3
_SPLIT_SIGNIFICANCE_LEVEL = 1e-3  # for all pairs of links of a card together
_ONE_SIGMA_PROBABILITY = 0.683
_MIN_CORRELATION_FACTOR = 1.05
_MIN_ADVISED_FACTOR = 3.0
"""Growth of the sigma above which correlated weights give a much better estimate."""


def fit_fields(solution: Solution) -> Iterator[Field]:
    """Yield the fields of the card, in order."""
    yield from in_section(
        RESIDUALS,
        Field("data", _data(solution)),
        Field("fit", _fit(solution)),
        _correlated_series(solution),
        Field("misfit", findings(solution, outside_ellipsoid=False)),
        Field("reliability", reliability_lines(solution.consistency.reliability)),
        *_groups(solution),
    )
    yield Field("rejected", _largest_rejected(solution), section="")


def rejected_detail(solution: Solution) -> Detail:
    """Return the rejected observations as a table."""
    residuals, count = solution.residuals, solution.fit.total.rejected
    order = _rejected(solution)[:_MAX_PAGE_ROWS]
    sizes = (f"{value:.4g}" for value in residuals.residual_m[order])
    epochs = utc_strings(residuals.epoch_utc[order], decimals=0)
    rows = list(zip(epochs, _links(residuals)[order], sizes, residuals.statuses[order], strict=True))
    heading = ("UTC", "link", "residual, m", "reason")
    title = f"{len(rows)} of {count}" if count > len(rows) else "All"
    table = Field("", (), heading, rows)
    return Detail(REJECTED, f"{title}, the largest residuals first", (table,), count <= _MAX_UNFOLDED)


def inconsistent(solution: Solution, *, outside_ellipsoid: bool) -> Iterator[ConsistencyTest]:
    """Yield the inconsistencies that move the position out of its 68 % ellipsoid, or all others."""
    for item in solution.consistency.findings:
        if outside_ellipsoid == _leaves_ellipsoid(solution, item.shift_enu_m):
            yield item


def findings(solution: Solution, *, outside_ellipsoid: bool) -> Iterator[str]:
    """Yield the inconsistencies that move the position out of its ellipsoid, or others, and the adapted position."""
    texts = [str(item) for item in inconsistent(solution, outside_ellipsoid=outside_ellipsoid)]
    yield from (f"WARNING: {text}" if outside_ellipsoid else text for text in texts)
    adapted, count = solution.with_findings(), len(solution.consistency.findings)
    if adapted is None or not texts or not (outside_ellipsoid or len(texts) == count):
        return
    longitude_deg, latitude_deg, height_m = adapted.selenographic
    yield (
        f"with {'them' if count > 1 else 'it'} estimated: {longitude_deg:.8f} deg E, {latitude_deg:+.8f} deg N, "
        f"height {height_m:.3f} m; 1 sigma east, north, up {', '.join(map(metres, adapted.sigma_enu_m()))} m. "
        "The total sigma covers both positions"
    )


def _leaves_ellipsoid(solution: Solution, shift_enu_m: tuple[float, float, float] | None) -> bool:
    """Return whether a shift, None for a moving target, leaves the 68 % ellipsoid of a determined position."""
    if shift_enu_m is None or not solution.position_determined:
        return False
    shift_m, covariance_m2 = np.array(shift_enu_m), solution.position_covariance()
    if (adapted := solution.consistency.adapted) is not None:  # the ellipsoid without the findings
        joint_shift_m = solution.enu_partials @ adapted.shift
        covariance_m2 = covariance_m2 - np.outer(joint_shift_m, joint_shift_m)
    dof = int(np.linalg.matrix_rank(covariance_m2, hermitian=True))  # a fixed direction has zero variance
    chi2 = float(shift_m @ np.linalg.pinv(covariance_m2, hermitian=True) @ shift_m)
    return dof > 0 and chi2 > chi2_quantile(_ONE_SIGMA_PROBABILITY, dof)


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
    line = f"{fit.total.used} used, {fit.total.rejected} rejected"
    # Ranges and Doppler, both in metres, have no common rms.
    if fit.total.wrms_m is not None and len(fit.by_type) <= 1:
        line += f"; wrms {metres(fit.total.wrms_m)} m"
        if {group.label for group in fit.by_type} == {"range"}:
            line += f" round trip ({metres(0.5 * fit.total.wrms_m)} m one way)"
    yield line
    for text, sigmas_m in (
        ("noise added in quadrature to the stated sigmas", fit.excess_noise_m),
        ("errors of stations common to the delays of one epoch, 1 sigma", fit.shared_noise_m),
    ):
        sizes = [f"{name} {metres(sigma_m)} m" for name, sigma_m in sigmas_m.items() if sigma_m > 0.0]
        if sizes:
            yield f"{text}: {', '.join(first_lines(sizes, _MAX_ROWS))}"
    if fit.chi2_per_dof is None or fit.chi2_per_dof_bound is None:
        yield "no redundancy: the stated sigmas cannot be tested"
        return
    line = f"chi2/dof {fit.chi2_per_dof:.3g} with {fit.dof} degrees of freedom"
    if fit.chi2_per_dof > fit.chi2_per_dof_bound:
        line += (
            f": the residuals are {math.sqrt(fit.chi2_per_dof):.3g} times their sigmas "
            f"(with correct sigmas chi2/dof is below {fit.chi2_per_dof_bound:.3g} in 99.9 %)"
        )
    yield line


def _correlated_series(solution: Solution) -> Field:
    """Series whose residuals are correlated in time, the least informative first, and the effect on sigma."""
    if solution.time_correlation is None:
        return Field("correlated")
    weights = {item.name: item.weighed_as for item in solution.series_weights}
    series = sorted(solution.time_correlation.series, key=lambda item: item.effective_count / item.count)
    heading = ["series", "correlation time", "used", "independent"] + ["weight"] * bool(weights)
    rows = [
        (
            item.name,
            duration(item.correlation_time_s),
            str(item.count),
            f"{max(item.effective_count, 1.0):.0f}",
            *[f"{max(weights.get(item.name, item.count), 1.0):.0f}"] * bool(weights),
        )
        for item in series
    ]
    below = []
    factor = solution.correlation_factor  # 1 if the position is not determined
    if factor >= _MIN_CORRELATION_FACTOR:
        below.append(f"the time correlation enlarges the position sigma by a factor of {factor:.2g}")
    if factor > _MIN_ADVISED_FACTOR and not weights:
        below.append('[estimate] weights = "correlated" includes it in the weights too')
    return table("correlated", heading, rows, _MAX_SERIES, below)


def _ends(rows: Residuals) -> set[str]:
    """Return the stations at either end of the paths."""
    if not have_paths(rows):
        return set(rows.stations.present())
    return {station for path in rows.paths.present() for station in Link.from_path(path).stations}


def _links(rows: Residuals) -> Labels:
    """Return the station or link of each observation, with the type if there are several."""
    if not have_paths(rows):
        return rows.stations
    # Ranges and range differences of a station, both in metres, have no common rms.
    several = len(rows.types.present()) > 1
    names = [
        # The place says "one-way" already.
        f"{place} {kind.removeprefix('one_way_') if 'one-way' in place else kind}" if several else place
        for place in link_names([Link.from_path(path) for path in rows.paths.texts])
        for kind in rows.types.texts
    ]
    return Labels.coded(names, rows.paths.codes * len(rows.types.texts) + rows.types.codes)


def _groups(solution: Solution) -> Iterator[Field]:
    """Yield residual statistics by station; with several types or paths of a station, by type and by link."""
    rows, fit = solution.residuals, solution.fit
    if not have_paths(rows) or len(fit.by_path) == len(fit.by_station) == len(_ends(rows)):
        statistics = {"stations": fit.by_station}
    else:
        statistics = {"types": fit.by_type} if len(fit.by_type) > 1 else {}
        statistics["links"] = rows.statistics_by(_links(rows))
    heading = ("residuals, m", "used", "rejected", "mean", "rms", "wrms")
    for label, groups in statistics.items():
        cells = []
        for group in groups:
            sizes = ("-" if x is None else metres(x) for x in (group.mean_m, group.rms_m, group.wrms_m))
            cells.append((group.label, str(group.used), str(group.rejected), *sizes))
        of_links = label == "links"
        max_rows, below = (_MAX_LINK_ROWS, _disagreeing_ranges(solution)) if of_links else (_MAX_ROWS, ())
        yield table(label, heading, cells, max_rows, below)


def _disagreeing_ranges(solution: Solution) -> Iterator[str]:
    """Yield ranges of two links of one station whose means differ significantly, which its own mean can hide."""
    independent = {}
    if solution.time_correlation is not None:
        independent = {item.name: max(item.effective_count, 1.0) for item in solution.time_correlation.series}
    residuals, used = solution.residuals, solution.residuals.used
    of_station: dict[str, list[tuple[str, float, float]]] = {}
    for group in solution.fit.by_path:
        kind, _, path = group.label.partition(" ")
        if kind != "range" or not group.used or group.mean_m is None or group.rms_m is None:
            continue
        link = Link.from_path(path)
        way = "two-way" if link.transmitter == link.receiver else f"from {link.transmitter}"
        # The scatter of few residuals is smaller than their sigmas.
        members = used & residuals.types.are(kind) & residuals.paths.are(path)
        scatter_m2 = max(group.rms_m**2 - group.mean_m**2, np.square(residuals.sigma_m[members]).mean())
        variance_m2 = scatter_m2 / independent.get(group.label, group.used)
        of_station.setdefault(link.receiver, []).append((way, group.mean_m, variance_m2))
    pair_count = sum(math.comb(len(means), 2) for means in of_station.values())
    for station, means in of_station.items():
        way_1, mean_1, variance_1 = min(means, key=lambda item: item[1])
        way_2, mean_2, variance_2 = max(means, key=lambda item: item[1])
        sigmas = (mean_2 - mean_1) / math.sqrt(variance_1 + variance_2)
        if len(means) > 1 and pair_count * math.erfc(sigmas / math.sqrt(2.0)) < _SPLIT_SIGNIFICANCE_LEVEL:
            yield (
                f"ranges of {station}, {way_1} {signed_metres(mean_1)} m and {way_2} {signed_metres(mean_2)} m, "
                f'disagree by {sigmas:.1f} sigmas: [estimate] clock = "all" or range_bias_per = "link" absorbs it'
            )


def _largest_rejected(solution: Solution) -> Iterator[str]:
    """Yield the rejected observations: each of a few, otherwise those of a link with one reason in one line."""
    rows, order = solution.residuals, _rejected(solution)
    links, reasons = _links(rows), rows.reasons
    faults = links.codes[order] * len(reasons.texts) + reasons.codes[order]
    if len(order) <= _MAX_REJECTED:
        faults = np.arange(len(order))
    _, first, fault = np.unique(faults, return_index=True, return_inverse=True)
    shown = 0
    for index in np.argsort(first)[:_MAX_REJECTED].tolist():
        members = order[fault == index]
        first_row = members[np.lexsort((rows.epoch_utc.fraction[members], rows.epoch_utc.jd[members]))[:1]]
        times, reason = utc_strings(rows.epoch_utc[first_row], decimals=0)[0], rows.statuses[members[0]]
        if len(members) > 1:
            times += f" and {len(members) - 1} later"
        if len(set(rows.statuses.codes[members].tolist())) > 1:
            figures = reason.partition(": ")[2]
            reason = f"{reasons[members[0]]}, the largest: {figures}" if figures else reasons[members[0]]
        yield f"{times} {links[members[0]]}: {reason}"
        shown += len(members)
    yield from more(len(order), shown)


def _rejected(solution: Solution) -> NDArray[np.intp]:
    """Rows of the rejected observations, the largest residuals first."""
    rows = solution.residuals
    rejected = np.flatnonzero(~rows.used)
    size = np.abs(rows.residual_m[rejected] / rows.sigma_m[rejected])
    return rejected[np.argsort(-size, kind="stable")]


_CARD_KINDS = (
    "station_position",
    "clock",
    "range_bias",
    "time_bias",
    "transponder_delay",
    "frequency_offset",
)
"""Kinds of error that the card names, the usual faults of stations first."""
_MAX_KINDS, _MAX_HIDDEN = 4, 3  # a card fits a screen; to_dict() has all of them
# Smallest effect on the position, m, with which an undetectable error is listed.
_MIN_EFFECT_M = 0.01
_TIME_UNITS = ((1e-6, 1e9, "ns"), (1e-3, 1e6, "us"), (1.0, 1e3, "ms"))  # upper bound, s, factor and unit


def reliability_lines(items: Sequence[Reliability]) -> Iterator[str]:
    """Yield the minimal detectable biases, the largest effect of an undetected one, and unrevealed errors."""
    faults = [item for item in items if _is_fault(item)]
    sizes = []
    for kind in _CARD_KINDS:
        revealed = [item for item in faults if item.revealed and _kind(item) == kind]
        if revealed:
            item = min(revealed, key=lambda fault: fault.minimal)
            sizes.append(f"{source_name(kind)} {_amount(item.minimal, item.unit)}{_owner(item)}")
    if sizes:
        yield f"smallest detectable errors (power {100 * POWER:.0f} %): {', '.join(sizes[:_MAX_KINDS])}"
    largest: dict[str, tuple[float, Reliability]] = {}
    for item in sorted(faults, key=lambda fault: -(fault.shift_m or 0.0)):
        if item.revealed and item.shift_m:
            largest.setdefault(item.kind if item.kind == "offset" else _kind(item), (item.shift_m, item))
    if largest:
        effects = [
            f"{metres(shift_m)} m ({_name(item)}, {_amount(item.minimal, item.unit)})"
            for shift_m, item in list(largest.values())[:_MAX_KINDS]
        ]
        yield f"largest effects of undetected errors: {', '.join(effects)}"
    if hidden := [text for item in faults if not item.revealed for text in _hidden(item)]:
        yield f"not revealed: {', '.join(first_lines(hidden, _MAX_HIDDEN))}"


def _is_fault(item: Reliability) -> bool:
    """Return whether an error is that of a station, link, target or stated value, not of Earth, Moon or a type."""
    kind, _, owner = item.name.partition(".")
    return (
        owner not in KINDS and kind != TERM and (kind not in PARAMETERS or PARAMETERS[kind].scopes[0].named)
    )


def _hidden(item: Reliability) -> Iterator[str]:
    """Yield an error of a usual kind that the data do not reveal, with its effect on the position."""
    kind, effect_m = _kind(item), item.shift_per_unit_m
    if kind not in _CARD_KINDS or len(item.components) > 1:
        return
    if effect_m is None:
        yield _name(item)
    elif effect_m * PARAMETERS[kind].scale > _MIN_EFFECT_M:
        factor, unit = 1.0, item.unit
        if unit == "s":
            factor, unit = (1e-9, "ns") if PARAMETERS[kind].scale < _TIME_UNITS[0][0] else (1e-3, "ms")
        considered = f", sigma {item.prior_sigma / factor:.3g} {unit}" if item.prior_sigma else ""
        yield f"{_name(item)} ({metres(factor * effect_m)} m of position per {unit}{considered})"


def _kind(item: Reliability) -> str:
    return item.name.partition(".")[0]


def _name(item: Reliability) -> str:
    if item.kind == "offset":
        return f"offset of {item.name}"
    kind, _, owner = item.name.partition(".")
    if owner == ALL:
        return f"common {source_name(kind)}"
    components = item.components if len(item.components) == 1 else ()
    return parameter_name(".".join(filter(None, (item.name, *components))))


def _owner(item: Reliability) -> str:
    owner = item.name.partition(".")[2]
    return f" ({'common' if owner == ALL else owner})" if owner else ""


def _amount(value: float, unit: str) -> str:
    """Return a size with three digits, of times in a suitable unit."""
    if unit == "s":
        for bound_s, factor, name in _TIME_UNITS:
            if value < bound_s:
                return f"{factor * value:.3g} {name}"
    return f"{value:.3g} {unit}" if unit != "1" else f"{value:.3g}"
