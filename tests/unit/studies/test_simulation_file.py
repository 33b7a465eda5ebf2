"""The [simulation] tables: what is read, what is refused, and that every key is on its page."""

import re
from pathlib import Path

import numpy as np
import pytest

import radioloc
import radioloc.cli
from radioloc.errors import InputError
from radioloc.measurements.registry import KINDS
from radioloc.simulation import Clock, Departure, Noise, Spread, Truth, baselines, departed
from radioloc.studies.toml_table import TomlTable

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
    assert scenario.truth.clock["KASHI"] == Clock(-5e-9, 1e-14, "2020-12-01T15:11:00")
    assert scenario.truth.terms_off == ("pole_tide",)
    sigmas = scenario.spread.sigmas()
    assert sigmas[Departure("range_bias_m", "JIAMUSI")] == 10.0
    assert sigmas[Departure("station_enu_m", "KASHI", 2)] == 0.1
    assert sigmas[Departure("position_enu_m", axis=2)] == 5.0


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
    of_tables = {"sessions", "noise", "truth", "truth_sigma", "position"}
    assert asked["simulation"] - of_tables == documented["simulation"]
    both = documented["simulation.truth"]
    assert asked["simulation.truth"] == both - {"position_enu_m"}
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
        ("seed = 1", "seed = -1", r"\[simulation\] seed: must be a whole number"),
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
        ("{ KASHI = 7.0 }", "7.0", r"station_masks_deg: must be a table by station"),
        ("moon_m = [0.1, 0.5, 0.3]", "moon_m = [0.1, 0.5]", r"truth_sigma\] moon_m: .* three numbers"),
        ("tec_tecu = 3.0\n", "tec_tecu = -3.0\n", r"truth_sigma\] the sigma of tec_tecu JIAMUSI is -3.0"),
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


def test_without_files_there_is_nothing_to_locate(tmp_path):
    with pytest.raises(InputError, match="only a simulation"):
        radioloc.locate(read(tmp_path))


def test_departures_add_to_the_truth():
    truth = Truth(moon_m=(1.0, 2.0, 3.0), clock={"KASHI": Clock(1e-9)}, range_bias_m={"KASHI": 1.0})
    found = departed(
        truth,
        {
            Departure("moon_m", axis=1): 0.5,
            Departure("moon_m", axis=2): -1.0,
            Departure("ut1_s"): 1e-5,
            Departure("clock_s", "KASHI"): 2e-9,
            Departure("clock_rate", "KASHI"): 1e-14,
            Departure("station_enu_m", "JIAMUSI", 2): 0.1,
            Departure("range_bias_m", "JIAMUSI"): 4.0,
            Departure("position_enu_m", axis=0): 7.0,
        },
        "2020-12-01",
    )
    assert found.moon_m == (1.0, 2.5, 2.0)
    assert found.ut1_s == 1e-5
    assert found.clock == {"KASHI": Clock(1e-9 + 2e-9, 1e-14, "2020-12-01")}
    assert found.station_enu_m == {"JIAMUSI": (0.0, 0.0, 0.1)}
    assert found.range_bias_m == {"KASHI": 1.0, "JIAMUSI": 4.0}
    assert departed(truth, {}) == truth


def test_one_departure_more_leaves_the_others():
    few = Spread(ut1_s=1.0, range_bias_m={"KASHI": 1.0}).draw(3)
    more = Spread(ut1_s=2.0, moon_m=(0.0, 1.0, 0.0), range_bias_m={"JIAMUSI": 1.0, "KASHI": 1.0}).draw(3)
    assert set(more) - set(few) == {Departure("moon_m", axis=1), Departure("range_bias_m", "JIAMUSI")}
    assert more[Departure("ut1_s")] == 2.0 * few[Departure("ut1_s")]
    assert more[Departure("range_bias_m", "KASHI")] == few[Departure("range_bias_m", "KASHI")]


def test_drawn_departures_have_their_sigma():
    spread = Spread(position_enu_m=(0.0, 2.0, 5.0))
    drawn = np.array([list(spread.draw(seed).values()) for seed in range(400)])
    # The standard deviation of 400 unit normals lies in 1 +- 0.16 but for 1e-5.
    np.testing.assert_allclose(drawn.std(axis=0) / [2.0, 5.0], 1.0, atol=0.16)
    assert abs(np.corrcoef(drawn.T)[0, 1]) < 0.22


def test_the_command_writes_what_python_simulates(tmp_path, capsys):
    path = tmp_path / "simulated.toml"
    path.write_text(EXAMPLE)
    assert radioloc.cli.main(["simulate", str(path), "--out", str(tmp_path / "a.csv"), "--seed", "7"]) == 0
    assert "seed 7" in capsys.readouterr().out
    written = radioloc.read_observations(tmp_path / "a.csv")
    made = radioloc.simulate(radioloc.read_study(path), seed=7).observations
    np.testing.assert_allclose(written.value_m, made.value_m, rtol=0.0, atol=1e-6)
    assert (written.paths() == made.paths()).all()
