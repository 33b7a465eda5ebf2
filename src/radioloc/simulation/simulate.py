"""Simulated observations, with the record of their true values and errors."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np

from radioloc.dynamics import AdjustableOrbit
from radioloc.ephemeris.trajectory import SpacecraftTrajectory
from radioloc.errors import InputError
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.predictor import Prediction, Predictor, blocks, reasons
from radioloc.measurements.registry import KINDS
from radioloc.measurements.target_motion import TargetMotion, TrajectoryMotion
from radioloc.parameters.choice import ParameterChoice
from radioloc.parameters.registry import PARAMETERS
from radioloc.simulation.noise import NoiseModel, generator, require_seed
from radioloc.simulation.schedule import Plan, Schedule
from radioloc.simulation.truth import (
    GRAVITY_ERROR,
    DrawnErrors,
    TrueTarget,
    Truth,
    TruthSigma,
    drawn_errors,
    fixed_errors,
)
from radioloc.simulation.visibility import horizon_notes
from radioloc.targets.design import effects_on_orbit
from radioloc.targets.target import TargetDescription, declared_motion
from radioloc.time import Epochs, tai_to_utc, utc_strings, utc_to_tai
from radioloc.vectors import Floats, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """Observations of a simulated world; arrays are of shape (n,), m."""

    observations: Observations  #: with all errors; sigmas of the schedule
    targets: tuple[TrueTarget, ...]  #: with the drawn errors of their positions
    truth: Truth
    noise: NoiseModel
    seed: int
    error_free_m: Floats  #: values by the nominal model with the world's terms
    added_m: dict[str, Floats]  #: effects of the truth's errors, by kind of parameter
    drawn: dict[str, float]  #: drawn errors by parameter
    drawn_m: Floats  #: their effects
    noise_m: Floats
    is_outlier: Mask
    notes: tuple[str, ...] = ()  #: types without noise, and complexes of which all antennas take part

    def __repr__(self) -> str:
        first, last = self.observations.span().day_strings()
        outliers = int(self.is_outlier.sum())
        return (
            f"<Simulated {len(self.observations)} {first} to {last}, seed {self.seed}, {outliers} outliers>"
        )

    def summary(self) -> str:
        """Return a text about the observations and their errors, for people and for the head of a file."""
        lines = [
            "simulated observations",
            self.observations.summary(),
            *(line for target in self.targets for line in _described(target, len(self.targets) > 1)),
            f"seed {self.seed}, {int(self.is_outlier.sum())} outlier(s)",
            *self.notes,
            *(f"drawn {name}: {error:.4g}" for name, error in self.drawn.items()),
        ]
        return "\n".join(lines)


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Simulated world without noise; any number of realizations can be drawn from it."""

    scenario: Scenario
    plan: Plan
    targets: tuple[TrueTarget, ...]
    error_free_m: Floats  #: this and the following as in Simulated
    added_m: dict[str, Floats]
    errors: dict[str, float]  #: errors of the truth by parameter, such as "range_bias.KASHI"
    drawn: DrawnErrors  #: errors of the trials of a Monte Carlo study
    notes: tuple[str, ...] = ()  #: as in Simulated

    def __repr__(self) -> str:
        return f"<World {len(self.plan.observations)} observations of {self.scenario.name}>"

    @property
    def value_m(self) -> Floats:
        """Observed values without noise and drawn errors, m, shape (n,)."""
        return np.asarray(self.error_free_m + sum(self.added_m.values(), start=0.0))

    @property
    def drawn_keys(self) -> tuple[str, ...]:
        """Keys of the drawn errors: those of the scenario, then those of other considered errors."""
        kinds = (PARAMETERS.get(name.partition(".")[0]) for name in self.drawn.names)
        keys = (kind.value_key for kind in kinds if kind is not None)
        return tuple(dict.fromkeys((*self.scenario.truth_sigma.keys, *keys)))

    def draw(
        self, noise: NoiseModel | None = None, *, seed: int | None = None, draw_errors: bool = False
    ) -> Simulated:
        """Return observations with one realization of the noise and, with `draw_errors`, of errors of `truth_sigma`.

        Noise and seed are those of the scenario by default.
        """
        scenario = self.scenario
        noise = scenario.noise if noise is None else noise
        seed = scenario.seed if seed is None else seed
        noise_m, is_outlier = noise.draw(self.plan, seed)
        errors = self.drawn.draw(seed) if draw_errors else np.zeros(len(self.drawn.names))
        drawn = self.drawn.by_name(errors) if draw_errors else {}
        drawn_m = errors @ self.drawn.partials
        value_m = self.value_m + drawn_m + noise_m
        value_m.flags.writeable = False
        return Simulated(
            observations=replace(self.plan.observations, value_m=value_m),
            targets=tuple(target.displaced(drawn) for target in self.targets),
            truth=scenario.truth,
            noise=noise,
            seed=seed,
            error_free_m=self.error_free_m,
            added_m=self.added_m,
            drawn=drawn,
            drawn_m=drawn_m,
            noise_m=noise_m,
            is_outlier=is_outlier,
            notes=self.notes,
        )


