"""Images: cameras and their orientation, from pixels to the ground and back.

A pixel is (sample, line), to the right and down; the centre of the first pixel is (0, 0). Points on the Moon are in
mean-Earth axes, m, unless a name says otherwise.
"""

from typing import TYPE_CHECKING

from radioloc.lazy import lazy_exports as _lazy_exports

if TYPE_CHECKING:  # these modules are imported on first use
    from radioloc.imaging.cameras import Camera
    from radioloc.imaging.distortion import Distortion
    from radioloc.imaging.figures import plot_images, plot_point
    from radioloc.imaging.ground_points import ImagePointSigmas, locate_image_point
    from radioloc.imaging.isd import read_isd
    from radioloc.imaging.location import locate_images
    from radioloc.imaging.orientation import ConstantOrientation, TabulatedOrientation
    from radioloc.imaging.orthophoto import write_orthophoto
    from radioloc.imaging.sensor_models import FrameModel, LineScanModel
    from radioloc.imaging.solution import ImageSolution, PointSolution
    from radioloc.imaging.study import read_image_study
    from radioloc.imaging.surfaces import Sphere, Terrain

__all__ = [
    "Camera",
    "ConstantOrientation",
    "Distortion",
    "FrameModel",
    "ImagePointSigmas",
    "ImageSolution",
    "LineScanModel",
    "PointSolution",
    "Sphere",
    "TabulatedOrientation",
    "Terrain",
    "locate_image_point",
    "locate_images",
    "plot_images",
    "plot_point",
    "read_image_study",
    "read_isd",
    "write_orthophoto",
]

__getattr__, __dir__ = _lazy_exports(
    __name__,
    {
        "cameras": "Camera",
        "distortion": "Distortion",
        "figures": "plot_images plot_point",
        "ground_points": "ImagePointSigmas locate_image_point",
        "isd": "read_isd",
        "location": "locate_images",
        "orientation": "ConstantOrientation TabulatedOrientation",
        "orthophoto": "write_orthophoto",
        "sensor_models": "FrameModel LineScanModel",
        "solution": "ImageSolution PointSolution",
        "study": "read_image_study",
        "surfaces": "Sphere Terrain",
    },
)
