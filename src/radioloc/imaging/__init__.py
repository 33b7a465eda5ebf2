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
    from radioloc.imaging.frames import find_mask, read_frame, read_mask
    from radioloc.imaging.ground_points import (
        ImagePoint,
        ImagePointSigmas,
        ground_to_image,
        image_to_ground,
        locate_image_point,
    )
    from radioloc.imaging.homography import Homography, HomographyFit, fit_homography
    from radioloc.imaging.image_chain import Frame, FrameStatus
    from radioloc.imaging.isd import SupportData, read_isd
    from radioloc.imaging.location import locate_images
    from radioloc.imaging.matching import Detector
    from radioloc.imaging.orientation import ConstantOrientation, PolynomialOrientation, TabulatedOrientation
    from radioloc.imaging.orthophoto import write_mosaic, write_orthophoto
    from radioloc.imaging.registration import GroundPoint, RegisteredFrame, Registration, register_chain
    from radioloc.imaging.sensor_models import FrameModel, LineScanModel
    from radioloc.imaging.solution import ImageSolution, PointSolution
    from radioloc.imaging.spice_source import orientation_from_spice
    from radioloc.imaging.stereo import StereoPair, body_position, resect
    from radioloc.imaging.study import (
        CameraChoice,
        ImageChoice,
        ImagePointChoice,
        ImageStudy,
        Landmark,
        PointStudy,
        StereoChoice,
        read_image_study,
    )
    from radioloc.imaging.surfaces import Plane, Sphere, Terrain
    from radioloc.imaging.tie_points import Measurement, TiePoint

__all__ = [
    "Camera",
    "CameraChoice",
    "ConstantOrientation",
    "Detector",
    "Distortion",
    "Frame",
    "FrameModel",
    "FrameStatus",
    "GroundPoint",
    "Homography",
    "HomographyFit",
    "ImageChoice",
    "ImagePoint",
    "ImagePointChoice",
    "ImagePointSigmas",
    "ImageSolution",
    "ImageStudy",
    "Landmark",
    "LineScanModel",
    "Measurement",
    "Plane",
    "PointSolution",
    "PointStudy",
    "PolynomialOrientation",
    "RegisteredFrame",
    "Registration",
    "Sphere",
    "StereoChoice",
    "StereoPair",
    "SupportData",
    "TabulatedOrientation",
    "Terrain",
    "TiePoint",
    "body_position",
    "find_mask",
    "fit_homography",
    "ground_to_image",
    "image_to_ground",
    "locate_image_point",
    "locate_images",
    "orientation_from_spice",
    "plot_images",
    "plot_point",
    "read_frame",
    "read_image_study",
    "read_isd",
    "read_mask",
    "register_chain",
    "resect",
    "write_mosaic",
    "write_orthophoto",
]

__getattr__, __dir__ = _lazy_exports(
    __name__,
    {
        "cameras": "Camera",
        "distortion": "Distortion",
        "figures": "plot_images plot_point",
        "frames": "find_mask read_frame read_mask",
        "ground_points": "ImagePoint ImagePointSigmas ground_to_image image_to_ground locate_image_point",
        "homography": "Homography HomographyFit fit_homography",
        "image_chain": "Frame FrameStatus",
        "isd": "SupportData read_isd",
        "location": "locate_images",
        "matching": "Detector",
        "orientation": "ConstantOrientation PolynomialOrientation TabulatedOrientation",
        "orthophoto": "write_mosaic write_orthophoto",
        "registration": "GroundPoint RegisteredFrame Registration register_chain",
        "sensor_models": "FrameModel LineScanModel",
        "solution": "ImageSolution PointSolution",
        "spice_source": "orientation_from_spice",
        "stereo": "StereoPair body_position resect",
        "study": "CameraChoice ImageChoice ImagePointChoice ImageStudy Landmark PointStudy StereoChoice "
        "read_image_study",
        "surfaces": "Plane Sphere Terrain",
        "tie_points": "Measurement TiePoint",
    },
)
