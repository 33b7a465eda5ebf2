"""Image support data of real and synthetic cameras, against USGS and SPICE for the same files."""

import gzip
import json

import numpy as np
import pytest
import spiceypy
from paths import ISDS

from radioloc.errors import FileFormatError, InputError
from radioloc.imaging import Sphere, read_isd
from radioloc.imaging.ground_points import image_to_ground

ROUND_TRIP_PX = 1e-6  # of the secant method, which ends at 1e-8 of a line
USGS_M = 1e-8  # last decimal in the tests of ``usgscsm``
HAND_M = 2e-4  # rounding of epochs to 0.1 microseconds, in which an orbiter moves by 0.17 mm
SAME_AXES_RAD = 1e-11  # of rotations by SPICE from the same kernels, rounded to sixteen digits


def isd(name, **options):
    return read_isd(ISDS / name, **options)


def raw(name):
    content = (ISDS / name).read_bytes()
    return json.loads(gzip.decompress(content) if name.endswith("gz") else content)


# Pixels of each image whose rays meet the sphere. Most of the synthetic frame misses it, the half lines at both ends of
# the synthetic scan have no ephemeris, and the Apollo frame has its axis at the first pixel and the horizon in view.
FIELDS = {
    "synthetic_frame.json": ([5.0, 5.0], [9.0, 9.0]),
    "synthetic_line_scan.json": ([-0.5, 0.0], [15.5, 15.0]),
    "apollo15_metric.json": ([-6000.0, -6000.0], [6000.0, 6000.0]),
    "lro_nac.json.gz": ([-0.5, -0.5], [5063.49, 399.49]),
    "kaguya_tc.json.gz": ([-0.5, -0.5], [3207.49, 399.49]),
    "lro_nac_polar.json.gz": ([-0.5, -0.5], [2531.49, 8191.49]),
}


@pytest.mark.parametrize("name", FIELDS)
def test_pixels_return_from_the_ground(name):
    data = isd(name)
    rng = np.random.default_rng(4)
    low, high = FIELDS[name]
    pixels = np.vstack([rng.uniform(low, high, size=(500, 2)), [low, high]])
    for height_m in (0.0, 8000.0 if data.radius_m > 1e6 else 0.3):
        ground = image_to_ground(data.model, pixels, Sphere(data.radius_m + height_m))
        assert np.abs(data.model.project(ground).pixels - pixels).max() < ROUND_TRIP_PX


def test_synthetic_frame_agrees_with_usgs():
    """Reproduce usgscsm's FrameCameraTests: (line, sample) from 0.5; 1 km above a sphere of 10 m.

    Its singular distortion, which usgscsm ignores from image to ground, is replaced with zero in our copy.
    """
    model = isd("synthetic_frame.json").model
    ground = image_to_ground(model, np.array([[7.5, 7.5], [6.5, 7.5]]) - 0.5, Sphere(10.0))
    usgs = [[10.0, 0.0, 0.0], [9.80194018, 0.0, 1.98039612]]
    assert np.abs(ground - usgs).max() < USGS_M
    # By hand: 0.1 mm at 50 mm is a slope of 0.002, on x = 1000 - t, z = 0.002 t with x^2 + z^2 = 100.
    t = (1000.0 - np.sqrt(1000.0**2 - (1000.0**2 - 100.0) * (1 + 0.002**2))) / (1 + 0.002**2)
    assert ground[1] == pytest.approx([1000.0 - t, 0.0, 0.002 * t], abs=1e-9)


def test_synthetic_line_scan_agrees_with_usgs():
    """Reproduce usgscsm's LineScanCameraTests: (line, sample) = (8.5, 8), 1050 km from a sphere of 1000 km."""
    model = isd("synthetic_line_scan.json").model
    [ground] = image_to_ground(model, [[7.5, 8.0]], Sphere(1e6))
    assert ground == pytest.approx([999999.67040488799, 0.0, -811.90523782723039], abs=1e-5)
    # By hand, in the plane y = 0: the ray is 0.05 mm on 50 mm from the direction to the centre; the angle of the axis
    # is that of the file's quaternion.
    table = raw("synthetic_line_scan.json")
    x, _, z = 1e3 * np.array(table["instrument_position"]["positions"][8])
    w, _, qy, _ = table["instrument_pointing"]["quaternions"][8]
    angle = -2.0 * np.arctan2(qy, w) - 0.001  # of the line of sight from the x axis, about y
    direction = np.array([-np.sin(angle), -np.cos(angle)])
    start = np.array([x, z])
    projection = start @ direction
    distance = -projection - np.sqrt(projection**2 - (start @ start - 1e12))
    assert ground[[0, 2]] == pytest.approx(
        start + distance * direction, abs=0.01
    )  # atan(0.001) is 3e-10 less


def by_spice(name, node, camera_direction):
    """Intersect a direction in the camera's axes with the Moon from a node of the tables, by SPICE."""
    table = raw(name)
    body, pointing, place = (
        table[k] for k in ("body_rotation", "instrument_pointing", "instrument_position")
    )
    node_s = place["ephemeris_times"][node]
    assert node_s == pointing["ephemeris_times"][node]
    quaternions, times = body["quaternions"], body["ephemeris_times"]
    to_moon = spiceypy.q2m(quaternions[0])
    if len(times) > 1:
        axis, angle = spiceypy.raxisa(spiceypy.q2m(quaternions[1]) @ to_moon.T)
        part = (node_s - times[0]) / (times[1] - times[0])
        to_moon = spiceypy.axisar(axis, part * angle) @ to_moon
    constant = [np.reshape(t.get("constant_rotation", np.eye(3)), (3, 3)) for t in (body, pointing)]
    to_moon, to_camera = constant[0] @ to_moon, constant[1] @ spiceypy.q2m(pointing["quaternions"][node])
    position_km = to_moon @ place["positions"][node]
    return 1e3 * spiceypy.surfpt(
        position_km, to_moon @ to_camera.T @ camera_direction, 1737.4, 1737.4, 1737.4
    )


