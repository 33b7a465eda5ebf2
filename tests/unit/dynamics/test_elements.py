"""Elements of orbits against SPICE's, and their partials against differences."""

import numpy as np
import pytest
import spiceypy

from radioloc.dynamics import elements_of_state, state_of_elements
from radioloc.dynamics.elements import FORMS, equatorial_axes, state_by_elements
from radioloc.ephemeris import LunarOrientation
from radioloc.errors import InputError
from radioloc.time import epochs_from_strings

GM = 4.902800076e12
KEPLERIAN = [
    [1792.8e3, 0.004, 88.8, 114.8, 200.0, 310.0],
    [6.2e6, 0.7, 12.0, 350.0, 90.0, 170.0],
    [1.9e6, 0.05, 0.0, 0.0, 40.0, 10.0],
    [2.5e6, 0.2, 152.0, 10.0, 359.0, 0.0],
]
EPOCH = epochs_from_strings("2012-04-09T04:30:00", "TDB")


@pytest.fixture(scope="module", name="axes")
def _axes():
    return equatorial_axes(LunarOrientation.open("DE421"), EPOCH)


@pytest.mark.parametrize("elements", KEPLERIAN)
def test_states_are_spices(elements, axes):
    axis_m, size, *angles = elements
    inclination, node, periapsis, anomaly = np.radians(angles)
    eccentric = 2.0 * np.arctan(np.sqrt((1.0 - size) / (1.0 + size)) * np.tan(0.5 * anomaly))
    mean = eccentric - size * np.sin(eccentric)
    spices = spiceypy.conics(
        [axis_m * (1.0 - size) / 1e3, size, inclination, node, periapsis, mean, 0.0, GM / 1e9], 0.0
    )
    state = state_of_elements(elements, GM, np.eye(3))
    np.testing.assert_allclose(state, np.array(spices) * 1e3, rtol=0, atol=1e-7)
    turned = state_of_elements(elements, GM, axes)
    np.testing.assert_allclose(turned, np.concatenate([state[:3] @ axes, state[3:] @ axes]), atol=1e-8)


@pytest.mark.parametrize("elements", KEPLERIAN)
def test_elements_are_spices(elements):
    state = state_of_elements(elements, GM, np.eye(3))
    lowest_km, size, inclination, node, periapsis, mean = spiceypy.oscelt(state / 1e3, 0.0, GM / 1e9)[:6]
    axis_m, own_size, own_inclination, own_node, own_periapsis, own_anomaly = elements_of_state(
        state, GM, np.eye(3)
    )
    assert axis_m * (1.0 - own_size) == pytest.approx(1e3 * lowest_km, abs=1e-6)
    assert own_size == pytest.approx(size, abs=1e-12)
    assert own_inclination == pytest.approx(np.degrees(inclination), abs=1e-10)
    eccentric = 2.0 * np.arctan(np.sqrt((1.0 - size) / (1.0 + size)) * np.tan(0.5 * np.radians(own_anomaly)))
    for own, other in (
        (own_node + own_periapsis, np.degrees(node + periapsis)),
        (np.degrees(eccentric - size * np.sin(eccentric)), np.degrees(mean)),
    ):
        assert (own - other + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("form", ["keplerian", "equinoctial"])
def test_partials_are_differences_and_elements_come_back(form, axes):
    state = state_of_elements(KEPLERIAN[0], GM, axes)
    elements = elements_of_state(state, GM, axes, form)
    np.testing.assert_allclose(state_of_elements(elements, GM, axes, form), state, rtol=0, atol=1e-7)
    same, partials = state_by_elements(elements, GM, axes, form)
    np.testing.assert_allclose(same, state, rtol=0, atol=1e-7)
    for k, step in enumerate([10.0, 1e-5, 1e-5, 1e-5, 1e-5, 1e-4]):
        ends = [state_of_elements(elements + sign * step * np.eye(6)[k], GM, axes, form) for sign in (1, -1)]
        difference = (ends[0] - ends[1]) / (2.0 * step)
        np.testing.assert_allclose(partials[:, k], difference, rtol=0, atol=1e-5 * np.abs(difference).max())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({1: 1.2}, "eccentricity 1.2 is no ellipse"),
        ({0: -1.8e6}, "semi_major_axis_m -1.8e\\+06 .* no ellipse"),
        ({2: 180.0}, "inclination_deg must be from 0 to less than 180"),
    ],
)
def test_elements_that_are_no_ellipse(changes, message):
    elements = [changes.get(k, value) for k, value in enumerate(KEPLERIAN[0])]
    with pytest.raises(InputError, match=message):
        state_of_elements(elements, GM, np.eye(3))


@pytest.mark.parametrize(
    "state",
    [[1.8e6, 0.0, 0.0, 0.0, -1650.0, 0.0], [1.8e6, 0.0, 0.0, 100.0, 0.0, 0.0], [0.0] * 6, [np.nan] * 6],
    ids=["against the axes", "no plane", "at the centre", "no numbers"],
)
@pytest.mark.parametrize("form", FORMS)
def test_a_state_without_elements(state, form):
    with pytest.raises(InputError, match="has no osculating elements"):
        elements_of_state(state, GM, np.eye(3), form)


def test_forms_and_numbers_of_elements():
    with pytest.raises(InputError, match="form 'Keplerian' is not known; use keplerian or equinoctial"):
        elements_of_state([1.8e6, 0.0, 0.0, 0.0, 1650.0, 0.0], GM, np.eye(3), "Keplerian")
    with pytest.raises(InputError, match="form 'delaunay' is not known"):
        state_of_elements(KEPLERIAN[0], GM, np.eye(3), "delaunay")
    for form in FORMS:
        with pytest.raises(InputError, match="six finite numbers"):
            state_of_elements([1.8e6], GM, np.eye(3), form)
