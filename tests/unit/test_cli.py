"""The command line as its user meets it: exit status, one line for what is wrong, the card, the files."""

import csv
import io
import json
import os
import re
import shlex
import subprocess
import sys
import warnings

import numpy as np
import pytest
from odf_files import doppler, odf
from paths import EXAMPLES, ROOT
from quick import some
from tdm_messages import TWO_WAY, kvn

import radioloc
from radioloc import cli
from radioloc.cli.output import BAD_INPUT, EXIT_STATUS
from radioloc.cli.registry import make_parser
from radioloc.errors import ConvergenceError, DataQualityWarning, PredictedEopWarning
from radioloc.jobs import locate

TABLE = EXAMPLES / "apollo15" / "apollo15_apollo_2006-2007.csv"
JPL_PA_M = np.array([1554678.949, 98094.118, 765004.906])  # JPL IOM 335-JW,DB,WF-20080314-001, DE421

HELP_LIMIT_S = 0.5
"""Of a processor's time, as the machine may do other things meanwhile."""

TARGET = '[target]\nframe = "ME_DE421"\nlongitude_deg = 3.5\nlatitude_deg = 26.0\nheight_m = -1000.0\n'

# Three normal points of Apache Point to Apollo 15 as the ILRS publishes them (EUROLAS Data Center, May 2024), without
# records without effect on the range.
CRD = """\
h1 CRD  2 2025  6 26 21
h2       APOL 7045 95  1  4       ILRS
h3 apollo15        103  103       na 0 1  3
h4  1 2024  5  2 11 33  1 2024  5  2 11 37  4  1 0 0 0 1 0 2 0
c0 0     532.0 std3 lpd apd4 cesm  na  na  na  na
11 41695.0000000 2.4382990776324 std3 2  243.0     91     264.9      na      na       na    na 0 193.8
20 41695.000  723.75 280.34   34 1
50 std3  264.9     na     na   na 1
h8
h4  1 2024  5  2 11 56  3 2024  5  2 11 58 31  1 0 0 0 1 0 2 0
11 43045.0000000 2.4358884133254 std3 2  148.0     67     278.4      na      na       na    na 0 131.1
20 43045.000  723.99 280.21   35 1
h8
h9
"""


class Outcome:
    """Exit status and what was said."""

    def __init__(self, status, out, err):
        self.status, self.out, self.err = status, out, err


@pytest.fixture
def folder(tmp_path):
    lines = TABLE.read_text(encoding="utf-8").splitlines(keepends=True)
    (tmp_path / "d.csv").write_text("".join(lines[:4] + lines[4::7]), encoding="utf-8")
    return tmp_path


@pytest.fixture
def run(folder, capsys):
    def run(content, *arguments, command="locate"):
        study = folder / "s.toml"
        if content is not None:
            study.write_text(content, encoding="utf-8")
        try:
            status = cli.main([command, str(study), *map(str, arguments)])
        except SystemExit as end:
            status = end.code
        return Outcome(status, *capsys.readouterr())

    return run


def study_of(files="d.csv", extra="", target=TARGET):
    return f'{target}[observations]\nfiles = ["{files}"]\n{extra}'


def refused(outcome, *parts):
    assert outcome.status == 2
    assert outcome.out == ""
    assert outcome.err.startswith("radioloc: ")
    assert outcome.err.count("\n") == 1
    assert outcome.err.endswith("\n")
    for part in parts:
        assert part in outcome.err


