"""Recorded results checked at the boundary: ``solution.json``, ``arcs.json`` and mappings of the same form.

The schema lists the keys that other jobs read, with their types and ranges. Other keys are not checked.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from radioloc.constants import LUNAR_HEIGHT_LIMITS_M, MEAN_LUNAR_RADIUS_M
from radioloc.errors import InputError, error_context, legible
from radioloc.text_files import json_file
from radioloc.time import epochs_from_strings

Check = Callable[[Any, str], None]
"""Function that raises :class:`InputError` for an invalid value; the text is its place."""

MAX_COORDINATE_M = 1e12
"""Largest accepted coordinate or sigma of a position; fits that fail can end far from the Moon."""

_MAX_SHOWN = 60  # characters of a wrong value
_MAX_HEIGHT_DIFFERENCE_M = 1e3  # between the forms of a position


def read_recorded(path: str | Path) -> Mapping[str, Any]:
    """Read and check a ``solution.json`` or an ``arcs.json``."""
    problem = "is neither a solution.json nor an arcs.json of this version of radioloc; make it again"
    with json_file(path, problem) as content:
        if not isinstance(content, Mapping):
            raise InputError(problem)
        _check(_ARCS if "positions" in content else _SOLUTION, content, "")
        solutions = [arc["solution"] for arc in content["arcs"]] if "positions" in content else [content]
        if not solutions:
            _fail("arcs", "at least one item", [])
        for solution in solutions:
            _require_complete(solution)
    return dict(content)


def check_solution(content: Mapping[str, Any]) -> None:
    """Check the content of a ``solution.json``; an InputError names the key of a wrong value."""
    _check(_SOLUTION, content, "")
    _require_complete(content)


def _fail(place: str, expected: str, value: Any) -> NoReturn:
    is_short = isinstance(value, float | bool | None) or (isinstance(value, int) and abs(value) < 10**20)
    got = legible(
        repr(value[:_MAX_SHOWN] if isinstance(value, str) else value if is_short else type(value).__name__)
    )
    raise InputError(f"{place or 'top level'}: expected {expected}, got {got}; make the file again")


def _check(schema: Any, value: Any, place: str) -> None:
    """Compare a value with its schema; an InputError names the place of a difference.

    A schema is a mapping of keys (``KEY?``: optional, ``*``: all others), a list of one schema for all items or of one
    for each, a tuple of None and a schema for optional values, or a function that checks.
    """
    match schema:
        case Mapping():
            _check_mapping(schema, value, place)
        case [None, inner] if isinstance(schema, tuple):
            if value is not None:
                _check(inner, value, place)
        case list():
            if not isinstance(value, Sequence | np.ndarray) or isinstance(value, str):
                _fail(place, "a list", value)
            if len(schema) not in (1, len(value)):
                _fail(place, f"a list of {len(schema)}", f"{len(value)} items")
            for k, item in enumerate(value):
                _check(schema[k % len(schema)], item, f"{place}[{k}]")
        case _:
            schema(value, place)


def _check_mapping(schema: Mapping[str, Any], value: Any, place: str) -> None:
    if not isinstance(value, Mapping):
        _fail(place, "an object", value)
    for key, item in value.items() if "*" in schema else ():
        _check(schema["*"], item, f"{place}.{legible(str(key))}")
    for name, inner in schema.items():
        key = name.rstrip("?")
        path = f"{place}.{key}" if place else key
        if key in value:
            _check(inner, value[key], path)
        elif name not in (f"{key}?", "*"):
            raise InputError(f"{path}: the key is missing; make the file again")


def _required(is_valid: Callable[[Any], bool], expected: str) -> Check:
    return lambda value, place: None if is_valid(value) else _fail(place, expected, value)


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


def _utc(value: Any, place: str) -> None:
    try:
        epochs_from_strings([value], "UTC")
    except (TypeError, ValueError):
        _fail(place, "a date such as 2020-12-01T15:11:00", value)


def _require_complete(value: Mapping[str, Any]) -> None:
    """Require what belongs to a position, for each of several targets too."""
    for name, target in value.get("targets", {}).items():
        with error_context(f"targets.{legible(str(name))}:"):
            _require_complete({**value, **target, "targets": {}})
    if value["position"] is None:
        return
    stated_m = value["position"]["me"]["height_m"]
    for axes, place in value["position"].items():
        height_m = math.hypot(*(place[key] for key in _XYZ)) - MEAN_LUNAR_RADIUS_M
        if not math.isclose(height_m, stated_m, abs_tol=_MAX_HEIGHT_DIFFERENCE_M):
            _fail(
                f"position.{axes}", f"x, y and z at position.me.height_m, {stated_m:.0f} m", round(height_m)
            )
    for key in ("sigma", "covariance"):
        if value[key] is None:
            _fail(key, "an object beside the position", None)
    covariance = np.array(value["covariance"]["enu_m2"], dtype=np.float64)
    if not np.allclose(covariance, covariance.T, rtol=1e-6, equal_nan=True):
        raise InputError("covariance.enu_m2: expected a symmetric matrix; make the file again")
    _require_spans_and_terrain(value)


def _require_spans_and_terrain(value: Mapping[str, Any]) -> None:
    """Require the spans of errors and the terrain of heights, by which other solutions recognise them."""
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
_SIGMA = (None, _number(0.0))
_XYZ = {f"{axis}_m": _METRES for axis in "xyz"}
_LATITUDE = _number(-90.0, 90.0)
_GEOGRAPHIC = {"longitude_deg": _number(-360.0, 360.0), "latitude_deg": _LATITUDE, "height_m": _METRES}
_POSITION = {
    "pa": {"frame": _text(r"PA_[A-Za-z0-9_.-]+", "principal axes, such as PA_DE421"), **_XYZ},
    "me": {
        "frame": _text(r"ME_[A-Za-z0-9_.-]+", "mean-Earth axes, such as ME_DE421"),
        **_GEOGRAPHIC,
        **_XYZ,
    },
}
_SIGMA_ENU = dict.fromkeys(_SIGMAS, _SIGMA)
_SIGMA_LEVELS = _SIGMA_ENU | dict.fromkeys(("scaled?", "formal?", "ephemeris?"), _SIGMA_ENU)
_LOCATED = {
    "position": (None, _POSITION),
    "sigma": (None, _SIGMA_LEVELS),
    "covariance": (None, {"enu_m2": [[(None, _ANY_NUMBER)] * 3] * 3}),
}
_LUNAR_HEIGHT = _number(*LUNAR_HEIGHT_LIMITS_M)
_REFERENCE = (
    {"name": _text(), **_GEOGRAPHIC, "height_m": _LUNAR_HEIGHT}
    | dict.fromkeys(("east_m?", "north_m?", "up_m?", "horizontal_m?", "distance_m?"), _METRES)
    | dict.fromkeys(("east_sigmas?", "north_sigmas?", "up_sigmas?", "combined_sigmas?"), (None, _ANY_NUMBER))
)
_SHA256 = _text(r"[0-9a-f]{64}", "64 hexadecimal digits")
_FILE = {"file": _text(), "sha256": (None, _SHA256)}
_PROVENANCE = {
    "terrain_resolution_m?": (None, _number(1e-3)),
    "files?": [_text()],
    "images?": [_text()],
    "study?": (
        None,
        _FILE | {"inputs": [_FILE], "hours?": (None, _number(0.0)), "settings?": {"*": _text()}},
    ),
    "estimate?": (
        None,
        {"height_prior?": (None, {"sigma_m": _number(0.0), "dem?": [{"sha256": _SHA256}]})},
    ),
}
_SPAN = {"first_utc?": _utc, "last_utc?": _utc}
_SHIFT = [_METRES] * 3
_ERRORS = {
    "considered?": [{"name": _text(), "position_enu_m?": _SHIFT, **_SPAN}],
    "priors?": [
        {"name": _text(), "value": _ANY_NUMBER, "sigma": _number(1e-30), "position_enu_m": _SHIFT, **_SPAN}
    ],
}
_SERIES = {"path": _text(), "type": _text(), "utc_s": [_ANY_NUMBER], "observed_m": [_ANY_NUMBER]}


def _series(value: Any, place: str) -> None:
    _check(_SERIES | {"count_s": _SIGMA, "sigma_m": _number(0.0)}, value, place)
    if len(value["utc_s"]) != len(value["observed_m"]):
        _fail(f"{place}.observed_m", f"{len(value['utc_s'])} values, as of utc_s", len(value["observed_m"]))


_SOLUTION = {
    "name": _text(r".*"),
    "converged": _TRUTH,
    **_LOCATED,
    "fit": {
        "used": _COUNT,
        "rejected": _COUNT,
        "wrms_m?": (None, _ANY_NUMBER),
        "chi2_per_dof?": (None, _ANY_NUMBER),
    },
    "reference": (None, _REFERENCE),
    "provenance": _PROVENANCE,
    "method?": _text(),
    "status?": _text(),
    "message?": _text(r".*"),
    "references?": [_REFERENCE],
    "parameters?": [
        {
            "name": _text(),
            "unit": _text(),
            "value": _ANY_NUMBER,
            "sigma": _SIGMA,
            "total_sigma": _SIGMA,
            "fixed": _TRUTH,
        }
    ],
    "observations?": [_series],
    "targets?": {"*": _LOCATED | _ERRORS},
    **_ERRORS,
}
_ROW_PLACE = {"longitude_deg": _number(-360.0, 360.0), "latitude_deg": _LATITUDE, "height_m": _METRES}


def _row(value: Any, place: str) -> None:
    """Check a row of a table of positions; a reference needs a place."""
    _check(
        {"name": _text(), "method": _text()} | {f"{key}?": _ROW_PLACE[key] for key in _ROW_PLACE},
        value,
        place,
    )
    if value["method"] == "reference":
        _check(_ROW_PLACE | {"height_m": _LUNAR_HEIGHT}, value, place)


_ARCS = {"name": _text(), "positions": [_row], "arcs": [{"hours": _number(0.0), "solution": _SOLUTION}]}
