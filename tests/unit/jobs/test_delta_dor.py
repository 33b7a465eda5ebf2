"""Delays of a lander and of quasars: together they tell the stations' clocks, differenced they need none."""

from dataclasses import replace

import numpy as np
import pytest
from arc_cases import observed_at
from tdm_messages import DELAY, kvn

import radioloc
from radioloc import LunarPosition, Observations
from radioloc.ephemeris import CONSTANTS
from radioloc.errors import InputError
from radioloc.jobs.preparation import build_model
from radioloc.measurements import Link
from radioloc.parameters.choice import parameter_choices
from radioloc.study import EstimateChoice, ModelChoice, ObservationChoice
from radioloc.time import Epochs

SITE = LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
APRIORI = LunarPosition.from_selenographic(-51.9, 43.0, -2550.4)
STATIONS = ("SESHAN25", "KUNMING", "URUMQI")
BASELINES = [(first, second) for k, first in enumerate(STATIONS) for second in STATIONS[k + 1 :]]
# Two of those that were near the Moon, which stood at 7 h 20 min and +23 deg.
LIST = "source,right_ascension_deg,declination_deg\n0716+332,109.9,33.12\n0738+313,115.2945,31.2\n"
CLOCKS_S = {"KUNMING": 3.0e-7, "URUMQI": -1.5e-7}
RATES = {"KUNMING": 2e-13, "URUMQI": -4e-13}
RECOVERED_M = 2e-3
"""Without noise: what a sigma of 1e-6 s of the clocks and one of 100 m of the height take."""


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    path = tmp_path_factory.mktemp("quasars") / "quasars.csv"
    path.write_text(LIST)
    return path


