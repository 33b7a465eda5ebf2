"""Files of descent images and masks."""

import cv2
import numpy as np
import pytest
import rasterio
from terrain_maps import write_raster

from radioloc.errors import FileFormatError
from radioloc.imaging.frames import read_frame, read_mask

pytestmark = pytest.mark.filterwarnings(
    "ignore::rasterio.errors.NotGeoreferencedWarning"
)  # of files' writing
GREY = np.random.default_rng(1).integers(0, 256, (60, 80)).astype(np.uint8)


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.jpg"])
def test_eight_bits_are_read_unchanged(tmp_path, name):
    cv2.imwrite(str(tmp_path / name), np.full((60, 80), 77, np.uint8) if name == "a.jpg" else GREY)
    image = read_frame(tmp_path / name)
    assert image.dtype == np.uint8
    assert np.array_equal(image, np.full((60, 80), 77) if name == "a.jpg" else GREY)


def test_deeper_images_are_stretched(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), GREY.astype(np.uint16) * 16 + 1000)
    assert np.abs(read_frame(tmp_path / "a.png").astype(int) - GREY).max() <= 1


def test_three_equal_bands_are_grey(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.repeat(GREY[..., np.newaxis], 3, axis=2))
    assert np.array_equal(read_frame(tmp_path / "a.png"), GREY)
    cv2.imwrite(str(tmp_path / "b.png"), np.stack([GREY, GREY, 255 - GREY], axis=2))
    with pytest.raises(FileFormatError, match="got 3 bands"):
        read_frame(tmp_path / "b.png")


def test_calibrated_cube_of_floats_is_stretched(tmp_path):
    values = GREY.astype(np.float32) / 1e4
    values[:3] = np.float32(-3.40282265508890445e38)  # ISIS' null
    image = read_frame(write_raster(tmp_path / "a.cub", values, driver="ISIS3"))
    assert (image[:3] == 0).all()
    assert np.abs(image[3:].astype(int) - GREY[3:]).max() <= 1


PDS3 = """PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = 80
FILE_RECORDS = 60
^IMAGE = "A.IMG"
OBJECT = IMAGE
  LINES = 60
  LINE_SAMPLES = 80
  SAMPLE_TYPE = UNSIGNED_INTEGER
  SAMPLE_BITS = 8
END_OBJECT = IMAGE
END
"""


def test_pds3_frame_is_read_by_its_label(tmp_path):
    (tmp_path / "A.LBL").write_text(PDS3.replace("\n", "\r\n"))
    (tmp_path / "A.IMG").write_bytes(GREY.tobytes())
    assert np.array_equal(read_frame(tmp_path / "A.LBL"), GREY)
    (tmp_path / "A.IMG").write_bytes(GREY.tobytes()[:2400])
    with pytest.raises(FileFormatError, match=r"A\.LBL"):
        read_frame(tmp_path / "A.LBL")


STEPS = np.repeat(np.arange(0, 256, 85, dtype=np.uint8), 15)[:, np.newaxis] * np.ones(
    80, np.uint8
)  # 4 grey values
BINARY = np.where(STEPS > 127, 255, 0).astype(np.uint8)


def write_palette(path, colours, indices):
    write_raster(path, indices, photometric="PALETTE")
    with rasterio.open(path, "r+") as dataset:
        dataset.write_colormap(1, colours)
    return path


def coded_files(folder):
    """Write files that viewers show as grey steps or as black and white, with different codes."""
    reversed_grey = {"photometric": "MINISWHITE"}
    steps = {0: (170, 170, 170), 1: (0, 0, 0), 2: (255, 255, 255), 3: (85, 85, 85)}
    index = np.choose(STEPS // 85, [1, 3, 0, 2]).astype(np.uint8)
    yield write_raster(folder / "2 bits.tif", STEPS // 85, nbits=2), STEPS
    yield write_raster(folder / "4 bits.tif", STEPS // 17, nbits=4), STEPS
    yield write_raster(folder / "white is 0.tif", 255 - STEPS, **reversed_grey), STEPS
    yield write_raster(folder / "white is 0, 2 bits.tif", 3 - STEPS // 85, nbits=2, **reversed_grey), STEPS
    yield (
        write_raster(folder / "white is 0, deep.tif", 65535 - STEPS * np.uint16(257), **reversed_grey),
        STEPS,
    )
    yield write_palette(folder / "palette.tif", steps, index), STEPS
    yield write_raster(folder / "1 bit.tif", BINARY // 255, nbits=1), BINARY
    yield write_raster(folder / "white is 0, 1 bit.tif", 1 - BINARY // 255, nbits=1, **reversed_grey), BINARY
    yield (
        write_raster(folder / "fax.tif", 1 - BINARY // 255, nbits=1, compress="CCITTFAX4", **reversed_grey),
        BINARY,
    )
    cv2.imwrite(str(folder / "1 bit.png"), BINARY, [cv2.IMWRITE_PNG_BILEVEL, 1])
    yield folder / "1 bit.png", BINARY


def test_bits_photometric_interpretation_and_palette_are_applied(tmp_path):
    for path, grey in coded_files(tmp_path):
        assert np.array_equal(read_frame(path), grey), path.name
        assert np.array_equal(read_mask(path), grey > 127), path.name


@pytest.mark.parametrize(
    "values", [BINARY // 255, (BINARY // 255).astype(np.uint16), BINARY * np.uint16(257)]
)
def test_brighter_of_two_values_of_a_mask_is_ground(tmp_path, values):
    assert np.array_equal(read_mask(write_raster(tmp_path / "a.tif", values)), BINARY > 0)


@pytest.mark.parametrize("value", [0, 3])
def test_mask_without_ground_is_refused(tmp_path, value):
    values = np.full((60, 80), value, np.uint8)
    values[0, :3] = 1, 2, 255
    with pytest.raises(FileFormatError, match=r"dark\.tif: expected a mask"):
        read_mask(write_raster(tmp_path / "dark.tif", values))


@pytest.mark.parametrize("read", [read_frame, read_mask])
def test_files_of_too_many_pixels_are_refused(tmp_path, read):
    size = {"width": 32000, "height": 32000, "count": 1, "dtype": "uint8"}
    with rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", sparse_ok=True, tiled=True, **size):
        pass
    with pytest.raises(FileFormatError, match="got 32000 x 32000"):
        read(tmp_path / "a.tif")
