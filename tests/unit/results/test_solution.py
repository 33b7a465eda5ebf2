import json
from dataclasses import replace

import numpy as np
import pytest
from lunar_partials import cartesian_partials
from toy_moon import LANDER_M, ToyMoon, toy_solution

from radioloc.estimation import Parameter, ParameterSet
from radioloc.estimation.editing import fit_with_editing
from radioloc.estimation.time_correlation import scaled_covariance
from radioloc.parameters.parameter import Role

# A rotation of the size of the one from principal to mean-Earth axes, about an arbitrary axis.
SMALL_ROTATION = np.array([[1.0, -3e-4, 4e-4], [3e-4, 1.0, 1e-5], [-4e-4, -1e-5, 1.0]])


@pytest.fixture(scope="module")
def solution():
    solution = toy_solution(
        ToyMoon(200, 72.0),
        blunders_m={17: 19.0, 60: -1e5},
        reference_pa_m=LANDER_M,
        reference_name="truth",
        ephemeris_sigma_enu_m=(0.2, 0.3, 0.1),
    )
    return replace(solution, provenance={"kernel": "none"})


def rotation():
    q, r = np.linalg.qr(SMALL_ROTATION)
    return q * np.sign(np.diag(r))


def test_levels_of_sigma_add_up(solution):
    formal, scaled, total = (solution.sigma_enu_m(level) for level in ("formal", "scaled", "total"))
    np.testing.assert_allclose(scaled, formal)  # the noise is as stated
    np.testing.assert_allclose(total**2, scaled**2 + np.array([0.2, 0.3, 0.1]) ** 2)


def test_covariance_in_all_axes_is_the_same_ellipsoid():
    solution = toy_solution(
        ToyMoon(200, 72.0), rot_pa_to_me=rotation(), ephemeris_sigma_enu_m=(0.2, 0.3, 0.1)
    )
    eigenvalues = [np.linalg.eigvalsh(solution.position_covariance(axes)) for axes in ("enu", "pa", "me")]
    np.testing.assert_allclose(eigenvalues[1], eigenvalues[0], rtol=1e-9)
    np.testing.assert_allclose(eigenvalues[2], eigenvalues[0], rtol=1e-9)
    np.testing.assert_allclose(
        solution.position_covariance("me"),
        rotation() @ solution.position_covariance("pa") @ rotation().T,
        rtol=1e-9,
        atol=1e-9,
    )
    np.testing.assert_allclose(
        solution.position_covariance("pa", "formal"), solution.formal_covariance[:3, :3], rtol=1e-9, atol=1e-9
    )
    longitude_deg, latitude_deg, height_m = solution.selenographic
    partials = cartesian_partials(np.radians(longitude_deg), np.radians(latitude_deg), height_m)
    np.testing.assert_allclose(
        partials @ solution.position_covariance("geographic") @ partials.T,
        solution.position_covariance("me"),
        rtol=1e-8,
        atol=1e-8,
    )


def test_scaling_only_when_significant():
    as_stated = toy_solution(ToyMoon(200, 72.0))
    assert as_stated.noise_scale == 1.0
    worse = toy_solution(ToyMoon(200, 72.0), noise_factor=4.0)
    assert worse.noise_scale == pytest.approx(4.0, rel=0.15)
    np.testing.assert_allclose(worse.sigma_enu_m(), worse.noise_scale * worse.sigma_enu_m("formal"))


def test_scaling_leaves_a_priori_values_alone():
    # A bias known a priori to 1 m and hardly from the data stays known to 1 m however noisy those are.
    solution = toy_solution(ToyMoon(200, 12.0), noise_factor=4.0, bias_sigma_m=1.0)
    for _, sigma_m in solution.biases().values():
        assert sigma_m < 1.3
    design = np.random.default_rng(0).normal(size=(30, 3))
    parameters = ParameterSet([Parameter(name, "m", "p", prior_sigma=2.0) for name in "abc"])
    fit = fit_with_editing(lambda x: (-design @ x, design), parameters, 0.5).fit
    information = design.T @ design / 0.5**2
    inverse = np.linalg.inv(information + np.eye(3) / 4.0)
    expected = inverse @ (9.0 * information + np.eye(3) / 4.0) @ inverse
    np.testing.assert_allclose(scaled_covariance(fit, 3.0), expected, rtol=1e-9, atol=1e-12)


def test_reference_comparison(solution):
    reference = solution.reference
    difference_m = solution.position_pa_m - LANDER_M
    assert reference.distance_m == pytest.approx(np.linalg.norm(difference_m))
    covariance = solution.position_covariance("pa")
    expected = np.sqrt(difference_m @ np.linalg.solve(covariance, difference_m))
    assert reference.combined_sigmas == pytest.approx(expected, rel=1e-6)
    assert reference.east_sigmas == pytest.approx(reference.east_m / solution.sigma_enu_m()[0])
    assert reference.combined_sigmas < 4.0


