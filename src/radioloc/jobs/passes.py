"""Passes of a study's target over its stations, and tables of light times, ranges, Doppler and pointing.

Directions for pointing are those of the light in the frame of the station: they include annual and diurnal aberration,
but not refraction. A transmitting station points to the later position of the target, with the aberration of the
opposite sign. The bending of light by the Sun is below 0.001 arcseconds for such near targets and neglected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import erfa
import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.errors import InputError
from radioloc.jobs.preparation import build_model, prepared_arc
from radioloc.labels import Labels
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import reasons
from radioloc.measurements.registry import Geometry, is_one_way, kind_of
from radioloc.measurements.station_motion import StationMotion
from radioloc.measurements.target_motion import TargetMotion
from radioloc.quantities import DateLike, FloatLike, accepts_quantities
from radioloc.results.predictions import LightTimes, Pass, Passes
from radioloc.simulation.schedule import LINKS, Schedule, Session
from radioloc.simulation.simulate import TargetRecord, spanning_motion
from radioloc.simulation.visibility import SPHERICAL_HORIZON, Masks, Window, elevations, windows
from radioloc.study.observation_choice import link_stations
from radioloc.study.study import Study
from radioloc.study.study_file import as_study
from radioloc.time import (
    Epochs,
    epochs_from_strings,
    tai_to_tt,
    tai_to_utc,
    utc_strings,
    utc_to_tai,
    utc_to_tt,
)
from radioloc.vectors import Floats, cross, dot, normalized, rotated

_SUN_DISTANCE_AU = 1.0  # for the relativistic part of aberration, below 1e-7 arcseconds


@dataclass(frozen=True, slots=True, eq=False)
class Direction:
    """Directions of the target from stations at n events; angles in degrees, shape (n,)."""

    azimuth_deg: Floats  # from north through east, 0 to 360
    elevation_deg: Floats  # above the plane normal to the ellipsoid's vertical
    ra_deg: Floats  # apparent, of the true equator and equinox of date, 0 to 360
    dec_deg: Floats
    icrs_ra_deg: Floats  # astrometric: along the ICRF's axes without aberration
    icrs_dec_deg: Floats


def direction(unit_bcrs: Floats, station: StationMotion, tt: Epochs, *, sends: bool = False) -> Direction:
    """Return directions from stations to the target, from unit vectors (BCRS) at the events."""
    beta = station.point.velocity_m_s / C_M_S * (-1.0 if sends else 1.0)
    apparent = np.asarray(erfa.ab(unit_bcrs, beta, _SUN_DISTANCE_AU, np.sqrt(1.0 - dot(beta, beta))))
    up = station.up_gcrs
    east = normalized(cross(station.pole_gcrs, up))
    horizontal = dot(east, apparent), dot(cross(up, east), apparent)
    ra_deg, dec_deg = _angles_deg(rotated(erfa.pnm06a(tt.jd, tt.fraction), apparent))
    return Direction(
        np.degrees(np.arctan2(*horizontal)) % 360.0,
        np.degrees(np.arctan2(dot(up, apparent), np.hypot(*horizontal))),
        ra_deg,
        dec_deg,
        *_angles_deg(unit_bcrs),
    )


def _angles_deg(unit: Floats) -> tuple[Floats, Floats]:
    longitude_rad, latitude_rad = erfa.c2s(unit)
    return np.degrees(longitude_rad) % 360.0, np.degrees(latitude_rad)


_STEP_S = 60.0  # between elevations; the maximum is then determined to 0.0002 deg
_KINDS_BY_FORM = {
    Geometry.ROUND_TRIP.value: ("range", "doppler"),
    Geometry.ONE_WAY.value: ("one_way_range", "one_way_doppler"),
}
"""Types of range and Doppler by the form of path."""
WAYS = {name: form for name, (form, _) in LINKS.items() if form in _KINDS_BY_FORM}
"""Forms of path by the choices of `links`."""
_COUNT_S = 2.0
_X_BAND_HZ = 8.4e9
_RADIO_HZ = (1e6, 3e11)


@accepts_quantities
def visibility(
    study: Study | str | Path,
    stations: Sequence[str] = (),
    *,
    start_utc: DateLike | None = None,
    stop_utc: DateLike | None = None,
    mask_deg: FloatLike | None = None,
) -> Passes:
    """Find the passes of a study's targets over stations: rise, set and highest elevation.

    Parameters
    ----------
    study : Study or path-like
        Its targets, or the true position of its simulation.
    stations : str or sequence of str
        Names, aliases or networks; by default those of the study's schedule, or else of its observations.
    start_utc, stop_utc : str, optional
        Limits of the search; by default those of the schedule, or of the observations.
    mask_deg : float, optional
        Lowest elevation at the stations, deg; by default those of the schedule, or 10 deg.

    Raises
    ------
    RadiolocError
        Neither the study nor an argument gives stations and a span, or the span is invalid.

    Examples
    --------
    >>> from radioloc import visibility
    >>> passes = visibility("examples/change5/short_arc.toml", ["KASHI"], stop_utc="2020-12-02T15:11:00").passes
    >>> [(item.station, item.rises, item.sets) for item in passes]
    [('KASHI', False, True), ('KASHI', True, False)]
    """
    scene = build_scene(study, stations, start_utc, stop_utc, mask_deg)
    model, masks = scene.model, scene.masks
    names, first, last = scene.stations, scene.start_utc, scene.stop_utc
    several = len(scene.motions) > 1
    passes = [
        _pass(model, target, name, window, target_name if several else "")
        for target_name, target in scene.motions.items()
        for name in dict.fromkeys(names)
        for window in windows(model, target, [name], first, last, masks)
    ]
    by_station = {name: masks.for_station(name) for name in names}
    targets = tuple(scene.motions) if several else ()
    notes = model.catalogue.antenna_notes(names)
    if any(motion.trajectory is None for motion in scene.motions.values()):
        notes.append(SPHERICAL_HORIZON)
    return Passes(scene.name, first, last, by_station, masks.target_deg, tuple(passes), targets, tuple(notes))


@dataclass(frozen=True, slots=True)
class Scene:
    """Targets, stations, span and masks of visibility."""

    name: str  # of the study
    model: PhysicalModel
    motions: dict[str, TargetMotion]  # by their names in links
    stations: list[str]  # names in the catalogue
    start_utc: str
    stop_utc: str
    masks: Masks


def build_scene(
    study: Study | str | Path,
    stations: Sequence[str],
    start_utc: str | None,
    stop_utc: str | None,
    mask_deg: float | None,
) -> Scene:
    """Return the scene of a study; arguments replace its stations, span and masks, as in :func:`visibility`."""
    study = as_study(study)
    stations = (stations,) if isinstance(stations, str) else stations
    model = build_model(study)
    if study.simulation is not None:
        names, first, last, masks = _planned(study)
    elif stations and start_utc and stop_utc:
        names, first, last, masks = [], "", "", Masks()
    else:
        names, first, last, masks = _observed(study)
    places: dict[str, TargetRecord] = {name or "lander": place for name, place in study.all_targets.items()}
    if study.simulation is not None:
        places = study.simulation.targets
    start_utc, stop_utc = start_utc or first, stop_utc or last
    span = epochs_from_strings([start_utc, stop_utc], "UTC")
    motions = {name: spanning_motion(place, model, span) for name, place in places.items()}
    return Scene(
        study.name,
        model,
        motions,
        [station.name for name in stations or names for station in model.catalogue.members(name)],
        start_utc,
        stop_utc,
        masks if mask_deg is None else replace(masks, station_deg=mask_deg, by_station_deg={}),
    )


def _planned(study: Study) -> tuple[list[str], str, str, Masks]:
    assert study.simulation is not None
    schedule = study.simulation.schedule
    names = [name for session in schedule.sessions for pair in session.pairs for name in pair if name]
    limits = [(session.start_utc, session.stop_utc) for session in schedule.sessions]
    order = [epochs_from_strings(list(dates), "UTC").mjd for dates in zip(*limits, strict=True)]
    first, last = limits[int(np.argmin(order[0]))][0], limits[int(np.argmax(order[1]))][1]
    return names, first, last, schedule.masks


def _observed(study: Study) -> tuple[list[str], str, str, Masks]:
    observations = prepared_arc(study)[0].observations
    names = sorted(set().union(*link_stations(observations.links, study.catalogue)))
    epochs = utc_strings(observations.epoch, decimals=0)
    return names, str(min(epochs)), str(max(epochs)), Masks()


def _pass(model: PhysicalModel, target: TargetMotion, station: str, window: Window, name: str) -> Pass:
    """Return a window with its highest elevation."""
    limits = utc_to_tai(epochs_from_strings([window.start_utc, window.stop_utc], "UTC"))
    length_s = float(limits[1].seconds_since(limits[0])[0])
    offset_s = np.linspace(0.0, length_s, max(2, int(np.ceil(length_s / _STEP_S)) + 1))
    tai = limits[np.zeros(len(offset_s), dtype=np.int64)].shifted(offset_s)
    above_rad = elevations(model, target, [station], tai_to_tt(tai)).at_station_rad[:, 0]
    top = int(np.argmax(above_rad))
    return Pass(
        station,
        window.start_utc,
        window.stop_utc,
        window.rises,
        window.sets,
        length_s / 3600.0,
        float(np.degrees(above_rad[top])),
        str(utc_strings(tai_to_utc(tai[top]), decimals=0)[0]),
        name,
    )


@accepts_quantities
def light_times(
    study: Study | str | Path,
    stations: Sequence[str] = (),
    *,
    links: str = "two_way",
    start_utc: DateLike | None = None,
    stop_utc: DateLike | None = None,
    step_s: FloatLike = 600.0,
    frequency_hz: FloatLike | None = None,
    mask_deg: FloatLike = 0.0,
) -> LightTimes:
    """Tabulate light times, ranges, their rates and directions for pointing.

    Parameters
    ----------
    study : Study or path-like
        Its targets, or the true position of its simulation, and its model.
    stations : str or sequence of str
        Names, aliases or networks; by default those of the study's schedule, or else of its observations.
    links : {"two_way", "three_way", "all", "one_way"}
        Links: each station with itself; from the first station to the others; all pairs; from the target down.
    start_utc, stop_utc : str, optional
        First and last epoch of reception; by default those of the schedule, or of the observations.
    step_s : float
        Interval of the epochs, s.
    frequency_hz : float, optional
        Received radio frequency f without motion, Hz, for a column of Doppler. Media are at this frequency, or at
        8.4 GHz.
    mask_deg : float
        Lowest elevation at the stations, deg; -90 includes all epochs at which neither the target's own horizon nor
        the Moon blocks the signal.

    Raises
    ------
    RadiolocError
        Neither the study nor an argument gives stations and a span, no station sees the target, or another argument is
        invalid.

    Notes
    -----
    Ranges and Doppler are those of a :class:`~radioloc.measurements.ExactPredictor`, with all terms of the study's
    model. The rate is the mean over two seconds about the epoch, within 1e-6 m/s of that at the epoch for a lander;
    -f/c times the rate is the received frequency less f.

    Examples
    --------
    >>> from radioloc import light_times
    >>> table = light_times("examples/change5/short_arc.toml", ["KASHI"], step_s=1800.0, frequency_hz=8.47e9)
    >>> table["doppler_hz"].round().tolist()
    [18789.0, 17799.0, 16551.0]
    """
    if links not in WAYS:
        raise InputError(f"links: expected one of {', '.join(WAYS)}, got {links!r}")
    carrier_hz = _X_BAND_HZ if frequency_hz is None else float(frequency_hz)
    if not _RADIO_HZ[0] <= carrier_hz <= _RADIO_HZ[1]:
        raise InputError(f"frequency_hz (--frequency): expected 1e6 to 3e11 Hz, got {frequency_hz!r}")
    kind, counted = _KINDS_BY_FORM[WAYS[links]]
    scene = build_scene(study, stations, start_utc, stop_utc, mask_deg)
    pairs = LINKS[links][1](*dict.fromkeys(scene.stations))
    if not pairs:
        raise InputError(f"stations: links = {links!r} needs two or more, got {', '.join(scene.stations)}")
    session = Session(
        kind=counted,
        pairs=pairs,
        start_utc=scene.start_utc,
        stop_utc=scene.stop_utc,
        step_s=step_s,
        sigma_m=1.0,
        count_s=_COUNT_S,
        uplink_hz=carrier_hz,
        wavelength_um=1e6 * C_M_S / carrier_hz,
    )
    parts = []
    for name, target in scene.motions.items():
        planned = Schedule([session], scene.masks).plan(scene.model, target, name).observations
        counts = planned.select(np.argsort(planned.link, kind="stable"))
        parts.append(_table(scene.model, counts, target, kind, frequency_hz))
    rows = Observations.concatenate([part for part, _, _ in parts])
    columns = {name: np.concatenate([part[name] for _, part, _ in parts]) for name in parts[0][1]}
    return LightTimes(
        scene.name,
        scene.start_utc,
        scene.stop_utc,
        len(session.epochs()) * len(pairs) * len(scene.motions) - len(rows),
        frequency_hz,
        rows.epoch,
        Labels(rows.link, tuple(link.path for link in rows.links)),
        columns,
        Labels.from_texts(np.concatenate([sentences for _, _, sentences in parts])),
        tuple(scene.model.catalogue.antenna_notes(scene.stations)),
    )


def _table(
    model: PhysicalModel, counts: Observations, motion: TargetMotion, kind: str, frequency_hz: float | None
) -> tuple[Observations, dict[str, Floats], NDArray[np.str_]]:
    """Return ranges at the time tags of Doppler, the columns, and reasons why rows are unusable."""
    rows = replace(
        counts, kind=np.full_like(counts.kind, kind_of(kind)), count_s=np.full(len(counts), np.nan)
    )
    predictor = ExactPredictor(model, rows, motion)
    computed = predictor.compute()
    path, sender, receiver = predictor.light_path()
    no_uplink = is_one_way(rows.kind)
    columns = {
        "uplink_light_time_s": np.where(no_uplink, np.nan, path.up_s),
        "downlink_light_time_s": path.down_s,
        "range_m": computed.value_m,
        "range_rate_m_s": ExactPredictor(model, counts, motion).compute().value_m / _COUNT_S,
    }
    if frequency_hz is not None:
        columns["doppler_hz"] = -frequency_hz / C_M_S * columns["range_rate_m_s"]
    tt = utc_to_tt(rows.epoch)
    transmit = direction(path.up_unit, sender, tt, sends=True)
    receive = direction(-path.down_unit, receiver, tt)
    for field in fields(Direction):
        columns[f"transmit_{field.name}"] = np.where(no_uplink, np.nan, getattr(transmit, field.name))
    columns |= {f"receive_{field.name}": getattr(receive, field.name) for field in fields(Direction)}
    return rows, columns, reasons(predictor, computed)[1]
