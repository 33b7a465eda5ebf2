"""Messages of the CCSDS: ephemerides of landers and orbits, orbit parameters.

Sources: CCSDS 502.0-B-2 (2009), chapters 3, 5 and 7, which issue 3 (2023) still allows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from radioloc.dynamics import Orbit
from radioloc.ephemeris import CONSTANTS, LunarOrientation
from radioloc.errors import InputError
from radioloc.io.spice_kernels import M_PER_KM, orbit_parts, states_km
from radioloc.io.tdm.write import creation_date_now
from radioloc.lunar import east_north_up, rot_icrf_to_pa, rot_pa_to_me
from radioloc.lunar.frames import rot_icrf_to_pa_rate
from radioloc.quantities import accepts_quantities
from radioloc.results.tables import SolutionLike, position_of, single_content
from radioloc.text_files import write_text
from radioloc.time import Epochs, epochs_from_strings, to_scale, utc_strings
from radioloc.vectors import Floats

_MAX_STEP_S = 86400.0  # Polynomials of degree 7 through states a day apart are off by 0.1 mm
_POINT_DEGREE, _ORBIT_DEGREE = 7, 11  # of the Hermite polynomials between states


@accepts_quantities
def write_oem(
    path: str | Path,
    solution: SolutionLike,
    start_utc: str,
    stop_utc: str,
    *,
    originator: str,
    step_s: float = 3600.0,
) -> Path:
    """Write the inertial states of a lander as an OEM in KVN, with the covariance at the first epoch."""
    # With the position r in principal axes, without tides, and the rotation R to the ICRF, states are (R r, R' r).
    # Their covariance is J P J^T with J = (R, R') and the total covariance P of the position.
    content = single_content([solution])
    pa = position_of(content)["pa"]
    tai = _epochs(start_utc, stop_utc, step_s)
    to_icrf = _rotation(pa["frame"], tai)
    states = to_icrf @ [pa[f"{axis}_m"] / M_PER_KM for axis in "xyz"]
    dates = [str(date) for date in utc_strings(to_scale(tai, "UTC"), decimals=6)]
    covariance_pa_m2 = _covariance_pa_m2(content)
    at_first = None
    if covariance_pa_m2 is not None:
        at_first = dates[0], to_icrf[0] @ covariance_pa_m2 @ to_icrf[0].T
    metadata = _metadata(content["name"], "UTC")
    comment = f"a point fixed in {pa['frame']}, without tides"
    segment = _segment(metadata, dates, states, _POINT_DEGREE, at_first, comment)
    return _write(path, "OEM", originator, segment)


@accepts_quantities
def write_orbit_oem(
    path: str | Path,
    orbit: Orbit | Sequence[Orbit],
    *,
    originator: str,
    step_s: float = 15.0,
    covariance: ArrayLike | None = None,
) -> Path:
    """Write an orbit, or several that follow each other, as an OEM in KVN: Moon-centred, axes of the ICRF, TDB.

    A segment ends where an impulse or thrust begins or ends. The covariance, m and m/s, is that of the state at the
    epoch of the first orbit, shape (6, 6).
    """
    lines = []
    for part, times_s in orbit_parts(orbit, step_s):
        dates = [str(date) for date in utc_strings(part.epoch.shifted(times_s), 9)]
        at_epoch = None
        if covariance is not None and times_s[0] <= 0.0 <= times_s[-1]:
            at_epoch, covariance = (str(utc_strings(part.epoch, 9)[0]), covariance), None
        metadata = _metadata(part.name, "TDB")
        lines += _segment(metadata, dates, states_km(part, times_s), _ORBIT_DEGREE, at_epoch)
    return _write(path, "OEM", originator, lines)


@accepts_quantities
def write_orbit_opm(
    path: str | Path, orbit: Orbit, *, originator: str, covariance: ArrayLike | None = None
) -> Path:
    """Write an orbit's state at its epoch with its covariance, and its impulses, as an OPM in KVN."""
    (state,) = states_km(orbit, np.zeros(1))
    fields = _metadata(orbit.name, "TDB") | {"EPOCH": str(utc_strings(orbit.epoch, 9)[0])}
    names = ["X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT"]
    fields |= {name: f"{x:.12f}" for name, x in zip(names, state, strict=True)}
    if covariance is not None:
        fields["COV_REF_FRAME"] = "ICRF"
        for name, row in zip(names, _triangle_km2(covariance), strict=True):
            fields |= {f"C{name}_{column}": f"{x:.12e}" for column, x in zip(names, row, strict=False)}
    lines = [*_lines(fields)]
    for impulse in orbit.forces.impulses:
        lines += _lines(
            {
                "MAN_EPOCH_IGNITION": str(utc_strings(impulse.epoch, 9)[0]),
                "MAN_DURATION": "0.0",
                "MAN_DELTA_MASS": "0.0",
                "MAN_REF_FRAME": impulse.axes,
            }
            | {f"MAN_DV_{k}": f"{dv / M_PER_KM:.12f}" for k, dv in enumerate(impulse.delta_v_m_s, 1)}
        )
    return _write(path, "OPM", originator, lines)


