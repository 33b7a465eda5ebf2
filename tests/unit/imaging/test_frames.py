"""Images of a descent as files."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import rasterio

from radioloc.errors import FileFormatError, InputError
from radioloc.imaging.frames import read_frame

pytestmark = pytest.mark.filterwarnings(
    "ignore::rasterio.errors.NotGeoreferencedWarning"
)  # of files' writing
GREY = np.random.default_rng(1).integers(0, 256, (60, 80)).astype(np.uint8)


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.jpg"])
def test_eight_bits_are_read_as_they_stand(tmp_path, name):
    cv2.imwrite(str(tmp_path / name), np.full((60, 80), 77, np.uint8) if name == "a.jpg" else GREY)
    image = read_frame(tmp_path / name)
    assert image.dtype == np.uint8
    assert np.array_equal(image, np.full((60, 80), 77) if name == "a.jpg" else GREY)


def test_deeper_images_are_stretched(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), GREY.astype(np.uint16) * 16 + 1000)
    assert np.abs(read_frame(tmp_path / "a.png").astype(int) - GREY).max() <= 1


def test_an_image_of_three_equal_bands_is_grey(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.repeat(GREY[..., np.newaxis], 3, axis=2))
    assert np.array_equal(read_frame(tmp_path / "a.png"), GREY)
    cv2.imwrite(str(tmp_path / "b.png"), np.stack([GREY, GREY, 255 - GREY], axis=2))
    with pytest.raises(FileFormatError, match="3 bands of type uint8 are no grey image"):
        read_frame(tmp_path / "b.png")


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.jpg"])
@pytest.mark.parametrize("kept", [0.9, 0.5, 0.1])
def test_cut_files_are_refused(tmp_path, name, kept):
    cv2.imwrite(str(tmp_path / name), GREY)
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: int(kept * len(whole))])
    with pytest.raises(FileFormatError, match=name):
        read_frame(tmp_path / name)


def test_files_refused(tmp_path):
    (tmp_path / "a.png").write_text("no image")
    with pytest.raises(FileFormatError, match="GDAL does not read it whole as an image"):
        read_frame(tmp_path / "a.png")
    with pytest.raises(InputError, match="there is no such file"):
        read_frame(tmp_path / "b.png")


def test_calibrated_cube_of_floats(tmp_path):
    values = GREY.astype(np.float32) / 1e4
    values[:3] = np.float32(-3.40282265508890445e38)  # ISIS' null
    with rasterio.open(
        tmp_path / "a.cub", "w", driver="ISIS3", width=80, height=60, count=1, dtype="float32"
    ) as dataset:
        dataset.write(values, 1)
    image = read_frame(tmp_path / "a.cub")
    assert (image[:3] == 0).all()
    assert np.abs(image[3:].astype(int) - GREY[3:]).max() <= 1


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_a_frame_of_pds4_by_its_label(tmp_path, dtype):
    label = tmp_path / "a.xml"
    with rasterio.open(label, "w", driver="PDS4", width=80, height=60, count=1, dtype=dtype) as dataset:
        dataset.write(GREY.astype(dtype) * (1 if dtype == "uint8" else 16), 1)
    assert np.abs(read_frame(label).astype(int) - GREY).max() <= (0 if dtype == "uint8" else 1)
    data = tmp_path / "a.img"
    data.write_bytes(data.read_bytes()[:2400])
    with pytest.raises(FileFormatError, match=r"a\.xml"):
        read_frame(label)


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


def test_a_frame_of_pds3_by_its_label(tmp_path):
    (tmp_path / "A.LBL").write_text(PDS3.replace("\n", "\r\n"))
    (tmp_path / "A.IMG").write_bytes(GREY.tobytes())
    assert np.array_equal(read_frame(tmp_path / "A.LBL"), GREY)
    (tmp_path / "A.IMG").write_bytes(GREY.tobytes()[:2400])
    with pytest.raises(FileFormatError, match=r"A\.LBL"):
        read_frame(tmp_path / "A.LBL")
