"""Residuals as a Tracking Data Message, observed minus computed in the place of what was observed."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.errors import InputError
from radioloc.estimation.solution import Solution
from radioloc.io.tdm.message import WEATHER, TdmFile, TdmHeader
from radioloc.io.tdm.write import tdm_of, write_tdm_file
from radioloc.measurements.observations import Observations

_SAYS = "the values are residuals, observed minus computed, not observations"


def write_residuals_tdm(
    solution: Solution,
    observations: Observations,
    path: str | Path,
    *,
    originator: str,
    creation_date: str | None = None,
) -> Path:
    """Write residuals as a message: XML where the file's name ends in ``.xml``, else KVN.

    The standard (CCSDS 503.0-B-2) has no keywords for residuals: they stand under those of what was observed, in its
    units, and comments say so in the header and in each segment. Segments of observations that took part in the fit
    have DATA_QUALITY = VALIDATED, those of others DEGRADED. Whole wavelengths are kept, weather is not.

    Parameters
    ----------
    solution : Solution
        Whose residuals are written.
    observations : Observations
        That it was made from, row by row: ``observations`` of :func:`~radioloc.studies.locate.arc_of`'s predictor.
    path : path-like
        The file; an existing one is replaced.
    originator : str
        Agency that makes the message.
    creation_date : str, optional
        UTC date of the message; now by default.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        The observations are others, or some that a message cannot hold (:func:`radioloc.io.tdm.write_tdm`).

    Examples
    --------
    >>> import radioloc
    >>> study = radioloc.read_study("examples/change5/short_arc.toml")
    >>> predictor, _ = radioloc.studies.arc_of(study)
    >>> solution = radioloc.residuals(study)
    >>> file = radioloc.report.write_residuals_tdm(solution, predictor.observations, "oc.tdm", originator="AGENCY")
    >>> file.name
    'oc.tdm'
    """
    rows = solution.residuals
    if not (
        len(rows) == len(observations)
        and np.array_equal(rows.epoch_utc.jd, observations.epoch.jd)
        and np.array_equal(rows.epoch_utc.fraction, observations.epoch.fraction)
    ):
        raise InputError(f"{solution.name}: the solution is not of these {len(observations)} observations")
    unrecorded: dict[str, Any] = dict.fromkeys([*WEATHER.values(), "modulus_m"], np.full(len(rows), np.nan))
    lengths = np.zeros(len(rows), dtype=bool)  # also where cycles of ramps were observed
    residuals = replace(observations, value_m=rows.residual_m, ramped=lengths, **unrecorded)
    header = TdmHeader(
        creation_date or datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S"),
        originator,
        comments=(f"{solution.name}: {_SAYS}",),
    )
    segments = [
        replace(segment, metadata={**segment.metadata, "DATA_QUALITY": quality}, data_comments=(_SAYS,))
        for quality, which in (("VALIDATED", rows.used), ("DEGRADED", ~rows.used))
        if which.any()
        for segment in tdm_of(residuals.select(which), header).segments
    ]
    write_tdm_file(path, TdmFile(str(path), header, tuple(segments)))
    return Path(path)
