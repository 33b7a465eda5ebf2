"""The card of a solution: where the target is, how well that is known, and how well observations are fitted."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from radioloc.constants import SECONDS_PER_DAY
from radioloc.estimation.labels import Labels
from radioloc.estimation.solution import ReferenceComparison, Solution, card_of
from radioloc.estimation.statistics import GroupStatistics, Residuals
from radioloc.measurements.link import Link
from radioloc.parameters.parameter import Role
from radioloc.report.cards import (
    Card,
    Field,
    duration,
    metres,
    more,
    plural,
    sigma_text,
    signed_metres,
    to_sigma,
)
from radioloc.report.link_names import short_names
from radioloc.time import utc_strings

# A card is to fit a screen; to_dict() has all rows.
_MAX_ROWS = 6
_MAX_LINKS = 12  # six baselines of four stations, and some that range
_MAX_PARAMETERS = 12
_MAX_OUTLIERS = 3
_MAX_SENTENCES = 4
_MAX_SERIES = 3
_MUCH_LARGER = 3.0
"""A sigma that grows by more belongs to an estimate that other weights make much better."""

_VARIANCE_SOURCES = {
    "noise": "measurement noise",
    "other parameters": "estimating the other parameters",
    "misfit": "residuals larger than the stated sigmas",
    "correlation": "time correlation of the residuals",
    "considered": "considered parameters",
    "ephemeris": "assumed ephemeris error",
}


@card_of.register(Solution)
def solution_card(solution: Solution) -> Card:
    """Collect what the card of a solution says, in order."""
    sentences = (*solution.observability.describe()[:_MAX_SENTENCES], *which_sigmas((solution,)))
    fields = [
        Field("solution", (solution.name,)),
        Field("status", _status(solution)),
        *_where(solution),
        Field("targets", _targets(solution)),
        Field("variance", _variance_sources(solution)),
        Field("reference", _reference(solution.reference)),
        Field("a priori", _position_priors(solution)),
        _other_parameters(solution),
        Field("held", _held(solution)),
        Field("considered", _considered(solution)),
        Field("passes", _passes(solution)),
        Field("data", _data(solution)),
        Field("fit", _fit(solution)),
        *_groups(solution),
        Field("left out", _left_out(solution)),
        Field("observable", sentences),
        Field("notes", solution.notes),
    ]
    return Card(tuple(fields))


def which_sigmas(solutions: Iterable[Solution]) -> tuple[str, ...]:
    """Say below sentences on observability what sigmas they state, where those of the position are others."""
    lines = []
    for solution in solutions:
        if not (solution.observability.common or solution.observability.weak):
            continue
        if solution.series_weights:
            lines.append("these sigmas are those of the weights, which allow for the time correlation")
        elif solution.noise_scale > 1.0 or solution.time_correlation is not None:
            lines.append(
                "these sigmas are formal: size and time correlation of the residuals are not in them"
            )
    return tuple(dict.fromkeys(lines))


def _status(solution: Solution) -> tuple[str, ...]:
    if not solution.parameters.free.any():
        where = "at the given position" if solution.trajectory is None else "along the given trajectory"
        return (f"NO FIT: observed minus computed {where}",)
    state = "CONVERGED" if solution.converged else solution.status.upper()
    iterations = plural(solution.iterations, "iteration")
    count = f" ({iterations}, {plural(solution.passes, 'editing pass', 'es')})"
    return (state + count, *((solution.message,) if solution.message else ()))


def _where(solution: Solution) -> list[Field]:
    if solution.trajectory is not None:
        return [Field("target", (f"on a trajectory, {solution.trajectory}", "taken as given"))]
    return [Field("position", _position(solution)), _sigmas(solution)]


def _position(solution: Solution) -> tuple[str, ...]:
    longitude_deg, latitude_deg, height_m = solution.selenographic
    lines = [
        f"{solution.me_frame}  {longitude_deg:.8f} deg E, {latitude_deg:+.8f} deg N, height {height_m:.3f} m"
    ]
    vectors = {solution.me_frame: solution.position_me_m, solution.pa_frame: solution.position_pa_m}
    for frame, (x, y, z) in vectors.items():
        lines.append(f"{frame}  x {x:.3f}  y {y:.3f}  z {z:.3f} m")
    return tuple(lines if solution.position_estimated else [*lines, "held at its a-priori value"])


def _sigmas(solution: Solution) -> Field:
    if not solution.position_estimated:
        return Field("sigma", ("none: the position was not estimated",))
    levels = [("formal", solution.sigma_enu_m("formal"))]
    if solution.time_correlation is not None:
        levels.append(("with time correlation", solution.sigma_enu_m("scaled")))
    elif solution.noise_scale > 1.0:
        levels.append((f"noise scaled by {solution.noise_scale:.3g}", solution.sigma_enu_m("scaled")))
    beyond = ["considered"] * (solution.consider is not None) + ["ephemeris error"] * bool(
        solution.ephemeris_sigma_enu_m.any()
    )
    if beyond:
        levels.append((f"with {' and '.join(beyond)}", solution.sigma_enu_m("total")))
    rows = tuple(
        (name, *(metres(s) for s in sigma), metres(float(np.linalg.norm(sigma)))) for name, sigma in levels
    )
    ellipse = solution.ellipse()
    lines: tuple[str, ...] = ()
    if ellipse is not None:
        lines = (
            f"95 % error ellipse, horizontal: {metres(ellipse.semi_major_m)} m x "
            f"{metres(ellipse.semi_minor_m)} m, azimuth {ellipse.azimuth_deg:.0f} deg",
        )
    return Field("sigma", lines, ("1 sigma, m", "east", "north", "up", "3D"), rows)


def _targets(solution: Solution) -> tuple[str, ...]:
    """The positions of several targets, of which the first is the one above."""
    lines = []
    for target in solution.targets:
        of = solution.of_target(target.name)
        longitude_deg, latitude_deg, height_m = of.selenographic
        sigma = " ".join(metres(s) for s in of.sigma_enu_m())
        lines.append(
            f"{target.name}: {longitude_deg:.8f} deg E, {latitude_deg:+.8f} deg N, {height_m:.3f} m; "
            f"1 sigma east, north, up {sigma} m"
        )
    return tuple(lines)


def _considered(solution: Solution) -> tuple[str, ...]:
    """Considered parameters, those that move the position most first."""
    if solution.consider is None:
        return ()
    enu = None if solution.trajectory is not None else solution.enu_by_parameters
    records = solution.consider.to_list(enu)
    lines = []
    for record in records[:_MAX_PARAMETERS]:
        moved = "".join(
            f"; {word} {signed_metres(x)}"
            for word, x in zip(("east", "north", "up"), record.get("position_enu_m", ()), strict=False)
        )
        lines.append(f"{record['name']} +- {record['sigma']:.3g} {record['unit']}{moved}{' m' * bool(moved)}")
    return (*lines, *more(len(records), _MAX_PARAMETERS))


def _variance_sources(solution: Solution) -> tuple[str, ...]:
    if not solution.position_estimated:
        return ()
    shares = solution.variance_shares()
    if not shares:
        return ("the position is not determined",)
    parts = [
        f"{100.0 * part:.0f} % {_VARIANCE_SOURCES[key]}" for key, part in shares.items() if part >= 0.005
    ]
    return ("of the position: " + ", ".join(parts),)


def _reference(reference: ReferenceComparison | None) -> tuple[str, ...]:
    if reference is None:
        return ()
    line = (
        f"solution - {reference.name}: east {metres(reference.east_m)}, north {metres(reference.north_m)}, "
        f"up {metres(reference.up_m)} m; {metres(reference.horizontal_m)} m horizontal, "
        f"{metres(reference.distance_m)} m in space"
    )
    if reference.combined_sigmas is not None:
        line += f"; {reference.combined_sigmas:.2f} sigmas (95 % are below 2.80)"
    return (line,)


def _position_priors(solution: Solution) -> tuple[str, ...]:
    """A-priori values of the position's parameters, and how far off the estimate is."""
    lines = []
    for item, value in zip(solution.parameters, solution.values, strict=True):
        if item.kind != "position" or item.fixed or not math.isfinite(item.prior_sigma):
            continue
        off_m = float(value) - item.prior_value
        lines.append(
            f"{item.name} {item.prior_value:.6g} +- {metres(item.prior_sigma)} {item.unit}; the estimate is "
            f"{signed_metres(off_m)} {item.unit} from it, {abs(off_m) / item.prior_sigma:.2f} a-priori sigmas"
        )
    return tuple(lines)


