"""A log of half ranges: a heading with the station, then lines of reception (UTC), metres and sigma."""

from pathlib import Path

import numpy as np

from radioloc import Observations
from radioloc.io import Reader
from radioloc.time import epochs_from_strings


def read(paths, settings):
    heading, *lines = Path(paths[0]).read_text().splitlines()
    station = heading.split()[-1]
    epoch, value_m, sigma_m = np.array([line.split() for line in lines]).T
    return Observations.from_columns(
        epoch=epochs_from_strings(epoch.tolist(), "UTC"),
        value_m=value_m.astype(float),
        sigma_m=sigma_m.astype(float),
        kind="half_range",
        links=[f"{station}>lander>{station}"],
        tag="receive",
    )


HALF_RANGE_LOG = Reader(
    "half-range log", "first line: HALF RANGES OF", lambda head: head.startswith(b"HALF RANGES OF"), read
)
