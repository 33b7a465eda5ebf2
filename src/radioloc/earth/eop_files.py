"""Read the files in which the IERS and the USNO publish daily Earth orientation.

Two layouts of fixed columns are read, told apart by their rows: the IERS 20 C04 series (one row per 0h UTC,
all measured), and Bulletin A's finals2000A (measured values, then a year of predictions, then rows with a
date alone). Of finals2000A the Bulletin A columns are used, not the monthly Bulletin B beside them.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import ARCSEC_RAD
from radioloc.errors import FileFormatError
from radioloc.text_files import read_blocks
from radioloc.time import Epochs

_LARGEST_POLE_OFFSET_ARCSEC = 0.03
"""IAU 2000A offsets stay below 9 mas in all published rows; those of the 1980 theory reach 120 mas."""


class _Layout(NamedTuple):
    """Places of the columns in a row, counted from 1 as the formats' descriptions do."""

    series: str
    row: re.Pattern[bytes]
    width: int
    places: dict[str, tuple[int, int]]
    pole_offset_arcsec: float  # unit of dX, dY


_C04 = _Layout(
    "C04",
    re.compile(rb"\d{4}[ \d]{4}[ \d]{4}[ \d]{4} *\d{5}\.\d\d "),
    218,
    {"MJD": (17, 26), "x": (27, 38), "y": (39, 50), "UT1-UTC": (51, 62), "dX": (63, 74), "dY": (75, 86)},
    1.0,
)
_FLAGS = {"flag of x, y": (17, 17), "flag of UT1": (58, 58), "flag of dX, dY": (96, 96)}  # P is a prediction
_BULLETIN_A = _Layout(
    "Bulletin A",
    re.compile(rb"[ \d]{6} \d{5}\.\d\d [IP ]"),
    187,
    {"MJD": (8, 15), "x": (19, 27), "y": (38, 46), "UT1-UTC": (59, 68), "dX": (98, 106), "dY": (117, 125)}
    | _FLAGS,
    1e-3,
)


def read_eop_rows(
    path: str | Path, first_mjd_utc: float = 0.0, package: str = ""
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Read a C04 or finals2000A file, plain or gzip; which of the two it is, its rows tell.

    Returns the columns of :class:`radioloc.earth.eop.EopTable` from a date on, and its sources: the file, which may be
    that of a package. A missing value or day, and pole offsets of the 1980 nutation theory, are a
    :class:`FileFormatError`.
    """
    path = Path(path)
    texts = b"".join(block for _, block in read_blocks(path, encoding="latin-1")).split(b"\n")
    lines = np.array([k for k, text in enumerate(texts) if text.strip() and not text.startswith(b"#")]) + 1
    if not len(lines):
        raise FileFormatError(path, "has no rows; fetch or write it again")
    if len(texts) > 1 and 0 < len(texts[-1]) < len(texts[-2]):
        raise FileFormatError(path, "the last row was cut; fetch or write the file again", len(texts))
    layout = next((one for one in (_C04, _BULLETIN_A) if one.row.match(texts[lines[0] - 1])), None)
    if layout is None:
        raise FileFormatError(
            path,
            "this is a row of neither IERS 20 C04 (year, month, day, hour, MJD, x, y, UT1-UTC, dX, dY ...) "
            "nor finals2000A; download eopc04.1962-now or finals2000A.all",
            int(lines[0]),
        )
    places = layout.places.values()
    fields: Any = {
        "names": list(layout.places),
        "formats": [f"S{last - first + 1}" for first, last in places],
        "offsets": [first - 1 for first, _ in places],
        "itemsize": layout.width,
    }
    rows = np.array([texts[k - 1] for k in lines], dtype=f"S{layout.width}").view(np.dtype(fields))

    def numbers(name: str, blank_allowed: bool = False) -> NDArray[np.float64]:
        text = rows[name]
        if blank_allowed:
            text = np.where(np.char.strip(text) != b"", text, b"nan")
        try:
            values = text.astype(np.float64)
        except ValueError:
            values = np.array([_number(item) for item in text])
        wrong = np.flatnonzero(~np.isfinite(values) & ~(blank_allowed & (text == b"nan")))
        if len(wrong):
            first, last = layout.places[name]
            shown = text[wrong[0]].decode("ascii", "replace")
            problem = f"columns {first} to {last} should hold {name}, but hold {shown!r}"
            raise FileFormatError(path, problem, int(lines[wrong[0]]))
        return np.asarray(values)

    used = numbers("MJD") >= first_mjd_utc
    of_bulletin_a = layout is _BULLETIN_A
    if of_bulletin_a:  # rows after the last prediction hold a date alone
        filled = np.flatnonzero(np.char.strip(rows["UT1-UTC"]) != b"")
        used[filled[-1] + 1 if len(filled) else 0 :] = False
    rows, lines = rows[used], lines[used]
    mjd, x, y, ut1 = (numbers(name) for name in ("MJD", "x", "y", "UT1-UTC"))
    skipped = np.flatnonzero(np.diff(mjd) != 1.0)
    if len(skipped):
        k = skipped[0]
        problem = f"MJD {mjd[k + 1]:.2f} follows {mjd[k]:.2f}; daily rows are needed"
        raise FileFormatError(path, problem, int(lines[k + 1]))
    dx, dy = (layout.pole_offset_arcsec * numbers(name, of_bulletin_a) for name in ("dX", "dY"))
    too_large = np.flatnonzero(np.maximum(np.abs(dx), np.abs(dy)) > _LARGEST_POLE_OFFSET_ARCSEC)
    if len(too_large):
        raise FileFormatError(
            path,
            "the celestial pole offset is too large to be dX, dY of IAU 2000A: offsets of the 1980 nutation "
            "theory (dPsi, dEpsilon) are of no use here; take the file with dX, dY",
            int(lines[too_large[0]]),
        )
    predicted = np.zeros(len(mjd), dtype=np.bool_)
    for flag in _FLAGS if of_bulletin_a else ():
        predicted |= rows[flag] == b"P"
    angles = {"xp_rad": x, "yp_rad": y, "dx_rad": dx, "dy_rad": dy}
    columns: dict[str, Any] = {name: arcsec * ARCSEC_RAD for name, arcsec in angles.items()}
    columns |= {"mjd_utc": mjd, "ut1_minus_utc_s": ut1, "predicted": predicted}
    if not len(mjd):
        return columns, ()
    name, sha256 = path.name + package, hashlib.sha256(path.read_bytes()).hexdigest()
    return columns, (f"{layout.series} {name}, {day_of(mjd[0])} to {day_of(mjd[-1])}, sha256 {sha256}",)


def day_of(mjd_utc: float) -> str:
    """A date as text, yyyy-mm-dd."""
    return str(Epochs.from_jd(2400000.5, mjd_utc, "UTC").day_strings()[0])


def _number(text: bytes) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan
