"""The card of a solution: where the target is, how well that is known, and how well observations are fitted."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.estimation.consider import A_PRIORI, EPHEMERIS, NOISE, BudgetItem, by_source
from radioloc.estimation.consistency import Inconsistency
from radioloc.estimation.labels import Labels
from radioloc.estimation.orbit_state import OrbitState, ProcessEstimate
from radioloc.estimation.solution import Level, Solution, card_of
from radioloc.estimation.statistics import Residuals
from radioloc.measurements.link import Link
from radioloc.measurements.registry import KINDS, is_integrated
from radioloc.parameters.parameter import Role
from radioloc.report.cards import (
    Card,
    Field,
    duration,
    have_paths,
    metres,
    more,
    plural,
    short_names,
    sigma_text,
    signed_metres,
    to_sigma,
)
from radioloc.time import utc_strings

# A card is to fit a screen; to_dict() has all rows.
_MAX_ROWS = 6
_MAX_CANDIDATES = 3
_MAX_LINKS = 12  # six baselines of four stations, and some that range
MAX_PARAMETERS = 12
_MAX_OUTLIERS = 3
_MAX_SENTENCES = 4
_MAX_SERIES = 3
_LEAST_SHARE = 0.005
"""Sources with a smaller part of the variance are shown together."""
_MEASURES = {
    "measurement noise, by more or better observations": (NOISE,),
    "a-priori values": (A_PRIORI,),
    "the ephemeris": (
        EPHEMERIS,
        *("moon_position", "moon_position_variation", "libration", "libration_variation"),
    ),
    "coordinates of stations": ("station_position",),
    "clocks and frequencies": ("clock", "clock_rate", "frequency_offset", "frequency_rate"),
    "delays of stations": ("station_delay", "range_bias", "time_bias"),
    "zenith delays": ("zenith_delay",),
    "electron content": ("electron_content",),
    "Earth orientation": ("ut1", "pole"),
}
"""What one measure would improve, and the sources of error that this is; others are called by their names."""
_COARSE_M = 10.0
"""Coordinates worse than that are not surveyed."""
_SPLIT_SIGMAS = 3.3
"""Means of two links that differ by more do so by chance in 1 of 1000 cases."""
_ENLARGED = 1.05
_MUCH_LARGER = 3.0
"""A sigma that grows by more belongs to an estimate that other weights make much better."""


@card_of.register(Solution)
def solution_card(solution: Solution, *, parameters: int | None = None) -> Card:
    """Collect what the card of a solution says, in order; on a page, with so many parameters, all rows of the rest."""
    page = parameters is not None
    sentences = (
        *doppler_alone(solution),
        *solution.observability.describe()[:_MAX_SENTENCES],
        *which_sigmas((solution,)),
    )
    orbit = [] if solution.state is None else [Field("orbit", _orbit(solution.state, solution.arcs))]
    if orbit and solution.trajectory is not None:
        where = orbit
    elif solution.trajectory is not None:
        where = [Field("target", (f"on a trajectory, {solution.trajectory}", "taken as given"))]
    else:
        of = (f"of {solution.targets[0].name}, the first of the targets",) if solution.targets else ()
        where = [Field("position", (*of, *_position(solution))), _sigmas(solution), *orbit]
    return Card(
        (
            Field("solution", (solution.name,)),
            Field("status", _status(solution)),
            *where,
            _overlaps(solution),
            Field("targets", _targets(solution)),
            _budget(solution),
            Field("reference", _reference(solution)),
            Field("a priori", _position_priors(solution)),
            parameter_field(solution, MAX_PARAMETERS)
            if parameters is None
            else parameter_field(solution, parameters, "the table of all parameters"),
            Field("held", _held(solution)),
            Field("passes", _passes(solution, page)),
            Field("data", _data(solution)),
            _transmitters(solution),
            Field("fit", _fit(solution)),
            Field(
                "misfit", (str(item) for item in solution.consistency.found if not _strong(solution, item))
            ),
            *_groups(solution, page),
            Field("left out", _left_out(solution)),
            Field("observable", sentences),
            Field("notes", solution.notes),
        )
    )


def _orbit(state: OrbitState, arcs: Sequence[OrbitState]) -> Iterator[str]:
    (shape, _), (lowest_m, highest_m) = state.elements(), state.apsides_m()
    x, y, z = (f"{value / 1e3:.6f}" for value in state.position_m)
    vx, vy, vz = (f"{value / 1e3:.9f}" for value in state.velocity_m_s)
    of = f", first of {len(arcs)} arcs" if arcs else ""
    yield f"of {state.orbit.name}{of}, Moon-centred ICRF, at {utc_strings(state.epoch, 3)[0]} TDB"
    yield f"position {x}, {y}, {z} km"
    yield f"velocity {vx}, {vy}, {vz} km/s"
    if state.covariance.any():  # else it is held
        for where, tdb in (("sigma there", state.epoch), ("at the arc's ends", state.orbit.times(2))):
            radial_m, along_m, across_m = np.max(state.sigma_rtn_m(tdb), axis=0)
            yield f"{where} {metres(radial_m)} m radial, {metres(along_m)} m along, {metres(across_m)} m across"
    if state.process is not None:
        yield _process(state.process)
    up_to = " and higher" if highest_m is None else f" to {highest_m / 1e3:.1f}"
    yield (
        f"semi-major axis {shape['semi_major_axis_m'] / 1e3:.3f} km, eccentricity {shape['eccentricity']:.5f}, "
        f"{shape['inclination_deg']:.3f} deg to the Moon's equator, "
        f"{lowest_m / 1e3:.1f}{up_to} km above 1737.4 km"
    )


def _process(process: ProcessEstimate) -> str:
    """Sizes of stochastic accelerations and what is assumed of them."""
    values = np.concatenate([chain[:-1] for chain in process.values_m_s2])
    found, assumed = (
        ", ".join(f"{size:.2g}" for size in sizes)
        for sizes in (np.sqrt((values**2).mean(axis=0)), process.sigma_m_s2)
    )
    lasting = f", correlated over {process.correlation_s:g} s" if process.correlation_s else ""
    return (
        f"stochastic accelerations of {process.effects.interval_s:g} s{lasting}: rms {found} m/s2 radial, along, "
        f"across; a priori {assumed}"
    )


def _overlaps(solution: Solution) -> Field:
    """Where arcs of an orbit meet, and by how much they differ there."""
    rows = [
        (
            utc_strings(one.epoch, 0)[0][5:16],
            *(
                f"{signed_metres(difference)} +- {metres(sigma)}"
                for difference, sigma in zip(one.difference_m, one.sigma_m, strict=True)
            ),
            "-" if one.sigmas is None else f"{one.sigmas:.2f}",
        )
        for one in solution.overlaps
    ]
    below = ["the later arc less the earlier, m; in sigmas 95 % are below 2.80"]
    heading = ("meet (TDB)", "radial", "along", "across", "sigmas")
    return Field("arcs", (), heading, rows, below if rows else ())


def doppler_alone(solution: Solution) -> Iterator[str]:
    """What is known of a position best and worst where all that was used are counts: they measure no distance."""
    kinds = [group.label for group in solution.fit.by_type if group.used]
    counted = [kind in KINDS and bool(is_integrated(np.array(KINDS.index(kind)))) for kind in kinds]
    if not (counted and all(counted)) or not (solution.position_estimated and solution.position_determined):
        return
    variances, axes = np.linalg.eigh(solution.position_covariance())
    best, *_, worst = (
        f"{metres(math.sqrt(max(variance, 0.0)))} m {_towards(axis)}"
        for variance, axis in zip(variances.tolist(), axes.T, strict=True)
    )
    yield (
        f"Doppler alone, without a range or a delay: the position is known best to {best}, worst to {worst} (1 sigma)"
    )


def _towards(east_north_up: NDArray[np.float64]) -> str:
    """A direction, or its opposite, whichever does not point down."""
    east, north, up = east_north_up * (1.0 if east_north_up[2] >= 0.0 else -1.0)
    azimuth_deg = math.degrees(math.atan2(east, north)) % 360.0
    up_deg = math.degrees(math.asin(min(up, 1.0)))
    if up_deg > 80.0:
        return "in height"
    return f"towards azimuth {azimuth_deg:.0f} deg" + (f", {up_deg:.0f} deg up" if up_deg >= 0.5 else "")


def which_sigmas(solutions: Iterable[Solution]) -> Iterable[str]:
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
    return dict.fromkeys(lines)


def _status(solution: Solution) -> Iterator[str]:
    if not solution.parameters.free.any():
        where = "at the given position" if solution.trajectory is None else "along the given trajectory"
        yield f"NO FIT: observed minus computed {where}"
        return
    state = "CONVERGED" if solution.converged else solution.status.upper()
    iterations = plural(solution.iterations, "iteration")
    yield f"{state} ({iterations}, {plural(solution.passes, 'editing pass', 'es')})"
    if solution.message:
        yield solution.message
    for item in solution.consistency.found:
        if _strong(solution, item):
            yield f"WARNING: {item}"


def _strong(solution: Solution, item: Inconsistency) -> bool:
    """Whether what does not fit moves the position by more than its sigma."""
    if item.shift_enu_m is None:
        return False
    return math.hypot(*item.shift_enu_m) > float(np.linalg.norm(solution.sigma_enu_m()))


def _position(solution: Solution) -> Iterator[str]:
    longitude_deg, latitude_deg, height_m = solution.selenographic
    yield f"{solution.me_frame}  {longitude_deg:.8f} deg E, {latitude_deg:+.8f} deg N, height {height_m:.3f} m"
    vectors = {solution.me_frame: solution.position_me_m, solution.pa_frame: solution.position_pa_m}
    for frame, (x, y, z) in vectors.items():
        yield f"{frame}  x {x:.3f}  y {y:.3f}  z {z:.3f} m"
    if not solution.position_estimated:
        yield "held at its a-priori value"


def _sigmas(solution: Solution) -> Field:
    if not solution.position_estimated:
        return Field("sigma", ("none: the position was not estimated",))
    levels: dict[str, Level] = {"formal": "formal"}
    if solution.time_correlation is not None:
        levels["with time correlation"] = "scaled"
    elif solution.noise_scale > 1.0:
        levels[f"noise scaled by {solution.noise_scale:.3g}"] = "scaled"
    beyond = ["considered"] * (solution.consider is not None)
    beyond += ["ephemeris error"] * bool(solution.ephemeris_sigma_enu_m.any())
    if beyond:
        levels[f"with {' and '.join(beyond)}"] = "total"
    rows = []
    for name, level in levels.items():
        sigma_m = solution.sigma_enu_m(level)
        rows.append((name, *map(metres, sigma_m), metres(float(np.linalg.norm(sigma_m)))))
    lines = []
    if (ellipse := solution.ellipse()) is not None:
        lines.append(
            f"95 % error ellipse, horizontal: {metres(ellipse.semi_major_m)} m x "
            f"{metres(ellipse.semi_minor_m)} m, azimuth {ellipse.azimuth_deg:.0f} deg"
        )
    return Field("sigma", lines, ("1 sigma, m", "east", "north", "up", "3D"), rows)


def _targets(solution: Solution) -> Iterator[str]:
    """The positions of several targets, of which the first is the one above."""
    for target in solution.targets:
        of = solution.of_target(target.name)
        longitude_deg, latitude_deg, height_m = of.selenographic
        yield (
            f"{target.name}: {longitude_deg:.8f} deg E, {latitude_deg:+.8f} deg N, {height_m:.3f} m; "
            f"1 sigma east, north, up {' '.join(map(metres, of.sigma_enu_m()))} m"
        )


def _budget(solution: Solution) -> Field:
    """What the sigma comes from, by source, and what to improve first."""
    if not solution.position_estimated:
        return Field("budget")
    if not solution.position_determined:
        return Field("budget", ("the position is not determined",))
    items = solution.budget
    total_m2 = sum(item.total_m**2 for item in items)
    rows: list[tuple[str, ...]] = []
    rest: list[BudgetItem] = []
    for whole in by_source(items):
        if len(rows) < _MAX_ROWS and whole.total_m**2 > _LEAST_SHARE * total_m2:
            rows.append((whole.source, *_sides(whole)))
        else:
            rest.append(replace(whole, source="others"))
    rows += [("others", *_sides(whole)) for whole in by_source(rest)]
    return Field(
        "budget",
        (),
        ("1 sigma, m", "east", "north", "up", "3D"),
        rows,
        (*_advice(items), *_coordinates(solution, items)) if solution.converged else (),
    )


def _sides(item: BudgetItem) -> tuple[str, ...]:
    return tuple(metres(side) for side in (item.east_m, item.north_m, item.up_m, item.total_m))


def _advice(items: Sequence[BudgetItem]) -> Iterator[str]:
    """The largest that are somebody's, and what to improve first."""
    if not items:
        return
    if named := [item for item in items if item.name][:_MAX_OUTLIERS]:
        of_them = (f"{item.source} of {item.name} {metres(item.total_m)} m" for item in named)
        yield f"largest in these: {', '.join(of_them)}"
    measures = {source: measure for measure, all_of in _MEASURES.items() for source in all_of}
    groups: dict[str, list[BudgetItem]] = {}
    for item in items:
        groups.setdefault(measures.get(item.source, item.source.replace("_", " ")), []).append(item)
    sizes_m2 = {measure: sum(item.total_m**2 for item in mine) for measure, mine in groups.items()}
    if len(sizes_m2) == 1:  # without it nothing would be left, which says nothing
        return
    measure = max(sizes_m2, key=lambda one: sizes_m2[one])
    names = list(dict.fromkeys(item.name for item in groups[measure] if item.name))
    first = f", {'most of all ' * (len(names) > 1)}those of {names[0]}" if names else ""
    total_m2 = sum(sizes_m2.values())
    without_m = math.sqrt(max(0.0, total_m2 - sizes_m2[measure]))
    yield (
        f"to improve first: {measure}{first}; without this error {metres(without_m)} m in place of "
        f"{metres(math.sqrt(total_m2))} m"
    )


