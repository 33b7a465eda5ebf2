"""From a study to its solution: select, prepare, fit, report."""

from __future__ import annotations

import math
import platform
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc._version import __version__
from radioloc.errors import InputError
from radioloc.estimation.build import build_solution
from radioloc.estimation.editing import USED, EditingSettings, fit_with_editing
from radioloc.estimation.excess_noise import NoisyFit, fit_with_excess_noise
from radioloc.estimation.parameters import Parameter, ParameterSet
from radioloc.estimation.solution import Solution
from radioloc.io.detect import read_observations
from radioloc.lunar import cartesian_partials, rot_pa_to_me, selenographic_to_cartesian
from radioloc.measurements.observations import TIME_TAGS, Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.range_model import RangeArc
from radioloc.measurements.terms import TERMS
from radioloc.studies.selection import select_observations
from radioloc.studies.study import EstimateChoice, Study


def locate(study: Study, observations: Observations | None = None) -> Solution:
    """Fit the position and what else the study asks for.

    Parameters
    ----------
    study : Study
        From :func:`~radioloc.studies.study.read_study`, or built in Python.
    observations : Observations, optional
        In place of the study's files.

    Raises
    ------
    RadiolocError
        The input is not usable; a fit that does not converge or is not observable is not an error but said in the
        solution.
    """
    return _solve(study, observations, study.estimate)


def residuals(study: Study, observations: Observations | None = None) -> Solution:
    """Observed minus computed at the study's position, nothing fitted, nothing edited.

    Parameters and errors as :func:`locate`.
    """
    return _solve(study, observations, None)


def arc_of(study: Study, observations: Observations | None = None) -> tuple[RangeArc, NDArray[np.float64]]:
    """The prepared arc of a study and its a-priori position in principal axes, for predictions and tables of terms.

    Parameters and errors as :func:`locate`.
    """
    model = _model(study)
    chosen, _ = _observations(study, observations)
    target = study.target.to_axes("PA", model.ephemeris.constants)
    return RangeArc(model, chosen, target.xyz_m), target.xyz_m


def _model(study: Study) -> PhysicalModel:
    choice = study.model
    return PhysicalModel.build(
        ephemeris=choice.ephemeris,
        libration=choice.libration,
        earth_orientation=choice.earth_orientation,
        catalogue=study.catalogue,
        off=set(TERMS) - choice.terms,
    )


def _observations(study: Study, observations: Observations | None) -> tuple[Observations, dict[str, int]]:
    if observations is None:
        observations = read_observations(study.observations.files, catalogue=study.catalogue)
    return select_observations(observations, study.observations, study.catalogue)


def _solve(study: Study, given: Observations | None, estimate: EstimateChoice | None) -> Solution:
    model = _model(study)
    observations, left_out = _observations(study, given)
    constants = model.ephemeris.constants
    target = study.target.to_axes("PA", constants)
    arc = RangeArc(model, observations, target.xyz_m)
    problem = _Problem.of(study, model, arc, estimate)
    sigma_m = np.hypot(observations.sigma_m, study.observations.extra_sigma_m)
    a_priori = arc.compute(target.xyz_m)
    status = np.where(a_priori.problem == "", USED, a_priori.problem)
    if estimate is not None and not (status == USED).any():
        raise InputError(f"no observations left: all {len(status)} are rejected, the first one: {status[0]}")
    if estimate is None:
        plain = EditingSettings(enabled=False)
        fitted = NoisyFit(
            fit_with_editing(problem.residuals, problem.parameters, sigma_m, status=status, editing=plain),
            0.0,
        )
    else:
        fitted = fit_with_excess_noise(
            problem.residuals,
            problem.parameters,
            sigma_m,
            status=status,
            editing=EditingSettings(threshold=estimate.rejection_sigma),
        )
    edited = fitted.edited
    lander_pa_m = problem.position_pa_m(edited.fit.x)
    computed = arc.compute(lander_pa_m)
    reference = None if study.reference is None else study.reference.position.to_axes("PA", constants)
    return build_solution(
        edited,
        position_pa_m=lander_pa_m,
        position_partials=problem.position_partials(edited.fit.x),
        rot_pa_to_me=rot_pa_to_me(constants),
        pa_frame=model.libration.frame,
        me_frame=constants.me_frame,
        epoch_utc=observations.epoch,
        station=np.array(arc.stations)[arc.receivers],
        observed_m=observations.value_m,
        path=observations.paths(),
        type=observations.types(),
        elevation_deg=np.degrees(computed.elevation_rad.min(axis=-1)),
        ephemeris_sigma_enu_m=(0.0, 0.0, 0.0) if estimate is None else estimate.ephemeris_sigma_m,
        excess_noise_m=fitted.excess_noise_m,
        reference_pa_m=None if reference is None else reference.xyz_m,
        reference_name="reference" if study.reference is None else study.reference.name,
        name=study.name,
        notes=_notes(study, model, arc, left_out, estimate),
        provenance=_provenance(study, model, observations, left_out),
    )


