"""What studies of images have in common: the ground's height at a place, and what a result was made from."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.kernels import sha256_of
from radioloc.lunar import TerrainModel
from radioloc.studies.image_study import GroundChoice
from radioloc.studies.record import versions

Floats = NDArray[np.float64]

FRAME = "ME_DE421"
"""The axes of lunar maps."""


class Ground(NamedTuple):
    """The ground at a place."""

    height_m: float
    sigma_m: float  # NaN where nothing tells the height
    to_enu: Floats  # (3, 2): east, north and up on the ground by east and north
    notes: tuple[str, ...]


def ground_at(chosen: GroundChoice, longitude_deg: float, latitude_deg: float) -> Ground:
    """The height of the ground as far as it is known, and how it follows the place."""
    if chosen.height_m is not None:
        return Ground(chosen.height_m, chosen.height_sigma_m, np.eye(3)[:, :2], ())
    if chosen.dem is None:
        note = "no height is known: give dem or height_m; the position stands on the sphere of 1737.4 km"
        return Ground(0.0, math.nan, np.vstack([np.eye(2), [math.nan, math.nan]]), (note,))
    longitude, latitude = np.radians([[longitude_deg], [latitude_deg]])
    height_m, by_longitude, by_latitude = (
        float(np.ravel(v)[0]) for v in TerrainModel.open(chosen.dem).height_and_slope(longitude, latitude)
    )
    slope = np.array([by_longitude / math.cos(latitude[0]), by_latitude]) / (MEAN_LUNAR_RADIUS_M + height_m)
    return Ground(height_m, chosen.dem_sigma_m, np.vstack([np.eye(2), slope]), ())


def provenance_of(
    study: Path | None, images: Iterable[Path], others: Iterable[Path | None]
) -> dict[str, Any]:
    """What a solution is from: the study, the images that it measures or else its own numbers, and other files."""
    measured = [*images] or ([] if study is None else [study])
    files = dict.fromkeys([*measured, *(path for path in others if path is not None)])
    origin = None
    if study is not None:
        origin = {
            "file": str(study.resolve()),
            "sha256": sha256_of(study),
            "hours": None,
            "inputs": [{"file": path.name, "sha256": sha256_of(path)} for path in files],
        }
    return {**versions(), "study": origin, "files": [path.name for path in measured]}
