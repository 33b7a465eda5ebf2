"""Doubts about stations whose observations fit with other axes or signs of their coordinates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.stations import Station, StationCatalogue, reordered_coordinates
from radioloc.errors import InputError
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.target_motion import Motions
from radioloc.targets.design import a_priori_orbits

_SAMPLE_ROWS = 20
_MIN_IMPROVEMENT = 10.0  # Ratio of the rms of residuals
_MAX_RMS_M = 1.0e5  # At an a-priori position some tens of kilometres off


def coordinate_doubts(
    predictor: Predictor, motions: Motions, used: NDArray[np.bool_], fits: bool
) -> Iterator[str]:
    """Yield a warning for each station that fits, or sees the target, only with exchanged axes or signs."""
    # Without it a station with x and y exchanged is only far off (tests/unit/jobs/test_station_doubts.py).
    observations, shipped = predictor.observations, StationCatalogue.default()
    for name in () if a_priori_orbits(predictor) else predictor.stations:
        station = predictor.model.catalogue.get(name)
        if station.name in shipped and np.array_equal(shipped[station.name].itrf_m, station.itrf_m):
            continue
        of_link = np.array([name in link.stations for link in observations.links])
        rows = np.flatnonzero(of_link[observations.link])
        if not len(rows) or (fits and used[rows].any()):
            continue
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, _SAMPLE_ROWS).astype(int))]
        given_m = _rms_m(predictor, motions, rows, station)
        rms_by_mistake_m = {
            mistake: _rms_m(predictor, motions, rows, station, itrf_m)
            for mistake, itrf_m in reordered_coordinates(station.itrf_m).items()
        }
        mistake, rms_m = min(rms_by_mistake_m.items(), key=lambda item: item[1])
        if rms_m < min(given_m / _MIN_IMPROVEMENT, _MAX_RMS_M):
            stated = "it does not see the target" if np.isinf(given_m) else f"{1e-3 * given_m:.0f} km"
            yield (
                f"WARNING: with {mistake}, observations of {name} fit an a-priori position to {1e-3 * rms_m:.3g} km "
                f"(as given: {stated}): check itrf_m of [stations.{name}]"
            )


def _rms_m(
    predictor: Predictor,
    motions: Motions,
    rows: NDArray[np.intp],
    station: Station,
    itrf_m: NDArray[np.float64] | None = None,
) -> float:
    """Return the rms of residuals with other coordinates of a station; infinite without a model or a visible target."""
    stations = [item for item in predictor.model.catalogue if item.name != station.name]
    some = predictor.observations.select(rows)
    try:
        changed = station if itrf_m is None else replace(station, itrf_m=itrf_m)
        model = replace(predictor.model, catalogue=StationCatalogue([*stations, changed]))
        computed = prepare_predictor(model, some, motions, "exact", predictor.targets).compute()
    except InputError:  # such as a height outside the model of the troposphere
        return np.inf
    if not computed.usable.any():
        return np.inf
    return float(np.sqrt(np.square((some.value_m - computed.value_m)[computed.usable]).mean()))
