"""Jobs: functions that run a study and return a result. They are functions of :mod:`radioloc`."""

from radioloc.jobs.preparation import arc_of

__all__ = ["arc_of"]
