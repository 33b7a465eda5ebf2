"""A lander as an Orbit Ephemeris Message: read by another implementation, states by SPICE."""

import json
import math

import numpy as np
import pytest
import spiceypy
from scipy.interpolate import KroghInterpolator
from spk_files import position_on_moon

from radioloc.cli import main
from radioloc.errors import InputError
from radioloc.kernels import find_kernel
from radioloc.report import write_oem, write_spice
from radioloc.time import epochs_from_strings, to_scale

DAYS = ("2020-12-01T12:00:00", "2020-12-03T00:30:00")
SIGMAS_M = np.array([10.0, 4.0, 30.0])
CONTENT = position_on_moon() | {"covariance": {"enu_m2": np.diag(SIGMAS_M**2).tolist()}}

# Nine decimals of a kilometre, rounded; a double of seconds since J2000 is 0.06 us wrong, at 4.6 m/s.
SAME_M, SAME_M_S = 1e-6, 2e-9


def read(path):
    """Dates, states in m and m/s, and the segment, as ccsds-ndm has them."""
    ndm_io = pytest.importorskip("ccsds_ndm.ndm_io")
    (segment,) = ndm_io.NdmIo().from_path(path).body.segment
    rows = segment.data.state_vector
    names = ("x", "y", "z", "x_dot", "y_dot", "z_dot")
    states = [[float(getattr(getattr(row, name), "value")) for name in names] for row in rows]  # noqa: B009
    return [str(row.epoch) for row in rows], np.array(states) * 1e3, segment


def spice_states(tmp_path, et_s):
    files = write_spice(CONTENT, tmp_path / "lander.bsp")
    kernels = [find_kernel("DE421", kind) for kind in ("SPK", "PCK")]
    with spiceypy.KernelPool([str(file) for file in (*kernels, *files)]):
        return np.array([spiceypy.spkgeo(301001, et, "J2000", 301)[0] for et in et_s]) * 1e3


def et_of(dates):
    return to_scale(epochs_from_strings(dates), "TDB").seconds_since(
        epochs_from_strings("2000-01-01T12:00:00", "TDB")
    )


def test_states_are_those_of_spice(tmp_path):
    file = write_oem(CONTENT, tmp_path / "lander.oem", *DAYS, originator="TEST", step_s=7200.0)
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
    file = write_oem(CONTENT, tmp_path / "a.oem", "2020-12-01", "2020-12-05", originator="TEST", step_s=86400)
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
    file = write_oem(CONTENT, tmp_path / "lander.oem", *DAYS, originator="TEST")
    dates, states, segment = read(file)
    (covariance,) = segment.data.covariance_matrix
    assert str(covariance.epoch) == dates[0]
    axes = ("x", "y", "z", "x_dot", "y_dot", "z_dot")
    full = np.zeros((6, 6))
    for i, one in enumerate(axes):
        for j, other in enumerate(axes[: i + 1]):
            element = getattr(covariance, f"c{one}_{other}")
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
    for name, of_enu in (("held", np.zeros((3, 3)).tolist()), ("none", [[None] * 3] * 3)):
        content = CONTENT | {"covariance": {"enu_m2": of_enu}}
        text = write_oem(content, tmp_path / name, *DAYS, originator="TEST").read_text()
        assert "COVARIANCE" not in text


@pytest.mark.parametrize(
    ("change", "given", "message"),
    [
        ({"position": None}, {}, "no fixed position"),
        ({"name": "嫦娥"}, {}, "OBJECT_NAME .* printable ASCII"),
        ({}, {"originator": " "}, "ORIGINATOR"),
        ({}, {"step_s": 0.0}, "step 0.0 s is not"),
        ({}, {"step_s": math.nan}, "step nan s is not"),
        ({}, {"step_s": 86401.0}, "at most 86400 s"),
        ({}, {"stop_utc": DAYS[0]}, "is not after start"),
        ({}, {"start_utc": "yesterday"}, "'yesterday' is not a date"),
    ],
)
def test_what_cannot_be_written_is_refused(tmp_path, change, given, message):
    asked = {"start_utc": DAYS[0], "stop_utc": DAYS[1], "originator": "TEST"} | given
    with pytest.raises(InputError, match=message):
        write_oem(CONTENT | change, tmp_path / "a.oem", **asked)
    assert not list(tmp_path.iterdir())


def test_the_command(tmp_path, capsys):
    recorded = CONTENT | {"converged": True, "reference": None, "provenance": {}, "fit": {}}
    xyz = dict(zip(("x_m", "y_m", "z_m"), (8e5, -1e6, 1.2e6), strict=True))
    recorded |= {"sigma": {}, "position": CONTENT["position"] | {"me": CONTENT["position"]["me"] | xyz}}
    solution = tmp_path / "solution.json"
    solution.write_text(json.dumps(recorded))
    asked = ["export", str(solution), str(tmp_path / "a.oem"), "--start", DAYS[0], "--stop", DAYS[1]]
    with pytest.raises(SystemExit, match="2"):
        main(asked)
    assert "--originator" in capsys.readouterr().err
    assert main([*asked, "--originator", "TEST", "--step", "600"]) == 0
    assert len(read(tmp_path / "a.oem")[0]) == 220
