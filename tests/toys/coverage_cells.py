"""Worlds whose errors are drawn as the fit considers them, or otherwise, and how often regions of fits hold the truth.

A cell is a kind of data, a length of arc, a kind of noise and a world. Tracking of the Chang'e-5 lander, one point in
five minutes, is drawn and fitted by the trials of a Monte Carlo study, which are the fits of `locate`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from change5_case import LANDER, NEAR, RANGING, START, VLBI

import radioloc
from radioloc import Study
from radioloc.estimation.build import seconds_since_midnight
from radioloc.parameters.considered import considered_choices
from radioloc.simulation import (
    Masks,
    Noise,
    NoiseModel,
    Scenario,
    Schedule,
    Session,
    TruthSigma,
    all_ranges,
    baselines,
)
from radioloc.simulation.noise import NoiseDraws
from radioloc.simulation.truth import DrawnErrors
from radioloc.studies import EstimateChoice, HeightPrior, ModelChoice
from radioloc.studies.linear_trials import LinearTrials
from radioloc.studies.prepared_trials import Prepared
from radioloc.studies.problem import considered_errors, observation_model

HOURS = (48.0, 24.0, 12.0)
LEVELS = (0.68, 0.95)
DATA = ("ranges", "delays", "both")
STEP_S, STOP = 300.0, "2020-12-03T15:10:00"
RANGE_M, DELAY_M, BIAS_M, HEIGHT_M = 2.0, 0.4, 10.0, 5.0
SURVEYED_M = {"JIAMUSI": 0.1, "KASHI": 0.1, "NEUQUEN": 0.1, "MIYUN50": 0.05}

WHITE = NoiseModel({"range": Noise(white_m=RANGE_M), "vlbi_delay": Noise(white_m=DELAY_M)})
GAUSS_MARKOV = NoiseModel(
    {
        "range": Noise(white_m=1.4, coloured_m=1.5, correlation_s=7200.0),
        "vlbi_delay": Noise(white_m=0.3, coloured_m=0.2, correlation_s=5400.0),
    }
)
FLICKER = NoiseModel(
    {"range": Noise(white_m=1.4, flicker_m=1.0), "vlbi_delay": Noise(white_m=0.3, flicker_m=0.1)}
)
NOISE = {"white": WHITE, "Gauss-Markov": GAUSS_MARKOV, "flicker": FLICKER}
OF_STATIONS = NoiseModel(
    {"range": GAUSS_MARKOV.link["range"], "vlbi_delay": Noise(white_m=0.3)},
    vlbi_station=Noise(white_m=0.15, coloured_m=0.15, correlation_s=5400.0),
)
GROSS = NoiseModel(
    {
        "range": replace(GAUSS_MARKOV.link["range"], outlier_fraction=0.02, outlier_m=60.0),
        "vlbi_delay": replace(GAUSS_MARKOV.link["vlbi_delay"], outlier_fraction=0.02, outlier_m=10.0),
    }
)
AIR_CHANGES_S = 3.0 * 3600.0


@dataclass(frozen=True)
class World:
    """What is drawn: noise, and errors of what the fit considers, so many times as large."""

    noise: NoiseModel
    factor: float = 1.0
    air_changes: bool = False
    """Zenith delays and electron contents that go on changing within a pass."""


MATCHED = {name: World(noise) for name, noise in NOISE.items()}
MISMATCHED = {
    "considered errors 1.5 times as large": World(GAUSS_MARKOV, factor=1.5),
    "air that changes within passes": World(GAUSS_MARKOV, air_changes=True),
    "noise of VLBI stations": World(OF_STATIONS),
    "2 % gross errors": World(GROSS),
}


@cache
def prepared(data: str, hours: float) -> tuple[Prepared, LinearTrials, DrawnErrors, np.ndarray]:
    """An arc, its trials, what the fit considers, and times of the rows, s."""
    signal = {"wavelength_um": 35394.6}
    ranging = Session(
        "range",
        all_ranges(*RANGING),
        START,
        STOP,
        STEP_S,
        RANGE_M,
        one_uplink=True,
        uplink_hz=7.2e9,
        **signal,
    )
    delays = Session("vlbi_delay", baselines(*VLBI), START, STOP, STEP_S, DELAY_M, **signal)
    sessions = {"ranges": [ranging], "delays": [delays], "both": [ranging, delays]}[data]
    masks = Masks(station_deg=15.0, by_station_deg=dict.fromkeys(RANGING, 10.0))
    lot = TruthSigma(position_enu_m=(0.0, 0.0, HEIGHT_M), range_bias_m=dict.fromkeys(RANGING, BIAS_M))
    stations = {name for session in sessions for pair in session.pairs for name in pair}
    surveyed = {name: sigma_m for name, sigma_m in SURVEYED_M.items() if name in stations}
    study = Study(
        name=data,
        target=NEAR,
        estimate=EstimateChoice(
            range_bias="all" if data != "delays" else "none",
            range_bias_sigma_m=BIAS_M if data != "delays" else None,
            height_prior=HeightPrior(-2550.4, HEIGHT_M),
        ),
        model=ModelChoice(terms=radioloc.measurements.active_terms(["ionosphere"])),
        consider=considered_choices({"station_position_sigma_m": surveyed}),
        simulation=Scenario(Schedule(sessions, masks), LANDER, truth_sigma=lot),
    )
    ready = Prepared.of(study, (hours,))
    linear = ready.linear()
    assert linear is not None
    part = ready.parts[0]
    problem = observation_model(part.arc, ready._target_pa, part.estimate)
    x = np.concatenate([linear.arcs[0].problem.x])
    errors, _ = considered_errors(study, problem, part.estimate, x)
    partials = errors.partials(np.arange(len(ready.rows))).T
    found = DrawnErrors(errors.parameters.names, errors.parameters.prior_sigmas, partials)
    return ready, linear, found, seconds_since_midnight(part.arc.observations.epoch)


def trials_of(data: str, hours: float, world: World) -> LinearTrials:
    """Trials of some data in a world."""
    ready, linear, considered, time_s = prepared(data, hours)
    mine = changing(considered, time_s) if world.air_changes else considered
    lot = linear.drawn
    drawn = DrawnErrors(
        (*lot.names, *mine.names),
        np.concatenate([lot.sigmas, world.factor * mine.sigmas]),
        np.concatenate([lot.partials, mine.partials]),
    )
    return replace(linear, draws=NoiseDraws.of(world.noise, ready.world.plan), drawn=drawn)


def changing(errors: DrawnErrors, time_s: np.ndarray) -> DrawnErrors:
    """The same, those of the air as Gauss-Markov processes between knots half an hour apart, from pass to pass."""
    of_air: dict[str, list[int]] = {}
    for k, name in enumerate(errors.names):
        if name.startswith(("zenith_delay.", "electron_content.")):
            of_air.setdefault(name.rpartition(" ")[0], []).append(k)
    knots_s = np.arange(time_s.min(), time_s.max() + 1800.0, 1800.0)
    root = np.linalg.cholesky(np.exp(-np.abs(knots_s[:, None] - knots_s) / AIR_CHANGES_S))
    at = np.array([np.interp(time_s, knots_s, column) for column in root.T])  # (knots, n)
    rest = [k for k in range(len(errors.names)) if not any(k in mine for mine in of_air.values())]
    names, sigmas, partials = [errors.names[k] for k in rest], [errors.sigmas[rest]], [errors.partials[rest]]
    for name, mine in of_air.items():
        names += [f"{name} at {knot}" for knot in range(len(knots_s))]
        sigmas.append(np.full(len(knots_s), errors.sigmas[mine[0]]))
        partials.append(at * errors.partials[mine].sum(axis=0))
    return DrawnErrors(tuple(names), np.concatenate(sigmas), np.concatenate(partials))
