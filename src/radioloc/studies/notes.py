"""What a reader of a result must know about its data and its model: sentences for the card."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.estimation.variance_components import NoisyFit
from radioloc.lunar import cartesian_to_selenographic, rot_pa_to_me
from radioloc.measurements.gravitational_delay import PLANETS_MM
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import KINDS
from radioloc.measurements.terms import TERMS
from radioloc.parameters.parameter import ParameterSet
from radioloc.studies.study import HEIGHT_LIMITS_M, EstimateChoice, Study, TerrainPrior
from radioloc.studies.weights import Weight

_DOUBTFUL = 20.0
"""Additive noise in stated sigmas that model errors no longer explain; laser ranges of DE421's time ask for 5."""
_ROUGHER = 1.5
"""Ratio of the sigmas that a terrain's roughness gives here and there, from which on a note says so."""


def notes_of(
    study: Study,
    arc: Predictor,
    left_out: dict[str, int],
    estimate: EstimateChoice | None,
    fitted: NoisyFit,
    lander_pa_m: NDArray[np.float64],
) -> list[str]:
    """All notes of a result, warnings first."""
    return [
        *_doubts(fitted, arc.observations),
        *(_height_doubt(lander_pa_m) if arc.trajectory is None else []),
        *_weights_note(study.observations.weights),
        *(_terrain_doubt(arc, estimate, fitted.edited.fit.parameters, lander_pa_m)),
        *_of_data_and_model(arc.model, arc, left_out, estimate),
        *([] if estimate is None else _without_scope(estimate, fitted.edited.fit.parameters)),
    ]


def _without_scope(estimate: EstimateChoice, parameters: ParameterSet) -> list[str]:
    """Parameters that were asked for of all stations, and that no observation depends on."""
    none = [
        key
        for key, choice in estimate.parameters.items()
        if choice.names == "all" and not parameters.of_kind(key)
    ]
    return [
        f'no {key} is estimated, though [estimate] asks for "all": no observation depends on one'
        for key in none
    ]


def _height_doubt(lander_pa_m: NDArray[np.float64]) -> list[str]:
    """A warning where the point is above or below all of the Moon's terrain."""
    height_m = float(np.linalg.norm(lander_pa_m)) - MEAN_LUNAR_RADIUS_M
    low_m, high_m = HEIGHT_LIMITS_M
    if low_m <= height_m <= high_m:
        return []
    return [
        f"WARNING: a height of {height_m / 1e3:.0f} km is outside the Moon's terrain (-9.2 to 10.8 km): look at the "
        "sigma; an a-priori height, or a-priori sigmas of biases, may be needed"
    ]


def _terrain_doubt(
    arc: Predictor,
    estimate: EstimateChoice | None,
    parameters: ParameterSet,
    lander_pa_m: NDArray[np.float64],
) -> list[str]:
    """Where the terrain at the estimate is not as rough as at the a-priori position, which the prior's sigma is of."""
    if estimate is None or not isinstance(estimate.height_prior, TerrainPrior):
        return []
    prior = estimate.height_prior
    longitude_rad, latitude_rad, _ = cartesian_to_selenographic(
        rot_pa_to_me(arc.model.ephemeris.constants) @ lander_pa_m
    )
    used_m = parameters["position.height_above_terrain"].prior_sigma
    try:
        here_m = float(prior.terrain.sigma_m(longitude_rad, latitude_rad, prior.sigma_m))
    except InputError as error:  # roughness takes more cells than a height
        return [f"WARNING: how rough the terrain is at the estimate is not known: {error}"]
    if used_m / _ROUGHER < here_m < used_m * _ROUGHER:
        return []
    return [
        f"WARNING: the a-priori sigma of the height above the terrain is {used_m:.3g} m, from the roughness at the "
        f"a-priori position; at the estimate it would be {here_m:.3g} m: use the estimate as [target] and fit again"
    ]


