"""Registries: entry points of other packages, entries registered at run time, and entries that fail."""

import csv
import json
import os
import re
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from arc_cases import observed_at
from paths import EXAMPLES, ROOT
from quick import some

import radioloc
from radioloc.cli import main
from radioloc.errors import InputError
from radioloc.io.formats import READERS
from radioloc.jobs.workers import open_workers
from radioloc.measurements import FixedPoint
from radioloc.media import MEDIA
from radioloc.parameters.registry import PARAMETERS
from radioloc.study import STUDY_TABLES, StudyTable

SHORT_ARC = EXAMPLES / "change5" / "short_arc.toml"
PACKAGE = ROOT / "tests" / "data" / "plugin_package"
LANDER = radioloc.LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
BIAS_M_RAD = {"KASHI": 2.5, "JIAMUSI": -1.25}
STUDY = """
[target]
longitude_deg = -51.9
latitude_deg = 43.05
height_m = -2500.0

[observations]
files = ["kashi.csv", "jiamusi.log"]

[estimate]
zenith_angle_bias = "all"
zenith_angle_bias_sigma_m_rad = 100.0

[consider]
defaults = false
"""
POSITION_M = 1e-3
"""What rounding of the table (0.1 mm) leaves of a position from 48 hours."""
BIAS_TOLERANCE_M_RAD = 1e-3
RADOME_M = 0.004


def installed(folder: Path, entry_points: dict[str, dict[str, str]]) -> Path:
    """Write the metadata of an installed package for importlib.metadata: its entry points."""
    info = folder / "radioloc_toys-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: radioloc-toys\nVersion: 1.0\n")
    groups = [
        f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, value in points.items())
        for group, points in entry_points.items()
    ]
    (info / "entry_points.txt").write_text("\n".join(groups))
    return folder


def python(site: Path, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    path = [str(ROOT / "src"), str(PACKAGE), str(site)]
    return subprocess.run(
        [sys.executable, *arguments],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(path)},
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.fixture
def toys(tmp_path):
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]
    return installed(tmp_path / "site", project["entry-points"])


def write_half_ranges(folder: Path) -> None:
    """Half of the round trips that the model gives, with the bias and the delay by the radome in them.

    Those of one station are a table, those of the other a file of the format that the package adds.
    """
    epochs = [f"2020-12-{1 + hour // 24:02d}T{hour % 24:02d}:30:00" for hour in range(12, 60)]
    stations = ["KASHI", "JIAMUSI"]
    plan = observed_at(
        [epoch for epoch in epochs for _ in stations],
        [radioloc.measurements.Link(name, "lander", name) for name in stations],
        value_m=7.6e8,
        link=np.tile([0, 1], len(epochs)),
    )
    model = radioloc.measurements.PhysicalModel.build()
    lander_pa_m = LANDER.to_axes("PA", model.ephemeris.constants).xyz_m
    computed = radioloc.measurements.ExactPredictor(model, plan, FixedPoint(lander_pa_m)).compute()
    lines = {
        "KASHI": ["epoch_utc,time_tag,type,path,observed_m,sigma_m"],
        "JIAMUSI": ["HALF RANGES OF JIAMUSI"],
    }
    for row in np.flatnonzero(computed.usable):
        name = plan.links[plan.link[row]].receiver
        zenith_angle_rad = 0.5 * np.pi - computed.elevation_rad[row, 1]
        added_m = BIAS_M_RAD[name] * zenith_angle_rad + (2.0 * RADOME_M if name == "KASHI" else 0.0)
        half_m = 0.5 * (computed.value_m[row] + added_m)
        epoch = radioloc.time.utc_strings(plan.epoch[[row]], decimals=3)[0]
        if name == "KASHI":
            lines[name].append(f"{epoch},receive,half_range,{name}>lander>{name},{half_m:.4f},0.5")
        else:
            lines[name].append(f"{epoch} {half_m:.4f} 0.5")
    (folder / "kashi.csv").write_text("\n".join(lines["KASHI"]) + "\n")
    (folder / "jiamusi.log").write_text("\n".join(lines["JIAMUSI"]) + "\n")


