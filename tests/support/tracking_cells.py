"""Cells of the calibration with tracking of landers, in worlds with the errors of the fit's model and with others.

A cell is a kind of data, a length of arc, and a kind of noise or of difference from the model of the fit. Consider
parameters, biases and heights are drawn with the sigmas of the fit. Trials of a Monte Carlo study are the fits of
`locate`.
"""

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from functools import cache, partial

import numpy as np
from calibration import Cell, Draws
from change5_case import LANDER, NEAR, RANGING, START, VLBI
from threadpoolctl import threadpool_limits

from radioloc import LunarPosition, Study
from radioloc.jobs.linear_trials import LinearArc, LinearTrials, trial_seed
from radioloc.jobs.prepared_trials import Prepared
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
    two_way,
)
from radioloc.simulation.noise import NoiseDraws
from radioloc.simulation.schedule import Plan
from radioloc.simulation.truth import DrawnErrors
from radioloc.study import EstimateChoice, HeightPrior, ModelChoice, ObservationChoice

HOURS = (12.0, 24.0, 48.0)
STEP_S, STOP, SIGNAL = 300.0, "2020-12-03T15:10:00", {"wavelength_um": 35394.6}
UPLINK = {"uplink_hz": 7.2e9, "one_uplink": True}
RANGE_M, DELAY_M, BIAS_M, HEIGHT_M = 2.0, 0.4, 10.0, 5.0
SURVEYED_M = {"JIAMUSI": 0.1, "KASHI": 0.1, "NEUQUEN": 0.1, "MIYUN50": 0.05}
DSN = ("DSS-24", "DSS-34", "DSS-65")
DSN_BIAS_M, DSN_RANGE_M, DOPPLER_M = 2.0, 1.0, 0.006
"""Sigmas of range biases, of ranges and of 60 s of Doppler, 0.1 mm/s: DSN 810-005 module 202 and 203."""
REFLECTOR = LunarPosition("PA_DE421", np.array([1554678.949, 98094.118, 765004.906]))
NEAR_REFLECTOR = LunarPosition("PA_DE421", np.array([1554778.949, 97994.118, 765054.906]))
FIRST_NIGHT, NIGHT_STEP = datetime(2006, 4, 1, 2), timedelta(days=9.3)  # hours and phases of the Moon vary
LASER_M = 0.006

Trials = tuple[Plan, LinearTrials]
"""Plan of an arc and its trials."""
World = Callable[[Plan, LinearTrials], LinearTrials]
"""Trials with other errors than those that the fit considers."""


def matched(study: Study, hours: float) -> Trials:
    """Return the plan of a study and its trials, which draw the errors that the fit considers."""
    ready = Prepared.from_study(study, (hours,))
    linear = ready.linear()
    assert linear is not None
    return ready.world.plan, linear


def study_of(
    sessions: list[Session],
    masks: Masks,
    *,
    noise: NoiseModel | None = None,
    truth_sigma: TruthSigma | None = None,
    **choices: object,
) -> Study:
    """Return the study of a simulated lander with a height known to 5 m."""
    choices = {"estimate": EstimateChoice(height_prior=HeightPrior(-2550.4, HEIGHT_M))} | choices
    truth_sigma = truth_sigma or TruthSigma(position_enu_m=(0.0, 0.0, HEIGHT_M))
    world = Scenario(
        Schedule(sessions, masks), LANDER, noise=noise or NoiseModel({}), truth_sigma=truth_sigma
    )
    return Study(name="cell", target=NEAR, model=ModelChoice(off=["ionosphere"]), simulation=world, **choices)


def biased(stations: Sequence[str], bias_m: float) -> dict[str, object]:
    """Return choices of a study that estimates range biases, which are drawn with their a-priori sigma."""
    return {
        "estimate": EstimateChoice(
            range_bias="all", range_bias_sigma_m=bias_m, height_prior=HeightPrior(-2550.4, HEIGHT_M)
        ),
        "truth_sigma": TruthSigma(
            position_enu_m=(0.0, 0.0, HEIGHT_M), range_bias_m=dict.fromkeys(stations, bias_m)
        ),
    }


def delays(sigma_m: float) -> Session:
    """Return VLBI of four stations."""
    return Session("vlbi_delay", baselines(*VLBI), START, STOP, STEP_S, sigma_m, **SIGNAL)


