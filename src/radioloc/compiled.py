"""Functions compiled by numba, whose machine code is kept on disk between runs, where that can be.

By itself numba stops where the files it keeps are damaged or cannot be written, and runs machine code in which a byte
has changed. Here such code is not used: the function is compiled again.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from radioloc.errors import InputError

_THREADS = os.environ.get("NUMBA_NUM_THREADS", "1")
if not (_THREADS.isdecimal() and int(_THREADS) > 0):  # numba itself would end its import in a ValueError
    raise InputError(
        f"environment variable NUMBA_NUM_THREADS: expected a whole number above zero, got {_THREADS!r}; correct or "
        "unset it"
    )

import numba  # noqa: E402
from numba.core.caching import FunctionCache, IndexDataCacheFile  # noqa: E402

_DIGEST_BYTES = 32


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a function that numba compiles without the interpreter's lock; options as those of ``numba.njit``."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(nogil=True, **options)(function)
        if hasattr(dispatcher, "enable_caching"):  # not where the compiler is off
            with suppress(RuntimeError):  # there is no directory to write to
                dispatcher._cache = _Cache(function)
        return dispatcher

    return decorate


class _CheckedFile(IndexDataCacheFile):
    """Files of one function; after what numba writes stands its SHA-256, which numba itself passes over."""

    def _dump(self, obj: Any) -> bytes:
        content: bytes = super()._dump(obj)
        return content + hashlib.sha256(content).digest()

    def _load_data(self, name: str) -> Any:
        content = Path(self._data_path(name)).read_bytes()
        if hashlib.sha256(content[:-_DIGEST_BYTES]).digest() != content[-_DIGEST_BYTES:]:
            raise OSError("damaged")  # for numba as if the file were not there
        return super()._load_data(name)


class _Cache(FunctionCache):
    """What is kept of one function."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        # By itself numba looks at the function's own module only, not at those whose functions it has compiled in.
        called = (getattr(one, "_cache", None) for one in function.__globals__.values())
        stamps = (one.stamp for one in called if isinstance(one, _Cache))
        self.stamp: frozenset[Any] = frozenset({self._impl.locator.get_source_stamp()}).union(*stamps)
        self._cache_file = _CheckedFile(self._cache_path, self._impl.filename_base, self.stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        # A damaged index is anything to pickle.
        with suppress(Exception):
            return super().load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(Exception):
            try:
                super().save_overload(sig, data)
            except Exception:
                self.flush()
                super().save_overload(sig, data)
