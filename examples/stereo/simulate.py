"""How the measurements of this example were made: prints the tables of landmarks of ``stereo.toml``.

    python examples/stereo/simulate.py

The cameras (table 3), the four horizontal distances and the rover's place (table 4) are those of the paper. It prints
neither pixels nor coordinates of its landmarks: azimuths, attitudes and the mounting of the camera are of our choice.
Landmarks are off by errors of 0.5 m on the map, a third of its pixel; pixels are rounded to 0.0001.
"""

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.imaging import read_image_study
from radioloc.lunar import TangentPlane

DISTANCES_M = {"a": 15.888, "b": 13.648, "c": 17.584, "d": 15.896}
AZIMUTHS_DEG = {"a": 20.0, "b": 95.0, "c": 190.0, "d": 280.0}
ATTITUDES_DEG = {"a": (-12.0, 0.8), "b": (-15.0, -0.5), "c": (-11.0, 0.3), "d": (-12.5, 0.0)}  # pitch, roll
ASIDE_DEG = {"a": 3.0, "b": -6.0, "c": 8.0, "d": -1.0}  # from the camera's axis
BELOW_M = {"a": 3.4, "b": 3.6, "c": 3.1, "d": 3.5}  # the camera, which is on a rover on its lander
PLACE_DEG = (-19.5126, 44.1188)
MAP_SIGMA_M = 0.5


def in_camera(name):
    """The landmark in the axes of the left camera, m."""
    pitch, roll = np.radians(ATTITUDES_DEG[name])
    aside = np.radians(ASIDE_DEG[name])
    right, ahead = DISTANCES_M[name] * np.array([np.sin(aside), np.cos(aside)])
    down = BELOW_M[name]
    ahead, down = ahead * np.cos(pitch) - down * np.sin(pitch), down * np.cos(pitch) + ahead * np.sin(pitch)
    right, down = right * np.cos(roll) + down * np.sin(roll), down * np.cos(roll) - right * np.sin(roll)
    return np.array([right, down, ahead])


def main():
    from scipy.spatial.transform import Rotation

    chosen = read_image_study("examples/stereo/stereo.toml").chosen
    scale = 1.0 + chosen.height_m / MEAN_LUNAR_RADIUS_M
    heading, pitch, roll = np.radians(chosen.body_attitude_deg)
    ahead, right, down = chosen.camera_in_body_m
    # The rotation written out: roll, then pitch, then heading.
    ahead, down = (
        ahead * np.cos(pitch) + np.sin(pitch) * (right * np.sin(roll) + down * np.cos(roll)),
        down,
    )
    right = right * np.cos(roll) - down * np.sin(roll)
    camera_m = np.array(
        [ahead * np.sin(heading) + right * np.cos(heading), ahead * np.cos(heading) - right * np.sin(heading)]
    )
    to_right = Rotation.from_rotvec(chosen.rotation_deg, degrees=True).inv()
    plane = TangentPlane(*PLACE_DEG)
    errors = np.random.default_rng(2013).normal(scale=MAP_SIGMA_M, size=(len(DISTANCES_M), 2))
    for name, error_m in zip(DISTANCES_M, errors, strict=True):
        azimuth = np.radians(AZIMUTHS_DEG[name])
        on_map = camera_m + DISTANCES_M[name] * np.array([np.sin(azimuth), np.cos(azimuth)]) + error_m
        [(longitude, latitude)] = plane.to_longitude_latitude(on_map[None] / scale)
        point = in_camera(name)
        left, _ = chosen.left.camera((0, 0)).pixels(point[None])
        other, _ = chosen.right.camera((0, 0)).pixels(to_right.apply(point - chosen.baseline_m)[None])
        print("[[stereo.landmarks]]")
        print(f'name = "{name}"\nlongitude_deg = {longitude:.7f}\nlatitude_deg = {latitude:.7f}')
        print("left_px = [{:.4f}, {:.4f}]\nright_px = [{:.4f}, {:.4f}]".format(*left[0], *other[0]))
        print("pitch_deg = {}\nroll_deg = {}\n".format(*ATTITUDES_DEG[name]))


if __name__ == "__main__":
    main()
