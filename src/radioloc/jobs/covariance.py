"""What tracking would tell of a position, before there is any: covariance analysis without trials.

The observations are those of a study's ``[simulation]`` schedule with the noise that it states, or the epochs of its
data with their stated sigmas. They are weighed by the inverse of their covariance, so that the estimate has the least
variance (Aitken 1935), and so are considered parameters by their a-priori sigmas. No value of an observation is needed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from radioloc.boundary import bare_arguments
from radioloc.dynamics import AdjustableOrbit
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import InputError
from radioloc.estimation.consider import (
    ConsideredErrors,
    ErrorSource,
    error_budget,
    owner,
    prior_effects,
    sensitivity,
)
from radioloc.estimation.least_squares import FitResult, FitStatus
from radioloc.estimation.linearization import Linearization, covariance_of, factorize
from radioloc.estimation.observability import assess_observability
from radioloc.jobs.notes import notes_of_plan
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.preparation import model_of, planned_arc, prepared_arc
from radioloc.jobs.problem import (
    ConsideredParameters,
    fitted_orbit,
    problem_of,
    require_position_or_orbit,
    status_of,
)
from radioloc.jobs.selection import ArcPart, arc_lengths, arc_parts
from radioloc.jobs.station_noise import stated_noise
from radioloc.jobs.stochastic import IndependentAccelerations, StochasticProblem
from radioloc.jobs.study_targets import apriori_points
from radioloc.labels import USED
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.link import Link
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import KINDS
from radioloc.noise import ObservationCovariance
from radioloc.parameters.parameter import ParameterSet, Role
from radioloc.results.covariance import CovarianceStudy, Gain, PlannedArc, Share
from radioloc.simulation import Scenario, Session
from radioloc.simulation.schedule import Pair
from radioloc.simulation.simulate import rot_pa_to_enu
from radioloc.study.orbiter import Orbiter
from radioloc.study.study import Study
from radioloc.study.study_file import as_study
from radioloc.study.weights import rows_by_station
from radioloc.targets.design import ObservationModel, orbit_of
from radioloc.targets.orbit_state import (
    ALONG_ACROSS_RADIAL,
    EAST_NORTH_UP,
    LOCAL_LEVEL,
    OrbitState,
    turned,
)
from radioloc.time import Epochs, tt_to_tdb, utc_to_tt
from radioloc.vectors import rtn_axes

_Floats = NDArray[np.float64]
_Mask = NDArray[np.bool_]

HOURS = (0.5, 1.0, 2.0, 3.0, 6.0, 12.0, 24.0, 48.0)
"""Lengths that are shown where none are asked for, as far as the plan goes; then days, doubled."""
_TO_H = 1.0 / 12.0  # When a radius is reached is found to five minutes
_MAPPED_S, _FEWEST_EPOCHS = 600.0, 13
"""Epochs of an orbit over which covariances are averaged: a dozen in a revolution at least."""


@bare_arguments
@on_one_blas_thread()
def covariance(
    study: Study | str | Path,
    hours: Iterable[float] | float | None = None,
    *,
    reach_m: float | None = None,
) -> CovarianceStudy:
    """Find how well the tracking of a study would tell a position, in seconds and without trials.

    Parameters
    ----------
    study : Study or path-like
        With a simulation, whose schedule and noise are taken, or with files, whose epochs and stated sigmas are.
    hours : iterable of float, optional
        Lengths from the start, h; up to the end of the plan, doubled again and again, where not given.
    reach_m : float, optional
        A 95 % radius: find after how many hours it is reached, m.

    Returns
    -------
    CovarianceStudy
        Sigmas and their budget by length, what each type and station tells, and what better knowledge and, of a
        schedule, other stations would buy: those of ``[covariance] candidates``, or else of the catalogue,
        antennas of the same network and telescopes of the same country only.

    Raises
    ------
    RadiolocError
        The study is not of one position or orbit that is estimated, or it cannot be simulated.

    Notes
    -----
    Of an orbit the sigmas are along, across and radial, root mean squares over the arc that is tracked, and its forces
    are those of the fit; ``state`` of each length says more.

    Examples
    --------
    >>> import radioloc
    >>> found = radioloc.covariance("examples/change5/short_arc.toml", reach_m=1000.0)
    >>> found.determined, found.reach_h
    (True, 0.5)
    """
    study = as_study(study)
    if len(study.targets) > 1:
        raise InputError(
            f"{study.name}: a covariance study is of one position on the Moon, or of an orbit that is estimated"
        )
    require_position_or_orbit(study, "a covariance study")
    if reach_m is not None and not (np.isfinite(reach_m) and reach_m > 0.0):
        raise InputError(f"the 95 % radius to be reached is {reach_m!r} m; give a number above zero")
    plan = _Planned.of(study)
    solved = [_Solved.of(plan, part) for part in plan.parts(hours)]
    arcs = [one.planned for one in solved]
    longest = solved[-1]
    reach_h = None if reach_m is None else _reached_h(plan, arcs, reach_m)
    gains = [*_better_known(longest), *_more_stations(plan, longest)] if arcs[-1].determined else []
    return CovarianceStudy(
        name=study.name,
        arcs=tuple(arcs),
        shares=tuple(_shares(longest)),
        gains=tuple(sorted(gains, key=lambda gain: gain.radius_95_m)),
        reach_m=reach_m,
        reach_h=reach_h,
        notes=(*plan.notes, *longest.not_considered),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Planned:
    """A study's observations without their values, and their noise."""

    study: Study  # its target is where the point truly stands
    longest: Predictor
    noise: ObservationCovariance
    usable: _Mask
    notes: tuple[str, ...]
    orbit: AdjustableOrbit | None = None  # over the whole plan
    errant: AdjustableOrbit | None = None  # with the errors of gravity that are considered

    @classmethod
    def of(cls, study: Study, like: _Planned | None = None) -> _Planned:
        """That of the schedule, or of the files; of the orbit of another plan, if it is `like` that."""
        scenario, notes = study.simulation, []
        orbit, errant = (None, None) if like is None else (like.orbit, like.errant)
        if scenario is None:
            longest, left_out = prepared_arc(study)
            noise = stated_noise(longest, study.observations)
            notes.append(
                "the noise is white and as stated: how long errors last is known from residuals only"
            )
        else:
            target: LunarPosition | Orbiter | None = scenario.place
            if study.orbiter is not None and scenario.flight is not None:
                target = study.orbiter.at(scenario.flight.state)  # the forces are those of the fit
            assert target is not None  # the study has seen to that
            study = replace(study, target=target, reference=None, references=())
            model = model_of(study)
            if study.orbiter is not None and orbit is None:
                assert study.estimate.orbit is not None
                forces = study.estimate.orbit.parameters(study.orbiter.forces)
                orbit = scenario.orbit(model, study.orbiter, forces)
            points = apriori_points(study, model)
            aimed = points[0].position_pa_m if orbit is None else orbit.nearest()
            plan = scenario.schedule.plan(model, aimed, scenario.name)
            longest, left_out, rows = planned_arc(study, plan.observations, model, orbit)
            noise = scenario.noise.covariance(plan).select(rows)
            silent = [kind for kind in longest.observations.types() if kind not in scenario.noise.link]
            notes += [
                f"[simulation.noise.{kind}] is not given: white noise of the sessions' sigma_m"
                for kind in dict.fromkeys(silent)
            ]
            if longest.predicted_eop.any() and study.consider_defaults and "ut1" not in study.consider:
                notes.append(
                    "once this is tracked, Earth orientation will have been measured: "
                    "[consider] ut1_sigma_s = 1e-5 and pole_sigma_rad = 3e-10 say so"
                )
        usable = status_of(longest)[0].are(USED)
        if not usable.all():
            notes.append(f"{int((~usable).sum())} observations cannot be used: too low, or out of sight")
        planned = orbit_of(longest)
        if planned is not None and study.orbiter is not None:
            orbit = orbit or planned
            errant = errant or study.orbiter.disturbed(orbit)
        return cls(study, longest, noise, usable, (*notes, *notes_of_plan(longest, left_out)), orbit, errant)

    def parts(self, hours: Iterable[float] | float | None) -> list[ArcPart]:
        """Parts of some lengths, the shortest first; of lengths that are not asked for those that hold anything."""
        if hours is not None:
            return arc_parts(self.longest, self.study, arc_lengths(hours, self.study.observations))
        span_h = arc_parts(self.longest, self.study, [1e9])[0].span_h
        lengths = [length for length in HOURS if length < 0.98 * span_h]
        while lengths and 2.0 * lengths[-1] < 0.98 * span_h:
            lengths.append(2.0 * lengths[-1])
        found: list[ArcPart] = []
        for length in [*lengths, float(np.ceil(10.0 * span_h - 1e-6) / 10.0)]:
            try:
                part = arc_parts(self.longest, self.study, [length])[0]
            except InputError:  # nothing is seen yet
                continue
            if not found or len(part.rows) > len(found[-1].rows):
                found.append(part)
        return found


