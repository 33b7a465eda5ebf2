"""The problem that a study's arc is: what is solved for, which observations can be used, and why others cannot.

Of clocks that nothing ties together, how they differ is estimated unless a study says otherwise. Three-way Doppler is
counted against the receiving station's frequency standard and transmitted by another's; one-way Doppler has the
target's oscillator at its start. An offset of 1e-12, usual of all but hydrogen masers, moves a lander by hundreds of
metres, a listener's quartz by more than the Moon is large, and the residuals do not show it. Where there are delays of
quasars, the stations' clocks, by which they are off by some microseconds, are in all delays still.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import SECONDS_PER_DAY
from radioloc.dynamics import AdjustableOrbit
from radioloc.ephemeris import EphemerisConstants, Trajectory
from radioloc.errors import InputError, named
from radioloc.estimation.consider import Consider, ConsideredErrors
from radioloc.estimation.editing import EditedFit
from radioloc.estimation.linearization import ResidualFunction
from radioloc.estimation.orbit_state import OrbitState
from radioloc.estimation.series import SeriesOrder
from radioloc.estimation.time_correlation import fit_with_correlated_weights
from radioloc.jobs.verdict import LOWEST_EARTH_DEG
from radioloc.labels import USED, Labels
from radioloc.lunar.position import LunarPosition
from radioloc.lunar.visibility import earth_elevation_rad
from radioloc.measurements.link import canonical_target
from radioloc.measurements.predictor import Predictor, blocks, reasons
from radioloc.measurements.registry import kind_of
from radioloc.measurements.target_motion import FixedPoint, Motions, OrbitMotion, TrajectoryMotion
from radioloc.media.status import Status
from radioloc.parameters.choice import ParameterChoice, chosen_parameters
from radioloc.parameters.columns import Columns
from radioloc.parameters.considered import resolved
from radioloc.parameters.design import DesignMatrix, ObservationModel
from radioloc.parameters.kind import Scope
from radioloc.parameters.motion import MotionParameters, OrbitFunction, of_points, orbit_of
from radioloc.parameters.orbit import (
    Ground,
    LandingParameters,
    landing_parameters,
    orbit_parameters,
)
from radioloc.parameters.parameter import Parameter, ParameterSet, Role
from radioloc.parameters.position import PositionParameters, cartesian, on_sphere, on_terrain
from radioloc.parameters.position_prior import PositionPrior, with_position_priors
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import networks
from radioloc.study.orbit_choice import OrbitChoice
from radioloc.study.orbiter import Orbiter
from radioloc.study.study import EstimateChoice, Study, TerrainPrior
from radioloc.time import Epochs, evaluate_smooth, tt_to_tdb, utc_to_tt

_OF_THE_EPHEMERIS = ("moon_position", "moon_position_variation", "libration", "libration_variation")
_RATE_SIGMA = 1e-11
"""Ten times that of a hydrogen maser which nobody has set; from one scan of each target a rate is not told."""


def observation_model(
    predictor: Predictor,
    targets_pa: LunarPosition | Mapping[str, LunarPosition] | None,
    estimate: EstimateChoice | None,
    held: EstimateChoice | None = None,
    considered: Sequence[tuple[Columns, list[Parameter]]] = (),
) -> ObservationModel:
    """Return the parameters of an arc, the considered ones last; without `estimate` those of `held` are fixed."""
    choice = (EstimateChoice() if held is None else held).held() if estimate is None else estimate
    kinds = []
    for name, chosen in choice.parameters.items():
        found = _columns("[estimate]", name, chosen, predictor, Role.ESTIMATED, choice)
        if found is not None:
            kinds.append(found)
    kinds += considered
    if isinstance(targets_pa, Mapping) and len(targets_pa) > 1:
        points = with_position_priors(
            [
                _place(predictor, place.xyz_m, choice, f"position.{name}")
                for name, place in targets_pa.items()
            ],
            [_prior(choice, name) for name in targets_pa],
            predictor.model.ephemeris.constants,
        )
        motions = [of_points(point) for point in points]
    else:
        place = next(iter(targets_pa.values())) if isinstance(targets_pa, Mapping) else targets_pa
        if (landing := _landing(predictor, place, choice)) is not None:
            function = OrbitFunction(landing.orbit, landing.changes)
            model = ObservationModel.of(predictor, [(landing.parameters, function)], kinds)
            return replace(model, landing=landing)
        motions = [_motion(predictor, place, choice)]
    model = ObservationModel.of(predictor, motions, kinds)
    if estimate is not None and not any(item.role is Role.ESTIMATED for item in model.parameters):
        raise InputError(
            'nothing to estimate: [estimate] position is "none" and no bias is asked for; '
            "use `radioloc residuals` to see residuals at the given position"
        )
    return model


def weighed(
    residual_function: ResidualFunction,
    fitted: EditedFit,
    order: SeriesOrder,
    estimate: EstimateChoice | None,
) -> EditedFit:
    """Repeat the fit with the weights that a study asks for."""
    if estimate is not None and estimate.weights == "correlated":
        return fit_with_correlated_weights(residual_function, fitted, order)
    return fitted


@dataclass(frozen=True, slots=True, eq=False)
class ConsideredParameters:
    """Considered parameters of an arc, with their columns of the design matrix."""

    in_weights: list[tuple[Columns, list[Parameter]]] = field(default_factory=list)
    suboptimal: list[tuple[Columns, list[Parameter]]] = field(default_factory=list)  # left out of the weights
    notes: tuple[str, ...] = ()  # on those that are not considered

    @classmethod
    def of(cls, study: Study, predictor: Predictor, estimate: EstimateChoice | None) -> ConsideredParameters:
        """Return those of a study and the defaults of their kinds; none where nothing is estimated."""
        if estimate is None:
            return cls()
        moon_is_in = any(estimate.ephemeris_sigma_m) or bool(predictor.trajectories)
        with named("[consider]"):
            choices, notes = resolved(
                study.consider,
                predictor,
                estimate.parameters,
                defaults=study.consider_defaults,
                without=_OF_THE_EPHEMERIS if moon_is_in else (),
            )
        found = cls(notes=tuple(notes))
        for name, choice in choices.items():
            columns = _columns("[consider]", name, choice, predictor, Role.CONSIDERED, estimate)
            if columns is not None:
                (found.suboptimal if name in study.suboptimal else found.in_weights).append(columns)
        return found

    def suboptimal_errors(
        self, problem: ObservationModel, x: NDArray[np.float64], errant: AdjustableOrbit | None
    ) -> ConsideredErrors | None:
        """Return the errors that stay out of the weights, those of the gravity field last, at parameters x."""
        gravity = gravity_errors(errant, problem)
        if not self.suboptimal:
            return gravity
        model = ObservationModel.of(problem.predictor, (), self.suboptimal)
        motions = problem.motions(x)
        at, residual_m = problem.predictor.at(motions), np.zeros(0)  # residuals are not asked for
        design = DesignMatrix(model, at, motions, model.parameters.prior_values, residual_m)
        if gravity is None:
            return ConsideredErrors(model.parameters, design.partials)
        return ConsideredErrors(
            ParameterSet([*model.parameters, *gravity.parameters]),
            lambda rows: np.hstack([design.partials(rows), gravity.partials(rows)]),
        )


def disturbed(study: Study, problem: ObservationModel, x: NDArray[np.float64]) -> AdjustableOrbit | None:
    """The orbit at parameters x, with the errors of its gravity field that are considered, if it is one."""
    orbit = problem.orbit_at(x)
    if problem.process is not None or orbit is None or not isinstance(study.target, Orbiter):
        return None  # process noise stands for what the field leaves out
    return study.target.disturbed(orbit)


def require_position_or_orbit(study: Study, what: str) -> None:
    """Refuse a study in which neither a position nor an orbit is estimated."""
    if not isinstance(study.target, Orbiter) and study.estimate.position == "none":
        raise InputError(f'{what} needs the position estimated: [estimate] position is "none"')


def fitted_orbit(
    study: Study,
    problem: ObservationModel,
    x: NDArray[np.float64],
    covariance: NDArray[np.float64],
    consider: Consider | None,
    errant: AdjustableOrbit | None,
) -> OrbitState:
    """The state of the orbit whose parameters come first in x and `covariance`, which is of all that is uncertain."""
    assert isinstance(study.target, Orbiter)
    mine = slice(0, problem.first)
    motion, by = problem.functions[0](x[mine])
    assert isinstance(motion, OrbitMotion)
    estimated = motion.trajectory
    assert isinstance(estimated, AdjustableOrbit)
    estimated.require_above_ground()
    sensitivity = np.zeros((problem.first, 0))
    if consider is not None:
        sensitivity = consider.sensitivity[mine][:, list(consider.parameters.of_kind("gravity_error"))]
    return OrbitState(
        estimated,
        by @ covariance[mine, mine] @ by.T,
        by @ sensitivity,
        errant if sensitivity.size else None,
        study.target.body,
    )


def gravity_errors(orbit: AdjustableOrbit | None, problem: ObservationModel) -> ConsideredErrors | None:
    """Errors of an orbit's gravity field, with what they do to the observations."""
    if orbit is None:
        return None
    effects = problem.predictor.compute(orbit).by_motion
    names = [f"gravity_error.{k + 1}" for k in range(effects.shape[1])]
    parameters = [Parameter(name, "1", "gravity_error", 0.0, 1.0, role=Role.CONSIDERED) for name in names]
    return ConsideredErrors(ParameterSet(parameters), lambda rows: effects[rows])


