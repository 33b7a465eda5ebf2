"""Who sees whom at very many epochs: computed a minute apart, and between only as far as that leaves something open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.earth.geodesy import rot_itrf_to_enu
from radioloc.ephemeris import Trajectory
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.simulation.visibility import Masks, Target, directions_itrf, elevations
from radioloc.time import Epochs, lagrange_weights

_NODES_S = 60.0
"""Apart are the epochs at which dense series are computed: seven points on are missed by 1e-15."""
_POINTS = 8
_FASTEST_RAD_S = 9e-5
"""No elevation of a point on the Moon above a station's horizon changes faster, nor that of a station above the
point's: the Earth turns by 7.3e-5 rad/s, the Moon goes round it by up to 3.3e-6, a station passes by it at 1.3e-6."""
_EPOCHS_AT_ONCE = 32768


def seen(
    model: PhysicalModel, target_pa_m: Target, stations: Sequence[str], tt: Epochs, masks: Masks
) -> NDArray[np.bool_]:
    """Whether target and stations see each other, above the masks, shape (n, k).

    Parameters and errors as :func:`elevations`; the epochs in order.

    Notes
    -----
    Of dense epochs one a minute is computed. Between two of them a margin that is a and b there, of one sign, cannot
    have changed it if |a| + |b| is more than it can change in that time; where it can, all epochs between are computed.
    A spacecraft's elevations have no such bound.
    """
    n = len(tt)
    length_s = float(tt[-1].seconds_since(tt[0])[0]) if n else 0.0
    every = 1
    if length_s > 0.0 and not isinstance(target_pa_m, Trajectory):
        every = max(1, int(_NODES_S * (n - 1) / length_s))

    def margin_rad(rows: NDArray[np.intp]) -> NDArray[np.float64]:
        parts = np.split(rows, range(_EPOCHS_AT_ONCE, len(rows), _EPOCHS_AT_ONCE))
        return np.concatenate(
            [elevations(model, target_pa_m, stations, tt[part]).margin_rad(masks) for part in parts]
        )

    coarse = np.unique(np.append(np.arange(0, n, every), n - 1)) if n else np.arange(0)
    margin = margin_rad(coarse)
    if every == 1:
        return margin >= 0.0
    between = np.diff(coarse)
    out = np.append(np.repeat(margin[:-1] >= 0.0, between, axis=0), margin[-1:] >= 0.0, axis=0)
    apart_s = tt[coarse[1:]].seconds_since(tt[coarse[:-1]])
    same = (margin[1:] >= 0.0) == (margin[:-1] >= 0.0)
    far = np.abs(margin[1:]) + np.abs(margin[:-1]) > _FASTEST_RAD_S * apart_s[:, None]
    doubtful = np.flatnonzero(np.repeat(~(same & far).all(axis=1), between))
    if len(doubtful):
        out[doubtful] = margin_rad(doubtful) >= 0.0
    return out


def station_elevations_rad(
    model: PhysicalModel,
    target_pa_m: Target,
    stations: Sequence[str],
    which: NDArray[np.intp],
    tt: Epochs,
) -> NDArray[np.float64]:
    """Elevation of the target above the horizon of one station at each epoch, rad, shape (n,).

    Parameters and errors as :func:`elevations`; ``which`` says which of the stations at each epoch. Those of a point on
    the Moon are interpolated where epochs are dense, within 1e-12 rad.
    """
    nodes = None if isinstance(target_pa_m, Trajectory) else _Nodes.of(tt)
    if nodes is None or isinstance(target_pa_m, Trajectory):
        return elevations(model, target_pa_m, stations, tt).at_station_rad[np.arange(len(tt)), which]
    # Directions are smooth also where an elevation is not, in the zenith.
    away = directions_itrf(model, target_pa_m, stations, nodes.tt)
    enu = np.stack([rot_itrf_to_enu(model.catalogue.get(name).itrf_m) for name in stations])
    away = np.einsum("kij,nkj->nki", enu, away)
    out = np.empty(len(tt))
    for start in range(0, len(tt), _EPOCHS_AT_ONCE):
        rows = slice(start, start + _EPOCHS_AT_ONCE)
        east, north, up = nodes.interpolated(away, rows, which[rows]).T
        out[rows] = np.arctan2(up, np.hypot(east, north))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Nodes:
    """Epochs about a minute apart, from the first to the last of dense ones, between which to interpolate.

    Parameters
    ----------
    tt : Epochs
        The nodes that are needed.
    first : ndarray of int, shape (n,)
        The first of the eight nodes of each epoch.
    place : ndarray, shape (n,)
        Where the epoch lies, in nodes from that one.
    """

    tt: Epochs
    first: NDArray[np.intp]
    place: NDArray[np.float64]

    @classmethod
    def of(cls, tt: Epochs) -> _Nodes | None:
        """None where the epochs are so few that it is not worth it."""
        if len(tt) < 2 * _POINTS:
            return None
        origin = tt[int(np.argmin(tt.mjd))]
        since_s = tt.seconds_since(origin)
        steps = int(np.ceil(since_s.max() / _NODES_S))
        if steps < _POINTS:
            return None
        step_s = since_s.max() / steps
        place = since_s / step_s
        first = np.clip(place.astype(np.intp) - (_POINTS // 2 - 1), 0, steps + 1 - _POINTS)
        starts, which = np.unique(first, return_inverse=True)
        nodes = np.unique(starts[:, None] + np.arange(_POINTS))
        if len(nodes) > len(tt) // 2:
            return None
        at = origin[np.zeros(len(nodes), dtype=np.intp)].shifted(nodes * step_s)
        return cls(at, np.searchsorted(nodes, starts)[which], place - first)

    def interpolated(
        self, values: NDArray[np.float64], rows: slice, which: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """Of the values at the nodes, shape (nodes, k, ...), those of one k at each epoch of some rows."""
        first = self.first[rows]
        weights = lagrange_weights(self.place[rows] - (_POINTS // 2 - 1))
        out = np.zeros((len(first), *values.shape[2:]))
        for k in range(_POINTS):
            out += weights[:, k, None] * values[first + k, which]
        return out
