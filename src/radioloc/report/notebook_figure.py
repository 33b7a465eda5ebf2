"""The class of the figures; it imports matplotlib, so only :func:`~radioloc.report.figures.new_figure` imports it."""

from __future__ import annotations

from io import BytesIO
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


class NotebookFigure(Figure):
    """A figure that shows itself where it is the last line of a notebook cell, whether or not pyplot is imported.

    Notebooks show a plain ``Figure`` only once pyplot, with its global state and its choice of a window system, has
    been imported.
    """

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        image = BytesIO()
        self.savefig(image, format="png")
        return image.getvalue()
