"""A solution in SINEX 2.02, the format in which geodesy exchanges estimates with their covariance.

Blocks SOLUTION/ESTIMATE, SOLUTION/APRIORI and SOLUTION/MATRIX_ESTIMATE of the IERS format description. The position
is in principal axes, as STAX, STAY and STAZ; the format knows no frame of the Moon, so FILE/COMMENT names it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from radioloc.errors import InputError
from radioloc.estimation.solution import Solution
from radioloc.text_files import write_text
from radioloc.time import Epochs

_TYPES = {"range_bias": "RBIAS", "time_bias": "TBIAS"}
"""Of the format's own parameter types; the others are the first letters of the kind."""


def write_sinex(solution: Solution, path: str | Path) -> Path:
    """Write a solution as SINEX: position in principal axes, other parameters, total covariance.

    Raises
    ------
    InputError
        The position is held or not determined, or the target moves along a trajectory.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> radioloc.report.write_sinex(solution, "apollo15.snx").name
    'apollo15.snx'
    """
    if solution.trajectory is not None or not solution.position_estimated or not solution.position_determined:
        raise InputError(f"{solution.name}: SINEX holds an estimated position, and this solution has none")
    others = [
        k
        for k, item in enumerate(solution.parameters)
        if not item.fixed and item.kind != "position" and np.isfinite(solution.covariance[k, k])
    ]
    used = solution.residuals.epoch_utc[np.flatnonzero(solution.residuals.used)]
    order = np.lexsort((used.fraction, used.jd))
    first, middle, last = (_epoch(used[[int(order[k])]]) for k in (0, len(order) // 2, -1))
    transform = np.zeros((3 + len(others), len(solution.parameters)))
    transform[:3] = solution.position_partials
    transform[3 + np.arange(len(others)), others] = 1.0
    finite = np.isfinite(np.diag(solution.covariance))
    transform[:, ~finite] = 0.0
    scaled = np.where(np.isfinite(solution.covariance), solution.covariance, 0.0)
    if solution.consider is not None:
        scaled = scaled + solution.consider.covariance
    covariance = transform @ scaled @ transform.T
    covariance[:3, :3] = solution.position_covariance("pa")
    code = "".join(filter(str.isalnum, solution.name.upper()))[:4] or "MOON"
    items = [solution.parameters.parameters[k] for k in others]
    labels = [(axis, code, "m") for axis in ("STAX", "STAY", "STAZ")]
    labels += [
        (
            _TYPES.get(item.kind, item.kind.replace("_", "").upper()[:6]),
            item.name.partition(".")[2][:4].upper() or "----",
            item.unit[:4],
        )
        for item in items
    ]
    values = [*solution.position_pa_m.tolist(), *solution.values[others].tolist()]
    estimate = _lines(labels, values, np.sqrt(np.diag(covariance)).tolist(), middle)
    known = [k for k, item in enumerate(items) if np.isfinite(item.prior_sigma)]
    apriori = _lines(
        [labels[3 + k] for k in known],
        [items[k].prior_value for k in known],
        [items[k].prior_sigma for k in known],
        middle,
        [4 + k for k in known],
    )
    content = [
        f"%=SNX 2.02 RLC {last} RLC {first} {last} C {len(labels):05d} 2 S",
        "+FILE/COMMENT",
        f" {solution.name}: position in {solution.pa_frame}, principal axes of the Moon",
        *(f" {4 + k:5d} is {item.name}, {item.unit}" for k, item in enumerate(items)),
        "-FILE/COMMENT",
        "+SOLUTION/ESTIMATE",
        _HEADING.format("__ESTIMATED VALUE____"),
        *estimate,
        "-SOLUTION/ESTIMATE",
        "+SOLUTION/APRIORI",
        _HEADING.format("____APRIORI VALUE____"),
        *apriori,
        "-SOLUTION/APRIORI",
        "+SOLUTION/MATRIX_ESTIMATE L COVA",
        "*PARA1 PARA2 ____PARA2+0__________ ____PARA2+1__________ ____PARA2+2__________",
    ]
    for row in range(len(labels)):
        for column in range(0, row + 1, 3):
            part = covariance[row, column : min(column + 3, row + 1)]
            content.append(f" {row + 1:5d} {column + 1:5d}" + "".join(f" {value:21.14E}" for value in part))
    content += ["-SOLUTION/MATRIX_ESTIMATE L COVA", "%ENDSNX"]
    path = Path(path)
    write_text(path, "\n".join(content) + "\n")
    return path


_HEADING = "*INDEX TYPE__ CODE PT SOLN _REF_EPOCH__ UNIT S {} _STD_DEV___"


def _lines(
    labels: list[tuple[str, str, str]],
    values: list[float],
    sigmas: list[float],
    epoch: str,
    numbers: list[int] | None = None,
) -> list[str]:
    numbers = list(range(1, len(labels) + 1)) if numbers is None else numbers
    return [
        f" {number:5d} {kind:<6s} {code:<4s}  A    1 {epoch} {unit:<4s} 2 {value:21.14E} {sigma:11.5E}"
        for number, (kind, code, unit), value, sigma in zip(numbers, labels, values, sigmas, strict=True)
    ]


def _epoch(epoch: Epochs) -> str:
    """Year, day of the year and second of the day, UTC, as YY:DDD:SSSSS."""
    from radioloc.time import utc_strings

    text = str(utc_strings(epoch, decimals=0)[0])
    day = np.datetime64(text[:10])
    number = int((day - day.astype("datetime64[Y]")).astype(int)) + 1
    seconds = 3600 * int(text[11:13]) + 60 * int(text[14:16]) + int(text[17:19])
    return f"{text[2:4]}:{number:03d}:{seconds:05d}"
