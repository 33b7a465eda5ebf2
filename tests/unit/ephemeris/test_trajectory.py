"""Trajectories from SPK files: segments, frames and centres, and what is refused."""

import numpy as np
import pytest
import spiceypy
from spk_files import ORBITER, START_S, STOP_S, circular, write_states

from radioloc.ephemeris import Ephemeris, Trajectory
from radioloc.errors import CoverageError, InputError, KernelError
from radioloc.kernels import find_kernel
from radioloc.time import Epochs

STATES = circular(1.8374e6, 4902.800076e9)
HIGHER_STATES = circular(3.0e6, 4902.800076e9)

# States in km, and Hermite interpolation of a circle of 118 minutes over 60 s.
SAME_KM = 1e-9

AT_S = START_S + np.array([0.0, 1000.0, 20000.5, STOP_S - START_S])


@pytest.fixture
def orbit(tmp_path):
    return write_states(tmp_path / "orbit.bsp", STATES)


def states_km(path, et_s=AT_S, body=ORBITER):
    source = Trajectory.open(path, body)
    return source.states(et_s, source.segment_indices(et_s))


def test_states_are_those_that_were_written(orbit):
    source = Trajectory.open(orbit, ORBITER)
    assert np.abs(states_km(orbit) - STATES(AT_S) / 1e3).max() < SAME_KM
    assert (source.kernel.start_tdb, source.kernel.end_tdb) == ("2020-12-02", "2020-12-03T12:00:00")
    assert source.spans_s() == [(START_S, STOP_S)]


def test_what_a_program_has_loaded_neither_matters_nor_changes(orbit, tmp_path):
    """The same body from another file, and the same file, are in SPICE's pool before and after."""
    second_spk = write_states(tmp_path / "other.bsp", HIGHER_STATES)
    try:
        for path in (orbit, second_spk):
            spiceypy.furnsh(str(path))
        initial = [spiceypy.spkgeo(ORBITER, et, "J2000", 301)[0] for et in AT_S]
        assert np.abs(states_km(orbit) - STATES(AT_S) / 1e3).max() < SAME_KM
        assert np.array_equal([spiceypy.spkgeo(ORBITER, et, "J2000", 301)[0] for et in AT_S], initial)
        spiceypy.unload(str(second_spk))
        final = [spiceypy.spkgeo(ORBITER, et, "J2000", 301)[0] for et in AT_S]
        assert np.abs(final - STATES(AT_S) / 1e3).max() < SAME_KM
        assert spiceypy.ktotal("SPK") == 1
    finally:
        spiceypy.kclear()
    assert np.abs(states_km(orbit) - STATES(AT_S) / 1e3).max() < SAME_KM


def test_another_inertial_frame_is_turned(orbit, tmp_path):
    turn = spiceypy.pxform("J2000", "ECLIPJ2000", 0.0)

    def turned(et_s):
        return (STATES(et_s).reshape(-1, 2, 3) @ turn.T).reshape(-1, 6)

    ecliptic = write_states(tmp_path / "ecliptic.bsp", turned, frame="ECLIPJ2000")
    assert np.abs(states_km(ecliptic) - states_km(orbit)).max() < SAME_KM


def test_a_frame_that_turns_is_refused(tmp_path):
    fixed = write_states(tmp_path / "fixed.bsp", STATES, frame="IAU_MOON")
    with pytest.raises(KernelError, match=r"fixed\.bsp.*-85.*IAU_MOON \(10020\)"):
        Trajectory.open(fixed, ORBITER)


def test_what_is_no_trajectory_is_refused(orbit, tmp_path):
    with pytest.raises(KernelError, match=r"NAIF.*-86.*-85"):
        Trajectory.open(orbit, -86)
    with pytest.raises(KernelError, match="neither a file"):
        Trajectory.open(tmp_path / "absent.bsp", ORBITER)
    (tmp_path / "text.bsp").write_text("not a kernel")
    with pytest.raises(KernelError, match="SPICE"):
        Trajectory.open(tmp_path / "text.bsp", ORBITER)
    (tmp_path / "cut.bsp").write_bytes(orbit.read_bytes()[:4096])
    with pytest.raises(KernelError, match="cut short"):
        Trajectory.open(tmp_path / "cut.bsp", ORBITER)
    with pytest.raises(InputError, match="an integer such as -85"):
        Trajectory.open(orbit, "-85")


def relative_to(path, chain):
    """Write one circle per pair of a body and its centre, each smaller than that before."""
    handle = spiceypy.spkopn(str(path), "chain", 0)
    for k, (body, center, hours) in enumerate(chain):
        et_s = START_S + np.linspace(0.0, 3600.0 * hours, 200)
        states = circular(1.8374e6 / 100**k, 4902.800076e9 / 100 ** (3 * k))(et_s) / 1e3
        spiceypy.spkw13(
            handle, body, center, "J2000", et_s[0], et_s[-1], "chain", 11, len(et_s), states, et_s
        )
    spiceypy.spkcls(handle)
    return path


