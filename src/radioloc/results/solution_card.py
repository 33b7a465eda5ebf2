"""The card of a solution: where the target is and how well that is known, beside how well observations are fitted."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.consider import A_PRIORI, EPHEMERIS, NOISE, ErrorSource, by_source
from radioloc.measurements.registry import KINDS, MEASUREMENTS
from radioloc.parameters.parameter import Role
from radioloc.parameters.registry import parameter_label
from radioloc.results.cards import (
    BUDGET,
    OBSERVABILITY,
    Card,
    Detail,
    Field,
    in_section,
    metres,
    plural,
    provenance_detail,
    sigma_text,
    signed_metres,
    table,
    to_sigma,
)
from radioloc.results.fit_card import fit_fields, inconsistent, rejected_detail
from radioloc.results.solution import Level, Solution, card_of
from radioloc.results.tables import ellipse_text
from radioloc.targets.orbit_state import OrbitState, ProcessEstimate
from radioloc.time import utc_strings

# A card is to fit a screen; to_dict() has all rows.
_MAX_ROWS = 6
_MAX_PARAMETERS = 12
_MAX_OUTLIERS = 3
_MAX_SENTENCES = 4
_MIN_VARIANCE_FRACTION = 0.005
"""Sources with a smaller part of the variance are shown together."""
_MEASURES = {
    "measurement noise, by more or better observations": (NOISE,),
    "a-priori values": (A_PRIORI,),
    "the ephemeris": (
        EPHEMERIS,
        "moon_position",
        "moon_position_variation",
        "libration",
        "libration_variation",
    ),
    "coordinates of stations": ("station_position",),
    "clocks and frequencies": ("clock", "clock_rate", "frequency_offset", "frequency_rate"),
    "delays of stations": ("station_delay", "range_bias", "time_bias"),
    "zenith delays": ("zenith_delay",),
    "electron content": ("electron_content",),
    "Earth orientation": ("ut1", "pole"),
}
"""Measures by their names, and the sources of error that each reduces; others have the names of their sources."""
_MIN_COARSE_SIGMA_M = 10.0
"""Coordinates worse than that are not surveyed."""


@card_of.register(Solution)
def solution_card(solution: Solution) -> Card:
    """Collect what the card of a solution says, in order."""
    sentences = (
        *_doppler_alone(solution),
        *solution.observability.describe()[:_MAX_SENTENCES],
        *which_sigmas((solution,)),
    )
    orbit = [Field("orbit", _orbit(state)) for state in solution.states.values()]
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
            Field("targets", _targets(solution)),
            *in_section(BUDGET, _budget(solution)),
            Field("reference", _reference(solution)),
            Field("a priori", _position_priors(solution)),
            *in_section(
                OBSERVABILITY, _estimated(solution), Field("held", _held(solution)), _passes(solution)
            ),
            *fit_fields(solution),
            Field("observable", sentences, section=OBSERVABILITY),
            Field("notes", solution.notes),
        ),
        _details(solution),
    )


def _details(solution: Solution) -> Iterator[Detail]:
    """Yield whole tables of which the card has the first rows, and the origin."""
    rows = [(item.source, item.name or "-", *_sides(item)) for item in solution.budget]
    heading = ("1 sigma, m", "of", "east", "north", "up", "3D")
    yield Detail(BUDGET, "Every source", (Field("", (), heading, rows),))
    pairs = solution.observability.correlations
    rows = [(pair.first, pair.second, f"{pair.coefficient:+.4f}") for pair in pairs]
    table = Field("", (), ("parameter", "and", "correlation"), rows)
    yield Detail(OBSERVABILITY, "All large correlations", (table,))
    yield rejected_detail(solution)
    yield provenance_detail(solution.provenance)


def _orbit(state: OrbitState) -> Iterator[str]:
    (shape, _), (lowest_m, highest_m) = state.elements(), state.apsides_m()
    x, y, z = (f"{value / 1e3:.6f}" for value in state.position_m)
    vx, vy, vz = (f"{value / 1e3:.9f}" for value in state.velocity_m_s)
    yield f"of {state.orbit.name}, Moon-centred ICRF, at {utc_strings(state.epoch, 3)[0]} TDB"
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


def _doppler_alone(solution: Solution) -> Iterator[str]:
    """Best and worst determined directions of a position from counts alone, which measure no distance."""
    kinds = {group.label for group in solution.fit.by_type if group.used}
    known = solution.position_estimated and solution.position_determined
    if not (known and kinds and all(kind in KINDS and MEASUREMENTS[kind].integrated for kind in kinds)):
        return
    variances, axes = np.linalg.eigh(solution.position_covariance())
    best, *_, worst = (
        f"{metres(math.sqrt(max(variance, 0.0)))} m {_towards(axis)}"
        for variance, axis in zip(variances.tolist(), axes.T, strict=True)
    )
    yield (
        f"Doppler alone, without a range or a delay: the position is determined best to {best}, worst to {worst} "
        "(1 sigma)"
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
    yield from (f"WARNING: {item}" for item in inconsistent(solution, strongly=True))


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
        lines.append(ellipse_text(ellipse))
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
    """Sources of the sigma, and what to improve first."""
    if not solution.position_estimated:
        return Field("budget")
    if not solution.position_determined:
        return Field("budget", ("the position is not determined",))
    items = solution.budget
    total_m2 = sum(item.total_m**2 for item in items)
    rows: list[tuple[str, ...]] = []
    rest: list[ErrorSource] = []
    for whole in by_source(items):
        if len(rows) < _MAX_ROWS and whole.total_m**2 > _MIN_VARIANCE_FRACTION * total_m2:
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


def _sides(item: ErrorSource) -> tuple[str, ...]:
    return tuple(map(metres, (*item.sigma_m.tolist(), item.total_m)))


def _advice(items: Sequence[ErrorSource]) -> Iterator[str]:
    """The largest that are somebody's, and what to improve first."""
    if not items:
        return
    if named := [item for item in items if item.name][:_MAX_OUTLIERS]:
        of_them = (f"{item.source} of {item.name} {metres(item.total_m)} m" for item in named)
        yield f"largest in these: {', '.join(of_them)}"
    measures = {source: measure for measure, all_of in _MEASURES.items() for source in all_of}
    groups: dict[str, list[ErrorSource]] = {}
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


