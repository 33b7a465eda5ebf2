"""Numbers in the lines of the text files of models of the atmosphere."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError

ENCODING = "latin-1"
"""Of these files: the comments of some are not ASCII, numbers and keywords are."""


def numbers_of(path: str | Path, line_number: int, words: list[str], what: str) -> list[float]:
    """Finite numbers of a line's words; :class:`FileFormatError` where a word is none."""
    numbers = []
    for word in words:
        try:
            number = float(word)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise FileFormatError(path, f"{word!r} is not a number, but {what} is wanted", line_number)
        numbers.append(number)
    return numbers


def table_of(
    path: str | Path, lines: list[tuple[int, str]], n_columns: int, what: str
) -> NDArray[np.float64]:
    """Rows of numbers, n_columns each, from lines with their numbers; errors as :func:`numbers_of`."""
    rows = []
    for line_number, line in lines:
        words = line.split()
        if len(words) != n_columns:
            problem = f"{len(words)} columns, but {what} has {n_columns}"
            raise FileFormatError(path, problem, line_number)
        rows.append(numbers_of(path, line_number, words, what))
    return np.array(rows).reshape(len(rows), n_columns)
