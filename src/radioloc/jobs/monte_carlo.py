"""Monte Carlo studies: many simulated realizations of a tracking plan, each fitted as a user would, for some arcs."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.errors import InputError
from radioloc.jobs.linear_trials import LinearTrials
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.prepared_trials import Prepared
from radioloc.jobs.selection import DEFAULT_HOURS, arc_lengths
from radioloc.jobs.simulate import build_scenario
from radioloc.jobs.trial_folder import (
    TrialFolder,
    locked_folder,
    refuse_other_study,
    run_trials,
    study_record,
)
from radioloc.jobs.workers import open_workers
from radioloc.progress import step
from radioloc.quantities import FloatLike
from radioloc.results.monte_carlo import LinearityCheck, MonteCarlo
from radioloc.simulation.noise import generator, require_seed
from radioloc.study.study import Study
from radioloc.study.study_file import as_study
from radioloc.vectors import Floats

logger = logging.getLogger(__name__)


_MAX_CHUNK_TRIALS = 25  # that are run together: drawing their noise together is what makes it fast
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
    """Simulate the tracking of a study in many trials, and fit each for several arc lengths.

    Parameters
    ----------
    study : Study or path-like
        Study with a simulation that states tracking, noise and drawn errors. Each trial is fitted as the study states.
    trials : int
        Number of trials.
    hours : iterable of float
        Lengths of the arcs from the start, h.
    seed : int, optional
        Seed of the random numbers; that of the simulation by default. It determines each trial, whatever the number of
        trials and processes.
    workers : int or executor
        Number of processes; or an executor such as those of :mod:`concurrent.futures` and ``mpi4py.futures``, or the
        ``distributed.Client`` of a Dask cluster. A script with several processes needs ``if __name__ == "__main__":``,
        as they are spawned.
    out : path-like, optional
        Folder in which trials are saved as they are made. Without `resume`, earlier trials there are removed.
    resume : bool
        Whether to keep the trials that are already in `out`, and to add to them.
    full : bool
        Whether to fit each trial with the whole model, which is slow.
    progress : bool
        Whether to show a progress bar, on a terminal or in a notebook.

    Raises
    ------
    InputError
        An argument is invalid, or `out` has the trials of another study.
    RadiolocError
        The study cannot be simulated or fitted.

    Notes
    -----
    Trials are fitted with the model linearized at the true position. The trials farthest from it, and some drawn at
    random, are also simulated and fitted in full. If one of these positions differs by more than 1 mm and 1 % of its
    sigma, or a sigma by 2 %, all trials are fitted in full.

    Trials are identical to the last bit for any number of processes. Full fits, and fits of delays with common errors
    of stations, may be rounded differently if the number of threads differs.

    Examples
    --------
    >>> import radioloc
    >>> trials = radioloc.monte_carlo("examples/change5/simulation.toml", trials=20, hours=12.0)
    >>> trials["east_m"].shape
    (20, 1)
    """
    study = as_study(study)
    lengths = arc_lengths(hours, study.observations)
    seed = build_scenario(study).seed if seed is None else seed
    require_seed(seed)
    if isinstance(trials, bool) or not isinstance(trials, int) or trials < 1:
        raise InputError(f"trials is {trials!r}; give a whole number above zero")
    if resume and out is None:
        raise InputError("to resume needs the folder of the trials; give it as out")
    record = study_record(study, lengths, seed)
    resumed = resume and out is not None and refuse_other_study(out, record)
    with locked_folder(out), open_workers(workers) as pool:
        with step("preparing the trials"):
            ready = Prepared.from_study(study, lengths)
        folder = None if out is None else TrialFolder(out, record, ready.columns, ready.hours)
        if folder is not None and not resumed:
            folder.start()
        bar = {"shown": progress, "unit": "trial"}
        results = partial(run_trials, pool, seed=seed, trials=range(trials), folder=folder, bar=bar)
        with step("linearizing the model"):
            linear = None if full else ready.linear()
        check = None
        if linear is not None:
            values = results(linear, way="linear", max_chunk=_MAX_CHUNK_TRIALS)
            with step("checking the linear model"):
                check = _check_linearity(linear, ready, seed, values)
            if not check.passed:
                linear = None
                logger.warning(
                    "the linear model is off by %.4g m, %.3g sigmas: all trials are fitted in full",
                    check.largest_m,
                    check.largest_sigmas,
                )
        if linear is None:
            values = results(ready, way="full", max_chunk=1)
    first, *others = ready.results(values, seed=int(seed), linear=linear is not None, linearity=check)
    return replace(first, others=tuple(others))


def _check_linearity(linear: LinearTrials, full: Prepared, seed: int, values: Floats) -> LinearityCheck:
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
