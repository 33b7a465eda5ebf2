"""Registration of the images of a descent to a map.

:mod:`radioloc.imaging.image_chain` ties the images to each other and to the map. All tie points enter one adjustment
(:mod:`radioloc.imaging.adjustment`). Images with too few consistent tie points are rejected by name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from radioloc.errors import InputError
from radioloc.imaging.adjustment import Adjusted, TiePoints, adjust, approximate_places
from radioloc.imaging.homography import Homography
from radioloc.imaging.image_chain import (
    MAX_PIXEL_GROWTH,
    ChainImage,
    Frame,
    FrameStatus,
    ImageChain,
    pixel_size_m,
)
from radioloc.imaging.map_features import MapFeatures
from radioloc.imaging.projections import Homographies, Poses, Projections, Relief
from radioloc.lunar import TerrainModel
from radioloc.lunar.grey_images import Mask
from radioloc.lunar.maps import Map, TangentPlane
from radioloc.lunar.terrain import NoTerrainError
from radioloc.vectors import Floats

_MIN_TIES = 6
_MIN_PART_WITH_HEIGHT = 0.5  # of an image's tie points, for poses over the elevation model
# Largest distance from the middle of an image's tie points, in their standard deviations; a square's corner has 2.4.
_MAX_EXTRAPOLATION = 4.0
# Common error of all map features beside the map's tie, as a part of the map's pixel: under another Sun craters shift
# by up to a pixel each, but by less than a tenth in the mean. This bound, as of a uniform distribution, is sqrt(3)
# sigmas. The error does not decrease with the number of tie points.
_COMMON_PIXEL_PART = 0.1 / math.sqrt(3.0)
# The same for ground taken as a plane, as a part of the rms displacement by relief: it is equal for neighbouring tie
# points, and places err as if four of them were independent. The noise of features is independent and averages out.
_COMMON_RELIEF_PART = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredFrame:
    """Image after the adjustment."""

    name: str
    status: FrameStatus
    reason: str = ""  # of an unreadable image
    matched_to: tuple[str, ...] = ()  # earlier images, and "map"
    candidates: int = 0  # pairs of features in all successful matches
    inliers: int = 0  # tie points in the adjustment
    map_inliers: int = 0  # tie points with the map
    rms_px: float = float("nan")
    rms_m: float = float("nan")
    pixel_m: float = float("nan")  # at the image's centre
    altitude_m: float = float("nan")  # of the camera above the visible ground, for an image with a pose
    homography: Homography | None = None  # equation 7: from east and north in the plane, m, to pixels
    centre: Floats = field(default_factory=lambda: np.full(2, np.nan))

    @property
    def is_registered(self) -> bool:
        """True if the image has a place on the map."""
        return self.status is FrameStatus.REGISTERED


@dataclass(frozen=True, slots=True, eq=False)
class GroundPoint:
    """Place of a pixel on the Moon."""

    longitude_deg: float
    latitude_deg: float
    covariance_m2: Floats  # east and north, shape (2, 2), with the map's tie


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """All images after the adjustment."""

    frames: tuple[RegisteredFrame, ...]
    plane: TangentPlane
    map_sigma_m: tuple[float, float]
    common_sigma_m: float  # common to map features beside the map's tie, east and north
    sigma_factors: tuple[float, float]  # of stated sigmas in images and on the map, from residuals
    redundancy: int
    map_places_m: Floats  # adjusted places in the plane of the tie points with the map, shape (k, 2)
    relief: bool  # whether heights of the ground were modelled
    _ties: TiePoints = field(repr=False)
    _adjusted: Adjusted = field(repr=False)
    _images: dict[str, tuple[int, ChainImage]] = field(repr=False)

    def ground_point(
        self, name: str, pixel: ArrayLike | None = None, pixel_sigma: float = 0.0
    ) -> GroundPoint:
        """Return the place of a pixel of a registered image, by default its centre, with its covariance.

        The covariance includes errors of features and of the chain, and those common to all points: the map's tie,
        0.058 of its pixel and, without relief, half of the rms displacement by relief.
        """
        if name not in self._images:
            status = {frame.name: frame.status.value for frame in self.frames}.get(name, "not an image")
            raise InputError(f"expected a registered image, but {name} is {status}")
        index, image = self._images[name]
        measured = np.asarray(image.centre if pixel is None else pixel, dtype=np.float64)
        undistorted = image.undistorted(measured[np.newaxis])[0]
        try:
            place, covariance = self._adjusted.place(index, undistorted, pixel_sigma)
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
        tied = self._adjusted.places_m[self._ties.point[self._used(index)]]
        offset_m = place - tied.mean(axis=0)
        if offset_m @ np.linalg.solve(np.cov(tied.T), offset_m) > _MAX_EXTRAPOLATION**2:
            raise InputError(
                f"{name}: the ground at sample {measured[0]:.1f}, line {measured[1]:.1f} is "
                f"{np.hypot(*offset_m):.3g} m from the middle of the image's {len(tied)} tie points, far beyond their "
                "spread; choose another image or pixel"
            )
        longitude, latitude = self.plane.to_longitude_latitude(place[np.newaxis])[0]
        common_m2 = np.square(self.map_sigma_m) + self.common_sigma_m**2
        ground = self.plane.covariance_at(place, covariance) + np.diag(common_m2)
        return GroundPoint(float(longitude), float(latitude), ground)

    def radial_pattern_px(self) -> tuple[float, float]:
        """Return the radial pattern of all residuals, as of lens distortion: pixels at the corners, and sigma.

        It grows with the cube of the distance from the middle of an image, less the part that homographies absorb.
        """
        product = square = variance = count = 0.0
        for index, image in self._images.values():
            used = self._used(index)
            from_middle = (self._ties.pixels[used] - image.centre) / float(np.hypot(*image.centre))
            x, y = from_middle.T
            ones, zeros = np.ones(len(x)), np.zeros(len(x))
            # Derivatives by the parameters of a homography: linear and quadratic in the image.
            by_samples = np.column_stack([ones, x, y, zeros, zeros, zeros, x * x, x * y])
            by_lines = np.column_stack([zeros, zeros, zeros, ones, x, y, x * y, y * y])
            absorbed = np.vstack([by_samples, by_lines])
            pattern = (from_middle * (x**2 + y**2)[:, np.newaxis]).T.ravel()
            pattern -= absorbed @ np.linalg.lstsq(absorbed, pattern, rcond=None)[0]
            residual = self._adjusted.residuals_px[used].T.ravel()
            product, square = product + float(pattern @ residual), square + float(pattern @ pattern)
            variance, count = variance + float(residual @ residual), count + len(residual)
        if not square:
            return 0.0, float("inf")
        return product / square, float(np.sqrt(variance / count / square))

    def _used(self, index: int) -> Mask:
        """Select the tie points of an image in the adjustment."""
        return np.asarray(self._adjusted.used & (self._ties.image == index))


def register_chain(
    frames: Sequence[Frame],
    base: Map,
    *,
    map_sigma_m: tuple[float, float],
    mask: Mask | None = None,
    search_area: tuple[float, float, float] | None = None,
    terrain: TerrainModel | None = None,
    progress: Callable[[Iterable[Frame]], Iterable[Frame]] = iter,
) -> Registration:
    """Register the images of a descent, in order from high to low, to a map.

    `map_sigma_m` is the tie of the map to the Moon's axes, east and north. `mask` selects pixels of the ground.
    `search_area` is longitude and latitude, degrees, and a radius, m. With `terrain` and cameras, images have poses
    over relief; without, or where it lacks half of an image's tie points, the ground is a plane. Images out of order
    are an `InputError`, images of which none is found on the map a `ConvergenceError`.
    """
    plane = base.plane() if search_area is None else TangentPlane(*search_area[:2])
    chain = ImageChain(frames, MapFeatures(base, plane), mask, search_area)
    for frame in progress(frames):
        chain.add(frame)
    chain.require_descent()
    return adjusted_registration(chain, map_sigma_m, terrain)


def adjusted_registration(
    chain: ImageChain, map_sigma_m: tuple[float, float], terrain: TerrainModel | None
) -> Registration:
    """Adjust a chain of images, and return their registration."""
    numbers, ties, result = _adjusted(chain, terrain)
    on_map = np.zeros(ties.count, bool)
    on_map[ties.map_point[result.map_used]] = True
    frames = [
        RegisteredFrame(
            image.name,
            image.status,
            image.reason,
            tuple(image.matched_to),
            image.candidates,
            centre=image.centre,
        )
        for image in chain.images
    ]
    for k, number in enumerate(numbers):
        block = result.block(k)
        homography = result.model.homography(k, result.covariance[block, block])
        used = result.used & (ties.image == k)
        rms_px = float(np.sqrt(np.mean(result.residuals_px[used] ** 2)))
        to_plane = np.asarray(np.linalg.inv(homography.matrix), np.float64)
        pixel_m = pixel_size_m(to_plane, chain.images[number].size)
        frames[number] = replace(
            frames[number],
            status=FrameStatus.REGISTERED,
            inliers=int(used.sum()),
            map_inliers=int(on_map[ties.point[used]].sum()),
            rms_px=rms_px,
            rms_m=rms_px * pixel_m,
            pixel_m=pixel_m,
            altitude_m=result.model.altitude_m(k),
            homography=homography,
        )
    relief = isinstance(result.model, Poses)
    common_m = _COMMON_PIXEL_PART * chain.map.base.resolution_m
    if not relief:
        common_m = math.hypot(common_m, common_relief_m(ties, result))
    _require_order([frame for frame in frames if frame.is_registered])
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
        _images={chain.images[number].name: (k, chain.images[number]) for k, number in enumerate(numbers)},
    )


def common_relief_m(ties: TiePoints, result: Adjusted) -> float:
    """Return the sigma common to places on ground taken as a plane, m, from residuals beyond the stated map noise."""
    used = result.map_used
    square_m2 = np.mean(result.map_residuals_m[used] ** 2) - np.mean(ties.map_sigma_m[used] ** 2)
    return _COMMON_RELIEF_PART * math.sqrt(max(0.0, float(square_m2)))


def _adjusted(chain: ImageChain, terrain: TerrainModel | None) -> tuple[list[int], TiePoints, Adjusted]:
    """Adjust the images that are tied to the map, and reject those with too few consistent tie points."""
    chain.place_all()
    rejected: set[int] = set()
    while True:
        numbers, ties = chain.ties(rejected)
        counts = np.bincount(ties.image, minlength=len(numbers))
        if (counts >= _MIN_TIES).all():
            ties, model, places = _projections(chain, [chain.images[n] for n in numbers], ties, terrain)
            result = adjust(ties, model, places)
            counts = np.bincount(ties.image[result.used], minlength=len(numbers))
            if (counts >= _MIN_TIES).all():
                return numbers, ties, result
        for k in np.flatnonzero(counts < _MIN_TIES):
            rejected.add(numbers[k])
            chain.images[numbers[k]].status = FrameStatus.REJECTED


def _projections(
    chain: ImageChain, images: Sequence[ChainImage], ties: TiePoints, terrain: TerrainModel | None
) -> tuple[TiePoints, Projections, Floats]:
    """Return usable tie points, approximate projections of the images, and approximate places of the points."""
    matrices = np.array([np.linalg.inv(image.to_plane) for image in images])  # type: ignore[arg-type]
    places = approximate_places(ties, matrices)
    sizes = np.array([image.size for image in images], dtype=np.float64)
    homographies = Homographies.of_matrices(matrices, sizes)
    # In axes with z along the line of sight.
    cameras = [
        image.camera.matrix * [image.camera.looks_along_z, 1.0, 1.0]
        for image in images
        if image.camera is not None
    ]
    if terrain is None or len(cameras) < len(images):
        return ties, homographies, places
    west, south, east, north = chain.extent_m
    size = np.array([east - west, north - south])  # wrong tie points may lie anywhere
    middle = 0.5 * np.array([west + east, south + north])
    usable = np.asarray((np.abs(places - middle) < 1.5 * size).all(axis=1))
    try:
        relief = Relief.around(chain.map.plane, terrain, places[usable])
    except NoTerrainError:
        return ties, homographies, places
    usable[usable] = relief.covers(places[usable])
    selected = ties.select(usable)
    total, with_height = (np.bincount(part.image, minlength=len(images)) for part in (ties, selected))
    if (with_height < _MIN_PART_WITH_HEIGHT * total).any():
        return ties, homographies, places
    places = places[usable]
    points = selected.image, places[selected.point]
    return selected, Poses.of_homographies(relief, np.array(cameras), homographies, *points), places


def _require_order(frames: list[RegisteredFrame]) -> None:
    lowest = frames[0]
    for frame in frames[1:]:
        if frame.pixel_m > MAX_PIXEL_GROWTH * lowest.pixel_m:
            raise InputError(
                f"images are not in order from high to low: {frame.name} ({frame.pixel_m:.3g} m/pixel) comes after "
                f"{lowest.name} ({lowest.pixel_m:.3g} m/pixel)"
            )
        lowest = min(lowest, frame, key=lambda f: f.pixel_m)
