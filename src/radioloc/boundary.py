"""What public functions and records take of astropy, by the names of their arguments and fields.

A name that ends in a unit (``step_s``, ``reach_m``, ``by_station_deg``) takes a ``Quantity`` of any unit that converts
into it; ``tt``, ``tdb``, ``epochs`` and names that end in ``_utc`` take a ``Time`` of any scale. What is neither stays
as it is. So nothing in kilometres is taken for metres, and inside the library there are floats and epochs only.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np

from radioloc.constants import J2000_JD, SECONDS_PER_DAY
from radioloc.errors import InputError
from radioloc.time import Epochs, to_scale, utc_strings
from radioloc.units import as_metres, in_unit, unit_of

_P = ParamSpec("_P")
_T = TypeVar("_T")

_SCALES = {"tt": "TT", "tdb": "TDB", "ut1": "UT1"} | dict.fromkeys(
    ("utc", "epoch", "epochs", "epoch_utc"), "UTC"
)
"""Names of epochs, and the scale that each is in."""


def bare(name: str, value: Any) -> Any:
    """Return a value as floats or epochs, by the name of its argument or field; other kinds are an InputError."""
    if not takes_astropy(name):
        return value
    if hasattr(value, "jd1") or (name in ("tt", "tdb", "utc") and not isinstance(value, Epochs)):
        return _moment(name, Epochs.from_time(value))
    if isinstance(value, Epochs) and name.endswith("_utc") and name not in _SCALES:
        return _moment(name, value)
    unit = unit_of(name)
    if unit is None:
        return value
    if isinstance(value, Mapping):
        found = {key: bare(name, item) for key, item in value.items()}
        return found if any(found[key] is not item for key, item in value.items()) else value
    return as_metres(value, name) if unit == "m" else in_unit(value, unit, name)


def bare_fields(record: Any) -> None:
    """Make floats and epochs of the fields of a frozen record that is being made; see :func:`bare`."""
    for field in (field for field in fields(record) if field.init):  # others are not there yet
        given = getattr(record, field.name)
        value = bare(field.name, given)
        if value is not given:
            if "tuple" in str(field.type) and np.ndim(value):
                value = tuple(np.asarray(value).tolist())
            object.__setattr__(record, field.name, value)


def bare_arguments(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Let a function have floats and epochs, whatever its arguments are given as; see :func:`bare`."""
    places = {
        name: place
        for place, name in enumerate(inspect.signature(function).parameters)
        if takes_astropy(name)
    }

    @wraps(function)
    def called(*args: _P.args, **kwargs: _P.kwargs) -> _T:
        given: list[Any] = list(args)
        for name, place in places.items():
            if place < len(given):
                given[place] = bare(name, given[place])
            elif name in kwargs:
                kwargs[name] = bare(name, kwargs[name])
        return function(*given, **kwargs)

    return called


def takes_astropy(name: str) -> bool:
    """Whether an argument of that name is a number with a unit, or an epoch."""
    return unit_of(name) is not None or name in _SCALES or name.endswith("_utc")


def _moment(name: str, given: Epochs) -> Any:
    """Epochs as the argument has them: in its scale, as text, or as seconds of TDB since J2000."""
    if name in _SCALES:
        return to_scale(given, _SCALES[name])
    if name.endswith("_utc"):
        texts = utc_strings(to_scale(given, "UTC")).tolist()
        return texts[0] if len(texts) == 1 else texts
    if name.endswith("_tdb_s"):
        tdb = to_scale(given, "TDB")
        seconds = ((tdb.jd - J2000_JD) + tdb.fraction) * SECONDS_PER_DAY
        return float(seconds[0]) if len(seconds) == 1 else seconds
    raise InputError(f"{name} is no time, but an astropy Time was given")
