"""First orbit from Doppler alone, for a nearly circular orbit of a given altitude.

Within one pass Doppler determines the velocity along the line of sight, and with it the tilt of the orbital plane to
the line of sight and the phase. The rotation of the plane about the line of sight follows only from the motion of that
line, a degree in two hours, and from the gravity field. The search begins with a grid of circular orbits, as sums of
projections. Integrated orbits are then fitted from starts all around the line of sight. The best-fitting alternative is
usually the mirror image in the plane in which the line of sight moves.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from radioloc.constants import C_M_S, MEAN_LUNAR_RADIUS_M
from radioloc.dynamics.elements import equatorial_axes, inclination_and_node_deg
from radioloc.errors import InputError
from radioloc.jobs.orbit_start import OrbitPart, fitted_state, turned_state
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.observations import DOPPLER, Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.target_motion import FixedPoint
from radioloc.study.orbiter import Orbiter, RoughOrbit
from radioloc.time import tt_to_tdb, utc_to_tt
from radioloc.vectors import Floats

logger = logging.getLogger(__name__)

_WINDOW_S = 7200.0  # counts used about the first one near the epoch: longer arcs have more than one minimum
_MIN_COUNTS, _MAX_COUNTS = 12, 80
_GRID_RAD = np.radians(5.0)
_PHASE_STEP_RAD = np.radians(1.0)  # for a given plane
_MAX_RESIDUAL_M_S = 500.0  # bound in the misfit, for counts without lock
_TURN_COUNT = 12  # starts about the line of sight
_ROUGH_DEGREE = 20
_ROUGH_STEPS, _FINE_STEPS = 10, 40
_STEP_M, _STEP_M_S = 1e5, 1e2  # standard deviations of one step of a fit
_MIN_MISFIT_M_S = 1e-4  # noise of good counts
_SAME_PLANE_RAD = np.radians(2.0)
_REFINED_COUNT = 2
_AMBIGUITY_RATIO = 1.5  # misfits of candidates within this ratio do not decide between them
# Point near the centre of the Moon, where tides have no direction; it moves by 3 mm/s.
_NEAR_CENTRE = FixedPoint(np.array([1e3, 0.0, 0.0]))


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """Orbit that fits Doppler near the epoch."""

    state: Floats  # m and m/s, Moon-centred ICRF, at the epoch
    misfit_m_s: float  # robust spread of the range rates
    inclination_deg: float  # to the Moon's equator
    node_deg: float
    # Plane closer to the mirror image of the best candidate than to the best candidate.
    mirrored: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return all fields in JSON types."""
        return asdict(self) | {"state": self.state.tolist()}

    def __str__(self) -> str:
        return (
            f"{'mirrored, ' if self.mirrored else ''}inclination {self.inclination_deg:.1f} deg, "
            f"node {self.node_deg:.1f} deg (misfit {1e3 * self.misfit_m_s:.3g} mm/s)"
        )


def first_orbits(orbiter: Orbiter, model: PhysicalModel, observations: Observations) -> tuple[Candidate, ...]:
    """Return orbits near a rough orbit that fit Doppler near the epoch, the best first; InputError if none fits."""
    rough = orbiter.rough
    assert rough is not None
    arc = _counts_near_epoch(orbiter, model, observations)
    state, line, mirror = _best_circle(orbiter, rough, arc)
    forces = orbiter.forces
    starts = [state]
    if not rough.in_plane:
        field = forces.gravity.to_degree(min(_ROUGH_DEGREE, forces.gravity.degree))
        smooth = replace(orbiter, forces=replace(forces, gravity=field))
        turns = np.arange(_TURN_COUNT) * 2.0 * np.pi / _TURN_COUNT
        candidates = _fitted(smooth, arc, [turned_state(state, turn * line) for turn in turns], _ROUGH_STEPS)
        starts = [item.state for item in candidates[:_REFINED_COUNT]]
        starts += [_mirrored(item, mirror) for item in starts]
    fitted = _fitted(orbiter, arc, starts, _FINE_STEPS)
    logger.info("first orbits: %s", "; ".join(map(str, fitted)))
    if not fitted:
        raise InputError(
            f"[target] altitude_m: no orbit near {rough} fits the Doppler of {orbiter.name}; check it"
        )
    best, *alternatives = fitted
    image = _mirrored(best.state, mirror)
    return (
        best,
        *(
            replace(item, mirrored=_angle_rad(item.state, image) < _angle_rad(item.state, best.state))
            for item in alternatives
        ),
    )


