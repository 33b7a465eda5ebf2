"""Quantities of astropy, converted to floats in the expected unit at the public boundary.

NumPy drops the unit of a ``Quantity`` silently. A number without a unit is taken to be in the unit that the argument's
name gives. Nothing is imported unless a unit is met.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError


def in_unit(value: Any, unit: str, name: str) -> Any:
    """A number or array in a unit of astropy's spelling, such as ``"m / yr"``, without it; the name is for the error.

    What has a unit is a Quantity, Angle or Column of astropy, or a list of them; anything else is given back as it is.
    """
    if isinstance(value, list | tuple) and any(_has_unit(one) for one in value):
        if not all(_has_unit(one) for one in value):
            raise InputError(f"{name} mixes numbers with and without a unit; give all of them in one way")
        return np.array([in_unit(one, unit, name) for one in value])
    if not _has_unit(value):
        return value
    quantity = getattr(value, "quantity", value)  # of a table's column
    if not hasattr(quantity, "to_value"):
        raise InputError(f"{name} = {value!r} is of no kind that is known here; give numbers in {unit}")
    try:
        return quantity.to_value(unit)
    except Exception as error:  # astropy's own, which is not imported here
        raise InputError(f"{name} is in {quantity.unit or 'no unit'}; give {unit}") from error


def as_metres(value: Any, name: str) -> Any:
    """A length as metres; an astropy ``EarthLocation`` as its geocentric coordinates. See :func:`in_unit`."""
    if hasattr(value, "geocentric"):
        return np.stack([in_unit(part, "m", name) for part in value.geocentric], axis=-1)
    return in_unit(value, "m", name)


def as_float_array(value: Any, unit: str, name: str) -> NDArray[np.float64]:
    """Numbers in a unit as an array of floats; see :func:`in_unit`."""
    bare = in_unit(value, unit, name)
    try:
        return np.asarray(bare, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} = {value!r} is not a number or an array of numbers, in {unit}") from None


def _has_unit(value: Any) -> bool:
    return getattr(value, "unit", None) is not None or hasattr(value, "magnitude")