def test_a_trajectory_relative_to_another_of_the_file_is_their_sum(tmp_path):
    path = relative_to(tmp_path / "chain.bsp", [(-901, 301, 2.0), (-900, -901, 1.0), (-902, -900, 3.0)])
    ephemeris, et_s = Ephemeris.open(), START_S + np.array([0.0, 1234.5, 3600.0])
    files = [path, find_kernel("DE421", "SPK")]
    spiceypy.furnsh(list(map(str, files)))
    try:
        by_spice = 1e3 * np.array([spiceypy.spkgeo(-902, et, "J2000", 399)[0] for et in et_s])
    finally:
        spiceypy.kclear()
    lander = Trajectory.open(path, -902)
    position_m, velocity_m_s = lander.geocentric(ephemeris, Epochs.from_tdb_seconds(et_s))
    np.testing.assert_allclose(position_m, by_spice[:, :3], rtol=0, atol=1e-5)
    np.testing.assert_allclose(velocity_m_s, by_spice[:, 3:], rtol=0, atol=1e-8)
    assert lander.spans_s() == [(START_S, START_S + 3600.0)]
    with pytest.raises(CoverageError, match="NAIF code -900"):
        lander.geocentric(ephemeris, Epochs.from_tdb_seconds(START_S + np.array([5000.0])))


@pytest.mark.parametrize(
    ("chain", "words"),
    [
        ([(-900, -901, 1.0)], "relative to body -901, which is not in that file"),
        ([(-900, -901, 1.0), (-901, -900, 1.0)], "in a cycle"),
    ],
)
def test_a_chain_that_does_not_end_is_refused_when_it_is_opened(tmp_path, chain, words):
    with pytest.raises(KernelError, match=rf"chain\.bsp gives body -9\d\d .*{words}"):
        Trajectory.open(relative_to(tmp_path / "chain.bsp", chain), -900)


def test_a_type_of_segment_that_is_not_read_is_refused_with_the_conversion(tmp_path):
    handle = spiceypy.spkopn(str(tmp_path / "two_body.bsp"), "type 5", 0)
    et_s = START_S + 60.0 * np.arange(20)
    states = STATES(et_s) / 1e3
    spiceypy.spkw05(handle, ORBITER, 301, "J2000", et_s[0], et_s[-1], "o", 4902.8, 20, states, et_s)
    spiceypy.spkcls(handle)
    with pytest.raises(KernelError, match=r"SPK.*5.*1, 2, 3,.*spkw13"):
        Trajectory.open(tmp_path / "two_body.bsp", ORBITER)


def test_the_moon_of_the_ephemeris_itself():
    """A body of JPL's own file, relative to the barycentre of Earth and Moon, is where the ephemeris has it."""
    ephemeris = Ephemeris.open()
    tdb = Epochs.from_jd(2459185.5, np.linspace(0.0, 30.0, 50) + 0.123456789, "TDB")
    moon = Trajectory.open(find_kernel("DE421", "SPK"), 301).geocentric(ephemeris, tdb)
    for ours, theirs in zip(ephemeris.geocentric("moon", tdb), moon, strict=True):
        assert np.abs(ours - theirs).max() < 1e-6


@pytest.mark.parametrize(("center", "code"), [("earth", 399), ("sun", 10), ("solar system barycentre", 0)])
def test_centres(tmp_path, center, code):
    ephemeris = Ephemeris.open()
    path = write_states(tmp_path / "orbit.bsp", STATES, center=code)
    tdb = Epochs.from_tdb_seconds(AT_S)
    position_m, velocity_m_s = Trajectory.open(path, ORBITER).geocentric(ephemeris, tdb)
    if code == 399:
        place_m, rate_m_s = np.zeros(3), np.zeros(3)
    elif code == 10:
        place_m, rate_m_s = ephemeris.geocentric("sun", tdb)
    else:
        earth = ephemeris.earth(tdb)
        place_m, rate_m_s = -earth.position_m, -earth.velocity_m_s
    # Positions of 1.5e11 m are rounded to 0.03 mm.
    assert np.abs(position_m - place_m - STATES(AT_S)[:, :3]).max() < 1e-4
    assert np.abs(velocity_m_s - rate_m_s - STATES(AT_S)[:, 3:]).max() < 1e-6


def test_a_centre_that_the_ephemeris_lacks(tmp_path):
    path = write_states(tmp_path / "orbit.bsp", STATES, center=499)
    with pytest.raises(KernelError, match=r"NAIF.*499.*0"):
        Trajectory.open(path, ORBITER).geocentric(Ephemeris.open(), Epochs.from_tdb_seconds(AT_S))


def test_an_epoch_is_finer_than_one_float(orbit):
    """Steps of 0.02 microseconds, in which an orbiter moves 33 micrometres: five of them in SPICE's own step."""
    steps_s = 2e-8 * np.arange(50)
    tdb = Epochs.from_tdb_seconds(np.full(50, START_S + 4321.0)).shifted(steps_s)
    position_m, velocity_m_s = Trajectory.open(orbit, ORBITER).geocentric(_no_earth(), tdb)
    moved_m = np.linalg.norm(position_m - position_m[0], axis=-1)
    # The fraction of the day is resolved to 1e-11 s.
    assert np.abs(moved_m - np.linalg.norm(velocity_m_s[0]) * steps_s).max() < 1e-6


def _no_earth():
    class FixedEarth:
        def geocentric_center(self, code, tdb):
            return np.zeros((len(tdb), 3)), np.zeros((len(tdb), 3))

    return FixedEarth()
