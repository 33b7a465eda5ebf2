"""Rendering of results: figures, the page, and the files of an output folder.

Figures are of matplotlib: each shows itself in a notebook, and :func:`save_figure` writes it. With `ax` a figure is
drawn in given axes, one of several panels in place of axes of a grid.
"""

from radioloc.report.figure_types import FIGURES, FigureType, plot
from radioloc.report.figures import save_figure
from radioloc.report.files import write_report
from radioloc.report.map_figures import plot_map
from radioloc.report.page import write_html
from radioloc.report.position_figures import plot_position
from radioloc.report.residual_figures import plot_links, plot_residuals, plot_terms

__all__ = [
    "FIGURES",
    "FigureType",
    "plot",
    "plot_links",
    "plot_map",
    "plot_position",
    "plot_residuals",
    "plot_terms",
    "save_figure",
    "write_html",
    "write_report",
]
