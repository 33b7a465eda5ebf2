"""Bodies about the Moon and its orientation over an arc, as piecewise Chebyshev series that compiled code evaluates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.dynamics._force_data import QUANTITIES
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.lunar import rot_between, rot_icrf_to_pa
from radioloc.time import Epochs

BODIES = ("earth", "sun", "venus", "jupiter", "saturn")
"""Point masses beside the Moon, in the order of the table."""

_SEGMENT_S = 21600.0
_NODES = 12  # within 6 h the twelfth coefficient of the Moon's motion is below rounding


def body_table(
    ephemeris: Ephemeris, libration: LunarOrientation, frame: str, epoch: Epochs, span_s: tuple[float, float]
) -> tuple[NDArray[np.float64], float, float]:
    """Chebyshev coefficients, shape (n_segments, QUANTITIES, n_coefficients), start and length of a segment, s.

    Of the positions of :data:`BODIES` from the Moon, zeros for those that the ephemeris does not hold, the rotation
    from the ICRF to the axes `frame`, row by row, and the velocities of the Earth and the Sun from the Moon and of the
    Moon from the barycentre; SI units, ICRF axes.

    Raises
    ------
    CoverageError
        The span, s from the epoch (TDB), is not that of the ephemeris or the Moon's orientation.
    InputError
        No angles lead from the axes of the orientation to `frame`.
    """
    count = max(1, int(np.ceil((span_s[1] - span_s[0]) / _SEGMENT_S)))
    length_s = max(span_s[1] - span_s[0], 1.0) / count
    angle = np.pi * (np.arange(_NODES) + 0.5) / _NODES
    nodes_s = span_s[0] + length_s * (np.arange(count)[:, None] + 0.5 * (1.0 + np.cos(angle)))
    tdb = epoch.shifted(nodes_s.ravel())
    values = np.zeros((nodes_s.size, QUANTITIES))
    moon_m, moon_m_s = ephemeris.geocentric("moon", tdb)
    values[:, :3] = -moon_m
    for k, body in enumerate(BODIES[1:], 1):
        if body in ephemeris.bodies:
            values[:, 3 * k : 3 * k + 3] = ephemeris.geocentric(body, tdb)[0] - moon_m
    to_frame = rot_between(libration.frame, frame)
    values[:, 15:24] = (to_frame @ rot_icrf_to_pa(libration.angles(tdb)[0])).reshape(-1, 9)
    values[:, 24:27] = -moon_m_s
    values[:, 27:30] = ephemeris.geocentric("sun", tdb)[1] - moon_m_s
    values[:, 30:] = ephemeris.earth(tdb).velocity_m_s + moon_m_s
    to_series = 2.0 / _NODES * np.cos(np.outer(np.arange(_NODES), angle))
    to_series[0] *= 0.5
    table = np.einsum("kj,sjq->sqk", to_series, values.reshape(count, _NODES, QUANTITIES))
    return np.ascontiguousarray(table), span_s[0], length_s
