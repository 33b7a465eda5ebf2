"""Real images of descents, which are not part of the project; their tests are skipped without them."""

import cv2
import pytest
from paths import LARGE_DATA

FOLDER = LARGE_DATA / "images"
NAMES = ("1801", "1831", "1861", "1891")
BOX = {"1801": (82.0, 83.0), "1831": (79.0, 145.0), "1861": (78.0, 207.5), "1891": (68.5, 258.0)}
"""Centre of the box drawn about one crater, within some 2 pixels (sample, line)."""

needs_images = pytest.mark.skipif(
    not FOLDER.is_dir(), reason=f"the real images are not in {FOLDER}; they may not be passed on"
)


def image(name):
    return cv2.imread(str(FOLDER / name), cv2.IMREAD_GRAYSCALE)


def change3():
    return {name: image(f"change3_{name}.png") for name in NAMES}