@cache
def change5(data: str, hours: float) -> Trials:
    """Return trials of ranges by three stations, of VLBI by four, or of both."""
    ranging = Session("range", all_ranges(*RANGING), START, STOP, STEP_S, RANGE_M, **UPLINK, **SIGNAL)
    of_ranges, of_delays = "ranges" in data, "VLBI" in data
    stations = RANGING * of_ranges + VLBI * of_delays
    surveyed = {name: sigma_m for name, sigma_m in SURVEYED_M.items() if name in stations}
    study = study_of(
        [ranging] * of_ranges + [delays(DELAY_M)] * of_delays,
        Masks(station_deg=15.0, by_station_deg=dict.fromkeys(RANGING, 10.0)),
        consider=considered_choices({"station_position_sigma_m": surveyed}),
        **(biased(RANGING, BIAS_M) if of_ranges else {}),
    )
    return matched(study, hours)


def vlbi(hours: float, noise: NoiseModel, sigma_m: float, station_m: float = 0.0) -> Trials:
    """Return trials of VLBI whose delays share errors of stations; they are stated by `station_m`, or not."""
    stated = ObservationChoice(vlbi_station_sigma_m=station_m)
    return matched(
        study_of([delays(sigma_m)], Masks(station_deg=15.0), noise=noise, observations=stated), hours
    )


def clocks_with_rates() -> Trials:
    """Return trials of VLBI over 48 h whose clocks have drawn offsets and rates."""
    truth_sigma = TruthSigma(
        position_enu_m=(0.0, 0.0, HEIGHT_M),
        clock_s=dict.fromkeys(VLBI, 0.2e-9),
        clock_rate_s_s=dict.fromkeys(VLBI, 5e-15),
    )
    noise = NoiseModel({"vlbi_delay": Noise(white_m=DELAY_M)})
    return matched(
        study_of([delays(DELAY_M)], Masks(station_deg=15.0), noise=noise, truth_sigma=truth_sigma), 48.0
    )


def deep_space_network(hours: float, noise: NoiseModel) -> Trials:
    """Return trials of two-way ranges and Doppler by three complexes."""
    common = UPLINK | SIGNAL
    sessions = [
        Session("range", two_way(*DSN), START, STOP, 300.0, DSN_RANGE_M, **common),
        Session("doppler", two_way(*DSN), START, STOP, 60.0, DOPPLER_M, count_s=60.0, **common),
    ]
    return matched(study_of(sessions, Masks(station_deg=10.0), noise=noise, **biased(DSN, DSN_BIAS_M)), hours)


def laser_ranges_of_a_year() -> Trials:
    """Return trials of laser ranges by one station, six in each of forty nights of a year."""
    nights = [FIRST_NIGHT + NIGHT_STEP * k for k in range(40)]
    sessions = [
        Session(
            "range",
            two_way("APOLLO"),
            night.isoformat(),
            (night + timedelta(hours=1)).isoformat(),
            600.0,
            LASER_M,
            wavelength_um=0.532,
        )
        for night in nights
    ]
    noise = NoiseModel({"range": Noise(white_m=LASER_M)})
    world = Scenario(Schedule(sessions, Masks(station_deg=20.0)), REFLECTOR, noise=noise)
    # The troposphere of laser ranges needs recorded weather.
    off = ModelChoice(off=["troposphere"])
    return matched(
        Study(name="laser ranges", target=NEAR_REFLECTOR, model=off, simulation=world), 366.0 * 24.0
    )


def with_noise(noise: NoiseModel) -> World:
    """Return the matched world with some noise."""
    return lambda plan, linear: replace(linear, draws=NoiseDraws.from_plan(noise, plan))


def scaled_errors(factor: float) -> World:
    """Scale the drawn errors of consider parameters, biases and height."""
    return lambda plan, linear: with_noise(WHITE)(
        plan, replace(linear, drawn=replace(linear.drawn, sigmas=factor * linear.drawn.sigmas))
    )


