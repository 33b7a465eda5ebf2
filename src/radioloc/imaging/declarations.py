"""Results and figures of images, for the registries that entry points fill."""

from __future__ import annotations

from radioloc.imaging.base_map import BaseMap
from radioloc.imaging.figures import plot_base_map, plot_images, plot_point, plot_stereo
from radioloc.imaging.products import FILES
from radioloc.imaging.solution import ImageSolution, PointSolution
from radioloc.imaging.stereo_points import StereoPoints
from radioloc.report.figure_types import FigureType
from radioloc.results.cards import POSITION
from radioloc.results.result import ResultType

IMAGES_RESULT = ResultType("images", ImageSolution, ("images", "map"), ("solution.json", *FILES))
POINT_RESULT = ResultType("image_point", PointSolution, ("image_position", "map"), ("solution.json",))
STEREO_RESULT = ResultType(
    "stereo_pair", StereoPoints, ("stereo",), ("stereo_points.json", "points.csv", "points.ply")
)
BASE_MAP_RESULT = ResultType("base_map", BaseMap, ("base_map",), ("base_map.json", "tie_points.csv"))

IMAGES_FIGURE = FigureType(
    "images",
    plot_images,
    "the images on the map, from the ground of the highest image down to the lander",
    photograph=True,
)
POINT_FIGURE = FigureType(
    "image_position",
    plot_point,
    "the estimate and its references with error ellipses",
    POSITION,
    file="position",
)
BASE_MAP_FIGURE = FigureType(
    "base_map",
    plot_base_map,
    "the mosaic, and the residuals of the tie points with the numbers of the images",
    photograph=True,
)
STEREO_FIGURE = FigureType(
    "stereo",
    plot_stereo,
    "the points of a stereo pair from above, with the chosen features and their distances",
)