def _coordinates(solution: Solution, items: Sequence[ErrorSource]) -> Iterator[str]:
    """Advice where rounded coordinates of the catalogue dominate the sigma."""
    if solution.consider is None or not items or items[0].source != "station_position":
        return
    known = solution.consider.parameters
    coarse = {
        item.name.split(".")[1]
        for k in known.of_kind("station_position")
        if (item := known.parameters[k]).prior_sigma > _MIN_COARSE_SIGMA_M
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
    shown = [
        f"{parameter_label(item.name)} {item.prior_value:.6g} {item.unit}" for item in items[:_MAX_PARAMETERS]
    ]
    more = [f"and {len(items) - len(shown)} others, in solution.json"] if len(items) > len(shown) else []
    if shown:
        yield ", ".join(shown + more)


def _estimated(solution: Solution) -> Field:
    """Estimated parameters beside the position."""
    sigmas, formal, rows = solution.sigmas(), solution.sigmas("formal"), []
    for k in _others(solution):
        item = solution.parameters.parameters[k]
        free = math.isinf(item.prior_sigma)
        prior = "free" if free else f"{item.prior_value:.4g} +- {item.prior_sigma:.4g}"
        value = to_sigma(solution.values[k], formal[k])
        rows.append((parameter_label(item.name), value, sigma_text(sigmas[k]), item.unit, prior))
    return table("estimated", ("parameter", "value", "sigma", "unit", "a priori"), rows, _MAX_PARAMETERS)


def _passes(solution: Solution) -> Field:
    """Spans of the passes that have parameters of their own."""
    rows = [(item.name, *item.span_utc) for item in solution.parameters if item.span_utc is not None]
    return table("passes", ("of a pass", "from (UTC)", "to"), rows, _MAX_ROWS)
