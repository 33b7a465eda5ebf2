"""Starts for the fit of an orbit: in one arc, in several, and of one that ends on the ground.

Hundreds of metres of the a-priori state are hundreds of kilometres after some days, far outside of what is linear. So
growing parts of an arc are fitted, each from where the one before ended: within two hours of the epoch they are not;
what these settle is good for six, and so on to the whole arc. Further arcs begin where the one before ends.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics import AdjustableOrbit
from radioloc.dynamics.arcs import AnyOrbit, OrbitArcs, arcs_of
from radioloc.errors import InputError
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.parameters.design import ObservationModel
from radioloc.parameters.orbit import orbit_parameters
from radioloc.studies.manoeuvres import Manoeuvre, unnamed_manoeuvre
from radioloc.studies.orbit_choice import EMPIRICAL_NAME, OrbitChoice
from radioloc.studies.orbit_steps import fitted_state
from radioloc.time import Epochs, tt_to_tdb, utc_strings, utc_to_tt

logger = logging.getLogger(__name__)

Floats = NDArray[np.float64]

_FIRST_S = 7200.0
_FEWEST = 30
_WEAK_M, _WEAK_M_S = 2e3, 2.0
"""How far a state without a-priori sigmas goes in one step: what a short part does not tell stays where it is."""
_FREE = 1e6
"""Scales of a parameter that stand for no a-priori sigma."""
_INVERSIONS = 8
"""Newton's steps from a state to its elements."""
_LIGHT_S = 3.0
"""Light does not take longer from the Moon."""
_REACH = 0.25
"""Part of an arc by which its end may move to a gap between observations."""
_FEWEST_OF_ARC = 20
_BEYOND_S = 60.0
"""What an arc has beyond its borders, for events of observations near them."""
_LATER_STEPS = 2


