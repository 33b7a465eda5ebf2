"""Study: what to locate, from which observations, with which model.

The records check themselves, so a study built in Python is held to the same rules as one read from a file
(:mod:`radioloc.study.study_file`): what cannot be is an :class:`~radioloc.errors.InputError` that names the key.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

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
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.terms import active_terms
from radioloc.media.ionosphere import UniformTec
from radioloc.parameters.choice import ParameterChoice, of_part, parameter_choices
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
from radioloc.study.schema import TomlTable, check, entry, names_of
from radioloc.targets.position_prior import PositionPrior

WEIGHTS = ("independent", "correlated")
COMPONENTS = ("type", "link", "link and pass")
POSITION_FORMS = ("geographic", "cartesian", "none")
MIN_REJECTION_SIGMA = 2.0
"""Lower values would cut good data: one in 22 normal residuals exceeds two sigmas."""
PARAMETER_KEYS = DerivedNames(lambda: [key for kind in PARAMETERS.values() for key in kind.keys.values()])
"""Keys of the kinds of parameter in ``[estimate]`` and ``[consider]``."""


def read_parameters(table: TomlTable, _: str = "") -> dict[str, ParameterChoice]:
    """Take the keys of all kinds of parameter."""
    given = {key: value for key in PARAMETER_KEYS if (value := table.take(key)) is not None}
    return table.build(parameter_choices, settings=given)


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
    """A registered name as it is; anything that looks like a file relative to the study file."""
    name: str | None = table.get(key, str)
    return name if name is None or not Path(name).suffix else str(table.path.parent / name)


def _delays(table: TomlTable, _: str) -> EquipmentDelays:
    by_station = table.table("station_delay_s")
    keys = {"transmit": "transmit_s", "receive": "receive_s"}
    stations = {} if by_station is None else by_station.named()
    delays = {name: delay.read(StationDelay, keys) for name, delay in stations.items()}
    hold_s = table.get("transponder_delay_s", float)
    return table.build(EquipmentDelays, transponder_s=hold_s, stations=delays)


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
    """Prior on the height that follows a terrain model in mean-Earth axes.

    The sigma is the model's own error; the roughness of the terrain about the a-priori position is added to it.
    """

    terrain: TerrainModel
    sigma_m: float = entry(positive=True)

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, slots=True, init=False)
class EstimateChoice:
    """Choice of the estimated parameters, with their priors.

    Parameters
    ----------
    position : {"geographic", "cartesian", "none"}
        Parameters of the position: along the sphere and in height; x, y, z; or held.
    height_prior : HeightPrior or TerrainPrior or None
        Prior on the height; needs the geographic parameters, of which the height is one.
    ephemeris_sigma_m : tuple of float
        Error to be assumed of the lunar ephemeris and orientation as seen in the position: east, north, up.
    rejection_sigma : float
        An observation is rejected when its residual exceeds so many of its expected sigmas; 2 or more.
    weights : {"correlated", "independent"}
        Whether dense series of time-correlated observations count as the few that they are worth, or all in full.
    variance_components : {"type", "link", "link and pass"}
        Whose noise beyond the stated sigmas is found from the residuals: that of each type and of stations and links
        that differ significantly, of each link, or of each link and pass.
    pass_gap_h : float
        A new pass begins when a station has not observed for longer.
    position_priors : tuple of PositionPrior
        A-priori positions with their covariance, of positions on maps; the study sets them.
    orbit : OrbitChoice or None
        What of an orbiter's orbit; without it, of an orbiter, the state and what else of the forces is not known.
    parameters : mapping of str to ParameterChoice, optional
        Kinds of parameter by name; keys that follow change them.
    **keys
        For each kind NAME of :data:`~radioloc.parameters.registry.PARAMETERS`: ``NAME``, whose parameter is estimated
        (a list of names, ``"all"`` or ``"none"``; true or false where there is only one); ``NAME_m`` (or another
        unit), the a-priori value by name or of all, zero where there is none, at which those that have one and are
        not estimated are held; ``NAME_sigma_m``, its sigma, free where there is none; ``NAME_per``, whom it belongs
        to (``"station"``, ``"pass"``, ``"link"``, ``"link and pass"``). Such as ``range_bias="all",
        range_bias_sigma_m=10.0``.
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
    orbit: OrbitChoice | None = None
    position_priors: tuple[PositionPrior, ...] = entry((), keys=(), read=lambda *_: None)
    parameters: Mapping[str, ParameterChoice] = entry(factory=dict, keys=PARAMETER_KEYS, read=read_parameters)

    def __init__(self, *, parameters: Mapping[str, ParameterChoice] | None = None, **keys: Any) -> None:
        for f in fields(self):
            if f.name != "parameters":
                object.__setattr__(self, f.name, keys.pop(f.name, f.default))
        object.__setattr__(self, "parameters", parameter_choices(keys, parameters))
        of_axes = convert_quantity("ephemeris_sigma_m", self.ephemeris_sigma_m)
        of_axes = tuple(of_axes) if isinstance(of_axes, Iterable) else (of_axes,) * 3
        object.__setattr__(self, "ephemeris_sigma_m", of_axes)
        check(self)
        if self.height_prior is not None and self.position != "geographic":
            raise InputError('height_prior needs position = "geographic", where the height is a parameter')
        if len(of_axes) != 3:
            raise InputError(f"ephemeris_sigma_m must be three numbers (east, north, up), not {of_axes!r}")
        if not (math.isfinite(self.rejection_sigma) and self.rejection_sigma >= MIN_REJECTION_SIGMA):
            raise InputError(
                f"rejection_sigma must be {MIN_REJECTION_SIGMA:g} or more, not {self.rejection_sigma!r}: "
                "less cuts good data"
            )

    def component_groups(self, order: SeriesOrder) -> Labels | None:
        """Groups of observations that have a variance component each; none where residuals tell them."""
        if self.variance_components == "type":
            return None
        return by_link(order, 3600.0 * self.pass_gap_h if "pass" in self.variance_components else math.inf)

    def held(self) -> EstimateChoice:
        """Return the choice with nothing estimated; the a-priori values of all parameters stay."""
        values = {
            name: ParameterChoice(value=choice.value, per=choice.per)
            for name, choice in self.parameters.items()
        }
        return EstimateChoice(position="none", parameters=values)

    def of_part(self, part: Predictor) -> EstimateChoice:
        """Return the choice for a part of an arc, without members that have no observations in it."""
        try:
            kept = {
                name: of_part(PARAMETERS[name], choice, part.simple)
                for name, choice in self.parameters.items()
            }
        except InputError as error:
            raise type(error)(f"[estimate] {error}") from None
        return replace(self, parameters=kept)


