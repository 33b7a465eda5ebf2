"""Studies of received frequencies whose sender is not published: three-way Doppler of a lander in files of STRF."""

from __future__ import annotations

import numpy as np
import pytest

import radioloc
from radioloc.constants import C_M_S
from radioloc.io import read_sites
from radioloc.measurements import ExactPredictor, Link, PhysicalModel
from radioloc.measurements.observations import DOPPLER, Observations
from radioloc.search import search
from radioloc.time import epochs_from_strings

UPLINK_HZ, RATIO, COUNT_S, NOISE_HZ = 7.1893e9, 880 / 749, 10.0, 0.5
# Each pass has its own offset, Hz: the uplink is not known to better.
PASSES = {"JIAMUSI": ("2020-12-02T14", 170.0), "NEUQUEN": ("2020-12-03T03", -260.0)}
SITES = "# No ID   Latitude Longitude   Elev   Observer\n8049 XX   49.4348 -123.6685     40    A dish\n"
STUDY = """
[target]
longitude_deg = -51.0
latitude_deg = 43.5
height_m = -2550.0
[observations]
files = ["*.dat"]
sites = ["sites.txt"]
transmitters = ["KASHI", "JIAMUSI", "NEUQUEN"]
[[observations.frequencies]]
transmit_hz = 7.1893e9
transmitter = "KASHI"
turnaround = [880, 749]
count_s = 10
sigma_hz = 0.5
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A file of two passes at one dish, of which two stations were the senders."""
    folder = tmp_path_factory.mktemp("strf")
    (folder / "sites.txt").write_text(SITES)
    (folder / "study.toml").write_text(STUDY)
    catalogue = radioloc.StationCatalogue.default()
    for site in read_sites(folder / "sites.txt"):
        catalogue = catalogue.with_station(site)
    model = PhysicalModel.build(catalogue=catalogue)
    place_m = radioloc.LunarPosition.from_selenographic(-51.916, 43.058, -2550.0).to_frame("PA_DE421").xyz_m
    random, lines = np.random.default_rng(4), []
    for station, (hour, offset_hz) in PASSES.items():
        counts = Observations.from_columns(
            epoch=epochs_from_strings([f"{hour}:{minute:02d}:00" for minute in range(60)]),
            links=[Link(station, "lander", "COSPAR 8049")],
            kind=DOPPLER,
            tag=1,
            value_m=0.0,
            sigma_m=1.0,
            count_s=COUNT_S,
            wavelength_um=1e6 * C_M_S / (RATIO * UPLINK_HZ),
            uplink_hz=UPLINK_HZ,
        )
        computed = ExactPredictor(model, counts, place_m).compute(place_m)
        assert computed.usable.all()
        received_hz = RATIO * UPLINK_HZ * (1.0 - computed.value_m / (C_M_S * COUNT_S)) + offset_hz
        received_hz += random.normal(0.0, NOISE_HZ, 60)
        mjd = counts.epoch.jd - 2400000.5 + counts.epoch.fraction
        lines += [
            f"{day:.6f}\t{f:14.3f}\t{1.0:8.3f}\t8049\n" for day, f in zip(mjd, received_hz, strict=True)
        ]
    (folder / "two_passes.dat").write_text("".join(lines))
    return folder


def test_who_sent_is_found(folder):
    """The file names nobody; the study says any of the candidates."""
    completed = search(folder / "study.toml").write(folder / "completed.toml")
    solution = radioloc.residuals(completed)
    assert set(solution.residuals.path) == {f"{station}>lander>COSPAR 8049" for station in PASSES}
    for station in PASSES:
        mine = solution.residuals.path == f"{station}>lander>COSPAR 8049"
        hertz = RATIO * UPLINK_HZ / (C_M_S * COUNT_S) * solution.residuals.residual_m[mine]
        # About its offset the pass is as quiet as its readings, but for the a-priori position, 40 km off.
        assert np.std(hertz) < 4.0 * NOISE_HZ
        assert np.mean(hertz) == pytest.approx(-PASSES[station][1], abs=20.0)
