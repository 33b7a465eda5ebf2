"""Quantities and times of astropy as arguments of public functions and fields of records.

Names that end in a unit (``step_s``, ``by_station_deg``) take a ``Quantity`` of any unit that converts into it; ``tt``,
``tdb``, ``epochs`` and names that end in ``_utc`` take a ``Time`` of any scale. Other values are unchanged.
Inside the library there are only floats in SI units and epochs. Tables of results have units and times again.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import wraps
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, ParamSpec, TypeAlias, TypeVar

import numpy as np

from radioloc.constants import J2000_JD, SECONDS_PER_DAY
from radioloc.errors import InputError
from radioloc.lazy import optional
from radioloc.time import Epochs, to_scale, utc_strings
from radioloc.time.dates import utc_datetimes
from radioloc.units import argument_unit, as_metres, in_unit, set_fields

if TYPE_CHECKING:
    from astropy.time import Time
    from astropy.units import Quantity

TableForm = Literal["astropy", "pandas"]


def as_table(
    columns: Mapping[str, Any], form: TableForm, units: Mapping[str, str | None] = MappingProxyType({})
) -> Any:
    """Return columns as a QTable of astropy or a DataFrame of pandas (UTC to the nanosecond, no leap second)."""
    if form == "astropy":
        from astropy.table import QTable
        from astropy.units import Quantity

        return QTable(
            {
                name: _with_unit(Quantity, units.get(name) or argument_unit(name), column)
                for name, column in columns.items()
            }
        )
    if form == "pandas":
        pandas = optional("pandas", "a table of pandas needs pandas:", "notebook")
        return pandas.DataFrame(
            {
                name: pandas.DatetimeIndex(utc_datetimes(column), tz="UTC")
                if isinstance(column, Epochs)
                else column
                for name, column in columns.items()
            }
        )
    raise InputError(f"expected a table of astropy or pandas, got {form!r}")


def _with_unit(quantity: Any, unit: str | None, column: Any) -> Any:
    if isinstance(column, Epochs):
        return column.to_time()
    return column if unit is None else quantity(column, unit)


EpochsLike: TypeAlias = "Epochs | Time"
"""Epochs, or an astropy ``Time`` of any scale."""
FloatLike: TypeAlias = "float | Quantity"
"""Number in the unit of the argument's name, or a quantity."""
DateLike: TypeAlias = "str | Time"
"""Date and time of UTC as text, or an astropy ``Time``."""

_P = ParamSpec("_P")
_T = TypeVar("_T")

_SCALES = {"tt": "TT", "tdb": "TDB", "ut1": "UT1"} | dict.fromkeys(
    ("utc", "epoch", "epochs", "epoch_utc"), "UTC"
)
"""Time scale of epochs by the name of the argument."""


def convert_quantity(name: str, value: Any) -> Any:
    """Return a value as floats or epochs, by the name of its argument or field; other kinds are an InputError."""
    if not takes_astropy(name):
        return value
    if hasattr(value, "jd1") or (name in ("tt", "tdb", "utc") and not isinstance(value, Epochs)):
        return _epochs_as(name, Epochs.from_time(value))
    if isinstance(value, Epochs) and name.endswith("_utc") and name not in _SCALES:
        return _epochs_as(name, value)
    unit = argument_unit(name)
    if unit is None:
        return value
    if isinstance(value, Mapping):
        converted = {key: convert_quantity(name, item) for key, item in value.items()}
        return converted if any(converted[key] is not item for key, item in value.items()) else value
    return as_metres(value, name) if unit == "m" else in_unit(value, unit, name)


def convert_fields(record: Any) -> None:
    """Convert the fields of a frozen record in its ``__post_init__``; see :func:`convert_quantity`."""
    for field in (field for field in fields(record) if field.init):
        original = getattr(record, field.name)
        value = convert_quantity(field.name, original)
        if value is not original:
            if "tuple" in str(field.type) and np.ndim(value):
                value = tuple(np.asarray(value).tolist())
            set_fields(record, **{field.name: value})


def accepts_quantities(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Decorate a function whose arguments may be quantities and times; see :func:`convert_quantity`."""
    positions = {
        name: position
        for position, name in enumerate(inspect.signature(function).parameters)
        if takes_astropy(name)
    }

    @wraps(function)
    def converting(*args: _P.args, **kwargs: _P.kwargs) -> _T:
        values: list[Any] = list(args)
        for name, position in positions.items():
            if position < len(values):
                values[position] = convert_quantity(name, values[position])
            elif name in kwargs:
                kwargs[name] = convert_quantity(name, kwargs[name])
        return function(*values, **kwargs)

    return converting


def takes_astropy(name: str) -> bool:
    """Return whether an argument of that name is a number with a unit, or an epoch."""
    return argument_unit(name) is not None or name in _SCALES or name.endswith("_utc")


def _epochs_as(name: str, epochs: Epochs) -> Any:
    """Return epochs in the argument's scale, as text, or as seconds of TDB since J2000."""
    if name in _SCALES:
        return to_scale(epochs, _SCALES[name])
    if name.endswith("_utc"):
        texts = utc_strings(to_scale(epochs, "UTC")).tolist()
        return texts[0] if len(texts) == 1 else texts
    if name.endswith("_tdb_s"):
        tdb = to_scale(epochs, "TDB")
        seconds = ((tdb.jd - J2000_JD) + tdb.fraction) * SECONDS_PER_DAY
        return float(seconds[0]) if len(seconds) == 1 else seconds
    raise InputError(f"{name}: expected a quantity or a number, got an astropy Time")
