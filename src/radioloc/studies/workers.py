"""Where the trials of a study run: in this process, in a pool of processes, or on a Dask cluster.

What is to be run is an object with a method ``run(seed, trials)``. It is sent to each worker once; after that only
numbers of trials go there and rows of results come back.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.extras import optional

Chunk = Sequence[int]
"""Numbers of trials that are run together."""

_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


class Job(Protocol):
    """Something that runs trials."""

    def run(self, seed: int, trials: Sequence[int]) -> NDArray[np.float64]:
        """Results of some trials, shape (trials, arcs, columns); the same in any company and in any process."""


def run_chunks(
    job: Job, seed: int, chunks: Sequence[Chunk], *, workers: int = 1, client: Any = None
) -> Iterator[tuple[Chunk, NDArray[np.float64]]]:
    """Run trials, chunk by chunk, and give each chunk's results as soon as they are there, in any order.

    Parameters
    ----------
    job : Job
        Picklable, if others than this process are to run it.
    seed : int
        Of the study.
    chunks : sequence of sequence of int
    workers : int
        Processes; with 1 this one does all.
    client : distributed.Client, optional
        In place of processes.

    Raises
    ------
    InputError
        As :func:`require_workers`.
    """
    require_workers(workers, client)
    if client is not None:
        yield from _on_cluster(job, seed, chunks, client)
    elif workers == 1 or len(chunks) < 2:
        for chunk in chunks:
            yield chunk, job.run(seed, chunk)
    else:
        yield from _in_pool(job, seed, chunks, min(workers, len(chunks)))


def require_workers(workers: int, client: Any) -> None:
    """Refuse what cannot run anything.

    Raises
    ------
    InputError
        The number of workers is not a whole number above zero, or the client is none of Dask's.
    """
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise InputError(f"workers is {workers!r}; give a whole number above zero")
    if client is None:
        return
    distributed = optional("distributed", "a Dask cluster needs distributed:", "dask")
    if not isinstance(client, distributed.Client):
        raise InputError(f"client is {client!r}; give a distributed.Client, or workers for processes")


def _in_pool(
    job: Job, seed: int, chunks: Sequence[Chunk], workers: int
) -> Iterator[tuple[Chunk, NDArray[np.float64]]]:
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context

    # Processes are spawned, not forked: a fork of a process with threads may hang, and some systems cannot.
    pool = ProcessPoolExecutor(
        workers, mp_context=get_context("spawn"), initializer=_install, initargs=(pickle.dumps(job),)
    )
    try:
        with _one_thread_each():
            futures = {pool.submit(_run_installed, seed, chunk): chunk for chunk in chunks}
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _on_cluster(
    job: Job, seed: int, chunks: Sequence[Chunk], client: Any
) -> Iterator[tuple[Chunk, NDArray[np.float64]]]:
    import distributed

    there = client.scatter(job, broadcast=True)
    futures = {client.submit(_run, there, seed, chunk, pure=False): chunk for chunk in chunks}
    try:
        for future, result in distributed.as_completed(futures, with_results=True):
            yield futures[future], result
    finally:
        client.cancel(list(futures))


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes that are started here do not use threads for linear algebra: the processes share the cores already."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


_installed: Job | None = None
"""The job of this worker process, which it was started with."""


def _install(job: bytes) -> None:
    global _installed
    _installed = pickle.loads(job)


def _run_installed(seed: int, chunk: Chunk) -> NDArray[np.float64]:
    assert _installed is not None  # the pool's initializer has been here
    return _installed.run(seed, chunk)


def _run(job: Job, seed: int, chunk: Chunk) -> NDArray[np.float64]:
    return job.run(seed, chunk)
