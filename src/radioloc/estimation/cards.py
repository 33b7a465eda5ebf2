"""The card of a solution: one list of fields, rendered as text for a terminal and as HTML for a notebook."""

from __future__ import annotations

import html
import math
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.labels import Labels
from radioloc.estimation.statistics import GroupStatistics, statistics_by
from radioloc.measurements.link import Link
from radioloc.time import utc_strings

if TYPE_CHECKING:
    from radioloc.estimation.solution import ReferenceComparison, Residuals, Solution

_WIDTH = 80
_LABEL_WIDTH = 12
_SHORTEST_NAME = 6  # where numbers take all the room, the card grows wider
_MAX_ROWS = 6  # stations, biases, outliers: a card is to fit a screen; to_dict() has them all
_MAX_LINKS = 12  # six baselines of four stations, and some that range
_MAX_PARAMETERS = 12
_MAX_OUTLIERS = 3
_MAX_SENTENCES = 4
_FINE = 1e-3  # sigmas below, such as those of clocks, are written with a power of ten
_MAX_SERIES = 3
_MUCH_GROWTH = 3.0
"""A sigma that grows by more has an estimate that other weights make much better."""


@dataclass(frozen=True, slots=True)
class CardField:
    """A label and what it says: lines of text, rows of a table under a heading, lines below it."""

    label: str
    lines: tuple[str, ...] = ()
    heading: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    below: tuple[str, ...] = ()


def card_fields(solution: Solution) -> tuple[CardField, ...]:
    """Collect what the card of a solution says, in order."""
    fields = [
        CardField("solution", (solution.name,)),
        CardField("status", _status(solution)),
        *_where(solution),
    ]
    fields += [CardField("from", _variance_sources(solution))] if solution.position_estimated else []
    fields += [CardField("reference", _reference(solution.reference))] if solution.reference else []
    fields += [CardField("a priori", priors)] if (priors := _position_priors(solution)) else []
    fields += [_other_parameters(solution)] if _others(solution) else []
    fields += [CardField("held", held)] if (held := _held(solution)) else []
    fields += [CardField("passes", passes)] if (passes := _passes(solution)) else []
    fields += [CardField("data", _data(solution)), CardField("fit", _fit(solution)), *_groups(solution)]
    fields += [CardField("left out", _left_out(solution))] if solution.fit.total.rejected else []
    sentences = (*solution.observability.describe()[:_MAX_SENTENCES], *which_sigmas((solution,)))
    fields += [CardField("observable", sentences)] if sentences else []
    fields += [CardField("notes", solution.notes)] if solution.notes else []
    return tuple(fields)


def render_text(fields: tuple[CardField, ...], width: int = _WIDTH) -> str:
    """Fields as text, no line longer than a width, 80 characters by default."""
    out = []
    for item in fields:
        lines = []
        for line in item.lines:
            lines += textwrap.wrap(line, width - _LABEL_WIDTH, subsequent_indent="  ") or [""]
        if item.rows:
            lines += _columns((item.heading, *item.rows), width)
        for line in item.below:
            lines += textwrap.wrap(line, width - _LABEL_WIDTH, subsequent_indent="  ")
        for k, line in enumerate(lines):
            out.append(f"{item.label if k == 0 else '':<{_LABEL_WIDTH}}{line}".rstrip())
    return "\n".join(out)


def render_html(fields: tuple[CardField, ...]) -> str:
    """Fields as an HTML table."""
    rows = []
    for item in fields:
        content = "<br>".join(html.escape(line) for line in item.lines)
        if item.rows:
            head = "".join(f"<th>{html.escape(cell)}</th>" for cell in item.heading)
            cells = ["".join(f"<td>{html.escape(cell)}</td>" for cell in row) for row in item.rows]
            body = "".join(f"<tr>{row}</tr>" for row in cells)
            content += f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
        content += "<br>".join(html.escape(line) for line in item.below)
        left = 'style="text-align:left"'
        rows.append(f"<tr><th {left}>{html.escape(item.label)}</th><td {left}>{content}</td></tr>")
    return f"<table>{''.join(rows)}</table>"


