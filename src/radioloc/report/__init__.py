"""Everything that shows results: cards, tables, figures, and the files of an output folder."""

from radioloc.report.figures import save_figure
from radioloc.report.position_figures import plot_position
from radioloc.report.residual_figures import plot_links, plot_residuals

__all__ = ["plot_links", "plot_position", "plot_residuals", "save_figure"]
