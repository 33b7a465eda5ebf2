"""Fitting parameters to observations, and saying how well they are known.

The order of work: a :class:`ParameterSet` names what is solved for; :func:`fit_with_editing` fits it to
residuals by :func:`fit_least_squares`, leaving outliers out; :func:`build_solution` puts the outcome
together as a :class:`Solution`.
"""

from radioloc.estimation.combination import Ellipse, ReferenceComparison
from radioloc.estimation.editing import EditedFit, fit_with_editing
from radioloc.estimation.gauss_markov import SeriesCorrelation, SeriesWeight, TimeCorrelation
from radioloc.estimation.least_squares import FitResult, FitStatus, fit_least_squares
from radioloc.estimation.linearization import DenseLinearization, Linearization, ResidualFunction
from radioloc.estimation.observability import Correlation, Direction, Observability, assess_observability
from radioloc.estimation.observation_noise import ALONE, ObservationNoise, SharedErrors
from radioloc.estimation.statistics import FitStatistics, GroupStatistics, Residuals
from radioloc.estimation.time_correlation import assess_time_correlation, fit_with_correlated_weights
from radioloc.estimation.variance_components import fit_with_variance_components
from radioloc.labels import USED, Labels
from radioloc.parameters.parameter import Parameter, ParameterSet

__all__ = [
    "ALONE",
    "USED",
    "Correlation",
    "DenseLinearization",
    "Direction",
    "EditedFit",
    "Ellipse",
    "FitResult",
    "FitStatistics",
    "FitStatus",
    "GroupStatistics",
    "Labels",
    "Linearization",
    "Observability",
    "ObservationNoise",
    "Parameter",
    "ParameterSet",
    "ReferenceComparison",
    "ResidualFunction",
    "Residuals",
    "SeriesCorrelation",
    "SeriesWeight",
    "SharedErrors",
    "TimeCorrelation",
    "assess_observability",
    "assess_time_correlation",
    "fit_least_squares",
    "fit_with_correlated_weights",
    "fit_with_editing",
    "fit_with_variance_components",
]
