"""Textured planes with craters, and frames of them by a descending camera, with the truth."""

import cv2
import numpy as np


def ground(seed, size=1500, craters=1200, sun_deg=0.0):
    """Return grey values of a cratered plane under a Sun; one seed is one terrain."""
    rng = np.random.default_rng(seed)
    heights = np.zeros((size, size), np.float32)
    for octave in range(1, 9):
        cells = 2 ** (octave + 1)
        noise = rng.normal(0.0, 1.0, (cells, cells)).astype(np.float32)
        heights += cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC) * 60.0 / cells
    radii = np.minimum(3.0 * rng.pareto(1.8, craters) + 3.0, 90.0)
    for radius, (x, y) in zip(radii, rng.uniform(0, size, (craters, 2)), strict=True):
        reach = int(2.0 * radius) + 1
        x0, y0 = max(int(x) - reach, 0), max(int(y) - reach, 0)
        part = heights[y0 : int(y) + reach, x0 : int(x) + reach]
        line, sample = np.mgrid[y0 : y0 + part.shape[0], x0 : x0 + part.shape[1]]
        distance = np.hypot(sample - x, line - y) / radius
        part += (
            0.2 * radius * np.where(distance < 1.0, distance**2 - 0.8, 0.2 * np.exp(-3.0 * (distance - 1.0)))
        )
    down, right = np.gradient(heights)
    sun = np.radians(sun_deg)
    return np.clip(110.0 + 180.0 * (right * np.cos(sun) + down * np.sin(sun)), 0, 255).astype(np.uint8)


def frame_matrix(centre, pixel, turn_deg=0.0, tilt=(0.0, 0.0), shape=(400, 400)):
    """Return the matrix from pixels of a frame to those of the ground, by centre, pixel size, rotation and tilt."""
    turn = np.radians(turn_deg)
    lines, samples = shape
    to_middle = np.array([[1, 0, -(samples - 1) / 2], [0, 1, -(lines - 1) / 2], [0, 0, 1.0]])
    perspective = np.array([[1, 0, 0], [0, 1, 0], [tilt[0], tilt[1], 1.0]])
    similarity = np.array(
        [
            [pixel * np.cos(turn), -pixel * np.sin(turn), centre[0]],
            [pixel * np.sin(turn), pixel * np.cos(turn), centre[1]],
            [0, 0, 1.0],
        ]
    )
    return similarity @ perspective @ to_middle


def frame(scene, matrix, shape=(400, 400), noise=2.0, seed=0, spacecraft=False):
    """Return a frame of a scene, which is smoothed for larger pixels."""
    pixel = np.sqrt(abs(np.linalg.det(matrix[:2, :2])))
    smooth = cv2.GaussianBlur(scene, (0, 0), 0.4 * pixel) if pixel > 1.2 else scene
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    image = cv2.warpPerspective(smooth, matrix, shape[::-1], flags=flags, borderMode=cv2.BORDER_CONSTANT)
    image = image + np.random.default_rng(seed).normal(0.0, noise, shape)
    if spacecraft:
        rng = np.random.default_rng(99)
        part = cv2.resize(rng.uniform(0, 255, (20, 8)), (shape[1] // 6, shape[0] // 2))
        image[: part.shape[0], : part.shape[1]] = part
        cv2.line(image, (shape[1] // 2, 0), (shape[1] - 1, shape[0] // 2), 5.0, 25)
    return np.clip(image, 0, 255).astype(np.uint8)


def spacecraft_mask(shape=(400, 400)):
    """Return the mask of the spacecraft in :func:`frame`."""
    mask = np.zeros(shape, np.uint8)
    mask[: shape[0] // 2, : shape[1] // 6] = 1
    cv2.line(mask, (shape[1] // 2, 0), (shape[1] - 1, shape[0] // 2), 1, 25)
    return mask.astype(bool)