def is_ambiguous(orbits: Sequence[Candidate]) -> bool:
    """Return True if the data do not decide between the best two candidates."""
    return len(orbits) > 1 and orbits[1].misfit_m_s < _AMBIGUITY_RATIO * orbits[0].misfit_m_s


def _counts_near_epoch(orbiter: Orbiter, model: PhysicalModel, observations: Observations) -> ExactPredictor:
    """Return some coherent counts of Doppler near the epoch, predicted for a target near the Moon's centre."""
    coherent = np.array(
        [bool(link.transmitter) and not link.differenced for link in observations.links], dtype=bool
    )
    rows = np.flatnonzero((observations.kind == DOPPLER) & coherent[observations.link])
    if len(rows):
        since_s = tt_to_tdb(utc_to_tt(observations.epoch[rows])).seconds_since(orbiter.epoch)
        first_s = since_s[np.argmin(np.abs(since_s))]
        rows = rows[np.abs(since_s - first_s) <= _WINDOW_S]
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, _MAX_COUNTS).astype(int))]
    arc = ExactPredictor(model, observations.select(rows), _NEAR_CENTRE)
    arc = arc.select(arc.compute().usable)
    if len(arc.observations) < _MIN_COUNTS:
        raise InputError(
            f"[target] altitude_m: a first orbit of {orbiter.name} needs {_MIN_COUNTS} counts of two- or three-way "
            f"Doppler within two hours near the epoch, got {len(arc.observations)}; give position_m and "
            "velocity_m_s, or another epoch"
        )
    return arc


def _best_circle(orbiter: Orbiter, rough: RoughOrbit, arc: ExactPredictor) -> tuple[Floats, Floats, Floats]:
    """Return the state on the best circular orbit, m and m/s, the line of sight, and a reflection, shape (3, 3).

    The reflection is in the plane in which the line of sight moves. For a target at c along the line of sight from the
    Moon's centre, a leg from a station at the distance D is longer by c - c^2 / 2D, up to a constant.
    """
    observations, model = arc.observations, arc.model
    path, _, _ = arc.light_path()
    half_s = 0.5 * observations.count_s
    tdb = tt_to_tdb(utc_to_tt(observations.epoch))
    since_s = tdb.seconds_since(orbiter.epoch)
    angle_s = np.concatenate([since_s + half_s, since_s - half_s]) + path.bounce_s
    # From the transmitter and from the receiver to the target.
    units = np.stack([path.up_unit, -path.down_unit])
    flat = 0.5 / (C_M_S * np.stack([path.up_s, path.down_s]))
    observed_m_s = (observations.value_m - arc.compute().value_m) / observations.count_s

    axes = equatorial_axes(model.libration, orbiter.epoch)
    nodes, quarters = _planes(rough, axes)
    a_m = MEAN_LUNAR_RADIUS_M + rough.altitude_m
    gm = orbiter.forces.gm_m3_s2 or model.ephemeris.constants.gm_m3_s2("moon")
    mean_motion = np.sqrt(gm / a_m**3)
    cos, sin = np.cos(mean_motion * angle_s), np.sin(mean_motion * angle_s)
    step = _PHASE_STEP_RAD if rough.in_plane else _GRID_RAD
    phases = np.arange(0.0, 2.0 * np.pi, step)
    n = len(observations)
    best = (np.inf, 0, 0.0)
    for k, (p, q) in enumerate(zip(nodes, quarters, strict=True)):
        at_node, at_quarter = (a_m * (units @ axis) for axis in (p, q))
        first, second = at_node * cos + at_quarter * sin, at_quarter * cos - at_node * sin
        along_m = np.cos(phases)[:, None, None] * first + np.sin(phases)[:, None, None] * second
        length_m = (along_m - flat * along_m**2).sum(axis=1)
        rate_m_s = (length_m[:, :n] - length_m[:, n:]) / observations.count_s
        misfit = np.minimum(np.abs(observed_m_s - rate_m_s), _MAX_RESIDUAL_M_S).mean(axis=-1)
        phase_index = int(np.argmin(misfit))
        if misfit[phase_index] < best[0]:
            best = (float(misfit[phase_index]), k, float(phases[phase_index]))
    misfit_m_s, k, phase = best
    logger.info("circular orbits: %d planes, smallest mean residual %.0f m/s", len(nodes), misfit_m_s)
    position = np.cos(phase) * nodes[k] + np.sin(phase) * quarters[k]
    velocity = np.cos(phase) * quarters[k] - np.sin(phase) * nodes[k]
    units = path.up_unit
    line = units.mean(axis=0) / np.linalg.norm(units.mean(axis=0))
    across = np.linalg.svd(units - units.mean(axis=0))[2][0]
    pole = np.cross(line, across)
    mirror = np.eye(3) - 2.0 * np.outer(pole, pole) / (pole @ pole)
    return np.concatenate([a_m * position, a_m * mean_motion * velocity]), line, mirror