REGISTRATION = """
import radioloc
from radioloc_toys import half_range, half_range_log, wet_radome, zenith_angle_bias
for entry in (half_range.HALF_RANGE, zenith_angle_bias.ZENITH_ANGLE_BIAS, wet_radome.WET_RADOME):
    radioloc.register(entry)
radioloc.register(half_range_log.HALF_RANGE_LOG)
"""


@pytest.mark.study
@pytest.mark.parametrize("at_run_time", [False, True], ids=["entry points", "register"])
def test_study_with_additional_measurement_parameter_medium_and_reader(at_run_time, toys, tmp_path):
    write_half_ranges(tmp_path)
    (tmp_path / "toys.toml").write_text(STUDY)
    undrawn = "import radioloc.report.files; radioloc.report.files.save_figure = lambda *_: None\n"
    command = f"{undrawn}import radioloc.cli, sys; sys.exit(radioloc.cli.main(sys.argv[1:]))"
    site, command = (tmp_path, REGISTRATION + command) if at_run_time else (toys, command)
    done = python(site, "-c", command, "locate", "toys.toml", "--out", "out", "--terms", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    solution = json.loads((tmp_path / "out" / "solution.json").read_text())
    values = {entry["name"]: entry["value"] for entry in solution["parameters"]}
    for name, bias_m_rad in BIAS_M_RAD.items():
        assert values[f"zenith_angle_bias.{name}"] == pytest.approx(bias_m_rad, abs=BIAS_TOLERANCE_M_RAD)
    position = [solution["position"]["me"][f"{axis}_m"] for axis in "xyz"]
    np.testing.assert_allclose(position, LANDER.xyz_m, rtol=0, atol=POSITION_M)
    with (tmp_path / "out" / "terms.csv").open() as file:
        for row in csv.DictReader(file):
            expected_m = RADOME_M if row["path"].startswith("KASHI") else 0.0
            assert row["type"] == "half_range"
            assert float(row["wet_radome_m"]) == pytest.approx(expected_m, abs=1e-5)


@pytest.mark.study
def test_troposphere_of_the_how_to_replaces_the_built_in_one(restored_registries, monkeypatch):
    page = (ROOT / "docs" / "how-to" / "radio-media.md").read_text()
    [code] = [text for text in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "register(" in text]
    monkeypatch.chdir(ROOT)
    names: dict = {}
    exec(code, names)
    exec(code, names)  # a cell of a notebook runs twice
    study = names["study"]
    built_in = radioloc.locate(replace(study, model=replace(study.model, off=["cosecant"])))
    difference_m = names["solution"].position.xyz_m - built_in.position.xyz_m
    assert (
        10.0 < np.linalg.norm(difference_m) < 500.0
    )  # the cosecant law is wrong by metres at low elevations
    with pytest.raises(InputError, match="workers: expected 1"), open_workers(2):
        pass


SLIDE = """
[target]
kind = "sliding_lander"
longitude_deg = -51.92
latitude_deg = 43.06
height_m = -2500.0
epoch = "2020-12-02T12:00:00"

[observations]
files = ["slide.csv"]

[consider]
defaults = false

[simulation.position]
longitude_deg = -51.9162
latitude_deg = 43.0584
velocity_m_s = [1e-3, -2e-3, 5e-4]

[simulation.sessions.ranges]
kind = "range"
stations = ["KASHI", "JIAMUSI"]
start = 2020-12-01T12:00:00
stop = 2020-12-03T12:00:00
step_s = 1800.0
sigma_m = 0.1

[simulation.noise]
range = { white_m = 0.1 }
"""
NEES_LIMIT = 22.5
"""Chi-square of six parameters that is exceeded once in a thousand."""


@pytest.fixture
def sliding(tmp_path, restored_registries, monkeypatch):
    """Study of a target of another package, with simulated ranges."""
    monkeypatch.syspath_prepend(PACKAGE)
    from radioloc_toys.elevation_noise import ELEVATION_NOISE
    from radioloc_toys.sliding_lander import SLIDING_LANDER

    radioloc.register(SLIDING_LANDER)
    radioloc.register(ELEVATION_NOISE)
    path = tmp_path / "slide.toml"
    path.write_text(SLIDE)
    assert main(["simulate", str(path), "--out", str(tmp_path / "slide.csv"), "--quiet"]) == 0
    return path


@pytest.mark.study
def test_target_of_another_package_in_all_jobs(sliding):
    study = radioloc.read_study(sliding)
    solution = radioloc.locate(study)
    assert solution.converged
    truth = study.simulation.targets["lander"].target("", radioloc.measurements.PhysicalModel.build())
    error = solution.values - truth.slide.state
    covariance = solution.parameter_covariance()
    assert error @ np.linalg.solve(covariance, error) < NEES_LIMIT
    place_m = truth.slide.state[:3] - solution.position_pa_m
    assert np.linalg.norm(place_m) < 4.0 * np.linalg.norm(solution.sigma_enu_m())
    assert not radioloc.compute_residuals(study).position_estimated
    planned = radioloc.covariance(study, [24.0, 48.0])
    np.testing.assert_allclose(planned.arcs[1].sigma_m, solution.sigma_enu_m("formal"), rtol=1e-3)
    assert radioloc.monte_carlo(study, trials=20, hours=48.0).converged
    assert len(radioloc.arcs(study, [24.0, 48.0]).arcs) == 2
    assert len(radioloc.leave_one_out(study).omissions) == 2
    assert len(radioloc.visibility(study).passes) == 5
    assert radioloc.compare([solution, replace(solution, name="second")]).is_usable


def test_target_of_another_package_by_its_entry_point(toys, tmp_path):
    (tmp_path / "slide.toml").write_text(SLIDE)
    code = "import radioloc; print(radioloc.read_study('slide.toml').target.height_m)"
    assert python(toys, "-c", code, cwd=tmp_path).stdout == "-2500.0\n"


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("sliding_lander", "hovering", "kind"),
        ("latitude_deg", "speed", "speed"),
        ("43.06", '"N"', "latitude_deg"),
    ],
)
def test_mistakes_in_the_table_of_another_target_are_named(old, new, key, sliding):
    sliding.write_text(SLIDE.replace(old, new, 1))
    with pytest.raises(InputError, match=rf"\[target\] '?{key}"):
        radioloc.read_study(sliding)


