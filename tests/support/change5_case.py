"""Small simulated tracking of the Chang'e-5 landing site."""

from radioloc import LunarPosition, Observations, Study
from radioloc.measurements import PhysicalModel
from radioloc.simulation import (
    Noise,
    NoiseModel,
    Scenario,
    Schedule,
    Session,
    Truth,
    World,
    all_ranges,
    baselines,
)
from radioloc.study import EstimateChoice, HeightPrior, ModelChoice

START = "2020-12-01T15:11:00"
LANDER = LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
NEAR = LunarPosition.from_selenographic(-51.8, 43.1, -2000.0)
"""A-priori position, 10 km off."""

RANGING = ("JIAMUSI", "KASHI", "NEUQUEN")
VLBI = ("SESHAN25", "MIYUN50", "KUNMING", "URUMQI")
NOISE = NoiseModel(link={"range": Noise(white_m=1.0), "vlbi_delay": Noise(white_m=0.3)})
BIAS_M = {"JIAMUSI": 3.0, "KASHI": -4.0, "NEUQUEN": 2.0}
STUDY = """
[target]
longitude_deg = -51.8
latitude_deg = 43.0
height_m = -2500.0
[observations]
files = ["change5.csv"]
[estimate]
position = "geographic"
range_bias = "all"
range_bias_sigma_m = 10.0
height_prior = { height_m = -2550.4, sigma_m = 5.0 }
[model]
off = ["ionosphere"]
"""
"""Study file of benchmarks, for observations in ``change5.csv`` beside it."""


def sessions(
    step_s: float,
    stop: str,
    stations: tuple[str, ...] = RANGING,
    vlbi: tuple[str, ...] = VLBI,
    one_uplink: bool = True,
    sigmas_m: tuple[float, float] = (1.0, 0.3),
) -> list[Session]:
    """Return ranges for all pairs of stations and delays for all baselines."""
    ranges = Session("range", all_ranges(*stations), START, stop, step_s, sigmas_m[0], one_uplink=one_uplink)
    delays = [Session("vlbi_delay", baselines(*vlbi), START, stop, step_s, sigmas_m[1])] if vlbi else []
    return [ranges, *delays]


def study_of(
    planned: list[Session],
    noise: NoiseModel = NOISE,
    *,
    target: LunarPosition = LANDER,
    estimate: dict[str, object] | None = None,
    scenario: dict[str, object] | None = None,
    **changes: object,
) -> Study:
    """Return a study of simulated sessions, with range biases of 10 m and a height of 5 m a priori."""
    prior = HeightPrior(-2550.4, 5.0)
    choice = {"range_bias": "all", "range_bias_sigma_m": 10.0, "height_prior": prior} | (estimate or {})
    return Study(
        target=target,
        estimate=EstimateChoice(**choice),  # type: ignore[arg-type]
        model=ModelChoice(off=["ionosphere"]),
        simulation=Scenario(Schedule(planned), LANDER, noise=noise, **scenario or {}),  # type: ignore[arg-type]
        **{"consider_defaults": False} | changes,
    )


def world(
    model: PhysicalModel,
    step_s: float,
    *,
    stop: str = "2020-12-03T15:10:00",
    vlbi: bool = True,
    one_uplink: bool = True,
    bias_m: dict[str, float] | None = None,
) -> World:
    """Return the world of ranges by three stations and of delays on six baselines, without noise."""
    planned = sessions(step_s, stop, vlbi=VLBI if vlbi else (), one_uplink=one_uplink)
    truth = Truth(range_bias_m=BIAS_M if bias_m is None else bias_m)
    return Scenario(Schedule(planned), LANDER, truth).world(model)


def observations(model: PhysicalModel, step_s: float, *, seed: int = 1, **options: object) -> Observations:
    """Return observations of :func:`world` with noise."""
    return world(model, step_s, **options).draw(NOISE, seed=seed).observations  # type: ignore[arg-type]


PLAN = """
[target]
longitude_deg = -51.9
latitude_deg = 43.1
height_m = -2500.0
[estimate]
height_prior = { height_m = -2550.0, sigma_m = 5.0 }
[model]
off = ["ionosphere"]
[simulation.sessions.ranging]
kind = "range"
stations = ["JIAMUSI", "KASHI"]
links = "all"
one_uplink = true
start = 2020-12-01T15:11:00
stop = 2020-12-02T03:10:00
step_s = 3600
sigma_m = 1.0
[simulation.noise.range]
white_m = 1.0
"""
"""A study file of twelve hours of ranges, one an hour."""
