"""Trials on disk: what a study that was interrupted has found already, and whether it is still the same study.

Each chunk of trials is a file of its own, ``parts/linear-000000-000049.npz``, that is there as a whole or not at all.
``study.json`` says what the trials depend on; trials of another study are never taken over.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.report.files import OF_A_MONTE_CARLO, made_folder, remove_files, write_json
from radioloc.studies.record import settings_of, versions
from radioloc.studies.study import Study
from radioloc.text_files import read_text, replaced_file


def study_record(study: Study, hours: Sequence[float], seed: int) -> dict[str, Any]:
    """What the trials of a study depend on, in types that JSON has; not their number."""
    return {"versions": versions(), "seed": seed, "hours": list(hours), **settings_of(study)}


class TrialFolder:
    """The folder of a study's trials; `record` is from :func:`study_record`."""

    def __init__(
        self, folder: str | Path, record: dict[str, Any], columns: Sequence[str], hours: Sequence[float]
    ) -> None:
        self._folder = made_folder(folder)
        self._parts = made_folder(self._folder / "parts")
        self._record, self._columns, self._hours = record, tuple(columns), tuple(hours)

    def start(self) -> None:
        """Begin anew: trials that are there from before are removed, and what was made of them."""
        remove_files(self._parts, ("*-*-*.*",))
        remove_files(self._folder, OF_A_MONTE_CARLO)
        write_json(self._folder / "study.json", self._record)

    def found(self, way: str) -> dict[int, NDArray[np.float64]]:
        """Results that are there already, (arcs, columns), by number of the trial; `way` is "linear" or "full"."""
        out: dict[int, NDArray[np.float64]] = {}
        for path in sorted(self._parts.glob(f"{way}-*.npz")):
            try:
                with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
                    trials, values, columns = (file[name] for name in ("trials", "values", "columns"))
                if tuple(columns.tolist()) != self._columns:
                    raise ValueError("the columns are not those of the study")
                if values.shape != (*trials.shape, len(self._hours), len(self._columns)):
                    raise ValueError(f"{values.shape} numbers do not fit {trials.shape} trials")
                out |= dict(zip(trials.tolist(), values.astype(np.float64), strict=True))
            except (
                OSError,
                EOFError,
                RuntimeError,
                LookupError,
                ValueError,
                BadZipFile,
                zlib.error,
            ) as error:
                [reason, *_] = str(error).splitlines() or ["no content"]
                raise InputError(f"{path}: is damaged ({reason}); remove the file and resume") from None
        return out

    def add(self, way: str, trials: Sequence[int], values: NDArray[np.float64]) -> None:
        """Keep results of some trials, (trials, arcs, columns)."""
        path = self._parts / f"{way}-{min(trials):06d}-{max(trials):06d}.npz"
        with replaced_file(path) as temporary, temporary.open("wb") as stream:
            np.savez(stream, trials=np.array(trials), values=values, columns=np.array(self._columns))


def refuse_other_study(folder: str | Path, record: dict[str, Any]) -> bool:
    """Whether a folder holds trials of this study; an error where they are of another one, or it cannot be told."""
    path = Path(folder) / "study.json"
    if not path.is_file():
        return False
    try:
        before = json.loads(read_text(path))
        if not isinstance(before, dict):
            raise ValueError
    except ValueError:
        raise InputError(f"{path}: is damaged; start anew, without resuming") from None
    now = json.loads(json.dumps(record))
    changed = [key for key in now if before.get(key) != now[key]]
    if changed:
        raise InputError(
            f"{folder}: the trials there are of another study (what differs: {', '.join(changed)}); "
            "give another folder, or start anew, without resuming"
        )
    return True
