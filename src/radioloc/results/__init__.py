"""Results of jobs: solutions, arcs, trials, covariance plans and comparisons, with their statistics and tables."""

from radioloc.results.accuracy_map import AccuracyMap
from radioloc.results.cards import Card, Field
from radioloc.results.comparison import Comparison
from radioloc.results.covariance import CovarianceStudy
from radioloc.results.estimate import LocatedEstimate
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
    "LocatedEstimate",
    "MonteCarlo",
    "Raster",
    "Result",
    "ResultType",
    "Solution",
    "Table",
    "contents_by_target",
]
