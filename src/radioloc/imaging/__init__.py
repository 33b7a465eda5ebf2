"""Images: cameras and their orientation, from pixels to the ground and back.

A pixel is (sample, line), to the right and down; the centre of the first is (0, 0). Points on the Moon are in
mean-Earth axes, m, unless a name says otherwise.
"""

from typing import TYPE_CHECKING

from radioloc.lazy import lazy_exports as _lazy_exports

if TYPE_CHECKING:  # what is here is imported when it is first used
    from radioloc.imaging.cameras import Camera
    from radioloc.imaging.distortion import Distortion
    from radioloc.imaging.figures import plot_images, plot_point
    from radioloc.imaging.ground_points import (
        ImagePointSigmas,
        ground_to_image,
        image_to_ground,
        locate_image_point,
    )
    from radioloc.imaging.image_chain import Frame, TiePoint
    from radioloc.imaging.isd import read_isd
    from radioloc.imaging.location import locate_images
    from radioloc.imaging.orientation import ConstantOrientation, PolynomialOrientation, TabulatedOrientation
    from radioloc.imaging.orthophoto import write_orthophoto
    from radioloc.imaging.registration import register_chain
    from radioloc.imaging.sensor_models import FrameModel, LineScanModel
    from radioloc.imaging.solution import ImageSolution, PointSolution
    from radioloc.imaging.spice_source import orientation_from_spice
    from radioloc.imaging.study import read_image_study
    from radioloc.imaging.surfaces import Sphere, Terrain

__all__ = [
    "Camera",
    "ConstantOrientation",
    "Distortion",
    "Frame",
    "FrameModel",
    "ImagePointSigmas",
    "ImageSolution",
    "LineScanModel",
    "PointSolution",
    "PolynomialOrientation",
    "Sphere",
    "TabulatedOrientation",
    "Terrain",
    "TiePoint",
    "ground_to_image",
    "image_to_ground",
    "locate_image_point",
    "locate_images",
    "orientation_from_spice",
    "plot_images",
    "plot_point",
    "read_image_study",
    "read_isd",
    "register_chain",
    "write_orthophoto",
]

__getattr__, __dir__ = _lazy_exports(
    __name__,
    {
        "cameras": "Camera",
        "distortion": "Distortion",
        "figures": "plot_images plot_point",
        "ground_points": "ImagePointSigmas ground_to_image image_to_ground locate_image_point",
        "image_chain": "Frame TiePoint",
        "isd": "read_isd",
        "location": "locate_images",
        "orientation": "ConstantOrientation PolynomialOrientation TabulatedOrientation",
        "orthophoto": "write_orthophoto",
        "registration": "register_chain",
        "sensor_models": "FrameModel LineScanModel",
        "solution": "ImageSolution PointSolution",
        "spice_source": "orientation_from_spice",
        "study": "read_image_study",
        "surfaces": "Sphere Terrain",
    },
)
