"""End of a fit: its status, and reasons why its estimate cannot be used."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class FitStatus(enum.StrEnum):
    """End of a fit, and whether its estimate can be used; the value is shown to users."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "not converged: iteration limit reached"
    DIVERGED = "not converged: no step lowers the sum of squares"
    UNOBSERVABLE = "not observable: the data do not determine every parameter"
    UNSETTLED = "not converged: the editing did not settle"
    HIDDEN = "not converged: a used station cannot see the point"
    OFF_THE_MOON = "not converged: a height that the Moon does not have"
    MISFIT = "not converged: the observations do not fit the model"


@dataclass(frozen=True, slots=True)
class Doubt:
    """Reason why an estimate cannot be used: a status, and a sentence with numbers."""

    status: FitStatus
    reason: str
