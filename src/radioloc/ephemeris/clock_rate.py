"""How fast ideal clocks run where an ephemeris has them, against coordinate time at the geocentre."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.ephemeris.positions import Ephemeris
from radioloc.time import Epochs
from radioloc.vectors import dot, length


def clock_rate(
    ephemeris: Ephemeris,
    tdb: Epochs,
    place_m: NDArray[np.float64],
    velocity_m_s: NDArray[np.float64],
    leave_out: str = "",
) -> NDArray[np.float64]:
    """Rate of a clock against TCG at the geocentre, d(tau - TCG)/d(TDB), shape (n,).

    It is -[(v^2 - v_E^2) / 2 + w(x) - w_E(x_E)] / c^2, with the barycentric velocities v of clock and Earth, the
    potential w of all bodies at the clock and w_E of all but the Earth at the geocentre (IERS Conventions 2010, section
    10.1; Soffel et al. 2003). Terms of the order c^-4 are below 1e-17.

    Parameters
    ----------
    ephemeris : Ephemeris
        What the Earth and other bodies are taken from.
    tdb : Epochs
        When.
    place_m, velocity_m_s : ndarray, shape (n, 3)
        Of the clock from the geocentre, ICRF axes.
    leave_out : str
        A body whose potential does not act on the clock: that in whose centre it is, for coordinate time there.
    """
    gm = ephemeris.constants.gm_m3_s2
    slower = dot(ephemeris.earth(tdb).velocity_m_s + 0.5 * velocity_m_s, velocity_m_s)
    slower = slower + gm("earth") / length(place_m)
    for body in ephemeris.bodies:
        body_m, _ = ephemeris.geocentric(body, tdb)
        slower = slower - gm(body) / length(body_m)
        if body != leave_out:
            slower = slower + gm(body) / length(place_m - body_m)
    return np.asarray(-slower / C_M_S**2)
