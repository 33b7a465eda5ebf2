"""Linear algebra on one thread.

A fit is made of very many small products and decompositions. A BLAS library that shares each of them between all
processors spends more on that than it gains, several times as much where others use these processors too; and its sums,
hence the last digits of results, depend on how many there are.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

_P = ParamSpec("_P")
_T = TypeVar("_T")


def on_one_blas_thread(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Make a function that has BLAS use one thread while it runs, and as many as before when it is done."""

    @wraps(function)
    def limited(*args: _P.args, **kwargs: _P.kwargs) -> _T:
        import scipy.linalg  # noqa: F401  # the library that it brings is limited only if it is there
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
