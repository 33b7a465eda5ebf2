"""The images of a descent, from high to low, and what ties them to each other and to a map.

Each image is compared with images before it (one, two, four and eight back) and, while it is wide enough and not
much finer than the map, with the map: anywhere on it until an image has been found there, then where the chain predicts
it. What does not match keeps a status that says why.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from radioloc.errors import ConvergenceError, InputError, RadiolocError
from radioloc.imaging.adjustment import TiePoints
from radioloc.imaging.cameras import Camera, undistorted
from radioloc.imaging.frames import load_opencv
from radioloc.imaging.homography import derivative, fit_homography, transformed
from radioloc.imaging.map_features import MapFeatures, MapPart
from radioloc.imaging.matching import Features, Matches, MatchStatus, detect, match
from radioloc.imaging.tracks import MAP
from radioloc.lunar.grey_images import Image, Mask
from radioloc.vectors import Floats

_STEPS_BACK = (1, 2, 4, 8)
_LARGEST_SIDE_PIXELS = 1200  # of images in which features are sought
_FEATURES = 1500
_LEAST_WIDTH_ON_MAP_PIXELS = 90
_SEARCHES = 6  # of the whole map, for the first images
_SEARCH_PIXELS = 500, 4200  # sides of the whole map, reduced, at which it is searched
_PREDICTED_PART = 0.08  # of an image's width: how far a prediction along the chain may be off
_FOUND, _FOR_MAP, _GIVEN = range(3)  # measurements: features, those at the map's size of pixels, given ones

RISE = 1.3  # ratio of pixel sizes by which a later image is out of order
_RISING_PART = 0.6  # of links between neighbours, in which a descent in reversed order rises


class FrameStatus(StrEnum):
    """What became of an image."""

    REGISTERED = "registered"
    UNREADABLE = "unreadable"
    FEATURELESS = "featureless"  # black, saturated, or without detail
    UNMATCHED = "unmatched"  # matches no other image and not the map
    UNTIED = "untied"  # matches images none of which is tied to the map
    REJECTED = "rejected"  # too few of its tie points agree with those of the other images


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """An image to be registered.

    Parameters
    ----------
    name : str
        For messages and results.
    read : callable
        Returns the image, eight bits; called once, when its turn comes.
    camera : callable, optional
        From lines and samples to the camera of such an image. Its distortion is taken off; homographies are of pixels
        without it.
    """

    name: str
    read: Callable[[], Image]
    camera: Callable[[tuple[int, int]], Camera] | None = None


@dataclass(frozen=True, slots=True)
class Measurement:
    """Where a point is in one image."""

    image: str
    sample: float
    line: float
    sigma_px: float = 1.0  # of points clicked by hand


@dataclass(frozen=True, slots=True)
class TiePoint:
    """A point measured in images, with its place on the Moon where that is known (mean-Earth axes)."""

    name: str
    measurements: tuple[Measurement, ...]
    longitude_deg: float | None = None
    latitude_deg: float | None = None
    sigma_m: float | None = None


@dataclass(slots=True, eq=False)
class Taken:
    """An image of the chain, its features in its own pixels (undistorted)."""

    name: str
    size: tuple[int, int]  # samples and lines
    status: FrameStatus
    reason: str = ""
    features: Features | None = None
    first: int = 0  # number of the first of them
    matched_to: list[str] = field(default_factory=list)
    candidates: int = 0
    to_plane: Floats | None = None  # approximate
    camera: Camera | None = None

    @property
    def centre(self) -> Floats:
        """The pixel in the middle."""
        return 0.5 * (np.array(self.size, dtype=np.float64) - 1.0)

    def match(self, name: str, candidates: int) -> None:
        """Note what it was matched to."""
        self.status = FrameStatus.UNTIED
        self.matched_to.append(name)
        self.candidates += candidates

    def undistorted(self, pixels: Floats) -> Floats:
        """Pixels, shape (n, 2), where they would be without distortion."""
        return pixels if self.camera is None else undistorted(self.camera)(pixels)


class ImageChain:
    """Images taken one by one, the tie points found, and what links them."""

    def __init__(
        self,
        frames: Sequence[Frame],
        on_map: MapFeatures,
        mask: Mask | None,
        near: tuple[float, float, float] | None,
        ties: Sequence[TiePoint],
    ) -> None:
        names = [frame.name for frame in frames]
        if len(set(names)) < len(names):
            raise InputError(f"images have the same name: {sorted({n for n in names if names.count(n) > 1})}")
        self.mask, self.map = mask, on_map
        self.taken: list[Taken] = []
        self.tracks = on_map.tracks
        self.links: list[tuple[int, int, Floats]] = []  # homographies between images
        self.given = [tie for tie in ties if {m.image for m in tie.measurements} & set(names)]
        if ties and not self.given:
            raise InputError(
                f"none of the {len(ties)} tie points is measured in one of the images; compare names"
            )
        # The first measurement of each: its number, the image, the pixel or place, and its sigma.
        self.first_of_given: dict[int, tuple[int, int, Floats, float]] = {}
        for k, tie in enumerate(self.given):
            if tie.longitude_deg is not None and tie.latitude_deg is not None:
                [place] = on_map.plane.from_longitude_latitude([[tie.longitude_deg, tie.latitude_deg]])
                self._give(k, MAP, place, tie.sigma_m or on_map.base.resolution_m)
        self.searches = 0
        self.extent_m = on_map.base.extent_m(on_map.plane)
        if near is not None:
            west, south, east, north = self.extent_m
            self.extent_m = max(west, -near[2]), max(south, -near[2]), min(east, near[2]), min(north, near[2])
            if self.extent_m[0] >= self.extent_m[2] or self.extent_m[1] >= self.extent_m[3]:
                raise InputError(
                    f"{on_map.base.path} does not show the surroundings of longitude {near[0]:.4f}, latitude "
                    f"{near[1]:.4f} degrees; it covers {on_map.base.coverage}"
                )

    def add(self, frame: Frame) -> None:
        """Take the next image: find its features, and tie them to images before it and to the map."""
        try:
            image = frame.read()
        except RadiolocError as error:
            self.taken.append(Taken(frame.name, (0, 0), FrameStatus.UNREADABLE, str(error)))
            return
        if self.mask is not None and self.mask.shape != image.shape:
            raise InputError(f"{frame.name} has {image.shape} lines and samples, the mask {self.mask.shape}")
        size = (image.shape[1], image.shape[0])
        reduction = max(1, -(-max(size) // _LARGEST_SIDE_PIXELS))
        camera = None if frame.camera is None else frame.camera(image.shape)
        this = Taken(frame.name, size, FrameStatus.UNMATCHED, camera=camera)
        this.features = features = self._features(this, image, reduction)
        number = len(self.taken)
        this.first = self.tracks.add(number, _FOUND, features.pixels, features.sigma_px)
        self.taken.append(this)
        self._take_given(frame, number)
        best = 0
        for back in _STEPS_BACK:
            other = self.taken[number - back] if back <= number else None
            if other is None or other.features is None:
                continue
            found = match(features, other.features)
            if found.status is MatchStatus.FEATURELESS and len(features.pixels) < len(other.features.pixels):
                this.features = None
                this.status = FrameStatus.FEATURELESS if this.status is FrameStatus.UNMATCHED else this.status
                return
            if not found.matched or found.matrix is None:
                continue
            this.match(other.name, found.candidates)
            self.links.append((number, number - back, found.matrix))
            self.tracks.join(this.first + found.first, other.first + found.second)
            if other.to_plane is not None and len(found.first) > best:
                best, this.to_plane = len(found.first), _product(other.to_plane, found.matrix)
        self._tie_to_map(number, image, reduction)

    def _take_given(self, frame: Frame, number: int) -> None:
        """Tie the image by points that are given, and place it where enough of them have a place already."""
        this = self.taken[number]
        known: list[tuple[Floats, float, Floats, float]] = []
        for k, tie in enumerate(self.given):
            for m in (m for m in tie.measurements if m.image == frame.name):
                pixel = this.undistorted(np.array([[m.sample, m.line]]))[0]
                image, place, sigma = self._give(k, number, pixel, m.sigma_px)
                if image != MAP:
                    to_plane = self.taken[image].to_plane
                    if to_plane is None:
                        continue
                    sigma *= pixel_size_m(to_plane, self.taken[image].size)
                    place = transformed(to_plane, place[np.newaxis])[0]
                known.append((pixel, m.sigma_px, place, sigma))
        if len(known) >= 4:
            pixels, sigma_px, places, sigma_m = (np.array(column) for column in zip(*known, strict=True))
            this.to_plane = fit_homography(pixels, places, sigma_px, sigma_m)
            this.match("given", len(known))

    def _give(self, k: int, image: int, place: Floats, sigma: float) -> tuple[int, Floats, float]:
        """Note a measurement of a given point, tied to its first one: image, pixel or place, and sigma of that."""
        here = self.tracks.add(image, _GIVEN, place[np.newaxis], [sigma])
        first = self.first_of_given.setdefault(k, (here, image, place, sigma))
        if first[0] != here:
            self.tracks.join([here], [first[0]])
        return first[1:]

    def _features(self, this: Taken, image: Image, reduction: int) -> Features:
        """Features of an image reduced by a whole number, at their pixels in the image itself, undistorted."""
        cv2 = load_opencv()
        mask = self.mask
        if reduction > 1:
            size = (image.shape[1] // reduction, image.shape[0] // reduction)
            cut = slice(size[1] * reduction), slice(size[0] * reduction)
            image = cv2.resize(image[cut], size, interpolation=cv2.INTER_AREA)
            if mask is not None:
                mask = cv2.resize(mask[cut].astype(np.uint8), size, interpolation=cv2.INTER_AREA) == 1
        found = detect(image, mask, self.map.detector, _FEATURES)
        pixels = (found.pixels + 0.5) * reduction - 0.5
        shape = (image.shape[0] * reduction, image.shape[1] * reduction)
        return found.moved(this.undistorted(pixels), found.sigma_px * reduction, shape)

    def _tie_to_map(self, number: int, image: Image, reduction: int) -> None:
        this = self.taken[number]
        found: tuple[Matches, MapPart] | None = None
        features, first = this.features, this.first
        if features is None:
            return
        if this.to_plane is not None:
            pixel_m = pixel_size_m(this.to_plane, this.size)
            width_m = pixel_m * max(this.size)
            if width_m < _LEAST_WIDTH_ON_MAP_PIXELS * self.map.base.resolution_m:
                return
            needed = int(self.map.base.resolution_m / pixel_m)
            if needed > 1.5 * reduction:
                features = self._features(this, image, needed)
                first = self.tracks.add(number, _FOR_MAP, features.pixels, features.sigma_px)
            level = self.map.level(pixel_m * max(reduction, needed))
            found = self._near_prediction(features, this, level, width_m)
        elif self.searches < _SEARCHES:
            self.searches += 1
            found = self._anywhere(features)
        if found is None or found[0].matrix is None:
            return
        matches, part = found
        this.match("map", matches.candidates)
        this.to_plane = part.to_plane @ found[0].matrix
        self.tracks.join(first + matches.first, part.numbers[matches.second])

    def _near_prediction(
        self, features: Features, this: Taken, level: int, width_m: float
    ) -> tuple[Matches, MapPart] | None:
        assert this.to_plane is not None
        samples, lines = this.size
        corners = transformed(
            this.to_plane, np.array([[0.0, 0.0], [samples, 0.0], [0.0, lines], [samples, lines]])
        )
        margin_m = _PREDICTED_PART * width_m
        west, south = corners.min(axis=0) - margin_m
        east, north = corners.max(axis=0) + margin_m
        if max(east - west, north - south) > 10.0 * width_m:
            return None
        part = self.map.around(level, (west, south, east, north))
        predicted = np.diag([1.0 / part.pixel_m, -1.0 / part.pixel_m, 1.0]) @ this.to_plane
        matches = match(features, part.features, predicted, max(10.0, margin_m / part.pixel_m))
        return (matches, part) if matches.matched else None

    def _anywhere(self, features: Features) -> tuple[Matches, MapPart] | None:
        """The image sought on the whole map, or near a place, at sizes of the map's pixels from coarse to fine."""
        # The size of the image's own pixels is not known yet: of all that match, chance makes the one taken the least.
        west, south, east, north = self.extent_m
        side_m = max(east - west, north - south)
        found = []
        for level in range(self.map.level(side_m / _SEARCH_PIXELS[0]), -1, -1):
            if side_m > _SEARCH_PIXELS[1] * self.map.pixel_m(level):
                break
            part = self.map.around(level, self.extent_m)
            matches = match(features, part.features)
            if matches.matched:
                found.append((matches, part))
        return min(found, key=lambda one: one[0].log10_false_alarms, default=None)

    def require_descent(self) -> None:
        """Refuse images in reversed order, whose pixels on the ground grow from image to image."""
        neighbours = ((number, matrix) for number, other, matrix in self.links if number - other == 1)
        growth = np.log([pixel_size_m(matrix, self.taken[number].size) for number, matrix in neighbours])
        factor = float(np.exp(growth.sum()))
        if factor > RISE and (growth > 0.0).mean() > _RISING_PART:
            raise InputError(
                f"images are in reversed order: from {self.taken[0].name} to {self.taken[-1].name} their pixels on the "
                f"ground grow by a factor of {factor:.3g}; give them in order of time, the highest first"
            )

    def place_all(self) -> None:
        """Approximate homographies of images that come before the first that was found on the map."""
        for number, other, matrix in reversed(self.links):
            one, two = self.taken[number], self.taken[other]
            if two.to_plane is None and one.to_plane is not None:
                two.to_plane = _product(one.to_plane, np.asarray(np.linalg.inv(matrix), dtype=np.float64))

    def ties(self, left_out: set[int]) -> tuple[list[int], TiePoints]:
        """Return the numbers of the images that are tied to the map, and their tie points, or raise an error."""
        images, ties = self.tracks.ties(left_out, np.array([one.to_plane is not None for one in self.taken]))
        if not len(images):
            status = [f"{taken.name} {taken.status.value}" for taken in self.taken[:5]]
            more = f" and {len(self.taken) - 5} more" if len(self.taken) > 5 else ""
            raise ConvergenceError(
                f"no image was found on {self.map.base.path} ({', '.join(status)}{more}); give a map of the landing "
                "area under a sun like the images', or shade the elevation model at their sun; the highest image "
                "comes first"
            )
        return images.tolist(), ties


def _product(first: Floats, second: Floats) -> Floats:
    """Of homographies, of size one: along hundreds of images the products would overflow."""
    product = first @ second
    return np.asarray(product / np.linalg.norm(product))


def pixel_size_m(to_plane: Floats, size: tuple[int, int]) -> float:
    """Size of a pixel on the ground at the centre of an image."""
    centre = 0.5 * (np.array([size], dtype=np.float64) - 1.0)
    return float(np.sqrt(np.abs(np.linalg.det(derivative(to_plane, centre)[0]))))
