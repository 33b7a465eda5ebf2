"""The same measurement given twice would count twice: it is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.measurements.observations import Observations

# Odd, with its ones well spread: the golden ratio in 64 bits.
_MIX = np.uint64(0x9E3779B97F4A7C15)


def refuse_duplicates(observations: Observations) -> None:
    """Raise where two rows agree in epoch, kind, path and value.

    Raises
    ------
    InputError
        Names the files and lines of the first such pair, and how many there are.
    """
    suspects = _suspects(observations)
    if not len(suspects):
        return
    keys = tuple(column[suspects] for column in _columns(observations))
    order = np.lexsort(keys)
    same = np.ones(max(len(order) - 1, 0), dtype=bool)
    for key in keys:
        same &= key[order][1:] == key[order][:-1]
    if not same.any():
        return
    order = suspects[order]
    pairs = np.sort(np.stack([order[:-1][same], order[1:][same]], axis=1), axis=1)
    first, second = (int(row) for row in pairs[np.lexsort((pairs[:, 0], pairs[:, 1]))[0]])
    raise InputError(
        f"{observations.origin(second)}: this observation is already there, in {observations.origin(first)} "
        f"({len(pairs)} such pair(s) in all); leave one of them out"
    )


def _columns(observations: Observations) -> tuple[NDArray[Any], ...]:
    return (
        observations.value_m,
        observations.epoch.fraction,
        observations.epoch.jd,
        observations.link,
        observations.kind,
    )


def _suspects(observations: Observations) -> NDArray[np.intp]:
    """Rows whose hash is there twice, in order: all that agree with another, and hardly any others."""
    mixed = np.zeros(len(observations), dtype=np.uint64)
    for column in _columns(observations):
        # Zero may be positive or negative.
        bits = (column + 0.0).view(np.uint64)
        mixed = (mixed ^ bits) * _MIX
        mixed ^= mixed >> np.uint64(32)
    in_order = np.sort(mixed)
    twice = in_order[1:][in_order[1:] == in_order[:-1]]
    return np.flatnonzero(np.isin(mixed, twice)) if len(twice) else np.empty(0, dtype=np.intp)
