"""Cubes of LRO's NAC: equal results of an ISD and of a cube of the same tables; a real cube against ISIS and SPICE."""

import gzip
import json

import numpy as np
import pytest
import spiceypy
from descent_images import FOLDER
from paths import ISDS

from radioloc.errors import FileFormatError
from radioloc.imaging import Sphere, read_isd
from radioloc.imaging.ground_points import image_to_ground
from radioloc.lunar.frames import sun_position_me_m
from radioloc.time import Epochs

REAL = FOLDER / "M143947267L.cal.echo.crop.cub"
LABEL_BYTES = 16384
LINE_ERROR, PREROLL = 0.0045, 1024.0
CLOCK_S = 1e-6  # rounding of epochs of 3e8 s to 0.06 microseconds, three times
GROUND_M = 2e-3  # motion of LRO in that time
ABERRATION_RAD = 1.05e-4

LABEL = """Object = IsisCube
  Object = Core
    StartByte = {pixels}
    Format = BandSequential
    Group = Dimensions
      Samples = {samples}
      Lines = {lines}
      Bands = 1
    End_Group
    Group = Pixels
      Type = UnsignedByte
      ByteOrder = Lsb
      Base = 0.0
      Multiplier = 1.0
    End_Group
  End_Object
  Group = Instrument
    SpacecraftName = "LUNAR RECONNAISSANCE ORBITER"
    InstrumentId = NACL
    TargetName = MOON
    SpacecraftClockPrerollCount = 1/270650905:12345
    LineExposureDuration = {exposure_ms!r} <ms>
    SpatialSumming = 1
    SampleFirstPixel = 0
  End_Group
{alpha_cube}End_Object
Object = Label
  Bytes = {label}
End_Object
{tables}Object = NaifKeywords
  BODY301_RADII = (1737.4, 1737.4, 1737.4)
  INS-85600_FOCAL_LENGTH = 699.62
  INS-85600_CONSTANT_TIME_OFFSET = 0.0
  INS-85600_ADDITIONAL_PREROLL = 1024.0
  INS-85600_ADDITIVE_LINE_ERROR = 0.0
  INS-85600_MULTIPLI_LINE_ERROR = 0.0045
  CLOCK_ET_-85_1/270650905:12345_COMPUTED = {clock}
  INS-85600_ITRANSS = (0.0, 0.0, 142.857)
  INS-85600_ITRANSL = (0.0, -142.857, 0.0)
  INS-85600_BORESIGHT_SAMPLE = 2548.0
  INS-85600_BORESIGHT_LINE = 0.0
  INS-85600_OD_K = 1.81e-05
End_Object
End
"""
AXES = ["X", "Y", "Z", "XV", "YV", "ZV"]
QUATERNION = ["Q0", "Q1", "Q2", "Q3"]


