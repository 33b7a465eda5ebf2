"""Integrated orbits as files: SPKs read by SPICE, messages read by another implementation."""

import numpy as np
import pytest
from low_orbit import EPOCH, STATE, at, forces, propagated
from spk_files import ORBITER

from radioloc.dynamics import Acceleration, Impulse
from radioloc.ephemeris import Ephemeris, Trajectory
from radioloc.errors import InputError
from radioloc.report import write_orbit_oem, write_orbit_opm, write_orbit_spk

IMPULSE = Impulse("turn", EPOCH.shifted(1000.0), (1.0, -2.0, 3.0))
SAME_M, SAME_M_S = 1e-6, 2e-7  # Hermite polynomials through states 15 s apart; rounding of 4e8 m
COVARIANCE = np.diag([1.0, 4.0, 9.0, 1e-6, 4e-6, 9e-6]) + 1e-7


@pytest.fixture(scope="module", name="orbit")
def _orbit():
    burn = Acceleration(
        "burn", start=EPOCH.shifted(-700.3), stop=EPOCH.shifted(-600.0), constant_m_s2=(0.1, 0, 0)
    )
    model = forces(100, impulses=(IMPULSE,), accelerations=(burn,))
    return propagated(model, (-3600.0, 3600.0), name="GRAIL-B")


def test_spk(orbit, tmp_path):
    trajectory = Trajectory.open(write_orbit_spk(orbit, tmp_path / "orbit.bsp", ORBITER), ORBITER)
    times_s = np.array([-3600.0, -650.0, -333.3, 0.0, 17.0, 999.999, 1000.001, 2345.678, 3600.0])
    tdb = EPOCH.shifted(times_s)
    for own, other, limit in zip(
        orbit.geocentric(Ephemeris.open(), tdb),
        trajectory.geocentric(Ephemeris.open(), tdb),
        (SAME_M, SAME_M_S),
        strict=True,
    ):
        assert np.abs(own - other).max() < limit
    assert len(trajectory.segments) == 5


def read(path):
    return pytest.importorskip("ccsds_ndm.ndm_io").NdmIo().from_path(path)


def numbers(record, names):
    return np.array([float(getattr(getattr(record, name), "value")) for name in names])  # noqa: B009


NAMES = ("x", "y", "z", "x_dot", "y_dot", "z_dot")


def test_oem(orbit, tmp_path):
    path = write_orbit_oem(
        orbit, tmp_path / "orbit.oem", originator="TEST", covariance=COVARIANCE, step_s=60.0
    )
    segments = read(path).body.segment
    assert len(segments) == 5
    metadata = segments[0].metadata
    assert (metadata.object_name, metadata.center_name, metadata.ref_frame) == ("GRAIL-B", "MOON", "ICRF")
    assert (metadata.time_system, metadata.interpolation_degree) == ("TDB", 11)
    before, after = segments[3].data.state_vector[-1], segments[4].data.state_vector[0]
    assert str(before.epoch) == str(after.epoch) == "2012-04-09T04:46:40.000000000"
    jump_m_s = (numbers(after, NAMES) - numbers(before, NAMES))[3:] * 1e3
    assert np.linalg.norm(jump_m_s) == pytest.approx(np.sqrt(14.0), abs=1e-8)
    last = segments[4].data.state_vector[-1]
    np.testing.assert_allclose(numbers(last, NAMES) * 1e3, at(orbit, 3600.0)[0], rtol=0, atol=1e-6)
    (covariance,) = segments[2].data.covariance_matrix
    assert float(covariance.cz_z.value) == pytest.approx(9.0e-6, rel=1e-6)


def test_opm(orbit, tmp_path):
    path = write_orbit_opm(orbit, tmp_path / "orbit.opm", originator="TEST", covariance=COVARIANCE)
    data = read(path).body.segment.data
    np.testing.assert_allclose(numbers(data.state_vector, NAMES) * 1e3, STATE, rtol=0, atol=1e-8)
    (manoeuvre,) = data.maneuver_parameters
    assert manoeuvre.man_ref_frame == "RTN"
    assert str(manoeuvre.man_epoch_ignition) == "2012-04-09T04:46:40.000000000"
    np.testing.assert_allclose(
        numbers(manoeuvre, [f"man_dv_{k}" for k in (1, 2, 3)]) * 1e3, IMPULSE.delta_v_m_s, rtol=0, atol=1e-9
    )
    assert float(data.covariance_matrix.cz_dot_z_dot.value) == pytest.approx(9.1e-12, rel=1e-6)


@pytest.mark.parametrize("body", [177, 0, True, -1.0])
def test_codes_that_are_no_spacecrafts(orbit, body, tmp_path):
    with pytest.raises(InputError, match="no NAIF code of a spacecraft"):
        write_orbit_spk(orbit, tmp_path / "orbit.bsp", body)


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        ({"step_s": 0.0}, "step 0.0 s is not more than 0"),
        ({"covariance": np.eye(3)}, "covariance must be that of a state"),
        ({"originator": ""}, "ORIGINATOR '' cannot stand"),
    ],
)
def test_messages_that_cannot_be(orbit, more, problem, tmp_path):
    with pytest.raises(InputError, match=problem):
        write_orbit_oem(orbit, tmp_path / "orbit.oem", **({"originator": "TEST"} | more))
