"""Observations from Tracking Data Messages: what the segments mean, and their measurements in metres.

What becomes an observation is said by :data:`radioloc.io.tdm.message.TYPES`. What helps: TRANSMIT_FREQ, CLOCK_BIAS,
weather, in whatever segment. What says nothing to the models (angles, powers, magnitudes, media) is counted and passed
over. What measures the path in a way that is not modelled is refused.

A range is taken at its time tag: INTEGRATION_INTERVAL is the count interval of Doppler. Received frequencies count
cycles of the transmitted one (:mod:`radioloc.io.frequencies`). Where that is constant, cycles are a length whatever the
light time; where it changes, the observations are `ramped`, in metres by the first frequency, and the model finds out
which part of the ramps was received. So it is of ranges in range units.

Source: CCSDS 503.0-B-2 (2020), sections 3.3 to 3.5 and table 3-3.
"""

from __future__ import annotations

import logging
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from radioloc.constants import C_M_S
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import DataQualityWarning, FileFormatError, InputError
from radioloc.io.frequencies import MICROMETRES, range_change_m
from radioloc.io.tdm.agreement import TdmAgreement
from radioloc.io.tdm.message import (
    MEASURED,
    NOT_MODELLED,
    RANGE_RATES,
    RECEIVED,
    SENT,
    TYPES,
    TdmFile,
    TdmSegment,
    exponent_of,
)
from radioloc.io.tdm.segment import Reading, SegmentReader
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.observations import Observations, counted_once, without_duplicates
from radioloc.measurements.registry import KINDS, MEASUREMENTS
from radioloc.measurements.table_columns import FLIGHT_TIME_LIMITS_S
from radioloc.vectors import Floats

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class TdmReadout:
    """Observations from messages, and what else was in them."""

    observations: Observations  # segment by segment, in each by keyword, in order of time
    ignored: Mapping[str, int]  # how many records of each keyword became no observation and changed none
    notes: tuple[str, ...]  # what was done to the values and time tags beyond a change of unit

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
        raise InputError("no TDM was given; give at least one file")
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
    if keyword in RECEIVED:
        # Who reads peaks off a spectrum clicks some twice; of these the first counts.
        again = np.flatnonzero((np.diff(made.epoch.jd) == 0.0) & (np.diff(made.epoch.fraction) == 0.0))
        made = counted_once(made, again, again + 1, "a frequency of this epoch is already there")
    return made


INSTANTANEOUS_COUNT_S = 1.0
"""Count interval that stands for an instantaneous range rate, s.

Over a second the mean rate differs from the rate at its middle by a 24th of the path's third derivative, 2e-7 m/s
for a station on the turning Earth.
"""
# Two stations on the equator, one on either side of the Earth, part by 2 x 465 m/s.
_FASTEST_BASELINE = 1000.0 / C_M_S


def _ranges(part: SegmentReader, keyword: str) -> dict[str, Any]:
    """RANGE: light path there and back, or from the target."""
    epoch = part.tagged(keyword)
    units = part.segment.metadata.get("RANGE_UNITS", "km")
    unit_m = _range_unit_m(part, units)
    factor = unit_m * 10.0 ** exponent_of(keyword, units)
    modulus_m = part.segment.number("RANGE_MODULUS") * factor
    correction_m = part.segment.correction("RANGE") * factor
    if part.link.differenced:
        delay_s = part.differenced_delay_s()
    else:
        ends = [("TRANSMIT", part.sender), ("RECEIVE", part.receiver)]
        if not part.one_way:
            ends[1:1] = [("RECEIVE", part.target), ("TRANSMIT", part.target)]
        delay_s = part.delay_s(*(f"{way}_DELAY_{n}" for way, n in ends))
    value_m = unit_m * part.segment.values(keyword)
    value_m = part.less_delays(keyword, value_m, delay_s, correction_m)
    if modulus_m and part.link.differenced:
        problem = f"RANGE_MODULUS is {modulus_m:.6g} m: the difference is ambiguous by multiples of it"
        raise part.fail("RANGE_MODULUS", f"{problem}; resolve it and set RANGE_MODULUS = 0")
    columns: dict[str, Any] = {"epoch": epoch, "value_m": value_m} | part.frequencies(keyword)
    if units == "RU" and part.sent is not None:
        columns |= part.cycles(keyword, float(part.sent.value[0]))
    if modulus_m and (not part.agreement.lunar or modulus_m < C_M_S * FLIGHT_TIME_LIMITS_S[1]):
        return columns | {"modulus_m": modulus_m}
    _require_plausible(part, value_m)
    return columns


