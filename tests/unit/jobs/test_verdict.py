"""A status of "converged" means that the position can be used."""

import re
from dataclasses import replace

import change5_case
import numpy as np
import pytest
from reader_cases import EXAMPLES
from toy_moon import ToyMoon, toy_fit

import radioloc
from radioloc.constants import C_M_S
from radioloc.estimation import FitStatus, variance_components
from radioloc.estimation.consistency_results import ConsistencyTest
from radioloc.estimation.status import Doubt
from radioloc.jobs.preparation import prepared_arc
from radioloc.jobs.verdict import decide_status
from radioloc.lunar import LunarPosition
from radioloc.measurements import MEASUREMENTS, Link, PhysicalModel
from radioloc.simulation import Noise, NoiseModel, Scenario, Schedule
from radioloc.study import EstimateChoice, ModelChoice, ObservationChoice
from radioloc.targets.doubts import FittedObservations, height_doubts, place_doubts


@pytest.fixture(scope="module")
def tracking():
    return change5_case.observations(PhysicalModel.build(), 1200.0)


def study(target=change5_case.NEAR, hours=None, stations=None, consider_defaults=True, **estimate):
    return radioloc.Study(
        target,
        ObservationChoice(hours=hours, stations=stations),
        EstimateChoice(**estimate),
        ModelChoice(off=["ionosphere"]),
        consider_defaults=consider_defaults,
    )


def exchanged(observations, item, second):
    """The same values with the names of two stations exchanged."""
    name = {item: second, second: item}
    links = tuple(
        Link(
            name.get(x.transmitter, x.transmitter), x.target, name.get(x.receiver, x.receiver), x.differenced
        )
        for x in observations.links
    )
    return replace(observations, links=links)


@pytest.mark.slow
def test_an_orbiter_taken_for_a_lander_does_not_converge():
    """The fit looks for a point that moves like it, thousands of kilometres away, and ends with what is wrong."""
    target = LunarPosition.from_selenographic(31.3, 8.3, -1750.0)
    tracking = radioloc.read_observations(EXAMPLES / "orbiter" / "tracking.csv")
    doppler = tracking.select(tracking.kind == list(MEASUREMENTS).index("doppler"))
    solution = radioloc.locate(radioloc.Study(target), doppler)
    assert not solution.converged
    assert "the residuals are far beyond their stated sigmas: of doppler" in solution.message
    assert "an orbiter needs a trajectory or dynamics" in solution.message


@pytest.mark.slow
def test_delays_of_two_stations_exchanged_do_not_converge(tracking):
    solution = radioloc.locate(study(), exchanged(tracking, "SESHAN25", "KUNMING"))
    assert not solution.converged
    assert "far beyond their stated sigmas" in solution.message
    assert "of vlbi_delay" in solution.message


@pytest.mark.parametrize(("count", "status"), [(12, FitStatus.MISFIT), (5, FitStatus.CONVERGED)])
def test_a_run_of_outliers_is_named_and_much_of_a_station_is_a_misfit(tracking, count, status):
    two_way = [link.transmitter == link.receiver == "NEUQUEN" for link in tracking.links]
    rows = np.flatnonzero(np.array(two_way)[tracking.link])
    rows = rows[np.argsort(tracking.epoch.fraction[rows] + tracking.epoch.jd[rows])][10 : 10 + count]
    long = replace(tracking, value_m=tracking.value_m + 300.0 * np.isin(np.arange(len(tracking)), rows))
    solution = radioloc.locate(study(), long)
    assert solution.status is status
    assert not solution.residuals.used[rows].any()
    run = solution.consistency.findings[0]
    assert (run.kind, run.dof) == ("run", count)
    assert "NEUQUEN" in run.name
    assert run.amounts[""] == pytest.approx(300.0, abs=5.0)
    if status is FitStatus.MISFIT:
        assert "range observations of NEUQUEN are rejected as outliers" in solution.message


def test_a_point_that_no_station_sees_does_not_converge(tracking):
    """On the far side, from where the delays of a baseline are nearly those of the near side."""
    arc, _ = prepared_arc(study(), tracking)
    used, elevation_deg = np.ones(len(tracking), dtype=bool), np.full(len(tracking), 20.0)
    fitted = FittedObservations(arc, 0, used, used, np.zeros(len(tracking)), elevation_deg)
    place_m = change5_case.LANDER.to_axes("PA", arc.model.ephemeris.constants).xyz_m
    assert [*place_doubts(place_m, fitted)] == []
    [doubt] = place_doubts(-place_m, fitted)
    assert doubt.status is FitStatus.HIDDEN
    assert "deg below its horizon" in doubt.reason
    elevation_deg[7] = -0.5
    [doubt] = place_doubts(place_m, fitted)
    assert doubt.status is FitStatus.HIDDEN
    assert "1 used observation is below" in doubt.reason


@pytest.mark.parametrize(
    ("height_m", "good"), [(10_700.0, True), (-9_100.0, True), (19.683e6, False), (-3e4, False)]
)
def test_heights_are_those_of_the_moon(height_m, good):
    assert [doubt.status for doubt in height_doubts(height_m)] == ([] if good else [FitStatus.OFF_THE_MOON])


