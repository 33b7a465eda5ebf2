"""Card of a solution: status, position or orbit with its uncertainty, error budget, parameters and the fit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from radioloc.estimation.consider import (
    A_PRIORI,
    EPHEMERIS,
    NOISE,
    UNMODELLED_ERROR,
    ErrorSource,
    owner,
    sum_by_source,
)
from radioloc.measurements.registry import KINDS, MEASUREMENTS
from radioloc.parameters.parameter import Role
from radioloc.results.cards import (
    BUDGET,
    OBSERVABILITY,
    PROVENANCE,
    Card,
    Detail,
    Field,
    first_lines,
    in_section,
    metres,
    plural,
    provenance_detail,
    sigma_text,
    signed_metres,
    table,
    value_text,
)
from radioloc.results.fit_card import finding_lines, fit_fields, rejected_detail, select_findings
from radioloc.results.names import error_name, parameter_name, source_name, with_parameter_names
from radioloc.results.solution import Level, Solution, build_card
from radioloc.results.tables import ellipse_text
from radioloc.targets.orbit_state import OrbitState, ProcessEstimate
from radioloc.time import utc_strings
from radioloc.vectors import Floats

# A card fits a screen; to_dict() has all rows.
_MAX_ROWS = 6
_MAX_PARAMETERS = 12
_MAX_NAMED_SOURCES = 3
_MAX_SENTENCES = 4
_MIN_EXCESS_RATIO = 1.01  # of a total sigma over its a-priori one from which the card explains it
_MIN_VARIANCE_FRACTION = 0.005  # smallest part of the variance of a source that the card names
_MEASURES = {
    "what the consistency tests name, by correcting, excluding or estimating it": (UNMODELLED_ERROR,),
    "measurement noise, by more or better observations": (NOISE,),
    "a-priori values": (A_PRIORI,),
    "the ephemeris": (
        EPHEMERIS,
        "moon_position",
        "moon_position_variation",
        "libration",
        "libration_variation",
    ),
    "station coordinates": ("station_position",),
    "clocks and frequencies": ("clock", "clock_rate", "frequency_offset", "frequency_rate"),
    "delays of stations": ("station_delay", "range_bias", "time_bias"),
    "zenith delays": ("zenith_delay",),
    "electron content": ("electron_content",),
    "Earth orientation": ("ut1", "pole"),
}
"""Sources of error by the measure that reduces them; other measures have the names of their sources."""
_SIGMA_HEADING = ("1 sigma, m", "east", "north", "up", "3D")


@build_card.register(Solution)
def solution_card(solution: Solution) -> Card:
    """Return the fields of the card, in order."""
    sentences = (
        *_doppler_lines(solution),
        *solution.observability.describe()[:_MAX_SENTENCES],
        *sigma_levels((solution,)),
    )
    observable = (with_parameter_names(text, solution.parameters) for text in sentences)
    target_fields = [Field("orbit", _orbit_lines(state)) for state in solution.states.values()]
    if solution.trajectory is None:
        target = (f"of {solution.targets[0].name}, the first of the targets",) if solution.targets else ()
        position = Field("position", (*target, *_position_lines(solution)))
        target_fields = [position, _sigma_field(solution), *target_fields]
    elif not target_fields:
        target_fields = [Field("target", (f"on a trajectory, {solution.trajectory}", "taken as given"))]
    return Card(
        (
            Field("solution", (solution.name,)),
            Field("status", _status_lines(solution)),
            *target_fields,
            Field("targets", _target_lines(solution)),
            *in_section(BUDGET, _budget_field(solution)),
            Field("reference", _reference_lines(solution)),
            Field("a priori", _prior_lines(solution)),
            *in_section(OBSERVABILITY, _estimated_field(solution), Field("fixed", _fixed_lines(solution))),
            *fit_fields(solution),
            Field("observable", observable, section=OBSERVABILITY),
            Field("notes", solution.notes),
        ),
        _details(solution),
    )


def _details(solution: Solution) -> Iterator[Detail]:
    """Yield complete tables, limits of the model and the provenance."""
    rows = [(source_name(item.source), _owner(item), *_sigma_cells(item)) for item in solution.budget]
    heading = ("1 sigma, m", "of", *_SIGMA_HEADING[1:])
    yield Detail(BUDGET, "Every source", (Field("", (), heading, rows),))
    rows = [
        (parameter_name(pair.first), parameter_name(pair.second), f"{pair.coefficient:+.4f}")
        for pair in solution.observability.correlations
    ]
    table = Field("", (), ("parameter", "and", "correlation"), rows)
    yield Detail(OBSERVABILITY, "All large correlations", (table,))
    parameters = solution.parameters
    rows = [(parameter_name(item.name), *item.span_utc) for item in parameters if item.span_utc is not None]
    table = Field("", (), ("parameter", "from (UTC)", "to"), rows)
    yield Detail(OBSERVABILITY, "Parameters of passes and sessions", (table,))
    yield rejected_detail(solution)
    limits = ((text,) for text in solution.limitations)
    table = Field("", (), ("not modelled, or the source of a model",), limits)
    yield Detail(PROVENANCE, "Limits and sources of the model", (table,))
    yield provenance_detail(solution.provenance)


def _owner(item: ErrorSource) -> str:
    """Return the owner of a source of error in words, or a dash."""
    return (parameter_name(item.name) if item.source == A_PRIORI else item.name) or "-"


def _orbit_lines(state: OrbitState) -> Iterator[str]:
    """Yield state, standard deviations and osculating elements of an orbit."""
    (elements, _), (lowest_m, highest_m) = state.elements(), state.apsides_m()
    x, y, z = (f"{value / 1e3:.6f}" for value in state.position_m)
    vx, vy, vz = (f"{value / 1e3:.9f}" for value in state.velocity_m_s)
    yield f"of {state.orbit.name}, Moon-centred ICRF, at {utc_strings(state.epoch, 3)[0]} TDB"
    yield f"position {x}, {y}, {z} km"
    yield f"velocity {vx}, {vy}, {vz} km/s"
    if state.covariance.any():  # zeros of a state that is fixed
        for name, tdb in (("1 sigma", state.epoch), ("1 sigma at the arc's ends", state.orbit.times(2))):
            radial_m, along_m, across_m = np.max(state.sigma_rtn_m(tdb), axis=0)
            yield f"{name} {metres(radial_m)} m radial, {metres(along_m)} m along, {metres(across_m)} m across"
    if state.process is not None:
        yield _process_line(state.process)
    heights = " and higher" if highest_m is None else f" to {highest_m / 1e3:.1f}"
    yield (
        f"semi-major axis {elements['semi_major_axis_m'] / 1e3:.3f} km, eccentricity "
        f"{elements['eccentricity']:.5f}, {elements['inclination_deg']:.3f} deg to the Moon's equator, "
        f"{lowest_m / 1e3:.1f}{heights} km above 1737.4 km"
    )


def _process_line(process: ProcessEstimate) -> str:
    """Return the rms of stochastic accelerations and their a-priori sigmas in words."""
    values = np.concatenate([chain[:-1] for chain in process.values_m_s2])
    rms, sigmas = (
        ", ".join(f"{size:.2g}" for size in sizes)
        for sizes in (np.sqrt((values**2).mean(axis=0)), process.sigma_m_s2)
    )
    correlation = f", correlated over {process.correlation_s:g} s" if process.correlation_s else ""
    return (
        f"stochastic accelerations of {process.effects.interval_s:g} s{correlation}: rms {rms} m/s2 radial, along, "
        f"across; a-priori sigma {sigmas} m/s2"
    )


def _doppler_lines(solution: Solution) -> Iterator[str]:
    """Yield the best and the worst determined direction of a position from Doppler without ranges or delays."""
    kinds = {group.label for group in solution.fit.by_type if group.used}
    determined = solution.position_estimated and solution.position_determined
    if not (determined and kinds and all(kind in KINDS and MEASUREMENTS[kind].integrated for kind in kinds)):
        return
    variances, axes = np.linalg.eigh(solution.position_covariance())
    best, *_, worst = (
        f"{metres(math.sqrt(max(variance, 0.0)))} m {_direction(axis)}"
        for variance, axis in zip(variances.tolist(), axes.T, strict=True)
    )
    yield (
        f"Doppler alone, without a range or a delay: the 1 sigma of the position is smallest, {best}, and largest, "
        f"{worst}"
    )


def _direction(axis_enu: Floats) -> str:
    """Return azimuth and elevation, in words, of a direction or its opposite, whichever points up."""
    east, north, up = axis_enu * (1.0 if axis_enu[2] >= 0.0 else -1.0)
    azimuth_deg = math.degrees(math.atan2(east, north)) % 360.0
    up_deg = math.degrees(math.asin(min(up, 1.0)))
    if up_deg > 80.0:
        return "in height"
    return f"towards azimuth {azimuth_deg:.0f} deg" + (f", {up_deg:.0f} deg up" if up_deg >= 0.5 else "")


def sigma_levels(solutions: Iterable[Solution]) -> Iterable[str]:
    """Return sentences on the level of the sigmas of the observability, if it is not that of the position."""
    lines = []
    for solution in solutions:
        if not (solution.observability.common or solution.observability.weak):
            continue
        if solution.series_weights:
            lines.append("these sigmas are those of the weights, with the time correlation")
        elif solution.noise_scale > 1.0 or solution.time_correlation is not None:
            lines.append("these sigmas are formal, without size and time correlation of the residuals")
    return dict.fromkeys(lines)


def _status_lines(solution: Solution) -> Iterator[str]:
    """Yield the end of the fit, the reason why it is not usable, and findings that move the position."""
    if not solution.parameters.free.any():
        place = "at the given position" if solution.trajectory is None else "along the given trajectory"
        yield f"NO FIT: observed minus computed {place}"
        return
    state = "CONVERGED" if solution.converged else solution.status.upper()
    iterations = plural(solution.iterations, "iteration")
    yield f"{state} ({iterations}, {plural(solution.fit_count, 'fit')})"
    findings = finding_lines(solution, serious=True)
    if not solution.converged:
        yield from findings
    if solution.message:
        yield solution.message
    yield from findings
    if below := [*select_findings(solution, serious=False)]:
        remainder = f" and {len(below) - 1} more" if len(below) > 1 else ""
        yield f"see misfit, below: {below[0].cause}{remainder}"


def _position_lines(solution: Solution) -> Iterator[str]:
    """Yield selenographic and Cartesian coordinates."""
    longitude_deg, latitude_deg, height_m = solution.selenographic
    yield f"{solution.me_frame}  {longitude_deg:.8f} deg E, {latitude_deg:+.8f} deg N, height {height_m:.3f} m"
    vectors = {solution.me_frame: solution.position_me_m, solution.pa_frame: solution.position_pa_m}
    for frame, (x, y, z) in vectors.items():
        yield f"{frame}  x {x:.3f}  y {y:.3f}  z {z:.3f} m"
    if not solution.position_estimated:
        yield "fixed at its a-priori value"


def _sigma_field(solution: Solution) -> Field:
    """Return formal, scaled and total standard deviations, and the error ellipse."""
    if not solution.position_estimated:
        return Field("sigma", ("none: the position was not estimated",))
    levels: dict[str, Level] = {"formal": "formal"}
    if solution.time_correlation is not None:
        levels["scaled: time correlation"] = "scaled"
    elif solution.noise_scale > 1.0:
        levels[f"scaled: noise times {solution.noise_scale:.3g}"] = "scaled"
    errors = ["considered errors"] * bool(solution.consider.parameters)
    errors += ["ephemeris error"] * bool(solution.ephemeris_sigma_enu_m.any())
    if errors:
        levels[f"total: {', '.join(errors)}"] = "total"
    sigmas_m = {name: solution.sigma_enu_m(level) for name, level in levels.items()}
    rows = [
        (name, *map(metres, sigma_m), metres(float(np.linalg.norm(sigma_m))))
        for name, sigma_m in sigmas_m.items()
    ]
    ellipse = solution.ellipse()
    return Field("sigma", () if ellipse is None else (ellipse_text(ellipse),), _SIGMA_HEADING, rows)


def _target_lines(solution: Solution) -> Iterator[str]:
    for target in solution.targets:
        located = solution.of_target(target.name)
        longitude_deg, latitude_deg, height_m = located.selenographic
        yield (
            f"{target.name}: {longitude_deg:.8f} deg E, {latitude_deg:+.8f} deg N, {height_m:.3f} m; "
            f"1 sigma east, north, up {' '.join(map(metres, located.sigma_enu_m()))} m"
        )


def _budget_field(solution: Solution) -> Field:
    """Return the sources of the position error, and the most effective improvement."""
    if not solution.position_estimated:
        return Field("budget")
    if not solution.position_determined:
        return Field("budget", ("the position is not determined",))
    items, rows, small = solution.budget, list[tuple[str, ...]](), list[ErrorSource]()
    total_m2 = sum(item.total_m**2 for item in items)
    for item in sum_by_source(items):
        if len(rows) < _MAX_ROWS and item.total_m**2 > _MIN_VARIANCE_FRACTION * total_m2:
            rows.append((source_name(item.source), *_sigma_cells(item)))
        else:
            small.append(replace(item, source="others"))
    rows += [("others", *_sigma_cells(item)) for item in sum_by_source(small)]
    advice = (*_advice_lines(items), *_range_bias_lines(solution)) if solution.converged else ()
    return Field("budget", (), _SIGMA_HEADING, rows, advice)


def _range_bias_lines(solution: Solution) -> Iterator[str]:
    """Yield the shift of the position by a metre of bias of all ranges, if no bias is estimated."""
    estimated = any(solution.parameters.free[k] for k in solution.parameters.of_kind("range_bias"))
    consider, columns = solution.consider, list(solution.consider.parameters.of_kind("range_bias"))
    if estimated or not columns:
        return
    shifts_m = solution.enu_partials @ consider.sensitivity[:, columns]  # by one sigma of each bias
    shift_m = float(np.linalg.norm(shifts_m @ (1.0 / consider.parameters.prior_sigmas[columns])))
    stations = {owner(consider.parameters.parameters[k]) for k in columns}
    common = " common to all stations" if len(stations) > 1 else ""
    yield f"1 m of range bias{common} moves the position by {metres(shift_m)} m"


def _sigma_cells(item: ErrorSource) -> tuple[str, ...]:
    return tuple(map(metres, (*item.sigma_m.tolist(), item.total_m)))


def _advice_lines(items: Sequence[ErrorSource]) -> Iterator[str]:
    """Yield the largest errors of stations and parameters, and the measure that reduces the sigma most."""
    if not items:
        return
    if named := [item for item in items if item.name][:_MAX_NAMED_SOURCES]:
        sizes = (f"{error_name(item)} {metres(item.total_m)} m" for item in named)
        yield f"largest: {'; '.join(sizes)}"
    measures = {source: measure for measure, sources in _MEASURES.items() for source in sources}
    groups: dict[str, list[ErrorSource]] = {}
    for item in items:
        groups.setdefault(measures.get(item.source, source_name(item.source)), []).append(item)
    sizes_m2 = {measure: sum(item.total_m**2 for item in group) for measure, group in groups.items()}
    if len(sizes_m2) == 1:  # nothing would remain
        return
    measure = max(sizes_m2, key=lambda name: sizes_m2[name])
    names = list(dict.fromkeys(_owner(item) for item in groups[measure] if item.name))
    first = f", {'first ' * (len(names) > 1)}of {names[0]}" if names else ""
    total_m2 = sum(sizes_m2.values())
    without_m = math.sqrt(max(0.0, total_m2 - sizes_m2[measure]))
    yield (
        f"improve first: {measure}{first}; without this error {metres(without_m)} m in place of "
        f"{metres(math.sqrt(total_m2))} m"
    )


def _reference_lines(solution: Solution) -> Iterator[str]:
    for reference in solution.all_references:
        line = (
            f"solution - {reference.name}: east {metres(reference.east_m)}, north {metres(reference.north_m)}, "
            f"up {metres(reference.up_m)} m; {metres(reference.horizontal_m)} m horizontal, "
            f"{metres(reference.distance_m)} m in space"
        )
        if reference.combined_sigmas is not None:
            line += f"; {reference.combined_sigmas:.2f} sigmas (95 % are below 2.80)"
        yield line


def _prior_lines(solution: Solution) -> Iterator[str]:
    """Yield the a-priori values of the position's parameters with the distance of the estimate."""
    for item, value in zip(solution.parameters, solution.values, strict=True):
        if item.kind != "position" or item.fixed or not math.isfinite(item.prior_sigma):
            continue
        change_m = float(value) - item.prior_value
        yield (
            f"{parameter_name(item.name)} {item.prior_value:.6g} {item.unit}, sigma {metres(item.prior_sigma)} "
            f"{item.unit}; the estimate is {signed_metres(change_m)} {item.unit} from it, "
            f"{abs(change_m) / item.prior_sigma:.2f} a-priori sigmas"
        )


