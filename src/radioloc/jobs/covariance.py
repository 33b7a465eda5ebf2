"""Covariance analysis of planned tracking: the accuracy of a position or an orbit without values and without trials.

The observations are those of a study's ``[simulation]`` schedule with the noise that it states, or the epochs of its
data with their stated sigmas.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from radioloc.dynamics import AdjustableOrbit
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError
from radioloc.estimation.consider import owner
from radioloc.jobs.error_columns import GravityErrorOrbits
from radioloc.jobs.notes import planning_notes
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.planned_fit import PlannedFit
from radioloc.jobs.preparation import build_model, planned_arc, prepared_arc, usability
from radioloc.jobs.problem import ArcPart, EstimationProblem, arc_parts, require_position_or_orbit
from radioloc.jobs.selection import arc_lengths
from radioloc.jobs.simulate import antenna_targets, planned_orbits, with_true_positions
from radioloc.labels import USED
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import KINDS
from radioloc.noise import ObservationCovariance
from radioloc.parameters.parameter import Role
from radioloc.quantities import FloatLike, accepts_quantities
from radioloc.results.covariance import Contribution, CovarianceStudy, Improvement, PlannedArc
from radioloc.simulation import Scenario, Session
from radioloc.simulation.schedule import Pair
from radioloc.simulation.visibility import horizon_notes
from radioloc.study.observation_choice import rows_by_station
from radioloc.study.study import Study
from radioloc.study.study_file import as_study
from radioloc.vectors import Mask

HOURS = (0.5, 1.0, 2.0, 3.0, 6.0, 12.0, 24.0, 48.0)
"""Default lengths, as far as the plan extends; then days, doubled."""
_REACH_TOLERANCE_H = 1.0 / 12.0  # of the length at which a radius is reached


@accepts_quantities
@on_one_blas_thread()
def covariance(
    study: Study | str | Path,
    hours: Iterable[FloatLike] | FloatLike | None = None,
    observations: Observations | None = None,
    *,
    reach_m: FloatLike | None = None,
) -> CovarianceStudy:
    """Predict how well the tracking of a study determines its targets, in seconds and without trials.

    Parameters
    ----------
    study : Study or path-like
        Study with a simulation that states schedule and noise, or with files that give epochs and sigmas.
    hours : iterable of float, optional
        Lengths of the tracking from its start, h; by default each is twice the one before, up to the whole plan.
    observations : Observations, optional
        Observations in place of the study's files; their values are not used.
    reach_m : float, optional
        Radius of 95 %, m; the result states after how many hours the plan reaches it.

    Returns
    -------
    CovarianceStudy
        Sigmas and error budget for each length, contributions of each type and station, and improvements if an error
        is removed or, in a schedule, a station added. Stations are those of ``[covariance] candidates``, by default
        antennas of the same networks and telescopes of the same countries. ``others`` has further targets.

    Raises
    ------
    RadiolocError
        No position or orbit is estimated, or the study cannot be simulated.

    Notes
    -----
    The sigmas of an orbit are along, across and radial, root mean squares over the tracked arc, with the forces of the
    fit; ``state`` of each length has the state at the epoch.

    Examples
    --------
    >>> import radioloc
    >>> plan = radioloc.covariance("examples/change5/short_arc.toml", reach_m=1000.0)
    >>> plan.determined, plan.reach_h
    (True, 0.5)
    """
    study = as_study(study)
    require_position_or_orbit(study, "a covariance study")
    if reach_m is not None and not (np.isfinite(reach_m) and reach_m > 0.0):
        raise InputError(f"the 95 % radius to be reached is {reach_m!r} m; give a number above zero")
    plan = _Plan.from_study(study, observations)
    fits = [plan.fit(part) for part in plan.parts(hours)]
    indices = fits[-1].part.problem.model.estimated_indices
    first, *further = (_study_of_target(plan, fits, k, reach_m) for k in indices)
    return replace(first, others=tuple(further))


def _study_of_target(
    plan: _Plan, fits: Sequence[PlannedFit], target: int, reach_m: float | None
) -> CovarianceStudy:
    arcs, longest = [fit.planned(target) for fit in fits], fits[-1]
    improvements: list[Improvement] = []
    if arcs[-1].determined:
        improvements = [*_better_known(longest, target), *_more_stations(plan, longest, target)]
    model = longest.part.problem.model
    several = f", {model.targets[target].name}" if len(model.targets) > 1 else ""
    return CovarianceStudy(
        name=f"{plan.study.name}{several}",
        arcs=tuple(arcs),
        contributions=tuple(_contributions(longest, target)),
        improvements=tuple(sorted(improvements, key=lambda item: item.radius_95_m)),
        reach_m=reach_m,
        reach_h=None if reach_m is None else _reach_h(plan, arcs, reach_m, target),
        notes=(*plan.notes, *longest.part.problem.notes),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    """A study's observations without their values, and their noise."""

    study: Study  # its target is at the true position
    problem: EstimationProblem  # of all observations
    usable: Mask
    notes: tuple[str, ...]
    orbits: Mapping[str, AdjustableOrbit] = field(default_factory=dict)  # over the whole plan, by target
    with_gravity_errors: GravityErrorOrbits = field(default_factory=dict)

    @classmethod
    def from_study(
        cls, study: Study, observations: Observations | None = None, like: _Plan | None = None
    ) -> _Plan:
        """Return the plan of a schedule or of files; `like` has the orbits of another plan."""
        orbits = {} if like is None else like.orbits
        if study.simulation is None or observations is not None:
            predictor, left_out = prepared_arc(study, observations)
            noise = None
            notes = [
                "the noise is taken as white with the stated sigmas; its time correlation follows from residuals only"
            ]
        else:
            study, predictor, left_out, noise, notes = _scheduled(study, study.simulation, orbits)
        problem = EstimationProblem.from_study(study, predictor, study.estimate, noise)
        usable = usability(predictor)[0].are(USED)
        if not usable.all():
            notes.append(f"{int((~usable).sum())} observations cannot be used: too low, or out of sight")
        if not orbits:
            orbits = {one.name: one.orbit for one in problem.model.targets if one.orbit is not None}
        errors = (
            problem.orbits_with_gravity_errors(problem.model.parameters.prior_values)
            if like is None
            else like.with_gravity_errors
        )
        unadjusted = [item for _, items in problem.unadjusted_blocks for item in items]
        notes += planning_notes(predictor, left_out, [*problem.model.parameters, *unadjusted])
        return cls(study, problem, usable, tuple(notes), orbits, errors)

    def fit(self, part: ArcPart) -> PlannedFit:
        """Return the fit of a part without values."""
        return PlannedFit.from_arc(part, self.usable, self.with_gravity_errors)

    def parts(self, hours: Iterable[FloatLike] | FloatLike | None) -> list[ArcPart]:
        """Return parts of some lengths, the shortest first; of default lengths those that add observations."""
        if hours is not None:
            return arc_parts(self.problem, arc_lengths(hours, self.study.observations))
        span_h = arc_parts(self.problem, [1e9])[0].span_h
        lengths = [length for length in HOURS if length < 0.98 * span_h]
        while lengths and 2.0 * lengths[-1] < 0.98 * span_h:
            lengths.append(2.0 * lengths[-1])
        parts: list[ArcPart] = []
        for length in [*lengths, float(np.ceil(10.0 * span_h - 1e-6) / 10.0)]:
            try:
                part = arc_parts(self.problem, [length])[0]
            except InputError:  # nothing is seen yet
                continue
            if not parts or len(part.rows) > len(parts[-1].rows):
                parts.append(part)
        return parts


