"""What a result says of its data and its model: sentences for the card, and the provenance of ``solution.json``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import ARCSEC_RAD
from radioloc.dynamics import AdjustableOrbit
from radioloc.earth.eop import EopTable
from radioloc.earth.eop_prediction import orientation_errors
from radioloc.earth.stations import Station
from radioloc.ephemeris import EphemerisConstants, Trajectory
from radioloc.ephemeris.trajectory import AdjustableTrajectory
from radioloc.errors import InputError
from radioloc.estimation.consider import ConsideredErrors
from radioloc.estimation.editing import EditedFit
from radioloc.kernels import sha256_of
from radioloc.lunar import cartesian_to_selenographic, rot_pa_to_me
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.chebyshev_predictor import ChebyshevPredictor
from radioloc.measurements.light_path import PLANETS_MM
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import kernel_record
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.prepared_paths import is_radio
from radioloc.measurements.terms import TERMS
from radioloc.media.csp import CHARGED, DRY, WET
from radioloc.parameters.choice import chosen_keys
from radioloc.parameters.parameter import ParameterSet
from radioloc.parameters.registry import PARAMETERS
from radioloc.results.cards import metres, plural
from radioloc.study.identity import spacecraft_doubts
from radioloc.study.orbiter import Orbiter
from radioloc.study.record import plain, study_origin, versions
from radioloc.study.study import EstimateChoice, Study, TerrainPrior

_EQUATOR_M_S = 465.1  # Speed of a station on the Earth's equator
_ROUGHER = 1.5
"""Ratio of the sigmas that a terrain's roughness gives here and there, from which on a note says so."""
_MAX_RELATIVE_OFFSET = 1e-4  # Relative frequency offset of a simple quartz oscillator
_OF_OBSERVATIONS = (
    "doppler_average_s",
    "extra_sigma_m",
    "vlbi_station_sigma_m",
    "vlbi_station_rate_sigma_m",
    "doppler_phase_sigma_m",
)
"""Keys of ``[observations]`` that a result repeats."""


def notes_of(
    study: Study,
    arc: Predictor,
    left_out: dict[str, int],
    estimate: EstimateChoice | None,
    fitted: EditedFit,
    lander_pa_m: NDArray[np.float64],
    considered: ConsideredErrors | None,
) -> list[str]:
    """All notes of a result, warnings first."""
    notes = spacecraft_doubts(study, arc.observations, arc.model)
    notes += _turned(study, arc.model.ephemeris.constants)
    if weights := study.observations.weights:
        notes.append(f"sigmas changed: {'; '.join(map(str, weights))}")
    parameters = fitted.fit.parameters
    if estimate is not None and isinstance(estimate.height_prior, TerrainPrior):
        notes += _terrain_doubt(arc, estimate.height_prior, parameters, lander_pa_m)
    notes += notes_of_plan(arc, left_out)
    if estimate is not None:
        in_sigma = any(estimate.ephemeris_sigma_m)
        if considered is not None:
            in_sigma |= any(map(considered.parameters.of_kind, ("moon_position", "libration")))
        if arc.trajectory is None and not in_sigma:
            notes.append(
                f"the sigma does not include the error of {arc.model.ephemeris.name}: neither moon_position nor "
                "libration is considered, and no [estimate] ephemeris_sigma_m is given"
            )
        if parameters.of_kind("frequency_offset") and "frequency_offset" not in study.estimate.parameters:
            notes.append(
                "a frequency offset of each link and pass of one- and three-way Doppler is estimated, as nothing ties "
                "its oscillators together; [estimate] frequency_offset says otherwise"
            )
        kinds = ("frequency_offset", "target_frequency")
        offsets = {parameters.names[k]: fitted.fit.x[k] for kind in kinds for k in parameters.of_kind(kind)}
        if far := [f"{name} {x:.2g}" for name, x in offsets.items() if abs(x) > _MAX_RELATIVE_OFFSET]:
            notes.append(
                f"no oscillator is as far off as {', '.join(far)}, but a nominal frequency or a turnaround ratio is: "
                "see transmit_hz and turnaround, or uplink_hz and wavelength_um"
            )
        notes += [
            f'no {key} is estimated, though [estimate] asks for "all": no observation depends on one'
            for key, choice in estimate.parameters.items()
            if choice.names == "all" and not parameters.of_kind(key)
        ]
    return notes


