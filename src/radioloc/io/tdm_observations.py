"""Observations from Tracking Data Messages.

What becomes an observation: RANGE, DOPPLER_INTEGRATED, DOPPLER_INSTANTANEOUS and RECEIVE_FREQ of two- and three-way
paths, VLBI_DELAY and DOR of two stations. What helps: TRANSMIT_FREQ, CLOCK_BIAS, weather, in whatever segment. What
says nothing to the models (angles, powers, magnitudes, media) is counted and passed over. What measures the path
in a way that is not modelled is refused.

Source: CCSDS 503.0-B-2 (2020), sections 3.3 to 3.5.
"""

from __future__ import annotations

import logging
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from radioloc.errors import DataQualityWarning, FileFormatError, InputError
from radioloc.io.checks import Catalogue, refuse_duplicates
from radioloc.io.tdm_agreement import TdmAgreement
from radioloc.io.tdm_clocks import Clocks
from radioloc.io.tdm_file import TdmFile, TdmSegment
from radioloc.io.tdm_frequencies import Sent
from radioloc.io.tdm_keywords import CODE, DATA, DELAYS, MEASURED, NOT_MODELLED, RANGE_RATES, RECEIVED
from radioloc.io.tdm_measurements import SegmentReader, Shared
from radioloc.io.tdm_paths import Names
from radioloc.measurements.observations import Observations
from radioloc.time import Epochs

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class TdmReadout:
    """Observations from messages, and what else was in them.

    Parameters
    ----------
    observations : Observations
        The observations, segment by segment, in each by keyword, in order of time.
    ignored : mapping of str to int
        How many records of each keyword became no observation and changed none.
    notes : tuple of str
        What was done to the values and time tags beyond a change of unit.
    """

    observations: Observations
    ignored: Mapping[str, int]
    notes: tuple[str, ...]

    def summary(self) -> str:
        """Text for people: what was read, what was done to it, what was passed over."""
        passed = ", ".join(f"{count} {keyword}" for keyword, count in self.ignored.items()) or "nothing"
        return "\n".join([self.observations.summary(), *self.notes, f"passed over: {passed}"])


def tdm_observations(
    files: TdmFile | Sequence[TdmFile], agreement: TdmAgreement, *, catalogue: Catalogue | None = None
) -> TdmReadout:
    """Make observations of one or more messages, which may complement each other.

    Parameters
    ----------
    files : TdmFile or sequence of TdmFile
        The messages; frequencies, clocks and weather of one count for the measurements of all.
    agreement : TdmAgreement
        What the messages do not say.
    catalogue : Catalogue, optional
        Gives stations their catalogue names; every station must be in it, and every range must be one between
        Earth and Moon. Without one, names and values stand as they are.

    Raises
    ------
    FileFormatError
        There is no measurement; a mode, path or measurement is not modelled; a station is unknown; something that
        the data need is missing or contradicts them. Names the line.
    InputError
        The agreement lacks a standard deviation, or the same observation is there twice.

    Warns
    -----
    DataQualityWarning
        A segment says of its data that they are degraded.
    """
    messages = [files] if isinstance(files, TdmFile) else list(files)
    if not messages:
        raise InputError("no TDM was given; give at least one")
    segments = [(file, segment) for file in messages for segment in file.segments]
    names = Names(catalogue)
    shared = Shared(
        segments,
        tuple(dict.fromkeys(file.path for file in messages)),
        agreement,
        names,
        Sent.of(segments, names, delays_removed=agreement.delays_removed),
        Clocks.of(segments if agreement.apply_clocks else [], names),
    )
    # What overflows becomes infinite and is refused with its line.
    with np.errstate(over="ignore", invalid="ignore"):
        for place, (file, segment) in enumerate(segments):
            _read_segment(shared, place, file, segment)
    readout = _readout(shared)
    _log.info("%s\n%s", ", ".join(shared.files), readout.summary())
    return readout


def _read_segment(shared: Shared, place: int, file: TdmFile, segment: TdmSegment) -> None:
    """Add the observations of one segment."""
    held = [keyword for keyword in segment.keywords() if keyword in MEASURED]
    # Beside range rates, or beside ranges and without a count interval, a received frequency is no measurement.
    beside = {"RANGE", *RANGE_RATES} if "INTEGRATION_INTERVAL" not in segment.metadata else {*RANGE_RATES}
    measured = [keyword for keyword in held if keyword not in RECEIVED or not beside & set(held)]
    if not measured:
        return
    part = SegmentReader(shared, place, file.path, segment, delay=bool(set(measured) & set(DELAYS)))
    if segment.metadata.get("DATA_QUALITY") == "DEGRADED":
        where = f"{file.path}, line {segment.line_of('DATA_QUALITY')}"
        warnings.warn(f"{where}: DATA_QUALITY is DEGRADED", DataQualityWarning, stacklevel=4)
    for keyword in measured:
        shared.used.add((place, keyword))
        if part.signal.link.differenced and keyword not in DELAYS:
            problem = (
                f"{keyword} of MODE = SINGLE_DIFF is not modelled; differenced are only VLBI_DELAY and DOR"
            )
            raise part.fail(keyword, problem)
        if keyword in NOT_MODELLED:
            raise part.fail(keyword, f"{keyword} is not modelled; convert it to RECEIVE_FREQ or leave it out")
        if keyword == "RANGE":
            part.add_ranges()
        elif keyword in RANGE_RATES:
            part.add_range_rates(keyword)
        elif keyword in DELAYS:
            part.add_delays(keyword)
        else:
            part.add_received(keyword)


def _readout(shared: Shared) -> TdmReadout:
    if not shared.columns:
        held = ", ".join(sorted({k for _, segment in shared.segments for k in segment.keywords()}))
        raise FileFormatError(shared.files[0], f"holds no range, Doppler or VLBI delay, only {held}")
    epoch = Epochs.concatenate([part.pop("epoch") for part in shared.columns])
    # A column that is joined is let go; one that need not be joined may be a single number for all of its rows.
    joined: dict[str, Any] = {
        name: np.concatenate(parts) if len(parts) > 1 else parts[0]
        for name in list(shared.columns[0])
        for parts in [[part.pop(name) for part in shared.columns]]
    }
    observations = Observations.from_columns(
        epoch=epoch,
        links=tuple(shared.links),
        files=shared.files,
        **joined,
    )
    refuse_duplicates(observations)
    ignored: Counter[str] = Counter()
    for place, (_, segment) in enumerate(shared.segments):
        counts = np.bincount(segment.keyword, minlength=len(DATA))
        for keyword in segment.keywords():
            if (place, keyword) not in shared.used:
                ignored[keyword] += int(counts[CODE[keyword]])
    return TdmReadout(observations, dict(ignored), tuple(dict.fromkeys(shared.notes)))
