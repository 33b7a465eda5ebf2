"""Coverage of confidence regions in worlds with the errors of the fit's model, and with other errors.

A cell is a kind of data, a length of arc and a kind of noise or of difference from the model of the fit. Tracking of
the Chang'e-5 lander, one point in five minutes, is simulated and fitted by the trials of a Monte Carlo study, which are
the fits of `locate`.
"""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
from calibration import CHUNK_DRAWS, LEVELS, Cell, Draws
from change5_case import LANDER, NEAR, RANGING, START, VLBI
from scipy.stats import binom, chi2
from threadpoolctl import threadpool_limits
from tracking_cells import drawing, matched_trials

from radioloc import Study
from radioloc.jobs.linear_trials import LinearTrials
from radioloc.labels import USED
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
from radioloc.simulation.schedule import Plan
from radioloc.simulation.truth import DrawnErrors
from radioloc.study import EstimateChoice, HeightPrior, ModelChoice

HOURS = (48.0, 24.0, 12.0)
SIDES = ("east", "north", "up")
DATA = ("ranges", "delays", "both")
NAMES = {"ranges": "ranges", "delays": "VLBI", "both": "ranges and VLBI"}
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
DOUBLE = NoiseModel({"range": Noise(white_m=2.0 * RANGE_M), "vlbi_delay": Noise(white_m=2.0 * DELAY_M)})
SHARED = NoiseModel(
    {"range": Noise(white_m=RANGE_M), "vlbi_delay": Noise(white_m=0.2)}, vlbi_station=Noise(white_m=0.25)
)
NOISY_M = {"KASHI": 3.0 * RANGE_M, "MIYUN50": 2.0 * DELAY_M}
"""Larger noise of ranges at one station and of VLBI arrivals at another, unknown to the fit."""
DRIFT = " drift"
DRIFT_M = 0.03
"""Sigma of the drift of the zenith delay at the ends of a pass."""


@cache
def prepared(data: str, hours: float) -> tuple[Plan, LinearTrials]:
    """Return the plan of an arc, and its trials, in which consider parameters are drawn with their sigmas."""
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
    truth_sigma = TruthSigma(position_enu_m=(0.0, 0.0, HEIGHT_M), range_bias_m=dict.fromkeys(RANGING, BIAS_M))
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
        model=ModelChoice(off=["ionosphere"]),
        consider=considered_choices({"station_position_sigma_m": surveyed}),
        simulation=Scenario(Schedule(sessions, masks), LANDER, truth_sigma=truth_sigma),
    )
    return matched_trials(study, hours)


def noisy_station(plan: Plan, linear: LinearTrials) -> LinearTrials:
    """Increase the noise of a station for ranges and of another for VLBI."""
    at_station = replace(WHITE, vlbi_station=Noise(white_m=1.0))
    series = []
    for item in NoiseDraws.of(at_station, plan).series:
        name = item.label.split()[1]  # path or station
        white_m = item.noise.white_m if ">" in name else 0.0
        white_m = NOISY_M.get(name.rpartition(">")[2] if item.label.startswith("range") else name, white_m)
        series.append(replace(item, noise=Noise(white_m=white_m)))
    return replace(linear, draws=NoiseDraws(linear.draws.count, tuple(series)))


def drifting_air(plan: Plan, linear: LinearTrials) -> LinearTrials:
    """Add linear drifts to zenith delays, which the fit considers as constant in a pass."""
    drawn, time_s = linear.drawn, linear.arcs[0].order.time_s
    names, partials = [], []
    for name, by_delay in zip(drawn.names, drawn.partials, strict=True):
        rows = np.flatnonzero(by_delay)
        if name.startswith("zenith_delay.") and len(rows):
            middle_s, half_s = 0.5 * (time_s[rows].max() + time_s[rows].min()), 0.5 * np.ptp(time_s[rows])
            names.append(name + DRIFT)
            partials.append(by_delay * (time_s - middle_s) / half_s)
    sigmas = np.concatenate([drawn.sigmas, np.full(len(names), DRIFT_M)])
    extended = DrawnErrors((*drawn.names, *names), sigmas, np.concatenate([drawn.partials, partials]))
    return with_noise(WHITE)(plan, drawing(linear, extended))


def considered(factor: float) -> Callable[[Plan, LinearTrials], LinearTrials]:
    """Scale the drawn errors of consider parameters, biases and height."""
    return lambda plan, linear: with_noise(WHITE)(
        plan, replace(linear, drawn=replace(linear.drawn, sigmas=factor * linear.drawn.sigmas))
    )


def with_noise(noise: NoiseModel) -> Callable[[Plan, LinearTrials], LinearTrials]:
    """Return the matched world with some noise."""
    return lambda plan, linear: replace(linear, draws=NoiseDraws.of(noise, plan))


