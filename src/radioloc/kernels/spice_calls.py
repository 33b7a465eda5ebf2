"""Calls of SPICE: paths that it can open, and its errors in one line."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from radioloc.errors import InputError
from radioloc.text_files import scratch_folder

MAX_PATH_BYTES = 255  # of a file name in SPICE


@contextmanager
def short_folder() -> Iterator[Path]:
    """Make a folder for temporary files whose paths SPICE can open."""
    with scratch_folder() as folder:
        if len(os.fsencode(folder)) > MAX_PATH_BYTES // 2:
            raise InputError(
                f"the folder for temporary files, {tempfile.gettempdir()}: expected a path of at most "
                f"{MAX_PATH_BYTES // 2} bytes, as SPICE opens no longer ones; set TMPDIR to another"
            )
        yield folder


@contextmanager
def spice_path(path: Path) -> Iterator[str]:
    """Give the name under which SPICE opens a file: its path, or a short link to it where that is too long."""
    if len(os.fsencode(path)) <= MAX_PATH_BYTES:
        yield str(path)
        return
    with short_folder() as folder:
        link = folder / f"kernel{path.suffix[:10]}"
        link.symlink_to(path.absolute())
        yield str(link)


def spice_message(error: Exception) -> str:
    """Return the message of a SPICE error in one line."""
    text = getattr(error, "long", "") or getattr(error, "short", "") or str(error)
    return " ".join(text.split())
