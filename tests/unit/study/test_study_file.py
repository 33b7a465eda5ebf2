"""The study file: every key arrives where it belongs, every mistake is a sentence with file, table and key."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from paths import EXAMPLES

import radioloc
from radioloc import read_study
from radioloc.errors import InputError
from radioloc.imaging import read_image_study
from radioloc.measurements.equipment_delays import StationDelay
from radioloc.study import EstimateChoice, ObservationChoice

TARGET = '[target]\nframe = "ME_DE421"\nlongitude_deg = 3.5\nlatitude_deg = 26.0\nheight_m = -1000.0\n'
FILES = '[observations]\nfiles = ["d.csv"]\n'
ITRF = "itrf_m = [-1463998.9085, -5166632.7635, 3435012.8835]\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "d.csv").write_text("x", encoding="utf-8")
    return tmp_path


@pytest.fixture
def read(folder):
    def read(text):
        path = folder / "s.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_study(path)

    return read


def refused(read, text, message):
    with pytest.raises(InputError) as caught:
        read(text)
    assert message in str(caught.value)
    assert "s.toml: " in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_key_arrives(read, folder):
    (folder / "eop.txt").write_text("x", encoding="utf-8")
    study = read(
        TARGET
        + """
[observations]
files = ["d.csv"]
targets = "apollo15"
stations = ["APOLLO", "GRASSE"]
start = 2006-04-07
stop = "2006-04-09T12:00:00"
hours = 12
extra_sigma_m = 0.02
vlbi_station_sigma_m = 0.03
[estimate]
position = "geographic"
range_bias = ["APOLLO"]
range_bias_sigma_m = 0.5
time_bias = "all"
time_bias_sigma_s = 1e-6
height_prior = { height_m = -1900.0, sigma_m = 5.0 }
ephemeris_sigma_m = [0.1, 0.2, 0.3]
rejection_sigma = 4
weights = "correlated"
[model]
off = ["shapiro", "pole_tide"]
ephemeris = "sub/de.bsp"
libration = "DE421"
earth_orientation = "eop.txt"
[reference]
name = "JPL"
frame = "PA_DE421"
position_m = [1554678.949, 98094.118, 765004.906]
[references.map]
longitude_deg = 3.63
latitude_deg = 26.13
height_m = -1922.0
"""
    )
    assert study.name == "s"
    assert study.target.frame == "ME_DE421"
    assert study.target.selenographic == pytest.approx((3.5, 26.0, -1000.0))
    chosen = study.observations
    assert chosen.files == (folder / "d.csv",)
    assert (chosen.targets, chosen.stations) == (("apollo15",), ("APOLLO", "GRASSE"))
    assert chosen.start.day_strings()[0] == "2006-04-07"
    assert chosen.stop.fraction[0] == 0.5
    assert (chosen.hours, chosen.extra_sigma_m, chosen.vlbi_station_sigma_m) == (12.0, 0.02, 0.03)
    assert study.estimate == radioloc.study.EstimateChoice(
        position="geographic",
        range_bias=("APOLLO",),
        range_bias_sigma_m=0.5,
        time_bias="all",
        time_bias_sigma_s=1e-6,
        height_prior=radioloc.study.HeightPrior(-1900.0, 5.0),
        ephemeris_sigma_m=(0.1, 0.2, 0.3),
        rejection_sigma=4.0,
        weights="correlated",
    )
    assert set(study.model.off) == {"shapiro", "pole_tide"}
    assert study.model.ephemeris == str(folder / "sub" / "de.bsp")
    assert study.model.libration == "DE421"
    assert study.model.earth_orientation == folder / "eop.txt"
    assert (study.reference.name, study.reference.position.frame) == ("JPL", "PA_DE421")
    [reference] = study.references
    assert (reference.name, reference.position.selenographic[2]) == ("map", pytest.approx(-1922.0))


def test_defaults_are_those_of_the_records(read, folder):
    study = read(TARGET + FILES)
    assert study.estimate == radioloc.study.EstimateChoice()
    assert study.model == radioloc.study.ModelChoice()
    assert study.observations == radioloc.study.ObservationChoice(files=(folder / "d.csv",))
    assert study.reference is None
    assert study.catalogue is radioloc.StationCatalogue.default()


def test_byte_order_mark_is_passed_over(read):
    assert read(b"\xef\xbb\xbf" + (TARGET + FILES).encode()).name == "s"


def test_dates_as_toml_or_as_text_are_the_same(read):
    forms = ["2006-10-01T06:00:00Z", "2006-10-01T06:00:00", '"2006-10-01 06:00:00"', '"2006-274T06:00:00"']
    starts = [read(TARGET + FILES + f"start = {form}\n").observations.start for form in forms]
    assert all((s.jd[0], s.fraction[0]) == (starts[0].jd[0], 0.25) for s in starts)


@pytest.mark.parametrize("pattern", ["*.csv", "d.*", "?.csv", "[cd].csv", "./*.csv", "**/d.csv"])
def test_globs(pattern, read, folder):
    study = read(TARGET + f'[observations]\nfiles = ["{pattern}"]\n')
    assert [file.resolve() for file in study.observations.files] == [(folder / "d.csv").resolve()]


def test_globs_are_sorted_and_a_file_is_taken_once(read, folder):
    for name in ("b.csv", "a.csv"):
        (folder / name).write_text("x", encoding="utf-8")
    study = read(TARGET + '[observations]\nfiles = ["d.csv", "*.csv", "./d.csv"]\n')
    assert [file.name for file in study.observations.files] == ["d.csv", "a.csv", "b.csv"]


def test_a_name_that_looks_like_a_glob_is_a_name_first(read, folder):
    (folder / "a[1].csv").write_text("x", encoding="utf-8")
    study = read(TARGET + '[observations]\nfiles = ["a[1].csv"]\n')
    assert [file.name for file in study.observations.files] == ["a[1].csv"]


@pytest.mark.parametrize("name", ["APOLLO", "7045", "apollo"])
def test_replaced_station_keeps_its_names_and_its_loading(name, read):
    study = read(TARGET + FILES + f"[stations.{name}]\n{ITRF}")
    catalogued = radioloc.StationCatalogue.default().get("GRASSE")
    ours, theirs = study.catalogue.get("7045"), radioloc.StationCatalogue.default().get("APOLLO")
    assert ours is study.catalogue.get("APOLLO")
    assert ours.itrf_m.tolist() == [-1463998.9085, -5166632.7635, 3435012.8835]
    assert (ours.name, ours.aliases, ours.kind) == (theirs.name, theirs.aliases, theirs.kind)
    assert ours.ocean_loading is theirs.ocean_loading
    assert ours.velocity_m_yr is None
    assert study.catalogue.get("GRASSE") is catalogued
    assert len(study.catalogue) == len(radioloc.StationCatalogue.default())


def test_an_alias_of_a_station_elsewhere_is_refused(read):
    problem = r"\[stations.Ww\] Ww: WARK12M of the catalogue is also called Ww, and stands \d+ km from here"
    with pytest.raises(InputError, match=problem):
        read(TARGET + FILES + f"[stations.Ww]\n{ITRF}")


def test_station_above_the_ellipsoid_in_an_earlier_frame(read):
    text = "[stations.dss24]\nlongitude_deg = 116.191\nlatitude_deg = -31.048\nheight_m = 252.0\nframe = 'ITRF2008'\n"
    station = read(TARGET + FILES + text).catalogue.get("DSS-24")
    itrf_m = radioloc.earth.geodesy.itrf_from_geodetic(np.deg2rad(116.191), np.deg2rad(-31.048), 252.0)
    np.testing.assert_allclose(station.itrf_m, itrf_m, rtol=0.0, atol=1e-9)
    assert (station.frame, station.velocity_m_yr, station.position_sigma_m) == ("ITRF2008", None, 0.01)
    assert station.axis_offset_m == 0.0  # as the catalogue has it


def test_station_epoch_and_velocity(read):
    text = f"[stations.APOLLO]\n{ITRF}velocity_m_yr = [0.02, 0.0, 0.0]\nepoch = 2010\n"
    station = read(TARGET + FILES + text).catalogue.get("7045")
    tt = radioloc.time.epochs_from_strings("2020-01-01T12:00:00", "TT")
    assert station.position_at(tt)[0, 0] - station.itrf_m[0] == pytest.approx(0.2, abs=1e-4)


@pytest.mark.parametrize("content", [TARGET, TARGET + "[observations]\nfiles = []\nextra_sigma_m = 0.1\n"])
def test_a_study_without_files_is_for_observations_made_in_python(content, read):
    refused(
        lambda text: radioloc.compute_residuals(read(text)),
        content,
        "[observations] files is missing; name at least one file",
    )
    ranges = radioloc.read_observations("examples/apollo15/apollo15_apollo_2006-2007.csv")[:3]
    assert len(radioloc.compute_residuals(read(content), ranges).residuals) == 3


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "[target] is missing"),
        ("a = " + "9" * 5000, "not valid TOML"),
        (TARGET.replace("3.5", "3,5"), "'longitude_deg = 3,5'"),
        (TARGET.replace("target", "taget") + FILES, "did you mean 'target'?"),
    ],
)
def test_file_as_a_whole(content, message, read):
    refused(read, content, message)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("3.5", "361", "longitude_deg = 361.0 is not between -360 and 360"),
        ("-1000.0", "1e6", "height_m: expected a lunar height"),
        ("ME_DE421", "IAU", "frame 'IAU' is not known; use PA_DE421 (principal axes) or ME_DE421"),
    ],
)
def test_target(old, new, message, read):
    refused(read, TARGET.replace(old, new) + FILES, "[target] ")
    refused(read, TARGET.replace(old, new) + FILES, message)


def test_cartesian_target(read):
    position = "[1554.6, 98.0, 765.0]"
    refused(read, f"[target]\nposition_m = {position}\n" + FILES, "are the coordinates in metres?")


NO_FILES = """
[""] | 3 | [3] | ["no.csv"] | ["no*.csv"] | ["."] | ["**x"] | ["/"] | ["///"] | ["\\u0000"]
| ["/no/such/*.csv"] | ["..."] | ["[a"] | [["d.csv"]] | {}
"""


@pytest.mark.parametrize("files", [text.strip() for text in NO_FILES.split("|")])
def test_files(files, read):
    refused(read, TARGET + f"[observations]\nfiles = {files}\n", "[observations] files: ")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("start = 2006-10-01T00:00:00+02:00", "start: '2006-10-01T00:00:00+02:00' is not a date"),
        ("start = 3", "start: expected a UTC date, got 3"),
        ('start = "2007-01-01"\nstop = "2006-01-01"', "stop: expected an epoch after the start"),
    ],
)
def test_observations(line, message, read):
    refused(read, TARGET + FILES + line + "\n", "[observations] ")
    refused(read, TARGET + FILES + line + "\n", message)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('range_bias = "some"', 'expected a list of names, "all" or "none"'),
        ("rejection_sigma = 1", "rejection_sigma: expected 2 or more"),
        (
            'height_prior = { height_m = 0, sigma_m = 1, dem = "d.csv" }',
            "[estimate.height_prior] height_m: give either dem or height_m, not both",
        ),
        (
            'height_prior = { height_m = 0, sigma_m = 1, interpolation = "bilinear" }',
            "[estimate.height_prior] interpolation: belongs to a terrain model; name one as dem",
        ),
        ("range_bias_sigma_m = 10", "[estimate] range_bias_sigma_m needs range_bias"),
        ('position = "none"\nheight_prior = { height_m = 0, sigma_m = 1 }', 'needs position = "geographic"'),
    ],
)
def test_estimate(line, message, read):
    refused(read, TARGET + FILES + "[estimate]\n" + line + "\n", message)


def test_delays_of_equipment(read):
    lines = "[model]\ntransponder_delay_s = 1.2e-6\n"
    lines += "station_delay_s = { 7045 = { receive = 2e-8 }, KASHI = { transmit = 3e-8 } }\n"
    delays = read(TARGET + FILES + lines).model.delays
    assert delays.transponder_s == 1.2e-6
    assert dict(delays.stations) == {"APOLLO": StationDelay(receive_s=2e-8), "KASHI": StationDelay(3e-8)}


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("transponder_delay_s = 1.2", "[model] transponder_delay_s: expected 0"),
        ("station_delay_s = { KASHI = 3e-8 }", "[model.station_delay_s.KASHI]: expected a table"),
        ("station_delay_s = { APOLLO = {}, 7045 = {} }", "7045 duplicates APOLLO"),
    ],
)
def test_invalid_delays_are_refused(line, message, read):
    refused(read, TARGET + FILES + "[model]\n" + line + "\n", message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[stations.X]\nlatitude_deg = 5\nheight_m = 3\n",
            "[stations.X] latitude_deg: a position above the ellipsoid is longitude_deg, latitude_deg, height_m",
        ),
        ("[stations.X]\nlatitude_deg = 5\n" + ITRF, "[stations.X] itrf_m: give either itrf_m or longitude"),
        ("[stations.X]\nitrf_m = [1, 2, 3]\n", "[stations.X] station X is 3.74166 m from the geocentre"),
        ("[stations.X]\nepoch = 51544\n" + ITRF, "[stations.X] epoch: expected a Julian year such as 2010.0"),
        ('[stations.X]\naliases = ["7045"]\n' + ITRF, "stations APOLLO and X are both called '7045'"),
    ],
)
def test_stations(text, message, read):
    refused(read, TARGET + FILES + text, message)


def test_examples_are_studies():
    examples = sorted(EXAMPLES.glob("*/*.toml"))
    assert examples
    for example in examples:
        if "[positions." in example.read_text():
            continue  # published positions, for `radioloc compare`
        if example.parent.name in ("images", "stereo"):
            read_image_study(example)
            continue
        study = read_study(str(example))
        if isinstance(study.target, radioloc.LunarPosition):
            assert np.linalg.norm(study.target.xyz_m) == pytest.approx(1.7374e6, rel=0.01)


def test_axes_of_antennas(read):
    text = (
        '[stations.KASHI]\naxis_offset_m = 1.2\nmount = "equatorial"\naliases = ["K9"]\n'
        "[stations.KUNMING]\nitrf_m = [-1281152.0, 5640864.0, 2682653.0]\n"
    )
    catalogue = read(TARGET + FILES + text).catalogue
    kashi, kunming = catalogue["K9"], catalogue["KUNMING"]
    default = radioloc.StationCatalogue.default()
    assert (kashi.name, kashi.axis_offset_m, kashi.mount) == ("KASHI", 1.2, "equatorial")
    assert kashi.quality == "rounded"
    assert kashi.itrf_m.tolist() == default["KASHI"].itrf_m.tolist()
    assert set(default["KASHI"].aliases) < set(kashi.aliases)
    assert kunming.axis_offset_m == -0.0031
    assert kunming.itrf_m[0] == -1281152.0


SITE = "longitude_deg = 3.5\nlatitude_deg = 26.0\nheight_m = -1000.0\n"
TWO = f"[targets.lander]\n{SITE}[targets.rover]\n{SITE.replace('3.5', '3.6')}"


def test_several_targets(read):
    study = read(TWO + FILES)
    assert list(study.targets) == ["lander", "rover"]
    assert study.target is study.targets["lander"]
    assert study.targets["rover"].selenographic[0] == pytest.approx(3.6)
    assert replace(study, name="again").targets == study.targets
    assert read(TARGET + FILES).targets == {}
    assert list(read(f"[targets.AP15]\n{SITE}" + FILES).targets) == ["apollo15"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TARGET + TWO + FILES, "[target] and [targets] exclude each other"),
        (
            TWO + f"[targets.ap15]\n{SITE}[targets.apollo15]\n{SITE}" + FILES,
            "expected different targets, got apollo15",
        ),
        (TWO + FILES + f"[reference]\n{SITE}", "[reference]: expected one position"),
    ],
)
def test_several_targets_are_checked(text, message, read):
    refused(read, text, message)


def test_considered_parameters(read):
    lines = (
        '[estimate]\nrange_bias = ["KASHI"]\n[consider]\nrange_bias = ["APOLLO"]\nrange_bias_sigma_m = 0.5\n'
    )
    study = read(TARGET + FILES + lines + "ut1 = true\nut1_sigma_s = 1e-5\n")
    assert study.consider["range_bias"].names == ("APOLLO",)
    assert (study.consider["ut1"].names, study.consider["ut1"].sigma) == ("all", 1e-5)
    assert read(TARGET + FILES).consider == {}


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("love_numbers = true", "[consider] love_numbers_sigma is missing"),
        ('time_bias = ["A", "B"]\ntime_bias_sigma_s = { A = 1 }', "time_bias_sigma_s of B is missing"),
        ('range_bias = ["7045"]\nrange_bias_sigma_m = 1', "[consider] range_bias: APOLLO is in [estimate]"),
    ],
)
def test_considered_parameters_are_checked(lines, message, read):
    refused(
        read, TARGET + FILES + '[estimate]\nrange_bias = ["APOLLO"]\n[consider]\n' + lines + "\n", message
    )


def test_single_names_and_files_stand_for_lists_of_one():
    choice = ObservationChoice(files="a.csv", targets="apollo15", stations="7045")
    assert choice.files == (Path("a.csv"),)
    assert choice.targets == ("apollo15",)
    assert choice.stations == ("7045",)
    assert ObservationChoice(files=["a", Path("b")], targets=["x"]).files == (Path("a"), Path("b"))
    assert EstimateChoice(range_bias=["A", "B"]).parameters["range_bias"].names == ("A", "B")


def test_a_key_of_a_parameter_can_be_replaced():
    """`dataclasses.replace` changes one key, and what else was chosen stays."""
    choice = EstimateChoice(range_bias="all", range_bias_sigma_m=10.0, range_bias_per="link", clock=["A"])
    looser = replace(choice, range_bias_sigma_m=20.0)
    assert looser == EstimateChoice(
        range_bias="all", range_bias_sigma_m=20.0, range_bias_per="link", clock=["A"]
    )
    free = replace(choice, range_bias_sigma_m=None)
    assert free == EstimateChoice(range_bias="all", range_bias_per="link", clock=["A"])


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"hours": 0.0}, "hours: expected a number above zero"),
        ({"start": 2460432.5}, "start: expected one epoch"),
    ],
)
def test_choice_of_observations_is_checked(fields, message):
    with pytest.raises(InputError, match=message):
        ObservationChoice(**fields)
