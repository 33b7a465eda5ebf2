"""The same measurement given twice would count twice: it is refused."""

from __future__ import annotations

import numpy as np

from radioloc.errors import InputError
from radioloc.measurements.observations import Observations


def refuse_duplicates(observations: Observations) -> None:
    """Raise where two rows agree in epoch, kind, path and value.

    Raises
    ------
    InputError
        Names the files and lines of the first such pair, and how many there are.
    """
    keys = (
        observations.value_m,
        observations.epoch.fraction,
        observations.epoch.jd,
        observations.link,
        observations.kind,
    )
    order = np.lexsort(keys)
    same = np.ones(max(len(order) - 1, 0), dtype=bool)
    for key in keys:
        same &= key[order][1:] == key[order][:-1]
    if not same.any():
        return
    pairs = np.sort(np.stack([order[:-1][same], order[1:][same]], axis=1), axis=1)
    first, second = (int(row) for row in pairs[np.lexsort((pairs[:, 0], pairs[:, 1]))[0]])
    raise InputError(
        f"{observations.origin(second)}: this observation is already there, in {observations.origin(first)} "
        f"({len(pairs)} such pair(s) in all); leave one of them out"
    )