def notes_of_plan(arc: Predictor, left_out: dict[str, int]) -> list[str]:
    """Those of them that need no values: what was not selected, what is not known of stations and model."""
    not_selected = [
        f"{plural(count, 'observation')} not selected: {reason}" for reason, count in left_out.items()
    ]
    return [*not_selected, *_of_stations(arc), *_of_model(arc)]


def _turned(study: Study, constants: EphemerisConstants) -> Iterator[str]:
    """Positions in axes of another ephemeris."""
    places: dict[str, LunarPosition | Trajectory | Orbiter] = {"[target]": study.target}
    if study.targets:
        places = {f"[targets.{name}]": place for name, place in study.targets.items()}
    if study.reference is not None:
        places["[reference]"] = study.reference.position
    places |= {f"[references] {known.name}": known.position for known in study.references}
    for table, place in places.items():
        if isinstance(place, LunarPosition) and place.frame not in (
            f"PA_{constants.name}",
            constants.me_frame,
        ):
            yield (
                f"{table} is given in {place.frame} and was turned to axes of {constants.name} by "
                f"{constants.me_frame}, constant angles that leave some decimetres of what the librations differ by"
            )


def _terrain_doubt(
    arc: Predictor, prior: TerrainPrior, parameters: ParameterSet, lander_pa_m: NDArray[np.float64]
) -> Iterator[str]:
    """Where the terrain at the estimate is not as rough as at the a-priori position, which the prior's sigma is of."""
    longitude_rad, latitude_rad, _ = cartesian_to_selenographic(
        rot_pa_to_me(arc.model.ephemeris.constants) @ lander_pa_m
    )
    used_m = parameters["position.height_above_terrain"].prior_sigma
    try:
        here_m = float(prior.terrain.sigma_m(longitude_rad, latitude_rad, prior.sigma_m))
    except InputError as error:  # roughness takes more cells than a height
        yield f"WARNING: how rough the terrain is at the estimate is not known: {error}"
        return
    if not used_m / _ROUGHER < here_m < used_m * _ROUGHER:
        yield (
            f"WARNING: the a-priori sigma of the height above the terrain is {used_m:.3g} m, from the roughness at the "
            f"a-priori position; at the estimate it would be {here_m:.3g} m: use the estimate as [target] and fit again"
        )


def _radio_stations(arc: Predictor) -> list[Station]:
    """Stations of signals that are radio, whatever the kind that the catalogue gives them."""
    found = []
    for i, name in enumerate(arc.stations):
        station, rows = arc.model.catalogue.get(name), (arc.transmitters == i) | (arc.receivers == i)
        if is_radio(arc.observations.wavelength_um[rows], [station], np.array(0)).any():
            found.append(station)
    return found


def _of_stations(arc: Predictor) -> Iterator[str]:
    """What the catalogue does not know of stations, and what of the model this leaves out."""
    stations, radio = [arc.model.catalogue.get(name) for name in arc.stations], _radio_stations(arc)
    for term, lacking, text in (
        (
            "",
            [s.quality == "rounded" and s.sigma_m is None for s in stations],
            "catalogue positions of {} are rounded, good to 100 m to 1 km only; give better ones under "
            "[stations.NAME], or what they are good to as [consider] station_position_sigma_m",
        ),
        (
            "",
            [s.quality == "approximate" and s.sigma_m is None for s in stations],
            "catalogue positions of {} are good to about a metre only; give better ones under [stations.NAME]",
        ),
        (
            "station_velocity",
            [not s.velocity_known for s in stations],
            "no station velocity for {}: plate motion, some cm a year, is not modelled",
        ),
        (
            "ocean_loading",
            [s.ocean_loading is None for s in stations],
            "no ocean loading coefficients for {}: up to about 1 cm is not modelled",
        ),
        (
            "antenna_axis_offset",
            [s.axis_offset_m is None and s in radio for s in stations],
            "no antenna axis offset for {}: millimetres, of some antennas metres, are not modelled; "
            "give axis_offset_m and mount under [stations.NAME]",
        ),
    ):
        if any(lacking) and (not term or arc.model.has(term)):
            yield text.format(", ".join(compress(arc.stations, lacking)))


