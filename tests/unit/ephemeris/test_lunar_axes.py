"""Landers in axes that turn with the Moon: SPICE, with frames and orientation loaded, says where they are."""

import numpy as np
import pytest
import spiceypy
from recorded import recorded
from spk_files import ORBITER, START_S, STOP_S, circular, write_states

from radioloc.ephemeris import Ephemeris, LunarOrientation, Trajectory
from radioloc.ephemeris.orientation import LUNAR_AXES
from radioloc.errors import CoverageError, KernelError
from radioloc.io import write_spice
from radioloc.kernels import find_kernel
from radioloc.time import Epochs

AT_S = np.linspace(START_S, STOP_S, 7)

# An angle of the orientation has grown to 1750 rad, which rounds it by 1.1e-13 rad: 2e-7 m on the surface, 2e-10 m/s of
# an orbit's 1.6 km/s.
SAME_M, SAME_M_S = 2e-7, 2e-10

# The two names that frames kernels of DE421 and DE440 give to their axes, each with a code of its own.
ALIAS = """KPL/FK
\\begindata
FRAME_{name} = {code}
FRAME_{code}_NAME = '{name}'
FRAME_{code}_CLASS = 4
FRAME_{code}_CLASS_ID = {code}
FRAME_{code}_CENTER = 301
TKFRAME_{code}_RELATIVE = '{relative}'
TKFRAME_{code}_SPEC = 'MATRIX'
TKFRAME_{code}_MATRIX = ( 1 0 0 0 1 0 0 0 1 )
\\begintext
"""


@pytest.mark.parametrize("ephemeris", ["DE421", "DE440"])
def test_a_lander_that_was_exported_is_read_where_spice_has_it(tmp_path, ephemeris):
    spk, frames = write_spice(tmp_path / "lander.bsp", recorded(frame=f"ME_{ephemeris}"), body=-900)
    with spiceypy.KernelPool([str(file) for file in (find_kernel(ephemeris, "PCK"), spk, frames)]):
        expected = np.array([spiceypy.spkgeo(-900, et, "J2000", 301)[0] for et in AT_S])
    read = Trajectory.open(spk, -900)
    states = read.states(AT_S, read.segment_indices(AT_S))
    assert np.abs(states - expected)[:, :3].max() * 1e3 < SAME_M
    assert np.abs(states - expected)[:, 3:].max() * 1e3 < SAME_M_S
    assert f"in PA_{ephemeris}, 1898" in str(read)


@pytest.mark.parametrize("code", LUNAR_AXES)
def test_an_orbit_in_each_of_the_axes(tmp_path, code):
    axes = LUNAR_AXES[code]
    _, frames = write_spice(tmp_path / "lander.bsp", recorded(frame=f"ME_{axes.ephemeris}"))
    kernels = [find_kernel(axes.ephemeris, "PCK"), frames]
    if axes.name in ("MOON_PA", "MOON_ME"):
        by_name = {LUNAR_AXES[k].axes: LUNAR_AXES[k].name for k in (31006, 31007)}
        if axes.ephemeris == "DE440":
            by_name = {"PA": "MOON_PA_DE440", "ME": "MOON_ME_DE440_ME421"}
        text = ALIAS.format(name=axes.name, code=code, relative=by_name[axes.axes])
        (tmp_path / "alias.tf").write_text(text)
        kernels.append(tmp_path / "alias.tf")
    with spiceypy.KernelPool([str(file) for file in kernels]):
        assert spiceypy.frmnam(code) == axes.name
        orbit = write_states(tmp_path / "orbit.bsp", circular(1.8374e6, 4.9e12), frame=axes.name)
        spiceypy.furnsh(str(orbit))
        expected = np.array([spiceypy.spkgeo(ORBITER, et, "J2000", 301)[0] for et in AT_S])
    read = Trajectory.open(orbit, ORBITER)
    states = read.states(AT_S, read.segment_indices(AT_S))
    assert np.abs(states - expected)[:, :3].max() * 1e3 < SAME_M
    assert np.abs(states - expected)[:, 3:].max() * 1e3 < SAME_M_S


def test_epochs_without_an_orientation_of_the_moon_are_refused(tmp_path):
    """The kernel of a lander has no limits of time; the orientation has."""
    spk, _ = write_spice(tmp_path / "lander.bsp", recorded(frame="ME_DE440"))
    ends = LunarOrientation.open("DE440").kernel.end_tdb
    with pytest.raises(CoverageError, match=ends):
        Trajectory.open(spk, 301001).geocentric(Ephemeris.open(), Epochs.from_tdb_seconds(np.array([1.6e9])))


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
