"""The [simulation] tables: what is read, what is refused, and that every key is on its page."""

import re
from pathlib import Path

import numpy as np
import pytest

import radioloc
import radioloc.cli
from radioloc.errors import InputError
from radioloc.measurements.registry import KINDS
from radioloc.parameters.registry import PARAMETERS
from radioloc.simulation import Noise, baselines, one_way
from radioloc.study.schema import TomlTable

PAGE = Path(__file__).resolve().parents[3] / "docs" / "reference" / "simulation.md"
EXAMPLE = re.search(r"```toml\n# simulated.toml\n(.*?)```", PAGE.read_text(), re.DOTALL)[1]


def read(folder, text=EXAMPLE):
    path = folder / "simulated.toml"
    path.write_text(text)
    return radioloc.read_study(path)


def test_what_is_read(tmp_path):
    scenario = read(tmp_path).simulation
    ranging, doppler = scenario.schedule.sessions
    assert ranging.pairs == tuple((a, b) for a in ("JIAMUSI", "KASHI") for b in ("JIAMUSI", "KASHI"))
    assert ranging.one_uplink
    assert doppler.pairs == (("KASHI", "KASHI"),)
    assert ranging.start_utc == "2020-12-01T15:11:00"
    assert scenario.schedule.masks.of("KASHI") == 7.0
    assert scenario.schedule.masks.of("JIAMUSI") == 10.0
    assert scenario.noise.link["range"] == Noise(0.8, 0.5, 3600.0, 0.001, 0.01, 50.0)
    assert scenario.truth.values["clock"].value == {"KASHI": -5e-9}
    assert scenario.truth.values["clock_rate"].value == {"KASHI": 1e-14}
    assert scenario.truth.clock_epoch_utc == "2020-12-01T15:11:00"
    assert scenario.truth.terms_off == ("pole_tide",)
    sigmas = scenario.truth_sigma.sigmas
    assert sigmas["range_bias"].value == 10.0
    assert sigmas["station_position"].value == (0.05, 0.05, 0.1)
    assert scenario.truth_sigma.position_enu_m == (0.0, 0.0, 5.0)
    world = scenario.world(radioloc.measurements.PhysicalModel.build())
    sigma = dict(zip(world.drawn.names, world.drawn.sigmas, strict=True))
    assert sigma["range_bias.JIAMUSI"] == sigma["range_bias.KASHI"] == 10.0
    assert sigma["station_position.KASHI.up"] == 0.1
    assert sigma["position.up"] == 5.0
    assert "position.east" not in sigma
    assert world.errors["clock.KASHI"] == -5e-9


def test_every_key_is_on_the_page(tmp_path, monkeypatch):
    asked = {}
    take = TomlTable.take

    def noted(self, key):
        table = re.sub(r"(sessions|noise)\.\w+$", r"\1", self.name)
        asked.setdefault(table, set()).add(key)
        return take(self, key)

    monkeypatch.setattr(TomlTable, "take", noted)
    read(tmp_path)
    documented = {}
    for line in PAGE.read_text().splitlines():
        if line.startswith("## "):
            names = [re.sub(r"\.(NAME|KIND)$", "", name) for name in re.findall(r"\[([\w.]+)\]", line)]
        elif re.match(r"\| `\w+`", line):
            for name in names:
                documented.setdefault(name, set()).update(re.findall(r"`(\w+)`", line.split("|")[1]))
    of_tables = {"sessions", "noise", "truth", "truth_sigma", "position", "state", "forces"}
    assert asked["simulation"] - of_tables == documented["simulation"]
    whose = {kind.keys["per"] for kind in PARAMETERS.values()}
    both = documented["simulation.truth"] - {"NAME_per"} | whose
    assert {kind.value_key for kind in PARAMETERS.values()} < both
    assert asked["simulation.truth"] == both - {"position_enu_m", "gravity_errors"}
    assert asked["simulation.truth_sigma"] == both - {"terms_on", "terms_off"}
    kinds = {*KINDS, "vlbi_station", "vlbi_station_rate"}
    assert asked["simulation.noise"] - kinds == documented["simulation.noise"]
    sessions = {"kind", "stations"}
    assert sessions < documented["simulation.sessions"]
    assert asked["simulation.sessions"] - {"ranging", "doppler"} == documented["simulation.sessions"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mask_deg = 10.0", "mask = 10.0", r"\[simulation\] 'mask' is not known; did you mean 'mask_deg'"),
        (
            "{ KASHI = 7.0 }",
            "{ KASHI = 7.0, kashi = 8.0 }",
            r"\[simulation\] station_masks_deg: names a station twice",
        ),
        ('links = "all"', 'links = "every"', r"ranging\] links: must be one of .*, not 'every'"),
        ("{ KASHI = -5e-9 }", "{ KASHI = -5e-9, kashi = 1e-9 }", r"KASHI is named twice"),
        ("seed = 1", "seed = -1", r"\[simulation\] seed is -1; give a whole number from zero up"),
        (
            'links = "all"',
            'links = "baselines"',
            r"ranging\] links: 'baselines' does not go with kind 'range'",
        ),
        ("step_s = 600.0", "step_s = 0.0", r"ranging\] step_s is 0.0; give a positive number"),
        ("step_s = 600.0\n", "", r"ranging\] step_s: is missing"),
        ('["JIAMUSI", "KASHI"]', '["JIAMUSI", "KASCHI"]', r"ranging\] stations: .*KASCHI"),
        ("white_m = 0.8", "white = 0.8", r"\[simulation.noise.range\] 'white' is not known"),
        ("white_m = 0.8", "white_m = -0.8", r"\[simulation.noise.range\] noise: white_m is -0.8"),
        ("{ KASHI = 4.2 }", "{ NEUQUEN = 4.2 }", r"range_bias_m: NEUQUEN is in no session"),
        (
            "{ KASHI = 7.0 }",
            "7.0",
            r"station_masks_deg\] must be a table, not 7.0; it is by station, such as",
        ),
        (
            "moon_position_m = [0.1, 0.5, 0.3]",
            "moon_position_m = [0.1, 0.5]",
            r"truth_sigma\] moon_position_m must be 3 numbers \(radial, along, normal\), not \[0.1, 0.5\]$",
        ),
        (
            "electron_content_tecu = 3.0\n",
            "electron_content_tecu = -3.0\n",
            r"truth_sigma\] electron_content_tecu: the sigma is -3.0",
        ),
        ("clock_s = 5e-9", "clock_s = 0.1", r"clock_s: 0.1 is too large for .* at most 0.01 s"),
        ("ut1_s = 2e-5", "ut1 = 2e-5", r"\[simulation.truth\] 'ut1' is not known; did you mean 'ut1_s'"),
        ("one_uplink = true", "one_uplink = 1.5", r"one_uplink: must be true or false"),
    ],
)
def test_mistakes_are_told(tmp_path, old, new, message):
    assert old in EXAMPLE
    with pytest.raises(InputError, match=message):
        read(tmp_path, EXAMPLE.replace(old, new, 1))


