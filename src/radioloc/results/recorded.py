"""Recorded results checked at the boundary: ``solution.json``, ``arcs.json`` and mappings of the same form.

The schema names the keys that other jobs read, with their types and ranges. What passes can be used without further
checks; other keys are not read, and may be anything.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from radioloc.constants import LUNAR_HEIGHT_LIMITS_M
from radioloc.errors import InputError, legible, named
from radioloc.lunar.selenographic import selenographic_to_cartesian
from radioloc.text_files import json_file
from radioloc.time import epochs_from_strings

Check = Callable[[Any, str], None]
"""Raises :class:`InputError` for a value that is not as the schema has it; the text is the place of the value."""

MAX_COORDINATE_M = 1e12
"""Largest plausible coordinate or sigma of a position: fits that fail can end far from the Moon."""

_COORDINATE_TOLERANCE_M = 1.0  # between geographic and Cartesian coordinates of one position
_SIGMA_TOLERANCE = 1e-6  # relative, between a sigma and the square root of its variance
_MAX_SHOWN = 60  # characters of a wrong value


def read_recorded(path: str | Path, *, require_consistency: bool = True) -> Mapping[str, Any]:
    """Read a ``solution.json`` or an ``arcs.json`` and check it, without agreement of its numbers if so asked."""
    what = "is neither a solution.json nor an arcs.json of this version of radioloc; make it again"
    with json_file(path, what) as content:
        if not isinstance(content, Mapping):
            raise InputError(what)
        (_ARCS if "positions" in content else _SOLUTION)(content, "")
        solutions = [arc["solution"] for arc in content["arcs"]] if "positions" in content else [content]
        for solution in solutions if require_consistency else ():
            _require_consistency(solution)
    return dict(content)


def check_solution(content: Mapping[str, Any]) -> None:
    """Check what a ``solution.json`` holds; an InputError names the key of a wrong value."""
    _SOLUTION(content, "")
    _require_consistency(content)


def _fail(where: str, expected: str, value: Any) -> NoReturn:
    is_short = isinstance(value, float | bool | None) or (isinstance(value, int) and abs(value) < 10**20)
    got = legible(
        repr(value[:_MAX_SHOWN] if isinstance(value, str) else value if is_short else type(value).__name__)
    )
    raise InputError(f"{where or 'top level'}: expected {expected}, got {got}; make the file again")


def _required(is_valid: Callable[[Any], bool], expected: str) -> Check:
    def check(value: Any, where: str) -> None:
        if not is_valid(value):
            _fail(where, expected, value)

    return check


def _number(low: float = -math.inf, high: float = math.inf) -> Check:
    bounds = f" of at least {low:g}" if math.isinf(high) else f" from {low:g} to {high:g}"

    def is_valid(value: Any) -> bool:
        is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        # Comparison, unlike conversion, is defined for integers of any length.
        return is_number and low <= value <= high and -1e300 < value < 1e300

    return _required(is_valid, f"a number{'' if math.isinf(low) else bounds}")


def _text(pattern: str = r".+", meaning: str = "a text") -> Check:
    return _required(
        lambda value: isinstance(value, str) and bool(re.fullmatch(pattern, value, re.DOTALL)), meaning
    )


def _utc(value: Any, where: str) -> None:
    try:
        epochs_from_strings([value])
    except (TypeError, ValueError):
        _fail(where, "a date such as 2020-12-01T15:11:00", value)


def _same_lengths(value: Any, where: str) -> None:
    if len(value["utc_s"]) != len(value["observed_m"]):
        _fail(f"{where}.observed_m", f"{len(value['utc_s'])} values, as of utc_s", len(value["observed_m"]))


def _or_none(check: Check) -> Check:
    return lambda value, where: None if value is None else check(value, where)


def _list(check: Check, length: int | None = None) -> Check:
    def check_list(value: Any, where: str) -> None:
        if not isinstance(value, Sequence | np.ndarray) or isinstance(value, str):
            _fail(where, "a list", value)
        if length is not None and len(value) != length:
            _fail(where, f"a list of {length}", f"{len(value)} items")
        for place, item in enumerate(value):
            check(item, f"{where}[{place}]")

    return check_list


def _mapping(check: Check) -> Check:
    def check_mapping(value: Any, where: str) -> None:
        if not isinstance(value, Mapping):
            _fail(where, "an object", value)
        for key, item in value.items():
            check(item, f"{where}.{legible(str(key))}")

    return check_mapping


def _record(required: Mapping[str, Check], optional: Mapping[str, Check] | None = None) -> Check:
    """Check the keys of an object; others are allowed."""

    def check(value: Any, where: str) -> None:
        if not isinstance(value, Mapping):
            _fail(where, "an object", value)
        for key, item in {**(optional or {}), **required}.items():
            place = f"{where}.{key}" if where else key
            if key in value:
                item(value[key], place)
            elif key in required:
                raise InputError(f"{place}: the key is missing; make the file again")

    return check


def _all(*checks: Check) -> Check:
    def check(value: Any, where: str) -> None:
        for item in checks:
            item(value, where)

    return check


def _require_consistency(value: Mapping[str, Any]) -> None:
    """Require that the parts of a solution that state the same number agree, also of each of several targets."""
    for name, target in value.get("targets", {}).items():
        with named(f"targets.{legible(str(name))}:"):
            _require_consistency({**value, **target, "targets": {}})
    if value["position"] is None:
        return
    for key in ("sigma", "covariance"):
        if value[key] is None:
            _fail(key, "an object beside the position", None)
    _require_spans_and_terrain(value)
    me = value["position"]["me"]
    place = (math.radians(me["longitude_deg"]), math.radians(me["latitude_deg"]), me["height_m"])
    apart_m = selenographic_to_cartesian(*place) - [me[f"{axis}_m"] for axis in "xyz"]
    if not np.linalg.norm(apart_m) <= _COORDINATE_TOLERANCE_M:
        raise InputError(
            f"position.me: longitude, latitude and height differ from x, y and z by "
            f"{np.linalg.norm(apart_m):.3g} m; make the file again"
        )
    covariance = np.array(value["covariance"]["enu_m2"], dtype=np.float64)
    if not np.allclose(covariance, covariance.T, rtol=1e-6, equal_nan=True):
        raise InputError("covariance.enu_m2: expected a symmetric matrix; make the file again")
    for key, variance in zip(_SIGMAS, np.diag(covariance), strict=True):
        sigma = value["sigma"][key]
        if (sigma is None) != (not np.isfinite(variance)) or not (
            sigma is None or abs(sigma**2 - variance) <= 2.0 * _SIGMA_TOLERANCE * max(sigma**2, variance)
        ):
            _fail(f"sigma.{key}", f"the square root of its variance, {variance:g} m^2", sigma)


def _require_spans_and_terrain(value: Mapping[str, Any]) -> None:
    """Require what errors of a span of time, and heights above terrain, need to be recognised in other solutions."""
    for key in ("considered", "priors"):
        for place, item in enumerate(value.get(key, ())):
            if ("first_utc" in item) != ("last_utc" in item):
                _fail(f"{key}[{place}]", "both first_utc and last_utc, or neither", item)
            if item.get("first_utc", "") > item.get("last_utc", ""):
                _fail(f"{key}[{place}].last_utc", "an epoch not before first_utc", item["last_utc"])
            if key == "considered" and "position_enu_m" not in item:
                _fail(f"{key}[{place}].position_enu_m", "a list of 3", None)
    if any(item["name"].endswith(".height_above_terrain") for item in value.get("priors", ())):
        provenance = value["provenance"]
        prior = (provenance.get("estimate") or {}).get("height_prior") or {}
        if "dem" not in prior or provenance.get("terrain_resolution_m") is None:
            _fail("provenance.estimate.height_prior", "the files and the resolution of the terrain", prior)


_SIGMAS = ("east_m", "north_m", "up_m")
_ANY_NUMBER = _number()
_TRUTH = _required(lambda value: isinstance(value, bool), "true or false")
_COUNT = _number(0)
_METRES = _number(-MAX_COORDINATE_M, MAX_COORDINATE_M)
_SIGMA = _or_none(_number(0.0))
_XYZ = {f"{axis}_m": _METRES for axis in "xyz"}
_GEOGRAPHIC: dict[str, Check] = {
    "longitude_deg": _number(-360.0, 360.0),
    "latitude_deg": _number(-90.0, 90.0),
    "height_m": _METRES,
}
_PLACE = _GEOGRAPHIC | _XYZ
_POSITION = _record(
    {
        "pa": _record({"frame": _text(r"PA_[A-Za-z0-9_.-]+", "principal axes, such as PA_DE421")} | _XYZ),
        "me": _record({"frame": _text(r"ME_[A-Za-z0-9_.-]+", "mean-Earth axes, such as ME_DE421")} | _PLACE),
    }
)
_SIGMA_ENU = _record(dict.fromkeys(_SIGMAS, _SIGMA))
_SIGMA_LEVELS = _record(
    dict.fromkeys(_SIGMAS, _SIGMA), dict.fromkeys(("scaled", "formal", "ephemeris"), _SIGMA_ENU)
)
_COVARIANCE = _record({"enu_m2": _list(_list(_or_none(_ANY_NUMBER), 3), 3)})
_LOCATED: dict[str, Check] = {
    "position": _or_none(_POSITION),
    "sigma": _or_none(_SIGMA_LEVELS),
    "covariance": _or_none(_COVARIANCE),
}
_LUNAR_HEIGHT = _number(*LUNAR_HEIGHT_LIMITS_M)
_REFERENCE = _record(
    {"name": _text(), **_GEOGRAPHIC, "height_m": _LUNAR_HEIGHT},
    dict.fromkeys(("east_m", "north_m", "up_m", "horizontal_m", "distance_m"), _METRES)
    | dict.fromkeys(("east_sigmas", "north_sigmas", "up_sigmas", "combined_sigmas"), _or_none(_ANY_NUMBER)),
)
_PARAMETER = _record(
    dict.fromkeys(("name", "unit"), _text())
    | dict.fromkeys(("sigma", "total_sigma"), _SIGMA)
    | {"value": _ANY_NUMBER, "fixed": _TRUTH}
)
_SHA256 = _text(r"[0-9a-f]{64}", "64 hexadecimal digits")
_FILE: dict[str, Check] = {"file": _text(), "sha256": _or_none(_SHA256)}
_STUDY = _record(
    _FILE | {"inputs": _list(_record(_FILE))},
    {"hours": _or_none(_number(0.0)), "settings": _mapping(_text())},
)
_HEIGHT_PRIOR = _record({"sigma_m": _number(0.0)}, {"dem": _list(_record({"sha256": _SHA256}))})
_PROVENANCE = _record(
    {},
    {
        "terrain_resolution_m": _or_none(_number(1e-3)),
        "files": _list(_text()),
        "images": _list(_text()),
        "study": _or_none(_STUDY),
        "estimate": _or_none(_record({}, {"height_prior": _or_none(_HEIGHT_PRIOR)})),
    },
)
_SPAN = {"first_utc": _utc, "last_utc": _utc}
_PRIOR = _record(
    {"name": _text(), "value": _ANY_NUMBER, "sigma": _number(1e-30), "position_enu_m": _list(_METRES, 3)},
    _SPAN,
)
_CONSIDERED = _list(_record({"name": _text()}, {"position_enu_m": _list(_METRES, 3), **_SPAN}))
_SERIES = _record(
    dict.fromkeys(("path", "type"), _text())
    | dict.fromkeys(("utc_s", "observed_m"), _list(_ANY_NUMBER))
    | {"count_s": _SIGMA, "sigma_m": _number(0.0)}
)
_SOLUTION = _record(
    {
        "name": _text(r".*"),
        "converged": _TRUTH,
        **_LOCATED,
        "fit": _record(
            {"used": _COUNT, "rejected": _COUNT},
            {"wrms_m": _or_none(_ANY_NUMBER), "chi2_per_dof": _or_none(_ANY_NUMBER)},
        ),
        "reference": _or_none(_REFERENCE),
        "provenance": _PROVENANCE,
    },
    {
        "method": _text(),
        "status": _text(),
        "message": _text(r".*"),
        "references": _list(_REFERENCE),
        "parameters": _list(_PARAMETER),
        "considered": _CONSIDERED,
        "priors": _list(_PRIOR),
        "observations": _list(_all(_SERIES, _same_lengths)),
        "targets": _mapping(_record(_LOCATED | {"priors": _list(_PRIOR)}, {"considered": _CONSIDERED})),
    },
)
_ROW_PLACE: dict[str, Check] = {
    "longitude_west_deg": _number(-360.0, 360.0),
    "latitude_deg": _GEOGRAPHIC["latitude_deg"],
    "height_m": _METRES,
}


def _reference_has_place(value: Any, where: str) -> None:
    if value["method"] == "reference":
        _record(_ROW_PLACE | {"height_m": _LUNAR_HEIGHT})(value, where)


_ROW = _all(_record({"name": _text(), "method": _text()}, _ROW_PLACE), _reference_has_place)


_ARCS = _record(
    {
        "name": _text(),
        "positions": _list(_ROW),
        "arcs": _all(
            _list(_record({"hours": _number(0.0), "solution": _SOLUTION})),
            _required(bool, "at least one item"),
        ),
    }
)