@dataclass(frozen=True, slots=True, eq=False)
class _WithProcess:
    """A linearization with the independent accelerations of the process noise as further parameters."""

    design: Linearization
    process: IndependentAccelerations

    @property
    def residual_m(self) -> _Floats:
        """Residuals, m, shape (n,)."""
        return self.design.residual_m

    def partials(self, rows: NDArray[np.intp]) -> _Floats:
        """d(computed)/d(parameter) of some observations, shape (m, p)."""
        return np.hstack([self.design.partials(rows), self.process.effects_m(rows)])


@dataclass(frozen=True, eq=False)
class _Solved:
    """The first hours of a plan, solved with all observations or with some."""

    plan: _Planned
    part: ArcPart
    noise: ObservationCovariance  # of the part
    problem: ObservationModel
    x: _Floats
    used: _Mask
    parameters: ParameterSet  # of the problem, and those of the process noise
    suboptimal: ConsideredErrors | None  # left out of the weights
    not_considered: tuple[str, ...]  # notes
    process: IndependentAccelerations | None = None

    @classmethod
    def of(cls, plan: _Planned, part: ArcPart) -> _Solved:
        """Solve a part of a plan."""
        study, arc = plan.study, part.arc
        considered = ConsideredParameters.of(study, arc, part.estimate)
        problem = problem_of(study, arc, part.estimate, considered.in_weights)
        x = problem.parameters.prior_values
        noise, used = plan.noise.select(part.rows), plan.usable[part.rows]
        chosen = None if part.estimate.orbit is None else part.estimate.orbit.process_noise
        if chosen is None:
            suboptimal = considered.suboptimal_errors(problem, x, plan.errant)
            return cls(plan, part, noise, problem, x, used, problem.parameters, suboptimal, considered.notes)
        # Process noise stands for the errors of the gravity field.
        suboptimal = considered.suboptimal_errors(problem, x, None)
        process = IndependentAccelerations.of(StochasticProblem.about(problem, chosen, x))
        parameters = ParameterSet([*problem.parameters, *process.parameters])
        return cls(plan, part, noise, problem, x, used, parameters, suboptimal, considered.notes, process)

    def among(self, used: _Mask) -> PlannedArc:
        """The same with some of its observations only."""
        return replace(self, used=used & self.used).planned

    def known(self, *names: str) -> PlannedArc:
        """Return the plan with some of its adjusted parameters known without error."""
        items = [replace(item, role=Role.FIXED) if item.name in names else item for item in self.parameters]
        return replace(self, parameters=ParameterSet(items)).planned

    @cached_property
    def fit(self) -> FitResult:
        """The fit without values: what determines what, and how well."""
        parameters, used, process = self.parameters, self.used, self.process
        linearization: Linearization = self.problem.linearize(self.x)
        if process is not None:
            linearization = _WithProcess(linearization, process)
        x = parameters.prior_values
        whitening = self.noise.whitener(used)
        factor = factorize(linearization, whitening, parameters, x)
        if factor is None:
            raise InputError("the partials of the observations are not finite numbers")
        determined = bool(factor.determined.all())
        return FitResult(
            parameters=parameters,
            x=x,
            covariance=covariance_of(factor, parameters),
            linearization=linearization,
            noise=self.noise,
            used=used,
            chi2=0.0,
            dof=0,
            status=FitStatus.CONVERGED if determined else FitStatus.UNOBSERVABLE,
            iterations=0,
            factor=factor,
            whitening=whitening,
        )

    @cached_property
    def planned(self) -> PlannedArc:
        """What it tells."""
        fit, involved = self.fit, (self.problem.position_partials(self.x) != 0.0).any(axis=0)
        if self._maps_states:
            involved[: self.problem.first] = True
        missing: tuple[str, ...] = ()
        sources: tuple[ErrorSource, ...] = ()
        state = None
        if np.isfinite(np.diag(fit.covariance)[: len(involved)][involved]).all():
            sources, state = self._sources()
        else:
            missing = assess_observability(fit).describe()[:1]
        axes = ALONG_ACROSS_RADIAL if self._maps_states else EAST_NORTH_UP
        count = int(fit.used.sum())
        planned = PlannedArc(self.part.hours, self.part.span_h, count, sources, missing, axes, state)
        if state is None:
            return planned
        first_s, last_s = self._epochs[[0, -1]].seconds_since(state.epoch).tolist()
        return replace(planned, tracked_h=(first_s / 3600.0, last_s / 3600.0))

    def _sources(self) -> tuple[tuple[ErrorSource, ...], OrbitState | None]:
        """Return the parts of the covariance, of an orbit as means over the arc: C A C, C P C, considered."""
        fit, parameters = self.fit, self.parameters
        total = np.where(np.isfinite(fit.covariance), fit.covariance, 0.0)
        outside = None if self.suboptimal is None else sensitivity(fit, self.suboptimal)
        state, direct_m = None, np.zeros(1)
        if not self._maps_states:
            position_pa_m = self.problem.position_pa_m(self.x)
            partials = self.problem.position_partials(self.x)
            axes = np.zeros((3, len(parameters)))
            axes[:, : partials.shape[1]] = rot_pa_to_enu(position_pa_m, self.part.arc.model) @ partials
        else:
            whole = total if outside is None else total + outside.covariance
            state = fitted_orbit(self.problem, self.x, whole, outside, self.plan.errant)
            assert state is not None
            by_orbit, by_gravity = (one[:, LOCAL_LEVEL[:3]] for one in state.partials_rtn(self._epochs))
            axes = np.zeros((*by_orbit.shape[:2], len(parameters)))
            mine, by = (
                slice(0, self.problem.first),
                self.problem.targets[0].motion(self.x[: self.problem.first])[1],
            )
            axes[..., mine] = by_orbit @ by
            if self.process is not None:
                count = len(self.problem.parameters)
                turn = rtn_axes(*state.orbit.states(self._epochs))
                axes[..., count:] = turned(turn, self.process.states(self._epochs))[:, LOCAL_LEVEL[:3]]
                chosen = [*range(self.problem.first), *range(count, len(parameters))]
                onto = block_diag(by, np.eye(len(parameters) - count))
                state = replace(
                    state, process=self.process.estimate(onto @ total[np.ix_(chosen, chosen)] @ onto.T)
                )
            if outside is not None:
                direct_m = np.zeros((*by_orbit.shape[:2], len(outside.parameters)))
                direct_m[
                    ..., list(outside.parameters.of_kind("gravity_error"))
                ] = -by_gravity  # it is the truth that they move
        found = error_budget(
            parameters,
            axes,
            axes @ total @ np.swapaxes(axes, -1, -2),
            prior_effects(fit),
            outside,
            np.array(self.part.estimate.ephemeris_sigma_m),
            direct_m,
        )
        return found, state

    @property
    def _maps_states(self) -> bool:
        """Whether states of an orbit are mapped over the arc, and not a position on the ground."""
        return self.problem.of_orbit and not self.plan.study.lands

    @property
    def _epochs(self) -> Epochs:
        """Epochs all over the part of an orbit that is tracked, TDB."""
        ends = tt_to_tdb(utc_to_tt(self.part.arc.observations.span()))
        length_s = float(ends[1].seconds_since(ends[0])[0])
        count = max(_FEWEST_EPOCHS, int(length_s / _MAPPED_S) + 1)
        return ends[:1].shifted(np.linspace(0.0, length_s, count))


