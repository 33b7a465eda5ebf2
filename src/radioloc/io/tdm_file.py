"""A Tracking Data Message as a record: header, and segments of metadata and columns of data.

Nothing here says what the data mean for a model (that is :mod:`radioloc.io.tdm_observations`); it is the
content of a file, KVN or XML, with what the standard demands of it checked.

Source: CCSDS 503.0-B-2 (2020), sections 3.2 to 3.4.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError, InputError
from radioloc.io.tdm_keywords import (
    ABOVE_ZERO,
    AT_MOST_A_DAY,
    CHOICES,
    CODE,
    DATA,
    LONGEST_S,
    METADATA,
    NOT_NEGATIVE,
    NUMBERS,
    ORDERED,
    PATHS,
    TIME_SYSTEMS,
    WHOLE_NUMBERS,
)
from radioloc.time import Epochs, epochs_from_strings

VERSIONS = ("1.0", "2.0")
"""Versions of the message that are read; 2.0 is written."""

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@dataclass(frozen=True, slots=True)
class TdmHeader:
    """Who made the message, and when.

    Parameters
    ----------
    creation_date : str
        UTC date of the file.
    originator : str
        Agency that made it.
    message_id : str
        The agency's name for the message; empty where it has none.
    comments : tuple of str
        Comments of the header.
    """

    creation_date: str
    originator: str
    message_id: str = ""
    comments: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class TdmSegment:
    """One metadata section and the data it describes.

    Parameters
    ----------
    metadata : mapping of str to str
        Values by keyword; words that the standard lists are in its spelling.
    keyword : ndarray of int8, shape (n,)
        Index into :data:`radioloc.io.tdm_keywords.DATA`.
    epoch : Epochs
        Time tags in UTC, whatever the file's time system, n epochs.
    value : ndarray, shape (n,)
        Values in the standard's units, except that kilometres are metres here (RANGE where its unit is km,
        DOPPLER_*) and percent are parts of one: the float nearest to the file's decimal number.
    lines : Mapping of str to int
        Line of each metadata keyword in the file; ``""`` gives that of the section's start.
    line : ndarray of int32, shape (n,)
        Line of each record in the file, counted from 1.
    comments, data_comments : tuple of str
        Comments of the two sections.
    """

    metadata: Mapping[str, str]
    keyword: NDArray[np.int8]
    epoch: Epochs
    value: NDArray[np.float64]
    lines: Mapping[str, int]
    line: NDArray[np.int32]
    comments: tuple[str, ...] = ()
    data_comments: tuple[str, ...] = ()

    def rows(self, keyword: str) -> NDArray[np.intp]:
        """Rows that hold a keyword's data."""
        return np.flatnonzero(self.keyword == CODE[keyword])

    def keywords(self) -> tuple[str, ...]:
        """Data keywords that there are, each once, in the order of :data:`radioloc.io.tdm_keywords.DATA`."""
        return tuple(DATA[code] for code in np.flatnonzero(np.bincount(self.keyword, minlength=len(DATA))))

    def number(self, keyword: str, otherwise: float = 0.0) -> float:
        """Number that a metadata keyword gives."""
        return float(self.metadata[keyword]) if keyword in self.metadata else otherwise

    def line_of(self, keyword: str) -> int:
        """Line of a metadata keyword, or of the section where it is missing."""
        return self.lines.get(keyword, self.lines.get("", 1))


@dataclass(frozen=True, slots=True, eq=False)
class TdmFile:
    """A whole message.

    Parameters
    ----------
    path : str
        File that it came from.
    header : TdmHeader
        Its header.
    segments : tuple of TdmSegment
        Its segments, in the file's order.
    """

    path: str
    header: TdmHeader
    segments: tuple[TdmSegment, ...]

    def __len__(self) -> int:
        return sum(len(segment.line) for segment in self.segments)

    def __repr__(self) -> str:
        return f"<TdmFile {self.path}: {len(self.segments)} segment(s), {len(self)} records>"


def checked_header(
    path: str, version: str, fields: Mapping[str, str], comments: tuple[str, ...]
) -> TdmHeader:
    """Header from its fields.

    Raises
    ------
    FileFormatError
        Another version, a field is missing, or the date does not exist.
    """
    if version not in VERSIONS:
        known = " and ".join(VERSIONS)
        raise FileFormatError(path, f"CCSDS_TDM_VERS is {version!r}; versions {known} are read", 1)
    for keyword in ("CREATION_DATE", "ORIGINATOR"):
        if not fields.get(keyword):
            raise FileFormatError(path, f"the header has no {keyword}; add it", 1)
    _require_date(path, 1, "CREATION_DATE", fields["CREATION_DATE"])
    return TdmHeader(fields["CREATION_DATE"], fields["ORIGINATOR"], fields.get("MESSAGE_ID", ""), comments)


