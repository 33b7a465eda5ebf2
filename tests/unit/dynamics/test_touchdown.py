"""An orbit that ends on the ground, which carries it on; partials against differences."""

import numpy as np
import pytest
from descent import TOUCHDOWN, at_rest, thrust_m_s2

from radioloc.dynamics import Acceleration, Forces, GravityField, propagate
from radioloc.ephemeris import LunarOrientation
from radioloc.errors import InputError
from radioloc.lunar import rot_icrf_to_pa
from radioloc.time import epochs_from_strings

EPOCH = epochs_from_strings(TOUCHDOWN, "TDB")
REST, NORMAL = at_rest(EPOCH)
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


def flown(state=REST, span_s=(-1500.0, 900.0), parameters=None, **changes):
    return propagate(
        EPOCH, state[:3], state[3:], forces(**changes), span_s, parameters=parameters, touchdown=EPOCH
    )


def states(orbit, times_s):
    epochs = EPOCH.shifted(np.array(times_s))
    return np.concatenate(orbit.states(epochs), axis=-1)


def test_after_the_touchdown_it_keeps_its_place_on_the_moon():
    times_s = np.array([0.0, 1.0, 300.0, 900.0])
    found = states(flown(), times_s)
    epochs = EPOCH.shifted(times_s)
    place_pa_m = np.einsum(
        "nij,nj->ni", rot_icrf_to_pa(LunarOrientation.open().angles(epochs)[0]), found[:, :3]
    )
    assert np.abs(place_pa_m - place_pa_m[0]).max() < 1e-6
    along = states(flown(), [299.0, 301.0])
    assert found[2, 3:] == pytest.approx(0.5 * (along[1] - along[0])[:3], abs=1e-6)


@pytest.mark.study
def test_partials_are_those_of_differences():
    names = ["burn3.r", "burn3.t", "burn3.n", "burn11.n"]
    times_s, size = [-1500.0, -300.0, -20.0, 400.0], 1e-3
    partials = flown(parameters=names).partials(EPOCH.shifted(np.array(times_s)))
    known = forces().parameters()
    for k, name in enumerate(names):
        ends = [states(flown(**{name: known[name] + sign * size}), times_s) for sign in (1.0, -1.0)]
        differences = (ends[0] - ends[1]) / (2.0 * size)
        assert (
            np.abs(partials[:, :3, 6 + k] - differences[:, :3]).max()
            < 2e-6 * np.abs(differences).max() + 1e-3
        )
    for k in range(6):
        step = np.where(np.arange(6) == k, [10.0] * 3 + [0.01] * 3, 0.0)
        differences = (states(flown(REST + step), times_s) - states(flown(REST - step), times_s)) / (
            2.0 * step[k]
        )
        assert np.abs(partials[:, :3, k] - differences[:, :3]).max() < 2e-6 * np.abs(differences).max()
    assert np.abs(partials[3, :, 6:]).max() == 0.0  # after the touchdown only the state there counts


def test_a_state_before_leads_to_the_same_touchdown():
    before = states(flown(), [-1500.0])[0]
    epoch = EPOCH.shifted(-1500.0)
    again = propagate(
        epoch, before[:3], before[3:], forces(), (0.0, 2000.0), parameters=["burn3.r"], touchdown=EPOCH
    )
    assert np.concatenate(again.states(EPOCH), axis=-1)[0] == pytest.approx(REST, abs=1e-4)
    assert states(again, [400.0]) == pytest.approx(states(flown(), [400.0]), abs=1e-4)
    moved = again.partials(EPOCH.shifted(400.0))[0]
    assert np.linalg.norm(moved[:3, 0]) > 0.1  # the ground carries on what the flight led to


def test_what_rests_on_a_pole_has_no_velocity():
    pole, _ = at_rest(EPOCH, (0.0, -90.0, -1000.0))
    orbit = propagate(
        EPOCH, pole[:3], pole[3:] * 0.0, Forces(FIELD), (-1.0, 100.0), parameters=(), touchdown=EPOCH
    )
    assert np.isfinite(orbit.partials(EPOCH.shifted(50.0))).all()


def test_a_touchdown_before_the_epoch_is_refused():
    with pytest.raises(InputError, match="before the epoch of its state"):
        propagate(EPOCH, REST[:3], REST[3:], Forces(FIELD), (-10.0, 10.0), touchdown=EPOCH.shifted(-5.0))
