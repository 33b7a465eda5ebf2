"""Monte Carlo studies: many simulated realizations of a tracking plan, each fitted as a user would, for some arcs.

What an interrupted study has found already is on disk. Each chunk of trials is a file of its own,
``parts/linear-000000-000049.npz``, that is there as a whole or not at all. ``study.json`` says what the trials depend
on; trials of another study are never taken over.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from zipfile import ZIP_STORED, ZipFile

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError, legible
from radioloc.jobs.linear_trials import LinearTrials
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.prepared_trials import Prepared
from radioloc.jobs.selection import DEFAULT_HOURS, arc_lengths
from radioloc.jobs.simulate import scenario_of
from radioloc.jobs.workers import Run, workers_of
from radioloc.progress import progress_bar
from radioloc.quantities import FloatLike
from radioloc.report.files import earlier_files, made_folder, remove_files, write_json
from radioloc.results.monte_carlo import LinearityCheck, MonteCarlo
from radioloc.results.registry import RESULTS
from radioloc.simulation.noise import generator, require_seed
from radioloc.study.record import settings_of, versions
from radioloc.study.study import Study
from radioloc.study.study_file import as_study
from radioloc.text_files import TEMPORARY_FILES, json_file, locked, replaced_file

logger = logging.getLogger(__name__)

_Floats = NDArray[np.float64]

_MOST_IN_CHUNK = 25  # trials that are run together, so that their noise is drawn together, which is fast
_CHUNKS_PER_WORKER = 4
_RANDOM_PROOFS = 2
_ALLOWED_M, _ALLOWED_SIGMAS = 1e-3, 0.01
"""How far a position by the linear model may be from that of the full fit: the larger of both."""
_ALLOWED_OF_SIGMAS = 0.02
"""By how much sigmas may differ: the bins in which residuals are examined for time correlation begin elsewhere
when outliers are left out, and that alone moves sigmas by up to 1 %."""


@on_one_blas_thread()
def monte_carlo(
    study: Study | str | Path,
    trials: int = 1000,
    hours: Iterable[FloatLike] | FloatLike = DEFAULT_HOURS,
    *,
    seed: int | None = None,
    workers: Any = 1,
    out: str | Path | None = None,
    resume: bool = False,
    full: bool = False,
    progress: bool = False,
) -> MonteCarlo:
    """Simulate the tracking of a study again and again, and fit it, for arcs of several lengths.

    Parameters
    ----------
    study : Study or path-like
        With a simulation: the tracking, the noise and the drawn errors; its estimate, priors and
        noise settings are those of every fit, as :func:`~radioloc.jobs.locate.locate` takes them.
    trials : int
        How many.
    hours : iterable of float
        Lengths of the arcs from the start, h.
    seed : int, optional
        The simulation's where not given. The same seed gives the same trials, however and wherever they are run; a
        trial does not depend on how many others there are.
    workers : int or distributed.Client
        Number of processes, or the client of a Dask cluster. A script with several processes needs
        ``if __name__ == "__main__":``, as they are spawned.
    out : path-like, optional
        Folder that keeps the trials as they are made, so that a study can be resumed. Without `resume`, those that are
        there from before are removed.
    resume : bool
        Take over the trials that are in `out` already; more trials than last time may be asked for.
    full : bool
        Fit every trial with the whole model, however long it takes.
    progress : bool
        Show a bar, on a terminal or in a notebook.

    Returns
    -------
    MonteCarlo

    Raises
    ------
    InputError
        An argument cannot be, or `out` holds the trials of another study.
    RadiolocError
        The study cannot be simulated or fitted.

    Notes
    -----
    The model is linearized at the true position, and trials are fitted with that. The trials farthest from it and some
    at random are then simulated and fitted in full as well; where a position differs by more than 1 mm and 1 % of its
    sigma, or a sigma by 2 %, all trials are fitted in full.

    Trials are the same to the last bit wherever they are run, but for full fits and for delays that share the errors of
    stations, whose least squares may be rounded otherwise in another number of threads.

    Examples
    --------
    >>> import radioloc
    >>> found = radioloc.monte_carlo("examples/change5/simulation.toml", trials=20, hours=12.0)
    >>> found["east_m"].shape
    (20, 1)
    """
    study = as_study(study)
    lengths = arc_lengths(hours, study.observations)
    seed = scenario_of(study).seed if seed is None else seed
    require_seed(seed)
    if isinstance(trials, bool) or not isinstance(trials, int) or trials < 1:
        raise InputError(f"trials is {trials!r}; give a whole number above zero")
    if resume and out is None:
        raise InputError("to resume needs the folder of the trials; give it as out")
    record = study_record(study, lengths, seed)
    resumed = resume and out is not None and refuse_other_study(out, record)
    with nullcontext() if out is None else _locked(out), workers_of(workers) as run:
        ready = Prepared.of(study, lengths)
        folder = None if out is None else TrialFolder(out, record, ready.columns, ready.hours)
        if folder is not None and not resumed:
            folder.start()
        share_count = 1 if workers == 1 else _CHUNKS_PER_WORKER * (workers if isinstance(workers, int) else 1)
        results = partial(_run_trials, run, seed, range(trials), folder, share_count, progress)
        linear = None if full else ready.linear()
        check = None
        if linear is not None:
            values = results(linear)
            check = _check_linearity(linear, ready, seed, values)
            if not check.passed:
                linear = None
                logger.warning(
                    "the linear model is off by %.4g m, %.3g sigmas: all trials are fitted in full",
                    check.largest_m,
                    check.largest_sigmas,
                )
        if linear is None:
            values = results(ready)
    first, *others = ready.results(values, seed=int(seed), linear=linear is not None, linearity=check)
    return replace(first, others=tuple(others))


def _run_trials(
    run: Run,
    seed: int,
    trials: range,
    folder: TrialFolder | None,
    share_count: int,
    progress: bool,
    job: LinearTrials | Prepared,
) -> _Floats:
    """Return results of all trials; those that the folder keeps already are not run again."""
    way = "linear" if isinstance(job, LinearTrials) else "full"
    completed = {} if folder is None else folder.completed(way)
    results = {trial: values for trial, values in completed.items() if trial in trials}
    missing = [trial for trial in trials if trial not in results]
    size = max(1, min(_MOST_IN_CHUNK, -(-len(missing) // share_count))) if way == "linear" else 1
    chunks = [missing[k : k + size] for k in range(0, len(missing), size)]
    with progress_bar(shown=progress, total=len(trials), initial=len(results), unit="trial") as bar:
        for chunk, values in run(job, seed, chunks):
            if folder is not None:
                folder.add(way, chunk, values)
            results |= dict(zip(chunk, values, strict=True))
            bar.update(len(chunk))
    return np.array([results[trial] for trial in trials])


def _check_linearity(linear: LinearTrials, full: Prepared, seed: int, values: _Floats) -> LinearityCheck:
    """Compare the linear model with full fits where it is most likely to be wrong, and elsewhere.

    Without it trials of a model that is not linear are taken as they are (`tests/unit/jobs/test_monte_carlo.py`).
    """
    by_linear = full.results(values, seed=seed, linear=True, linearity=None)
    farthest = []
    for result in by_linear:
        distance_m = np.linalg.norm(result.errors_m, axis=-1)
        farthest += [int(np.argmax(distance_m[:, k])) for k in {0, distance_m.shape[1] - 1}]
    random = generator(seed, "trials to prove the linear model with")
    some = random.choice(len(values), min(_RANDOM_PROOFS, len(values)), replace=False).tolist()
    chosen = tuple(dict.fromkeys([*farthest, *some]))
    by_fits = full.results(full.run(seed, chosen), seed=seed, linear=False, linearity=None)
    largest_m, largest_sigmas, passed = 0.0, 0.0, True
    for result, fits in zip(by_linear, by_fits, strict=True):
        apart_m, sigma_m = np.abs(result.errors_m[list(chosen)] - fits.errors_m), fits.sigmas_m
        of_sigmas = np.abs(result.sigmas_m[list(chosen)] / sigma_m - 1.0)
        allowed_m = np.maximum(_ALLOWED_M, _ALLOWED_SIGMAS * sigma_m)
        passed &= bool(((apart_m <= allowed_m) & (of_sigmas <= _ALLOWED_OF_SIGMAS)).all())
        passed &= bool((result["converged"][list(chosen)] == fits["converged"]).all())
        largest_m = max(largest_m, float(apart_m.max()))
        largest_sigmas = max(largest_sigmas, float((apart_m / sigma_m).max()), float(of_sigmas.max()))
    return LinearityCheck(chosen, largest_m, largest_sigmas, passed)


def _locked(folder: str | Path) -> AbstractContextManager[None]:
    """Keep other studies out of a folder of trials while this one runs."""
    lock = made_folder(Path(folder) / "parts") / ".lock"
    lock.touch()
    return locked(lock)


class TrialFolder:
    """The folder of a study's trials; `record` is from :func:`study_record`."""

    def __init__(
        self, folder: str | Path, record: dict[str, Any], columns: Sequence[str], hours: Sequence[float]
    ) -> None:
        self._folder = made_folder(folder)
        self._parts = made_folder(self._folder / "parts")
        self._record, self._columns, self._hours = record, tuple(columns), tuple(hours)
        remove_files(self._parts, (TEMPORARY_FILES,))  # of a run that was killed

    def start(self) -> None:
        """Remove the trials of an earlier run and the files derived from them."""
        remove_files(self._parts, ("*-*-*.*",))
        remove_files(self._folder, earlier_files(RESULTS["monte_carlo"]))
        write_json(self._folder / "study.json", self._record)

    def completed(self, way: str) -> dict[int, NDArray[np.float64]]:
        """Results that are there already, (arcs, columns), by number of the trial; `way` is "linear" or "full"."""
        out: dict[int, NDArray[np.float64]] = {}
        for path in sorted(self._parts.glob(f"{way}-*.npz")):
            try:
                trials, values = self._read(path)
            except Exception as error:  # zipfile and NumPy raise errors of ten types for damaged archives
                [reason, *_] = str(error).splitlines() or ["no content"]
                raise InputError(
                    f"{path}: is damaged ({legible(reason[:200])}); remove the file and resume"
                ) from None
            out |= dict(zip(trials.tolist(), values, strict=True))
        return out

    def _read(self, path: Path) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Read numbers of trials and their results; shapes and types are checked before anything is allocated."""
        arrays: dict[str, NDArray[Any]] = {}
        with ZipFile(path) as archive:
            for name, kind, dimensions in (("trials", "i", 1), ("values", "f", 3), ("columns", "U", 1)):
                member = archive.getinfo(f"{name}.npy")
                # Without compression no array is larger than the file.
                if member.compress_type != ZIP_STORED:
                    raise ValueError(f"{name} is compressed")
                with archive.open(member) as stream:
                    np.lib.format.read_magic(stream)
                    shape, by_columns, dtype = np.lib.format.read_array_header_1_0(stream)
                    if dtype.kind != kind or len(shape) != dimensions or by_columns:
                        raise ValueError(f"{name} is an array of {dtype} and shape {shape}")
                    arrays[name] = np.frombuffer(stream.read(), dtype).reshape(shape)
        trials, values, columns = arrays["trials"], arrays["values"].astype(np.float64), arrays["columns"]
        if tuple(columns.tolist()) != self._columns:
            raise ValueError("the columns are not those of the study")
        if values.shape != (len(trials), len(self._hours), len(self._columns)):
            raise ValueError(f"{values.shape} numbers do not fit {trials.shape} trials")
        if len(np.unique(trials)) < len(trials) or (trials < 0).any():
            raise ValueError("numbers of trials are negative or repeated")
        return trials.astype(np.int64), values

    def add(self, way: str, trials: Sequence[int], values: NDArray[np.float64]) -> None:
        """Keep results of some trials, (trials, arcs, columns)."""
        path = self._parts / f"{way}-{min(trials):06d}-{max(trials):06d}.npz"
        with replaced_file(path) as temporary, temporary.open("wb") as stream:
            np.savez(stream, trials=np.array(trials), values=values, columns=np.array(self._columns))


def study_record(study: Study, hours: Sequence[float], seed: int) -> dict[str, Any]:
    """Return the settings of the trials of a study, except their number, in types of JSON."""
    return {"versions": versions(), "seed": seed, "hours": list(hours), **settings_of(study)}


def refuse_other_study(folder: str | Path, record: dict[str, Any]) -> bool:
    """Return whether a folder holds trials of this study; those of another study, or damaged ones, are an error."""
    path = Path(folder) / "study.json"
    if not path.is_file():
        return False
    current = json.loads(json.dumps(record))
    try:
        with json_file(path, "") as stored:
            changed = [key for key in current if dict(stored).get(key) != current[key]]
    except InputError:
        raise InputError(f"{path}: is damaged; start anew, without resuming") from None
    if changed:
        raise InputError(
            f"{folder}: the trials there are of another study (what differs: {', '.join(changed)}); "
            "give another folder, or start anew, without resuming"
        )
    return True