def near_orbit(
    problem: ObservationModel, sigma_m: Floats, usable: NDArray[np.bool_], seek: bool = False
) -> tuple[Floats | None, list[Manoeuvre]]:
    """Parameters of an arc's problem that are near the estimate; ``None`` where the target is no orbit to be fitted.

    If one is to `seek` them, with manoeuvres that residuals show; then what is beyond them is not looked at.
    """
    parameters, orbit = problem.parameters, problem.predictor.trajectory
    if isinstance(orbit, OrbitArcs):
        return _with_orbit(problem, orbit.start), []
    count = len(parameters.of_kind("state")) + len(parameters.of_kind("force"))
    free = np.flatnonzero(parameters.free[:count])
    if not isinstance(orbit, AdjustableOrbit) or not len(free) or not usable.any():
        return None, []
    arc = problem.predictor.along(orbit.coarse())
    tdb = tt_to_tdb(utc_to_tt(arc.observations.epoch))
    away_s = np.abs(tdb.seconds_since(orbit.epoch))
    apriori = np.array(list(orbit.values.values()))
    sigmas = _cartesian_sigmas(problem, count)[free]
    x, found = apriori.copy(), list[Manoeuvre]()
    reach_s = max(_FIRST_S, float(np.sort(away_s[usable])[min(_FEWEST, int(usable.sum())) - 1]))
    while True:
        rows = np.flatnonzero(usable & (away_s <= reach_s))
        part, before = arc.select(rows), x
        x, spread = fitted_state(part, sigma_m[rows], before, apriori, free, sigmas)
        logger.info(
            "orbit within %.1f h of the epoch: %d observations, robust misfit %.3g sigmas",
            reach_s / 3600.0,
            len(rows),
            spread,
        )

        def starts(
            rows: NDArray[np.intp] = rows, first: Floats = x, before: Floats = before
        ) -> Iterator[Floats]:
            """Of which the later ones may fit on the epoch's side of a manoeuvre."""
            yield from (first, before)
            for fraction in (2, 4):
                near = rows[np.argsort(away_s[rows])[: max(_FEWEST, len(rows) // fraction)]]
                yield fitted_state(arc.select(near), sigma_m[near], before, apriori, free, sigmas)[0]

        manoeuvre = unnamed_manoeuvre(part, sigma_m[rows], starts(), apriori, free, sigmas) if seek else None
        if manoeuvre is not None:
            found.append(manoeuvre)
            x, usable = manoeuvre.x, usable & ~manoeuvre.hides(arc.observations)
        elif reach_s >= away_s[usable].max():
            break
        else:
            reach_s *= 3.0
    return _with_orbit(problem, x - apriori), found


def _with_orbit(problem: ObservationModel, changes: Floats) -> Floats:
    """A-priori values of all parameters, but for the orbit those that change it so."""
    start, mine = problem.parameters.prior_values.copy(), slice(len(changes))
    for _ in range(_INVERSIONS):
        made, by = problem.positions[0](start[mine])
        start[mine] += np.linalg.solve(by, changes - made)
    return start


def _cartesian_sigmas(problem: ObservationModel, count: int) -> Floats:
    """How far one step of the state and of the forces may go, by what is known a priori."""
    parameters = problem.parameters
    known = np.minimum(parameters.prior_sigmas, _FREE * parameters.scales)[:count]
    by = problem.positions[0](parameters.prior_values[:count])[1]
    most = np.concatenate([[_WEAK_M] * 3, [_WEAK_M_S] * 3, np.full(count - 6, math.inf)])
    most[[one.unit == "m/s" for one in parameters.parameters[:count]]] = _WEAK_M_S
    return np.minimum(np.sqrt(by**2 @ known**2), most)


def orbit_arcs(
    whole: AdjustableOrbit,
    hours: float,
    choice: OrbitChoice,
    model: PhysicalModel,
    observations: Observations,
) -> AnyOrbit:
    """An orbit in arcs of some hours, each fitted from where the one before ends; the orbit itself where it is one arc.

    Parameters
    ----------
    whole : AdjustableOrbit
        With the a-priori state, whose epoch the first arc keeps.
    hours : float
        About how long an arc is; they meet where there is a gap between observations, if one is near.
    choice : OrbitChoice
        What is estimated. States, and what is estimated of the empirical acceleration, are of each arc.
    model : PhysicalModel
    observations : Observations

    Raises
    ------
    InputError
        The a-priori state is of a later arc than the first, or an arc comes down to the ground.
    """
    first_s, last_s = _events_s(observations, whole.epoch)
    borders_s = _borders_s(first_s, last_s, 3600.0 * hours)
    if not len(borders_s):
        return whole
    if borders_s[0] <= 0.0:
        raise InputError(
            f"[target] arcs_hours: the epoch is behind the first arc of {whole.name}, which ends at "
            f"{utc_strings(whole.epoch.shifted(borders_s[0]), 0)[0]} TDB; give a state before that"
        )
    borders = whole.epoch.shifted(borders_s)
    which = np.searchsorted(borders_s, 0.5 * (first_s + last_s))
    edges_s = [whole.span_s[0], *borders_s.tolist(), whole.span_s[1]]
    arcs: list[AdjustableOrbit] = []
    first_start, sigmas = np.zeros(6), choice.sigmas(whole.forces)
    fitted = whole
    for k in range(len(edges_s) - 1):
        epoch_s = 0.0 if k == 0 else edges_s[k]
        epoch = whole.epoch.shifted(epoch_s)
        state = whole.state if k == 0 else np.hstack(fitted.states(epoch))[0]
        span_s = (edges_s[k] - epoch_s - _BEYOND_S, edges_s[k + 1] - epoch_s + _BEYOND_S)
        arc = _acting(replace(whole, epoch=epoch, state=state, span_s=span_s, integrated=[]))
        known = {name: sigma for name, sigma in sigmas.items() if k == 0 or name in arc.parameters}
        fitted = _fitted(arc, choice, known, model, observations.select(which == k))
        logger.info("arc %d of %d begins at %s TDB", k + 1, len(edges_s) - 1, utc_strings(epoch, 0)[0])
        if k == 0:
            first_start = fitted.state - arc.state
        arcs.append(arc if k == 0 else replace(arc, state=fitted.state, integrated=fitted.integrated))
    own = (name for name in whole.parameters if name.rpartition(".")[0] == EMPIRICAL_NAME)
    return arcs_of(tuple(arcs), borders, frozenset(own), whole.forces, first_start)


def cut_by_borders(arcs: OrbitArcs, observations: Observations) -> NDArray[np.bool_]:
    """Which observations have events in two arcs, shape (n,)."""
    first_s, last_s = _events_s(observations, arcs.borders[:1])
    borders_s = arcs.borders.seconds_since(arcs.borders[:1])
    return np.searchsorted(borders_s, first_s) != np.searchsorted(borders_s, last_s)


def _events_s(observations: Observations, epoch: Epochs) -> tuple[Floats, Floats]:
    """Between which times, TDB seconds from an epoch, all events of each observation at the target are."""
    since_s = tt_to_tdb(utc_to_tt(observations.epoch)).seconds_since(epoch)
    half_s = 0.5 * np.nan_to_num(observations.count_s) + _LIGHT_S
    return since_s - half_s, since_s + half_s


def _borders_s(first_s: Floats, last_s: Floats, length_s: float) -> Floats:
    """Where arcs meet: where the fewest observations, from first event to last, are cut; most often none."""
    starts, stops, middle_s = np.sort(first_s), np.sort(last_s), 0.5 * (first_s + last_s)
    corners = np.unique(np.concatenate([starts, stops]))
    borders: list[float] = []
    count = max(1, round((stops[-1] - starts[0]) / length_s))
    length_s = (stops[-1] - starts[0]) / count
    for wanted_s in starts[0] + length_s * np.arange(1, count):
        times = np.append(0.5 * (corners[1:] + corners[:-1]), wanted_s)
        times = times[np.abs(times - wanted_s) <= _REACH * length_s]
        cut = np.searchsorted(starts, times, "right") - np.searchsorted(stops, times, "left")
        border_s = float(times[np.lexsort((np.abs(times - wanted_s), cut))[0]])
        since_s = borders[-1] if borders else -np.inf
        own, rest = ((middle_s > since_s) & (middle_s <= border_s)).sum(), (middle_s > border_s).sum()
        if own >= _FEWEST_OF_ARC and rest >= _FEWEST_OF_ARC:
            borders.append(border_s)
    return np.array(borders)


def _acting(arc: AdjustableOrbit) -> AdjustableOrbit:
    """An arc with those impulses that are in it, and parameters of these."""
    forces, (first_s, last_s) = arc.forces, arc.span_s
    inside = [first_s < float(one.epoch.seconds_since(arc.epoch)[0]) < last_s for one in forces.impulses]
    kept = tuple(one for one, is_inside in zip(forces.impulses, inside, strict=True) if is_inside)
    acting = replace(forces, impulses=kept)
    known = acting.parameters()
    return replace(arc, forces=acting, parameters=tuple(name for name in arc.parameters if name in known))


def _fitted(
    arc: AdjustableOrbit,
    choice: OrbitChoice,
    sigmas: Mapping[str, float],
    model: PhysicalModel,
    observations: Observations,
) -> AdjustableOrbit:
    """An arc near its estimate, from what is not ambiguous."""
    observations = observations.select(np.isnan(observations.modulus_m))
    arc = arc.coarse()
    predictor = prepare_predictor(model, observations, np.zeros(3), trajectory=arc)
    orbit = orbit_parameters(arc, sigmas, True, choice.state, choice.form)
    problem = ObservationModel.of(predictor, [orbit], [])
    start, _ = near_orbit(problem, observations.sigma_m, predictor.compute(np.zeros(3)).usable)
    return arc if start is None else arc.corrected(problem.all_positions_pa_m(start))


def near_landing(
    problem: ObservationModel, epoch: Epochs, sigma_m: Floats, usable: NDArray[np.bool_]
) -> Floats:
    """Parameters of a landing near the estimate: those of the flight from a state at an epoch before it (TDB)."""
    landing, arc = problem.landing, problem.predictor
    assert landing is not None  # it is such a problem
    flight = landing.orbit.moved_to(epoch)
    start, count = problem.parameters.prior_values.copy(), problem.first
    if isinstance(arc, ExactPredictor):
        sigmas = {
            one.name.partition(".")[2]: one.prior_sigma for one in landing.parameters if one.kind == "force"
        }
        before = ObservationModel.of(
            arc.along(flight), [orbit_parameters(flight, sigmas, estimated=True)], []
        )
        x, _ = near_orbit(before, sigma_m, usable)
        if x is not None:
            flight = flight.corrected(before.all_positions_pa_m(x))
    if usable.any():
        flight = _at_rest_by_later_thrust(flight, problem, problem.predictor.observations.epoch[usable])
    start[:count] = landing.values_of(flight.moved_to(landing.orbit.epoch))
    return np.where(problem.parameters.free, start, problem.parameters.prior_values)


def _at_rest_by_later_thrust(
    flight: AdjustableOrbit, problem: ObservationModel, used_utc: Epochs
) -> AdjustableOrbit:
    """The flight with what no data tell yet of its thrust such that it ends nearly at rest: the likeliest of such."""
    landing, parameters = problem.landing, problem.parameters
    assert landing is not None
    last_s = tt_to_tdb(utc_to_tt(used_utc)).seconds_since(landing.orbit.epoch).max()
    later = {
        name
        for one in flight.forces.accelerations
        if one.start is not None and one.start.seconds_since(landing.orbit.epoch)[0] > last_s
        for name in one.names()[0]
    }
    touchdown = slice(3, 6)
    variance = np.array(
        [parameters[f"force.{name}"].prior_sigma ** 2 if name in later else 0.0 for name in flight.parameters]
    )
    if not variance.any() or not np.isfinite(variance).all():
        return flight
    for _ in range(_LATER_STEPS):
        velocity = landing.values_of(flight.moved_to(landing.orbit.epoch))[touchdown]
        by_force = landing.axes.T @ flight.partials(landing.orbit.epoch)[0, touchdown, 6:]
        own = np.diag(parameters.prior_sigmas[touchdown] ** 2)
        gain = (variance * by_force).T @ np.linalg.inv((variance * by_force) @ by_force.T + own)
        flight = flight.corrected(np.concatenate([np.zeros(6), -gain @ velocity]))
    return flight