def _parameter_indices(solution: Solution, *, free: bool) -> list[int]:
    """Return the indices of the free or of the fixed parameters that are not those of the position."""
    involved = (solution.position_partials != 0.0).any(axis=0)
    return [
        k
        for k, item in enumerate(solution.parameters)
        if item.kind != "position"
        and not involved[k]
        and item.fixed != free
        and item.role is not Role.CONSIDERED
    ]


def _fixed_lines(solution: Solution) -> Iterator[str]:
    items = [solution.parameters.parameters[k] for k in _parameter_indices(solution, free=False)]
    values = [f"{parameter_name(item.name)} {item.prior_value:.6g} {item.unit}" for item in items]
    if values:
        yield ", ".join(first_lines(values, _MAX_PARAMETERS))


def _estimated_field(solution: Solution) -> Field:
    """Return the estimated parameters beside the position."""
    sigmas, formal, rows, notes = solution.sigmas(), solution.sigmas("formal"), [], []
    for k in _parameter_indices(solution, free=True):
        item = solution.parameters.parameters[k]
        prior = (
            "free" if math.isinf(item.prior_sigma) else f"{item.prior_value:.4g} +- {item.prior_sigma:.4g}"
        )
        value = value_text(solution.values[k], formal[k])
        rows.append((parameter_name(item.name), item.unit, value, sigma_text(sigmas[k]), prior))
        if sigmas[k] > _MIN_EXCESS_RATIO * item.prior_sigma:
            notes.append(
                f"sigma of {parameter_name(item.name)} above the a-priori one: formal {sigma_text(formal[k])}; errors "
                "that the weights neglect, such as those of the gravity field, move its value"
            )
    heading = ("parameter", "unit", "value", "sigma", "a priori")
    return table("estimated", heading, rows, _MAX_PARAMETERS, notes)