def table(targets, kind="vlbi_delay"):
    """Scans of two minutes in turn, over ten hours."""
    links = [Link.from_path(f"{a}<{target}>{b}") for target in targets for a, b in BASELINES]
    scans = np.arange(150)
    parts = [
        observed_at(
            Epochs.from_jd(2459185.5, (15.0 + scans[index] * 4.0 / 60.0) / 24.0, "TAI"),
            link,
            kind=kind,
            sigma_m=0.02,
            wavelength_um=35394.6,
        )
        for k, link in enumerate(links)
        for index in [slice(k // len(BASELINES), None, len(targets))]
    ]
    return Observations.concatenate(parts)


def study(sources, clocks=True, **keys):
    stations = {
        "clock": list(CLOCKS_S),
        "clock_sigma_s": 1e-6,
        "clock_rate": list(RATES),
        "clock_rate_sigma_s_s": 1e-11,
    }
    height = radioloc.study.HeightPrior(-2550.4, 100.0)
    return radioloc.Study(
        APRIORI,
        ObservationChoice(),
        EstimateChoice(height_prior=height, weights="independent", **(stations if clocks else {}), **keys),
        ModelChoice(sources=[sources]),
        consider=parameter_choices({}),
        consider_defaults=False,
    )


def measured(sources, observations, **clocks):
    truth = replace(study(sources), target=SITE, estimate=EstimateChoice(position="none", **clocks))
    solution = radioloc.compute_residuals(truth, observations)
    usable = np.flatnonzero(solution.residuals.used)
    value_m = np.array(observations.value_m - solution.residuals.residual_m)
    return replace(observations, value_m=value_m).select(usable)


WITH_CLOCKS = {"clock_s": CLOCKS_S, "clock_rate_s_s": RATES}


@pytest.fixture(scope="module")
def tracking(sources):
    return measured(sources, table(["lander", "0716+332", "0738+313"]), **WITH_CLOCKS)


def off_m(solution):
    return np.linalg.norm(
        np.subtract(*(item.to_axes("PA", CONSTANTS["DE421"]).xyz_m for item in (solution.position, SITE)))
    )


def test_quasars_tell_the_clocks(sources, tracking):
    solution = radioloc.locate(study(sources), tracking)
    assert solution.converged
    assert off_m(solution) < RECOVERED_M
    for name, clock_s in CLOCKS_S.items():
        found_s = solution.values[solution.parameters.index(f"clock.{name}")]
        assert found_s == pytest.approx(clock_s, abs=1e-12)
    # Both kinds of target are named where residuals are grouped.
    assert "0716+332" in str(solution.residuals.paths.present())


@pytest.mark.study
def test_clocks_are_estimated_where_a_study_says_nothing(sources, tracking):
    """All but that of the first station, which keeps the time."""
    solution = radioloc.locate(replace(study(sources, clocks=False), consider_defaults=True), tracking)
    assert solution.converged
    assert off_m(solution) < RECOVERED_M
    clocks = solution.parameters.of_kind("clock") + solution.parameters.of_kind("clock_rate")
    assert sorted(solution.parameters.names[k] for k in clocks) == sorted(
        f"{kind}.{name}" for kind in ("clock", "clock_rate") for name in CLOCKS_S
    )
    # Not where it is said that nothing is to be assumed, and then the delays do not fit.
    assert not radioloc.locate(study(sources, clocks=False), tracking).converged


def test_without_quasars_the_place_is_less_certain(sources, tracking):
    # With noise as it is stated: what stations share in residuals that are nothing but rounding means nothing.
    noise_m = np.random.default_rng(1).normal(0.0, tracking.sigma_m)
    tracking = replace(tracking, value_m=tracking.value_m + noise_m)
    lander = np.array([link.target == "lander" for link in tracking.links])[tracking.link]
    block = radioloc.locate(study(sources), tracking)
    separate_solution = radioloc.locate(study(sources), tracking.select(lander))
    sigmas = [np.sqrt(np.trace(plan.position_covariance()[:2, :2])) for plan in (block, separate_solution)]
    assert sigmas == [pytest.approx(45.0, abs=2.0), pytest.approx(150.0, abs=5.0)]


def test_differences_need_no_clocks(sources):
    """A file of delta-DOR, made with clocks that its reader does not know of."""
    differences = measured(sources, table(["lander|0716+332"], "differenced_delay"), **WITH_CLOCKS)
    solution = radioloc.locate(study(sources, clocks=False), differences)
    assert solution.converged
    # Of the second order: a clock that tags late does so for both, while they move apart.
    assert off_m(solution) < 0.05


def test_a_quasar_in_a_message(sources, tmp_path):
    """DOR of a quasar and of the lander, each in its segment."""
    records = ["DOR = 2020-12-02T16:00:00 -1.5E-03"]
    message = tmp_path / "dor.tdm"
    message.write_text(
        "\n".join(kvn((DELAY, records), (DELAY | {"PARTICIPANT_1": "0716+332"}, records))) + "\n"
    )
    requested = ObservationChoice(files=[message], tdm=radioloc.io.TdmAgreement(sigma_m={"vlbi_delay": 0.02}))
    held = replace(
        study(sources, clocks=False), observations=requested, estimate=EstimateChoice(position="none")
    )
    solution = radioloc.compute_residuals(held)
    assert set(solution.residuals.paths.present()) == {"SESHAN25<lander>KUNMING", "SESHAN25<0716+332>KUNMING"}
    with pytest.raises(InputError, match=r": \[model\]"):
        radioloc.compute_residuals(replace(held, model=ModelChoice()))


PLAN = """
[target]
longitude_deg = -51.9162
latitude_deg = 43.0584
height_m = -2550.4
[model]
sources = "quasars.csv"
[estimate]
height_prior = { height_m = -2550.4, sigma_m = 100.0 }
[simulation.truth]
clock_s = { KUNMING = 3e-7, URUMQI = -1.5e-7 }
[simulation.noise.vlbi_delay]
white_m = 0.02
[simulation.sessions.lander]
kind = "vlbi_delay"
stations = ["SESHAN25", "KUNMING", "URUMQI"]
start = 2020-12-02T15:00:00
stop = 2020-12-03T01:00:00
step_s = 480
sigma_m = 0.02
"""
OF_A_QUASAR = (
    PLAN[PLAN.index("[simulation.sessions.lander]") :]
    .replace("sessions.lander", "sessions.quasar")
    .replace("T15:00:00", "T15:04:00")
    + 'source = "0716+332"\n'
)


def planned(folder, text):
    (folder / "quasars.csv").write_text(LIST)
    (folder / "plan.toml").write_text(text)
    return radioloc.read_study(folder / "plan.toml")


def test_tracking_beside_a_quasar_is_simulated_and_fitted(tmp_path):
    plan = planned(tmp_path, PLAN + OF_A_QUASAR)
    observations = plan.simulation.world(build_model(plan)).draw().observations
    of_quasar = np.array([link.target == "0716+332" for link in observations.links])[observations.link]
    assert 150 < of_quasar.sum() < (~of_quasar).sum() + 30
    solution = radioloc.locate(replace(plan, simulation=None), observations)
    assert solution.converged
    assert solution.values[solution.parameters.index("clock.KUNMING")] == pytest.approx(3e-7, abs=1e-10)
