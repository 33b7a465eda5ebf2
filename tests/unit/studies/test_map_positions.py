"""Places on maps beside tracking: one least squares, the tie of the map as a parameter, and what cannot be."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from delay_network import DelayNetwork
from recorded import recorded

import radioloc
from radioloc import LunarPosition, Observations
from radioloc.cli import main
from radioloc.ephemeris.constants import CONSTANTS
from radioloc.errors import InputError
from radioloc.estimation import ALONE, Labels, ObservationNoise, SharedErrors, fit_with_variance_components
from radioloc.estimation.combination import PositionEstimate, agreement
from radioloc.estimation.series import SeriesOrder
from radioloc.io.table import write_table
from radioloc.measurements.map_predictor import MapPosition, MapPredictor
from radioloc.parameters.choice import ParameterChoice
from radioloc.report.files import write_json, write_residuals
from radioloc.studies import EstimateChoice, ObservationChoice, PlaceOnMap, compare

EXAMPLE = Path(__file__).parents[3] / "examples" / "change5"
PLACE = (-51.9149, 43.0579, -2600.0)
RELATIVE_M2 = np.array([[9.0, 4.0], [4.0, 16.0]])
TIE_M = (25.0, 30.0)
SAME_M = (1e-3, 1e-3, 5e-3)
"""East, north, up: the joint estimate is linear, the fit is not: (70 m)^2 over the Moon's radius are 3 mm."""


@pytest.fixture(scope="module")
def ranges():
    return radioloc.read_observations(EXAMPLE / "short_arc.csv").select(slice(None, None, 5))


@pytest.fixture(scope="module")
def radio():
    study = radioloc.read_study(EXAMPLE / "short_arc.toml")
    return replace(study, consider_defaults=False, consider={}, simulation=None)


def solved(folder, place=PLACE, relative_m2=RELATIVE_M2, **more):
    """What is written of a solution of images without a height."""
    position = LunarPosition.from_selenographic(*place)
    total = np.full((3, 3), np.nan)
    total[:2, :2] = relative_m2 + np.diag(np.square(TIE_M))
    covariance = [[None if np.isnan(value) else value for value in row] for row in total]
    me = dict(zip(("longitude_deg", "latitude_deg", "height_m"), place, strict=True))
    xyz = zip(("x_m", "y_m", "z_m"), position.xyz_m.tolist(), strict=True)
    content = {
        "name": "images",
        "method": "images",
        "converged": True,
        "message": "",
        "position": {"pa": recorded()["position"]["pa"], "me": {"frame": position.frame, **me, **dict(xyz)}},
        "sigma": {"east_m": total[0, 0] ** 0.5, "north_m": total[1, 1] ** 0.5, "up_m": None},
        "covariance": {"enu_m2": covariance},
        "considered": [
            {
                "name": f"map_tie.some.map.{axis}",
                "sigma": sigma,
                "position_enu_m": (sigma * np.eye(3)[k]).tolist(),
            }
            for k, (axis, sigma) in enumerate(zip(("east", "north"), TIE_M, strict=True))
        ],
        "fit": {"used": 10, "rejected": 0},
        "reference": None,
        "provenance": {"study": None, "files": ["0001.png"]},
    } | more
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "solution.json"
    path.write_text(json.dumps(content))
    return path


def with_places(study, *places, **estimate):
    """A study with places on maps; nothing is considered but their ties."""
    return replace(
        study,
        observations=replace(study.observations, map_positions=places),
        estimate=EstimateChoice(range_bias="all", range_bias_sigma_m=10.0, **estimate),
        consider={"map_tie": ParameterChoice("none" if "map_tie" in estimate else "all")},
    )


def number(east_m=0.0, north_m=0.0, **more):
    """A place some metres off PLACE, in numbers."""
    longitude, latitude, height = PLACE
    radius_m = 1737400.0 + height
    return PlaceOnMap(
        longitude_deg=longitude + np.degrees(east_m / radius_m) / np.cos(np.radians(latitude)),
        latitude_deg=latitude + np.degrees(north_m / radius_m),
        height_m=height,
        **{"sigma_m": 3.0, "map": "some.map", "map_sigma_m": TIE_M} | more,
    )


