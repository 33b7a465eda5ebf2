"""Results of jobs: solutions, arcs, trials, covariance plans and comparisons, with their statistics and tables."""

from radioloc.results.build import build_solution, compare_with
from radioloc.results.cards import Card, Field
from radioloc.results.comparison import Comparison
from radioloc.results.covariance import CovarianceStudy
from radioloc.results.monte_carlo import MonteCarlo
from radioloc.results.predictions import LightTimes
from radioloc.results.registry import RESULTS
from radioloc.results.result import Result, ResultType, Table
from radioloc.results.solution import Solution
from radioloc.results.subsets import ArcStudy
from radioloc.results.tables import TextTable, contents_by_target, solution_table

__all__ = [
    "RESULTS",
    "ArcStudy",
    "Card",
    "Comparison",
    "CovarianceStudy",
    "Field",
    "LightTimes",
    "MonteCarlo",
    "Result",
    "ResultType",
    "Solution",
    "Table",
    "TextTable",
    "build_solution",
    "compare_with",
    "contents_by_target",
    "solution_table",
]
