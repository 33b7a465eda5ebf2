"""Ramps of transmitted frequencies as a plain table, a file beside those of the observations that they belong to.

::

    station,start_utc,stop_utc,frequency_hz,rate_hz_s
    DSS-24,2012-04-09T04:34:00.000000000000,2012-04-09T04:36:12.000000000000,2102419321.5,0.125
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from radioloc.earth.stations import StationCatalogue, station_name
from radioloc.errors import FileFormatError, InputError
from radioloc.measurements.observations import Observations
from radioloc.measurements.ramps import Ramps
from radioloc.text_files import read_rows
from radioloc.time import Epochs
from radioloc.time.dates import utc_from_text

COLUMNS = ("station", "start_utc", "stop_utc", "frequency_hz", "rate_hz_s")


def read_ramps(path: str | Path, *, catalogue: StationCatalogue | None = None) -> Ramps:
    r"""Read a table of ramps; stations get their catalogue names.

    Raises
    ------
    FileFormatError
        The table is cut or damaged, or ramps contradict each other; the message names the line where there is one.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from radioloc.io import read_ramps
    >>> path = pathlib.Path(tempfile.mkdtemp(), "ramps.csv")
    >>> _ = path.write_text(
    ...     "station,start_utc,stop_utc,frequency_hz,rate_hz_s\n"
    ...     "KASHI,2024-05-02T06:00:00,2024-05-02T06:10:00,7.2e9,-0.5\n"
    ... )
    >>> read_ramps(path)
    <Ramps 1 of KASHI>
    """
    names, spans, numbers = [], [], []
    for line, row in read_rows(path, COLUMNS, "a table of ramps"):
        names.append(station_name(catalogue, row["station"]))
        try:
            numbers.append([float(row["frequency_hz"]), float(row["rate_hz_s"])])
            spans.append(utc_from_text([row["start_utc"], row["stop_utc"]]))
        except ValueError as error:  # an InputError is one, too
            raise FileFormatError(path, str(error), line) from None
    if not names:
        raise FileFormatError(path, "has columns, but no ramps")
    span = Epochs.concatenate(spans)
    frequency_hz, rate_hz_s = np.array(numbers).T
    try:
        return Ramps.of(names, span[0::2], span[1::2], frequency_hz, rate_hz_s)
    except InputError as error:
        raise FileFormatError(path, str(error)) from None


def read_ramps_only(path: str | Path, *, catalogue: StationCatalogue | None = None) -> Observations:
    """The ramps of a table as a table of observations without rows, which lends them to those it is joined with."""
    none = np.zeros(0)
    ramps = read_ramps(path, catalogue=catalogue)
    return Observations.from_columns(
        epoch=utc_from_text([]), links=(), value_m=none, sigma_m=none, files=(str(path),), ramps=ramps
    )


def write_ramps(path: str | Path, ramps: Ramps) -> None:
    """Write ramps as a table that :func:`read_ramps` gives back.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from radioloc.io import read_ramps, write_ramps
    >>> from radioloc.measurements import Ramps
    >>> from radioloc.time import epochs_from_strings
    >>> start, stop = epochs_from_strings(["2024-05-02T06:00:00"]), epochs_from_strings(["2024-05-02T06:10:00"])
    >>> path = pathlib.Path(tempfile.mkdtemp(), "ramps.csv")
    >>> write_ramps(path, Ramps.of(["KASHI"], start, stop, [7.2e9], [-0.5]))
    >>> read_ramps(path)
    <Ramps 1 of KASHI>
    """
    # Arrow takes a fifth of a second to import.
    from radioloc.estimation.labels import Labels
    from radioloc.io.csv_file import batches_of, write_csv

    columns = {
        "station": Labels(ramps.station, ramps.stations),
        "start_utc": ramps.start_utc,
        "stop_utc": ramps.stop_utc,
        "frequency_hz": ramps.frequency_hz,
        "rate_hz_s": ramps.rate_hz_s,
    }
    write_csv(path, batches_of(columns))


def looks_like_ramps(lines: list[str]) -> bool:
    """Whether the first line that is no comment names the columns."""
    first = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    return "start_utc" in first and "frequency_hz" in first
