"""Observations as a plain table: comma-separated text that a spreadsheet opens and nothing is lost in.

The first line that is not a comment (``#``) or blank names the columns, in any order::

    epoch_utc,type,path,light_time_s,sigma_s,time_tag,pressure_hpa,temperature_k,relative_humidity,wavelength_um
    2006-04-07T06:26:30.000000000000,range,APOLLO>apollo15>APOLLO,2.6494326499837,5.38e-11,transmit,721.6,...

========================  ====================================================================================
``epoch_utc``             UTC of the event that ``time_tag`` names, ``yyyy-mm-ddThh:mm:ss.ssssssssssss``
``type``                  ``range``, ``vlbi_delay``, ``doppler`` or ``vlbi_delay_rate``
``path``                  ``transmitter>target>receiver``, or ``station1<target>station2`` of VLBI
``observed_m``            whole light path (round trip), m; for the other types as
                          :data:`radioloc.measurements.observations.KINDS` says; or, instead,
``light_time_s``          time of flight (round trip), s; for the other types ``observed_m`` over the speed of light
``sigma_m``               standard deviation of the whole light path, m; or, instead,
``sigma_s``               standard deviation of the time of flight, s
``time_tag``              ``transmit``, ``receive`` or ``bounce``
``pressure_hpa``          pressure at the station, hPa
``temperature_k``         temperature, K
``relative_humidity``     from 0 to 1
``wavelength_um``         vacuum wavelength of the light or of the radio signal on its way down, micrometres
``uplink_hz``             frequency of the radio signal on its way up, Hz
``count_s``               count interval of Doppler and of a delay rate, s
========================  ====================================================================================

The last six may be left out, whole or, with an empty field, for a row: then they were not recorded. Doppler and
delay rates need their count interval.
Numbers are written with as many digits as give back the same float.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.errors import FileFormatError, InputError
from radioloc.io.dates import utc_from_text, utc_to_text
from radioloc.io.duplicates import refuse_duplicates
from radioloc.io.names import Catalogue, named_link
from radioloc.io.plausible import FLIGHT_TIME_LIMITS_S, require_lunar_flight_time
from radioloc.measurements.observations import KINDS, RANGE, TIME_TAGS, Link, Observations
from radioloc.text_files import read_lines, write_text

_TEXT = ("epoch_utc", "type", "path", "time_tag")
_VALUE = ("observed_m", "light_time_s")
_SIGMA = ("sigma_m", "sigma_s")
_WEATHER = ("pressure_hpa", "temperature_k", "relative_humidity", "wavelength_um")
_RADIO = ("uplink_hz", "count_s")
_COLUMNS = (*_TEXT[:3], *_VALUE, *_SIGMA, _TEXT[3], *_WEATHER, *_RADIO)


def looks_like_table(lines: list[str]) -> bool:
    """Whether the first line that is not a comment names the epoch's column."""
    return "epoch_utc" in next((line for line in lines if _is_content(line)), "")


def read_table(path: str | Path, *, catalogue: Catalogue | None = None) -> Observations:
    """Read a table, plain or gzip, in the layout that this module's documentation gives.

    Parameters
    ----------
    path : path-like
        The file.
    catalogue : Catalogue, optional
        Gives stations their catalogue names; without it they stay as they are.

    Raises
    ------
    FileFormatError
        A column is missing, unknown or there twice; a row has another number of fields; a date, number,
        type, tag or path cannot be read or is impossible. Names the line.
    InputError
        The same observation is there twice.
    """
    return parse_table(path, read_lines(path), catalogue)


def parse_table(path: str | Path, lines: list[str], catalogue: Catalogue | None) -> Observations:
    """As :func:`read_table`, from the file's lines."""
    kept = [(number, line) for number, line in enumerate(lines, start=1) if _is_content(line)]
    if not kept:
        raise FileFormatError(path, "has no header line; see the documentation of radioloc.io.table", 1)
    numbers = [number for number, _ in kept]
    rows = _split(path, kept)
    header = _header(path, numbers[0], rows[0])
    for row, number in zip(rows, numbers, strict=True):
        if len(row) != len(header):
            problem = f"has {len(row)} fields, but the header has {len(header)}: cut or damaged"
            raise FileFormatError(path, problem, number)
    del rows[0], numbers[0]
    if not rows:
        raise FileFormatError(path, "has a header, but no observations")
    table = dict(zip(header, zip(*rows, strict=True), strict=True))

    def column(name: str, convert: Callable[[Sequence[str]], Any]) -> Any:
        """Convert a whole column; should that fail, field by field to find the line."""
        try:
            return convert(table[name])
        except (ValueError, InputError):
            for text, number in zip(table[name], numbers, strict=True):
                try:
                    convert([text])
                except (ValueError, InputError) as error:
                    problem = str(error) if isinstance(error, InputError) else f"{text!r} is not a number"
                    raise FileFormatError(path, f"{name}: {problem}", number) from None
            raise

    def numbers_of(name: str) -> Any:
        return column(name, _floats)

    links: dict[Link, int] = {}
    link = column("path", lambda texts: _link_codes(texts, links, catalogue))
    observations = Observations.from_columns(
        epoch=column("epoch_utc", lambda texts: utc_from_text([text.strip() for text in texts])),
        links=tuple(links),
        link=link,
        tag=column("time_tag", lambda texts: _choice_codes(texts, TIME_TAGS)),
        kind=column("type", lambda texts: _choice_codes(texts, KINDS)),
        value_m=numbers_of("observed_m") if "observed_m" in table else C_M_S * numbers_of("light_time_s"),
        sigma_m=numbers_of("sigma_m") if "sigma_m" in table else C_M_S * numbers_of("sigma_s"),
        files=(str(path),),
        line=numbers,
        **{name: column(name, _optional_floats) for name in (*_WEATHER, *_RADIO) if name in table},
    )
    low_s, high_s = FLIGHT_TIME_LIMITS_S
    flight_s = observations.value_m / C_M_S
    absurd = (observations.kind == RANGE) & ~((flight_s > low_s) & (flight_s < high_s))
    if absurd.any():
        first = int(np.argmax(absurd))
        require_lunar_flight_time(path, int(observations.line[first]), float(flight_s[first]))
    refuse_duplicates(observations)
    return observations


