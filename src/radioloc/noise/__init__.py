"""Noise of the observations: their covariance R as a sum of terms, and the whiteners that its structure allows."""

from radioloc.noise.covariance import (
    ALONE,
    DopplerPhase,
    GaussMarkov,
    NoiseTerm,
    ObservationCovariance,
    SharedAtEpoch,
    White,
)
from radioloc.noise.processes import NONE, Process
from radioloc.noise.whitening import StructuredWhitener, TransposableWhitener, Whitener

__all__ = [
    "ALONE",
    "NONE",
    "DopplerPhase",
    "GaussMarkov",
    "NoiseTerm",
    "ObservationCovariance",
    "Process",
    "SharedAtEpoch",
    "StructuredWhitener",
    "TransposableWhitener",
    "White",
    "Whitener",
]
