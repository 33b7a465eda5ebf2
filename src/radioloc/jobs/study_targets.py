"""The targets of a study: its positions, trajectories and orbiters, with their estimated parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from radioloc.dynamics import AdjustableOrbit
from radioloc.ephemeris import EphemerisConstants
from radioloc.errors import error_context
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.target_motion import FixedPoint, Motions
from radioloc.parameters.parameter import Parameter, Role
from radioloc.study.orbit_choice import OrbitChoice
from radioloc.study.orbiter import Orbiter
from radioloc.study.study import EstimateChoice, Study, TerrainPrior
from radioloc.targets.descent import Descent, Ground, touchdown_parameters
from radioloc.targets.known_trajectory import KnownTrajectory
from radioloc.targets.orbit import GravityErrors, TargetOrbit, orbit_parameters
from radioloc.targets.position_prior import PositionPrior, with_position_priors
from radioloc.targets.surface_point import (
    PositionFunction,
    PositionParameters,
    SurfacePoint,
    cartesian,
    on_sphere,
    on_terrain,
)
from radioloc.targets.target import Target
from radioloc.vectors import Floats, Indices


def build_targets(study: Study, predictor: Predictor, choice: EstimateChoice) -> list[Target]:
    """Return the targets of a study, with their estimated parameters, in the order of the arc's motions."""
    model, names = predictor.model, study.names_in_order or tuple(study.all_targets)
    motions = dict(zip(names, predictor.motions, strict=True))
    starts = {name: place.xyz_m for name, place in targets_in_pa(study, model).items()}
    grounds = dict[str, Ground]()
    for name, orbiter in study.orbiters.items():
        orbit: AdjustableOrbit = motions[name].adjustable  # type: ignore[assignment]
        if orbiter.landing is not None and orbit.touchdown is not None:
            grounds[name], place = Ground(model, orbit.touchdown), orbiter.landing.place
            if place is None or choice.orbit is None:
                starts[name] = grounds[name].place_pa_m(orbit.state)
            else:
                starts[name] = position_in_pa("[target.landing]", place, model.ephemeris.constants).xyz_m
    positions = _positions(starts, model, choice, several=len(study.landers) > 1)
    targets, begins = list[Target](), dict[str, int]()  # index of the first parameter of each target
    for name, motion in motions.items():
        begins[name] = sum(len(target.parameters) for target in targets)
        if name in study.points:
            targets.append(SurfacePoint(name, *positions[name], apriori_pa_m=starts[name]))
            continue
        if name in study.described:
            targets.append(described_target(study, name, model, estimated=choice.position != "none"))
            continue
        if name not in study.orbiters:
            targets.append(KnownTrajectory(name * (len(study.trajectories) > 1), motion.trajectory))  # type: ignore[arg-type]
            continue
        target: TargetOrbit | Descent
        orbiter, orbit = study.orbiters[name], motion.adjustable  # type: ignore[assignment]
        if name in grounds:
            k, shared_count = list(starts).index(name), positions[name][2] // 3
            landers = list(starts)[k - shared_count : k + 1]
            values = np.array([item.prior_value for lander in landers for item in positions[lander][0]])
            columns = np.concatenate(
                [begins[lander] - begins[landers[0]] + np.arange(3) for lander in landers]
            )
            place_pa_m = positions[name][1](values)[0]
            target = _descent(orbiter, orbit, grounds[name], choice, positions[name], place_pa_m, columns)
        else:
            target = _orbit(orbiter, orbit, choice)
        targets.append(_named(target, name, several=len(study.orbiters) > 1))
    return targets


def described_target(study: Study, name: str, model: PhysicalModel, *, estimated: bool = False) -> Target:
    """Return a target of a registered kind."""
    role = Role.ESTIMATED if estimated else Role.FIXED
    return study.described[name].target(name * (len(study.all_targets) > 1), model, role)


def _named(target: TargetOrbit | Descent, name: str, *, several: bool) -> TargetOrbit | Descent:
    """Return a target with its name in the study, which its parameters have behind their kind if there are several."""
    if not several:
        return replace(target, name=name)
    parameters = [
        item if item.kind == "position" else replace(item, name=item.name.replace(".", f".{name}.", 1))
        for item in target.parameters
    ]
    return replace(target, name=name, parameters=parameters)


def surface_points(
    places_pa: Mapping[str, LunarPosition],
    model: PhysicalModel,
    choice: EstimateChoice,
    *,
    several: bool = False,
) -> list[SurfacePoint]:
    """Return the points of a-priori positions by name, with parameters that have their names if there are several."""
    starts = {name: place.xyz_m for name, place in places_pa.items()}
    positions = _positions(starts, model, choice, several=several)
    return [
        SurfacePoint(name, *positions[name], apriori_pa_m=start_pa_m) for name, start_pa_m in starts.items()
    ]


