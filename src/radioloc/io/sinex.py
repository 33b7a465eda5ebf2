"""A solution in SINEX 2.02, the format in which geodesy exchanges estimates with their covariance.

Fixed columns and blocks are those of the IERS format description. Positions are in principal axes, as STAX, STAY and
STAZ; the format knows no frame of the Moon and has no names for most of what is estimated, so FILE/COMMENT has both.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np

from radioloc._version import __version__
from radioloc.errors import ConvergenceError, InputError
from radioloc.lunar.selenographic import cartesian_to_selenographic
from radioloc.results.solution import Solution
from radioloc.text_files import to_ascii, write_text
from radioloc.time import Epochs, utc_strings
from radioloc.vectors import Floats

_TYPES = {
    "range_bias": ("RBIAS", "m", 1.0),
    "time_bias": ("TBIAS", "ms", 1e3),
    "zenith_delay": ("ZBIAS", "m", 1.0),
}
"""The format's own types, their units, and the factors from ours; other types are the first letters of the kind."""

_OF_A_STATION = re.compile(r"([A-Za-z][\w-]*)(?: \d+)?(?:\.\w+)?")
"""What follows the kind in the name of a parameter of a station, or of one of its passes."""

_NO_TIME = "00:000:00000"  # the time of writing: the same solution makes the same file
_PRIOR_KNOWN, _UNCONSTRAINED = 1, 2


@dataclass(frozen=True, slots=True)
class _Line:
    """What SOLUTION/ESTIMATE and SOLUTION/APRIORI say of a parameter, in the units of the file."""

    type: str
    code: str
    unit: str
    value: float
    constrained: bool
    prior_value: float = 0.0
    prior_sigma: float = math.inf


def write_sinex(solution: Solution, path: str | Path) -> Path:
    """Write a solution as SINEX: positions in principal axes, other parameters, total covariance.

    Raises
    ------
    InputError
        The position is held, or the target moves along a trajectory.
    ConvergenceError
        The solution has not converged, or the position is not determined.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> radioloc.io.write_sinex(solution, "apollo15.snx").name
    'apollo15.snx'
    """
    if solution.trajectory is not None or not solution.position_estimated:
        raise InputError(f"{solution.name}: SINEX holds an estimated position, and this solution has none")
    if not solution.converged:
        raise ConvergenceError(
            f"{solution.name}: no SINEX file is written of a solution that has not converged"
        )
    items = solution.parameters.parameters
    others = [
        k
        for k, item in enumerate(items)
        if not item.fixed and item.kind != "position" and np.isfinite(solution.covariance[k, k])
    ]
    targets = solution.targets or (solution,)
    places_me_m = {target.name: solution.rot_pa_to_me @ target.position_pa_m for target in targets}
    owners = [_OF_A_STATION.fullmatch(items[k].name.partition(".")[2]) for k in others]
    codes = _codes([*places_me_m, *(owner[1] for owner in owners if owner)])

    height_known = any(math.isfinite(item.prior_sigma) for item in items if item.kind == "position")
    lines = [
        _Line(axis, codes[target.name], "m", value, height_known)
        for target in targets
        for axis, value in zip(("STAX", "STAY", "STAZ"), target.position_pa_m.tolist(), strict=True)
    ]
    factors = []  # from the units of the solution
    for k, owner in zip(others, owners, strict=True):
        item = items[k]
        first_letters = item.kind.replace("_", "").upper()[:6]
        kind, unit, factor = _TYPES.get(item.kind, (first_letters, item.unit[:4], 1.0))
        code, constrained = codes[owner[1]] if owner else "----", math.isfinite(item.prior_sigma)
        sizes = (factor * size for size in (item.prior_value, item.prior_sigma))
        lines.append(_Line(kind, code, unit, factor * float(solution.values[k]), constrained, *sizes))
        factors.append(factor)
    covariance = _covariance(solution, others, np.array(factors))

    used = solution.residuals.epoch_utc[np.flatnonzero(solution.residuals.used)]
    order = np.lexsort((used.fraction, used.jd))
    first, middle, last = (_epoch(used[[int(order[k])]]) for k in (0, len(order) // 2, -1))
    # Numbers that tell parameters of one type and site apart, such as those of several passes.
    kinds = [(line.type, line.code) for line in lines]
    numbers = [kinds[: k + 1].count(kind) for k, kind in enumerate(kinds)]

    def parameter(k: int, value: float, sigma: float) -> str:
        line = lines[k]
        constraint = _PRIOR_KNOWN if line.constrained else _UNCONSTRAINED
        return (
            f" {k + 1:5d} {line.type:<6s} {line.code:<4s} {'--' if line.code == '----' else ' A'} {numbers[k]:4d} "
            f"{middle} {line.unit:<4s} {constraint} {value:21.14E} {sigma:11.5E}"
        )

    sigmas = np.sqrt(np.diag(covariance)).tolist()
    constraint = _PRIOR_KNOWN if any(line.constrained for line in lines) else _UNCONSTRAINED
    blocks = {
        "FILE/REFERENCE": [
            f" {'DESCRIPTION':<18s} {to_ascii(solution.name, 60)}",
            f" {'SOFTWARE':<18s} radioloc {__version__}",
        ],
        "FILE/COMMENT": [
            f" Positions in {solution.pa_frame}, principal axes of the Moon, not of the Earth.",
            " The covariance is the total one, with the errors of considered parameters.",
            *(
                f" {3 * len(targets) + 1 + n:5d} is {to_ascii(items[k].name, 60)}"
                for n, k in enumerate(others)
            ),
        ],
        "SITE/ID": [
            "*CODE PT __DOMES__ T _STATION DESCRIPTION__ _LONGITUDE_ _LATITUDE__ HEIGHT_",
            *(_site(code, name, places_me_m.get(name)) for name, code in codes.items()),
        ],
        "SOLUTION/EPOCHS": [
            "*CODE PT SOLN T _DATA_START_ __DATA_END__ _MEAN_EPOCH_",
            *(f" {code:<4s}  A    1 C {first} {last} {middle}" for code in codes.values()),
        ],
        "SOLUTION/ESTIMATE": [
            _HEADING.format("__ESTIMATED VALUE____"),
            *(parameter(k, line.value, sigmas[k]) for k, line in enumerate(lines)),
        ],
        "SOLUTION/APRIORI": [
            _HEADING.format("____APRIORI VALUE____"),
            *(
                parameter(k, line.prior_value, line.prior_sigma)
                for k, line in enumerate(lines)
                if math.isfinite(line.prior_sigma)
            ),
        ],
        "SOLUTION/MATRIX_ESTIMATE L COVA": [
            "*PARA1 PARA2 ____PARA2+0__________ ____PARA2+1__________ ____PARA2+2__________",
            *(
                f" {row + 1:5d} {column + 1:5d}"
                + "".join(f" {value:21.14E}" for value in covariance[row, column : min(column + 3, row + 1)])
                for row in range(len(lines))
                for column in range(0, row + 1, 3)
            ),
        ],
    }
    content = [f"%=SNX 2.02 RLC {_NO_TIME} RLC {first} {last} C {len(lines):05d} {constraint} S"]
    for name, block in blocks.items():
        if any(line.startswith(" ") for line in block):
            content += [f"+{name}", *block, f"-{name}"]
    path = Path(path)
    write_text(path, "\n".join([*content, "%ENDSNX"]) + "\n")
    return path


_HEADING = "*INDEX TYPE__ CODE PT SOLN _REF_EPOCH__ UNIT S {} _STD_DEV___"


def _covariance(solution: Solution, others: Sequence[int], factors: Floats) -> Floats:
    """Total covariance of the coordinates of all targets and of other parameters, in the units of the file."""
    positions = [target.position_partials for target in solution.targets or (solution,)]
    transform = np.concatenate([*positions, factors[:, None] * np.eye(len(solution.parameters))[others]])
    known = np.isfinite(np.diag(solution.covariance))
    of_parameters = solution.parameter_covariance()[np.ix_(known, known)]
    covariance = transform[:, known] @ of_parameters @ transform[:, known].T
    # The error of the ephemeris moves all targets alike.
    by_error = np.tile(solution.rot_pa_to_enu.T * solution.ephemeris_sigma_enu_m, (len(positions), 1))
    covariance[: len(by_error), : len(by_error)] += by_error @ by_error.T
    return np.asarray(covariance)


def _codes(names: Sequence[str]) -> dict[str, str]:
    """Codes of four characters, no two alike, by name: the first four letters, or else the first and last two."""
    letters = {name: re.sub(r"[^A-Z0-9]", "", name.upper()) or "MOON" for name in names}
    starts = Counter(text[:4] for text in letters.values())
    codes: dict[str, str] = {}
    for name, text in letters.items():
        tries = [text[:4]] if starts[text[:4]] == 1 else [text[:2] + text[-2:]]
        tries += [f"{text[: 4 - len(str(n))]}{n}" for n in range(1, 1000)]
        codes[name] = next(code for code in tries if code not in codes.values())
    return codes


def _site(code: str, name: str, position_me_m: Floats | None) -> str:
    """A line of SITE/ID; the place of a station on Earth is left at zero, which means that it is not given."""
    longitude, latitude, height_m = (0.0, 0.0, 0.0)
    if position_me_m is not None:
        longitude, latitude, height_m = map(float, cartesian_to_selenographic(position_me_m))
    place = f"{_sexagesimal(math.degrees(longitude) % 360.0)} {_sexagesimal(math.degrees(latitude))}"
    return f" {code:<4s}  A {'---------':<9s} C {to_ascii(name, 22):<22s} {place} {height_m:7.1f}"


def _sexagesimal(angle_deg: float) -> str:
    """Degrees, minutes and seconds to a tenth, the sign with the first that is not zero."""
    tenths = round(abs(angle_deg) * 36000.0)
    parts = [tenths // 36000, tenths // 600 % 60, tenths % 600 / 10.0]
    if angle_deg < 0.0:
        first = next((k for k, part in enumerate(parts) if part), 0)
        parts[first] = -parts[first]
    return f"{parts[0]:3d} {parts[1]:2d} {parts[2]:4.1f}"


def _epoch(epoch: Epochs) -> str:
    """Year, day of the year and second of the day, UTC, as YY:DDD:SSSSS."""
    text = str(utc_strings(epoch, decimals=0)[0])
    seconds = 3600 * int(text[11:13]) + 60 * int(text[14:16]) + int(text[17:19])
    return f"{date.fromisoformat(text[:10]):%y:%j}:{seconds:05d}"
