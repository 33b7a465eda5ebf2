"""Exterior orientation from SPICE kernels, which SPICE writes from the tables of a real image."""

import gzip
import json

import numpy as np
import pytest
import spiceypy
from paths import ISDS

from radioloc.errors import FileFormatError, InputError, KernelError
from radioloc.imaging import (
    LineScanModel,
    Sphere,
    ground_to_image,
    image_to_ground,
    orientation_from_spice,
    read_isd,
)

ISD = ISDS / "lro_nac.json.gz"

KERNEL_M = 1e-3
"""Between nodes SPICE has Lagrange polynomials of degree 7, clocks of 65536 ticks a second: 0.03 m/s off, 8 us."""

CLOCK_TICKS = 1e6  # of this test's clock, in a second

FRAMES = """KPL/FK
\\begindata
FRAME_CAMERA = -85600
FRAME_-85600_NAME = 'CAMERA'
FRAME_-85600_CLASS = 3
FRAME_-85600_CLASS_ID = -85600
FRAME_-85600_CENTER = -85
CK_-85600_SCLK = -85
CK_-85600_SPK = -85
\\begintext
"""

CLOCK = """KPL/SCLK
\\begindata
SCLK_KERNEL_ID = ( @2009-07-01 )
SCLK_DATA_TYPE_85 = ( 1 )
SCLK01_TIME_SYSTEM_85 = ( 1 )
SCLK01_N_FIELDS_85 = ( 2 )
SCLK01_MODULI_85 = ( 4294967296 1000000 )
SCLK01_OFFSETS_85 = ( 0 0 )
SCLK01_OUTPUT_DELIM_85 = ( 1 )
SCLK_PARTITION_START_85 = ( 0.0 )
SCLK_PARTITION_END_85 = ( 4.0E+15 )
SCLK01_COEFFICIENTS_85 = ( 0.0 302228000.0 1.0 )
\\begintext
"""


@pytest.fixture(scope="module")
def kernels(tmp_path_factory):
    """SPK of type 13 and CK of type 3 with the positions and quaternions of the image's support data."""
    folder = tmp_path_factory.mktemp("kernels")
    table = json.loads(gzip.decompress(ISD.read_bytes()))
    place, pointing = table["instrument_position"], table["instrument_pointing"]
    paths = [folder / name for name in ("camera.tf", "clock.tsc", "orbit.bsp", "attitude.bc")]
    paths[0].write_text(FRAMES)
    paths[1].write_text(CLOCK)
    times = np.array(place["ephemeris_times"])
    states = np.hstack([place["positions"], place["velocities"]])
    handle = spiceypy.spkopn(str(paths[2]), "orbit", 0)
    spiceypy.spkw13(handle, -85, 301, "J2000", times[0], times[-1], "orbit", 7, len(times), states, times)
    spiceypy.spkcls(handle)
    ticks = (np.array(pointing["ephemeris_times"]) - 302228000.0) * CLOCK_TICKS
    handle = spiceypy.ckopn(str(paths[3]), "attitude", 0)
    spiceypy.ckw03(
        handle, ticks[0], ticks[-1], -85600, "J2000", False, "attitude", len(ticks), ticks,
        np.array(pointing["quaternions"]), np.zeros((len(ticks), 3)), 1, ticks[:1],
    )  # fmt: skip
    spiceypy.ckcls(handle)
    return paths


def of_image(kernels, **changes):
    given = {
        "spacecraft": -85,
        "camera_frame": "CAMERA",
        "epoch_tdb_s": read_isd(ISD).epoch_tdb_s,
        "span_s": (-0.2, 0.2),
        "step_s": 0.002,
    }
    return orientation_from_spice(kernels, **(given | changes))


def test_spice_has_the_orientation_of_the_support_data(kernels):
    model = read_isd(ISD).model
    found = of_image(kernels)
    assert found.span_s == pytest.approx((-0.2, 0.2), abs=1e-6)
    at = np.linspace(-0.19, 0.19, 77)
    (positions, rotations), (expected_positions, expected_rotations) = found.at(at), model.orientation.at(at)
    assert np.abs(positions - expected_positions).max() < KERNEL_M
    assert np.abs(rotations - expected_rotations).max() < 2e-7  # jitter between nodes
    own = LineScanModel(model.camera, found, model.line_times, model.shape)
    pixels = np.array([[100.0, 20.0], [2500.0, 200.0], [5000.0, 380.0]])
    ground = image_to_ground(model, pixels, Sphere())
    assert np.abs(ground_to_image(own, ground) - pixels).max() < 0.02  # 30 mm


def test_kernels_are_not_left_loaded(kernels):
    before = spiceypy.ktotal("ALL")
    of_image(kernels)
    assert spiceypy.ktotal("ALL") == before


def test_what_kernels_do_not_have_is_one_clear_error(kernels, tmp_path):
    for change in ({"spacecraft": "-86"}, {"camera_frame": "NONE"}, {"span_s": (5.0, 6.0)}):
        with pytest.raises(KernelError, match=r"SPICE cannot give the camera's orientation from .*camera.tf"):
            of_image(kernels, **change)
    with pytest.raises(FileFormatError):
        of_image([*kernels, tmp_path / "none.bsp"])
    with pytest.raises(InputError, match="makes no table of two times"):
        of_image(kernels, step_s=1.0)


def test_a_damaged_trajectory_is_refused_before_spice_sees_it(kernels, tmp_path):
    cut = tmp_path / "cut.bsp"
    cut.write_bytes(kernels[2].read_bytes()[:-1])
    with pytest.raises(KernelError, match=r"cut\.bsp .*is cut short"):
        of_image([kernels[0], kernels[1], cut, kernels[3]])
