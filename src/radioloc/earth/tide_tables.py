"""Published tables of tides, one file each in ``data``: what a table holds and where it is from, its head says."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray


@cache
def tide_table(name: str) -> NDArray[np.float64]:
    """Rows of numbers of a table that ships, shape (rows, columns), read-only."""
    text = (files("radioloc.earth") / "data" / f"{name}.csv").read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if not line.startswith("#")][1:]  # under the columns' names
    table = np.loadtxt(rows, delimiter=",", ndmin=2)
    table.setflags(write=False)
    return table
