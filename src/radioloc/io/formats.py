"""Readers of observations by the content of files, and writers by the ending of the name."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path

import numpy as np

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import FileFormatError, InputError
from radioloc.io.crd import read_crd
from radioloc.io.frequencies import FrequencyAgreement, looks_like_strf, read_strf
from radioloc.io.mini import read_mini
from radioloc.io.odf import looks_like_odf, read_odf
from radioloc.io.table import (
    RAMP_COLUMNS,
    parquet_parts,
    read_parquet,
    read_ramps_only,
    read_table,
    write_parquet,
    write_ramps,
    write_table,
)
from radioloc.io.tdm import TdmAgreement, looks_like_tdm, read_tdm, write_tdm
from radioloc.measurements.observations import Observations, without_duplicates, without_second
from radioloc.measurements.quantised import with_rounding_in_sigmas
from radioloc.measurements.registry import is_integrated
from radioloc.measurements.table_columns import COLUMNS, own_columns_hint
from radioloc.plugins import Registry, entry_errors
from radioloc.progress import step
from radioloc.text_files import read_head, read_text, require_ending
from radioloc.time import utc_to_tai

logger = logging.getLogger(__name__)

_HEAD_BYTES = 65536
_MAX_HEADER_LINES = 20  # of comments or titles before the line that names columns
_MIN_COLUMN_NAMES = 3
_NAME_DECORATION = "#%;/! \"'\t"
_MAX_TAG_ROUNDING_S = 0.1  # Twice the rounding of modified Julian dates with six decimals
ENDINGS = (".csv", ".parquet", ".tdm", ".kvn")
"""Endings of the names of files that are written."""


@dataclass(frozen=True, slots=True)
class ReadSettings:
    """Information that files may lack."""

    catalogue: StationCatalogue  #: stations by name and alias
    tdm: TdmAgreement  #: agreements on Tracking Data Messages
    lunar: bool  #: whether the target is at the Moon
    frequencies: tuple[FrequencyAgreement, ...] = ()  #: signals of files of received frequencies


@dataclass(frozen=True, slots=True)
class Reader:
    """File format of observations."""

    name: str  #: unique name of the format
    description: str  #: start of a file, for messages
    #: Function of the first bytes of a file (unpacked, without a byte order mark): whether it has the format.
    looks_like: Callable[[bytes], bool]
    #: Function of paths and settings that returns observations. There is one path, unless `joint`.
    read: Callable[[Sequence[str | Path], ReadSettings], Observations]
    joint: bool = False  #: whether all files of the format are read as one, because they complete each other
    #: Function of a path, settings and a number of rows that yields observations, about so many at once; or None.
    in_parts: Callable[[str | Path, ReadSettings, int], Iterator[Observations]] | None = None


def _by_lines(looks_like: Callable[[list[str]], bool]) -> Callable[[bytes], bool]:
    return lambda head: looks_like(head.decode(errors="replace").splitlines())


def _first_line(form: str, comment: str = "#") -> Callable[[bytes], bool]:
    """Return a test whether the first line that is neither blank nor a comment starts with a pattern."""

    def looks_like(lines: list[str]) -> bool:
        content = (line for line in lines if line.strip() and not line.lstrip().startswith(comment))
        return re.match(form, next(content, ""), re.ASCII) is not None

    return _by_lines(looks_like)


def _names_columns(columns: Collection[str], form: str) -> Callable[[bytes], bool]:
    """Return a test whether the first line matches a pattern, or an early line has three names of columns."""

    def looks_like(lines: list[str]) -> bool:
        content = (line for line in lines if line.strip() and not line.lstrip().startswith("#"))
        first = chain(islice(content, _MAX_HEADER_LINES), lines[:_MAX_HEADER_LINES])
        cells = (
            {cell.strip(_NAME_DECORATION).lower() for cell in re.split("[,;\t]", line)} for line in first
        )
        return any(len(names.intersection(columns)) >= _MIN_COLUMN_NAMES for names in cells)

    by_form, by_names = _first_line(form), _by_lines(looks_like)
    return lambda head: by_form(head) or by_names(head)


READERS = Registry(
    "radioloc.readers",
    Reader,
    [
        Reader(
            "Tracking Data Message",
            "of CCSDS: CCSDS_TDM_VERS = 2.0, or XML with <tdm>",
            _by_lines(looks_like_tdm),
            lambda paths, settings: read_tdm(
                paths,
                replace(
                    settings.tdm,
                    lunar=settings.lunar and settings.tdm.lunar,
                    frequencies=settings.frequencies or settings.tdm.frequencies,
                ),
                catalogue=settings.catalogue,
            ),
            joint=True,
        ),
        Reader(
            "CRD normal points",
            "first record: H1 CRD",
            _first_line(r"(?i)h1\s+crd\b", comment="00"),
            lambda paths, settings: read_crd(paths[0], catalogue=settings.catalogue),
        ),
        Reader(
            "MINI normal points",
            "lines start with 51 and a date",
            _first_line(r"51(19|20)\d\d[ \d]{17}"),
            lambda paths, settings: read_mini(paths[0], catalogue=settings.catalogue),
        ),
        Reader(
            "STRF frequencies",
            "lines: modified Julian date, Hz, strength, site",
            _by_lines(looks_like_strf),
            lambda paths, settings: read_strf(paths[0], settings.frequencies, catalogue=settings.catalogue),
        ),
        Reader(
            "table of observations",
            "first line names columns: epoch_utc,type,path,...",
            _names_columns(COLUMNS, r".*epoch_utc"),
            lambda paths, settings: read_table(paths[0], catalogue=settings.catalogue, lunar=settings.lunar),
        ),
        Reader(
            "table of ramps",
            "first line names columns: station,start_utc,stop_utc,frequency_hz,rate_hz_s",
            _names_columns(RAMP_COLUMNS, r"(?=.*start_utc).*frequency_hz"),
            lambda paths, settings: read_ramps_only(paths[0], catalogue=settings.catalogue),
        ),
        Reader(
            "orbit data file",
            "of the Deep Space Network, TRK-2-18: the header of a file label, key 101",
            looks_like_odf,
            lambda paths, settings: read_odf(
                paths[0], catalogue=settings.catalogue, sigma_m=settings.tdm.sigma_m
            ),
        ),
        Reader(
            "Parquet",
            "first bytes: PAR1",
            lambda head: head.startswith(b"PAR1"),
            lambda paths, settings: read_parquet(
                paths[0], catalogue=settings.catalogue, lunar=settings.lunar
            ),
            in_parts=lambda path, settings, rows: parquet_parts(
                path, rows, catalogue=settings.catalogue, lunar=settings.lunar
            ),
        ),
    ],
)
"""File formats of observations by name.

