"""Positions on maps as a-priori positions: their covariance, the tie that a map's positions share, and refusals."""

import json
from dataclasses import replace

import numpy as np
import pytest
from paths import EXAMPLES
from recorded import recorded

import radioloc
from radioloc import LunarPosition, Observations, compare
from radioloc.cli import main
from radioloc.ephemeris.constants import CONSTANTS
from radioloc.errors import InputError
from radioloc.estimation.combination import PositionEstimate, agreement
from radioloc.io.table import write_table
from radioloc.lunar.local import axes_at, displaced, local_difference
from radioloc.report.files import write_json
from radioloc.simulation.truth import Truth, TruthSigma
from radioloc.study import EstimateChoice, HeightPrior, PlaceOnMap
from radioloc.study.map_positions import position_priors
from radioloc.targets.position_prior import with_position_priors
from radioloc.targets.surface_point import on_sphere

EXAMPLE = EXAMPLES / "change5"
PLACE = (-51.9149, 43.0579, -2600.0)
RELATIVE_M2 = np.array([[9.0, 4.0, 2.0], [4.0, 16.0, -6.0], [2.0, -6.0, 121.0]])
TIE_M = (25.0, 30.0)
SLOPE = (0.12, -0.18)
"""Of the ground, which the height follows where the tie of the map is wrong."""
SAME_M = 1e-3
SAME_SIGMAS = 2e-4
"""Bounds of what a fit and the combination of two solutions differ: in position, m, and in parts of the sigmas."""


@pytest.fixture(scope="module")
def ranges():
    return radioloc.read_observations(EXAMPLE / "short_arc.csv").select(slice(None, None, 5))


@pytest.fixture(scope="module")
def radio():
    study = radioloc.read_study(EXAMPLE / "short_arc.toml")
    return replace(study, consider_defaults=False, consider={}, simulation=None)


def solved(folder, place=PLACE, relative_m2=RELATIVE_M2, **fields):
    """Write what ``radioloc images`` writes of a position, whose height may be undetermined (NaN)."""
    ties_m = np.diag(TIE_M) @ np.column_stack([np.eye(2), SLOPE])
    ties_m[:, 2] *= np.isfinite(relative_m2[2, 2])
    total = relative_m2 + ties_m.T @ ties_m
    content = recorded("images", place, np.sqrt(np.diag(total)), method="images") | {
        "covariance": {"enu_m2": [[None if np.isnan(v) else v for v in row] for row in total.tolist()]},
        "considered": [
            {
                "name": f"map_tie.some.map.{axis}",
                "unit": "m",
                "sigma": sigma,
                "position_enu_m": moved.tolist(),
            }
            for axis, sigma, moved in zip(("east", "north"), TIE_M, ties_m, strict=True)
        ],
        "provenance": {"study": None, "files": ["0001.png"]},
        **fields,
    }
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "solution.json"
    path.write_text(json.dumps(content))
    return path


def with_places(study, *places, **estimate):
    estimate = EstimateChoice(range_bias="all", range_bias_sigma_m=10.0, **estimate)
    return replace(study, observations=replace(study.observations, map_positions=places), estimate=estimate)


def number(east_m=0.0, north_m=0.0, **fields):
    """A position some metres off PLACE, in numbers."""
    longitude, latitude, height = PLACE
    radius_m = 1737400.0 + height
    return PlaceOnMap(
        longitude_deg=longitude + np.degrees(east_m / radius_m) / np.cos(np.radians(latitude)),
        latitude_deg=latitude + np.degrees(north_m / radius_m),
        height_m=height,
        **{"sigma_m": 3.0, "map": "some.map", "map_sigma_m": TIE_M} | fields,
    )


def assert_same(solution, joint):
    """Compare a fit with the combination of two solutions."""
    moved_m = local_difference(solution.position_me_m, joint.position_me_m).enu_m
    assert np.abs(moved_m).max() < SAME_M
    assert np.sqrt(np.diag(solution.position_covariance("enu"))) == pytest.approx(
        np.sqrt(np.diag(joint.covariance_enu_m2)), rel=SAME_SIGMAS
    )


def sigmas_m(study, ranges):
    return np.sqrt(np.diag(radioloc.locate(study, ranges).position_covariance("enu")))