def which_sigmas(solutions: Iterable[Solution]) -> tuple[str, ...]:
    """What to say below sentences on observability of their sigmas, where those of the position are others."""
    lines = []
    for solution in solutions:
        if not (solution.observability.common or solution.observability.weak):
            continue
        if solution.series_weights:
            lines.append(
                "sigmas in these lines are those of the weights: series that stay alike count for less"
            )
        elif solution.noise_scale > 1.0 or solution.time_correlation is not None:
            lines.append(
                "sigmas in these lines are formal ones, which do not contain what the residuals show"
            )
    return tuple(dict.fromkeys(lines))


def metres(value_m: float | None) -> str:
    """Text of a length to three digits, to a tenth of a millimetre at the finest."""
    if value_m is None or not math.isfinite(value_m):
        return "undetermined"
    if value_m == 0.0:
        return "0"
    decimals = min(4, max(0, 2 - math.floor(math.log10(abs(value_m)))))
    return f"{round(value_m, decimals) + 0.0:.{decimals}f}"


def to_sigma(value: float, sigma: float) -> str:
    """Text of a value with the digits that its sigma, given to three of them, asks for; nought far below it."""
    if not (math.isfinite(sigma) and sigma > 0.0 and math.isfinite(value) and value):
        return f"{value + 0.0:.6g}"
    decimals = 2 - math.floor(math.log10(sigma))
    if sigma >= _FINE:
        return f"{round(value, max(decimals, 0)) + 0.0:.{max(decimals, 0)}f}"
    digits = math.floor(math.log10(abs(value))) + decimals + 1
    return f"{value:#.{min(digits, 15)}g}".replace(".e", "e").rstrip(".") if digits > 0 else "0"


def sigma_text(sigma: float) -> str:
    """Text of a sigma to three digits."""
    if not math.isfinite(sigma):
        return "undetermined"
    return metres(sigma) if sigma >= _FINE else f"{sigma:.3g}"


def _columns(table: tuple[tuple[str, ...], ...], width: int) -> list[str]:
    """Rows of cells as aligned lines: the first column to the left, the others to the right."""
    widths = [max(len(row[k]) for row in table) for k in range(len(table[0]))]
    # Names give way so that the numbers stay within the card.
    room = width - _LABEL_WIDTH - sum(w + 2 for w in widths[1:])
    widths[0] = min(widths[0], max(room, _SHORTEST_NAME))
    return [
        f"{_shortened(row[0], widths[0]):<{widths[0]}}"
        + "".join(f"  {cell:>{width}}" for cell, width in zip(row[1:], widths[1:], strict=True))
        for row in table
    ]


def _shortened(text: str, width: int) -> str:
    return text if len(text) <= width else text[: width - 1] + "…"


def _plural(count: int, noun: str, ending: str = "s") -> str:
    return f"{count} {noun}{'' if count == 1 else ending}"


def _status(solution: Solution) -> tuple[str, ...]:
    if not solution.parameters.free.any():
        where = "at the given position" if solution.trajectory is None else "along the given trajectory"
        return (f"NO FIT: observed minus computed {where}",)
    state = "CONVERGED" if solution.converged else solution.status.upper()
    iterations = _plural(len(solution.iterations), "iteration")
    count = f" ({iterations}, {_plural(solution.passes, 'editing pass', 'es')})"
    return (state + count, *((solution.message,) if solution.message else ()))


def _where(solution: Solution) -> list[CardField]:
    if solution.trajectory is not None:
        return [CardField("target", (f"on a trajectory, {solution.trajectory}", "taken as given"))]
    return [CardField("position", _position(solution)), _sigmas(solution)]