@dataclass(frozen=True, slots=True)
class _Problem:
    """The parameters of a study and what they do to the computed ranges."""

    arc: RangeArc
    parameters: ParameterSet
    to_pa: Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]
    """From the three position parameters to the principal-axes position and its partials (3, 3)."""
    bias_columns: NDArray[np.float64]
    """Partials of the range biases, (n, number of range biases)."""
    time_columns: NDArray[np.float64]
    """Which observations a station's time bias shifts, (n, number of time biases)."""

    @classmethod
    def of(
        cls, study: Study, model: PhysicalModel, arc: RangeArc, estimate: EstimateChoice | None
    ) -> _Problem:
        choice = EstimateChoice(position="none") if estimate is None else estimate
        position, to_pa = _position_parameters(study, model, choice)
        owner = np.where(arc.observations.tag == TIME_TAGS.index("transmit"), arc.transmitters, arc.receivers)
        ranges = _stations_for("range_bias", choice.range_bias, study, arc, arc.receivers)
        times = _stations_for("time_bias", choice.time_bias, study, arc, owner)
        names = arc.stations
        parameters = [
            *position,
            *_bias_parameters("range_bias", [names[i] for i in ranges], "m", choice.range_bias_sigma_m, 1.0),
            *_bias_parameters("time_bias", [names[i] for i in times], "s", choice.time_bias_sigma_s, 1e-3),
        ]
        if all(p.fixed for p in parameters) and estimate is not None:
            raise InputError(
                'nothing to estimate: [estimate] position is "none" and no bias is asked for; '
                "use `radioloc residuals` to see residuals at the given position"
            )
        return cls(
            arc,
            ParameterSet(parameters),
            to_pa,
            _membership(ranges, arc.receivers),
            _membership(times, owner),
        )

    def position_pa_m(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Position at parameters x, principal axes, m."""
        return self.to_pa(x[:3])[0]

    def position_partials(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """d(position)/d(parameters), shape (3, p)."""
        partials = np.zeros((3, len(self.parameters)))
        partials[:, :3] = self.to_pa(x[:3])[1]
        return partials

    def residuals(self, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Observed minus computed (n,) and partials of the computed (n, p)."""
        lander_pa_m, by_parameters = self.to_pa(x[:3])
        computed = self.arc.compute(lander_pa_m)
        n_range = self.bias_columns.shape[1]
        by_time = self.time_columns * computed.by_time_m_s[:, None]
        total_m = computed.range_m + self.bias_columns @ x[3 : 3 + n_range] + by_time @ x[3 + n_range :]
        partials = np.hstack([computed.by_position_pa @ by_parameters, self.bias_columns, by_time])
        return self.arc.observations.value_m - total_m, partials


def _position_parameters(
    study: Study, model: PhysicalModel, choice: EstimateChoice
) -> tuple[list[Parameter], Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]]:
    """Three parameters of the position in the target's own frame, and how they give the principal-axes position."""
    constants = model.ephemeris.constants
    start = study.target.xyz_m
    in_pa = study.target.frame == model.libration.frame
    rot = np.eye(3) if in_pa else rot_pa_to_me(constants).T
    prior = choice.height_prior
    if choice.position == "geographic":
        longitude_deg, latitude_deg, height_m = study.target.selenographic
        radius_m = float(np.linalg.norm(start))
        height = (height_m, math.inf) if prior is None else (prior.height_m, prior.sigma_m)
        east_scale = 1.0 / (radius_m * max(math.cos(math.radians(latitude_deg)), 1e-3))
        parameters = [
            Parameter("position.longitude", "rad", "position", math.radians(longitude_deg), scale=east_scale),
            Parameter(
                "position.latitude", "rad", "position", math.radians(latitude_deg), scale=1.0 / radius_m
            ),
            Parameter("position.height", "m", "position", *height),
        ]

        def from_geographic(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
            return rot @ selenographic_to_cartesian(*x), rot @ cartesian_partials(*x)

        return parameters, from_geographic
    if prior is not None:
        raise InputError('[estimate] height_prior needs position = "geographic", where height is a parameter')
    fixed = choice.position == "none"
    parameters = [
        Parameter(f"position.{axis}", "m", "position", float(start[k]), fixed=fixed)
        for k, axis in enumerate("xyz")
    ]
    return parameters, lambda x: (rot @ x, rot)


def _stations_for(
    key: str, names: tuple[str, ...] | str, study: Study, arc: RangeArc, owner: NDArray[np.int32]
) -> list[int]:
    """Indices of the stations that get a parameter of one kind."""
    taking_part = [int(i) for i in np.unique(owner)]
    if names == "none":
        return []
    if names == "all":
        return taking_part
    chosen = []
    for name in names:
        station = study.catalogue.get(name).name
        if station not in arc.stations or arc.stations.index(station) not in taking_part:
            present = ", ".join(arc.stations[i] for i in taking_part)
            raise InputError(f"[estimate] {key}: no observation of {station}; the stations are {present}")
        chosen.append(arc.stations.index(station))
    return sorted(set(chosen))


def _bias_parameters(
    kind: str, names: list[str], unit: str, sigma: float | None, scale: float
) -> list[Parameter]:
    prior_sigma = math.inf if sigma is None else sigma
    return [Parameter(f"{kind}.{name}", unit, kind, 0.0, prior_sigma, scale=scale) for name in names]


def _membership(stations: list[int], owner: NDArray[np.int32]) -> NDArray[np.float64]:
    return (
        np.stack([owner == i for i in stations], axis=-1).astype(np.float64)
        if stations
        else np.zeros((len(owner), 0))
    )


def _notes(
    study: Study,
    model: PhysicalModel,
    arc: RangeArc,
    left_out: dict[str, int],
    estimate: EstimateChoice | None,
) -> list[str]:
    """What a reader of the result must know about the model and the data."""
    notes = [f"{count} observations were not asked for: {reason}" for reason, count in left_out.items()]
    stations = [model.catalogue.get(name) for name in arc.stations]
    coarse = [s.name for s in stations if s.quality != "survey"]
    if coarse:
        notes.append(
            f"positions of {', '.join(coarse)} are rounded in the catalogue, good to 100 m to 1 km only"
        )
    unloaded = [s.name for s in stations if s.ocean_loading is None]
    if unloaded and model.has("ocean_loading"):
        notes.append(
            f"no ocean loading coefficients for {', '.join(unloaded)}: up to about 1 cm is not modelled"
        )
    predicted = int(arc.predicted_eop.sum())
    if predicted:
        notes.append(f"Earth orientation is predicted, not measured, for {predicted} observations")
    off = [name for name in TERMS if not model.has(name)]
    if off:
        notes.append(f"terms left out of the model: {', '.join(off)}")
    if estimate is not None and not any(estimate.ephemeris_sigma_m):
        notes.append(
            f"the sigma does not contain the error of {model.ephemeris.name} itself; name one as "
            "[estimate] ephemeris_sigma_m = [east, north, up]"
        )
    return notes


def _provenance(
    study: Study, model: PhysicalModel, observations: Observations, left_out: dict[str, int]
) -> dict[str, Any]:
    choice = study.estimate
    return {
        "radioloc": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "files": [Path(name).name for name in observations.files],
        "not_selected": left_out,
        "extra_sigma_m": study.observations.extra_sigma_m,
        "estimate": {
            "position": choice.position,
            "range_bias": choice.range_bias,
            "range_bias_sigma_m": choice.range_bias_sigma_m,
            "rejection_sigma": choice.rejection_sigma,
            "ephemeris_sigma_m": choice.ephemeris_sigma_m,
        },
        "a_priori": {"frame": study.target.frame, "xyz_m": study.target.xyz_m},
        **model.provenance(),
    }