def test_one_fit_gives_what_both_solutions_give_together(radio, ranges, tmp_path):
    of_radio = radioloc.locate(radio, ranges)
    longitude, latitude, height = of_radio.selenographic
    images = solved(tmp_path / "images", (longitude + 1e-3, latitude - 5e-4, height))
    alone = tmp_path / "radio.json"
    write_json(alone, of_radio.to_dict())
    apart = compare([alone, images]).joint
    joint = radioloc.locate(with_places(radio, PlaceOnMap(solution=images)), ranges)
    assert joint.converged
    assert joint.noise_scale == 1.0  # as of the ranges alone: the noise of both is the same
    moved_m = joint.rot_pa_to_enu @ (joint.position_pa_m - joint.rot_pa_to_me.T @ apart.position_me_m)
    assert (np.abs(moved_m) < SAME_M).all()
    covariance = joint.position_covariance("enu")
    assert np.sqrt(np.diag(covariance)) == pytest.approx(np.sqrt(np.diag(apart.covariance_enu_m2)), rel=2e-4)
    assert covariance[0, 1] == pytest.approx(apart.covariance_enu_m2[0, 1], rel=1e-3, abs=0.05)
    # It holds the images, so it is not tested against them.
    one, two = (PositionEstimate.from_solution(c) for c in (joint.to_dict(), json.loads(images.read_text())))
    assert agreement(one, two).why == "they share observations"
    rows = joint.residuals
    assert rows.type[-2:].tolist() == ["map_east", "map_north"]
    assert rows.sigma_m[-2:] == pytest.approx([3.0, 4.0])
    assert np.isnan(rows.elevation_deg[-2:]).all()


@pytest.mark.study
def test_a_tie_that_is_considered_is_as_one_that_is_estimated(radio, ranges):
    # The same estimate, as weights allow for the tie; told apart where it is small beside the place's own error, too.
    for sigma_m in (0.3, 3.0, 200.0):
        place = number(60.0, -40.0, sigma_m=sigma_m)
        considered = radioloc.locate(with_places(radio, place), ranges)
        estimated = radioloc.locate(with_places(radio, place, map_tie="all", map_tie_sigma_m=TIE_M), ranges)
        assert considered.position_pa_m == pytest.approx(estimated.position_pa_m, abs=2e-3)
        covariances = [one.position_covariance("enu") for one in (considered, estimated)]
        assert covariances[0] == pytest.approx(covariances[1], rel=1e-4)
        assert considered.converged
        assert {item.source: item for item in considered.budget}["map_tie"].name == "some.map"


def test_errors_that_delays_share_are_found_beside_a_place_of_which_east_and_north_are_correlated():
    network, rng = DelayNetwork.make(epochs=60, ranges=2, own_m=0.4, seed=3), np.random.default_rng(5)
    epochs, place = network.epoch[:-2], [-2, -1]
    of_stations_m = 0.3 * rng.normal(size=(60, 4))
    observed_m = np.append(
        of_stations_m[epochs, network.second[:-2]] - of_stations_m[epochs, network.first[:-2]], [0.0, 0.0]
    )
    observed_m += 0.3 * rng.normal(size=len(observed_m))
    count = len(observed_m)
    group, effect_m = np.full(count, ALONE), np.zeros((count, 2))
    group[place], effect_m[place, 1] = 0, 0.2
    shared = SharedErrors(group, np.zeros((count, 2), dtype=np.intp), effect_m)
    names = [f"{a}<x>{b}" for a, b in zip(network.first[:-2], network.second[:-2], strict=True)] + [
        "x@map"
    ] * 2
    types = Labels.of(["vlbi_delay"] * (count - 2) + ["map_east", "map_north"])
    order = SeriesOrder.of(types, Labels.of(names), np.append(600.0 * epochs, [0.0, 0.0]))
    found = fit_with_variance_components(
        network.residual_function(observed_m),
        network.parameters(),
        ObservationNoise(np.full(count, 0.3), shared),
        order=order,
    )
    assert found.shared_sigma_m == {f"vlbi_delay of {k}": pytest.approx(0.3, rel=0.25) for k in range(4)}
    kept = found.fit.noise.shared
    assert kept.group[-2] == kept.group[-1] not in kept.group[:-2]
    assert (kept.effect_m[place] == effect_m[place]).all()