@dataclass(frozen=True, slots=True)
class ModelChoice:
    """Kernels, tables and terms of the model.

    Parameters
    ----------
    off : iterable of str
        Terms to leave out, of :data:`~radioloc.measurements.TERMS`.
    ephemeris, libration : str
        Registered name or path of the SPK and of the binary PCK.
    earth_orientation : Path or None
        A C04 or finals2000A file in place of the installed tables.
    eop_beyond : {"hold", "extrapolate"} or None
        How Earth orientation goes on after the table, for planning.
    ionex : tuple of Path
        IONEX maps of the electron content.
    tec_tecu : float or None
        In their place the same vertical content everywhere and always, TECU.
    vmf3 : tuple of Path
        Files of VMF3 for the troposphere of radio signals, of sites or maps.
    vmf3_orography : Path or None
        With maps, the file of their heights.
    csp : tuple of Path
        TRO and ION files of the Deep Space Network, for its stations.
    csp_scid : int or None
        Number of the spacecraft that they are of, where they have several.
    gpt3 : Path or None
        The grid of GPT3, for stations of which VMF3 has nothing, or for all.
    delays : EquipmentDelays
        Delays of transponder and stations that the observations contain.
    sources : tuple of Path
        Lists of quasars, of which there are VLBI delays.
    free_clocks : iterable of str
        Stations whose frequency standards run free and do not follow UTC.
    evaluation : {"auto", "exact", "interpolated"}
        Whether dense series are interpolated: :func:`~radioloc.measurements.evaluation.prepare_predictor`.
    """

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
        object.__setattr__(self, "free_clocks", names_of("free_clocks", self.free_clocks))
        object.__setattr__(self, "off", names_of("off", self.off))
        with error_context("off:"):
            active_terms(self.off)  # refuses unknown names
        if self.ionex and self.tec_tecu is not None:
            raise InputError("give either ionex or tec_tecu, not both")
        if self.csp_scid is not None and not self.csp:
            raise InputError(
                "csp_scid goes with csp, the files whose spacecraft it names; give them, or leave it out"
            )
        if self.tec_tecu is not None:
            UniformTec(self.tec_tecu)  # knows what can be