def _reached_h(plan: _Planned, arcs: Sequence[PlannedArc], reach_m: float) -> float | None:
    """Length at which a 95 % radius is reached first, h; None where it is not."""
    k = next((k for k, arc in enumerate(arcs) if arc.radius_95_m <= reach_m), None)
    if k is None:
        return None
    low, high = (arcs[k - 1].hours, arcs[k].hours) if k else (0.0, arcs[0].hours)
    while k and high - low > _TO_H:
        middle = 0.5 * (low + high)
        part = arc_parts(plan.longest, plan.study, [middle])[0]
        if _Solved.of(plan, part).planned.radius_95_m <= reach_m:
            high = middle
        else:
            low = middle
    return high


def _shares(solved: _Solved) -> Iterator[Share]:
    """What the observations of each type and of each station tell, alone and by what is lost without them."""
    observations = solved.part.arc.observations
    kinds, catalogue = observations.kind, solved.plan.study.catalogue
    groups = [("type", KINDS[kind], kinds == kind) for kind in np.unique(kinds).tolist()]
    groups += [("station", *item) for item in rows_by_station(observations, catalogue).items()]
    for group, name, mine in groups:
        if mine.all() and group == "type":
            continue
        count = int((mine & solved.fit.used).sum())
        if count:
            alone_m = solved.among(mine).radius_95_m
            yield Share(
                group, name, count, alone_m, solved.among(~mine).radius_95_m if not mine.all() else np.inf
            )