def _of_model(arc: Predictor) -> Iterator[str]:
    """What the model is made of, and what is not in it."""
    model = arc.model
    if predicted := int(arc.predicted_eop.sum()):
        yield f"Earth orientation is predicted, not measured, for {plural(predicted, 'observation')}"
    yield from _beyond(model.earth.table, arc.observations.epoch.mjd)
    if absent := model.missing_planets:
        sizes = " and ".join(f"{name.capitalize()} (up to {PLANETS_MM[name]:g} mm)" for name in absent)
        yield f"no gravitational delay by {sizes}, one way: not in the ephemeris file; use a complete one"
    radio = _radio_stations(arc)
    without = [station.name for station in radio]
    if (cards := model.media_calibrations) is not None:
        for term, kinds in (("troposphere", (DRY, WET)), ("ionosphere", (CHARGED,))):
            names = [s.name for s in radio if model.has(term) and any(cards.serves(s, k) for k in kinds)]
            if names:
                yield f"{term} of radio signals from calibrations of the DSN for {', '.join(names)}"
            for kind, air in ((DRY, "dry"), (WET, "wet")) if names and term == "troposphere" else ():
                if other := [s.name for s in radio if s.name in names and not cards.serves(s, kind)]:
                    yield f"the calibrations have no {air} air for {', '.join(other)}: it is the model's"
        without = [s.name for s in radio if not cards.serves(s, CHARGED)]
    if model.has("ionosphere") and model.ionosphere is None and without:
        of = f" for {', '.join(without)}" if len(without) < len(radio) else ""
        yield f"no ionospheric delay of radio signals{of}: give maps or a content, [model] ionex or tec_tecu"
    files = model.radio_atmosphere
    if model.has("troposphere") and files is not None:
        for source in ("VMF3", "GPT3"):
            served = ", ".join(station.name for station in radio if files.source_of(station) == source)
            if served:
                yield f"troposphere of radio signals from {source} for {served}, beside recorded pressure"
    if isinstance(arc.trajectory, AdjustableOrbit):
        yield from arc.trajectory.forces.gravity.notes
    if arc.trajectory is not None and not isinstance(arc.trajectory, AdjustableTrajectory):
        yield "the trajectory is taken as exact: its error is in the residuals, and in no sigma"
    if off := [name for name in TERMS if not model.has(name)]:
        yield f"terms switched off: {', '.join(off)}"


def _beyond(table: EopTable, mjd_utc: NDArray[np.float64]) -> Iterator[str]:
    """How Earth orientation goes on after its table, and how wrong that may be."""
    end = float(mjd_utc.max(initial=0.0))
    if table.beyond is not None and end > table.beyond[1]:
        (ut1_s,), (pole_rad,) = orientation_errors(table, np.array([end]))
        yield (
            f"Earth orientation is {table.sources[-1]}: at the end of the arc UT1 may be off by {metres(ut1_s)} s "
            f"({metres(_EQUATOR_M_S * ut1_s)} m at the equator), the pole by "
            f"{1e3 * pole_rad / ARCSEC_RAD:.3g} milliarcseconds (1 sigma)"
        )


def provenance(
    study: Study,
    arc: Predictor,
    left_out: dict[str, int],
    estimate: EstimateChoice | None,
    positions_pa_m: NDArray[np.float64],
) -> dict[str, Any]:
    """Versions, files, choices and kernels of a fit, and how its observations were computed at the positions found."""
    evaluation: dict[str, Any] = {"kind": "exact"}
    if isinstance(simple := arc.simple, ChebyshevPredictor):
        evaluation = {"kind": "interpolated", **asdict(simple.check(positions_pa_m))}
    model, chosen = arc.model, study.model
    height = None if estimate is None else estimate.height_prior
    one_each = {"vmf3_orography": chosen.vmf3_orography, "gpt3": chosen.gpt3}
    of_air = {"vmf3": chosen.vmf3} | {key: () if path is None else (path,) for key, path in one_each.items()}
    return {
        **versions(),
        "study": study_origin(study) if _of_its_files(study, arc.observations) else None,
        "files": [Path(name).name for name in arc.observations.files],
        "images": sorted({key for prior in study.estimate.position_priors for key in prior.data}),
        "not_selected": left_out,
        **{key: getattr(study.observations, key) for key in _OF_OBSERVATIONS},
        "weights": [weight.record() for weight in study.observations.weights],
        "estimate": None if estimate is None else _estimate_record(estimate),
        "terrain_resolution_m": height.terrain.metadata.resolution_m
        if isinstance(height, TerrainPrior)
        else None,
        **_target_record(study.target),
        "ionosphere": {"ionex": [path.name for path in chosen.ionex], "tec_tecu": chosen.tec_tecu},
        "troposphere": {key: _named(paths) for key, paths in of_air.items()},
        "sources": _named(chosen.sources),
        "free_clocks": list(model.free_clocks),
        "media_calibrations": {"csp": _named(chosen.csp), "scid": chosen.csp_scid},
        "delays": {
            "transponder_s": model.delays.transponder_s,
            "stations": {name: asdict(delay) for name, delay in model.delays.stations.items()},
        },
        **model.provenance(),
        "evaluation": evaluation,
        "extensions": plain(study.extensions),
    }


def _named(files: Iterable[Path]) -> list[dict[str, str]]:
    return [{"name": path.name, "sha256": sha256_of(path)} for path in files]


def _of_its_files(study: Study, observations: Observations) -> bool:
    """Whether the study is from a file, and the observations are from its files, not given in Python."""
    return (
        study.path is not None
        and bool(observations.files)
        and set(observations.files) <= set(map(str, study.observations.files))
    )


def _target_record(target: LunarPosition | Trajectory | Orbiter) -> dict[str, Any]:
    if isinstance(target, Orbiter):
        return {"a_priori": target.record(), "trajectory": None}
    if isinstance(target, Trajectory):
        return {
            "a_priori": None,
            "trajectory": {"body": target.body, **kernel_record(target.kernel, target.name)},
        }
    return {"a_priori": {"frame": target.frame, "xyz_m": target.xyz_m.tolist()}, "trajectory": None}


def _estimate_record(estimate: EstimateChoice) -> dict[str, Any]:
    """What was estimated; of a terrain map its files, not its heights."""
    prior: Any = estimate.height_prior
    if isinstance(prior, TerrainPrior):
        map_files = [{"name": file.path.name, "sha256": file.sha256} for file in prior.terrain.metadata.files]
        prior = {"dem": map_files, "interpolation": prior.terrain.interpolation, "sigma_m": prior.sigma_m}
    elif prior is not None:
        prior = asdict(prior)
    noise = None if estimate.orbit is None else estimate.orbit.process_noise
    keys = (
        "position",
        "height_prior",
        "ephemeris_sigma_m",
        "rejection_sigma",
        "weights",
        "variance_components",
    )
    return {
        **{key: getattr(estimate, key) for key in keys},
        "height_prior": prior,
        "process_noise": None if noise is None else asdict(noise),
        "pass_gap_h": estimate.pass_gap_h,
        **dict.fromkeys(PARAMETERS, "none"),
        **chosen_keys(estimate.parameters),
    }
