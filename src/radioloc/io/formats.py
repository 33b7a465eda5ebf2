"""Observations from files of any format that is known, by the content, and to files, by the ending of the name."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path

import numpy as np

from radioloc.earth.stations import StationCatalogue
from radioloc.errors import FileFormatError, InputError
from radioloc.io.crd import read_crd
from radioloc.io.frequencies import (
    FrequencyAgreement,
    looks_like_fdets,
    looks_like_strf,
    read_fdets,
    read_strf,
)
from radioloc.io.mini import read_mini
from radioloc.io.odf import read_odf
from radioloc.io.odf_records import looks_like_odf
from radioloc.io.table import (
    RAMP_COLUMNS,
    read_parquet,
    read_ramps_only,
    read_table,
    write_parquet,
    write_ramps,
    write_table,
)
from radioloc.io.tdm import TdmAgreement, looks_like_tdm, read_tdm, write_tdm
from radioloc.measurements.observations import Observations, counted_once, without_duplicates
from radioloc.measurements.quantised import with_rounding_in_sigmas
from radioloc.measurements.registry import is_integrated
from radioloc.measurements.table_columns import COLUMNS
from radioloc.plugins import Registry, entry_errors
from radioloc.text_files import head_of, read_text, require_ending
from radioloc.time import utc_to_tai

logger = logging.getLogger(__name__)

_HEAD_BYTES = 65536
_HEADER_LINES = 20  # of comments or titles before the line that names columns
_MIN_COLUMN_NAMES = 3
_AROUND_NAMES = "#%;/! \"'\t"
# Modified Julian dates of six decimals are rounded to half of this.
_REREAD_S = 0.1
ENDINGS = (".csv", ".parquet", ".tdm", ".kvn")
"""Endings of the names of files that are written."""


@dataclass(frozen=True, slots=True)
class ReadSettings:
    """What a file may leave open.

    Parameters
    ----------
    catalogue : StationCatalogue
        Gives stations their catalogue names.
    tdm : TdmAgreement
        What Tracking Data Messages do not say.
    lunar : bool
        Whether the target is at the Moon.
    frequencies : tuple of FrequencyAgreement
        What files of received frequencies do not say.
    """

    catalogue: StationCatalogue
    tdm: TdmAgreement
    lunar: bool
    frequencies: tuple[FrequencyAgreement, ...] = ()


@dataclass(frozen=True, slots=True)
class Reader:
    """A file format of observations, as the registry holds it.

    Parameters
    ----------
    name : str
        Unique name of the format.
    description : str
        How a file of it begins, for messages.
    looks_like : callable
        From the first bytes of a file (unpacked, without a byte order mark) to whether it is of this format.
    read : callable
        From paths and settings to observations. There is one path, unless all files of the format are read `together`.
    together : bool
        Whether files of the format are read as one, since one says what holds for others.
    """

    name: str
    description: str
    looks_like: Callable[[bytes], bool]
    read: Callable[[Sequence[str | Path], ReadSettings], Observations]
    together: bool = False


def _by_lines(looks_like: Callable[[list[str]], bool]) -> Callable[[bytes], bool]:
    return lambda head: looks_like(head.decode(errors="replace").splitlines())


def _first_line(form: str, comment: str = "#") -> Callable[[bytes], bool]:
    """Whether a file's first line that is neither blank nor a comment begins in a form."""

    def looks_like(lines: list[str]) -> bool:
        said = (line for line in lines if line.strip() and not line.lstrip().startswith(comment))
        return re.match(form, next(said, ""), re.ASCII) is not None

    return _by_lines(looks_like)


