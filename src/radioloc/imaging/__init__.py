"""Images: cameras and their orientation, from pixels to the ground and back.

A pixel is (sample, line), to the right and down; the centre of the first pixel is (0, 0). Points on the Moon are in
mean-Earth axes, m, unless a name says otherwise.
"""

from typing import TYPE_CHECKING

from radioloc.lazy import lazy_exports as _lazy_exports

if TYPE_CHECKING:  # these modules are imported on first use
    from radioloc.imaging.base_map import BaseMap, make_base_map
    from radioloc.imaging.cameras import Camera
    from radioloc.imaging.distortion import Distortion
    from radioloc.imaging.figures import plot_base_map, plot_images, plot_point, plot_stereo
    from radioloc.imaging.ground_points import ImagePointSigmas, locate_image_point
    from radioloc.imaging.isd import read_isd
    from radioloc.imaging.location import locate_images
    from radioloc.imaging.orientation import ConstantOrientation, TabulatedOrientation
    from radioloc.imaging.orthophoto import write_orthophoto
    from radioloc.imaging.sensor_models import FrameModel, LineScanModel
    from radioloc.imaging.solution import ImageSolution, PointSolution
    from radioloc.imaging.stereo_points import StereoPoints
    from radioloc.imaging.study import read_image_study
    from radioloc.imaging.surfaces import Sphere, Terrain

__all__ = [
    "BaseMap",
    "Camera",
    "ConstantOrientation",
    "Distortion",
    "FrameModel",
    "ImagePointSigmas",
    "ImageSolution",
    "LineScanModel",
    "PointSolution",
    "Sphere",
    "StereoPoints",
    "TabulatedOrientation",
    "Terrain",
    "locate_image_point",
    "locate_images",
    "make_base_map",
    "plot_base_map",
    "plot_images",
    "plot_point",
    "plot_stereo",
    "read_image_study",
    "read_isd",
    "write_orthophoto",
]

__getattr__, __dir__ = _lazy_exports(
    __name__,
    {
        "base_map": "BaseMap make_base_map",
        "cameras": "Camera",
        "distortion": "Distortion",
        "figures": "plot_base_map plot_images plot_point plot_stereo",
        "ground_points": "ImagePointSigmas locate_image_point",
        "isd": "read_isd",
        "location": "locate_images",
        "orientation": "ConstantOrientation TabulatedOrientation",
        "orthophoto": "write_orthophoto",
        "sensor_models": "FrameModel LineScanModel",
        "solution": "ImageSolution PointSolution",
        "stereo_points": "StereoPoints",
        "study": "read_image_study",
        "surfaces": "Sphere Terrain",
    },
)
