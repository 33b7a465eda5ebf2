"""Outlier editing: what does not fit is left out, with the reason kept, and let in when it fits again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.estimation.least_squares import (
    FitResult,
    FitSettings,
    FitStatus,
    ResidualFunction,
    fit_least_squares,
)
from radioloc.estimation.observation_noise import ObservationNoise
from radioloc.estimation.parameters import ParameterSet
from radioloc.estimation.robust import robust_scale, robust_start

USED = "used"
"""Status of an observation that takes part in the fit; every other status is the reason why it does not."""


@dataclass(frozen=True, slots=True)
class EditingSettings:
    """What counts as an outlier.

    Parameters
    ----------
    enabled : bool
        Whether to edit at all.
    threshold : float
        An observation is left out when its residual exceeds this many expected sigmas. Expected is the
        stated sigma, or more where the residuals as a whole spread more than stated. Of normal residuals
        one in 1.7 million exceeds 5.
    max_rejected_fraction : float
        Refuse to leave out more than this part of the usable observations: so many outliers mean that the
        model, a station or the sigmas are wrong, not the data.
    max_passes : int
        Limit of fits.
    """

    enabled: bool = True
    threshold: float = 5.0
    max_rejected_fraction: float = 0.3
    max_passes: int = 20

    def __post_init__(self) -> None:
        if not self.threshold >= 2.0:
            raise InputError(
                f"an outlier threshold of {self.threshold} sigmas cuts good data; give 2 or more"
            )
        if not 0.0 <= self.max_rejected_fraction <= 0.5:
            raise InputError(
                f"max_rejected_fraction = {self.max_rejected_fraction} is not between 0 and 0.5; "
                "when most data are wrong nothing tells which"
            )


@dataclass(frozen=True, slots=True, eq=False)
class EditedFit:
    """A fit with its editing.

    Parameters
    ----------
    fit : FitResult
        The final fit.
    status : ndarray of str, shape (n,)
        :data:`USED` or the reason why an observation was left out.
    robust_scale : float
        Spread of the usable observations' residuals over their stated sigmas, by the median: 1 where those
        are right.
    passes : int
        Number of fits made.
    complete : bool
        Whether the editing settled on a set of observations.
    message : str
        What went wrong or is worth knowing; empty if nothing.
    """

    fit: FitResult
    status: NDArray[np.str_]
    robust_scale: float
    passes: int
    complete: bool
    message: str

    @property
    def converged(self) -> bool:
        """Whether the fit converged, everything is determined, and the editing settled."""
        return self.complete and self.fit.converged


def fit_with_editing(
    residual_function: ResidualFunction,
    parameters: ParameterSet,
    sigma_m: ArrayLike | ObservationNoise,
    *,
    status: ArrayLike | None = None,
    editing: EditingSettings | None = None,
    settings: FitSettings | None = None,
) -> EditedFit:
    """Fit, leaving out gross errors.

    A robust estimate (:func:`~radioloc.estimation.robust.robust_start`) gives the first guess of what is an
    outlier; then fit and selection alternate until the selection no longer changes. The spread is taken by
    the median over all usable observations, kept or not, so leaving some out does not tighten the limit for
    the rest. An observation that shares errors with others is judged, as any other, by its own standard deviation,
    all its errors together. A gross error that is small beside the shared ones stays in, and shows in the sum of
    squares.

    Parameters
    ----------
    residual_function : callable
        From x (p,) to residuals observed - computed (n,), m, and partials d(computed)/dx (n, p).
    parameters : ParameterSet
        What is solved for.
    sigma_m : array_like, shape (n,) or (), or ObservationNoise
        Stated standard deviations of the observations, m; or their noise where they share errors.
    status : array_like of str, shape (n,), optional
        Observations to leave out from the beginning have the reason here, such as ``"below the horizon"``;
        the others :data:`USED` or an empty text.
    editing : EditingSettings, optional
        What counts as an outlier.
    settings : FitSettings, optional
        Limits and tolerances of the fit.

    Returns
    -------
    EditedFit

    Raises
    ------
    InputError
        As for :func:`~radioloc.estimation.least_squares.fit_least_squares`.
    """
    editing = editing or EditingSettings()
    settings = settings or FitSettings()
    n = len(residual_function(parameters.prior_values)[0])
    noise = ObservationNoise.of(sigma_m, n)
    sigma = noise.sigma_m
    given = np.full(n, USED, dtype=object) if status is None else np.array(status, dtype=object)
    if given.shape != (n,):
        raise InputError(f"status has shape {given.shape}; {n} observations need ({n},)")
    given[given == ""] = USED
    usable = given == USED
    n_usable, n_free = int(usable.sum()), int(parameters.free.sum())

    def fit(used: NDArray[np.bool_], start: NDArray[np.float64]) -> FitResult:
        return fit_least_squares(
            residual_function, parameters, noise, used=used, start=start, settings=settings
        )

    # An outlier can be told from the rest only if at least one observation is left over without it.
    limit = min(int(editing.max_rejected_fraction * n_usable), n_usable - n_free - 1)
    if not editing.enabled or limit < 1:
        result = fit(usable, parameters.prior_values)
        scale = robust_scale(result.normalized_residuals[usable], n_free)
        return EditedFit(result, given.astype(np.str_), scale, 1, True, "")

    start = robust_start(residual_function, parameters, sigma, usable, settings)
    normalized = residual_function(start)[0] / sigma
    seen: list[NDArray[np.bool_]] = []
    message = ""
    complete = True
    while True:
        scale = robust_scale(normalized[usable], n_free)
        used = usable & (np.abs(normalized) <= editing.threshold * max(1.0, scale))
        if seen and np.array_equal(used, seen[-1]):
            break
        repeated = [k for k, earlier in enumerate(seen) if np.array_equal(used, earlier)]
        if repeated:
            # The selection runs in a circle: what any part of the circle leaves out stays out.
            circle = np.array(seen[repeated[0] :])
            used = circle.all(axis=0)
            wavering = int((circle.any(axis=0) & ~used).sum())
            message = f"{wavering} observations at the outlier limit were left out, in and out by turns"
        n_rejected = n_usable - int(used.sum())
        if n_rejected > limit:
            complete = False
            used = usable
            message = (
                f"{n_rejected} of {n_usable} observations exceed {editing.threshold:g} sigmas, more than the "
                f"{limit} that may be left out, so none was: check stations, sigmas and model"
            )
        elif len(seen) >= editing.max_passes:
            complete = False
            message = f"the editing did not settle in {editing.max_passes} passes"
        result = fit(used, start)
        normalized = result.normalized_residuals
        seen.append(used)
        if repeated or not complete or result.status in (FitStatus.DIVERGED, FitStatus.MAX_ITERATIONS):
            scale = robust_scale(normalized[usable], n_free)
            break
        start = result.x

    for k in np.flatnonzero(usable & ~result.used):
        given[k] = outlier_reason(float(result.residual_m[k]), float(sigma[k]) * max(1.0, scale))
    return EditedFit(result, given.astype(np.str_), scale, len(seen), complete, message)


def outlier_reason(residual_m: float, expected_m: float) -> str:
    """Say why one is left out, such as "outlier: 19.021 m is 612 times its expected 0.031 m"."""
    ratio = abs(residual_m) / expected_m
    times = f"{ratio:.0f}" if ratio >= 100.0 else f"{ratio:.3g}"
    return f"outlier: {_metres(abs(residual_m))} m is {times} times its expected {_metres(expected_m)} m"


def _metres(value_m: float) -> str:
    """Text to the millimetre, or to two digits where that is finer."""
    if value_m >= 0.01:
        return f"{value_m:.3f}"
    return np.format_float_positional(value_m, precision=2, unique=False, fractional=False)
