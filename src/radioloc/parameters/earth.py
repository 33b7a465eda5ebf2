"""Where the stations are: their coordinates (m), UT1 (s) and the pole (rad), each beyond the model's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import EARTH_ROTATION_RAD_S
from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.parameters import apriori
from radioloc.parameters.kind import ParameterKind, Scope, both_stations, everywhere
from radioloc.parameters.rows import ObservationRows


def _itrf_m(rows: ObservationRows) -> NDArray[np.float64]:
    """ITRF coordinates of the stations that take part, m, shape (n_stations, 3)."""
    return np.array([rows.model.catalogue.get(name).itrf_m for name in rows.predictor.stations])


def _station_position(rows: ObservationRows) -> NDArray[np.float64]:
    to_enu = np.array([rot_itrf_to_enu(itrf_m) for itrf_m in _itrf_m(rows)])
    by_enu = np.einsum("mekl,mel->mek", to_enu[rows.ends], rows.computed.by_station_itrf)
    return np.asarray(by_enu * (rows.ends >= 0)[..., None])


def _displaced(rows: ObservationRows, shifts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Partials by what displaces all stations, ITRF, m per unit, shape (n_stations, 3, components)."""
    return np.asarray(np.einsum("mel,melc->mec", rows.computed.by_station_itrf, shifts[rows.ends]))


def _ut1(rows: ObservationRows) -> NDArray[np.float64]:
    x, y, z = _itrf_m(rows).T
    return _displaced(rows, EARTH_ROTATION_RAD_S * np.stack([-y, x, 0.0 * z], axis=-1)[..., None])


def _pole(rows: ObservationRows) -> NDArray[np.float64]:
    """W = R3(-s') R2(xp) R1(yp), IERS Conventions 2010, equation 5.3."""
    x, y, z = _itrf_m(rows).T
    zero = 0.0 * x
    by_xp, by_yp = np.stack([-z, zero, x], axis=-1), np.stack([zero, z, -y], axis=-1)
    return _displaced(rows, np.stack([by_xp, by_yp], axis=-1))


STATION_POSITION = ParameterKind(
    name="station_position",
    unit="m",
    description="correction to a station's catalogue coordinates: east, north, up",
    scopes=(Scope.STATION,),
    partials=_station_position,
    acts_on=both_stations,
    components=("east", "north", "up"),
    more_partials=True,
    considered=apriori.station_positions,
)
UT1 = ParameterKind(
    name="ut1",
    unit="s",
    description="correction to the tabulated UT1",
    scopes=(Scope.EARTH, Scope.SESSION),
    partials=_ut1,
    acts_on=everywhere,
    scale=2e-3,
    more_partials=True,
    considered=apriori.ut1,
)
POLE = ParameterKind(
    name="pole",
    unit="rad",
    description="correction to the tabulated pole coordinates xp and yp",
    scopes=(Scope.EARTH, Scope.SESSION),
    partials=_pole,
    acts_on=everywhere,
    components=("x", "y"),
    scale=1.6e-7,
    more_partials=True,
    considered=apriori.pole,
)
