"""Rows of a table of observations as columns: plain rows in bulk, any others one by one.

A row is plain if it is what :func:`radioloc.io.table.write_table` and most programs write. Blocks of lines in which
one is not, because it has quotes, another form of date or a mistake, are read a second time by Python's own means,
which find the line and the column of a mistake.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError, InputError
from radioloc.io.dates import utc_from_fields, utc_from_text
from radioloc.io.field_numbers import as_float, floats
from radioloc.io.fields import Fields, TextCodes
from radioloc.io.names import Catalogue, named_link
from radioloc.measurements.link import Link
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.registry import KINDS
from radioloc.time import Epochs

NEEDED_NUMBERS = ("observed_m", "light_time_s", "sigma_m", "sigma_s")
OPTIONAL_NUMBERS = (
    "pressure_hpa",
    "temperature_k",
    "relative_humidity",
    "wavelength_um",
    "uplink_hz",
    "count_s",
)
CODED_TEXTS: dict[str, type[np.integer]] = {"path": np.int32, "time_tag": np.int8, "type": np.int8}
"""Columns of texts that few rows differ in, with the type of their codes."""
# Names of the columns in Observations; seconds become metres at the end.
_NAMES = {
    "path": "link",
    "time_tag": "tag",
    "type": "kind",
    "observed_m": "value_m",
    **{name: name for name in (*NEEDED_NUMBERS[1:], *OPTIONAL_NUMBERS)},
}
# A line that begins with a lower or a higher character may be blank or a comment.
_HASH, _DELETE, _NEW_LINE = 0x23, 0x7F, 0x0A


def is_content(line: str) -> bool:
    """Whether a line is neither blank nor a comment."""
    stripped = line.strip()
    return bool(stripped) and not stripped.startswith("#")


class _Seen(NamedTuple):
    """Texts of a column in the rows so far, and the code that each stands for."""

    texts: TextCodes
    codes: list[int]


class RowReader:
    """Takes the rows of one file, block by block, and keeps their columns.

    Parameters
    ----------
    path : path-like
        The file, for messages.
    header : sequence of str
        Names of its columns, all of them known and none missing.
    catalogue : Catalogue or None
        Gives stations their catalogue names.
    """

    def __init__(self, path: str | Path, header: Sequence[str], catalogue: Catalogue | None) -> None:
        self._path = path
        self._header = list(header)
        self._catalogue = catalogue
        self._links: dict[Link, int] = {}
        self._seen = {name: _Seen(TextCodes(), []) for name in CODED_TEXTS}
        self._parts: dict[str, list[NDArray[Any]]] = {}

    def read(self, block: bytes, first_line: int) -> None:
        """Read lines, the first of which has this number.

        Raises
        ------
        FileFormatError
            A row has another number of fields, or a field cannot be read. Names line and column.
        """
        text, numbers = _content(block, first_line)
        if not len(numbers):
            return
        try:
            columns = self._in_bulk(text)
        except ValueError:
            columns = self._one_by_one(text, numbers)
        columns["line"] = numbers
        for name, column in columns.items():
            self._parts.setdefault(name, []).append(column)

    def columns(self) -> dict[str, Any]:
        """All that was read, as :func:`radioloc.io.table.checked_observations` takes it; the reader then is empty.

        Raises
        ------
        FileFormatError
            There was no row.
        """
        if not self._parts:
            raise FileFormatError(self._path, "has a header, but no observations")
        return joined_columns(self._parts) | {"links": tuple(self._links)}

    def _in_bulk(self, text: bytes) -> dict[str, NDArray[Any]]:
        """Columns of plain rows; :class:`ValueError` where a row is not plain or not right."""
        fields = Fields(text, len(self._header))
        columns = _epoch_columns(utc_from_fields(fields, self._header.index("epoch_utc")))
        for place, name in enumerate(self._header):
            if name in CODED_TEXTS:
                seen = self._seen[name]
                rows = seen.texts.codes(fields, place)
                new = seen.texts.texts[len(seen.codes) :]
                seen.codes.extend([self._code(name, text) for text in new])
                columns[_NAMES[name]] = np.array(seen.codes, dtype=CODED_TEXTS[name])[rows]
            elif name != "epoch_utc":
                columns[_NAMES[name]] = floats(fields, place, optional=name in OPTIONAL_NUMBERS)
        return columns

    def _one_by_one(self, text: bytes, numbers: NDArray[np.int32]) -> dict[str, NDArray[Any]]:
        """Columns of any rows; an error names line and column."""
        lines = text.decode().split("\n")[:-1]
        rows = split_lines(self._path, list(zip(numbers.tolist(), lines, strict=True)))
        for row, number in zip(rows, numbers, strict=True):
            if len(row) != len(self._header):
                problem = f"has {len(row)} fields, but the header has {len(self._header)}: cut or damaged"
                raise FileFormatError(self._path, problem, int(number))
        table = dict(zip(self._header, zip(*rows, strict=True), strict=True))
        columns: dict[str, NDArray[Any]] = {}
        # First what each row is, then what it measures: of several mistakes that is the one to be told.
        for name in (*CODED_TEXTS, *(name for name in self._header if name not in CODED_TEXTS)):
            fields = table[name]
            try:
                converted = self._converted(name, fields)
            except (ValueError, InputError):
                for field, number in zip(fields, numbers, strict=True):
                    self._refuse(name, field, int(number))
                raise
            columns |= (
                _epoch_columns(converted) if isinstance(converted, Epochs) else {_NAMES[name]: converted}
            )
        return columns

    def _converted(self, name: str, fields: Sequence[str]) -> NDArray[Any] | Epochs:
        if name == "epoch_utc":
            return utc_from_text([field.strip() for field in fields])
        if name in CODED_TEXTS:
            # Not a set: links are numbered as they come.
            codes = {field: self._code(name, field) for field in dict.fromkeys(fields)}
            return np.array([codes[field] for field in fields], dtype=CODED_TEXTS[name])
        if name in OPTIONAL_NUMBERS:
            fields = [field if field.strip() else "nan" for field in fields]
        return np.array([as_float(field) for field in fields])

    def _refuse(self, name: str, field: str, number: int) -> None:
        """Raise :class:`FileFormatError` if a field is what could not be converted."""
        try:
            self._converted(name, [field])
        except InputError as error:
            raise FileFormatError(self._path, f"{name}: {error}", number) from None
        except ValueError:
            raise FileFormatError(self._path, f"{name}: {field!r} is not a number", number) from None

    def _code(self, name: str, text: str) -> int:
        return text_code(name, text, self._links, self._catalogue)


def joined_columns(parts: dict[str, list[NDArray[Any]]]) -> dict[str, Any]:
    """Columns of all blocks together, read-only; the parts are given up one by one, so that few are there twice."""
    whole: dict[str, Any] = {}
    while parts:
        name, arrays = parts.popitem()
        whole[name] = np.concatenate(arrays)
        whole[name].flags.writeable = False
    whole["epoch"] = Epochs(whole.pop("jd"), whole.pop("fraction"), "UTC")
    return whole


def column_name(name: str) -> str:
    """What Observations call a column of the table."""
    return _NAMES[name]


def text_code(name: str, text: str, links: dict[Link, int], catalogue: Catalogue | None) -> int:
    """Code of a path, type or time tag.

    Parameters
    ----------
    name : {"path", "type", "time_tag"}
        The column.
    text : str
        What it says.
    links : dict of Link to int
        Links with their codes; a new one is added.
    catalogue : Catalogue or None
        Gives stations their catalogue names.

    Raises
    ------
    InputError
        It is none.
    """
    if name == "path":
        return links.setdefault(named_link(Link.from_path(text), catalogue), len(links))
    choices = KINDS if name == "type" else TIME_TAGS
    try:
        return choices.index(text.strip())
    except ValueError:
        raise InputError(f"{text!r} is not known; use {' or '.join(choices)}") from None


def split_lines(path: str | Path, lines: Sequence[tuple[int, str]]) -> list[list[str]]:
    """Fields of numbered lines, quotes taken off.

    Raises
    ------
    FileFormatError
        A quoted field does not end on its line. Names the line.
    """
    rows: list[list[str]] = []
    reader = csv.reader((line for _, line in lines), strict=True, skipinitialspace=True)
    try:
        for row in reader:
            if reader.line_num != len(rows) + 1:
                raise csv.Error("a quoted field does not end on its line")
            rows.append(row)
    except csv.Error as error:
        raise FileFormatError(path, f"{error}; correct the quotes", lines[len(rows)][0]) from error
    return rows


def _content(block: bytes, first_line: int) -> tuple[bytes, NDArray[np.int32]]:
    """Lines that are neither blank nor comments, each ended by a line feed, and their numbers."""
    if block and not block.endswith(b"\n"):
        block += b"\n"
    characters = np.frombuffer(block, dtype=np.uint8)
    ends = np.flatnonzero(characters == _NEW_LINE)
    numbers = np.arange(first_line, first_line + len(ends), dtype=np.int32)
    begins = characters[np.concatenate([[0], ends[:-1] + 1])] if len(ends) else characters
    if ((begins > _HASH) & (begins < _DELETE)).all():
        return block, numbers
    lines = block.split(b"\n")[:-1]
    kept = np.array([is_content(line.decode()) for line in lines])
    text = b"".join(line + b"\n" for line, keep in zip(lines, kept, strict=True) if keep)
    return text, numbers[kept]


def _epoch_columns(epoch: Epochs) -> dict[str, NDArray[Any]]:
    return {"jd": epoch.jd, "fraction": epoch.fraction}