def _others(solution: Solution, *, held: bool = False) -> list[int]:
    """Parameters beside the position: those that are estimated, or those that are held."""
    free = solution.parameters.free
    involved = (solution.position_partials != 0.0).any(axis=0)
    return [
        k
        for k, item in enumerate(solution.parameters)
        if item.kind != "position"
        and not involved[k]
        and free[k] != held
        and item.role is not Role.CONSIDERED
    ]


def _held(solution: Solution) -> tuple[str, ...]:
    """Values that were given and not estimated."""
    items = [solution.parameters.parameters[k] for k in _others(solution, held=True)]
    return (", ".join(f"{item.name} {item.prior_value:.6g} {item.unit}" for item in items),) if items else ()


def _other_parameters(solution: Solution) -> Field:
    others = _others(solution)
    sigmas = solution.sigmas()
    rows = []
    for k in others[:_MAX_PARAMETERS]:
        item = solution.parameters.parameters[k]
        prior = (
            "free" if math.isinf(item.prior_sigma) else f"{item.prior_value:.4g} +- {item.prior_sigma:.4g}"
        )
        value = to_sigma(solution.values[k], sigmas[k])
        rows.append((item.name, value, sigma_text(sigmas[k]), item.unit, prior))
    heading = ("parameter", "value", "sigma", "unit", "a priori")
    return Field("estimated", (), heading, tuple(rows), more(len(others), _MAX_PARAMETERS))


