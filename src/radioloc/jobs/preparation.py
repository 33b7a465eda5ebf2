"""Preparation of an arc: the model, the observations that take part, and the predictor; nothing is estimated."""

from __future__ import annotations

import logging
import math
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.dynamics import AdjustableOrbit
from radioloc.ephemeris import EphemerisConstants
from radioloc.errors import CoverageError, DataQualityWarning, FileFormatError, InputError, require_type
from radioloc.estimation.statistics import without_figures
from radioloc.io.formats import ReadSettings, read_files, read_in_parts
from radioloc.jobs.normal_points import IntervalSums, interval_sums
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.selection import (
    require_targets,
    select_observations,
    selected,
    targets_of,
    with_target_names,
)
from radioloc.jobs.study_targets import position_in_pa, targets_in_pa
from radioloc.labels import USED, Labels
from radioloc.lunar.frames import earth_elevation_rad
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.link import canonical_target
from radioloc.measurements.observations import Observations, without_duplicates
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Predictor, blocks, reasons
from radioloc.measurements.quantised import with_rounding_in_sigmas
from radioloc.measurements.registry import is_integrated
from radioloc.measurements.sources import read_sources
from radioloc.measurements.target_motion import MotionLike, Motions, OrbitMotion
from radioloc.media.csp import read_csp
from radioloc.media.ionex import read_ionex
from radioloc.media.ionosphere import UniformTec
from radioloc.media.medium import Status
from radioloc.media.radio_atmosphere import RadioAtmosphere, read_radio_atmosphere
from radioloc.parameters.registry import PARAMETERS
from radioloc.progress import step
from radioloc.study.identity import spacecraft_doubts
from radioloc.study.observation_choice import require_stations, weighted_observations, with_uplinks
from radioloc.study.study import ModelChoice, Study
from radioloc.study.study_file import as_study
from radioloc.targets.doubts import MIN_EARTH_ELEVATION_DEG
from radioloc.targets.target import TargetDescription, declared_motion
from radioloc.time import Epochs, tt_to_tdb, utc_to_tt
from radioloc.time.smooth import evaluate_smooth
from radioloc.vectors import Floats, Indices

_ROWS_AT_ONCE = 2**20  # of observations that are condensed; takes some 400 MB
_EARTH_ELEVATION_MARGIN_DEG = 1.0  # change of the Earth's elevation between two of the epochs six hours apart


def usability(predictor: Predictor, motions: Motions | None = None) -> tuple[Labels, NDArray[np.int8]]:
    """Return why observations cannot be used for motions, by default those of the arc, as text and by code."""
    motions = predictor.motions if motions is None else motions
    prediction, model, epoch = predictor.predict(motions), predictor.model, predictor.observations.epoch
    # The Moon hides spacecraft in the predictions themselves.
    earth_elevation = {
        k: partial(earth_elevation_rad, model.ephemeris, model.libration, point_pa_m=motion.position_pa_m)
        for k, motion in enumerate(motions)
        if motion.trajectory is None
    }
    limit_deg = MIN_EARTH_ELEVATION_DEG + _EARTH_ELEVATION_MARGIN_DEG
    low_targets = [k for k, elevation in earth_elevation.items() if _min_deg(elevation, epoch) < limit_deg]
    codes = np.zeros(len(predictor.observations), dtype=np.int8)
    labels = np.zeros(len(predictor.observations), dtype=np.int32)
    label_numbers = {USED: 0}
    for rows in blocks(predictor):
        computed = prediction.rows(rows)
        bad = np.flatnonzero(~computed.usable)
        codes[rows[bad]], sentences = reasons(predictor, computed.rows(bad), rows[bad])
        texts, inverse = np.unique(sentences, return_inverse=True)
        numbers = [label_numbers.setdefault(str(text), len(label_numbers)) for text in texts]
        labels[rows[bad]] = np.array(numbers, dtype=np.int32)[inverse]
        for target in low_targets:
            target_rows = rows[(predictor.target[rows] == target) & (codes[rows] == Status.OK)]
            # The Earth moves in the lander's sky with the librations, in days.
            tdb = tt_to_tdb(utc_to_tt(epoch[target_rows]))
            elevation_deg = np.degrees(evaluate_smooth(earth_elevation[target], tdb))
            for k in np.flatnonzero(elevation_deg < MIN_EARTH_ELEVATION_DEG):
                text = Status.EARTH_BELOW_HORIZON.text(elevation_deg[k])
                codes[target_rows[k]] = Status.EARTH_BELOW_HORIZON
                labels[target_rows[k]] = label_numbers.setdefault(text, len(label_numbers))
    return Labels(labels, tuple(label_numbers)), codes


