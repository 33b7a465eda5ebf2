"""Simulated observations, with the record of what was put into them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.ephemeris import Trajectory
from radioloc.errors import InputError
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.observations import RANGE, Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import reasons
from radioloc.measurements.registry import KINDS
from radioloc.simulation.noise import NoiseModel
from radioloc.simulation.schedule import Plan, Schedule
from radioloc.simulation.truth import Truth
from radioloc.simulation.visibility import Target

_ROWS_AT_ONCE = 65536


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """Observations of a simulated world.

    Parameters
    ----------
    observations : Observations
        As measured: with all errors; sigmas are those that the schedule states.
    target_pa_m : ndarray, shape (3,)
        Where the point truly is, principal axes, m; of a spacecraft the offset from its trajectory, zeros.
    truth : Truth
        In what the world departs from the nominal model.
    noise : NoiseModel
    seed : int
    error_free_m : ndarray, shape (n,)
        What instruments without errors would have measured in that world, m.
    added_m : dict of str to ndarray, shape (n,)
        What clocks, biases and media added, m.
    noise_m : ndarray, shape (n,)
        Random error, m.
    is_outlier : ndarray of bool, shape (n,)
        Whether the random error has a wild part.
    trajectory : Trajectory or None
        Where the spacecraft truly is, if the target is one.
    """

    observations: Observations
    target_pa_m: NDArray[np.float64]
    truth: Truth
    noise: NoiseModel
    seed: int
    error_free_m: NDArray[np.float64]
    added_m: dict[str, NDArray[np.float64]]
    noise_m: NDArray[np.float64]
    is_outlier: NDArray[np.bool_]
    trajectory: Trajectory | None = None

    def summary(self) -> str:
        """Text for people and for the head of a file: what was measured, and what was put in."""
        x, y, z = self.target_pa_m.tolist()
        where = f"true position, principal axes, m: {x:.4f} {y:.4f} {z:.4f}"
        lines = [
            "simulated observations",
            self.observations.summary(),
            where if self.trajectory is None else f"true trajectory: {self.trajectory}",
            f"seed {self.seed}, {int(self.is_outlier.sum())} outlier(s)",
            *(f"{name}: {_shown(value)}" for name, value in _departures(self.truth)),
            f"noise of station arrivals (VLBI): {_shown(self.noise.vlbi_station)}",
            *(
                [f"noise of the growth of station arrivals (VLBI): {_shown(self.noise.vlbi_station_rate)}"]
                if "vlbi_delay_rate" in self.observations.types()
                else []
            ),
            *(f"noise of {kind}: {_shown(noise)}" for kind, noise in self.noise.link.items()),
        ]
        return "\n".join(lines)


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A simulated world made ready: what remains is to add noise, as often as wanted.

    Parameters
    ----------
    plan : Plan
        What is measured.
    target_pa_m : ndarray, shape (3,)
        Principal axes, m.
    truth : Truth
    error_free_m : ndarray, shape (n,)
    added_m : dict of str to ndarray, shape (n,)
        As in :class:`Simulated`.
    trajectory : Trajectory or None
        Of a spacecraft; the position then is an offset from it, zeros.
    """

    plan: Plan
    target_pa_m: NDArray[np.float64]
    truth: Truth
    error_free_m: NDArray[np.float64]
    added_m: dict[str, NDArray[np.float64]]
    trajectory: Trajectory | None = None

    @classmethod
    def prepare(
        cls,
        schedule: Schedule,
        target: LunarPosition | Trajectory,
        truth: Truth | None = None,
        *,
        model: PhysicalModel,
        name: str = "lander",
        plan: Plan | None = None,
    ) -> World:
        """Compute all but the noise; parameters and errors as :func:`simulate`.

        With a `plan`, that is measured, and the schedule is not planned again.
        """
        truth = truth or Truth()
        trajectory = target if isinstance(target, Trajectory) else None
        target_pa_m = (
            np.zeros(3)
            if isinstance(target, Trajectory)
            else target.to_axes("PA", model.ephemeris.constants).xyz_m
        )
        place: Target = target_pa_m if trajectory is None else trajectory
        world = truth.model(model)
        # What the stations believe is what they plan with.
        plan = plan or schedule.plan(model, place, name)
        happened = replace(plan.observations, epoch=truth.true_epochs(plan.observations, model.catalogue))
        error_free_m = _computed_m(world, happened, target_pa_m, trajectory)
        ranges = plan.observations.kind == RANGE
        light_time_s = np.where(ranges, error_free_m / C_M_S, 0.0)
        added_m = truth.added_m(world, plan.observations, place, light_time_s)
        return cls(plan, target_pa_m, truth, error_free_m, added_m, trajectory)

    def draw(self, noise: NoiseModel | None = None, *, seed: int = 0) -> Simulated:
        """Observations with one realization of the noise; parameters and errors as :func:`simulate`."""
        noise = noise or NoiseModel()
        noise_m, is_outlier = noise.draw(self.plan, seed)
        value_m = self.error_free_m + noise_m
        for added_m in self.added_m.values():
            value_m += added_m
        value_m.flags.writeable = False
        return Simulated(
            observations=replace(self.plan.observations, value_m=value_m),
            target_pa_m=self.target_pa_m,
            truth=self.truth,
            noise=noise,
            seed=seed,
            error_free_m=self.error_free_m,
            added_m=self.added_m,
            noise_m=noise_m,
            is_outlier=is_outlier,
            trajectory=self.trajectory,
        )


