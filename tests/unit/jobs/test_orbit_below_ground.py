"""A-priori orbits that meet the ground: the fit starts from them, and only its estimate is tested."""

import numpy as np
import pytest
from tracked_orbit import STATE, craft, tracked

import radioloc
from radioloc.dynamics import Forces, GravityField
from radioloc.errors import InputError
from radioloc.measurements import PhysicalModel


@pytest.fixture(scope="module")
def forces():
    return Forces(GravityField.open("GRGM660PRIM", 20), gradient_degree=20)


@pytest.fixture(scope="module")
def doppler(forces):
    return tracked(PhysicalModel.build(), forces, 2e-4)[0]


def slower(forces, part):
    """An orbit whose perilune is lower by 4 a for each part of the velocity."""
    return study(craft(np.concatenate([STATE[:3], (1.0 - part) * STATE[3:]]), forces))


def study(target):
    return radioloc.Study(target, consider_defaults=False, name="orbit")


def test_a_fit_starts_from_an_orbit_that_meets_the_ground(forces, doppler):
    """The perilune of the a-priori orbit is 54 km below the mean sphere."""
    solution = radioloc.locate(slower(forces, 0.015), doppler)
    assert solution.converged
    error = np.concatenate([solution.state.position_m, solution.state.velocity_m_s]) - STATE
    assert error @ np.linalg.solve(solution.state.covariance, error) < 22.5


@pytest.mark.parametrize(("job", "part"), [("residuals", 0.015), ("locate", 0.1)])
def test_an_orbit_that_ends_or_is_too_deep_below_the_ground_is_refused(forces, doppler, job, part):
    with pytest.raises(InputError, match="craft comes down to the ground of the Moon at 2012-04-09T0"):
        getattr(radioloc, job)(slower(forces, part), doppler)
