"""The images of a descent, tied to each other and to a map by :mod:`radioloc.imaging.image_chain`, adjusted together.

All tie points go into one adjustment (:mod:`radioloc.imaging.adjustment`). What does not match is left out by name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from radioloc.errors import InputError
from radioloc.imaging.adjustment import Adjusted, TiePoints, adjust, approximate_places
from radioloc.imaging.homography import Homography
from radioloc.imaging.image_chain import RISE, Frame, FrameStatus, ImageChain, Taken, TiePoint, pixel_size_m
from radioloc.imaging.map_features import MapFeatures
from radioloc.imaging.matching import Detector
from radioloc.imaging.projections import Homographies, Poses, Projections, Relief
from radioloc.lunar import TerrainModel
from radioloc.lunar.grey_images import Mask
from radioloc.lunar.maps import Map, TangentPlane
from radioloc.lunar.terrain import NoTerrainError
from radioloc.quantities import accepts_quantities
from radioloc.vectors import Floats

_FEWEST_TIES = 6
_FEWEST_WITH_HEIGHT = 0.5  # of an image's tie points: the model of heights covers what it shows
# From the middle of an image's tie points, in standard deviations of these; of a square's corner 2.4.
_FARTHEST = 4.0
# What all features of the map have in common beside its tie, of a pixel of the map: under another sun craters seem to
# move, each by up to a pixel, all together by less than a tenth; no number of tie points makes that smaller.
_COMMON_PART = 0.1
# Of the rms residual of places on the map, where the ground is taken as a plane: relief moves neighbouring tie points
# alike, and places err as if four of them were independent.
_COMMON_RELIEF = 0.5


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
    altitude_m: float = float("nan")  # of the camera above the ground that it sees, if it has a pose
    homography: Homography | None = None  # equation 7: from east and north in the plane, m, to pixels
    centre: Floats = field(default_factory=lambda: np.full(2, np.nan))

    @property
    def is_registered(self) -> bool:
        """Whether the image has a place on the map."""
        return self.status is FrameStatus.REGISTERED


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
    common_sigma_m: float  # of what features of the map have in common beside its tie, east and north
    sigma_factors: tuple[float, float]  # of stated sigmas in images and on the map, found from residuals
    redundancy: int
    map_places_m: Floats  # adjusted places in the plane of the tie points with the map, shape (k, 2)
    relief: bool  # whether heights of the ground were taken into account
    _ties: TiePoints = field(repr=False)
    _adjusted: Adjusted = field(repr=False)
    _taken: dict[str, tuple[int, Taken]] = field(repr=False)

    def ground_point(
        self, name: str, pixel: ArrayLike | None = None, pixel_sigma: float = 0.0
    ) -> GroundPoint:
        """Return where a pixel of a registered image, by default its centre, lies on the Moon, with its covariance.

        The covariance includes errors of features and of the chain, and those common to all points: the map's tie, a
        tenth of its pixel (features seem moved under another sun) and, without relief, half of its rms residual.
        """
        if name not in self._taken:
            status = {frame.name: frame.status.value for frame in self.frames}.get(
                name, "not among the images"
            )
            raise InputError(f"{name} is {status}: none of its pixels has a place on the map")
        image, taken = self._taken[name]
        at = np.asarray(taken.centre if pixel is None else pixel, dtype=np.float64)
        try:
            place, covariance = self._adjusted.place(image, taken.undistorted(at[np.newaxis])[0], pixel_sigma)
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
        mine = self._adjusted.used & (self._ties.image == image)
        tied = self._adjusted.places_m[self._ties.point[mine]]
        away = place - tied.mean(axis=0)
        if away @ np.linalg.solve(np.cov(tied.T), away) > _FARTHEST**2:
            raise InputError(
                f"{name}: what is seen at sample {at[0]:.1f}, line {at[1]:.1f} is {np.hypot(*away):.3g} m from the "
                f"middle of the image's {len(tied)} tie points, far beyond the ground that they determine; choose "
                "another image or pixel"
            )
        longitude, latitude = self.plane.to_longitude_latitude(place[np.newaxis])[0]
        common_m2 = np.square(self.map_sigma_m) + self.common_sigma_m**2
        ground = self.plane.covariance_at(place, covariance) + np.diag(common_m2)
        return GroundPoint(float(longitude), float(latitude), ground)

    def radial_pattern_px(self) -> tuple[float, float]:
        """Return the part of all residuals that grows with the cube of the distance from the middle of an image.

        As distortion of the lens does, less what the images absorb: pixels at the corners, and standard deviation.
        """
        product = square = variance = count = 0.0
        for image, taken in self._taken.values():
            mine = self._adjusted.used & (self._ties.image == image)
            from_middle = (self._ties.pixels[mine] - taken.centre) / float(np.hypot(*taken.centre))
            x, y = from_middle.T
            one, none = np.ones(len(x)), np.zeros(len(x))
            # What a homography absorbs: linear in its parameters, quadratic in the image.
            along_samples = np.column_stack([one, x, y, none, none, none, x * x, x * y])
            absorbed = np.vstack(
                [along_samples, np.column_stack([none, none, none, one, x, y, x * y, y * y])]
            )
            pattern = (from_middle * (x**2 + y**2)[:, np.newaxis]).T.ravel()
            pattern -= absorbed @ np.linalg.lstsq(absorbed, pattern, rcond=None)[0]
            residual = self._adjusted.residuals_px[mine].T.ravel()
            product, square = product + float(pattern @ residual), square + float(pattern @ pattern)
            variance, count = variance + float(residual @ residual), count + len(residual)
        if not square:
            return 0.0, float("inf")
        return product / square, float(np.sqrt(variance / count / square))


@accepts_quantities
def register_chain(
    frames: Sequence[Frame],
    base: Map,
    *,
    map_sigma_m: tuple[float, float],
    mask: Mask | None = None,
    near: tuple[float, float, float] | None = None,
    ties: Sequence[TiePoint] = (),
    terrain: TerrainModel | None = None,
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
        Which pixels of the images show the ground (:func:`radioloc.imaging.frames.find_mask`).
    near : tuple of float, optional
        Longitude and latitude, degrees, and a radius, m: where on the map the images are sought.
    ties : sequence of TiePoint, optional
        Tie points that are measured already, in images by their names; they are used beside those that are found.
    terrain : TerrainModel, optional
        Heights of the ground, where the images' cameras are known: relief moves points of images, unless the camera
        stands above them. Without, or where it does not have half of an image's tie points, the ground is a plane.
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

    Examples
    --------
    >>> from functools import partial
    >>> from radioloc.imaging import Frame, register_chain
    >>> from radioloc.imaging.frames import read_frame
    >>> from radioloc.lunar import Map
    >>> name = "examples/images/frames/0001.png"
    >>> frames = [Frame("0001.png", partial(read_frame, name))]
    >>> found = register_chain(frames, Map.open("examples/images/map.tif"), map_sigma_m=(25.0, 25.0))
    >>> found.frames[0].status.value
    'registered'
    """
    plane = base.plane() if near is None else TangentPlane(near[0], near[1])
    chain = ImageChain(frames, MapFeatures(base, plane, detector), mask, near, ties)
    for frame in progress(frames):
        chain.add(frame)
    chain.require_descent()
    return _registration(chain, map_sigma_m, terrain)