def write_cube(path, *, window=None, **replaced):
    """Write a cube with the tables of the ISD; a window is its first sample and line, samples and lines."""
    isd = json.loads(gzip.decompress((ISDS / "lro_nac.json.gz").read_bytes()))
    lines, samples = isd["image_lines"], isd["image_samples"]
    exposure_s = isd["line_scan_rate"][0][2] / (1.0 + LINE_ERROR)
    alpha_cube = ""
    if window is not None:
        sample, line, samples, lines = window
        edges = (("StartingSample", sample), ("StartingLine", line))
        edges += (("EndingSample", sample + samples), ("EndingLine", line + lines))
        edges_text = "".join(f"    Alpha{name} = {value + 0.5}\n" for name, value in edges)
        alpha_cube = f"  Group = AlphaCube\n{edges_text}  End_Group\n"
    tables, content, at = "", b"", LABEL_BYTES + lines * samples
    for name, key in (
        ("InstrumentPointing", "instrument_pointing"),
        ("BodyRotation", "body_rotation"),
        ("InstrumentPosition", "instrument_position"),
        ("SunPosition", "sun_position"),
    ):
        table, keywords = isd[key], ""
        if "quaternions" in table:
            columns, values = QUATERNION, [table["quaternions"]]
            keywords = "".join(
                f"  {word} = ({', '.join(map(repr, table[part]))})\n"
                for word, part in (
                    ("TimeDependentFrames", "time_dependent_frames"),
                    ("ConstantFrames", "constant_frames"),
                    ("ConstantRotation", "constant_rotation"),
                )
            )
        else:
            columns, values = AXES, [table["positions"], table["velocities"]]
        rows = np.column_stack([*values, table["ephemeris_times"]])
        fields = "".join(
            f"  Group = Field\n    Name = {column}\n    Type = Double\n    Size = 1\n  End_Group\n"
            for column in [*(f"J2000{column}" for column in columns), "ET"]
        )
        tables += (
            f"Object = Table\n  Name = {name}\n  StartByte = {at + len(content) + 1}\n  Bytes = {rows.nbytes}\n"
            f"  Records = {len(rows)}\n  ByteOrder = Lsb\n{keywords}{fields}End_Object\n"
        )
        content += rows.astype("<f8").tobytes()
    clock_s = isd["starting_ephemeris_time"] - PREROLL * isd["line_scan_rate"][0][2]
    label = LABEL.format(
        pixels=LABEL_BYTES + 1,
        label=LABEL_BYTES,
        samples=samples,
        lines=lines,
        exposure_ms=1e3 * exposure_s,
        alpha_cube=alpha_cube,
        tables=tables,
        clock=np.array(clock_s, "<f8").tobytes().hex(),
    )
    for old, new in replaced.values():
        assert old in label
        label = label.replace(old, new)
    assert len(label) < LABEL_BYTES
    path.write_bytes(label.encode().ljust(LABEL_BYTES, b"\0") + bytes(lines * samples) + content)
    return path


def test_cube_and_isd_of_the_same_tables_agree(tmp_path):
    by_isd, by_cube = read_isd(ISDS / "lro_nac.json.gz"), read_isd(write_cube(tmp_path / "a.cub"))
    assert by_cube.model.shape == by_isd.model.shape
    assert by_cube.model.axes == by_isd.model.axes == "ME_DE421"
    assert by_cube.epoch_tdb_s == pytest.approx(by_isd.epoch_tdb_s, abs=CLOCK_S)
    np.testing.assert_allclose(by_cube.sun_m, by_isd.sun_m, rtol=1e-12)
    pixels = [[0.0, 0.0], [5063.0, 0.0], [2531.5, 199.5], [100.0, 399.0]]
    ground = [image_to_ground(data.model, pixels, Sphere()) for data in (by_isd, by_cube)]
    np.testing.assert_allclose(ground[1], ground[0], rtol=0, atol=GROUND_M)


def test_cut_cube_has_the_offset_of_its_label(tmp_path):
    full = read_isd(write_cube(tmp_path / "a.cub")).model
    part = read_isd(write_cube(tmp_path / "b.cub", window=(2999, 120, 400, 200))).model
    assert part.shape == (200, 400)
    ground = [
        image_to_ground(model, np.array([[0.0, 0.0], [399.0, 199.0]]) + offset, Sphere())
        for model, offset in ((full, [2999.0, 120.0]), (part, [0.0, 0.0]))
    ]
    np.testing.assert_allclose(ground[1], ground[0], rtol=0, atol=GROUND_M)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("InstrumentId = NACL", 'InstrumentId = "WAC-VIS"', "got an image of 'WAC-VIS'"),
        ("Name = BodyRotation", "Name = Histogram", "table BodyRotation is missing"),
        ("Records = 401", "Records = 400", "table InstrumentPointing is cut"),
    ],
)
def test_invalid_cubes_are_refused(tmp_path, old, new, words):
    with pytest.raises(FileFormatError, match=words):
        read_isd(write_cube(tmp_path / "a.cub", window=(0, 0, 40, 30), one=(old, new)))


@pytest.fixture(scope="module")
def real():
    if not REAL.exists():
        pytest.skip(f"{REAL} is not here")
    return read_isd(REAL)


def test_first_line_of_a_real_cube_begins_with_its_table(real):
    """Compare with ``CkTableStartTime`` of spiceinit, five decimals, for the first edge of the cut part."""
    [start_s], _ = real.model.times_s(np.array([-0.5]))
    assert real.epoch_tdb_s + start_s == pytest.approx(342580072.37562, abs=5e-6)


