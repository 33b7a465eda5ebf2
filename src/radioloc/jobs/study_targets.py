"""The targets of a study: its positions, trajectories and orbiters, with their estimated parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from radioloc.dynamics import AdjustableOrbit
from radioloc.ephemeris import EphemerisConstants
from radioloc.errors import error_context
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.target_motion import FixedPoint, Motions
from radioloc.parameters.parameter import Role
from radioloc.study.orbit_choice import OrbitChoice
from radioloc.study.orbiter import Orbiter
from radioloc.study.study import EstimateChoice, Study, TerrainPrior
from radioloc.targets.descent import Descent, Ground, touchdown_parameters
from radioloc.targets.known_trajectory import KnownTrajectory
from radioloc.targets.orbit import GravityErrors, TargetOrbit, orbit_parameters
from radioloc.targets.position_prior import PositionPrior, with_position_priors
from radioloc.targets.surface_point import PositionParameters, SurfacePoint, cartesian, on_sphere, on_terrain
from radioloc.targets.target import Target
from radioloc.vectors import Floats


def build_targets(study: Study, predictor: Predictor, choice: EstimateChoice) -> list[Target]:
    """Return the targets of a study, with their estimated parameters, in the order of the arc's motions."""
    names = study.names_in_order or tuple(study.all_targets)
    targets: list[Target] = [
        *surface_points(
            targets_in_pa(study, predictor.model), predictor.model, choice, several=len(study.landers) > 1
        )
    ]
    for name, motion in zip(names[len(targets) :], predictor.motions[len(targets) :], strict=True):
        if name in study.described:
            targets.append(
                described_target(study, name, predictor.model, estimated=choice.position != "none")
            )
            continue
        orbiter, orbit = study.orbiters.get(name), motion.adjustable
        if orbiter is None:
            targets.append(KnownTrajectory(name * (len(study.trajectories) > 1), motion.trajectory))  # type: ignore[arg-type]
            continue
        place_name = name if len(study.landers) > 1 else ""
        prior = _prior(choice, name)
        target = _flying(orbiter, orbit, predictor.model, choice, place_name, prior)  # type: ignore[arg-type]
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
    priors = [_prior(choice, name) for name in places_pa]
    parameters = [
        _place(model, place.xyz_m, choice, prior, f"position.{name}" if several else "position")
        for (name, place), prior in zip(places_pa.items(), priors, strict=True)
    ]
    positions = with_position_priors(parameters, priors, model.ephemeris.constants)
    return [
        SurfacePoint(name, *positions[k], preceding=3 * k, apriori_pa_m=place.xyz_m)
        for k, (name, place) in enumerate(places_pa.items())
    ]


def _flying(
    orbiter: Orbiter,
    orbit: AdjustableOrbit,
    model: PhysicalModel,
    choice: EstimateChoice,
    place_name: str,
    prior: PositionPrior | None,
) -> TargetOrbit | Descent:
    """Return the target on an orbit, or one that ends on the ground, whose place has a name beside other places."""
    orbit_choice, estimated = choice.orbit or OrbitChoice(), choice.orbit is not None
    errors = GravityErrors(orbiter.gravity_errors, orbiter.gravity_error_degree)
    if orbiter.landing is None or orbit.touchdown is None:
        sigmas = orbit_choice.sigmas(orbit.forces) if estimated else {}
        parameters = orbit_parameters(orbit, sigmas, estimated, orbit_choice.state, orbit_choice.form)
        return TargetOrbit("", *parameters, orbit, errors, orbiter.body, orbit_choice.process_noise)
    ground, place = Ground(model, orbit.touchdown), orbiter.landing.place
    start_pa_m = ground.place_pa_m(orbit.state)
    if place is not None and estimated:
        start_pa_m = position_in_pa("[target.landing]", place, model.ephemeris.constants).xyz_m
    parameter_name = f"position.{place_name}" if place_name else "position"
    place_parameters = _place(model, start_pa_m, choice, prior, parameter_name)
    [position] = with_position_priors([place_parameters], [prior], model.ephemeris.constants)
    of_orbit = orbit_parameters(orbit, orbit_choice.sigmas(orbit.forces), estimated=True)[0]
    forces = [item for item in of_orbit if item.kind == "force"]
    of_touchdown, axes = touchdown_parameters(ground, position, forces, orbit_choice.touchdown_sigma_m_s)
    descent = Descent("", of_touchdown, position[1], orbit, ground, axes, errors, orbiter.body, orbiter.epoch)
    return descent if estimated else descent.held()


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
