"""How far maps show everything too far east and north (m): their tie to the Moon's axes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from radioloc.measurements.map_predictor import MapPredictor
from radioloc.measurements.registry import is_on_map, kind_of
from radioloc.parameters.kind import Amount, ParameterKind, Scope
from radioloc.parameters.rows import ObservationRows


def _on_map(rows: ObservationRows) -> NDArray[np.bool_]:
    return is_on_map(rows.kind)[:, None]


def _partials(rows: ObservationRows) -> NDArray[np.float64]:
    components = [rows.kind == kind_of(name) for name in ("map_east", "map_north")]
    return np.stack(components, axis=-1)[:, None, :].astype(np.float64)


def _stated(rows: ObservationRows, members: Mapping[str, int]) -> Mapping[str, Amount]:
    """What is stated of each map."""
    assert isinstance(rows.predictor, MapPredictor)  # nothing else has members
    return rows.predictor.map_sigma_m


MAP_TIE = ParameterKind(
    name="map_tie",
    unit="m",
    description="how far a map shows everything too far east and north; with the sigma that is stated of the map",
    scopes=(Scope.MAP,),
    partials=_partials,
    acts_on=_on_map,
    components=("east", "north"),
    considered=_stated,
)
