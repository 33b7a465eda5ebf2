"""Named columns of observations, of a file or of a table in memory, converted to a table of observations.

``docs/reference/observation-table.md`` defines the columns. An epoch is ``epoch_utc``, text or a timestamp, or (except
in CSV files) ``utc_date`` and ``utc_ps``, the picoseconds since midnight, 86400e12 to 86401e12 in a leap second.
Columns are Arrow arrays; Arrow is imported on first use, as that takes a tenth of a second.

A float32 has 24 bits: a range to the Moon of 8e8 m is rounded to 64 m, a modified Julian date to 5.6 minutes.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import C_M_S, SECONDS_PER_DAY
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import FileFormatError, InputError
from radioloc.measurements.link import Link
from radioloc.measurements.registry import KINDS, TIME_TAGS
from radioloc.text_files import read_text, text_of_cell
from radioloc.time import Epochs, to_scale
from radioloc.time.dates import utc_from_picoseconds, utc_from_text, utc_to_picoseconds
from radioloc.units import ASTROPY_UNITS, argument_unit, as_float_array, in_unit
from radioloc.vectors import Floats, Indices

RELATIVE_STEP = 2.0**-23  # largest relative spacing of single-precision numbers

_SINGLE_TYPES = ("float16", "float32", "halffloat", "float")  # of NumPy and pandas, and of Arrow
_MIN_DIFFERENT_COUNT = 3  # round epochs written by hand are representable, too
_SAMPLE_SIZE = 1000  # epochs that exclude most tables at once
_DATE_FRACTION_BITS = (8, 31)  # of a modified Julian date in a float32, and of a Julian date in a double
_MAX_UNUSED_BITS = 4  # last bits that are zero in rounded dates; even divisions of days leave more
_WHOLE_SECOND_BITS = 7  # 86400 s are 675 times 2^7 s: further bits of a day are fractions of seconds
MIN_RANGE_RATE_M_S = 400.0  # by the Earth's rotation; converts errors of epochs to errors of ranges


def is_single_precision(column: Any) -> bool:
    """Return whether a column of NumPy, pandas, Arrow or astropy has single or half precision."""
    if isinstance(column, list | tuple):
        column = np.asarray(column[:1])
    kind = getattr(column, "type", None) or getattr(column, "dtype", None)
    return str(kind).lower() in _SINGLE_TYPES


def single_precision_step_m(value_m: Floats, unit_m: Floats | float) -> Floats:
    """Return the spacing of single-precision numbers near values in a unit, m."""
    with np.errstate(over="ignore"):
        return np.spacing(np.abs(value_m / unit_m).astype(np.float32)).astype(np.float64) * unit_m


def epoch_step_s(fraction: Floats) -> float:
    """Return the spacing of Julian dates of a single number, s, if all fractions of a day are its multiples, or 0."""
    for bits in _DATE_FRACTION_BITS:
        samples = (np.ldexp(rows, bits) for rows in (fraction[:_SAMPLE_SIZE], fraction))
        if all((sample == np.rint(sample)).all() for sample in samples):
            unused_bits = max(_WHOLE_SECOND_BITS, bits - _MAX_UNUSED_BITS)
            different = np.unique(np.ldexp(fraction, unused_bits))
            if np.count_nonzero(different != np.rint(different)) >= _MIN_DIFFERENT_COUNT:
                return float(SECONDS_PER_DAY * 2.0**-bits)
    return 0.0


SPLIT_EPOCH = ("utc_date", "utc_ps")
VALUE = ("observed_m", "light_time_s")
SIGMA = ("sigma_m", "sigma_s")
WEATHER = ("pressure_hpa", "temperature_k", "relative_humidity", "wavelength_um")
OPTIONAL = (*WEATHER, "uplink_hz", "count_s", "modulus_m", "ramped")
COLUMNS = ("epoch_utc", "type", "path", *VALUE, *SIGMA, "time_tag", *OPTIONAL)  # of a CSV file

FLIGHT_TIME_LIMITS_S = (2.2, 2.8)  # round trips between the surfaces of Earth and Moon: 2.31 to 2.74 s

UNITS = {
    "value_m": "m",
    "sigma_m": "m",
    "pressure_hpa": "hPa",
    "temperature_k": "K",
    "relative_humidity": "1",
    "wavelength_um": "um",
    "uplink_hz": "Hz",
    "count_s": "s",
    "modulus_m": "m",
}
"""Units of the columns of numbers in the notation of astropy."""

_ALL_COLUMNS = (*COLUMNS, *SPLIT_EPOCH)
FILE_COLUMNS = {"value_m": "observed_m"}  # names of tables in memory by those of files
_ORIGIN = ("file", "line")
_ROUND_TRIP_FACTORS = {
    2.0: "half of the round trip",
    0.5: "twice the round trip",
    1e3: "in kilometres",
    2e3: "in kilometres, one way",
    1e-3: "in milliseconds or millimetres",
}
_TABLE = "table"
_TEXTS: dict[str, tuple[str, type[np.integer]]] = {
    "type": ("kind", np.int8),
    "path": ("link", np.int32),
    "time_tag": ("tag", np.int8),
}
_TICKS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
# Names of types of Arrow.
_TEXT, _INTEGER, _NUMBER = (
    re.compile(form)
    for form in ("(large_)?string|string_view", r"u?int\d+", r"u?int\d+|halffloat|float|double")
)


def require_columns(
    path: str | Path, header: list[str], line: int | None = None, *, split_epoch: bool = False
) -> None:
    """Raise a FileFormatError for missing, unknown, duplicate or redundant columns."""
    choices = _ALL_COLUMNS if split_epoch else COLUMNS
    for name in header:
        if name not in choices:
            matches = difflib.get_close_matches(name.lower(), {*choices} - {*header}, n=1)
            hint = f"did you mean {matches[0]}? Columns are" if matches else "use"
            advice = "" if path == _TABLE else f"; {own_columns_hint(path, header)}"
            raise FileFormatError(path, f"unknown column {name!r}; {hint} {', '.join(choices)}{advice}", line)
        if header.count(name) > 1:
            raise FileFormatError(path, f"duplicate column {name!r}; remove one", line)
    split = [name for name in SPLIT_EPOCH if name in header]
    if len(split) == 1 and "epoch_utc" not in header:
        [missing] = {*SPLIT_EPOCH} - {*split}
        raise FileFormatError(path, f"column {missing!r} is missing; an epoch is utc_date and utc_ps", line)
    for choice in (("epoch_utc", *split[:1]), ("type",), ("path",), ("time_tag",), VALUE, SIGMA):
        present = [name for name in choice if name in header]
        if not present:
            raise FileFormatError(path, f"column {' or '.join(choice)} is missing; add it", line)
        if len(present) > 1:
            raise FileFormatError(path, f"columns {' and '.join(present)} are redundant; remove one", line)


def own_columns_hint(path: str | Path, header: Sequence[str]) -> str:
    """Return how a file with other names of columns is read."""
    return (
        "columns with other names are read in Python: "
        f"radioloc.Observations.from_table({Path(path).name!r}, columns={{'epoch_utc': {header[0]!r}, "
        "'observed_m': ..., 'sigma_m': ...}, type='range', path='KASHI>lander>KASHI', time_tag='receive')"
    )


def require_lunar_flight_times(
    path: str | Path, flight_s: Floats, line: NDArray[np.integer] | Floats
) -> None:
    """Raise a FileFormatError for the first round-trip time of flight outside of those of lunar targets."""
    low, high = FLIGHT_TIME_LIMITS_S
    wrong = ~((flight_s > low) & (flight_s < high))
    if not wrong.any():
        return
    row = int(np.argmax(wrong))
    time_s = float(flight_s[row])
    advice = "remove or correct it"
    for factor, mistake in _ROUND_TRIP_FACTORS.items():
        if low < factor * time_s < high:
            advice = f"it is {mistake}: give the round trip in metres, or its light time in seconds"
    problem = f"time of flight: expected {low} to {high} s between Earth and Moon, got {time_s!r} s; {advice}"
    raise FileFormatError(path, problem, int(line[row]))


class ColumnReader:
    """Reader of the rows of a file in batches of Arrow columns; numbers may be text, as in CSV."""

    def __init__(
        self,
        path: str | Path,
        catalogue: StationCatalogue | None,
        *,
        as_text: bool = False,
        single_precision: Iterable[str] = (),
    ) -> None:
        self._path, self._catalogue, self._as_text = path, catalogue, as_text
        self._single_precision = set(single_precision)
        self._links: dict[Link, int] = {}
        self._columns: dict[str, list[NDArray[Any]]] = {}
        self._line: NDArray[np.int32] = np.empty(0, dtype=np.int32)

    def read(self, columns: Mapping[str, Any], line: NDArray[np.int32]) -> None:
        """Read a batch of columns that :func:`require_columns` accepts, with the lines of its rows."""
        self._line = line
        # Types and paths first, so that their errors are reported before those of values.
        batch = {key: self._codes(name, columns[name]) for name, (key, _) in _TEXTS.items()}
        epoch = self._epoch(columns)
        batch |= {"jd": epoch.jd, "fraction": epoch.fraction, "line": line}
        for name in columns:
            if name not in (*_TEXTS, *SPLIT_EPOCH, "epoch_utc"):
                batch[name] = self._numbers(name, columns[name])
        for name, part in batch.items():
            self._columns.setdefault(name, []).append(part)

    def columns(self) -> dict[str, Any]:
        """Return the arguments of :meth:`Observations.from_columns` from all batches, and clear the reader."""
        if not self._columns:
            raise FileFormatError(self._path, "expected observations, got none")
        columns: dict[str, Any] = {"files": (str(self._path),), "links": tuple(self._links)}
        for name in list(self._columns):  # releases joined parts
            columns[name] = np.concatenate(self._columns.pop(name))
            columns[name].flags.writeable = False  # read-only arrays are not copied again
        columns["epoch"] = Epochs(columns.pop("jd"), columns.pop("fraction"), "UTC")
        if "ramped" in columns:
            columns["ramped"] = columns["ramped"] == 1.0
        for (metres, seconds), key in ((VALUE, "value_m"), (SIGMA, "sigma_m")):
            columns[key] = columns.pop(metres) if metres in columns else C_M_S * columns.pop(seconds)
        columns["single_precision"] = sorted(self._single_precision)
        return columns

    def _fail(self, name: str, row: int, problem: str) -> NoReturn:
        raise FileFormatError(self._path, f"{name}: {problem}", int(self._line[row]))

    def _require(self, form: re.Pattern[str] | str, name: str, column: Any, expected: str) -> None:
        """Raise an error for a column with another Arrow type, or with missing values if it is required."""
        if not re.fullmatch(form, str(column.type)):
            raise FileFormatError(self._path, f"column {name}: expected {expected}, got type {column.type}")
        if name not in OPTIONAL and column.null_count:
            self._fail(
                name, int(np.argmax(column.is_null().to_numpy(zero_copy_only=False))), "missing value (null)"
            )

    def _numbers(self, name: str, column: Any) -> Floats:
        if self._as_text:
            numbers = self._numbers_of_text(name, column)
        else:
            self._require(_NUMBER, name, column, "numbers")
            if is_single_precision(column):
                self._single_precision.add(name)
            numbers = _values_of(column.cast("float64", safe=False))
        if name == "ramped":
            wrong = ~(np.isnan(numbers) | (numbers == 0.0) | (numbers == 1.0))
            if wrong.any():
                problem = f"expected 1 (yes) or 0 (no), got {numbers[wrong][0]:g}"
                self._fail(name, int(np.argmax(wrong)), problem)
        return numbers

    def _numbers_of_text(self, name: str, column: Any) -> Floats:
        import pyarrow
        from pyarrow import compute

        column = compute.utf8_trim_whitespace(column)
        if name in OPTIONAL:
            has_text = compute.utf8_length(column).cast("bool")
            column = compute.if_else(has_text, column, pyarrow.nulls(1, column.type)[0])
        try:
            numbers: Floats = _values_of(column.cast("float64"))
        except pyarrow.ArrowInvalid:
            numbers = np.full(len(column), np.nan)
            for row, text in enumerate(column.to_pylist()):
                try:
                    # Underscores and digits of other scripts, which Python would accept, are errors.
                    numbers[row] = np.nan if text is None else float(text.replace("_", "x").encode("ascii"))
                except ValueError:
                    self._fail(name, row, f"expected a number, got {text!r}")
        return numbers

    def _codes(self, name: str, column: Any) -> NDArray[Any]:
        places, texts = self._unique_texts(name, column, "text")
        codes = np.zeros(len(texts), dtype=_TEXTS[name][1])
        # Links are numbered in the order of the rows; a dictionary may have unused texts.
        used, first = np.unique(places, return_index=True)
        for place in used[np.argsort(first)].tolist():
            try:
                text = texts[place].as_py()
                codes[place] = self._code(name, text_of_cell(text) if self._as_text else text)
            except InputError as error:
                self._fail(name, int(np.argmax(places == place)), str(error).removeprefix("path: "))
        return codes[places]

    def _unique_texts(self, name: str, column: Any, expected: str) -> tuple[Indices, Any]:
        """Return the index of the text of each row, and the different texts."""
        if _TEXT.fullmatch(str(column.type)):
            column = column.dictionary_encode()
        self._require(r"dictionary<values=((large_)?string|string_view), .*", name, column, expected)
        texts = column.dictionary
        if str(texts.type) == "string_view":  # of polars, without Arrow's text functions
            import pyarrow

            texts = pyarrow.array(texts.to_pylist(), pyarrow.string())
        return _values_of(column.indices).astype(np.intp), texts

    def _code(self, name: str, text: str) -> int:
        if name == "path":
            link = Link.from_path(text).with_canonical_names(self._catalogue)
            return self._links.setdefault(link, len(self._links))
        choices = KINDS if name == "type" else TIME_TAGS
        try:
            return choices.index(text.strip())
        except ValueError:
            raise InputError(f"expected {' or '.join(choices)}, got {text!r}") from None

    def _epoch(self, columns: Mapping[str, Any]) -> Epochs:
        if "epoch_utc" not in columns:
            name, (days, picoseconds) = "utc_ps", self._split_epoch(columns["utc_date"], columns["utc_ps"])
        elif str(columns["epoch_utc"].type).startswith("timestamp"):
            name, (days, picoseconds) = "epoch_utc", self._timestamp(columns["epoch_utc"])
        else:
            from pyarrow import compute

            # Different epochs are few in dense data; each is parsed once.
            expected = "text, a timestamp, or utc_date and utc_ps instead"
            places, texts = self._unique_texts("epoch_utc", columns["epoch_utc"], expected)
            listed = compute.utf8_trim_whitespace(texts).to_pylist()
            return self._epochs_of(
                "epoch_utc", places, lambda k: utc_from_text([listed[i] for i in k.tolist()])
            )
        rows = np.arange(len(days))
        return self._epochs_of(name, rows, lambda k: utc_from_picoseconds(days[k], picoseconds[k]))

    def _timestamp(self, column: Any) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return days since 1970 and picoseconds of the day."""
        self._require(r"timestamp\[\w+(, tz=(UTC|\+00:00))?\]", "epoch_utc", column, "UTC")
        per_second = _TICKS[column.type.unit]
        days, ticks = np.divmod(_values_of(column.cast("int64")), 86400 * per_second)
        return days, ticks * (10**12 // per_second)

    def _split_epoch(self, date: Any, picoseconds: Any) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the same as :meth:`_timestamp`."""
        self._require(r"date32\[day\]", "utc_date", date, "a date (date32)")
        self._require(_INTEGER, "utc_ps", picoseconds, "whole numbers (int64)")
        return _values_of(date.cast("int32")).astype(np.int64), _values_of(picoseconds.cast("int64"))

    def _epochs_of(self, name: str, places: Indices, convert: Callable[[Indices], Epochs]) -> Epochs:
        """Return epochs of rows, with each place converted once; errors name the first invalid row."""
        different, index = np.unique(places, return_inverse=True)
        try:
            return convert(different)[index]
        except InputError:
            for row in range(len(places)):
                try:
                    convert(places[row : row + 1])
                except InputError as error:
                    self._fail(name, row, str(error))
            raise


def columns_of_table(
    table: Any,
    columns: Mapping[str, str] | None,
    units: Mapping[str, str] | None,
    constants: Mapping[str, Any],
    *,
    catalogue: StationCatalogue,
) -> dict[str, Any]:
    """Return the arguments of :meth:`Observations.from_columns` from those of :meth:`Observations.from_table`."""
    origin, line = _TABLE, None
    if isinstance(table, str | Path):
        origin, (table, line) = str(table), _read_csv(table)
    table_columns = _columns_in_memory(table)
    names = _chosen(table_columns, columns)
    units = dict(units or {})
    if unknown := [name for name in units if name not in table_columns]:
        raise InputError(f"units: expected columns {', '.join(table_columns)}, got {unknown[0]!r}")
    n = len(next(iter(table_columns.values()), ((),))[0])
    arrays: dict[str, Any] = {}
    for column, name in names.items():
        arrays |= _arrow(FILE_COLUMNS.get(column, column), *table_columns[name], units.get(name))
    for column, value in constants.items():
        if column in names:
            raise InputError(f"{column}: expected a column of the table or a constant, got both")
        repeated = value * np.ones(n) if hasattr(value, "unit") else np.full(n, value)
        if isinstance(value, str) and "{" in value:
            repeated = _filled(column, value, table_columns)
        arrays |= _arrow(FILE_COLUMNS.get(column, column), repeated, _unit(value), None)
    require_columns(_TABLE, list(arrays), split_epoch=True)
    single = [
        FILE_COLUMNS.get(k, k) for k, name in names.items() if is_single_precision(table_columns[name][0])
    ]
    reader = ColumnReader(origin, catalogue, single_precision=single)
    if n:
        reader.read(arrays, np.arange(1, n + 1, dtype=np.int32) if line is None else line)
    return reader.columns()


def _filled(column: str, form: str, table_columns: Mapping[str, Any]) -> NDArray[np.str_]:
    """Return a text for each row, such as ``{station}>lander>{station}``, with the columns that it names."""
    names = re.findall(r"\{(.*?)\}", form)
    if unknown := [name for name in names if name not in table_columns]:
        raise InputError(f"{column}: expected columns {', '.join(table_columns)}, got {unknown[0]!r}")
    rows = zip(*(map(str, np.asarray(table_columns[name][0]).tolist()) for name in names), strict=True)
    return np.array([form.format(**dict(zip(names, row, strict=True))) for row in rows])


def _read_csv(path: str | Path) -> tuple[Any, NDArray[np.int32]]:
    """Return a file with a line of names and columns between commas, semicolons or tabs, and the lines of its rows."""
    from pyarrow import ArrowInvalid, BufferReader, csv

    lines = {
        k: line for k, line in enumerate(read_text(path).split("\n"), 1) if line.strip() and line[0] != "#"
    }
    if not lines:
        raise FileFormatError(path, "has no line that names columns")
    heading, *rows = lines
    options = csv.ParseOptions(delimiter=max(",;\t", key=lines[heading].count))
    try:
        table = csv.read_csv(BufferReader("\n".join(lines.values()).encode()), parse_options=options)
    except ArrowInvalid as error:
        raise FileFormatError(path, f"cannot be read as a table ({error})") from None
    return table, np.array(rows, dtype=np.int32)


def _columns_in_memory(table: Any) -> dict[str, tuple[Any, str]]:
    """Return columns by name, with the units of the table."""
    if hasattr(table, "__arrow_c_stream__"):
        import pyarrow

        try:
            arrow = pyarrow.table(table)
        except (ValueError, TypeError, pyarrow.ArrowException) as error:  # duplicate names, mixed types
            raise InputError(f"table: cannot be converted to Arrow ({error})") from None
        for name in arrow.column_names:
            if arrow.column_names.count(name) > 1:
                raise InputError(f"table: duplicate column {name!r}; rename or remove one")
        return {
            field.name: (arrow[field.name], (field.metadata or {}).get(b"unit", b"").decode())
            for field in arrow.schema
            if not field.name.startswith("__index_level_")  # index of pandas
        }
    if not (hasattr(table, "keys") and hasattr(table, "__getitem__")):
        raise InputError(
            f"table: expected a file, pandas, Arrow, polars, astropy or a dictionary, got {type(table).__name__}"
        )
    columns = {name: table[name] for name in table.keys()}  # noqa: SIM118  # a Table is iterated by rows
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        raise InputError(f"table: expected columns of equal length, got {lengths}")
    return {name: (column, _unit(column)) for name, column in columns.items()}


def _unit(column: Any) -> str:
    return str(getattr(column, "unit", None) or "")


def _chosen(table_columns: Mapping[str, Any], columns: Mapping[str, str] | None) -> dict[str, str]:
    """Return the names of columns in the table by the names here."""
    choices = (*_ALL_COLUMNS, *FILE_COLUMNS)
    names = dict(columns or {})
    for column, name in names.items():
        if column not in choices:
            raise InputError(f"columns: expected {', '.join(_ALL_COLUMNS)}, got {column!r}")
        if name not in table_columns:
            raise InputError(f"columns: {column}: expected {' or '.join(table_columns)}, got {name!r}")
    unnamed = [name for name in table_columns if name not in names.values()]
    names |= {name: name for name in unnamed if name in choices and name not in names}
    unused = [name for name in unnamed if name not in names.values() and name not in _ORIGIN]
    if unused and columns is None:
        raise InputError(
            f"unknown column {unused[0]!r}; name it in `columns` ({', '.join(_ALL_COLUMNS)}), or pass an empty "
            "dictionary to ignore unknown columns"
        )
    return names


def _values_of(column: Any) -> NDArray[Any]:
    """Values of an Arrow column, floats with NaN for nulls, without the 0.3 s in which Arrow imports pandas."""
    if not column.null_count:
        return np.array(np.from_dlpack(column))
    (validity, data), rows = column.buffers(), slice(column.offset, column.offset + len(column))
    is_valid = np.unpackbits(np.frombuffer(validity, np.uint8), bitorder="little")[rows]
    return np.where(is_valid, np.frombuffer(data)[rows], np.nan)


def _arrow(name: str, column: Any, column_unit: str, unit: str | None) -> dict[str, Any]:
    """Return a column in the form of files; an epoch of other types than text and timestamp as two columns."""
    import pyarrow

    if name == "epoch_utc" and (hasattr(column, "jd1") or isinstance(column, Epochs)):
        days, picoseconds = utc_to_picoseconds(to_scale(column, "UTC"))
        return {"utc_date": pyarrow.array(days.astype("datetime64[D]")), "utc_ps": pyarrow.array(picoseconds)}
    expected = "1" if name in ("relative_humidity", "ramped") else argument_unit(name)
    if expected is not None and name not in SPLIT_EPOCH:
        return {name: pyarrow.array(_in_unit(name, column, column_unit, unit, expected), from_pandas=True)}
    if unit is not None:
        raise InputError(f"units: {name} is without unit; remove it")
    if isinstance(column, pyarrow.ChunkedArray):
        values = column.combine_chunks()
        zoned = pyarrow.types.is_timestamp(values.type) and values.type.tz
        return {name: values.cast(pyarrow.timestamp(values.type.unit, "UTC")) if zoned else values}
    values = np.ma.getdata(column)
    mask = np.ma.getmaskarray(column) if np.ma.isMaskedArray(column) else None
    texts = values.astype("U") if values.dtype.kind == "S" else values  # of FITS
    try:
        array = pyarrow.array(texts, mask=mask, from_pandas=True)
    except (ValueError, TypeError, pyarrow.ArrowException) as error:
        raise InputError(f"column {name}: expected text or timestamps ({error})") from None
    is_chunked = isinstance(array, pyarrow.ChunkedArray)  # large columns of text
    return {name: array.combine_chunks() if is_chunked else array}


def _in_unit(name: str, column: Any, column_unit: str, unit: str | None, expected: str) -> Floats:
    """Return numbers in the expected unit from that of the table or the caller; NaN for masked or null entries."""
    bare = column.to_numpy() if hasattr(column, "chunks") else getattr(column, "unmasked", column)
    numbers = as_float_array(np.ma.getdata(getattr(bare, "value", bare)), expected, name)
    if (mask := getattr(column, "mask", None)) is not None and not callable(mask):
        numbers = np.where(mask, np.nan, numbers)
    text = unit or column_unit
    if not text:
        return numbers
    from astropy.units import Quantity, Unit

    try:
        of_column, of_caller = (Unit(ASTROPY_UNITS.get(item, item)) for item in (column_unit or text, text))
    except ValueError:
        raise InputError(f"units: {name}: expected a unit of astropy, got {text!r}") from None
    if of_column != of_caller:
        raise InputError(f"units: {name}: expected {column_unit}, the unit of the table, got {unit}")
    converted: Floats = in_unit(Quantity(numbers, of_caller), expected, name)
    return converted


def as_column(name: str, values: ArrayLike, n: int, dtype: Any = np.float64) -> Any:
    """Return a column as a read-only contiguous array of n values: a copy, unless it is read-only already."""
    mask = getattr(values, "mask", None)  # NumPy drops it with the unit
    if name in UNITS:
        values = in_unit(values, UNITS[name], name)
    values = getattr(values, "unmasked", values)
    array = as_float_array(values, UNITS[name], name) if name in UNITS else np.asarray(values, dtype=dtype)
    if isinstance(mask, np.ndarray | np.bool_) and np.any(mask):
        if dtype is not np.float64:
            raise InputError(f"{name}: masked entries; remove their rows")
        array = np.where(mask, np.nan, array)
    if array is values and array.shape == (n,) and array.flags.owndata and not array.flags.writeable:
        return array
    if array.shape not in ((), (n,)):
        raise InputError(f"{name}: expected one value or {n}, the number of epochs, got shape {array.shape}")
    out = np.empty(n, dtype=dtype)
    out[...] = array
    out.flags.writeable = False
    return out


def codes_of_names(key: str, values: ArrayLike, names: Sequence[str]) -> ArrayLike:
    """Return indices into a list of names; numbers are indices already."""
    texts = np.asarray(values)
    if texts.dtype.kind not in "UO":
        return values
    different, place = np.unique(texts.astype(np.str_), return_inverse=True)
    for text in different:
        if text not in names:
            raise InputError(f"{key}: expected {' or '.join(names)}, got {str(text)!r}")
    return np.array([names.index(text) for text in different], dtype=np.int64)[place].reshape(texts.shape)


def as_codes(name: str, values: ArrayLike, n: int, count: int, dtype: Any) -> Any:
    """Return codes, indices below a count, as a column."""
    codes = as_column(name, values, n, np.int64)
    if n and not (codes.min() >= 0 and codes.max() < count):
        raise InputError(f"{name}: expected indices of 0 to {count - 1}, got {codes.min()} to {codes.max()}")
    return as_column(name, codes, n, dtype)


def recoded(codes: NDArray[np.int32], column: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return a column of codes mapped to new codes, read-only."""
    out = codes[column] if len(column) else column.copy()
    out.flags.writeable = False
    return out


def unique_items(items: Sequence[Any]) -> tuple[tuple[Any, ...], NDArray[np.int32]]:
    """Return the different items in order of first appearance, and the index of each item among them."""
    place: dict[Any, int] = {}
    codes = np.array([place.setdefault(item, len(place)) for item in items], dtype=np.int32)
    return tuple(place), codes
