"""Observations that the model cannot explain for given motions of the targets: below a horizon, behind the Moon."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.labels import USED, Labels
from radioloc.lunar.frames import earth_elevation_rad
from radioloc.measurements.predictor import Predictor, blocks, reasons
from radioloc.measurements.target_motion import Motions
from radioloc.media.medium import Status
from radioloc.targets.doubts import MIN_EARTH_ELEVATION_DEG
from radioloc.time import Epochs, tt_to_tdb, utc_to_tt
from radioloc.time.smooth import evaluate_smooth

_EARTH_ELEVATION_MARGIN_DEG = 1.0  # change of the Earth's elevation between two of the epochs six hours apart


def usability(arc: Predictor, motions: Motions | None = None) -> tuple[Labels, NDArray[np.int8]]:
    """Return why observations cannot be used for motions, by default those of the arc, as text and by code."""
    motions = arc.motions if motions is None else motions
    prediction, model, epoch = arc.predict(motions), arc.model, arc.observations.epoch
    # The Moon hides spacecraft in the predictions themselves.
    earth_elevation = {
        k: partial(earth_elevation_rad, model.ephemeris, model.libration, point_pa_m=motion.position_pa_m)
        for k, motion in enumerate(motions)
        if motion.trajectory is None
    }
    limit_deg = MIN_EARTH_ELEVATION_DEG + _EARTH_ELEVATION_MARGIN_DEG
    low_targets = [k for k, elevation in earth_elevation.items() if _min_deg(elevation, epoch) < limit_deg]
    codes = np.zeros(len(arc.observations), dtype=np.int8)
    labels = np.zeros(len(arc.observations), dtype=np.int32)
    label_numbers = {USED: 0}
    for rows in blocks(arc):
        computed = prediction.rows(rows)
        bad = np.flatnonzero(~computed.usable)
        codes[rows[bad]], sentences = reasons(arc, computed.rows(bad), rows[bad])
        texts, inverse = np.unique(sentences, return_inverse=True)
        numbers = [label_numbers.setdefault(str(text), len(label_numbers)) for text in texts]
        labels[rows[bad]] = np.array(numbers, dtype=np.int32)[inverse]
        for target in low_targets:
            target_rows = rows[(arc.target[rows] == target) & (codes[rows] == Status.OK)]
            # The Earth moves in the lander's sky with the librations, in days.
            tdb = tt_to_tdb(utc_to_tt(epoch[target_rows]))
            elevation_deg = np.degrees(evaluate_smooth(earth_elevation[target], tdb))
            for k in np.flatnonzero(elevation_deg < MIN_EARTH_ELEVATION_DEG):
                text = Status.EARTH_BELOW_HORIZON.text(elevation_deg[k])
                codes[target_rows[k]] = Status.EARTH_BELOW_HORIZON
                labels[target_rows[k]] = label_numbers.setdefault(text, len(label_numbers))
    return Labels(labels, tuple(label_numbers)), codes


def _min_deg(elevation_rad: Callable[[Epochs], NDArray[np.float64]], epoch_utc: Epochs) -> float:
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