def test_ground_of_a_real_cube_agrees_with_spice(real):
    """Compare a pixel at a node of the tables."""
    content = REAL.read_bytes()
    pointing = np.frombuffer(content, "<f8", 32, 705536).reshape(4, 8)
    position = np.frombuffer(content, "<f8", 21, 705792).reshape(3, 7)
    body = np.frombuffer(content, "<f8", 16, 705960).reshape(2, 8)
    assert pointing[0, 7] == position[0, 6] == body[0, 7]
    constant = """0.99999987325471 -3.29285422375571e-04 3.80869618671387e-04 3.29286000210947e-04 0.99999994578431
    -1.45444093783627e-06 -3.80869119096078e-04 1.57985578682691e-06 0.99999992746811"""
    constant = np.reshape(np.array(constant.split(), dtype=float), (3, 3))
    to_moon = constant @ spiceypy.q2m(body[0, :4].copy())
    to_camera = spiceypy.q2m(pointing[0, :4].copy())
    # Sample 300 is detector 3299 from 0, the axis 2547; the distortion is that of LROC.
    measured_mm = (2999.0 + 300.0 - 2547.0) * 0.007
    look = [0.0, measured_mm / (1.0 + 1.81e-05 * measured_mm**2), 699.62]
    ray = to_moon @ to_camera.T @ look
    expected = spiceypy.surfpt(1e3 * to_moon @ position[0, :3], ray, 1737400.0, 1737400.0, 1737400.0)
    ground = image_to_ground(real.model, [[300.0, -0.5]], Sphere())[0]
    np.testing.assert_allclose(ground, expected, rtol=0, atol=2e-2)


def test_angles_in_a_real_cube_agree_with_isis(real):
    """Compare the quotient of two photometric corrections of a pixel in ISIS's tests, printed to eight digits.

    It depends on incidence, emission and phase only (functional tests of lronacpho, algorithms of 2014 and 2019, sample
    300 of line 300). The next sample changes it by 1.8e-6, so the ray agrees within 0.06 samples, 3 cm.
    """
    expected = 0.28940132 / 0.26584613
    quotients = [
        _correction_2014(*angles) / _correction_2019(*angles) for angles in map(real_angles(real), (300, 301))
    ]
    assert quotients[0] == pytest.approx(expected, rel=1e-7)
    assert quotients[1] != pytest.approx(expected, rel=1e-6)


def real_angles(real):
    def angles(sample):
        pixel = [[sample, 299.0]]
        point, look = image_to_ground(real.model, pixel, Sphere())[0], real.model.rays(pixel).directions[0]
        up, sun = point / np.linalg.norm(point), (real.sun_m - point) / np.linalg.norm(real.sun_m - point)
        return np.degrees(np.arccos([sun @ up, -look @ up, -sun @ look]))

    return angles


def _correction_2014(incidence, emission, phase):
    def model(incidence, emission, phase):
        mu0, mu = np.cos(np.radians([incidence, emission]))
        return np.exp(-2.9811422 - 0.0112862 * phase - 0.8084603 * mu + 1.3248888 * mu0)

    return model(30.0, 0.0, 30.0) / model(incidence, emission, phase)


def _correction_2019(incidence, emission, phase):
    def model(incidence, emission, phase):
        mu0, mu = np.cos(np.radians([incidence, emission]))
        polynomial = -1.479654495 - 0.000083528 * phase**2 + 0.012964707 * phase - 0.237774774 * phase**0.5
        return (
            mu0
            / (mu + mu0)
            * np.exp(polynomial + 0.556075496 * mu + 0.663671460 * mu0 - 0.439918609 * mu0**2)
        )

    return model(30.0, 0.0, 30.0) / model(incidence, emission, phase)


def test_axes_and_sun_of_a_real_cube_agree_with_the_kernels(real):
    by_kernels = read_isd(REAL, axes="ME_DE421")
    pixels = [[0.0, 0.0], [399.0, 399.0]]
    np.testing.assert_allclose(
        image_to_ground(by_kernels.model, pixels, Sphere()),
        image_to_ground(real.model, pixels, Sphere()),
        atol=1e-3,
    )
    sun_m = sun_position_me_m(Epochs.from_tdb_seconds([real.epoch_tdb_s]))[0]
    assert np.linalg.norm(sun_m - real.sun_m) < ABERRATION_RAD * np.linalg.norm(sun_m)