def _columns(
    table: str, name: str, chosen: ParameterChoice, predictor: Predictor, role: Role, estimate: EstimateChoice
) -> tuple[Columns, list[Parameter]] | None:
    kind = PARAMETERS[name]
    with named(table):
        return chosen_parameters(kind, chosen, predictor.simple, role, estimate.pass_gap_h)


def _motion(
    predictor: Predictor, target_pa: LunarPosition | None, choice: EstimateChoice
) -> MotionParameters:
    orbit = orbit_of(predictor)
    if orbit is not None:
        given, estimated = choice.orbit or OrbitChoice(), choice.orbit is not None
        sigmas = given.sigmas(orbit.forces) if estimated else {}
        parameters, changes = orbit_parameters(orbit, sigmas, estimated, given.state, given.form)
        return parameters, OrbitFunction(orbit, changes)
    if target_pa is None:
        [trajectory] = predictor.trajectories
        parameters, _ = cartesian(np.zeros(3), role=Role.FIXED, name="offset")
        return parameters, lambda x: (TrajectoryMotion(trajectory, x), np.eye(3))
    constants = predictor.model.ephemeris.constants
    place = _place(predictor, target_pa.xyz_m, choice)
    return of_points(with_position_priors([place], [_prior(choice, "")], constants)[0])


