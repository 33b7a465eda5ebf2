"""Part of a prepared arc is what would be prepared of the part."""

import numpy as np
import pytest
from arc_cases import APOLLO15, LASER, assert_same, epochs_tai, observations

import radioloc
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.registry import KINDS

SAME_M = 1e-6
"""Some roundings of a range of 8e8 m, 1.2e-7 m each: the events may be placed in another number of steps."""


@pytest.fixture(scope="module")
def arc():
    """Ranges, delays and Doppler of five stations, mixed."""
    tai = epochs_tai(7, 6.0)
    ranges = observations("KASHI>x>JIAMUSI", tai, "receive", wavelength_um=35000.0)
    light = observations("APOLLO>x>APOLLO", tai, **LASER)
    delay = observations("SESHAN25<x>URUMQI", tai, "receive", "vlbi_delay")
    doppler = observations("KASHI>x>KASHI", tai, "receive", "doppler", count_s=60.0)
    mixed = radioloc.Observations.concatenate([doppler, ranges, light, delay])
    order = np.random.default_rng(4).permutation(len(mixed))
    return ExactPredictor(radioloc.measurements.PhysicalModel.build(), mixed.select(order), APOLLO15)


@pytest.mark.parametrize("selection", ["mask", "indices", "slice"])
def test_selected_rows_have_the_values_of_the_full_arc(arc, selection):
    rows = {
        "mask": np.arange(len(arc.observations)) % 3 == 1,
        "indices": np.array([20, 3, 11, 4, 27]),
        "slice": slice(5, 19),
    }[selection]
    part, full = arc.select(rows).compute(APOLLO15), arc.compute(APOLLO15)
    assert_same(part, full.rows(rows))


def test_selection_equals_a_new_arc_of_the_rows(arc):
    rows = np.flatnonzero(arc.observations.kind != KINDS.index("range"))
    part = arc.select(rows)
    new = ExactPredictor(arc.model, arc.observations.select(rows), APOLLO15)
    assert part.stations == new.stations == ("KASHI", "SESHAN25", "URUMQI")
    assert (part.transmitters == new.transmitters).all()
    assert (part.receivers == new.receivers).all()
    assert (part.predicted_eop == new.predicted_eop).all()
    assert_same(part.compute(APOLLO15), new.compute(APOLLO15), atol=SAME_M)