def _planes(rough: RoughOrbit, axes: Floats) -> tuple[Floats, Floats]:
    """Return directions to the ascending node, and 90 deg from it, of all candidate planes, ICRF, shapes (n, 3)."""
    step = np.degrees(_GRID_RAD)
    inclinations = (
        np.arange(0.5 * step, 180.0, step) if rough.inclination_deg is None else [rough.inclination_deg]
    )
    nodes = np.arange(0.0, 360.0, step) if rough.node_deg is None else [rough.node_deg]
    i, node = (grid.ravel() for grid in np.radians(np.meshgrid(inclinations, nodes)))
    to_node = np.stack([np.cos(node), np.sin(node), np.zeros_like(node)], axis=-1)
    quarter = np.stack([-np.sin(node) * np.cos(i), np.cos(node) * np.cos(i), np.sin(i)], axis=-1)
    return to_node @ axes, quarter @ axes


def _fitted(orbiter: Orbiter, arc: ExactPredictor, starts: Sequence[Floats], steps: int) -> list[Candidate]:
    """Return orbits fitted from several states, the best first, without repeated planes."""
    axes = equatorial_axes(arc.model.libration, orbiter.epoch)
    sigmas = np.repeat([_STEP_M, _STEP_M_S], 3)
    sigma_m = _MIN_MISFIT_M_S * arc.observations.count_s
    candidates = []
    for start in starts:
        orbit = orbiter.with_state(start).orbit(arc.model, arc.observations, ()).coarse()
        try:
            predictor = ExactPredictor(arc.model, arc.observations, orbit)
            part = OrbitPart(predictor, orbit, sigma_m, start, np.arange(6), sigmas)
            state, spread = fitted_state(part, start, steps)
        except InputError as error:  # orbit below the surface
            logger.info("start without orbit: %s", error)
            continue
        candidates.append(Candidate(state, _MIN_MISFIT_M_S * spread, *inclination_and_node_deg(state, axes)))
    distinct: list[Candidate] = []
    for item in sorted(candidates, key=lambda item: item.misfit_m_s):
        if all(_angle_rad(item.state, better.state) > _SAME_PLANE_RAD for better in distinct):
            distinct.append(item)
    return distinct


def _mirrored(state: Floats, mirror: Floats) -> Floats:
    return np.asarray((state.reshape(2, 3) @ mirror).ravel())


def _angle_rad(first: Floats, second: Floats) -> float:
    """Return the angle between the orbital planes of two states."""
    normals = [np.cross(state[:3], state[3:]) for state in (first, second)]
    cosine = normals[0] @ normals[1] / np.prod(np.linalg.norm(normals, axis=1))
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))
