"""An orbit in arcs: where they meet, and from where the fit of each begins."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics import AdjustableOrbit
from radioloc.dynamics.arcs import OrbitArcs, arcs_of
from radioloc.errors import InputError
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.parameters.design import ObservationModel
from radioloc.parameters.orbit import orbit_parameters
from radioloc.studies.orbit_start import near_orbit
from radioloc.studies.orbiter import EMPIRICAL_NAME, OrbitChoice
from radioloc.time import Epochs, tt_to_tdb, utc_strings, utc_to_tt

logger = logging.getLogger(__name__)

Floats = NDArray[np.float64]

_LIGHT_S = 3.0
"""Light does not take longer from the Moon."""
_REACH = 0.25
"""Part of an arc by which its end may move to a gap between observations."""
_FEWEST = 20
"""Observations that make an arc."""
_BEYOND_S = 60.0
"""What an arc has beyond its borders, for events of observations near them."""


def orbit_arcs(
    whole: AdjustableOrbit,
    hours: float,
    choice: OrbitChoice,
    model: PhysicalModel,
    observations: Observations,
) -> AdjustableOrbit | OrbitArcs[AdjustableOrbit]:
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
        fitted = _fitted(arc, choice, _of_arc(sigmas, arc, k), model, observations.select(which == k))
        logger.info("arc %d of %d begins at %s TDB", k + 1, len(edges_s) - 1, utc_strings(epoch, 0)[0])
        if k == 0:
            first_start = fitted.state - arc.state
        arcs.append(arc if k == 0 else replace(arc, state=fitted.state, integrated=fitted.integrated))
    own = (name for name in whole.parameters if name.rpartition(".")[0] == EMPIRICAL_NAME)
    return arcs_of(tuple(arcs), borders, frozenset(own), whole.forces, first_start)


def cut_by_borders(arcs: OrbitArcs[AdjustableOrbit], observations: Observations) -> NDArray[np.bool_]:
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
        if own >= _FEWEST and rest >= _FEWEST:
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


def _of_arc(sigmas: Mapping[str, float], arc: AdjustableOrbit, number: int) -> dict[str, float]:
    """A-priori sigmas: those of the state are of the first arc's."""
    return {name: sigma for name, sigma in sigmas.items() if number == 0 or name in arc.parameters}


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
