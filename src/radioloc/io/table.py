"""Tables of observations, as lossless comma-separated text and as Parquet, and writers of other tables.

Both have the columns of :mod:`radioloc.measurements.table_columns`. The first line of text that is neither blank nor a
comment (``#``) names them, in any order::

    epoch_utc,type,path,light_time_s,sigma_s,time_tag,pressure_hpa,temperature_k,relative_humidity,wavelength_um
    2006-04-07T06:26:30.000000000000,range,APOLLO>apollo15>APOLLO,2.6494326499837,5.38e-11,transmit,721.6,...

Numbers have as many digits as reproduce the float.

Timestamps of Parquet count nanoseconds, in which the range of the Moon changes by up to a micrometre, and lack leap
seconds. The epoch is therefore two columns of whole numbers, ``utc_date`` and ``utc_ps``. Files of other programs may
have ``epoch_utc`` instead, text or a timestamp. Missing numbers are null. Type, path and time tag are dictionaries of
texts. The metadata of each column state its unit.

Ramps of transmitted frequencies are a separate table of text beside that of the observations::

    station,start_utc,stop_utc,frequency_hz,rate_hz_s
    DSS-24,2012-04-09T04:34:00.000000000000,2012-04-09T04:36:12.000000000000,2102419321.5,0.125

Source: Apache Parquet format, logical types.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc._version import __version__
from radioloc.constants import C_M_S
from radioloc.earth.stations import StationCatalogue, station_name
from radioloc.errors import FileFormatError, InputError, in_file
from radioloc.labels import Labels, changed
from radioloc.measurements.observations import Observations, observations_from_columns
from radioloc.measurements.ramps import Ramps
from radioloc.measurements.registry import KINDS, TIME_TAGS
from radioloc.measurements.table_columns import (
    COLUMNS,
    OPTIONAL,
    SIGMA,
    VALUE,
    WEATHER,
    ColumnReader,
    require_columns,
)
from radioloc.text_files import (
    CUT_LINE,
    read_blocks,
    read_rows,
    replaced_file,
    require_file,
    spreadsheet_cell,
)
from radioloc.time import Epochs
from radioloc.time.dates import utc_from_text, utc_to_picoseconds, utc_to_text

RAMP_COLUMNS = ("station", "start_utc", "stop_utc", "frequency_hz", "rate_hz_s")

_MAX_SHOWN_CHARACTERS = 60
# Lines that start with a character up to _HASH or from _DELETE on may be blank or a comment.
_HASH, _DELETE, _NEW_LINE = 0x23, 0x7F, 0x0A
_MAX_DECIMAL = 1e15  # of numbers that with all decimals are far below the 38 digits of Arrow
_ROWS_READ, _ROWS_WRITTEN, _ROWS_OF_TEXT = 2**17, 2**16, 2**14
_UNITS = {"utc_ps": "ps", "relative_humidity": "1"} | {
    name: name.rpartition("_")[2]
    for name in (*VALUE, *SIGMA, *OPTIONAL)
    if name not in ("relative_humidity", "ramped")
}


def read_table(
    path: str | Path, *, catalogue: StationCatalogue | None = None, lunar: bool = True
) -> Observations:
    """Read a table, plain or gzip, in the order of its rows; ranges of a lunar target are checked.

    Examples
    --------
    >>> from radioloc.io import read_table
    >>> read_table("examples/change5/short_arc.csv")
    <Observations 122 2020-12-01 to 2020-12-01>
    """
    return _from_blocks(path, read_blocks(path), catalogue, lunar)


def write_table(
    path: str | Path, observations: Observations, *, light_time: bool = False, comments: Iterable[str] = ()
) -> None:
    """Write observations as a table that :func:`read_table` reads back unchanged.

    With `light_time` values are in seconds (``light_time_s``, ``sigma_s``) rather than metres, so that values that were
    read as such keep their digits.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import radioloc
    >>> from radioloc.io import read_table, write_table
    >>> path = pathlib.Path(tempfile.mkdtemp(), "ranges.csv")
    >>> ranges = radioloc.read_observations("examples/apollo15/apollo15_apollo_2006-2007.csv")
    >>> write_table(path, ranges[:5])
    >>> read_table(path)
    <Observations 5 2006-04-07 to 2006-04-08>
    """
    write_csv(path, _record_batches(observations, light_time=light_time), comments=comments)


def read_parquet(
    path: str | Path, *, catalogue: StationCatalogue | None = None, lunar: bool = True
) -> Observations:
    """Read a Parquet file of observations; rows, counted from 1, serve as line numbers."""
    [observations] = parquet_parts(path, None, catalogue=catalogue, lunar=lunar)
    return observations


def parquet_parts(
    path: str | Path,
    rows_at_once: int | None,
    *,
    catalogue: StationCatalogue | None = None,
    lunar: bool = True,
) -> Iterator[Observations]:
    """Yield the observations of a Parquet file in parts of some number of rows, or all together."""
    import pyarrow
    from pyarrow import parquet

    require_file(path)
    reader, row, begin = ColumnReader(path, catalogue), 1, 1
    try:
        with parquet.ParquetFile(path) as file:
            header = list(file.schema_arrow.names)
            require_columns(path, header, split_epoch=True)
            for batch in file.iter_batches(_ROWS_READ):
                # Detects invalid UTF-8 and dictionary indices.
                batch.validate(full=True)
                if len(batch):
                    lines = np.arange(row, row + len(batch), dtype=np.int32)
                    reader.read(dict(zip(header, batch.columns, strict=True)), lines)
                row += len(batch)
                if rows_at_once is not None and row - begin >= rows_at_once:
                    begin = row
                    yield observations_from_columns(reader.columns(), lunar)
    except (pyarrow.ArrowException, OSError, UnicodeDecodeError) as error:
        [first, *_] = str(error).splitlines() or ["damaged"]
        reason = "".join(character for character in first if character.isprintable()).strip()
        raise FileFormatError(
            path, f"cannot be read as Parquet ({reason}); fetch or write it again"
        ) from error
    pyarrow.default_memory_pool().release_unused()  # a third of the table itself
    if row > begin or row == 1:
        yield observations_from_columns(reader.columns(), lunar)


def write_parquet(path: str | Path, observations: Observations) -> None:
    """Write observations as a Parquet file that :func:`read_parquet` reads back, epochs to 1e-12 s or better."""
    from pyarrow import parquet

    batches = _record_batches(observations, split_epoch=True)
    first = next(batches)
    with replaced_file(path) as temporary, parquet.ParquetWriter(temporary, first.schema) as writer:
        for batch in chain([first], batches):
            writer.write_batch(batch)


def _record_batches(
    observations: Observations, *, light_time: bool = False, split_epoch: bool = False
) -> Iterator[Any]:
    """Yield observations as Arrow columns with units, without empty radio columns."""
    unit = C_M_S if light_time else 1.0
    columns: dict[str, Any] = {"epoch_utc": observations.epoch}
    if split_epoch:
        days, picoseconds = utc_to_picoseconds(observations.epoch)
        columns = {"utc_date": days.astype("datetime64[D]"), "utc_ps": picoseconds}
    columns |= {
        "type": Labels(observations.kind.astype(np.int32), tuple(KINDS)),
        "path": Labels(observations.link, tuple(link.path for link in observations.links)),
        VALUE[light_time]: observations.value_m / unit,
        SIGMA[light_time]: observations.sigma_m / unit,
        "time_tag": Labels(observations.tag.astype(np.int32), TIME_TAGS),
    }
    for name in OPTIONAL:
        values = getattr(observations, name)
        if name == "ramped":
            values = np.where(values, 1.0, np.nan)
        if name in WEATHER or not np.isnan(values).all():
            columns[name] = values
    return batches_of(columns, units=_UNITS, rows_at_once=_ROWS_WRITTEN, for_text=not split_epoch)


def read_ramps(path: str | Path, *, catalogue: StationCatalogue | None = None) -> Ramps:
    """Read a table of ramps; stations get their catalogue names."""
    names, spans, numbers = [], [], []
    for line, row in read_rows(path, RAMP_COLUMNS, "a table of ramps"):
        names.append(station_name(catalogue, row["station"]))
        try:
            numbers.append([float(row["frequency_hz"]), float(row["rate_hz_s"])])
            spans.append(utc_from_text([row["start_utc"], row["stop_utc"]]))
        except ValueError as error:  # InputError included
            raise FileFormatError(path, str(error), line) from None
    if not names:
        raise FileFormatError(path, "has columns, but no ramps")
    span = Epochs.concatenate(spans)
    frequency_hz, rate_hz_s = np.array(numbers).T
    with in_file(path):
        ramps = Ramps.from_columns(names, span[0::2], span[1::2], frequency_hz, rate_hz_s)
    return ramps


def read_ramps_only(path: str | Path, *, catalogue: StationCatalogue | None = None) -> Observations:
    """Return a table of ramps as observations without rows, to be concatenated with others."""
    empty = np.zeros(0)
    ramps = read_ramps(path, catalogue=catalogue)
    return Observations.from_columns(
        epoch=utc_from_text([]), links=(), value_m=empty, sigma_m=empty, files=(str(path),), ramps=ramps
    )


def write_ramps(path: str | Path, ramps: Ramps) -> None:
    """Write ramps as a table that :func:`read_ramps` reads back."""
    columns = {name: getattr(ramps, name) for name in RAMP_COLUMNS}
    write_csv(path, batches_of(columns | {"station": Labels(ramps.station, ramps.stations)}))


def _from_blocks(
    path: str | Path,
    blocks: Iterable[tuple[int, bytes]],
    catalogue: StationCatalogue | None,
    lunar: bool = True,
) -> Observations:
    reader = ColumnReader(path, catalogue, as_text=True)
    header: list[str] = []
    for first_line, block in blocks:
        text, line = _content(block, first_line)
        if not header and len(line):
            head, _, text = text.partition(b"\n")
            header = [name.strip(' "') for name in head.decode().split(",")]
            if not {name.lower() for name in header}.intersection(COLUMNS):
                problem = (
                    f"{head.decode()[:_MAX_SHOWN_CHARACTERS]!r} does not name columns; name them on the first line "
                    "that is not a comment (# ...), separated by commas (epoch_utc,type,path,...)"
                )
                raise FileFormatError(path, problem, int(line[0]))
            require_columns(path, header, int(line[0]))
            line = line[1:]
        if len(line):
            reader.read(_columns(path, header, text, line), line)
        # A cut text is refused by its reader; a cut number is another number.
        if not block.endswith(b"\n") and len(line) and header[-1] not in ("type", "path", "time_tag"):
            last = first_line + block.count(b"\n")
            if line[-1] == last:
                raise FileFormatError(path, CUT_LINE.format(header[-1]), last)
    if not header:
        raise FileFormatError(path, "has no header line; name the columns (epoch_utc,type,path,...)", 1)
    observations = observations_from_columns(reader.columns(), lunar)
    import pyarrow

    pyarrow.default_memory_pool().release_unused()  # as much as the table itself
    return observations


def _content(block: bytes, first_line: int) -> tuple[bytes, NDArray[np.int32]]:
    """Return the lines that are neither blank nor comments, each with a line feed, and their numbers."""
    if block and not block.endswith(b"\n"):
        block += b"\n"
    characters = np.frombuffer(block, dtype=np.uint8)
    ends = np.flatnonzero(characters == _NEW_LINE)
    numbers = np.arange(first_line, first_line + len(ends), dtype=np.int32)
    begins = characters[np.concatenate([[0], ends[:-1] + 1])] if len(ends) else characters
    if ((begins > _HASH) & (begins < _DELETE)).all():
        return block, numbers
    lines = block.split(b"\n")[:-1]
    has_content = np.array([line.decode().strip()[:1] not in ("", "#") for line in lines])
    content = b"".join(line + b"\n" for line, keep in zip(lines, has_content, strict=True) if keep)
    return content, numbers[has_content]


def _columns(path: str | Path, header: list[str], text: bytes, line: NDArray[np.int32]) -> dict[str, Any]:
    """Return the fields of some lines as Arrow columns of text."""
    import pyarrow
    import pyarrow.csv

    quoted = b'"' in text
    for number, row in zip(line, text.split(b"\n"), strict=False) if quoted else ():
        if row.count(b'"') % 2:
            problem = "a quoted field does not end on its line; correct the quotes"
            raise FileFormatError(path, problem, int(number))

    wrong: list[Any] = []

    def skip_row(row: Any) -> str:
        wrong.append(row)
        return "skip"

    table = pyarrow.csv.read_csv(
        pyarrow.BufferReader(text),
        pyarrow.csv.ReadOptions(column_names=header, block_size=len(text) + 1, use_threads=False),
        pyarrow.csv.ParseOptions(quote_char='"' if quoted else False, invalid_row_handler=skip_row),
        pyarrow.csv.ConvertOptions(column_types=dict.fromkeys(header, pyarrow.string())),
    )
    for row in wrong[:1]:
        problem = f"has {row.actual_columns} fields, but the header has {len(header)}: cut or damaged"
        raise FileFormatError(path, problem, int(line[row.number - 1]))
    return {name: table[name].combine_chunks() for name in header}


def write_csv(path: str | Path, batches: Iterable[Any], *, comments: Iterable[str] = ()) -> None:
    """Write batches, at least one, as a table with comments at the top; null is empty, floats are reproduced."""
    notes = [f"# {comment}".rstrip() for text in comments for comment in text.split("\n")]
    with replaced_file(path) as temporary, temporary.open("wb") as stream:
        batches = iter(batches)
        try:
            first = next(batches)
            stream.write(
                "\n".join([*notes, ",".join(map(spreadsheet_cell, first.schema.names)), ""]).encode()
            )
            for batch in chain([first], batches):
                stream.write(_csv_lines(batch, path))
        except UnicodeEncodeError as error:
            wrong = error.object[error.start : error.end]
            raise InputError(f"{wrong!r} is not text; leave it out") from error


def _csv_lines(batch: Any, path: str | Path) -> Any:
    """Return the lines of a batch; a text with a comma or a quote is quoted."""
    import pyarrow
    import pyarrow.csv

    sink = pyarrow.BufferOutputStream()
    try:
        pyarrow.csv.write_csv(
            batch, sink, pyarrow.csv.WriteOptions(include_header=False, quoting_style="none")
        )
    except pyarrow.ArrowInvalid:
        text = io.StringIO()
        cells = [column.cast(pyarrow.string()).to_pylist() for column in batch.columns]
        csv.writer(text, lineterminator="\n").writerows(zip(*cells, strict=True))
        if text.getvalue().count("\n") != batch.num_rows:
            raise InputError(f"{path}: a text of the table has a line break; leave it out") from None
        return text.getvalue().encode()
    return sink.getvalue()


def batches_of(
    columns: Mapping[str, Any],
    decimals: Mapping[str, int] = MappingProxyType({}),
    units: Mapping[str, str] = MappingProxyType({}),
    rows_at_once: int = _ROWS_OF_TEXT,
    *,
    for_text: bool = True,
) -> Iterator[Any]:
    """Yield columns as Arrow batches, numbers with decimals as text, names `for_text` safe from spreadsheets."""
    import pyarrow

    count = len(next(iter(columns.values())))
    for start in range(0, max(count, 1), rows_at_once):
        rows = slice(start, min(start + rows_at_once, count))
        arrays = {
            name: _cells(column, rows, decimals.get(name), for_text) for name, column in columns.items()
        }
        fields = [
            pyarrow.field(name, array.type, metadata={"unit": units[name]} if name in units else None)
            for name, array in arrays.items()
        ]
        schema = pyarrow.schema(fields, metadata={"radioloc": __version__})
        yield pyarrow.RecordBatch.from_arrays(list(arrays.values()), schema=schema)


def _cells(column: Any, rows: slice, decimals: int | None, for_text: bool) -> Any:
    import pyarrow

    as_cell: Callable[[str], str] = spreadsheet_cell if for_text else str
    part: Any = column.codes[rows] if isinstance(column, Labels) else column[rows]
    match column:
        case Epochs():
            # Observations of one instant stand one after another in dense data.
            new = changed(part.jd, part.fraction)
            return _label_texts(np.cumsum(new) - 1, utc_to_text(part[new]).tolist())
        case Labels():
            return _label_texts(part, list(map(as_cell, column.texts)))
    if decimals is not None:
        part = np.asarray(part, dtype=np.float64)
        sizes = np.abs(part)
        # Arrow writes decimals six times as fast as Python, but those below a millionth as 1E-7.
        if ((sizes < _MAX_DECIMAL) & ((decimals <= 6) | (sizes > 1e-6))).all():
            return pyarrow.array(part).cast(pyarrow.decimal128(38, decimals))
        # One operation for many numbers is twice as fast as one for each.
        values = part.tolist()
        text = (f"%.{decimals}f\n" * len(values)) % tuple(values)
        return pyarrow.array(text.split("\n")[:-1], pyarrow.string(), mask=np.isnan(part))
    if isinstance(part, np.ndarray) and part.dtype.kind != "U":
        return pyarrow.array(part, from_pandas=True)
    values = part.tolist() if isinstance(part, np.ndarray) else part
    cells = [as_cell(item) if isinstance(item, str) else item for item in values]
    return pyarrow.array(cells, None if any(cell is not None for cell in cells) else pyarrow.string())


def _label_texts(codes: NDArray[Any], labels: Sequence[str]) -> Any:
    """Text column with few distinct values, stored as an index into them."""
    import pyarrow

    texts = pyarrow.array(list(labels) or [""], pyarrow.string())
    return pyarrow.DictionaryArray.from_arrays(pyarrow.array(codes), texts)