def _position(solution: Solution) -> tuple[str, ...]:
    longitude_deg, latitude_deg, height_m = solution.selenographic
    lines = (
        f"{solution.me_frame}  {longitude_deg:.8f} deg E, {latitude_deg:+.8f} deg N, height {height_m:.3f} m",
        f"{solution.me_frame}  x {solution.position_me_m[0]:.3f}  y {solution.position_me_m[1]:.3f}  "
        f"z {solution.position_me_m[2]:.3f} m",
        f"{solution.pa_frame}  x {solution.position_pa_m[0]:.3f}  y {solution.position_pa_m[1]:.3f}  "
        f"z {solution.position_pa_m[2]:.3f} m",
    )
    return lines if solution.position_estimated else (*lines, "held at its a-priori value")


def _sigmas(solution: Solution) -> CardField:
    if not solution.position_estimated:
        return CardField("sigma", ("none: the position was not estimated",))
    levels = [("formal", solution.sigma_enu_m("formal"))]
    if solution.noise_scale > 1.0:
        levels.append((f"noise scaled by {solution.noise_scale:.3g}", solution.sigma_enu_m("scaled")))
    if solution.time_correlation is not None:
        levels = [*levels[:1], ("with residuals alike", solution.sigma_enu_m("scaled"))]
    if solution.ephemeris_sigma_enu_m.any():
        levels.append(("with ephemeris error", solution.sigma_enu_m("total")))
    rows = tuple(
        (name, *(metres(s) for s in sigma), metres(float(np.linalg.norm(sigma)))) for name, sigma in levels
    )
    ellipse = solution.ellipse()
    lines: tuple[str, ...] = ()
    if solution.position_estimated and ellipse is not None:
        lines = (
            f"95 % ellipse, horizontal: {metres(ellipse.semi_major_m)} m x {metres(ellipse.semi_minor_m)} m, "
            f"long axis to {ellipse.azimuth_deg:.0f} deg",
        )
    return CardField("sigma", lines, ("1 sigma, m", "east", "north", "up", "3D"), rows)


def _variance_sources(solution: Solution) -> tuple[str, ...]:
    shares = solution.variance_shares()
    if not shares:
        return ("the position is not determined",)
    names = {
        "noise": "the measurement noise",
        "other parameters": "solving for the other parameters",
        "misfit": "residuals larger than the stated sigmas",
        "correlation": "residuals that stay alike for a while",
        "ephemeris": "the assumed ephemeris error",
    }
    parts = [f"{names[key]} {100.0 * part:.0f} %" for key, part in shares.items() if part >= 0.005]
    return ("of the position's variance: " + ", ".join(parts),)


def _reference(reference: ReferenceComparison) -> tuple[str, ...]:
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
            f"{item.name} {item.prior_value:.6g} +- {metres(item.prior_sigma)} {item.unit}; estimated "
            f"{metres(off_m) if off_m < 0.0 else '+' + metres(off_m)} {item.unit} from it, "
            f"{abs(off_m) / item.prior_sigma:.2f} of its sigmas"
        )
    return tuple(lines)


def _others(solution: Solution, *, held: bool = False) -> list[int]:
    """Parameters beside the position: those that are solved for, or those that are held."""
    free = solution.parameters.free
    involved = (solution.position_partials != 0.0).any(axis=0)
    return [
        k
        for k, item in enumerate(solution.parameters)
        if item.kind != "position" and not involved[k] and free[k] != held
    ]


def _held(solution: Solution) -> tuple[str, ...]:
    """Values that were given and not estimated."""
    items = [solution.parameters.parameters[k] for k in _others(solution, held=True)]
    return (", ".join(f"{item.name} {item.prior_value:.6g} {item.unit}" for item in items),) if items else ()


def _other_parameters(solution: Solution) -> CardField:
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
    return CardField("estimated", (), heading, tuple(rows), _more(len(others), _MAX_PARAMETERS))


def _more(count: int, most: int, where: str = "solution.json") -> tuple[str, ...]:
    return (f"{count - most} more are not shown; {where} has them",) if count > most else ()