def test_ellipse_axes_and_azimuth():
    solution = toy_solution(ToyMoon(200, 72.0))
    ellipse = solution.ellipse(0.95)
    azimuth = np.radians(ellipse.azimuth_deg)
    along = np.array([np.sin(azimuth), np.cos(azimuth)])
    covariance = solution.position_covariance("enu")[:2, :2]
    factor = 5.991464547107979  # 95 % of chi-square with two degrees of freedom
    assert ellipse.semi_major_m**2 == pytest.approx(factor * along @ covariance @ along)
    assert ellipse.semi_minor_m <= ellipse.semi_major_m
    assert 0.0 <= ellipse.azimuth_deg <= 180.0


def test_dictionary_has_the_promised_fields_and_is_json(solution):
    content = solution.to_dict()
    json.dumps(content, allow_nan=False)
    assert content["converged"] is True
    assert set(content["position"]["pa"]) == {"frame", "x_m", "y_m", "z_m"}
    assert {"frame", "longitude_deg", "latitude_deg", "height_m"} <= set(content["position"]["me"])
    assert {"east_m", "north_m", "up_m"} <= set(content["sigma"])
    assert content["sigma"]["east_m"] == pytest.approx(solution.sigma_enu_m("total")[0])
    assert set(content["biases"]) == {"A", "B", "C"}
    assert set(content["biases"]["A"]) == {"value_m", "sigma_m"}
    assert {"used", "rejected", "wrms_m", "chi2_per_dof", "by_station"} <= set(content["fit"])
    assert content["fit"]["used"] == 198
    assert content["fit"]["rejected"] == 2
    assert sum(group["rejected"] for group in content["fit"]["by_station"].values()) == 2
    assert content["provenance"] == {"kernel": "none"}
    assert [(row["reason"], row["count"]) for row in content["rejected"]] == [("outlier", 1), ("outlier", 1)]
    assert min(row["largest"][0]["residual_m"] for row in content["rejected"]) == pytest.approx(
        -1e5, rel=1e-3
    )
    assert content["reference"]["name"] == "truth"


def test_undetermined_bias_leaves_the_position_known():
    model = ToyMoon(100, 72.0, biases=False)
    model.biased = ("D",)  # of which there is no observation
    solution = toy_solution(model, sigma_m=0.01, reference_pa_m=LANDER_M)
    assert not solution.converged
    assert solution.status.startswith("not observable")
    assert np.isfinite(solution.sigma_enu_m()).all()
    content = solution.to_dict()
    json.dumps(content, allow_nan=False)
    assert content["biases"]["D"]["sigma_m"] is None
    assert "the data do not determine range_bias.D" in content["observability"]["text"]


def test_undetermined_position_has_no_numbers():
    # One observation for three coordinates.
    solution = toy_solution(ToyMoon(1, 1.0, ("A",), biases=False), reference_pa_m=LANDER_M)
    assert not solution.converged
    assert np.isinf(solution.sigma_enu_m()).all()
    content = solution.to_dict()
    json.dumps(content, allow_nan=False)
    assert content["sigma"]["east_m"] is None
    assert content["reference"]["combined_sigmas"] is None
    assert solution.ellipse() is None
    assert solution.budget == ()


def with_held_position(model, **given):
    parameters = model.parameters()
    for axis in "xyz":
        parameters = parameters.changed(f"position.{axis}_m", role=Role.FIXED)
    solution = toy_solution(model, parameters=parameters, **given)
    assert solution.converged
    assert not solution.position_estimated
    np.testing.assert_array_equal(solution.sigma_enu_m(), 0.0)
    return solution


def test_held_position():
    solution = with_held_position(ToyMoon(60, 72.0))
    assert solution.biases()["A"][1] == pytest.approx(0.3 / 20**0.5, rel=0.05)


def test_paths_of_a_station_are_told_apart():
    """Two-way ranges 3 m long and three-way ranges 3 m short have no mean at the station that receives both."""
    paths = np.array(["A>x>A", "B>x>A"] * 100)
    shifts = {k: 3.0 if path == "A>x>A" else -3.0 for k, path in enumerate(paths)}
    solution = toy_solution(
        ToyMoon(200, 72.0, ("A",), biases=False), path=paths, blunders_m=shifts, noise_factor=1.0, sigma_m=3.0
    )
    assert abs(solution.fit.by_station[0].mean_m) < 0.5
    by_path = solution.to_dict()["fit"]["by_path"]
    assert list(by_path) == ["range A>x>A", "range B>x>A"]
    for path, mean_m in (("range A>x>A", 3.0), ("range B>x>A", -3.0)):
        rows = (solution.residuals.path == path.split()[1]) & solution.residuals.used
        assert by_path[path]["mean_m"] == pytest.approx(solution.residuals.residual_m[rows].mean())
        assert by_path[path]["mean_m"] == pytest.approx(mean_m, abs=1.0)