@dataclass(frozen=True, slots=True)
class CovarianceChoice:
    """Keys of ``[covariance]``, for covariance studies."""

    candidates: tuple[str, ...] | None = None


_FIELD_TYPES: Mapping[str, tuple[type, ...]] = {
    "target": (LunarPosition, Trajectory, Orbiter, type(None)),
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
    "simulations": (Mapping,),
}
"""Types of the fields of a study that is built in Python."""


@dataclass(frozen=True, slots=True)
class Study:
    """A whole study, as read from a file or built in Python.

    Parameters
    ----------
    target : LunarPosition, Trajectory or Orbiter, optional
        A-priori position, where the fit starts (and stays, if the position is not estimated); or a known trajectory,
        of which no position is estimated (``position = "none"``); or an orbiter, whose orbit is. The first of
        `targets` where those are given.
    observations, estimate, model
    catalogue : StationCatalogue
        The stations known to the study.
    reference : Reference or None
        A known position to compare the result with.
    references : iterable of Reference
        Further ones, for the table of an arc-length study.
    name : str
        Shown on the result card.
    simulation : Scenario or None
        Tracking to be simulated, for Monte Carlo studies.
    simulations : mapping of str to Scenario
        In its place the tracking of each of several targets, by their names.
    targets : mapping of str to LunarPosition, Trajectory or Orbiter
        Several targets of any kinds by the names that the observations have for them; empty where there is only
        `target`.
    consider : mapping of str to ParameterChoice
        Parameters that are not estimated, but whose a-priori errors count in the covariance, each with its sigma:
        of :func:`~radioloc.parameters.considered.considered_choices`. None is estimated, too.
    consider_defaults : bool
        Whether kinds of parameter of which `consider` says nothing are considered as their records say.
    suboptimal : tuple of str
        Kinds of considered parameters that stay out of the weights: the estimate is made as if they had no errors,
        whose effect is then added to its covariance (classical consider analysis).
    path : Path or None
        The file that it was read from.
    candidates : iterable of str or None
        Stations, and links by their paths, whose improvement a covariance study predicts; all stations of the
        catalogue where ``None``.
    longitude_to_360 : bool
        Whether cards count longitudes from 0 to 360 deg, as the file of the study does, not from -180 to 180.
    target_name : str or None
        Name of `target`, which is compared with that in the tracking data.
    extensions : mapping of str to object
        Records of tables that other packages add (:class:`~radioloc.study.StudyTable`), by the name of the table.
    """

    target: LunarPosition | Trajectory | Orbiter = None  # type: ignore[assignment]  # of targets, then
    observations: ObservationChoice = field(default_factory=ObservationChoice)
    estimate: EstimateChoice = field(default_factory=EstimateChoice)
    model: ModelChoice = field(default_factory=ModelChoice)
    catalogue: StationCatalogue = field(default_factory=StationCatalogue.default)
    reference: Reference | None = None
    references: tuple[Reference, ...] = ()
    name: str = "study"
    simulation: Scenario | None = None
    targets: Mapping[str, LunarPosition | Trajectory | Orbiter] = field(default_factory=dict)
    consider: Mapping[str, ParameterChoice] = field(default_factory=dict)
    consider_defaults: bool = True
    suboptimal: tuple[str, ...] = ()
    path: Path | None = None
    candidates: tuple[str, ...] | None = None
    longitude_to_360: bool = False
    target_name: str | None = None
    extensions: Mapping[str, Any] = field(default_factory=dict)
    simulations: Mapping[str, Scenario] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, types in _FIELD_TYPES.items():
            require_type(f"Study: {name}", getattr(self, name), *types)
        object.__setattr__(self, "references", tuple(self.references))
        for k, reference in enumerate(self.references):
            require_type(f"Study: references[{k}]", reference, Reference)
        if self.candidates is not None:
            object.__setattr__(self, "candidates", tuple(self.candidates))
        self._name_targets()
        self._require_considered()
        self._set_position_priors()
        if self.orbiters:
            chosen = self.estimate.orbit or OrbitChoice()
            for orbiter in self.orbiters.values():
                chosen.parameters(orbiter.forces)
            position = self.estimate.position if self.landers else "none"
            object.__setattr__(self, "estimate", replace(self.estimate, position=position, orbit=chosen))
            self._require_states(chosen)
            if chosen.process_noise is not None:
                # The information filter of process noise takes the place of weights correlated in time.
                object.__setattr__(self, "estimate", replace(self.estimate, weights="independent"))
                self._require_process_noise()
        elif self.estimate.orbit is not None:
            raise InputError('[estimate.orbit] belongs to a target with dynamics = "moon"; leave it out')
        if not self.points:
            self._require_no_position()

    @property
    def all_targets(self) -> Mapping[str, LunarPosition | Trajectory | Orbiter]:
        """A-priori records of all targets by name; the name of the only one is empty."""
        return self.targets or {"": self.target}

    @property
    def points(self) -> dict[str, LunarPosition]:
        """A-priori positions of the targets that are points on the Moon, by name."""
        return {name: one for name, one in self.all_targets.items() if isinstance(one, LunarPosition)}

    @property
    def names_in_order(self) -> tuple[str, ...]:
        """Names of several targets in the order of an arc: points on the Moon, a trajectory, an orbiter."""
        if len(self.targets) < 2:
            return ()
        return (*self.points, *(name for name in self.targets if name not in self.points))

    @property
    def orbiters(self) -> dict[str, Orbiter]:
        """Targets whose orbits are determined, by name."""
        return {name: one for name, one in self.all_targets.items() if isinstance(one, Orbiter)}

    @property
    def orbiter(self) -> Orbiter | None:
        """First target whose orbit is determined."""
        return next(iter(self.orbiters.values()), None)

    @property
    def landers(self) -> tuple[str, ...]:
        """Names of the targets that are, or come to rest, at a place on the Moon, in the order of an arc."""
        return (*self.points, *(name for name, one in self.orbiters.items() if one.landing is not None))

    @property
    def lands(self) -> bool:
        """Whether the first orbiter comes to rest on the Moon."""
        return self.orbiter is not None and self.orbiter.landing is not None

    @property
    def trajectories(self) -> dict[str, Trajectory]:
        """Known trajectories of targets, by name."""
        return {name: one for name, one in self.all_targets.items() if isinstance(one, Trajectory)}

    def __repr__(self) -> str:
        target = ", ".join(self.targets) if len(self.targets) > 1 else repr(self.target).strip("<>")
        estimated = [name for name, choice in self.estimate.parameters.items() if choice.names != "none"]
        if self.estimate.position != "none":
            estimated.insert(0, f"{self.estimate.position} position")
        return (
            f"<Study {self.name}: {target}; {len(self.observations.files)} file(s); "
            f"estimates {', '.join(estimated) or 'nothing'}"
            f"{'; simulated' if self.simulation or self.simulations else ''}>"
        )

    def _name_targets(self) -> None:
        named: dict[str, LunarPosition | Trajectory | Orbiter] = {}
        for name, target in self.targets.items():
            require_type(f"[targets.{name}]", target, LunarPosition, Trajectory, Orbiter)
            if canonical_target(name) in named:
                raise InputError(
                    f"[targets.{name}] is another name of {canonical_target(name)}, which is there"
                )
            named[canonical_target(name)] = target
        object.__setattr__(self, "targets", named)
        first = next(iter(named.values()), None)
        if self.target is None and first is None:
            raise InputError(
                "[target] is missing; it gives the a-priori position, or [targets.NAME] that of each"
            )
        if self.target is None:
            object.__setattr__(self, "target", first)
        elif first is not None and self.target is not first:
            raise InputError("give either [target] or [targets.NAME], not both")
        if len(named) > 1:
            given = {
                "[reference] is compared with": self.reference,
                "[references] is compared with": self.references,
                "simulation is of": self.simulation,
            }
            for what in filter(given.get, given):
                raise InputError(f"{what} one position, but [targets] gives several; leave it out")

    def _require_states(self, choice: OrbitChoice) -> None:
        """Refuse a choice of states where all targets land, whose parameters are the place and the velocity."""
        of_state = choice.state_sigma_m, choice.state_sigma_m_s, choice.state_sigma or None
        if all(one.landing is not None for one in self.orbiters.values()) and not (
            choice.state and of_state == (None, None, None)
        ):
            raise InputError(
                "[estimate.orbit] state and its sigmas belong to a target that does not land; what is estimated of "
                "one that does is the place; leave them out"
            )

    def _set_position_priors(self) -> None:
        """Make positions on maps the a-priori positions of their targets."""
        places, estimate = self.observations.map_positions, self.estimate
        if not self.points or not (places or estimate.position_priors):
            return
        height = estimate.height_prior
        with error_context("[[observations.map_positions]]"):
            if places and estimate.position != "geographic":
                raise InputError(
                    f'expected [estimate] position = "geographic", got "{estimate.position}"; a position on a map is '
                    "the a-priori position of the geographic parameters"
                )
            priors = position_priors(places, tuple(filter(None, self.points)))
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
        object.__setattr__(self, "estimate", replace(estimate, position_priors=priors))

    def _require_considered(self) -> None:
        for key in self.suboptimal:
            if key not in PARAMETERS:
                near = difflib.get_close_matches(key, PARAMETERS, n=1)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                raise InputError(
                    f"[consider] suboptimal: expected kinds of parameter ({', '.join(PARAMETERS)}), got {key!r}{hint}"
                )
        for key, choice in self.consider.items():
            _require_sigmas(key, choice)
            estimated = self.estimate.parameters.get(key)
            if estimated is None or estimated.names == "none" or isinstance(choice.names, str):
                continue
            both = self._canonical_names(choice)
            if estimated.names != "all":
                both &= self._canonical_names(estimated)
            if both:
                raise InputError(
                    f"[consider] {key}: {', '.join(sorted(both))} is in [estimate] {key}, too; a parameter is either "
                    "estimated or considered"
                )

    def _canonical_names(self, choice: ParameterChoice) -> set[str]:
        return {self.catalogue.get(n).name if n in self.catalogue else n for n in choice.names}

    def _require_process_noise(self) -> None:
        if len(self.orbiters) > 1:
            raise InputError(
                f"[estimate.orbit] process_noise: expected one spacecraft, got {', '.join(self.orbiters)}; intervals "
                "of the filter are counted from the epoch of one orbit: fit each in a study of its own"
            )
        if self.lands:
            raise InputError(
                "[estimate.orbit] process_noise belongs to a target that does not land, as its axes along and across "
                "vanish with the velocity at the touchdown; a descent has thrust in segments, "
                "[[forces.accelerations]] every_s"
            )
        if self.observations.doppler_phase_sigma_m:
            raise InputError(
                "[estimate.orbit] process_noise is for observations of independent noise; leave [observations] "
                "doppler_phase_sigma_m out"
            )

    def _require_no_position(self) -> None:
        lands = bool(self.landers)
        flying: list[Orbiter | Trajectory] = [*self.orbiters.values(), *self.trajectories.values()]
        trajectory = flying[0]
        if self.estimate.position != "none" and not lands:
            raise InputError(
                f"[estimate] position: the target is a trajectory ({trajectory.name}), of which no position is "
                'estimated; set position = "none"'
            )
        given = {
            "[estimate] ephemeris_sigma_m": any(self.estimate.ephemeris_sigma_m) and not lands,
            "[reference]": self.reference is not None and not lands,
            "[references]": bool(self.references) and not lands,
            "[simulation]": self.simulation is not None and self.orbiter is None,
            "[[observations.map_positions]]": bool(self.observations.map_positions),
        }
        for key in filter(given.get, given):
            raise InputError(
                f"{key} belongs to a position on the Moon, but the target is a trajectory ({trajectory.name}); "
                "leave it out"
            )


def _require_sigmas(key: str, choice: ParameterChoice) -> None:
    """Require the sigmas of considered parameters whose kind has none by itself."""
    kind = PARAMETERS[key]
    if choice.names == "none" and choice.value is not None:
        raise InputError(f'[consider] {key} says whose is considered; give names or "all"')
    stated = choice.sigma if isinstance(choice.sigma, Mapping) else {}
    listed = () if isinstance(choice.names, str) or not stated else choice.names
    missing = [name for name in listed if name not in stated]
    if kind.considered is None and (missing or (choice.sigma is None and choice.names != "none")):
        of_whom = f" of {', '.join(missing)}" if missing else ""
        raise InputError(
            f"[consider] {kind.sigma_key}{of_whom} is missing; what is considered needs its sigma"
        )
