"""Offset and drift of the oscillator by which a target transmits."""

import numpy as np
import pytest
from arc_cases import APOLLO15, epochs_tai, observations

from radioloc.constants import C_M_S
from radioloc.measurements import ExactPredictor, PhysicalModel
from radioloc.parameters.registry import PARAMETERS
from radioloc.parameters.rows import ObservationRows
from radioloc.time import Epochs

COUNT_S = 600.0
TAI = epochs_tai(6, 5.0, start_fraction=0.6)
REFERENCE = Epochs.from_jd(2459185.5, 0.5, "TAI")


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build().without("troposphere")


def column(model, name, kind, tai=TAI, tag="receive"):
    counted = kind == "one_way_doppler"
    table = observations("x>KASHI", tai, tag, kind=kind, count_s=COUNT_S if counted else np.nan)
    arc = ExactPredictor(model, table, APOLLO15)
    rows = ObservationRows(arc, reference=REFERENCE, prediction=arc.predict())
    return PARAMETERS[name].partials(rows)[:, 0, 0], rows.computed


def test_drift_grows_with_the_square_of_time(model):
    drift, computed = column(model, "target_frequency_rate", "one_way_range")
    sent_s = TAI.seconds_since(REFERENCE) - computed.value_m / C_M_S
    assert drift == pytest.approx(-0.5 * C_M_S * sent_s**2, rel=1e-12)


@pytest.mark.parametrize("tag", ["receive", "transmit"])
@pytest.mark.parametrize("name", ["target_frequency", "target_frequency_rate"])
def test_partials_of_counts_are_changes_over_the_interval(model, name, tag):
    """Difference of ranges at the ends of the interval, which the target's clock counts where it reads the tag."""
    early, late = (
        column(model, name, "one_way_range", TAI.shifted(half_s), tag)[0]
        for half_s in (-0.5 * COUNT_S, 0.5 * COUNT_S)
    )
    counted, _ = column(model, name, "one_way_doppler", tag=tag)
    # Since the transmission or the tag, a drift of the offset over 1.3 s of hours.
    assert counted == pytest.approx(late - early, rel=3e-4 if name.endswith("rate") else 1e-6)
