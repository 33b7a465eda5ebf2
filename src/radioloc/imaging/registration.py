"""Registration of the images of a descent to a map.

:mod:`radioloc.imaging.image_chain` ties the images to each other and to the map. All tie points enter one adjustment
(:mod:`radioloc.imaging.adjustment`). Images with too few consistent tie points are rejected by name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError
from radioloc.imaging.adjustment import Adjusted, TiePoints, adjust, approximate_places, map_influence
from radioloc.imaging.cameras import Camera, distorted, sight_matrix
from radioloc.imaging.homography import Homography
from radioloc.imaging.image_chain import (
    MAX_PIXEL_GROWTH,
    ChainImage,
    Detected,
    Frame,
    FrameStatus,
    ImageChain,
    pixel_size_m,
)
from radioloc.imaging.map_features import MapFeatures
from radioloc.imaging.orientation import ConstantOrientation
from radioloc.imaging.projections import Homographies, Poses, Projections, Relief, pose_of_homography
from radioloc.imaging.rectification import Bounds, PlaneView, TerrainView, View, outline
from radioloc.imaging.self_calibration import SelfCalibration, self_calibration
from radioloc.imaging.sensor_models import FrameModel
from radioloc.labels import Labels
from radioloc.lunar import TerrainModel
from radioloc.lunar.grey_images import Mask
from radioloc.lunar.maps import Map, TangentPlane
from radioloc.lunar.terrain import NoTerrainError
from radioloc.vectors import Floats

_MIN_TIES = 6
_MIN_PART_WITH_HEIGHT = 0.5  # of an image's tie points, for poses over the elevation model
# Common error of all map features beside the map's tie, as a part of the map's pixel: under another Sun craters shift
# by up to a pixel each, but by less than a tenth in the mean. This bound, as of a uniform distribution, is sqrt(3)
# sigmas. The error does not decrease with the number of tie points.
_COMMON_PIXEL_PART = 0.1 / math.sqrt(3.0)
# The least common error of oblique images of ground taken as a plane, as a part of the rms displacement by heights: the
# adjustment absorbs relief that is wider than an image, and residuals do not show it.
_COMMON_OBLIQUE_PART = 0.5
# Distances between tie points at which the autocovariance of residuals is computed, and points for it.
_LAG_COUNT, _MAX_LAG_POINTS = 40, 2000

TIE_COLUMNS = (
    *("sample", "line", "residual_sample_px", "residual_line_px"),  # in images
    *("residual_east_m", "residual_north_m"),  # on the map
)


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
    common_m2: Floats  # covariance common to map features beside the map's tie, east and north, shape (2, 2)
    height_sigma_m: float  # of oblique images: heights about the plane or the elevation model
    sigma_factors: tuple[float, float]  # of stated sigmas in images and on the map, from residuals
    redundancy: int
    map_places_m: Floats  # adjusted places in the plane of the tie points with the map, shape (k, 2)
    map_residuals_m: Floats  # places on the map less the adjusted ones, shape (k, 2)
    relief: bool  # whether heights of the ground were modelled
    _ties: TiePoints = field(repr=False)
    _adjusted: Adjusted = field(repr=False)
    _images: dict[str, tuple[int, ChainImage]] = field(repr=False)
    _outlines: dict[str, Floats] = field(default_factory=dict, repr=False)

    def ground_point(
        self, name: str, pixel: ArrayLike | None = None, pixel_sigma: float = 0.0
    ) -> GroundPoint:
        """Return the place of a pixel of a registered image, by default its centre, with its covariance.

        The covariance includes errors of features and of the chain, and those common to all points: the map's tie,
        0.058 of its pixel and, without relief, its displacement of tie points. An unknown height h displaces
        the place by h tan(tilt) along its ray in the finest image with tie points on the map.
        """
        index, image = self._image(name)
        measured = np.asarray(image.centre if pixel is None else pixel, dtype=np.float64)
        undistorted = image.undistorted(measured[np.newaxis])[0]
        try:
            place, covariance = self._adjusted.place(index, undistorted, pixel_sigma)
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
        tied = self._tied_m(index)
        if not Bounds(self.plane, tied).are_near(place[np.newaxis])[0]:
            distance_m = np.hypot(*(place - tied.mean(axis=0)))
            raise InputError(
                f"{name}: the ground at sample {measured[0]:.1f}, line {measured[1]:.1f} is "
                f"{distance_m:.3g} m from the middle of the image's {len(tied)} tie points, far beyond their "
                "spread; choose another image or pixel"
            )
        longitude, latitude = self.plane.to_longitude_latitude(place[np.newaxis])[0]
        common_m2 = np.diag(np.square(self.map_sigma_m)) + self.common_m2
        if self.height_sigma_m:
            displacement = self.height_sigma_m * self._map_slope(index, place)
            covariance = covariance + np.outer(displacement, displacement)
        ground = self.plane.covariance_at(place, covariance) + common_m2
        return GroundPoint(float(longitude), float(latitude), ground)

    def self_calibration(self, focal_sigma_part: float, k1_sigma: float) -> SelfCalibration:
        """Estimate the errors of focal length and k1 from the residuals; all images need a camera."""
        cameras = [
            sight_matrix(image.camera) for _, image in self._images.values() if image.camera is not None
        ]
        prior_sigmas = np.array([focal_sigma_part, k1_sigma])
        return self_calibration(self._ties, self._adjusted, np.array(cameras), prior_sigmas)

    def radial_pattern(self) -> SelfCalibration:
        """Estimate k1 of cameras with half of the diagonal of their images as focal length.

        It is the displacement at the corners, as of unknown lens distortion, in units of half of the diagonal.
        """
        centres = np.array([image.centre for _, image in self._images.values()])
        cameras = np.hypot(*centres.T)[:, np.newaxis, np.newaxis] * np.diag([1.0, 1.0, 0.0])
        cameras[:, :2, 2], cameras[:, 2, 2] = centres, 1.0
        return self_calibration(self._ties, self._adjusted, cameras, np.array([0.0, 1.0]))

    def calibrated_point(
        self, point: GroundPoint, calibration: SelfCalibration, name: str, pixel: ArrayLike
    ) -> GroundPoint:
        """Return the place of a pixel with estimated errors of the camera, and with their covariance."""
        by_camera = self.camera_partials(calibration, name, pixel)
        place = self.plane.from_longitude_latitude([[point.longitude_deg, point.latitude_deg]])
        shifted = self.plane.to_longitude_latitude(place + by_camera @ calibration.values)
        covariance = point.covariance_m2 + by_camera @ calibration.covariance @ by_camera.T
        return GroundPoint(float(shifted[0, 0]), float(shifted[0, 1]), covariance)

    def camera_partials(self, calibration: SelfCalibration, name: str, pixel: ArrayLike) -> Floats:
        """Return the partials of the place of a pixel with respect to both errors of the camera, m, shape (2, 2)."""
        index, image = self._image(name)
        undistorted = image.undistorted(np.asarray(pixel, dtype=np.float64)[np.newaxis])[0]
        return calibration.place_partials(self._adjusted, index, undistorted)

    def tie_points(self) -> dict[str, Any]:
        """Return the tie points: one row for each image that shows one, and one for its place on the map.

        ``residual_sample_px`` and ``residual_line_px`` are observed less computed pixels without distortion,
        ``residual_east_m`` and ``residual_north_m`` places on the map less adjusted ones; NaN in rows of the other
        kind. ``used`` is zero for rejected observations. Places are adjusted, mean-Earth axes.
        """
        ties, result = self._ties, self._adjusted
        points = np.concatenate([ties.point, ties.map_point])
        degrees = self.plane.to_longitude_latitude(result.places_m)[points]
        pixels = ties.pixels.copy()
        for index, image in self._images.values():
            if image.camera is not None:
                rows = ties.image == index
                pixels[rows] = distorted(image.camera)(pixels[rows])[0]
        n = len(pixels)
        columns = np.full((len(points), len(TIE_COLUMNS)), np.nan)
        columns[:n, :4], columns[n:, 4:] = np.hstack([pixels, result.residuals_px]), result.map_residuals_m
        images = np.concatenate([ties.image, np.full(len(points) - n, len(self._images))]).astype(np.int32)
        return {
            "point": points,
            "observed_in": Labels(images, (*self._images, "map")),
            "used": np.concatenate([result.used, result.map_used]).astype(np.int64),
            **dict(zip(("longitude_deg", "latitude_deg"), degrees.T, strict=True)),
            **dict(zip(TIE_COLUMNS, columns.T, strict=True)),
        }

    def sensor_model(self, name: str, height_m: float = 0.0) -> FrameModel | None:
        """Return camera and pose of a registered image, mean-Earth axes; None without a camera.

        Images without a pose have that of their homography. `height_m` is the height of the ground for registrations
        without relief.
        """
        index, image = self._image(name)
        if image.camera is None:
            return None
        rotation, position_m = self._pose(index, image.camera, height_m)
        axes, sight = self.plane.axes(), image.camera.looks_along_z
        pose = ConstantOrientation(position_m @ axes, axes.T @ rotation.T * [1.0, sight, sight])
        return FrameModel(image.camera, pose, (image.size[1], image.size[0]))

    def _pose(self, index: int, camera: Camera, height_m: float = 0.0) -> tuple[Floats, Floats]:
        """Return rotation Q from the plane's axes to those along the line of sight, and position C, m."""
        model = self._adjusted.model
        if isinstance(model, Poses) and not model.low[index]:
            return model.rotations[index], model.positions_m[index]
        middle_m = self._tied_m(index).mean(axis=0)
        if isinstance(model, Poses):
            [point_m], _ = model.relief.points(middle_m[np.newaxis])
        else:
            up_m = math.sqrt(MEAN_LUNAR_RADIUS_M**2 - float(middle_m @ middle_m))
            point_m = np.append(middle_m, up_m) * (1.0 + height_m / MEAN_LUNAR_RADIUS_M)
        return pose_of_homography(sight_matrix(camera), self._homographies.matrices[index], point_m)

    def _slopes(self, index: int, pixels: Floats) -> Floats:
        """Return the displacement east and north by height of the ground, tan(tilt), of undistorted pixels, (n, 2)."""
        camera = self._image_at(index).camera
        if camera is None:
            return np.zeros((len(pixels), 2))
        to_plane = self._pose(index, camera)[0].T @ np.linalg.inv(sight_matrix(camera))
        rays = np.insert(pixels, 2, 1.0, axis=1) @ to_plane.T
        return np.asarray(rays[:, :2] / rays[:, 2:])

    def _map_slope(self, index: int, place: Floats) -> Floats:
        """Return the displacement by height of the ground in the finest image tied to the map that shows a place."""
        tied = (frame for frame in self.frames if frame.map_inliers >= _MIN_TIES)
        for frame in sorted(tied, key=lambda frame: frame.pixel_m):
            k, image = self._images[frame.name]
            pixel = self._adjusted.model.pixels(np.array([k]), np.array([0]), place[np.newaxis])
            if (np.abs(pixel[0] - image.centre) <= image.centre + 0.5).all():
                return self._slopes(k, pixel)[0]
        return self._slopes(index, self._image_at(index).centre[np.newaxis])[0]

    def _image_at(self, index: int) -> ChainImage:
        return [*self._images.values()][index][1]

    def with_height_sigma(self) -> Registration:
        """Return the registration with the sigma of heights, from places on the map less those by the images.

        An unknown height h displaces a tie point by h tan(tilt) along its rays; across them, differences are noise.
        The difference of both variances, at least its standard error, is that of the displacements.
        """
        ties, result = self._ties, self._adjusted
        projected = result.model.project(ties.image, ties.point, result.places_m)
        by_image = np.linalg.solve(projected.by_place, result.residuals_px[:, :, np.newaxis])[:, :, 0]
        slopes, moved, number = np.zeros((ties.count, 2)), np.zeros((ties.count, 2)), np.zeros(ties.count)
        for index in range(len(self._images)):
            used = self._used(index)
            slopes[ties.point[used]] = self._slopes(index, ties.pixels[used])
            np.add.at(moved, ties.point[used], by_image[used])
            np.add.at(number, ties.point[used], 1.0)
        on_map = ties.map_point[result.map_used]
        differences = result.map_residuals_m[result.map_used] - moved[on_map] / np.maximum(
            number[on_map, np.newaxis], 1.0
        )
        slopes = slopes[on_map]
        slopes2 = (slopes**2).sum(axis=1)
        if not slopes2.any():
            return self
        along_m2 = ((differences * slopes).sum(axis=1) ** 2).sum() / slopes2.sum()
        across_m2 = ((differences * slopes[:, ::-1] * [1.0, -1.0]).sum(axis=1) ** 2).sum() / slopes2.sum()
        error = math.hypot(along_m2, across_m2) * math.sqrt(2.0 / len(slopes))
        variance = max(along_m2 - across_m2, error) / slopes2.mean()
        part_m2 = 0.0 if self.relief else 0.5 * (_COMMON_OBLIQUE_PART**2 * variance * slopes2.mean())
        common_m2 = max(self.common_m2, part_m2 * np.eye(2), key=np.trace)
        return replace(self, height_sigma_m=math.sqrt(variance), common_m2=common_m2)

    def pose_covariance(self, name: str) -> Floats | None:
        """Return the covariance of a pose relative to the map, shape (6, 6); None for an image without adjusted pose.

        Errors are three angles about the camera's axes, rad, and three components of the position, east, north, up in
        the plane, m.
        """
        index, _ = self._image(name)
        model, block = self._adjusted.model, self._adjusted.block(index)
        if not isinstance(model, Poses) or model.low[index]:
            return None
        scale = np.append(np.ones(3), np.full(3, model.ranges_m()[index]))
        return self._adjusted.covariance[block, block][:6, :6] * np.outer(scale, scale)

    def view(self, name: str) -> View:
        """Return the view of a registered image, for its rectification."""
        index, image = self._image(name)
        model, bounds = self._adjusted.model, Bounds(self.plane, self._tied_m(index))
        if isinstance(model, Poses) and not model.low[index]:
            sensor = self.sensor_model(name)
            assert sensor is not None
            return TerrainView(sensor, model.relief.model, bounds)
        shape = image.size[1], image.size[0]
        return PlaneView(self.plane, self._homographies.matrices[index], shape, image.camera, bounds)

    def outline(self, name: str) -> Floats:
        """Return angles of the ground that a registered image shows, rad, shape (n, 2), computed once."""
        if name not in self._outlines:
            self._outlines[name] = outline(self.view(name))
        return self._outlines[name]

    @property
    def _homographies(self) -> Homographies:
        model = self._adjusted.model
        return model.homographies if isinstance(model, Poses) else model

    def _image(self, name: str) -> tuple[int, ChainImage]:
        """Return the number in the adjustment and the image of a name."""
        if name not in self._images:
            status = {frame.name: frame.status.value for frame in self.frames}.get(name, "not an image")
            raise InputError(f"expected a registered image, but {name} is {status}")
        return self._images[name]

    def _tied_m(self, index: int) -> Floats:
        """Return the places of the tie points of an image in the plane."""
        return self._adjusted.places_m[self._ties.point[self._used(index)]]

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
    detected: Detected | None = None,
) -> Registration:
    """Register the images of a descent, in order from high to low, to a map.

    `map_sigma_m` is the tie of the map to the Moon's axes, east and north. `mask` selects pixels of the ground.
    `search_area` is longitude and latitude, degrees, and a radius, m. With `terrain` and cameras, images have poses
    over relief; without, or where it lacks half of an image's tie points, the ground is a plane. `detected` keeps the
    features of images and their matches for the next map. Images out of order are an `InputError`, images of which none
    is found on the map a `ConvergenceError`.
    """
    plane = base.plane() if search_area is None else TangentPlane(*search_area[:2])
    chain = ImageChain(frames, MapFeatures(base, plane), mask, search_area, detected)
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
            *(image.name, image.status, image.reason, tuple(image.matched_to), image.candidates),
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
    common_m2 = (_COMMON_PIXEL_PART * chain.map.base.resolution_m) ** 2 * np.eye(2)
    if not relief:
        common_m2 += relief_covariance_m2(ties, result, len(numbers) - 1)
    _require_order([frame for frame in frames if frame.is_registered])
    registration = Registration(
        frames=tuple(frames),
        plane=chain.map.plane,
        map_sigma_m=map_sigma_m,
        common_m2=common_m2,
        height_sigma_m=0.0,
        sigma_factors=result.sigma_factors,
        redundancy=result.redundancy,
        map_places_m=result.places_m[ties.map_point[result.map_used]],
        map_residuals_m=result.map_residuals_m[result.map_used],
        relief=relief,
        _ties=ties,
        _adjusted=result,
        _images={
            chain.images[number].name: (k, replace(chain.images[number], features=None))
            for k, number in enumerate(numbers)
        },
    )
    # Images that are not declared as oblique look down, where heights hardly displace the place of the lander.
    oblique = any(chain.images[number].turned is not None for number in numbers)
    return registration.with_height_sigma() if oblique else registration


