"""Results of jobs: solutions, arcs, trials, covariance plans and comparisons, with their statistics and tables."""

from radioloc.results.build import build_solution, compare_with
from radioloc.results.comparison import Comparison
from radioloc.results.covariance import CovarianceStudy
from radioloc.results.monte_carlo import MonteCarlo
from radioloc.results.predictions import LightTimes
from radioloc.results.solution import Solution
from radioloc.results.subsets import ArcStudy
from radioloc.results.tables import TextTable, solution_table

__all__ = [
    "ArcStudy",
    "Comparison",
    "CovarianceStudy",
    "LightTimes",
    "MonteCarlo",
    "Solution",
    "TextTable",
    "build_solution",
    "compare_with",
    "solution_table",
]
