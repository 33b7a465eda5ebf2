"""Osculating elements against SPICE, and partials against differences."""

import numpy as np
import pytest
import spiceypy

from radioloc.dynamics import elements_from_state, state_from_elements
from radioloc.dynamics.elements import equatorial_axes, state_with_partials
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
def test_states_agree_with_spice(elements, axes):
    axis_m, eccentricity, *angles = elements
    inclination, node, periapsis, anomaly = np.radians(angles)
    eccentric = 2.0 * np.arctan(np.sqrt((1.0 - eccentricity) / (1.0 + eccentricity)) * np.tan(0.5 * anomaly))
    mean = eccentric - eccentricity * np.sin(eccentric)
    spices = spiceypy.conics(
        [
            axis_m * (1.0 - eccentricity) / 1e3,
            eccentricity,
            inclination,
            node,
            periapsis,
            mean,
            0.0,
            GM / 1e9,
        ],
        0.0,
    )
    state = state_from_elements(elements, GM, np.eye(3))
    np.testing.assert_allclose(state, np.array(spices) * 1e3, rtol=0, atol=1e-7)
    turned = state_from_elements(elements, GM, axes)
    np.testing.assert_allclose(turned, np.concatenate([state[:3] @ axes, state[3:] @ axes]), atol=1e-8)


@pytest.mark.parametrize("elements", KEPLERIAN)
def test_elements_agree_with_spice(elements):
    state = state_from_elements(elements, GM, np.eye(3))
    periapsis_km, eccentricity, inclination, node, periapsis, mean = spiceypy.oscelt(
        state / 1e3, 0.0, GM / 1e9
    )[:6]
    elements = elements_from_state(state, GM, np.eye(3))
    assert elements[0] * (1.0 - elements[1]) == pytest.approx(1e3 * periapsis_km, abs=1e-6)
    assert elements[1] == pytest.approx(eccentricity, abs=1e-12)
    assert elements[2] == pytest.approx(np.degrees(inclination), abs=1e-10)
    ratio = np.sqrt((1.0 - eccentricity) / (1.0 + eccentricity))
    eccentric = 2.0 * np.arctan(ratio * np.tan(0.5 * np.radians(elements[5])))
    for angle_deg, spice_rad in (
        (elements[3] + elements[4], node + periapsis),
        (np.degrees(eccentric - eccentricity * np.sin(eccentric)), mean),
    ):
        assert (angle_deg - np.degrees(spice_rad) + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("form", ["keplerian", "equinoctial"])
def test_partials_and_round_trip(form, axes):
    state = state_from_elements(KEPLERIAN[0], GM, axes)
    elements = elements_from_state(state, GM, axes, form)
    np.testing.assert_allclose(state_from_elements(elements, GM, axes, form), state, rtol=0, atol=1e-7)
    returned, partials = state_with_partials(elements, GM, axes, form)
    np.testing.assert_allclose(returned, state, rtol=0, atol=1e-7)
    for k, step in enumerate([10.0, 1e-5, 1e-5, 1e-5, 1e-5, 1e-4]):
        ends = [
            state_from_elements(elements + sign * step * np.eye(6)[k], GM, axes, form) for sign in (1, -1)
        ]
        difference = (ends[0] - ends[1]) / (2.0 * step)
        np.testing.assert_allclose(partials[:, k], difference, rtol=0, atol=1e-5 * np.abs(difference).max())


@pytest.mark.parametrize("changes", [{1: 1.5}, {0: -1.8e6}, {0: -1.8e6, 1: 1.5, 5: 180.0}])
def test_partials_of_no_orbit_are_refused(changes):
    elements = np.array([changes.get(k, value) for k, value in enumerate(KEPLERIAN[0])])
    with pytest.raises(InputError, match="ellipse or a point of a hyperbola"):
        state_with_partials(elements, GM, np.eye(3), "keplerian")


def test_elements_of_a_hyperbola_return_its_state():
    state = np.array([2e6, 0.0, 0.0, 100.0, 2500.0, 300.0])
    elements = elements_from_state(state, GM, np.eye(3))
    assert elements[1] > 1.0
    returned, _ = state_with_partials(elements, GM, np.eye(3), "keplerian")
    np.testing.assert_allclose(returned, state, rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    ("changes", "words"),
    [({1: 1.2}, "and 1.2"), ({0: -1.8e6}, "-1.8e\\+06"), ({2: 180.0}, "inclination_deg")],
)
def test_elements_outside_of_ellipses(changes, words):
    elements = [changes.get(k, value) for k, value in enumerate(KEPLERIAN[0])]
    with pytest.raises(InputError, match=words):
        state_from_elements(elements, GM, np.eye(3))
