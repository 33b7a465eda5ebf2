"""Reading and writing of files; each failure is an error with the path and the remedy."""

from __future__ import annotations

import codecs
import csv
import errno
import gzip
import json
import math
import os
import re
import secrets
import stat
import tempfile
import unicodedata
import zlib
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError, InputError

BLOCK_BYTES = 2**22
"""Bytes read at once: enough for speed, few enough for the memory."""

ANY_BYTE = "latin-1"
"""Encoding that reads any byte, for files with ASCII data and comments in an unknown encoding."""

TEMPORARY_FILES = ".radioloc-*.part"
"""Pattern of the names of files that are being written."""

CUT_LINE = "the last line has no line end: its {} may be cut; end the line if it is complete"

_DISK_FAILURES = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
# Beginnings that spreadsheets take for a formula, full-width signs too. Names with an apostrophe get a second one.
_FORMULA = re.compile(r"'*[=+\-@\t\r\uff1d\uff0b\uff0d\uff20].", re.DOTALL)
_NUMBER = re.compile(r"[+-]?\d+\.?\d*(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
_GZIP_MAGIC = b"\x1f\x8b"
_COMPRESS_MAGIC = b"\x1f\x9d"


def require_ending(path: str | Path, endings: Iterable[str]) -> str:
    """Return the ending of a file's name in lower case; one other than `endings` is an InputError."""
    ending = Path(path).suffix.lower()
    if ending not in (supported := list(endings)):
        raise InputError(f"{path}: unsupported file extension {ending!r}; supported: {', '.join(supported)}")
    return ending


def read_lines(path: str | Path, *, encoding: str = "utf-8-sig", ended: bool = False) -> Iterator[str]:
    """Yield the lines of a text file, plain or gzip, and an empty one after the last line end.

    With `ended`, a last line without a line end is an error, as its last number may be cut.
    """
    last, number = "", 1
    for first_line, block in read_blocks(path, encoding=encoding):
        lines = block.decode(encoding.removesuffix("-sig")).split("\n")
        last, number = lines.pop(), first_line + len(lines)
        yield from lines
    if ended and last.strip():
        raise FileFormatError(path, CUT_LINE.format("number"), number)
    yield last


def read_text(path: str | Path, *, encoding: str = "utf-8-sig") -> str:
    """Return the text of a file, plain or gzip, UTF-8 or ``"latin-1"``, with lines ended by line feeds."""
    blocks = read_blocks(path, encoding=encoding)
    return "".join(block.decode(encoding.removesuffix("-sig")) for _, block in blocks)


@contextmanager
def json_file(path: str | Path, problem: str) -> Iterator[Any]:
    """Yield the content of a JSON file; errors in it or in the with statement are a FileFormatError of a `problem`."""
    text = read_text(path)
    try:
        yield json.loads(text, parse_constant=_refuse_constant)
    except FileFormatError:
        raise
    except InputError as error:
        raise FileFormatError(path, str(error)) from None
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise FileFormatError(path, problem, getattr(error, "lineno", None)) from None


def finite_or_none(value: float) -> float | None:
    """Return a number, or None for infinity and NaN, which JSON lacks."""
    return float(value) if math.isfinite(value) else None


def _refuse_constant(name: str) -> float:
    raise InputError(f"{name} is not a number of JSON; make the file again")


def read_blocks(
    path: str | Path, size: int = BLOCK_BYTES, *, encoding: str = "utf-8-sig"
) -> Iterator[tuple[int, bytes]]:
    """Yield the number of the first line and the text of blocks of lines, some megabytes each, plain or gzip."""
    first_line, blank, pending, start = 1, True, b"", b""
    for content in chain(_pieces(path, size), [b""]):
        start = start or content[:8]
        if b"\0" in content:
            lines_before = (pending + content).partition(b"\0")[0].count(b"\n")
            line = None if b"\0" in start else first_line + lines_before
            raise FileFormatError(
                path, "is not text (it has a zero byte); give a text file or its gzip", line
            )
        lines, line_end, remainder = content.rpartition(b"\n")
        if content and not line_end:
            pending += remainder
            continue
        block = _text_block(path, pending + lines + line_end, first_line, encoding)
        pending = remainder
        blank = blank and not block.decode(encoding).strip()
        if block:
            yield first_line, block
        first_line += block.count(b"\n")
    if blank:
        raise FileFormatError(path, "is empty; fetch or write it again")


def parse_numbers(path: str | Path, line_number: int | None, words: list[str], quantity: str) -> list[float]:
    """Return the finite numbers of a line's words; another word is a :class:`FileFormatError`."""
    numbers = []
    for word in words:
        try:
            number = float(word)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise FileFormatError(path, f"{word!r} is not a number; expected {quantity}", line_number)
        numbers.append(number)
    return numbers


def table_of(
    path: str | Path, lines: list[tuple[int, str]], n_columns: int, quantity: str
) -> NDArray[np.float64]:
    """Return an array of `n_columns` from numbered lines; errors as :func:`parse_numbers`."""
    rows = []
    for line_number, line in lines:
        words = line.split()
        if len(words) != n_columns:
            problem = f"{len(words)} columns, but {quantity} has {n_columns}"
            raise FileFormatError(path, problem, line_number)
        rows.append(parse_numbers(path, line_number, words, quantity))
    return np.array(rows).reshape(len(rows), n_columns)


def spreadsheet_cell(text: str) -> str:
    """Return a name as a cell of a CSV file; an apostrophe stops spreadsheets from computing it as a formula."""
    return f"'{text}" if _FORMULA.match(text) and not _NUMBER.fullmatch(text) else text


def text_of_cell(cell: str) -> str:
    """Return the name of a cell that :func:`spreadsheet_cell` wrote."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def read_rows(path: str | Path, columns: Sequence[str], table: str) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield line numbers and cells by column of a small CSV table without comments; `table` names it in errors."""
    lines = ((k, line) for k, line in enumerate(read_lines(path), 1) if line.strip() and line[0] != "#")
    first, heading = next(lines, (1, ""))
    header = [name.strip() for name in heading.split(",")]
    if sorted(header) != sorted(columns):
        raise FileFormatError(path, f"{table} has the columns {','.join(columns)}", first)
    for number, line in lines:
        [cells] = csv.reader([line])
        if len(cells) != len(header):
            problem = f"has {len(cells)} fields, but the header has {len(header)}: cut or damaged"
            raise FileFormatError(path, problem, number)
        texts = (text_of_cell(cell.strip()) for cell in cells)
        yield number, dict(zip(header, texts, strict=True))


def require_file(path: str | Path) -> None:
    """Raise a FileFormatError unless a file can be read; for files that other libraries read."""
    with _opened(path) as stream:
        stream.read(1)


def read_head(path: str | Path, size: int) -> bytes:
    """Return the first bytes of a file, unpacked and without a byte order mark."""
    return next(_pieces(path, size))


def read_bytes(path: str | Path) -> bytes:
    """Return the content of a file, unpacked and without a byte order mark."""
    return b"".join(_pieces(path, BLOCK_BYTES))


@contextmanager
def _opened(path: str | Path) -> Iterator[BinaryIO]:
    """Open a regular file; a failure is a FileFormatError."""
    try:
        mode = Path(path).stat().st_mode
        if stat.S_ISDIR(mode):
            raise FileFormatError(path, "is a directory; give the files in it")
        if not stat.S_ISREG(mode):  # a pipe without a writer would never be opened
            raise FileFormatError(path, "is a pipe or a device; give a file")
        with Path(path).open("rb") as stream:
            yield stream
    except FileNotFoundError:
        raise FileFormatError(path, "no such file; check the name and the directory") from None
    except FileFormatError:
        raise
    except (OSError, ValueError) as error:
        raise FileFormatError(
            path, f"cannot be read ({error}); check the name and the permissions"
        ) from error


def _pieces(path: str | Path, size: int) -> Generator[bytes]:
    """Yield the content of a file in pieces, unpacked and without a byte order mark."""
    with _opened(path) as stream:
        packed = stream.read(len(_GZIP_MAGIC)) == _GZIP_MAGIC
        stream.seek(0)
        content: Any = gzip.GzipFile(fileobj=stream) if packed else stream
        try:
            piece = content.read(size)
            if piece.startswith(_COMPRESS_MAGIC):
                raise FileFormatError(path, "is compressed with Unix compress (.Z); uncompress it first")
            yield piece.removeprefix(codecs.BOM_UTF8)
            while piece := content.read(size):
                yield piece
        except (OSError, EOFError, zlib.error) as error:
            if not packed:
                raise
            raise FileFormatError(path, f"gzip file is cut or damaged ({error}); fetch it again") from error


def _text_block(path: str | Path, block: bytes, first_line: int, encoding: str) -> bytes:
    """Return lines ended by line feeds; bytes outside the encoding are a FileFormatError."""
    try:
        if not block.isascii():
            block.decode(encoding)
    except UnicodeDecodeError as error:
        line = first_line + block.count(b"\n", 0, error.start)
        problem = f"byte 0x{block[error.start]:02x} is not UTF-8; save the file as UTF-8"
        raise FileFormatError(path, problem, line) from error
    return block.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in block else block


def to_ascii(text: str, length: int) -> str:
    """Return printable ASCII of at most `length` characters; accents are dropped, other characters become ``?``."""
    letters = (c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in letters)[:length]


def write_text(path: str | Path, text: str) -> None:
    """Write a file in one step: its content is the old one until the new one is complete."""
    try:
        content = text.encode()
    except UnicodeEncodeError as error:
        problem = f"cannot be written: {text[error.start : error.end]!r} is not text; leave it out"
        raise FileFormatError(path, problem) from error
    write_blocks(path, [content])


def write_blocks(path: str | Path, blocks: Iterable[bytes]) -> None:
    """Write a file in one step from blocks of bytes; see :func:`write_text`."""
    with replaced_file(path) as temporary, temporary.open("wb") as stream:
        for block in blocks:
            stream.write(block)


@contextmanager
def replaced_file(path: str | Path) -> Iterator[Path]:
    """Yield a new file that replaces a file once it is complete and on the disk."""
    file = Path(path)
    if file.is_dir():
        raise FileFormatError(path, "is a directory; give the name of a file")
    # In the same folder for the replacement; unlike files of tempfile it has the permissions of the umask.
    temporary = file.with_name(TEMPORARY_FILES.replace("*", secrets.token_hex(8)))
    try:
        temporary.touch(exist_ok=False)
    except OSError as error:
        raise _not_written(file, error, "make the directory or choose another") from error
    try:
        yield temporary
        with temporary.open("rb+") as stream:
            os.fsync(stream.fileno())  # a crash leaves the old content or the new one
        temporary.replace(file)
    except OSError as error:
        raise _not_written(file, error, "check space and permissions") from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Lock an existing file against other processes if the system can; a locked one is an InputError."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with path.open("r+b") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                f"{path.parent}: another run writes its results here; wait for its end or give another folder"
            ) from None
        except OSError:
            pass  # a file system without locks
        yield


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Make a folder for temporary files and remove it at the end."""
    with tempfile.TemporaryDirectory(prefix="radioloc-", ignore_cleanup_errors=True) as folder:
        yield Path(folder)


def disk_failed(error: OSError) -> bool:
    """Return whether a disk is full or fails, rather than a name or permission being wrong."""
    return error.errno in _DISK_FAILURES


def _not_written(path: Path, error: OSError, advice: str) -> OSError | FileFormatError:
    if disk_failed(error):
        problem = f"cannot be written ({error.strerror}); make room on the disk, then run again"
        return OSError(error.errno, problem, str(path))
    return FileFormatError(path, f"cannot be written ({error.strerror}); {advice}")
