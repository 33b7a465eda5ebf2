"""The [simulation] tables: what is read, what is refused, and that every key is on its page."""

import re

import numpy as np
import pytest
from paths import ROOT

import radioloc
import radioloc.cli
from radioloc.errors import InputError
from radioloc.simulation import Noise, one_way

PAGE = ROOT / "docs" / "reference" / "simulation.md"
EXAMPLE = re.search(r"```toml\n# simulated.toml\n(.*?)```", PAGE.read_text(), re.DOTALL)[1]


def read(folder, text=EXAMPLE):
    path = folder / "simulated.toml"
    path.write_text(text)
    return radioloc.read_study(path)


def test_every_key_is_read(tmp_path):
    scenario = read(tmp_path).simulation
    ranging, doppler = scenario.schedule.sessions
    assert ranging.pairs == tuple((a, b) for a in ("JIAMUSI", "KASHI") for b in ("JIAMUSI", "KASHI"))
    assert ranging.one_uplink
    assert doppler.pairs == (("KASHI", "KASHI"),)
    assert ranging.start_utc == "2020-12-01T15:11:00"
    assert scenario.schedule.masks.for_station("KASHI") == 7.0
    assert scenario.schedule.masks.for_station("JIAMUSI") == 10.0
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


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("{ KASHI = 7.0 }", "{ KASHI = 7.0, kashi = 8.0 }", r"station_masks_deg: names a station twice"),
        ("seed = 1", "seed = -1", r"\[simulation\] seed: .*, got -1"),
        ('["JIAMUSI", "KASHI"]', '["JIAMUSI", "KASCHI"]', r"ranging\] stations: .*KASCHI"),
        ("{ KASHI = 4.2 }", "{ NEUQUEN = 4.2 }", r"range_bias_m: NEUQUEN is in no session"),
    ],
)
def test_mistakes_name_table_and_key(tmp_path, old, new, message):
    assert old in EXAMPLE
    with pytest.raises(InputError, match=message):
        read(tmp_path, EXAMPLE.replace(old, new, 1))


def test_links_follow_from_the_kind(tmp_path):
    text = EXAMPLE.replace('kind = "doppler"', 'kind = "one_way_doppler"')
    [session] = [s for s in read(tmp_path, text).simulation.schedule.sessions if s.kind == "one_way_doppler"]
    assert session.pairs == one_way("KASHI")


def test_locate_without_files_is_refused(tmp_path):
    with pytest.raises(InputError, match="only a simulation"):
        radioloc.locate(read(tmp_path))


def test_any_parameter_of_the_registry_can_be_wrong(tmp_path):
    """A frequency offset by link, and one drawn for all of them."""
    text = EXAMPLE.replace(
        "terms_on = []", 'terms_on = []\nfrequency_offset_value = { "KASHI>lander>KASHI" = 1e-13 }'
    )
    text += "frequency_offset_value = 1e-12\n"
    simulated = radioloc.simulate(read(tmp_path, text))
    doppler = simulated.observations.types() == "doppler"
    # An offset scales what is received: the whole count, less by how much the path grows in it.
    received_m = 299792458.0 * 60.0 - simulated.observations.value_m
    np.testing.assert_allclose(
        simulated.added_m["frequency_offset"], np.where(doppler, 1e-13 * received_m, 0.0), rtol=1e-10
    )
    assert "frequency_offset_value" in read(tmp_path, text).simulation.truth_sigma.keys


TWO_TARGETS = """
[targets.lander]
longitude_deg = -51.9
latitude_deg = 43.0
height_m = -2550.0

[targets.rover]
longitude_deg = -51.8
latitude_deg = 43.1
height_m = -2550.0

[estimate]
height_prior = { height_m = -2550.0, sigma_m = 5.0 }

[simulation]
seed = 1

[simulation.targets.rover.position]
longitude_deg = -51.7990
latitude_deg = 43.1005
height_m = -2550.0

[simulation.sessions.ranging]
kind = "range"
stations = ["JIAMUSI", "KASHI", "NEUQUEN"]
start = 2020-12-01T15:00:00
stop = 2020-12-03T15:00:00
step_s = 1800.0
sigma_m = 1.0

[simulation.sessions.doppler]
kind = "doppler"
targets = ["rover"]
stations = ["KASHI"]
start = 2020-12-01T15:05:00
stop = 2020-12-02T15:05:00
step_s = 1800.0
sigma_m = 0.05
count_s = 60.0

[simulation.noise.range]
white_m = 1.0

[simulation.truth]
range_bias_m = { KASHI = 4.2 }
clock_s = { KASHI = 1e-8 }
clock_rate_s_s = { KASHI = 1e-13 }
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("simulation.targets.rover.position", "simulation.targets.drone.position", "lander, rover"),
        (
            "[simulation.truth]",
            "[simulation.truth_sigma]\ngravity_errors = 3\n[simulation.truth]",
            "gravity_errors",
        ),
    ],
)
def test_unknown_targets_of_a_simulation(old, new, message, tmp_path):
    with pytest.raises(InputError, match=message):
        read(tmp_path, TWO_TARGETS.replace(old, new))
