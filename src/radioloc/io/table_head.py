"""Columns of a table of observations: which there are, which must be there, and which say the same."""

from __future__ import annotations

from pathlib import Path

from radioloc.errors import FileFormatError
from radioloc.io.table_rows import OPTIONAL_NUMBERS

VALUE = ("observed_m", "light_time_s")
SIGMA = ("sigma_m", "sigma_s")
EPOCH_COLUMNS = ("utc_date", "utc_ps")
"""Date and time of day apart, which a Parquet file may have in place of ``epoch_utc``."""
COLUMNS = ("epoch_utc", "type", "path", *VALUE, *SIGMA, "time_tag", *OPTIONAL_NUMBERS)


def require_columns(
    path: str | Path, header: list[str], line: int | None = None, *, split_epoch: bool = False
) -> None:
    """Raise :class:`FileFormatError` where a column is missing, unknown, there twice or said by another.

    Parameters
    ----------
    path : path-like
        The file.
    header : list of str
        Names of its columns.
    line : int, optional
        Where they stand.
    split_epoch : bool
        Whether :data:`EPOCH_COLUMNS` are known too.
    """
    known = (*COLUMNS, *EPOCH_COLUMNS) if split_epoch else COLUMNS
    for name in header:
        if name not in known:
            raise FileFormatError(path, f"column {name!r} is not known; use {', '.join(known)}", line)
        if header.count(name) > 1:
            raise FileFormatError(path, f"column {name!r} is there twice; leave one out", line)
    epoch = tuple(name for name in EPOCH_COLUMNS if name in header)
    if epoch and "epoch_utc" in header:
        raise FileFormatError(path, f"columns epoch_utc and {epoch[0]} say the same; leave one out", line)
    for name in EPOCH_COLUMNS if epoch else ():
        if name not in header:
            raise FileFormatError(path, f"column {name!r} is missing; an epoch is utc_date and utc_ps", line)
    single = ("type", "path", "time_tag") if epoch else ("epoch_utc", "type", "path", "time_tag")
    for choice in (*((name,) for name in single), VALUE, SIGMA):
        given = [name for name in choice if name in header]
        if not given:
            raise FileFormatError(path, f"column {' or '.join(choice)} is missing; add it", line)
        if len(given) > 1:
            raise FileFormatError(path, f"columns {' and '.join(given)} say the same; leave one out", line)
