"""When the stations of a study see its target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from radioloc.boundary import bare_arguments
from radioloc.ephemeris.trajectory import AnyTrajectory
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.report.passes import Pass, Passes
from radioloc.simulation.simulate import StateAndForces
from radioloc.simulation.visibility import Masks, Target, Window, elevations, windows
from radioloc.studies.locate import model_of, prepared_arc
from radioloc.studies.study import Study
from radioloc.studies.study_file import as_study
from radioloc.studies.weights import ends_of
from radioloc.time import epochs_from_strings, tai_to_tt, tai_to_utc, utc_strings, utc_to_tai

_STEP_S = 60.0
"""Between epochs at which the elevation is looked at: the highest is then found to 0.0002 deg."""


@bare_arguments
def visibility(
    study: Study | str | Path,
    stations: Sequence[str] = (),
    *,
    start_utc: str | None = None,
    stop_utc: str | None = None,
    mask_deg: float | None = None,
) -> Passes:
    """Find the passes of a study's targets over stations: rise, set and highest elevation.

    Parameters
    ----------
    study : Study or path-like
        Its targets, or the true position of its simulation.
    stations : sequence of str
        Names or aliases; by default those of the study's schedule, or else of its observations.
    start_utc, stop_utc : str, optional
        Limits of the search; by default those of the schedule, or of the observations.
    mask_deg : float, optional
        Elevation at the stations below which they do not see the target; by default those of the schedule, or 10 deg.

    Raises
    ------
    RadiolocError
        The study says neither stations nor a span and none is given, or as of
        :func:`radioloc.simulation.visibility.windows`.

    Examples
    --------
    >>> from radioloc.studies import visibility
    >>> found = visibility("examples/change5/short_arc.toml", ["KASHI"], stop_utc="2020-12-02T15:11:00")
    >>> [(one.station, one.rises, one.sets) for one in found.passes]
    [('KASHI', False, True), ('KASHI', True, False)]
    """
    scene = scene_of(study, stations, start_utc, stop_utc, mask_deg)
    model, masks = scene.model, scene.masks
    names, first, last = scene.stations, scene.start_utc, scene.stop_utc
    several = len(scene.targets) > 1
    passes = [
        _pass(model, target, name, window, which if several else "")
        for which, target in scene.targets.items()
        for name in dict.fromkeys(names)
        for window in windows(model, target, [name], first, last, masks)
    ]
    by_station = {name: masks.of(name) for name in names}
    targets = tuple(scene.targets) if several else ()
    return Passes(scene.name, first, last, by_station, masks.target_deg, tuple(passes), targets)


@dataclass(frozen=True, slots=True)
class Scene:
    """What is seen, from where and when."""

    name: str  # of the study
    model: PhysicalModel
    targets: dict[str, Target]  # by their names in links
    stations: list[str]  # names in the catalogue
    start_utc: str
    stop_utc: str
    masks: Masks


def scene_of(
    study: Study | str | Path,
    stations: Sequence[str],
    start_utc: str | None,
    stop_utc: str | None,
    mask_deg: float | None,
) -> Scene:
    """What a study says of it where it is not given; parameters and errors as :func:`visibility`."""
    study = as_study(study)
    model = model_of(study)
    if study.simulation is not None:
        names, first, last, masks = _planned(study)
    elif stations and start_utc and stop_utc:
        names, first, last, masks = [], "", "", Masks()
    else:
        names, first, last, masks = _observed(study)
    places: dict[str, LunarPosition | AnyTrajectory | StateAndForces] = {**study.targets} or {
        "lander": study.target
    }
    if study.simulation is not None:
        places = {study.simulation.name: study.simulation.position}
    start_utc, stop_utc = start_utc or first, stop_utc or last
    targets: dict[str, Target] = {}
    for name, place in places.items():
        if isinstance(place, LunarPosition):
            targets[name] = place.to_axes("PA", model.ephemeris.constants).xyz_m
        elif isinstance(place, AnyTrajectory):
            targets[name] = place
        else:
            span = epochs_from_strings([start_utc, stop_utc], "UTC")
            targets[name] = place.orbit_over(model, span, 0.0).nearest()[0]
    return Scene(
        study.name,
        model,
        targets,
        [model.catalogue.get(name).name for name in stations or names],
        start_utc,
        stop_utc,
        masks if mask_deg is None else replace(masks, station_deg=mask_deg, by_station_deg={}),
    )


def _planned(study: Study) -> tuple[list[str], str, str, Masks]:
    """Stations, span and masks of a schedule."""
    assert study.simulation is not None
    schedule = study.simulation.schedule
    names = [name for session in schedule.sessions for pair in session.pairs for name in pair if name]
    limits = [(session.start_utc, session.stop_utc) for session in schedule.sessions]
    order = [epochs_from_strings(list(dates), "UTC").mjd for dates in zip(*limits, strict=True)]
    first, last = limits[int(np.argmin(order[0]))][0], limits[int(np.argmax(order[1]))][1]
    return names, first, last, schedule.masks


def _observed(study: Study) -> tuple[list[str], str, str, Masks]:
    """Stations and span of the observations."""
    observations = prepared_arc(study)[0].observations
    names = sorted(set().union(*ends_of(observations.links, study.catalogue)))
    epochs = utc_strings(observations.epoch, decimals=0)
    return names, str(min(epochs)), str(max(epochs)), Masks()


def _pass(model: PhysicalModel, target: Target, station: str, window: Window, name: str) -> Pass:
    """A window with its highest elevation."""
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
