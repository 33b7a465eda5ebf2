"""Images of a descent, from high to low, and their tie points with each other and with a map.

Each image is compared with earlier images (one, two, four and eight back). While it is wide enough and not much finer
than the map, it is also compared with the map: all of it until an image is located there, later the part that the chain
predicts. Images without matches keep a status with the reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from radioloc.errors import ConvergenceError, InputError, RadiolocError
from radioloc.imaging.adjustment import TiePoints
from radioloc.imaging.cameras import Camera, undistorted
from radioloc.imaging.frames import load_opencv
from radioloc.imaging.homography import derivative, transformed
from radioloc.imaging.map_features import MapFeatures, MapPart
from radioloc.imaging.matching import Features, Matches, MatchStatus, detect, match
from radioloc.imaging.oblique import TurnedImage, searched_verticals, vertical_of_homography
from radioloc.lunar.grey_images import Image, Mask
from radioloc.vectors import Floats

_STEPS_BACK = (1, 2, 4, 8)
_MAX_SIDE_PIXELS = 1200  # of images in which features are detected
_FEATURE_COUNT = 1500
_MIN_WIDTH_MAP_PIXELS = 90  # of images that are compared with the map
_MAX_SEARCHES = 6  # of the whole map, for the first images
# log10 of the false alarms of a search that ends it: finer levels cannot change the place, only refine it.
_MAX_CERTAIN_ALARMS = -20.0
# Pixel size as a part of the map's below which images are reduced by two: their tie points stay finer than the map's.
_MAX_REDUCED_PIXEL_PART = 0.4
_MIN_REDUCED_SIDE_PIXELS = 500  # so that frames far apart in scale keep enough features in common
_PART_PIXELS = 900  # side of the part of the map for an image
_SEARCH_PIXELS = 500, 4200  # sides of the whole map, reduced, for searches
_PREDICTION_ERROR_PART = 0.08  # of an image's width: error of a prediction along the chain
_DETECTED, _REDUCED = range(2)  # measurements: features, and features at the map's pixel size

MAX_PIXEL_GROWTH = 1.3  # ratio of pixel sizes by which a later image is out of order
_MIN_GROWING_PART = 0.6  # of links between neighbours, in which a descent in reversed order grows


class FrameStatus(StrEnum):
    """Result of the registration of an image."""

    REGISTERED = "registered"
    UNREADABLE = "unreadable"
    FEATURELESS = "featureless"  # black, saturated, or without detail
    UNMATCHED = "unmatched"  # matches neither another image nor the map
    UNTIED = "untied"  # matches images that are not tied to the map
    REJECTED = "rejected"  # too few of its tie points agree with those of the other images


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Image to be registered; `camera` returns the camera for lines and samples, whose distortion is removed.

    Features of a `turned` image are those of a view straight down, by its rotation from the camera's axes to the Moon's
    or by an estimated one.
    """

    name: str
    read: Callable[[], Image]  # eight bits; called once
    camera: Callable[[tuple[int, int]], Camera] | None = None
    turned: bool = False
    rot_camera_to_moon: Floats | None = None


@dataclass(slots=True, eq=False)
class ChainImage:
    """Image of the chain with its features in undistorted pixels of full size."""

    name: str
    size: tuple[int, int]  # samples and lines
    status: FrameStatus
    reason: str = ""
    features: Features | None = None
    first: int = 0  # number of the first feature
    matched_to: list[str] = field(default_factory=list)
    candidates: int = 0
    to_plane: Floats | None = None  # approximate
    camera: Camera | None = None
    turned: TurnedImage | None = None

    @property
    def centre(self) -> Floats:
        """Pixel in the middle."""
        return 0.5 * (np.array(self.size, dtype=np.float64) - 1.0)

    def record_match(self, name: str, candidates: int) -> None:
        """Record a match with another image or the map."""
        self.status = FrameStatus.UNTIED
        self.matched_to.append(name)
        self.candidates += candidates

    def undistorted(self, pixels: Floats) -> Floats:
        """Return pixels, shape (n, 2), without distortion."""
        return pixels if self.camera is None else undistorted(self.camera)(pixels)


