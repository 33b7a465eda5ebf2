"""The targets of a study: its positions, trajectories and orbiters, with their estimated parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import singledispatchmethod
from typing import Any

import numpy as np

from radioloc.dynamics import AdjustableOrbit
from radioloc.ephemeris import EphemerisConstants, Trajectory
from radioloc.errors import error_context
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Predictor
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
from radioloc.vectors import Floats


def build_targets(study: Study, predictor: Predictor, choice: EstimateChoice) -> list[Target]:
    """Return the targets of a study, with their estimated parameters, in the order of the arc's motions."""
    builder = _TargetBuilder(study, predictor, choice)
    for name in builder.motions:
        builder.targets.append(builder.build(study.all_targets[name], name))
    return builder.targets


class _TargetBuilder:
    """Builder of the targets that a study declares, one after another."""

    def __init__(self, study: Study, predictor: Predictor, choice: EstimateChoice) -> None:
        self.study, self.model, self.choice = study, predictor.model, choice
        names = study.names_in_order or tuple(study.all_targets)
        self.motions = dict(zip(names, predictor.motions, strict=True))
        self.targets, self.grounds = list[Target](), dict[str, Ground]()
        self.starts = {name: place.xyz_m for name, place in targets_in_pa(study, self.model).items()}
        for name, orbiter in study.orbiters.items():
            orbit: AdjustableOrbit = self.motions[name].adjustable  # type: ignore[assignment]
            if orbiter.landing is not None and orbit.touchdown is not None:
                self.grounds[name], place = Ground(self.model, orbit.touchdown), orbiter.landing.place
                self.starts[name] = (
                    self.grounds[name].place_pa_m(orbit.state)
                    if place is None or choice.orbit is None
                    else position_in_pa("[target.landing]", place, self.model.ephemeris.constants).xyz_m
                )
        self.positions = _positions(self.starts, self.model, choice, several=len(study.landers) > 1)

    @singledispatchmethod
    def build(self, record: Any, name: str) -> Target:
        """Return the target of a registered kind; those of other kinds follow."""
        role = Role.FIXED if self.choice.position == "none" else Role.ESTIMATED
        return record.target(name * (len(self.motions) > 1), self.model, role)

    @build.register
    def _(self, record: LunarPosition, name: str) -> Target:
        return SurfacePoint(name, *self.positions[name], apriori_pa_m=self.starts[name])

    @build.register
    def _(self, record: Trajectory, name: str) -> Target:
        trajectory = self.motions[name].trajectory or record
        return KnownTrajectory(name * (len(self.study.trajectories) > 1), trajectory)

    @build.register
    def _(self, record: Orbiter, name: str) -> Target:
        orbit: AdjustableOrbit = self.motions[name].adjustable  # type: ignore[assignment]
        build = self._descent if name in self.grounds else self._orbit
        target = build(record, name, orbit, GravityErrors(record.gravity_errors, record.gravity_error_degree))
        if len(self.study.orbiters) < 2:
            return replace(target, name=name)
        parameters = [
            item if item.kind == "position" else replace(item, name=item.name.replace(".", f".{name}.", 1))
            for item in target.parameters
        ]
        return replace(target, name=name, parameters=parameters)

    def _orbit(
        self, orbiter: Orbiter, name: str, orbit: AdjustableOrbit, errors: GravityErrors
    ) -> TargetOrbit | Descent:
        choice, estimated = self.choice.orbit or OrbitChoice(), self.choice.orbit is not None
        sigmas = choice.sigmas(orbit.forces) if estimated else {}
        parameters = orbit_parameters(orbit, sigmas, estimated, choice.state, choice.form)
        return TargetOrbit("", *parameters, orbit, errors, orbiter.body, choice.process_noise)

    def _descent(
        self, orbiter: Orbiter, name: str, orbit: AdjustableOrbit, errors: GravityErrors
    ) -> TargetOrbit | Descent:
        """Return a target that comes to rest at a place, which depends on those before if they share errors."""
        choice, ground = self.choice.orbit or OrbitChoice(), self.grounds[name]
        (of_place, place, shared_count), landers = self.positions[name], list(self.starts)
        k = landers.index(name)
        landers = landers[k - shared_count // 3 : k + 1]
        values = np.array([item.prior_value for lander in landers for item in self.positions[lander][0]])
        begins = np.cumsum([0, *(len(target.parameters) for target in self.targets)])
        begins = begins[[list(self.motions).index(lander) for lander in landers]]
        columns = (begins[:, None] - begins[0] + np.arange(3)).ravel()
        of_orbit = orbit_parameters(orbit, choice.sigmas(orbit.forces), estimated=True)[0]
        forces = [item for item in of_orbit if item.kind == "force"]
        further, axes = touchdown_parameters(ground, place(values)[0], forces, choice.touchdown_sigma_m_s)
        descent = Descent(
            "", [*of_place, *further], place, orbit, ground, axes, errors, orbiter.body, orbiter.epoch
        )
        descent = replace(descent, place_columns=columns, preceding=int(columns[-3]))
        return descent if self.choice.orbit is not None else descent.held()


def surface_points(
    places_pa: Mapping[str, LunarPosition], model: PhysicalModel, choice: EstimateChoice
) -> list[SurfacePoint]:
    """Return the points of a-priori positions by name."""
    starts = {name: place.xyz_m for name, place in places_pa.items()}
    positions = _positions(starts, model, choice, several=len(starts) > 1)
    return [
        SurfacePoint(name, *positions[name], apriori_pa_m=start_pa_m) for name, start_pa_m in starts.items()
    ]


def _positions(
    starts_pa_m: Mapping[str, Floats], model: PhysicalModel, choice: EstimateChoice, *, several: bool
) -> dict[str, tuple[list[Parameter], PositionFunction, int]]:
    """Return the parameters of places by name, the places as functions of them, and how many precede their own."""
    stated = {prior.target: prior for prior in choice.position_priors if choice.position == "geographic"}
    priors = [stated.get(name) for name in starts_pa_m]
    parameters = [
        _place(model, start_pa_m, choice, prior, f"position.{name}" if several else "position")
        for (name, start_pa_m), prior in zip(starts_pa_m.items(), priors, strict=True)
    ]
    positions = with_position_priors(parameters, priors, model.ephemeris.constants)
    return dict(zip(starts_pa_m, positions, strict=True))


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


def position_in_pa(table: str, position: LunarPosition, constants: EphemerisConstants) -> LunarPosition:
    """Return a position of the study in principal axes; an error names its table."""
    with error_context(f"{table} frame:"):
        return position.to_axes("PA", constants)