def _positions(
    starts_pa_m: Mapping[str, Floats], model: PhysicalModel, choice: EstimateChoice, *, several: bool
) -> dict[str, tuple[list[Parameter], PositionFunction, int]]:
    """Return the parameters of places by name, the places as functions of them, and how many precede their own."""
    priors = [_prior(choice, name) for name in starts_pa_m]
    parameters = [
        _place(model, start_pa_m, choice, prior, f"position.{name}" if several else "position")
        for (name, start_pa_m), prior in zip(starts_pa_m.items(), priors, strict=True)
    ]
    positions = with_position_priors(parameters, priors, model.ephemeris.constants)
    return dict(zip(starts_pa_m, positions, strict=True))


def _orbit(orbiter: Orbiter, orbit: AdjustableOrbit, choice: EstimateChoice) -> TargetOrbit:
    orbit_choice, estimated = choice.orbit or OrbitChoice(), choice.orbit is not None
    errors = GravityErrors(orbiter.gravity_errors, orbiter.gravity_error_degree)
    sigmas = orbit_choice.sigmas(orbit.forces) if estimated else {}
    parameters = orbit_parameters(orbit, sigmas, estimated, orbit_choice.state, orbit_choice.form)
    return TargetOrbit("", *parameters, orbit, errors, orbiter.body, orbit_choice.process_noise)


def _descent(
    orbiter: Orbiter,
    orbit: AdjustableOrbit,
    ground: Ground,
    choice: EstimateChoice,
    position: tuple[list[Parameter], PositionFunction, int],
    place_pa_m: Floats,
    columns: Indices,
) -> Descent:
    """Return a target that comes to rest at a place, which follows from some columns of the parameters."""
    orbit_choice, (of_place, place, _) = choice.orbit or OrbitChoice(), position
    errors = GravityErrors(orbiter.gravity_errors, orbiter.gravity_error_degree)
    of_orbit = orbit_parameters(orbit, orbit_choice.sigmas(orbit.forces), estimated=True)[0]
    forces = [item for item in of_orbit if item.kind == "force"]
    further, axes = touchdown_parameters(ground, place_pa_m, forces, orbit_choice.touchdown_sigma_m_s)
    parameters, body, epoch = [*of_place, *further], orbiter.body, orbiter.epoch
    descent = Descent("", parameters, place, orbit, ground, axes, errors, body, epoch)
    descent = replace(descent, place_columns=columns, preceding=int(columns[-3]))
    return descent if choice.orbit is not None else descent.held()


def _prior(choice: EstimateChoice, target: str) -> PositionPrior | None:
    if choice.position != "geographic":
        return None
    return next((prior for prior in choice.position_priors if prior.target == target), None)


def _place(
    model: PhysicalModel, start_pa_m: Floats, choice: EstimateChoice, prior: PositionPrior | None, name: str
) -> PositionParameters:
    if choice.position != "geographic":
        role = Role.FIXED if choice.position == "none" else Role.ESTIMATED
        return cartesian(start_pa_m, role=role, name=name)
    height, constants = choice.height_prior, model.ephemeris.constants
    if prior is not None:
        start_pa_m = prior.mean.to_axes("PA", constants).xyz_m
    if isinstance(height, TerrainPrior):
        return on_terrain(start_pa_m, height.terrain, height.sigma_m, constants, name)
    if height is None or (prior is not None and prior.has_height):
        return on_sphere(start_pa_m, None, name)
    return on_sphere(start_pa_m, (height.height_m, height.sigma_m), name)


def targets_in_pa(study: Study, model: PhysicalModel) -> dict[str, LunarPosition]:
    """Return the a-priori positions of points on the Moon in principal axes by name."""
    constants = model.ephemeris.constants
    places = {
        name: position_in_pa(f"[targets.{name}]" if name else "[target]", position, constants)
        for name, position in study.points.items()
    }
    for prior in study.estimate.position_priors:
        if prior.target not in places:  # the place of a descent
            continue
        places[prior.target] = position_in_pa("[[observations.map_positions]]", prior.mean, constants)
    return places


def apriori_points(study: Study, model: PhysicalModel) -> Motions:
    """Return the a-priori positions of points on the Moon as motions."""
    return tuple(FixedPoint(position.xyz_m) for position in targets_in_pa(study, model).values())


def position_in_pa(table: str, position: LunarPosition, constants: EphemerisConstants) -> LunarPosition:
    """Return a position of the study in principal axes; an error names its table."""
    with error_context(f"{table} frame:"):
        return position.to_axes("PA", constants)
