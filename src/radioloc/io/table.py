"""Observations as a plain table: comma-separated text that a spreadsheet opens and nothing is lost in.

The first line that is not a comment (``#``) or blank names the columns of :mod:`radioloc.io.table_columns`, in any
order::

    epoch_utc,type,path,light_time_s,sigma_s,time_tag,pressure_hpa,temperature_k,relative_humidity,wavelength_um
    2006-04-07T06:26:30.000000000000,range,APOLLO>apollo15>APOLLO,2.6494326499837,5.38e-11,transmit,721.6,...

Numbers are written with as many digits as give back the same float. Arrow takes blocks of lines apart; those that it
cannot, and those with quotes, Python's ``csv``, which finds the line of a mistake.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError
from radioloc.io.checks import Catalogue
from radioloc.measurements.observations import Observations
from radioloc.text_files import CUT_LINE, read_blocks

# A line that begins with a lower or a higher character may be blank or a comment.
_HASH, _DELETE, _NEW_LINE = 0x23, 0x7F, 0x0A


def read_table(path: str | Path, *, catalogue: Catalogue | None = None, lunar: bool = True) -> Observations:
    """Read a table, plain or gzip, in the order of its rows; ranges of a lunar target must be those of the Moon.

    Examples
    --------
    >>> from radioloc.io import read_table
    >>> read_table("examples/change5/short_arc.csv")
    <Observations 122 2020-12-01 to 2020-12-01>
    """
    return _from_blocks(path, read_blocks(path), catalogue, lunar)


def write_table(
    path: str | Path, observations: Observations, *, light_time: bool = False, comments: Iterable[str] = ()
) -> None:
    """Write observations as a table that :func:`read_table` gives back unchanged.

    In seconds (``light_time_s``, ``sigma_s``) rather than metres values that were read as such keep their digits.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import radioloc
    >>> from radioloc.io import read_table, write_table
    >>> path = pathlib.Path(tempfile.mkdtemp(), "ranges.csv")
    >>> ranges = radioloc.read_observations("examples/apollo15/apollo15_apollo_2006-2007.csv")
    >>> write_table(path, ranges[:5])
    >>> read_table(path)
    <Observations 5 2006-04-07 to 2006-04-08>
    """
    from radioloc.io.csv_file import write_csv
    from radioloc.io.table_columns import record_batches

    write_csv(path, record_batches(observations, light_time=light_time), comments=comments)


def looks_like_table(lines: list[str]) -> bool:
    """Whether the first line that is not a comment names the epoch's column."""
    return "epoch_utc" in next((line for line in lines if _is_content(line)), "")


def _is_content(line: str) -> bool:
    """Whether a line is neither blank nor a comment."""
    stripped = line.strip()
    return bool(stripped) and not stripped.startswith("#")


def _from_blocks(
    path: str | Path, blocks: Iterable[tuple[int, bytes]], catalogue: Catalogue | None, lunar: bool = True
) -> Observations:
    # Arrow takes a fifth of a second to import.
    from radioloc.io.table_columns import ColumnReader, require_columns

    reader = ColumnReader(path, catalogue, as_text=True)
    header: list[str] = []
    for first_line, block in blocks:
        text, line = _content(block, first_line)
        if not header and len(line):
            head, _, text = text.partition(b"\n")
            [names] = _split(path, [head.decode()], line[:1])
            header = [name.strip() for name in names]
            require_columns(path, header, int(line[0]))
            line = line[1:]
        if len(line):
            reader.read(_columns(path, header, text, line), line)
        # A text that was cut is none that is known; a number that was cut is another number.
        if not block.endswith(b"\n") and len(line) and header[-1] not in ("type", "path", "time_tag"):
            last = first_line + block.count(b"\n")
            if line[-1] == last:
                raise FileFormatError(path, CUT_LINE.format(header[-1]), last)
    if not header:
        raise FileFormatError(path, "has no header line; name the columns (epoch_utc,type,path,...)", 1)
    return reader.observations(lunar=lunar)


def _content(block: bytes, first_line: int) -> tuple[bytes, NDArray[np.int32]]:
    """Lines that are neither blank nor comments, each ended by a line feed, and their numbers."""
    if block and not block.endswith(b"\n"):
        block += b"\n"
    characters = np.frombuffer(block, dtype=np.uint8)
    ends = np.flatnonzero(characters == _NEW_LINE)
    numbers = np.arange(first_line, first_line + len(ends), dtype=np.int32)
    begins = characters[np.concatenate([[0], ends[:-1] + 1])] if len(ends) else characters
    if ((begins > _HASH) & (begins < _DELETE)).all():
        return block, numbers
    lines = block.split(b"\n")[:-1]
    kept = np.array([_is_content(line.decode()) for line in lines])
    return b"".join(line + b"\n" for line, keep in zip(lines, kept, strict=True) if keep), numbers[kept]


def _columns(path: str | Path, header: list[str], text: bytes, line: NDArray[np.int32]) -> dict[str, Any]:
    """Fields of some lines as Arrow columns of text."""
    import pyarrow
    import pyarrow.csv

    if b'"' not in text:
        try:
            table = pyarrow.csv.read_csv(
                pyarrow.BufferReader(text),
                pyarrow.csv.ReadOptions(column_names=header, block_size=len(text) + 1, use_threads=False),
                pyarrow.csv.ParseOptions(quote_char=False),
                pyarrow.csv.ConvertOptions(column_types=dict.fromkeys(header, pyarrow.string())),
            )
            return {name: table[name].combine_chunks() for name in header}
        except pyarrow.ArrowInvalid:
            pass
    rows = _split(path, text.decode().split("\n")[:-1], line)
    for row, number in zip(rows, line, strict=True):
        if len(row) != len(header):
            problem = f"has {len(row)} fields, but the header has {len(header)}: cut or damaged"
            raise FileFormatError(path, problem, int(number))
    return {
        name: pyarrow.array(cells, pyarrow.string())
        for name, cells in zip(header, zip(*rows, strict=True), strict=True)
    }


def _split(path: str | Path, lines: list[str], numbers: NDArray[np.int32]) -> list[list[str]]:
    """Fields of lines, quotes taken off."""
    rows: list[list[str]] = []
    reader = csv.reader(lines, strict=True, skipinitialspace=True)
    try:
        for row in reader:
            if reader.line_num != len(rows) + 1:
                raise csv.Error("a quoted field does not end on its line")
            rows.append(row)
    except csv.Error as error:
        raise FileFormatError(path, f"{error}; correct the quotes", int(numbers[len(rows)])) from error
    return rows
