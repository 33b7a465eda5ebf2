"""Images of a descent: one band, read whole, in eight bits; and which of their pixels show the ground.

Pixels are (sample, line), to the right and down, and the centre of the first one is (0, 0). GDAL counts from the
corner of the first pixel, half a pixel away.

What does not move from image to image is the spacecraft. The mean of the images keeps the edges of what stands still
and loses those of what moves: where the gradient of the mean has as much energy as the gradients have in the mean, the
scene does not move. With n images of moving ground the ratio is about 1/n, on the spacecraft it is one.
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
from radioloc.lunar.map_files import open_dataset, refuse_cut_map
from radioloc.lunar.map_grid import load_rasterio
from radioloc.text_files import require_file

MAX_IMAGE_PIXELS = 2**26
"""Bound of decoded images: descent cameras have up to 25 million, files of a few kB unpack to 1000 million."""

MIN_GROUND_PART = 0.01
"""Least part of a mask that is ground: less ties no frame to another."""

_FEWEST_IMAGES = 4
_SIZE = 512  # images are reduced to about this many samples
_STILL = 0.6  # between 1 and, with four images, 0.25 and its scatter of 0.1
_SMOOTHED, _NEIGHBOURHOOD = 1.0, 3.0  # pixels of the reduced images
_MARGIN = 9  # pixels of the reduced images that edges of the spacecraft reach beyond what is found
_LARGEST_PART = 0.7
_NO_CONTRAST = 0.02  # of the mean energy: shadowed inside of the spacecraft, where nothing shows motion


def load_opencv() -> ModuleType:
    """The module ``cv2``, imported when the first image is worked on."""
    return optional("cv2", "images are matched with OpenCV, which is not installed;", "imaging")


def read_frame(path: str | Path) -> Image:
    """Read an image of one band (any format of GDAL) as eight bits, stretched but for 0.1 % at each end."""
    bands = _grey_bands(Path(path))
    return eight_bit(bands[0])[0]


def read_mask(path: str | Path) -> Mask:
    """Read a mask: True where an image is brighter than half of white, or is the brighter of its two dark values."""
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
    if ground.mean() < MIN_GROUND_PART:
        raise FileFormatError(
            path,
            f"expected a mask that is white where frames show the ground, got {100.0 * ground.mean():.2g} % of ground "
            f"(values from {min(levels, default=0)} to {max(levels, default=0)}); "
            "save the ground as 255 and the spacecraft as 0",
        )
    return ground


def _grey_bands(path: Path) -> Any:
    """Equal bands of an image, a masked array of shape (bands, lines, samples)."""
    rasterio = load_rasterio()
    from rasterio._err import CPLE_BaseError

    require_file(path)
    try:
        with open_dataset(path) as dataset:
            refuse_cut_map(path, dataset)
        with open_grey(path) as dataset:
            if dataset.width * dataset.height > MAX_IMAGE_PIXELS:
                raise FileFormatError(
                    path,
                    f"expected at most {MAX_IMAGE_PIXELS / 1e6:.0f} million pixels, got {dataset.width} x "
                    f"{dataset.height}; cut the image, or reduce it with gdal_translate -outsize",
                )
            kinds = {np.dtype(kind).kind for kind in dataset.dtypes}
            colours = [k for k, colour in enumerate(dataset.colorinterp, 1) if colour.name != "alpha"]
            bands = (
                dataset.read(colours, masked=True) if 1 <= len(colours) <= 4 and kinds <= set("iuf") else None
            )
            described = f"{dataset.count} bands of type {dataset.dtypes[0]}"
    except RadiolocError:
        raise
    except (rasterio.errors.RasterioError, CPLE_BaseError, ValueError) as error:
        raise FileFormatError(path, f"GDAL does not read it whole as an image: {error}") from error
    if bands is None or any((band != bands[0]).any() for band in bands[1:3]):
        raise FileFormatError(path, f"{described} are no grey image; give one band")
    return bands


def find_mask(images: Sequence[Image]) -> Mask:
    """Find the pixels that show the ground, from four images or more over which the ground moves."""
    cv2 = load_opencv()
    if len(images) < _FEWEST_IMAGES or len({image.shape for image in images}) > 1:
        sizes = sorted({image.shape for image in images})
        raise InputError(
            f"a mask was to be found from {len(images)} images of sizes {sizes}; give four or more of one size, "
            "or a mask"
        )
    lines, samples = images[0].shape
    reduction = max(1, round(samples / _SIZE))
    size = (samples // reduction, lines // reduction)
    mean_gradient = np.zeros((2, size[1], size[0]))
    mean_energy = np.zeros((size[1], size[0]))
    equalize = cv2.createCLAHE(3.0, (8, 8))
    for image in images:
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        smooth = cv2.GaussianBlur(equalize.apply(small), (0, 0), _SMOOTHED).astype(np.float64)
        gradient = np.stack([cv2.Sobel(smooth, cv2.CV_64F, 1, 0), cv2.Sobel(smooth, cv2.CV_64F, 0, 1)])
        mean_gradient += gradient / len(images)
        mean_energy += (gradient**2).sum(axis=0) / len(images)
    of_mean, of_images = (
        cv2.GaussianBlur(energy, (0, 0), _NEIGHBOURHOOD)
        for energy in ((mean_gradient**2).sum(axis=0), mean_energy)
    )
    still = (of_mean > _STILL * of_images) | (of_images < _NO_CONTRAST * mean_energy.mean())
    margin = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_MARGIN, _MARGIN))
    # Small gaps are filled: the black inside of an arm between its edges.
    still = cv2.morphologyEx(still.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    still = cv2.dilate(still, margin)
    if still.mean() > _LARGEST_PART:
        raise InputError(
            f"{100.0 * still.mean():.0f} % of the images do not move, so the spacecraft cannot be told from the "
            "ground; give a mask, or images farther apart"
        )
    return np.asarray(cv2.resize(still, (samples, lines), interpolation=cv2.INTER_NEAREST) == 0)
