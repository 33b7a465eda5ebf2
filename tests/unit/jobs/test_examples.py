"""Examples of tracking: their files are what their scripts and studies make, and their studies find what was put in."""

import runpy
import shutil
from dataclasses import replace
from types import SimpleNamespace

import dsn_pass
import numpy as np
import pytest
from ldem import write_ldem_4
from odf_files import taken_apart
from paths import EXAMPLES

import radioloc
from radioloc import cli
from radioloc.constants import C_M_S
from radioloc.jobs.locate import fit_arc
from radioloc.jobs.preparation import prepared_arc

# Revised Earth orientation would move the stations by some centimetres, and turn them by as much in a day.
REVISED_M, REVISED_HZ = 0.1, 1e-3
# Sines of one machine and another.
LAST_DIGIT_M, LAST_DIGIT_KM = 1e-3, 1e-9
# Three decimals in the files of the beacon.
ROUNDED_HZ = 2e-3
# Sigmas in metres follow the nominal frequency, by 1.8e-4.
WEIGHTS_M = 1.0
LIKELY_SIGMAS = 5.1  # 1e-5 of chance in three coordinates


def script_of(name):
    return SimpleNamespace(**runpy.run_path(EXAMPLES / name / "simulate.py"))


def assert_same(simulated, shipped, tolerance_m):
    assert (simulated.paths() == shipped.paths()).all()
    assert np.array_equal(simulated.epoch.mjd, shipped.epoch.mjd)
    assert np.abs(simulated.value_m - shipped.value_m).max() < tolerance_m


@pytest.mark.slow
def test_files_of_change5_and_of_the_descent_are_what_is_simulated(tmp_path):
    script = script_of("change5")
    script.main.__globals__["FILE"] = tmp_path / "change5.csv"
    script.main(check=False)
    # A change of the model by a millimetre needs a new file.
    assert_same(*map(radioloc.read_observations, (tmp_path / "change5.csv", script.FILE)), LAST_DIGIT_M)
    head = script.FILE.read_text(encoding="utf-8").partition("epoch_utc")[0]
    assert (tmp_path / "change5.csv").read_text(encoding="utf-8").startswith(head)
    assert "SIMULATED" in head
    simulated = radioloc.simulate(EXAMPLES / "descent" / "descent.toml").observations
    assert_same(simulated, radioloc.read_observations(EXAMPLES / "descent" / "tracking.csv"), REVISED_M)


@pytest.mark.slow
def test_place_of_the_landing_is_found():
    solution = radioloc.locate(EXAMPLES / "descent" / "descent.toml")
    assert solution.converged
    assert solution.reference.combined_sigmas < 2.8  # 95 % of three
    assert solution.reference.distance_m < 15.0
    assert solution.ellipse().semi_major_m < 10.0
    assert solution.state.sigma_rtn_m(solution.state.epoch).max() < 5.0


@pytest.mark.parametrize(
    ("study", "sigma_m"), [("short_arc", (107.0, 113.0)), ("short_arc_dem", (0.0, 50.0))]
)
def test_an_hour_of_ranges(study, sigma_m):
    solution = radioloc.locate(EXAMPLES / "change5" / f"{study}.toml")
    assert solution.converged
    assert sigma_m[0] < np.hypot(*solution.sigma_enu_m()[:2]) < sigma_m[1]
    assert solution.reference.combined_sigmas < LIKELY_SIGMAS


def test_ranges_of_the_short_arc_are_what_the_study_makes(tmp_path):
    study = EXAMPLES / "change5" / "short_arc.toml"
    assert cli.main(["simulate", str(study), "--out", str(tmp_path / "new.csv")]) == 0
    simulated, shipped = map(radioloc.read_observations, (tmp_path / "new.csv", study.with_suffix(".csv")))
    assert_same(simulated, shipped, LAST_DIGIT_M)


def test_map_is_an_excerpt(tmp_path):
    """Cells of the map are the whole map's own."""
    from radioloc.lunar import TerrainModel

    part = TerrainModel.open(EXAMPLES / "change5" / "ldem_4_landing_site.tif")
    assert float(part.height_m(*np.radians([-51.9162, 43.0584]))) == pytest.approx(-2547.1, abs=0.1)
    places = np.radians(np.random.default_rng(1).uniform((-55, 40), (-49, 46), (100, 2))).T
    complete = TerrainModel.open(write_ldem_4(tmp_path))
    np.testing.assert_allclose(part.height_m(*places), complete.height_m(*places), atol=1e-3)


def test_files_of_the_orbiter_are_what_the_script_makes_and_its_bias_is_found(tmp_path):
    script, folder = script_of("orbiter"), EXAMPLES / "orbiter"
    script.main(tmp_path)
    simulated, shipped = (radioloc.read_observations(path / "tracking.csv") for path in (tmp_path, folder))
    assert_same(simulated, shipped, REVISED_M)
    source = radioloc.ephemeris.Trajectory.open(folder / "orbiter.bsp", script.BODY)
    et_s = np.arange(script.FIRST_S, script.LAST_S, 7.0 * script.STEP_S)
    states = source.states(et_s, source.segment_indices(et_s))
    assert np.abs(states - script.states_km(et_s)).max() < LAST_DIGIT_KM
    solution = radioloc.locate(folder / "orbiter.toml")
    value_m, sigma_m = solution.biases()["JIAMUSI"]
    assert solution.converged
    assert abs(value_m - script.BIAS_M) < 3.0 * sigma_m
    assert sigma_m < 0.1
    assert solution.residuals.used.sum() == 140


