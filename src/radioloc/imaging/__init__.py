"""Images: cameras and their orientation, from pixels to the ground and back.

A pixel is (sample, line), to the right and down; the centre of the first is (0, 0). Points on the Moon are in
mean-Earth axes, m, unless a name says otherwise.
"""

from radioloc.imaging.cameras import Camera
from radioloc.imaging.distortion import Distortion
from radioloc.imaging.frames import read_frame
from radioloc.imaging.maps import Map, TangentPlane
from radioloc.imaging.stereo import StereoPair, body_position, resect

__all__ = [
    "Camera",
    "Distortion",
    "Map",
    "StereoPair",
    "TangentPlane",
    "body_position",
    "read_frame",
    "resect",
]
