"""Columns of a table of observations, as Arrow has them: what CSV and Parquet files have in common.

What each holds is said in ``docs/reference/observation-table.md``. An epoch is ``epoch_utc``, text or a timestamp, or
(Parquet only) ``utc_date`` and ``utc_ps``, the picoseconds since midnight, of a leap second 86400e12 to 86401e12.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pyarrow
from numpy.typing import NDArray
from pyarrow import compute, types

from radioloc.constants import C_M_S
from radioloc.errors import FileFormatError, InputError
from radioloc.estimation.labels import Labels
from radioloc.io.checks import (
    FLIGHT_TIME_LIMITS_S,
    Catalogue,
    named_link,
    require_lunar_flight_time,
    without_duplicates,
)
from radioloc.io.csv_file import batches_of
from radioloc.io.dates import utc_from_picoseconds, utc_from_text, utc_to_picoseconds
from radioloc.measurements.link import Link
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.observations import RANGE, WEATHER_LIMITS, Observations
from radioloc.measurements.registry import KINDS
from radioloc.time import Epochs

SPLIT_EPOCH = ("utc_date", "utc_ps")
VALUE = ("observed_m", "light_time_s")
SIGMA = ("sigma_m", "sigma_s")
OPTIONAL = (*WEATHER_LIMITS, "uplink_hz", "count_s", "modulus_m", "ramped")
COLUMNS = ("epoch_utc", "type", "path", *VALUE, *SIGMA, "time_tag", *OPTIONAL)
"""Names of all columns of a CSV file; Parquet may have :data:`SPLIT_EPOCH` too."""

_TEXTS: dict[str, tuple[str, type[np.integer]]] = {
    "type": ("kind", np.int8),
    "path": ("link", np.int32),
    "time_tag": ("tag", np.int8),
}
_UNITS = {"utc_ps": "ps", "relative_humidity": "1"} | {
    name: name.rpartition("_")[2]
    for name in (*VALUE, *SIGMA, *OPTIONAL)
    if name not in ("relative_humidity", "ramped")
}
_TICKS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
_ROWS_AT_ONCE = 2**16


def require_columns(
    path: str | Path, header: list[str], line: int | None = None, *, split_epoch: bool = False
) -> None:
    """Raise :class:`FileFormatError` where a column is missing, unknown, there twice or said by another."""
    known = (*COLUMNS, *SPLIT_EPOCH) if split_epoch else COLUMNS
    for name in header:
        if name not in known:
            raise FileFormatError(path, f"column {name!r} is not known; use {', '.join(known)}", line)
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


def record_batches(
    observations: Observations, *, light_time: bool = False, split_epoch: bool = False
) -> Iterator[pyarrow.RecordBatch]:
    """Observations as Arrow columns with their units, some ten thousand rows at a time.

    Columns of radio are there only if there is something in them; what was not recorded is null.
    """
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
        if name in WEATHER_LIMITS or not np.isnan(values).all():
            columns[name] = values
    return batches_of(columns, units=_UNITS, rows_at_once=_ROWS_AT_ONCE)


class ColumnReader:
    """Takes the rows of one file, batch by batch, and makes observations of them; numbers may be texts, as in CSV."""

    def __init__(self, path: str | Path, catalogue: Catalogue | None, *, as_text: bool = False) -> None:
        self._path, self._catalogue, self._as_text = path, catalogue, as_text
        self._links: dict[Link, int] = {}
        self._columns: dict[str, list[NDArray[Any]]] = {}
        self._line: NDArray[np.int32] = np.empty(0, dtype=np.int32)

    def read(self, columns: Mapping[str, pyarrow.Array], line: NDArray[np.int32]) -> None:
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

    def observations(self, *, lunar: bool = True) -> Observations:
        """All that was read; the reader then is empty."""
        if not self._columns:
            raise FileFormatError(self._path, "has columns, but no observations")
        columns: dict[str, Any] = {}
        for name in list(self._columns):  # parts that are joined are let go
            columns[name] = np.concatenate(self._columns.pop(name))
            columns[name].flags.writeable = False  # what nobody can write to is not copied again
        columns["epoch"] = Epochs(columns.pop("jd"), columns.pop("fraction"), "UTC")
        if "ramped" in columns:
            columns["ramped"] = self._yes_or_no("ramped", columns["ramped"], columns["line"])
        for (metres, seconds), key in ((VALUE, "value_m"), (SIGMA, "sigma_m")):
            columns[key] = columns.pop(metres) if metres in columns else C_M_S * columns.pop(seconds)
        observations = Observations.from_columns(
            files=(str(self._path),), links=tuple(self._links), **columns
        )
        low_s, high_s = FLIGHT_TIME_LIMITS_S
        flight_s = observations.value_m / C_M_S
        whole = (observations.kind == RANGE) & np.isnan(observations.modulus_m)
        absurd = lunar & whole & ~((flight_s > low_s) & (flight_s < high_s))
        if absurd.any():
            first = int(np.argmax(absurd))
            require_lunar_flight_time(self._path, int(observations.line[first]), float(flight_s[first]))
        return without_duplicates(observations)

    def _yes_or_no(
        self, name: str, values: NDArray[np.float64], line: NDArray[np.int32]
    ) -> NDArray[np.bool_]:
        """1 is yes, 0 and nothing are no."""
        wrong = ~(np.isnan(values) | (values == 0.0) | (values == 1.0))
        if wrong.any():
            self._line = line
            self._fail(name, int(np.argmax(wrong)), f"{values[wrong][0]:g} is neither 1 (yes) nor 0 (no)")
        return np.asarray(values == 1.0)

    def _fail(self, name: str, row: int, problem: str) -> NoReturn:
        raise FileFormatError(self._path, f"{name}: {problem}", int(self._line[row]))

    def _wrong_type(self, name: str, column: pyarrow.Array, wanted: str) -> NoReturn:
        raise FileFormatError(self._path, f"column {name} is of type {column.type}; give {wanted}")

    def _require_all(self, name: str, column: pyarrow.Array) -> None:
        if column.null_count:
            row = int(np.argmax(column.is_null().to_numpy(zero_copy_only=False)))
            self._fail(name, row, "is missing (null)")

    def _numbers(self, name: str, column: pyarrow.Array) -> NDArray[np.float64]:
        if self._as_text:
            return self._numbers_of_text(name, column)
        if not (types.is_floating(column.type) or types.is_integer(column.type)):
            self._wrong_type(name, column, "numbers")
        if name not in OPTIONAL:
            self._require_all(name, column)
        numbers: NDArray[np.float64] = column.cast("float64", safe=False).to_numpy(zero_copy_only=False)
        return numbers

    def _numbers_of_text(self, name: str, column: pyarrow.Array) -> NDArray[np.float64]:
        column = compute.utf8_trim_whitespace(column)
        if name in OPTIONAL:
            column = compute.if_else(compute.equal(column, ""), None, column)
        try:
            numbers: NDArray[np.float64] = column.cast("float64").to_numpy(zero_copy_only=False)
        except pyarrow.ArrowInvalid:
            numbers = np.full(len(column), np.nan)
            for row, text in enumerate(column.to_pylist()):
                try:
                    numbers[row] = np.nan if text is None else _as_float(text)
                except ValueError:
                    self._fail(name, row, f"{text!r} is not a number")
        return numbers

    def _codes(self, name: str, column: pyarrow.Array) -> NDArray[Any]:
        places, texts = self._different(name, column, "text")
        codes = np.zeros(len(texts), dtype=_TEXTS[name][1])
        # In the order of the rows, in which links are numbered; a dictionary may hold what no row has.
        used, first = np.unique(places, return_index=True)
        for place in used[np.argsort(first)].tolist():
            try:
                codes[place] = self._code(name, texts[place].as_py())
            except InputError as error:
                self._fail(name, int(np.argmax(places == place)), str(error))
        return codes[places]

    def _different(
        self, name: str, column: pyarrow.Array, wanted: str
    ) -> tuple[NDArray[np.intp], pyarrow.Array]:
        """Different texts of a column, and which of them each row has."""
        self._require_all(name, column)
        if _is_text(column.type):
            column = column.dictionary_encode()
        if not types.is_dictionary(column.type) or not _is_text(column.type.value_type):
            self._wrong_type(name, column, wanted)
        return column.indices.to_numpy(zero_copy_only=False).astype(np.intp), column.dictionary

    def _code(self, name: str, text: str) -> int:
        if name == "path":
            link = named_link(Link.from_path(text), self._catalogue)
            return self._links.setdefault(link, len(self._links))
        choices = KINDS if name == "type" else TIME_TAGS
        try:
            return choices.index(text.strip())
        except ValueError:
            raise InputError(f"{text!r} is not known; use {' or '.join(choices)}") from None

    def _epoch(self, columns: Mapping[str, pyarrow.Array]) -> Epochs:
        if "epoch_utc" not in columns:
            name, (days, picoseconds) = "utc_ps", self._split_epoch(columns["utc_date"], columns["utc_ps"])
        elif types.is_timestamp(columns["epoch_utc"].type):
            name, (days, picoseconds) = "epoch_utc", self._timestamp(columns["epoch_utc"])
        else:
            # Observations of one instant are many in dense data: each is read once.
            wanted = "text, a timestamp, or utc_date and utc_ps in its place"
            places, texts = self._different("epoch_utc", columns["epoch_utc"], wanted)
            texts = compute.utf8_trim_whitespace(texts)
            return self._dated("epoch_utc", places, lambda k: utc_from_text(texts.take(pyarrow.array(k))))
        rows = np.arange(len(days))
        return self._dated(name, rows, lambda k: utc_from_picoseconds(days[k], picoseconds[k]))

    def _timestamp(self, column: pyarrow.Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Days since 1970 and picoseconds since their midnights."""
        if column.type.tz not in (None, "UTC", "+00:00"):
            self._wrong_type("epoch_utc", column, "UTC")
        self._require_all("epoch_utc", column)
        per_second = _TICKS[column.type.unit]
        days, rest = np.divmod(column.cast("int64").to_numpy(), 86400 * per_second)
        return days, rest * (10**12 // per_second)

    def _split_epoch(
        self, date: pyarrow.Array, picoseconds: pyarrow.Array
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """As :meth:`_timestamp`."""
        if not types.is_date32(date.type):
            self._wrong_type("utc_date", date, "a date (date32)")
        if not types.is_integer(picoseconds.type):
            self._wrong_type("utc_ps", picoseconds, "whole numbers (int64)")
        self._require_all("utc_date", date)
        self._require_all("utc_ps", picoseconds)
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


def _as_float(text: str) -> float:
    """Number that a text is; :class:`ValueError` also for what no other program would read alike."""
    if "_" in text or not text.isascii():
        raise ValueError(f"could not convert {text!r}")
    return float(text)


def _is_text(type_: pyarrow.DataType) -> bool:
    return bool(types.is_string(type_) or types.is_large_string(type_))
