"""A position from a point in one image, or from stereo images of landmarks: its card and its dictionary."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.combination import horizontal_ellipse
from radioloc.estimation.statistics import finite_or_none
from radioloc.lunar.position import LunarPosition
from radioloc.report.cards import Card, Field, Shown, metres
from radioloc.report.one_position import position_content, position_field, reference_field

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSource:
    """What a part of the covariance is from.

    Parameters
    ----------
    name : str
        On the card.
    errors_enu_m : ndarray, shape (3, k)
        How far each error of one sigma moves the position; NaN up where nothing tells the height.
    shared : tuple of (str, str, float), optional
        Name, unit and sigma of each, where other solutions have the same errors.
    """

    name: str
    errors_enu_m: Floats
    shared: tuple[tuple[str, str, float], ...] = ()

    @property
    def covariance_enu_m2(self) -> Floats:
        """Its part of the covariance, shape (3, 3)."""
        return self.errors_enu_m @ self.errors_enu_m.T


@dataclass(frozen=True, slots=True, eq=False)
class PointSolution(Shown):
    """Where a point is that an image shows, or a rover or lander that took stereo images.

    Parameters
    ----------
    name : str
        Of the study.
    method : {"image_point", "stereo"}
    message : str
        Why the position cannot be used; empty where it can.
    position : LunarPosition
        Mean-Earth axes.
    sources : tuple of ErrorSource
        What its covariance is from; it is their sum.
    fields : tuple of Field
        What the card says of the measurements.
    details : mapping
        The same in numbers.
    used : int
        Points or landmarks.
    wrms_m : float, optional
        Of distances, weighted.
    references : mapping of str to LunarPosition
        Known positions.
    notes : tuple of str
    provenance : mapping
    landmarks_en_m, distances_m : ndarray, shape (n, 2) and (n,), optional
        Of a stereo solution: landmarks east and north of the position and their horizontal distances, m.
    """

    name: str
    method: str
    message: str
    position: LunarPosition
    sources: tuple[ErrorSource, ...]
    fields: tuple[Field, ...]
    details: Mapping[str, Any]
    used: int
    wrms_m: float | None = None
    references: Mapping[str, LunarPosition] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    landmarks_en_m: Floats | None = None
    distances_m: Floats | None = None

    @property
    def converged(self) -> bool:
        """Whether the position can be used."""
        return not self.message

    @property
    def covariance_enu_m2(self) -> Floats:
        """Total covariance, shape (3, 3); NaN for a height that nothing determines."""
        return sum((source.covariance_enu_m2 for source in self.sources), np.zeros((3, 3)))

    @property
    def sigma_enu_m(self) -> Floats:
        """Total standard deviations east, north, up, m; NaN where not determined."""
        return np.sqrt(np.diag(self.covariance_enu_m2))

    def to_dict(self) -> dict[str, Any]:
        """All numbers, with the keys of :meth:`radioloc.Solution.to_dict`, and one of the method's name."""
        return {
            "name": self.name,
            "method": self.method,
            "converged": self.converged,
            "status": "converged" if self.converged else "not converged",
            "message": self.message,
            **position_content(self.position, self.covariance_enu_m2, self.references),
            "budget": {
                source.name: [finite_or_none(float(v)) for v in np.sqrt(np.diag(source.covariance_enu_m2))]
                for source in self.sources
            },
            "biases": {},
            "considered": [
                {
                    "name": name,
                    "unit": unit,
                    "sigma": sigma,
                    "position_enu_m": [finite_or_none(float(v)) for v in source.errors_enu_m[:, k]],
                }
                for source in self.sources
                for k, (name, unit, sigma) in enumerate(source.shared)
            ],
            "fit": {"used": self.used, "rejected": 0, "wrms_m": self.wrms_m, "by_station": {}},
            self.method: dict(self.details),
            "notes": list(self.notes),
            "provenance": dict(self.provenance),
        }

    def card(self) -> Card:
        """Card of the solution."""
        ellipse = horizontal_ellipse(self.covariance_enu_m2[:2, :2])
        rows = [(source.name, *_sides(np.sqrt(np.diag(source.covariance_enu_m2)))) for source in self.sources]
        return Card(
            (
                Field("solution", (self.name,)),
                Field("status", ("CONVERGED" if self.converged else f"NOT CONVERGED: {self.message}",)),
                position_field(self.position),
                Field(
                    "sigma",
                    (
                        f"95 % error ellipse, horizontal: {metres(ellipse.semi_major_m)} m x "
                        f"{metres(ellipse.semi_minor_m)} m, azimuth {ellipse.azimuth_deg:.0f} deg",
                    ),
                    ("1 sigma, m", "east", "north", "up"),
                    [*rows, ("all", *_sides(self.sigma_enu_m))],
                ),
                *self.fields,
                reference_field(self.position, self.references),
                Field("notes", self.notes),
            )
        )

    def __repr__(self) -> str:
        longitude, latitude, _ = self.position.selenographic
        state = "converged" if self.converged else "NOT CONVERGED"
        return f"<PointSolution {self.name}: {longitude:.6f} deg E, {latitude:.6f} deg N, {state}>"


def _sides(sigma_enu_m: Floats) -> tuple[str, ...]:
    return tuple(metres(round(side, 4)) if math.isfinite(side) else "-" for side in sigma_enu_m)