@runtime_checkable
class StateAndForces(Protocol):
    """Orbit to be integrated over the sessions, such as :class:`~radioloc.study.orbiter.Orbiter`."""

    def orbit_spanning(
        self, model: PhysicalModel, utc: Epochs, count_s: float, parameters: tuple[str, ...] = ()
    ) -> AdjustableOrbit:
        """Return the orbit from one epoch to another, and beyond as far as count intervals need."""
        ...

    def with_gravity_errors(
        self, orbit: AdjustableOrbit, count: int, seed: np.random.Generator
    ) -> AdjustableOrbit | None:
        """Return the orbit with drawn errors of its gravity field; ``None`` without any."""
        ...


TargetRecord = LunarPosition | SpacecraftTrajectory | StateAndForces | TargetDescription
"""Description of a target's true position or motion."""
ConsideredOf = Callable[[Predictor], Mapping[str, ParameterChoice]]
"""Function that returns the errors that a fit of observations considers, by kind, with their sigmas."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """Simulation apart from the nominal model, with which the observations would be fitted.

    Examples
    --------
    >>> import radioloc
    >>> from radioloc.measurements import PhysicalModel
    >>> from radioloc.simulation import Scenario, Schedule, Session, two_way
    >>> lander = radioloc.LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
    >>> start, stop = "2020-12-01T17:00:00", "2020-12-01T18:00:00"
    >>> hour = Session("range", two_way("KASHI"), start, stop, step_s=60.0, sigma_m=2.5)
    >>> Scenario(Schedule([hour]), lander, seed=1).world(PhysicalModel.build()).draw()
    <Simulated 61 2020-12-01 to 2020-12-01, seed 1, 0 outliers>
    """

    schedule: Schedule
    #: True position, trajectory or orbit of the target, or of several by name.
    position: TargetRecord | Mapping[str, TargetRecord]
    truth: Truth = field(default_factory=Truth)  #: differences of the world from the nominal model
    noise: NoiseModel = field(default_factory=NoiseModel)  #: random errors
    #: Errors about those of the truth, drawn anew in every trial.
    truth_sigma: TruthSigma = field(default_factory=TruthSigma)
    seed: int = 0  #: whole number from zero up; the same seed gives the same errors
    name: str = "lander"  #: name of a single target in the observations

    def __post_init__(self) -> None:
        require_seed(self.seed)

    @property
    def targets(self) -> dict[str, TargetRecord]:
        """True positions, trajectories and orbits by name."""
        if isinstance(self.position, Mapping):
            return dict(self.position)
        return {self.name: self.position}

    @property
    def clock_epoch_utc(self) -> str:
        """Epoch of the drawn offsets of clocks and frequencies with rates, by default the middle of the sessions."""
        return self.truth_sigma.clock_epoch_utc or _middle_utc(self.schedule)

    def world(self, model: PhysicalModel, considered: ConsideredOf | None = None) -> World:
        """Compute the world without noise, for a nominal model.

        The errors that a fit considers, `considered`, are drawn unless the scenario states some of their kind.

        Raises
        ------
        InputError
            The model is not valid for an observation (too low for the troposphere).
        StationError
            A station is not in the catalogue.
        CoverageError
            An epoch lies outside the kernels or the Earth orientation table.
        """
        targets = tuple(self._target(name, record, model) for name, record in self.targets.items())
        motions = {item.name: item.motion for item in targets}
        plan = self.schedule.plan(model, motions)
        kinds = (*self.truth.values, *self.truth_sigma.sigmas)
        drawing = considered if self.truth_sigma.considered else None
        predictor = prepare_predictor(
            self.truth.model(model),
            plan.observations,
            list(motions.values()),
            targets=tuple(motions) if len(targets) > 1 else (),
            more_partials=drawing is not None or any(PARAMETERS[name].more_partials for name in kinds),
        )
        prediction = predictor.predict()
        _require_usable(predictor, prediction)
        middle = _middle_utc(self.schedule)
        added_m, errors = fixed_errors(self.truth, predictor, prediction, targets, middle)
        of_fit = {} if drawing is None else drawing(predictor)
        of_fit = {name: choice for name, choice in of_fit.items() if name not in kinds}
        drawn = drawn_errors(self.truth_sigma, predictor, prediction, targets, middle, of_fit)
        # One set of drawn fields acts on all orbits.
        effects_m = [
            effects_on_orbit(predictor, item.with_gravity_errors, k)
            for k, item in enumerate(targets)
            if item.with_gravity_errors is not None
        ]
        if effects_m:
            drawn = drawn.with_gravity(np.sum(effects_m, axis=0))
        stations = (name for link in plan.observations.links for name in link.stations)
        antennas = model.catalogue.antenna_notes(stations)
        points = [item.position_pa_m for item in targets if item.trajectory is None]
        horizon = horizon_notes(self.schedule.masks, points)
        notes = (*self.noise.notes(plan.observations), *antennas, *horizon)
        return World(self, plan, targets, prediction.value_m, added_m, errors, drawn, notes)

    def _target(self, name: str, record: TargetRecord, model: PhysicalModel) -> TrueTarget:
        """Return a target at its true position, or on its true trajectory, with the drawn errors of gravity."""
        several = len(self.targets) > 1
        if not isinstance(record, StateAndForces):
            return TrueTarget.declared(name, record, model, several)
        orbit = self.orbit(model, record)
        random = generator(self.seed, GRAVITY_ERROR)
        disturbed = record.with_gravity_errors(orbit, self.truth_sigma.gravity_errors, random)
        return replace(
            TrueTarget.declared(name, orbit.nearest(), model, several), with_gravity_errors=disturbed
        )

    def orbit(
        self, model: PhysicalModel, target: StateAndForces, parameters: tuple[str, ...] = ()
    ) -> AdjustableOrbit:
        """Return an orbit over the sessions, with partials with respect to some parameters of its forces."""
        counts_s = np.nan_to_num([session.count_s for session in self.schedule.sessions])
        return target.orbit_spanning(model, self.schedule.span(), float(counts_s.max()), parameters)


def spanning_motion(record: TargetRecord, model: PhysicalModel, utc: Epochs) -> TargetMotion:
    """Return the motion of a target, integrated over a span of UTC from a state."""
    if isinstance(record, StateAndForces):
        return TrajectoryMotion(record.orbit_spanning(model, utc, 0.0).nearest())
    return declared_motion(record, model)


def _middle_utc(schedule: Schedule) -> str:
    """Return the epoch halfway between the start of the first session and the stop of the last."""
    ends = utc_to_tai(schedule.span())
    middle = ends[:1].shifted(0.5 * ends[1:].seconds_since(ends[:1]))
    return str(utc_strings(tai_to_utc(middle), 9)[0])


def _require_usable(predictor: Predictor, prediction: Prediction) -> None:
    """Raise an error if the model is not valid for an observation."""
    observations = predictor.observations
    count, problem = 0, ""
    for rows in blocks(predictor):
        computed = prediction.rows(rows)
        unusable = np.flatnonzero(~computed.usable)
        if len(unusable) and not count:
            row = int(rows[unusable[0]])
            problem = reasons(predictor, computed.rows(unusable[:1]), [row])[1][0]
        count += len(unusable)
    if count:
        link = observations.links[observations.link[row]].path
        kind = KINDS[observations.kind[row]]
        raise InputError(
            f"{count} of {len(observations)} observations cannot be simulated; the first, a {kind} of {link}: "
            f"{problem}; raise the elevation mask, or switch the term off"
        )


def _described(target: TrueTarget, several: bool) -> Iterator[str]:
    """Yield texts of a target's true position or trajectory."""
    of_target = f" of {target.name}" if several else ""
    if target.trajectory is None:
        x, y, z = target.position_pa_m.tolist()
        yield f"true position{of_target}, principal axes, m: {x:.4f} {y:.4f} {z:.4f}"
    else:
        yield f"true trajectory{of_target}: {target.trajectory}"