def _min_deg(elevation_rad: Callable[[Epochs], Floats], epoch_utc: Epochs) -> float:
    """Return the lowest elevation of the Earth every six hours, in which it moves half a degree."""
    if not len(epoch_utc):
        return math.inf
    ends = epoch_utc[[int(epoch_utc.mjd.argmin()), int(epoch_utc.mjd.argmax())]]
    first, last = (tt_to_tdb(utc_to_tt(ends))[[k]] for k in (0, 1))
    span_d = last.seconds_since(first)[0] / SECONDS_PER_DAY
    count = int(4.0 * span_d) + 2
    if count > len(epoch_utc):
        return -math.inf
    epochs = Epochs.from_jd(first.jd, first.fraction + np.linspace(0.0, span_d, count), "TDB")
    return float(np.degrees(elevation_rad(epochs).min()))


logger = logging.getLogger(__name__)


def prepare_arc(
    study: Study | str | Path, observations: Observations | None = None, model: PhysicalModel | None = None
) -> Predictor:
    """Return the prepared arc of a study, at its a-priori positions or trajectory, for predictions and tables of terms.

    Parameters and errors as :func:`radioloc.locate`.

    Examples
    --------
    >>> import radioloc
    >>> arc = radioloc.jobs.prepare_arc("examples/apollo15/apollo15.toml")
    >>> arc.compute().by_position_pa.shape
    (153, 3)
    """
    return prepared_arc(with_model_of_caller(as_study(study), model), observations, model=model)[0]


def with_model_of_caller(study: Study, model: PhysicalModel | None) -> Study:
    """Return the study for a model of the caller: with its stations, and without a file that would reproduce it."""
    return study if model is None else replace(study, catalogue=model.catalogue, path=None)


@on_one_blas_thread()
def prepared_arc(
    study: Study,
    observations: Observations | None = None,
    orbits: Mapping[str, AdjustableOrbit] | None = None,
    model: PhysicalModel | None = None,
) -> tuple[Predictor, dict[str, int]]:
    """Return the prepared arc of a study, and the number of observations that were not asked for, by reason.

    The a-priori `orbits` of targets over all of them, by name, are not integrated anew.
    """
    model = build_model(study) if model is None else model
    places = targets_in_pa(study, model)
    known_positions(study, model.ephemeris.constants)  # refuses wrong frames before the work
    if study.observations.normal_point_s is None:
        chosen, left_out = chosen_observations(study, observations, model)
    else:
        points, rejected = _normal_points(study, observations, model, places)
        chosen, left_out = _chosen(study, points, model)
        left_out = dict(Counter(rejected) + Counter(left_out))
    with step(f"preparing {len(chosen)} observations"):
        predictor = _arc(study, model, chosen, places, orbits or {})
    logger.info("prepared the model for %d observations by %s", len(chosen), ", ".join(predictor.stations))
    _require_tracked(study, predictor)
    return predictor, left_out


def planned_arc(
    study: Study, planned: Observations, model: PhysicalModel, orbits: Mapping[str, AdjustableOrbit]
) -> tuple[Predictor, dict[str, int], Indices]:
    """Return :func:`prepared_arc` of the planned observations that a study asks for, and their rows in the plan."""
    for key, session_key in (("doppler_average_s", "count_s"), ("normal_point_s", "step_s")):
        if getattr(study.observations, key) is not None:
            raise InputError(
                f"[observations] {key} is of files; a schedule plans observations as they are used: leave it out "
                f"and give {session_key} in the sessions"
            )
    places = study.targets if len(study.targets) > 1 else ()
    mask, _ = selected(
        planned, study.observations, study.catalogue, places, model.sources, name=study.target_name
    )
    rows = np.flatnonzero(mask)
    return *prepared_arc(study, planned.select(rows), orbits, model), rows


def _require_tracked(study: Study, predictor: Predictor) -> None:
    """Refuse a position on a map of a target that is not tracked."""
    tracked = [
        name
        for k in np.unique(predictor.observations.link)
        for name in predictor.observations.links[k].targets
    ]
    for place in study.observations.map_positions:
        if place.reference_position is not None or place.target is None:
            continue
        if canonical_target(place.target) not in map(canonical_target, tracked):
            raise InputError(
                "[[observations.map_positions]] target: expected a target that is tracked "
                f"({', '.join(dict.fromkeys(tracked))}) or a known place (known_deg_m), got {place.target!r}"
            )


