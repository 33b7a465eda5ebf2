"""Numbers in the lines of the text files of models of the atmosphere."""

from __future__ import annotations

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
            number = float("nan")
        if not np.isfinite(number):
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
        rows.append(words)
    try:
        table = np.array(rows, dtype=np.float64).reshape(len(rows), n_columns)
        if np.isfinite(table).all():
            return table
    except ValueError:
        pass
    # Only a file with a wrong number is gone through word by word, to name its line.
    return np.array([numbers_of(path, k, row, what) for (k, _), row in zip(lines, rows, strict=True)])


def fixed_numbers(
    path: str | Path, line_number: int, line: str, skip: int, width: int, count: int
) -> list[float]:
    """Finite numbers in columns of one width, from a column on; :class:`FileFormatError` where a field is none."""
    fields = [line[skip + k * width : skip + (k + 1) * width] for k in range(count)]
    try:
        numbers = [float(field) for field in fields]
    except ValueError:
        numbers = []
    if not numbers or not np.isfinite(numbers).all():
        problem = f"{count} numbers of {width} columns each are wanted, but {line.rstrip()!r} stands here"
        raise FileFormatError(path, problem, line_number)
    return numbers
