"""The figures of results, with those that other packages add by entry points (group ``radioloc.figures``)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from radioloc.errors import InputError
from radioloc.plugins import Registry
from radioloc.report.error_figures import plot_budget, plot_correlations, plot_covariance, plot_trials
from radioloc.report.figures import NothingToDrawError
from radioloc.report.map_figures import plot_accuracy_map, plot_map
from radioloc.report.position_figures import plot_arcs, plot_comparison, plot_position
from radioloc.report.residual_figures import plot_links, plot_residuals
from radioloc.results.cards import BUDGET, OBSERVABILITY, POSITION, RESIDUALS, RESULT
from radioloc.results.registry import result_type
from radioloc.results.result import Result
from radioloc.results.solution import Solution

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class FigureType:
    """Declaration of a figure of results."""

    name: str  #: unique name, by which result types list the figure
    #: Function of the result, and of ``ax`` if the figure can be drawn in axes given, that returns the figure,
    #: several of one kind, or None if the result has nothing to draw.
    draw: Callable[..., Figure | Iterable[Figure] | None]
    caption: str  #: text alternative of the figure
    section: str = RESULT  #: section of the page
    #: File name without ending, if it is not the name. Further figures of one kind are numbered: ``arcs_2``.
    file: str = ""
    page_only: bool = False  #: whether the page shows the figure and the folder has no file of it
    #: Whether the figure consists of photographs, which the page shows on a dark ground.
    photograph: bool = False

    @property
    def stem(self) -> str:
        """File name without ending."""
        return self.file or self.name

    def drawn(self, result: Any) -> Iterator[tuple[str, Figure]]:
        """Draw the figures of a result; yield each with its file name without ending."""
        try:
            for number, figure in enumerate(self._figures(self.draw(result)), start=1):
                yield self.stem if number == 1 else f"{self.stem}_{number}", figure
        except NothingToDrawError:
            return

    @staticmethod
    def _figures(drawn: Figure | Iterable[Figure] | None) -> Iterable[Figure]:
        return () if drawn is None else drawn if isinstance(drawn, Iterable) else (drawn,)


def plot(result: Result, name: str, ax: Axes | None = None) -> Figure:
    """Draw a figure of a result.

    Parameters
    ----------
    result : Solution, ArcStudy, MonteCarlo, CovarianceStudy, Comparison, ImageSolution or PointSolution
        Result of a job, or of a type that another package registers.
    name : str
        File name of the figure without ending, such as ``"budget"``.
    ax : matplotlib.axes.Axes, optional
        Axes to draw in, in place of a figure of its own. A figure of several panels takes their place in the grid that
        they are of.

    Raises
    ------
    InputError
        Such results have no figure of this name, or this result has nothing to draw.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> radioloc.report.plot(solution, "budget").axes[0].get_xlabel()
    '1 sigma (cm); beside the bars: 3D'
    """
    declared = {figure_type.stem: figure_type for figure_type in available_figures(result)}
    if name not in declared:
        names = ", ".join(declared) or "none"
        raise InputError(f"figure of a {type(result).__name__}: expected one of {names}, got {name!r}")
    draw = declared[name].draw
    for figure in FigureType._figures(draw(result) if ax is None else draw(result, ax=ax)):
        return figure
    raise NothingToDrawError(f"{name}: this {type(result).__name__} has nothing to draw")


def available_figures(result: Result) -> list[FigureType]:
    """Return the declared figures of the type of a result, in order."""
    return [FIGURES[name] for name in result_type(result).figures]


def _draw_residuals(solution: Solution, ax: Axes | None = None) -> Figure:
    rows = solution.residuals
    # Ranges and Doppler of a station have no common scale, and a delay belongs to two stations.
    by_type = len(rows.types.present()) > 1 or any("<" in path for path in rows.paths.present())
    return (plot_links if by_type else plot_residuals)(solution, ax=ax)


def _draw_map(result: Result, ax: Axes | None = None) -> Figure | None:
    positions = [place.to_dict() | {"name": name} for name, place in result.positions().items()]
    return plot_map(positions, ax=ax) if positions else None


FIGURES = Registry(
    "radioloc.figures",
    FigureType,
    (
        FigureType("residuals", _draw_residuals, "residuals over time, by link", RESIDUALS),
        FigureType(
            "figure2",
            lambda study, ax=None: plot_links(study.longest, ax=ax),
            "residuals of the longest arc over time, by link",
            RESIDUALS,
        ),
        # Drawn by `write_report(terms_by=...)`: a solution has no terms.
        FigureType("terms", lambda _, ax=None: None, "what each term of the model adds over time", RESIDUALS),
        FigureType(
            "arcs",
            lambda study, ax=None: (plot_arcs(of_target, ax) for of_target in study.by_target),
            "positions of the arcs with ellipses of 95 %, and each coordinate by the length of the arc",
        ),
        FigureType("budget", plot_budget, "sigmas east, north and up by source of error", BUDGET),
        FigureType(
            "map",
            _draw_map,
            "map with error ellipses of one and three sigma, and where on the Moon it is",
            POSITION,
            page_only=True,
        ),
        FigureType(
            "position",
            plot_position,
            "the estimate beside what it is compared with, with error ellipses",
            POSITION,
        ),
        FigureType(
            "correlations",
            plot_correlations,
            "matrix of the correlations of estimated parameters",
            OBSERVABILITY,
        ),
        FigureType(
            "comparison", plot_comparison, "positions east and north of the benchmark, with ellipses of 95 %"
        ),
        FigureType(
            "trials", plot_trials, "horizontal errors of the trials, with claimed and found ellipses of 95 %"
        ),
        FigureType("covariance", plot_covariance, "sigmas by length of the arc, and what they are made of"),
        FigureType(
            "accuracy_map",
            plot_accuracy_map,
            "95 % radius of the position over landing sites, with the lunar graticule",
        ),
    ),
)
"""Figures by name."""
