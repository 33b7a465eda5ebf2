"""Which pixels of a descent camera show the ground: what does not move from image to image is the spacecraft.

The mean of the images keeps the edges of what stands still and loses those of what moves. Where the gradient of the
mean has as much energy as the gradients have in the mean, the scene does not move: with n images of moving ground the
ratio is about 1/n, on the spacecraft it is one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.imaging.frames import Image, Mask, load_opencv

_FEWEST_IMAGES = 4
_SIZE = 512  # images are reduced to about this many samples
_STILL = 0.6  # between 1 and, with four images, 0.25 and its scatter of 0.1
_SMOOTHED, _NEIGHBOURHOOD = 1.0, 3.0  # pixels of the reduced images
_MARGIN = 9  # pixels of the reduced images that edges of the spacecraft reach beyond what is found
_LARGEST_PART = 0.7
_NO_CONTRAST = 0.02  # of the mean energy: shadowed inside of the spacecraft, where nothing shows motion


def find_mask(images: Sequence[Image]) -> Mask:
    """Find the pixels that show the ground, from images over which the ground moves.

    Parameters
    ----------
    images : sequence of numpy.ndarray of uint8, shape (lines, samples)
        Four or more, best spread over the descent.

    Returns
    -------
    numpy.ndarray of bool, shape (lines, samples)
        True where the ground is seen.

    Raises
    ------
    InputError
        Fewer than four images, of different sizes, or most of which do not move.

    Examples
    --------
    >>> import numpy as np
    >>> from radioloc.imaging import find_mask
    >>> rng = np.random.default_rng(1)
    >>> images = [rng.integers(0, 255, (120, 160)).astype(np.uint8) for _ in range(6)]
    >>> for image in images:
    ...     image[:, :40] = np.arange(40) % 7 * 20  # stands still
    >>> mask = find_mask(images)
    >>> bool(mask[:, :40].any()), bool(mask[20:-20, 60:].all())
    (False, True)
    """
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
    nearby = [_mean_around(energy, cv2) for energy in ((mean_gradient**2).sum(axis=0), mean_energy)]
    still = (nearby[0] > _STILL * nearby[1]) | (nearby[1] < _NO_CONTRAST * mean_energy.mean())
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


def _mean_around(values: NDArray[np.float64], cv2: object) -> NDArray[np.float64]:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), _NEIGHBOURHOOD))  # type: ignore[attr-defined]