def _names_columns(columns: Collection[str], form: str) -> Callable[[bytes], bool]:
    """Whether a file's first line has a form, or one of the first lines has three of a table's column names."""

    def looks_like(lines: list[str]) -> bool:
        content = (line for line in lines if line.strip() and not line.lstrip().startswith("#"))
        first = chain(islice(content, _HEADER_LINES), lines[:_HEADER_LINES])
        cells = ({cell.strip(_AROUND_NAMES).lower() for cell in re.split("[,;\t]", line)} for line in first)
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
            lambda paths, its: read_tdm(
                paths,
                replace(
                    its.tdm,
                    lunar=its.lunar and its.tdm.lunar,
                    frequencies=its.frequencies or its.tdm.frequencies,
                ),
                catalogue=its.catalogue,
            ),
            together=True,
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
            lambda paths, its: read_strf(paths[0], its.frequencies, catalogue=its.catalogue),
        ),
        Reader(
            "Fdets frequencies",
            "comments first, one of them: Base frequency: 8400.00 MHz",
            _by_lines(looks_like_fdets),
            lambda paths, its: read_fdets(paths[0], its.frequencies, catalogue=its.catalogue),
        ),
        Reader(
            "table of observations",
            "first line names columns: epoch_utc,type,path,...",
            _names_columns(COLUMNS, r".*epoch_utc"),
            lambda paths, its: read_table(paths[0], catalogue=its.catalogue, lunar=its.lunar),
        ),
        Reader(
            "table of ramps",
            "first line names columns: station,start_utc,stop_utc,frequency_hz,rate_hz_s",
            _names_columns(RAMP_COLUMNS, r"(?=.*start_utc).*frequency_hz"),
            lambda paths, its: read_ramps_only(paths[0], catalogue=its.catalogue),
        ),
        Reader(
            "orbit data file",
            "of the Deep Space Network, TRK-2-18: the header of a file label, key 101",
            looks_like_odf,
            lambda paths, its: read_odf(paths[0], catalogue=its.catalogue, sigma_m=its.tdm.sigma_m),
        ),
        Reader(
            "Parquet",
            "first bytes: PAR1",
            lambda head: head.startswith(b"PAR1"),
            lambda paths, its: read_parquet(paths[0], catalogue=its.catalogue, lunar=its.lunar),
        ),
    ],
)
"""File formats of observations by name: those of the package, and those of other packages.

A package adds its own by an entry point of the group ``radioloc.readers`` that names a :class:`Reader`.
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
        Gives stations their catalogue names; the library's own by default. A station that it does not know
        keeps the name that the file gives it.
    tdm : TdmAgreement, optional
        What Tracking Data Messages do not say; their standard deviations must be given. All messages are read as
        one, in the place of the first: clocks, weather and frequencies of one count for the others.
    lunar : bool
        Whether the target is at the Moon, so that a range of another length is a mistake; a spacecraft on its way is
        not. Normal points (CRD, MINI) always are of the Moon.
    frequencies : iterable of FrequencyAgreement
        What files of received frequencies do not say: for each file the first that holds for it.

    Raises
    ------
    FileFormatError
        A file cannot be read, is of no known format, or is damaged. Names the line.
    InputError
        No file was given, or one observation has two values, in one file or in two.

    Warns
    -----
    DataQualityWarning
        The same observation is there twice, and counted once; or readings are multiples of a step, and their sigmas
        are raised to step / sqrt(12).

    Examples
    --------
    >>> import radioloc
    >>> radioloc.read_observations("examples/apollo15/apollo15_apollo_2006-2007.csv")
    <Observations 153 2006-04-07 to 2007-06-19>
    """
    files = [paths] if isinstance(paths, (str, Path)) else list(paths)
    if not files:
        raise InputError("no file of observations was given; give at least one")
    settings = ReadSettings(
        StationCatalogue.default() if catalogue is None else catalogue,
        tdm or TdmAgreement(),
        lunar,
        tuple(frequencies),
    )
    groups: dict[tuple[str, int], list[str | Path]] = {}
    for place, file in enumerate(files):
        reader = _reader_of(file)
        groups.setdefault((reader.name, -1 if reader.together else place), []).append(file)
    parts = []
    for (name, _), group in groups.items():
        reader = READERS[name]
        with entry_errors(f"reader {reader.name}", "read"):
            parts.append(reader.read(group, settings))
        logger.info(
            "read %d observations from %s (%s)", len(parts[-1]), ", ".join(map(str, group)), reader.name
        )
    joined = parts[0] if len(parts) == 1 else without_duplicates(Observations.concatenate(parts))
    return with_rounding_in_sigmas(_without_rereadings(joined))


def _without_rereadings(observations: Observations) -> Observations:
    """Count Doppler once that two files have with tags that differ by rounding."""
    rows = np.flatnonzero(is_integrated(observations.kind))
    if len(observations.files) == 1 or len(rows) < 2:
        return observations
    tai, count_s = utc_to_tai(observations.epoch[rows]), observations.count_s[rows]
    time_s = tai.seconds_since(tai[:1])
    band = np.nan_to_num(np.rint(10.0 * np.log(observations.wavelength_um[rows])))
    series = [band, count_s, *(getattr(observations, name)[rows] for name in ("tag", "kind", "link"))]
    order = np.lexsort([time_s, *series])
    near = np.diff(time_s[order]) < np.minimum(_REREAD_S, 0.25 * count_s[order[1:]])
    near &= np.all([column[order[1:]] == column[order[:-1]] for column in series], axis=0)
    file = observations.file[rows]
    pairs = np.column_stack([order[:-1], order[1:]])[near & (np.diff(file[order]) != 0)]
    later = np.argsort(file[pairs], axis=1)
    first, second = rows[np.take_along_axis(pairs, later, axis=1).T]
    problem = "this count of Doppler is already there, but for the rounding of its time"
    return counted_once(observations, first, second, problem)


def _reader_of(path: str | Path) -> Reader:
    def of_content(content: bytes) -> Reader | None:
        for reader in READERS.values():
            with entry_errors(f"reader {reader.name}", "looks_like"):
                if reader.looks_like(content):
                    return reader
        return None

    if (reader := of_content(head_of(path, _HEAD_BYTES))) is not None:
        return reader
    # The start may hold nothing but comments; of what is no text, this is the error.
    text = read_text(path)
    if (reader := of_content(text.encode())) is not None:
        return reader
    lines = [line for line in text.splitlines() if line.strip()]
    first = next((line for line in lines if not line.lstrip().startswith("#")), lines[0])
    known = "; ".join(f"{reader.name} ({reader.description})" for reader in READERS.values())
    solution = "; a solution of images belongs to [[observations.map_positions]]" if first[0] == "{" else ""
    raise FileFormatError(
        path, f"starts with {first[:40]!r}, which is none of the known formats: {known}{solution}"
    )


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
    ending = require_ending(path, ENDINGS)
    if originator is None and ending not in (".csv", ".parquet"):
        raise InputError(
            f"{path}: a Tracking Data Message names the agency that makes it; "
            "give originator (--originator NAME)"
        )
    return ending