def _range_unit_m(part: SegmentReader, units: str) -> float:
    """Metres of light path in one of the units that RANGE is in (m where it is km in the file)."""
    mode = part.segment.metadata.get("RANGE_MODE", "")
    if mode and (mode == "ONE_WAY") != part.down_only:
        goes = "from the target to a station" if part.down_only else "to the target and back"
        raise part.fail("RANGE_MODE", f"RANGE_MODE is {mode}, but PATH goes {goes}; correct one of them")
    if units == "RU" and part.agreement.range_unit_s is None:
        problem = "RANGE_UNITS is RU, whose length is an agreement between the agencies"
        raise part.fail("RANGE_UNITS", f"{problem}; give range_unit_s (in a study file tdm_range_unit_s)")
    halves = 2.0 if part.agreement.range_convention == "half" and not part.down_only else 1.0
    return halves * {"km": 1.0, "s": C_M_S, "RU": C_M_S * (part.agreement.range_unit_s or 0.0)}[units]


def _require_plausible(part: SegmentReader, value_m: Floats) -> None:
    """Refuse ranges that cannot be between Earth and Moon, above all those of the other convention."""
    if not part.agreement.lunar or part.link.differenced:
        return
    low_m, high_m = (C_M_S * limit * (0.5 if part.one_way else 1.0) for limit in FLIGHT_TIME_LIMITS_S)
    way = "one way" if part.one_way else "there and back"
    limits = f"between Earth and Moon it is {low_m / 1000.0:.6g} to {high_m / 1000.0:.6g} km"
    fits = (value_m > low_m) & (value_m < high_m)
    convention = part.agreement.range_convention
    factor, other = (2.0, "half") if convention == "round_trip" else (0.5, "round_trip")
    twice = (factor * value_m > low_m) & (factor * value_m < high_m) & ~fits
    if twice.any() and not part.one_way:
        row = int(np.argmax(twice))
        path = f"RANGE gives a light path of {value_m[row] / 1000.0:.6g} km {way}, taken as {convention!r}"
        advice = f'off by a factor of two: set tdm_range = "{other}"'
        raise part.fail("RANGE", f"{path}; {limits}, {advice}", row)
    if part.reading.catalogue is not None and not fits.all():
        row = int(np.argmin(fits))
        problem = f"RANGE is {value_m[row] / 1000.0:.6g} km {way}, but {limits}"
        raise part.fail("RANGE", f"{problem}; correct it or leave it out", row)


def _count_interval(part: SegmentReader, keyword: str) -> tuple[float, float]:
    """Count interval, s, and how far its middle is after the time tag."""
    for name in ("INTEGRATION_INTERVAL", "INTEGRATION_REF"):
        if name not in part.segment.metadata:
            problem = f"{keyword} needs {name}, which has no default; add it to the metadata"
            raise part.fail(keyword, problem)
    count_s = part.segment.number("INTEGRATION_INTERVAL")
    after = {"START": 0.5, "MIDDLE": 0.0, "END": -0.5}[part.segment.metadata["INTEGRATION_REF"]]
    return count_s, after * count_s


def _range_rates(part: SegmentReader, keyword: str) -> dict[str, Any]:
    """DOPPLER_INTEGRATED or DOPPLER_INSTANTANEOUS: mean rate of the light path."""
    if len(set(part.segment.counts()) & set(RANGE_RATES)) > 1:
        problem = "mean and instantaneous range rates of one signal; leave one of them out"
        raise part.fail(keyword, problem)
    integrated = keyword == "DOPPLER_INTEGRATED"
    count_s, middle_s = _count_interval(part, keyword) if integrated else (INSTANTANEOUS_COUNT_S, 0.0)
    halves = 2.0 if part.agreement.doppler_convention == "half" and not part.down_only else 1.0
    rate_m_s = part.segment.values(keyword) + 1000.0 * part.segment.correction("DOPPLER")
    return {
        "epoch": part.tagged(keyword, middle_s),
        "value_m": halves * count_s * rate_m_s,
        "count_s": count_s,
    } | part.frequencies(keyword)


