"""A position from descent images: what came out, its card and its dictionary."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.imaging import Camera, Map
from radioloc.imaging.image_chain import FrameStatus
from radioloc.imaging.registration import RegisteredFrame, Registration
from radioloc.lunar.position import LunarPosition
from radioloc.report.cards import Card, Field, Shown, metres, plural
from radioloc.report.one_position import ENU, position_content, position_field, reference_field

Floats = NDArray[np.float64]

_MOST_ROWS = 12
MAP_TIE = "map_tie"
"""Name of the considered error that all points of a map have in common."""


class CameraOf(Protocol):
    """A camera that is known, for images of any size."""

    @property
    def distortion(self) -> tuple[float, ...]:
        """Its coefficients."""

    def camera(self, shape: tuple[int, int]) -> Camera:
        """That of images of so many lines and samples."""


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class ImageSolution(Shown):
    """Where a lander stands by its descent images, and how each image was registered.

    Parameters
    ----------
    name : str
        Of the study.
    message : str
        Why the position cannot be used; empty where it can.
    position : LunarPosition
        Mean-Earth axes.
    covariance_enu_m2 : ndarray, shape (3, 3)
        Total covariance; NaN for a height that nothing determines.
    map_name : str
        What the images were laid over; its tie is one error for all solutions on it.
    map_sigma_m : tuple of float
        Tie of the map to the Moon's axes, east and north.
    registration : Registration
        Each image after the adjustment.
    altitudes_m : mapping of str to float
        Of the camera above the ground, by image, where the camera is known.
    base : Map
    camera : CameraChoice or None
    mask : ndarray of bool or None
        Which pixels of the images show the ground.
    references : mapping of str to LunarPosition
        Known positions.
    notes : tuple of str
    provenance : mapping
    paths : mapping of str to Path
        The images' files, by name.
    """

    name: str
    message: str
    position: LunarPosition
    covariance_enu_m2: Floats
    map_name: str
    map_sigma_m: tuple[float, float]
    registration: Registration
    base: Map
    camera: CameraOf | None = None
    mask: NDArray[np.bool_] | None = None
    altitudes_m: Mapping[str, float] = field(default_factory=dict)
    references: Mapping[str, LunarPosition] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    paths: Mapping[str, Path] = field(default_factory=dict, repr=False)

    @property
    def converged(self) -> bool:
        """Whether the position can be used."""
        return not self.message

    @property
    def sigma_enu_m(self) -> Floats:
        """Total standard deviations east, north, up, m; NaN where not determined."""
        return np.sqrt(np.diag(self.covariance_enu_m2))

    @property
    def registered(self) -> tuple[RegisteredFrame, ...]:
        """Images that have a place on the map."""
        return tuple(f for f in self.registration.frames if f.status is FrameStatus.REGISTERED)

    @property
    def wrms_m(self) -> float:
        """Root mean square of the residuals of tie points on the ground, weighted by one over their pixels, m."""
        count, rms_m, pixel_m = np.array([(f.inliers, f.rms_m, f.pixel_m) for f in self.registered]).T
        return float(np.sqrt(np.average(rms_m**2, weights=count / pixel_m**2)))

    @property
    def relative_covariance_en_m2(self) -> Floats:
        """Covariance of east and north relative to the map, without its tie to the Moon's axes, shape (2, 2)."""
        return np.asarray(self.covariance_enu_m2[:2, :2] - np.diag(np.square(self.map_sigma_m)))

    def to_dict(self) -> dict[str, Any]:
        """All numbers, with the keys of :meth:`radioloc.Solution.to_dict`, and ``images``."""
        return {
            "name": self.name,
            "method": "images",
            "converged": self.converged,
            "status": "converged" if self.converged else "not converged",
            "message": self.message,
            **position_content(self.position, self.covariance_enu_m2, self.references),
            "biases": {},
            "considered": [
                {
                    "name": f"{MAP_TIE}.{self.map_name}.{axis}",
                    "unit": "m",
                    "sigma": sigma_m,
                    "position_enu_m": (sigma_m * np.eye(3)[k]).tolist(),
                }
                for k, (axis, sigma_m) in enumerate(zip(ENU, self.map_sigma_m, strict=False))
            ],
            "fit": {
                "used": sum(frame.inliers for frame in self.registered),
                "rejected": sum(max(frame.candidates - frame.inliers, 0) for frame in self.registered),
                "wrms_m": self.wrms_m,
                "rms_px": float(np.sqrt(np.mean([frame.rms_px**2 for frame in self.registered]))),
                "sigma_factor_images": self.registration.sigma_factors[0],
                "sigma_factor_map": self.registration.sigma_factors[1],
                "redundancy": self.registration.redundancy,
                "by_station": {},
            },
            "images": [self._image(frame) for frame in self.registration.frames],
            "notes": list(self.notes),
            "provenance": dict(self.provenance),
        }

    def _image(self, frame: RegisteredFrame) -> dict[str, Any]:
        content: dict[str, Any] = {
            "file": frame.name,
            "status": frame.status.value,
            "reason": frame.reason,
            "matched_to": list(frame.matched_to),
            "matches": frame.candidates,
            "inliers": frame.inliers,
            "map_inliers": frame.map_inliers,
        }
        if frame.homography is None:
            return content
        centre = None
        with contextlib.suppress(InputError):  # it may show the sky, or ground far beyond the tie points
            point = self.registration.ground_point(frame.name)
            centre = {
                "longitude_deg": point.longitude_deg,
                "latitude_deg": point.latitude_deg,
                "covariance_en_m2": point.covariance_m2.tolist(),
            }
        return content | {
            "rms_px": frame.rms_px,
            "rms_m": frame.rms_m,
            "pixel_m": frame.pixel_m,
            "altitude_m": self.altitudes_m.get(frame.name),
            "plane": {
                "longitude_deg": self.registration.plane.longitude_deg,
                "latitude_deg": self.registration.plane.latitude_deg,
            },
            "parameters": frame.homography.matrix.ravel()[:8].tolist(),
            "covariance": frame.homography.covariance.tolist(),
            "centre": centre,
        }

    def card(self) -> Card:
        """Card of the solution."""
        sigmas = self.sigma_enu_m
        up = metres(sigmas[2]) if math.isfinite(sigmas[2]) else "not determined"
        tie = " and ".join(metres(value) for value in self.map_sigma_m)
        # The first and the last images tell most.
        frames, half = list(self.registration.frames), _MOST_ROWS // 2
        shown = frames if len(frames) <= _MOST_ROWS else frames[:half] + frames[-half:]
        return Card(
            (
                Field("solution", (self.name,)),
                Field("status", ("CONVERGED" if self.converged else f"NOT CONVERGED: {self.message}",)),
                position_field(self.position),
                Field(
                    "1 sigma",
                    (
                        f"east {metres(sigmas[0])}, north {metres(sigmas[1])} m, up {up} m",
                        f"in it the tie of {self.map_name} to the Moon's axes, {tie} m east and north",
                    ),
                ),
                reference_field(self.position, self.references),
                Field(
                    "images",
                    (f"{len(self.registered)} of {len(frames)} registered",),
                    ("image", "status", "matched to", "inliers", "rms, px", "pixel, m", "altitude, m"),
                    map(self._row, shown),
                    rest=map(self._row, frames[half : len(frames) - len(shown) + half]),
                    where="solution.json",
                ),
                Field("left out", tuple(self._left_out())),
                Field("notes", self.notes),
            )
        )

    def __repr__(self) -> str:
        longitude, latitude, _ = self.position.selenographic
        state = "converged" if self.converged else "NOT CONVERGED"
        return f"<ImageSolution {self.name}: {longitude:.6f} deg E, {latitude:.6f} deg N, {state}>"

    def _row(self, frame: RegisteredFrame) -> tuple[str, ...]:
        numbers = ("-", "-", "-", "-")
        if frame.homography is not None:
            altitude = self.altitudes_m.get(frame.name)
            numbers = (
                str(frame.inliers),
                f"{frame.rms_px:.2f}",
                f"{frame.pixel_m:.3g}",
                "-" if altitude is None else f"{altitude:.4g}",
            )
        to_map = "map" in frame.matched_to
        others = len(frame.matched_to) - to_map
        to = " + ".join([*(["map"] if to_map else []), *([plural(others, "image")] if others else [])]) or "-"
        return (frame.name, frame.status.value, to, *numbers)

    def _left_out(self) -> Iterator[str]:
        for frame in self.registration.frames:
            if frame.status is not FrameStatus.REGISTERED:
                yield f"{frame.name}: {frame.status.value}{f': {frame.reason}' if frame.reason else ''}"