def _scheduled(
    study: Study, scenario: Scenario, orbits: Mapping[str, AdjustableOrbit]
) -> tuple[Study, Predictor, dict[str, int], ObservationCovariance, list[str]]:
    """Return the study at the true position, its arc by the schedule, and the noise that the schedule states."""
    study = with_true_positions(study, scenario)
    model = build_model(study)
    orbits = orbits or planned_orbits(study, scenario, model)
    plan = scenario.schedule.plan(model, antenna_targets(study, scenario, model, orbits))
    predictor, left_out, rows = planned_arc(study, plan.observations, model, orbits)
    notes = [
        f"[simulation.noise.{kind}] is not given: white noise of the sessions' sigma_m"
        for kind in scenario.noise.unstated(predictor.observations)
    ]
    notes += study.catalogue.antenna_notes(predictor.stations)
    points = [motion.position_pa_m for motion in predictor.motions if motion.trajectory is None]
    notes += horizon_notes(scenario.schedule.masks, points)
    if predictor.predicted_eop.any() and study.consider_defaults and "ut1" not in study.consider:
        notes.append(
            "once this is tracked, Earth orientation will have been measured: "
            "state [consider] ut1_sigma_s = 1e-5 and pole_sigma_rad = 3e-10"
        )
    return study, predictor, left_out, scenario.noise.covariance(plan).select(rows), notes


