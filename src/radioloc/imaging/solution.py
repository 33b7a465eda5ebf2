"""Results of studies of images: positions with covariances, cards and dictionaries."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.ephemeris.constants import CONSTANTS
from radioloc.errors import InputError
from radioloc.estimation.combination import horizontal_ellipse
from radioloc.imaging.products import MappedImages, product_files
from radioloc.lunar.local import EAST_NORTH_UP
from radioloc.lunar.position import LunarPosition
from radioloc.results.cards import Card, Field, metres, plural, provenance_detail
from radioloc.results.result import Content, Result
from radioloc.results.tables import GEOGRAPHIC, by_axis, difference, ellipse_text, finite, place_record
from radioloc.targets.position_prior import map_tie_names
from radioloc.vectors import Floats

if TYPE_CHECKING:
    from radioloc.imaging.cameras import Camera
    from radioloc.imaging.registration import RegisteredFrame, Registration
    from radioloc.lunar.maps import Map

_MAX_ROWS = 12  # of the card's table of images


class _ImageResult(Result):
    """Common fields and methods of positions from images."""

    __slots__ = ()
    name: str
    message: str
    position: LunarPosition
    covariance_enu_m2: Floats
    references: Mapping[str, LunarPosition]
    notes: tuple[str, ...]
    provenance: Mapping[str, Any]

    @property
    def converged(self) -> bool:
        """True if the position can be used."""
        return not self.message

    @property
    def sigma_enu_m(self) -> Floats:
        """Total standard deviations east, north, up, m; NaN where not determined."""
        return np.sqrt(np.diag(self.covariance_enu_m2))

    def files(self) -> Mapping[str, Content]:
        """Return all numbers as ``solution.json``."""
        return {"solution.json": self.to_dict()}

    def positions(self) -> Mapping[str, Result]:
        """Return the position itself."""
        return {self.name: self}

    def _content(self, method: str, **measured: Any) -> dict[str, Any]:
        """Return the content of ``solution.json``, with the keys of the measurements."""
        pa = self.position.to_axes("PA", CONSTANTS["DE421"])
        return {
            "name": self.name,
            "method": method,
            "converged": self.converged,
            "status": "converged" if self.converged else "not converged",
            "message": self.message,
            "position": {
                "pa": {"frame": pa.frame, **by_axis("xyz", pa.xyz_m)},
                "me": place_record(self.position.frame, self.position.selenographic, self.position.xyz_m),
            },
            "sigma": by_axis(EAST_NORTH_UP, self.sigma_enu_m),
            "covariance": {"enu_m2": list(map(finite, self.covariance_enu_m2))},
            "reference": next(self._differences(), None),
            **measured,
            "notes": list(self.notes),
            "provenance": dict(self.provenance),
        }

    def _card(self, *fields: Field) -> Card:
        """Return a card with the fields of the measurements between position and notes."""
        longitude, latitude, height = self.position.selenographic
        place = (
            f"{longitude:.6f} deg E, {latitude:.6f} deg N ({self.position.frame})",
            f"{height:.1f} m above the 1737.4 km sphere",
        )
        status = "CONVERGED" if self.converged else f"NOT CONVERGED: {self.message}"
        return Card(
            (
                Field("solution", (self.name,)),
                Field("status", (status,)),
                Field("position", place),
                *fields,
                Field("notes", self.notes),
            ),
            (provenance_detail(self.provenance),),
        )

    def _reference_field(self) -> Field:
        """Return the differences from the references."""
        lines = (
            f"solution - {row['name']}: east {metres(row['east_m'])}, north {metres(row['north_m'])}, "
            f"up {metres(round(row['up_m'], 4))} m; {metres(row['horizontal_m'])} m horizontal"
            for row in self._differences()
        )
        return Field("reference", lines)

    def _differences(self) -> Iterator[dict[str, Any]]:
        for name, place in self.references.items():
            *_, east_m, north_m, up_m = difference(self.position.selenographic, place.selenographic)
            yield {
                "name": name,
                **dict(zip(GEOGRAPHIC, place.selenographic, strict=True)),
                **by_axis(EAST_NORTH_UP, (east_m, north_m, up_m)),
                "horizontal_m": math.hypot(east_m, north_m),
            }

    def __repr__(self) -> str:
        longitude, latitude, _ = self.position.selenographic
        state = "converged" if self.converged else "NOT CONVERGED"
        return f"<{type(self).__name__} {self.name}: {longitude:.6f} deg E, {latitude:.6f} deg N, {state}>"


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSource:
    """Source of a part of the covariance."""

    name: str  # on the card
    # Shift of the position by each error of one sigma, shape (3, k); NaN for an undetermined height.
    errors_enu_m: Floats
    # Name, unit and sigma of errors that other solutions share.
    shared: tuple[tuple[str, str, float], ...] = ()

    @property
    def covariance_enu_m2(self) -> Floats:
        """Part of the covariance, shape (3, 3)."""
        return self.errors_enu_m @ self.errors_enu_m.T

    @property
    def sigma_enu_m(self) -> Floats:
        """Standard deviations from this source alone, east, north, up, m."""
        return np.sqrt(np.diag(self.covariance_enu_m2))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PointSolution(_ImageResult):
    """Position of a point in an image, or of a rover or lander that took stereo images."""

    #: Name of the study; ``"image_point"`` or ``"stereo"``; reason if the position cannot be used, else empty.
    name: str
    method: str  #: likewise
    message: str  #: likewise
    position: LunarPosition  #: Mean-Earth axes
    sources: tuple[ErrorSource, ...]  #: parts that sum to the covariance
    fields: tuple[Field, ...]  #: description of the measurements for the card, and in numbers
    details: Mapping[str, Any]  #: likewise
    used: int  #: number of points or landmarks, and weighted rms residual of distances
    wrms_m: float | None = None  #: likewise
    references: Mapping[str, LunarPosition] = field(default_factory=dict)  #: reference positions
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    #: (n, 2), landmarks of a stereo solution, east and north of the position, and their horizontal distances, m.
    landmarks_en_m: Floats | None = None
    distances_m: Floats | None = None  #: likewise

    @property
    def covariance_enu_m2(self) -> Floats:  # type: ignore[override]
        """Total covariance, shape (3, 3); NaN for an undetermined height."""
        return sum((source.covariance_enu_m2 for source in self.sources), np.zeros((3, 3)))

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers, with the keys of :meth:`radioloc.Solution.to_dict` and a key named after the method."""
        considered = [
            {"name": name, "unit": unit, "sigma": sigma, "position_enu_m": finite(source.errors_enu_m[:, k])}
            for source in self.sources
            for k, (name, unit, sigma) in enumerate(source.shared)
        ]
        return self._content(
            self.method,
            budget={source.name: finite(source.sigma_enu_m) for source in self.sources},
            biases={},
            considered=considered,
            fit={"used": self.used, "rejected": 0, "wrms_m": self.wrms_m, "by_station": {}},
            **{self.method: dict(self.details)},
        )

    def card(self) -> Card:
        """Return the card of the solution."""
        line = ellipse_text(horizontal_ellipse(self.covariance_enu_m2[:2, :2]))
        sigmas = {source.name: source.sigma_enu_m for source in self.sources} | {"all": self.sigma_enu_m}
        rows = [
            (name, *(metres(round(side, 4)) if math.isfinite(side) else "-" for side in sides))
            for name, sides in sigmas.items()
        ]
        sigma = Field("sigma", (line,), ("1 sigma, m", *EAST_NORTH_UP), rows)
        return self._card(sigma, *self.fields, self._reference_field())


