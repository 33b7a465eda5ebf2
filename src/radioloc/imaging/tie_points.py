"""Tie points that are measured elsewhere, by hand or with other software, for :func:`register_chain`."""

from __future__ import annotations

from dataclasses import dataclass

_DEFAULT_SIGMA_PX = 1.0  # of points clicked by hand


@dataclass(frozen=True, slots=True)
class Measurement:
    """Where a point is in one image."""

    image: str
    sample: float
    line: float
    sigma_px: float = _DEFAULT_SIGMA_PX


@dataclass(frozen=True, slots=True)
class TiePoint:
    """A point measured in images, with its place on the Moon where that is known (mean-Earth axes)."""

    name: str
    measurements: tuple[Measurement, ...]
    longitude_deg: float | None = None
    latitude_deg: float | None = None
    sigma_m: float | None = None
