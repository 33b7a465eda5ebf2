"""Where a lander stands on the Moon, from Earth-based tracking, with how well it is known.

>>> import radioloc
>>> study = radioloc.read_study("examples/apollo15/apollo15.toml")  # doctest: +SKIP
>>> solution = radioloc.locate(study)  # doctest: +SKIP
>>> print(solution)  # doctest: +SKIP
"""

from radioloc._version import __version__
from radioloc.earth.stations import Station, StationCatalogue
from radioloc.ephemeris import Trajectory
from radioloc.errors import (
    ConvergenceError,
    CoverageError,
    FileFormatError,
    InputError,
    KernelError,
    RadiolocError,
    RadiolocWarning,
    StationError,
)
from radioloc.estimation import Solution
from radioloc.io.detect import read_observations
from radioloc.io.write import write_observations
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.chebyshev_predictor import ChebyshevPredictor
from radioloc.measurements.equipment_delays import EquipmentDelays, StationDelay
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.link import Link
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.terms import TERMS, active_terms
from radioloc.report import (
    ArcStudy,
    MonteCarlo,
    plot_links,
    plot_position,
    plot_residuals,
    save_figure,
    write_arcs,
    write_monte_carlo,
    write_report,
    write_terms,
)
from radioloc.studies.arcs import arcs
from radioloc.studies.locate import arc_of, locate, residuals
from radioloc.studies.monte_carlo import monte_carlo
from radioloc.studies.simulate import simulate
from radioloc.studies.study import (
    EstimateChoice,
    HeightPrior,
    ModelChoice,
    ObservationChoice,
    Reference,
    Study,
)
from radioloc.studies.study_file import read_study
from radioloc.studies.weights import Weight
from radioloc.time import Epochs, epochs_from_strings

__all__ = [
    "TERMS",
    "ArcStudy",
    "ChebyshevPredictor",
    "ConvergenceError",
    "CoverageError",
    "Epochs",
    "EquipmentDelays",
    "EstimateChoice",
    "ExactPredictor",
    "FileFormatError",
    "HeightPrior",
    "InputError",
    "KernelError",
    "Link",
    "LunarPosition",
    "ModelChoice",
    "MonteCarlo",
    "ObservationChoice",
    "Observations",
    "PhysicalModel",
    "RadiolocError",
    "RadiolocWarning",
    "Reference",
    "Solution",
    "Station",
    "StationCatalogue",
    "StationDelay",
    "StationError",
    "Study",
    "Trajectory",
    "Weight",
    "__version__",
    "active_terms",
    "arc_of",
    "arcs",
    "epochs_from_strings",
    "locate",
    "monte_carlo",
    "plot_links",
    "plot_position",
    "plot_residuals",
    "prepare_predictor",
    "read_observations",
    "read_study",
    "residuals",
    "save_figure",
    "simulate",
    "write_arcs",
    "write_monte_carlo",
    "write_observations",
    "write_report",
    "write_terms",
]
