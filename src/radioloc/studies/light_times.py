"""Light times, ranges, Doppler and pointing of a study's target over a grid of epochs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.boundary import bare_arguments
from radioloc.constants import C_M_S
from radioloc.ephemeris.trajectory import AnyTrajectory
from radioloc.errors import InputError
from radioloc.estimation.labels import Labels
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.measurement_type import Geometry
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.pointing import Direction, direction
from radioloc.measurements.predictor import reasons
from radioloc.measurements.registry import is_one_way, kind_of
from radioloc.report.light_times import LightTimes
from radioloc.simulation.schedule import LINKS, Schedule, Session
from radioloc.simulation.visibility import Target
from radioloc.studies.passes import scene_of
from radioloc.studies.study import Study
from radioloc.time import utc_to_tt

_KINDS = {
    Geometry.ROUND_TRIP.value: ("range", "doppler"),
    Geometry.ONE_WAY.value: ("one_way_range", "one_way_doppler"),
}
"""Types of measurement by the form of path."""
WAYS = {name: form for name, (form, _) in LINKS.items() if form in _KINDS}
"""How stations can be linked, with the form of path."""
_COUNT_S = 2.0
_X_BAND_HZ = 8.4e9
_LIGHT_HZ = 3e11


@bare_arguments
def light_times(
    study: Study | str | Path,
    stations: Sequence[str] = (),
    *,
    links: str = "two_way",
    start_utc: str | None = None,
    stop_utc: str | None = None,
    step_s: float = 600.0,
    frequency_hz: float | None = None,
    mask_deg: float = 0.0,
) -> LightTimes:
    """Tabulate light times, ranges, their rates and directions for pointing.

    Parameters
    ----------
    study : Study or path-like
        Its targets, or the true position of its simulation, and its model.
    stations : sequence of str
        Names or aliases; by default those of the study's schedule, or else of its observations.
    links : {"two_way", "three_way", "all", "one_way"}
        Each station by itself; the first one sends to the others; each to each; the target sends.
    start_utc, stop_utc : str, optional
        First and last epoch, of reception; by default those of the schedule, or of the observations.
    step_s : float
        From epoch to epoch, s.
    frequency_hz : float, optional
        Of the radio signal that is received if nothing moves, Hz, for a column of Doppler. Media are those at this
        frequency, or at 8.4 GHz.
    mask_deg : float
        Elevation below which a station does not see the target; -90 is for all epochs at which the target's own
        horizon, or the Moon, does not hide it.

    Raises
    ------
    RadiolocError
        The study says neither stations nor a span and none is given, nothing is seen, or another argument cannot be.

    Notes
    -----
    Ranges and Doppler are those of a :class:`~radioloc.measurements.ExactPredictor`, with all terms of the study's
    model. The rate is what Doppler tells in two seconds about the epoch, which is that of the epoch to 1e-6 m/s for a
    lander, and -f/c of it is the received frequency less f.

    Examples
    --------
    >>> from radioloc.studies import light_times
    >>> found = light_times("examples/change5/short_arc.toml", ["KASHI"], step_s=1800.0, frequency_hz=8.47e9)
    >>> found["doppler_hz"].round().tolist()
    [18789.0, 17799.0, 16551.0]
    """
    if links not in WAYS:
        raise InputError(f"links = {links!r} is not known here; use one of {', '.join(WAYS)}")
    carrier_hz = _X_BAND_HZ if frequency_hz is None else float(frequency_hz)
    if not (math.isfinite(carrier_hz) and 0.0 < carrier_hz < _LIGHT_HZ):
        raise InputError(f"frequency_hz = {frequency_hz!r} is no radio frequency, which is up to 3e11 Hz")
    kind, counted = _KINDS[WAYS[links]]
    scene = scene_of(study, stations, start_utc, stop_utc, mask_deg)
    pairs = LINKS[links][1](*dict.fromkeys(scene.stations))
    if not pairs:
        raise InputError(
            f"links = {links!r} needs two stations or more, not {', '.join(scene.stations)} alone"
        )
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
    for name, target in scene.targets.items():
        planned = Schedule([session], scene.masks).plan(scene.model, target, name).observations
        counts = planned.select(np.argsort(planned.link, kind="stable"))
        parts.append(_table(scene.model, counts, target, kind, frequency_hz))
    rows = Observations.concatenate([part for part, _, _ in parts])
    columns = {name: np.concatenate([part[name] for _, part, _ in parts]) for name in parts[0][1]}
    return LightTimes(
        scene.name,
        scene.start_utc,
        scene.stop_utc,
        len(session.epochs()) * len(pairs) * len(scene.targets) - len(rows),
        frequency_hz,
        rows.epoch,
        Labels(rows.link, tuple(link.path for link in rows.links)),
        columns,
        Labels.of(np.concatenate([sentences for _, _, sentences in parts])),
    )


def _table(
    model: PhysicalModel, counts: Observations, target: Target, kind: str, frequency_hz: float | None
) -> tuple[Observations, dict[str, NDArray[np.float64]], NDArray[np.str_]]:
    """Ranges at the tags of counts, the columns, and what does not hold."""
    rows = replace(
        counts, kind=np.full_like(counts.kind, kind_of(kind)), count_s=np.full(len(counts), np.nan)
    )
    trajectory = target if isinstance(target, AnyTrajectory) else None
    place_m = np.zeros(3) if isinstance(target, AnyTrajectory) else target
    predictor = ExactPredictor(model, rows, place_m, trajectory)
    computed = predictor.compute(place_m)
    path, sender, receiver = predictor.light_path(place_m)
    no_uplink = is_one_way(rows.kind)
    columns = {
        "uplink_light_time_s": np.where(no_uplink, np.nan, path.up_s),
        "downlink_light_time_s": path.down_s,
        "range_m": computed.value_m,
        "range_rate_m_s": ExactPredictor(model, counts, place_m, trajectory).compute(place_m).value_m
        / _COUNT_S,
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
