"""Observations from files of any format that is known: the content says which."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import FileFormatError, InputError
from radioloc.io.crd import looks_like_crd, read_crd
from radioloc.io.duplicates import refuse_duplicates
from radioloc.io.mini import looks_like_mini, read_mini
from radioloc.io.names import Catalogue
from radioloc.io.parquet import MAGIC as PARQUET_MAGIC
from radioloc.io.parquet import read_parquet
from radioloc.io.table import looks_like_table, read_table
from radioloc.io.tdm import looks_like_tdm, read_tdm_file
from radioloc.io.tdm_agreement import TdmAgreement
from radioloc.io.tdm_file import TdmFile
from radioloc.io.tdm_observations import tdm_observations
from radioloc.measurements.observations import Observations
from radioloc.text_files import read_blocks, read_lines, starts_with

_Reader = Callable[..., Observations]
_FORMATS: tuple[tuple[str, Callable[[list[str]], bool], _Reader], ...] = (
    ("CRD normal points (first record: H1 CRD)", looks_like_crd, read_crd),
    ("MINI normal points (lines start with 51 and a date)", looks_like_mini, read_mini),
    (
        "table of observations (first line names columns: epoch_utc,type,path,...)",
        looks_like_table,
        read_table,
    ),
)
_NOT_ONLY_LUNAR = (read_table,)
_TDM = "CCSDS Tracking Data Message (CCSDS_TDM_VERS = 2.0, or XML with <tdm>)"


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
        No file was given, a Parquet file needs pyarrow, or the same observation is there twice, in one file or in two.
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
        read = _reader(file)
        if read is None:
            place = place if messages else len(parts)
            messages.append(read_tdm_file(file))
        else:
            anywhere = {} if lunar or read not in _NOT_ONLY_LUNAR else {"lunar": False}
            parts.append(read(file, catalogue=catalogue, **anywhere))
    if messages:
        agreement = tdm or TdmAgreement()
        agreement = replace(agreement, lunar=lunar and agreement.lunar)
        parts.insert(place, tdm_observations(messages, agreement, catalogue=catalogue).observations)
    if len(parts) == 1:
        return parts[0]
    observations = Observations.concatenate(parts)
    refuse_duplicates(observations)
    return observations


def _reader(path: str | Path) -> _Reader | None:
    """What reads a file of this format, None for a Tracking Data Message."""
    if starts_with(path, PARQUET_MAGIC):
        return read_parquet
    # The start is enough, unless it holds nothing but comments.
    for lines in _starts(path):
        if looks_like_tdm(lines):
            return None
        for _, looks_like, read in _FORMATS:
            if looks_like(lines):
                return read
    first = next(line for line in lines if line.strip())
    known = "; ".join([*(name for name, _, _ in _FORMATS), _TDM, "Parquet"])
    raise FileFormatError(path, f"starts with {first[:40]!r}, which is none of the known formats: {known}")


def _starts(path: str | Path) -> Iterator[list[str]]:
    """Lines at the start of a file, then all of them."""
    _, start = next(read_blocks(path))
    yield start.decode().split("\n")
    yield list(read_lines(path))