def test_axes_of_real_cameras_agree_with_spice():
    """Compare pixels on the axes at nodes of the tables with SPICE's intersection with the sphere."""
    # LRO: sample 2547.5 in the numbering of the file; the middle of the image in time is node 200.
    ground = image_to_ground(isd("lro_nac.json.gz").model, [[2547.0, 199.5]], Sphere())
    assert np.abs(ground - by_spice("lro_nac.json.gz", 200, [0.0, 0.0, 1.0])).max() < HAND_M
    # Summed by two, the axis is at 1273.75; the first node is the start of the first line.
    ground = image_to_ground(isd("lro_nac_polar.json.gz").model, [[1273.25, -0.5]], Sphere())
    assert np.abs(ground - by_spice("lro_nac_polar.json.gz", 0, [0.0, 0.0, 1.0])).max() < HAND_M
    # Apollo's camera looks along -z.
    ground = image_to_ground(isd("apollo15_metric.json").model, [[-0.5, -0.5]], Sphere())
    assert np.abs(ground - by_spice("apollo15_metric.json", 0, [0.0, 0.0, -1.0])).max() < HAND_M
    # Kaguya's detector is offset by one pixel (0.007 mm) in x; its distortion has a boresight and cubic polynomials.
    lens = raw("kaguya_tc.json.gz")["optical_distortion"]["kaguyalism"]
    r = np.array([1.0, 0.007, 0.007**2, 0.007**3])
    ideal = [0.007 + lens["boresight_x"] + lens["x"] @ r, lens["boresight_y"] + lens["y"] @ r, 72.45]
    ground = image_to_ground(isd("kaguya_tc.json.gz").model, [[2046.5, 199.5]], Sphere())
    assert np.abs(ground - by_spice("kaguya_tc.json.gz", 200, ideal)).max() < HAND_M


@pytest.mark.parametrize("name", ["lro_nac.json.gz", "lro_nac_polar.json.gz", "apollo15_metric.json"])
def test_rotation_of_the_moon_in_files_is_that_of_de421(name):
    from_file, from_kernel = isd(name).model.orientation, isd(name, axes="ME_DE421").model.orientation
    time_s = np.array([0.0])
    assert np.abs(from_file.poses(time_s)[1] - from_kernel.poses(time_s)[1]).max() < SAME_AXES_RAD
    assert np.abs(from_file.poses(time_s)[0] - from_kernel.poses(time_s)[0]).max() < SAME_AXES_RAD * 1.8e6


def test_axes_are_those_of_the_file_or_of_the_argument():
    name = "kaguya_tc.json.gz"
    from_file, chosen = isd(name).model, isd(name, axes="ME_DE421").model
    assert (from_file.axes, chosen.axes) == ("IAU_MOON", "ME_DE421")
    shift_m = image_to_ground(from_file, [[1000.0, 200.0]], Sphere()) - image_to_ground(
        chosen, [[1000.0, 200.0]], Sphere()
    )
    assert 10.0 < np.linalg.norm(shift_m) < 155.0  # error of the IAU series
    assert isd("lro_nac.json.gz").model.axes == "ME_DE421"


def changed(key, value):
    def change(content):
        *parents, last = key.split(".")
        for part in parents:
            content = content[part]
        content[last] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (changed("name_model", "USGS_ASTRO_SAR_SENSOR_MODEL"), "name_model: expected"),
        (changed("focal_length_model.focal_length", -5.0), "focal_length_mm: expected a positive"),
        (changed("line_scan_rate", [[0.5, 0.0, -0.1]]), "line_times: expected rising"),
        (changed("optical_distortion", {"fisheye": {}}), "optical_distortion: expected .* 'fisheye'"),
        (changed("instrument_position.positions", [[1.0, 2.0, 3.0]]), "positions: expected 16 by 3"),
        (
            changed("instrument_pointing.quaternions", [[2.0, 0.0, 0.0, 0.0]] * 16),
            "quaternions: expected unit length",
        ),
        (changed("body_rotation.ephemeris_times", []), "rising times in body_rotation"),
        (changed("radii.semiminor", 900), "radii: expected"),
    ],
)
def test_invalid_values_are_refused_by_key(tmp_path, change, message):
    content = raw("synthetic_line_scan.json")
    change(content)
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match=message) as caught:
        read_isd(path)
    assert str(path) in str(caught.value)


def test_other_files_and_axes_are_refused(tmp_path):
    path = tmp_path / "bad.json"
    path.write_text('{"name_model":\n')
    with pytest.raises(FileFormatError, match="JSON of an ISD"):
        read_isd(path)
    path.write_text("[1, 2]")
    with pytest.raises(FileFormatError, match="name_model is missing"):
        read_isd(path)
    with pytest.raises(FileFormatError):
        read_isd(tmp_path / "none.json")
    with pytest.raises(InputError, match=r"axes: .* 'PA_DE421'"):
        read_isd(path, axes="PA_DE421")
