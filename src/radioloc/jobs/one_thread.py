"""Linear algebra on one thread.

A fit is made of very many small products and decompositions. A BLAS library that shares each of them between all
processors spends more on that than it gains, several times as much where others use these processors too; and its sums,
hence the last digits of results, depend on how many there are.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def on_one_blas_thread() -> Iterator[None]:
    """Have BLAS use one thread in a block, or in a function that this decorates, and as many as before after it."""
    import scipy.linalg  # noqa: F401  # the library that it brings is limited only if it is there
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield
