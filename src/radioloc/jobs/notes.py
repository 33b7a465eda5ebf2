"""Notes of a result on its data and model, and its provenance: versions, files and settings that reproduce it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.constants import ARCSEC_RAD
from radioloc.earth.eop import EopTable
from radioloc.earth.eop_prediction import orientation_errors
from radioloc.earth.stations import Station
from radioloc.estimation.consider import owner
from radioloc.estimation.editing import EditedFit
from radioloc.jobs.problem import EstimationProblem
from radioloc.kernels.files import sha256_of
from radioloc.measurements.chebyshev_predictor import ChebyshevPredictor
from radioloc.measurements.evaluation import second_tropospheres
from radioloc.measurements.light_path import PLANETS_MM
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import TERMS, PhysicalModel, kernel_record
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.prepared_paths import is_radio
from radioloc.measurements.target_motion import Motions
from radioloc.media.csp import CHARGED, DRY, WET
from radioloc.parameters.choice import chosen_keys
from radioloc.parameters.parameter import Parameter, ParameterSet, Role
from radioloc.parameters.registry import PARAMETERS
from radioloc.results.cards import metres, plural
from radioloc.study.identity import spacecraft_doubts
from radioloc.study.record import plain, study_origin, versions
from radioloc.study.study import EstimateChoice, Study, TerrainPrior
from radioloc.targets.design import a_priori_orbits
from radioloc.time import utc_strings
from radioloc.vectors import Floats

_EQUATOR_M_S = 465.1  # speed of a station on the Earth's equator
# part of the squared residuals by motion within intervals of process noise; beyond it sigmas are 1.8 times too small
_MAX_PROCESS_PART = 0.5
_MAX_RELATIVE_OFFSET = 1e-4  # relative frequency offset of a simple quartz oscillator
_NOTED_TERMS = ("ionosphere", "troposphere")  # electron content is considered, and a zenith delay has a note
_RECORDED_KEYS = (
    "doppler_average_s",
    "normal_point_s",
    "extra_sigma_m",
    "vlbi_station_sigma_m",
    "vlbi_station_rate_sigma_m",
    "doppler_phase_sigma_m",
)
"""Keys of ``[observations]`` in the provenance."""


def study_notes(
    problem: EstimationProblem,
    predictor: Predictor,
    not_selected: dict[str, int],
    fitted: EditedFit,
    considered: ParameterSet,
) -> list[str]:
    """Return all notes of a result, warnings first."""
    study, estimate = problem.study, problem.choice
    notes = spacecraft_doubts(study, predictor.observations, predictor.model)
    if weights := study.observations.weights:
        notes.append(f"sigmas changed: {'; '.join(map(str, weights))}")
    if terms := [f"{name} ({TERMS[name]})" for name in study.model.off if name not in _NOTED_TERMS]:
        notes.append(f"switched off by [model] off, and not in the sigmas: {', '.join(terms)}")
    parameters = fitted.fit.parameters
    estimated = {item.kind for item in parameters if item.role is not Role.CONSIDERED}
    notes += planning_notes(predictor, not_selected, [*parameters, *considered])
    if problem.is_fixed:
        return notes
    kinds = {item.kind for item in considered}
    in_sigma = any(estimate.ephemeris_sigma_m) or "moon_position" in kinds or "libration" in kinds
    if not predictor.trajectories and not in_sigma:
        notes.append(
            f"the sigma does not include the error of {predictor.model.ephemeris.name}: neither moon_position nor "
            "libration is considered, and no [estimate] ephemeris_sigma_m is given"
        )
    notes += _frequency_notes(study, fitted)
    notes += _process_notes(predictor, estimate, fitted)
    notes += [
        f'no {key} is estimated, though [estimate] asks for "all": no observation depends on it'
        for key, choice in estimate.parameters.items()
        if choice.names == "all" and key not in estimated
    ]
    return notes


def _process_notes(predictor: Predictor, estimate: EstimateChoice, fitted: EditedFit) -> Iterator[str]:
    """Yield a note on intervals of stochastic accelerations in which the velocity varies more than Doppler allows."""
    noise = None if estimate.orbit is None else estimate.orbit.process_noise
    observations = predictor.observations
    counts = fitted.fit.used & (observations.count_s > 0.0)
    if noise is None or not counts.any():
        return
    ways = np.array([2.0 if link.transmitter else 1.0 for link in observations.links])[observations.link]
    rates_m_s = fitted.fit.residual_m[counts] / (observations.count_s * ways)[counts]
    rms_m_s, within_m_s = float(np.sqrt(np.mean(rates_m_s**2))), noise.velocity_within_m_s
    if within_m_s**2 > _MAX_PROCESS_PART * rms_m_s**2:
        yield (
            f"within the intervals of the stochastic accelerations, {noise.interval_s:g} s, the velocity varies by "
            f"{1e3 * within_m_s:.2g} mm/s, and the residuals are {1e3 * rms_m_s:.2g} mm/s (rms, one way): errors are "
            "correlated, and the sigmas of the orbit are too small. Give a shorter interval_s, and sigmas larger by "
            "the square root of the ratio"
        )


def _frequency_notes(study: Study, fitted: EditedFit) -> Iterator[str]:
    """Yield notes on frequency offsets that are added, or that are too large for an oscillator."""
    parameters = fitted.fit.parameters
    estimated = {item.kind for item in parameters if item.role is not Role.CONSIDERED}
    if "frequency_offset" in estimated and "frequency_offset" not in study.estimate.parameters:
        yield (
            "a frequency offset of each link and pass of one- and three-way Doppler is estimated, as their oscillators "
            "are independent; [estimate] frequency_offset changes this"
        )
    offsets = [k for kind in ("frequency_offset", "target_frequency") for k in parameters.of_kind(kind)]
    if large := [
        f"{parameters.names[k]} {fitted.fit.x[k]:.2g}"
        for k in offsets
        if abs(fitted.fit.x[k]) > _MAX_RELATIVE_OFFSET
    ]:
        yield (
            f"{', '.join(large)}: larger than the offset of any oscillator; check the nominal frequency and the "
            "turnaround ratio (transmit_hz and turnaround, or uplink_hz and wavelength_um)"
        )


def planning_notes(
    predictor: Predictor, not_selected: dict[str, int], parameters: Iterable[Parameter]
) -> list[str]:
    """Return the notes that need no values: observations not selected, data that the user can improve.

    `parameters` are those of the fit, with the considered ones.
    """
    notes = [
        f"{plural(count, 'observation')} not selected: {reason}" for reason, count in not_selected.items()
    ]
    return [*notes, *_position_notes(predictor, parameters), *_model_notes(predictor)]


def model_limitations(predictor: Predictor) -> tuple[str, ...]:
    """Return the effects that are not modelled and the sources of the model; they require no action."""
    return (*_unmodelled_effects(predictor), *_model_sources(predictor))


def _radio_stations(predictor: Predictor) -> list[Station]:
    """Return the stations with radio signals, whatever their kind in the catalogue."""
    stations = []
    for i, name in enumerate(predictor.stations):
        station = predictor.model.catalogue.get(name)
        rows = (predictor.transmitters == i) | (predictor.receivers == i)
        if is_radio(predictor.observations.wavelength_um[rows], [station], np.array(0)).any():
            stations.append(station)
    return stations


def _position_notes(predictor: Predictor, parameters: Iterable[Parameter]) -> Iterator[str]:
    """Yield the stations whose catalogue coordinates are rounded or approximate, with their sigmas."""
    positions = [item for item in parameters if item.kind == "station_position"]
    considered_m = {owner(item): item.prior_sigma for item in positions if item.role is Role.CONSIDERED}
    estimated = {owner(item) for item in positions} - considered_m.keys()
    groups: dict[tuple[float, float], list[Station]] = {}
    unstated = [
        item for item in map(predictor.model.catalogue.get, predictor.stations) if item.sigma_m is None
    ]
    for station in unstated:
        if station.quality == "rounded" and station.name not in estimated:
            sigmas_m = considered_m.get(station.name, 0.0), station.position_sigma_m
            groups.setdefault(sigmas_m, []).append(station)
    for (sigma_m, default_m), stations in groups.items():
        considered = (
            f"the sigma considered is {metres(sigma_m)} m a coordinate"
            if sigma_m
            else "no sigma is considered"
        )
        text = f"catalogue positions of {_names(stations)} are rounded to 100 m to 1 km; {considered}"
        if sigma_m in (0.0, default_m):
            text += ": give better ones under [stations.NAME], or [consider] station_position_sigma_m"
        yield text
    if approximate := [item for item in unstated if item.quality == "approximate"]:
        yield (
            f"catalogue positions of {_names(approximate)} are accurate to about a metre only; "
            "give better ones under [stations.NAME]"
        )


def _model_notes(predictor: Predictor) -> Iterator[str]:
    model = predictor.model
    simple = predictor.uncombined
    yield from second_tropospheres(model, simple.observations, simple.motions, simple.targets)
    if predicted := int(predictor.predicted_eop.sum()):
        yield f"Earth orientation is predicted, not measured, for {plural(predicted, 'observation')}"
    yield from _extrapolation_note(model.earth.table, predictor.observations.epoch.mjd)
    radio = _radio_stations(predictor)
    if (cards := model.media_calibrations) is not None:
        for term, kinds in _CALIBRATIONS.items():
            served = _calibrated(model, radio, term)
            for kind, part in kinds.items():
                if missing := [s for s in served if not cards.has_cards(s, kind)]:
                    yield f"no calibration of the {part} {term} for {_names(missing)}; the model's is used"
    uncalibrated = radio if cards is None else [s for s in radio if not cards.has_cards(s, CHARGED)]
    if model.has("ionosphere") and model.ionosphere is None and uncalibrated:
        stations = f" for {_names(uncalibrated)}" if len(uncalibrated) < len(radio) else ""
        yield f"no ionospheric delay of radio signals{stations}: give maps or a content, [model] ionex or tec_tecu"
    orbits = a_priori_orbits(predictor)
    yield from dict.fromkeys(note for orbit in orbits for note in orbit.forces.gravity.notes)
    if any(motion.trajectory is not None and motion.adjustable is None for motion in predictor.motions):
        yield "the trajectory is taken as exact: its error is in the residuals, and in no sigma"


def _unmodelled_effects(predictor: Predictor) -> Iterator[str]:
    """Yield the effects without data of some stations."""
    model, stations = predictor.model, [predictor.model.catalogue.get(name) for name in predictor.stations]
    still = [item for item in stations if not item.velocity_known]
    if still and model.has("station_velocity"):
        yield f"no station velocity for {_names(still)}: plate motion, some cm a year, is not modelled"
    unloaded = [item for item in stations if item.ocean_loading is None]
    if unloaded and model.has("ocean_loading"):
        yield f"no ocean loading coefficients for {_names(unloaded)}: up to about 1 cm is not modelled"
    without_offset = [item for item in _radio_stations(predictor) if item.axis_offset_m is None]
    if without_offset and model.has("antenna_axis_offset"):
        yield (
            f"no antenna axis offset for {_names(without_offset)}: millimetres, of some antennas metres, are not "
            "modelled"
        )


def _model_sources(predictor: Predictor) -> Iterator[str]:
    """Yield the terms that the model does not contain, and the sources of its media."""
    model, radio = predictor.model, _radio_stations(predictor)
    if absent := model.missing_planets:
        sizes = " and ".join(f"{name.capitalize()} (up to {PLANETS_MM[name]:g} mm)" for name in absent)
        yield f"no gravitational delay by {sizes}, one way: not in the ephemeris file; use a complete one"
    if off := [name for name in TERMS if not model.has(name)]:
        yield f"terms switched off: {', '.join(off)}"
    for term in _CALIBRATIONS if model.media_calibrations is not None else ():
        if served := _calibrated(model, radio, term):
            yield f"{term} of radio signals from calibrations of the DSN for {_names(served)}"
    if model.has("troposphere") and (files := model.radio_atmosphere) is not None:
        for source in ("VMF3", "GPT3"):
            if served := [s for s in radio if files.source_of(s) == source]:
                yield f"troposphere of radio signals from {source} for {_names(served)}, beside recorded pressure"


_CALIBRATIONS = {"troposphere": {DRY: "dry", WET: "wet"}, "ionosphere": {CHARGED: "charged"}}


def _calibrated(model: PhysicalModel, radio: list[Station], term: str) -> list[Station]:
    """Return the stations with a calibration of any part of a medium."""
    cards = model.media_calibrations
    if cards is None or not model.has(term):
        return []
    return [s for s in radio if any(cards.has_cards(s, kind) for kind in _CALIBRATIONS[term])]


def _names(stations: Iterable[Station]) -> str:
    return ", ".join(station.name for station in stations)


def _extrapolation_note(table: EopTable, mjd_utc: Floats) -> Iterator[str]:
    """Yield the error of Earth orientation that is extrapolated beyond its table."""
    end = float(mjd_utc.max(initial=0.0))
    if table.beyond is not None and end > table.beyond[1]:
        (ut1_s,), (pole_rad,) = orientation_errors(table, np.array([end]))
        yield (
            f"Earth orientation is {table.sources[-1]}: at the end of the arc UT1 may be off by {metres(ut1_s)} s "
            f"({metres(_EQUATOR_M_S * ut1_s)} m at the equator), the pole by "
            f"{1e3 * pole_rad / ARCSEC_RAD:.3g} milliarcseconds (1 sigma)"
        )


def provenance(
    problem: EstimationProblem, predictor: Predictor, not_selected: dict[str, int], motions: Motions
) -> dict[str, Any]:
    """Return versions, files, choices and kernels of a fit, and how observations at its estimate were computed."""
    study, height = problem.study, problem.choice.height_prior
    evaluation: dict[str, Any] = {"kind": "exact"}
    if isinstance(simple := predictor.uncombined, ChebyshevPredictor):
        evaluation = {"kind": "interpolated", **asdict(simple.check(motions))}
    model, chosen = predictor.model, study.model
    single_files = {"vmf3_orography": chosen.vmf3_orography, "gpt3": chosen.gpt3}
    troposphere = {"vmf3": chosen.vmf3} | {
        key: () if path is None else (path,) for key, path in single_files.items()
    }
    return {
        **versions(),
        "study": study_origin(study) if _is_reproducible(study, predictor.observations) else None,
        "files": [Path(name).name for name in predictor.observations.files],
        "images": sorted({key for prior in study.estimate.position_priors for key in prior.data}),
        "not_selected": not_selected,
        **{key: getattr(study.observations, key) for key in _RECORDED_KEYS},
        "weights": [weight.record() for weight in study.observations.weights],
        "estimate": None if problem.is_fixed else _estimate_record(problem.choice),
        "terrain_resolution_m": height.terrain.metadata.resolution_m
        if isinstance(height, TerrainPrior)
        else None,
        **_target_record(study),
        "ionosphere": {"ionex": [path.name for path in chosen.ionex], "tec_tecu": chosen.tec_tecu},
        "troposphere": {key: _file_records(paths) for key, paths in troposphere.items()},
        "sources": _file_records(chosen.sources),
        "free_clocks": list(model.free_clocks),
        "media_calibrations": {"csp": _file_records(chosen.csp), "scid": chosen.csp_scid},
        "delays": {
            "transponder_s": model.delays.transponder_s,
            "stations": {name: asdict(delay) for name, delay in model.delays.stations.items()},
        },
        **model.provenance(),
        "evaluation": evaluation,
        "extensions": plain(study.extensions),
    }


def _file_records(files: Iterable[Path]) -> list[dict[str, str]]:
    return [{"name": path.name, "sha256": sha256_of(path)} for path in files]


def _is_reproducible(study: Study, observations: Observations) -> bool:
    """Return whether study and observations both come from the files that the study names."""
    return (
        study.path is not None
        and bool(observations.files)
        and set(observations.files) <= set(map(str, study.observations.files))
    )


def _target_record(study: Study) -> dict[str, Any]:
    """Return the a-priori state of the first orbiter, or position of the first point, and the known trajectory."""
    trajectory, point = next(iter(study.trajectories.values()), None), next(iter(study.points.values()), None)
    apriori = None if point is None else {"frame": point.frame, "xyz_m": point.xyz_m.tolist()}
    if study.orbiter is not None:
        apriori = study.orbiter.record()
    elif study.described and point is None:
        apriori = plain(next(iter(study.described.values())))
    record: dict[str, Any] | None = None
    if trajectory is not None:
        record = {"body": trajectory.body, **kernel_record(trajectory.kernel, trajectory.name)}
    return {"a_priori": apriori, "trajectory": record}


def _estimate_record(estimate: EstimateChoice) -> dict[str, Any]:
    """Return the settings of an estimate, with the files of a terrain map in place of its heights."""
    prior: Any = estimate.height_prior
    if isinstance(prior, TerrainPrior):
        files = [{"name": file.path.name, "sha256": file.sha256} for file in prior.terrain.metadata.files]
        prior = {"dem": files, "interpolation": prior.terrain.interpolation, "sigma_m": prior.sigma_m}
    elif prior is not None:
        prior = asdict(prior)
    noise = None if estimate.orbit is None else estimate.orbit.process_noise
    keys = "position", "ephemeris_sigma_m", "rejection_sigma", "weights", "variance_components", "pass_gap_h"
    return {
        **{key: getattr(estimate, key) for key in keys},
        "clock_epoch": None if estimate.clock_epoch is None else utc_strings(estimate.clock_epoch, 9)[0],
        "height_prior": prior,
        "process_noise": None if noise is None else asdict(noise),
        **dict.fromkeys(PARAMETERS, "none"),
        **chosen_keys(estimate.parameters),
    }
