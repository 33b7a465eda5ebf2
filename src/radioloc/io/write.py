"""Observations to a file of the format that its name ends in."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from radioloc.errors import InputError
from radioloc.io.ramp_table import write_ramps
from radioloc.io.table import write_parquet, write_table
from radioloc.io.tdm import write_tdm
from radioloc.measurements.observations import Observations

ENDINGS = {
    ".csv": "table",
    ".parquet": "Parquet",
    ".tdm": "Tracking Data Message (KVN)",
    ".kvn": "Tracking Data Message (KVN)",
    ".xml": "Tracking Data Message (XML)",
}
"""Formats that are written, by the ending of the name."""


def write_observations(
    path: str | Path,
    observations: Observations,
    *,
    originator: str | None = None,
    comments: Iterable[str] = (),
) -> list[Path]:
    """Write observations as a table (``.csv``), Parquet (``.parquet``) or Tracking Data Message (``.tdm``, ...).

    Parameters
    ----------
    path : path-like
        The file; an existing one is replaced.
    observations : Observations
        What to write.
    originator : str, optional
        Agency that makes a Tracking Data Message, which must say so.
    comments : iterable of str
        Comments for the top of a table or a message; Parquet has none.

    Returns
    -------
    list of Path
        The file, and where it is a table or Parquet of observations with ramps the table of these, ``NAME.ramps.csv``
        beside ``NAME.csv``. A study names both.

    Raises
    ------
    InputError
        The ending is not one of :data:`ENDINGS`, or a message has no originator or cannot hold the observations.
    FileFormatError
        The file cannot be written.

    Examples
    --------
    >>> import radioloc
    >>> ranges = radioloc.read_observations("examples/apollo15/apollo15_apollo_2006-2007.csv")
    >>> radioloc.write_observations("ranges.parquet", ranges)
    [PosixPath('ranges.parquet')]
    >>> radioloc.read_observations("ranges.parquet")
    <Observations 153 2006-04-07 to 2007-06-19>
    """
    ending = require_writable(path, originator)
    if ending == ".csv":
        write_table(path, observations, comments=comments)
    elif ending == ".parquet":
        write_parquet(path, observations)
    else:
        assert originator is not None  # require_writable has seen to that
        write_tdm(path, observations, originator=originator, comments=comments)
        return [Path(path)]
    if not len(observations.ramps):
        return [Path(path)]
    write_ramps(ramps_beside(path), observations.ramps)
    return [Path(path), ramps_beside(path)]


def ramps_beside(path: str | Path) -> Path:
    """Where the ramps of a file of observations are written."""
    return Path(path).with_suffix(".ramps.csv")


def require_writable(path: str | Path, originator: str | None = None) -> str:
    """The ending of a file's name, in small letters, if a file of it can be written, or :class:`InputError`."""
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        known = ", ".join(f"{known} ({name})" for known, name in ENDINGS.items())
        raise InputError(f"{path}: the ending says no format that is written; use {known}")
    if originator is None and ending not in (".csv", ".parquet"):
        raise InputError(
            f"{path}: a Tracking Data Message names the agency that makes it; "
            "give originator (--originator NAME)"
        )
    return ending
