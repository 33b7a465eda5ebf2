"""Light times of other programs, with which `make bench` compares, for the same link as the model without its terms."""

import numpy as np
import others
import pytest
from arc_cases import observations
from change5_case import LANDER, RANGING

import radioloc
from radioloc.measurements import TERMS, FixedPoint
from radioloc.time import Epochs
from radioloc.time.scales import tdb_to_tt, tt_to_tai


@pytest.mark.study
@pytest.mark.parametrize(
    ("program", "tolerance_m"),
    [
        (others.SpiceLoop, 2e4),  # IAU_EARTH: without nutation and UT1
        (others.Skyfield, 10.0),  # the pole and the rotation of its own tables
        (others.Astropy, 2.0 * 1.8e6),  # centre of the Moon
    ],
)
def test_other_programs_model_the_same_link(program, tolerance_m, tmp_path):
    model = radioloc.measurements.PhysicalModel.build(off=TERMS)
    sender, receiver = (model.catalogue.get(name).itrf_m for name in RANGING[1::-1])
    place_pa_m = LANDER.to_axes("PA", model.ephemeris.constants).xyz_m
    tdb_s = 6.6e8 + np.arange(12) * 1800.0
    table = observations(
        f"{RANGING[1]}>x>{RANGING[0]}", tt_to_tai(tdb_to_tt(Epochs.from_tdb_seconds(tdb_s))), "receive"
    )
    own_m = radioloc.measurements.ExactPredictor(model, table, FixedPoint(place_pa_m)).compute().value_m
    geometry = program(tmp_path)
    other_m = geometry.three_way_m(sender, place_pa_m, receiver, tdb_s)
    geometry.close()
    assert np.abs(own_m - other_m).max() < tolerance_m
