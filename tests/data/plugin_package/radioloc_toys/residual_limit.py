"""Table ``[residual_limit]`` of a study file: the residual that a station may have, m."""

from dataclasses import dataclass

from radioloc.errors import InputError
from radioloc.study import StudyTable


@dataclass(frozen=True)
class ResidualLimit:
    limit_m: float

    def __post_init__(self):
        if self.limit_m <= 0.0:
            raise InputError(f"limit_m: expected a positive length, got {self.limit_m}")


RESIDUAL_LIMIT = StudyTable("residual_limit", ResidualLimit)
