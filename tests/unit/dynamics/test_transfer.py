"""Transfer from the Earth to the Moon: integration about the Moon against integration about the Earth by scipy."""

import numpy as np
import pytest
from low_orbit import EPOCH, at, forces
from moyer import post_newtonian
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

from radioloc.dynamics import GravityField, propagate
from radioloc.dynamics._force_kernels import EARTH_J2, EARTH_RADIUS_M
from radioloc.ephemeris import Ephemeris
from radioloc.errors import InputError

EPHEMERIS = Ephemeris.open()
GM = EPHEMERIS.constants.gm_m3_s2
END_S = 3.0 * 86400.0
BODIES = ("moon", "sun", "venus", "jupiter", "saturn")


def geocentric(body, time_s):
    return EPHEMERIS.geocentric(body, EPOCH.shifted(time_s))[0][0]


def equations_about_the_earth():
    """Return the equations of motion about the Earth: J2, point masses, relativity."""
    times_s = np.linspace(0.0, END_S, 433)
    tdb = EPOCH.shifted(times_s)
    tracks = {body: make_interp_spline(times_s, EPHEMERIS.geocentric(body, tdb)[0], k=9) for body in BODIES}
    earth = make_interp_spline(times_s, EPHEMERIS.earth(tdb).velocity_m_s, k=9)
    c = np.zeros((3, 3))
    c[2, 0] = -EARTH_J2 / np.sqrt(5.0)
    zero = np.zeros((3, 3))
    oblate = GravityField("J2", GM("earth"), EARTH_RADIUS_M, "ICRF", "unknown", c, zero, zero, zero)
    gm = np.array([0.0, GM("earth"), GM("moon"), GM("sun")])

    def rate(time_s, state):
        r = state[:3]
        pull = -GM("earth") * r / np.linalg.norm(r) ** 3 + oblate.acceleration(r)
        for body, track in tracks.items():
            place = track(time_s)
            to = place - r
            pull += GM(body) * (to / np.linalg.norm(to) ** 3 - place / np.linalg.norm(place) ** 3)
        places = np.array([r, np.zeros(3), tracks["moon"](time_s), tracks["sun"](time_s)])
        speeds = earth(time_s) + np.array(
            [state[3:], np.zeros(3), tracks["moon"](time_s, 1), tracks["sun"](time_s, 1)]
        )
        zeros = np.zeros((4, 3))  # accelerations of the bodies are neglected
        pull += post_newtonian(0, places, speeds, zeros, gm)
        pull -= post_newtonian(0, places[1:], speeds[1:], zeros, gm[1:])
        return np.concatenate([state[3:], pull])

    return rate


def start(speed_m_s):
    """Return a state 40,000 km from the Earth's centre, opposite to the later Moon, with a transverse velocity."""
    moon_m = geocentric("moon", END_S)
    down = -moon_m / np.linalg.norm(moon_m)
    across = np.cross([0.1, 0.2, 1.0], down)
    return np.concatenate([4.0e7 * down, speed_m_s * across / np.linalg.norm(across)])


def about_the_moon(state):
    moon_m, moon_m_s = EPHEMERIS.geocentric("moon", EPOCH)
    return state - np.concatenate([moon_m[0], moon_m_s[0]])


def test_transfer_about_the_moon_and_about_the_earth():
    begin = start(4280.0)
    state = about_the_moon(begin)
    orbit = propagate(EPOCH, state[:3], state[3:], forces(5, k2=0.0), (0.0, END_S))
    solved = solve_ivp(
        equations_about_the_earth(), (0.0, END_S), begin, method="DOP853", rtol=1e-12, atol=1e-4
    )
    assert np.linalg.norm(solved.y[:3, -1]) > 3e8
    end_m = solved.y[:3, -1] - geocentric("moon", END_S)
    # 1 m after three days is 3e-11 m/s^2, the agreement of the forces on the Moon with its motion in the ephemeris.
    assert np.linalg.norm(at(orbit, END_S)[0, :3] - end_m) < 1.0


def test_fall_to_the_earth():
    state = about_the_moon(start(500.0))
    with pytest.raises(InputError, match="ground of the Earth"):
        propagate(EPOCH, state[:3], state[3:], forces(0), (0.0, 86400.0))
