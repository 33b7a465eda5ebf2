"""Progress bars on a terminal and in a notebook, and announcements of work that takes seconds."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable
from contextvars import ContextVar
from typing import Any

SILENT: ContextVar[bool] = ContextVar("SILENT", default=False)
"""True with ``--quiet``."""
_announced = set[str]()


def progress_bar(items: Iterable[Any] | None = None, *, shown: bool, **options: Any) -> Any:
    """Return a bar of tqdm with its options, hidden if not `shown` or if standard error is not interactive."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "IProgress not found")  # a notebook without ipywidgets
        from tqdm.auto import tqdm
    return tqdm(items, disable=not (shown and _is_interactive()), **options)


def _is_interactive() -> bool:
    stream = sys.stderr
    return bool(stream) and (stream.isatty() or type(stream).__module__ == "ipykernel.iostream")


def announce(text: str) -> None:
    """Print a line on standard error if that is a terminal, each text once."""
    stream = sys.stderr
    if stream and stream.isatty() and not SILENT.get() and text not in _announced:
        _announced.add(text)
        print(text, file=stream, flush=True)
