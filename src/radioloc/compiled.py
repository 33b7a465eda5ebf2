"""Functions compiled by numba, whose machine code is kept on disk between runs, where that can be."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from radioloc.errors import InputError

_THREADS = os.environ.get("NUMBA_NUM_THREADS", "1")
if not (_THREADS.isdecimal() and int(_THREADS) > 0):  # numba itself would end its import in a ValueError
    raise InputError(
        f"environment variable NUMBA_NUM_THREADS: expected a whole number above zero, got {_THREADS!r}; correct or "
        "unset it"
    )

import numba  # noqa: E402


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a function that numba compiles without the interpreter's lock; options as those of ``numba.njit``."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(nogil=True, **options)(function)
        if hasattr(dispatcher, "enable_caching"):  # not where the compiler is off
            with suppress(RuntimeError):  # there is no directory to write to
                dispatcher.enable_caching()
        return dispatcher

    return decorate
