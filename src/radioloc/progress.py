"""Progress of long work: bars on a terminal and in a notebook, and a status line of the command line.

The library reports its steps by :func:`step`; only a command that opens :func:`status_line` shows them.
"""

from __future__ import annotations

import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from typing import Any, TextIO

SILENT: ContextVar[bool] = ContextVar("SILENT", default=False)
"""True with ``--quiet``."""
_MIN_SHOWN_S, _REFRESH_S = 2.0, 0.5  # shorter work is not shown
_announced = set[str]()


class _StatusLine:
    """Line of a terminal with the innermost step and the seconds since the first, removed at the end."""

    def __init__(self, stream: TextIO) -> None:
        self.steps: list[str] = []
        self.bars: list[Any] = []
        self._stream, self._is_shown = stream, False
        self._ended, self._lock = threading.Event(), threading.Lock()
        self._thread = threading.Thread(target=self._refresh, args=(time.monotonic(),), daemon=True)

    def _refresh(self, start_s: float) -> None:
        while not self._ended.wait(_REFRESH_S):
            elapsed_s = time.monotonic() - start_s
            steps = self.steps[-1:]  # a copy, as the other thread changes them
            with self._lock:
                # A bar is not disabled until it ends.
                if steps and elapsed_s >= _MIN_SHOWN_S and all(bar.disable for bar in self.bars):
                    self._stream.write(f"\r\x1b[2Kradioloc: {steps[0]} ... {elapsed_s:.0f} s")
                    self._stream.flush()
                    self._is_shown = True

    def erase(self) -> None:
        """Remove the line, to write in its place."""
        with self._lock:
            self._erase()

    def _erase(self) -> None:
        if self._is_shown:
            self._stream.write("\r\x1b[2K")
            self._stream.flush()
            self._is_shown = False

    def replaced_by(self, make_bar: Callable[[], Any]) -> Any:
        """Return a new bar, until whose end the line is not shown."""
        with self._lock:
            self._erase()
            self.bars.append(make_bar())
            return self.bars[-1]

    def start(self) -> None:
        """Begin to show steps."""
        self._thread.start()

    def end(self) -> None:
        """Remove the line for good."""
        self._ended.set()
        self._thread.join()
        self.erase()


_STATUS: ContextVar[_StatusLine | None] = ContextVar("_STATUS", default=None)


@contextmanager
def status_line(text: str) -> Iterator[None]:
    """Show the steps of a block that takes more than two seconds on standard error if that is a terminal."""
    stream = sys.stderr
    if not (stream and stream.isatty()) or SILENT.get():
        yield
        return
    line = _StatusLine(stream)
    line.steps.append(text)
    token = _STATUS.set(line)
    line.start()
    try:
        yield
    finally:
        _STATUS.reset(token)
        line.end()


@contextmanager
def step(text: str) -> Iterator[None]:
    """Name a step of the work on the status line of the command line."""
    line = _STATUS.get()
    if line is None:
        yield
        return
    line.steps.append(text)
    try:
        yield
    finally:
        line.steps.pop()


def erase_status() -> None:
    """Remove the status line, before other output; it appears again while the work goes on."""
    line = _STATUS.get()
    if line is not None:
        line.erase()


def progress_bar(items: Iterable[Any] | None = None, *, shown: bool, **options: Any) -> Any:
    """Return a bar of tqdm with its options, hidden if not `shown` or if standard error is not interactive."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "IProgress not found")  # a notebook without ipywidgets
        from tqdm.auto import tqdm
    bar = partial(tqdm, items, disable=not (shown and _is_interactive()), **options)
    line = _STATUS.get()
    return bar() if line is None else line.replaced_by(bar)


def _is_interactive() -> bool:
    stream = sys.stderr
    return bool(stream) and (stream.isatty() or type(stream).__module__ == "ipykernel.iostream")


def announce(text: str) -> None:
    """Print a line on standard error if that is a terminal, each text once; a status line has it as a step."""
    stream = sys.stderr
    if stream and stream.isatty() and not SILENT.get() and text not in _announced and _STATUS.get() is None:
        _announced.add(text)
        print(text, file=stream, flush=True)
