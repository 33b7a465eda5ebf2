"""A study of descent images: its tables ``[images]`` and ``[camera]``, and reading them from a file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from radioloc.errors import InputError
from radioloc.imaging import Camera
from radioloc.studies.schema import Hints, TomlTable, check, entry, keys_of
from radioloc.studies.study import Reference
from radioloc.studies.study_file import references_of, toml_content
from radioloc.time import Epochs

DETECTORS = ("sift", "orb")
TABLES = ("images", "camera", "reference", "references")


@dataclass(frozen=True, slots=True)
class ImageChoice:
    """The images, and what they are laid over.

    Parameters
    ----------
    files : tuple of Path
        Frames in order of time, the highest first.
    base_map_sigma_m : tuple of float
        How well the map is tied to the Moon's axes, east and north, m; the same error for all its points.
    base_map : Path, optional
        A map image with a lunar projection. With ``shade`` the elevation model takes its place.
    dem : Path, optional
        An elevation model: the height of the point. Without it and ``height_m`` there is no height.
    dem_sigma_m : float
        How well its heights are known, m.
    height_m, height_sigma_m : float, optional
        The height above the 1737.4 km sphere and its sigma, m, in place of a model.
    mask : Path, optional
        An image of the frames' size, white where they show the ground. What does not move from frame to frame is found
        and left out where none is given.
    point : "centre" or tuple of float
        The lander in the last image: its middle, or (sample, line).
    point_sigma_px : float
        How well that is known, pixels of the last image.
    near : Path, optional
        A ``solution.json`` about whose position the map is searched.
    near_margin_m : float
        How far beyond three sigmas of that, m: half the ground that the highest image covers, or more.
    shade : bool
        Whether the base is the elevation model shaded at the Sun's direction.
    sun_azimuth_deg, sun_elevation_deg : float, optional
        That direction, from north over east and above the horizon.
    epoch : Epochs, optional
        In their place when the images were taken, UTC: the Sun's direction then is computed.
    detector : {"sift", "orb"}
        What finds features.
    """

    files: tuple[Path, ...]
    base_map_sigma_m: tuple[float, float] = entry(not_negative=True)
    base_map: Path | None = None
    dem: Path | None = None
    dem_sigma_m: float = entry(10.0, not_negative=True)
    height_m: float | None = None
    height_sigma_m: float = entry(10.0, not_negative=True)
    mask: Path | None = None
    point: str | tuple[float, float] = "centre"
    point_sigma_px: float = entry(1.0, not_negative=True)
    near: Path | None = None
    near_margin_m: float = entry(10e3, positive=True)
    shade: bool = False
    sun_azimuth_deg: float | None = None
    sun_elevation_deg: float | None = None
    epoch: Epochs | None = entry(None, moment=True)
    detector: str = entry("sift", choices=DETECTORS)

    def __post_init__(self) -> None:
        check(self)
        if self.base_map is None and not self.shade:
            raise InputError("base_map is missing; name a map image, or shade = true with a dem")
        if self.shade and self.dem is None:
            raise InputError("shade needs a dem, which is shaded")
        angles = [angle for angle in (self.sun_azimuth_deg, self.sun_elevation_deg) if angle is not None]
        if self.shade and len(angles) != (2 if self.epoch is None else 0):
            raise InputError(
                "shade needs either epoch, or sun_azimuth_deg and sun_elevation_deg, where the Sun stood"
            )
        if self.shade and self.base_map is not None:
            raise InputError("give either base_map or shade = true, not both")
        if self.dem is not None and self.height_m is not None:
            raise InputError("give either dem or height_m, not both")
        if isinstance(self.point, str) and self.point != "centre":
            raise InputError(f'point must be "centre" or [sample, line], not {self.point!r}')


@dataclass(frozen=True, slots=True)
class CameraChoice:
    """The camera, where it is known: distortion is taken off, and altitudes follow from the size of pixels."""

    focal_length_mm: float = entry(positive=True)
    pixel_size_um: float = entry(positive=True)
    principal_point_px: tuple[float, float] | None = None
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check(self)

    def camera(self, shape: tuple[int, int]) -> Camera:
        """The camera of images of so many lines and samples; its axis is in their middle where nothing else is said."""
        middle = (0.5 * (shape[1] - 1), 0.5 * (shape[0] - 1))
        point = self.principal_point_px or middle
        return Camera.of_pinhole(self.focal_length_mm, self.pixel_size_um, point, self.distortion)


@dataclass(frozen=True, slots=True)
class ImageStudy:
    """Where a lander stands on a map, by its descent images.

    Parameters
    ----------
    images : ImageChoice
    camera : CameraChoice, optional
    references : tuple of Reference
        Known positions to compare with.
    name : str
    path : Path, optional
        The file that it is from.
    """

    images: ImageChoice
    camera: CameraChoice | None = None
    references: tuple[Reference, ...] = ()
    name: str = "images"
    path: Path | None = field(default=None, repr=False)


def read_image_study(path: str | Path) -> ImageStudy:
    """Read a study file with ``[images]``; paths in it are relative to its folder.

    Raises
    ------
    InputError
        The file cannot be read, is not TOML, or has an unknown key or an unusable value; the message names it.

    Examples
    --------
    >>> import radioloc
    >>> study = radioloc.studies.read_image_study("examples/images/descent.toml")
    >>> study.images.base_map.name
    'map.tif'
    """
    path = Path(path)
    hints = Hints({"images": keys_of(ImageChoice), "camera": keys_of(CameraChoice)})
    top = TomlTable(path, "", toml_content(path), hints)
    tables = {name: top.table(name) for name in TABLES}
    top.finish()
    if tables["images"] is None:
        raise InputError(f"{path}: [images] is missing; it names the frames and the map")
    camera = tables["camera"]
    return ImageStudy(
        tables["images"].read(ImageChoice),
        None if camera is None else camera.read(CameraChoice),
        references_of(tables["reference"], tables["references"]),
        path.stem,
        path,
    )
