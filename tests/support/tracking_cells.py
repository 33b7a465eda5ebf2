"""Cells of the calibration with tracking of a lander: clocks with rates, and noise that lasts in short arcs."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from functools import partial

import numpy as np
from calibration import Cell, Draws
from change5_case import LANDER, NEAR, START, VLBI
from threadpoolctl import threadpool_limits

from radioloc import LunarPosition, Study
from radioloc.jobs.linear_trials import LinearArc, LinearTrials
from radioloc.jobs.prepared_trials import Prepared
from radioloc.simulation import (
    Masks,
    Noise,
    NoiseModel,
    Scenario,
    Schedule,
    Session,
    TruthSigma,
    baselines,
    two_way,
)
from radioloc.simulation.schedule import Plan
from radioloc.simulation.truth import DrawnErrors
from radioloc.study import EstimateChoice, HeightPrior, ModelChoice, ObservationChoice

CLOCKS_SEED, DSN_SEED, SHARED_SEED, LASER_SEED = 1, 2, 3, 4
DELAY_M, HEIGHT_M = 0.4, 5.0
DSN = ("DSS-24", "DSS-34", "DSS-65")
BIAS_M, RANGE_M, DOPPLER_M = 2.0, 1.0, 0.006
"""Sigmas of range biases, of ranges and of 60 s of Doppler, 0.1 mm/s: DSN 810-005 module 202 and 203."""
REFLECTOR = LunarPosition("PA_DE421", np.array([1554678.949, 98094.118, 765004.906]))
NEAR_REFLECTOR = LunarPosition("PA_DE421", np.array([1554778.949, 97994.118, 765054.906]))
FIRST_NIGHT, NIGHT_STEP = datetime(2006, 4, 1, 2), timedelta(days=9.3)  # hours and phases of the Moon vary
LASER_M = 0.006
SIGNAL = {"wavelength_um": 35394.6}
STOP = "2020-12-03T15:10:00"


def matched_trials(study: Study, hours: float) -> tuple[Plan, LinearTrials]:
    """Return the plan of a study and its trials, which draw the errors that the fit considers."""
    ready = Prepared.of(study, (hours,))
    linear = ready.linear()
    assert linear is not None
    return ready.world.plan, linear


def drawing(linear: LinearTrials, drawn: DrawnErrors) -> LinearTrials:
    """Append drawn errors that do not shift the true position."""
    count = len(drawn.names) - len(linear.drawn.names)

    def padded(arc: LinearArc) -> LinearArc:
        [compared] = arc.compared
        by_drawn = np.pad(compared.by_drawn, ((0, 0), (0, 0), (0, count)))
        return replace(arc, compared=(replace(compared, by_drawn=by_drawn),))

    return replace(linear, drawn=drawn, arcs=tuple(map(padded, linear.arcs)))


def horizontal_squares(linear: LinearTrials, seed: int, numbers: Sequence[int]) -> np.ndarray:
    """Return the normalized horizontal errors squared of trials that must converge."""
    with threadpool_limits(1):
        values = linear.run(seed, numbers)[:, 0]
    columns = dict(zip(linear.columns, values.T, strict=True))
    assert columns["converged"].all()
    return columns["nees_horizontal"]


def clocks_with_rates() -> Draws:
    """Return trials of VLBI over 48 h whose clocks have drawn offsets and rates."""
    offset_s, rate = dict.fromkeys(VLBI, 0.2e-9), dict.fromkeys(VLBI, 5e-15)
    session = Session("vlbi_delay", baselines(*VLBI), START, STOP, 300.0, DELAY_M, **SIGNAL)
    truth_sigma = TruthSigma(position_enu_m=(0.0, 0.0, HEIGHT_M), clock_s=offset_s, clock_rate_s_s=rate)
    noise = NoiseModel({"vlbi_delay": Noise(white_m=DELAY_M)})
    study = Study(
        name="clocks",
        target=NEAR,
        estimate=EstimateChoice(height_prior=HeightPrior(-2550.4, HEIGHT_M)),
        model=ModelChoice(off=["ionosphere"]),
        simulation=Scenario(
            Schedule([session], Masks(station_deg=15.0)), LANDER, noise=noise, truth_sigma=truth_sigma
        ),
    )
    return partial(horizontal_squares, matched_trials(study, 48.0)[1], CLOCKS_SEED)


def deep_space_network(hours: float, noise: NoiseModel) -> Draws:
    """Return trials of two-way ranges and Doppler by three complexes."""
    common = {"uplink_hz": 7.2e9, "one_uplink": True, **SIGNAL}
    sessions = [
        Session("range", two_way(*DSN), START, STOP, 300.0, RANGE_M, **common),
        Session("doppler", two_way(*DSN), START, STOP, 60.0, DOPPLER_M, count_s=60.0, **common),
    ]
    truth_sigma = TruthSigma(position_enu_m=(0.0, 0.0, HEIGHT_M), range_bias_m=dict.fromkeys(DSN, BIAS_M))
    study = Study(
        name="DSN",
        target=NEAR,
        estimate=EstimateChoice(
            range_bias="all", range_bias_sigma_m=BIAS_M, height_prior=HeightPrior(-2550.4, HEIGHT_M)
        ),
        model=ModelChoice(off=["ionosphere"]),
        simulation=Scenario(
            Schedule(sessions, Masks(station_deg=10.0)), LANDER, noise=noise, truth_sigma=truth_sigma
        ),
    )
    return partial(horizontal_squares, matched_trials(study, hours)[1], DSN_SEED)


def laser_ranges_of_a_year() -> Draws:
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
    study = Study(
        name="laser ranges",
        target=NEAR_REFLECTOR,
        model=ModelChoice(off=["troposphere"]),  # which needs recorded weather
        simulation=Scenario(
            Schedule(sessions, Masks(station_deg=20.0)),
            REFLECTOR,
            noise=NoiseModel({"range": Noise(white_m=LASER_M)}),
        ),
    )
    return partial(horizontal_squares, matched_trials(study, 366.0 * 24.0)[1], LASER_SEED)


def shared_by_stations(hours: float, noise: NoiseModel, sigma_m: float, station_m: float = 0.0) -> Draws:
    """Return trials of VLBI whose delays share errors of stations; they are stated by `station_m`, or not."""
    session = Session("vlbi_delay", baselines(*VLBI), START, STOP, 300.0, sigma_m, **SIGNAL)
    study = Study(
        name="shared",
        target=NEAR,
        estimate=EstimateChoice(height_prior=HeightPrior(-2550.4, HEIGHT_M)),
        observations=ObservationChoice(vlbi_station_sigma_m=station_m),
        model=ModelChoice(off=["ionosphere"]),
        simulation=Scenario(
            Schedule([session], Masks(station_deg=15.0)),
            LANDER,
            noise=noise,
            truth_sigma=TruthSigma(position_enu_m=(0.0, 0.0, HEIGHT_M)),
        ),
    )
    return partial(horizontal_squares, matched_trials(study, hours)[1], SHARED_SEED)


def stations_last(delay_m: float, white_m: float, coloured_m: float) -> NoiseModel:
    """Return white noise of delays, and noise of stations of which a part lasts for 90 minutes."""
    station = Noise(white_m=white_m, coloured_m=coloured_m, correlation_s=5400.0)
    return NoiseModel({"vlbi_delay": Noise(white_m=delay_m)}, vlbi_station=station)


LASTING = NoiseModel(
    {
        "range": Noise(white_m=0.7, coloured_m=0.7, correlation_s=3600.0),
        "doppler": Noise(white_m=0.004, coloured_m=0.004, correlation_s=3600.0),
    }
)
DSN_WHITE = NoiseModel({"range": Noise(white_m=RANGE_M), "doppler": Noise(white_m=DOPPLER_M)})


def calibration_cells() -> list[Cell]:
    """Return the cells of this module."""
    small, large = stations_last(0.38, 0.15, 0.1), stations_last(0.2, 0.1, 0.25)
    shared = [
        Cell(f"VLBI, {name}, {hours:g} h", partial(shared_by_stations, hours, *arguments))
        for name, arguments in {
            "shared errors stated": (stations_last(0.38, 0.18, 0.0), 0.38, 0.18),
            "lasting errors of stations": (small, 0.457),
            "lasting errors of stations, stated": (small, 0.38, 0.18),
            "large lasting errors of stations": (large, 0.43),
            "large lasting errors of stations, stated": (large, 0.2, 0.27),
        }.items()
        for hours in (24.0, 48.0)
    ]
    return [
        *shared,
        Cell("VLBI, clock offsets and rates, 48 h", clocks_with_rates),
        Cell("DSN, Gauss-Markov, 12 h", partial(deep_space_network, 12.0, LASTING)),
        Cell("DSN, Gauss-Markov, 24 h", partial(deep_space_network, 24.0, LASTING)),
        Cell("DSN, white, 12 h", partial(deep_space_network, 12.0, DSN_WHITE)),
        Cell("laser ranges, one station, nights of a year", laser_ranges_of_a_year),
    ]