def _coordinates(solution: Solution, items: Sequence[BudgetItem]) -> Iterator[str]:
    """What to do where coordinates that the catalogue has only roundly dominate the sigma."""
    if solution.consider is None or not items or items[0].source != "station_position":
        return
    known = solution.consider.parameters
    coarse = {
        item.name.split(".")[1]
        for k in known.of_kind("station_position")
        if (item := known.parameters[k]).prior_sigma > _COARSE_M
    }
    if coarse:
        yield (
            f"coordinates of {', '.join(sorted(coarse))} are rounded: give better ones with their sigma_m under "
            "[stations.NAME], or station_position_sigma_m under [consider] where these are better than stated"
        )


def _reference(solution: Solution) -> Iterator[str]:
    for reference in solution.known:
        line = (
            f"solution - {reference.name}: east {metres(reference.east_m)}, north {metres(reference.north_m)}, "
            f"up {metres(reference.up_m)} m; {metres(reference.horizontal_m)} m horizontal, "
            f"{metres(reference.distance_m)} m in space"
        )
        if reference.combined_sigmas is not None:
            line += f"; {reference.combined_sigmas:.2f} sigmas (95 % are below 2.80)"
        yield line


def _position_priors(solution: Solution) -> Iterator[str]:
    """A-priori values of the position's parameters, and how far off the estimate is."""
    for item, value in zip(solution.parameters, solution.values, strict=True):
        if item.kind != "position" or item.fixed or not math.isfinite(item.prior_sigma):
            continue
        off_m = float(value) - item.prior_value
        yield (
            f"{item.name} {item.prior_value:.6g} +- {metres(item.prior_sigma)} {item.unit}; the estimate is "
            f"{signed_metres(off_m)} {item.unit} from it, {abs(off_m) / item.prior_sigma:.2f} a-priori sigmas"
        )


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