def _passes(solution: Solution) -> tuple[str, ...]:
    """When the passes were that have parameters of their own."""
    spans = [
        f"{item.name}: {item.span_utc[0]} to {item.span_utc[1]} UTC"
        for item in solution.parameters
        if item.span_utc is not None
    ]
    return (*spans[:_MAX_ROWS], *_more(len(spans), _MAX_ROWS))


def _data(solution: Solution) -> tuple[str, ...]:
    rows = solution.residuals
    if not len(rows):
        return ("no observations",)
    order = np.lexsort((rows.epoch_utc.fraction, rows.epoch_utc.jd))[[0, -1]]
    first, last = rows.epoch_utc[order[:1]], rows.epoch_utc[order[1:]]
    hours = 24.0 * float((last.jd - first.jd + last.fraction - first.fraction)[0])
    span = f"{hours:.1f} h" if hours < 72.0 else f"{hours / 24.0:.1f} days"
    span = f"{60.0 * hours:.1f} min" if hours < 0.95 else span
    start, stop = (str(utc_strings(epoch, decimals=0)[0]) for epoch in (first, last))
    stations = _plural(len(_ends(rows)), "station")
    return (
        f"{_plural(len(rows), 'observation')} from {stations} over {span},",
        f"{start} to {stop} UTC",
    )


def _fit(solution: Solution) -> tuple[str, ...]:
    fit = solution.fit
    line = f"{fit.total.used} used, {fit.total.rejected} left out"
    # Types whose metres are of different things have no common one.
    if fit.total.wrms_m is not None and len(fit.by_type) <= 1:
        line += f"; wrms {metres(fit.total.wrms_m)} m"
        if {group.label for group in fit.by_type} == {"range"}:
            line += f" of the whole light path ({metres(0.5 * fit.total.wrms_m)} m one way)"
    lines = [line]
    added = {kind: excess_m for kind, excess_m in fit.excess_noise_m.items() if excess_m > 0.0}
    for kind, excess_m in added.items():
        lines.append(
            f"{metres(excess_m)} m of noise added in quadrature to each stated sigma of {kind}: the residuals show it"
        )
    lines += _alike(solution)
    if fit.chi2_per_dof is None or fit.chi2_per_dof_bound is None:
        return (*lines, "no redundancy: nothing tests the stated sigmas")
    verdict = f"chi2/dof {fit.chi2_per_dof:.3g} with {fit.dof} degrees of freedom"
    if fit.chi2_per_dof > fit.chi2_per_dof_bound:
        verdict += (
            f": the residuals are {math.sqrt(fit.chi2_per_dof):.3g} times larger than stated "
            f"(chance allows {fit.chi2_per_dof_bound:.3g} in 99.9 %, Wilson-Hilferty)"
        )
    return (*lines, verdict)


def _alike(solution: Solution) -> list[str]:
    """Which residuals stay alike, those that count least first, and what that does to the sigma."""
    if solution.time_correlation is None:
        return []
    series = sorted(solution.time_correlation.series, key=lambda item: item.effective_count / item.count)
    lines = [str(item) for item in series[:_MAX_SERIES]]
    if len(series) > _MAX_SERIES:
        lines[-1] += f"; so do {len(series) - _MAX_SERIES} more series"
    growth = f"the position's sigma grows by a factor of {solution.correlation_factor:.2g} for that"
    if solution.series_weights:
        return [*lines, *_weighed_as(solution), growth]
    if solution.correlation_factor > _MUCH_GROWTH:
        growth += ', as the estimate weighs them in full: [estimate] weights = "correlated" does not'
    return [*lines, growth]


def _weighed_as(solution: Solution) -> list[str]:
    """Which series the estimate does not weigh in full, those that count least first."""
    weights = sorted(solution.series_weights, key=lambda item: -item.sigma_factor)
    lines = [
        f"weighed as {max(item.weighed_as, 1.0):.0f} independent ones: {item.name}"
        for item in weights[:_MAX_SERIES]
    ]
    if len(weights) > _MAX_SERIES:
        least, most = (max(end(w.weighed_as for w in weights[_MAX_SERIES:]), 1.0) for end in (min, max))
        lines[-1] += f"; {len(weights) - _MAX_SERIES} more series as {least:.0f} to {most:.0f}"
    return lines


