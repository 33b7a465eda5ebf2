"""An integrated orbit as files: SPK of type 13, CCSDS Orbit Ephemeris Message and Orbit Parameter Message.

Sources: NAIF's *SPK Required Reading*; CCSDS 502.0-B-2 (2009), chapters 3 and 5, which issue 3 (2023) goes on to read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.boundary import bare_arguments
from radioloc.constants import J2000_JD, SECONDS_PER_DAY
from radioloc.dynamics import Orbit
from radioloc.errors import InputError
from radioloc.estimation.orbit_state import OrbitState
from radioloc.report.ccsds import (
    M_PER_KM,
    ephemeris_segment,
    header,
    lunar_metadata,
    message_fields,
    triangle_km2,
)
from radioloc.text_files import replaced_file, write_text
from radioloc.time import Epochs, utc_strings

Floats = NDArray[np.float64]

_MOON = 301
_DEGREE = 11
_LONGEST_STEP_S = 600.0


ORBIT_FILES = ("orbit.bsp", "orbit.oem", "orbit.opm")
"""Names of the files of an orbit that was determined."""


def orbit_writers(state: OrbitState, arcs: Sequence[OrbitState] = ()) -> dict[str, Callable[[Path], Path]]:
    """What writes an orbit that was determined, or its arcs up to the epoch of the next, to :data:`ORBIT_FILES`.

    Both messages have the covariance of the first state; the OPM is of that one alone.
    """
    whole = [one.orbit for one in (arcs or (state,))]
    starts_s = [whole[0].span_s[0], *(0.0 for _ in whole[1:])]
    stops_s = [float(b.epoch.seconds_since(a.epoch)[0]) for a, b in pairwise(whole)] + [whole[-1].span_s[1]]
    spans_s = zip(starts_s, stops_s, strict=True)
    orbits = [replace(one, span_s=s).integrate() for one, s in zip(whole, spans_s, strict=True)]
    message: dict[str, Any] = {"originator": "radioloc"}
    if np.isfinite(state.covariance).all() and state.covariance.any():
        message["covariance"] = state.covariance
    writers = (
        partial(write_orbit_spk, orbits, body=state.body),
        partial(write_orbit_oem, orbits, **message),
        partial(write_orbit_opm, orbits[0], **message),
    )
    return dict(zip(ORBIT_FILES, writers, strict=True))


@bare_arguments
def write_orbit_spk(
    orbit: Orbit | Sequence[Orbit], path: str | Path, body: int, *, step_s: float = 15.0
) -> Path:
    """Write an orbit as an SPK of type 13, Hermite polynomials of degree 11 through states at equal steps.

    Parameters
    ----------
    orbit : Orbit or sequence of Orbit
        One, or several from one after the other, each with segments of its own.
    path : path-like
        The file, ``.bsp``; one that is there is replaced.
    body : int
        NAIF code of the spacecraft, negative, such as -177.
    step_s : float
        From state to state, s, 600 at most; of 15 s the error is a micrometre in a low orbit and a field to degree 150.

    Raises
    ------
    InputError
        The code is not one of a spacecraft, or the step is not one.

    Examples
    --------
    >>> from radioloc.dynamics import Forces, GravityField, propagate
    >>> from radioloc.ephemeris import Trajectory
    >>> from radioloc.report import write_orbit_spk
    >>> from radioloc.time import epochs_from_strings
    >>> epoch = epochs_from_strings("2012-04-09T04:30:00", "TDB")
    >>> forces = Forces(GravityField.open("GRGM660PRIM", degree=20))
    >>> orbit = propagate(epoch, [575750.0, -463261.0, -1631634.0], [-567.855, 1434.222, -600.22], forces, (0, 600))
    >>> print(Trajectory.open(write_orbit_spk(orbit, "orbit.bsp", -177), -177))
    body -177 of orbit.bsp, 2012-04-09T04:30:00 to 2012-04-09T04:40:00 TDB
    """
    import spiceypy

    if isinstance(body, bool) or not isinstance(body, int) or not -(2**31) < body < 0:
        raise InputError(
            f"body {body!r} is no NAIF code of a spacecraft; give a negative integer such as -177"
        )
    with replaced_file(path) as temporary:
        temporary.unlink()
        handle = spiceypy.spkopn(str(temporary), "radioloc", 0)
        try:
            for part, times_s in _parts(orbit, step_s):
                midnight_s = float((part.epoch.jd[0] - J2000_JD) * SECONDS_PER_DAY)
                of_day_s = float(part.epoch.fraction[0] * SECONDS_PER_DAY)
                et_s = midnight_s + of_day_s + times_s
                states = _states_km(part, times_s)
                # A float of seconds since J2000 is off by up to 0.06 us: 0.1 mm along a low orbit.
                rest_s = (midnight_s - et_s) + of_day_s + times_s
                states[:, :3] -= states[:, 3:] * rest_s[:, None]
                degree = min(_DEGREE, 2 * len(et_s) - 1)
                span = et_s[0], et_s[-1]
                spiceypy.spkw13(
                    handle,
                    body,
                    _MOON,
                    "J2000",
                    *span,
                    part.name[:40],
                    degree,
                    len(et_s),
                    states.tolist(),
                    et_s.tolist(),
                )
        finally:
            spiceypy.spkcls(handle)
    return Path(path)


@bare_arguments
def write_orbit_oem(
    orbit: Orbit | Sequence[Orbit],
    path: str | Path,
    *,
    originator: str,
    step_s: float = 15.0,
    object_id: str = "UNKNOWN",
    covariance: ArrayLike | None = None,
    creation_date: str | None = None,
) -> Path:
    """Write an orbit as an Orbit Ephemeris Message, in KVN: Moon-centred, axes of the ICRF, TDB.

    Parameters
    ----------
    orbit : Orbit or sequence of Orbit
        One, or several from one after the other. Where an impulse or thrust begins or ends, so does a segment.
    path : path-like
    originator : str
        Agency that makes the message.
    step_s : float
        From state to state, s, 600 at most.
    object_id : str
        International designator, such as ``"2011-046B"``.
    covariance : array_like, shape (6, 6), optional
        Of the state at the epoch of the first orbit, ICRF axes, m and m/s.
    creation_date : str, optional
        UTC date of the message; now by default.

    Raises
    ------
    InputError
        The step is not one, the covariance is none, or a text is not printable ASCII.

    Examples
    --------
    >>> from radioloc.dynamics import Forces, GravityField, propagate
    >>> from radioloc.report import write_orbit_oem
    >>> from radioloc.time import epochs_from_strings
    >>> epoch = epochs_from_strings("2012-04-09T04:30:00", "TDB")
    >>> forces = Forces(GravityField.open("GRGM660PRIM", degree=20))
    >>> orbit = propagate(epoch, [575750.0, -463261.0, -1631634.0], [-567.855, 1434.222, -600.22], forces, (0, 600))
    >>> write_orbit_oem(orbit, "orbit.oem", originator="AGENCY").name
    'orbit.oem'
    """
    lines = header("OEM", originator, creation_date)
    for part, times_s in _parts(orbit, step_s):
        dates = [str(date) for date in utc_strings(_at(part, times_s), 9)]
        at_epoch = None
        if covariance is not None and times_s[0] <= 0.0 <= times_s[-1]:
            at_epoch, covariance = (str(utc_strings(part.epoch, 9)[0]), covariance), None
        metadata = lunar_metadata(part.name, object_id, "TDB")
        lines += ephemeris_segment(metadata, dates, _states_km(part, times_s), _DEGREE, covariance=at_epoch)
    write_text(path, "\n".join(lines) + "\n")
    return Path(path)


@bare_arguments
def write_orbit_opm(
    orbit: Orbit,
    path: str | Path,
    *,
    originator: str,
    object_id: str = "UNKNOWN",
    covariance: ArrayLike | None = None,
    creation_date: str | None = None,
) -> Path:
    """Write an orbit's state at its epoch and its impulses as an Orbit Parameter Message, in KVN.

    Parameters as those of :func:`write_orbit_oem`, errors too.

    Examples
    --------
    >>> from radioloc.dynamics import Forces, GravityField, propagate
    >>> from radioloc.report import write_orbit_opm
    >>> from radioloc.time import epochs_from_strings
    >>> epoch = epochs_from_strings("2012-04-09T04:30:00", "TDB")
    >>> forces = Forces(GravityField.open("GRGM660PRIM", degree=20))
    >>> orbit = propagate(epoch, [575750.0, -463261.0, -1631634.0], [-567.855, 1434.222, -600.22], forces, (0, 600))
    >>> write_orbit_opm(orbit, "orbit.opm", originator="AGENCY").name
    'orbit.opm'
    """
    (state,) = _states_km(orbit, np.zeros(1))
    fields = lunar_metadata(orbit.name, object_id, "TDB") | {"EPOCH": str(utc_strings(orbit.epoch, 9)[0])}
    names = ["X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT"]
    fields |= {name: f"{x:.12f}" for name, x in zip(names, state, strict=True)}
    if covariance is not None:
        fields["COV_REF_FRAME"] = "ICRF"
        for name, row in zip(names, triangle_km2(covariance), strict=True):
            fields |= {f"C{name}_{other}": f"{x:.12e}" for other, x in zip(names, row, strict=False)}
    lines = [*header("OPM", originator, creation_date), *message_fields(fields)]
    for impulse in orbit.forces.impulses:
        lines += message_fields(
            {
                "MAN_EPOCH_IGNITION": str(utc_strings(impulse.epoch, 9)[0]),
                "MAN_DURATION": "0.0",
                "MAN_DELTA_MASS": "0.0",
                "MAN_REF_FRAME": impulse.axes,
            }
            | {f"MAN_DV_{k}": f"{dv / M_PER_KM:.12f}" for k, dv in enumerate(impulse.delta_v_m_s, 1)}
        )
    write_text(path, "\n".join(lines) + "\n")
    return Path(path)


def _parts(orbit: Orbit | Sequence[Orbit], step_s: float) -> Iterator[tuple[Orbit, Floats]]:
    """Each part without a jump, and equally spaced times in it from its epoch, both ends included."""
    if not 0.0 < step_s <= _LONGEST_STEP_S:
        raise InputError(f"step {step_s!r} s is not more than 0 and at most {_LONGEST_STEP_S:.0f} s")
    for one in (orbit,) if isinstance(orbit, Orbit) else orbit:
        for leg in one.legs:
            first_s, last_s = leg.span_s
            yield (
                replace(one, legs=(leg,)),
                np.linspace(first_s, last_s, 2 + int((last_s - first_s) / step_s)),
            )


def _at(orbit: Orbit, times_s: Floats) -> Epochs:
    return orbit.epoch.shifted(times_s)


def _states_km(orbit: Orbit, times_s: Floats) -> Floats:
    return np.hstack(orbit.states(_at(orbit, times_s))) / M_PER_KM