def test_ranges_that_are_too_long_are_a_height_that_the_moon_does_not_have(tracking):
    """100 km too long, for an hour in which nothing else can tell: the fit is as good as any."""
    long = replace(tracking, value_m=tracking.value_m + 1e5)
    solution = radioloc.locate(study(hours=1.0, stations=("JIAMUSI",)), long)
    assert solution.fit.chi2_per_dof < 3.0
    assert solution.status is FitStatus.OFF_THE_MOON
    assert "is outside the Moon's terrain (-9.2 to 10.8 km)" in solution.message


@pytest.mark.study
@pytest.mark.parametrize(
    ("noise", "usable"), [(Noise(coloured_m=100.0, correlation_s=5e3), False), (Noise(white_m=50.0), True)]
)
def test_trials_are_judged_as_solutions_are(noise, usable):
    """Errors far beyond the sigmas that last for hours: no trial counts, by the linear model or in full. Noise does."""
    ranges = change5_case.sessions(1200.0, "2020-12-03T15:11:00", vlbi=())
    scenario = Scenario(Schedule(ranges), change5_case.LANDER, noise=NoiseModel({"range": noise}))
    result = radioloc.monte_carlo(replace(study(), simulation=scenario), trials=3, hours=48.0)
    assert result.linear
    assert result.linearity.passed
    assert (result["converged"] == usable).all()


@pytest.mark.study
def test_a_split_of_two_links_of_a_station_is_told(tracking):
    """Three-way ranges 5 m off: a bias of the station is the mean of both, and its own mean hides it.

    Considered errors of clocks would explain it.
    """
    three_way = np.array([link.transmitter not in ("", link.receiver) for link in tracking.links])[
        tracking.link
    ]
    ranges = tracking.kind == list(MEASUREMENTS).index("range")
    off = replace(tracking, value_m=tracking.value_m + 5.0 * (three_way & ranges))
    biased = study(range_bias="all", consider_defaults=False)
    output = " ".join(str(radioloc.locate(biased, off)).split())
    assert re.search(
        r"ranges of KASHI, .* disagree by \d+\.\d sigmas: .*\[estimate\] range_bias_per",
        output,
    )
    for absorbed in ({"range_bias_per": "link"}, {"clock": "all"}):
        assert "disagree by" not in str(radioloc.locate(study(range_bias="all", **absorbed), off))


@pytest.mark.study
@pytest.mark.parametrize("passes", [60, 5])
def test_a_clock_error_is_named_whether_variance_components_settle_or_not(tracking, passes, monkeypatch):
    """50 ns of SESHAN25: the component of the delays grows for 23 fits before the station has its own."""
    monkeypatch.setattr(variance_components, "_MAX_ROUND_COUNT", passes)
    paths = np.array(tracking.paths())
    signs = 1.0 * np.char.endswith(paths, "<lander>SESHAN25") - np.char.startswith(paths, "SESHAN25<")
    solution = radioloc.locate(study(), replace(tracking, value_m=tracking.value_m + 50e-9 * C_M_S * signs))
    assert not solution.converged
    assert (solution.status is FitStatus.UNSETTLED) == (passes == 5)
    first = solution.consistency.findings[0]
    assert "SESHAN25" in first.name
    if passes == 60:
        assert (first.kind, first.name) == ("a priori", "clock.SESHAN25")


@pytest.mark.study
def test_reference_in_other_axes_than_stated_is_a_finding():
    study = radioloc.read_study("examples/apollo15/apollo15.toml")
    constants = PhysicalModel.build().ephemeris.constants
    principal = study.reference.position.to_axes("PA", constants)
    mistaken = replace(study.reference, position=replace(principal, frame=constants.me_frame))
    solution = radioloc.locate(replace(study, reference=mistaken))
    assert [item.name for item in solution.consistency.findings] == [
        f"the coordinates of the reference {study.reference.name} are in principal axes"
    ]
    assert solution.converged


OFF_THE_MOON = Doubt(FitStatus.OFF_THE_MOON, "a height of 4000 km")
MISFIT = Doubt(FitStatus.MISFIT, "residuals of 9 km")
MISTAKE = ConsistencyTest("mistake", "the values have the wrong sign", 1.0, 1, -9.0)


@pytest.mark.parametrize(
    ("doubts", "mistake", "sigma_m", "status"),
    [
        ([], None, 0.0, FitStatus.CONVERGED),
        ([], MISTAKE, 0.0, FitStatus.MISFIT),
        ([OFF_THE_MOON], MISTAKE, 0.0, FitStatus.OFF_THE_MOON),
        ([], None, 1e6, FitStatus.UNOBSERVABLE),
        ([OFF_THE_MOON], None, 1e6, FitStatus.UNOBSERVABLE),
        ([MISFIT], None, 1e6, FitStatus.MISFIT),
        ([], MISTAKE, 1e6, FitStatus.MISFIT),
    ],
)
def test_status_follows_from_all_reasons_at_once(doubts, mistake, sigma_m, status):
    assessed = toy_fit(ToyMoon(200, 72.0), ephemeris_sigma_enu_m=(sigma_m,) * 3)
    decided, message = decide_status(assessed, doubts, mistake)
    assert decided is status
    assert (MISFIT.reason in message) == (MISFIT in doubts)
    # With a sigma that large, a height is no further reason.
    assert (OFF_THE_MOON.reason in message) == (status is FitStatus.OFF_THE_MOON)
