"""Simulated worlds of the benchmark of faults: tracking with drawn a-priori errors and noise, and its true positions.

Every error with an a-priori sigma in the fit, estimated or considered, is drawn with this sigma, so that a fit without
a fault has the errors that its model states. Laser ranging and the lunar orbiter have the epochs of real tracking.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from change5_case import LANDER, RANGING, VLBI
from paths import ROOT
from tracked_orbit import OFF, REAL, STATE

import radioloc
from radioloc import LunarPosition, Observations, Study
from radioloc.dynamics import Forces, GravityField
from radioloc.jobs.preparation import prepared_arc
from radioloc.jobs.problem import EstimationProblem
from radioloc.parameters.considered import considered_choices
from radioloc.simulation import Masks, Scenario, Schedule, Session, all_ranges, baselines, two_way
from radioloc.simulation.noise import generator
from radioloc.study import EstimateChoice, HeightPrior, ModelChoice, ObservationChoice
from radioloc.study.orbiter import Orbiter
from radioloc.time import epochs_from_strings

START, STOP = "2020-12-01T15:00:00", "2020-12-03T15:00:00"
APRIORI = LunarPosition.from_selenographic(-51.8, 43.0, -2500.0)
HEIGHT_M, HEIGHT_SIGMA_M, BIAS_SIGMA_M = -2550.4, 5.0, 10.0
DSN = ("DSS-14", "DSS-43", "DSS-63")
X_BAND = {"uplink_hz": 7.2e9, "wavelength_um": 35394.6}
SURVEYED_M = dict.fromkeys((*RANGING, "MIYUN50"), 0.05)
GRAVITY_DEGREE = 30
ORBIT_HOURS = 4.0
NIGHT_GAP_D = 0.35


@dataclass(frozen=True, eq=False)
class Case:
    """Study and observations of an analyst."""

    study: Study
    observations: Observations


@dataclass(frozen=True, eq=False)
class World:
    """Tracking at true positions, of which realizations of errors are drawn."""

    name: str
    study: Study  # of the fit, with a-priori positions
    truth: Study  # with true positions
    plan: Observations
    station: str  # at which a fault of one station acts
    partner: str  # another station of the same kind of tracking
    length_m: float = 1.0  # size of errors of ranges, 1 m for radio signals

    @cached_property
    def problem(self) -> EstimationProblem:
        """Problem of the fit at the true positions."""
        arc, _ = prepared_arc(self.truth, self.plan)
        return EstimationProblem.from_study(self.truth, arc, self.truth.estimate)

    @cached_property
    def value_m(self) -> np.ndarray:
        """Values without errors, m, shape (n,)."""
        return self.values_m(self.truth)

    def values_m(self, truth: Study) -> np.ndarray:
        """Return values of another world at the same epochs, m, shape (n,)."""
        arc, _ = prepared_arc(truth, self.plan)
        return np.array(arc.compute().value_m)

    @cached_property
    def errors(self) -> tuple[tuple[str, ...], np.ndarray]:
        """Names of the errors with a-priori sigmas, and their effects by one sigma, m, shape (n, k)."""
        model = self.problem.model
        parameters = model.parameters
        partials = model.linearize(parameters.prior_values).partials(np.arange(len(self.plan)))
        columns = [
            k
            for k, item in enumerate(parameters)
            if np.isfinite(item.prior_sigma) and item.kind != "position"
        ]
        sigmas = parameters.prior_sigmas[columns]
        return tuple(parameters.names[k] for k in columns), partials[:, columns] * sigmas

    def draw(self, seed: int) -> Case:
        """Return the study and the observations of one realization of errors and noise."""
        names, effects_m = self.errors
        normal = np.array([generator(seed, f"prior {name}").standard_normal() for name in names])
        noise = generator(seed, f"noise {self.name}").standard_normal(len(self.plan))
        value_m = self.value_m + effects_m @ normal + self.plan.sigma_m * noise
        study, prior = self.study, self.study.estimate.height_prior
        if prior is not None:
            error_m = prior.sigma_m * generator(seed, "height prior").standard_normal()
            study = with_height_prior(study, HEIGHT_M + error_m)
        return Case(study, replace(self.plan, value_m=value_m))

    def distances(self, solution: radioloc.Solution) -> dict[str, tuple[float, float]]:
        """Return errors of the positions of all targets, m, and in units of their covariance."""
        if solution.states:
            [state] = solution.states.values()
            error_m = state.position_m - np.array(self.truth.target.position_m)
            return {"": _distance(error_m, state.covariance[:3, :3])}
        if not solution.targets:
            error_m = solution.position_me_m - self.truth.target.xyz_m
            return {"": _distance(error_m, solution.position_covariance("me"))}
        return {
            target.name: _distance(
                target.position_pa_m - self.truth.targets[target.name].xyz_m,
                solution.of_target(target.name).position_covariance("pa"),
            )
            for target in solution.targets
        }


def _distance(error_m: np.ndarray, covariance_m2: np.ndarray) -> tuple[float, float]:
    if not np.isfinite(covariance_m2).all():
        return float(np.linalg.norm(error_m)), 0.0
    return float(np.linalg.norm(error_m)), float(np.sqrt(error_m @ np.linalg.solve(covariance_m2, error_m)))


def with_height_prior(study: Study, height_m: float) -> Study:
    """Return a study with another a-priori height."""
    prior = replace(study.estimate.height_prior, height_m=height_m)
    return replace(study, estimate=replace(study.estimate, height_prior=prior))


def _lander(name: str, sessions: list[Session], station: str, partner: str, **choice) -> World:
    masks = Masks(station_deg=15.0, by_station_deg=dict.fromkeys(RANGING, 10.0))
    scenario = Scenario(Schedule(sessions, masks), LANDER)
    study = Study(
        name=name, target=APRIORI, simulation=scenario, model=ModelChoice(off=["ionosphere"]), **choice
    )
    plan = radioloc.simulate(study, 0).observations
    study = replace(study, simulation=None)
    return World(name, study, replace(study, target=LANDER), plan, station, partner)


def dsn() -> World:
    """Two-way ranges and Doppler of three stations over two days, with the defaults of the fit."""
    sessions = [
        Session("range", two_way(*DSN), START, STOP, 900.0, 1.0, **X_BAND),
        Session("doppler", two_way(*DSN), START, STOP, 900.0, 0.012, count_s=60.0, **X_BAND),
    ]
    return _lander("dsn", sessions, "DSS-43", "DSS-63")


def _ranging(step_s: float) -> Session:
    return Session("range", all_ranges(*RANGING), START, STOP, step_s, 2.0, one_uplink=True, **X_BAND)


def _estimate() -> EstimateChoice:
    return EstimateChoice(
        range_bias="all", range_bias_sigma_m=BIAS_SIGMA_M, height_prior=HeightPrior(HEIGHT_M, HEIGHT_SIGMA_M)
    )


def _surveyed(stations: tuple[str, ...]) -> Mapping:
    return considered_choices({"station_position_sigma_m": {name: SURVEYED_M[name] for name in stations}})


def three_way() -> World:
    """Two- and three-way ranges of three stations over two days, with biases and an a-priori height."""
    return _lander(
        "three-way", [_ranging(450.0)], "KASHI", "JIAMUSI", estimate=_estimate(), consider=_surveyed(RANGING)
    )


def ranges_vlbi() -> World:
    """Ranges of three stations and VLBI delays of four over two days, with biases and an a-priori height."""
    delays = Session("vlbi_delay", baselines(*VLBI), START, STOP, 1200.0, 0.4, **X_BAND)
    return _lander(
        "vlbi",
        [_ranging(900.0), delays],
        "URUMQI",
        "KUNMING",
        estimate=_estimate(),
        consider=_surveyed((*RANGING, "MIYUN50")),
    )


def llr() -> World:
    """Laser ranges to four reflectors at the epochs and with the weather of normal points of 2006 to 2024."""
    study = radioloc.read_study(ROOT / "examples" / "reflectors" / "de440.toml")
    arc, _ = prepared_arc(study)
    study = replace(study, observations=ObservationChoice(), path=None, name="llr")
    # Each night adds six parameters: every second one, and those with the reflector that is seldom ranged.
    night = np.cumsum(np.diff(np.sort(arc.observations.epoch.mjd), prepend=0.0) > NIGHT_GAP_D)
    order = np.argsort(arc.observations.epoch.mjd)
    is_rare = np.array([link.target == "luna21" for link in arc.observations.links])[arc.observations.link]
    rows = order[(night % 2 == 0) | is_rare[order]]
    return World("llr", study, study, arc.observations.select(rows), "GRASSE", "APOLLO", length_m=0.02)


def orbiter() -> World:
    """Doppler of a low lunar orbit at the epochs and with the frequencies of files of GRAIL-B, counts of 60 s."""
    epoch = epochs_from_strings("2012-04-09T04:30:00", "TDB")
    forces = Forces(GravityField.open("GRGM660PRIM", degree=GRAVITY_DEGREE), radiation_m2_kg=0.018)
    state = Orbiter(epoch, tuple(STATE[:3]), tuple(STATE[3:]), forces, "GRAIL-B", gravity_errors=0)
    choice = ObservationChoice(
        files=tuple(sorted(REAL.glob("*.odf"))), types=("doppler",), doppler_average_s=60.0, hours=ORBIT_HOURS
    )
    truth = Study(name="grail", target=state, observations=choice)
    arc, _ = prepared_arc(truth)
    truth = replace(truth, observations=ObservationChoice())
    study = replace(truth, target=state.with_state(STATE + np.array(OFF)))
    return World("grail", study, truth, arc.observations, "DSS-24", "DSS-65", length_m=0.003)


WORLDS = {"dsn": dsn, "three-way": three_way, "vlbi": ranges_vlbi, "llr": llr, "grail": orbiter}


@cache
def world(name: str) -> World:
    """Return a world by its name."""
    return WORLDS[name]()
