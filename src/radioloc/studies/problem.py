"""The observation model of a study's arc: its positions and the parameters that the study asks for."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from radioloc.ephemeris import EphemerisConstants, Trajectory
from radioloc.errors import InputError
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.targets import canonical_target
from radioloc.parameters.choice import ParameterChoice, chosen_parameters
from radioloc.parameters.design import ObservationModel, simple_predictor
from radioloc.parameters.parameter import Role
from radioloc.parameters.position import PositionParameters, cartesian, on_sphere, on_terrain
from radioloc.parameters.registry import PARAMETERS
from radioloc.studies.study import EstimateChoice, Study, TerrainPrior


def observation_model(
    predictor: Predictor,
    targets_pa: LunarPosition | Mapping[str, LunarPosition] | None,
    estimate: EstimateChoice | None,
    held: EstimateChoice | None = None,
    consider: Mapping[str, ParameterChoice] | None = None,
) -> ObservationModel:
    """Set up what is solved for in an arc.

    Parameters
    ----------
    predictor : Predictor
    targets_pa : LunarPosition, mapping of str to LunarPosition, or None
        A-priori position in principal axes, or those of several targets by name; none for a trajectory, whose offset is
        then held at zero.
    estimate : EstimateChoice or None
        What to estimate; nothing where ``None``.
    held : EstimateChoice, optional
        Where nothing is estimated, whose a-priori values of biases and the like hold; zero otherwise.
    consider : mapping of str to ParameterChoice, optional
        What is considered.

    Raises
    ------
    StationError
        A station is not in the catalogue.
    InputError
        A parameter is asked for of a station without observations, or nothing at all is to be estimated.
    """
    choice = (EstimateChoice() if held is None else held).held() if estimate is None else estimate
    simple = simple_predictor(predictor)
    kinds = []
    tables = [("[estimate]", Role.ESTIMATED, choice.parameters)]
    tables.append(("[consider]", Role.CONSIDERED, {} if estimate is None else consider or {}))
    for table, role, given in tables:
        for name, chosen in given.items():
            try:
                found = chosen_parameters(PARAMETERS[name], chosen, simple, role, choice.pass_gap_h)
            except InputError as error:
                raise type(error)(f"{table} {error}") from None
            if found is not None:
                kinds.append(found)
    if isinstance(targets_pa, Mapping) and len(targets_pa) > 1:
        positions = [
            _position(predictor, place, choice, f"position.{name}") for name, place in targets_pa.items()
        ]
    else:
        place = next(iter(targets_pa.values())) if isinstance(targets_pa, Mapping) else targets_pa
        positions = [_position(predictor, place, choice)]
    model = ObservationModel.of(predictor, positions, kinds)
    if estimate is not None and all(parameter.fixed for parameter in model.parameters):
        raise InputError(
            'nothing to estimate: [estimate] position is "none" and no bias is asked for; '
            "use `radioloc residuals` to see residuals at the given position"
        )
    return model


def _position(
    predictor: Predictor, target_pa: LunarPosition | None, choice: EstimateChoice, name: str = "position"
) -> PositionParameters:
    if target_pa is None:
        return cartesian(np.zeros(3), role=Role.FIXED, name="offset")
    if choice.position != "geographic":
        role = Role.FIXED if choice.position == "none" else Role.ESTIMATED
        return cartesian(target_pa.xyz_m, role=role, name=name)
    prior = choice.height_prior
    if isinstance(prior, TerrainPrior):
        constants = predictor.model.ephemeris.constants
        return on_terrain(target_pa.xyz_m, prior.terrain, prior.sigma_m, constants, name)
    return on_sphere(target_pa.xyz_m, None if prior is None else (prior.height_m, prior.sigma_m), name)


def targets_in_pa(study: Study, constants: EphemerisConstants) -> dict[str, LunarPosition]:
    """The a-priori positions in principal axes by name; none where the target is a trajectory."""
    if isinstance(study.target, Trajectory):
        return {}
    if study.targets:
        return {
            canonical_target(name): position_in_pa(f"[targets.{name}]", position, constants)
            for name, position in study.targets.items()
        }
    return {"": position_in_pa("[target]", study.target, constants)}


def start_pa_m(targets_pa: Mapping[str, LunarPosition]) -> NDArray[np.float64]:
    """Where an arc is prepared: at the a-priori positions, or at no offset from the trajectory."""
    places = [position.xyz_m for position in targets_pa.values()]
    return np.zeros(3) if not places else places[0] if len(places) == 1 else np.array(places)


def position_in_pa(table: str, position: LunarPosition, constants: EphemerisConstants) -> LunarPosition:
    """A position of the study in principal axes; an error names its table."""
    try:
        return position.to_axes("PA", constants)
    except InputError as error:
        raise InputError(f"{table} frame: {error}") from None
