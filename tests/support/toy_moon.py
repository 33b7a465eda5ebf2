"""A toy Earth and Moon with exact partials: geometry enough for the estimator, no real ephemeris.

Two-way range between stations on a turning Earth and a point fixed to a Moon on a circular orbit that keeps
its face to the Earth but for a libration of some degrees. Sizes are right to a per cent, so sigmas are
realistic.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation import Parameter, ParameterSet
from radioloc.estimation.editing import EditedFit, fit_with_editing
from radioloc.estimation.series import SeriesOrder, seconds_since_midnight
from radioloc.estimation.statistics import Residuals
from radioloc.jobs.verdict import decide_status
from radioloc.labels import Labels
from radioloc.results import Solution
from radioloc.results.build import AssessedFit, assess_fit, compare_with
from radioloc.time import Epochs

STATIONS = {"A": (0.57, -1.85), "B": (0.76, 0.12), "C": (0.71, 0.29)}  # latitude, longitude, rad
LANDER_M = np.array([1653220.0, -10321.0, 520433.0])
_EARTH_RADIUS_M, _DISTANCE_M = 6.371e6, 3.844e8
_EARTH_RATE, _MOON_RATE, _LIBRATION_RATE = 7.2921e-5, 2.6617e-6, 2.64e-6


def _turn_z(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    c, s, z = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    return np.stack([np.stack([c, -s, z], -1), np.stack([s, c, z], -1), np.stack([z, z, z + 1.0], -1)], -2)


class ToyMoon:
    """Times, stations, and the model of ranges to them."""

    def __init__(
        self, n: int, hours: float, stations: tuple[str, ...] = ("A", "B", "C"), biases: bool = True
    ) -> None:
        self.time_s = np.linspace(0.0, 3600.0 * hours, n)
        self.station = np.array(stations)[np.arange(n) % len(stations)]
        self.biased = tuple(dict.fromkeys(stations)) if biases else ()
        latitude, longitude = np.array([STATIONS[name] for name in self.station]).T
        angle = longitude + _EARTH_RATE * self.time_s
        self.station_m = _EARTH_RADIUS_M * np.stack(
            [np.cos(latitude) * np.cos(angle), np.cos(latitude) * np.sin(angle), np.sin(latitude)], -1
        )
        orbit = _MOON_RATE * self.time_s
        inclination = 0.4 * np.sin(orbit + 0.3)
        self.moon_m = _DISTANCE_M * np.stack(
            [np.cos(orbit) * np.cos(inclination), np.sin(orbit) * np.cos(inclination), np.sin(inclination)],
            -1,
        )
        self.rot_moon = _turn_z(orbit + np.pi + 0.12 * np.sin(_LIBRATION_RATE * self.time_s + 0.5))

    def parameters(
        self, start_m: NDArray[np.float64] = LANDER_M, bias_sigma_m: float = np.inf
    ) -> ParameterSet:
        position = [
            Parameter(f"position.{axis}_m", "m", "position", float(value))
            for axis, value in zip("xyz", start_m, strict=True)
        ]
        biases = [Parameter(f"range_bias.{s}", "m", "range_bias", 0.0, bias_sigma_m) for s in self.biased]
        return ParameterSet([*position, *biases])

    def ranges(self, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return two-way ranges (n,), m, and their partials (n, p)."""
        line = self.moon_m + self.rot_moon @ x[:3] - self.station_m
        one_way = np.linalg.norm(line, axis=1)
        by_position = 2.0 * np.einsum("ni,nij->nj", line / one_way[:, None], self.rot_moon)
        by_bias = np.array([self.station == name for name in self.biased], dtype=float).T
        by_bias = by_bias.reshape(len(one_way), len(self.biased))
        return 2.0 * one_way + by_bias @ x[3:], np.hstack([by_position, by_bias])

    def residual_function(
        self, observed_m: NDArray[np.float64]
    ) -> Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]:
        def residuals(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
            computed_m, partials = self.ranges(x)
            return observed_m - computed_m, partials

        return residuals


EPOCH_JD = 2456650.5


def assessed_fit(
    edited: EditedFit, *, count_s: Any = None, elevation_deg: Any = None, **fields: Any
) -> AssessedFit:
    """Assess a fit from columns of its observations and fields of its estimate."""
    epoch_utc = fields.pop("epoch_utc")
    stations, types, paths = (Labels.from_texts(fields.pop(name)) for name in ("station", "type", "path"))
    residuals = Residuals(
        epoch_utc=epoch_utc,
        stations=stations,
        types=types,
        paths=paths,
        observed_m=fields.pop("observed_m"),
        residual_m=edited.fit.residual_m,
        sigma_m=edited.fit.sigma_m,
        elevation_deg=elevation_deg,
        count_s=count_s,
        statuses=edited.status,
    )
    order = SeriesOrder.from_labels(types, paths, seconds_since_midnight(epoch_utc))
    return assess_fit(edited, order, residuals, **fields)


def solution_of(assessed: AssessedFit) -> Solution:
    """Return the solution of a fit whose targets leave no doubts."""
    return assessed.solution(*decide_status(assessed, ()))


def toy_fit(
    model: ToyMoon,
    *,
    sigma_m: float = 0.3,
    noise_factor: float = 1.0,
    blunders_m: dict[int, float] | None = None,
    status: NDArray[np.str_] | None = None,
    bias_sigma_m: float = np.inf,
    parameters: ParameterSet | None = None,
    seed: int = 1,
    **fields: Any,
) -> AssessedFit:
    """Return a fit of simulated observations of :data:`LANDER_M` with normal noise and no biases."""
    n = len(model.time_s)
    truth = np.concatenate([LANDER_M, np.zeros(len(model.biased))])
    observed_m = model.ranges(truth)[0] + noise_factor * sigma_m * np.random.default_rng(seed).normal(size=n)
    for k, size_m in (blunders_m or {}).items():
        observed_m[k] += size_m
    parameters = parameters or model.parameters(LANDER_M + np.array([2e4, 3e4, -3e4]), bias_sigma_m)
    edited = fit_with_editing(model.residual_function(observed_m), parameters, sigma_m, status=status)
    partials = np.zeros((3, len(parameters)))
    partials[:, :3] = np.eye(3)
    options: dict[str, Any] = {
        "position_pa_m": edited.fit.x[:3],
        "position_partials": partials,
        "rot_pa_to_me": np.eye(3),
        "pa_frame": "PA_DE421",
        "me_frame": "ME_DE421",
        "epoch_utc": Epochs.from_jd(EPOCH_JD, model.time_s / 86400.0, "UTC"),
        "station": model.station,
        "path": [f"{name}>lander>{name}" for name in fields.get("station", model.station)],
        "type": ["range"] * n,
        "observed_m": observed_m,
        "name": "toy lander",
    }
    return assessed_fit(edited, **(options | fields))


def toy_solution(
    model: ToyMoon,
    *,
    reference_pa_m: NDArray[np.float64] | None = None,
    reference_name: str = "reference",
    **options: Any,
) -> Solution:
    """Return the solution of :func:`toy_fit`, compared with a reference."""
    solution = solution_of(toy_fit(model, **options))
    if reference_pa_m is None:
        return solution
    return replace(solution, reference=compare_with(solution, reference_pa_m, reference_name))