def _held(solution: Solution) -> Iterator[str]:
    """Values that were given and not estimated."""
    items = [solution.parameters.parameters[k] for k in _others(solution, held=True)]
    if items:
        yield ", ".join(f"{item.name} {item.prior_value:.6g} {item.unit}" for item in items)


def parameter_field(solution: Solution, most: int, where: str = "solution.json") -> Field:
    """Estimated parameters beside the position, the first of them, and where the others are."""
    others, sigmas = _others(solution), solution.sigmas()
    rows = []
    for k in others[:most]:
        item = solution.parameters.parameters[k]
        prior = (
            "free" if math.isinf(item.prior_sigma) else f"{item.prior_value:.4g} +- {item.prior_sigma:.4g}"
        )
        rows.append(
            (item.name, to_sigma(solution.values[k], sigmas[k]), sigma_text(sigmas[k]), item.unit, prior)
        )
    heading = ("parameter", "value", "sigma", "unit", "a priori")
    return Field("estimated", (), heading, rows, more(len(others), most, where))


def _passes(solution: Solution, every: bool) -> Iterator[str]:
    """When the passes were that have parameters of their own."""
    items = [item for item in solution.parameters if item.span_utc is not None]
    most = len(items) if every else _MAX_ROWS
    for item in items[:most]:
        yield f"{item.name}: {' to '.join(item.span_utc or ())} UTC"
    yield from more(len(items), most)


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


