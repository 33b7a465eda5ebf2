"""Results of jobs: solutions, arcs, trials, covariance plans and comparisons, with their statistics and tables."""

from typing import TYPE_CHECKING

from radioloc.lazy import lazy_exports as _lazy_exports

if TYPE_CHECKING:  # imported on first use
    from radioloc.results.accuracy_map import AccuracyMap
    from radioloc.results.cards import Card, Field
    from radioloc.results.comparison import Comparison
    from radioloc.results.covariance import CovarianceStudy
    from radioloc.results.monte_carlo import MonteCarlo
    from radioloc.results.predictions import LightTimes
    from radioloc.results.registry import RESULTS
    from radioloc.results.result import Raster, Result, ResultType, Table
    from radioloc.results.solution import Solution
    from radioloc.results.subsets import ArcStudy
    from radioloc.results.tables import contents_by_target

__all__ = [
    "RESULTS",
    "AccuracyMap",
    "ArcStudy",
    "Card",
    "Comparison",
    "CovarianceStudy",
    "Field",
    "LightTimes",
    "MonteCarlo",
    "Raster",
    "Result",
    "ResultType",
    "Solution",
    "Table",
    "contents_by_target",
]

__getattr__, __dir__ = _lazy_exports(
    __name__,
    {
        "accuracy_map": "AccuracyMap",
        "cards": "Card Field",
        "comparison": "Comparison",
        "covariance": "CovarianceStudy",
        "monte_carlo": "MonteCarlo",
        "predictions": "LightTimes",
        "registry": "RESULTS",
        "result": "Raster Result ResultType Table",
        "solution": "Solution",
        "subsets": "ArcStudy",
        "tables": "contents_by_target",
    },
)
