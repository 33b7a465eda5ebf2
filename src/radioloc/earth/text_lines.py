"""Lines of the text files of models of the atmosphere, plain or gzip."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError

_GZIP_MAGIC = b"\x1f\x8b"


def read_lines(path: str | Path) -> list[str]:
    """Lines of a text file, plain or gzip (told by its content), without line ends.

    Raises
    ------
    FileFormatError
        A gzip file was cut or damaged, or the file is empty or compressed in another way.
    OSError
        The file cannot be opened.
    """
    content = Path(path).read_bytes()
    if content.startswith(_GZIP_MAGIC):
        try:
            content = gzip.decompress(content)
        except (OSError, EOFError, zlib.error) as error:
            raise FileFormatError(
                path, f"is a gzip file that was cut or damaged ({error}); fetch it again"
            ) from error
    if content.startswith(b"\x1f\x9d"):
        raise FileFormatError(path, "is compressed with Unix compress (.Z); uncompress it first")
    if not content.strip():
        raise FileFormatError(path, "is empty; fetch it again")
    # The comments of some of these files are in Latin-1; numbers and keywords are ASCII.
    return content.decode("latin-1").splitlines()


def numbers_of(path: str | Path, line_number: int, words: list[str], what: str) -> list[float]:
    """Finite numbers of a line's words.

    Raises
    ------
    FileFormatError
        A word is not a finite number.
    """
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
