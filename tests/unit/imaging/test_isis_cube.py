"""Cubes of LRO's NAC: one image by its ISD and by a cube of the same tables; a real cube beside ISIS and SPICE."""

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
from radioloc.lunar.visibility import sun_me_m
from radioloc.time import Epochs

REAL = FOLDER / "M143947267L.cal.echo.crop.cub"
LABEL_BYTES = 16384
LINE_ERROR, PREROLL = 0.0045, 1024.0
CLOCK_S = 1e-6
"""An epoch of 3e8 s is rounded to 0.06 microseconds; three are added here. Meanwhile LRO moves by 2 mm."""
GROUND_M = 2e-3
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
{more}End_Object
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


def support_data():
    return json.loads(gzip.decompress((ISDS / "lro_nac.json.gz").read_bytes()))


def write_cube(path, *, window=None, **replaced):
    """The cube of which the ISD could have been made; of a window its first sample and line, samples and lines."""
    isd = support_data()
    lines, samples = isd["image_lines"], isd["image_samples"]
    exposure_s = isd["line_scan_rate"][0][2] / (1.0 + LINE_ERROR)
    more = ""
    if window is not None:
        sample, line, samples, lines = window
        edges = (("StartingSample", sample), ("StartingLine", line))
        edges += (("EndingSample", sample + samples), ("EndingLine", line + lines))
        more = "".join(f"    Alpha{name} = {value + 0.5}\n" for name, value in edges)
        more = f"  Group = AlphaCube\n{more}  End_Group\n"
    tables, content, at = "", b"", LABEL_BYTES + lines * samples
    for name, key in (
        ("InstrumentPointing", "instrument_pointing"),
        ("BodyRotation", "body_rotation"),
        ("InstrumentPosition", "instrument_position"),
        ("SunPosition", "sun_position"),
    ):
        table, about = isd[key], ""
        if "quaternions" in table:
            columns, values = QUATERNION, [table["quaternions"]]
            about = "".join(
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
            f"  Records = {len(rows)}\n  ByteOrder = Lsb\n{about}{fields}End_Object\n"
        )
        content += rows.astype("<f8").tobytes()
    clock_s = isd["starting_ephemeris_time"] - PREROLL * isd["line_scan_rate"][0][2]
    label = LABEL.format(
        pixels=LABEL_BYTES + 1,
        label=LABEL_BYTES,
        samples=samples,
        lines=lines,
        exposure_ms=1e3 * exposure_s,
        more=more,
        tables=tables,
        clock=np.array(clock_s, "<f8").tobytes().hex(),
    )
    for old, new in replaced.values():
        assert old in label
        label = label.replace(old, new)
    assert len(label) < LABEL_BYTES
    whole = label.encode().ljust(LABEL_BYTES, b"\0") + bytes(lines * samples) + content
    path.write_bytes(whole)
    return path


def test_a_cube_and_an_isd_of_the_same_tables_are_one_camera(tmp_path):
    by_isd, by_cube = read_isd(ISDS / "lro_nac.json.gz"), read_isd(write_cube(tmp_path / "a.cub"))
    assert by_cube.model.shape == by_isd.model.shape
    assert by_cube.model.axes == by_isd.model.axes == "ME_DE421"
    assert by_cube.epoch_tdb_s == pytest.approx(by_isd.epoch_tdb_s, abs=CLOCK_S)
    np.testing.assert_allclose(by_cube.sun_m, by_isd.sun_m, rtol=1e-12)
    pixels = [[0.0, 0.0], [5063.0, 0.0], [2531.5, 199.5], [100.0, 399.0]]
    ground = [image_to_ground(one.model, pixels, Sphere()) for one in (by_isd, by_cube)]
    np.testing.assert_allclose(ground[1], ground[0], rtol=0, atol=GROUND_M)


def test_a_cube_that_was_cut_out_knows_where(tmp_path):
    whole = read_isd(write_cube(tmp_path / "a.cub")).model
    part = read_isd(write_cube(tmp_path / "b.cub", window=(2999, 120, 400, 200))).model
    assert part.shape == (200, 400)
    ground = [
        image_to_ground(model, np.array([[0.0, 0.0], [399.0, 199.0]]) + offset, Sphere())
        for model, offset in ((whole, [2999.0, 120.0]), (part, [0.0, 0.0]))
    ]
    np.testing.assert_allclose(ground[1], ground[0], rtol=0, atol=GROUND_M)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("InstrumentId = NACL", 'InstrumentId = "WAC-VIS"', "got an image of 'WAC-VIS'"),
        ("Group = Instrument", "Group = Mapping\n  End_Group\n  Group = Instrument", "got a map"),
        ("Name = BodyRotation", "Name = Histogram", "table BodyRotation is missing"),
        ("INS-85600_OD_K", "INS-85600_K", "INS-85600_OD_K is missing"),
        ("Records = 401", "Records = 400", "table InstrumentPointing is cut"),
    ],
)
def test_what_is_wrong_in_a_cube_is_named(tmp_path, old, new, says):
    with pytest.raises(FileFormatError, match=says):
        read_isd(write_cube(tmp_path / "a.cub", window=(0, 0, 40, 30), one=(old, new)))


@pytest.fixture(scope="module")
def real():
    if not REAL.exists():
        pytest.skip(f"{REAL} is not here")
    return read_isd(REAL)


def test_lines_of_a_real_cube_begin_with_its_table(real):
    """``CkTableStartTime``, which spiceinit wrote for the first edge of the part that was cut, with five decimals."""
    [start_s], _ = real.model.times_s(np.array([-0.5]))
    assert real.epoch_tdb_s + start_s == pytest.approx(342580072.37562, abs=5e-6)


def test_the_ground_of_a_real_cube_is_that_of_spice(real):
    """From the bytes of its tables at one of their nodes, a pixel on the camera's axis without distortion."""
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
    # Sample 300 is detector 3299 of ISIS's count, from 0 and 2547 on the axis; the distortion is that of LROC.
    measured_mm = (2999.0 + 300.0 - 2547.0) * 0.007
    look = [0.0, measured_mm / (1.0 + 1.81e-05 * measured_mm**2), 699.62]
    ray = to_moon @ to_camera.T @ look
    expected = spiceypy.surfpt(1e3 * to_moon @ position[0, :3], ray, 1737400.0, 1737400.0, 1737400.0)
    found = image_to_ground(real.model, [[300.0, -0.5]], Sphere())[0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-2)


def test_angles_in_a_real_cube_are_those_of_isis(real):
    """Of two photometric corrections of one pixel that ISIS's tests print, to eight digits, the quotient.

    The pixel's own value is not in it. Incidence, emission and phase are by ISIS's camera (functional tests of
    lronacpho, algorithms of 2014 and 2019; the pixel with 300 before it in line 300). A pixel to the side changes the
    quotient by 1.8e-6, so it places the ray within 0.06 samples, 3 cm; along the lines it tells little.
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


def test_the_axes_and_the_sun_of_a_real_cube_are_those_of_the_library(real):
    ours = read_isd(REAL, axes="ME_DE421")
    pixels = [[0.0, 0.0], [399.0, 399.0]]
    np.testing.assert_allclose(
        image_to_ground(ours.model, pixels, Sphere()),
        image_to_ground(real.model, pixels, Sphere()),
        atol=1e-3,
    )
    sun_m = sun_me_m(Epochs.from_tdb_seconds([real.epoch_tdb_s]))[0]
    assert np.linalg.norm(sun_m - real.sun_m) < ABERRATION_RAD * np.linalg.norm(sun_m)
