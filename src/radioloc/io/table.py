"""Observations as a plain table: comma-separated text that a spreadsheet opens and nothing is lost in.

The first line that is not a comment (``#``) or blank names the columns, in any order::

    epoch_utc,type,path,light_time_s,sigma_s,time_tag,pressure_hpa,temperature_k,relative_humidity,wavelength_um
    2006-04-07T06:26:30.000000000000,range,APOLLO>apollo15>APOLLO,2.6494326499837,5.38e-11,transmit,721.6,...

========================  ====================================================================================
``epoch_utc``             UTC of the event that ``time_tag`` names, ``yyyy-mm-ddThh:mm:ss.ssssssssssss``
``type``                  ``range``, ``vlbi_delay``, ``doppler`` or ``vlbi_delay_rate``
``path``                  ``transmitter>target>receiver``, or ``station1<target>station2`` of VLBI
``observed_m``            whole light path (round trip), m; for the other types as
                          :data:`radioloc.measurements.registry.KINDS` says; or, instead,
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

import itertools
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import C_M_S
from radioloc.errors import FileFormatError
from radioloc.estimation.labels import Labels
from radioloc.io.csv_columns import Cells, label_cells, lines_of
from radioloc.io.dates import utc_cells
from radioloc.io.duplicates import refuse_duplicates
from radioloc.io.names import Catalogue
from radioloc.io.plausible import FLIGHT_TIME_LIMITS_S, require_lunar_flight_time
from radioloc.io.shortest_numbers import shortest_cells
from radioloc.io.table_head import SIGMA, VALUE, require_columns
from radioloc.io.table_rows import OPTIONAL_NUMBERS, RowReader, is_content, split_lines
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.observations import RANGE, WEATHER_LIMITS, Observations
from radioloc.measurements.registry import KINDS
from radioloc.text_files import read_blocks, write_blocks
from radioloc.time import Epochs


def looks_like_table(lines: list[str]) -> bool:
    """Whether the first line that is not a comment names the epoch's column."""
    return "epoch_utc" in next((line for line in lines if is_content(line)), "")


def read_table(path: str | Path, *, catalogue: Catalogue | None = None, lunar: bool = True) -> Observations:
    """Read a table, plain or gzip, in the layout that this module's documentation gives.

    Parameters
    ----------
    path : path-like
        The file.
    catalogue : Catalogue, optional
        Gives stations their catalogue names; without it they stay as they are.
    lunar : bool
        Whether the target is at the Moon, so that a range of another length is a mistake.

    Returns
    -------
    Observations
        In the order of the file's rows, whatever their epochs.

    Raises
    ------
    FileFormatError
        A column is missing, unknown or there twice; a row has another number of fields; a date, number,
        type, tag or path cannot be read or is impossible. Names the line.
    InputError
        The same observation is there twice.
    """
    return _from_blocks(path, read_blocks(path), catalogue, lunar)


def parse_table(path: str | Path, lines: list[str], catalogue: Catalogue | None) -> Observations:
    """As :func:`read_table`, from the file's lines."""
    return _from_blocks(path, [(1, "\n".join(lines).encode())], catalogue)


def _from_blocks(
    path: str | Path, blocks: Iterable[tuple[int, bytes]], catalogue: Catalogue | None, lunar: bool = True
) -> Observations:
    reader: RowReader | None = None
    for line, text in blocks:
        while reader is None and text:
            row, _, text = text.partition(b"\n")
            if is_content(row.decode()):
                reader = RowReader(path, _header(path, line, row.decode()), catalogue)
            line += 1
        if reader is not None:
            reader.read(text, line)
    if reader is None:
        raise FileFormatError(path, "has no header line; see the documentation of radioloc.io.table", 1)
    return checked_observations(path, reader.columns(), lunar)


def checked_observations(path: str | Path, columns: dict[str, Any], lunar: bool = True) -> Observations:
    """Observations of one file, refused where a range is not one to the Moon or a row is there twice.

    Parameters
    ----------
    path : path-like
        The file.
    columns : dict
        By the names that :meth:`~radioloc.measurements.observations.Observations.from_columns` has for them, but
        for values in seconds, ``light_time_s`` and ``sigma_s``, and with ``line``.
    lunar : bool
        Whether the target is at the Moon; if not, any range will do.

    Raises
    ------
    FileFormatError
        A value is impossible. Names the line.
    InputError
        The same observation is there twice.
    """
    for seconds, metres in (("light_time_s", "value_m"), ("sigma_s", "sigma_m")):
        if seconds in columns:
            columns[metres] = C_M_S * columns.pop(seconds)
    observations = Observations.from_columns(files=(str(path),), **columns)
    low_s, high_s = FLIGHT_TIME_LIMITS_S
    flight_s = observations.value_m / C_M_S
    absurd = lunar & (observations.kind == RANGE) & ~((flight_s > low_s) & (flight_s < high_s))
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
    header = []
    columns: list[Callable[[slice], Cells]] = []
    for name, column in table_columns(observations, light_time=light_time).items():
        header.append(name)
        columns.append(_cells_of(column))
    notes = [f"# {comment}".rstrip() for text in comments for comment in text.split("\n")]
    start = "\n".join([*notes, ",".join(header), ""]).encode()
    write_blocks(path, itertools.chain([start], lines_of(columns, len(observations))))


def table_columns(
    observations: Observations, *, light_time: bool = False
) -> dict[str, Epochs | Labels | NDArray[np.float64]]:
    """Columns of a table by name, in order; those of radio only if there is something in them."""
    unit = C_M_S if light_time else 1.0
    columns: dict[str, Epochs | Labels | NDArray[np.float64]] = {
        "epoch_utc": observations.epoch,
        "type": Labels(observations.kind.astype(np.int32), KINDS),
        "path": Labels(observations.link, tuple(link.path for link in observations.links)),
        VALUE[light_time]: observations.value_m / unit,
        SIGMA[light_time]: observations.sigma_m / unit,
        "time_tag": Labels(observations.tag.astype(np.int32), TIME_TAGS),
    }
    for name in OPTIONAL_NUMBERS:
        column = getattr(observations, name)
        if name in WEATHER_LIMITS or not np.isnan(column).all():
            columns[name] = column
    return columns


def _cells_of(column: Epochs | Labels | NDArray[np.float64]) -> Callable[[slice], Cells]:
    """What gives the texts of some rows."""
    match column:
        case Epochs():
            return lambda rows: utc_cells(column[rows])
        case Labels():
            return lambda rows: label_cells(column, rows)
    return lambda rows: shortest_cells(column[rows])


def _header(path: str | Path, number: int, line: str) -> list[str]:
    [fields] = split_lines(path, [(number, line)])
    header = [name.strip() for name in fields]
    require_columns(path, header, number)
    return header