def _adjusted(chain: ImageChain, terrain: TerrainModel | None) -> tuple[list[int], TiePoints, Adjusted]:
    """Adjust what is tied to the map, leaving out images of which too little agrees."""
    chain.place_all()
    left_out: set[int] = set()
    while True:
        images, ties = chain.ties(left_out)
        counts = np.bincount(ties.image, minlength=len(images))
        if (counts >= _FEWEST_TIES).all():
            ties, model, places = _modelled(chain, [chain.taken[n] for n in images], ties, terrain)
            result = adjust(ties, model, places)
            counts = np.bincount(ties.image[result.used], minlength=len(images))
            if (counts >= _FEWEST_TIES).all():
                return images, ties, result
        for k in np.flatnonzero(counts < _FEWEST_TIES):
            left_out.add(images[k])
            chain.taken[images[k]].status = FrameStatus.REJECTED


def _modelled(
    chain: ImageChain, taken: Sequence[Taken], ties: TiePoints, terrain: TerrainModel | None
) -> tuple[TiePoints, Projections, Floats]:
    """Approximate images, with the tie points whose ground they know and the places of these."""
    matrices = np.array([np.linalg.inv(one.to_plane) for one in taken])  # type: ignore[arg-type]
    places = approximate_places(ties, matrices)
    homographies = Homographies.of_matrices(matrices, np.array([one.size for one in taken], dtype=np.float64))
    # In axes of which z is ahead.
    cameras = [
        one.camera.matrix * [one.camera.looks_along_z, 1.0, 1.0] for one in taken if one.camera is not None
    ]
    if terrain is None or len(cameras) < len(taken):
        return ties, homographies, places
    west, south, east, north = chain.extent_m
    size = np.array([east - west, north - south])  # wrong tie points may seem to be anywhere
    middle = 0.5 * np.array([west + east, south + north])
    known = np.asarray((np.abs(places - middle) < 1.5 * size).all(axis=1))
    try:
        relief = Relief.around(chain.map.plane, terrain, places[known])
    except NoTerrainError:
        return ties, homographies, places
    known[known] = relief.known(places[known])
    some = ties.only(known)
    before, after = (np.bincount(one.image, minlength=len(taken)) for one in (ties, some))
    if (after < _FEWEST_WITH_HEIGHT * before).any():
        return ties, homographies, places
    places = places[known]
    seen = some.image, places[some.point]
    return some, Poses.of_homographies(relief, np.array(cameras), homographies, *seen), places