@pytest.mark.parametrize("height", [True, False])
def test_fit_with_a_map_position_equals_the_combination_of_both_solutions(radio, ranges, tmp_path, height):
    relative_m2 = RELATIVE_M2.copy()
    if not height:
        relative_m2[2], relative_m2[:, 2] = np.nan, np.nan
    of_radio = radioloc.locate(radio, ranges)
    longitude, latitude, up = of_radio.selenographic
    images = solved(tmp_path / "images", (longitude + 1e-3, latitude - 5e-4, up + 40.0 * height), relative_m2)
    tracking_only = tmp_path / "radio.json"
    write_json(tracking_only, of_radio.to_dict())
    combined = compare([tracking_only, images]).joint
    joint = radioloc.locate(with_places(radio, PlaceOnMap(solution=images)), ranges)
    assert joint.converged
    assert_same(joint, combined)
    covariance = joint.position_covariance("enu")
    assert covariance == pytest.approx(combined.covariance_enu_m2, rel=1e-3, abs=0.05)
    if height:
        assert np.sqrt(covariance[2, 2]) < 11.0
    # It contains the images, so it is not tested against them; the tie is an error of both.
    of_fit, of_images = (
        PositionEstimate.from_solution(c) for c in (joint.to_dict(), json.loads(images.read_text()))
    )
    assert agreement(of_fit, of_images).why == "they share observations"
    assert set(of_images.errors_enu_m) <= set(of_fit.errors_enu_m)
    assert np.linalg.eigvalsh(of_fit.noise_enu_m2).min() > 0.0
    # The budget adds up, and names the map.
    assert sum(item.total_m**2 for item in joint.budget) == pytest.approx(np.trace(covariance))
    assert {item.source: item for item in joint.budget}["map_tie"].name == "some.map"


@pytest.mark.parametrize(
    "considered",
    [
        # Not in the weights of tracking, but in its covariance: here they are large.
        {"moon_position_sigma_m": [30.0, 30.0, 30.0]},
        # The default errors and those of the stations of the documented example.
        {"station_position_sigma_m": {"JIAMUSI": 0.1, "KASHI": 0.1}},
    ],
)
def test_considered_errors_weigh_against_the_map_as_in_the_combination(radio, ranges, tmp_path, considered):
    choices = radioloc.parameters.considered.considered_choices(considered)
    study = replace(radio, consider=choices, consider_defaults="station_position_sigma_m" in considered)
    of_radio = radioloc.locate(study, ranges)
    tracking_only = tmp_path / "radio.json"
    write_json(tracking_only, of_radio.to_dict())
    # As far off as in the documented example, where lines of sight and the verticals of both differ by 2.5e-5 rad.
    away_m = displaced(of_radio.position_me_m, np.array([-43.0, -5.0, 139.0]))
    images = solved(tmp_path / "images", LunarPosition.from_cartesian(away_m, "ME_DE421").selenographic)
    joint = radioloc.locate(with_places(study, PlaceOnMap(solution=images)), ranges)
    assert_same(joint, compare([tracking_only, images]).joint)
    assert (joint.sigma_enu_m()[:2] < np.hypot(TIE_M, np.sqrt(np.diag(RELATIVE_M2))[:2])).all()