def noisy_station(plan: Plan, linear: LinearTrials) -> LinearTrials:
    """Increase the noise of a station for ranges and of another for VLBI."""
    at_station = replace(WHITE, vlbi_station=Noise(white_m=1.0))
    series = []
    for item in NoiseDraws.from_plan(at_station, plan).series:
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
    extended = DrawnErrors(
        (*drawn.names, *names),
        np.concatenate([drawn.sigmas, np.full(len(names), DRIFT_M)]),
        np.concatenate([drawn.partials, partials]),
    )

    def padded(arc: LinearArc) -> LinearArc:
        [compared] = arc.compared  # drifts do not shift the true position
        by_drawn = np.pad(compared.by_drawn, ((0, 0), (0, 0), (0, len(names))))
        return replace(arc, compared=(replace(compared, by_drawn=by_drawn),))

    return with_noise(WHITE)(plan, replace(linear, drawn=extended, arcs=tuple(map(padded, linear.arcs))))


def undetected_covariance_m2(linear: LinearTrials) -> np.ndarray:
    """Covariance (2, 2) of the place by drifts of zenith delays, K D K^T with the gain K of the stated weights.

    The fit adjusts a constant zenith delay for each pass. Its residuals keep of a drift of 3 cm less than the noise of
    0.4 m of single delays, so that hardly any fit detects it: a test of the regions must add it to their covariance.
    """
    arc = linear.arcs[0]
    drifts = [k for k, name in enumerate(linear.drawn.names) if name.endswith(DRIFT)]
    errors_m = linear.drawn.partials[drifts] * linear.drawn.sigmas[drifts, None]
    weights = arc.status.are(USED) / arc.noise.sigma_m**2
    shifts = np.zeros((len(arc.parameters), len(drifts)))
    shifts[arc.parameters.free] = arc.problem.to_free @ (arc.problem.basis.T @ (errors_m * weights).T)
    by_parameters = arc.compared[0].by_parameters[0][:2]
    shifts_m = by_parameters @ shifts[: by_parameters.shape[1]]
    return np.asarray(shifts_m @ shifts_m.T)


def horizontal_squares(linear: LinearTrials, seed: int, numbers: Sequence[int]) -> np.ndarray:
    """Return the normalized horizontal errors squared of trials that must converge."""
    with threadpool_limits(1):
        values = linear.run(seed, numbers)[:, 0]
    columns = dict(zip(linear.columns, values.T, strict=True))
    assert columns["converged"].all()
    added_m2 = undetected_covariance_m2(linear)
    if not added_m2.any():
        return columns["nees_horizontal"]
    error_m, sigma_m = (
        np.stack([columns[f"{prefix}{side}_m"] for side in ("east", "north")], axis=1)
        for prefix in ("", "sigma_")
    )
    correlation = np.eye(2) + columns["correlation_east_north"][:, None, None] * (1.0 - np.eye(2))
    covariance_m2 = correlation * sigma_m[:, :, None] * sigma_m[:, None] + added_m2
    return (error_m * np.linalg.solve(covariance_m2, error_m[..., None])[..., 0]).sum(axis=1)


def drawn(trials: Callable[[], Trials], world: World | None, seed: int) -> Draws:
    """Return normalized errors squared of trials, by default with the noise of their study."""
    plan, linear = trials()
    return partial(horizontal_squares, linear if world is None else world(plan, linear), seed)


def drawn_stations(hours: float, seed: int) -> Draws:
    """Return trials of VLBI whose errors of stations have a drawn correlation: white or lasting at even odds."""
    plan, linear = vlbi(hours, NoiseModel({}), 0.38, 0.18)

    def squares(numbers: Sequence[int]) -> list[float]:
        result = []
        for number in numbers:
            rng = np.random.default_rng([trial_seed(seed, number), 1])
            lasting_m = rng.integers(2) * rng.uniform(0.0, MAX_LASTING_M)
            correlation_s = TYPICAL_CORRELATION_S * np.exp(LOG_CORRELATION_SIGMA * rng.standard_normal())
            noise = stations_last(0.38, 0.18, lasting_m, correlation_s)
            result += horizontal_squares(with_noise(noise)(plan, linear), seed, [number]).tolist()
        return result

    return squares


def stations_last(
    delay_m: float, white_m: float, coloured_m: float, correlation_s: float = 5400.0
) -> NoiseModel:
    """Return white noise of delays, and noise of stations of which a part lasts."""
    station = Noise(white_m=white_m, coloured_m=coloured_m, correlation_s=correlation_s)
    return NoiseModel({"vlbi_delay": Noise(white_m=delay_m)}, vlbi_station=station)


