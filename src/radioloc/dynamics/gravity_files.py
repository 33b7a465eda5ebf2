"""Files of gravity fields: ICGEM's ``.gfc`` and the SHADR tables (``.tab``) of NASA's Planetary Data System.

ICGEM: a header of keys that ends with ``end_of_head``, then lines ``gfc n m C S`` with or without sigmas
(Barthelmes and Förste 2011, *The ICGEM-format*). SHADR: a line with reference radius (km), GM (km^3/s^2), its
sigma, degree, order, normalization (1), reference longitude and latitude (0), then lines of degree, order, C, S
and their sigmas, separated by commas. The header of the former, or the detached label of the latter, may name the axes
by an ephemeris.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.ephemeris import CONSTANTS
from radioloc.errors import FileFormatError
from radioloc.text_files import ANY_BYTE, parse_numbers, read_lines, read_text

_GM_M3_S2 = CONSTANTS["DE421"].gm_moon_m3_s2
_RADIUS_M = 1738.0e3
_GM_TOLERANCE, _RADIUS_TOLERANCE = 1e-3, 0.05  # relative: lunar fields agree to 1e-6 and 1e-3
_MAX_DEGREE = 2200  # above all published fields; larger numbers are damaged
_MAX_DIGIT_COUNT = 7  # of a degree or order
_C00_TOLERANCE = 1e-5  # estimated values differ from 1 by some 1e-8, as GM does
_MAX_DEGREE_1 = 1e-6  # 3 m from the centre of mass, the origin of the model
TIDE_SYSTEMS = ("tide_free", "zero_tide", "unknown")


def read_gravity_file(path: str | Path) -> dict[str, Any]:
    """Read the fields of a ``GravityField`` from a file of the Moon; the content determines the format."""
    lines = enumerate(read_lines(path, encoding="latin-1", ended=True), 1)
    first = next(lines)
    if first[1].count(",") > 4:
        return _read_shadr(Path(path), first[1], lines)
    return _read_icgem(Path(path), chain([first], lines))


def _read_icgem(path: Path, lines: Iterator[tuple[int, str]]) -> dict[str, Any]:
    header: dict[str, tuple[int, str]] = {}
    text = ""
    for number, line in lines:
        words = line.split()
        text += f"{line}\n"
        if words and words[0] == "end_of_head":
            break
        if words and words[0] == "begin_of_head":
            header = {}
        elif len(words) > 1:
            header[words[0]] = number, words[1]
    else:
        raise FileFormatError(
            path, "expected a gravity field: end_of_head of ICGEM, or the first line of a SHADR table"
        )
    if "gravity_constant" not in header and "earth_gravity_constant" in header:
        header["gravity_constant"] = header["earth_gravity_constant"]
    for key in ("gravity_constant", "radius", "max_degree"):
        if key not in header:
            raise FileFormatError(path, f"the header lacks {key}; download the file again")
    norm_line, norm = header.get("norm", (None, "fully_normalized"))
    if norm != "fully_normalized":
        raise FileFormatError(path, f"norm: expected fully_normalized, got {norm}", norm_line)
    product_line, product = header.get("product_type", (None, "gravity_field"))
    if product != "gravity_field":
        raise FileFormatError(path, f"product_type: expected gravity_field, got {product}", product_line)
    tide_line, tide_system = header.get("tide_system", (None, "unknown"))
    tide_system = tide_system.lower().replace("-", "_")
    if tide_system not in TIDE_SYSTEMS:
        choices = ", ".join(TIDE_SYSTEMS)
        raise FileFormatError(path, f"tide_system: expected {choices}, got {tide_system}", tide_line)
    gm_line, gm = header["gravity_constant"]
    degree_line, degree = header["max_degree"]
    table = _Table(
        path,
        _integer(path, degree_line, degree),
        _number(path, gm_line, gm),
        _number(path, *header["radius"]),
    )
    for number, line in lines:
        words = line.split()
        if words and words[0] != "gfc":
            raise FileFormatError(
                path, f"expected lines gfc (constant coefficients), got {words[0]!r}", number
            )
        if words:
            table.add(number, words[1:])
    name = header.get("modelname", (0, path.stem))[1]
    return table.coefficients(name, tide_system, _stated_axes(text))


def _read_shadr(path: Path, first: str, lines: Iterator[tuple[int, str]]) -> dict[str, Any]:
    head = [word.strip() for word in first.split(",")]
    if len(head) < 6:
        raise FileFormatError(path, f"expected a line of eight numbers of a SHADR table, got {len(head)}", 1)
    if _number(path, 1, head[5]) != 1.0:
        raise FileFormatError(path, f"normalization: expected 1 (fully normalized), got {head[5]}", 1)
    for word, coordinate in zip(head[6:8], ("longitude", "latitude"), strict=False):
        if _number(path, 1, word) != 0.0:
            raise FileFormatError(
                path, f"reference {coordinate}: expected 0 (prime meridian and equator), got {word}", 1
            )
    degree = min(_integer(path, 1, head[3]), _integer(path, 1, head[4]))
    table = _Table(path, degree, _number(path, 1, head[1]) * 1e9, _number(path, 1, head[0]) * 1e3)
    for number, line in lines:
        words = [word.strip() for word in line.split(",")]
        if any(words):
            table.add(number, words)
    labels = (path.with_suffix(ending) for ending in (".lbl", ".LBL"))
    label = next((read_text(label, encoding=ANY_BYTE) for label in labels if label.is_file()), "")
    return table.coefficients(path.stem, "unknown", _stated_axes(label))


def _stated_axes(text: str) -> str | None:
    """Return the axes that a header or label names, such as PA_DE421, or None without a single ephemeris."""
    ephemerides = set(re.findall(r"(?<![A-Za-z])DE[- ]?0?(4\d\d)(?!\d)", text, re.IGNORECASE))
    principal = re.search(r"principal[\s-]+ax|(?<![A-Za-z])PA_DE|MOON_PA", text, re.IGNORECASE)
    mean_earth = re.search(r"mean[\s-]+earth|(?<![A-Za-z])ME_DE|MOON_ME", text, re.IGNORECASE)
    axes = "ME" if mean_earth and not principal else "PA"
    if not ephemerides and axes == "ME":
        ephemerides = {"421"}  # the mean-Earth axes of DE421 are those of lunar maps
    return f"{axes}_DE{ephemerides.pop()}" if len(ephemerides) == 1 else None


class _Table:
    """Coefficients of a file, added line by line."""

    def __init__(self, path: Path, degree: int, gm_m3_s2: float, radius_m: float) -> None:
        if not (
            abs(gm_m3_s2 / _GM_M3_S2 - 1.0) < _GM_TOLERANCE
            and abs(radius_m / _RADIUS_M - 1.0) < _RADIUS_TOLERANCE
        ):
            raise FileFormatError(
                path,
                f"expected GM {_GM_M3_S2:.6g} m^3/s^2 and radius {_RADIUS_M:.6g} m of the Moon, got {gm_m3_s2:.6g} and "
                f"{radius_m:.6g}",
            )
        if degree > _MAX_DEGREE:
            raise FileFormatError(
                path, f"degree: expected up to {_MAX_DEGREE}, got {degree}; download the file again"
            )
        self.path, self.degree, self.gm_m3_s2, self.radius_m = path, degree, gm_m3_s2, radius_m
        self.values = np.full((degree + 1, degree + 1, 4), np.nan)
        self.values[:2] = 0.0  # files may begin with degree 2
        self.values[0, 0, 0] = 1.0
        self.lines = np.zeros((degree + 1, degree + 1), dtype=np.int64)

    def add(self, number: int, words: list[str]) -> None:
        if len(words) not in (4, 6):
            problem = f"expected degree, order, C, S, or these with two sigmas, got {len(words)} numbers"
            raise FileFormatError(self.path, problem, number)
        n, m = (_integer(self.path, number, word) for word in words[:2])
        if m > n or n > self.degree:
            raise FileFormatError(
                self.path, f"expected degree and order up to {self.degree}, got {n}, {m}", number
            )
        if self.lines[n, m]:
            problem = f"duplicate degree {n}, order {m}, also in line {self.lines[n, m]}; remove one of them"
            raise FileFormatError(self.path, problem, number)
        self.lines[n, m] = number
        self.values[n, m] = [_number(self.path, number, word) for word in words[2:]] + [0.0] * (
            6 - len(words)
        )

    def coefficients(self, name: str, tide_system: str, frame: str | None) -> dict[str, Any]:
        missing = np.argwhere(np.isnan(np.tril(self.values[..., 0])))
        if len(missing):
            n, m = missing[0]
            raise FileFormatError(
                self.path,
                f"degree {n}, order {m}, is missing in a field to {self.degree}; download the file again",
            )
        if abs(c00 := self.values[0, 0, 0] - 1.0) > _C00_TOLERANCE:
            problem = (
                f"expected C00 = 1, got {1.0 + c00:.9g}: the coefficients are damaged or in another unit"
            )
            raise FileFormatError(self.path, problem, int(self.lines[0, 0]))
        if (off_centre := np.abs(self.values[1:2, :2, :2])).max(initial=0.0) > _MAX_DEGREE_1:
            raise FileFormatError(
                self.path,
                f"expected coefficients of degree 1 below {_MAX_DEGREE_1:g} (origin in the centre of mass), got "
                f"{off_centre.max():.3g}",
            )
        squares = np.nan_to_num(np.moveaxis(self.values, -1, 0))
        return {
            "name": name,
            "gm_m3_s2": self.gm_m3_s2,
            "radius_m": self.radius_m,
            "tide_system": tide_system,
            "frame": frame,
            **dict(zip(("c", "s", "sigma_c", "sigma_s"), squares, strict=True)),
        }


def _number(path: Path, line: int, word: str) -> float:
    """Return the finite number of a word, which may have Fortran's exponent D."""
    return parse_numbers(path, line, [word.replace("D", "E").replace("d", "e")], "a coefficient or constant")[
        0
    ]


def _integer(path: Path, line: int, word: str) -> int:
    if not (word.isdecimal() and len(word) <= _MAX_DIGIT_COUNT):
        raise FileFormatError(path, f"expected a degree or order, got {word!r}", line)
    return int(word)