class MapResult(NamedTuple):
    """Location on one of several base maps."""

    map_name: str
    pixel_m: float
    sun_difference_deg: float | None  # of azimuth, from the images
    status: str
    solution: ImageSolution | None

    def row(self, leading: ImageSolution) -> dict[str, Any]:
        """Return the position, and its difference from that of the leading map.

        `misfit_sigmas` is the difference in its standard deviations by the errors of both maps and registrations.
        """
        content: dict[str, Any] = {"map": self.map_name, "pixel_m": self.pixel_m, "status": self.status}
        content["sun_difference_deg"] = self.sun_difference_deg
        solution = self.solution
        if solution is None:
            return content
        place = solution.position.selenographic
        *_, east_m, north_m, up_m = difference(place, leading.position.selenographic)
        offset_m = np.array([east_m, north_m])
        # Errors after the last image, of the lens and of the height are common to both.
        total = sum(
            (
                part.registration.ground_point(part.registered[-1].name).covariance_m2
                for part in (solution, leading)
            ),
            np.zeros((2, 2)),
        )
        is_leading = solution.base.path == leading.base.path
        return {
            **content,
            "served": is_leading,
            **dict(zip(GEOGRAPHIC, place, strict=True)),
            "sigma": by_axis(EAST_NORTH_UP, solution.sigma_enu_m),
            "difference": by_axis(EAST_NORTH_UP, (east_m, north_m, up_m)),
            "misfit_sigmas": 0.0
            if is_leading
            else float(np.sqrt(offset_m @ np.linalg.solve(total, offset_m))),
        }


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True, repr=False)
class ImageSolution(_ImageResult, MappedImages):
    """Position of a lander by its descent images, and the registration of each image."""

    name: str  #: name of the study; reason if the position cannot be used, else empty
    message: str  #: likewise
    position: LunarPosition  #: Mean-Earth axes
    covariance_enu_m2: Floats  #: (3, 3), total covariance; NaN for an undetermined height
    #: Map, and sigma of its tie to the Moon's axes, east and north, m: a common error of all solutions on it.
    map_name: str
    map_sigma_m: tuple[float, float]  #: likewise
    registration: Registration  #: images after the adjustment
    base: Map
    #: Function of lines and samples that returns the :class:`~radioloc.imaging.Camera`.
    camera: Callable[[tuple[int, int]], Camera] | None = None
    mask: NDArray[np.bool_] | None = None  #: pixels of the images that show the ground
    #: Altitude of the camera above the ground, if the study has a camera, and file of each image, by its name.
    altitudes_m: Mapping[str, float] = field(default_factory=dict)
    references: Mapping[str, LunarPosition] = field(default_factory=dict)  #: reference positions
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    paths: Mapping[str, Path] = field(default_factory=dict)  #: likewise
    maps: tuple[MapResult, ...] = ()  #: results on all maps of a study with several

    @property
    def wrms_m(self) -> float:
        """Root mean square of the residuals of tie points on the ground, weighted by their inverse pixel size, m."""
        count, rms_m, pixel_m = np.array([(f.inliers, f.rms_m, f.pixel_m) for f in self.registered]).T
        return float(np.sqrt(np.average(rms_m**2, weights=count / pixel_m**2)))

    @property
    def relative_covariance_en_m2(self) -> Floats:
        """Covariance of east and north relative to the map, without its tie to the Moon's axes, shape (2, 2)."""
        return np.asarray(self.covariance_enu_m2[:2, :2] - np.diag(np.square(self.map_sigma_m)))

    @property
    def _along_ground(self) -> Floats:
        """Unit displacements east and north along the sloping ground, shape (2, 3)."""
        horizontal_m2, with_height_m2 = self.covariance_enu_m2[:2, :2], self.covariance_enu_m2[:2, 2:]
        return np.hstack([np.eye(2), np.nan_to_num(np.linalg.solve(horizontal_m2, with_height_m2))])

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers, with the keys of :meth:`radioloc.Solution.to_dict` and ``images``."""
        considered = [
            {"name": name, "unit": "m", "sigma": sigma_m, "position_enu_m": (sigma_m * side).tolist()}
            for name, sigma_m, side in zip(
                map_tie_names(self.map_name), self.map_sigma_m, self._along_ground, strict=True
            )
        ]
        fit = {
            "used": sum(frame.inliers for frame in self.registered),
            "rejected": sum(max(frame.candidates - frame.inliers, 0) for frame in self.registered),
            "wrms_m": self.wrms_m,
            "rms_px": float(np.sqrt(np.mean([frame.rms_px**2 for frame in self.registered]))),
            "sigma_factor_images": self.registration.sigma_factors[0],
            "sigma_factor_map": self.registration.sigma_factors[1],
            "redundancy": self.registration.redundancy,
            "by_station": {},
        }
        images = [self._image(frame) for frame in self.registration.frames]
        maps = [result.row(self) for result in self.maps]
        return self._content("images", biases={}, considered=considered, fit=fit, images=images, maps=maps)

    def files(self) -> Mapping[str, Content]:
        """Return all numbers as ``solution.json``, and the files for geographic information systems."""
        return {**_ImageResult.files(self), **product_files(self)}

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
        # The centre may show the sky, or ground far beyond the tie points.
        with contextlib.suppress(InputError):
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
        """Return the card of the solution."""
        sigmas = self.sigma_enu_m
        up = metres(sigmas[2]) if math.isfinite(sigmas[2]) else "not determined"
        tie = " and ".join(metres(value) for value in self.map_sigma_m)
        frames, half = list(self.registration.frames), _MAX_ROWS // 2
        shown = frames if len(frames) <= _MAX_ROWS else frames[:half] + frames[-half:]
        sigma = (
            f"east {metres(sigmas[0])}, north {metres(sigmas[1])} m, up {up} m",
            f"includes the tie of {self.map_name} to the Moon's axes, {tie} m east and north",
        )
        images = Field(
            "images",
            (f"{len(self.registered)} of {len(frames)} registered",),
            ("image", "status", "matched to", "inliers", "rms, px", "pixel, m", "altitude, m"),
            map(self._row, shown),
            hidden=map(self._row, frames[half : len(frames) - len(shown) + half]),
            file="solution.json",
        )
        unregistered = (
            f"{frame.name}: {frame.status.value}{f': {frame.reason}' if frame.reason else ''}"
            for frame in frames
            if not frame.is_registered
        )
        fields = (
            Field("1 sigma", sigma),
            self._reference_field(),
            self._maps_field(),
            images,
            Field("not registered", unregistered),
        )
        return self._card(*fields)

    def _maps_field(self) -> Field:
        """Return the table of positions on several maps."""
        header = ("map", "pixel, m", "longitude", "latitude", "east, m", "north, m", "sigmas")
        rows = []
        for row in (result.row(self) for result in self.maps):
            numbers: tuple[str, ...] = ("-",) * 5
            if "difference" in row:
                numbers = (
                    f"{row['longitude_deg']:.6f}",
                    f"{row['latitude_deg']:.6f}",
                    *(metres(row["difference"][f"{axis}_m"]) for axis in ("east", "north")),
                    f"{row['misfit_sigmas']:.2f}",
                )
            rows.append((row["map"], f"{row['pixel_m']:.3g}", *numbers))
        served = (f"{self.map_name} served; differences are from its position",) if rows else ()
        return Field("maps", served, header, rows)

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
        count = len(frame.matched_to) - to_map
        matches = [*(["map"] if to_map else []), *([plural(count, "image")] if count else [])]
        return (frame.name, frame.status.value, " + ".join(matches) or "-", *numbers)