@pytest.mark.study
def test_noise_of_another_package_weights_the_observations(sliding):
    sliding.write_text(f"{SLIDE}\n[elevation_noise]\nzenith_sigma_m = 0.2\n")
    solution = radioloc.locate(sliding)
    residuals = solution.residuals
    expected_m = np.hypot(0.1, 0.2 * np.sqrt(2.0) / np.sin(np.radians(residuals.elevation_deg)))
    np.testing.assert_allclose(residuals.sigma_m, expected_m, rtol=2e-2)  # both ends at the lower elevation
    assert solution.provenance["extensions"] == {"elevation_noise": {"zenith_sigma_m": 0.2}}


def test_names_of_the_package_and_other_objects_are_not_registered(restored_registries):
    with pytest.raises(InputError, match="'troposphere' is taken"):
        radioloc.register(MEDIA["troposphere"])
    with pytest.raises(InputError, match="got SimpleNamespace"):
        radioloc.register(SimpleNamespace(name="mist"))


@pytest.mark.study
def test_a_command_with_a_study_table_a_result_and_a_figure_of_another_package(toys, tmp_path):
    study = SHORT_ARC.read_text()
    (tmp_path / SHORT_ARC.with_suffix(".csv").name).write_bytes(SHORT_ARC.with_suffix(".csv").read_bytes())
    for name, limit_m, status in (("strict", 0.5, 3), ("loose", 1e6, 0), ("wrong", -1.0, 2)):
        (tmp_path / f"{name}.toml").write_text(f"{study}\n[residual_limit]\nlimit_m = {limit_m}\n")
        done = python(
            toys, "-m", "radioloc", "largest", f"{name}.toml", "--out", name, "--report", cwd=tmp_path
        )
        assert done.returncode == status, done.stderr
    assert done.stderr == (
        "radioloc: wrong.toml: [residual_limit] limit_m: expected a positive length, got -1.0\n"
    )
    written = json.loads((tmp_path / "strict" / "largest.json").read_text())
    assert written["limit_m"] == 0.5
    assert set(written["largest_m"]) == {"KASHI>lander>KASHI", "JIAMUSI>lander>JIAMUSI"}
    with (tmp_path / "strict" / "largest.csv").open() as file:
        rows = {row["path"]: float(row["largest_m"]) for row in csv.DictReader(file)}
    assert rows == pytest.approx(written["largest_m"], abs=1e-3)
    files = {path.name for path in (tmp_path / "strict").iterdir()}
    assert files >= {"largest_residuals.png", "largest_residuals.svg", "report.html"}
    assert "The largest residual of each path." in (tmp_path / "strict" / "report.html").read_text()


