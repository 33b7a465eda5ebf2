"""Study: targets, observations, model and estimated parameters.

The records check themselves, with the same rules in Python as in a study file
(:mod:`radioloc.study.study_file`): an :class:`~radioloc.errors.InputError` names the key.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeAlias, get_args

from radioloc.earth.eop_prediction import BEYOND
from radioloc.earth.stations import StationCatalogue
from radioloc.ephemeris import Trajectory
from radioloc.errors import InputError, error_context, require_type
from radioloc.estimation.noise_structure import by_link
from radioloc.estimation.series import SeriesOrder
from radioloc.labels import Labels
from radioloc.lunar import TerrainModel
from radioloc.lunar.position import LunarPosition
from radioloc.lunar.selenographic import require_lunar_height
from radioloc.measurements.equipment_delays import EquipmentDelays, StationDelay
from radioloc.measurements.evaluation import EVALUATIONS
from radioloc.measurements.link import canonical_target
from radioloc.measurements.physical_model import active_terms
from radioloc.measurements.predictor import Predictor
from radioloc.media.ionosphere import UniformTec
from radioloc.parameters.choice import ParameterChoice, parameter_choices, without_unobserved_members
from radioloc.parameters.columns import PASS_GAP_H
from radioloc.parameters.registry import PARAMETERS
from radioloc.plugins import DerivedNames
from radioloc.quantities import convert_quantity
from radioloc.results.subsets import Reference
from radioloc.simulation.simulate import Scenario
from radioloc.study.map_positions import position_priors
from radioloc.study.observation_choice import ObservationChoice
from radioloc.study.orbit_choice import OrbitChoice
from radioloc.study.orbiter import Orbiter
from radioloc.study.schema import TomlTable, as_names, check, entry
from radioloc.targets.position_prior import PositionPrior
from radioloc.targets.target import TargetDescription
from radioloc.time import Epochs
from radioloc.units import set_fields

WEIGHTS = ("independent", "correlated")
COMPONENTS = ("type", "link", "link and pass")
POSITION_FORMS = ("geographic", "cartesian", "none")
MIN_REJECTION_SIGMA = 2.0  # Lower values reject good data: one in 22 normal residuals exceeds two sigmas
PARAMETER_KEYS = DerivedNames(lambda: [key for kind in PARAMETERS.values() for key in kind.keys.values()])
"""Keys of the kinds of parameter in ``[estimate]`` and ``[consider]``."""


def read_parameters(table: TomlTable, _: str = "") -> dict[str, ParameterChoice]:
    """Read the keys of all kinds of parameter."""
    settings = {key: value for key in PARAMETER_KEYS if (value := table.take(key)) is not None}
    return table.build(parameter_choices, settings=settings)


def _height_prior(table: TomlTable, key: str) -> HeightPrior | TerrainPrior | None:
    prior = table.table(key)
    if prior is None:
        return None
    dem, interpolation = prior.get("dem", Path), prior.get("interpolation", str)
    if dem is None:
        if interpolation is not None:
            prior.fail("interpolation", "belongs to a terrain model; name one as dem")
        return prior.read(HeightPrior)
    if "height_m" in prior:
        prior.fail("height_m", "give either dem or height_m, not both")
    terrain = prior.build(TerrainModel.open, path=dem, interpolation=interpolation)
    return prior.read(TerrainPrior, terrain=terrain)


def _kernel(table: TomlTable, key: str) -> str | None:
    """Return a registered name, or the path of a file beside the study file."""
    name: str | None = table.get(key, str)
    return name if name is None or not Path(name).suffix else str(table.path.parent / name)


def _delays(table: TomlTable, _: str) -> EquipmentDelays:
    by_station = table.table("station_delay_s")
    keys = {"transmit": "transmit_s", "receive": "receive_s"}
    stations = {} if by_station is None else by_station.named()
    delays = {name: delay.read(StationDelay, keys) for name, delay in stations.items()}
    transponder_s = table.get("transponder_delay_s", float)
    return table.build(EquipmentDelays, transponder_s=transponder_s, stations=delays)


@dataclass(frozen=True, slots=True)
class HeightPrior:
    """Prior on the height above the 1737.4 km sphere."""

    height_m: float
    sigma_m: float = entry(positive=True)

    def __post_init__(self) -> None:
        check(self)
        require_lunar_height(self.height_m)


@dataclass(frozen=True, slots=True)
class TerrainPrior:
    """Prior on the height from a terrain model in mean-Earth axes.

    The sigma is that of the model; the roughness of the terrain about the a-priori position is added to it.
    """

    terrain: TerrainModel
    sigma_m: float = entry(positive=True)

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, slots=True, init=False)
class EstimateChoice:
    """Keys of ``[estimate]``, as the reference of the study file describes them, with those of all kinds of parameter.

    For example ``EstimateChoice(range_bias="all", range_bias_sigma_m=10.0)``. `parameters` are choices by kind, which
    the keys change; `position_priors` are those of positions on maps, which the study sets.
    """

    position: str = entry("geographic", choices=POSITION_FORMS)
    height_prior: HeightPrior | TerrainPrior | None = entry(None, read=_height_prior)
    ephemeris_sigma_m: tuple[float, float, float] = entry(
        (0.0, 0.0, 0.0), not_negative=True, kind=float | tuple[float, float, float]
    )
    rejection_sigma: float = 5.0
    weights: str = entry(
        "correlated",
        choices=WEIGHTS,
        advice="sigmas by type, station and file belong to [[observations.weights]]",
    )
    variance_components: str = entry("type", choices=COMPONENTS)
    pass_gap_h: float = entry(PASS_GAP_H, positive=True)
    clock_epoch: Epochs | None = entry(None, moment=True)
    orbit: OrbitChoice | None = None
    position_priors: tuple[PositionPrior, ...] = entry((), keys=(), read=lambda *_: None)
    parameters: Mapping[str, ParameterChoice] = entry(factory=dict, keys=PARAMETER_KEYS, read=read_parameters)

    def __init__(self, *, parameters: Mapping[str, ParameterChoice] | None = None, **keys: Any) -> None:
        for f in fields(self):
            if f.name != "parameters":
                set_fields(self, **{f.name: keys.pop(f.name, f.default)})
        set_fields(self, parameters=parameter_choices(keys, parameters))
        sigmas_m = convert_quantity("ephemeris_sigma_m", self.ephemeris_sigma_m)
        sigmas_m = tuple(sigmas_m) if isinstance(sigmas_m, Iterable) else (sigmas_m,) * 3
        set_fields(self, ephemeris_sigma_m=sigmas_m)
        check(self)
        if self.height_prior is not None and self.position != "geographic":
            raise InputError('height_prior needs position = "geographic"')
        if len(sigmas_m) != 3:
            raise InputError(f"ephemeris_sigma_m: expected three numbers (east, north, up), got {sigmas_m!r}")
        if not (math.isfinite(self.rejection_sigma) and self.rejection_sigma >= MIN_REJECTION_SIGMA):
            raise InputError(
                f"rejection_sigma: expected {MIN_REJECTION_SIGMA:g} or more, got {self.rejection_sigma!r}"
            )

    def component_groups(self, order: SeriesOrder) -> Labels | None:
        """Return the groups of observations with a variance component each, or None if residuals determine them."""
        if self.variance_components == "type":
            return None
        return by_link(order, 3600.0 * self.pass_gap_h if "pass" in self.variance_components else math.inf)

    def without_estimates(self) -> EstimateChoice:
        """Return the choice with all parameters fixed at their a-priori values."""
        values = {
            name: ParameterChoice(value=choice.value, per=choice.per)
            for name, choice in self.parameters.items()
        }
        return EstimateChoice(position="none", clock_epoch=self.clock_epoch, parameters=values)

    def restricted_to(self, part: Predictor) -> EstimateChoice:
        """Return the choice for a part of an arc, without members that lack observations."""
        try:
            parameters = {
                name: without_unobserved_members(PARAMETERS[name], choice, part.uncombined)
                for name, choice in self.parameters.items()
            }
        except InputError as error:
            raise type(error)(f"[estimate] {error}") from None
        return replace(self, parameters=parameters)


@dataclass(frozen=True, slots=True)
class ModelChoice:
    """Keys of ``[model]``, as the reference of the study file describes them, with the delays as one record."""

    off: tuple[str, ...] = ()
    ephemeris: str = entry("DE421", read=_kernel)
    libration: str = entry("DE421", read=_kernel)
    earth_orientation: Path | None = None
    eop_beyond: str | None = entry(None, choices=BEYOND)
    ionex: tuple[Path, ...] = ()
    tec_tecu: float | None = None
    vmf3: tuple[Path, ...] = ()
    vmf3_orography: Path | None = None
    gpt3: Path | None = None
    csp: tuple[Path, ...] = ()
    csp_scid: int | None = None
    delays: EquipmentDelays = entry(
        factory=EquipmentDelays, keys=("transponder_delay_s", "station_delay_s"), read=_delays
    )
    sources: tuple[Path, ...] = ()
    free_clocks: tuple[str, ...] = ()
    evaluation: str = entry("auto", choices=EVALUATIONS)

    def __post_init__(self) -> None:
        check(self)
        set_fields(self, free_clocks=as_names("free_clocks", self.free_clocks))
        set_fields(self, off=as_names("off", self.off))
        with error_context("off:"):
            active_terms(self.off)  # refuses unknown names
        if self.ionex and self.tec_tecu is not None:
            raise InputError("give either ionex or tec_tecu, not both")
        if self.csp_scid is not None and not self.csp:
            raise InputError("csp_scid needs csp, the files of the spacecraft; give them, or leave it out")
        if self.tec_tecu is not None:
            UniformTec(self.tec_tecu)  # refuses impossible values


@dataclass(frozen=True, slots=True)
class CovarianceChoice:
    """Keys of ``[covariance]``, for covariance studies."""

    candidates: tuple[str, ...] | None = None


AnyTarget: TypeAlias = LunarPosition | Trajectory | Orbiter | TargetDescription
"""A-priori record of a target."""

_FIELD_TYPES: Mapping[str, tuple[type, ...]] = {
    "target": (*get_args(AnyTarget), type(None)),
    "observations": (ObservationChoice,),
    "estimate": (EstimateChoice,),
    "model": (ModelChoice,),
    "catalogue": (StationCatalogue,),
    "reference": (Reference, type(None)),
    "references": (Iterable,),
    "name": (str,),
    "simulation": (Scenario, type(None)),
    "targets": (Mapping,),
    "consider": (Mapping,),
    "extensions": (Mapping,),
}
"""Types of the fields of a study built in Python."""


@dataclass(frozen=True, slots=True)
class Study:
    """Study, read from a file or built in Python.

    Raises
    ------
    InputError
        Fields contradict each other or have the wrong type.
    """

    #: A-priori position; or a known trajectory, which needs ``position="none"``; or an orbiter; or a target of a
    #: kind in :data:`~radioloc.targets.TARGET_KINDS`. By default the first of `targets`.
    target: AnyTarget = None  # type: ignore[assignment]  #: of targets, then
    observations: ObservationChoice = field(default_factory=ObservationChoice)
    estimate: EstimateChoice = field(default_factory=EstimateChoice)
    model: ModelChoice = field(default_factory=ModelChoice)
    catalogue: StationCatalogue = field(default_factory=StationCatalogue.default)  #: stations
    reference: Reference | None = None  #: known position to compare the result with
    references: tuple[Reference, ...] = ()  #: further known positions, for the table of an arc-length study
    name: str = "study"  #: name on the result card
    simulation: Scenario | None = None  #: tracking to be simulated, of all targets
    #: Several targets of any kinds, by their names in the observations.
    targets: Mapping[str, AnyTarget] = field(default_factory=dict)
    #: Consider parameters with their a-priori sigmas, of
    #: :func:`~radioloc.parameters.considered.considered_choices`. They are not estimated; their errors are in
    #: the covariance.
    consider: Mapping[str, ParameterChoice] = field(default_factory=dict)
    #: Whether other kinds of parameter are considered with their default sigmas.
    consider_defaults: bool = True
    #: Kinds of consider parameters that the weights neglect: their effect on the estimate is added to its
    #: covariance (classical consider analysis).
    suboptimal: tuple[str, ...] = ()
    path: Path | None = None  #: file of the study
    #: Stations, and links by their paths, whose improvement a covariance study predicts; by default stations of
    #: the catalogue.
    candidates: tuple[str, ...] | None = None
    target_name: str | None = None  #: name of `target`, compared with that in the tracking data
    #: Records of tables of other packages (:class:`~radioloc.study.StudyTable`), by the name of the table.
    extensions: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, types in _FIELD_TYPES.items():
            require_type(f"Study: {name}", getattr(self, name), *types)
        set_fields(self, references=tuple(self.references))
        for k, reference in enumerate(self.references):
            require_type(f"Study: references[{k}]", reference, Reference)
        if self.candidates is not None:
            set_fields(self, candidates=tuple(self.candidates))
        self._name_targets()
        self._require_considered()
        self._set_position_priors()
        if self.orbiters:
            chosen = self.estimate.orbit or OrbitChoice()
            for orbiter in self.orbiters.values():
                chosen.parameters(orbiter.forces)
            position = self.estimate.position if self.landers or self.described else "none"
            set_fields(self, estimate=replace(self.estimate, position=position, orbit=chosen))
            self._require_states(chosen)
            if chosen.process_noise is not None:
                # The information filter of process noise takes the place of weights correlated in time.
                set_fields(self, estimate=replace(self.estimate, weights="independent"))
                self._require_process_noise()
        elif self.estimate.orbit is not None:
            raise InputError('[estimate.orbit] belongs to a target with dynamics = "moon"; leave it out')
        self._require_simulated()
        if not self.points and not self.described:
            self._require_no_position()

    @property
    def all_targets(self) -> Mapping[str, AnyTarget]:
        """A-priori records of all targets by name; the name of a single one is empty."""
        return self.targets or {"": self.target}

    @property
    def points(self) -> dict[str, LunarPosition]:
        """A-priori positions of the targets that are points on the Moon, by name."""
        return self._of_kind(LunarPosition)

    @property
    def names_in_order(self) -> tuple[str, ...]:
        """Names of several targets in the order of an arc: points on the Moon, a trajectory, an orbiter."""
        if len(self.targets) < 2:
            return ()
        return (*self.points, *(name for name in self.targets if name not in self.points))

    @property
    def orbiters(self) -> dict[str, Orbiter]:
        """Targets whose orbits are determined, by name."""
        return self._of_kind(Orbiter)

    @property
    def orbiter(self) -> Orbiter | None:
        """First target whose orbit is determined."""
        return next(iter(self.orbiters.values()), None)

    @property
    def landers(self) -> tuple[str, ...]:
        """Names of the targets with a place on the Moon, landing orbiters included, in the order of an arc."""
        return (*self.points, *(name for name, item in self.orbiters.items() if item.landing is not None))

    @property
    def trajectories(self) -> dict[str, Trajectory]:
        """Known trajectories of targets, by name."""
        return self._of_kind(Trajectory)

    @property
    def described(self) -> dict[str, TargetDescription]:
        """Targets of registered kinds, by name."""
        return self._of_kind(TargetDescription)

    def _of_kind(self, kind: Any) -> dict[str, Any]:
        return {name: item for name, item in self.all_targets.items() if isinstance(item, kind)}

    def __repr__(self) -> str:
        target = ", ".join(self.targets) if len(self.targets) > 1 else repr(self.target).strip("<>")
        estimated = [name for name, choice in self.estimate.parameters.items() if choice.names != "none"]
        if self.estimate.position != "none":
            estimated.insert(0, f"{self.estimate.position} position")
        return (
            f"<Study {self.name}: {target}; {len(self.observations.files)} file(s); "
            f"estimates {', '.join(estimated) or 'nothing'}"
            f"{'; simulated' if self.simulation else ''}>"
        )

    def _name_targets(self) -> None:
        named: dict[str, AnyTarget] = {}
        for name, target in self.targets.items():
            require_type(f"[targets.{name}]", target, *get_args(AnyTarget))
            if canonical_target(name) in named:
                raise InputError(
                    f"[targets.{name}]: expected different targets, got {canonical_target(name)} twice"
                )
            named[canonical_target(name)] = target
        set_fields(self, targets=named)
        first = next(iter(named.values()), None)
        if self.target is None and first is None:
            raise InputError(
                "[target] is missing; it gives the a-priori position, or [targets.NAME] that of each"
            )
        if self.target is None:
            set_fields(self, target=first)
        elif first is not None and self.target is not first:
            raise InputError("give either [target] or [targets.NAME], not both")
        if len(named) > 1:
            of_one_position = {"[reference]": self.reference, "[references]": self.references}
            for key in filter(of_one_position.get, of_one_position):
                raise InputError(f"{key}: expected one position, but [targets] gives several; leave it out")

    def _require_simulated(self) -> None:
        """Refuse a simulation of other targets than those of the study, and errors that none of them has."""
        if self.simulation is None:
            return
        simulated = [canonical_target(name) for name in self.simulation.targets]
        if len(self.all_targets) != len(simulated) or (
            len(simulated) > 1 and {*simulated} != {*self.targets}
        ):
            raise InputError(
                f"[simulation]: expected the targets of the study ({', '.join(self.targets) or 'one'}), "
                f"got {', '.join(simulated)}"
            )
        sigma = self.simulation.truth_sigma
        if any(sigma.position_enu_m) and len(self.orbiters) == len(simulated):
            raise InputError(
                "[simulation.truth_sigma] position_enu_m belongs to a place on the Moon; leave it out"
            )
        if sigma.gravity_errors and not self.orbiters:
            raise InputError("[simulation.truth_sigma] gravity_errors belongs to an orbiter; leave it out")

    def _require_states(self, choice: OrbitChoice) -> None:
        """Refuse keys of the state if all targets land: their parameters are place and velocity of the touchdown."""
        sigmas = choice.state_sigma_m, choice.state_sigma_m_s, choice.state_sigma or None
        if all(item.landing is not None for item in self.orbiters.values()) and not (
            choice.state and sigmas == (None, None, None)
        ):
            raise InputError(
                "[estimate.orbit] state and its sigmas belong to a target that does not land; leave them out"
            )

    def _set_position_priors(self) -> None:
        places, estimate = self.observations.map_positions, self.estimate
        if not self.landers or not (places or estimate.position_priors):
            return
        height = estimate.height_prior
        with error_context("[[observations.map_positions]]"):
            if places and estimate.position != "geographic":
                raise InputError(
                    f'expected [estimate] position = "geographic", got "{estimate.position}"; a position on a map is '
                    "the a-priori position of the geographic parameters"
                )
            priors = position_priors(places, self.landers)
            if isinstance(height, TerrainPrior) and any(prior.has_height for prior in priors):
                raise InputError(
                    "the position on the map has a height with a sigma, and [estimate] height_prior is a terrain "
                    "model; leave height_prior out"
                )
        if isinstance(height, HeightPrior):
            priors = tuple(
                prior.with_height(height.height_m, height.sigma_m) if prior.has_height else prior
                for prior in priors
            )
        set_fields(self, estimate=replace(estimate, position_priors=priors))

    def _require_considered(self) -> None:
        for key in self.suboptimal:
            if key not in PARAMETERS:
                matches = difflib.get_close_matches(key, PARAMETERS, n=1)
                hint = f"; did you mean {matches[0]!r}?" if matches else ""
                raise InputError(
                    f"[consider] suboptimal: expected kinds of parameter ({', '.join(PARAMETERS)}), got {key!r}{hint}"
                )
        for key, choice in self.consider.items():
            _require_sigmas(key, choice)
            estimated = self.estimate.parameters.get(key)
            if estimated is None or estimated.names == "none" or isinstance(choice.names, str):
                continue
            common = self._canonical_names(choice)
            if estimated.names != "all":
                common &= self._canonical_names(estimated)
            if common:
                raise InputError(
                    f"[consider] {key}: {', '.join(sorted(common))} is in [estimate] {key}, too; a parameter is either "
                    "estimated or considered"
                )

    def _canonical_names(self, choice: ParameterChoice) -> set[str]:
        return {self.catalogue.get(n).name if n in self.catalogue else n for n in choice.names}

    def _require_process_noise(self) -> None:
        if all(orbiter.landing is not None for orbiter in self.orbiters.values()):
            raise InputError(
                "[estimate.orbit] process_noise belongs to a target that does not land, as its axes need a velocity; "
                "for a descent give thrust in segments, [[forces.accelerations]] every_s"
            )
        if self.observations.doppler_phase_sigma_m:
            raise InputError(
                "[estimate.orbit] process_noise needs independent noise; leave [observations] doppler_phase_sigma_m out"
            )

    def _require_no_position(self) -> None:
        lands = bool(self.landers)
        flying: list[Orbiter | Trajectory] = [*self.orbiters.values(), *self.trajectories.values()]
        trajectory = flying[0]
        if self.estimate.position != "none" and not lands:
            raise InputError(
                f'[estimate] position: expected "none" for a known trajectory ({trajectory.name}), got '
                f'"{self.estimate.position}"'
            )
        of_position = {
            "[estimate] ephemeris_sigma_m": any(self.estimate.ephemeris_sigma_m) and not lands,
            "[reference]": self.reference is not None and not lands,
            "[references]": bool(self.references) and not lands,
            "[[observations.map_positions]]": bool(self.observations.map_positions) and not lands,
        }
        for key in filter(of_position.get, of_position):
            raise InputError(
                f"{key} belongs to a position on the Moon, but the target is a trajectory ({trajectory.name}); "
                "leave it out"
            )


def _require_sigmas(key: str, choice: ParameterChoice) -> None:
    """Require the sigmas of consider parameters whose kind has no default."""
    kind = PARAMETERS[key]
    if choice.names == "none" and choice.value is not None:
        raise InputError(f'[consider] {key} is missing; give names or "all"')
    stated = choice.sigma if isinstance(choice.sigma, Mapping) else {}
    listed = () if isinstance(choice.names, str) or not stated else choice.names
    missing = [name for name in listed if name not in stated]
    if kind.considered is None and (missing or (choice.sigma is None and choice.names != "none")):
        of_whom = f" of {', '.join(missing)}" if missing else ""
        raise InputError(
            f"[consider] {kind.sigma_key}{of_whom} is missing; a consider parameter needs an a-priori sigma"
        )
