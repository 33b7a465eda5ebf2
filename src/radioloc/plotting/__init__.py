"""Figures, drawn with matplotlib, which is imported only when a figure is asked for.

Figures are made without pyplot: nothing global changes, no window opens, and they work without a display. In a
notebook each shows itself as the last line of a cell.
"""

from radioloc.plotting.figures import save_figure
from radioloc.plotting.links import plot_links
from radioloc.plotting.position import plot_position
from radioloc.plotting.residuals import plot_residuals

__all__ = ["plot_links", "plot_position", "plot_residuals", "save_figure"]
