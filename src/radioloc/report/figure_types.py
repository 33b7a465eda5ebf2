"""The figures of results, with those that other packages add by entry points (group ``radioloc.figures``)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from radioloc.plugins import registry
from radioloc.report.estimate_figures import has_correlations, plot_budget, plot_correlations
from radioloc.report.map_figures import plot_map
from radioloc.report.position_figures import plot_arcs, plot_comparison, plot_position
from radioloc.report.residual_figures import plot_distribution, plot_links, plot_residuals
from radioloc.report.study_figures import (
    plot_covariance,
    plot_covariance_on_arc,
    plot_error_by_length,
    plot_trials,
)
from radioloc.results.cards import BUDGET, OBSERVABILITY, POSITION, RESIDUALS, RESULT
from radioloc.results.covariance import CovarianceStudy
from radioloc.results.monte_carlo import MonteCarlo
from radioloc.results.registry import result_type
from radioloc.results.result import Result
from radioloc.results.solution import Solution
from radioloc.results.subsets import ArcStudy

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class FigureType:
    """Declaration of a figure of results.

    Parameters
    ----------
    name : str
        Unique name, by which result types list the figure.
    draw : callable
        Function of the result that returns the figure, several of one kind, or None if the result has nothing to draw.
    caption : str
        What the figure shows, for readers who do not see it.
    section : str
        Section of the page.
    file : str
        File name without ending, if it is not the name. Further figures of one kind are numbered: ``arcs_2``.
    page_only : bool
        Whether the page shows the figure and the folder has no file of it.
    photograph : bool
        Whether the figure consists of photographs, which the page shows on a dark ground.
    """

    name: str
    draw: Callable[[Any], Figure | Iterable[Figure] | None]
    caption: str
    section: str = RESULT
    file: str = ""
    page_only: bool = False
    photograph: bool = False

    @property
    def stem(self) -> str:
        """File name without ending."""
        return self.file or self.name

    def drawn(self, result: Any) -> Iterator[tuple[str, Figure]]:
        """Draw the figures of a result; yield each with its file name without ending."""
        figures = self.draw(result)
        if figures is None:
            return
        for number, figure in enumerate(figures if isinstance(figures, Iterable) else (figures,), start=1):
            yield self.stem if number == 1 else f"{self.stem}_{number}", figure


def figures_of(result: Result) -> list[FigureType]:
    """Return the declared figures of the type of a result, in order."""
    return [FIGURES[name] for name in result_type(result).figures]


def _draw_residuals(solution: Solution) -> Figure:
    rows = solution.residuals
    # Ranges and Doppler of a station have no common scale, and a delay belongs to two stations.
    apart = len(rows.types.present()) > 1 or any("<" in path for path in rows.paths.present())
    return (plot_links if apart else plot_residuals)(solution)


def _draw_position(solution: Solution) -> Figure | None:
    return plot_position(solution) if solution.position_estimated and solution.position_determined else None


def _draw_correlations(solution: Solution) -> Figure | None:
    return plot_correlations(solution) if has_correlations(solution) else None


def _draw_distribution(solution: Solution) -> Figure | None:
    rows = solution.residuals
    return plot_distribution(solution) if rows.elevation_deg is not None and rows.used.any() else None


def _draw_budget(solution: Solution) -> Figure | None:
    return plot_budget(solution) if solution.budget else None


def _draw_arcs(study: ArcStudy) -> Iterator[Figure]:
    return map(plot_arcs, study.by_target)


def _draw_map(result: Result) -> Figure | None:
    positions = [one.to_dict() | {"name": name} for name, one in result.positions().items()]
    return plot_map(positions) if positions else None


def _draw_trials(study: MonteCarlo) -> Figure | None:
    return plot_trials(study) if study.some_converged else None


def _draw_error_by_length(study: MonteCarlo) -> Figure | None:
    return plot_error_by_length(study) if study.some_converged else None


def _draw_covariance(study: CovarianceStudy) -> Figure | None:
    return plot_covariance(study) if study.determined else None


def _draw_covariance_on_arc(study: CovarianceStudy) -> Figure | None:
    return plot_covariance_on_arc(study) if study.longest.state is not None else None


FIGURES = registry(
    "radioloc.figures",
    FigureType,
    (
        FigureType("residuals", _draw_residuals, "residuals over time, by link", RESIDUALS),
        FigureType(
            "figure2",
            lambda study: plot_links(study.longest),
            "residuals of the longest arc over time, by link",
            RESIDUALS,
        ),
        FigureType(
            "distribution",
            _draw_distribution,
            "residuals over their sigmas against elevation, and their histogram",
            RESIDUALS,
        ),
        # Drawn by `write_report(terms_by=...)`: a solution has no terms.
        FigureType("terms", lambda _: None, "what each term of the model adds over time", RESIDUALS),
        FigureType(
            "arcs",
            _draw_arcs,
            "positions of the arcs with ellipses of 95 %, and each coordinate by the length of the arc",
        ),
        FigureType("budget", _draw_budget, "sigmas east, north and up by source of error", BUDGET),
        FigureType(
            "map",
            _draw_map,
            "map with error ellipses of one and three sigma, and where on the Moon it is",
            POSITION,
            page_only=True,
        ),
        FigureType(
            "position",
            _draw_position,
            "the estimate beside what it is compared with, with error ellipses",
            POSITION,
        ),
        FigureType(
            "correlations",
            _draw_correlations,
            "matrix of the correlations of estimated parameters",
            OBSERVABILITY,
        ),
        FigureType(
            "comparison",
            plot_comparison,
            "positions east and north of the benchmark, with ellipses of 95 %",
        ),
        FigureType(
            "trials", _draw_trials, "horizontal errors of the trials, with claimed and found ellipses of 95 %"
        ),
        FigureType(
            "error_by_length", _draw_error_by_length, "errors and claimed sigmas by length of the arc"
        ),
        FigureType("covariance", _draw_covariance, "sigmas by length of the arc, and what they are made of"),
        FigureType(
            "covariance_on_arc",
            _draw_covariance_on_arc,
            "sigmas of the orbit over the plan, radial, along and across, by length of the arc",
        ),
    ),
)
"""Figures by name."""