def checked_metadata(
    path: str, metadata: Mapping[str, str], lines: Mapping[str, int], time_system: str | None
) -> dict[str, str]:
    """Metadata with listed words in the standard's spelling.

    Parameters
    ----------
    path : str
        The file, for messages.
    metadata : mapping of str to str
        What the file says.
    lines : mapping of str to int
        Where it says so; ``""`` gives the section's start.
    time_system : str or None
        Time system of the segments before; None for the first.

    Raises
    ------
    FileFormatError
        A keyword is unknown or missing, a word or number is not one that the standard allows, a path names a
        participant that there is not, or the time system is not one that can be read or not the others'.
    """
    made = {}
    for keyword, value in metadata.items():
        try:
            made[keyword] = _checked_value(keyword, value)
        except ValueError as error:
            raise FileFormatError(path, f"{keyword}: {error}", lines[keyword]) from None
    system = made.get("TIME_SYSTEM")
    for keyword in ("TIME_SYSTEM", "PARTICIPANT_1"):
        if keyword not in made and not (keyword == "PARTICIPANT_1" and _participants(made)):
            raise FileFormatError(path, f"the metadata have no {keyword}; add it", lines[""])
    if time_system is not None and system != time_system:
        problem = (
            f"TIME_SYSTEM is {system}, but {time_system} in the segments before; "
            "mixed time systems are not read: write all of them in one"
        )
        raise FileFormatError(path, problem, lines["TIME_SYSTEM"])
    for keyword in PATHS:
        for index in made[keyword].split(",") if keyword in made else ():
            if f"PARTICIPANT_{index}" not in made:
                there = ", ".join(_participants(made))
                problem = f"{keyword} = {made[keyword]} names participant {index}, but there are only {there}"
                raise FileFormatError(path, f"{problem}; correct it or add the participant", lines[keyword])
    for keyword in ("START_TIME", "STOP_TIME"):
        if keyword in made:
            _require_date(path, lines[keyword], keyword, made[keyword])
    corrections = [k for k in made if k.startswith("CORRECTION_")]
    if corrections and "CORRECTIONS_APPLIED" not in made:
        problem = f"{corrections[0]} without CORRECTIONS_APPLIED: say YES or NO"
        raise FileFormatError(path, problem, lines[corrections[0]])
    return made


def require_order(path: str, segment: TdmSegment) -> None:
    """Refuse data that are needed and whose epochs are not in order, or there twice (3.4.10, 3.4.11).

    Raises
    ------
    FileFormatError
        Names both lines.
    """
    for keyword in segment.keywords():
        if keyword not in ORDERED:
            continue
        rows = segment.rows(keyword)
        jd, fraction, line = segment.epoch.jd[rows], segment.epoch.fraction[rows], segment.line[rows]
        day = np.diff(jd)
        step = np.where(day == 0.0, np.diff(fraction), day)
        if (step > 0.0).all():
            continue
        place = int(np.argmin(step > 0.0))
        first, second = int(line[place]), int(line[place + 1])
        if step[place] == 0.0:
            problem = f"{keyword} is there twice at one epoch, first in line {first}; leave one of them out"
        else:
            problem = f"{keyword} is earlier than that of line {first}; put the records in order of time"
        raise FileFormatError(path, problem, second)


def _participants(metadata: Mapping[str, str]) -> list[str]:
    return [keyword for keyword in metadata if keyword.startswith("PARTICIPANT_")]


def _require_date(path: str, line: int, keyword: str, text: str) -> None:
    try:
        epochs_from_strings(text)
    except InputError as error:
        raise FileFormatError(path, f"{keyword}: {error}", line) from None


def _checked_value(keyword: str, value: str) -> str:
    """Value of a metadata keyword; :class:`ValueError` says what is wrong with it."""
    if keyword not in METADATA:
        raise ValueError("is not a metadata keyword of the standard; correct or remove it")
    if not value:
        raise ValueError("has no value; give one or leave the line out")
    if keyword in CHOICES:
        spelled = {choice.upper(): choice for choice in CHOICES[keyword]}
        word = value.upper().replace(" ", "_")
        if word not in spelled:
            raise ValueError(f"{value!r} is not one of {', '.join(CHOICES[keyword])}")
        return spelled[word]
    if keyword in PATHS:
        path = value.replace(" ", "")
        if re.fullmatch(r"[1-5](,[1-5])+", path) is None:
            raise ValueError(f"{value!r} is not a list of participants' numbers such as 1,2,1")
        return path
    if keyword == "TIME_SYSTEM":
        if value.upper() not in TIME_SYSTEMS:
            raise ValueError(f"{value!r} cannot be read; use one of {', '.join(TIME_SYSTEMS)}")
        return value.upper()
    if keyword in NUMBERS:
        return _checked_number(keyword, value)
    return " ".join(value.split())


def _checked_number(keyword: str, value: str) -> str:
    if _NUMBER.fullmatch(value) is None or not math.isfinite(float(value)):
        raise ValueError(f"{value!r} is not a finite number")
    number = float(value)
    if keyword in WHOLE_NUMBERS and not number.is_integer():
        raise ValueError(f"{value!r} is not a whole number")
    if keyword in ABOVE_ZERO and number <= 0.0:
        raise ValueError(f"{value} must be above zero")
    if keyword in NOT_NEGATIVE and number < 0.0:
        raise ValueError(f"{value} must not be negative")
    if keyword in AT_MOST_A_DAY and number > LONGEST_S:
        raise ValueError(f"{value} must not be longer than a day, in seconds")
    return value