def test_with_independent_weights_ties_are_estimated(radio, ranges):
    estimate = EstimateChoice(range_bias="all", range_bias_sigma_m=10.0, weights="independent")
    observations = replace(radio.observations, map_positions=[number()])
    study = replace(radio, observations=observations, estimate=estimate, consider_defaults=True)
    assert radioloc.locate(study, ranges).parameters["map_tie.some.map.north"].prior_sigma == TIE_M[1]


@pytest.mark.study
def test_a_tie_moves_the_position_as_its_sensitivity_says(radio, ranges):
    def fitted(*off_m):
        return radioloc.locate(with_places(radio, number(*off_m)), ranges)

    records = {item["name"]: item["position_enu_m"] for item in fitted().to_dict()["considered"]}
    for k, axis in enumerate(("east", "north")):
        off_m = TIE_M[k] * np.eye(2)[k]
        one, two = fitted(*off_m), fitted(*-off_m)
        moved_m = 0.5 * one.rot_pa_to_enu @ (one.position_pa_m - two.position_pa_m)
        assert moved_m == pytest.approx(records[f"map_tie.some.map.{axis}"], rel=1e-3, abs=0.01)


@pytest.mark.slow
def test_ellipses_hold_the_truth_where_map_and_ranges_are_drawn(radio, ranges):
    draws, inside, squares = 100, 0, []
    rng = np.random.default_rng(20131214)
    arc, _ = radioloc.studies.arc_of(radio, ranges)
    truth = LunarPosition.from_selenographic(*PLACE).to_axes("PA", CONSTANTS["DE421"])
    computed_m = arc.compute(truth.xyz_m).value_m
    for _ in range(draws):
        biases_m = 10.0 * rng.standard_normal(2)[arc.receivers]
        measured = replace(ranges, value_m=computed_m + biases_m + rng.standard_normal(len(ranges)))
        off_m = 3.0 * rng.standard_normal(2) + TIE_M * rng.standard_normal(2)
        solution = radioloc.locate(with_places(radio, number(*off_m)), measured)
        assert solution.converged
        error_m = (solution.rot_pa_to_enu @ (solution.position_pa_m - truth.xyz_m))[:2]
        squares.append(error_m @ np.linalg.solve(solution.position_covariance("enu")[:2, :2], error_m))
        inside += squares[-1] < 5.991  # 95 % of chi-square of two
    # 99.9 % of right ones: binomial, and chi-square of 200 over 100
    assert inside >= 87
    assert 1.40 < np.mean(squares) < 2.73


def test_what_is_known_of_another_place_on_the_map_tells_its_tie(radio, ranges):
    reflector = number(40.0, -20.0, target="reflector", known_deg_m=PLACE, sigma_m=0.1)
    solution = radioloc.locate(with_places(radio, number(40.0, -20.0), reflector, map_tie="all"), ranges)
    found = dict(zip(solution.parameters.names, solution.values, strict=True))
    sigmas = dict(zip(solution.parameters.names, solution.sigmas(), strict=True))
    assert found["map_tie.some.map.east"] == pytest.approx(40.0, abs=0.05)
    assert found["map_tie.some.map.north"] == pytest.approx(-20.0, abs=0.05)
    assert sigmas["map_tie.some.map.east"] == pytest.approx(0.1, rel=1e-2)
    # The lander is where the map, less its tie, has it, to the 3 m of its own place.
    place = LunarPosition.from_selenographic(*PLACE)
    assert (
        np.linalg.norm(np.cross(place.xyz_m, solution.rot_pa_to_me @ solution.position_pa_m)) / 1.7348e6 < 3.0
    )


