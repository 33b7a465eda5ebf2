"""The types of results, with those that other packages add by entry points (group ``radioloc.results``)."""

from __future__ import annotations

from radioloc.errors import InputError
from radioloc.plugins import Registry
from radioloc.results.accuracy_map import AccuracyMap
from radioloc.results.comparison import Comparison, StateComparison
from radioloc.results.covariance import CovarianceStudy
from radioloc.results.monte_carlo import MonteCarlo
from radioloc.results.result import Result, ResultType
from radioloc.results.scores import Scores
from radioloc.results.solution import ORBIT_FILES, Solution
from radioloc.results.subsets import ArcStudy, LeaveOneOut
from radioloc.results.tables import POSITION_FILES

RESULTS = Registry(
    "radioloc.results",
    ResultType,
    (
        ResultType(
            "solution",
            Solution,
            ("residuals", "position", "correlations", "budget", "terms", "map"),
            (
                "solution.json",
                "residuals.csv",
                "terms.csv",
                "map.[ps][nv]g",
                *ORBIT_FILES,
                "orbits/*.[bo][spe][pm]",
            ),
        ),
        ResultType(
            "arcs",
            ArcStudy,
            ("figure2", "arcs", "map"),
            ("arcs.json", "states.csv", *POSITION_FILES, "[0-9]*h/solution.json", "[0-9]*h/residuals.csv"),
        ),
        ResultType("comparison", Comparison, ("comparison",), ("comparison.json", *POSITION_FILES)),
        ResultType("state_comparison", StateComparison, (), ("comparison.json", "states.csv")),
        ResultType(
            "monte_carlo", MonteCarlo, ("trials",), ("montecarlo.json", "trials.csv", "trials_[0-9]*.csv")
        ),
        ResultType(
            "covariance",
            CovarianceStudy,
            ("covariance",),
            ("covariance.json", "covariance.csv", "covariance_[0-9]*.csv"),
        ),
        ResultType(
            "accuracy_map",
            AccuracyMap,
            ("accuracy_map",),
            ("accuracy_map.json", "accuracy_map.csv", "accuracy_map.tif"),
        ),
        ResultType("scores", Scores, (), ("scores.json", "scores.md")),
        ResultType("leave_one_out", LeaveOneOut, (), ("leave_one_out.json", "leave_one_out.csv")),
    ),
)
"""Types of results by name."""


def result_type(result: Result) -> ResultType:
    """Return the declaration of the type of a result."""
    for entry in RESULTS.values():
        if isinstance(result, entry.type):
            return entry
    names = ", ".join(entry.type.__name__ for entry in RESULTS.values())
    raise InputError(f"expected a result ({names}), got a {type(result).__name__}")