@dataclass(slots=True, eq=False)
class Detected:
    """Features of images and their matches, for registrations on several maps."""

    features: dict[tuple[str, int, bytes], Features] = field(default_factory=dict)
    matches: dict[tuple[int, int], Matches] = field(default_factory=dict)  # by the identity of both features

    def match(self, first: Features, second: Features, predicted: Floats | None) -> Matches:
        """Return the matches of two images, near predicted partners if they are given."""
        key = id(first), id(second)
        if key not in self.matches:
            radius_px = math.inf if predicted is None else _PREDICTION_ERROR_PART * max(second.shape)
            self.matches[key] = match(first, second, predicted, radius_px)
        return self.matches[key]


class ImageChain:
    """Images in order of time with their tie points and links."""

    def __init__(
        self,
        frames: Sequence[Frame],
        map_features: MapFeatures,
        mask: Mask | None,
        search_area: tuple[float, float, float] | None,
        detected: Detected | None = None,
    ) -> None:
        names = [frame.name for frame in frames]
        if len(set(names)) < len(names):
            raise InputError(f"images have the same name: {sorted({n for n in names if names.count(n) > 1})}")
        self.mask, self.map, self.detected = mask, map_features, detected or Detected()
        self.images: list[ChainImage] = []
        self.tracks = map_features.tracks
        self.links: dict[tuple[int, int], Floats] = {}  # homographies of images to earlier ones
        self.searches = 0
        self.extent_m = map_features.base.extent_m(map_features.plane)
        if search_area is not None:
            longitude, latitude, radius_m = search_area
            west, south, east, north = np.clip(self.extent_m, -radius_m, radius_m).tolist()
            self.extent_m = west, south, east, north
            if west >= east or south >= north:
                raise InputError(
                    f"{map_features.base.path} does not show the surroundings of longitude {longitude:.4f}, latitude "
                    f"{latitude:.4f} degrees; it covers {map_features.base.coverage}"
                )

    def add(self, frame: Frame) -> None:
        """Add the next image: detect its features, and match them with earlier images and the map."""
        try:
            pixels = frame.read()
        except RadiolocError as error:
            self.images.append(ChainImage(frame.name, (0, 0), FrameStatus.UNREADABLE, str(error)))
            return
        if self.mask is not None and self.mask.shape != pixels.shape:
            raise InputError(f"{frame.name} has {pixels.shape} lines and samples, the mask {self.mask.shape}")
        size = (pixels.shape[1], pixels.shape[0])
        reduction = max(1, -(-max(size) // _MAX_SIDE_PIXELS))
        if max(size) >= 2 * reduction * _MIN_REDUCED_SIDE_PIXELS and self._is_finer_than_map(reduction):
            reduction *= 2
        camera = None if frame.camera is None else frame.camera(pixels.shape)
        image = ChainImage(frame.name, size, FrameStatus.UNMATCHED, camera=camera)
        if frame.turned:
            self._turn(image, frame.rot_camera_to_moon, pixels, reduction)
        image.features = features = self._features(image, pixels, reduction)
        number = len(self.images)
        image.first = self.tracks.add(number, _DETECTED, features.pixels, features.sigma_px)
        self.images.append(image)
        best = 0
        for step in _STEPS_BACK:
            earlier = self.images[number - step] if step <= number else None
            if earlier is None or earlier.features is None:
                continue
            middle = number - step // 2
            halves = self.links.get((middle, number - step)), self.links.get((number, middle))
            predicted = None if halves[0] is None or halves[1] is None else _product(halves[0], halves[1])
            matches = self.detected.match(features, earlier.features, predicted)
            featureless = matches.status is MatchStatus.FEATURELESS
            if featureless and len(features.pixels) < len(earlier.features.pixels):
                image.features = None
                if image.status is FrameStatus.UNMATCHED:
                    image.status = FrameStatus.FEATURELESS
                return
            if matches.matrix is None:
                continue
            image.record_match(earlier.name, matches.candidates)
            self.links[number, number - step] = matches.matrix
            self.tracks.join(image.first + matches.first, earlier.first + matches.second)
            if earlier.to_plane is not None and len(matches.first) > best:
                best, image.to_plane = len(matches.first), _product(earlier.to_plane, matches.matrix)
        self._tie_to_map(number, pixels, reduction)

    def _is_finer_than_map(self, reduction: int) -> bool:
        """Return True if the pixels of the previous image, reduced, are much smaller than those of the map."""
        previous = self.images[-1] if self.images else None
        if previous is None or previous.to_plane is None:
            return False
        pixel_m = reduction * pixel_size_m(previous.to_plane, previous.size)
        return pixel_m < _MAX_REDUCED_PIXEL_PART * self.map.base.resolution_m

    def _turn(self, image: ChainImage, rotation: Floats | None, pixels: Image, reduction: int) -> None:
        """Set the view straight down of an image, by its attitude, by that of the previous image, or by a search."""
        camera, previous = image.camera, self.images[-1] if self.images else None
        assert camera is not None
        if rotation is not None:
            down = -self.map.plane.axes()[2] @ rotation * [1.0, camera.looks_along_z, camera.looks_along_z]
            image.turned = TurnedImage.of_vertical(camera, image.size, down)
        elif previous is not None and previous.to_plane is not None:
            down = vertical_of_homography(camera, previous.to_plane, previous.centre)
            image.turned = TurnedImage.of_vertical(camera, image.size, down)
        elif self.searches < _MAX_SEARCHES:
            views, alarms = [], []
            for vertical in searched_verticals():
                image.turned = TurnedImage.of_vertical(camera, image.size, vertical)
                result = self._search_map(self._features(image, pixels, reduction))
                views.append(image.turned)
                alarms.append(math.inf if result is None else result[0].log10_false_alarms)
            image.turned = views[int(np.argmin(alarms))]

    def _features(self, image: ChainImage, pixels: Image, reduction: int) -> Features:
        """Return the features of an image reduced by a whole number, at undistorted pixels of full size."""
        turned = b"" if image.turned is None else image.turned.to_turned.tobytes()
        key = image.name, reduction, turned
        if key not in self.detected.features:
            self.detected.features[key] = self._detect(image, pixels, reduction)
        return self.detected.features[key]

    def _detect(self, image: ChainImage, pixels: Image, reduction: int) -> Features:
        cv2 = load_opencv()
        mask = self.mask
        if reduction > 1:
            size = (pixels.shape[1] // reduction, pixels.shape[0] // reduction)
            cut = slice(size[1] * reduction), slice(size[0] * reduction)
            pixels = cv2.resize(pixels[cut], size, interpolation=cv2.INTER_AREA)
            if mask is not None:
                mask = cv2.resize(mask[cut].astype(np.uint8), size, interpolation=cv2.INTER_AREA) == 1
        if image.turned is not None:
            features = detect(*image.turned.drawn(pixels, mask, reduction), _FEATURE_COUNT)
            places, size_px = image.turned.straight(features.pixels, reduction)
            full = pixels.shape[0] * reduction, pixels.shape[1] * reduction
            return features._replace(pixels=places, sigma_px=features.sigma_px * size_px, shape=full)
        features = detect(pixels, mask, _FEATURE_COUNT)
        return features._replace(
            pixels=image.undistorted((features.pixels + 0.5) * reduction - 0.5),
            sigma_px=features.sigma_px * reduction,
            shape=(pixels.shape[0] * reduction, pixels.shape[1] * reduction),
        )

    def _tie_to_map(self, number: int, pixels: Image, reduction: int) -> None:
        image = self.images[number]
        result: tuple[Matches, MapPart] | None = None
        features, first = image.features, image.first
        assert features is not None
        to_plane = image.to_plane
        if to_plane is None and self.searches < _MAX_SEARCHES:
            self.searches += 1
            result = self._search_map(features)
            if result is not None and result[0].matrix is not None:
                to_plane = result[1].to_plane @ result[0].matrix
        if to_plane is not None:
            pixel_m = pixel_size_m(to_plane, image.size)
            width_m = pixel_m * max(image.size)
            if width_m >= _MIN_WIDTH_MAP_PIXELS * self.map.base.resolution_m:
                map_reduction = int(self.map.base.resolution_m / pixel_m)
                if map_reduction > 1.5 * reduction and result is None:
                    features = self._features(image, pixels, map_reduction)
                    first = self.tracks.add(number, _REDUCED, features.pixels, features.sigma_px)
                pixel_m *= max(reduction, map_reduction)
                result = self._match_predicted(features, to_plane, image.size, pixel_m, width_m) or result
        if result is None:
            return
        matches, part = result
        assert matches.matrix is not None
        image.record_match("map", matches.candidates)
        image.to_plane = part.to_plane @ matches.matrix
        self.tracks.join(first + matches.first, part.numbers[matches.second])

    def _match_predicted(
        self, features: Features, to_plane: Floats, size: tuple[int, int], pixel_m: float, width_m: float
    ) -> tuple[Matches, MapPart] | None:
        """Match an image with the part of the map that its approximate homography predicts."""
        corners = transformed(to_plane, np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]) * size)
        margin_m = _PREDICTION_ERROR_PART * width_m
        west, south = corners.min(axis=0) - margin_m
        east, north = corners.max(axis=0) + margin_m
        if max(east - west, north - south) > 10.0 * width_m:
            return None
        # At finer levels, the part of an oblique image would lose most of its features.
        side_m = math.sqrt((east - west) * (north - south))
        level = self.map.level(max(pixel_m, side_m / _PART_PIXELS))
        part = self.map.part(level, (west, south, east, north))
        predicted = np.diag([1.0 / part.pixel_m, -1.0 / part.pixel_m, 1.0]) @ to_plane
        matches = match(features, part.features, predicted, max(10.0, margin_m / part.pixel_m))
        return None if matches.matrix is None else (matches, part)

    def _search_map(self, features: Features) -> tuple[Matches, MapPart] | None:
        """Search the map for an image at pixel sizes from coarse to fine; the result has the fewest false alarms."""
        west, south, east, north = self.extent_m
        side_m = max(east - west, north - south)
        results = []
        for level in range(self.map.level(side_m / _SEARCH_PIXELS[0]), -1, -1):
            if side_m > _SEARCH_PIXELS[1] * self.map.pixel_m(level):
                break
            part = self.map.part(level, self.extent_m)
            matches = match(features, part.features)
            if matches.matrix is not None:
                results.append((matches, part))
                if matches.log10_false_alarms < _MAX_CERTAIN_ALARMS:
                    break
        return min(results, key=lambda result: result[0].log10_false_alarms, default=None)

    def require_descent(self) -> None:
        """Raise an error for images in reversed order, whose pixels on the ground grow from image to image."""
        pairs = [(number, self.links.get((number, number - 1))) for number in range(1, len(self.images))]
        links = [(self.images[number].size, matrix) for number, matrix in pairs if matrix is not None]
        growth = np.log([pixel_size_m(matrix, size) for size, matrix in links])
        factor = float(np.exp(growth.sum()))
        if factor > MAX_PIXEL_GROWTH and (growth > 0.0).mean() > _MIN_GROWING_PART:
            raise InputError(
                f"images are in reversed order: from {self.images[0].name} to {self.images[-1].name} their pixels on "
                f"the ground grow by a factor of {factor:.3g}; give them in order of time, the highest first"
            )

    def place_all(self) -> None:
        """Set approximate homographies of images before the first one on the map."""
        for (number, earlier_number), matrix in reversed(self.links.items()):
            image, earlier = self.images[number], self.images[earlier_number]
            if earlier.to_plane is None and image.to_plane is not None:
                inverse = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
                earlier.to_plane = _product(image.to_plane, inverse)

    def ties(self, rejected: set[int]) -> tuple[list[int], TiePoints]:
        """Return the numbers of the images that are tied to the map, and their tie points."""
        placed = np.array([image.to_plane is not None for image in self.images])
        images, ties = self.tracks.ties(rejected, placed)
        if not len(images):
            status = [f"{image.name} {image.status.value}" for image in self.images[:5]]
            suffix = f" and {len(self.images) - 5} more" if len(self.images) > 5 else ""
            raise ConvergenceError(
                f"no image was found on {self.map.base.path} ({', '.join(status)}{suffix}); give a map of the landing "
                "area under a similar Sun, or shade the elevation model, with the highest image first"
            )
        return images.tolist(), ties


def _product(first: Floats, second: Floats) -> Floats:
    """Return the product of homographies, normalized: products along hundreds of images would overflow."""
    product = first @ second
    return np.asarray(product / np.linalg.norm(product))


def pixel_size_m(to_plane: Floats, size: tuple[int, int]) -> float:
    """Return the size of a pixel on the ground at the centre of an image, m."""
    centre = 0.5 * (np.array([size], dtype=np.float64) - 1.0)
    return float(np.sqrt(np.abs(np.linalg.det(derivative(to_plane, centre)[0]))))