def test_a_priori_positions_of_two_targets_on_one_map_have_their_covariance():
    constants, tie_m2 = CONSTANTS["DE421"], np.diag(np.square([*TIE_M, 0.0]))
    places = [number(target="a"), number(50.0, 80.0, sigma_up_m=9.0, target="b")]
    priors = position_priors(places, ["a", "b"])
    assert priors[0].cross_enu_m2["b"][:2, :2] == pytest.approx(tie_m2[:2, :2], rel=1e-6)
    starts = [prior.mean.to_axes("PA", constants).xyz_m for prior in priors]
    placed = with_position_priors([on_sphere(start, None) for start in starts], priors, constants)
    parameters = [item for items, *_ in placed for item in items]
    values = np.array([item.prior_value for item in parameters])
    assert placed[1][1](values)[0] == pytest.approx(starts[1], abs=1e-6)
    partials = np.zeros((2, 3, 6))
    for k, (_, function, _) in enumerate(placed):
        rotation = axes_at(priors[k].mean.xyz_m) @ radioloc.lunar.rot_pa_to_me(constants)
        partials[k, :, : 3 * k + 3] = rotation @ function(values[: 3 * k + 3])[1]
    partials = partials.reshape(6, 6)
    sigmas = np.array([item.prior_sigma for item in parameters])
    held = np.isfinite(sigmas)  # the height of the first is not determined
    covariance = (partials[:, held] * sigmas[held] ** 2) @ partials[:, held].T
    expected = np.kron(np.ones((2, 2)), tie_m2) + np.diag([9.0, 9.0, 0.0, 9.0, 9.0, 81.0])
    assert covariance == pytest.approx(expected, rel=1e-3, abs=0.05)  # their axes are 5e-5 rad apart
    # Displaced by the tie, both move alike.
    tie = np.array([item.prior_errors["map_tie.some.map.east"] for item in parameters])
    assert partials @ tie == pytest.approx([TIE_M[0], 0.0, 0.0] * 2, abs=0.01)


def test_positions_on_one_map_share_its_tie(radio, ranges):
    single = sigmas_m(with_places(radio, number()), ranges)
    double = sigmas_m(with_places(radio, number(), number(1.0)), ranges)
    two_maps = sigmas_m(with_places(radio, number(), number(1.0, map="another.map")), ranges)
    assert two_maps[0] < 0.85 * single[0]  # nearly by the root of two: two maps
    assert single[0] > double[0] > 0.97 * single[0]


def test_a_known_place_on_the_map_determines_its_tie(radio, ranges):
    reflector = number(40.0, -20.0, target="reflector", known_deg_m=PLACE, sigma_m=0.1)
    solution = radioloc.locate(with_places(radio, number(40.0, -20.0), reflector), ranges)
    away_m = local_difference(solution.position_me_m, LunarPosition.from_selenographic(*PLACE).xyz_m)
    assert away_m.horizontal_m < 6.0
    assert (solution.sigma_enu_m()[:2] < 3.1).all()


def test_a_map_position_is_that_of_its_target(radio, ranges):
    observations = Observations.concatenate(
        [
            replace(ranges, links=tuple(replace(link, target=name) for link in ranges.links))
            for name in ("lander", "rover")
        ]
    )
    study = replace(
        with_places(radio),
        target=None,
        reference=None,
        targets=dict.fromkeys(("lander", "rover"), radio.target),
    )
    place = number(target="rover")
    study = replace(study, observations=replace(study.observations, map_positions=[place]))
    solution = radioloc.locate(study, observations)
    sigmas = [solution.of_target(name).sigma_enu_m() for name in ("lander", "rover")]
    assert sigmas[1][0] < 30.0 < sigmas[0][0]
    # Both on one map: their difference has no part of its tie, and the rover's distance is as read on the map.
    lander = number(30.0, -40.0, target="lander")
    on_map = replace(study.observations, map_positions=[place, lander])
    solution = radioloc.locate(replace(study, observations=on_map), observations)
    solutions = [solution.of_target(name) for name in ("lander", "rover")]
    moved_m = local_difference(*(item.position_me_m for item in solutions))
    assert moved_m.enu_m[:2] == pytest.approx([30.0, -40.0], abs=5.0)
    first, second = (item.position_partials for item in solution.targets)
    difference = first - second
    rot = axes_at(solutions[0].position_pa_m) @ difference
    sigma_m = np.sqrt(np.diag(rot @ solution.parameter_covariance() @ rot.T))
    assert (sigma_m[:2] < 3.0 * np.sqrt(2.0)).all()
    assert all(item.sigma_enu_m()[0] > 10.0 for item in solutions)
    assert sum(item.total_m**2 for item in solutions[1].budget) == pytest.approx(
        np.trace(solutions[1].position_covariance("enu"))
    )
    # Of one target that is chosen from the files no name is needed.
    study = with_places(radio, number())
    study = replace(study, observations=replace(study.observations, targets=("rover",)))
    assert radioloc.locate(study, observations).sigma_enu_m()[0] == pytest.approx(sigmas[1][0], rel=0.05)