def test_file_of_the_deep_space_network_is_what_the_script_makes(tmp_path):
    dsn_pass.main(tmp_path)
    folders = (tmp_path, EXAMPLES / "dsn")
    simulated, shipped = (taken_apart((folder / "lander.odf").read_bytes()) for folder in folders)
    assert simulated[1] == shipped[1]
    for items in zip(simulated[0], shipped[0], strict=True):
        values = []
        for item in items:
            parts = [item.pop(name) for name in ("observable", "observable_1e9")]
            values.append(np.dot([1.0, 1e-9], [part - 2**32 * (part >= 2**31) for part in parts]))
        assert items[0] == items[1]
        assert abs(np.subtract(*values)) < (REVISED_HZ if items[0]["type"] != 37 else 1.0)


def test_lander_tracked_by_the_deep_space_network_is_found():
    study = radioloc.read_study(EXAMPLES / "dsn" / "lander.toml")
    arc, left_out = prepared_arc(study)
    assert left_out == {"left over from averages of Doppler over 60 s": 6}
    solution = fit_arc(study, arc, left_out)
    assert solution.converged
    content = solution.to_dict()
    assert content["reference"]["combined_sigmas"] < 3.0
    assert content["reference"]["distance_m"] < 10.0
    [frequency] = [item for item in content["parameters"] if item["name"].startswith("target_frequency")]
    assert frequency["value"] == pytest.approx(dsn_pass.OSCILLATOR, abs=4.0 * frequency["sigma"])
    # Sums of six counts of 10 s with 1.3 mHz of noise, by X band: 1.1 mm; ranges 2 m.
    residuals = solution.residuals
    for kind, rms_m in (("doppler", 1.13e-3), ("one_way_doppler", 1.13e-3), ("range", 2.0)):
        rows = residuals.type == kind
        assert residuals.used[rows].all()
        assert np.sqrt(np.mean(residuals.residual_m[rows] ** 2)) == pytest.approx(rms_m, rel=0.25)


@pytest.fixture(scope="module")
def script():
    return script_of("beacon")


@pytest.fixture(scope="module")
def solution():
    return radioloc.locate(EXAMPLES / "beacon" / "beacon.toml")


def test_files_of_the_beacon_are_what_the_script_makes(script, tmp_path):
    folder = EXAMPLES / "beacon"
    script.write(tmp_path)
    for name in ("sites.txt", "beacon.toml"):
        shutil.copy(folder / name, tmp_path)
    output = radioloc.read_study(folder / "beacon.toml").observations.frequencies
    tolerance_m = C_M_S * script.COUNT_S / script.BEACON_HZ * (ROUNDED_HZ + REVISED_HZ)
    for file in script.FILES.values():
        simulated, shipped = (
            radioloc.read_observations(path / file, frequencies=output) for path in (tmp_path, folder)
        )
        assert_same(simulated, shipped, tolerance_m)


@pytest.mark.study
def test_doppler_of_a_beacon_determines_tens_of_kilometres(solution):
    assert solution.converged
    assert solution.residuals.used.all()
    [station] = {path for path in solution.residuals.path.tolist() if path.endswith("9001")}
    assert station == "beacon>COSPAR 9001"
    result = solution.to_dict()
    assert result["reference"]["horizontal_m"] < 20e3
    assert 5e3 < result["sigma"]["east_m"] < 20e3
    assert 10e3 < result["sigma"]["north_m"] < 30e3


def test_the_frequency_of_the_beacon_and_the_noise_of_readings(solution, script):
    """One offset for each pass: that of the beacon, which wanders, less that of the receiver's standard."""
    result = [p for p in solution.to_dict()["parameters"] if p["name"].startswith("frequency_offset")]
    assert len(result) == 14
    offsets = np.array([p["value"] for p in result])
    expected = -script.BEACON_OFF_HZ / script.BEACON_HZ
    assert np.abs(offsets - expected).max() < 4.0 * script.RECEIVER
    residual_hz = script.BEACON_HZ * solution.residuals.residual_m / (C_M_S * script.COUNT_S)
    assert script.READING_HZ < np.std(residual_hz) < np.hypot(script.READING_HZ, script.WANDER_HZ)


def test_a_nominal_frequency_that_is_far_off_does_not_move_the_lander(solution):
    """The Doppler shift is that of the frequency that was sent, which the offset of each pass says."""
    study = radioloc.read_study(EXAMPLES / "beacon" / "beacon.toml")
    [sent] = study.observations.frequencies
    wrong = replace(sent, transmit_hz=sent.transmit_hz + 1.5e6)
    result = radioloc.locate(replace(study, observations=replace(study.observations, frequencies=[wrong])))
    assert result.converged
    assert np.linalg.norm(result.position_pa_m - solution.position_pa_m) < WEIGHTS_M
