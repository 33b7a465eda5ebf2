"""Integration against two bodies, Encke's method, energy, finer steps and scipy; partials against differences."""

import astropy.units as u
import numpy as np
import pytest
from low_orbit import EPOCH, POSITION_M, STATE, TWO_BODY, VELOCITY_M_S, at, forces, propagated
from scipy.integrate import simpson, solve_ivp
from scipy.optimize import brentq

from radioloc.dynamics import Acceleration, Impulse, acceleration_sizes, propagate
from radioloc.dynamics._force_kernels import accelerations, quantities
from radioloc.dynamics.accelerations import body_table, force_data
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.errors import ConvergenceError, CoverageError, InputError
from radioloc.lunar import rot_icrf_to_pa
from radioloc.lunar.frames import angular_velocity_pa

DAY_S = 86400.0
GM_M3_S2 = Ephemeris.open().constants.gm_moon_m3_s2
STEP_ERROR_M = 2e-3  # after a day of steps with errors of 1e-7 m, which grow along the orbit
PARTIALS_TOLERANCE = 1e-6  # relative


def kepler(state, gm, time_s):
    """Return the state of a two-body orbit by Kepler's equation."""
    r, v = state[:3], state[3:]
    h = np.cross(r, v)
    e = np.cross(v, h) / gm - r / np.linalg.norm(r)
    eccentricity = np.linalg.norm(e)
    a = 1.0 / (2.0 / np.linalg.norm(r) - v @ v / gm)
    p = e / eccentricity
    q = np.cross(h / np.linalg.norm(h), p)
    ratio = np.sqrt(1.0 - eccentricity**2)
    begin = np.arctan2(r @ q / (a * ratio), r @ p / a + eccentricity)
    mean = begin - eccentricity * np.sin(begin) + np.sqrt(gm / a**3) * time_s
    u = brentq(
        lambda anomaly: anomaly - eccentricity * np.sin(anomaly) - mean,
        mean - 1.0,
        mean + 1.0,
        xtol=1e-14,
        rtol=1e-15,
    )
    rate = np.sqrt(gm / a**3) / (1.0 - eccentricity * np.cos(u))
    place = a * (np.cos(u) - eccentricity) * p + a * ratio * np.sin(u) * q
    return np.concatenate([place, a * rate * (-np.sin(u) * p + ratio * np.cos(u) * q)])


def test_two_body_orbit():
    orbit = propagated(forces(0, **TWO_BODY), (-DAY_S, DAY_S))
    for time_s in (-DAY_S, -0.37 * DAY_S, 1234.5, DAY_S):
        error_m = np.linalg.norm(at(orbit, time_s)[0, :3] - kepler(STATE, GM_M3_S2, time_s)[:3])
        assert error_m < STEP_ERROR_M


def test_times_and_quantities():
    time = EPOCH.to_time().utc
    model = forces(0, **TWO_BODY)
    state = POSITION_M / 1e3 * u.km, VELOCITY_M_S / 1e3 * u.km / u.s
    orbit = propagate(time, *state, model, (0.0 * u.min, 10.0 * u.min), tolerance_m=1.0 * u.mm)
    expected = at(propagated(model, (0.0, 600.0)), 300.0)[0]
    computed = np.concatenate(orbit.states(time + 5.0 * u.min), axis=-1)[0]
    np.testing.assert_allclose(computed, expected, rtol=1e-9)
    assert Impulse("burn", time).epoch.seconds_since(EPOCH)[0] == pytest.approx(0.0, abs=1e-8)
    sizes = acceleration_sizes(time, 100.0 * u.km, model)
    assert sizes["central"] == pytest.approx(acceleration_sizes(EPOCH, 1e5, model)["central"])


