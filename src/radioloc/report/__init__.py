"""Everything that shows results: cards, tables, figures, and the files of an output folder."""

from radioloc.report.estimate_figures import plot_budget, plot_correlations
from radioloc.report.figure_types import FIGURES, FigureType
from radioloc.report.figures import save_figure
from radioloc.report.files import write_report
from radioloc.report.map_figures import plot_map
from radioloc.report.page import write_html
from radioloc.report.position_figures import plot_arcs, plot_comparison, plot_position
from radioloc.report.residual_figures import plot_distribution, plot_links, plot_residuals, plot_terms
from radioloc.report.station_figures import plot_visibility
from radioloc.report.study_figures import (
    plot_covariance,
    plot_covariance_on_arc,
    plot_error_by_length,
    plot_trials,
)

__all__ = [
    "FIGURES",
    "FigureType",
    "plot_arcs",
    "plot_budget",
    "plot_comparison",
    "plot_correlations",
    "plot_covariance",
    "plot_covariance_on_arc",
    "plot_distribution",
    "plot_error_by_length",
    "plot_links",
    "plot_map",
    "plot_position",
    "plot_residuals",
    "plot_terms",
    "plot_trials",
    "plot_visibility",
    "save_figure",
    "write_html",
    "write_report",
]
