"""Lunar axes against SPICE, which reads the same binary PCK with frame definitions written here."""

import numpy as np
import pytest
import spiceypy

from radioloc.ephemeris import CONSTANTS, LunarOrientation
from radioloc.kernels import find_kernel
from radioloc.lunar import rot_icrf_to_iau_moon, rot_icrf_to_pa, rot_pa_to_me
from radioloc.lunar.frames import rot_icrf_to_pa_rate
from radioloc.time import Epochs

# psi reaches some 1e4 rad, of which half a unit in the last place is 0.9e-12 rad: 2 micrometres on the surface.
AS_SPICE = 1e-12
ROTATION_RATE_RAD_S = 2.6617e-6

FRAMES = """KPL/FK
\\begindata
FRAME_MOON_PA_DE421   = 31006
FRAME_31006_NAME      = 'MOON_PA_DE421'
FRAME_31006_CLASS     = 2
FRAME_31006_CLASS_ID  = 31006
FRAME_31006_CENTER    = 301
FRAME_MOON_ME_DE421   = 31007
FRAME_31007_NAME      = 'MOON_ME_DE421'
FRAME_31007_CLASS     = 4
FRAME_31007_CLASS_ID  = 31007
FRAME_31007_CENTER    = 301
TKFRAME_31007_SPEC    = 'ANGLES'
TKFRAME_31007_RELATIVE = 'MOON_PA_DE421'
TKFRAME_31007_ANGLES  = ( 67.92 78.56 0.30 )
TKFRAME_31007_AXES    = ( 3 2 1 )
TKFRAME_31007_UNITS   = 'ARCSECONDS'
FRAME_MOON_PA_DE440   = 31008
FRAME_31008_NAME      = 'MOON_PA_DE440'
FRAME_31008_CLASS     = 2
FRAME_31008_CLASS_ID  = 31008
FRAME_31008_CENTER    = 301
FRAME_MOON_ME_DE440_ME421 = 31009
FRAME_31009_NAME      = 'MOON_ME_DE440_ME421'
FRAME_31009_CLASS     = 4
FRAME_31009_CLASS_ID  = 31009
FRAME_31009_CENTER    = 301
TKFRAME_31009_SPEC    = 'ANGLES'
TKFRAME_31009_RELATIVE = 'MOON_PA_DE440'
TKFRAME_31009_ANGLES  = ( 67.8526 78.6944 0.2785 )
TKFRAME_31009_AXES    = ( 3 2 1 )
TKFRAME_31009_UNITS   = 'ARCSECONDS'
\\begintext
"""

# The Moon of NAIF's pck00010.tpc and pck00011.tpc; arguments in degrees and degrees per Julian century.
IAU_MOON = """KPL/PCK
\\begindata
BODY3_NUT_PREC_ANGLES = ( 125.045 -1935.5364525 250.089 -3871.072905 260.008 475263.3328725
                          176.625 487269.629985 357.529 35999.0509575 311.589 964468.49931
                          134.963 477198.869325 276.617 12006.300765 34.226 63863.5132425
                          15.134 -5806.6093575 119.743 131.84064 239.961 6003.1503825
                          25.053 473327.79642 )
BODY301_POLE_RA      = ( 269.9949 0.0031 0. )
BODY301_POLE_DEC     = ( 66.5392 0.0130 0. )
BODY301_PM           = ( 38.3213 13.17635815 -1.4D-12 )
BODY301_LONG_AXIS    = ( 0. )
BODY301_NUT_PREC_RA  = ( -3.8787 -0.1204 0.0700 -0.0172 0.0 0.0072 0.0 0.0 0.0 -0.0052 0.0 0.0 0.0043 )
BODY301_NUT_PREC_DEC = ( 1.5419 0.0239 -0.0278 0.0068 0.0 -0.0029 0.0009 0.0 0.0 0.0008 0.0 0.0 -0.0009 )
BODY301_NUT_PREC_PM  = ( 3.5610 0.1208 -0.0642 0.0158 0.0252 -0.0066 -0.0047 -0.0046 0.0028 0.0052
                         0.0040 0.0019 -0.0044 )
\\begintext
"""


@pytest.fixture(scope="module", autouse=True)
def _spice(tmp_path_factory):
    directory = tmp_path_factory.mktemp("spice")
    (directory / "frames.tf").write_text(FRAMES)
    (directory / "moon.tpc").write_text(IAU_MOON)
    kernels = [find_kernel(name, "PCK") for name in ("DE421", "DE440")]
    for path in (*kernels, directory / "frames.tf", directory / "moon.tpc"):
        spiceypy.furnsh(str(path))
    yield
    spiceypy.kclear()


@pytest.fixture(scope="module")
def et():
    # Whole seconds, 1990 to 2049: exact in SPICE's one float as in our two.
    return np.random.default_rng(31006).integers(-315576000, 1577880000, 500).astype(float)


@pytest.mark.parametrize(
    ("name", "frame"),
    [
        ("DE421", "MOON_PA_DE421"),
        ("DE421", "MOON_ME_DE421"),
        ("DE440", "MOON_PA_DE440"),
        ("DE440", "MOON_ME_DE440_ME421"),
    ],
)
def test_rotation_and_its_rate(et, name, frame):
    spice = np.array([spiceypy.sxform("J2000", frame, t) for t in et])
    angles, rates = LunarOrientation.open(name).angles(Epochs.from_tdb_seconds(et))
    to_frame = np.eye(3) if "PA" in frame else rot_pa_to_me(CONSTANTS[name])
    np.testing.assert_allclose(to_frame @ rot_icrf_to_pa(angles), spice[:, :3, :3], rtol=0, atol=AS_SPICE)
    np.testing.assert_allclose(
        to_frame @ rot_icrf_to_pa_rate(angles, rates),
        spice[:, 3:, :3],
        rtol=0,
        atol=AS_SPICE * ROTATION_RATE_RAD_S,
    )


def test_mean_earth_axes_alone():
    spice = spiceypy.pxform("MOON_PA_DE421", "MOON_ME_DE421", 0.0)
    np.testing.assert_allclose(rot_pa_to_me(CONSTANTS["DE421"]), spice, rtol=0, atol=1e-15)


def test_iau_mean_rotation(et):
    spice = np.array([spiceypy.pxform("J2000", "IAU_MOON", t) for t in et])
    ours = rot_icrf_to_iau_moon(Epochs.from_tdb_seconds(et))
    np.testing.assert_allclose(ours, spice, rtol=0, atol=AS_SPICE)
