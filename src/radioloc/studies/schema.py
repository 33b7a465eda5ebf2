"""Records that say what a table of a study file holds: fields are keys, types and rules are what each key takes.

A record built in Python is held to the same rules as one read from a file (:mod:`radioloc.studies.toml_table`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping
from numbers import Real
from typing import Any

from radioloc.errors import InputError
from radioloc.time import Epochs


def entry(default: Any = dataclasses.MISSING, *, factory: Any = dataclasses.MISSING, **rules: Any) -> Any:
    """A field with rules.

    Rules of values, which :func:`check` looks at: ``positive``, ``not_negative``, ``choices``, ``names`` (one or more
    of them), ``moment`` (one epoch, UTC). Rules of reading: ``advice``, where something else belongs, for values of
    another kind; ``kind``, the type that the file has where it is not the field's; or ``read``, a function of table and
    key that takes the ``keys`` that the file has in place of the field.
    """
    return dataclasses.field(default=default, default_factory=factory, metadata=rules)


def check(record: Any) -> None:
    """Hold a record to the rules of its fields; a single name becomes a tuple of one.

    Raises
    ------
    InputError
        The message begins with the key.
    """
    for field in dataclasses.fields(record):
        value, rules = getattr(record, field.name), field.metadata
        if value is None:
            continue
        if rules.get("names"):
            value = names_of(field.name, value)
            object.__setattr__(record, field.name, value)
            if not value:
                raise InputError(f"{field.name} names none; leave it out to take all")
        if rules.get("moment"):
            _require_moment(field.name, value)
        for key, item in _items(field.name, value):
            if item not in rules.get("choices", (item,)):
                allowed = ", ".join(f'"{choice}"' for choice in rules["choices"])
                raise InputError(f"{key} must be one of {allowed}, not {item!r}")
            number = float(item) if isinstance(item, Real) and math.isfinite(item) else math.nan
            if rules.get("positive") and not number > 0.0:
                raise InputError(f"{key} must be above zero, not {item!r}")
            if rules.get("not_negative") and not number >= 0.0:
                raise InputError(f"{key} must not be negative, not {item!r}")


def names_of(key: str, value: str | Iterable[Any]) -> tuple[str, ...]:
    """One name or several, as a tuple."""
    names = (value,) if isinstance(value, str) else tuple(value)
    for name in names:
        if not isinstance(name, str) or not name.strip():
            raise InputError(f"{key} must be names, not {name!r}")
    return names


def keys_of(record: type) -> tuple[str, ...]:
    """The keys that a file has for a record."""
    return tuple(
        key for field in dataclasses.fields(record) for key in field.metadata.get("keys", (field.name,))
    )


def _items(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        yield from ((f"{key}.{name}", item) for name, item in value.items())
    elif isinstance(value, tuple):
        yield from ((key, item) for item in value)
    else:
        yield key, value


def _require_moment(key: str, value: Any) -> None:
    if not isinstance(value, Epochs) or len(value) != 1:
        raise InputError(f'{key} must be one epoch, such as epochs_from_strings("2024-05-02"), not {value!r}')
    value.require("UTC")