def _better_known(solved: _Solved) -> Iterator[Gain]:
    """Yield the improvement by knowing each considered source, and each estimated kind, without error."""
    arc, parameters = solved.planned, solved.parameters
    in_weights = [item for item in parameters if item.role is Role.CONSIDERED]
    outside = () if solved.suboptimal is None else solved.suboptimal.parameters
    for kind in dict.fromkeys(item.kind for item in (*in_weights, *outside)):
        owners = dict[str, list[str]]()
        for item in in_weights:
            if item.kind == kind:
                owners.setdefault(owner(item), []).append(item.name)
        if owners:
            every = [name for names in owners.values() for name in names]
            yield Gain(
                f"{kind} known{' for all' if len(owners) > 1 else ''}", solved.known(*every).radius_95_m
            )
            for whose, names in owners.items() if len(owners) > 1 else ():
                yield Gain(f"{kind} {whose} known", solved.known(*names).radius_95_m)
        else:
            sources = [source for source in arc.sources if source.source == kind]
            yield Gain(f"{kind} known", arc.without(*sources))
    yield from _estimated_kinds_known(solved)


def _estimated_kinds_known(solved: _Solved) -> Iterator[Gain]:
    """Yield the improvement by knowing each kind of estimated parameters without error."""
    parameters = solved.parameters
    for kind in dict.fromkeys(item.kind for item in parameters if item.role is Role.ESTIMATED):
        names = [item.name for item in parameters if item.kind == kind]
        if kind == "position":
            names = [name for name in names if name.startswith("position.height")]
        if names and kind != "state":
            yield Gain(f"{'height' if kind == 'position' else kind} known", solved.known(*names).radius_95_m)


