"""Text files whole: every way in which one cannot be read or written is one clear error."""

from __future__ import annotations

import gzip
import os
import tempfile
import zlib
from pathlib import Path

from radioloc.errors import FileFormatError

_GZIP_MAGIC = b"\x1f\x8b"
_COMPRESS_MAGIC = b"\x1f\x9d"


def read_lines(path: str | Path, *, encoding: str = "utf-8-sig") -> list[str]:
    """Lines of a text file, plain or gzip, without line ends; as :func:`read_text`."""
    return read_text(path, encoding=encoding).split("\n")


def read_text(path: str | Path, *, encoding: str = "utf-8-sig") -> str:
    """Text of a file, plain or gzip (told by its content, not its name), with lines ended by line feeds.

    Parameters
    ----------
    path : path-like
        The file.
    encoding : str
        UTF-8, of which ASCII is a part; ``"latin-1"`` takes any byte, for files of which only the comments are
        not ASCII.

    Raises
    ------
    FileFormatError
        No such file, a directory, not readable, empty, a gzip file that was cut or damaged, compressed in another
        way, or not text.
    """
    file = Path(path)
    if file.is_dir():
        raise FileFormatError(path, "is a directory; give the files in it")
    try:
        content = file.read_bytes()
    except FileNotFoundError:
        raise FileFormatError(path, "there is no such file; check the name and the directory") from None
    except (OSError, ValueError) as error:
        raise FileFormatError(
            path, f"cannot be read ({error}); check the name and the permissions"
        ) from error
    if content.startswith(_GZIP_MAGIC):
        try:
            content = gzip.decompress(content)
        except (OSError, EOFError, zlib.error) as error:
            problem = f"is a gzip file that was cut or damaged ({error}); fetch it again"
            raise FileFormatError(path, problem) from error
    if content.startswith(_COMPRESS_MAGIC):
        raise FileFormatError(path, "is compressed with Unix compress (.Z); uncompress it first")
    if b"\0" in content:
        raise FileFormatError(
            path, f"is not text (it starts with {content[:8]!r}); give a text file or its gzip"
        )
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        wrong = content[error.start]
        raise FileFormatError(
            path, f"byte 0x{wrong:02x} is not UTF-8; save the file as UTF-8", line
        ) from error
    if not text.strip():
        raise FileFormatError(path, "is empty; fetch or write it again")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def write_text(path: str | Path, text: str) -> None:
    """Write a file at once: whoever reads it sees the old content or the whole new one, never a part.

    Raises
    ------
    FileFormatError
        The directory is missing or cannot be written to, or the text holds half a surrogate pair.
    """
    file = Path(path)
    try:
        content = text.encode()
    except UnicodeEncodeError as error:
        wrong = text[error.start : error.end]
        raise FileFormatError(path, f"cannot be written: {wrong!r} is not text; leave it out") from error
    if file.is_dir():
        raise FileFormatError(path, "is a directory; give the name of a file")
    try:
        handle, temporary = tempfile.mkstemp(dir=file.parent, prefix=f".{file.name}.")
    except OSError as error:
        problem = f"cannot be written ({error.strerror}); make the directory or choose another"
        raise FileFormatError(path, problem) from error
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        # mkstemp makes files that only their owner reads; give this one what the user's umask allows.
        umask = os.umask(0)
        os.umask(umask)
        Path(temporary).chmod(0o666 & ~umask)
        Path(temporary).replace(file)
    except OSError as error:
        Path(temporary).unlink(missing_ok=True)
        raise FileFormatError(
            path, f"cannot be written ({error.strerror}); check space and permissions"
        ) from error
