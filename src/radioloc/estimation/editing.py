"""Outlier editing: what does not fit is left out, with the reason kept, and let in when it fits again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError
from radioloc.estimation.labels import Labels
from radioloc.estimation.least_squares import FitResult, FitSettings, FitStatus, fit_least_squares
from radioloc.estimation.linearization import Linearization, ResidualFunction, evaluate
from radioloc.estimation.observation_noise import ObservationNoise
from radioloc.estimation.robust import robust_scale, robust_start
from radioloc.parameters.parameter import ParameterSet

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
class Outcome:
    """What became of each observation: used, or the reason why not; an index gives an array of str.

    The reasons of outliers, each with its numbers, are put in words when they are asked for.

    Parameters
    ----------
    used : ndarray of bool, shape (n,)
        Which observations took part.
    given : Labels
        What was said before the fit: :data:`USED` or a reason.
    residual_m : ndarray, shape (n,)
        Observed - computed, m.
    sigma_m : ndarray, shape (n,)
        Stated standard deviations, m.
    scale : float
        Factor from stated to expected standard deviations.
    """

    used: NDArray[np.bool_]
    given: Labels
    residual_m: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    scale: float

    def __len__(self) -> int:
        return len(self.used)

    def __getitem__(self, rows: Any) -> NDArray[np.str_]:
        """Texts of a slice, a mask or indices of rows."""
        texts = self.given[rows]
        outliers, reasons = self.outliers(rows)
        if not len(outliers):
            return texts
        wide = texts.astype(np.result_type(texts.dtype, reasons.dtype))
        wide[outliers] = reasons
        return wide

    def outliers(self, rows: Any) -> tuple[NDArray[np.intp], NDArray[np.str_]]:
        """Which of a slice, a mask or indices of rows were left out by the fit, and why."""
        found = np.flatnonzero(self.given.select(rows).are(USED) & ~self.used[rows])
        residual_m, expected_m = self.residual_m[rows][found], self.sigma_m[rows][found] * self.scale
        reasons = [
            outlier_reason(r, e) for r, e in zip(residual_m.tolist(), expected_m.tolist(), strict=True)
        ]
        return found, np.array(reasons, dtype=np.str_)

    def select(self, rows: Any) -> Outcome:
        """Some rows."""
        return Outcome(
            self.used[rows], self.given.select(rows), self.residual_m[rows], self.sigma_m[rows], self.scale
        )

    def array(self) -> NDArray[np.str_]:
        """Texts of all rows, shape (n,); read-only."""
        out = self[:]
        out.flags.writeable = False
        return out


@dataclass(frozen=True, slots=True, eq=False)
class EditedFit:
    """A fit with its editing.

    Parameters
    ----------
    fit : FitResult
        The final fit.
    given : Labels
        What was said of each observation before the fit: :data:`USED` or the reason why it cannot be.
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
    given: Labels
    robust_scale: float
    passes: int
    complete: bool
    message: str

    @property
    def outcome(self) -> Outcome:
        """What became of each observation."""
        return Outcome(
            self.fit.used,
            self.given,
            self.fit.residual_m,
            self.fit.sigma_m,
            max(1.0, self.robust_scale),
        )

    @property
    def status(self) -> NDArray[np.str_]:
        """:data:`USED` or the reason why an observation was left out, shape (n,)."""
        return self.outcome.array()

    @property
    def converged(self) -> bool:
        """Whether the fit converged, everything is determined, and the editing settled."""
        return self.complete and self.fit.converged