def _write(path: str | Path, kind: str, originator: str, lines: Sequence[str]) -> Path:
    """Write a message such as an OEM, in KVN, with the present date."""
    header = _lines({"CREATION_DATE": creation_date_now(), "ORIGINATOR": originator})
    write_text(path, "\n".join([f"CCSDS_{kind}_VERS = 2.0", *header, *lines]) + "\n")
    return Path(path)


def _metadata(name: str, scale: str) -> dict[str, str]:
    """Return the object and the frame of its states: about the Moon's centre, axes of the ICRF."""
    centre = {"CENTER_NAME": "MOON", "REF_FRAME": "ICRF", "TIME_SYSTEM": scale}
    return {"OBJECT_NAME": name, "OBJECT_ID": "UNKNOWN"} | centre


def _segment(
    metadata: Mapping[str, str],
    dates: Sequence[str],
    states: Floats,
    degree: int,
    covariance: tuple[str, ArrayLike] | None,
    comment: str | None = None,
) -> list[str]:
    """Return a segment of an OEM: states (n, 6), km and km/s, and a covariance (6, 6) at a date, m and m/s."""
    fields = dict(metadata) | {
        "START_TIME": dates[0],
        "STOP_TIME": dates[-1],
        "INTERPOLATION": "HERMITE",
        "INTERPOLATION_DEGREE": str(min(degree, 2 * len(dates) - 1)),
    }
    lines = ["META_START", *_lines(fields), "META_STOP"]
    lines += [] if comment is None else [f"COMMENT {comment}"]
    for date, state in zip(dates, states, strict=True):
        place = " ".join(f"{x:.9f}" for x in state[:3])
        lines.append(f"{date} {place} {' '.join(f'{x:.12f}' for x in state[3:])}")
    if covariance is not None:
        date, covariance_m2 = covariance
        rows = (" ".join(f"{x:.9e}" for x in row) for row in _triangle_km2(covariance_m2))
        lines += ["COVARIANCE_START", f"EPOCH = {date}", *rows, "COVARIANCE_STOP"]
    return lines


def _triangle_km2(covariance: ArrayLike) -> list[list[float]]:
    """Return the lower triangle by rows, km and km/s, of a state's covariance in m and m/s, shape (6, 6)."""
    matrix = np.asarray(covariance, dtype=np.float64)
    if matrix.shape != (6, 6) or not np.isfinite(matrix).all() or (np.diag(matrix) < 0.0).any():
        raise InputError("covariance: expected finite numbers of shape (6, 6), the covariance of a state")
    return [(row[: k + 1] / M_PER_KM**2).tolist() for k, row in enumerate(matrix)]


def _lines(fields: Mapping[str, str]) -> Iterator[str]:
    """Yield lines of keywords and texts, which must be printable ASCII."""
    for keyword, text in fields.items():
        if not (text.strip() and text.isascii() and text.isprintable()):
            raise InputError(f"{keyword}: expected one line of printable ASCII text, got {text!r}")
        yield f"{keyword} = {text}"


def _epochs(start_utc: str, stop_utc: str, step_s: float) -> Epochs:
    """Return epochs of TAI at equal steps, and the last where it lies between two."""
    start, stop = (to_scale(epochs_from_strings(date, "UTC"), "TAI") for date in (start_utc, stop_utc))
    span_s = float(stop.seconds_since(start)[0])
    if not span_s > 0.0:
        raise InputError(f"expected a stop after the start {start_utc}, got {stop_utc}")
    if not 0.0 < step_s <= _MAX_STEP_S:
        raise InputError(f"step_s: expected above 0 and at most {_MAX_STEP_S:.0f} s, got {step_s!r}")
    offsets_s = np.append(np.arange(math.ceil(span_s / step_s)) * step_s, span_s)
    return start[np.zeros(len(offsets_s), dtype=int)].shifted(offsets_s)


def _rotation(frame: str, epochs: Epochs) -> Floats:
    """Return the matrices from a point fixed in principal axes to its state in the ICRF, shape (n, 6, 3)."""
    orientation = LunarOrientation.open(frame.removeprefix("PA_"))
    angles_rad, rates_rad_s = orientation.angles(to_scale(epochs, "TDB"))
    rotation, rate = rot_icrf_to_pa(angles_rad), rot_icrf_to_pa_rate(angles_rad, rates_rad_s)
    return np.concatenate([np.swapaxes(rotation, -1, -2), np.swapaxes(rate, -1, -2)], axis=-2)


def _covariance_pa_m2(content: Mapping[str, Any]) -> Floats | None:
    """Return the total covariance of the position in principal axes; None where it is not determined, or held."""
    me, ephemeris = content["position"]["me"], content["position"]["pa"]["frame"].removeprefix("PA_")
    enu_m2 = np.array(content["covariance"]["enu_m2"], dtype=np.float64)
    if not (np.isfinite(enu_m2).all() and enu_m2.any()):
        return None
    to_enu = east_north_up(
        math.radians(me["longitude_deg"]), math.radians(me["latitude_deg"])
    ) @ rot_pa_to_me(CONSTANTS[ephemeris])
    return np.asarray(to_enu.T @ enu_m2 @ to_enu)
