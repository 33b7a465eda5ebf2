"""Figure: a bar for the largest residual of each path."""

from radioloc.report import FigureType


def draw(result):
    from matplotlib.figure import Figure

    figure = Figure(layout="constrained")
    axes = figure.add_subplot(ylabel="largest residual, m")
    axes.bar([*result.largest_m], [*result.largest_m.values()])
    axes.axhline(result.limit_m)
    return figure


RESIDUAL_BARS = FigureType("largest_residuals", draw, caption="The largest residual of each path.")