def test_images_on_one_map_share_its_tie(radio, ranges):
    def sigma_m(*places):
        return radioloc.locate(with_places(radio, *places), ranges).position_covariance("enu")[0, 0] ** 0.5

    one, two = sigma_m(number()), sigma_m(number(), number(1.0))
    other = sigma_m(number(), number(1.0, map="another.map"))
    assert other < 0.85 * one  # nearly by the root of two: two maps
    assert one > two > 0.97 * one


def test_a_place_is_that_of_its_target(radio, ranges):
    both = Observations.concatenate(
        [
            replace(ranges, links=tuple(replace(link, target=name) for link in ranges.links))
            for name in ("lander", "rover")
        ]
    )
    study = with_places(radio, number(target="rover"))
    study = replace(
        study, target=None, reference=None, targets=dict.fromkeys(("lander", "rover"), radio.target)
    )
    lander, rover = radioloc.locate(study, both).targets
    place = LunarPosition.from_selenographic(*PLACE).to_axes("PA", CONSTANTS["DE421"])
    apart_m = [np.linalg.norm(np.cross(place.xyz_m, one.position_pa_m)) / 1.7348e6 for one in (lander, rover)]
    assert apart_m[1] < 10.0 < 25.0 < apart_m[0]
    # Of one target that is chosen from the files no name is needed.
    one = with_places(radio, number())
    one = replace(one, observations=replace(one.observations, targets=("rover",)))
    assert radioloc.locate(one, both).residuals.path[-1] == "rover@some.map"


def test_of_a_trajectory_there_is_no_place(radio):
    orbiter = radioloc.read_study(EXAMPLE.parent / "orbiter" / "orbiter.toml")
    with pytest.raises(
        InputError, match=r"\[\[observations.map_positions\]\] belongs to a position on the Moon"
    ):
        replace(orbiter, observations=replace(orbiter.observations, map_positions=[number()]))


def test_partials_are_central_differences(radio, ranges):
    arc, position_pa_m = radioloc.studies.arc_of(radio, ranges)
    far = LunarPosition.from_selenographic(-50.0, 44.0, 500.0)
    places = MapPredictor(arc, [MapPosition("", "a.map", far, np.eye(2), (25.0, 25.0))])
    computed = places.at(position_pa_m)
    for k in range(3):
        step_m = 10.0 * np.eye(3)[k]
        rise = places.at(position_pa_m + step_m).value_m - places.at(position_pa_m - step_m).value_m
        assert computed.by_position_pa[:, k] == pytest.approx(rise / 20.0, abs=1e-9)
    # From the haversine of both places, on a sphere through the one on the map.
    (lon0, lat0, _), (lon1, lat1, _) = (
        far.selenographic,
        LunarPosition("PA_DE421", position_pa_m).to_axes("ME", arc.model.ephemeris.constants).selenographic,
    )
    lon0, lat0, lon1, lat1 = np.radians([lon0, lat0, lon1, lat1])
    haversine = np.sin((lat1 - lat0) / 2) ** 2 + np.cos(lat0) * np.cos(lat1) * np.sin((lon1 - lon0) / 2) ** 2
    east, north = computed.value_m / 1737900.0
    assert np.arccos(np.cos(east) * np.cos(north)) == pytest.approx(
        2.0 * np.arcsin(np.sqrt(haversine)), rel=1e-9
    )


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