def _more_stations(plan: _Planned, solved: _Solved) -> Iterator[Gain]:
    """What one station or link more in the schedule's sessions would buy."""
    scenario, catalogue = plan.study.simulation, plan.study.catalogue
    if scenario is None:
        return
    asked = plan.study.candidates
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
    near = [
        s.name
        for s in catalogue
        if s.kind == "llr" or s.complex in networks or (s.kind == "vlbi" and s.country in countries)
    ]
    for name in near if asked is None else asked:
        what, sessions = _with_candidate(name, scenario, catalogue)
        if sessions == list(scenario.schedule.sessions):
            if asked is not None:
                raise InputError(
                    f"[covariance] candidates: {name} adds nothing: it takes part already, or no session is of its kind"
                )
            continue
        larger = replace(scenario, schedule=replace(scenario.schedule, sessions=sessions))
        more = _Planned.of(replace(plan.study, simulation=larger), plan)
        [part] = arc_parts(more.longest, more.study, [solved.part.hours])
        yield Gain(what, _Solved.of(more, part).planned.radius_95_m)


def _with_candidate(name: str, scenario: Scenario, catalogue: StationCatalogue) -> tuple[str, list[Session]]:
    """The sessions with a station, or a link given by its path, added where they are of its kind."""
    sessions = list(scenario.schedule.sessions)
    added: list[tuple[Pair, ...]] = []
    if "<" in name or ">" in name:
        link = Link.from_path(name)
        pair = (catalogue.get(link.stations[0]).name, catalogue.get(link.stations[-1]).name)
        added = [(pair,) if session.baseline == ("<" in name) else () for session in sessions]
        what = f"link {name}"
    else:
        station = catalogue.get(name)
        for session in sessions:
            ends = dict.fromkeys(end for pair in session.pairs for end in pair if end)
            known = {catalogue.get(end).name for end in ends}
            fits = station.kind in {catalogue.get(end).kind for end in ends} and station.name not in known
            added.append(_pairs_with(station.name, session) if fits else ())
        what = f"station {station.name}"
    return what, [
        replace(session, pairs=(*session.pairs, *(pair for pair in more if pair not in session.pairs)))
        for session, more in zip(sessions, added, strict=True)
    ]


def _pairs_with(station: str, session: Session) -> tuple[Pair, ...]:
    """Pairs of one station more, of the kinds that a session has: by itself, with senders, with receivers."""
    senders = dict.fromkeys(first for first, _ in session.pairs)
    receivers = dict.fromkeys(second for _, second in session.pairs)
    if session.baseline:
        return tuple((other, station) for other in {**senders, **receivers})
    itself = any(first == second for first, second in session.pairs)
    pairs = [(station, station)] if itself else []
    if any(first != second for first, second in session.pairs):
        pairs += [(sender, station) for sender in senders]
        if len(senders) > 1:
            pairs += [(station, receiver) for receiver in receivers]
    return tuple(pairs)
