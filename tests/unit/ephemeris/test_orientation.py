import numpy as np
import pytest
import spiceypy

from radioloc.ephemeris import LunarOrientation
from radioloc.errors import KernelError
from radioloc.time import Epochs

# Central differences of the angles leave the round-off of psi, 2e-12 rad, over the step of 120 s.
RATE_TOLERANCE_RAD_S = 5e-14


def made_up_pck(path, frame_codes, n_days=40):
    handle = spiceypy.pckopn(str(path), "made up", 0)
    for code in frame_codes:
        series = np.zeros((5, 3, 3))
        series[:, :, 1] = 0.1
        spiceypy.pckw02(
            handle, code, "J2000", 0.0, n_days * 86400.0, "x", 8 * 86400.0, 5, 2, series.ravel(), 0.0
        )
    spiceypy.pckcls(handle)
    return path


def test_rates_are_derivatives():
    orientation = LunarOrientation.open()
    assert orientation.frame == "PA_DE421"
    assert orientation.kernel.registered
    tdb = Epochs.from_jd(2440400.5 + np.arange(0, 29000, 97.3), 0.0, "TDB")
    ahead, behind = orientation.angles(tdb.shifted(60.0))[0], orientation.angles(tdb.shifted(-60.0))[0]
    _, rates_rad_s = orientation.angles(tdb)
    np.testing.assert_allclose((ahead - behind) / 120.0, rates_rad_s, rtol=0, atol=RATE_TOLERANCE_RAD_S)
    # Once around in a sidereal month of 27.32 days.
    assert rates_rad_s[:, 2].mean() + rates_rad_s[:, 0].mean() == pytest.approx(2.6617e-6, abs=1e-9)


def test_frame_of_another_ephemeris(tmp_path):
    assert LunarOrientation.open(made_up_pck(tmp_path / "de440.bpc", [31008])).frame == "PA_DE440"


@pytest.mark.parametrize("codes", [[31002], [3000], [31006, 31008]])
def test_unknown_or_ambiguous_frames(tmp_path, codes):
    with pytest.raises(KernelError, match=r"NAIF.*31006 \(PA_DE421\)"):
        LunarOrientation.open(made_up_pck(tmp_path / "odd.bpc", codes))
