"""Time scales UTC, TAI, TT, UT1 and TDB, and epochs.

An epoch is two floats, :class:`Epochs`, because a single float of seconds since J2000 resolves 0.12 microseconds,
36 m of light. Only this package adds leap seconds or TDB-TT.
"""

from radioloc.time.dates import epochs_from_strings
from radioloc.time.epochs import Epochs
from radioloc.time.scales import (
    geocentric_tdb_minus_tt,
    tai_to_tt,
    tai_to_utc,
    to_scale,
    topocentric_tdb_minus_tt,
    tt_to_tdb,
    utc_strings,
    utc_to_tai,
    utc_to_tt,
)

__all__ = [
    "Epochs",
    "epochs_from_strings",
    "geocentric_tdb_minus_tt",
    "tai_to_tt",
    "tai_to_utc",
    "to_scale",
    "topocentric_tdb_minus_tt",
    "tt_to_tdb",
    "utc_strings",
    "utc_to_tai",
    "utc_to_tt",
]
