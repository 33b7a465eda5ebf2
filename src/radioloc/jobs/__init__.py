"""Jobs: functions that run a study and return a result. The most used are functions of :mod:`radioloc`."""

from radioloc.jobs.arcs import leave_one_out
from radioloc.jobs.comparison import compare
from radioloc.jobs.passes import light_times, visibility
from radioloc.jobs.preparation import arc_of
from radioloc.jobs.verification import verify

__all__ = [
    "arc_of",
    "compare",
    "leave_one_out",
    "light_times",
    "verify",
    "visibility",
]