def test_steps_without_convergence_are_shortened():
    """Steps of a loose tolerance are too long near the pericentre of an eccentric orbit."""
    state = np.array([1.75e6, 0.0, 0.0, 0.0, 0.0, 2300.0])
    orbit = propagated(forces(0, **TWO_BODY), (0.0, 5 * DAY_S), state, tolerance_m=10.0)
    for time_s in (3600.0, 3.3 * DAY_S, 5 * DAY_S):
        assert np.linalg.norm(at(orbit, time_s)[0, :3] - kepler(state, GM_M3_S2, time_s)[:3]) < 0.1


def test_infinite_accelerations_end_the_integration():
    thrust = Acceleration("burn", constant_m_s2=(1e200, 0.0, 0.0), start=EPOCH.shifted(60.0))
    with pytest.raises(ConvergenceError, match=r"failed at 2012-04-09T04:31:00\.000"):
        propagated(forces(0, accelerations=(thrust,)), (0.0, 600.0))


def test_energy_in_the_field_of_the_rotating_moon():
    """The rate of E - w . L is -dw/dt . L, with the angular velocity w of the Moon."""
    gravity_only = TWO_BODY | {"gm_m3_s2": GM_M3_S2}
    field = forces(50, **gravity_only)
    times_s = np.linspace(0.0, 0.5 * DAY_S, 2001)
    states = at(propagated(field, (0.0, times_s[-1])), times_s)
    angles, rates = LunarOrientation.open().angles(EPOCH.shifted(times_s))
    rot = rot_icrf_to_pa(angles)
    spin = np.einsum("nji,nj->ni", rot, angular_velocity_pa(angles, rates))
    potential = field.gravity.potential(np.einsum("nij,nj->ni", rot, states[:, :3]))
    potential *= GM_M3_S2 / field.gravity.gm_m3_s2
    momentum = np.cross(states[:, :3], states[:, 3:])
    energy = 0.5 * (states[:, 3:] ** 2).sum(1) - potential
    jacobi = energy - (spin * momentum).sum(1)
    rate = -(np.gradient(spin, times_s, axis=0) * momentum).sum(1)
    work = simpson(rate, x=times_s)
    assert abs(energy[-1] - energy[0]) > 0.1  # m^2/s^2
    assert jacobi[-1] - jacobi[0] == pytest.approx(work, abs=1e-6)


def test_orbit_against_enckes_method():
    """Deviations from a two-body orbit, integrated by scipy: another formulation and integrator."""
    model = forces(10, radiation_m2_kg=0.02)
    end_s = 7200.0
    gm = GM_M3_S2
    data = force_data(model, Ephemeris.open(), LunarOrientation.open(), EPOCH, (0.0, end_s), STATE)

    def rate(time_s, deviation):
        reference = kepler(STATE, gm, time_s)
        state = reference + deviation
        parts = accelerations(state[:3], state[3:], quantities(time_s, data), data)
        perturbation = data.scales[1:] @ parts[1:]
        distance = np.linalg.norm(reference[:3])
        q = deviation[:3] @ (deviation[:3] - 2.0 * state[:3]) / (state[:3] @ state[:3])
        f = q * (3.0 + 3.0 * q + q * q) / (1.0 + (1.0 + q) ** 1.5)
        return np.concatenate(
            [deviation[3:], perturbation - gm / distance**3 * (f * state[:3] + deviation[:3])]
        )

    solved = solve_ivp(rate, (0.0, end_s), np.zeros(6), method="RK45", rtol=1e-9, atol=1e-6)
    encke = kepler(STATE, gm, end_s) + solved.y[:, -1]
    final = at(propagated(model, (0.0, end_s)), end_s)[0]
    assert np.linalg.norm(solved.y[:3, -1]) > 1000.0
    assert np.linalg.norm(final[:3] - encke[:3]) < 1e-4


@pytest.mark.study
def test_default_tolerance_against_finer_steps():
    model = forces(100, radiation_m2_kg=0.01)
    times_s = np.linspace(0.0, 4 * 3600.0, 500)
    coarse, fine = (
        at(propagated(model, (0.0, 4 * 3600.0), tolerance_m=tolerance_m), times_s)
        for tolerance_m in (1e-7, 1e-10)
    )
    assert np.linalg.norm((coarse - fine)[:, :3], axis=1).max() < 2e-5
    assert np.linalg.norm((coarse - fine)[:, 3:], axis=1).max() < 2e-8


