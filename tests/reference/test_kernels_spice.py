"""The kernels that ship and their evaluation against SPICE, which reads the same files."""

import numpy as np
import pytest
import spiceypy

from radioloc.ephemeris import BODIES, Ephemeris
from radioloc.kernels import find_kernel
from radioloc.time import Epochs

# Last places of the sums, in metres: of 4e8 m for the Moon, of 1.5e11 m for the Sun, 1.5e12 m for Saturn.
ROUNDOFF_M = {"moon": 2e-7, "sun": 1e-4, "venus": 1e-4, "jupiter": 5e-4, "saturn": 1e-3}
ROUNDOFF_M_S = 5e-11


SPAN_S = {"DE421": (-978264000, 1577880000), "DE440": (-315576000, 1577880000)}
SOURCE_SHA256 = {
    "DE421": "a20a7139da04cbc462454634918e9a9ca69127044e2cc9d4f9c16e238d2deedc",
    "DE440": "a4ce9bf9b3282becc9f4b2ac3cebe03a2ae7599981aabd7265fd8482fff7c4b5",
}


@pytest.fixture(scope="module", params=["DE421", "DE440"])
def name(request):
    spiceypy.furnsh(str(find_kernel(request.param, "SPK")))
    yield request.param
    spiceypy.kclear()


@pytest.fixture(scope="module")
def et(name):
    # Whole seconds and both ends of the span: exact in SPICE's one float as in our two.
    first, last = SPAN_S[name]
    interior_s = np.random.default_rng(301).integers(first, last, 500).astype(float)
    return np.append(interior_s, [first, last])


@pytest.mark.parametrize("body", BODIES)
def test_geocentric_states(name, et, body):
    position_m, velocity_m_s = Ephemeris.open(name).geocentric(body, Epochs.from_tdb_seconds(et))
    spice = 1e3 * np.array([spiceypy.spkezr(str(BODIES[body]), t, "J2000", "NONE", "399")[0] for t in et])
    np.testing.assert_allclose(position_m, spice[:, :3], rtol=0, atol=ROUNDOFF_M[body])
    np.testing.assert_allclose(velocity_m_s, spice[:, 3:], rtol=0, atol=ROUNDOFF_M_S)


def test_barycentric_states(name, et):
    ephemeris, tdb = Ephemeris.open(name), Epochs.from_tdb_seconds(et)
    earth = ephemeris.earth(tdb)
    spice = 1e3 * np.array([spiceypy.spkezr("399", t, "J2000", "NONE", "0")[0] for t in et])
    np.testing.assert_allclose(earth.position_m, spice[:, :3], rtol=0, atol=1e-4)
    np.testing.assert_allclose(earth.velocity_m_s, spice[:, 3:], rtol=0, atol=ROUNDOFF_M_S)
    for body in ("sun", "moon"):
        position_m, _ = ephemeris.barycentric(body, tdb)
        spice = 1e3 * np.array([spiceypy.spkezr(str(BODIES[body]), t, "J2000", "NONE", "0")[0] for t in et])
        np.testing.assert_allclose(position_m, spice[:, :3], rtol=0, atol=1e-4)


def test_spice_sees_the_span_and_the_comments(name):
    path = str(find_kernel(name, "SPK"))
    for body in (2, 3, 5, 6, 10, 301, 399):
        assert spiceypy.wnfetd(spiceypy.spkcov(path, body), 0) == SPAN_S[name]
    handle = spiceypy.dafopr(path)
    _, lines, done = spiceypy.dafec(handle, 100, 1000)
    spiceypy.dafcls(handle)
    assert done
    assert any(SOURCE_SHA256[name] in line for line in lines)
