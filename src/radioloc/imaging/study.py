"""Study of images: its tables and their reader.

``[images]`` and ``[camera]`` locate a lander by its descent images, ``[image_point]`` a point in one orbital image,
``[stereo]`` a rover or lander by stereo images of landmarks. ``[stereo_pair]`` measures points in a pair of images,
``[base_map]`` makes a map from orbital images.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from radioloc.errors import InputError, require_type
from radioloc.lunar.selenographic import require_lunar_height
from radioloc.study.schema import Hints, TomlTable, check, entry, keys_of, source_of, toml_content
from radioloc.study.study import Reference
from radioloc.study.target_file import references_of
from radioloc.time import Epochs, epochs_from_strings

if TYPE_CHECKING:
    from radioloc.imaging.cameras import Camera


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundChoice:
    """Height of the ground: an elevation model, or a height above the 1737.4 km sphere."""

    dem: Path | None = None
    dem_sigma_m: float = entry(10.0, not_negative=True)
    height_m: float | None = None
    height_sigma_m: float = entry(10.0, not_negative=True)

    def __post_init__(self) -> None:
        check(self)
        if self.dem is not None and self.height_m is not None:
            raise InputError("give either dem or height_m, not both")
        if self.height_m is not None:
            require_lunar_height(self.height_m)


@dataclass(frozen=True, slots=True)
class ImageChoice(GroundChoice):
    """Table ``[images]``: images of a descent, in order of time, and the map."""

    files: tuple[Path, ...]
    base_map_sigma_m: tuple[float, float] = entry(not_negative=True)  # east, north; common to all points
    base_map: Path | tuple[Path, ...] | None = None
    base_map_epochs: tuple[str, ...] = ()  # UTC, of the images of each map, for its Sun
    mask: Path | None = None  # white for pixels of the ground
    rectify: bool = False  # detect features in views straight down, of oblique images
    attitudes: Path | None = None  # table of quaternions for them; without it estimated
    point: str | tuple[float, float] = "centre"  # of the last frame
    point_sigma_px: float = entry(1.0, not_negative=True)
    near: Path | None = None  # solution.json with the centre of the search on the map
    near_margin_m: float = entry(10e3, positive=True)  # of the search, beyond three sigmas of that solution
    shade: bool = False
    sun_azimuth_deg: float | None = None  # from north over east
    sun_elevation_deg: float | None = None
    epoch: Epochs | None = entry(None, moment=True)

    def __post_init__(self) -> None:
        GroundChoice.__post_init__(self)
        if self.base_map is None and not self.shade:
            raise InputError("base_map is missing; name a map image, or shade = true with a dem")
        if self.shade and self.dem is None:
            raise InputError("shade needs a dem")
        angles = [angle for angle in (self.sun_azimuth_deg, self.sun_elevation_deg) if angle is not None]
        if self.shade and len(angles) != (2 if self.epoch is None else 0):
            raise InputError("shade needs either epoch, or sun_azimuth_deg and sun_elevation_deg")
        if self.shade and self.base_map is not None:
            raise InputError("give either base_map or shade = true, not both")
        if self.attitudes is not None and not self.rectify:
            raise InputError("attitudes belongs to rectify = true")
        if self.base_map_epochs:
            epochs_from_strings(list(self.base_map_epochs), "UTC")
            if len(self.base_map_epochs) != len(self.base_maps):
                raise InputError(
                    f"base_map_epochs: expected {len(self.base_maps)}, one for each base map, got "
                    f"{len(self.base_map_epochs)}"
                )
            if self.epoch is None and self.sun_azimuth_deg is None:
                raise InputError("base_map_epochs needs the epoch of the images, or sun_azimuth_deg")
        if isinstance(self.point, str) and self.point != "centre":
            raise InputError(f'point: expected "centre" or [sample, line], got {self.point!r}')

    @property
    def base_maps(self) -> tuple[Path, ...]:
        """All base maps."""
        if self.base_map is None:
            return ()
        return self.base_map if isinstance(self.base_map, tuple) else (self.base_map,)


@dataclass(frozen=True, slots=True)
class CameraChoice:
    """Tables ``[stereo.left]`` and ``[stereo.right]`` and base of ``[camera]``; distortion is in OpenCV's order."""

    focal_length_mm: float = entry(positive=True)
    pixel_size_um: float = entry(positive=True)
    principal_point_px: tuple[float, float] | None = None
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check(self)

    def camera(self, shape: tuple[int, int]) -> Camera:
        """Return the camera for images of a shape (lines, samples); the default principal point is their middle."""
        from radioloc.imaging.cameras import Camera

        middle = (0.5 * (shape[1] - 1), 0.5 * (shape[0] - 1))
        point = self.principal_point_px or middle
        return Camera.of_pinhole(self.focal_length_mm, self.pixel_size_um, point, self.distortion)