MANOEUVRES = {
    "accelerations": (
        Acceleration("empirical", "RTN", (1e-8, -2e-8, 1e-8), (3e-8, 0.0, 1e-8), (0.0, 1e-8, -2e-8)),
        Acceleration(
            "burn", "RTN", (0.1, -0.4, 0.2), start=EPOCH.shifted(1800.0), stop=EPOCH.shifted(1860.0)
        ),
        Acceleration("fixed", "ICRF", (0.0, 1e-7, 0.0), start=EPOCH.shifted(-3000.0)),
    ),
    "impulses": (
        Impulse("earlier", EPOCH.shifted(-1500.0), (0.5, -1.0, 2.0)),
        Impulse("after", EPOCH.shifted(2400.0), (1.0, 2.0, -1.0), "ICRF"),
        Impulse("turned", EPOCH.shifted(2500.0), (-1.0, 2.0, 3.0)),
    ),
}
STEPS = {"gm": 1e6, "k2": 1.0, "radiation": 10.0}
TIMES_S = np.array([-3600.0, -1000.0, 1830.0, 3600.0])


@pytest.fixture(scope="module")
def model():
    return forces(15, gm_m3_s2=GM_M3_S2, radiation_m2_kg=0.02, gradient_degree=15, **MANOEUVRES)


@pytest.fixture(scope="module")
def partials(model):
    orbit = propagated(model, (-3600.0, 3600.0), parameters=tuple(model.parameters()))
    return orbit.parameters, orbit.partials(EPOCH.shifted(TIMES_S))


def differences(model, name):
    """Return central differences of the states at TIMES_S by a parameter, extrapolated from two steps."""

    def states(step):
        state = STATE.copy()
        if name in ("x", "y", "z", "vx", "vy", "vz"):
            state[["x", "y", "z", "vx", "vy", "vz"].index(name)] += step
            return at(propagated(model, (-3600.0, 3600.0), state), TIMES_S)
        changed = model.with_parameters({name: model.parameters()[name] + step})
        return at(propagated(changed, (-3600.0, 3600.0)), TIMES_S)

    letter = name.rpartition(".")[0]
    step = STEPS.get(name, {"empirical": 1e-5, "burn": 1e-2, "fixed": 1e-5}.get(letter, 0.05))
    if name in ("x", "y", "z"):
        step = 100.0
    single, double = ((states(h) - states(-h)) / (2.0 * h) for h in (step, 2.0 * step))
    return (4.0 * single - double) / 3.0


NAMES = [*("x", "y", "z", "vx", "vy", "vz", "gm", "k2", "radiation")]
NAMES += ["empirical.r", "empirical.cos_t", "empirical.sin_n", "burn.r", "burn.t", "burn.n", "fixed.y"]
NAMES += ["earlier.r", "earlier.t", "earlier.n", "after.x", "turned.r", "turned.n"]


@pytest.mark.parametrize("name", NAMES)
def test_partials_against_differences(model, partials, name):
    names, values = partials
    computed, expected = values[:, :, names.index(name)], differences(model, name)
    for half in (slice(0, 3), slice(3, 6)):
        assert (
            np.abs(computed - expected)[:, half].max() < PARTIALS_TOLERANCE * np.abs(expected)[:, half].max()
        )


@pytest.mark.parametrize("delta_v_m_s", [(200.0, -1400.0, 600.0), (0.0, -1600.0, 30.0), (0.0, 0.0, 2000.0)])
def test_impulses_are_inverted(delta_v_m_s):
    model = forces(0, **TWO_BODY, impulses=(Impulse("large", EPOCH.shifted(1.0), delta_v_m_s),))
    state = at(propagated(model, (0.0, 2.0)), 2.0)[0]
    back = propagate(EPOCH.shifted(2.0), state[:3], state[3:], model, (-2.0, 0.0))
    np.testing.assert_allclose(np.ravel(back.states(EPOCH)), STATE, rtol=0, atol=1e-8)


