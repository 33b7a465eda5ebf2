"""Where a lander stands on the Moon, from Earth-based tracking, with how well it is known.

>>> import radioloc
>>> study = radioloc.read_study("examples/apollo15/apollo15.toml")  # doctest: +SKIP
>>> solution = radioloc.locate(study)  # doctest: +SKIP
>>> print(solution)  # doctest: +SKIP

Here are the names that most users need. What they rest on is in the packages, each with an ``__all__`` of its own:
:mod:`radioloc.measurements`, :mod:`radioloc.parameters`, :mod:`radioloc.media`, :mod:`radioloc.estimation`,
:mod:`radioloc.simulation`, :mod:`radioloc.study`, :mod:`radioloc.jobs`, :mod:`radioloc.results`, :mod:`radioloc.io`,
:mod:`radioloc.report`, :mod:`radioloc.search`, :mod:`radioloc.earth`, :mod:`radioloc.lunar`, :mod:`radioloc.dynamics`,
:mod:`radioloc.imaging`, :mod:`radioloc.ephemeris`, :mod:`radioloc.kernels`, :mod:`radioloc.time` and
:mod:`radioloc.errors`.
"""

from typing import TYPE_CHECKING

from radioloc._version import __version__
from radioloc.lazy import lazy_exports as _lazy_exports

if TYPE_CHECKING:  # what is here is imported when it is first used
    from radioloc.earth import StationCatalogue
    from radioloc.errors import RadiolocError
    from radioloc.io import read_observations, write_observations
    from radioloc.jobs.arcs import arcs
    from radioloc.jobs.covariance import covariance
    from radioloc.jobs.locate import locate, residuals
    from radioloc.jobs.monte_carlo import monte_carlo
    from radioloc.jobs.simulate import simulate
    from radioloc.lunar import LunarPosition
    from radioloc.measurements import Observations
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
    "arcs",
    "covariance",
    "locate",
    "monte_carlo",
    "plot_links",
    "plot_position",
    "plot_residuals",
    "read_observations",
    "read_study",
    "residuals",
    "simulate",
    "write_observations",
    "write_report",
]

__getattr__, __dir__ = _lazy_exports(
    __name__,
    {
        "earth": "StationCatalogue",
        "errors": "RadiolocError",
        "results": "Solution",
        "io": "read_observations write_observations",
        "lunar": "LunarPosition",
        "measurements": "Observations",
        "report": "plot_links plot_position plot_residuals write_report",
        "study": "Study read_study",
        "jobs.arcs": "arcs",
        "jobs.covariance": "covariance",
        "jobs.locate": "locate residuals",
        "jobs.monte_carlo": "monte_carlo",
        "jobs.simulate": "simulate",
        "time": "Epochs",
    },
)