def _transmitters(solution: Solution) -> Field:
    """Candidates for the transmitter of each pass, with the rms that each leaves; of many, the next best alone."""
    passes = solution.transmitters
    names = list(dict.fromkeys(name for one in passes for name in one.rms_m_s))
    few = len(names) <= _MAX_CANDIDATES
    rows: list[tuple[str, ...]] = []
    for one in passes:
        taken = one.taken if one.decided else f"{one.taken}?"
        next_best = [(name, one.size(name)) for name in one.ranking if name != one.taken][:1] or [("-", "-")]
        sizes = (*map(one.size, names), taken) if few else (taken, one.size(one.taken), *next_best[0])
        rows.append((f"{one.receiver} {one.first_utc[5:16]}", *sizes))
    heading = ("rms of pass", *names, "taken") if few else ("pass", "taken", "rms", "next best", "rms")
    cells = [cell for row in rows[:_MAX_LINKS] for cell in row]
    below = ["- does not see the target"] * ("-" in cells)
    below += ["? undecided: another fits about as well"] * any(cell.endswith("?") for cell in cells)
    shown, rest = rows[:_MAX_LINKS], rows[_MAX_LINKS:]
    return Field("transmitter", (), heading, shown, below, rest, "solution.json")


def _fit(solution: Solution) -> Iterator[str]:
    fit = solution.fit
    line = f"{fit.total.used} used, {fit.total.rejected} left out"
    # Types whose metres are of different things have no common one.
    if fit.total.wrms_m is not None and len(fit.by_type) <= 1:
        line += f"; wrms {metres(fit.total.wrms_m)} m"
        if {group.label for group in fit.by_type} == {"range"}:
            line += f" round trip ({metres(0.5 * fit.total.wrms_m)} m one way)"
    yield line
    added = fit.excess_noise_m
    if len(added) > _MAX_ROWS and any(added.values()):
        least, *_, most = sorted(added, key=lambda kind: added[kind])
        yield (
            f"additive variance components of {len(added)} links and passes: sigma {metres(added[least])} m ({least}) "
            f"to {metres(added[most])} m ({most}), added in quadrature to the stated sigmas"
        )
    for kind, added_m in added.items() if len(added) <= _MAX_ROWS else ():
        if added_m > 0.0:
            yield (
                f"additive variance component of {kind}: sigma {metres(added_m)} m, added in quadrature to the "
                "stated sigmas"
            )
        elif " of " in kind and any(added.values()):
            yield f"{kind} has no additive variance component, unlike the others"
    if fit.shared_noise_m:
        sizes = ", ".join(f"{name} {metres(sigma_m)} m" for name, sigma_m in fit.shared_noise_m.items())
        yield f"delays of one epoch share errors of stations, as their residuals show: sigma {sizes}"
    yield from _time_correlation(solution)
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
    """Which residuals are correlated in time, those with the least information first, and what that does to sigma."""
    if solution.time_correlation is None:
        return
    series = sorted(solution.time_correlation.series, key=lambda item: item.effective_count / item.count)
    lines = [
        f"time-correlated residuals of {item.name} (Gauss-Markov, correlation time "
        f"{duration(item.correlation_time_s)}): {item.count} observations carry the information of "
        f"{max(item.effective_count, 1.0):.0f}"
        for item in series[:_MAX_SERIES]
    ]
    if len(series) > _MAX_SERIES:
        lines[-1] += f"; likewise {len(series) - _MAX_SERIES} more series"
    weights = sorted(solution.series_weights, key=lambda item: -item.sigma_factor)
    lines += [
        f"weight of {item.name}: that of {max(item.weighed_as, 1.0):.0f} independent observations"
        for item in weights[:_MAX_SERIES]
    ]
    if len(weights) > _MAX_SERIES:
        least, most = (max(end(w.weighed_as for w in weights[_MAX_SERIES:]), 1.0) for end in (min, max))
        lines[-1] += f"; of {len(weights) - _MAX_SERIES} more series that of {least:.0f} to {most:.0f}"
    yield from lines
    if solution.correlation_factor < _ENLARGED:  # also where there is no position, or none that is determined
        return
    enlarged = (
        f"the time correlation enlarges the position sigma by a factor of {solution.correlation_factor:.2g}"
    )
    if solution.correlation_factor > _MUCH_LARGER and not weights:
        enlarged += '; [estimate] weights = "correlated" allows for it in the weights too'
    yield enlarged