def rows_of(file):
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.usefixtures("undrawn")
def test_locate_prints_a_card_and_writes_the_files(run, folder):
    reference = f'[reference]\nname = "JPL"\nframe = "PA_DE421"\nposition_m = {JPL_PA_M.tolist()}\n'
    outcome = run(study_of(extra=reference), "--out", folder / "out" / "new")
    assert outcome.status == 0
    assert outcome.err == ""
    for part in ("CONVERGED", "ME_DE421", "PA_DE421", "ellipse", "solution - JPL", "APOLLO", "written to "):
        assert part in outcome.out
    assert all(len(line) <= 80 for line in outcome.out.splitlines() if not line.startswith("written to "))
    solution = json.loads((folder / "out" / "new" / "solution.json").read_text(encoding="utf-8"))
    found_m = [solution["position"]["pa"][f"{axis}_m"] for axis in "xyz"]
    assert np.linalg.norm(found_m - JPL_PA_M) < 0.8
    rows = rows_of(folder / "out" / "new" / "residuals.csv")
    assert solution["fit"]["used"] + solution["fit"]["rejected"] == len(rows)
    used = [row["status"] for row in rows].count("used")
    assert used == solution["fit"]["used"]


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("count", [1, 2])
def test_not_observable_ends_with_3_and_says_what_is_missing(count, run, folder):
    lines = TABLE.read_text(encoding="utf-8").splitlines(keepends=True)
    (folder / "d.csv").write_text("".join(lines[: 4 + count]), encoding="utf-8")
    outcome = run(study_of(), "--out", folder / "out")
    assert outcome.status == 3
    assert "NOT OBSERVABLE" in outcome.out
    assert "would help: " in outcome.out
    solution = json.loads((folder / "out" / "solution.json").read_text(encoding="utf-8"))
    assert solution["converged"] is False
    assert solution["sigma"]["east_m"] is None
    quiet = run(study_of(), "--quiet")
    assert (quiet.status, quiet.out) == (3, "")
    assert "s: NOT OBSERVABLE" in quiet.err


@pytest.mark.usefixtures("undrawn")
def test_several_studies_are_fitted_one_after_another(folder, capsys):
    lines = TABLE.read_text(encoding="utf-8").splitlines(keepends=True)
    (folder / "few.csv").write_text("".join(lines[:5]), encoding="utf-8")
    contents = {"few": study_of("few.csv"), "bad": study_of("none.csv"), "good": study_of()}
    for name, content in contents.items():
        (folder / f"{name}.toml").write_text(content, encoding="utf-8")
    paths = [str(folder / f"{name}.toml") for name in contents]
    assert cli.main(["locate", *paths, "--out", str(folder / "out"), "--quiet"]) == 3
    outcome = capsys.readouterr()
    assert outcome.out == ""
    unobservable, bad = outcome.err.splitlines()
    assert unobservable.startswith("radioloc: few: NOT OBSERVABLE")
    assert bad.startswith("radioloc: bad: ")
    assert {path.parent.name for path in folder.glob("out/*/solution.json")} == {"few", "good"}
    assert cli.main(["residuals", *paths[1:], "--json"]) == 2
    [solution] = json.loads(capsys.readouterr().out)
    assert solution["name"] == "good"
    same_name = folder / "again" / "good.toml"
    same_name.parent.mkdir()
    same_name.write_text(study_of("../d.csv"), encoding="utf-8")
    assert cli.main(["residuals", paths[2], str(same_name), "--out", str(folder / "both"), "--quiet"]) == 0
    assert {path.parent.name for path in folder.glob("both/*/residuals.csv")} == {folder.name, "again"}
    for unclear in ([paths[2], paths[2]], [*paths[1:], "--sinex", "x.snx"]):
        with pytest.raises(SystemExit):
            cli.main(["locate", *unclear])


