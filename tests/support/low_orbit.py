"""A low polar orbit about the Moon, that of GRAIL-B in April 2012."""

import numpy as np

from radioloc.dynamics import Forces, GravityField, propagate
from radioloc.time import epochs_from_strings

EPOCH = epochs_from_strings("2012-04-09T04:30:00", "TDB")
POSITION_M = np.array([575750.0, -463261.0, -1631634.0])
VELOCITY_M_S = np.array([-567.855, 1434.222, -600.220])
STATE = np.concatenate([POSITION_M, VELOCITY_M_S])
TWO_BODY = {"bodies": (), "k2": 0.0, "figures": False, "relativity": False}
"""What leaves the central term alone, with a field of degree 0."""


def forces(degree, **more):
    return Forces(GravityField.open("GRGM660PRIM", degree=degree), **more)


def propagated(forces, span_s, state=STATE, **more):
    return propagate(EPOCH, state[:3], state[3:], forces, span_s, **more)


def at(orbit, times_s):
    """States at times from the epoch, shape (n, 6)."""
    times_s = np.atleast_1d(times_s)
    return np.hstack(orbit.states(EPOCH.shifted(times_s)))