def test_an_a_priori_height_is_combined_with_that_of_the_map(radio, ranges):
    place = number(sigma_up_m=10.0)
    tracking_only = sigmas_m(with_places(radio, place), ranges)
    assert tracking_only[2] < 10.0
    prior = HeightPrior(PLACE[2] - 3.0, 10.0)
    assert sigmas_m(with_places(radio, place, height_prior=prior), ranges)[2] < 10.0 / np.sqrt(2.0)
    without_map_height = sigmas_m(with_places(radio, number(), height_prior=prior), ranges)
    assert without_map_height == pytest.approx(tracking_only, rel=0.02)


@pytest.mark.study
def test_map_positions_are_drawn_in_each_trial(tmp_path):
    study = radioloc.read_study(EXAMPLE / "short_arc.toml")
    study = replace(
        with_places(study, PlaceOnMap(solution=solved(tmp_path))), consider_defaults=False, consider={}
    )
    scenario = study.simulation
    scenario = replace(scenario, truth=Truth(), truth_sigma=TruthSigma(range_bias_m=10.0))
    [arc] = radioloc.monte_carlo(replace(study, simulation=scenario), hours=[1.0], trials=300).arcs
    planned = radioloc.covariance(study, 1.0).arcs[-1].sigma_m
    assert arc.sigma_m == pytest.approx(planned, rel=0.03)
    assert arc.rms_m == pytest.approx(planned, rel=0.12)  # three sigmas of the rms of 300


STUDY = """
[target]
longitude_deg = -51.9
latitude_deg = 43.05
height_m = -2500.0

[observations]
files = ["ranges.csv"]

[[observations.map_positions]]
{place}

[estimate]
range_bias = "all"
range_bias_sigma_m = 10.0

[model]
off = ["ionosphere"]
"""
NUMBERS = """longitude_deg = -51.9149
latitude_deg = 43.0579
sigma_m = [3.0, 4.0]
map = "some.map"
map_sigma_m = 25.0"""


@pytest.fixture
def file(tmp_path, ranges):
    write_table(tmp_path / "ranges.csv", ranges)

    def written(place=NUMBERS):
        path = tmp_path / "study.toml"
        path.write_text(STUDY.format(place=place))
        return path

    return written


@pytest.mark.parametrize(
    ("place", "problem"),
    [
        ('solution = "none.json"', "none.json' matches no file"),
        ('solution = "ranges.csv"', "ranges.csv, line 1: is neither a solution.json nor"),
        ("longitude_deg = 1.0", "map is missing; give it, or the solution of images"),
        (NUMBERS + "\nsigma_up_m = 3.0", "height_m is missing"),
        (
            f"{NUMBERS}\n[[observations.map_positions]]\n{NUMBERS.replace('25.0', '30.0')}",
            "the tie map_tie.some.map.east has two sigmas",
        ),
        (NUMBERS + '\n[estimate]\nposition = "cartesian"\n[x]', '[estimate] position = "geographic"'),
    ],
)
def test_an_impossible_map_position_is_one_clear_error(file, place, problem, capsys):
    path = file(place)
    if "cartesian" in place:
        path.write_text(
            STUDY.format(place=NUMBERS).replace("[estimate]", '[estimate]\nposition = "cartesian"')
        )
    assert main(["locate", str(path)]) == 2
    assert problem in " ".join(capsys.readouterr().err.split())


def test_a_trajectory_has_no_map_position(radio):
    orbiter = radioloc.read_study(EXAMPLE.parent / "orbiter" / "orbiter.toml")
    with pytest.raises(InputError, match=r"map_positions.*Moon"):
        replace(orbiter, observations=replace(orbiter.observations, map_positions=[number()]))


def test_a_solution_of_images_among_the_files_of_tracking_is_an_error(tmp_path):
    with pytest.raises(InputError, match=r"\[\[observations.map_positions\]\]"):
        radioloc.read_observations(solved(tmp_path))


def test_a_solution_that_did_not_converge_is_refused(tmp_path):
    path = solved(tmp_path, converged=False, message="the last image is unmatched")
    with pytest.raises(InputError, match="last image is unmatched"):
        PlaceOnMap(solution=path)
