"""Ocean tide loading coefficients and their BLQ files.

A BLQ record gives a site eleven tides (M2 S2 N2 K2 K1 O1 P1 Q1 Mf Mm Ssa): amplitude and phase lag at
Greenwich of the displacement upwards, to the west and to the south. Such files come from the ocean tide
loading provider of H.-G. Scherneck and M. S. Bos at Onsala Space Observatory.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from radioloc.errors import DataQualityWarning, FileFormatError, InputError
from radioloc.text_files import CUT_LINE, read_blocks
from radioloc.units import read_only_array, set_fields
from radioloc.vectors import Floats

CONSTITUENTS = ("M2", "S2", "N2", "K2", "K1", "O1", "P1", "Q1", "MF", "MM", "SSA")
"""Tides of a BLQ record, in the order of its columns."""

_ROWS = ("radial amplitude", "EW amplitude", "NS amplitude", "radial phase", "EW phase", "NS phase")
_MAX_AMPLITUDE_M = 0.3
_CMC = re.compile(r"\bCMC\s*[:=]?\s*(YES|NO)\b", re.IGNORECASE)
"""Mark of a header or record: whether the tidal motion of the geocentre is in the coefficients."""
_AMPLITUDE_UNIT = re.compile(r"AMPLITUDES?\s*\(([^)]*)\)", re.IGNORECASE)
_MODEL = re.compile(r"Ocean tide model:?\s*(\S.*)", re.IGNORECASE)
_END = re.compile(r"\$\$\s*END TABLE")


@dataclass(frozen=True, slots=True, eq=False)
class BlqCoefficients:
    """Ocean tide loading of one site; shapes (3, 11), rows up, west, south, columns as :data:`CONSTITUENTS`."""

    site: str  # its name in the file
    amplitude_m: Floats
    phase_lag_rad: Floats  # at Greenwich, positive when the displacement follows the tide
    source: str  # ocean tide model and who computed it
    geocentre_included: bool = False  # against the centre of mass of Earth and oceans ("CMC: YES")

    def __post_init__(self) -> None:
        for name, unit in (("amplitude_m", "m"), ("phase_lag_rad", "rad")):
            table = read_only_array(getattr(self, name), unit, name)
            requirement = f"{name} of {self.site!r} must be 3 x {len(CONSTITUENTS)} finite numbers"
            if table.shape != (3, len(CONSTITUENTS)):
                raise InputError(f"{requirement}, but has shape {table.shape}")
            if not np.isfinite(table).all():
                raise InputError(f"{requirement}, but holds one that is not")
            set_fields(self, **{name: table})
        if (self.amplitude_m < 0.0).any() or (self.amplitude_m > _MAX_AMPLITUDE_M).any():
            raise InputError(
                f"ocean loading of {self.site!r} has amplitudes from {self.amplitude_m.min():g} to "
                f"{self.amplitude_m.max():g} m; they lie between 0 and {_MAX_AMPLITUDE_M} m: give metres"
            )

    def __repr__(self) -> str:
        return f"<BlqCoefficients {self.site}, M2 up {self.amplitude_m[0, 0] * 1e3:.1f} mm, {self.source}>"


def read_blq(path: str | Path) -> dict[str, BlqCoefficients]:
    """Read a file in BLQ layout, plain or gzip, as the ocean tide loading provider sends it: coefficients by site."""
    # Comments ($$) state the column order, the unit of amplitudes, the tide model and CMC. The head of an e-mail and
    # text after "$$ END TABLE" are ignored; without that mark, a cut between two sites cannot be recognised.
    # Names of sites and models may be in any encoding: bytes other than UTF-8 are replaced.
    content = b"".join(block for _, block in read_blocks(path, encoding="latin-1"))
    return parse_blq(content.decode("utf-8", errors="replace"), path)


def parse_blq(text: str, path: str | Path) -> dict[str, BlqCoefficients]:
    """Read the text of a file in BLQ layout; see :func:`read_blq`."""
    sites: dict[str, BlqCoefficients] = {}
    header = _Site("", 0, "ocean tide model not named in the file", False)
    site: _Site | None = None
    end_expected = False
    for number, line in _table_lines(text):
        if line.startswith("$$"):
            end_expected |= _is_column_order(line, path, number)
            (site or header).take_comment(line)
        elif site is None:
            site = _Site(line.strip(), number, "", header.geocentre_included)
            if site.name in sites:
                problem = f"site {site.name!r} appears twice; keep one of its records"
                raise FileFormatError(path, problem, number)
        else:
            site.rows.append(_read_row(line, site.name, len(site.rows), path, number))
            if len(site.rows) == len(_ROWS):
                sites[site.name] = site.coefficients(header.source, path)
                site = None
    if site is not None:
        problem = (
            f"the record of {site.name[:40]!r} has {len(site.rows)} rows of numbers; it needs {len(_ROWS)}"
        )
        raise FileFormatError(path, problem, site.line)
    if not sites:
        raise FileFormatError(path, "has no site; a BLQ record is a name and six rows of eleven numbers")
    ended = any(_END.match(line) for line in text.splitlines())
    if not (ended or text.endswith(("\n", "\r"))):
        raise FileFormatError(path, CUT_LINE.format("number"), len(text.splitlines()))
    if end_expected and not ended:
        missing = (
            f"{path} has no line $$ END TABLE; if it was cut, sites are missing: it has {', '.join(sites)}"
        )
        warnings.warn(missing, DataQualityWarning, stacklevel=3)
    return sites


@dataclass(slots=True)
class _Site:
    """Record of a site, or without a name the header, as far as it has been read."""

    name: str
    line: int
    source: str
    geocentre_included: bool
    rows: list[list[float]] = field(default_factory=list)

    def take_comment(self, line: str) -> None:
        if mark := _CMC.search(line):
            self.geocentre_included = mark[1].upper() == "YES"
        if self.name and not self.rows and not self.source:
            self.source = line.lstrip("$ ").strip()
        elif not self.name and (model := _MODEL.search(line)):
            self.source = model[1].strip()

    def coefficients(self, header_source: str, path: str | Path) -> BlqCoefficients:
        table = np.array(self.rows)
        values = self.name, table[:3], np.deg2rad(table[3:]), self.source or header_source
        try:
            return BlqCoefficients(*values, self.geocentre_included)
        except InputError as problem:
            raise FileFormatError(path, str(problem), self.line) from None


def _is_column_order(line: str, path: str | Path, number: int) -> bool:
    """Return whether a comment states the order of the columns; refuse another order or unit."""
    order = re.search(r"COLUMN ORDER:\s*(.*)", line, re.IGNORECASE)
    if order and tuple(order[1].upper().split()) != CONSTITUENTS:
        problem = f"columns are {order[1].strip()!r}, but only {' '.join(CONSTITUENTS)!r} can be read"
        raise FileFormatError(path, problem, number)
    unit = _AMPLITUDE_UNIT.search(line)
    if unit and unit[1].strip().lower() not in ("m", "metres", "meters"):
        raise FileFormatError(
            path, f"expected amplitudes in m, got {unit[1].strip()!r}; convert them", number
        )
    return order is not None


def _table_lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield number and content of the lines that belong to the table, blank ones left out."""
    in_mail_head = True
    for number, line in enumerate(text.splitlines(), start=1):
        if _END.match(line):
            return
        in_mail_head = in_mail_head and (not line.strip() or bool(re.match(r"[A-Za-z-]+\s*:", line)))
        if line.strip() and not in_mail_head:
            yield number, line


def _read_row(line: str, name: str, index: int, path: str | Path, number: int) -> list[float]:
    expected = f"{_ROWS[index]} of {name!r} needs {len(CONSTITUENTS)} numbers"
    try:
        values = [float(word) for word in line.split()]
    except ValueError:
        raise FileFormatError(path, f"{expected}, but the line reads {line.strip()!r}", number) from None
    if len(values) != len(CONSTITUENTS):
        raise FileFormatError(path, f"{expected}, but the line has {len(values)}", number)
    if index >= 3 and not all(math.fabs(value) <= 360.0 for value in values):
        raise FileFormatError(path, f"{_ROWS[index]} of {name!r} is not within 360 degrees", number)
    return values
