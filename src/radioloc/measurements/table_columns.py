"""Named columns of observations, of a file or of a table in memory, as what a table of observations is made of.

What each holds is said in ``docs/reference/observation-table.md``. An epoch is ``epoch_utc``, text or a timestamp, or
(not in CSV files) ``utc_date`` and ``utc_ps``, the picoseconds since midnight, of a leap second 86400e12 to 86401e12.
Columns are read as Arrow has them, which is imported when the first is, since that takes a tenth of a second.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import C_M_S
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import FileFormatError, InputError
from radioloc.measurements.link import Link
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.registry import KINDS
from radioloc.measurements.resolution import is_single_precision
from radioloc.text_files import text_of_cell
from radioloc.time import Epochs, to_scale
from radioloc.time.dates import utc_from_picoseconds, utc_from_text, utc_to_picoseconds
from radioloc.units import ASTROPY_UNITS, as_float_array, in_unit, unit_of
from radioloc.vectors import Floats

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
"""Of the columns of numbers of a table of observations, as astropy spells them."""

_KNOWN = (*COLUMNS, *SPLIT_EPOCH)
_SAME = {"value_m": "observed_m"}  # names that tables of observations in memory have and files do not
_ORIGIN = ("file", "line")
_TABLE = "table"
_TEXTS: dict[str, tuple[str, type[np.integer]]] = {
    "type": ("kind", np.int8),
    "path": ("link", np.int32),
    "time_tag": ("tag", np.int8),
}
_TICKS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
# Types of Arrow, by their names.
_TEXT, _INTEGER, _NUMBER = (
    re.compile(form)
    for form in ("(large_)?string|string_view", r"u?int\d+", r"u?int\d+|halffloat|float|double")
)


def require_columns(
    path: str | Path, header: list[str], line: int | None = None, *, split_epoch: bool = False
) -> None:
    """Raise :class:`FileFormatError` where a column is missing, unknown, there twice or said by another."""
    known = _KNOWN if split_epoch else COLUMNS
    for name in header:
        if name not in known:
            near = difflib.get_close_matches(name.lower(), {*known} - {*header}, n=1)
            meant = f"did you mean {near[0]}? Columns are" if near else "use"
            raise FileFormatError(path, f"column {name!r} is not known; {meant} {', '.join(known)}", line)
        if header.count(name) > 1:
            raise FileFormatError(path, f"column {name!r} is there twice; leave one out", line)
    split = [name for name in SPLIT_EPOCH if name in header]
    if len(split) == 1 and "epoch_utc" not in header:
        [missing] = {*SPLIT_EPOCH} - {*split}
        raise FileFormatError(path, f"column {missing!r} is missing; an epoch is utc_date and utc_ps", line)
    for choice in (("epoch_utc", *split[:1]), ("type",), ("path",), ("time_tag",), VALUE, SIGMA):
        given = [name for name in choice if name in header]
        if not given:
            raise FileFormatError(path, f"column {' or '.join(choice)} is missing; add it", line)
        if len(given) > 1:
            raise FileFormatError(path, f"columns {' and '.join(given)} say the same; leave one out", line)


def require_lunar_flight_times(
    path: str | Path, flight_s: Floats, line: NDArray[np.integer] | Floats
) -> None:
    """Raise :class:`FileFormatError` for the first round-trip time of flight that no lunar target has."""
    low, high = FLIGHT_TIME_LIMITS_S
    wrong = ~((flight_s > low) & (flight_s < high))
    if not wrong.any():
        return
    row = int(np.argmax(wrong))
    time_s = float(flight_s[row])
    problem = f"the time of flight is {time_s!r} s, but between Earth and Moon it is {low} to {high} s"
    advice = "leave the point out or correct it"
    for factor, said in (
        (2.0, "half of such a one: give the round trip"),
        (0.5, "twice such a one: halve it"),
    ):
        if low < factor * time_s < high:
            advice = f"it is {said}, if that is what it holds"
    raise FileFormatError(path, f"{problem}; {advice}", int(line[row]))


class ColumnReader:
    """Takes the rows of one file, batch by batch, as columns of Arrow; numbers may be texts, as in CSV."""

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
        """Take some rows of columns that :func:`require_columns` has seen, and the lines where they stand."""
        self._line = line
        # First what each row is, then what it measures: of several mistakes that is the one to be told.
        taken = {key: self._codes(name, columns[name]) for name, (key, _) in _TEXTS.items()}
        epoch = self._epoch(columns)
        taken |= {"jd": epoch.jd, "fraction": epoch.fraction, "line": line}
        for name in columns:
            if name not in (*_TEXTS, *SPLIT_EPOCH, "epoch_utc"):
                taken[name] = self._numbers(name, columns[name])
        for name, part in taken.items():
            self._columns.setdefault(name, []).append(part)

    def columns(self) -> dict[str, Any]:
        """What :meth:`Observations.from_columns` takes, of all that was read; the reader then is empty."""
        if not self._columns:
            raise FileFormatError(self._path, "has columns, but no observations")
        columns: dict[str, Any] = {"files": (str(self._path),), "links": tuple(self._links)}
        for name in list(self._columns):  # parts that are joined are let go
            columns[name] = np.concatenate(self._columns.pop(name))
            columns[name].flags.writeable = False  # what nobody can write to is not copied again
        columns["epoch"] = Epochs(columns.pop("jd"), columns.pop("fraction"), "UTC")
        if "ramped" in columns:
            columns["ramped"] = columns["ramped"] == 1.0
        for (metres, seconds), key in ((VALUE, "value_m"), (SIGMA, "sigma_m")):
            columns[key] = columns.pop(metres) if metres in columns else C_M_S * columns.pop(seconds)
        columns["single_precision"] = sorted(self._single_precision)
        return columns

    def _fail(self, name: str, row: int, problem: str) -> NoReturn:
        raise FileFormatError(self._path, f"{name}: {problem}", int(self._line[row]))

    def _require(self, form: re.Pattern[str] | str, name: str, column: Any, wanted: str) -> None:
        """Refuse a column of a type of Arrow that is not of a form, and one that is not given in each row."""
        if not re.fullmatch(form, str(column.type)):
            raise FileFormatError(self._path, f"column {name} is of type {column.type}; give {wanted}")
        if name not in OPTIONAL and column.null_count:
            self._fail(
                name, int(np.argmax(column.is_null().to_numpy(zero_copy_only=False))), "is missing (null)"
            )

    def _numbers(self, name: str, column: Any) -> Floats:
        if self._as_text:
            numbers = self._numbers_of_text(name, column)
        else:
            self._require(_NUMBER, name, column, "numbers")
            if is_single_precision(column):
                self._single_precision.add(name)
            numbers = column.cast("float64", safe=False).to_numpy(zero_copy_only=False)
        if name == "ramped":
            wrong = ~(np.isnan(numbers) | (numbers == 0.0) | (numbers == 1.0))
            if wrong.any():
                problem = f"{numbers[wrong][0]:g} is neither 1 (yes) nor 0 (no)"
                self._fail(name, int(np.argmax(wrong)), problem)
        return numbers

    def _numbers_of_text(self, name: str, column: Any) -> Floats:
        import pyarrow
        from pyarrow import compute

        column = compute.utf8_trim_whitespace(column)
        if name in OPTIONAL:
            column = compute.if_else(compute.equal(column, ""), None, column)
        try:
            numbers: Floats = column.cast("float64").to_numpy(zero_copy_only=False)
        except pyarrow.ArrowInvalid:
            numbers = np.full(len(column), np.nan)
            for row, text in enumerate(column.to_pylist()):
                try:
                    # Digits that only Python reads, with underscores or of other scripts, are refused.
                    numbers[row] = np.nan if text is None else float(text.replace("_", "x").encode("ascii"))
                except ValueError:
                    self._fail(name, row, f"{text!r} is not a number")
        return numbers

    def _codes(self, name: str, column: Any) -> NDArray[Any]:
        places, texts = self._different(name, column, "text")
        codes = np.zeros(len(texts), dtype=_TEXTS[name][1])
        # In the order of the rows, in which links are numbered; a dictionary may hold what no row has.
        used, first = np.unique(places, return_index=True)
        for place in used[np.argsort(first)].tolist():
            try:
                text = texts[place].as_py()
                codes[place] = self._code(name, text_of_cell(text) if self._as_text else text)
            except InputError as error:
                self._fail(name, int(np.argmax(places == place)), str(error))
        return codes[places]

    def _different(self, name: str, column: Any, wanted: str) -> tuple[NDArray[np.intp], Any]:
        """Which of its different texts each row of a column has, and those."""
        if _TEXT.fullmatch(str(column.type)):
            column = column.dictionary_encode()
        self._require(r"dictionary<values=((large_)?string|string_view), .*", name, column, wanted)
        texts = column.dictionary
        if (
            str(texts.type) == "string_view"
        ):  # text of polars, on which Arrow's functions of text are not defined
            import pyarrow

            texts = pyarrow.array(texts.to_pylist(), pyarrow.string())
        return column.indices.to_numpy(zero_copy_only=False).astype(np.intp), texts

    def _code(self, name: str, text: str) -> int:
        if name == "path":
            link = Link.from_path(text).named(self._catalogue)
            return self._links.setdefault(link, len(self._links))
        choices = KINDS if name == "type" else TIME_TAGS
        try:
            return choices.index(text.strip())
        except ValueError:
            raise InputError(f"{text!r} is not known; use {' or '.join(choices)}") from None

    def _epoch(self, columns: Mapping[str, Any]) -> Epochs:
        if "epoch_utc" not in columns:
            name, (days, picoseconds) = "utc_ps", self._split_epoch(columns["utc_date"], columns["utc_ps"])
        elif str(columns["epoch_utc"].type).startswith("timestamp"):
            name, (days, picoseconds) = "epoch_utc", self._timestamp(columns["epoch_utc"])
        else:
            import pyarrow
            from pyarrow import compute

            # Observations of one instant are many in dense data: each is read once.
            wanted = "text, a timestamp, or utc_date and utc_ps in its place"
            places, texts = self._different("epoch_utc", columns["epoch_utc"], wanted)
            texts = compute.utf8_trim_whitespace(texts)
            return self._dated("epoch_utc", places, lambda k: utc_from_text(texts.take(pyarrow.array(k))))
        rows = np.arange(len(days))
        return self._dated(name, rows, lambda k: utc_from_picoseconds(days[k], picoseconds[k]))

    def _timestamp(self, column: Any) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Days since 1970 and picoseconds since their midnights."""
        self._require(r"timestamp\[\w+(, tz=(UTC|\+00:00))?\]", "epoch_utc", column, "UTC")
        per_second = _TICKS[column.type.unit]
        days, rest = np.divmod(column.cast("int64").to_numpy(), 86400 * per_second)
        return days, rest * (10**12 // per_second)

    def _split_epoch(self, date: Any, picoseconds: Any) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """As :meth:`_timestamp`."""
        self._require(r"date32\[day\]", "utc_date", date, "a date (date32)")
        self._require(_INTEGER, "utc_ps", picoseconds, "whole numbers (int64)")
        return date.cast("int32").cast("int64").to_numpy(), picoseconds.cast("int64").to_numpy()

    def _dated(
        self, name: str, places: NDArray[np.intp], convert: Callable[[NDArray[np.intp]], Epochs]
    ) -> Epochs:
        """Epochs of rows, each place converted once; if one cannot be, the first row that has such a one is named."""
        different, which = np.unique(places, return_inverse=True)
        try:
            return convert(different)[which]
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
    """What :meth:`Observations.from_columns` takes, of the arguments of :meth:`Observations.from_table`."""
    theirs = _columns_in_memory(table)
    taken = _chosen(theirs, columns)
    units = dict(units or {})
    if unknown := [name for name in units if name not in theirs]:
        raise InputError(f"units names the column {unknown[0]!r}, but the table has {', '.join(theirs)}")
    n = len(next(iter(theirs.values()), ((),))[0])
    arrays: dict[str, Any] = {}
    for ours, name in taken.items():
        arrays |= _arrow(_SAME.get(ours, ours), *theirs[name], units.get(name))
    for ours, value in constants.items():
        if ours in taken:
            raise InputError(f"{ours} is a column of the table, and given for all rows; give one of them")
        repeated = value * np.ones(n) if hasattr(value, "unit") else np.full(n, value)
        arrays |= _arrow(_SAME.get(ours, ours), repeated, _unit(value), None)
    require_columns(_TABLE, list(arrays), split_epoch=True)
    single = [ours for ours, name in taken.items() if is_single_precision(theirs[name][0])]
    reader = ColumnReader(_TABLE, catalogue, single_precision=[_SAME.get(ours, ours) for ours in single])
    if n:
        reader.read(arrays, np.arange(1, n + 1, dtype=np.int32))
    return reader.columns()


def _columns_in_memory(table: Any) -> dict[str, tuple[Any, str]]:
    """Columns by name, each with the unit that the table states."""
    if hasattr(table, "__arrow_c_stream__"):
        import pyarrow

        try:
            arrow = pyarrow.table(table)
        except (
            ValueError,
            TypeError,
            pyarrow.ArrowException,
        ) as error:  # of pandas: names that occur twice, mixed types
            raise InputError(f"the table cannot be taken as columns of Arrow ({error}); correct it") from None
        for name in arrow.column_names:
            if arrow.column_names.count(name) > 1:
                raise InputError(f"the table has {name!r} more than once; rename or remove a column")
        return {
            field.name: (arrow[field.name], (field.metadata or {}).get(b"unit", b"").decode())
            for field in arrow.schema
            if not field.name.startswith("__index_level_")  # the rows of pandas, numbered
        }
    if not (hasattr(table, "keys") and hasattr(table, "__getitem__")):
        raise InputError(
            f"{type(table).__name__} is no table; give one of pandas, Arrow or astropy, or a dictionary"
        )
    found = {name: table[name] for name in table.keys()}  # noqa: SIM118  # a Table is iterated by rows
    lengths = {name: len(column) for name, column in found.items()}
    if len(set(lengths.values())) > 1:
        raise InputError(f"columns of a table are of one length, but these have {lengths}")
    return {name: (column, _unit(column)) for name, column in found.items()}


def _unit(column: Any) -> str:
    return str(getattr(column, "unit", None) or "")


def _chosen(theirs: Mapping[str, Any], columns: Mapping[str, str] | None) -> dict[str, str]:
    """Names of the table's columns by ours."""
    renamed = dict(columns or {})
    for ours, name in renamed.items():
        if ours not in (*_KNOWN, *_SAME):
            raise InputError(f"columns: {ours!r} is not known; use {', '.join(_KNOWN)}")
        if name not in theirs:
            raise InputError(f"columns: the table has no {name!r} for {ours}; it has {', '.join(theirs)}")
    others = [name for name in theirs if name not in renamed.values()]
    taken = renamed | {name: name for name in others if name in (*_KNOWN, *_SAME) and name not in renamed}
    left = [name for name in others if name not in taken.values() and name not in _ORIGIN]
    if left and columns is None:
        raise InputError(
            f"column {left[0]!r} is not known; say in `columns` what it is ({', '.join(_KNOWN)}), or give an empty "
            "dictionary there to leave out what is not known"
        )
    return taken


def _arrow(name: str, column: Any, own: str, unit: str | None) -> dict[str, Any]:
    """A column as files have it; an epoch that is no text and no timestamp as two."""
    import pyarrow

    if name == "epoch_utc" and (hasattr(column, "jd1") or isinstance(column, Epochs)):
        days, picoseconds = utc_to_picoseconds(to_scale(column, "UTC"))
        return {"utc_date": pyarrow.array(days.astype("datetime64[D]")), "utc_ps": pyarrow.array(picoseconds)}
    wanted = "1" if name in ("relative_humidity", "ramped") else unit_of(name)
    if wanted is not None and name not in SPLIT_EPOCH:
        return {name: pyarrow.array(_in_unit(name, column, own, unit, wanted), from_pandas=True)}
    if unit is not None:
        raise InputError(f"units: {name} has no unit; leave it out")
    if isinstance(column, pyarrow.ChunkedArray):
        values = column.combine_chunks()
        zoned = pyarrow.types.is_timestamp(values.type) and values.type.tz
        return {name: values.cast(pyarrow.timestamp(values.type.unit, "UTC")) if zoned else values}
    values = np.ma.getdata(column)
    mask = np.ma.getmaskarray(column) if np.ma.isMaskedArray(column) else None
    texts = values.astype("U") if values.dtype.kind == "S" else values  # as FITS has them
    try:
        made = pyarrow.array(texts, mask=mask, from_pandas=True)
    except (ValueError, TypeError, pyarrow.ArrowException) as error:
        raise InputError(f"column {name} is not of one type ({error}); give texts, or timestamps") from None
    many = isinstance(made, pyarrow.ChunkedArray)  # of very many texts
    return {name: made.combine_chunks() if many else made}


def _in_unit(name: str, column: Any, own: str, unit: str | None, wanted: str) -> Floats:
    """Numbers in the unit that is wanted, from what the table or the caller says; NaN where masked or null."""
    bare = column.to_numpy() if hasattr(column, "chunks") else getattr(column, "unmasked", column)
    numbers = as_float_array(np.ma.getdata(getattr(bare, "value", bare)), wanted, name)
    if (mask := getattr(column, "mask", None)) is not None and not callable(mask):
        numbers = np.where(mask, np.nan, numbers)
    text = unit or own
    if not text:
        return numbers
    from astropy.units import Quantity, Unit

    try:
        stated, given = (Unit(ASTROPY_UNITS.get(one, one)) for one in (own or text, text))
    except ValueError:
        raise InputError(f"units: {text!r} of {name} is no unit that astropy knows") from None
    if stated != given:
        raise InputError(f"units: {name} is in {own}, as the table says, not in {unit}; leave it out")
    found: Floats = in_unit(Quantity(numbers, given), wanted, name)
    return found


def as_column(name: str, values: ArrayLike, n: int, dtype: Any = np.float64) -> Any:
    """A column as a read-only contiguous array of n values: a copy, unless it is one that nobody else can write to."""
    mask = getattr(values, "mask", None)  # which NumPy drops with the unit
    if name in UNITS:
        values = in_unit(values, UNITS[name], name)
    array = np.asarray(getattr(values, "unmasked", values), dtype=dtype)
    if isinstance(mask, np.ndarray | np.bool_) and np.any(mask):
        if dtype is not np.float64:
            raise InputError(f"{name} has masked entries; leave their rows out")
        array = np.where(mask, np.nan, array)
    if array is values and array.shape == (n,) and array.flags.owndata and not array.flags.writeable:
        return array
    if array.shape not in ((), (n,)):
        raise InputError(f"{name} has shape {array.shape}; {n} epochs need one value or {n}")
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
    """Codes as a column: indices below a count."""
    wide = as_column(name, values, n, np.int64)
    if n and not (wide.min() >= 0 and wide.max() < count):
        held = f"{wide.min()} to {wide.max()}"
        raise InputError(f"{name} holds codes from {held}; allowed are 0 to {count - 1}")
    return as_column(name, wide, n, dtype)


def recoded(codes: NDArray[np.int32], column: NDArray[np.int32]) -> NDArray[np.int32]:
    """A read-only column of codes by the places that they now have."""
    out = codes[column] if len(column) else column.copy()
    out.flags.writeable = False
    return out


def each_once(items: Sequence[Any]) -> tuple[tuple[Any, ...], NDArray[np.int32]]:
    """Each item once, in order of first appearance, and for each item where it now is."""
    place: dict[Any, int] = {}
    codes = np.array([place.setdefault(item, len(place)) for item in items], dtype=np.int32)
    return tuple(place), codes