def _received(part: SegmentReader, keyword: str) -> dict[str, Any]:
    """RECEIVE_FREQ or RECEIVE_FREQ_n: mean received frequency."""
    if part.link.differenced:
        return _received_difference(part, keyword)
    if keyword not in ("RECEIVE_FREQ", f"RECEIVE_FREQ_{part.receiver}"):
        problem = f"is there, but PATH ends at participant {part.receiver}; correct one of them"
        raise part.fail(keyword, f"{keyword} {problem}")
    count_s, middle_s = _count_interval(part, keyword)
    its, link = part.agreed, part.link
    if part.sent is not None:
        base_hz = float(part.sent.value[0])
    elif its is not None:
        base_hz = its.transmit_hz
    else:
        sender = part.segment.participant(part.sender)
        problem = f"{keyword} needs TRANSMIT_FREQ_{part.sender} of {sender}; add it, in any segment"
        raise part.fail(keyword, f"{problem}, or say transmit_hz under [[observations.frequencies]]")
    if part.sent is None and its is not None and its.transmitter and part.one_way:
        link, ratio = replace(link, transmitter=part.reading.station(its.transmitter)), its.turnaround
    else:
        ratio = part.turnaround() or (its.turnaround if its is not None else None)
    if ratio is None:
        problem = "needs the transponder's ratio; give TURNAROUND_NUMERATOR and _DENOMINATOR, or turnaround"
        raise part.fail(keyword, f"{keyword} {problem} (in a study file tdm_turnaround)")
    epoch = part.tagged(keyword, middle_s)
    offset_hz = part.segment.number("FREQ_OFFSET")
    value_hz = part.segment.values(keyword) + part.segment.correction("RECEIVE")
    fail = partial(part.fail, keyword)
    value_m = range_change_m(value_hz, offset_hz, base_hz, ratio, count_s, fail)
    received_hz = offset_hz + value_hz
    columns = {"epoch": epoch, "value_m": value_m, "count_s": count_s} | part.frequencies(keyword)
    columns["wavelength_um"] = MICROMETRES * C_M_S / np.where(received_hz > 0.0, received_hz, np.nan)
    if part.sent is None and link.transmitter:
        columns["uplink_hz"] = base_hz
    columns |= part.cycles(keyword, base_hz)
    return columns | {"links": [link]} | _sigma_of_frequency(part, count_s, base_hz * ratio[0] / ratio[1])


def _sigma_of_frequency(part: SegmentReader, count_s: float, nominal_hz: float) -> dict[str, float]:
    """Sigma of Doppler where that of its frequencies is agreed on."""
    return {} if part.agreed is None else {"sigma_m": C_M_S * count_s * part.agreed.sigma_hz / nominal_hz}


def _received_difference(part: SegmentReader, keyword: str) -> dict[str, Any]:
    """RECEIVE_FREQ of two paths: mean frequency at the second station less that at the first."""
    count_s, middle_s = _count_interval(part, keyword)
    beacon_hz = part.beacon_hz(keyword)
    if np.isnan(beacon_hz):
        name = SENT[part.target - 1]
        problem = f"{keyword} of two paths needs {name}, one frequency that the target sends; add it"
        raise part.fail(keyword, f"{problem}, or say transmit_hz under [[observations.frequencies]]")
    apart_hz = (
        part.segment.values(keyword) + part.segment.number("FREQ_OFFSET") + part.segment.correction("RECEIVE")
    )
    if (np.abs(apart_hz) > _FASTEST_BASELINE * beacon_hz).any():
        row = int(np.argmax(np.abs(apart_hz)))
        problem = (
            f"{keyword} is {float(apart_hz[row])!r} Hz, but of two paths it is the difference of frequencies"
        )
        raise part.fail(keyword, f"{problem}, up to {_FASTEST_BASELINE * beacon_hz:.6g} Hz", row)
    return (
        {
            "epoch": part.tagged(keyword, middle_s),
            "value_m": -C_M_S * count_s * apart_hz / beacon_hz,
            "count_s": count_s,
        }
        | part.frequencies(keyword)
        | _sigma_of_frequency(part, count_s, beacon_hz / np.sqrt(2.0))
    )


def _delays(part: SegmentReader, keyword: str) -> dict[str, Any]:
    """VLBI_DELAY or DOR: arrival at the second station less that at the first."""
    for name in ("CORRECTION_RANGE", "CORRECTION_RECEIVE", "CORRECTION_TRANSMIT"):
        if name in part.segment.metadata and part.segment.metadata.get("CORRECTIONS_APPLIED") == "NO":
            problem = f"is not applied, and how it is to be applied to {keyword} is not said; apply it"
            raise part.fail(name, f"{name} {problem}")
    value_m = C_M_S * part.segment.values(keyword)
    value_m = part.less_delays(keyword, value_m, part.differenced_delay_s())
    if part.segment.number("RANGE_MODULUS"):
        part.note(f"RANGE_MODULUS is that of ranges, not applied to {keyword}")
    return {"epoch": part.tagged(keyword), "value_m": value_m} | part.frequencies(keyword)


VALUES: Mapping[str, Callable[[SegmentReader, str], dict[str, Any]]] = {
    "RANGE": _ranges,
    **dict.fromkeys(RANGE_RATES, _range_rates),
    **dict.fromkeys(RECEIVED, _received),
    **dict.fromkeys(("VLBI_DELAY", "DOR"), _delays),
}
"""What makes columns of observations, epoch and value_m among them, of the records of each data keyword."""
