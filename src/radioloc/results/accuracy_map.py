"""Accuracy of a tracking plan over a grid of landing sites."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.statistics import finite_or_none
from radioloc.results.cards import Card, Field, metres
from radioloc.results.result import Content, Raster, Result, Table
from radioloc.vectors import Floats

# Fraction of the determined sites that a site is better than.
_RANKS = {"best": 1.0, "median": 0.5, "worst": 0.0}
_SIGMAS = ("sigma_east_m", "sigma_north_m", "sigma_up_m")


@dataclass(frozen=True, slots=True, eq=False)
class AccuracyMap(Result):
    """Predicted sigmas at each of k times m sites in the middle of cells; infinite where a site is not determined."""

    name: str
    frame: str  #: mean-Earth axes of longitude and latitude
    height_m: float  #: of all sites above the sphere of 1737.4 km
    span_h: float  #: from the start to the last observation of any site
    longitude_deg: Floats  #: (m,), from west to east
    latitude_deg: Floats  #: (k,), from north to south
    count: NDArray[np.int64]  #: (k, m), observations
    refused: NDArray[np.int64]  #: (k, m), visible observations that the model cannot compute, as too low
    sigma_m: Floats  #: (k, m, 3), east, north and up
    radius_95_m: Floats  #: (k, m), of the horizontal circle with the true point in 95 % of cases

    @property
    def determined(self) -> bool:
        """True if the position of at least one site is determined."""
        return self.determined_count > 0

    @property
    def determined_count(self) -> int:
        """Number of sites whose position is determined."""
        return int(np.isfinite(self.radius_95_m).sum())

    @property
    def step_deg(self) -> float:
        """Size of a cell, deg."""
        axis = self.longitude_deg if len(self.longitude_deg) > 1 else self.latitude_deg
        return float(abs(axis[1] - axis[0])) if len(axis) > 1 else 1.0

    def site(self, row: int, column: int) -> dict[str, Any]:
        """Return the accuracy at a site."""
        sigmas = map(finite_or_none, self.sigma_m[row, column].tolist())
        return {
            "longitude_deg": float(self.longitude_deg[column]),
            "latitude_deg": float(self.latitude_deg[row]),
            "observations": int(self.count[row, column]),
            "refused": int(self.refused[row, column]),
            **dict(zip(_SIGMAS, sigmas, strict=True)),
            "radius_95_m": finite_or_none(float(self.radius_95_m[row, column])),
        }

    def ranked(self, fraction: float) -> tuple[int, int]:
        """Return row and column of the site that is better than a fraction of those determined; 1 is the best."""
        order = np.argsort(self.radius_95_m, axis=None, kind="stable")
        place = round((1.0 - fraction) * max(self.determined_count - 1, 0))
        row, column = divmod(int(order[place]), len(self.longitude_deg))
        return row, column

    def to_dict(self) -> dict[str, Any]:
        """Return the grid and its best, median and worst site, in types that JSON has."""
        ranks = _RANKS if self.determined else {}
        return {
            "name": self.name,
            "frame": self.frame,
            "height_m": self.height_m,
            "span_h": self.span_h,
            "step_deg": self.step_deg,
            "sites": self.count.size,
            "determined": self.determined_count,
            "refused": int(self.refused.sum()),
            **{name: self.site(*self.ranked(fraction)) for name, fraction in ranks.items()},
        }

    def files(self) -> Mapping[str, Content]:
        """Return the summary, a table with a row for each site, and the grid as GeoTIFF if rasterio is installed."""
        latitude_deg, longitude_deg = np.meshgrid(self.latitude_deg, self.longitude_deg, indexing="ij")
        finite = {
            name: np.where(np.isfinite(values), values, np.nan)
            for name, values in zip(
                (*_SIGMAS, "radius_95_m"), (*np.moveaxis(self.sigma_m, -1, 0), self.radius_95_m), strict=True
            )
        }
        places = {"longitude_deg": longitude_deg, "latitude_deg": latitude_deg}
        counts = {"observations": self.count, "refused": self.refused}
        table = {name: values.ravel() for name, values in (places | counts | finite).items()}
        contents: dict[str, Content] = {
            "accuracy_map.json": self.to_dict(),
            "accuracy_map.csv": Table(table, dict.fromkeys(places | finite, 4)),
        }
        if find_spec("rasterio"):
            west = self.longitude_deg[0] - 0.5 * self.step_deg
            north = self.latitude_deg[0] + 0.5 * self.step_deg
            contents["accuracy_map.tif"] = Raster(finite, float(west), float(north), self.step_deg)
        return contents

    def card(self) -> Card:
        """Return the card of the map."""
        heading = ("95 %, m", "deg E", "deg N", "obs.", "east", "north", "up")
        rows = [(name, *self._cells(fraction)) for name, fraction in _RANKS.items() if self.determined]
        return Card(
            (
                Field("accuracy", (self.name,)),
                Field("status", self._status()),
                Field("sites", (), ("", *heading), rows),
            )
        )

    def _status(self) -> Iterator[str]:
        yield f"{self.determined_count} of {self.count.size} sites are determined by {self.span_h:.1f} h of tracking"
        if refused := int(self.refused.sum()):
            yield f"{refused} of {refused + self.count.sum()} visible observations are too low for the media models"
        yield f"{self.frame}, height {self.height_m:.0f} m, a site every {self.step_deg:g} deg"

    def _cells(self, fraction: float) -> Iterator[str]:
        row, column = self.ranked(fraction)
        yield metres(float(self.radius_95_m[row, column]))
        yield f"{self.longitude_deg[column]:.2f}"
        yield f"{self.latitude_deg[row]:.2f}"
        yield str(self.count[row, column])
        yield from map(metres, self.sigma_m[row, column].tolist())

    def __repr__(self) -> str:
        best = float(np.min(self.radius_95_m, initial=math.inf))
        return f"<AccuracyMap {self.name}: {self.count.size} sites, the best within {metres(best)} m>"