def _prior(choice: EstimateChoice, target: str) -> PositionPrior | None:
    """A-priori position of a target that is estimated in geographic coordinates."""
    if choice.position != "geographic":
        return None
    return next((one for one in choice.position_priors if one.target == target), None)


def _place(
    predictor: Predictor, start_pa_m: NDArray[np.float64], choice: EstimateChoice, name: str = "position"
) -> PositionParameters:
    if choice.position != "geographic":
        role = Role.FIXED if choice.position == "none" else Role.ESTIMATED
        return cartesian(start_pa_m, role=role, name=name)
    height, constants = choice.height_prior, predictor.model.ephemeris.constants
    prior = _prior(choice, name.partition(".")[2])
    if prior is not None:
        start_pa_m = prior.mean.to_axes("PA", constants).xyz_m
    if isinstance(height, TerrainPrior):
        return on_terrain(start_pa_m, height.terrain, height.sigma_m, constants, name)
    if height is None or (prior is not None and prior.has_height):
        return on_sphere(start_pa_m, None, name)
    return on_sphere(start_pa_m, (height.height_m, height.sigma_m), name)


def _landing(
    predictor: Predictor, target_pa: LunarPosition | None, choice: EstimateChoice
) -> LandingParameters | None:
    """Parameters of an orbit that ends on the ground; where nothing is estimated, those of the a-priori orbit."""
    orbit = orbit_of(predictor)
    if orbit is None or orbit.touchdown is None:
        return None
    ground, estimated = Ground(predictor.model, orbit.touchdown), choice.orbit is not None
    start_pa_m = target_pa.xyz_m if target_pa is not None and estimated else ground.place_pa_m(orbit.state)
    given = choice.orbit or OrbitChoice()
    place, sigmas = _place(predictor, start_pa_m, choice), given.sigmas(orbit.forces)
    landing = landing_parameters(orbit, ground, place, given.touchdown_sigma_m_s, sigmas)
    if estimated:
        return landing
    fixed = [
        replace(item, prior_value=value, role=Role.FIXED)
        for item, value in zip(landing.parameters, landing.values_of(orbit).tolist(), strict=True)
    ]
    return replace(landing, parameters=fixed)