@pytest.mark.parametrize("delta_v_m_s", [(0.0, 0.0, -2000.0), (0.0, 2000.0, 0.0)])
def test_impulses_without_a_preceding_state(delta_v_m_s):
    model = forces(0, impulses=(Impulse("wrong", EPOCH.shifted(-60.0), delta_v_m_s),))
    with pytest.raises(InputError, match="impulse wrong"):
        propagated(model, (-120.0, 0.0))


def test_table_of_bodies_against_the_ephemeris():
    ephemeris, libration = Ephemeris.open(), LunarOrientation.open()
    table, first_s, length_s = body_table(ephemeris, libration, "PA_DE421", EPOCH, (-1e5, 2e5))
    times_s = np.linspace(-1e5, 2e5, 1001)
    tdb = EPOCH.shifted(times_s)
    place = (times_s - first_s) / length_s
    segment = np.minimum(place.astype(int), len(table) - 1)
    series = [
        np.polynomial.chebyshev.chebval(2 * (p - s) - 1, table[s].T)
        for p, s in zip(place, segment, strict=True)
    ]
    moon_m, _ = ephemeris.geocentric("moon", tdb)
    sun_m, _ = ephemeris.geocentric("sun", tdb)
    np.testing.assert_allclose(np.array(series)[:, :3], -moon_m, rtol=0, atol=1e-4)
    np.testing.assert_allclose(np.array(series)[:, 3:6], sun_m - moon_m, rtol=0, atol=1e-2)
    rot = rot_icrf_to_pa(libration.angles(tdb)[0]).reshape(-1, 9)
    np.testing.assert_allclose(np.array(series)[:, 15:24], rot, rtol=0, atol=1e-12)


def test_epochs_outside_of_the_span():
    orbit = propagated(forces(0, **TWO_BODY), (0.0, 600.0))
    assert str(orbit) == "orbit, integrated from 2012-04-09T04:30:00.000 to 2012-04-09T04:40:00.000 TDB"
    with pytest.raises(CoverageError, match=r"got .*T04:46:40"):
        orbit.states(EPOCH.shifted(1000.0))
    with pytest.raises(InputError, match="partials"):
        orbit.partials(EPOCH)


BAD = {
    "under the ground": ({"position_m": POSITION_M / 1e3}, "got 1.791 km"),
    "not finite": ({"velocity_m_s": [0.0, np.nan, 0.0]}, "three finite numbers"),
    "two numbers": ({"velocity_m_s": [0.0, 1.0]}, "three finite numbers"),
    "no plane": ({"velocity_m_s": POSITION_M / 1e3}, "not parallel"),
    "falls": ({"velocity_m_s": VELOCITY_M_S / 2}, "ground of the Moon"),
    "two epochs": ({"epoch": EPOCH.shifted([0.0, 60.0])}, "epoch: expected a single epoch"),
    "no tolerance": ({"tolerance_m": 0.0}, "tolerance_m"),
    "no span": ({"span_s": (0.0, 0.0)}, "span_s"),
    "parameter": ({"parameters": ("drag",)}, "got 'drag'"),
    "impulse outside": (
        {"forces": forces(0, impulses=(Impulse("late", EPOCH.shifted(1e6)),))},
        "got 2012-04-20T18:16:40.000",
    ),
}


@pytest.mark.parametrize(("change", "words"), BAD.values(), ids=BAD)
def test_unusable_input(change, words):
    arguments = {"epoch": EPOCH, "position_m": POSITION_M, "velocity_m_s": VELOCITY_M_S} | {
        "forces": forces(0),
        "span_s": (0.0, 7200.0),
    }
    with pytest.raises(InputError, match=words):
        propagate(**(arguments | change))
