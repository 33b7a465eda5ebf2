"""Masks of the spacecraft, which does not move in the images."""

import numpy as np
import pytest
from descent_images import BOX, change3, needs_images
from scenes import frame, frame_matrix, ground, spacecraft_mask

from radioloc.errors import InputError
from radioloc.imaging.frames import find_mask


def descent(step, count=8, spacecraft=True):
    scene = ground(1)
    times = [step * k for k in range(count)]
    matrices = (frame_matrix((700 + 8 * t, 700 - 5 * t), 2.5 * 0.85**t, 3 * t) for t in times)
    return [frame(scene, m, seed=k, spacecraft=spacecraft) for k, m in enumerate(matrices)]


@pytest.mark.study
def test_spacecraft_is_masked_and_the_ground_is_not():
    mask = find_mask(descent(1))
    assert not mask[spacecraft_mask()].any()
    assert mask[~spacecraft_mask()].mean() > 0.9  # without the margin
    assert find_mask(descent(1, spacecraft=False)).mean() > 0.98


@needs_images
def test_mask_of_change3():
    """Legs, thruster and arm are masked, and the tracked crater is not."""
    mask = find_mask(list(change3().values()))
    for sample, line in ((15, 90), (15, 230), (250, 80), (330, 180), (340, 240), (15, 335)):
        assert not mask[line, sample]
    for sample, line in BOX.values():
        assert mask[round(line), round(sample)]
    assert 0.7 < mask.mean() < 0.85


@pytest.mark.study
def test_still_or_too_few_images_are_refused():
    with pytest.raises(InputError, match="do not change"):
        find_mask(descent(0))
    with pytest.raises(InputError, match="expected 4 or more images"):
        find_mask(descent(1)[:3])
    with pytest.raises(InputError, match="expected 4 or more images"):
        find_mask([*descent(1), np.zeros((10, 10), np.uint8)])
