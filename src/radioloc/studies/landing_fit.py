"""The fit of a landing: from where it starts, and what it says of the orbit before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics import AdjustableOrbit
from radioloc.dynamics.disturbed import DisturbedOrbit
from radioloc.estimation.orbit_state import OrbitState
from radioloc.estimation.solution import Solution
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.parameters.design import ObservationModel
from radioloc.parameters.orbit import orbit_parameters
from radioloc.studies.orbit_start import near_orbit
from radioloc.studies.orbiter import Orbiter
from radioloc.time import Epochs, tt_to_tdb, utc_to_tt

Floats = NDArray[np.float64]

_LATER_STEPS = 2
_BEFORE_S = 1.0
"""The state of the orbit is told until so long before the touchdown, where it has a plane yet."""


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


def state_before(
    problem: ObservationModel, target: Orbiter, solution: Solution, errant: DisturbedOrbit | None
) -> OrbitState:
    """The state of the orbit at the target's epoch, and its covariance until the touchdown."""
    landing, epoch = problem.landing, target.epoch
    assert landing is not None
    mine = slice(0, problem.first)
    changes, by_x = landing.changes(solution.values[mine])
    landed = landing.orbit.corrected(changes)
    by_x = np.vstack([landed.partials(epoch)[0] @ by_x, by_x[6:]])  # of the state there, then of the forces
    covariance = solution.parameter_covariance()[mine, mine]
    flight = landed.moved_to(epoch)
    until_s = float(landed.epoch.seconds_since(epoch)[0]) - _BEFORE_S
    flight = replace(flight, span_s=(flight.span_s[0], until_s))
    consider = solution.consider
    by_gravity = [] if consider is None else list(consider.parameters.of_kind("gravity_error"))
    if not by_gravity or consider is None or errant is None:
        return OrbitState(flight, by_x @ covariance @ by_x.T, body=target.body)
    sensitivity = consider.sensitivity[mine][:, by_gravity]
    moved = by_x @ sensitivity
    moved[:6] -= errant.effects(epoch)[0]
    covariance = by_x @ (covariance - sensitivity @ sensitivity.T) @ by_x.T + moved @ moved.T
    return OrbitState(flight, covariance, target.disturbed(flight), moved, target.body)