def write_table(
    path: str | Path, observations: Observations, *, light_time: bool = False, comments: Iterable[str] = ()
) -> None:
    """Write observations as a table that :func:`read_table` gives back unchanged.

    Parameters
    ----------
    path : path-like
        The file; an existing one is replaced.
    observations : Observations
        What to write; where the rows came from is not written.
    light_time : bool
        Write seconds (``light_time_s``, ``sigma_s``) rather than metres. Values that were read as seconds
        come out with the digits that were read.
    comments : iterable of str
        Lines to put on top, each after ``#``.

    Raises
    ------
    FileFormatError
        The file cannot be written.
    """
    unit = C_M_S if light_time else 1.0
    columns: dict[str, Sequence[str]] = {
        "epoch_utc": utc_to_text(observations.epoch),
        "type": observations.types().tolist(),
        "path": observations.paths().tolist(),
        _VALUE[light_time]: _texts(observations.value_m / unit),
        _SIGMA[light_time]: _texts(observations.sigma_m / unit),
        "time_tag": observations.tags().tolist(),
    }
    for name in (*_WEATHER, *_RADIO):
        column = getattr(observations, name)
        if name in _WEATHER or not np.isnan(column).all():
            columns[name] = _texts(column)
    lines = [f"# {comment}".rstrip() for text in comments for comment in text.split("\n")]
    lines.append(",".join(columns))
    lines += map(",".join, zip(*columns.values(), strict=True))
    write_text(path, "\n".join(lines) + "\n")


def _is_content(line: str) -> bool:
    stripped = line.strip()
    return bool(stripped) and not stripped.startswith("#")


def _split(path: str | Path, kept: list[tuple[int, str]]) -> list[list[str]]:
    rows: list[list[str]] = []
    reader = csv.reader((line for _, line in kept), strict=True, skipinitialspace=True)
    try:
        for row in reader:
            if reader.line_num != len(rows) + 1:
                raise csv.Error("a quoted field does not end on its line")
            rows.append(row)
    except csv.Error as error:
        raise FileFormatError(path, f"{error}; correct the quotes", kept[len(rows)][0]) from error
    return rows


def _header(path: str | Path, number: int, fields: list[str]) -> list[str]:
    header = [name.strip() for name in fields]
    for name in header:
        if name not in _COLUMNS:
            raise FileFormatError(path, f"column {name!r} is not known; use {', '.join(_COLUMNS)}", number)
        if header.count(name) > 1:
            raise FileFormatError(path, f"column {name!r} is there twice; leave one out", number)
    for choice in (*((name,) for name in _TEXT), _VALUE, _SIGMA):
        given = [name for name in choice if name in header]
        if not given:
            raise FileFormatError(path, f"column {' or '.join(choice)} is missing; add it", number)
        if len(given) > 1:
            raise FileFormatError(path, f"columns {' and '.join(given)} say the same; leave one out", number)
    return header


def _floats(texts: Sequence[str]) -> NDArray[np.float64]:
    values = np.array([float(text) for text in texts])
    # float() takes underscores and digits of other scripts, which no other program would read alike.
    joined = "".join(texts)
    if "_" in joined or not joined.isascii():
        raise ValueError
    return values


def _optional_floats(texts: Sequence[str]) -> NDArray[np.float64]:
    return _floats([text if text.strip() else "nan" for text in texts])


def _choice_codes(texts: Sequence[str], choices: tuple[str, ...]) -> NDArray[np.int8]:
    codes = {text: _choice_code(text, choices) for text in set(texts)}
    return np.array([codes[text] for text in texts], dtype=np.int8)


def _choice_code(text: str, choices: tuple[str, ...]) -> int:
    try:
        return choices.index(text.strip())
    except ValueError:
        raise InputError(f"{text!r} is not known; use {' or '.join(choices)}") from None


def _link_codes(
    texts: Sequence[str], links: dict[Link, int], catalogue: Catalogue | None
) -> NDArray[np.int32]:
    codes = {}
    # Not a set: the links shall be numbered as they come.
    for text in dict.fromkeys(texts):
        codes[text] = links.setdefault(named_link(Link.from_path(text), catalogue), len(links))
    return np.array([codes[text] for text in texts], dtype=np.int32)


def _texts(values: NDArray[np.float64]) -> list[str]:
    return ["" if math.isnan(value) else repr(value) for value in values.tolist()]