def test_every_observation_is_accounted_for(file, tmp_path):
    solution = radioloc.locate(radioloc.read_study(file()))
    table = tmp_path / "residuals.csv"
    write_residuals(table, solution.residuals)
    with table.open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == solution.fit.total.used == 25 + 2
    assert [(row["type"], row["path"], row["sigma_m"], row["elevation_deg"]) for row in rows[-2:]] == [
        ("map_east", "lander@some.map", "3.000000", ""),
        ("map_north", "lander@some.map", "4.000000", ""),
    ]
    assert "map_tie of some.map" in " ".join(str(solution).split())
    # Without series that are correlated the covariance is known before the values are.
    planned = radioloc.covariance(radioloc.read_study(file()), 1.0).arcs[-1].sigma_m
    assert planned == pytest.approx(np.sqrt(np.diag(solution.position_covariance("enu"))), rel=1e-3)


@pytest.mark.slow
def test_every_command_takes_the_places(file, tmp_path):
    path, out = file(), tmp_path / "out"
    assert main(["locate", str(path), "--out", str(out), "--terms"]) == 0
    assert main(["verify", str(out / "solution.json")]) == 0
    for command in ("residuals", "covariance", "arcs"):
        assert main([command, str(path), *(["--hours", "1"] if command == "arcs" else [])]) == 0


@pytest.mark.parametrize(
    ("place", "problem"),
    [
        ('solution = "none.json"', "none.json' matches no file"),
        (
            'solution = "ranges.csv"',
            "ranges.csv: is no solution.json that this version of radioloc images wrote",
        ),
        (NUMBERS + '\nsolution = "ranges.csv"', "longitude_deg is in the solution already"),
        ("longitude_deg = 1.0", "map is missing; give it, or the solution of images"),
        (NUMBERS.replace("25.0", "-1.0"), "map_sigma_m must be above zero"),
        (NUMBERS.replace("some.map", "a>b"), "'a>b' cannot name a station or a target"),
        (NUMBERS.replace("43.0579", "143.0"), "latitude_deg = 143.0 is not between"),
        (
            NUMBERS + '\ntarget = "rover"',
            "what is seen on some.map must be tracked (lander), or its place known",
        ),
        (
            f"{NUMBERS}\n[[observations.map_positions]]\n{NUMBERS.replace('25.0', '30.0')}",
            "the map some.map has two sigmas of its tie",
        ),
    ],
)
def test_what_cannot_be_is_one_clear_error(file, place, problem, capsys):
    assert main(["locate", str(file(place))]) == 2
    assert problem in " ".join(capsys.readouterr().err.split())


def test_a_solution_among_the_files_of_tracking_is_told_where_it_belongs(tmp_path):
    with pytest.raises(
        InputError, match=r"a solution of images belongs to \[\[observations.map_positions\]\]"
    ):
        radioloc.read_observations(solved(tmp_path))


def test_a_solution_that_did_not_converge_is_refused(tmp_path):
    path = solved(tmp_path, converged=False, message="the last image is unmatched")
    with pytest.raises(InputError, match="did not converge: the last image is unmatched"):
        PlaceOnMap(solution=path)


def test_tracking_is_drawn_but_no_places(radio, ranges):
    study = radioloc.read_study(EXAMPLE / "short_arc.toml")
    study = replace(study, observations=ObservationChoice(map_positions=[number()]))
    with pytest.raises(InputError, match="draws tracking, but no places on maps"):
        radioloc.monte_carlo(study, hours=[1.0], trials=2)
    found = radioloc.covariance(study, 1.0)
    assert found.arcs[-1].sigma_m[0] < 30.0  # 72 m without the map


def test_a_place_is_no_row_of_a_table(tmp_path, radio):
    table = tmp_path / "table.csv"
    table.write_text(
        "epoch_utc,type,path,observed_m,sigma_m,time_tag\n2020-12-01T15:11:00,map_east,lander@a.map,0.0,3.0,transmit\n"
    )
    observations = radioloc.read_observations(table)
    with pytest.raises(
        InputError, match=r"table.csv, line 2: a place on a map is no tracking; give it as \[\[obs"
    ):
        radioloc.locate(radio, observations)
