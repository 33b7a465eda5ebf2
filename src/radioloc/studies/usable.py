"""Which observations of an arc can be used at all, seen from the a-priori position, and why others cannot."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.estimation.labels import USED, Labels
from radioloc.lunar.position import LunarPosition
from radioloc.lunar.visibility import earth_elevation_rad
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Predictor, blocks, reasons
from radioloc.media.status import Status
from radioloc.studies.problem import start_pa_m
from radioloc.time import Epochs, evaluate_smooth, tt_to_tdb, utc_to_tt

_LOWEST_EARTH_DEG = -8.0
"""The highest terrain, 10.8 km, sees 6.4 deg below the horizontal; an a-priori position 50 km off is 1.6 deg off."""


def status_of(arc: Predictor, targets: Mapping[str, LunarPosition]) -> tuple[Labels, NDArray[np.int8]]:
    """Which observations can be used at all, seen from the a-priori position, or why not, in words and by code."""
    at, model = arc.at(start_pa_m(targets)), arc.model
    earth_deg = [partial(_earth_deg, model, position_pa_m=position.xyz_m) for position in targets.values()]
    # Of a spacecraft the arc itself knows what the Moon hides.
    may_set = [_lowest(above, arc.observations.epoch) < _LOWEST_EARTH_DEG + 1.0 for above in earth_deg]
    reason = np.zeros(len(arc.observations), dtype=np.int8)
    labels = np.zeros(len(arc.observations), dtype=np.int32)
    places = {USED: 0}
    for rows in blocks(arc):
        computed = at.rows(rows)
        bad = np.flatnonzero(~computed.usable)
        reason[rows[bad]], sentences = reasons(arc, computed.rows(bad), rows[bad])
        texts, which = np.unique(sentences, return_inverse=True)
        new = [places.setdefault(str(text), len(places)) for text in texts]
        labels[rows[bad]] = np.array(new, dtype=np.int32)[which]
        for target in np.flatnonzero(may_set):
            mine = rows[(arc.target[rows] == target) & (reason[rows] == Status.OK)]
            # The Earth moves in the lander's sky with the librations, in days.
            tdb = tt_to_tdb(utc_to_tt(arc.observations.epoch[mine]))
            above_deg = evaluate_smooth(earth_deg[target], tdb)
            for k in np.flatnonzero(above_deg < _LOWEST_EARTH_DEG):
                text = Status.EARTH_BELOW_HORIZON.text(above_deg[k])
                reason[mine[k]] = Status.EARTH_BELOW_HORIZON
                labels[mine[k]] = places.setdefault(text, len(places))
    return Labels(labels, tuple(places)), reason


def _earth_deg(
    model: PhysicalModel, epochs: Epochs, position_pa_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Elevation of the Earth above a place's horizon, deg, shape (n,)."""
    return np.degrees(earth_elevation_rad(model.ephemeris, model.libration, epochs, position_pa_m))


def _lowest(earth_deg: Callable[[Epochs], NDArray[np.float64]], epoch_utc: Epochs) -> float:
    """Lowest elevation of the Earth in the span of epochs, every six hours, in which it moves half a degree.

    Minus infinity if the epochs themselves are fewer.
    """
    if not len(epoch_utc):
        return math.inf
    ends = epoch_utc[[int(epoch_utc.mjd.argmin()), int(epoch_utc.mjd.argmax())]]
    first, last = (tt_to_tdb(utc_to_tt(ends))[[k]] for k in (0, 1))
    span_d = last.seconds_since(first)[0] / SECONDS_PER_DAY
    count = int(4.0 * span_d) + 2
    if count > len(epoch_utc):
        return -math.inf
    return float(
        earth_deg(Epochs.from_jd(first.jd, first.fraction + np.linspace(0.0, span_d, count), "TDB")).min()
    )
