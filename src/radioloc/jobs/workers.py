"""Workers that run the trials of a study: this process, a pool of processes, or a Dask cluster.

A job is an object with a method ``run(seed, trials)``. It is sent to each worker once; after that only numbers of
trials and rows of results are exchanged.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import lru_cache, partial
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from pathlib import Path
from threading import Thread
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError, RadiolocError
from radioloc.plugins import registered_names
from radioloc.study.record import versions
from radioloc.text_files import scratch_folder

Chunk = Sequence[int]  # Numbers of trials that are run together

_GUARD = 'a script that asks for several workers needs if __name__ == "__main__":, as they are spawned'

_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")

_MIN_TRIALS_PER_PROCESS = 50  # They take several times as long as the start of the process

_CAN_MASK = hasattr(signal, "pthread_sigmask")


class Job(Protocol):
    """Object that runs trials."""

    def run(self, seed: int, trials: Sequence[int]) -> NDArray[np.float64]:
        """Return results of trials, (trials, arcs, columns), which do not depend on the other trials or the process."""


Run = Callable[[Job, int, Sequence[Chunk]], Iterator[tuple[Chunk, NDArray[np.float64]]]]
"""Function that runs chunks of trials of a seed and yields the results of each, in any order."""


def usual_workers(trials: int) -> int:
    """Return the number of processes for some trials: one for each core, with at least 50 trials each."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores, trials // _MIN_TRIALS_PER_PROCESS))


@contextmanager
def workers_of(workers: Any = 1) -> Iterator[Run]:
    """Provide a pool for trials until the block ends: this process, several processes, or the client of a cluster."""
    if (names := registered_names()) and workers != 1:
        raise InputError(
            f"workers: expected 1, as radioloc.register added {', '.join(names)} to this process only, got "
            f"{workers!r}; entry points of a package serve several processes"
        )
    distributed = sys.modules.get("distributed")  # imported by whoever has a client
    if distributed is not None and isinstance(workers, distributed.Client):
        yield partial(_on_cluster, workers)
    elif isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise InputError(
            f"workers: expected a number of processes above zero, or a distributed.Client, got {workers!r}"
        )
    elif workers == 1:
        yield lambda job, seed, chunks: ((chunk, job.run(seed, chunk)) for chunk in chunks)
    else:
        # Processes are spawned, not forked: a fork of a process with threads may hang, and some systems cannot.
        pool = ProcessPoolExecutor(workers, get_context("spawn"), _begin)
        with scratch_folder() as folder:
            try:
                _start(pool, workers)
                yield partial(_in_processes, pool, folder)
            finally:
                # The pool cancels the rest itself: it reports an invalid state of futures that are cancelled here if
                # an interrupt ends its processes at the same time.
                pool.shutdown(cancel_futures=True)


def _start(pool: ProcessPoolExecutor, count: int) -> None:
    try:
        with _spawning():
            for _ in range(count):
                pool.submit(_import_what_jobs_need)
    except RuntimeError:  # in a script that its own spawned process imports
        raise InputError(_GUARD) from None


def _in_processes(
    pool: ProcessPoolExecutor, folder: Path, job: Job, seed: int, chunks: Sequence[Chunk]
) -> Iterator[tuple[Chunk, NDArray[np.float64]]]:
    """Run in a pool of processes, which read each job from a file once."""
    file = folder / f"job{len(list(folder.iterdir()))}.pickle"
    file.write_bytes(pickle.dumps(job))
    try:
        with _spawning():
            futures = {pool.submit(_run_from, str(file), seed, chunk): chunk for chunk in chunks}
        for future in as_completed(futures):
            yield futures[future], future.result()
    except BrokenProcessPool:
        raise RadiolocError(
            f"a worker process ended before its trials: {_GUARD}; or the system killed it, as for lack of memory"
        ) from None


def _on_cluster(
    client: Any, job: Job, seed: int, chunks: Sequence[Chunk]
) -> Iterator[tuple[Chunk, NDArray[np.float64]]]:
    """Run on a Dask cluster; each job is sent to each of its workers once."""
    from distributed import CancelledError, KilledWorker, as_completed

    _check_versions(client)
    futures: dict[Any, Chunk] = {}
    try:
        sent = client.scatter(job, broadcast=True)
        futures |= {client.submit(_run, sent, seed, chunk, pure=False): chunk for chunk in chunks}
        for future in as_completed(futures):
            yield futures[future], future.result()
    except (CancelledError, KilledWorker, TimeoutError, OSError) as error:
        raise RadiolocError(
            "the Dask cluster lost its workers before the trials ended; restart it and run the study again"
        ) from error
    finally:
        client.cancel(list(futures))


def _check_versions(client: Any) -> None:
    """Refuse a cluster whose workers have other versions of the packages that compute."""
    expected = versions()
    try:
        versions_by_worker = client.run(versions)
    except (ImportError, AttributeError) as error:
        raise InputError(
            f"a worker of the Dask cluster has another radioloc or none ({error}); install radioloc "
            f"{expected['radioloc']} on all workers"
        ) from error
    if not versions_by_worker:
        raise InputError("the Dask cluster has no workers; start at least one")
    for worker, installed in versions_by_worker.items():
        for name, version in expected.items():
            if installed.get(name) != version:
                raise InputError(
                    f"worker {worker} of the Dask cluster: expected {name} {version}, got {installed.get(name)}; "
                    "install the same versions on all workers"
                )


@contextmanager
def _spawning() -> Iterator[None]:
    """Start processes with one thread of linear algebra each; an interrupt waits until they have begun."""
    earlier = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    masked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if _CAN_MASK else set()
    try:
        yield
    finally:
        if _CAN_MASK:
            signal.pthread_sigmask(signal.SIG_SETMASK, masked)
        for name, value in earlier.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _begin() -> None:
    """Set up a worker that ends silently with its parent or on an interrupt."""
    Thread(target=_end_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if _CAN_MASK:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None  # in a worker
    wait([parent.sentinel])
    os._exit(1)


def _import_what_jobs_need() -> None:
    import radioloc.jobs.linear_trials  # noqa: F401


@lru_cache(maxsize=1)
def _job_from(file: str) -> Job:
    job: Job = pickle.loads(Path(file).read_bytes())
    return job


def _run_from(file: str, seed: int, chunk: Chunk) -> NDArray[np.float64]:
    return _run(_job_from(file), seed, chunk)


def _run(job: Job, seed: int, chunk: Chunk) -> NDArray[np.float64]:
    return job.run(seed, chunk)
