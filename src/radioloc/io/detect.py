"""Observations from files of any format that is known: the content says which."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import FileFormatError, InputError
from radioloc.io.checks import Catalogue, refuse_duplicates
from radioloc.io.crd import looks_like_crd, read_crd
from radioloc.io.mini import looks_like_mini, read_mini
from radioloc.io.tdm import TdmAgreement, TdmFile, looks_like_tdm, read_tdm_file, tdm_observations
from radioloc.measurements.observations import Observations
from radioloc.text_files import read_blocks, read_lines, starts_with

_KNOWN = (
    "CRD normal points (first record: H1 CRD); MINI normal points (lines start with 51 and a date); "
    "table of observations (first line names columns: epoch_utc,type,path,...); "
    "CCSDS Tracking Data Message (CCSDS_TDM_VERS = 2.0, or XML with <tdm>); Parquet"
)


def read_observations(
    paths: str | Path | Sequence[str | Path],
    *,
    catalogue: Catalogue | None = None,
    tdm: TdmAgreement | None = None,
    lunar: bool = True,
) -> Observations:
    """Read one or more files of observations, each plain or gzip, and join them in the order given.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        The files.
    catalogue : Catalogue, optional
        Gives stations their catalogue names; the library's own by default. A station that it does not know
        keeps the name that the file gives it, except in a TDM, where it is an error.
    tdm : TdmAgreement, optional
        What Tracking Data Messages do not say; their standard deviations must be given. All messages are read as
        one, in the place of the first: clocks, weather and frequencies of one count for the others.
    lunar : bool
        Whether the target is at the Moon, so that a range of another length is a mistake; a spacecraft on its way is
        not. Normal points (CRD, MINI) always are of the Moon.

    Raises
    ------
    FileFormatError
        A file cannot be read, is of no known format, or is damaged. Names the line.
    InputError
        No file was given, or the same observation is there twice, in one file or in two.

    Examples
    --------
    >>> import radioloc
    >>> radioloc.read_observations("examples/apollo15/apollo15_apollo_2006-2007.csv")
    <Observations 153 2006-04-07 to 2007-06-19>
    """
    files = [paths] if isinstance(paths, (str, Path)) else list(paths)
    if not files:
        raise InputError("no file of observations was given; give at least one")
    if catalogue is None:
        catalogue = StationCatalogue.default()
    parts: list[Observations] = []
    messages: list[TdmFile] = []
    place = 0
    for file in files:
        read = _reader(file, catalogue, lunar)
        if read is None:
            place = place if messages else len(parts)
            messages.append(read_tdm_file(file))
        else:
            parts.append(read())
    if messages:
        agreement = tdm or TdmAgreement()
        agreement = replace(agreement, lunar=lunar and agreement.lunar)
        parts.insert(place, tdm_observations(messages, agreement, catalogue=catalogue).observations)
    if len(parts) == 1:
        return parts[0]
    observations = Observations.concatenate(parts)
    refuse_duplicates(observations)
    return observations


def _reader(path: str | Path, catalogue: Catalogue, lunar: bool) -> Callable[[], Observations] | None:
    """What reads a file of this format, None for a Tracking Data Message."""
    # Arrow takes a fifth of a second to import.
    from radioloc.io.parquet import MAGIC, read_parquet
    from radioloc.io.table import looks_like_table, read_table

    if starts_with(path, MAGIC):
        return lambda: read_parquet(path, catalogue=catalogue, lunar=lunar)
    # The start is enough, unless it holds nothing but comments.
    for lines in _starts(path):
        if looks_like_tdm(lines):
            return None
        if looks_like_crd(lines):
            return lambda: read_crd(path, catalogue=catalogue)
        if looks_like_mini(lines):
            return lambda: read_mini(path, catalogue=catalogue)
        if looks_like_table(lines):
            return lambda: read_table(path, catalogue=catalogue, lunar=lunar)
    first = next(line for line in lines if line.strip())
    raise FileFormatError(path, f"starts with {first[:40]!r}, which is none of the known formats: {_KNOWN}")


def _starts(path: str | Path) -> Iterator[list[str]]:
    """Lines at the start of a file, then all of them."""
    _, start = next(read_blocks(path))
    yield start.decode().split("\n")
    yield list(read_lines(path))
