"""Which figures a result has, by the names of their files."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from radioloc.estimation.solution import Solution
from radioloc.report.arc_study import ArcStudy
from radioloc.report.comparison import Comparison
from radioloc.report.covariance import CovarianceStudy
from radioloc.report.estimate_figures import can_be_drawn, plot_budget, plot_contours, plot_correlations
from radioloc.report.image_figures import plot_images
from radioloc.report.image_solution import ImageSolution
from radioloc.report.leave_one_out import LeaveOneOut
from radioloc.report.monte_carlo import MonteCarlo
from radioloc.report.point_solution import PointSolution
from radioloc.report.position_figures import plot_arcs, plot_comparison, plot_point, plot_position
from radioloc.report.residual_figures import plot_distribution, plot_links, plot_residuals
from radioloc.report.study_figures import (
    plot_covariance,
    plot_covariance_on_arc,
    plot_error_by_length,
    plot_trials,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Result = (
    Solution
    | ArcStudy
    | ImageSolution
    | PointSolution
    | Comparison
    | MonteCarlo
    | CovarianceStudy
    | LeaveOneOut
)
"""What has an output folder."""


def figures_of(result: Result) -> dict[str, Callable[[], Figure] | None]:
    """What draws each figure of a result, by name; None for those that such a result can have, and this one has not."""
    match result:
        case Solution():
            return _of_a_solution(result)
        case ArcStudy():
            return {"figure2": partial(plot_links, result.longest), "arcs": partial(plot_arcs, result)}
        case ImageSolution():
            return {"images": partial(plot_images, result), "position": None}
        case PointSolution():
            return {"images": None, "position": partial(plot_point, result)}
        case Comparison():
            return {"comparison": partial(plot_comparison, result)}
        case MonteCarlo():
            some = bool((result["converged"] == 1.0).any())
            drawn = {"trials": plot_trials, "error_by_length": plot_error_by_length}
            return {name: partial(draw, result) if some else None for name, draw in drawn.items()}
        case CovarianceStudy():
            on_arc = result.longest.state is not None
            return {
                "covariance": partial(plot_covariance, result) if result.determined else None,
                "covariance_on_arc": partial(plot_covariance_on_arc, result) if on_arc else None,
            }
        case LeaveOneOut():
            return {}


def _of_a_solution(solution: Solution) -> dict[str, Callable[[], Figure] | None]:
    rows = solution.residuals
    # Ranges and Doppler of a station have no common scale, and a delay belongs to two stations.
    apart = len(rows.types.present()) > 1 or any("<" in path for path in rows.paths.present())
    located = solution.position_estimated and solution.position_determined
    over_elevation = rows.elevation_deg is not None and rows.used.any()
    correlations, contours = can_be_drawn(solution)
    return {
        "residuals": partial(plot_links if apart else plot_residuals, solution),
        "position": partial(plot_position, solution) if located else None,
        "correlations": partial(plot_correlations, solution) if correlations else None,
        "contours": partial(plot_contours, solution) if contours else None,
        "distribution": partial(plot_distribution, solution) if over_elevation else None,
        "budget": partial(plot_budget, solution) if solution.budget else None,
        "terms": None,  # only where they were asked for
    }