def _ends(rows: Residuals) -> set[str]:
    """Stations at either end of some path."""
    if not _have_paths(rows):
        return set(rows.stations.present())
    links = [Link.from_path(path) for path in rows.paths.present()]
    return {end for link in links for end in (link.transmitter, link.receiver)}


def _have_paths(rows: Residuals) -> bool:
    """Whether paths are those of observations, not names of stations in their place."""
    return all(">" in path for path in rows.paths.present())


def _groups(solution: Solution) -> list[CardField]:
    """Statistics by station; where kinds of measurement differ, or there are baselines, by kind and by link."""
    rows, fit = solution.residuals, solution.fit
    several = len(fit.by_type) > 1
    baselines = any("<" in path for path in rows.paths.texts)
    if not _have_paths(rows) or not (several or baselines):
        return [_statistics("stations", fit.by_station, _MAX_ROWS)]
    places = Labels.coded(_places(rows), rows.paths.codes)
    if several:
        # Of several kinds a station has no one rms: metres of range and of growth over a count interval differ.
        names = [f"{place} {kind}" for place in places.texts for kind in rows.types.texts]
        places = Labels.coded(names, places.codes * len(rows.types.texts) + rows.types.codes)
    by_link = statistics_by(places, rows.residual_m, rows.sigma_m, rows.used)
    fields = [_statistics("types", fit.by_type, _MAX_ROWS)] if several else []
    return [*fields, _statistics("links", by_link, _MAX_LINKS, "residuals.csv")]


def _places(rows: Residuals) -> list[str]:
    return [Link.from_path(path).place for path in rows.paths.texts]


def _statistics(
    label: str, groups: tuple[GroupStatistics, ...], most: int, where: str = "solution.json"
) -> CardField:
    def cells(group: GroupStatistics) -> tuple[str, ...]:
        values = (group.mean_m, group.rms_m, group.wrms_m)
        return (
            group.label,
            str(group.used),
            str(group.rejected),
            *("-" if value is None else metres(value) for value in values),
        )

    heading = ("residuals, m", "used", "left out", "mean", "rms", "wrms")
    shown = tuple(cells(group) for group in groups[:most])
    return CardField(label, (), heading, shown, _more(len(groups), most, where))


def _left_out(solution: Solution) -> tuple[str, ...]:
    rows = solution.residuals
    out = np.flatnonzero(~rows.used)
    # The largest outliers say most; what was left out from the beginning has its own reasons.
    out = out[np.argsort(-np.abs(rows.residual_m[out] / rows.sigma_m[out]), kind="stable")]
    shown = out[:_MAX_OUTLIERS]
    epochs = utc_strings(rows.epoch_utc[shown], decimals=0)
    told = zip(epochs, _names(rows, shown), rows.outcome[shown], strict=True)
    lines = [f"{epoch} {name}: {reason}" for epoch, name, reason in told]
    if len(out) > len(shown):
        lines.append(f"... and {len(out) - len(shown)} more")
    return tuple(lines)


def _names(rows: Residuals, shown: NDArray[np.intp]) -> list[str]:
    """What some observations are called in a line: their station or baseline, and what else tells them apart."""
    if not _have_paths(rows):
        return [str(station) for station in rows.stations[shown]]
    several = len(rows.types.present()) > 1
    names = []
    for path, kind in zip(rows.paths[shown], rows.types[shown], strict=True):
        link = Link.from_path(str(path))
        three_way = not link.differenced and link.transmitter != link.receiver
        name = f"{link.place} from {link.transmitter}" if three_way else link.place
        names.append(f"{name} {kind}" if several else name)
    return names
