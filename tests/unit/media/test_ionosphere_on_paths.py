"""The ionosphere on the legs of radio paths."""

from __future__ import annotations

import numpy as np
import pytest
from arc_cases import epochs_tai
from legs import leg

from radioloc import LunarPosition, Observations
from radioloc.constants import C_M_S
from radioloc.errors import InputError
from radioloc.measurements import ExactPredictor, Link, PhysicalModel
from radioloc.media.ionosphere import (
    Ionosphere,
    UniformTec,
    delay_by_content_m,
    ionosphere_delay_m,
    modified_shell_mapping,
)
from radioloc.media.status import Status
from radioloc.time import tai_to_utc

X_DOWN_HZ, X_UP_HZ = 8.4e9, 7.2e9
LEVER_M = 1e-5
"""A delay of half a metre moves the events by 2 ns, and the rest of the path changes by less than this."""


def predicted(kind, tec, uplink_hz=X_UP_HZ, wavelength_um=C_M_S / X_DOWN_HZ * 1e6, **columns):
    model = PhysicalModel.build(ionosphere=None if tec is None else UniformTec(tec))
    point = LunarPosition.from_selenographic(-51.9, 43.0, -2500.0).to_axes("PA", model.ephemeris.constants)
    observations = Observations.from_columns(
        epoch=tai_to_utc(epochs_tai(3, 2.0, 2459185.5, 0.75)),
        links=[Link("KASHI", "lander", "URUMQI", kind == 1)],
        kind=kind,
        tag=1,
        value_m=1.0,
        sigma_m=1.0,
        uplink_hz=uplink_hz,
        wavelength_um=wavelength_um,
        **columns,
    )
    return ExactPredictor(model, observations, point.xyz_m).compute(point.xyz_m)


def slants(computed, frequencies_hz):
    mapping = modified_shell_mapping(computed.elevation_rad)[0]
    return np.stack(
        [ionosphere_delay_m(20.0 * mapping[:, k], f) for k, f in enumerate(frequencies_hz)], axis=-1
    )


def test_range_is_longer_by_both_legs_at_their_frequencies():
    without, with_it = predicted(0, None), predicted(0, 20.0)
    assert with_it.usable.all()
    expected = slants(with_it, (X_UP_HZ, X_DOWN_HZ)).sum(axis=-1)
    assert 0.2 < expected.min() < expected.max() < 2.0
    assert with_it.value_m - without.value_m == pytest.approx(expected, abs=LEVER_M)


def test_downlink_serves_for_an_uplink_that_was_not_recorded():
    without, with_it = predicted(0, None, np.nan), predicted(0, 20.0, np.nan)
    expected = slants(with_it, (X_DOWN_HZ, X_DOWN_HZ)).sum(axis=-1)
    assert with_it.value_m - without.value_m == pytest.approx(expected, abs=LEVER_M)


def test_delay_is_the_difference_of_two_downlinks():
    without, with_it = predicted(1, None), predicted(1, 20.0)
    first, second = slants(with_it, (X_DOWN_HZ, X_DOWN_HZ)).T
    assert with_it.value_m - without.value_m == pytest.approx(second - first, abs=LEVER_M)
    assert np.abs(second - first).max() > 10 * LEVER_M


def test_doppler_counts_the_phase_which_is_advanced():
    counted = predicted(2, 20.0, count_s=600.0).value_m - predicted(2, None, count_s=600.0).value_m
    group_m = predicted(0, 20.0).value_m - predicted(0, None).value_m
    # The elevations sink or rise one way over two hours, and the group delay with them; the phase goes against it.
    assert (np.sign(counted) == -np.sign(np.gradient(group_m))).all()


def test_a_missing_frequency_is_named():
    computed = predicted(0, 20.0, wavelength_um=np.nan)
    assert computed.status.tolist() == [[Status.OK, Status.NO_FREQUENCY]] * 3


def test_content_that_cannot_be_is_refused():
    with pytest.raises(InputError, match="TECU"):
        UniformTec(-1.0)


def test_delay_by_one_tecu_is_that_of_a_uniform_content():
    changes = {"frequency_hz": [X_UP_HZ, X_DOWN_HZ, X_DOWN_HZ, 5.6e14, np.nan], "phase": [0, 0, 1, 0, 0]}
    changes = {name: np.array(values) for name, values in changes.items()}
    changes["phase"] = changes["phase"] == 1
    some = leg([10.0, 45.0, 90.0, 30.0, 30.0], radio=np.array([True, True, True, False, True]), **changes)
    found = delay_by_content_m(some)
    expected = Ionosphere(UniformTec(1.0)).delay(some, None)
    np.testing.assert_allclose(found[:4], expected.delay_m[:4], rtol=1e-14)
    assert (found[2] < 0.0, found[3]) == (True, 0.0)
    assert np.isnan(found[4])
    assert expected.status.tolist() == [0, 0, 0, 0, Status.NO_FREQUENCY]
