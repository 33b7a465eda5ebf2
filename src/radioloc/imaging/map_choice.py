"""Choice of base maps: those that cover the region of a solution, with a similar Sun and the finest pixels first.

Craters look different under another Sun, so that fewer features match.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from radioloc.errors import DataQualityWarning, InputError
from radioloc.imaging.shading import sun_over_map
from radioloc.imaging.study import ImageChoice
from radioloc.lunar.maps import Map, TangentPlane
from radioloc.results.tables import horizontal_covariance_of, position_of
from radioloc.time import epochs_from_strings
from radioloc.vectors import Floats

MAX_SUN_DIFFERENCE_DEG = 30.0
_SIGMAS_95 = math.sqrt(-2.0 * math.log(0.05))  # semi-axes of the ellipse
_RING_POINTS = 72
_REGION_PIXELS = 64  # along each side of the view in which coverage is tested


@dataclass(frozen=True, slots=True, eq=False)
class MapCandidate:
    """Base map that can show the landing site; angles are from the Sun of the map to that of the images."""

    base: Map
    sun_difference_deg: float | None = None  # of azimuth, absolute; None for unknown epochs

    @property
    def has_similar_sun(self) -> bool:
        """True if the azimuths of the Sun agree, or are unknown."""
        return (self.sun_difference_deg or 0.0) <= MAX_SUN_DIFFERENCE_DEG


def find_candidates(chosen: ImageChoice, region: Floats | None) -> list[MapCandidate]:
    """Return the maps that cover a region, (n, 2) longitudes and latitudes in deg, those to be searched first leading.

    Another Sun than that of the images is a :class:`DataQualityWarning`.
    """
    maps = [Map.open(path) for path in chosen.base_maps]
    epochs: tuple[str | None, ...] = chosen.base_map_epochs or (None,) * len(maps)
    candidates = []
    for base, epoch in zip(maps, epochs, strict=True):
        if region is None or _covers(base, region):
            candidates.append(
                MapCandidate(base, None if epoch is None else _sun_difference_deg(chosen, base, epoch))
            )
    if not candidates:
        coverage = "; ".join(f"{base.path.name} covers {base.coverage}" for base in maps)
        raise InputError(
            f"base_map: expected a map that covers the 95 % ellipse of {chosen.near}, but {coverage}; give another map"
        )
    for candidate in candidates:
        if not candidate.has_similar_sun:
            warnings.warn(_sun_warning(candidate), DataQualityWarning, stacklevel=2)
    return sorted(
        candidates, key=lambda candidate: (not candidate.has_similar_sun, candidate.base.resolution_m)
    )


def sun_notes(candidates: list[MapCandidate]) -> tuple[str, ...]:
    """Return the warnings about the Sun."""
    return tuple(_sun_warning(candidate) for candidate in candidates if not candidate.has_similar_sun)


def _sun_warning(candidate: MapCandidate) -> str:
    return (
        f"the Sun over {candidate.base.path.name} is {candidate.sun_difference_deg:.0f} degrees from that of the "
        "images, and craters look different; give a map under a similar Sun, or shade an elevation model"
    )


def _sun_difference_deg(chosen: ImageChoice, base: Map, epoch: str) -> float:
    azimuth_deg = chosen.sun_azimuth_deg
    if chosen.epoch is not None:
        azimuth_deg, _ = sun_over_map(base, chosen.epoch)
    assert azimuth_deg is not None
    of_map_deg, _ = sun_over_map(base, epochs_from_strings(epoch, "UTC"))
    return abs(math.remainder(of_map_deg - azimuth_deg, 360.0))


def confidence_ellipse(content: dict[str, Any]) -> Floats | None:
    """Return longitudes and latitudes of the 95 % ellipse of a recorded solution, deg, shape (n, 2)."""
    place, covariance = position_of(content)["me"], horizontal_covariance_of(content)
    if covariance is None:
        return None
    variances, axes = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, _RING_POINTS)
    ring = (
        np.column_stack([np.cos(angle), np.sin(angle)]) @ (axes * _SIGMAS_95 * np.sqrt(variances.clip(0.0))).T
    )
    plane = TangentPlane(place["longitude_deg"], place["latitude_deg"])
    return plane.to_longitude_latitude(np.vstack([ring, np.zeros(2)]))


def _covers(base: Map, region: Floats) -> bool:
    """Return True if a map has values at all places of a region, of which the last is the middle."""
    plane = TangentPlane(*region[-1].tolist())
    places_m = plane.from_longitude_latitude(region)
    reach_m = float(np.abs(places_m).max()) + base.resolution_m
    pixel_m = 2.0 * reach_m / (_REGION_PIXELS - 1)
    _, valid = base.view(plane, -reach_m, reach_m, pixel_m, (_REGION_PIXELS, _REGION_PIXELS))
    column, row = np.rint((places_m * [1.0, -1.0] + reach_m) / pixel_m).astype(int).T
    return bool(valid[row, column].all())