def simulate(
    schedule: Schedule,
    target: LunarPosition | Trajectory,
    truth: Truth | None = None,
    noise: NoiseModel | None = None,
    *,
    model: PhysicalModel,
    seed: int = 0,
    name: str = "lander",
) -> Simulated:
    """Simulate the tracking of a point on the Moon, or of a spacecraft.

    Parameters
    ----------
    schedule : Schedule
        What is measured and when.
    target : LunarPosition or Trajectory
        Where the point truly is.
    truth : Truth, optional
        In what the world departs from the nominal model; in nothing where not given.
    noise : NoiseModel, optional
        Random errors; none where not given.
    model : PhysicalModel
        The nominal model: the one with which the observations would be fitted.
    seed : int
        Of the noise; the same seed gives the same errors.
    name : str
        Name of the point in the observations.

    Returns
    -------
    Simulated
        ``.observations`` to be fitted, and what was put into them.

    Raises
    ------
    InputError
        Something asked for cannot be, or the model does not hold for an observation (too low for the troposphere).
    StationError
        A station is not in the catalogue.
    CoverageError
        An epoch lies outside the kernels or the Earth orientation table.
    """
    return World.prepare(schedule, target, truth, model=model, name=name).draw(noise, seed=seed)


def _computed_m(
    world: PhysicalModel,
    observations: Observations,
    target_pa_m: NDArray[np.float64],
    trajectory: Trajectory | None,
) -> NDArray[np.float64]:
    """Prediction of the observations, refused where the model does not hold."""
    predictor = prepare_predictor(world, observations, target_pa_m, trajectory=trajectory)
    predicted = predictor.at(target_pa_m)
    wrong, problem = 0, ""
    for start in range(0, len(observations), _ROWS_AT_ONCE):
        computed = predicted.rows(slice(start, start + _ROWS_AT_ONCE))
        found = np.flatnonzero(~computed.usable)
        if len(found) and not wrong:
            row = start + int(found[0])
            problem = reasons(predictor, computed.rows(found[:1]), [row])[1][0]
        wrong += len(found)
    if wrong:
        link = observations.links[observations.link[row]].path
        kind = KINDS[observations.kind[row]]
        raise InputError(
            f"{wrong} of {len(observations)} observations cannot be simulated; the first, a {kind} of {link}: "
            f"{problem}; raise the elevation mask, or leave the term out of the model"
        )
    return predicted.value_m


def _departures(truth: Truth) -> list[tuple[str, Any]]:
    """Names and values of what a truth sets."""
    plain = Truth()
    found = [(f.name, getattr(truth, f.name)) for f in fields(truth)]
    return [(name, value) for name, value in found if value != getattr(plain, name)]


def _shown(value: Any) -> str:
    """A record by what it sets, a mapping by its items, numbers short."""
    if hasattr(value, "__dataclass_fields__"):
        given = [(f.name, getattr(value, f.name)) for f in fields(value)]
        return ", ".join(f"{name} {_shown(v)}" for name, v in given if v not in (0.0, None)) or "none"
    if isinstance(value, Mapping):
        return "; ".join(f"{key} {_shown(v)}" for key, v in value.items())
    if isinstance(value, tuple):
        return f"({', '.join(_shown(v) for v in value)})"
    if isinstance(value, float):
        return f"{value:.10g}"
    return f"{getattr(value, '__name__', value)}"