def targets_in_pa(study: Study, constants: EphemerisConstants) -> dict[str, LunarPosition]:
    """Return the a-priori positions in principal axes by name; none where the target is a trajectory."""
    if isinstance(study.target, Trajectory | Orbiter):
        return {}
    given = {name: (f"[targets.{name}]", position) for name, position in study.targets.items()}
    given = given or {"": ("[target]", study.target)}
    places = {
        canonical_target(name): position_in_pa(table, position, constants)
        for name, (table, position) in given.items()
    }
    for prior in study.estimate.position_priors:
        places[prior.target] = position_in_pa("[[observations.map_positions]]", prior.mean, constants)
    return places


def planned_place(study: Study, constants: EphemerisConstants) -> LunarPosition | None:
    """The a-priori place in principal axes where the target lands, if it does and there is one."""
    landing = study.target.landing if isinstance(study.target, Orbiter) else None
    if landing is None or landing.place is None:
        return None
    return position_in_pa("[target.landing]", landing.place, constants)


def apriori_points(targets_pa: Mapping[str, LunarPosition]) -> Motions:
    """Return the a-priori positions as motions."""
    return tuple(FixedPoint(position.xyz_m) for position in targets_pa.values())


def position_in_pa(table: str, position: LunarPosition, constants: EphemerisConstants) -> LunarPosition:
    """A position of the study in principal axes; an error names its table."""
    with named(f"{table} frame:"):
        return position.to_axes("PA", constants)


def status_of(arc: Predictor, motions: Motions | None = None) -> tuple[Labels, NDArray[np.int8]]:
    """Return why observations cannot be used for motions, by default those of the arc, as text and by code."""
    motions = arc.motions if motions is None else motions
    at, model = arc.at(motions), arc.model
    # The Moon hides spacecraft in the predictions themselves.
    earth_rad = {
        k: partial(earth_elevation_rad, model.ephemeris, model.libration, point_pa_m=motion.position_pa_m)
        for k, motion in enumerate(motions)
        if motion.trajectory is None
    }
    epoch = arc.observations.epoch
    may_set = [k for k, above in earth_rad.items() if _lowest_deg(above, epoch) < LOWEST_EARTH_DEG + 1.0]
    reason = np.zeros(len(arc.observations), dtype=np.int8)
    labels = np.zeros(len(arc.observations), dtype=np.int32)
    places = {USED: 0}
    for rows in blocks(arc):
        computed = at.rows(rows)
        bad = np.flatnonzero(~computed.usable)
        reason[rows[bad]], sentences = reasons(arc, computed.rows(bad), rows[bad])
        texts, which = np.unique(sentences, return_inverse=True)
        new = [places.setdefault(str(text), len(places)) for text in texts]
        labels[rows[bad]] = np.array(new, dtype=np.int32)[which]
        for target in may_set:
            mine = rows[(arc.target[rows] == target) & (reason[rows] == Status.OK)]
            # The Earth moves in the lander's sky with the librations, in days.
            tdb = tt_to_tdb(utc_to_tt(arc.observations.epoch[mine]))
            above_deg = np.degrees(evaluate_smooth(earth_rad[target], tdb))
            for k in np.flatnonzero(above_deg < LOWEST_EARTH_DEG):
                text = Status.EARTH_BELOW_HORIZON.text(above_deg[k])
                reason[mine[k]] = Status.EARTH_BELOW_HORIZON
                labels[mine[k]] = places.setdefault(text, len(places))
    return Labels(labels, tuple(places)), reason