@pytest.mark.parametrize(("command", "options"), [("arcs", ["--hours", 0.3, 0.5]), ("leave-one-out", [])])
def test_quiet_studies_of_several_fits_name_those_that_failed(command, options, run, folder):
    lines = (EXAMPLES / "change5" / "short_arc.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    (folder / "d.csv").write_text("".join(lines[:71]), encoding="utf-8")
    target = "[target]\nlongitude_deg = -51.88\nlatitude_deg = 43.06\nheight_m = -2500.0\n"
    wrong = "[estimate]\nheight_prior = { height_m = 9000.0, sigma_m = 0.1 }\nrejection_sigma = 30.0\n"
    wrong += "[stations.KASHI]\nitrf_m = [1151367.568, 4870627.568, 3952516.899]\n"
    wrong += "[consider]\ndefaults = false\n"
    outcome = run(study_of(extra=wrong, target=target), *options, "--quiet", command=command)
    assert (outcome.status, outcome.out) == (3, "")
    assert all(line.startswith("radioloc: s") for line in outcome.err.splitlines())
    assert outcome.err.count("NOT CONVERGED") == max(1, len(options) - 1)


def test_light_time_that_does_not_settle_ends_with_3(run, monkeypatch):
    def fails(study):
        raise ConvergenceError("the light time did not settle")

    monkeypatch.setattr("radioloc.jobs.preparation.prepared_arc", fails)
    outcome = run(study_of())
    assert (outcome.status, outcome.out, outcome.err) == (3, "", "radioloc: the light time did not settle\n")


def data(folder, text):
    (folder / "d.csv").write_bytes(text if isinstance(text, bytes) else text.encode())


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        (None, ["s.toml", "no such study file"]),
        (study_of(extra='stations = ["GRASSE"]\n'), ["[observations] stations", "the files have APOLLO"]),
        (study_of(extra='[model]\nephemeris = "DE999"\n'), ["DE999"]),
        (study_of(extra='[model]\nearth_orientation = "no.txt"\n'), ["[model] earth_orientation", "no.txt"]),
    ],
)
def test_bad_studies(content, parts, run, folder):
    kernel = ROOT / "kernels" / "moon_pa_de421_1969_2050.bpc"
    (folder / "cut.bpc").write_bytes(kernel.read_bytes()[:50000])
    refused(run(content), *parts)


@pytest.mark.study
def test_output_that_cannot_be_written(run, folder):
    refused(
        run(study_of(), "--out", folder / "d.csv"), "d.csv", "cannot create the output folder: File exists"
    )
    refused(
        run(study_of(), "--out", folder / "d.csv" / "x"), "cannot create the output folder: Not a directory"
    )
    (folder / "out" / "residuals.csv").mkdir(parents=True)
    refused(run(study_of(), "--out", folder / "out"), "residuals.csv")


def test_any_other_trouble_with_files_is_one_line(run, monkeypatch):
    def refuses(study):
        raise OSError(13, "Permission denied", "x.png")

    monkeypatch.setattr("radioloc.jobs.preparation.prepared_arc", refuses)
    refused(run(study_of()), "x.png: Permission denied")


def test_wrong_arguments_are_one_line(run, capsys):
    refused(run(study_of(), "--frobnicate"), "--frobnicate", "--help")
    for arguments in ([], ["locate"], ["frob", "x"]):
        with pytest.raises(SystemExit) as end:
            cli.main(arguments)
        refused(Outcome(end.value.code, *capsys.readouterr()), "--help")


def test_help_and_version(capsys):
    for arguments, text in ((["--version"], radioloc.__version__), (["locate", "--help"], "STUDY.toml")):
        with pytest.raises(SystemExit) as end:
            cli.main(arguments)
        assert end.value.code == 0
        assert text in capsys.readouterr().out


@pytest.mark.parametrize("name", make_parser().commands)
def test_each_command_has_examples_that_parse(name, capsys):
    parser = make_parser().commands[name]
    assert parser.examples
    for example in parser.examples:
        program, *arguments = shlex.split(example.partition(" > ")[0])
        assert program == "radioloc"
        assert make_parser().parse_args(arguments).command == name
    help_text = parser.format_help()
    assert "examples:" in help_text
    if name == "new" or "radioloc new keys" in help_text:
        assert len(help_text.splitlines()) < 45


def test_keys_of_study_files_are_printed(capsys):
    assert cli.main(["new", "keys"]) == 0
    output = capsys.readouterr().out
    assert "[estimate.orbit]" in output
    assert "station_position (m)" in output


def test_general_help_comes_at_once_and_has_the_exit_statuses():
    start = os.times().children_user
    done = process("--help")
    assert os.times().children_user - start < HELP_LIMIT_S
    assert done.returncode == 0
    for status in EXIT_STATUS:
        assert re.search(rf"^  {status} +\w", done.stdout, re.MULTILINE)


