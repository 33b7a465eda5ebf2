"""Trials of a study, or sites of a map, that run for long: on workers, and kept in a folder to be resumed.

What an interrupted run has computed is on disk. Each chunk of trials is a file of its own,
``parts/linear-000000-000049.npz``, that is there as a whole or not at all. ``study.json`` says what the trials depend
on; trials of another study are never taken over.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError, legible
from radioloc.jobs.workers import Job, Workers
from radioloc.progress import progress_bar
from radioloc.report.files import earlier_files, made_folder, remove_files, write_json
from radioloc.results.registry import RESULTS
from radioloc.study.record import study_settings, versions
from radioloc.study.study import Study
from radioloc.text_files import TEMPORARY_FILES, json_file, locked, replaced_file
from radioloc.vectors import Floats


def run_trials(
    workers: Workers,
    job: Job,
    seed: int,
    trials: range,
    *,
    way: str,
    max_chunk: int,
    folder: TrialFolder | None,
    bar: dict[str, Any],
) -> Floats:
    """Return results of all trials, (trials, arcs, columns); those that the folder keeps already are not run again.

    `way` is "linear", "full" or "sites", `bar` has the options of the progress bar.
    """
    completed = {} if folder is None else folder.completed(way)
    results = {trial: values for trial, values in completed.items() if trial in trials}
    missing = [trial for trial in trials if trial not in results]
    chunks = workers.chunks(missing, max_chunk)
    with progress_bar(total=len(trials), initial=len(results), **bar) as shown:
        for chunk, values in workers.run(job, seed, chunks):
            if folder is not None:
                folder.add(way, chunk, values)
            results |= dict(zip(chunk, values, strict=True))
            shown.update(len(chunk))
    return np.array([results[trial] for trial in trials])


def locked_folder(folder: str | Path | None) -> AbstractContextManager[None]:
    """Keep other studies out of a folder of trials while this one runs."""
    if folder is None:
        return nullcontext()
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
        for result in ("monte_carlo", "accuracy_map"):
            remove_files(self._folder, earlier_files(RESULTS[result]))
        write_json(self._folder / "study.json", self._record)

    def completed(self, way: str) -> dict[int, Floats]:
        """Results that are there already, (arcs, columns), by number of the trial; `way` is "linear" or "full"."""
        out: dict[int, Floats] = {}
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

    def _read(self, path: Path) -> tuple[NDArray[np.int64], Floats]:
        """Read numbers of trials and their results."""
        with path.open("rb") as stream, np.load(stream) as archive:
            trials, values, columns = (archive[name] for name in ("trials", "values", "columns"))
        if tuple(columns.tolist()) != self._columns:
            raise ValueError("the columns are not those of the study")
        if values.shape != (len(trials), len(self._hours), len(self._columns)):
            raise ValueError(f"{values.shape} numbers do not fit {trials.shape} trials")
        if len(np.unique(trials)) < len(trials) or (trials < 0).any():
            raise ValueError("numbers of trials are negative or repeated")
        return trials.astype(np.int64), values.astype(np.float64)

    def add(self, way: str, trials: Sequence[int], values: Floats) -> None:
        """Keep results of some trials, (trials, arcs, columns)."""
        path = self._parts / f"{way}-{min(trials):06d}-{max(trials):06d}.npz"
        with replaced_file(path) as temporary, temporary.open("wb") as stream:
            np.savez(stream, trials=np.array(trials), values=values, columns=np.array(self._columns))


def study_record(study: Study, hours: Sequence[float], seed: int) -> dict[str, Any]:
    """Return the settings of the trials of a study, except their number, in types of JSON."""
    return {"versions": versions(), "seed": seed, "hours": list(hours), **study_settings(study)}


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
