"""Quantities of astropy, converted to floats in the expected unit at the public boundary.

NumPy drops the unit of a ``Quantity`` silently. A number without a unit is taken to be in the unit that the argument's
name gives. Nothing is imported unless a unit is met.
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
"""Units that names end in, as astropy spells them; of numbers of several units none."""


def unit_of(name: str) -> str | None:
    """Unit, in astropy's spelling, that the name of an argument ends in, such as ``step_s``; None without one."""
    if name == "hours":
        return "h"
    words = name.split("_")
    endings = ("_".join(words[k:]) for k in range(1, len(words)))
    return next((ASTROPY_UNITS[ending] or None for ending in endings if ending in ASTROPY_UNITS), None)


def in_unit(value: Any, unit: str, name: str) -> Any:
    """Return a number, array or list in a unit of astropy's spelling; what has no unit is unchanged."""
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
    """A length as metres; of an ``EarthLocation`` or a representation of astropy x, y, z. See :func:`in_unit`."""
    if hasattr(value, "to_geocentric"):
        return np.stack([in_unit(part, "m", name) for part in value.to_geocentric()], axis=-1)
    if hasattr(value, "to_cartesian"):
        return in_unit(value.to_cartesian().get_xyz(xyz_axis=-1), "m", name)
    if hasattr(value, "xyz_m"):
        raise InputError(
            f"{name} is {value!r}; give its coordinates, to_frame(...).xyz_m, in the axes that are wanted"
        )
    return in_unit(value, "m", name)


def as_float_array(value: Any, unit: str, name: str) -> NDArray[np.float64]:
    """Numbers in a unit as an array of floats; see :func:`in_unit`."""
    bare = as_metres(value, name) if unit == "m" else in_unit(value, unit, name)
    try:
        return np.asarray(bare, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} = {value!r} is not a number or an array of numbers, in {unit}") from None


def _has_unit(value: Any) -> bool:
    return getattr(value, "unit", None) is not None or hasattr(value, "magnitude")