def test_a_solution_records_the_tables_of_other_packages_and_is_exported_to_their_formats(toys, tmp_path):
    (tmp_path / SHORT_ARC.with_suffix(".csv").name).write_bytes(SHORT_ARC.with_suffix(".csv").read_bytes())
    (tmp_path / "s.toml").write_text(f"{SHORT_ARC.read_text()}\n[residual_limit]\nlimit_m = 0.5\n")
    code = (
        "import radioloc, radioloc.io, radioloc.cli, json\n"
        "solution = radioloc.compute_residuals(radioloc.read_study('s.toml'))\n"
        "print(json.dumps(solution.provenance['extensions']))\n"
        "radioloc.io.export_solutions('lander.kml', [solution])\n"
        "radioloc.cli.main(['export', '--help'])\n"
    )
    done = python(toys, "-c", code, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    recorded, *lines = done.stdout.splitlines()
    assert json.loads(recorded) == {"residual_limit": {"limit_m": 0.5}}
    assert any(line.split()[:1] == [".kml"] for line in lines)
    longitude_deg, latitude_deg = re.search(
        r"<coordinates>([^,]*),([^<]*)", (tmp_path / "lander.kml").read_text()
    ).groups()
    target = tomllib.loads(SHORT_ARC.read_text())["target"]
    assert float(longitude_deg) == pytest.approx(target["longitude_deg"], abs=1e-9)
    assert float(latitude_deg) == pytest.approx(target["latitude_deg"], abs=1e-9)


def test_tables_that_are_unknown_or_of_another_kind_of_study_are_refused(monkeypatch, tmp_path):
    monkeypatch.setitem(STUDY_TABLES._entries, "image", StudyTable("image", StudyTable, print, "images"))
    path = tmp_path / "s.toml"
    for content, message in (
        ("[image]", r"expected a study of tracking, got one with \[image\]; use radioloc images"),
        ("[imag]", "'imag' is not known"),
    ):
        path.write_text(f"[target]\n{content}\n")
        with pytest.raises(InputError, match=message):
            radioloc.read_study(path)


@pytest.mark.parametrize(
    "first",
    some(
        ["radioloc", "radioloc_toys.zenith_angle_bias", "radioloc_toys.wet_radome"],
        ["radioloc_toys.zenith_angle_bias"],
    ),
)
def test_plugins_are_loaded_when_they_are_looked_for(first, toys, tmp_path):
    """Entry points are loaded late, so that their modules and radioloc can be imported in any order."""
    code = (
        f"import sys, {first}, radioloc\n"
        "toys = [name for name in sys.modules if name.startswith('radioloc_toys.')]\n"
        f"print(toys == [name for name in [{first!r}] if 'toys' in name])\n"
        "print('half_range' in radioloc.measurements.MEASUREMENTS)\n"
        "print('zenith_angle_bias' in radioloc.parameters.PARAMETERS, 'wet_radome' in radioloc.media.MEDIA)\n"
        "print('wet_radome' in radioloc.measurements.TERMS)\n"
    )
    done = python(toys, "-W", "error", "-c", code, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert set(done.stdout.split()) == {"True"}


BROKEN = {
    "measurements": {
        "no_such_module:THING": r"cannot be loaded \(No module named 'no_such_module'\)",
        "radioloc_toys.half_range:NOTHING": "cannot be loaded .*NOTHING",
        "radioloc_toys.zenith_angle_bias:ZENITH_ANGLE_BIAS": "is a ParameterKind, not a Measu",
    },
    "parameters": {"radioloc.parameters.biases:RANGE_BIAS": "has the name 'range_bias', which is taken"},
    "media": {"radioloc_toys.half_range:HALF_RANGE": "is a MeasurementType, not a Medium"},
}
"""Entry points that cannot be used, by group, and what is said of each."""


def test_broken_plugins_give_one_warning_each_and_are_left_out(tmp_path):
    named = {
        f"radioloc.{group}": {f"broken_{k}": value for k, value in enumerate(values)}
        for group, values in BROKEN.items()
    }
    code = (
        "import radioloc\n"
        "faces = radioloc.measurements.MEASUREMENTS, radioloc.parameters.PARAMETERS, radioloc.media.MEDIA\n"
        "for found in faces: print(*found); print(*found)\n"
        "print(*radioloc.measurements.TERMS)"
    )
    done = python(installed(tmp_path / "site", named), "-c", code, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    expected = {
        f"{value} of the entry points radioloc.{group} ": problem
        for group, values in BROKEN.items()
        for value, problem in values.items()
    }
    warnings = re.findall(r"PluginWarning: (.*)", done.stderr)
    assert len(warnings) == len(expected)
    for begin, problem in expected.items():
        [warning] = [text for text in warnings if text.startswith(begin)]
        assert re.match(problem, warning.removeprefix(begin))
        assert warning.endswith("it is left out")
    lines = done.stdout.splitlines()
    for first, second, name in zip(
        lines[:6:2], lines[1:6:2], ("range", "range_bias", "ionosphere"), strict=True
    ):
        assert name in first.split()
        assert first == second


FAILING = {
    "parameter": (PARAMETERS, "station_position", ("considered", "acts_on", "partials")),
    "medium": (MEDIA, "antenna_axis_offset", ("prepare", "delay")),
    "reader": (READERS, "table of observations", ("looks_like", "read")),
}
"""Entries of registries, with functions of theirs."""


@pytest.mark.parametrize(
    ("entry_type", "function"),
    [(entry_type, function) for entry_type, (_, _, functions) in FAILING.items() for function in functions],
)
def test_failures_of_registry_entries_are_one_line(entry_type, function, monkeypatch, capsys):
    def fails(*_):
        raise KeyError("radome")

    registry, name, _ = FAILING[entry_type]
    members = ("name", "description", "limits_rad", "prepare", "delay")
    entry = registry[name]
    if entry_type == "medium":
        broken = SimpleNamespace(**{member: getattr(entry, member) for member in members} | {function: fails})
    else:
        broken = replace(entry, **{function: fails})
    monkeypatch.setitem(registry._entries, name, broken)
    assert main(["locate", str(SHORT_ARC), "--quiet"]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.removeprefix("radioloc: ").removeprefix("[consider] ") == (
        f"the {entry_type} {name} cannot be used: {function} fails with KeyError: 'radome'; "
        "fix the package that provides it, or leave it out"
    )