def test_delay_rates_of_baselines(tmp_path):
    """Doppler of the example made delay rates, with the noise of their stations."""
    text = EXAMPLE.replace('kind = "doppler"', 'kind = "vlbi_delay_rate"').replace(
        "[simulation.noise.range]",
        "[simulation.noise.vlbi_station_rate]\nwhite_m = 0.002\n\n[simulation.noise.range]",
    )
    text = text.replace('stations = ["KASHI"]', 'stations = ["SESHAN25", "KUNMING", "URUMQI"]')
    scenario = read(tmp_path, text).simulation
    [session] = [s for s in scenario.schedule.sessions if s.kind == "vlbi_delay_rate"]
    assert session.pairs == baselines("SESHAN25", "KUNMING", "URUMQI")
    assert scenario.noise.vlbi_station_rate == Noise(white_m=0.002)
    assert scenario.noise.vlbi_station == Noise()


def test_links_follow_from_the_kind(tmp_path):
    text = EXAMPLE.replace('kind = "doppler"', 'kind = "one_way_doppler"')
    [session] = [s for s in read(tmp_path, text).simulation.schedule.sessions if s.kind == "one_way_doppler"]
    assert session.pairs == one_way("KASHI")


def test_without_files_there_is_nothing_to_locate(tmp_path):
    with pytest.raises(InputError, match="only a simulation"):
        radioloc.locate(read(tmp_path))


def test_any_parameter_of_the_registry_can_be_wrong(tmp_path):
    """A frequency offset by link, and one drawn for all of them."""
    text = EXAMPLE.replace(
        "terms_on = []", 'terms_on = []\nfrequency_offset_value = { "KASHI>lander>KASHI" = 1e-13 }'
    )
    text += "frequency_offset_value = 1e-12\n"
    found = radioloc.simulate(read(tmp_path, text))
    doppler = found.observations.types() == "doppler"
    # An offset scales what is received: the whole count, less by how much the path grows in it.
    received_m = 299792458.0 * 60.0 - found.observations.value_m
    np.testing.assert_allclose(
        found.added_m["frequency_offset"], np.where(doppler, 1e-13 * received_m, 0.0), rtol=1e-10
    )
    assert "frequency_offset_value" in read(tmp_path, text).simulation.truth_sigma.keys


def test_the_command_writes_what_python_simulates(tmp_path, capsys):
    path = tmp_path / "simulated.toml"
    path.write_text(EXAMPLE)
    assert radioloc.cli.main(["simulate", str(path), "--out", str(tmp_path / "a.csv"), "--seed", "7"]) == 0
    assert "seed 7" in capsys.readouterr().out
    written = radioloc.read_observations(tmp_path / "a.csv")
    world = radioloc.simulate(path, seed=7)
    made, drawn = world.observations, radioloc.simulate(path, seed=7, draw_errors=True)
    assert not world.drawn
    assert {"range_bias.KASHI", "position.up"} <= set(drawn.drawn)
    np.testing.assert_allclose(drawn.observations.value_m - drawn.drawn_m, made.value_m, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(written.value_m, made.value_m, rtol=0.0, atol=1e-6)
    assert (written.paths() == made.paths()).all()