Other packages add a :class:`Reader` by an entry point of the group ``radioloc.readers``.
"""


def read_observations(
    paths: str | Path | Sequence[str | Path],
    *,
    catalogue: StationCatalogue | None = None,
    tdm: TdmAgreement | None = None,
    lunar: bool = True,
    frequencies: Iterable[FrequencyAgreement] = (),
) -> Observations:
    """Read one or more files of observations, each plain or gzip, and join them in the order given.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        The files.
    catalogue : StationCatalogue, optional
        Stations by name and alias, by default those of the library; other stations keep the name in the file.
    tdm : TdmAgreement, optional
        Agreements on Tracking Data Messages; their standard deviations are required. All messages are read as one, in
        the place of the first: clocks, weather and frequencies of one apply to all.
    lunar : bool
        Whether the target is at the Moon, so that ranges of other lengths are errors. Normal points (CRD, MINI) always
        are.
    frequencies : iterable of FrequencyAgreement
        Signals of files of received frequencies: the first entry that matches each file.

    Raises
    ------
    FileFormatError
        A file cannot be read, has an unknown format, or is damaged. Names the line.
    InputError
        No file was given, or one observation has two values, in one file or in two.

    Warns
    -----
    DataQualityWarning
        An observation is repeated, and counted once; or values are multiples of a step, and their sigmas are raised to
        step / sqrt(12).

    Examples
    --------
    >>> import radioloc
    >>> radioloc.read_observations("examples/apollo15/apollo15_apollo_2006-2007.csv")
    <Observations 153 2006-04-07 to 2007-06-19>
    """
    files = [paths] if isinstance(paths, (str, Path)) else list(paths)
    if not files:
        raise InputError("expected at least one file of observations, got none")
    catalogue = StationCatalogue.default() if catalogue is None else catalogue
    return read_files(files, ReadSettings(catalogue, tdm or TdmAgreement(), lunar, tuple(frequencies)))


def read_files(files: Sequence[str | Path], settings: ReadSettings) -> Observations:
    """Return :func:`read_observations` of one or more files by its settings."""
    groups: dict[tuple[str, int], list[str | Path]] = {}
    for place, file in enumerate(files):
        reader = _reader_of(file)
        groups.setdefault((reader.name, -1 if reader.joint else place), []).append(file)
    parts = []
    for (name, _), group in groups.items():
        reader = READERS[name]
        names = ", ".join(Path(file).name for file in group[:3])
        with entry_errors(f"reader {reader.name}", "read"), step(f"reading {names}"):
            parts.append(reader.read(group, settings))
        logger.info(
            "read %d observations from %s (%s)", len(parts[-1]), ", ".join(map(str, group)), reader.name
        )
    joined = parts[0] if len(parts) == 1 else without_duplicates(Observations.concatenate(parts))
    return with_rounding_in_sigmas(_without_rereadings(joined))


def read_in_parts(
    paths: Sequence[str | Path], rows_at_once: int, settings: ReadSettings
) -> Iterator[Observations]:
    """Yield :func:`read_files` in parts; files whose reader has no `in_parts` are read together first."""
    whole_files = list[str | Path]()
    for path in paths:
        reader = _reader_of(path)
        if reader.in_parts is None:
            whole_files.append(path)
            continue
        with entry_errors(f"reader {reader.name}", "in_parts"):
            yield from map(with_rounding_in_sigmas, reader.in_parts(path, settings, rows_at_once))
    if whole_files:
        yield from read_files(whole_files, settings).parts(rows_at_once)


def _without_rereadings(observations: Observations) -> Observations:
    """Return observations without Doppler repeated in another file with rounded time tags."""
    rows = np.flatnonzero(is_integrated(observations.kind))
    if len(observations.files) == 1 or len(rows) < 2:
        return observations
    tai, count_s = utc_to_tai(observations.epoch[rows]), observations.count_s[rows]
    time_s = tai.seconds_since(tai[:1])
    band = np.nan_to_num(np.rint(10.0 * np.log(observations.wavelength_um[rows])))
    series = [band, count_s, *(getattr(observations, name)[rows] for name in ("tag", "kind", "link"))]
    order = np.lexsort([time_s, *series])
    repeats = np.diff(time_s[order]) < np.minimum(_MAX_TAG_ROUNDING_S, 0.25 * count_s[order[1:]])
    repeats &= np.all([column[order[1:]] == column[order[:-1]] for column in series], axis=0)
    file = observations.file[rows]
    pairs = np.column_stack([order[:-1], order[1:]])[repeats & (np.diff(file[order]) != 0)]
    later = np.argsort(file[pairs], axis=1)
    first, second = rows[np.take_along_axis(pairs, later, axis=1).T]
    problem = "this count of Doppler is already there, but for the rounding of its time"
    return without_second(observations, first, second, problem)


def _reader_of(path: str | Path) -> Reader:
    def of_content(content: bytes) -> Reader | None:
        for reader in READERS.values():
            with entry_errors(f"reader {reader.name}", "looks_like"):
                if reader.looks_like(content):
                    return reader
        return None

    if (reader := of_content(read_head(path, _HEAD_BYTES))) is not None:
        return reader
    # The start may consist of comments; a binary file of unknown format fails as text.
    text = read_text(path)
    if (reader := of_content(text.encode())) is not None:
        return reader
    lines = [line for line in text.splitlines() if line.strip()]
    first = next((line for line in lines if not line.lstrip().startswith("#")), lines[0])
    formats = "; ".join(f"{reader.name} ({reader.description})" for reader in READERS.values())
    hint = "; a solution of images belongs to [[observations.map_positions]]" if first[0] == "{" else ""
    if len(header := re.split("[,;\t]", first)) >= _MIN_COLUMN_NAMES and first[0].isalpha():
        raise FileFormatError(path, f"{own_columns_hint(path, header)}; other formats are {formats}")
    raise FileFormatError(path, f"starts with {first[:40]!r}; expected one of the formats {formats}{hint}")


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
        File to write; an existing one is replaced.
    observations : Observations
    originator : str, optional
        Agency, required for a Tracking Data Message.
    comments : iterable of str
        Comments at the top of a table or a message; not for Parquet.

    Returns
    -------
    list of Path
        The file, and for a table or Parquet of observations with ramps the table of ramps, ``NAME.ramps.csv`` beside
        ``NAME.csv``. A study names both.

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
        assert originator is not None  # by require_writable
        write_tdm(path, observations, originator=originator, comments=comments)
        return [Path(path)]
    if not len(observations.ramps):
        return [Path(path)]
    write_ramps(ramps_beside(path), observations.ramps)
    return [Path(path), ramps_beside(path)]


def ramps_beside(path: str | Path) -> Path:
    """Return the path of the ramps of a file of observations."""
    return Path(path).with_suffix(".ramps.csv")


def require_writable(path: str | Path, originator: str | None = None) -> str:
    """Return the ending of a file that can be written, in lower case; another one is an InputError."""
    ending = require_ending(path, ENDINGS)
    if originator is None and ending not in (".csv", ".parquet"):
        raise InputError(
            f"{path}: a Tracking Data Message needs the agency; give originator (--originator NAME)"
        )
    return ending
