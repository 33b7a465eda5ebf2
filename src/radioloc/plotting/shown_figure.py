"""The class of the figures; imports matplotlib, so import this only where one is made."""

from __future__ import annotations

from io import BytesIO

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


class ShownFigure(Figure):
    """A figure that shows itself where it is the last line of a notebook cell, whether or not pyplot is imported.

    Notebooks show a plain ``Figure`` only once pyplot, with its global state and its choice of a window system, has
    been imported.
    """

    def _repr_png_(self) -> bytes:
        if not hasattr(self.canvas, "buffer_rgba"):  # the user gave it to a canvas of another kind
            FigureCanvasAgg(self)
        image = BytesIO()
        self.savefig(image, format="png")
        return image.getvalue()
