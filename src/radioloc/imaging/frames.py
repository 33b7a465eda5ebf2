"""Images of a descent: one band in eight bits, and the mask of pixels that show the ground.

Pixels are (sample, line), to the right and down, and the centre of the first pixel is (0, 0). GDAL counts from its
corner, half a pixel away.

Parts of the spacecraft do not move from image to image. The mean of the images keeps their edges and loses those of
the moving ground: the ratio of the energy of the mean's gradient to the mean energy of the gradients is 1 on the
spacecraft, and about 1/n for n images of moving ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from radioloc.errors import FileFormatError, InputError, RadiolocError
from radioloc.lazy import optional
from radioloc.lunar.grey_images import Image, Mask, eight_bit, open_grey
from radioloc.lunar.map_grid import load_rasterio
from radioloc.text_files import require_file

# Decoded images: descent cameras have up to 25 million pixels, while files of a few kB unpack to 1000 million.
_MAX_IMAGE_PIXELS = 2**26
_MIN_GROUND_PART = 0.01  # of a mask; a smaller one ties no frames

_MIN_IMAGES = 4
_REDUCED_SAMPLES = 512  # of images in which the mask is found
_MIN_STATIC_RATIO = 0.6  # between 1 and, with four images, 0.25 and its scatter of 0.1
_SMOOTHING_PX, _NEIGHBOURHOOD_PX = 1.0, 3.0  # of the reduced images
_MARGIN_PX = 9  # of the reduced images, around the spacecraft
_MAX_STATIC_PART = 0.7
_MIN_CONTRAST = 0.02  # of the mean energy; the shadowed inside of the spacecraft has less


def load_opencv() -> ModuleType:
    """Import ``cv2`` on first use."""
    return optional("cv2", "images are matched with OpenCV, which is not installed;", "imaging")


def read_frame(path: str | Path) -> Image:
    """Read an image of one band (any format of GDAL) as eight bits, stretched between its 0.1 and 99.9 percentiles."""
    return eight_bit(_grey_bands(Path(path))[0])[0]


def read_mask(path: str | Path) -> Mask:
    """Read a mask: True for values above half of white, or for the brighter of two dark values."""
    path = Path(path)
    grey = _grey_bands(path)[0]
    values, valid = np.ma.getdata(grey), ~np.ma.getmaskarray(grey)
    valid &= np.isfinite(values)
    levels = np.unique(values[valid])
    white = np.iinfo(values.dtype).max if values.dtype.kind == "u" else max(levels, default=0)
    half = 0.5 * white
    if len(levels) == 2 and levels[1] <= half:
        half = levels[0]
    ground = valid & (values > half)
    if ground.mean() < _MIN_GROUND_PART:
        raise FileFormatError(
            path,
            f"expected a mask that is white where frames show the ground, got {100.0 * ground.mean():.2g} % of ground "
            f"(values from {min(levels, default=0)} to {max(levels, default=0)}); "
            "save the ground as 255 and the spacecraft as 0",
        )
    return ground


def _grey_bands(path: Path) -> Any:
    """Return the equal bands of an image, a masked array of shape (bands, lines, samples)."""
    rasterio = load_rasterio()
    from rasterio._err import CPLE_BaseError

    require_file(path)
    try:
        with open_grey(path) as dataset:
            if dataset.width * dataset.height > _MAX_IMAGE_PIXELS:
                raise FileFormatError(
                    path,
                    f"expected at most {_MAX_IMAGE_PIXELS / 1e6:.0f} million pixels, got {dataset.width} x "
                    f"{dataset.height}; cut the image, or reduce it with gdal_translate -outsize",
                )
            kinds = {np.dtype(kind).kind for kind in dataset.dtypes}
            colours = [k for k, colour in enumerate(dataset.colorinterp, 1) if colour.name != "alpha"]
            bands = (
                dataset.read(colours, masked=True) if 1 <= len(colours) <= 4 and kinds <= set("iuf") else None
            )
            description = f"{dataset.count} bands of type {dataset.dtypes[0]}"
    except RadiolocError:
        raise
    except (rasterio.errors.RasterioError, CPLE_BaseError, ValueError) as error:
        raise FileFormatError(path, f"GDAL cannot read all of the image: {error}") from error
    if bands is None or any((band != bands[0]).any() for band in bands[1:3]):
        raise FileFormatError(path, f"expected a grey image, got {description}; give one band")
    return bands


def find_mask(images: Sequence[Image]) -> Mask:
    """Find the pixels that show the ground, from four or more images of moving ground."""
    cv2 = load_opencv()
    if len(images) < _MIN_IMAGES or len({image.shape for image in images}) > 1:
        sizes = sorted({image.shape for image in images})
        raise InputError(
            f"expected {_MIN_IMAGES} or more images of one size to find a mask, got {len(images)} of sizes {sizes}; "
            "give more, or a mask"
        )
    lines, samples = images[0].shape
    reduction = max(1, round(samples / _REDUCED_SAMPLES))
    size = (samples // reduction, lines // reduction)
    mean_gradient = np.zeros((2, size[1], size[0]))
    mean_energy = np.zeros((size[1], size[0]))
    equalize = cv2.createCLAHE(3.0, (8, 8))
    for image in images:
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        smooth = cv2.GaussianBlur(equalize.apply(small), (0, 0), _SMOOTHING_PX).astype(np.float64)
        gradient = np.stack([cv2.Sobel(smooth, cv2.CV_64F, 1, 0), cv2.Sobel(smooth, cv2.CV_64F, 0, 1)])
        mean_gradient += gradient / len(images)
        mean_energy += (gradient**2).sum(axis=0) / len(images)
    static_energy, energy = (
        cv2.GaussianBlur(part, (0, 0), _NEIGHBOURHOOD_PX)
        for part in ((mean_gradient**2).sum(axis=0), mean_energy)
    )
    static = (static_energy > _MIN_STATIC_RATIO * energy) | (energy < _MIN_CONTRAST * mean_energy.mean())
    margin = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_MARGIN_PX, _MARGIN_PX))
    # Small gaps are filled, such as the black inside of an arm between its edges.
    static = cv2.morphologyEx(static.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    static = cv2.dilate(static, margin)
    if static.mean() > _MAX_STATIC_PART:
        raise InputError(
            f"{100.0 * static.mean():.0f} % of the pixels do not change between images: ground and spacecraft cannot "
            "be separated; give a mask, or images farther apart"
        )
    return np.asarray(cv2.resize(static, (samples, lines), interpolation=cv2.INTER_NEAREST) == 0)