def _reach_h(plan: _Plan, arcs: Sequence[PlannedArc], reach_m: float, target: int) -> float | None:
    """Return the length at which a 95 % radius is reached first, h; None where it is not."""
    k = next((k for k, arc in enumerate(arcs) if arc.radius_95_m <= reach_m), None)
    if k is None:
        return None
    low, high = (arcs[k - 1].hours, arcs[k].hours) if k else (0.0, arcs[0].hours)
    while k and high - low > _REACH_TOLERANCE_H:
        middle = 0.5 * (low + high)
        [part] = arc_parts(plan.problem, [middle])
        if plan.fit(part).planned(target).radius_95_m <= reach_m:
            high = middle
        else:
            low = middle
    return high


def _contributions(fit: PlannedFit, target: int) -> Iterator[Contribution]:
    """Yield the accuracy by the observations of each type and station alone, and without them."""
    problem = fit.part.problem
    kinds = problem.predictor.observations.kind
    groups = [("type", KINDS[kind], kinds == kind) for kind in np.unique(kinds).tolist()]
    stations = rows_by_station(problem.predictor.observations, problem.study.catalogue)
    groups += [("station", *item) for item in stations.items()]
    for group, name, rows in groups:
        count = int((rows & fit.used).sum())
        if not count or (rows.all() and group == "type"):
            continue
        alone_m = fit.with_observations(rows).planned(target).radius_95_m
        without_m = np.inf if rows.all() else fit.with_observations(~rows).planned(target).radius_95_m
        yield Contribution(group, name, count, alone_m, without_m)


def _better_known(fit: PlannedFit, target: int) -> Iterator[Improvement]:
    """Yield the improvement by knowing each considered source, and each estimated kind, without error."""

    def without_error(subject: str, names: Sequence[str]) -> Improvement:
        return Improvement(f"{subject} known", fit.with_fixed(*names).planned(target).radius_95_m)

    arc, parameters = fit.planned(target), fit.parameters
    in_weights = [item for item in parameters if item.role is Role.CONSIDERED]
    for kind in dict.fromkeys(item.kind for item in (*in_weights, *fit.unadjusted_errors.parameters)):
        owners = dict[str, list[str]]()
        for item in in_weights:
            if item.kind == kind:
                owners.setdefault(owner(item), []).append(item.name)
        if not owners:
            sources = [source for source in arc.sources if source.source == kind]
            yield Improvement(f"{kind} known", arc.radius_95_without_m(*sources))
            continue
        improvement = without_error(kind, [name for names in owners.values() for name in names])
        yield improvement if len(owners) == 1 else replace(improvement, change=f"{kind} known for all")
        for owner_name, names in owners.items() if len(owners) > 1 else ():
            yield without_error(f"{kind} {owner_name}", names)
    for kind in dict.fromkeys(item.kind for item in parameters if item.role is Role.ESTIMATED):
        names = [item.name for item in parameters if item.kind == kind]
        if kind == "position":
            names = [name for name in names if name.startswith("position.height")]
        if names and kind != "state":
            yield without_error("height" if kind == "position" else kind, names)


