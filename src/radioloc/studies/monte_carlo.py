"""Monte Carlo studies: many simulated realizations of a tracking plan, each fitted as a user would, for some arcs."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.progress import progress_bar
from radioloc.report.monte_carlo import MonteCarlo, Proof
from radioloc.report.trial_statistics import sides_of
from radioloc.simulation.noise import generator, require_seed
from radioloc.studies.linear_trials import LinearTrials
from radioloc.studies.one_thread import on_one_blas_thread
from radioloc.studies.prepared_trials import FullTrials, Prepared
from radioloc.studies.selection import DEFAULT_HOURS, arc_lengths
from radioloc.studies.simulate import scenario_of
from radioloc.studies.study import Study
from radioloc.studies.study_file import as_study
from radioloc.studies.trial_files import TrialFolder, refuse_other_study, study_record
from radioloc.studies.workers import Job, Workers, workers_of

logger = logging.getLogger(__name__)

_Floats = NDArray[np.float64]

_MOST_IN_CHUNK = 25
"""Trials that are run together: drawing their noise together is what makes it fast."""
_CHUNKS_PER_WORKER = 4
_RANDOM_PROOFS = 2
_ALLOWED_M, _ALLOWED_SIGMAS = 1e-3, 0.01
"""How far a position by the linear model may be from that of the full fit: the larger of both."""
_ALLOWED_OF_SIGMAS = 0.02
"""By how much sigmas may differ: the bins in which residuals are examined for time correlation begin elsewhere
when outliers are left out, and that alone moves sigmas by up to 1 %."""


@on_one_blas_thread
def monte_carlo(
    study: Study | str | Path,
    trials: int = 1000,
    hours: Iterable[float] | float = DEFAULT_HOURS,
    *,
    seed: int | None = None,
    workers: int = 1,
    client: Any = None,
    out: str | Path | None = None,
    resume: bool = False,
    full: bool = False,
    progress: bool = False,
) -> MonteCarlo:
    """Simulate the tracking of a study again and again, and fit it, for arcs of several lengths.

    Parameters
    ----------
    study : Study or path-like
        With a simulation, which says what is tracked, the noise, and what departs by lot; its estimate, priors and
        noise settings are those of every fit, as :func:`~radioloc.studies.locate.locate` takes them.
    trials : int
        How many.
    hours : iterable of float
        Lengths of the arcs from the start, h.
    seed : int, optional
        The simulation's where not given. The same seed gives the same trials, however and wherever they are run; a
        trial does not depend on how many others there are.
    workers : int
        Processes. A script that asks for several needs ``if __name__ == "__main__":``, as they are spawned.
    client : distributed.Client, optional
        A Dask cluster to run on, in place of processes.
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
    known = resume and out is not None and refuse_other_study(out, record)
    with workers_of(workers, client) as started:
        ready = Prepared.of(study, lengths)
        folder = None if out is None else TrialFolder(out, record, ready.columns, ready.hours)
        if folder is not None and not known:
            folder.start()
        chunks = None if workers == 1 and client is None else _CHUNKS_PER_WORKER * workers
        run = _Runner(seed, trials, folder, started, chunks, progress)
        in_full = FullTrials(ready)
        linear = None if full else ready.linear()
        values, proof = None, None
        if linear is not None:
            values = run.all("linear", linear)
            proof = _prove(linear, in_full, seed, values)
            if not proof.passed:
                logger.warning(
                    "the linear model is off by %.4g m, %.3g sigmas: all trials are fitted in full",
                    proof.largest_m,
                    proof.largest_sigmas,
                )
                values = None
        if values is None:
            linear = None
            values = run.all("full", in_full)
    return MonteCarlo(
        name=study.name,
        seed=int(seed),
        hours=ready.hours,
        span_h=ready.span_h,
        columns=ready.columns,
        values=values,
        linear=linear is not None,
        proof=proof,
        drawn=ready.world.scenario.truth_sigma.keys,
        at_h=ready.at_h,
    )


@dataclass(frozen=True, slots=True)
class _Runner:
    """How the trials are run and kept; `chunks` is how many there are at least, None without others to share them."""

    seed: int
    trials: int
    folder: TrialFolder | None
    workers: Workers
    chunks: int | None
    progress: bool

    def all(self, way: str, job: Job) -> _Floats:
        """Results of all trials, those that are kept already included."""
        found = {} if self.folder is None else self.folder.found(way)
        found = {trial: values for trial, values in found.items() if trial < self.trials}
        missing = [trial for trial in range(self.trials) if trial not in found]
        if self.chunks is None:
            at_once = _MOST_IN_CHUNK if way == "linear" else 1
        else:
            at_once = max(1, min(_MOST_IN_CHUNK, -(-len(missing) // self.chunks)))
        chunks = [missing[k : k + at_once] for k in range(0, len(missing), at_once)]
        with progress_bar(wanted=self.progress, total=self.trials, initial=len(found), unit="trial") as bar:
            for chunk, values in self.workers.run(job, self.seed, chunks):
                if self.folder is not None:
                    self.folder.add(way, chunk, values)
                found |= dict(zip(chunk, values, strict=True))
                bar.update(len(chunk))
        return np.array([found[trial] for trial in range(self.trials)])


def _prove(linear: LinearTrials, full: FullTrials, seed: int, values: _Floats) -> Proof:
    """Compare the linear model with full fits where it is most likely to be wrong, and elsewhere."""
    columns = {name: k for k, name in enumerate(linear.columns)}
    sides = sides_of(linear.columns)
    enu = [columns[f"{side}_m"] for side in sides]
    sigmas = [columns[f"sigma_{side}_m"] for side in sides]
    distance_m = np.linalg.norm(values[..., enu], axis=-1)
    farthest = [int(np.argmax(distance_m[:, k])) for k in {0, distance_m.shape[1] - 1}]
    random = generator(seed, "trials to prove the linear model with")
    some = random.choice(len(values), min(_RANDOM_PROOFS, len(values)), replace=False).tolist()
    chosen = tuple(dict.fromkeys([*farthest, *some]))
    known = full.run(seed, chosen)
    one = values[list(chosen)]
    apart_m = np.abs(one[..., enu] - known[..., enu])
    sigma_m = known[..., sigmas]
    in_sigmas = apart_m / sigma_m
    of_sigmas = np.abs(one[..., sigmas] / sigma_m - 1.0)
    passed = (apart_m <= np.maximum(_ALLOWED_M, _ALLOWED_SIGMAS * sigma_m)) & (
        of_sigmas <= _ALLOWED_OF_SIGMAS
    )
    passed &= (one[..., columns["converged"]] == known[..., columns["converged"]])[..., None]
    return Proof(
        chosen, float(apart_m.max()), float(max(in_sigmas.max(), of_sigmas.max())), bool(passed.all())
    )
