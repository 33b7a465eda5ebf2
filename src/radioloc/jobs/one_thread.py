"""Linear algebra on one thread.

A fit consists of very many small products and decompositions. Sharing each of them between processors costs more than
it saves, several times as much on a busy machine, and the last digits of sums would depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def on_one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread in a block or a decorated function."""
    import scipy.linalg  # noqa: F401  # its BLAS library is limited only if it is loaded
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield
