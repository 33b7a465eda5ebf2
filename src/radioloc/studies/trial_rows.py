"""One row of results for each trial and arc of a Monte Carlo study, whichever way the trial was made."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from radioloc.simulation import Departure

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
"""What is kept of each trial and arc; then the excess noise by type, then each nuisance parameter, its sigma and, of a
range bias, its error: the estimate less what was put in."""


def trial_seed(seed: int, trial: int) -> int:
    """Seed of one trial's noise and departures, as ``SeedSequence(seed).spawn`` gives to its child of that number."""
    words = np.random.SeedSequence(seed, spawn_key=(trial,)).generate_state(4)
    return sum(int(word) << (32 * k) for k, word in enumerate(words))


def true_biases_m(fixed_m: dict[str, float], drawn: dict[Departure, float]) -> dict[str, float]:
    """Biases of ranges that are in a trial, by station, m."""
    biases_m = dict(fixed_m)
    for departure, value in drawn.items():
        if departure.quantity == "range_bias_m":
            biases_m[departure.station] = biases_m.get(departure.station, 0.0) + value
    return biases_m


def station_of(name: str) -> str | None:
    """Station of a range bias, by the name of the parameter; none of other parameters."""
    kind, _, station = name.partition(".")
    return station if kind == "range_bias" else None


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
    biases_m: dict[str, float],
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
        station = station_of(name)
        if station is not None:
            known[f"{name}.error"] = value - biases_m.get(station, 0.0)
    return np.array([float(known.get(column, np.nan)) for column in columns])
