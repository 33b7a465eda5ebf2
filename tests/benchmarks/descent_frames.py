"""Descent of 240 frames of 2352 x 1728 pixels on a map of 10,000 x 10,000, for a benchmark.

Frames and map are drawn once, in some minutes, and kept in a folder of the system's for temporary files. To draw each
frame from the ground would take the better part of an hour: every sixth is, at half the size (features are sought in
reduced images), and those between are that one as the lower camera sees it, with noise and spacecraft of their own.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from procedural_descents import Descent
from procedural_ground import Ground

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.imaging import Camera, Sphere
from radioloc.imaging.ground_points import image_to_ground
from radioloc.imaging.shading import sun_direction
from radioloc.lunar import TangentPlane

FRAMES, EVERY, SHAPE = 240, 6, (1728, 2352)
MAP_PIXEL_M, MAP_PIXELS = 1.5, 10_000
SHIFT_M = (6.0, -4.0)
LEVEL_M = -2550.0

GROUND = Ground(TangentPlane(-51.9162, 43.0584), seed=5, level_m=LEVEL_M)
DESCENT = Descent(
    GROUND,
    Camera.of_pinhole(8.3, 4.33, [0.5 * (n - 1) for n in SHAPE[::-1]], [-0.05]),
    SHAPE,
    frames=FRAMES,
    altitudes_m=(9000.0, 4.0),
    seed=5,
)
HALF = replace(
    DESCENT,
    camera=Camera.of_pinhole(8.3, 8.66, [0.5 * (n // 2 - 1) for n in SHAPE[::-1]], [-0.05]),
    shape=(SHAPE[0] // 2, SHAPE[1] // 2),
    noise=0.0,
    spacecraft=False,
)
STUDY = f"""[images]
files = ["frames/*.png"]
base_map = "map.tif"
base_map_sigma_m = [5.0, 5.0]
height_m = {LEVEL_M}
[camera]
focal_length_mm = 8.3
pixel_size_um = 4.33
distortion = [-0.05, 0.0, 0.0, 0.0, 0.0]
"""


def draw(folder: Path) -> None:
    """Draw missing files; the study file comes last."""
    import cv2

    (folder / "frames").mkdir(parents=True, exist_ok=True)
    if not (folder / "map.tif").exists():
        GROUND.write_map(
            folder / "new.tif", MAP_PIXEL_M, MAP_PIXEL_M * MAP_PIXELS, sun_direction(85.0, 40.0), SHIFT_M, 1.0
        )
        (folder / "new.tif").rename(folder / "map.tif")
    parts, hidden = DESCENT._parts(), DESCENT.spacecraft_mask()
    for k in range(FRAMES):
        if k % EVERY == 0:
            high = HALF.frame(k)[0]
        shown = cv2.remap(high, *in_frame_above(k), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
        noisy = np.clip(shown + np.random.default_rng(k).normal(0.0, 2.0, SHAPE), 0, 255).astype(np.uint8)
        path = folder / "frames" / f"{k + 1:04d}.png"
        cv2.imwrite(str(path), np.where(hidden, parts, noisy), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    (folder / "study.toml").write_text(STUDY)


def in_frame_above(k: int) -> list:
    """Return samples and lines of pixels in the previous drawn frame, both of shape `SHAPE`."""
    import cv2

    nodes = np.stack(np.meshgrid(*(np.linspace(0.0, n - 1.0, 1 + n // 16) for n in SHAPE[::-1])), axis=-1)
    level_m = float(GROUND.heights_at_m(np.zeros((1, 2)), 1.0)[0])
    points_m = image_to_ground(DESCENT.model(k), nodes.reshape(-1, 2), Sphere(MEAN_LUNAR_RADIUS_M + level_m))
    projected = HALF.model(k - k % EVERY).project(points_m).pixels.reshape(nodes.shape)
    across, down = (
        np.linspace(0.0, n - 1.0, size) for n, size in zip(nodes.shape[1::-1], SHAPE[::-1], strict=True)
    )
    at = [axis.astype(np.float32) for axis in np.meshgrid(across, down)]
    return [cv2.remap(projected[..., c].astype(np.float32), *at, cv2.INTER_LINEAR) for c in (0, 1)]


def error_sigmas(content: dict) -> float:
    """Return the larger horizontal error of a solution in its sigmas, in which relief has its part."""
    place, sigma = content["position"]["me"], content["sigma"]
    truth, place = GROUND.plane.from_longitude_latitude(
        [DESCENT.lander()[:2], (place["longitude_deg"], place["latitude_deg"])]
    )
    return float(np.abs((place - truth) / [sigma["east_m"], sigma["north_m"]]).max())
