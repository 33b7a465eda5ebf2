"""Observations from Tracking Data Messages: what the segments mean.

What becomes an observation is said by :data:`radioloc.io.tdm.keywords.TYPES`. What helps: TRANSMIT_FREQ, CLOCK_BIAS,
weather, in whatever segment. What says nothing to the models (angles, powers, magnitudes, media) is counted and passed
over. What measures the path in a way that is not modelled is refused.

Source: CCSDS 503.0-B-2 (2020), sections 3.3 to 3.5.
"""

from __future__ import annotations

import logging
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from radioloc.constants import C_M_S
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import DataQualityWarning, FileFormatError, InputError
from radioloc.io.tdm.agreement import TdmAgreement
from radioloc.io.tdm.keywords import MEASURED, NOT_MODELLED, RANGE_RATES, RECEIVED, TYPES
from radioloc.io.tdm.message import TdmFile, TdmSegment
from radioloc.io.tdm.reading import Reading
from radioloc.io.tdm.segment import SegmentReader
from radioloc.io.tdm.values import VALUES
from radioloc.measurements.ambiguity import without_ambiguity
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.observations import Observations, without_duplicates
from radioloc.measurements.registry import KINDS, MEASUREMENTS

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
    files: TdmFile | Sequence[TdmFile], agreement: TdmAgreement, *, catalogue: StationCatalogue | None = None
) -> TdmReadout:
    """Make observations of one or more messages, which may complement each other.

    Parameters
    ----------
    files : TdmFile or sequence of TdmFile
        The messages; frequencies, clocks and weather of one count for the measurements of all.
    agreement : TdmAgreement
        What the messages do not say.
    catalogue : StationCatalogue, optional
        Gives stations their catalogue names; one that it does not know keeps the name that the file gives it. With one
        every range must be one between Earth and Moon.

    Raises
    ------
    FileFormatError
        There is no measurement; a mode, path or measurement is not modelled; something that
        the data need is missing or contradicts them. Names the line.
    InputError
        The agreement lacks a standard deviation, or one observation has two values.

    Warns
    -----
    DataQualityWarning
        A segment says of its data that they are degraded, or the same observation is there twice, and counted once.
    """
    messages = [files] if isinstance(files, TdmFile) else list(files)
    if not messages:
        raise InputError("no TDM was given; give at least one")
    segments = [segment for message in messages for segment in message.segments]
    reading = Reading(segments, agreement, catalogue)
    parts: list[Observations] = []
    # What overflows becomes infinite and is refused with its line.
    with np.errstate(over="ignore", invalid="ignore"):
        for segment in segments:
            parts += _read_segment(reading, segment)
    counts = [segment.counts() for segment in segments]
    if not parts:
        held = ", ".join(sorted({keyword for count in counts for keyword in count}))
        raise FileFormatError(reading.files[0], f"holds no range, Doppler or VLBI delay, only {held}")
    observations = Observations.concatenate(parts) if len(parts) > 1 else parts[0]
    observations = without_duplicates(observations)
    ignored: Counter[str] = Counter()
    for segment, count in zip(segments, counts, strict=True):
        ignored.update({k: n for k, n in count.items() if (segment, k) not in reading.used})
    readout = TdmReadout(observations, dict(ignored), tuple(dict.fromkeys(reading.notes)))
    _log.info("%s\n%s", ", ".join(observations.files), readout.summary())
    return readout


def _read_segment(reading: Reading, segment: TdmSegment) -> list[Observations]:
    """Observations of one segment, by keyword."""
    metadata, held = segment.metadata, [k for k in segment.counts() if k in MEASURED]
    # Beside range rates, or beside ranges and without a count interval, a received frequency is no measurement.
    beside = {*RANGE_RATES, *(["RANGE"] if "INTEGRATION_INTERVAL" not in metadata else [])}
    measured = [keyword for keyword in held if keyword not in RECEIVED or not beside & set(held)]
    if not measured:
        return []
    part = SegmentReader(reading, segment)
    if metadata.get("DATA_QUALITY") == "DEGRADED":
        where = f"{segment.path}, line {segment.line_of('DATA_QUALITY')}"
        warnings.warn(f"{where}: DATA_QUALITY is DEGRADED", DataQualityWarning, stacklevel=4)
    reading.used |= {(segment, keyword) for keyword in measured}
    return [_read(part, keyword) for keyword in measured]


def _read(part: SegmentReader, keyword: str) -> Observations:
    """Observations that a keyword's records are."""
    if keyword in NOT_MODELLED:
        problem = "is not modelled; convert it to RECEIVE_FREQ or leave it out"
        raise part.fail(keyword, f"{keyword} {problem}")
    held = {k: words for k, words in TYPES.items() if MEASUREMENTS[k].form == part.link.form}
    kind = next((kind for kind, keywords in held.items() if keyword in keywords), None)
    if kind is None:
        mode = part.segment.metadata["MODE"]
        known = ", ".join(dict.fromkeys(k for keywords in held.values() for k in keywords[:2]))
        raise part.fail(keyword, f"{keyword} of MODE = {mode} is not modelled; on its path can be {known}")
    if part.tag not in MEASUREMENTS[kind].tags or (part.tag != "receive" and keyword != "RANGE"):
        problem = f"TIMETAG_REF is {part.tag.upper()}; {keyword} is modelled at its reception only"
        raise part.fail("TIMETAG_REF", problem)
    columns = part.weather(keyword) | {"links": [part.link]} | VALUES[keyword](part, keyword)
    if columns["links"][0].form != part.link.form:
        kind = "doppler"  # of a signal on one path down that a station is known to have caused
    files = part.reading.files
    sigma_m = columns.pop("sigma_m", part.agreement.sigma_m.get(kind))
    if sigma_m is None:
        raise part.fail(
            keyword,
            f"a TDM says nothing of uncertainties, and it holds {kind} observations: "
            f"give sigma_m = {{{kind!r}: ...}} (in a study file [observations] sigma_m = {{ {kind} = ... }}, "
            f"to radioloc convert --sigma {kind}=...), in metres",
        )
    made = Observations.from_columns(
        sigma_m=sigma_m,
        kind=KINDS.index(kind),
        tag=TIME_TAGS.index(part.tag),
        files=files,
        file=files.index(part.segment.path),
        line=part.segment.line[part.segment.rows(keyword)],
        **columns,
    )
    if np.isnan(made.modulus_m).all() or made.ramped.any():
        return made
    light_s = part.agreement.known_light_time_s(made.epoch, part.link, part.tag)
    return made if light_s is None else without_ambiguity(made, C_M_S * light_s)
