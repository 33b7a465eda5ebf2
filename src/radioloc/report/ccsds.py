"""What CCSDS orbit data messages have in common, in KVN.

Source: CCSDS 502.0-B-2 (2009), chapters 3, 5 and 7, which issue 3 (2023) goes on to read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.errors import InputError

M_PER_KM = 1000.0


def header(kind: str, originator: str, creation_date: str | None) -> list[str]:
    """The first lines of a message such as an OEM; its date is now if none is given."""
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")
    fields = {"CREATION_DATE": creation_date or now, "ORIGINATOR": originator}
    return [f"CCSDS_{kind}_VERS = 2.0", *message_fields(fields)]


def lunar_metadata(name: str, object_id: str, scale: str) -> dict[str, str]:
    """Whose states they are: about the Moon's centre, axes of the ICRF."""
    centre = {"CENTER_NAME": "MOON", "REF_FRAME": "ICRF", "TIME_SYSTEM": scale}
    return {"OBJECT_NAME": name, "OBJECT_ID": object_id} | centre


def ephemeris_segment(
    metadata: Mapping[str, str],
    dates: Sequence[str],
    states_km: NDArray[np.float64],
    degree: int,
    comment: str | None = None,
    covariance: tuple[str, ArrayLike] | None = None,
) -> list[str]:
    """A segment of an OEM: states, shape (n, 6), and a covariance at a date, m and m/s, shape (6, 6)."""
    fields = dict(metadata) | {
        "START_TIME": dates[0],
        "STOP_TIME": dates[-1],
        "INTERPOLATION": "HERMITE",
        "INTERPOLATION_DEGREE": str(min(degree, 2 * len(dates) - 1)),
    }
    lines = ["META_START", *message_fields(fields), "META_STOP"]
    lines += [] if comment is None else [f"COMMENT {comment}"]
    for date, state in zip(dates, states_km, strict=True):
        place = " ".join(f"{x:.9f}" for x in state[:3])
        lines.append(f"{date} {place} {' '.join(f'{x:.12f}' for x in state[3:])}")
    if covariance is not None:
        date, of_state = covariance
        rows = (" ".join(f"{x:.9e}" for x in row) for row in triangle_km2(of_state))
        lines += ["COVARIANCE_START", f"EPOCH = {date}", *rows, "COVARIANCE_STOP"]
    return lines


def triangle_km2(covariance: ArrayLike) -> list[list[float]]:
    """Lower triangle by rows, km and km/s, of a state's covariance in m and m/s, shape (6, 6)."""
    whole = np.asarray(covariance, dtype=np.float64)
    if whole.shape != (6, 6) or not np.isfinite(whole).all() or (np.diag(whole) < 0.0).any():
        raise InputError("covariance must be that of a state, finite numbers of shape (6, 6)")
    return [(row[: k + 1] / M_PER_KM**2).tolist() for k, row in enumerate(whole)]


def message_fields(fields: Mapping[str, str]) -> Iterator[str]:
    """Lines of keywords and texts, which have to be printable ASCII."""
    for keyword, text in fields.items():
        if not (text.strip() and text.isascii() and text.isprintable()):
            raise InputError(
                f"{keyword} {text!r} cannot stand in a message of the CCSDS; give printable ASCII text of one line"
            )
        yield f"{keyword} = {text}"
