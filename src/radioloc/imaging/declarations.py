"""Results and figures of images, for the registries that entry points fill."""

from __future__ import annotations

from radioloc.imaging.figures import plot_images, plot_point
from radioloc.imaging.products import FILES
from radioloc.imaging.solution import ImageSolution, PointSolution
from radioloc.report.figure_types import FigureType
from radioloc.results.cards import POSITION
from radioloc.results.result import ResultType

IMAGES_RESULT = ResultType("images", ImageSolution, ("images", "map"), ("solution.json", *FILES))
POINT_RESULT = ResultType("image_point", PointSolution, ("image_position", "map"), ("solution.json",))

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