def _registration(
    chain: ImageChain, map_sigma_m: tuple[float, float], terrain: TerrainModel | None
) -> Registration:
    images, ties, result = _adjusted(chain, terrain)
    on_map = np.zeros(ties.count, bool)
    on_map[ties.map_point[result.map_used]] = True
    frames = [
        RegisteredFrame(
            one.name, one.status, one.reason, tuple(one.matched_to), one.candidates, centre=one.centre
        )
        for one in chain.taken
    ]
    for k, number in enumerate(images):
        block = result.block(k)
        homography = result.model.homography(k, result.covariance[block, block])
        mine = result.used & (ties.image == k)
        rms_px = float(np.sqrt(np.mean(result.residuals_px[mine] ** 2)))
        pixel_m = pixel_size_m(
            np.asarray(np.linalg.inv(homography.matrix), np.float64), chain.taken[number].size
        )
        frames[number] = replace(
            frames[number],
            status=FrameStatus.REGISTERED,
            inliers=int(mine.sum()),
            map_inliers=int(on_map[ties.point[mine]].sum()),
            rms_px=rms_px,
            rms_m=rms_px * pixel_m,
            pixel_m=pixel_m,
            altitude_m=result.model.altitude_m(k),
            homography=homography,
        )
    relief = isinstance(result.model, Poses)
    common_m = _COMMON_PART * chain.map.base.resolution_m
    if not relief:
        rms_m = float(np.sqrt(np.mean(result.map_residuals_m[result.map_used] ** 2)))
        common_m = float(np.hypot(common_m, _COMMON_RELIEF * rms_m))
    _require_order([f for f in frames if f.is_registered])
    return Registration(
        frames=tuple(frames),
        plane=chain.map.plane,
        map_sigma_m=map_sigma_m,
        common_sigma_m=common_m,
        sigma_factors=result.sigma_factors,
        redundancy=result.redundancy,
        map_places_m=result.places_m[ties.map_point[result.map_used]],
        relief=relief,
        _ties=ties,
        _adjusted=result,
        _taken={chain.taken[n].name: (k, chain.taken[n]) for k, n in enumerate(images)},
    )


def _require_order(frames: list[RegisteredFrame]) -> None:
    lowest = frames[0]
    for frame in frames[1:]:
        if frame.pixel_m > RISE * lowest.pixel_m:
            raise InputError(
                f"images are not in order from high to low: {frame.name} ({frame.pixel_m:.3g} m/pixel) comes after "
                f"{lowest.name} ({lowest.pixel_m:.3g} m/pixel)"
            )
        lowest = min(lowest, frame, key=lambda f: f.pixel_m)