MAX_LASTING_M = 0.25
"""Largest sigma of drawn lasting errors of stations: as in the cells with large ones."""
TYPICAL_CORRELATION_S, LOG_CORRELATION_SIGMA = 3600.0, 0.8
"""A-priori density of correlation times of the fit."""
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
DOUBLE = NoiseModel({"range": Noise(white_m=2.0 * RANGE_M), "vlbi_delay": Noise(white_m=2.0 * DELAY_M)})
SHARED = NoiseModel(
    {"range": Noise(white_m=RANGE_M), "vlbi_delay": Noise(white_m=0.2)}, vlbi_station=Noise(white_m=0.25)
)
NOISY_M = {"KASHI": 3.0 * RANGE_M, "MIYUN50": 2.0 * DELAY_M}
"""Larger noise of ranges at one station and of VLBI arrivals at another, unknown to the fit."""
DRIFT, DRIFT_M = " drift", 0.03
"""Sigma of the drift of the zenith delay at the ends of a pass."""
DSN_WHITE = NoiseModel({"range": Noise(white_m=DSN_RANGE_M), "doppler": Noise(white_m=DOPPLER_M)})
DSN_LASTING = NoiseModel(
    {
        "range": Noise(white_m=0.7, coloured_m=0.7, correlation_s=3600.0),
        "doppler": Noise(white_m=0.004, coloured_m=0.004, correlation_s=3600.0),
    }
)
WORLDS: dict[str, World] = {
    "white": with_noise(WHITE),
    "Gauss-Markov": with_noise(GAUSS_MARKOV),
    "flicker": with_noise(FLICKER),
    "twice the stated sigmas": with_noise(DOUBLE),
    "one noisy station": noisy_station,
    "delays share errors": with_noise(SHARED),
    "zenith delays drift": drifting_air,
}
REMARKS = {"zenith delays drift": "covariance of the drift added"}


def wrong_apriori(data: str, factor: float) -> Cell:
    """Return a cell with a-priori sigmas that are wrong by a factor, which data cannot reveal."""
    return Cell(
        f"{data}, a-priori errors {factor:g} times",
        partial(drawn, partial(change5, data, 12.0), scaled_errors(factor), 5),
    )


def calibration_cells() -> Iterator[Cell]:
    """Yield the cells of this module."""
    small, large = stations_last(0.38, 0.15, 0.1), stations_last(0.2, 0.1, 0.25)
    for name, arguments in {
        "shared errors stated": (stations_last(0.38, 0.18, 0.0), 0.38, 0.18),
        "lasting errors of stations": (small, 0.457),
        "lasting errors of stations, stated": (small, 0.38, 0.18),
        "large lasting errors of stations": (large, 0.43),
        "large lasting errors of stations, stated": (large, 0.2, 0.27),
    }.items():
        for hours in (24.0, 48.0):
            yield Cell(
                f"VLBI, {name}, {hours:g} h", partial(drawn, partial(vlbi, hours, *arguments), None, 3)
            )
    for hours in (24.0, 48.0):
        yield Cell(f"VLBI, drawn errors of stations, {hours:g} h", partial(drawn_stations, hours, 9))
    yield Cell("VLBI, clock offsets and rates, 48 h", partial(drawn, clocks_with_rates, None, 1))
    for name, hours, noise in (
        ("Gauss-Markov", 12.0, DSN_LASTING),
        ("Gauss-Markov", 24.0, DSN_LASTING),
        ("white", 12.0, DSN_WHITE),
    ):
        yield Cell(
            f"DSN, {name}, {hours:g} h", partial(drawn, partial(deep_space_network, hours, noise), None, 2)
        )
    yield Cell("laser ranges, one station, nights of a year", partial(drawn, laser_ranges_of_a_year, None, 4))
    for world, errors in WORLDS.items():
        for data, key in (("ranges", "ranges"), ("VLBI", "delays"), ("ranges and VLBI", "both")):
            for hours in HOURS if (world, data) != ("delays share errors", "ranges") else ():  # white noise
                seed = zlib.crc32(f"{key} {hours} {world}".encode())
                yield Cell(
                    f"{data}, {world}, {hours:g} h",
                    partial(drawn, partial(change5, data, hours), errors, seed),
                    remark=REMARKS.get(world, ""),
                )
