"""Frames of a descent to the Moon, with the truth."""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from procedural_ground import Ground, as_bytes

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.imaging import Camera, FrameModel
from radioloc.imaging.frames import load_opencv
from radioloc.imaging.orientation import ConstantOrientation, rotation_matrices
from radioloc.imaging.shading import sun_direction

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """Camera that descends to the point of contact of the plane of the ground."""

    ground: Ground
    camera: Camera
    shape: tuple[int, int]  # lines and samples
    frames: int = 24  # from the highest to the lowest, at altitudes in geometric progression
    altitudes_m: tuple[float, float] = (9000.0, 4.0)  # of the first and of the last frame
    # Above this altitude the camera looks ahead by this angle from straight down; the turn to straight down ends at
    # three fifths of it.
    oblique_above_m: float = 3000.0
    tilt_deg: float = 30.0
    heading_deg: float = 280.0  # direction of flight, from north over east
    sun_azimuth_deg: float = 100.0
    sun_elevation_deg: float = 35.0
    blur_px: float = 0.7  # standard deviation of the optics' blur
    noise: float = 2.0  # standard deviation of the values, of 255
    spacecraft: bool = True  # whether parts of it are in view
    seed: int = 0  # of attitudes, drift and noise
    _drawn: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # Each attitude and drift is two waves over the descent.
        drawn = np.random.default_rng(self.seed).normal(size=(5, 2, 2))
        object.__setattr__(self, "_drawn", drawn)

    @property
    def sun(self) -> Floats:
        """Unit vector to the Sun, east, north, up."""
        return sun_direction(self.sun_azimuth_deg, self.sun_elevation_deg)

    def altitude_m(self, k: int) -> float:
        """Return the height of the camera above the ground at the point of contact, m."""
        first, last = self.altitudes_m
        return float(first * (last / first) ** (k / (self.frames - 1)))

    def model(self, k: int) -> FrameModel:
        """Return the camera and pose of a frame, mean-Earth axes."""
        altitude = self.altitude_m(k)
        part = k / (self.frames - 1)
        waves = np.array([math.sin(2.0 * math.pi * part), math.cos(3.0 * math.pi * part)])
        roll, pitch, yaw, east, north = (self._drawn[:, 0] @ waves) + 0.3 * (self._drawn[:, 1] @ waves)
        turned = np.clip((altitude / self.oblique_above_m - 0.6) / 0.4, 0.0, 1.0)
        tilt = math.radians(self.tilt_deg) * float(turned**2 * (3.0 - 2.0 * turned)) + math.radians(
            0.5 * pitch
        )
        heading = math.radians(self.heading_deg)
        ahead = np.array([math.sin(heading), math.cos(heading), 0.0])
        level = float(self.ground.heights_at_m(np.zeros((1, 2)), self.altitudes_m[1] * 1e-3)[0])
        # The axis of the camera passes near the landing site; the lateral drift is proportional to the altitude.
        place = -0.85 * altitude * math.tan(tilt) * ahead + 0.03 * altitude * np.array([east, north, 0.0])
        place[2] = MEAN_LUNAR_RADIUS_M + level + altitude
        # Camera axes: x to the right, y down in the image, z ahead; up in the image is the direction of flight.
        forward = math.cos(tilt) * np.array([0.0, 0.0, -1.0]) + math.sin(tilt) * ahead
        right = np.cross(forward, -ahead)
        right = right / np.linalg.norm(right)
        rotation = np.column_stack([-right, np.cross(forward, -right), forward])
        yawed, rolled = rotation_matrices(np.radians([[0.0, 0.0, 4.0 * yaw], [0.0, 0.5 * roll, 0.0]]))
        rotation = rotation @ yawed @ rolled
        axes = self.ground.plane.axes()
        return FrameModel(self.camera, ConstantOrientation(axes.T @ place, axes.T @ rotation), self.shape)

    def frame(self, k: int) -> tuple[Image, Floats]:
        """Return a frame in eight bits, and the ground of its pixels: east, north, height, m."""
        cv2 = load_opencv()
        brightness, points = self.ground.seen_by(self.model(k), self.sun)
        if self.blur_px > 0.0:
            brightness = cv2.GaussianBlur(brightness, (0, 0), self.blur_px)
        image = as_bytes(brightness, self.sun, self.noise, self.seed * 1009 + k)
        if self.spacecraft:
            image = np.where(self.spacecraft_mask(), self._parts(), image)
        return image, points

    def spacecraft_mask(self) -> NDArray[np.bool_]:
        """Return the mask of a footpad and a strut, shape (lines, samples)."""
        lines, samples = self.shape
        line, sample = np.mgrid[:lines, :samples] / (lines - 1.0)
        width = (samples - 1.0) / (lines - 1.0)
        footpad = (sample / 0.22) ** 2 + ((line - 1.0) / 0.3) ** 2 < 1.0
        strut = np.abs(line - 0.9 * (sample - (width - 0.16))) < 0.025
        return np.asarray(footpad | (strut & (sample > width - 0.16)))

    def _parts(self) -> Image:
        """Return grey values of the spacecraft, equal in all frames."""
        cv2 = load_opencv()
        texture = np.random.default_rng(5).uniform(20.0, 235.0, (24, 24))
        return np.asarray(cv2.resize(texture, self.shape[::-1], interpolation=cv2.INTER_NEAREST), np.uint8)

    def lander(self) -> tuple[float, float, float]:
        """Return true longitude and latitude, deg, and height, m, of the ground in the middle of the last frame."""
        lines, samples = self.shape
        middle = (0.5 * (samples - 1), 0.5 * (lines - 1))
        east, north, height = self.ground.point_seen(self.model(self.frames - 1), middle)
        longitude, latitude = self.ground.plane.to_longitude_latitude([[east, north]])[0]
        return float(longitude), float(latitude), float(height)

    def write(self, folder: str | Path) -> Iterator[Path]:
        """Write ``frames/0001.png``, ..., ``mask.png`` and ``truth.json`` (place, poses), one file at a time."""
        cv2 = load_opencv()
        folder = Path(folder)
        (folder / "frames").mkdir(parents=True, exist_ok=True)
        truth = []
        for k in range(self.frames):
            path = folder / "frames" / f"{k + 1:04d}.png"
            cv2.imwrite(str(path), self.frame(k)[0])
            pose = self.model(k).orientation
            truth.append(
                {
                    "file": path.name,
                    "altitude_m": self.altitude_m(k),
                    "position_me_m": pose.position_m.tolist(),
                    "rot_camera_to_moon": pose.rot_camera_to_moon.tolist(),
                }
            )
            yield path
        cv2.imwrite(str(folder / "mask.png"), np.where(self.spacecraft_mask(), 0, 255).astype(np.uint8))
        yield folder / "mask.png"
        place = dict(zip(("longitude_deg", "latitude_deg", "height_m"), self.lander(), strict=True))
        (folder / "truth.json").write_text(json.dumps({"lander": place, "frames": truth}, indent=1) + "\n")
        yield folder / "truth.json"
