"""Orbits that end on the ground and rest there; partials against differences."""

import numpy as np
import pytest
from descent import TOUCHDOWN, at_rest, thrust_m_s2

from radioloc.dynamics import Acceleration, Forces, GravityField, propagate
from radioloc.ephemeris import LunarOrientation
from radioloc.errors import InputError
from radioloc.lunar import rot_icrf_to_pa
from radioloc.time import epochs_from_strings

EPOCH = epochs_from_strings(TOUCHDOWN, "TDB")
SURFACE_STATE, NORMAL = at_rest(EPOCH)
FIELD = GravityField.open("GRGM660PRIM", 4)
LENGTH_S, STEP_S = 720.0, 60.0


def forces(**changes):
    burns = [
        Acceleration(
            f"burn{k}",
            constant_m_s2=tuple(thrust_m_s2(np.array(STEP_S * (k + 0.5)), LENGTH_S)),
            start=EPOCH.shifted(STEP_S * k - LENGTH_S),
            stop=EPOCH.shifted(STEP_S * (k + 1) - LENGTH_S),
            normal=tuple(NORMAL),
        )
        for k in range(int(LENGTH_S / STEP_S))
    ]
    return Forces(FIELD, accelerations=tuple(burns), gradient_degree=4).with_parameters(changes)


def flown(state=SURFACE_STATE, span_s=(-1500.0, 900.0), parameters=None, **changes):
    return propagate(
        EPOCH, state[:3], state[3:], forces(**changes), span_s, parameters=parameters, touchdown=EPOCH
    )


def states(orbit, times_s):
    return np.concatenate(orbit.states(EPOCH.shifted(np.array(times_s))), axis=-1)


def test_rest_on_the_moon_after_the_touchdown():
    times_s = np.array([0.0, 1.0, 300.0, 900.0])
    computed = states(flown(), times_s)
    epochs = EPOCH.shifted(times_s)
    place_pa_m = np.einsum(
        "nij,nj->ni", rot_icrf_to_pa(LunarOrientation.open().angles(epochs)[0]), computed[:, :3]
    )
    assert np.abs(place_pa_m - place_pa_m[0]).max() < 1e-6
    neighbours = states(flown(), [299.0, 301.0])
    assert computed[2, 3:] == pytest.approx(0.5 * (neighbours[1] - neighbours[0])[:3], abs=1e-6)


@pytest.mark.study
def test_partials_against_differences():
    names = ["burn3.r", "burn3.t", "burn3.n", "burn11.n"]
    times_s, size = [-1500.0, -300.0, -20.0, 400.0], 1e-3
    partials = flown(parameters=names).partials(EPOCH.shifted(np.array(times_s)))
    values = forces().parameters()
    for k, name in enumerate(names):
        ends = [states(flown(**{name: values[name] + sign * size}), times_s) for sign in (1.0, -1.0)]
        differences = (ends[0] - ends[1]) / (2.0 * size)
        assert (
            np.abs(partials[:, :3, 6 + k] - differences[:, :3]).max()
            < 2e-6 * np.abs(differences).max() + 1e-3
        )
    for k in range(6):
        step = np.where(np.arange(6) == k, [10.0] * 3 + [0.01] * 3, 0.0)
        differences = (
            states(flown(SURFACE_STATE + step), times_s) - states(flown(SURFACE_STATE - step), times_s)
        ) / (2.0 * step[k])
        assert np.abs(partials[:, :3, k] - differences[:, :3]).max() < 2e-6 * np.abs(differences).max()
    assert np.abs(partials[3, :, 6:]).max() == 0.0  # after the touchdown only its state matters


def test_earlier_state_leads_to_the_same_touchdown():
    state = states(flown(), [-1500.0])[0]
    epoch = EPOCH.shifted(-1500.0)
    orbit = propagate(
        epoch, state[:3], state[3:], forces(), (0.0, 2000.0), parameters=["burn3.r"], touchdown=EPOCH
    )
    assert np.concatenate(orbit.states(EPOCH), axis=-1)[0] == pytest.approx(SURFACE_STATE, abs=1e-4)
    assert states(orbit, [400.0]) == pytest.approx(states(flown(), [400.0]), abs=1e-4)
    moved = orbit.partials(EPOCH.shifted(400.0))[0]
    assert np.linalg.norm(moved[:3, 0]) > 0.1  # effect of the flight


def test_rest_on_a_pole_without_velocity():
    pole, _ = at_rest(EPOCH, (0.0, -90.0, -1000.0))
    orbit = propagate(
        EPOCH, pole[:3], pole[3:] * 0.0, Forces(FIELD), (-1.0, 100.0), parameters=(), touchdown=EPOCH
    )
    assert np.isfinite(orbit.partials(EPOCH.shifted(50.0))).all()


def test_touchdown_before_the_epoch_is_an_error():
    with pytest.raises(InputError, match="touchdown of orbit"):
        propagate(
            EPOCH, *np.split(SURFACE_STATE, 2), Forces(FIELD), (-10.0, 10.0), touchdown=EPOCH.shifted(-5.0)
        )
