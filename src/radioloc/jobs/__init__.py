"""Jobs: functions that run a study and return a result. They are functions of :mod:`radioloc`."""

from radioloc.jobs.preparation import prepare_arc

__all__ = ["prepare_arc"]