@pytest.mark.parametrize(
    "arguments", [["doctor"], ["frames", "3.6", "26.1", "-1900"], ["stations", "kashi"], ["kernels"]]
)
def test_json_is_all_that_is_printed(arguments, capsys):
    assert cli.main([*arguments, "--json"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert json.loads(out)


@pytest.mark.study
def test_a_study_s_json_is_that_of_its_file(run, folder):
    outcome = run(study_of(), "--json", "--out", folder / "out", command="residuals")
    assert (outcome.status, outcome.err) == (0, "")
    assert outcome.out == (folder / "out" / "solution.json").read_text(encoding="utf-8")


class Stream(io.StringIO):
    """Standard input, of which the bytes are read."""

    @property
    def buffer(self):
        return io.BytesIO(self.getvalue().encode())


def test_a_study_from_standard_input_has_paths_relative_to_the_working_directory(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "stdin", Stream(study_of()))
    assert cli.main(["residuals", "-", "--json"]) == 0
    from_stream = json.loads(capsys.readouterr().out)
    (folder / "stdin.toml").write_text(study_of(), encoding="utf-8")
    assert cli.main(["residuals", "stdin.toml", "--json"]) == 0
    from_file = json.loads(capsys.readouterr().out)
    assert from_stream["provenance"].pop("study") is None
    assert from_file["provenance"].pop("study")["file"] == str(folder / "stdin.toml")
    assert from_stream == from_file


@pytest.mark.study
def test_convert_from_standard_input_to_standard_output(folder):
    packed_bytes = (folder / "d.csv").read_bytes()
    command = [sys.executable, "-m", "radioloc", "convert", "-", "-", "--format"]
    packed, table = (
        subprocess.run([*command, *options], input=content, capture_output=True, check=True, timeout=600)
        for options, content in ((["parquet"], packed_bytes), (["csv"], packed_bytes))
    )
    assert (packed.stderr, table.stderr) == (b"", b"")
    (folder / "e.parquet").write_bytes(packed.stdout)
    (folder / "e.csv").write_bytes(table.stdout)
    first = radioloc.read_observations(folder / "d.csv")
    for name in ("e.parquet", "e.csv"):
        assert (radioloc.read_observations(folder / name).value_m == first.value_m).all()


@pytest.mark.study
def test_convert_writes_ramps_beside_the_table(tmp_path, capsys):
    source, table = tmp_path / "pass.odf", tmp_path / "pass.csv"
    source.write_bytes(odf([doppler(k) for k in range(4)]))
    assert cli.main(["convert", str(source), str(table)]) == 0
    printed = capsys.readouterr().out
    assert "2 ramps of DSS-24" in printed
    assert printed.endswith(f"written to {table} and {tmp_path / 'pass.ramps.csv'}\n")
    first = radioloc.read_observations(source)
    restored = radioloc.read_observations([table, tmp_path / "pass.ramps.csv"])
    assert (restored.value_m == first.value_m).all()
    assert restored.ramped.all()
    assert (restored.ramps.frequency_hz == first.ramps.frequency_hz).all()
    assert (restored.ramps.start.fraction == first.ramps.start.fraction).all()
    command = [sys.executable, "-m", "radioloc", "convert", str(source), "-", "--format", "csv"]
    streamed = subprocess.run(command, capture_output=True, check=True, timeout=600)
    assert b"no place for the ramps" in streamed.stderr
    assert streamed.stdout == table.read_bytes()


def test_what_is_wrong_with_standard_input_is_said_of_it(capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", Stream("hello\n"))
    assert cli.main(["convert", "-", "-"]) == 2
    refused(Outcome(2, *capsys.readouterr()), "radioloc: stdin: starts with 'hello'")


def test_convert_reads_as_a_study_does(folder, capsys):
    ranges = TWO_WAY | {"RANGE_UNITS": "RU", "INTEGRATION_REF": None}
    (folder / "d.tdm").write_text("\n".join(kvn((ranges, ["RANGE = 2021-03-28T14:00:00 1000.0"]))))
    arguments = ["convert", str(folder / "d.tdm"), str(folder / "e.csv"), "--sigma", "range=1.0"]
    assert cli.main(arguments) == 2
    refused(Outcome(2, *capsys.readouterr()), "tdm_range_unit_s", "as --study")
    (folder / "s.toml").write_text(study_of("d.tdm", "tdm_range_unit_s = 0.00257\n"))
    assert cli.main([*arguments, "--study", str(folder / "s.toml")]) == 0
    [row] = rows_of(folder / "e.csv")
    assert float(row["observed_m"]) == pytest.approx(2.57 * 299792458.0, abs=1e-6)
    assert float(row["sigma_m"]) == 1.0


def test_verbose_says_what_is_done_on_standard_error(run):
    outcome = run(study_of(), "-v", "-q", command="residuals")
    assert outcome.out == ""
    lines = outcome.err.splitlines()
    assert len(lines) == 3
    assert all(re.match(r"radioloc: +\d+ ms  \w", line) for line in lines)
    assert "read 22 observations" in lines[0]
    assert run(study_of(), "-q", command="residuals").err == ""


def test_completion_in_bash(tmp_path, capsys):
    assert cli.main(["completion", "bash"]) == 0
    (tmp_path / "script").write_text(capsys.readouterr().out)
    ask = 'source ./script; COMP_WORDS=(radioloc locate --ter); COMP_CWORD=2; _shtab_radioloc; echo "${COMPREPLY[@]}"'
    done = subprocess.run(["bash", "-c", ask], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.stdout == "--terms\n"


def test_frames_have_the_iau_s_axes_at_an_epoch_and_lead_back(capsys):
    def rows(*arguments):
        assert cli.main(["frames", *map(str, arguments), "--epoch", "2020-12-01", "--json"]) == 0
        return {row.pop("frame"): row for row in json.loads(capsys.readouterr().out)}

    moved = rows(3.6, 26.1, -1900.0)
    iau = moved["IAU_MOON"]
    # The series of the IAU leaves its axes up to 155 m away from the mean-Earth axes.
    away_m = np.linalg.norm(np.subtract(iau["xyz_m"], moved["ME_DE421"]["xyz_m"]))
    assert 20.0 < away_m < 155.0
    numbers = (iau[key] for key in ("longitude_deg", "latitude_deg", "height_m"))
    back = rows(*numbers, "--frame", "IAU_MOON")
    assert set(back) == set(moved) == {"PA_DE421", "ME_DE421", "PA_DE440", "IAU_MOON"}
    for name, row in moved.items():
        np.testing.assert_allclose(back[name]["xyz_m"], row["xyz_m"], rtol=0.0, atol=1e-6)
    with pytest.raises(SystemExit):
        cli.main(["frames", "1", "2", "3", "--frame", "IAU_MOON"])
    refused(Outcome(2, *capsys.readouterr()), "give --epoch UTC")


@pytest.mark.study
def test_visibility_and_leave_one_out_print_their_cards(capsys, tmp_path):
    plan = str(EXAMPLES / "change5" / "simulation.toml")
    assert cli.main(["visibility", plan, "--stations", "KS", "--stop", "2020-12-02", "--mask", "5"]) == 0
    assert "KASHI" in capsys.readouterr().out
    data = str(EXAMPLES / "apollo15" / "apollo15_2024.toml")
    assert cli.main(["leave-one-out", data, "--json", "--out", str(tmp_path)]) == 0
    names = [entry["name"] for entry in json.loads(capsys.readouterr().out)["omissions"]]
    assert names == ["APOLLO", "GRASSE", "MATERA"]
    heading, *rows = (tmp_path / "leave_one_out.csv").read_text().splitlines()
    assert heading.startswith("kind,name,omitted,used,converged,radius_95_m,shift_east_m,")
    assert [row.split(",")[1] for row in rows] == names
    written = json.loads((tmp_path / "leave_one_out.json").read_text())["omissions"]
    assert [entry["shift_enu_m"][0] for entry in written] == [float(row.split(",")[6]) for row in rows]


def test_light_times_as_card_as_json_and_in_a_file(capsys, tmp_path):
    study = str(EXAMPLES / "change5" / "short_arc.toml")
    file = tmp_path / "table.csv"
    assert cli.main(["light-time", study, "--step", "1800", "--frequency", "8.47e9", "--out", str(file)]) == 0
    card = capsys.readouterr().out
    assert "JIAMUSI>lander>JIAMUSI" in card
    assert card.endswith(f"written to {file}\n")
    assert len(file.read_text().splitlines()) == 1 + 6
    place = ["--at", "-51.9162", "43.0584", "-2550.4", "--stations", "KASHI"]
    span = ["--start", "2020-12-01T15:11:00", "--stop", "2020-12-01T15:11:00"]
    assert cli.main(["light-time", *place, *span, "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["columns"]["path"] == ["KASHI>lander>KASHI"]
    assert content["name"] == "lander at -51.9162 deg E, 43.0584 deg N, -2550.4 m"
    assert f",{content['columns']['downlink_light_time_s'][0]:.12f}," in file.read_text()
    planned = ["light-time", *place, "--start", "2029-03-20T12:00", "--stop", "2029-03-21T12:00", "--quiet"]
    assert [cli.main(planned), cli.main([*planned, "--eop-beyond", "extrapolate"])] == [2, 0]
    capsys.readouterr()
    assert cli.main(["light-time", study, "--out", "table.txt"]) == 2
    assert "table.txt: unsupported file extension '.txt'; supported: .csv" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [([], "give a study file or --at"), (["a.toml", "--eop-beyond", "hold"], "--eop-beyond is of --at")],
)
def test_light_times_of_nothing_or_of_two_places_are_refused(capsys, arguments, message):
    with pytest.raises(SystemExit):
        cli.main(["light-time", *arguments])
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("category", "texts", "pattern"),
    [
        (DataQualityWarning, ["poor\n  data"] * 3, "poor data"),
        (
            PredictedEopWarning,
            [f"predicted at {count} epochs" for count in range(3)],
            "predicted at 0 epochs",
        ),
    ],
)
def test_warnings_of_the_library_are_single_lines_said_once(category, texts, pattern, run, monkeypatch):
    def warns(*arguments, **keywords):
        for text in texts:
            warnings.warn(text, category, stacklevel=1)
        return fit_arc(*arguments, **keywords)

    fit_arc = locate.fit_arc
    monkeypatch.setattr(locate, "fit_arc", warns)
    outcome = run(study_of(), "--quiet")
    assert (outcome.out, outcome.err) == ("", f"radioloc: warning: {pattern}\n")


def test_earth_orientation_after_its_table(run, folder):
    # Some years after the table's end, whenever it was installed.
    last_date = radioloc.measurements.PhysicalModel.build().earth.table.last_date
    data(folder, CRD.replace("2024  5", f"{int(last_date[:4]) + 4}  5"))
    refused(run(study_of()), "line 6", "[model] eop_beyond", '"hold" or "extrapolate"')
    refused(run(study_of(extra='[model]\neop_beyond = "guess"\n')), "eop_beyond: expected one of", "'guess'")
    outcome = run(study_of(extra='[model]\neop_beyond = "extrapolate"\n'), command="residuals")
    assert outcome.status == 0, outcome.err
    pattern = r"Earth orientation is extrapolated after 20[-0-9]+: at the end of the arc UT1 may be off by \d\.\d+ s "
    assert re.search(pattern, " ".join(outcome.out.split()))


def process(*arguments, **options):
    environment = {**os.environ, **options.pop("environment", {})}
    command = [sys.executable, "-m", "radioloc", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=600, env=environment, **options)


ENVIRONMENTS = [{}, {"PYTHONWARNINGS": "error", "LC_ALL": "C", "PYTHONUTF8": "0"}]
"""Environment variables of Python for warnings and language."""


@pytest.mark.parametrize("environment", some(ENVIRONMENTS, ENVIRONMENTS[1:]))
def test_as_a_program(environment, run, folder):
    expected = run(study_of(extra="[estimate]\nephemeris_sigma_m = [0.3, 0.4, 0.5]\n"))
    done = process("locate", folder / "s.toml", cwd="/", environment=environment)
    assert (done.returncode, done.stdout, done.stderr) == (0, expected.out, "")


@pytest.mark.parametrize("encoding", some(["cp1252", "ascii", "latin-1"], ["ascii"]))
def test_card_and_json_in_an_encoding_that_lacks_the_name(encoding, folder):
    (folder / "嫦娥五号.toml").write_text(study_of(), encoding="utf-8")
    environment = {"PYTHONIOENCODING": encoding}
    card = process("residuals", "嫦娥五号.toml", cwd=folder, environment=environment)
    assert (card.returncode, card.stderr) == (0, "")
    assert r"\u5ae6\u5a25\u4e94\u53f7" in card.stdout
    content = process("residuals", "嫦娥五号.toml", "--json", cwd=folder, environment=environment)
    assert json.loads(content.stdout)["name"] == "嫦娥五号"


@pytest.mark.parametrize("count", some(["0", "-3", "two", ""], ["0"]))
def test_impossible_count_of_threads_is_one_line(count, folder):
    failed = process("doctor", environment={"NUMBA_NUM_THREADS": count})
    refused(Outcome(failed.returncode, failed.stdout, failed.stderr), "NUMBA_NUM_THREADS", repr(count))


def test_convert_there_and_back(tmp_path, capsys):
    binary, table, message = (tmp_path / name for name in ("a.parquet", "b.csv", "c.tdm"))
    assert cli.main(["convert", str(TABLE), "--out", str(binary)]) == 0
    printed = capsys.readouterr().out
    assert "153 observations" in printed
    assert f"written to {binary}" in printed
    assert cli.main(["convert", str(binary), str(table), "--quiet"]) == 0
    first = radioloc.read_observations(TABLE)
    for file in (binary, table):
        read = radioloc.read_observations(file)
        assert (read.value_m == first.value_m).all()
        assert (read.epoch.fraction == first.epoch.fraction).all()
    # Laser light has no place in a message.
    row = "2020-12-01T00:00:00,range,KASHI>lander>JIAMUSI,7.5e8,1.0,receive"
    table.write_text(f"epoch_utc,type,path,observed_m,sigma_m,time_tag\n{row}\n")
    assert cli.main(["convert", str(table), str(message), "--originator", "X", "--quiet"]) == 0
    assert cli.main(["convert", str(message), str(binary), "--sigma", "range=0.02", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    read = radioloc.read_observations(binary)
    assert (read.value_m.tolist(), read.sigma_m.tolist()) == ([7.5e8], [0.02])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{csv}", "{folder}/a.txt"], "unsupported file extension"),
        (["{csv}", "{folder}/a.tdm"], "give originator"),
        (["{csv}", "{folder}/a.csv", "--sigma", "range"], "write it as TYPE=METRES"),
        (["{folder}/none.csv", "{folder}/a.csv"], "no such file"),
        (["{csv}"], "--out FILE"),
    ],
)
def test_convert_says_in_one_line_what_is_wrong(tmp_path, capsys, arguments, words):
    command = [text.format(csv=TABLE, folder=tmp_path) for text in arguments]
    try:
        status = cli.main(["convert", *command])
    except SystemExit as error:
        status = error.code
    assert status == 2
    output = capsys.readouterr().err
    assert words in output
    assert output.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["lander", "reflector", pytest.param("orbiter", marks=pytest.mark.slow)])
def test_starter_study_runs_at_once(kind, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["new", kind]) == 0
    assert f"radioloc simulate {kind}.toml --out {kind}.csv" in capsys.readouterr().out
    assert cli.main(["simulate", f"{kind}.toml", "--out", f"{kind}.csv"]) == 0
    assert cli.main(["locate", f"{kind}.toml", "--quiet"]) == 0


@pytest.mark.parametrize("sites", [[(0, -89.5, 1000)], [(-51.9, 43.0, -2500), (-40, 43, -2000.5)]])
def test_starter_study_of_landers_elsewhere(sites, tmp_path, capsys):
    path = tmp_path / "plan.toml"
    options = [text for site in sites for text in ("--at", *map(str, site))]
    assert cli.main(["new", "lander", "--out", str(path), *options]) == 0
    study = radioloc.read_study(path)
    assert [place.selenographic for place in study.all_targets.values()] == [
        pytest.approx(site) for site in sites
    ]
    assert len(radioloc.simulate(study).targets) == len(sites)
    assert cli.main(["new", "lander", str(tmp_path / "b.toml"), "--at", "0", "95", "0"]) == BAD_INPUT


def test_starter_study_does_not_replace_a_file(tmp_path, capsys):
    (tmp_path / "mine.toml").write_text("")
    assert cli.main(["new", "lander", str(tmp_path / "mine.toml")]) == BAD_INPUT
    assert (tmp_path / "mine.toml").read_text() == ""
