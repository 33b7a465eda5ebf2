"""Studies on Tracking Data Messages: what they leave to be agreed is said in the study file."""

import numpy as np
import pytest
from arc_cases import epochs_tai

import radioloc
from radioloc.errors import InputError
from radioloc.io.tdm import write_tdm
from radioloc.measurements import FixedPoint
from radioloc.measurements.registry import KINDS
from radioloc.time import tai_to_utc

TARGET = 'frame = "ME_DE421"\nlongitude_deg = -51.9\nlatitude_deg = 43.0\nheight_m = -2550.0\n'
SAME_POINT_M = 1e-3
"""A whole round trip through the file: its ranges carry every bit."""


def simulated_ranges(kind, ends):
    """A point on the Moon and what is measured of it on the hour for ten days: observations of one type."""
    model = radioloc.measurements.PhysicalModel.build()
    point = radioloc.LunarPosition.from_selenographic(-51.9162, 43.0584, -2550.4)
    point = point.to_axes("PA", model.ephemeris.constants)
    links = [radioloc.measurements.Link(a, "lander", b) for a, b in ends]
    epoch = tai_to_utc(epochs_tai(240, 12.0, 2459185.5))
    link = np.arange(240) % len(links)
    changes = {"links": links, "kind": KINDS.index(kind), "tag": 1, "sigma_m": 1.0}
    empty = radioloc.Observations.from_columns(
        epoch=epoch, link=link, value_m=1.0, wavelength_um=35000.0, **changes
    )
    arc = radioloc.measurements.ExactPredictor(model, empty, FixedPoint(point.xyz_m))
    computed = arc.compute()
    visible = computed.usable
    observations = radioloc.Observations.from_columns(
        epoch=epoch[visible], link=link[visible], value_m=computed.value_m[visible], **changes
    )
    return point, observations


@pytest.fixture(scope="module")
def truth():
    return simulated_ranges("range", [(a, b) for a in ("KASHI", "JIAMUSI") for b in ("KASHI", "JIAMUSI")])


def study_of(folder, **keys):
    lines = "\n".join(f"{key} = {value}" for key, value in keys.items())
    path = folder / "study.toml"
    path.write_text(f'[target]\n{TARGET}\n[observations]\nfiles = ["data.kvn"]\n{lines}\n')
    return radioloc.read_study(path)


def test_ranges_of_a_message_locate_the_lander(truth, tmp_path):
    point, observations = truth
    write_tdm(tmp_path / "data.kvn", observations, originator="TEST")
    solution = radioloc.locate(study_of(tmp_path, sigma_m="{ range = 1.0 }"))
    assert solution.converged
    assert np.linalg.norm(solution.position_pa_m - point.xyz_m) < SAME_POINT_M


def test_without_a_sigma_nothing_is_guessed(truth, tmp_path):
    write_tdm(tmp_path / "data.kvn", truth[1], originator="TEST")
    with pytest.raises(InputError, match=r"\[observations\] sigma_m"):
        radioloc.locate(study_of(tmp_path))


def test_what_a_message_leaves_open_is_said_in_the_study(truth, tmp_path):
    write_tdm(tmp_path / "data.kvn", truth[1], originator="TEST")
    output = study_of(
        tmp_path,
        tdm_turnaround="[880, 749]",
        tdm_delays_removed="true",
        tdm_apply_clocks="false",
        tdm_range_unit_s="1e-9",
    ).observations.tdm
    assert (output.turnaround, output.delays_removed, output.apply_clocks) == ((880, 749), True, False)
    assert output.range_unit_s == 1e-9