def fit_with_editing(
    residual_function: ResidualFunction,
    parameters: ParameterSet,
    sigma_m: ArrayLike | ObservationNoise,
    *,
    status: ArrayLike | Labels | None = None,
    editing: EditingSettings | None = None,
    settings: FitSettings | None = None,
    previous: EditedFit | None = None,
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
        As for :func:`~radioloc.estimation.least_squares.fit_least_squares`.
    parameters : ParameterSet
        What is solved for.
    sigma_m : array_like, shape (n,) or (), or ObservationNoise
        Stated standard deviations of the observations, m; or their noise where they share errors.
    status : array_like of str, shape (n,), or Labels, optional
        Observations to leave out from the beginning have the reason here, such as ``"below the horizon"``;
        the others :data:`USED` or an empty text.
    editing : EditingSettings, optional
        What counts as an outlier.
    settings : FitSettings, optional
        Limits and tolerances of the fit.
    previous : EditedFit, optional
        A fit of the same observations with other sigmas, from which to start in place of a robust start.

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
    if previous is None:
        x = parameters.prior_values
        at_x = evaluate(residual_function, x)
    else:
        x, at_x = previous.fit.x, previous.fit.linearization
    n = len(at_x.residual_m)
    noise = ObservationNoise.of(sigma_m, n)
    sigma = noise.sigma_m
    given = _given(status, n) if previous is None or status is not None else previous.given
    usable = given.are(USED)
    n_usable, n_free = int(usable.sum()), int(parameters.free.sum())

    def fit(used: NDArray[np.bool_], start: NDArray[np.float64], at_start: Linearization) -> FitResult:
        return fit_least_squares(
            residual_function,
            parameters,
            noise,
            used=used,
            start=start,
            linearization=at_start,
            settings=settings,
        )

    # An outlier can be told from the rest only if at least one observation is left over without it.
    limit = min(int(editing.max_rejected_fraction * n_usable), n_usable - n_free - 1)
    if not editing.enabled or limit < 1:
        result = fit(usable, x, at_x)
        scale = robust_scale(_normalized(result.residual_m, sigma, usable), n_free)
        return EditedFit(result, given, scale, 1, True, "")

    if previous is None:
        x, at_x = robust_start(residual_function, parameters, sigma, usable, settings, at_x)
    return _settled(fit, given, sigma, n_free, limit, editing, x, at_x)


_Fit = Callable[[NDArray[np.bool_], NDArray[np.float64], Linearization], FitResult]
"""A fit of the chosen observations, from where to start and the linearization there."""


def _settled(
    fit: _Fit,
    given: Labels,
    sigma_m: NDArray[np.float64],
    n_free: int,
    limit: int,
    editing: EditingSettings,
    x: NDArray[np.float64],
    at_x: Linearization,
) -> EditedFit:
    """Fit and select by turns from some start on, at most `limit` left out, until the selection stays."""
    usable = given.are(USED)
    n_usable = int(usable.sum())
    scale = robust_scale(_normalized(at_x.residual_m, sigma_m, usable), n_free)
    seen: list[NDArray[np.bool_]] = []
    found: EditedFit | None = None
    while True:
        limit_sigmas = editing.threshold * max(1.0, scale)
        used = usable & (np.abs(at_x.residual_m) <= limit_sigmas * sigma_m)
        if found is not None and np.array_equal(used, found.fit.used):
            return found
        used, message = _without_wavering(used, seen)
        last, complete = bool(message), True
        n_rejected = n_usable - int(used.sum())
        if n_rejected > limit:
            last, complete = True, False
            used = usable
            message = (
                f"{n_rejected} of {n_usable} observations exceed {editing.threshold:g} sigmas, more than the "
                f"{limit} that may be left out, so none was: check stations, sigmas and model"
            )
        elif len(seen) >= editing.max_passes:
            last, complete = True, False
            message = f"the editing did not settle in {editing.max_passes} passes"
        result = fit(used, x, at_x)
        scale = robust_scale(_normalized(result.residual_m, sigma_m, usable), n_free)
        seen.append(used)
        found = EditedFit(result, given, scale, len(seen), complete, message)
        if last or result.status in (FitStatus.DIVERGED, FitStatus.MAX_ITERATIONS):
            return found
        x, at_x = result.x, result.linearization


def _without_wavering(
    used: NDArray[np.bool_], seen: list[NDArray[np.bool_]]
) -> tuple[NDArray[np.bool_], str]:
    """A selection and no text; or, where it runs in a circle, that without what any part of it leaves out, and why."""
    first = next((k for k, earlier in enumerate(seen) if np.array_equal(used, earlier)), None)
    if first is None:
        return used, ""
    circle = np.array(seen[first:])
    kept = np.asarray(circle.all(axis=0))
    wavering = int((circle.any(axis=0) & ~kept).sum())
    return kept, f"{wavering} observations at the outlier limit were left out, in and out by turns"


def _given(status: ArrayLike | Labels | None, n: int) -> Labels:
    """What was said of n observations before the fit; an empty text is :data:`USED`."""
    if status is None:
        return Labels(np.zeros(n, dtype=np.int32), (USED,))
    given = Labels.of(status)
    if given.codes.shape != (n,):
        raise InputError(f"status has shape {given.codes.shape}; {n} observations need ({n},)")
    return Labels.coded([text or USED for text in given.texts], given.codes)


def _normalized(
    residual_m: NDArray[np.float64], sigma_m: NDArray[np.float64], which: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Residuals of some observations over their sigmas."""
    return np.asarray(residual_m[which] / sigma_m[which])


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