def _passes(solution: Solution) -> tuple[str, ...]:
    """When the passes were that have parameters of their own."""
    spans = [
        f"{item.name}: {item.span_utc[0]} to {item.span_utc[1]} UTC"
        for item in solution.parameters
        if item.span_utc is not None
    ]
    return (*spans[:_MAX_ROWS], *more(len(spans), _MAX_ROWS))


def _data(solution: Solution) -> tuple[str, ...]:
    rows = solution.residuals
    if not len(rows):
        return ("no observations",)
    order = np.lexsort((rows.epoch_utc.fraction, rows.epoch_utc.jd))[[0, -1]]
    first, last = rows.epoch_utc[order[:1]], rows.epoch_utc[order[1:]]
    span_s = SECONDS_PER_DAY * float((last.jd - first.jd + last.fraction - first.fraction)[0])
    start, stop = (str(utc_strings(epoch, decimals=0)[0]) for epoch in (first, last))
    stations = plural(len(_ends(rows)), "station")
    return (
        f"{plural(len(rows), 'observation')} from {stations} over {duration(span_s)},",
        f"{start} to {stop} UTC",
    )


def _fit(solution: Solution) -> tuple[str, ...]:
    fit = solution.fit
    line = f"{fit.total.used} used, {fit.total.rejected} left out"
    # Types whose metres are of different things have no common one.
    if fit.total.wrms_m is not None and len(fit.by_type) <= 1:
        line += f"; wrms {metres(fit.total.wrms_m)} m"
        if {group.label for group in fit.by_type} == {"range"}:
            line += f" round trip ({metres(0.5 * fit.total.wrms_m)} m one way)"
    lines = [line]
    for kind, added_m in fit.excess_noise_m.items():
        if added_m > 0.0:
            lines.append(
                f"additive variance component of {kind}: sigma {metres(added_m)} m, added in quadrature to the "
                "stated sigmas"
            )
    lines += _time_correlation(solution)
    if fit.chi2_per_dof is None or fit.chi2_per_dof_bound is None:
        return (*lines, "no redundancy: nothing tests the stated sigmas")
    verdict = f"chi2/dof {fit.chi2_per_dof:.3g} with {fit.dof} degrees of freedom"
    if fit.chi2_per_dof > fit.chi2_per_dof_bound:
        verdict += (
            f": the residuals are {math.sqrt(fit.chi2_per_dof):.3g} times larger than stated "
            f"(by chance chi2/dof stays below {fit.chi2_per_dof_bound:.3g} in 99.9 %)"
        )
    return (*lines, verdict)


