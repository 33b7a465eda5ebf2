"""Fits of parameters to observations, and their uncertainty.

A :class:`ParameterSet` names what is solved for; ``radioloc.estimation.editing`` fits it to residuals without outliers;
``radioloc.results.build`` makes a :class:`~radioloc.results.Solution` of the outcome.
"""

from radioloc.estimation.combination import Ellipse, ReferenceComparison
from radioloc.estimation.gauss_markov import SeriesCorrelation, SeriesWeight, TimeCorrelation
from radioloc.estimation.observability import Correlation, Direction, Observability
from radioloc.estimation.statistics import FitStatistics, GroupStatistics, Residuals
from radioloc.estimation.status import FitStatus
from radioloc.labels import USED, Labels
from radioloc.parameters.parameter import Parameter, ParameterSet

__all__ = [
    "USED",
    "Correlation",
    "Direction",
    "Ellipse",
    "FitStatistics",
    "FitStatus",
    "GroupStatistics",
    "Labels",
    "Observability",
    "Parameter",
    "ParameterSet",
    "ReferenceComparison",
    "Residuals",
    "SeriesCorrelation",
    "SeriesWeight",
    "TimeCorrelation",
]
