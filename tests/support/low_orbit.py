"""Low polar lunar orbit of GRAIL-B in April 2012."""

import numpy as np

from radioloc.dynamics import Forces, GravityField, propagate
from radioloc.time import epochs_from_strings

EPOCH = epochs_from_strings("2012-04-09T04:30:00", "TDB")
POSITION_M = np.array([575750.0, -463261.0, -1631634.0])
VELOCITY_M_S = np.array([-567.855, 1434.222, -600.220])
STATE = np.concatenate([POSITION_M, VELOCITY_M_S])
TWO_BODY = {"bodies": (), "k2": 0.0, "figures": False, "relativity": False}
"""Options of forces that leave the central term only, with a field of degree 0."""


def forces(degree, **options):
    return Forces(GravityField.open("GRGM660PRIM", degree=degree), **options)


def propagated(forces, span_s, state=STATE, **options):
    return propagate(EPOCH, state[:3], state[3:], forces, span_s, **options)


def at(orbit, times_s):
    """Return states at times from the epoch, shape (n, 6)."""
    times_s = np.atleast_1d(times_s)
    return np.hstack(orbit.states(EPOCH.shifted(times_s)))
