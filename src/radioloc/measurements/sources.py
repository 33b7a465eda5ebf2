"""Radio sources at infinity, such as quasars, whose VLBI delays determine the stations' clocks.

A list is a table with the columns ``source,right_ascension_deg,declination_deg``, or a file of the ICRF as published by
the IERS (``icrf3sx.txt``). Its lines begin with ICRF and have designation, name of the IERS, a D for defining sources,
right ascension (h, min, s) and declination (deg, arcmin, arcsec).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import erfa
import numpy as np

from radioloc.constants import ARCSEC_RAD
from radioloc.errors import FileFormatError
from radioloc.measurements.link import canonical_target
from radioloc.text_files import read_lines, read_rows
from radioloc.time import Epochs
from radioloc.vectors import Floats, dot, normalized

COLUMNS = ("source", "right_ascension_deg", "declination_deg")

_TO_GALACTIC_CENTRE = np.radians([266.4051, -28.936175])
_ABERRATION_RAD_YR = 5.8e-6 * ARCSEC_RAD
_EPOCH_JD = 2457023.5  # 2015.0, the epoch of ICRF3 for the acceleration of the solar system

Sources = Mapping[str, Floats]  # directions, BCRS unit vectors of shape (3,), by canonical names


def read_sources(path: str | Path) -> dict[str, Floats]:
    r"""Read a list of sources: directions in the ICRS, unit vectors of shape (3,), by names in lower case.

    Sources of the ICRF have the names of the IERS (``0059+581``) and designations (``j010245.7+582411``).

    Raises
    ------
    FileFormatError
        The file is not a list of sources, or a line is invalid.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from radioloc.measurements import read_sources
    >>> path = pathlib.Path(tempfile.mkdtemp(), "sources.csv")
    >>> _ = path.write_text("source,right_ascension_deg,declination_deg\n0059+581,15.690677,58.403093\n")
    >>> {name: direction.round(6).tolist() for name, direction in read_sources(path).items()}
    {'0059+581': [0.504416, 0.141696, 0.851755]}
    """
    sources: dict[str, Floats] = {}
    icrf = [(k, line) for k, line in enumerate(read_lines(path), 1) if line.startswith("ICRF J")]
    rows = icrf or read_rows(path, COLUMNS, "a list of sources has lines of the ICRF, or it")
    for number, row in rows:
        try:
            names, angles_rad = _icrf_source(row) if isinstance(row, str) else _table_source(row)
        except (ValueError, IndexError):
            text = row if isinstance(row, str) else ",".join(row.values())
            raise FileFormatError(
                path, f"expected a source with its direction, got {text.strip()!r}", number
            ) from None
        direction = erfa.s2c(*angles_rad)
        for name in map(canonical_target, names):
            if not np.array_equal(sources.setdefault(name, direction), direction):
                raise FileFormatError(path, f"{name} is duplicated with another direction", number)
    if not sources:
        raise FileFormatError(path, "expected sources, got none")
    return sources


def _table_source(row: Mapping[str, str]) -> tuple[list[str], tuple[float, float]]:
    right_ascension_deg, declination_deg = (float(row[name]) for name in COLUMNS[1:])
    return [row["source"]], _checked(right_ascension_deg, declination_deg)


def _icrf_source(line: str) -> tuple[list[str], tuple[float, float]]:
    _, designation, name, *words = line.split()
    numbers = words[1:] if words[0] == "D" else words
    hours, minutes, seconds, degrees, arcmin, arcsec = map(float, numbers[:6])
    size_deg = abs(degrees) + arcmin / 60.0 + arcsec / 3600.0
    # The text of -00 degrees has the sign.
    declination_deg = -size_deg if numbers[3].startswith("-") else size_deg
    return [name, designation], _checked(15.0 * (hours + minutes / 60.0 + seconds / 3600.0), declination_deg)


def _checked(right_ascension_deg: float, declination_deg: float) -> tuple[float, float]:
    if not (0.0 <= right_ascension_deg <= 360.0 and -90.0 <= declination_deg <= 90.0):
        raise ValueError
    return np.radians(right_ascension_deg), np.radians(declination_deg)


def with_galactic_aberration(direction: Floats, tdb: Epochs) -> Floats:
    """Return directions (n, 3) at epochs from those at 2015.0, the epoch of ICRF3."""
    # Aberration by the acceleration towards the centre of the Galaxy grows by 5.8 microarcseconds a year (Charlot et
    # al. 2020, Astron. Astrophys. 644, A159).
    years = ((tdb.jd - _EPOCH_JD) + tdb.fraction) / 365.25
    galactic_centre = np.broadcast_to(erfa.s2c(*_TO_GALACTIC_CENTRE), direction.shape)
    transverse = galactic_centre - direction * dot(galactic_centre, direction)[:, None]
    return normalized(direction + transverse * (_ABERRATION_RAD_YR * years)[:, None])
