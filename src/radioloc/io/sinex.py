"""A solution in SINEX 2.02, the format in which geodesy exchanges estimates with their covariance.

Fixed columns and blocks are those of the IERS format description. Positions are in principal axes, as STAX, STAY and
STAZ. The format lacks lunar frames and names of most parameters; FILE/COMMENT states both.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
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
"""Types of the format, their units, and the factors from SI; other types are the first letters of the kind."""

_STATION_NAME = re.compile(r"([A-Za-z][\w-]*)(?: \d+)?(?:\.\w+)?")
"""Name of a station or of one of its passes, behind the kind in the name of a parameter."""

_NO_TIME = "00:000:00000"  # the time of writing: the same solution makes the same file
_PRIOR_KNOWN, _UNCONSTRAINED = 1, 2
_HEADING = "*INDEX TYPE__ CODE PT SOLN _REF_EPOCH__ UNIT S {} _STD_DEV___"


@dataclass(frozen=True, slots=True, eq=False)
class _Parameter:
    """Parameter of SOLUTION/ESTIMATE and SOLUTION/APRIORI, in the units of the file."""

    type: str
    code: str
    unit: str
    value: float
    partials: Floats  # by the parameters of the solution
    constraint: int
    name: str = ""  # in the solution; coordinates have none
    prior_value: float = 0.0
    prior_sigma: float = math.inf


def write_sinex(path: str | Path, solution: Solution) -> Path:
    """Write a converged solution as SINEX: positions in principal axes, other parameters, total covariance."""
    if solution.trajectory is not None or not solution.position_estimated:
        raise InputError(
            f"{solution.name}: expected a solution with an estimated position, which SINEX needs"
        )
    if not solution.converged:
        raise ConvergenceError(f"{solution.name}: expected a converged solution; no SINEX file was written")
    targets = solution.targets or (solution,)
    places_me_m = {target.name: solution.rot_pa_to_me @ target.position_pa_m for target in targets}
    columns = [
        k
        for k, item in enumerate(solution.parameters)
        if not item.fixed and item.kind != "position" and np.isfinite(solution.covariance[k, k])
    ]
    codes = _codes([*places_me_m, *filter(None, (_station(solution.parameters.names[k]) for k in columns))])
    parameters = list(_parameters(solution, columns, codes))
    covariance = _covariance(solution, parameters)

    used = solution.residuals.epoch_utc[np.flatnonzero(solution.residuals.used)]
    order = np.lexsort((used.fraction, used.jd))
    first, middle, last = (_epoch(used[[int(order[k])]]) for k in (0, len(order) // 2, -1))
    sigmas = np.sqrt(np.diag(covariance)).tolist()
    estimates, priors = _parameter_rows(parameters, sigmas, middle)
    blocks = {
        "FILE/REFERENCE": [
            f" {'DESCRIPTION':<18s} {to_ascii(solution.name, 60)}",
            f" {'SOFTWARE':<18s} radioloc {__version__}",
        ],
        "FILE/COMMENT": [
            f" Positions in {solution.pa_frame}, principal axes of the Moon, not of the Earth.",
            " The covariance is the total one, with the errors of considered parameters.",
            *(f" {k:5d} is {to_ascii(item.name, 60)}" for k, item in enumerate(parameters, 1) if item.name),
        ],
        "SITE/ID": [
            "*CODE PT __DOMES__ T _STATION DESCRIPTION__ _LONGITUDE_ _LATITUDE__ HEIGHT_",
            *(_site(code, name, places_me_m.get(name)) for name, code in codes.items()),
        ],
        "SOLUTION/EPOCHS": [
            "*CODE PT SOLN T _DATA_START_ __DATA_END__ _MEAN_EPOCH_",
            *(f" {code:<4s}  A    1 C {first} {last} {middle}" for code in codes.values()),
        ],
        "SOLUTION/ESTIMATE": [_HEADING.format("__ESTIMATED VALUE____"), *estimates],
        "SOLUTION/APRIORI": [_HEADING.format("____APRIORI VALUE____"), *priors],
        "SOLUTION/MATRIX_ESTIMATE L COVA": [
            "*PARA1 PARA2 ____PARA2+0__________ ____PARA2+1__________ ____PARA2+2__________",
            *(
                f" {row + 1:5d} {column + 1:5d}"
                + "".join(f" {value:21.14E}" for value in covariance[row, column : min(column + 3, row + 1)])
                for row in range(len(parameters))
                for column in range(0, row + 1, 3)
            ),
        ],
    }
    constraint = min(item.constraint for item in parameters)
    content = [f"%=SNX 2.02 RLC {_NO_TIME} RLC {first} {last} C {len(parameters):05d} {constraint} S"]
    for name, block in blocks.items():
        if any(line.startswith(" ") for line in block):
            content += [f"+{name}", *block, f"-{name}"]
    path = Path(path)
    write_text(path, "\n".join([*content, "%ENDSNX"]) + "\n")
    return path


def _station(name: str) -> str:
    """Return the station of a parameter by its name, or an empty text."""
    match = _STATION_NAME.fullmatch(name.partition(".")[2])
    return match[1] if match else ""


def _parameters(solution: Solution, columns: Sequence[int], codes: Mapping[str, str]) -> Iterator[_Parameter]:
    """Yield the coordinates of all targets, then the other parameters."""
    items = solution.parameters.parameters
    constraint = _constraint(*(item.prior_sigma for item in items if item.kind == "position"))
    for target in solution.targets or (solution,):
        for axis, value, partials in zip("XYZ", target.position_pa_m, target.position_partials, strict=True):
            yield _Parameter(f"STA{axis}", codes[target.name], "m", float(value), partials, constraint)
    for k in columns:
        first_letters = items[k].kind.replace("_", "").upper()[:6]
        kind, unit, factor = _TYPES.get(items[k].kind, (first_letters, items[k].unit[:4], 1.0))
        code, partials = codes.get(_station(items[k].name), "----"), factor * np.eye(len(items))[k]
        value, prior_value = (factor * float(x) for x in (solution.values[k], items[k].prior_value))
        sigma = items[k].prior_sigma
        yield _Parameter(
            *(kind, code, unit, value, partials),
            _constraint(sigma),
            items[k].name,
            prior_value,
            factor * sigma,
        )


def _constraint(*prior_sigmas: float) -> int:
    return _PRIOR_KNOWN if any(map(math.isfinite, prior_sigmas)) else _UNCONSTRAINED


def _parameter_rows(
    parameters: Sequence[_Parameter], sigmas: Sequence[float], epoch: str
) -> tuple[list[str], list[str]]:
    """Return the rows of SOLUTION/ESTIMATE and of SOLUTION/APRIORI."""
    estimates, priors = [], []
    # Solution numbers distinguish parameters of one type and site, such as those of several passes.
    numbers: Counter[tuple[str, str]] = Counter()
    for k, (item, sigma) in enumerate(zip(parameters, sigmas, strict=True), start=1):
        numbers[item.type, item.code] += 1
        place = f"{item.code:<4s} {'--' if item.code == '----' else ' A'} {numbers[item.type, item.code]:4d}"
        row = f" {k:5d} {item.type:<6s} {place} {epoch} {item.unit:<4s} {item.constraint}"
        estimates.append(f"{row} {item.value:21.14E} {sigma:11.5E}")
        if math.isfinite(item.prior_sigma):
            priors.append(f"{row} {item.prior_value:21.14E} {item.prior_sigma:11.5E}")
    return estimates, priors


def _covariance(solution: Solution, parameters: Sequence[_Parameter]) -> Floats:
    """Return the total covariance of the parameters, in the units of the file."""
    transform = np.array([item.partials for item in parameters])
    determined = np.isfinite(np.diag(solution.covariance))
    parameter_covariance = solution.parameter_covariance()[np.ix_(determined, determined)]
    covariance = transform[:, determined] @ parameter_covariance @ transform[:, determined].T
    # The error of the ephemeris shifts all targets alike.
    ephemeris_error_m = np.tile(
        solution.rot_pa_to_enu.T * solution.ephemeris_sigma_enu_m, (len(solution.targets) or 1, 1)
    )
    size = len(ephemeris_error_m)
    covariance[:size, :size] += ephemeris_error_m @ ephemeris_error_m.T
    return np.asarray(covariance)


def _codes(names: Sequence[str]) -> dict[str, str]:
    """Return distinct codes of four characters by name: the first four letters, or else the first and last two."""
    letters = {name: re.sub(r"[^A-Z0-9]", "", name.upper()) or "MOON" for name in names}
    starts = Counter(text[:4] for text in letters.values())
    codes: dict[str, str] = {}
    for name, text in letters.items():
        tries = [text[:4]] if starts[text[:4]] == 1 else [text[:2] + text[-2:]]
        tries += [f"{text[: 4 - len(str(n))]}{n}" for n in range(1, 1000)]
        codes[name] = next(code for code in tries if code not in codes.values())
    return codes


def _site(code: str, name: str, position_me_m: Floats | None) -> str:
    """Return a line of SITE/ID; zeros mean that the place of a station on Earth is not given."""
    longitude, latitude, height_m = (0.0, 0.0, 0.0)
    if position_me_m is not None:
        longitude, latitude, height_m = map(float, cartesian_to_selenographic(position_me_m))
    place = f"{_sexagesimal(math.degrees(longitude) % 360.0)} {_sexagesimal(math.degrees(latitude))}"
    return f" {code:<4s}  A {'---------':<9s} C {to_ascii(name, 22):<22s} {place} {height_m:7.1f}"


def _sexagesimal(angle_deg: float) -> str:
    """Return degrees, minutes and seconds to a tenth, the sign with the first that is not zero."""
    tenths = round(abs(angle_deg) * 36000.0)
    parts = [tenths // 36000, tenths // 600 % 60, tenths % 600 / 10.0]
    if angle_deg < 0.0:
        first = next((k for k, part in enumerate(parts) if part), 0)
        parts[first] = -parts[first]
    return f"{parts[0]:3d} {parts[1]:2d} {parts[2]:4.1f}"


def _epoch(epoch: Epochs) -> str:
    """Return year, day of the year and second of the day, UTC, as YY:DDD:SSSSS."""
    text = str(utc_strings(epoch, decimals=0)[0])
    seconds = 3600 * int(text[11:13]) + 60 * int(text[14:16]) + int(text[17:19])
    return f"{date.fromisoformat(text[:10]):%y:%j}:{seconds:05d}"