@dataclass(frozen=True, slots=True)
class DescentCameraChoice(CameraChoice):
    """Table ``[camera]``: camera of a descent with the sigmas of its calibration."""

    focal_length_sigma_mm: float = entry(0.0, not_negative=True)
    k1_sigma: float = entry(0.0, not_negative=True)

    @property
    def has_sigmas(self) -> bool:
        """True if the calibration has an error."""
        return max(self.focal_length_sigma_mm, self.k1_sigma) > 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ImagePointChoice(GroundChoice):
    """Table ``[image_point]``: a point measured in one image."""

    model: Path  # ISD, or ISIS cube of LRO's NAC
    point: tuple[float, float]
    position_sigma_m: tuple[float, float, float] = entry(not_negative=True)  # east, north, up
    attitude_sigma_rad: tuple[float, float, float] = entry(not_negative=True)  # about the camera's axes
    point_sigma_px: float = entry(1.0, not_negative=True)

    def __post_init__(self) -> None:
        GroundChoice.__post_init__(self)
        if self.dem is None and self.height_m is None:
            raise InputError("the height of the ground is missing; give dem or height_m")


@dataclass(frozen=True, slots=True, kw_only=True)
class Landmark:
    """Table ``[[stereo.landmarks]]``: landmark on the map, with its distance or its pixels in both cameras."""

    name: str
    longitude_deg: float
    latitude_deg: float
    distance_m: float | None = entry(None, positive=True)  # horizontal, from the left camera
    distance_sigma_m: float | None = entry(None, positive=True)
    left_px: tuple[float, float] | None = None
    right_px: tuple[float, float] | None = None
    pitch_deg: float = 0.0  # of the left camera's axis above the horizon
    roll_deg: float = 0.0  # about that axis, clockwise in the view of the camera

    def __post_init__(self) -> None:
        check(self)
        values = (self.distance_m, self.distance_sigma_m, self.left_px, self.right_px)
        if [value is None for value in values] not in (
            [False, False, True, True],
            [True, True, False, False],
        ):
            raise InputError(
                f"landmark {self.name!r}: give either distance_m and distance_sigma_m, or left_px and right_px"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoChoice(GroundChoice):
    """Table ``[stereo]``: stereo images of landmarks from a rover or lander."""

    landmarks: tuple[Landmark, ...]
    landmark_sigma_m: float = entry(not_negative=True)
    map_name: str
    map_sigma_m: tuple[float, float] = entry(not_negative=True)
    left: CameraChoice | None = None
    right: CameraChoice | None = None
    baseline_m: tuple[float, float, float] | None = None  # right camera: right, down, ahead of the left
    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)  # from the left camera's axes to the right
    point_sigma_px: float = entry(0.3, positive=True)
    camera_in_body_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # left camera: ahead, right, down
    body_attitude_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)  # heading, pitch, roll

    def __post_init__(self) -> None:
        GroundChoice.__post_init__(self)
        if len(self.landmarks) < 4:
            raise InputError(f"expected four or more landmarks, got {len(self.landmarks)}")
        if len({landmark.name for landmark in self.landmarks}) < len(self.landmarks):
            raise InputError("two landmarks have the same name; rename one")
        if any(landmark.left_px is not None for landmark in self.landmarks):
            for name in ("left", "right", "baseline_m"):
                if getattr(self, name) is None:
                    raise InputError(f"{name} is missing; distances from pixels need it")
            for name in ("left", "right"):
                if getattr(self, name).principal_point_px is None:
                    raise InputError(
                        f"{name}.principal_point_px is missing: (sample, line) of the camera's axis"
                    )


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoFeature:
    """Table ``[[stereo_pair.features]]``: feature chosen in the left image."""

    name: str
    left_px: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoPairChoice:
    """Table ``[stereo_pair]``: two images of a rover or lander, for points in its axes."""

    left_image: Path
    right_image: Path
    left: CameraChoice
    right: CameraChoice
    baseline_m: tuple[float, float, float]  # right camera: right, down, ahead of the left
    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)  # from the left camera's axes to the right
    point_sigma_px: float = entry(0.3, positive=True)
    camera_in_body_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # left camera: ahead, right, down
    camera_attitude_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)  # heading, pitch, roll in the body
    nearest_m: float = entry(2.0, positive=True)  # closest ground in the images
    features: tuple[StereoFeature, ...] = ()

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlPoint:
    """Table ``[[base_map.ground_points]]``: point with coordinates, such as a laser reflector, in one of the images."""

    name: str
    image: str
    point: tuple[float, float]
    longitude_deg: float
    latitude_deg: float
    height_m: float
    sigma_m: float = entry(1.0, positive=True)  # of each coordinate
    point_sigma_px: float = entry(1.0, positive=True)

    def __post_init__(self) -> None:
        check(self)
        require_lunar_height(self.height_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseMapChoice:
    """Table ``[base_map]``: overlapping orbital images with support data, for a map of their orthophotos."""

    images: tuple[Path, ...]
    dem: Path
    resolution_m: float = entry(positive=True)
    position_sigma_m: tuple[float, float, float] = entry(not_negative=True)  # east, north, up
    attitude_sigma_rad: tuple[float, float, float] = entry(not_negative=True)  # about the camera's axes
    position_drift_m: tuple[float, float, float] = entry((0.0, 0.0, 0.0), not_negative=True)  # middle to end
    attitude_drift_rad: tuple[float, float, float] = entry((0.0, 0.0, 0.0), not_negative=True)
    models: tuple[Path, ...] = ()  # support data of the images in order; cubes contain theirs
    dem_sigma_m: float = entry(10.0, positive=True)
    projection: str = "IAU_2015:30110"
    ground_points: tuple[ControlPoint, ...] = ()

    def __post_init__(self) -> None:
        check(self)
        if self.models and len(self.models) != len(self.images):
            raise InputError(
                f"models: expected one for each of {len(self.images)} images, got {len(self.models)}"
            )
        names = [path.name for path in self.images]
        if len(set(names)) < len(names):
            raise InputError("images: two files have the same name; rename one")
        for point in self.ground_points:
            if point.image not in names:
                raise InputError(f"ground_points: expected an image of images, got {point.image!r}")


@dataclass(frozen=True, slots=True)
class ImageStudy:
    """Study that locates a lander on a map by its descent images."""

    images: ImageChoice
    camera: CameraChoice | None = None
    references: tuple[Reference, ...] = ()
    name: str = "images"
    path: Path | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.images.rectify and self.camera is None:
            raise InputError("rectify needs the table [camera]")


@dataclass(frozen=True, slots=True)
class PointStudy:
    """Study that locates a point in one image, a rover or lander by stereo images, or that makes a base map."""

    chosen: ImagePointChoice | StereoChoice | StereoPairChoice | BaseMapChoice
    references: tuple[Reference, ...] = ()
    name: str = "images"
    path: Path | None = field(default=None, repr=False)


TABLES: dict[str, type] = {
    "images": ImageChoice,
    "camera": DescentCameraChoice,
    "image_point": ImagePointChoice,
    "stereo": StereoChoice,
    "stereo.left": CameraChoice,
    "stereo.right": CameraChoice,
    "stereo.landmarks": Landmark,
    "stereo_pair": StereoPairChoice,
    "stereo_pair.left": CameraChoice,
    "stereo_pair.right": CameraChoice,
    "stereo_pair.features": StereoFeature,
    "base_map": BaseMapChoice,
    "base_map.ground_points": ControlPoint,
}
"""Records of the tables of a study of images, beside ``[reference]`` and ``[references.NAME]``."""


def read_image_study(path: str | Path) -> ImageStudy | PointStudy:
    """Read a study file with ``[images]``, ``[image_point]``, ``[stereo]``, ``[stereo_pair]`` or ``[base_map]``.

    Paths in it are relative to its folder.

    Raises
    ------
    InputError
        The file cannot be read, is not TOML, or has an unknown key or an unusable value; the message names it.

    Examples
    --------
    >>> import radioloc
    >>> study = radioloc.imaging.read_image_study("examples/images/descent.toml")
    >>> study.images.base_map.name
    'map.tif'
    """
    require_type("path", path, str, Path)
    content = toml_content(Path(path))
    path, file = source_of(path)
    hints = Hints({name: keys_of(record) for name, record in TABLES.items()})
    top = TomlTable(path, "", content, hints)
    kinds: dict[str, type] = {
        "images": ImageChoice,
        "image_point": ImagePointChoice,
        "stereo": StereoChoice,
        "stereo_pair": StereoPairChoice,
        "base_map": BaseMapChoice,
    }
    tables = {name: table for name in kinds if (table := top.table(name)) is not None}
    camera, reference, references = (top.table(name) for name in ("camera", "reference", "references"))
    top.finish()
    if len(tables) != 1:
        raise InputError(f"{path}: expected exactly one of {', '.join(f'[{name}]' for name in kinds)}")
    [(name, table)] = tables.items()
    if name != "images" and camera is not None:
        raise InputError(f"{path}: [camera] belongs to [images]")
    context = references_of(reference, references), path.stem, file
    if name == "images":
        return ImageStudy(
            table.read(ImageChoice), None if camera is None else camera.read(DescentCameraChoice), *context
        )
    return PointStudy(table.read(kinds[name]), *context)
