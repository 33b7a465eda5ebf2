"""Images of a descent as files: one band, read whole, in eight bits.

Pixels are (sample, line), to the right and down, and the centre of the first one is (0, 0). GDAL counts from the
corner of the first pixel, half a pixel away.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError
from radioloc.extras import optional
from radioloc.lunar.map_files import open_dataset, refuse_cut_map
from radioloc.lunar.map_grid import load_rasterio
from radioloc.text_files import require_file

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_STRETCHED_PERCENTILES = (0.1, 99.9)  # beyond them are glints, dead pixels and what is not lit


def load_opencv() -> ModuleType:
    """The module ``cv2``, imported when the first image is worked on."""
    return optional("cv2", "images are matched with OpenCV, which is not installed;", "imaging")


def read_frame(path: str | Path) -> Image:
    """Read an image of one band (PNG, TIFF, PDS3 or PDS4 by its label, any format of GDAL) as eight bits.

    Returns
    -------
    numpy.ndarray, shape (lines, samples)
        Grey values; deeper ones are stretched, 0.1 % at each end set aside.

    Raises
    ------
    FileFormatError
        No such file, a part of one, or none that GDAL reads as one band of numbers (bands of one colour image that
        are equal count as one).

    Examples
    --------
    >>> import tempfile, pathlib, cv2, numpy as np
    >>> from radioloc.imaging import read_frame
    >>> path = pathlib.Path(tempfile.mkdtemp(), "frame.png")
    >>> cv2.imwrite(str(path), np.arange(12, dtype=np.uint8).reshape(3, 4))
    True
    >>> read_frame(path)[2].tolist()
    [8, 9, 10, 11]
    """
    rasterio = load_rasterio()
    from rasterio._err import CPLE_BaseError

    path = Path(path)
    require_file(path)
    try:
        with open_dataset(path) as dataset:
            refuse_cut_map(path, dataset)
            bands = dataset.read(masked=True)
    except (rasterio.errors.RasterioError, CPLE_BaseError, ValueError) as error:
        raise FileFormatError(path, f"GDAL does not read it whole as an image: {error}") from error
    if bands.dtype.kind not in "iuf" or any((band != bands[0]).any() for band in bands[1:3]):
        raise FileFormatError(
            path, f"{len(bands)} bands of type {bands.dtype} are no grey image; give one band"
        )
    return eight_bit(bands[0])[0]


def eight_bit(values: Any) -> tuple[Image, Mask]:
    """Numbers (a masked array) as eight bits, and which of them are there; what is not is black.

    Examples
    --------
    >>> image, valid = eight_bit(np.ma.masked_less([[-1.0, 0.0, 0.6, 1.0]], 0.0))
    >>> image.tolist(), valid.tolist()
    ([[0, 0, 153, 255]], [[False, True, True, True]])
    """
    valid = ~np.ma.getmaskarray(values)
    numbers = np.ma.getdata(values)
    if numbers.dtype == np.uint8:
        return np.where(valid, numbers, np.uint8(0)), valid
    valid &= np.isfinite(numbers)
    if not valid.any():
        return np.zeros(numbers.shape, np.uint8), valid
    low, high = np.percentile(numbers[valid], _STRETCHED_PERCENTILES)
    scale = 255.0 / (high - low) if high > low else 0.0
    grey = np.clip((np.where(valid, numbers, low) - low) * scale, 0.0, 255.0)
    return np.rint(grey).astype(np.uint8), valid
