"""How ``orbital_image.json`` of this example was made: the sensor model of a pushbroom image that shows the lander.

    python examples/images/simulate_orbital_image.py

A camera as LRO's NAC passes 50 km above the landing site. The file's orbit is 9 m east, 6 m south and 2 m above the
true one, its attitude 20 to 30 microradians off; the pixel of the lander, which is printed, is 0.4 and -0.3 off.
"""

import json
from pathlib import Path

import numpy as np

from radioloc.imaging import Camera, Distortion, LineScanModel, TabulatedOrientation
from radioloc.imaging.orientation import quaternions_from_matrices, rotation_matrices
from radioloc.lunar import LunarPosition, east_north_up
from radioloc.time import epochs_from_strings, to_scale

FOLDER = Path(__file__).parent
EPOCH = "2020-12-02T05:00:00"
HEIGHT_M, SPEED_M_S, ASIDE_RAD = 50e3, 1650.0, 0.15
LINES, SAMPLES, LINE_S = 2000, 5064, 0.36e-3
ORBIT_ERROR_ENU_M = np.array([9.0, -6.0, 2.0])
ATTITUDE_ERROR_RAD = np.array([[30e-6, -20e-6, 30e-6]])
PIXEL_ERROR = np.array([0.4, -0.3])


def orientation(lander_m, to_enu, orbit_error_m, attitude_error_rad):
    """The orbit goes north; the camera looks west of down by so much that the lander is in view."""
    times = np.linspace(-0.5, 0.5, 11)
    east, north, up = to_enu
    middle = lander_m + (HEIGHT_M * np.tan(ASIDE_RAD) * east + HEIGHT_M * up) + orbit_error_m
    radius = np.linalg.norm(middle)
    angle = SPEED_M_S / radius * times[:, None]
    above = middle / radius
    positions = radius * (np.cos(angle) * above + np.sin(angle) * north)
    # Columns: the camera's x against the motion, y to the west and z down; then turned to the side.
    x = np.sin(angle) * above - np.cos(angle) * north
    z = -positions / radius
    level = np.stack([x, np.cross(z, x), z], axis=-1)
    turn = rotation_matrices(np.array([[-ASIDE_RAD, 0.0, 0.0]]))
    rotations = level @ turn @ rotation_matrices(attitude_error_rad)
    return TabulatedOrientation(times, positions, times, quaternions_from_matrices(rotations))


def main():
    truth = json.loads((FOLDER / "truth.json").read_text())["lander"]
    lander = LunarPosition.from_selenographic(
        truth["longitude_deg"], truth["latitude_deg"], truth["height_m"], "ME_DE421"
    )
    to_enu = east_north_up(*np.radians([truth["longitude_deg"], truth["latitude_deg"]]))
    camera = Camera(
        699.62,
        np.array([[0.0, 142.857], [142.857, 0.0]]),
        np.array([2547.0, 0.0]),
        Distortion("lrolrocnac", [1.81e-5]),
    )
    lines = np.array([[-0.5, -0.5 * LINES * LINE_S, LINE_S]])
    models = [
        LineScanModel(camera, orientation(lander.xyz_m, to_enu, *errors), lines, (LINES, SAMPLES))
        for errors in ((np.zeros(3), np.zeros((1, 3))), (ORBIT_ERROR_ENU_M @ to_enu, ATTITUDE_ERROR_RAD))
    ]
    [pixel], seen = models[0].project(lander.xyz_m[None])
    assert seen.all()
    print("point = [{:.2f}, {:.2f}]".format(*(pixel + PIXEL_ERROR)))
    tdb = to_scale(epochs_from_strings(EPOCH, "UTC"), "TDB")
    epoch_s = float(86400.0 * ((tdb.jd[0] - 2451545.0) + tdb.fraction[0]))
    content = support_data(models[1], epoch_s)
    (FOLDER / "orbital_image.json").write_text(json.dumps(content, indent=1) + "\n")


def support_data(model, epoch_s):
    """Image support data of USGS: the body's axes are at rest in J2000, pixels have 0.5 at the centre of the first."""
    camera, known = model.camera, model.orientation
    first_s, _ = model.times_s(np.array([-0.5]))
    return {
        "name_model": "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL",
        "name_platform": "SIMULATED",
        "name_sensor": "NAC",
        "image_lines": LINES,
        "image_samples": SAMPLES,
        "center_ephemeris_time": epoch_s,
        "radii": {"semimajor": 1737.4, "semiminor": 1737.4, "unit": "km"},
        "reference_height": {"minheight": -1000, "maxheight": 1000, "unit": "m"},
        "focal_length_model": {"focal_length": camera.focal_length_mm},
        "focal2pixel_samples": [0.0, *camera.pixel_per_mm[0].tolist()],
        "focal2pixel_lines": [0.0, *camera.pixel_per_mm[1].tolist()],
        "detector_center": {"sample": camera.principal_point_px[0] + 0.5, "line": 0.0},
        "detector_sample_summing": 1,
        "detector_line_summing": 1,
        "starting_detector_sample": 0,
        "starting_detector_line": 0,
        "optical_distortion": {
            camera.distortion.kind: {"coefficients": list(camera.distortion.coefficients)}
        },
        "body_rotation": {
            "ephemeris_times": [epoch_s],
            "quaternions": [[1.0, 0.0, 0.0, 0.0]],
            "angular_velocities": [[0.0] * 3],
            "time_dependent_frames": [31001, 1],
            "reference_frame": 1,
        },
        "instrument_pointing": {
            "ephemeris_times": (epoch_s + known.rotation_times_s).tolist(),
            "quaternions": (known.quaternions * [1.0, -1.0, -1.0, -1.0]).tolist(),
            "angular_velocities": [[0.0] * 3] * len(known.rotation_times_s),
            "time_dependent_frames": [-1, 1],
            "reference_frame": 1,
        },
        "instrument_position": {
            "ephemeris_times": (epoch_s + known.position_times_s).tolist(),
            "positions": (known.positions_m / 1e3).tolist(),
            "unit": "km",
            "reference_frame": 1,
        },
        "line_scan_rate": (model.line_times + np.array([1.0, 0.0, 0.0])).tolist(),
        "interpolation_method": "lagrange",
        "starting_ephemeris_time": epoch_s + float(first_s[0]),
    }


if __name__ == "__main__":
    main()
