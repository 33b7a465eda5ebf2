"""The observation model of a study's arc: its positions and the parameters that the study asks for."""

from __future__ import annotations

import numpy as np

from radioloc.errors import InputError
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.predictor import Predictor
from radioloc.parameters.choice import chosen_parameters
from radioloc.parameters.design import ObservationModel, simple_predictor
from radioloc.parameters.parameter import Role
from radioloc.parameters.position import PositionParameters, cartesian, on_sphere, on_terrain
from radioloc.parameters.registry import PARAMETERS
from radioloc.studies.study import EstimateChoice, TerrainPrior


def observation_model(
    predictor: Predictor,
    target_pa: LunarPosition | None,
    estimate: EstimateChoice | None,
    held: EstimateChoice | None = None,
) -> ObservationModel:
    """Set up what is solved for in an arc.

    Parameters
    ----------
    predictor : Predictor
    target_pa : LunarPosition or None
        A-priori position in principal axes; none for a trajectory, whose offset is then held at zero.
    estimate : EstimateChoice or None
        What to estimate; nothing where ``None``.
    held : EstimateChoice, optional
        Where nothing is estimated, whose a-priori values of biases and the like hold; zero otherwise.

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
    for name, given in choice.parameters.items():
        try:
            found = chosen_parameters(PARAMETERS[name], given, simple, gap_h=choice.pass_gap_h)
        except InputError as error:
            raise type(error)(f"[estimate] {error}") from None
        if found is not None:
            kinds.append(found)
    model = ObservationModel.of(predictor, [_position(predictor, target_pa, choice)], kinds)
    if estimate is not None and all(parameter.fixed for parameter in model.parameters):
        raise InputError(
            'nothing to estimate: [estimate] position is "none" and no bias is asked for; '
            "use `radioloc residuals` to see residuals at the given position"
        )
    return model


def _position(
    predictor: Predictor, target_pa: LunarPosition | None, choice: EstimateChoice
) -> PositionParameters:
    if target_pa is None:
        return cartesian(np.zeros(3), role=Role.FIXED, name="offset")
    if choice.position != "geographic":
        return cartesian(target_pa.xyz_m, role=Role.FIXED if choice.position == "none" else Role.ESTIMATED)
    prior = choice.height_prior
    if isinstance(prior, TerrainPrior):
        constants = predictor.model.ephemeris.constants
        return on_terrain(target_pa.xyz_m, prior.terrain, prior.sigma_m, constants)
    return on_sphere(target_pa.xyz_m, None if prior is None else (prior.height_m, prior.sigma_m))
