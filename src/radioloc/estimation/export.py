"""A solution in the types that other programs read: dictionaries for JSON, tables of astropy."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.estimation.observability import Direction
from radioloc.estimation.statistics import GroupStatistics
from radioloc.extras import astropy_table
from radioloc.time import utc_strings

if TYPE_CHECKING:
    from radioloc.estimation.solution import ReferenceComparison, Solution


def solution_dict(solution: Solution) -> dict[str, Any]:
    """Everything but the single residuals, in types that JSON has; None where a number is not finite."""
    return {
        "name": solution.name,
        "converged": solution.converged,
        "status": solution.status,
        "message": solution.message,
        "trajectory": solution.trajectory,
        **_position_dict(solution),
        "biases": _biases(solution, "range_bias", "m"),
        "time_biases": _biases(solution, "time_bias", "s"),
        "parameters": _parameter_rows(solution),
        "parameter_covariance": _matrix(solution.covariance),
        "fit": _fit_dict(solution),
        "rejected": _rejected_rows(solution),
        "observability": {
            "complete": not solution.observability.undetermined,
            "text": list(solution.observability.describe()),
            "singular_values": solution.observability.singular_values.tolist(),
            "condition_number": _finite(solution.observability.condition_number),
            "undetermined": [_direction(item) for item in solution.observability.undetermined],
            "weak": [_direction(item) for item in solution.observability.weak],
            "common": [
                {**asdict(item), "prior_sigma": _finite(item.prior_sigma)}
                for item in solution.observability.common
            ],
            "correlations": [
                [item.first, item.second, item.coefficient] for item in solution.observability.correlations
            ],
        },
        "reference": None if solution.reference is None else _reference_dict(solution.reference),
        "notes": list(solution.notes),
        "provenance": dict(solution.provenance),
    }


def _position_dict(solution: Solution) -> dict[str, Any]:
    """The position and how well it is known; None where the target moves along a trajectory."""
    if solution.trajectory is not None:
        return {"position": None, "sigma": None, "covariance": None}
    longitude_deg, latitude_deg, height_m = solution.selenographic
    return {
        "position": {
            "pa": {"frame": solution.pa_frame, **_xyz(solution.position_pa_m)},
            "me": {
                "frame": solution.me_frame,
                "longitude_deg": longitude_deg,
                "latitude_deg": latitude_deg,
                "height_m": height_m,
                **_xyz(solution.position_me_m),
            },
        },
        "sigma": {
            **_enu(solution.sigma_enu_m("total")),
            "scaled": _enu(solution.sigma_enu_m("scaled")),
            "formal": _enu(solution.sigma_enu_m("formal")),
            "ephemeris": _enu(solution.ephemeris_sigma_enu_m),
        },
        "covariance": {
            "enu_m2": _matrix(solution.position_covariance("enu")),
            "pa_m2": _matrix(solution.position_covariance("pa")),
            "me_m2": _matrix(solution.position_covariance("me")),
            "longitude_latitude_height_rad_rad_m": _matrix(solution.position_covariance("geographic")),
        },
    }


def solution_table(solution: Solution, what: str) -> Any:
    """Residuals or parameters as an ``astropy.table.Table``.

    Raises
    ------
    InputError
        astropy is not installed, or something else is asked for.
    """
    table = astropy_table().Table
    if what == "parameters":
        return table(_parameter_rows(solution, finite=False))
    if what != "residuals":
        raise InputError(f"there is no table of {what!r}; use residuals or parameters")
    rows = solution.residuals
    columns = {
        "epoch_utc": utc_strings(rows.epoch_utc),
        "type": rows.type,
        "station": rows.station,
        "path": rows.path,
        "observed_m": rows.observed_m,
        "computed_m": rows.computed_m,
        "residual_m": rows.residual_m,
        "sigma_m": rows.sigma_m,
        "status": rows.status,
    }
    if rows.elevation_deg is not None:
        columns["elevation_deg"] = rows.elevation_deg
    return table(columns)


def _biases(solution: Solution, kind: str, unit: str) -> dict[str, Any]:
    """Biases of a kind by station, or by station and pass with its first and last epoch."""
    found: dict[str, Any] = {}
    for k, (owner, (value, sigma)) in zip(
        solution.parameters.of_kind(kind), solution.biases(kind).items(), strict=True
    ):
        found[owner] = {f"value_{unit}": value, f"sigma_{unit}": _finite(sigma)}
        span = solution.parameters.parameters[k].span_utc
        if span is not None:
            found[owner] |= {"first_utc": span[0], "last_utc": span[1]}
    return found


def _fit_dict(solution: Solution) -> dict[str, Any]:
    total = solution.fit.total
    return {
        "used": total.used,
        "rejected": total.rejected,
        "wrms_m": total.wrms_m,
        "rms_m": total.rms_m,
        "mean_m": total.mean_m,
        "chi2": solution.fit.chi2,
        "dof": solution.fit.dof,
        "chi2_per_dof": solution.fit.chi2_per_dof,
        "chi2_per_dof_bound": solution.fit.chi2_per_dof_bound,
        "excess_noise_m": dict(solution.fit.excess_noise_m),
        "noise_scale": solution.noise_scale,
        "correlation_factor": solution.correlation_factor,
        "time_correlation": [
            asdict(item) for item in (solution.time_correlation.series if solution.time_correlation else ())
        ],
        "series_weights": [
            asdict(item) | {"weighed_as": item.weighed_as} for item in solution.series_weights
        ],
        "robust_scale": solution.fit.robust_scale,
        "iterations": len(solution.iterations),
        "passes": solution.passes,
        "by_station": {group.label: _group(group) for group in solution.fit.by_station},
        "by_type": {group.label: _group(group) for group in solution.fit.by_type},
    }


def _parameter_rows(solution: Solution, finite: bool = True) -> list[dict[str, Any]]:
    limit = _finite if finite else float
    scaled, formal = solution.sigmas("scaled"), solution.sigmas("formal")
    return [
        {
            "name": item.name,
            "unit": item.unit,
            "value": float(solution.values[k]),
            "sigma": limit(scaled[k]),
            "formal_sigma": limit(formal[k]),
            "prior_value": item.prior_value,
            "prior_sigma": limit(item.prior_sigma),
            "fixed": item.fixed,
        }
        for k, item in enumerate(solution.parameters)
    ]


def _rejected_rows(solution: Solution) -> list[dict[str, Any]]:
    rows = solution.residuals
    out = np.flatnonzero(~rows.used)
    if not len(out):
        return []
    epochs = utc_strings(rows.epoch_utc[out], decimals=3)
    return [
        {
            "epoch_utc": str(epoch),
            "station": str(station),
            "path": str(path),
            "residual_m": _finite(residual_m),
            "reason": str(reason),
        }
        for epoch, station, path, residual_m, reason in zip(
            epochs, rows.stations[out], rows.paths[out], rows.residual_m[out], rows.outcome[out], strict=True
        )
    ]


def _reference_dict(reference: ReferenceComparison) -> dict[str, Any]:
    return {
        "name": reference.name,
        "east_m": reference.east_m,
        "north_m": reference.north_m,
        "up_m": reference.up_m,
        "horizontal_m": reference.horizontal_m,
        "distance_m": reference.distance_m,
        "east_sigmas": reference.east_sigmas,
        "north_sigmas": reference.north_sigmas,
        "up_sigmas": reference.up_sigmas,
        "combined_sigmas": reference.combined_sigmas,
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _xyz(vector_m: NDArray[np.float64]) -> dict[str, float]:
    return dict(zip(("x_m", "y_m", "z_m"), vector_m.tolist(), strict=True))


def _enu(vector_m: NDArray[np.float64]) -> dict[str, float | None]:
    return {name: _finite(v) for name, v in zip(("east_m", "north_m", "up_m"), vector_m, strict=True)}


def _matrix(matrix: NDArray[np.float64]) -> list[list[float | None]]:
    return [[_finite(value) for value in row] for row in matrix]


def _direction(direction: Direction) -> dict[str, Any]:
    return {
        "weights": dict(zip(direction.names, direction.weights, strict=True)),
        "sigma": _finite(direction.sigma),
        "unit": direction.unit,
    }


def _group(group: GroupStatistics) -> dict[str, Any]:
    return {
        "used": group.used,
        "rejected": group.rejected,
        "mean_m": group.mean_m,
        "rms_m": group.rms_m,
        "wrms_m": group.wrms_m,
    }