def relief_covariance_m2(ties: TiePoints, result: Adjusted, image: int) -> Floats:
    """Return the covariance of the middle of an image by relief of ground taken as a plane, m^2, shape (2, 2).

    Relief displaces neighbouring tie points alike, which the adjustment takes for independent noise. Errors of two tie
    points have the autocovariance of the residuals on the map at their distance, up to the first that is not positive
    (initial positive sequence, Geyer 1992): beyond, residuals lack what the adjustment absorbed.
    """
    used = np.flatnonzero(result.map_used)
    step = -(-len(used) // _MAX_LAG_POINTS)
    points, residuals_m = ties.map_point[used[::step]], result.map_residuals_m[used[::step]]
    pixel = ties.pixels[result.used & (ties.image == image)].mean(axis=0)
    influence = step * map_influence(ties, result, image, pixel)[points]
    first, second = np.triu_indices(len(points), 1)
    distance_m = np.linalg.norm(result.places_m[points[first]] - result.places_m[points[second]], axis=1)
    lag = np.searchsorted(np.quantile(distance_m, np.arange(1, _LAG_COUNT) / _LAG_COUNT), distance_m)
    products_m2 = [
        np.bincount(lag, residuals_m[first, i] * residuals_m[second, j], _LAG_COUNT)
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1))
    ]
    autocovariance_m2 = np.reshape(
        products_m2 / np.maximum(np.bincount(lag, minlength=_LAG_COUNT), 1), (2, 2, -1)
    )
    autocovariance_m2 *= np.logical_and.accumulate(np.trace(autocovariance_m2) > 0.0)
    between_m2 = autocovariance_m2.transpose(2, 0, 1)[lag]
    covariance_m2 = np.einsum("nai,nij,nbj->ab", influence[first], between_m2, influence[second])
    values, axes = np.linalg.eigh(covariance_m2 + covariance_m2.T)
    return np.asarray(axes * np.maximum(values, 0.0) @ axes.T)


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
    cameras = [sight_matrix(image.camera) for image in images if image.camera is not None]
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
