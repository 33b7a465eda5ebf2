"""The images of a descent, tied to each other and to a map by :mod:`radioloc.imaging.image_chain`, adjusted together.

All tie points go into one adjustment (:mod:`radioloc.imaging.adjustment`). What does not match is left out by name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.imaging.frames import Mask
from radioloc.imaging.homography import Homography, derivative, of_correction
from radioloc.imaging.image_chain import Frame, FrameStatus, ImageChain, pixel_size_m
from radioloc.imaging.map_features import MapFeatures
from radioloc.imaging.maps import Map, TangentPlane
from radioloc.imaging.matching import Detector
from radioloc.imaging.tie_points import TiePoint

if TYPE_CHECKING:
    from radioloc.imaging.adjustment import AdjustedHomographies, TiePoints

Floats = NDArray[np.float64]

_FEWEST_TIES = 6
# What features of the map have in common beside its tie, of a pixel of the map: craters seem to move under another sun,
# and blur and sampling of images differ. No number of tie points makes it smaller.
_COMMON_PART = 0.3
_RISE = 1.3  # a later image whose pixels are larger by more than this is out of order


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredFrame:
    """One image after the adjustment."""

    name: str
    status: FrameStatus
    reason: str = ""  # of one that could not be read
    matched_to: tuple[str, ...] = ()  # images before it, "map", and "given" of tie points that were
    candidates: int = 0  # pairs of features that were compared with success, with all of these together
    inliers: int = 0  # its tie points in the adjustment,
    map_inliers: int = 0  # and those with the map
    rms_px: float = float("nan")
    rms_m: float = float("nan")
    pixel_m: float = float("nan")  # at the image's centre
    homography: Homography | None = None  # equation 7: from east and north in the plane, m, to pixels
    centre: Floats = field(default_factory=lambda: np.full(2, np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class GroundPoint:
    """Where a pixel lies on the Moon."""

    longitude_deg: float
    latitude_deg: float
    covariance_m2: Floats  # east and north, shape (2, 2), with the map's tie


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """All images after the adjustment."""

    frames: tuple[RegisteredFrame, ...]
    plane: TangentPlane
    map_sigma_m: tuple[float, float]
    map_pixel_m: float
    sigma_factors: tuple[
        float, float
    ]  # of features' stated sigmas in images and on the map, found from residuals
    redundancy: int
    map_places_m: Floats  # adjusted places in the plane of the tie points with the map, shape (k, 2)
    _adjusted: AdjustedHomographies = field(repr=False)
    _index: dict[str, int] = field(repr=False)
    _undistorted: dict[str, Callable[[Floats], Floats]] = field(repr=False)

    def ground_point(
        self, name: str, pixel: ArrayLike | None = None, pixel_sigma: float = 0.0
    ) -> GroundPoint:
        """Where a pixel of a registered image, by default its centre, lies on the Moon, with its covariance.

        The covariance has the errors of features and of the chain, and what all points have in common: the tie of the
        map to the Moon's axes, and 0.3 pixel of the map, by which features may seem moved under another sun.

        Raises
        ------
        InputError
            The image is not registered.
        """
        if name not in self._index:
            status = {frame.name: frame.status.value for frame in self.frames}.get(
                name, "not among the images"
            )
            raise InputError(f"{name} is {status}: none of its pixels has a place on the map")
        frame = next(f for f in self.frames if f.name == name)
        at = np.asarray(frame.centre if pixel is None else pixel, dtype=np.float64)
        if name in self._undistorted:
            at = self._undistorted[name](at[np.newaxis])[0]
        place, covariance = self._adjusted.ground_point(self._index[name], at)
        matrix = self._adjusted.matrices[self._index[name]]
        back = np.linalg.inv(derivative(matrix, place[np.newaxis])[0])
        covariance = covariance + pixel_sigma**2 * back @ back.T
        longitude, latitude = self.plane.to_longitude_latitude(place[np.newaxis])[0]
        common_m2 = np.square(self.map_sigma_m) + (_COMMON_PART * self.map_pixel_m) ** 2
        ground = self.plane.covariance_at(place, covariance) + np.diag(common_m2)
        return GroundPoint(float(longitude), float(latitude), ground)


def register_chain(
    frames: Sequence[Frame],
    base: Map,
    *,
    map_sigma_m: tuple[float, float],
    mask: Mask | None = None,
    near: tuple[float, float, float] | None = None,
    ties: Sequence[TiePoint] = (),
    detector: Detector = Detector.SIFT,
    progress: Callable[[Iterable[Frame]], Iterable[Frame]] = iter,
) -> Registration:
    """Register the images of a descent, in order from high to low, to a map.

    Parameters
    ----------
    frames : sequence of Frame
        The images; they may differ in size.
    base : Map
        The map.
    map_sigma_m : tuple of float
        How well the map is tied to the Moon's axes, east and north; considered, and the same for all points.
    mask : numpy.ndarray of bool, optional
        Which pixels of the images show the ground (:func:`radioloc.imaging.find_mask`).
    near : tuple of float, optional
        Longitude and latitude, degrees, and a radius, m: where on the map the images are sought.
    ties : sequence of TiePoint, optional
        Tie points that are measured already, in images by their names; they are used beside those that are found.
    detector : Detector
        Of features.
    progress : callable, optional
        Is given the frames and gives them back one by one, as a progress bar does.

    Returns
    -------
    Registration
        With the status of each image.

    Raises
    ------
    InputError
        Images are not in order from high to low.
    ConvergenceError
        No image is found on the map.
    """
    chain = ImageChain(frames, MapFeatures(base, _plane_of(base, near), detector), mask, near, ties)
    for frame in progress(frames):
        chain.add(frame)
    return _registration(chain, map_sigma_m)


def _plane_of(base: Map, near: tuple[float, float, float] | None) -> TangentPlane:
    return base.plane() if near is None else TangentPlane(near[0], near[1])


def _adjusted(chain: ImageChain) -> tuple[TiePoints, list[int], AdjustedHomographies, set[int]]:
    """Adjust what is tied to the map, leaving out images of which too little agrees."""
    from radioloc.imaging.adjustment import adjust  # brings much of scipy

    chain.place_all()
    left_out: set[int] = set()
    while True:
        images, ties = chain.ties(left_out)
        taken = [chain.taken[n] for n in images]
        counts = np.bincount(ties.image, minlength=len(images))
        if (counts >= _FEWEST_TIES).all():
            matrices = np.array([np.linalg.inv(one.to_plane) for one in taken])  # type: ignore[arg-type]
            result = adjust(ties, matrices, np.array([one.size for one in taken], dtype=np.float64))
            counts = np.bincount(ties.image[result.used], minlength=len(images))
            if (counts >= _FEWEST_TIES).all():
                return ties, images, result, left_out
        left_out |= {images[k] for k in np.flatnonzero(counts < _FEWEST_TIES)}


def _registration(chain: ImageChain, map_sigma_m: tuple[float, float]) -> Registration:
    ties, images, result, left_out = _adjusted(chain)
    on_map = np.zeros(int(ties.point.max()) + 1, bool)
    on_map[ties.map_point[result.map_used]] = True
    frames = []
    for number, taken in enumerate(chain.taken):
        frame = RegisteredFrame(
            taken.name,
            FrameStatus.REJECTED if number in left_out else taken.status,
            taken.reason,
            tuple(taken.matched_to),
            taken.candidates,
            centre=0.5 * (np.array(taken.size, dtype=np.float64) - 1.0),
        )
        if number in images:
            k = images.index(number)
            block = slice(8 * k, 8 * k + 8)
            mine = result.used & (ties.image == k)
            rms_px = float(np.sqrt(np.mean(result.residuals_px[mine] ** 2)))
            pixel_m = pixel_size_m(np.linalg.inv(result.matrices[k]), taken.size)
            frame = replace(
                frame,
                status=FrameStatus.REGISTERED,
                inliers=int(mine.sum()),
                map_inliers=int(on_map[ties.point[mine]].sum()),
                rms_px=rms_px,
                rms_m=rms_px * pixel_m,
                pixel_m=pixel_m,
                homography=of_correction(
                    result.matrices[k], result.normals[k], result.covariance[block, block]
                ),
            )
        frames.append(frame)
    _require_order([f for f in frames if f.status is FrameStatus.REGISTERED])
    return Registration(
        frames=tuple(frames),
        plane=chain.map.plane,
        map_sigma_m=map_sigma_m,
        map_pixel_m=chain.map.base.resolution_m,
        sigma_factors=result.sigma_factors,
        redundancy=result.redundancy,
        map_places_m=result.points_m[ties.map_point[result.map_used]],
        _adjusted=result,
        _index={chain.taken[n].name: k for k, n in enumerate(images)},
        _undistorted=chain.undistorted,
    )


def _require_order(frames: list[RegisteredFrame]) -> None:
    lowest = frames[0]
    for frame in frames[1:]:
        if frame.pixel_m > _RISE * lowest.pixel_m:
            raise InputError(
                f"images are not in order from high to low: {frame.name} ({frame.pixel_m:.3g} m/pixel) comes after "
                f"{lowest.name} ({lowest.pixel_m:.3g} m/pixel)"
            )
        lowest = min(lowest, frame, key=lambda f: f.pixel_m)