COVERED = {
    "twice the stated sigmas": with_noise(DOUBLE),
    "one noisy station": noisy_station,
    "delays share errors": with_noise(SHARED),
    "zenith delays drift": drifting_air,
}
"""Worlds that the regions cover although the fit has another noise model."""
UNCOVERED = {"a-priori errors twice": considered(2.0), "a-priori errors half": considered(0.5)}
"""Worlds with wrong a-priori sigmas, which data cannot reveal."""
WORLDS = {name: with_noise(noise) for name, noise in NOISE.items()} | COVERED | UNCOVERED
CELLS = [
    (world, data, hours)
    for world in (*NOISE, *COVERED)
    for data in DATA
    for hours in HOURS
    if (world, data) != ("delays share errors", "ranges")  # which is white noise
]
CELLS.sort(key=lambda cell: (list(WORLDS).index(cell[0]), DATA.index(cell[1]), cell[2]))
CELLS += [(world, data, 12.0) for world in UNCOVERED for data in DATA]


def squares(data: str, hours: float, world: str, numbers: Sequence[int]) -> dict[tuple[str, int], np.ndarray]:
    """Return normalized errors squared of trials by region and its dimension; each cell has independent draws."""
    seed = zlib.crc32(f"{data} {hours} {world}".encode())
    linear = drawn_in(world, data, hours)
    with threadpool_limits(1):
        values = linear.run(seed, numbers)[:, 0]
    columns = dict(zip(linear.columns, values.T, strict=True))
    assert columns["converged"].all()
    error_m = np.stack([columns[f"{side}_m"] for side in SIDES], axis=1)
    sigma_m = np.stack([columns[f"sigma_{side}_m"] for side in SIDES], axis=1)
    covariance_m2 = sigma_m[:, :, None] * sigma_m[:, None] * np.eye(3) + undetected_covariance_m2(linear)
    covariance_m2[:, [0, 1], [1, 0]] += (columns["correlation_east_north"] * sigma_m[:, 0] * sigma_m[:, 1])[
        :, None
    ]
    horizontal_m = np.linalg.solve(covariance_m2[:, :2, :2], error_m[:, :2, None])[..., 0]
    return {
        ("horizontal", 2): (error_m[:, :2] * horizontal_m).sum(axis=1),
        ("height", 1): error_m[:, 2] ** 2 / covariance_m2[:, 2, 2],
    }


@cache
def drawn_in(world: str, data: str, hours: float) -> LinearTrials:
    """Return the trials of a cell."""
    return WORLDS[world](*prepared(data, hours))


def horizontal(world: str, data: str, hours: float) -> Draws:
    """Return the horizontal normalized errors squared of a cell by the numbers of draws."""
    return lambda numbers: squares(data, hours, world, numbers)["horizontal", 2]


def calibration_cells() -> list[Cell]:
    """Return the cells of covered worlds."""
    remarks = {"zenith delays drift": "covariance of the drift added"}
    return [
        Cell(
            f"{NAMES[data]}, {world}, {hours:g} h",
            partial(horizontal, world, data, hours),
            2,
            remarks.get(world, ""),
        )
        for world, data, hours in CELLS
        if world not in UNCOVERED
    ]


def held(data: str, hours: float, world: str, trials: int) -> dict[tuple[str, float], int]:
    """Count the trials with the truth in regions, by region and level."""
    chunks = [range(k, min(k + CHUNK_DRAWS, trials)) for k in range(0, trials, CHUNK_DRAWS)]
    drawn = [squares(data, hours, world, chunk) for chunk in chunks]
    return {
        (region, level): sum(int((part[region, dof] <= chi2.ppf(level, dof)).sum()) for part in drawn)
        for region, dof in drawn[0]
        for level in LEVELS
    }


def undetected_covariance_m2(linear: LinearTrials) -> np.ndarray:
    """Covariance (3, 3) of the position by drifts of zenith delays, K D K^T with the gain K of the stated weights.

    The fit adjusts a constant zenith delay for each pass. Its residuals keep of a drift of 3 cm less than the noise of
    0.4 m of single delays, so that hardly any fit detects it: a test of the regions must add it to their covariance.
    """
    arc = linear.arcs[0]
    drifts = [k for k, name in enumerate(linear.drawn.names) if name.endswith(DRIFT)]
    errors_m = linear.drawn.partials[drifts] * linear.drawn.sigmas[drifts, None]
    weights = arc.status.are(USED) / arc.noise.sigma_m**2
    shifts = np.zeros((len(arc.parameters), len(drifts)))
    shifts[arc.parameters.free] = arc.problem.to_free @ (arc.problem.basis.T @ (errors_m * weights).T)
    by_parameters = arc.compared[0].by_parameters[0]
    shifts_m = by_parameters @ shifts[: by_parameters.shape[1]]
    return np.asarray(shifts_m @ shifts_m.T)


def bounds(trials: int, level: float, compared: int, chance: float = 0.01) -> tuple[int, int]:
    """Return bounds of the counts of correct regions for a number of comparisons (Bonferroni)."""
    low, high = binom.ppf([0.5 * chance / compared, 1.0 - 0.5 * chance / compared], trials, level)
    return int(low), int(high)
