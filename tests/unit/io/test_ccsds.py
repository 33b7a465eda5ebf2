"""Messages of the CCSDS: landers and orbits read by another implementation and by SPICE, residuals that come back."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import spiceypy
from low_orbit import EPOCH, STATE, at, forces, propagated
from recorded import recorded
from scipy.interpolate import KroghInterpolator
from spk_files import ORBITER

from radioloc.cli import main
from radioloc.dynamics import Acceleration, Impulse
from radioloc.ephemeris import Ephemeris, Trajectory
from radioloc.errors import InputError
from radioloc.io import write_spice
from radioloc.io.ccsds import write_oem, write_orbit_oem, write_orbit_opm
from radioloc.io.spice_kernels import write_orbit_spk
from radioloc.kernels import find_kernel
from radioloc.time import epochs_from_strings, to_scale

DAYS = ("2020-12-01T12:00:00", "2020-12-03T00:30:00")
SIGMAS_M = np.array([10.0, 4.0, 30.0])
CONTENT = recorded("lander 5", (-51.91637, 43.05784, -2570.25), SIGMAS_M)

# Nine decimals of a kilometre, rounded; a double of seconds since J2000 is 0.06 us wrong, at 4.6 m/s.
SAME_M, SAME_M_S = 1e-6, 2e-9


def message_of(path):
    return pytest.importorskip("ccsds_ndm.ndm_io").NdmIo().from_path(path)


NAMES = ("x", "y", "z", "x_dot", "y_dot", "z_dot")


def numbers(record, names):
    return np.array([float(getattr(getattr(record, name), "value")) for name in names])  # noqa: B009


def read(path):
    """Dates, states in m and m/s, and the segment, as ccsds-ndm has them."""
    (segment,) = message_of(path).body.segment
    rows = segment.data.state_vector
    return [str(row.epoch) for row in rows], np.array([numbers(row, NAMES) for row in rows]) * 1e3, segment


def spice_states(tmp_path, et_s):
    files = write_spice(tmp_path / "lander.bsp", CONTENT)
    kernels = [find_kernel("DE421", kind) for kind in ("SPK", "PCK")]
    with spiceypy.KernelPool([str(file) for file in (*kernels, *files)]):
        return np.array([spiceypy.spkgeo(301001, et, "J2000", 301)[0] for et in et_s]) * 1e3


def et_of(dates):
    return to_scale(epochs_from_strings(dates, "UTC"), "TDB").seconds_since(
        epochs_from_strings("2000-01-01T12:00:00", "TDB")
    )


def test_states_are_those_of_spice(tmp_path):
    file = write_oem(tmp_path / "lander.oem", CONTENT, *DAYS, originator="TEST", step_s=7200.0)
    dates, states, segment = read(file)
    assert (dates[0], dates[1], dates[-1]) == (
        "2020-12-01T12:00:00.000000",
        "2020-12-01T14:00:00.000000",
        "2020-12-03T00:30:00.000000",
    )
    assert len(dates) == 20  # 36.5 h: the last step is shorter
    metadata = segment.metadata
    assert (metadata.center_name, metadata.ref_frame, metadata.time_system) == ("MOON", "ICRF", "UTC")
    assert (metadata.object_name, metadata.object_id) == ("lander 5", "UNKNOWN")
    expected = spice_states(tmp_path, et_of(dates))
    assert np.abs(states - expected)[:, :3].max() < SAME_M
    assert np.abs(states - expected)[:, 3:].max() < SAME_M_S


def test_between_states_a_day_apart_the_stated_interpolation_holds(tmp_path):
    file = write_oem(tmp_path / "a.oem", CONTENT, "2020-12-01", "2020-12-05", originator="TEST", step_s=86400)
    dates, states, segment = read(file)
    assert (segment.metadata.interpolation, int(segment.metadata.interpolation_degree)) == ("HERMITE", 7)
    et_s = et_of(dates[:4])
    through = KroghInterpolator(
        np.repeat((et_s - et_s[0]) / 86400.0, 2),
        np.stack([states[:4, :3], states[:4, 3:] * 86400.0], axis=1).reshape(8, 3),
    )
    between_s = et_s[1] + np.array([20000.0, 43200.0])
    at = through((between_s - et_s[0]) / 86400.0)
    assert np.abs(at - spice_states(tmp_path, between_s)[:, :3]).max() < 1e-3


def test_the_covariance_is_that_of_the_position(tmp_path):
    file = write_oem(tmp_path / "lander.oem", CONTENT, *DAYS, originator="TEST")
    dates, states, segment = read(file)
    (covariance,) = segment.data.covariance_matrix
    assert str(covariance.epoch) == dates[0]
    axes = ("x", "y", "z", "x_dot", "y_dot", "z_dot")
    full = np.zeros((6, 6))
    for i, row in enumerate(axes):
        for j, column in enumerate(axes[: i + 1]):
            element = getattr(covariance, f"c{row}_{column}")
            full[i, j] = full[j, i] = float(getattr(element, "value", element)) * 1e6
    variances, directions = np.linalg.eigh(full[:3, :3])
    np.testing.assert_allclose(np.sqrt(variances), np.sort(SIGMAS_M), rtol=1e-6)
    # Up is known worst, and north best; the velocity turns with the position.
    up = states[0, :3] / np.linalg.norm(states[0, :3])
    assert abs(directions[:, 2] @ up) == pytest.approx(1.0, abs=1e-9)
    assert abs(directions[2, 0]) > 0.6
    turned_m_s = math.sqrt(np.trace(full[3:, 3:]))
    assert 2.66e-6 * 4.0 < turned_m_s < 2.67e-6 * np.linalg.norm(SIGMAS_M)
    assert np.linalg.matrix_rank(full[:3], tol=1e-6) == 3


def test_a_position_that_was_held_has_no_covariance(tmp_path):
    undetermined = recorded(sigma_m=[math.inf] * 3, covariance={"enu_m2": [[None] * 3] * 3})
    for name, content in (("held", recorded(sigma_m=[0.0] * 3)), ("none", undetermined)):
        text = write_oem(tmp_path / name, content, *DAYS, originator="TEST").read_text()
        assert "COVARIANCE" not in text


@pytest.mark.parametrize(
    ("change", "changes", "message"),
    [
        ({"position": None}, {}, "expected a position"),
        ({}, {"step_s": 0.0}, "step_s"),
        ({}, {"stop_utc": DAYS[0]}, "after the start"),
    ],
)
def test_invalid_options_of_messages_are_refused(tmp_path, change, changes, message):
    options = {"start_utc": DAYS[0], "stop_utc": DAYS[1], "originator": "TEST"} | changes
    with pytest.raises(InputError, match=message):
        write_oem(tmp_path / "a.oem", CONTENT | change, **options)
    assert not list(tmp_path.iterdir())


def test_the_command_writes_positions(tmp_path, capsys):
    solution = tmp_path / "solution.json"
    solution.write_text(json.dumps(CONTENT))
    options = ["export", str(solution), str(tmp_path / "a.oem"), "--start", DAYS[0], "--stop", DAYS[1]]
    assert main(options) == 2
    assert "--originator" in capsys.readouterr().err
    assert main([*options, "--originator", "TEST", "--step", "600"]) == 0
    assert len(read(tmp_path / "a.oem")[0]) == 220


IMPULSE = Impulse("turn", EPOCH.shifted(1000.0), (1.0, -2.0, 3.0))
SAME_ALONG_ORBIT_M_S = 2e-7  # Hermite polynomials through states 15 s apart; rounding of 4e8 m
COVARIANCE = np.diag([1.0, 4.0, 9.0, 1e-6, 4e-6, 9e-6]) + 1e-7


@pytest.fixture(scope="module", name="orbit")
def _orbit():
    burn = Acceleration(
        "burn", start=EPOCH.shifted(-700.3), stop=EPOCH.shifted(-600.0), constant_m_s2=(0.1, 0, 0)
    )
    model = forces(100, impulses=(IMPULSE,), accelerations=(burn,))
    return replace(propagated(model, (-3600.0, 3600.0)), name="GRAIL-B")


def test_spk(orbit, tmp_path):
    trajectory = Trajectory.open(write_orbit_spk(tmp_path / "orbit.bsp", orbit, ORBITER), ORBITER)
    times_s = np.array([-3600.0, -650.0, -333.3, 0.0, 17.0, 999.999, 1000.001, 2345.678, 3600.0])
    tdb = EPOCH.shifted(times_s)
    for axis, column, limit in zip(
        orbit.geocentric(Ephemeris.open(), tdb),
        trajectory.geocentric(Ephemeris.open(), tdb),
        (SAME_M, SAME_ALONG_ORBIT_M_S),
        strict=True,
    ):
        assert np.abs(axis - column).max() < limit
    assert len(trajectory.segments) == 5


def test_oem(orbit, tmp_path):
    path = write_orbit_oem(
        tmp_path / "orbit.oem", orbit, originator="TEST", covariance=COVARIANCE, step_s=60.0
    )
    segments = message_of(path).body.segment
    assert len(segments) == 5
    metadata = segments[0].metadata
    assert (metadata.object_name, metadata.center_name, metadata.ref_frame) == ("GRAIL-B", "MOON", "ICRF")
    assert (metadata.time_system, metadata.interpolation_degree) == ("TDB", 11)
    state_before, state_after = segments[3].data.state_vector[-1], segments[4].data.state_vector[0]
    assert str(state_before.epoch) == str(state_after.epoch) == "2012-04-09T04:46:40.000000000"
    jump_m_s = (numbers(state_after, NAMES) - numbers(state_before, NAMES))[3:] * 1e3
    assert np.linalg.norm(jump_m_s) == pytest.approx(np.sqrt(14.0), abs=1e-8)
    last = segments[4].data.state_vector[-1]
    np.testing.assert_allclose(numbers(last, NAMES) * 1e3, at(orbit, 3600.0)[0], rtol=0, atol=1e-6)
    (covariance,) = segments[2].data.covariance_matrix
    assert float(covariance.cz_z.value) == pytest.approx(9.0e-6, rel=1e-6)


def test_opm(orbit, tmp_path):
    path = write_orbit_opm(tmp_path / "orbit.opm", orbit, originator="TEST", covariance=COVARIANCE)
    data = message_of(path).body.segment.data
    np.testing.assert_allclose(numbers(data.state_vector, NAMES) * 1e3, STATE, rtol=0, atol=1e-8)
    (manoeuvre,) = data.maneuver_parameters
    assert manoeuvre.man_ref_frame == "RTN"
    assert str(manoeuvre.man_epoch_ignition) == "2012-04-09T04:46:40.000000000"
    np.testing.assert_allclose(
        numbers(manoeuvre, [f"man_dv_{k}" for k in (1, 2, 3)]) * 1e3, IMPULSE.delta_v_m_s, rtol=0, atol=1e-9
    )
    assert float(data.covariance_matrix.cz_dot_z_dot.value) == pytest.approx(9.1e-12, rel=1e-6)


def test_invalid_orbit_messages_are_refused(orbit, tmp_path):
    with pytest.raises(InputError, match="shape"):
        write_orbit_oem(tmp_path / "orbit.oem", orbit, originator="TEST", covariance=np.eye(3))