def known_positions(study: Study, constants: EphemerisConstants) -> list[tuple[str, Floats]]:
    """Return names and positions, principal axes, m, of known places, that of ``[reference]`` first."""
    tables = [] if study.reference is None else [("[reference]", study.reference)]
    tables += [
        (f"[references] {item.name}", item) for item in study.references if item is not study.reference
    ]
    return [(item.name, position_in_pa(table, item.position, constants).xyz_m) for table, item in tables]


def build_model(study: Study) -> PhysicalModel:
    """Return the physical model of a study; errors as :func:`radioloc.locate`."""
    choice = study.model
    uniform = None if choice.tec_tecu is None else UniformTec(choice.tec_tecu)
    return PhysicalModel.build(
        ephemeris=choice.ephemeris,
        libration=choice.libration,
        earth_orientation=choice.earth_orientation,
        eop_beyond=choice.eop_beyond,
        catalogue=study.catalogue,
        ionosphere=read_ionex(choice.ionex) if choice.ionex else uniform,
        radio_atmosphere=_radio_atmosphere(choice),
        media_calibrations=read_csp(choice.csp, choice.csp_scid) if choice.csp else None,
        delays=choice.delays,
        free_clocks=choice.free_clocks,
        sources={name: place for path in choice.sources for name, place in read_sources(path).items()},
        off=choice.off,
    )


def _radio_atmosphere(choice: ModelChoice) -> RadioAtmosphere | None:
    if not choice.vmf3 and choice.gpt3 is None and choice.vmf3_orography is None:
        return None
    try:
        return read_radio_atmosphere(choice.vmf3, choice.vmf3_orography, choice.gpt3)
    except FileFormatError:
        raise
    except InputError as error:
        raise InputError(f"[model] {error}") from None


def chosen_observations(
    study: Study, observations: Observations | None, model: PhysicalModel
) -> tuple[Observations, dict[str, int]]:
    """Return the observations of a study, and the number of others by reason; errors as :func:`radioloc.locate`."""
    study.observations.require_transmitters()
    observations = read_as(study, _files(study), model) if observations is None else _checked(observations)
    return _chosen(study, observations, model)


def _checked(observations: Observations) -> Observations:
    """Return observations in memory, checked as those of files are."""
    require_type("observations", observations, Observations)
    return with_rounding_in_sigmas(without_duplicates(observations))


def _chosen(
    study: Study, observations: Observations, model: PhysicalModel
) -> tuple[Observations, dict[str, int]]:
    """Return the observations that a study asks for, with its sigmas, and the number of others by reason."""
    chosen, left_out = select_observations(
        observations, study.observations, study.catalogue, study.targets, model.sources, study.target_name
    )
    spacecraft_doubts(study, chosen, model)  # identifiers that contradict each other are refused before a fit
    for key in ("vlbi_station_sigma_m", "vlbi_station_rate_sigma_m", "doppler_phase_sigma_m"):
        sigma = getattr(study.observations, key)
        if isinstance(sigma, Mapping):
            require_stations(chosen, key, sigma, study.catalogue)
    weighted = weighted_observations(chosen, study.observations.weights, study.catalogue)
    return with_uplinks(weighted, study.observations.uplinks, study.catalogue), left_out


def _files(study: Study) -> tuple[Path, ...]:
    """Return the files of observations of a study; none is an error."""
    if study.simulation is not None and not study.observations.files:
        raise InputError(
            f"{study.name}: the study has no observations, only a simulation; use `radioloc montecarlo`, or "
            "`radioloc simulate` to make a file of observations and name it as [observations] files"
        )
    if not study.observations.files:
        raise InputError(
            f"{study.path or study.name}: [observations] files is missing; name at least one file (relative to the "
            "study file, globs allowed)"
        )
    return study.observations.files


def read_as(study: Study, files: Sequence[str | Path], model: PhysicalModel | None = None) -> Observations:
    """Read observations from files with the stations and message settings of a study or its model.

    Errors as :func:`radioloc.locate`.
    """
    observations = read_files(files, _read_settings(study, model))
    renamed = with_target_names(observations, study.observations.target_names)
    return observations if renamed is observations else without_duplicates(renamed)


