"""Table ``[elevation_noise]``: white noise that grows with the air on the path, sigma / sin(elevation)."""

from dataclasses import dataclass

import numpy as np

from radioloc.noise import White
from radioloc.study import StudyTable


@dataclass(frozen=True)
class ElevationNoise:
    zenith_sigma_m: float

    def noise_term(self, arc):
        elevation_rad = arc.compute().elevation_rad  # of both stations, shape (n, 2)
        return White(self.zenith_sigma_m * np.hypot(*(1.0 / np.sin(elevation_rad)).T))


ELEVATION_NOISE = StudyTable("elevation_noise", ElevationNoise)
