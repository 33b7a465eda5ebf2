"""Quantities of astropy, converted to floats in the expected unit at the public boundary.

NumPy drops the unit of a ``Quantity`` silently. A number without a unit is taken to be in the unit that the argument's
name gives. Astropy is not imported here.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError

ASTROPY_UNITS = {
    name: name.replace("_", " / ", 1)
    for name in ("m", "s", "h", "deg", "rad", "um", "mm", "arcsec", "m2", "m_s", "rad_s", "m_rad", "rad_m", "s_s")
} | {
    "hpa": "hPa", "k": "K", "hz": "Hz", "px": "pix", "tecu": "1e16 / m2", "per_mm": "1 / mm",
    "m_yr": "m / yr", "m_s2": "m / s2", "m3_s2": "m3 / s2", "m_sqrt_s": "m / s(1/2)", "deg_m": "",
}  # fmt: skip
"""Units that names end in, as astropy spells them; empty for numbers of several units."""


def argument_unit(name: str) -> str | None:
    """Return the unit, in astropy's spelling, that an argument's name ends in, such as ``step_s``, or None."""
    if name == "hours":
        return "h"
    words = name.split("_")
    endings = ("_".join(words[k:]) for k in range(1, len(words)))
    return next((ASTROPY_UNITS[ending] or None for ending in endings if ending in ASTROPY_UNITS), None)


def in_unit(value: Any, unit: str, name: str) -> Any:
    """Return a number, array or list in a unit of astropy's spelling; numbers without a unit are unchanged."""
    if isinstance(value, list | tuple) and any(map(_has_unit, value)):
        if not all(map(_has_unit, value)):
            raise InputError(f"{name}: expected all numbers with a unit or all without, got both")
        return np.array([in_unit(item, unit, name) for item in value])
    if not _has_unit(value):
        return value
    quantity = getattr(value, "quantity", value)  # of a table's column
    if not hasattr(quantity, "to_value"):
        raise InputError(f"{name}: expected numbers in {unit}, got {value!r}")
    try:
        return quantity.to_value(unit)
    except Exception as error:  # astropy's own class, which is not imported here
        raise InputError(f"{name} is in {quantity.unit or 'no unit'}; give {unit}") from error


def as_metres(value: Any, name: str) -> Any:
    """Return lengths in m; x, y, z of an ``EarthLocation`` or representation of astropy; see :func:`in_unit`."""
    if hasattr(value, "to_geocentric"):
        return np.stack([in_unit(part, "m", name) for part in value.to_geocentric()], axis=-1)
    if hasattr(value, "to_cartesian"):
        return in_unit(value.to_cartesian().get_xyz(xyz_axis=-1), "m", name)
    if hasattr(value, "xyz_m"):
        raise InputError(
            f"{name}: expected coordinates, got {value!r}; give to_frame(...).xyz_m, in the axes that {name} is in"
        )
    return in_unit(value, "m", name)


def as_float_array(value: Any, unit: str, name: str) -> NDArray[np.float64]:
    """Return numbers in a unit as an array of floats; see :func:`in_unit`."""
    numbers = as_metres(value, name) if unit == "m" else in_unit(value, unit, name)
    try:
        return np.asarray(numbers, dtype=np.float64)
    except (TypeError, ValueError):
        items = numbers if isinstance(numbers, list | tuple | np.ndarray) else [numbers]
        first = next((item for item in items if not _is_number(item)), value)
        raise InputError(
            f"{name}: expected numbers in {unit}, with a decimal point, got {str(first)[:40]!r}"
        ) from None


def _is_number(value: Any) -> bool:
    try:
        float(value)
    except (TypeError, ValueError):
        return False
    return True


def read_only_array(value: Any, unit: str, name: str) -> NDArray[np.float64]:
    """Return a copy of numbers in a unit as a read-only array of floats; see :func:`in_unit`."""
    array = as_float_array(value, unit, name).copy()
    array.setflags(write=False)
    return array


def set_fields(record: object, **values: Any) -> None:
    """Set fields of a frozen record that is being made, in its ``__post_init__``."""
    for name, value in values.items():
        object.__setattr__(record, name, value)


def _has_unit(value: Any) -> bool:
    return getattr(value, "unit", None) is not None or hasattr(value, "magnitude")