def _time_correlation(solution: Solution) -> list[str]:
    """Which residuals are correlated in time, those with the least information first, and what that does to sigma."""
    if solution.time_correlation is None:
        return []
    series = sorted(solution.time_correlation.series, key=lambda item: item.effective_count / item.count)
    lines = [
        f"time-correlated residuals of {item.name} (Gauss-Markov, correlation time "
        f"{duration(item.correlation_time_s)}): {item.count} observations carry the information of "
        f"{max(item.effective_count, 1.0):.0f}"
        for item in series[:_MAX_SERIES]
    ]
    if len(series) > _MAX_SERIES:
        lines[-1] += f"; likewise {len(series) - _MAX_SERIES} more series"
    enlarged = (
        f"the time correlation enlarges the position sigma by a factor of {solution.correlation_factor:.2g}"
    )
    if solution.series_weights:
        return [*lines, *_weights(solution), enlarged]
    if solution.correlation_factor > _MUCH_LARGER:
        enlarged += '; [estimate] weights = "correlated" allows for it in the weights too'
    return [*lines, enlarged]


def _weights(solution: Solution) -> list[str]:
    """Which series do not have their full weight in the estimate, those with the least first."""
    weights = sorted(solution.series_weights, key=lambda item: -item.sigma_factor)
    lines = [
        f"weight of {item.name}: that of {max(item.weighed_as, 1.0):.0f} independent observations"
        for item in weights[:_MAX_SERIES]
    ]
    if len(weights) > _MAX_SERIES:
        least, most = (max(end(w.weighed_as for w in weights[_MAX_SERIES:]), 1.0) for end in (min, max))
        lines[-1] += f"; of {len(weights) - _MAX_SERIES} more series that of {least:.0f} to {most:.0f}"
    return lines


def _ends(rows: Residuals) -> set[str]:
    """Stations at either end of some path."""
    if not _have_paths(rows):
        return set(rows.stations.present())
    return {station for path in rows.paths.present() for station in Link.from_path(path).stations}


def _have_paths(rows: Residuals) -> bool:
    """Whether paths are those of observations, not names of stations in their place."""
    return all(">" in path for path in rows.paths.present())


def _links(rows: Residuals) -> Labels:
    """What the station or link of each observation is called, with the type where those differ."""
    if not _have_paths(rows):
        return rows.stations
    # Of several types a station has no one rms: metres of range and of range difference are not alike.
    several = len(rows.types.present()) > 1
    names = [
        f"{place} {kind}" if several else place
        for place in short_names([Link.from_path(path) for path in rows.paths.texts])
        for kind in rows.types.texts
    ]
    return Labels.coded(names, rows.paths.codes * len(rows.types.texts) + rows.types.codes)


def _groups(solution: Solution) -> list[Field]:
    """Statistics by station; where types differ, or a station has part in several paths, by type and by path."""
    rows, fit = solution.residuals, solution.fit
    if not _have_paths(rows) or len(fit.by_path) == len(fit.by_station) == len(_ends(rows)):
        return [_statistics("stations", fit.by_station, _MAX_ROWS)]
    by_link = rows.statistics_by(_links(rows))
    fields = [_statistics("types", fit.by_type, _MAX_ROWS)] if len(fit.by_type) > 1 else []
    return [*fields, _statistics("links", by_link, _MAX_LINKS)]


def _statistics(label: str, groups: tuple[GroupStatistics, ...], most: int) -> Field:
    def cells(group: GroupStatistics) -> tuple[str, ...]:
        values = ("-" if x is None else metres(x) for x in (group.mean_m, group.rms_m, group.wrms_m))
        return (group.label, str(group.used), str(group.rejected), *values)

    heading = ("residuals, m", "used", "left out", "mean", "rms", "wrms")
    return Field(label, (), heading, tuple(cells(group) for group in groups[:most]), more(len(groups), most))


def _left_out(solution: Solution) -> tuple[str, ...]:
    rows = solution.residuals
    out = np.flatnonzero(~rows.used)
    # The largest outliers say most; what was left out from the beginning has its own reasons.
    out = out[np.argsort(-np.abs(rows.residual_m[out] / rows.sigma_m[out]), kind="stable")]
    shown = out[:_MAX_OUTLIERS]
    epochs = utc_strings(rows.epoch_utc[shown], decimals=0)
    told = zip(epochs, _links(rows)[shown], rows.statuses[shown], strict=True)
    lines = [f"{epoch} {name}: {reason}" for epoch, name, reason in told]
    return (*lines, *more(len(out), len(shown)))
