"""One row of results for each trial and arc of a Monte Carlo study, whichever way the trial was made."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]

COLUMNS = (
    "converged",
    "used",
    "rejected",
    "east_m",
    "north_m",
    "up_m",
    "sigma_east_m",
    "sigma_north_m",
    "sigma_up_m",
    "correlation_east_north",
    "nees",
    "nees_horizontal",
    "noise_scale",
)
"""What is kept of each trial and arc; then the additive variance component of each type, as a sigma in metres, then
each parameter but the position, its sigma and, of a range bias, its error: the estimate less what was put in."""


def trial_seed(seed: int, trial: int) -> int:
    """Seed of one trial's noise and drawn errors, as ``SeedSequence(seed).spawn`` gives to its child of that number."""
    words = np.random.SeedSequence(seed, spawn_key=(trial,)).generate_state(4)
    return sum(int(word) << (32 * k) for k, word in enumerate(words))


def true_values(fixed: dict[str, float], drawn: dict[str, float]) -> dict[str, float]:
    """Errors of parameters that are in a trial."""
    return fixed | {name: fixed.get(name, 0.0) + value for name, value in drawn.items()}


def row_of(
    columns: Sequence[str],
    *,
    converged: bool,
    used: int,
    rejected: int,
    error_m: _Floats,
    covariance_m2: _Floats,
    noise_scale: float,
    excess_noise_m: dict[str, float],
    parameters: dict[str, tuple[float, float]],
    true: dict[str, float],
) -> _Floats:
    """One row of results in the order of the columns; NaN where an arc has no such number."""
    sigma_m = np.sqrt(np.diag(covariance_m2))
    correlation = nees = nees_horizontal = np.nan
    if np.isfinite(covariance_m2).all():
        correlation = covariance_m2[0, 1] / (sigma_m[0] * sigma_m[1])
        nees = float(error_m @ np.linalg.solve(covariance_m2, error_m))
        nees_horizontal = float(error_m[:2] @ np.linalg.solve(covariance_m2[:2, :2], error_m[:2]))
    known = dict(
        zip(
            COLUMNS,
            (converged, used, rejected, *error_m, *sigma_m, correlation, nees, nees_horizontal, noise_scale),
            strict=True,
        )
    )
    known |= {f"excess_noise_m.{kind}": value for kind, value in excess_noise_m.items()}
    for name, (value, sigma) in parameters.items():
        known[name], known[f"{name}.sigma"] = value, sigma
        # A bias of a pass is the station's.
        known[f"{name}.error"] = value - true.get(name, true.get(name.rpartition(" ")[0], 0.0))
    return np.array([float(known.get(column, np.nan)) for column in columns])
