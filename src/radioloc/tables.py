"""Tables of astropy, with units and times, and of pandas."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal

from radioloc.errors import InputError
from radioloc.lazy import optional
from radioloc.time import Epochs
from radioloc.time.dates import utc_datetimes
from radioloc.units import argument_unit

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
