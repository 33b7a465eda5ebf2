"""Choice between the computation of each observation and the interpolation of dense series."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence

import numpy as np

from radioloc.errors import InputError, PluginWarning
from radioloc.measurements.chebyshev_predictor import ChebyshevPredictor
from radioloc.measurements.combined_predictor import CombinedPredictor, expanded
from radioloc.measurements.dense_series import DenseSeries
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import is_combined
from radioloc.measurements.target_motion import MotionsLike, as_motions

EVALUATIONS = ("auto", "exact", "interpolated")

_PACKAGED_MEDIA = ("troposphere", "ionosphere", "antenna_axis_offset")
_SAMPLE_COUNT = 20  # observations by which delays of media are compared
_MIN_INTERPOLATED_COUNT = 5000  # fewer are computed in a second, about the time to load compiled code


def second_tropospheres(
    model: PhysicalModel, observations: Observations, motions: MotionsLike, targets: Sequence[str]
) -> Iterator[str]:
    """Yield a warning for each added medium with delays within a factor of two of the built-in troposphere's."""
    added = [medium.name for medium in model.media if medium.name not in _PACKAGED_MEDIA]
    if not (added and model.has("troposphere")):
        return
    rows = np.unique(np.linspace(0, len(observations) - 1, _SAMPLE_COUNT).astype(np.intp))
    sample = ExactPredictor(model, observations.select(rows), motions, targets)
    effects_m = sample.terms(names=("troposphere", *added))
    sum_m = {name: float(np.nansum(np.abs(effect_m))) for name, effect_m in effects_m.items()}
    for name in added:
        if 0.5 < sum_m[name] / (sum_m["troposphere"] or np.inf) < 2.0:
            advice = f'switch one off: [model] off = ["troposphere"] or ["{name}"]'
            yield f"medium {name} delays signals as much as the built-in troposphere, and both are applied; {advice}"


def prepare_predictor(
    model: PhysicalModel,
    observations: Observations,
    motions: MotionsLike,
    evaluation: str = "auto",
    targets: Sequence[str] = (),
    more_partials: bool = False,
) -> Predictor:
    """Prepare the observations of an arc for predictions.

    Parameters
    ----------
    model : PhysicalModel
        Kernels, tables and active terms.
    observations : Observations
        Epochs, paths and conditions; measured values are not used.
    motions : TargetMotion, LunarPosition or trajectory, or a sequence of them
        Motions of the targets in the order of their names: positions on the Moon, to some hundred kilometres
        (:class:`~radioloc.measurements.FixedPoint` has principal axes), and trajectories of spacecraft. A trajectory
        must cover the time tags and the instants at which signals meet the spacecraft.
    evaluation : {"auto", "exact", "interpolated"}
        ``"exact"`` computes each observation; ``"interpolated"`` interpolates dense series, within 0.09 mm of the exact
        values; ``"auto"`` does so from some thousand observations on, if most belong to dense series. Observations of
        spacecraft are always computed, as the Moon can hide them between nodes.
    targets : sequence of str
        Names of several targets; empty for a single target.
    more_partials : bool
        Whether to compute partials with respect to station positions and electron contents
        (:class:`~radioloc.measurements.predictor.Computed`).

    Raises
    ------
    InputError
        The evaluation is unknown, or interpolation is requested for a spacecraft; the trajectory is too far from the
        Earth; the number of motions differs from that of targets, or a motion is an array.
    StationError
        A station is not in the catalogue; the message names the file and line.
    CoverageError
        An epoch is outside of the kernels, the trajectory or the Earth orientation table.
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
        raise InputError(f"evaluation: expected {', '.join(EVALUATIONS)}, got {evaluation!r}")
    all_motions = as_motions(motions, model, targets)
    has_spacecraft = any(motion.trajectory is not None for motion in all_motions)
    if has_spacecraft and evaluation == "interpolated":
        raise InputError('evaluation: expected "exact" or "auto" for a spacecraft, got "interpolated"')
    if is_combined(observations.kind).any():
        simple, parts = expanded(observations)
        inner = prepare_predictor(model, simple, all_motions, evaluation, targets, more_partials)
        return CombinedPredictor(observations, parts, inner)
    for text in second_tropospheres(model, observations, all_motions, targets):
        warnings.warn(text, PluginWarning, stacklevel=2)
    sparse = len(observations) < _MIN_INTERPOLATED_COUNT
    exact = evaluation == "exact" or has_spacecraft or (evaluation == "auto" and sparse)
    series = None if exact else DenseSeries(model, observations, more_partials)
    if series is not None and evaluation == "auto":
        segments = series.segments()
        exact = int((segments.end - segments.begin).sum()) <= len(observations) // 2
    if exact:
        return ExactPredictor(model, observations, all_motions, targets, more_partials)
    return ChebyshevPredictor(model, observations, all_motions, series, targets, more_partials)
