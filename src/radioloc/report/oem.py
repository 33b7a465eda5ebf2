"""A lander as a CCSDS Orbit Ephemeris Message: states about the Moon's centre in the axes of the ICRF.

Source: CCSDS 502.0-B-2 (2009), chapter 5, which issue 3 (2023) goes on to read.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.boundary import bare_arguments
from radioloc.ephemeris import CONSTANTS, LunarOrientation
from radioloc.errors import InputError
from radioloc.estimation.solution import Solution
from radioloc.lunar import east_north_up, rot_icrf_to_pa, rot_pa_to_me
from radioloc.lunar.frames import rot_icrf_to_pa_rate
from radioloc.report.ccsds import M_PER_KM, ephemeris_segment, header, lunar_metadata
from radioloc.report.image_solution import ImageSolution
from radioloc.text_files import write_text
from radioloc.time import Epochs, epochs_from_strings, to_scale, utc_strings

_LONGEST_STEP_S = 86400.0
"""Polynomials of degree 7 through states a day apart are off by 0.1 mm."""
_DEGREE = 7


@bare_arguments
def write_oem(
    solution: Solution | ImageSolution | Mapping[str, Any],
    path: str | Path,
    start_utc: str,
    stop_utc: str,
    *,
    originator: str,
    step_s: float = 3600.0,
    object_id: str = "UNKNOWN",
    creation_date: str | None = None,
) -> Path:
    """Write where a lander is, as it turns with the Moon, with its covariance at the first epoch.

    Parameters
    ----------
    solution : Solution, ImageSolution or mapping
        Whose position is written; a mapping is what ``solution.json`` holds.
    path : path-like
        The message, in KVN.
    start_utc, stop_utc : str
        First and last epoch, UTC.
    originator : str
        Agency that makes the message.
    step_s : float
        From state to state, s, a day at most.
    object_id : str
        International designator, such as ``"2020-087B"``.
    creation_date : str, optional
        UTC date of the message; now by default.

    Raises
    ------
    InputError
        The solution has no position, the stop is not after the start, the step is not one, or a text is not printable
        ASCII.
    KernelError
        The axes of the position are those of an ephemeris whose orientation does not ship.
    CoverageError
        An epoch lies outside the orientation's span.

    Notes
    -----
    The position is that of the solution in principal axes, turned by their libration; tides are not added. With
    radii r in principal axes and the rotation R from these to the ICRF, states are (R r, R' r), and their covariance
    is J P J' with J = (R, R') and the position's total covariance P.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> days = "2007-06-01", "2007-06-08"
    >>> radioloc.report.write_oem(solution, "apollo15.oem", *days, originator="AGENCY").name
    'apollo15.oem'
    """
    content = solution if isinstance(solution, Mapping) else solution.to_dict()
    if not content["position"]:
        raise InputError(
            f"{content['name']}: there is no fixed position to write; it has a trajectory already"
        )
    tai = _epochs(start_utc, stop_utc, step_s)
    pa = content["position"]["pa"]
    to_icrf = _rotation(pa["frame"], tai)
    states_km = to_icrf @ [pa[f"{axis}_m"] / M_PER_KM for axis in "xyz"]
    dates = [str(date) for date in utc_strings(to_scale(tai, "UTC"), decimals=6)]
    covariance_pa_m2 = _covariance_pa_m2(content)
    segment = ephemeris_segment(
        lunar_metadata(content["name"], object_id, "UTC"),
        dates,
        states_km,
        _DEGREE,
        comment=f"a point at rest in {pa['frame']}, tides left out",
        covariance=None
        if covariance_pa_m2 is None
        else (dates[0], to_icrf[0] @ covariance_pa_m2 @ to_icrf[0].T),
    )
    write_text(path, "\n".join([*header("OEM", originator, creation_date), *segment]) + "\n")
    return Path(path)


def _epochs(start_utc: str, stop_utc: str, step_s: float) -> Epochs:
    """Epochs of TAI at equal steps, and the last where it comes between two."""
    start, stop = (to_scale(epochs_from_strings(date), "TAI") for date in (start_utc, stop_utc))
    span_s = float(stop.seconds_since(start)[0])
    if not span_s > 0.0:
        raise InputError(f"stop {stop_utc} is not after start {start_utc}; exchange or correct them")
    if not 0.0 < step_s <= _LONGEST_STEP_S:
        raise InputError(f"step {step_s!r} s is not more than 0 and at most {_LONGEST_STEP_S:.0f} s")
    offsets_s = np.append(np.arange(math.ceil(span_s / step_s)) * step_s, span_s)
    return start[np.zeros(len(offsets_s), dtype=int)].shifted(offsets_s)


def _rotation(frame: str, epochs: Epochs) -> NDArray[np.float64]:
    """From a point at rest in principal axes to its state in the ICRF, shape (n, 6, 3)."""
    orientation = LunarOrientation.open(frame.removeprefix("PA_"))
    angles_rad, rates_rad_s = orientation.angles(to_scale(epochs, "TDB"))
    halves = rot_icrf_to_pa(angles_rad), rot_icrf_to_pa_rate(angles_rad, rates_rad_s)
    return np.concatenate([np.swapaxes(half, -1, -2) for half in halves], axis=-2)


def _covariance_pa_m2(content: Mapping[str, Any]) -> NDArray[np.float64] | None:
    """Total covariance of the position in principal axes; None where it is not determined, or held."""
    me, ephemeris = content["position"]["me"], content["position"]["pa"]["frame"].removeprefix("PA_")
    of_enu = np.array(content["covariance"]["enu_m2"], dtype=np.float64)
    if not (np.isfinite(of_enu).all() and of_enu.any()):
        return None
    to_enu = east_north_up(
        math.radians(me["longitude_deg"]), math.radians(me["latitude_deg"])
    ) @ rot_pa_to_me(CONSTANTS[ephemeris])
    return np.asarray(to_enu.T @ of_enu @ to_enu)
