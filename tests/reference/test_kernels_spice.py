"""The kernels that ship and their evaluation against SPICE, which reads the same files."""

from __future__ import annotations

import numpy as np
import pytest
import spiceypy

from radioloc.ephemeris import BODIES, Ephemeris
from radioloc.kernels import find_kernel
from radioloc.time import Epochs

# Last places of the sums, in metres: of 4e8 m for the Moon, of 1.5e11 m for the Sun, 1.5e12 m for Saturn.
ROUNDOFF_M = {"moon": 2e-7, "sun": 1e-4, "venus": 1e-4, "jupiter": 5e-4, "saturn": 1e-3}
ROUNDOFF_M_S = 5e-11


@pytest.fixture(scope="module", autouse=True)
def _spice():
    spiceypy.furnsh(str(find_kernel("DE421", "SPK")))
    yield
    spiceypy.kclear()


@pytest.fixture(scope="module")
def et():
    # Whole seconds and both ends of the span: exact in SPICE's one float as in our two.
    inside = np.random.default_rng(301).integers(-978264000, 1577880000, 500).astype(float)
    return np.append(inside, [-978264000.0, 1577880000.0])


@pytest.mark.parametrize("body", BODIES)
def test_geocentric_states(et, body):
    position_m, velocity_m_s = Ephemeris.open().geocentric(body, Epochs.from_tdb_seconds(et))
    spice = 1e3 * np.array([spiceypy.spkezr(str(BODIES[body]), t, "J2000", "NONE", "399")[0] for t in et])
    np.testing.assert_allclose(position_m, spice[:, :3], rtol=0, atol=ROUNDOFF_M[body])
    np.testing.assert_allclose(velocity_m_s, spice[:, 3:], rtol=0, atol=ROUNDOFF_M_S)


def test_barycentric_states(et):
    ephemeris, tdb = Ephemeris.open(), Epochs.from_tdb_seconds(et)
    earth = ephemeris.earth(tdb)
    spice = 1e3 * np.array([spiceypy.spkezr("399", t, "J2000", "NONE", "0")[0] for t in et])
    np.testing.assert_allclose(earth.position_m, spice[:, :3], rtol=0, atol=1e-4)
    np.testing.assert_allclose(earth.velocity_m_s, spice[:, 3:], rtol=0, atol=ROUNDOFF_M_S)
    for body in ("sun", "moon"):
        position_m, _ = ephemeris.barycentric(body, tdb)
        spice = 1e3 * np.array([spiceypy.spkezr(str(BODIES[body]), t, "J2000", "NONE", "0")[0] for t in et])
        np.testing.assert_allclose(position_m, spice[:, :3], rtol=0, atol=1e-4)


def test_spice_sees_the_span_and_the_comments():
    path = str(find_kernel("DE421", "SPK"))
    for body in (2, 3, 5, 6, 10, 301, 399):
        window = spiceypy.spkcov(path, body)
        assert spiceypy.wnfetd(window, 0) == (-978264000.0, 1577880000.0)
    handle = spiceypy.dafopr(path)
    _, lines, done = spiceypy.dafec(handle, 100, 1000)
    spiceypy.dafcls(handle)
    assert done
    assert any("a20a7139da04cbc462454634918e9a9ca69127044e2cc9d4f9c16e238d2deedc" in line for line in lines)
