"""Which evaluation an arc gets: every observation computed by itself, or dense series interpolated."""

from __future__ import annotations

from collections.abc import Sequence

from radioloc.errors import InputError
from radioloc.measurements.chebyshev_predictor import ChebyshevPredictor
from radioloc.measurements.combined_predictor import CombinedPredictor, expanded
from radioloc.measurements.dense_series import DenseSeries
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import is_combined
from radioloc.measurements.target_motion import GivenMotions, as_motions

EVALUATIONS = ("auto", "exact", "interpolated")  # how an arc can be evaluated

_MIN_INTERPOLATED_COUNT = 5000  # fewer are computed in a second, about as long as loading compiled code takes


def prepare_predictor(
    model: PhysicalModel,
    observations: Observations,
    motions: GivenMotions,
    evaluation: str = "auto",
    targets: Sequence[str] = (),
    more_partials: bool = False,
) -> Predictor:
    """Prepare the observations of one arc for predictions.

    Parameters
    ----------
    model : PhysicalModel
    observations : Observations
        Epochs, paths, conditions; the measured values are not looked at.
    motions : TargetMotion, LunarPosition or trajectory, or a sequence of them
        Motions of the targets, in the order of their names: positions within some hundred kilometres of points fixed to
        the Moon (:class:`~radioloc.measurements.FixedPoint` takes principal axes), and trajectories of spacecraft. A
        trajectory has to hold the time tags and the instants at which signals meet the spacecraft.
    evaluation : {"auto", "exact", "interpolated"}
        ``"exact"`` computes every observation by itself; ``"interpolated"`` interpolates series wherever that takes
        less computing, within 0.09 mm of the exact values; ``"auto"`` does so from some thousand observations on, if
        most of them belong to dense series. Observations of spacecraft are computed by themselves, as the Moon can hide
        them between any two nodes.
    targets : sequence of str
        Names of the targets, where there are several.
    more_partials : bool
        Whether partials by the stations' places and by the electron content above them are computed as well, as
        :class:`~radioloc.measurements.predictor.Computed` says.

    Raises
    ------
    InputError
        There is no such evaluation, or none of a trajectory; the trajectory leads too far from the Earth; motions are
        not one for each target, or an array, which does not state what its numbers are.
    StationError
        A station is not in the catalogue; the message names the file and line.
    CoverageError
        An epoch lies outside the kernels, the trajectory or the Earth orientation table.
    KernelError
        The trajectory cannot be evaluated.

    Examples
    --------
    >>> import numpy as np
    >>> import radioloc
    >>> from radioloc.measurements import FixedPoint
    >>> ranges = radioloc.read_observations("examples/apollo15/apollo15_apollo_2006-2007.csv")
    >>> reflector = FixedPoint([1554678.949, 98094.118, 765004.906])
    >>> model = radioloc.measurements.PhysicalModel.build()
    >>> predictor = radioloc.measurements.prepare_predictor(model, ranges, reflector)
    >>> residual_m = ranges.value_m - predictor.compute().value_m
    >>> bool(np.median(np.abs(residual_m)) < 1.0)
    True
    """
    if evaluation not in EVALUATIONS:
        raise InputError(f"evaluation {evaluation!r} is not one of {', '.join(EVALUATIONS)}")
    aimed = as_motions(motions, model, targets)
    flies = any(motion.trajectory is not None for motion in aimed)
    if flies and evaluation == "interpolated":
        raise InputError('the tracking of a spacecraft is not interpolated; evaluation is "exact" or "auto"')
    if is_combined(observations.kind).any():
        simple, parts = expanded(observations)
        inner = prepare_predictor(model, simple, aimed, evaluation, targets, more_partials)
        return CombinedPredictor(observations, parts, inner)

    def exact() -> ExactPredictor:
        return ExactPredictor(model, observations, aimed, targets, more_partials)

    sparse = len(observations) < _MIN_INTERPOLATED_COUNT
    if evaluation == "exact" or flies or (evaluation == "auto" and sparse):
        return exact()
    series = DenseSeries(model, observations, more_partials)
    if evaluation == "auto":
        segments = series.segments()
        if int((segments.end - segments.begin).sum()) <= len(observations) // 2:
            return exact()
    return ChebyshevPredictor(model, observations, aimed, series, targets, more_partials)
