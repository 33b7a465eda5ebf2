"""Compilation by numba, with machine code kept on disk between runs where a directory is writable."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any

from radioloc.errors import InputError
from radioloc.progress import announce, step

_THREADS = os.environ.get("NUMBA_NUM_THREADS", "1")
if not (_THREADS.isdecimal() and int(_THREADS) > 0):  # the import of numba would fail with a ValueError
    raise InputError(f"NUMBA_NUM_THREADS: expected a positive integer, got {_THREADS!r}; correct or unset it")

import numba  # noqa: E402
from numba.core import event  # noqa: E402


class _Announcer(event.Listener):
    """Listener that announces the compilation of functions without machine code on the disk."""

    def __init__(self) -> None:
        super().__init__()
        self._steps = ExitStack()  # a function may compile others

    def on_start(self, event: Any) -> None:
        announce("compiling the inner loops (once) ...")
        self._steps.enter_context(step("compiling the inner loops (once)"))

    def on_end(self, event: Any) -> None:
        self._steps.close()


event.register("numba:compile", _Announcer())


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a function that numba compiles and runs without the interpreter lock; `options` of ``numba.njit``."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(nogil=True, **options)(function)
        if hasattr(dispatcher, "enable_caching"):  # unless the compiler is off
            with suppress(RuntimeError):  # no writable directory
                dispatcher.enable_caching()
        return dispatcher

    return decorate