def _ends(rows: Residuals) -> set[str]:
    """Stations at either end of some path."""
    if not have_paths(rows):
        return set(rows.stations.present())
    return {station for path in rows.paths.present() for station in Link.from_path(path).stations}


def _links(rows: Residuals) -> Labels:
    """What the station or link of each observation is called, with the type where those differ."""
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


def _groups(solution: Solution, every: bool) -> Iterator[Field]:
    """Statistics by station; where types differ, or a station has part in several paths, by type and by path."""
    rows, fit = solution.residuals, solution.fit
    if not have_paths(rows) or len(fit.by_path) == len(fit.by_station) == len(_ends(rows)):
        found = [("stations", fit.by_station, _MAX_ROWS)]
    else:
        found = [("types", fit.by_type, _MAX_ROWS)] if len(fit.by_type) > 1 else []
        found.append(("links", rows.statistics_by(_links(rows)), _MAX_LINKS))
    heading = ("residuals, m", "used", "left out", "mean", "rms", "wrms")
    for label, groups, at_most in found:
        most, cells = len(groups) if every else at_most, []
        for group in groups[:most]:
            sizes = ("-" if x is None else metres(x) for x in (group.mean_m, group.rms_m, group.wrms_m))
            cells.append((group.label, str(group.used), str(group.rejected), *sizes))
        split = _split(solution) if label == "links" else ()
        yield Field(label, (), heading, cells, (*more(len(groups), most), *split))


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
        if sigmas > _SPLIT_SIGMAS and one is not None and two is not None:
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
