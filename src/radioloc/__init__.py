"""Locate landers on the Moon from Earth-based tracking, with the uncertainty of the position.

>>> import radioloc
>>> study = radioloc.read_study("examples/apollo15/apollo15.toml")  # doctest: +SKIP
>>> solution = radioloc.locate(study)  # doctest: +SKIP
>>> print(solution)  # doctest: +SKIP

This package has the jobs and what most users need. The packages that ``dir(radioloc)`` lists have the rest; each
declares its public names in ``__all__``.
"""

from typing import TYPE_CHECKING

from radioloc._version import __version__
from radioloc.lazy import lazy_exports as _lazy_exports

if TYPE_CHECKING:  # imported on first use
    from radioloc.earth import StationCatalogue
    from radioloc.errors import RadiolocError
    from radioloc.io import read_observations, write_observations
    from radioloc.jobs.accuracy_map import accuracy_map
    from radioloc.jobs.arcs import arcs, leave_one_out
    from radioloc.jobs.benchmark import score
    from radioloc.jobs.comparison import compare
    from radioloc.jobs.covariance import covariance
    from radioloc.jobs.locate import compute_residuals, locate
    from radioloc.jobs.monte_carlo import monte_carlo
    from radioloc.jobs.passes import light_times, visibility
    from radioloc.jobs.simulate import simulate
    from radioloc.jobs.verification import verify
    from radioloc.lunar import LunarPosition
    from radioloc.measurements import Observations
    from radioloc.plugins import register
    from radioloc.report import plot_links, plot_position, plot_residuals, write_report
    from radioloc.results import Solution
    from radioloc.study import Study, read_study
    from radioloc.time import Epochs

__all__ = [
    "Epochs",
    "LunarPosition",
    "Observations",
    "RadiolocError",
    "Solution",
    "StationCatalogue",
    "Study",
    "__version__",
    "accuracy_map",
    "arcs",
    "compare",
    "compute_residuals",
    "covariance",
    "leave_one_out",
    "light_times",
    "locate",
    "monte_carlo",
    "plot_links",
    "plot_position",
    "plot_residuals",
    "read_observations",
    "read_study",
    "register",
    "score",
    "simulate",
    "verify",
    "visibility",
    "write_observations",
    "write_report",
]

__getattr__, __dir__ = _lazy_exports(
    __name__,
    {
        "earth": "StationCatalogue",
        "errors": "RadiolocError",
        "io": "read_observations write_observations",
        "jobs.accuracy_map": "accuracy_map",
        "jobs.arcs": "arcs leave_one_out",
        "jobs.benchmark": "score",
        "jobs.comparison": "compare",
        "jobs.covariance": "covariance",
        "jobs.locate": "compute_residuals locate",
        "jobs.monte_carlo": "monte_carlo",
        "jobs.passes": "light_times visibility",
        "jobs.simulate": "simulate",
        "jobs.verification": "verify",
        "lunar": "LunarPosition",
        "measurements": "Observations",
        "plugins": "register",
        "report": "plot_links plot_position plot_residuals write_report",
        "results": "Solution",
        "study": "Study read_study",
        "time": "Epochs",
    },
    "cli dynamics earth ephemeris errors estimation imaging io jobs kernels lunar measurements media noise "
    "parameters report results search simulation study targets time",
)