def _read_settings(study: Study, model: PhysicalModel | None) -> ReadSettings:
    # Delays of the model must not be subtracted a second time with those of a file.
    tdm = replace(study.observations.tdm, modelled=(model or build_model(study)).delays)
    return ReadSettings(study.catalogue, tdm, bool(study.points), study.observations.frequencies)


def _normal_points(
    study: Study, observations: Observations | None, model: PhysicalModel, places: Mapping[str, LunarPosition]
) -> tuple[Observations, dict[str, int]]:
    """Return normal points in place of the observations of a study, and the number of others by reason.

    Doppler and delay rates stay as they are. Observations are read and condensed in parts.
    """
    _require_linear_residuals(study)
    choice, arc = study.observations, partial(_arc, study, model, places=places, orbits={})
    assert choice.normal_point_s is not None
    sums, chosen, counts, present = list[IntervalSums](), list[Observations](), Counter[str](), set[str]()
    if observations is None:
        parts = read_in_parts(_files(study), _ROWS_AT_ONCE, _read_settings(study, model))
    else:
        parts = _checked(observations).parts(_ROWS_AT_ONCE)
    for part in parts:
        present |= targets_of(part)
        selection, left_out = _selected_part(study, part, model)
        integrated = is_integrated(selection.kind)
        chosen.append(selection.select(integrated))
        counts.update(left_out)
        if not integrated.all():
            with step(f"condensing {int((~integrated).sum())} observations"):
                part_sums, unusable = _sums_of_usable(
                    arc(selection.select(~integrated)), choice.normal_point_s
                )
            sums.append(part_sums)
            counts.update(unusable)
    require_targets(present, choice.target_names)
    if sums:
        chosen.insert(0, _points(IntervalSums.concatenate(sums), choice.normal_point_s, arc))
    if not chosen or (sums and not any(map(len, chosen))):
        texts = "; ".join(f"{count} {reason}" for reason, count in counts.items()) or "the files hold none"
        raise InputError(
            f"no observations left ({texts}); check the target's position and frame, the stations and the files"
        )
    return Observations.concatenate(chosen), dict(counts)


def _require_linear_residuals(study: Study) -> None:
    """Refuse normal points of an orbit, whose residuals are not linear in time, and of hours without a start."""
    study.observations.require_transmitters()
    if study.observations.hours is not None and study.observations.start is None:
        raise InputError(
            "[observations] normal_point_s: expected start beside hours, as files are read in parts; give start"
        )
    if study.orbiters:
        raise InputError(
            "[observations] normal_point_s: expected targets on the Moon, got an orbit to be determined, from which "
            "residuals do not change linearly in time; leave it out"
        )


def _selected_part(
    study: Study, part: Observations, model: PhysicalModel
) -> tuple[Observations, dict[str, int]]:
    """Return the observations of a part that a study asks for, and the number of others by reason."""
    if part.ramped.any():
        raise InputError(
            f"[observations] normal_point_s: expected constant frequencies, got ramps "
            f"({part.origin(int(np.argmax(part.ramped)))}); leave it out"
        )
    choice = study.observations
    part = with_target_names(part, choice.target_names, complete=False)
    mask, left_out = selected(
        part, choice, study.catalogue, study.targets, model.sources, study.target_name, complete=False
    )
    return part.select(mask), left_out


def _sums_of_usable(predictor: Predictor, interval_s: float) -> tuple[IntervalSums, Counter[str]]:
    """Return the sums of the observations that can be used, and the number of others by reason."""
    status, residual_m = usability(predictor)[0], predictor.observations.value_m - _computed_m(predictor)
    used = status.are(USED)
    sums, outlier_count = interval_sums(predictor.observations.select(used), residual_m[used], interval_s)
    unusable = Counter(without_figures(status)[~used].tolist())
    return sums, unusable + Counter({"outlier of a normal point": outlier_count})


def _points(sums: IntervalSums, interval_s: float, arc: Callable[[Observations], Predictor]) -> Observations:
    """Return normal points of sums with their values predicted."""
    if sums.shared_count:
        warnings.warn(
            f"{sums.shared_count} normal points have observations of the same link and interval in another file; "
            "copies in different files are not found and would count twice: remove them",
            DataQualityWarning,
            stacklevel=2,
        )
    points, residual_m = sums.points(interval_s)
    return replace(points, value_m=_computed_m(arc(points)) + residual_m)


