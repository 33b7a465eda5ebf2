"""Observations as a Parquet file: the columns of the plain table, numbers as numbers.

A timestamp of Parquet counts nanoseconds and knows no leap second; a time tag has picoseconds, and a laser range to the
Moon needs those beyond the nanosecond, in which the range changes by up to a micrometre. So the epoch is written as two
columns of whole numbers, ``utc_date`` and ``utc_ps``, which any program reads alike. Files of others may have
``epoch_utc`` instead, text or a timestamp. Numbers that were not recorded are null. The type, path and time tag are
dictionaries of texts. The unit of each column is in its metadata, those of the file name radioloc and its version.

Source: Apache Parquet format, logical types.
"""

from __future__ import annotations

from itertools import chain
from pathlib import Path

import numpy as np

from radioloc.errors import FileFormatError
from radioloc.io.checks import Catalogue
from radioloc.measurements.observations import Observations
from radioloc.text_files import replaced_file, require_file

_ROWS_AT_ONCE = 2**17
# What measures something takes bytes, however well it is packed; a file that says otherwise would fill the memory.
_MOST_ROWS_A_BYTE = 2
_LARGEST_GROWTH = 50
_ALWAYS_UNPACKED_BYTES = 2**24


def read_parquet(path: str | Path, *, catalogue: Catalogue | None = None, lunar: bool = True) -> Observations:
    """Read a Parquet file of observations; the row, counted from 1, stands for the line.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import radioloc
    >>> from radioloc.io import read_parquet
    >>> path = pathlib.Path(tempfile.mkdtemp(), "ranges.parquet")
    >>> ranges = radioloc.read_observations("examples/change5/short_arc.csv")
    >>> _ = radioloc.write_observations(path, ranges)
    >>> len(read_parquet(path)) == len(ranges)
    True
    """
    # Arrow takes a fifth of a second to import.
    import pyarrow
    from pyarrow import parquet

    from radioloc.io.table_columns import ColumnReader, require_columns

    require_file(path)
    reader, row = ColumnReader(path, catalogue), 1
    try:
        with parquet.ParquetFile(path) as file:
            header = list(file.schema_arrow.names)
            require_columns(path, header, split_epoch=True)
            size, rows = Path(path).stat().st_size, file.metadata.num_rows
            groups = (file.metadata.row_group(k) for k in range(file.metadata.num_row_groups))
            unpacked = sum(group.total_byte_size for group in groups)
            if rows > _MOST_ROWS_A_BYTE * size or unpacked > max(
                _LARGEST_GROWTH * size, _ALWAYS_UNPACKED_BYTES
            ):
                says = f"says that it has {rows} rows of {unpacked} bytes, more than it can hold"
                bound = f"{_MOST_ROWS_A_BYTE} rows a byte and {_LARGEST_GROWTH} times its size"
                raise FileFormatError(path, f"{says} (the bound is {bound}); it is refused")
            for batch in file.iter_batches(_ROWS_AT_ONCE):
                # Text that is not UTF-8 and places that a dictionary does not have.
                batch.validate(full=True)
                if len(batch):
                    lines = np.arange(row, row + len(batch), dtype=np.int32)
                    reader.read(dict(zip(header, batch.columns, strict=True)), lines)
                row += len(batch)
    except (pyarrow.ArrowException, OSError, UnicodeDecodeError) as error:
        [first, *_] = str(error).splitlines() or ["damaged"]
        reason = "".join(character for character in first if character.isprintable()).strip()
        raise FileFormatError(
            path, f"cannot be read as Parquet ({reason}); fetch or write it again"
        ) from error
    return reader.observations(lunar=lunar)


def write_parquet(path: str | Path, observations: Observations) -> None:
    """Write observations as a Parquet file that :func:`read_parquet` gives back, epochs to 1e-12 s or better.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import radioloc
    >>> from radioloc.io import read_parquet, write_parquet
    >>> path = pathlib.Path(tempfile.mkdtemp(), "ranges.parquet")
    >>> ranges = radioloc.read_observations("examples/apollo15/apollo15_apollo_2006-2007.csv")
    >>> write_parquet(path, ranges[:5])
    >>> read_parquet(path)
    <Observations 5 2006-04-07 to 2006-04-08>
    """
    from pyarrow import parquet

    from radioloc.io.table_columns import record_batches

    batches = record_batches(observations, split_epoch=True)
    first = next(batches)
    with replaced_file(path) as temporary, parquet.ParquetWriter(temporary, first.schema) as writer:
        for batch in chain([first], batches):
            writer.write_batch(batch)
