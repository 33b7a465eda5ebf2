"""Where a lander stands on the Moon, from Earth-based tracking, with how well it is known.

>>> import radioloc
>>> study = radioloc.read_study("examples/apollo15/apollo15.toml")  # doctest: +SKIP
>>> solution = radioloc.locate(study)  # doctest: +SKIP
>>> print(solution)  # doctest: +SKIP

Here are the names that most users need. What they rest on is in the packages, each with an ``__all__`` of its own:
:mod:`radioloc.measurements`, :mod:`radioloc.parameters`, :mod:`radioloc.media`, :mod:`radioloc.estimation`,
:mod:`radioloc.simulation`, :mod:`radioloc.studies`, :mod:`radioloc.io`, :mod:`radioloc.report`, :mod:`radioloc.earth`,
:mod:`radioloc.lunar`, :mod:`radioloc.ephemeris`, :mod:`radioloc.time` and :mod:`radioloc.errors`.
"""

import warnings as _warnings
from importlib import import_module as _import_module
from typing import Any as _Any

from radioloc._version import __version__
from radioloc.earth import StationCatalogue
from radioloc.errors import RadiolocError
from radioloc.estimation import Solution
from radioloc.io import read_observations, write_observations
from radioloc.lunar import LunarPosition
from radioloc.measurements import Observations
from radioloc.report import plot_links, plot_position, plot_residuals, write_report
from radioloc.studies import Study, read_study
from radioloc.studies.arcs import arcs
from radioloc.studies.covariance import covariance
from radioloc.studies.images import locate_images
from radioloc.studies.locate import locate, residuals
from radioloc.studies.monte_carlo import monte_carlo
from radioloc.studies.simulate import simulate
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
    "locate_images",
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

_MOVED = {
    name: home
    for home, names in {
        "earth": "Station",
        "ephemeris": "Trajectory",
        "errors": "ConvergenceError CoverageError FileFormatError InputError KernelError RadiolocWarning "
        "StationError",
        "measurements": "ChebyshevPredictor EquipmentDelays ExactPredictor Link PhysicalModel StationDelay TERMS "
        "active_terms prepare_predictor",
        "report": "ArcStudy MonteCarlo save_figure write_arcs write_monte_carlo write_terms",
        "studies": "EstimateChoice HeightPrior ModelChoice ObservationChoice Reference Weight arc_of",
        "time": "epochs_from_strings",
    }.items()
    for name in names.split()
}
"""Names that were here, and the package that has them."""


def __getattr__(name: str) -> _Any:
    if name not in _MOVED:
        raise AttributeError(f"module 'radioloc' has no attribute {name!r}")
    home = f"radioloc.{_MOVED[name]}"
    _warnings.warn(f"radioloc.{name} is now {home}.{name}", DeprecationWarning, stacklevel=2)
    return getattr(_import_module(home), name)
