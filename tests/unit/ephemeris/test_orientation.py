import numpy as np
import pytest
import spiceypy

from radioloc.ephemeris import LunarOrientation
from radioloc.errors import KernelError


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


def test_frame_of_another_ephemeris(tmp_path):
    assert LunarOrientation.open(made_up_pck(tmp_path / "de440.bpc", [31008])).frame == "PA_DE440"


@pytest.mark.parametrize("codes", [[31002], [3000], [31006, 31008]])
def test_unknown_or_ambiguous_frames(tmp_path, codes):
    with pytest.raises(KernelError, match=r"NAIF.*31006 \(PA_DE421\)"):
        LunarOrientation.open(made_up_pck(tmp_path / "odd.bpc", codes))