def _lowest_deg(earth_rad: Callable[[Epochs], NDArray[np.float64]], epoch_utc: Epochs) -> float:
    """Return the lowest elevation of the Earth every six hours, in which it moves half a degree."""
    if not len(epoch_utc):
        return math.inf
    ends = epoch_utc[[int(epoch_utc.mjd.argmin()), int(epoch_utc.mjd.argmax())]]
    first, last = (tt_to_tdb(utc_to_tt(ends))[[k]] for k in (0, 1))
    span_d = last.seconds_since(first)[0] / SECONDS_PER_DAY
    count = int(4.0 * span_d) + 2
    if count > len(epoch_utc):
        return -math.inf
    epochs = Epochs.from_jd(first.jd, first.fraction + np.linspace(0.0, span_d, count), "TDB")
    return float(np.degrees(earth_rad(epochs).min()))


def with_independent_clocks(study: Study, estimate: EstimateChoice, arc: Predictor) -> EstimateChoice:
    """Return the study with offsets of independent clocks, unless ``[consider] defaults = false``.

    Held at zero, offsets of 1e-11 put the lander where it is not (`tests/unit/jobs/test_independent_clocks.py`).
    """
    if not study.consider_defaults:
        return estimate
    estimated, considered = set(estimate.parameters), set(study.consider)
    chosen = _frequency_offsets(estimated | (considered & {"frequency_offset"}), arc)
    chosen |= _clocks(estimated | considered, arc)
    return replace(estimate, parameters={**estimate.parameters, **chosen}) if chosen else estimate


def _frequency_offsets(said: set[str], tracking: Predictor) -> dict[str, ParameterChoice]:
    """Return a free offset for each link and pass of one- and three-way Doppler, unless the study has its own."""
    if said & {"frequency_offset", "clock_rate"}:
        return {}
    observations = tracking.observations
    three_way = [bool(link.transmitter) and link.transmitter != link.receiver for link in observations.links]
    free = (observations.kind == kind_of("doppler")) & np.array(three_way)[observations.link]
    if "target_frequency" not in said:
        free |= observations.kind == kind_of("one_way_doppler")
    paths = tuple(observations.links[k].path for k in np.unique(observations.link[free]))
    return {"frequency_offset": ParameterChoice(paths, per=Scope.LINK_AND_PASS)} if paths else {}


def _clocks(said: set[str], tracking: Predictor) -> dict[str, ParameterChoice]:
    """Offsets, free, and rates of the stations that have delays of quasars, but for the first, unless any are said."""
    of_quasars = (tracking.target < 0) & (tracking.observations.kind == kind_of("vlbi_delay"))
    if said & {"clock", "clock_rate"} or not of_quasars.any():
        return {}
    ends = np.stack([tracking.transmitters, tracking.receivers], axis=-1)[of_quasars]
    network, there = networks(ends, len(tracking.stations)), np.unique(ends)
    first = {network[k]: k for k in there[::-1]}
    names = tuple(tracking.stations[k] for k in there if first[network[k]] != k)
    return {"clock": ParameterChoice(names), "clock_rate": ParameterChoice(names, sigma=_RATE_SIGMA)}