def _computed_m(predictor: Predictor) -> Floats:
    """Return computed values at the motions of an arc, m, shape (n,)."""
    return predictor.predict(predictor.motions).value_m


def _arc(
    study: Study,
    model: PhysicalModel,
    observations: Observations,
    places: Mapping[str, LunarPosition],
    orbits: Mapping[str, AdjustableOrbit],
) -> Predictor:
    names = study.names_in_order
    orbits = {
        name: orbits[name] if name in orbits else _orbit(study, name, model, observations)
        for name in study.orbiters
    }
    records: dict[str, MotionLike | TargetDescription] = {**places, **study.trajectories, **study.described}
    declared = {name: declared_motion(record, model) for name, record in records.items()}

    def motions_along(orbits: Mapping[str, AdjustableOrbit]) -> Motions:
        motions = declared | {name: OrbitMotion(orbit) for name, orbit in orbits.items()}
        return tuple(motions[name] for name in names or study.all_targets)

    # Partials of gravity of a lower degree suffice where only positions are needed.
    start = motions_along({name: orbit.coarse() for name, orbit in orbits.items()})
    kinds = (*study.estimate.parameters, *study.consider)
    more_partials = study.consider_defaults or any(PARAMETERS[kind].more_partials for kind in kinds)
    try:
        if len(rows := np.flatnonzero(~np.isnan(observations.modulus_m))):
            ambiguous = ExactPredictor(model, observations.select(rows), start, names)
            expected_m = np.full(len(observations), np.nan)
            expected_m[rows] = ambiguous.compute().value_m
            observations = without_ambiguity(observations, expected_m)
        predictor = prepare_predictor(
            model, observations, start, study.model.evaluation, names, more_partials
        )
    except CoverageError:
        # A kernel or table does not name the files: find which observation lies outside, the first or the last.
        order = np.lexsort((observations.epoch.fraction, observations.epoch.jd))
        for row in (int(order[0]), int(order[-1])):
            try:
                prepare_predictor(model, observations.select([row]), start, "exact", names)
            except CoverageError as error:
                error.args = (f"{observations.origin(row)}: {error}",)
                raise error from None
        raise
    return predictor.with_motions(motions_along(orbits)) if orbits else predictor


def _orbit(study: Study, name: str, model: PhysicalModel, observations: Observations) -> AdjustableOrbit:
    """Return the a-priori orbit of a target over its observations."""
    orbiter = study.orbiters[name]
    assert study.estimate.orbit is not None  # the study has seen to that
    if len(study.targets) > 1:
        of_target = [name in map(canonical_target, link.targets) for link in observations.links]
        observations = observations.select(np.array(of_target, dtype=bool)[observations.link])
    orbit = orbiter.orbit(model, observations, study.estimate.orbit.parameters(orbiter.forces))
    return orbit.reaching_below_ground() if orbiter.landing is None else orbit


MAX_DISTANCE_FRACTION = 0.25  # largest distance from the nearest multiple, as a fraction of the modulus
MAX_OUTLIER_FRACTION = 0.1  # of ranges beyond that distance: gross errors, which editing rejects


def without_ambiguity(observations: Observations, expected_m: Floats) -> Observations:
    """Return the observations with ambiguities resolved by the expected values, m (NaN for other observations)."""
    # The multiple of the modulus nearest to the prediction is correct if the error is below half of the modulus. The
    # limit is a quarter, so that the next multiple is at least three times as far.
    turns = np.rint((expected_m - observations.value_m) / observations.modulus_m)
    value_m = observations.value_m + np.nan_to_num(turns) * np.nan_to_num(observations.modulus_m)
    part = abs(value_m - expected_m) / observations.modulus_m
    is_ambiguous = np.isfinite(part)
    is_distant = is_ambiguous & (part > MAX_DISTANCE_FRACTION)
    if is_distant.sum() > MAX_OUTLIER_FRACTION * is_ambiguous.sum():
        row = int(np.argmax(is_distant))
        raise InputError(
            f"{observations.origin(row)}: the ambiguity of {observations.modulus_m[row]:.6g} m cannot be resolved: the "
            f"nearest range differs by {abs(value_m - expected_m)[row]:.6g} m from the prediction, "
            f"{is_distant.sum()} of {is_ambiguous.sum()} ranges by more than a quarter of the modulus; improve the "
            "a-priori position or trajectory, or exclude these ranges"
        )
    return replace(observations, value_m=value_m, modulus_m=np.full(len(observations), np.nan))
