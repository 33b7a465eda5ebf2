"""Workers that run the trials of a study or the sites of a map: this process, or an executor.

An executor has ``submit(function, *arguments)``, which returns a future with ``result``, ``cancel`` and
``add_done_callback``: those of :mod:`concurrent.futures`, of MPI, or the client of a Dask cluster. A job is an object
with a method ``run(seed, trials)``. Processes of this machine read it from a file, a Dask cluster gets it once, other
executors get it with each chunk of trials.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, ProcessPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Protocol

from radioloc.errors import InputError, RadiolocError
from radioloc.lazy import optional
from radioloc.plugins import registered_names
from radioloc.study.record import versions
from radioloc.text_files import scratch_folder
from radioloc.vectors import Floats

Chunk = Sequence[int]  # Numbers of trials that are run together

_GUARD = 'a script that asks for several workers needs if __name__ == "__main__":, as they are spawned'

_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")

_MIN_TRIALS_PER_PROCESS = 50  # They take several times as long as the start of the process
_CHUNKS_PER_WORKER = 4
_CONNECTION_TIMEOUT_S = 10.0

_CAN_MASK = hasattr(signal, "pthread_sigmask")


class Job(Protocol):
    """Object that runs trials."""

    def run(self, seed: int, trials: Sequence[int]) -> Floats:
        """Return results of trials, (trials, arcs, columns), which do not depend on the other trials or the process."""


def usual_workers(trials: int) -> int:
    """Return the number of processes for some trials: one for each core, with at least 50 trials each."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores, trials // _MIN_TRIALS_PER_PROCESS))


@dataclass(frozen=True, slots=True)
class Workers:
    """Executor of jobs; this process without one."""

    count: int = 1  # 0 if the executor does not state it
    executor: Any = None
    folder: Path | None = None  # of jobs, for processes of this machine

    def chunks(self, trials: Sequence[int], max_size: int) -> list[Chunk]:
        """Divide trials among the workers: four chunks for each if that makes them smaller than the largest size."""
        shares = _CHUNKS_PER_WORKER * self.count if self.count > 1 else 1
        size = max(1, min(max_size, -(-len(trials) // shares)))
        return [trials[k : k + size] for k in range(0, len(trials), size)]

    def run(self, job: Job, seed: int, chunks: Sequence[Chunk]) -> Iterator[tuple[Chunk, Floats]]:
        """Run chunks of trials of a seed and yield the results of each, in any order."""
        if self.executor is None:
            yield from ((chunk, job.run(seed, chunk)) for chunk in chunks)
            return
        futures, done = dict[Any, Chunk](), SimpleQueue[Any]()
        try:
            sent = self._sent(job)
            with nullcontext() if self.folder is None else _spawning():
                for chunk in chunks:
                    future = self.executor.submit(_run, sent, seed, chunk)
                    futures[future] = chunk
                    future.add_done_callback(done.put)
            for _ in chunks:
                future = done.get()
                yield futures[future], future.result()
        except _losses() as error:
            hint = f": {_GUARD}; or the system killed it, as for lack of memory" if self.folder else ""
            raise RadiolocError(
                f"the executor lost its workers before the trials ended{hint}; start it again"
            ) from error
        finally:
            # The pool of this module cancels the rest itself: it reports an invalid state of futures that are cancelled
            # here if an interrupt ends its processes at the same time.
            for future in futures if self.folder is None else ():
                future.cancel()

    def _sent(self, job: Job) -> Any:
        """Return what workers get a job from."""
        content = pickle.dumps(job)
        if self.folder is not None:
            file = self.folder / f"job{len(list(self.folder.iterdir()))}.pickle"
            file.write_bytes(content)
            return file
        if not hasattr(self.executor, "scatter"):
            return content
        _check_versions(self.executor)
        return self.executor.scatter(content, broadcast=True, hash=False)


@contextmanager
def open_workers(workers: Any = 1) -> Iterator[Workers]:
    """Provide workers until the block ends: this process, a number of processes, or an executor of the caller."""
    if (names := registered_names()) and workers != 1:
        raise InputError(
            f"workers: expected 1, as radioloc.register added {', '.join(names)} to this process only, got "
            f"{workers!r}; entry points of a package serve several processes"
        )
    if hasattr(workers, "submit"):
        threads = workers.nthreads() if hasattr(workers, "nthreads") else {}
        yield Workers(sum(threads.values()), workers)
    elif isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise InputError(
            f"workers: expected a number of processes above zero, or an executor with submit, got {workers!r}"
        )
    elif workers == 1:
        yield Workers()
    else:
        # Processes are spawned, not forked: a fork of a process with threads may hang, and some systems cannot.
        pool = ProcessPoolExecutor(workers, get_context("spawn"), _begin)
        with scratch_folder() as folder:
            try:
                _start(pool, workers)
                yield Workers(workers, pool, folder)
            finally:
                pool.shutdown(cancel_futures=True)


@contextmanager
def dask_client(address: str) -> Iterator[Any]:
    """Provide the client of a Dask cluster by the address of its scheduler until the block ends."""
    distributed = optional("distributed", "a Dask cluster needs the package distributed:", "dask")
    try:
        client = distributed.Client(address, timeout=_CONNECTION_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"Dask scheduler {address}: cannot be reached ({' '.join(str(error).split())}); expected an address such "
            "as tcp://host:8786 of a running `dask scheduler`"
        ) from None
    with client:
        yield client


def _losses() -> tuple[type[Exception], ...]:
    """Return the errors of executors that lose their workers."""
    distributed = sys.modules.get("distributed")  # a client implies that it is imported
    return BrokenExecutor, CancelledError, *([] if distributed is None else [distributed.KilledWorker])


def _start(pool: ProcessPoolExecutor, count: int) -> None:
    try:
        with _spawning():
            for _ in range(count):
                pool.submit(_import_what_jobs_need)
    except RuntimeError:  # in a script that its own spawned process imports
        raise InputError(_GUARD) from None


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
    threading.Thread(target=_end_with_parent, daemon=True).start()
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


class _JobOfThread(threading.local):
    """Last job of a thread of a worker; predictors of a job keep a state, so that threads do not share it."""

    sent: Path | bytes = b""
    job: Job


_job_of_thread = _JobOfThread()


def _run(sent: Path | bytes, seed: int, chunk: Chunk) -> Floats:
    if _job_of_thread.sent != sent:
        content = sent.read_bytes() if isinstance(sent, Path) else sent
        _job_of_thread.job, _job_of_thread.sent = pickle.loads(content), sent
    return _job_of_thread.job.run(seed, chunk)