def _more_stations(plan: _Plan, fit: PlannedFit, target: int) -> Iterator[Improvement]:
    """Yield the improvement by each further station or link in the schedule's sessions."""
    scenario, catalogue = plan.study.simulation, plan.study.catalogue
    if scenario is None:
        return
    candidates = plan.study.candidates
    taking_part = [
        catalogue.get(end)
        for session in scenario.schedule.sessions
        for pair in session.pairs
        for end in pair
        if end
    ]
    networks = {"", *(s.complex for s in taking_part)}
    countries = {s.country for s in taking_part} - {""}
    # Antennas are asked for within their network only, telescopes also in their country: who has a time on one rarely
    # gets it on all.
    names = [
        s.name
        for s in catalogue
        if s.kind == "llr" or s.complex in networks or (s.kind == "vlbi" and s.country in countries)
    ]
    if candidates is not None:
        members = [
            (name,) if "<" in name or ">" in name else [s.name for s in catalogue.members(name)]
            for name in candidates
        ]
        names = [name for group in members for name in group]
    for name in names:
        change, sessions = _with_candidate(name, scenario, catalogue)
        if sessions == list(scenario.schedule.sessions):
            if candidates is not None and name in candidates:
                raise InputError(
                    f"[covariance] candidates: {name} adds nothing: it takes part already, or no session is of its kind"
                )
            continue
        larger = replace(scenario, schedule=replace(scenario.schedule, sessions=sessions))
        larger_plan = _Plan.from_study(replace(plan.study, simulation=larger), like=plan)
        [part] = arc_parts(larger_plan.problem, [fit.part.hours])
        yield Improvement(change, larger_plan.fit(part).planned(target).radius_95_m)


def _with_candidate(name: str, scenario: Scenario, catalogue: StationCatalogue) -> tuple[str, list[Session]]:
    """Add a station, or a link given by its path, to the sessions of its kind."""
    sessions = list(scenario.schedule.sessions)
    added: list[tuple[Pair, ...]] = []
    if "<" in name or ">" in name:
        link = Link.from_path(name)
        pair = (catalogue.get(link.stations[0]).name, catalogue.get(link.stations[-1]).name)
        added = [(pair,) if session.baseline == ("<" in name) else () for session in sessions]
        change = f"link {name}"
    else:
        station = catalogue.get(name)
        for session in sessions:
            ends = dict.fromkeys(end for pair in session.pairs for end in pair if end)
            present = {catalogue.get(end).name for end in ends}
            fits = station.kind in {catalogue.get(end).kind for end in ends} and station.name not in present
            added.append(_pairs_with(station.name, session) if fits else ())
        change = f"station {station.name}"
    return change, [
        replace(session, pairs=(*session.pairs, *(pair for pair in added_pairs if pair not in session.pairs)))
        for session, added_pairs in zip(sessions, added, strict=True)
    ]


def _pairs_with(station: str, session: Session) -> tuple[Pair, ...]:
    """Pairs of one station more, of the kinds that a session has: by itself, with senders, with receivers."""
    senders = dict.fromkeys(first for first, _ in session.pairs)
    receivers = dict.fromkeys(second for _, second in session.pairs)
    if session.baseline:
        return tuple((partner, station) for partner in {**senders, **receivers})
    itself = any(first == second for first, second in session.pairs)
    pairs = [(station, station)] if itself else []
    if any(first != second for first, second in session.pairs):
        pairs += [(sender, station) for sender in senders]
        if len(senders) > 1:
            pairs += [(station, receiver) for receiver in receivers]
    return tuple(pairs)