def _doubts(noise: NoisyFit, observations: Observations) -> list[str]:
    """Warnings where data of a type and model disagree by far more than the data's own noise."""
    doubts = []
    for kind, added_m in noise.additive_sigma_m.items():
        typical_m = float(np.median(observations.sigma_m[observations.kind == KINDS.index(kind)]))
        if added_m > _DOUBTFUL * typical_m:
            doubts.append(
                f"WARNING: the {kind} residuals are {added_m / typical_m:.0f} times the stated sigmas; data and model "
                "disagree: look for outliers (hard to tell among few), a wrong station or target, a term switched off"
            )
    return doubts


def _weights_note(weights: tuple[Weight, ...]) -> list[str]:
    return [f"sigmas changed: {'; '.join(map(str, weights))}"] if weights else []


def _of_data_and_model(
    model: PhysicalModel, arc: Predictor, left_out: dict[str, int], estimate: EstimateChoice | None
) -> list[str]:
    """What a reader of the result must know about the model and the data."""
    notes = [f"{_count(count)} not selected: {reason}" for reason, count in left_out.items()]
    stations = [model.catalogue.get(name) for name in arc.stations]
    coarse = [s.name for s in stations if s.quality != "survey"]
    if coarse:
        notes.append(f"catalogue positions of {', '.join(coarse)} are rounded, good to 100 m to 1 km only")
    unmoved = [s.name for s in stations if not s.velocity_known]
    if unmoved and model.has("station_velocity"):
        notes.append(
            f"no station velocity for {', '.join(unmoved)}: plate motion, some cm a year, is not modelled"
        )
    unloaded = [s.name for s in stations if s.ocean_loading is None]
    if unloaded and model.has("ocean_loading"):
        notes.append(
            f"no ocean loading coefficients for {', '.join(unloaded)}: up to about 1 cm is not modelled"
        )
    aside = [s.name for s in stations if s.axis_offset_m is None and s.kind != "llr"]
    if aside and model.has("antenna_axis_offset"):
        notes.append(
            f"no antenna axis offset for {', '.join(aside)}: millimetres, of some antennas metres, are not modelled; "
            "give axis_offset_m and mount under [stations.NAME]"
        )
    predicted = int(arc.predicted_eop.sum())
    if predicted:
        notes.append(f"Earth orientation is predicted, not measured, for {_count(predicted)}")
    absent = model.missing_planets
    if absent:
        sizes = " and ".join(f"{name.capitalize()} (up to {PLANETS_MM[name]:g} mm)" for name in absent)
        notes.append(
            f"no gravitational delay by {sizes}, one way: not in the ephemeris file; use a complete one"
        )
    laser = all(station.kind == "llr" for station in stations)
    if model.has("ionosphere") and model.ionosphere is None and not laser:
        notes.append(
            "no ionospheric delay of radio signals: give maps or a content, [model] ionex or tec_tecu"
        )
    files = model.radio_atmosphere
    if model.has("troposphere") and files is not None and not laser:
        radio = [station for station in stations if station.kind != "llr"]
        for source in ("VMF3", "GPT3"):
            served = [station.name for station in radio if files.source_of(station) == source]
            if served:
                notes.append(
                    f"troposphere of radio signals from {source} for {', '.join(served)}, beside recorded pressure"
                )
    if arc.trajectory is not None:
        notes.append("the trajectory is taken as exact: its error is in the residuals, and in no sigma")
    off = [name for name in TERMS if not model.has(name)]
    if off:
        notes.append(f"terms switched off: {', '.join(off)}")
    if estimate is not None and arc.trajectory is None and not any(estimate.ephemeris_sigma_m):
        notes.append(
            f"the sigma does not include the error of {model.ephemeris.name}; give it as "
            "[estimate] ephemeris_sigma_m = [east, north, up]"
        )
    return notes


def _count(count: int) -> str:
    return f"{count} observation{'' if count == 1 else 's'}"
